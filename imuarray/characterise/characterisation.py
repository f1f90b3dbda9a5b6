"""The noise of a log's sensors at rest as an object: coefficients with intervals, tables and figures.

The text table has at most 110 columns and one block per quantity, in the sensor's unit.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from imuarray.characterise.findings import findings
from imuarray.errors import LogError
from imuarray.spelling import guess

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 110

_HEAD = (
    f"{'sensor':12} {'axis':4} {'mean':>10} {'std':>9} {'std':>8} {'error of':>9} {'lag-1':>6} {'even':>5}"
    f" {'repeat':>6}"
)
_FIT_HEAD = f"{'sensor':12} {'axis':4} {'N':>17} {'B':>17} {'K':>17} {'p':>7} {'lowest':>10} {'at tau':>7}"
_ROWS_HEAD = (
    f"{'sensor':12} {'chip':9} {'range':12} {'rate Hz':>7} {'rows':>9} {'gaps':>5} {'max ms':>9}  Allan deviation from"
)
_ALIGNMENT_HEAD = (
    f"{'':12} {'':>10} {'faster by':>10} {'nearest row, us':>19} {'gains or loses':>15} {'time known':>11}",
    f"{'sensor':12} {'rate Hz':>10} {'ppm':>10} {'mean':>9} {'std':>9} {'a row in s':>15} {'to us':>11}"
    f" {'delay us':>16}",
)
_ALIGNMENT_NOTES = (
    "faster by: excess of the row rate over that of the reference, in parts per million. nearest row: time from a row"
    " of the reference to the nearest row of the sensor, which varies if chips sample by their own clocks. gains or"
    " loses a row: the time in which it gets one row ahead or behind. time known: largest error of the times of a"
    " drained queue, as stated in the log (median). delay: delay of a gyroscope's response to the rotation in addition"
    " to its known filter delay, with its 95 % interval. pulses: later by is the mean error of the sensor's times"
    " against those of the first, with its 95 % interval."
)
_NOTES = (
    "error of the mean: its standard error, including correlation. repeat: rows without a new reading, flagged as "
    "stale or equal to the row before beyond chance. N: density of the white noise, two-sided "
    "(IEEE Std 952; a data sheet's one-sided figure is 1.41 N), B: bias instability, K: rate random walk, fitted to "
    "the Allan deviation with 95 % intervals; '<': not significant, with its upper limit. p: probability of "
    "such a misfit under the model; '!' and B, K in brackets: p is too small, the noise is of another kind (a line, a "
    "drift, a filter, a process with a time constant). lowest: lowest point of the curve / 0.664, "
    "'<' if the curve still falls at its end. Runs between gaps are pooled. "
    "Means are raw: they include the bias, and for an accelerometer gravity. Units are by "
    "the given calibration, or by the data sheet's typical sensitivity."
)


def render_text(result: Mapping[str, Any]) -> str:
    """Return the result of `characterise_log` as lines of text, the last one ended."""
    lines = list(_heading(result))
    for quantity in dict.fromkeys(sensor["quantity"] for sensor in result["sensors"]):
        sensors = [sensor for sensor in result["sensors"] if sensor["quantity"] == quantity]
        lines += ["", *_table(quantity, sensors), "", *_fits(sensors)]
    if sentences := findings(result):
        lines += [
            "",
            "remarks",
            *(
                line
                for sentence in sentences
                for line in textwrap.wrap(sentence, WIDTH, initial_indent="  ", subsequent_indent="    ")
            ),
        ]
    lines += ["", _ROWS_HEAD, *(line for sensor in result["sensors"] for line in _rows(sensor))]
    if result["alignment"] is not None:
        lines += ["", *_alignment(result["alignment"]), *_wrap(_ALIGNMENT_NOTES)]
    return "\n".join([*lines, "", *_wrap(_NOTES), ""])


def _alignment(alignment: Mapping[str, Any]) -> Iterator[str]:
    """Yield the table of the sensors' alignment in time, one line per sensor."""
    motion = ""
    if alignment["delays_from"]:
        since = f"{alignment['motion_from_s']:.0f} s"
        motion = f"; delays relative to {alignment['delays_from']}, by the rotation from {since} on"
    yield from _wrap(f"alignment in time, relative to {alignment['reference']}{motion}")
    yield from _ALIGNMENT_HEAD
    for sensor in alignment["sensors"]:
        distance = "-" if sensor["row_apart_s"] is None else _seconds(sensor["row_apart_s"])
        delay = "-"
        if sensor["delay_s"] is not None:
            delay = f"{1e6 * sensor['delay_s']:.1f}"
            if sensor["delay_error_s"]:
                delay += f" +-{1.96e6 * sensor['delay_error_s']:.1f}"
        yield (
            f"{_cut(sensor['name'], 12):12} {sensor['rate_hz']:>10.3f} {sensor['rate_ppm']:>10.0f} "
            f"{_micro(sensor['offset_s']):>9} {_micro(sensor['spread_s']):>9} {distance:>15} "
            f"{_micro(sensor['time_uncertainty_s']):>11} {delay:>16}"
        )
    if alignment["pulses_from"]:
        yield ""
        yield from _pulses(alignment)


def _pulses(alignment: Mapping[str, Any]) -> Iterator[str]:
    """Yield the table of the times of synchronisation pulses, one line per sensor that has them."""
    yield from _wrap(f"synchronisation pulses, relative to {alignment['pulses_from']}")
    yield f"{'sensor':12} {'pulses':>10} {'later by us':>20}"
    for sensor in alignment["sensors"]:
        if sensor["pulse_offset_s"] is not None:
            offset = f"{1e6 * sensor['pulse_offset_s']:.1f}"
            if sensor["name"] != alignment["pulses_from"]:
                offset += f" +-{1e6 * sensor['pulse_error_s']:.1f}"
            yield f"{_cut(sensor['name'], 12):12} {sensor['pulses']:>10} {offset:>20}"
    yield ""


def _seconds(seconds: float) -> str:
    """Format seconds with three digits and without powers of ten."""
    return f"{seconds:.3g}" if seconds < 999.5 else f"{seconds:.0f}"


def _micro(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1e6 * seconds:.1f}"


def _wrap(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH)


def _heading(result: Mapping[str, Any]) -> Iterator[str]:
    """Yield the log and the stretch, and a warning if no phase is at rest."""
    stretch = result["stretch"]
    emulated = " (emulated, no hardware)" if result["source"] == "emulated" else ""
    yield from _wrap(f"{result['log']}{emulated}")
    phase = f"phase {stretch['phase']!r}, " if stretch["phase"] is not None else ""
    direction = f", {stretch['up']} up" if stretch["up"] else ""
    yield from _wrap(
        f"{phase}{stretch['start_s']:.1f} s to {stretch['end_s']:.1f} s{direction} ({stretch['chosen_by']})"
    )
    if stretch["phase"] is None:
        yield "no phase is at rest: any motion counts as noise here"


def _table(quantity: str, sensors: list[Mapping[str, Any]]) -> Iterator[str]:
    unit = sensors[0]["unit"]
    title = quantity.replace("_", " ")
    yield f"{title} in {unit}; the second std in counts; shares in %"
    yield _HEAD
    yield f"{'':12} {'':4} {'':>10} {'':>9} {'counts':>8} {'the mean':>9}"
    for sensor in sensors:
        yield from (_line(sensor, axis) for axis in sensor["axes"])


def _line(sensor: Mapping[str, Any], axis: Mapping[str, Any]) -> str:
    """Return the line of one axis, in counts if the log has no sensitivity."""
    values = axis["unit"] if sensor["unit_per_count"] is not None else axis["counts"]
    return (
        f"{_cut(sensor['name'], 12):12} {_cut(axis['axis'], 4):4} {_number(values['mean'], 4):>10} "
        f"{_number(values['std'], 4):>9} {_number(axis['counts']['std'], 4):>8} {_number(values['sem']):>9} "
        f"{_format_fixed(axis['lag1'], 3):>6} {_format_fixed(axis['even_share'], 1, 100):>5} "
        f"{_format_fixed(_repeat_share(sensor), 2, 100):>6}"
    )


def _repeat_share(sensor: Mapping[str, Any]) -> float | None:
    """Return the share of rows without a new reading: flagged as stale, or equal to the row before beyond chance."""
    new_share = sensor["timing"]["repeats"]["new_share"] if sensor["timing"] else None
    shares = [
        share for share in (sensor["stale_share"], None if new_share is None else 1 - new_share) if share is not None
    ]
    return max(shares, default=None)


def _fits(sensors: list[Mapping[str, Any]]) -> Iterator[str]:
    unit = sensors[0]["unit"] if sensors[0]["unit_per_count"] is not None else "counts"
    yield f"noise of the Allan deviation: N in {unit}/sqrt(Hz), B in {unit}, K in {unit}/sqrt(s), tau in s"
    yield _FIT_HEAD
    for sensor in sensors:
        yield from (_fit_line(sensor, axis) for axis in sensor["axes"])


def _fit_line(sensor: Mapping[str, Any], axis: Mapping[str, Any]) -> str:
    scale = axis["unit_per_count"] if axis["unit_per_count"] is not None else 1.0
    values = axis["unit"] if sensor["unit_per_count"] is not None else axis["counts"]
    fit = axis.get("fit")
    terms = [_term(fit, name, scale) for name in ("white", "flicker", "random walk")]
    doubtful = "!" if fit and fit["verdict"] else ""
    bound = "<" if axis["bias_instability_is_bound"] else ""
    return (
        f"{_cut(sensor['name'], 12):12} {_cut(axis['axis'], 4):4} {terms[0]:>17} {terms[1]:>17} {terms[2]:>17} "
        f"{_number(fit['p_value'] if fit else None, 2) + doubtful:>7} "
        f"{bound + _number(values['bias_instability']):>10} {_number(axis['bias_instability_tau_s']):>7}"
    )


def _term(fit: Mapping[str, Any] | None, name: str, scale: float) -> str:
    """Return a coefficient with half its interval in per cent, or its upper limit; B and K are in brackets, without an
    interval, if the curve is not a sum of these noises, for example because of a process with a time constant.
    """
    term = fit["terms"].get(name) if fit else None
    if term is None or term["value"] is None:
        return "-"
    if not term["significant"] or term["low"] <= 0:
        return f"<{term['high'] * scale:.3g}"
    if term["doubtful"]:
        return f"({term['value'] * scale:.3g})"
    return f"{term['value'] * scale:.3g} +-{50 * (term['high'] - term['low']) / term['value']:.2g} %"


def _cut(name: str, width: int) -> str:
    return name if len(name) <= width else name[: width - 1] + "~"


def _number(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}g}"


def _format_fixed(value: float | None, digits: int, factor: float = 1.0) -> str:
    return "-" if value is None else f"{value * factor:.{digits}f}"


def _rows(sensor: Mapping[str, Any]) -> Iterator[str]:
    """Yield rate, rows, gaps and the rows of the Allan deviation, followed by the flags of the log."""
    run, scale = sensor["allan_run"], f"+-{sensor['range']:g} {sensor['unit']}" if sensor["range"] else ""
    has_allan = any(axis["allan"] for axis in sensor["axes"])
    stretch = f"{run['rows']} rows, {run['start_s']:.1f} s to {run['end_s']:.1f} s" if has_allan else "too few rows"
    if has_allan and run["runs"] > 1:
        longest_s = run["end_s"] - run["start_s"]
        stretch = f"{run['rows']} rows in {run['runs']} runs of <={longest_s:.3g} s"
    longest_ms = None if sensor["largest_gap_s"] is None else sensor["largest_gap_s"] * 1e3
    name, chip = _cut(sensor["name"], 12), _cut(sensor["chip"], 9)
    yield (
        f"{name:12} {chip:9} {_cut(scale, 12):12} {_number(sensor['rate_hz'], 4):>7} {sensor['rows']:>9} "
        f"{sensor['gaps']:>5} {_number(longest_ms, 4):>9}  {stretch}"
    )
    if sensor["rows"] > run["rows"] > 1:
        yield f"{'':12} {_format_fixed(run['left_out_share'], 1, 100)} % of the rows excluded from the Allan deviation"
    flags = ", ".join(f"{count} {name}" for name, count in sensor["flags"].items() if count)
    if flags:
        yield f"{'':12} {flags}"


TERMS: Mapping[str, str] = {"white": "N", "flicker": "B", "random walk": "K"}
"""Terms of the fit to an Allan deviation, with their letters in IEEE Std 952."""

PLOTS = ("allan", "spectrum", "autocorrelation", "histogram")


class Coefficient(NamedTuple):
    """A noise coefficient with its 95 % interval, in `unit`: the sensor's unit (g or dps), per root hertz for "white",
    per root second for "random walk". If not `significant`, the log does not show this noise, which is at most `high`.
    If `doubtful`, the Allan deviation is not a sum of the fitted noises, and the value may be that of a line, a drift
    or coloured noise.
    """

    value: float
    low: float
    high: float
    significant: bool
    doubtful: bool = False
    unit: str = ""

    def __repr__(self) -> str:
        values = f"value={self.value:.4g}, low={self.low:.4g}, high={self.high:.4g}, unit={self.unit!r}"
        return f"Coefficient({values}, significant={self.significant}, doubtful={self.doubtful})"


_PER = {"white": "/sqrt(Hz)", "flicker": "", "random walk": "/sqrt(s)"}
"""The unit of a coefficient, after that of the sensor."""


@dataclass(frozen=True, repr=False)
class Characterisation:
    """Result of `characterise_log` (`result`: the same as for JSON, in counts, the sensor's unit and SI)."""

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
            f"no sensor {sensor!r} was characterised; allowed are {', '.join(self.sensors)}"
            f"{guess(sensor, self.sensors)}"
        )

    def coefficient(self, sensor: str, axis: str, term: str = "white") -> Coefficient | None:
        """Return the white noise density ("white"), bias instability ("flicker") or rate random walk ("random walk") of
        an axis; None if the log was too short for a fit. LogError for an unknown sensor, axis or term.
        """
        if term not in TERMS:
            raise LogError(f"term {term!r}: allowed are {', '.join(TERMS)}")
        entry = self.axis(sensor, axis)
        fitted = (entry.get("fit") or {}).get("terms", {}).get(term)
        if fitted is None:
            return None
        scale = abs(entry["unit_per_count"] or 1.0)
        value, low, high = (scale * fitted[name] for name in ("value", "low", "high"))
        unit = next(row["unit"] for row in self.result["sensors"] if row["name"] == sensor)
        return Coefficient(value, low, high, fitted["significant"], fitted["doubtful"], unit + _PER[term])

    def plot(self, kind: str = "allan") -> Figure:
        """Return a figure of all sensors; `kind` is "allan", "spectrum", "autocorrelation" or "histogram". LogError for
        another kind, MissingExtraError without matplotlib.
        """
        if kind not in PLOTS:
            raise LogError(f"plot {kind!r}: allowed are {', '.join(PLOTS)}")
        from imuarray.characterise.plots import FIGURES

        return FIGURES[f"{kind}.png"](self.result)

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame` with a row for each axis: coefficients with their intervals, in the sensor's
        unit, nan where a term was not fitted, and whether each is doubtful (`Coefficient`). MissingExtraError without
        pandas.
        """
        from imuarray.log.datasets import optional_package

        pandas = optional_package("pandas")
        rows = []
        for sensor in self.result["sensors"]:
            for entry in sensor["axes"]:
                row = {"sensor": sensor["name"], "axis": entry["axis"], "unit": sensor["unit"]}
                row |= {name: entry["unit"][name] for name in ("mean", "std", "sem")}
                for term, letter in TERMS.items():
                    coefficient = self.coefficient(sensor["name"], entry["axis"], term)
                    for name in ("value", "low", "high"):
                        row[letter if name == "value" else f"{letter}_{name}"] = getattr(
                            coefficient, name, float("nan")
                        )
                    row[f"{letter}_doubtful"] = getattr(coefficient, "doubtful", False)
                rows.append(row)
        return pandas.DataFrame(rows).set_index(["sensor", "axis"])

    def __str__(self) -> str:
        return render_text(self.result)

    def __repr__(self) -> str:
        stretch = self.result["stretch"]
        seconds = stretch["end_s"] - stretch["start_s"]
        return f"<Characterisation of {len(self.sensors)} sensors of {self.result['log']}, {seconds:.0f} s at rest>"

    def _repr_html_(self) -> str:
        """Return the white noise, bias instability and random walk of each axis, for notebooks."""
        from imuarray.html_table import html_table

        rows = []
        for sensor in self.result["sensors"]:
            for entry in sensor["axes"]:
                coefficients = (self.coefficient(sensor["name"], entry["axis"], term) for term in TERMS)
                rows.append((f"{sensor['name']} {entry['axis']}", sensor["unit"], *map(_spell, coefficients)))
        heading = ("axis", "unit", "N, unit/√Hz", "B, unit", "K, unit/√s")
        title = f"{self!r}; intervals of 95 %; in brackets: not a noise of this kind".strip("<>")
        return html_table(title, heading, rows)


def _spell(coefficient: Coefficient | None) -> str:
    if coefficient is None:
        return "–"
    if not coefficient.significant:
        return f"< {coefficient.high:.2g}"
    if coefficient.doubtful:
        return f"({coefficient.value:.3g})"
    return f"{coefficient.value:.3g} ({coefficient.low:.2g} to {coefficient.high:.2g})"
