"""The noise of a log's sensors at rest as an object: coefficients with intervals, tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from imuarray.characterise.text import render_text
from imuarray.errors import LogError
from imuarray.spelling import guess

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TERMS: Mapping[str, str] = {"white": "N", "flicker": "B", "random walk": "K"}
"""Terms of the fit to an Allan deviation, with their letters in IEEE Std 952."""

PLOTS = ("allan", "spectrum", "autocorrelation", "histogram")


class Coefficient(NamedTuple):
    """A noise coefficient with its 95 % interval, in the sensor's unit (g or dps; per root hertz for "white", per root
    second for "random walk"). Not `significant`: not seen in the log, and at most `high`.
    """

    value: float
    low: float
    high: float
    significant: bool


@dataclass(frozen=True, repr=False)
class Characterisation:
    """Result of `characterise_log` (`result`, JSON-ready, SI and counts by name)."""

    result: Mapping[str, Any]

    @property
    def sensors(self) -> tuple[str, ...]:
        """The names of the sensors."""
        return tuple(sensor["name"] for sensor in self.result["sensors"])

    def axis(self, sensor: str, axis: str) -> Mapping[str, Any]:
        """Return all figures of one axis, as in `result`; LogError if the log lacks it."""
        for row in self.result["sensors"]:
            if row["name"] == sensor:
                for entry in row["axes"]:
                    if entry["axis"] == axis:
                        return dict(entry)
                raise LogError(f"{sensor}: no axis {axis!r}; allowed are {', '.join(a['axis'] for a in row['axes'])}")
        raise LogError(
            f"no sensor {sensor!r} was characterised; there are {', '.join(self.sensors)}{guess(sensor, self.sensors)}"
        )

    def coefficient(self, sensor: str, axis: str, term: str = "white") -> Coefficient | None:
        """White noise density ("white"), bias instability ("flicker") or rate random walk ("random walk") of an axis;
        None where the log was too short to fit any. LogError for a sensor, an axis or a term that there is not.
        """
        if term not in TERMS:
            raise LogError(f"term {term!r}: allowed are {', '.join(TERMS)}")
        entry = self.axis(sensor, axis)
        fitted = (entry.get("fit") or {}).get("terms", {}).get(term)
        if fitted is None:
            return None
        scale = abs(entry["unit_per_count"] or 1.0)
        value, low, high = (scale * fitted[name] for name in ("value", "low", "high"))
        return Coefficient(value, low, high, fitted["significant"])

    def plot(self, kind: str = "allan") -> Figure:
        """A figure of all sensors: "allan", "spectrum", "autocorrelation" or "histogram". LogError for another kind,
        MissingExtraError without matplotlib.
        """
        if kind not in PLOTS:
            raise LogError(f"plot {kind!r}: allowed are {', '.join(PLOTS)}")
        from imuarray.characterise.plots import FIGURES

        return FIGURES[f"{kind}.png"](self.result)

    def to_pandas(self) -> Any:
        """A `pandas.DataFrame` with a row for each axis: coefficients with their intervals, in the sensor's unit, nan
        where a term was not fitted. MissingExtraError without pandas.
        """
        from imuarray.log.datasets import optional_package

        pandas = optional_package("pandas")
        rows = []
        for sensor in self.result["sensors"]:
            for entry in sensor["axes"]:
                row = {"sensor": sensor["name"], "axis": entry["axis"], "unit": sensor["unit"]}
                row |= {name: entry["unit"][name] for name in ("mean", "std", "sem")}
                for term, letter in TERMS.items():
                    known = self.coefficient(sensor["name"], entry["axis"], term)
                    for name in ("value", "low", "high"):
                        row[letter if name == "value" else f"{letter}_{name}"] = getattr(known, name, float("nan"))
                rows.append(row)
        return pandas.DataFrame(rows).set_index(["sensor", "axis"])

    def __str__(self) -> str:
        return render_text(self.result)

    def __repr__(self) -> str:
        stretch = self.result["stretch"]
        seconds = stretch["end_s"] - stretch["start_s"]
        return f"<Characterisation of {len(self.sensors)} sensors of {self.result['log']}, {seconds:.0f} s at rest>"

    def _repr_html_(self) -> str:
        """White noise, bias instability and random walk of each axis, for notebooks."""
        from imuarray.html_table import html_table

        rows = []
        for sensor in self.result["sensors"]:
            for entry in sensor["axes"]:
                known = (self.coefficient(sensor["name"], entry["axis"], term) for term in TERMS)
                rows.append((f"{sensor['name']} {entry['axis']}", sensor["unit"], *map(_spelled, known)))
        heading = ("axis", "unit", "N, unit/√Hz", "B, unit", "K, unit/√s")
        return html_table(f"{self!r}; intervals of 95 %".strip("<>"), heading, rows)


def _spelled(coefficient: Coefficient | None) -> str:
    if coefficient is None:
        return "–"
    if not coefficient.significant:
        return f"< {coefficient.high:.2g}"
    return f"{coefficient.value:.3g} ({coefficient.low:.2g} to {coefficient.high:.2g})"
