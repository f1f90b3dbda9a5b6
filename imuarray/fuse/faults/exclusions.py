"""Exclusions: the excluded axes, the conditions for their readmission, and the events that report both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from imuarray.arrays import Booleans
from imuarray.fuse.faults.hypotheses import AXIS_GAIN, FaultKind, energy_limit
from imuarray.fuse.faults.window import NormalModel, WindowResiduals
from imuarray.units import READABLE_SI, UNIT_OF

_PLURAL: Mapping[str, str] = MappingProxyType(
    {
        "agrees": "agree",
        "disagrees": "disagree",
        "gives": "give",
        "gave": "gave",
        "is": "are",
        "has": "have",
        "reads": "read",
        "scatters": "scatter",
    }
)
"""Verbs of the sentences in singular (one axis) and plural."""

State = Literal["isolated", "not isolated", "readmitted", "silent", "back", "no redundancy"]


@dataclass(frozen=True)
class FaultEvent:
    """A failure or recovery of a sensor.

    `time_ns` is the first frame of the window in which it was detected, in the log's time; `sensor` and its `axes`
    ("x", "y", "z"); `kind` is the name of an effect (`bias`, `scale`, `stuck`, `range_reset`, `glitches`,
    `white_noise`, `random_walk`: the baseline has drifted beyond its limit; `dropped_samples`: no valid readings).
    `state` is the decision: "isolated" excludes the axes, "not isolated" keeps all in use, because a fault of `others`
    explains the readings as well. `size_si` is in m/s2 or rad/s; of `scale` and `range_reset` a factor, of
    `white_noise` the ratio to the usual noise, of `dropped_samples` seconds. `significance` is in standard deviations.
    """

    time_ns: int
    quantity: str
    sensor: str
    axes: tuple[str, ...]
    kind: str
    state: State
    size_si: float
    significance: float
    others: tuple[str, ...] = ()
    range: float | None = None
    """The measuring range, in the sensor's unit, that explains a `range_reset`."""

    @property
    def sentence(self) -> str:
        """The event as a sentence."""
        axes = "" if len(self.axes) == 3 else " " + " and ".join(self.axes)
        words = self._words()
        if len(self.axes) == 2:  # plural for two axes, not for a whole sensor
            verb, rest = words.split(" ", 1)
            words = f"{_PLURAL[verb]} {rest}"
        return f"{self.time_ns * 1e-9:.2f} s: {self.sensor}{axes} {words}"

    def _words(self) -> str:
        """Return the fault and the decision in words, in the singular."""
        if self.state == "readmitted":
            return "agrees with the others again: back in use"
        if self.state == "back":
            return "gives valid readings again"
        if self.state == "silent":
            return f"gave no valid reading for {self.size_si:.1f} s; fused from the others"
        if self.state == "no redundancy":
            return "is excluded; the remaining axes can't check each other: no further fault can be detected"
        significance = f"{self.significance:.0f} sigma"
        if self.state == "not isolated":
            rivals_text = " or ".join(self.others)
            return (
                f"{self._fault()} ({significance}), or the fault is in {rivals_text}: not isolated, all remain in use"
            )
        return f"{self._fault()} ({significance}): excluded"

    def _fault(self) -> str:
        """Return the fault in words, in the singular."""
        factor, unit = READABLE_SI[self.quantity]
        size = f"{factor * self.size_si:.3g} {unit}"
        span = f"{self.range or 0:g} {UNIT_OF[self.quantity]}"
        reset = f"has {self.size_si:.3g} times its scale, as if set to a range of {span}"
        words = {
            "bias": f"is off by {size}" if self.size_si else "disagrees with the others in its few valid readings",
            "random_walk": f"has drifted by {size}",
            "scale": f"reads {self.size_si:.3g} times what the others read",
            "range_reset": reset,
            "stuck": "is stuck",
            "glitches": f"has readings that are off by up to {size}",
            "white_noise": f"scatters {self.size_si:.3g} times as much as before",
        }
        return words[self.kind]

    def as_json(self) -> dict[str, Any]:
        """Return the event for JSON."""
        return {
            "time_s": self.time_ns * 1e-9,
            "quantity": self.quantity,
            "sensor": self.sensor,
            "axes": list(self.axes),
            "effect": self.kind,
            "state": self.state,
            "size_si": self.size_si,
            "significance": self.significance,
            "others": list(self.others),
            "sentence": self.sentence,
        }


AGREES_S = 3.0
"""Time for which an excluded sensor must agree with the others before it is readmitted; it doubles after each further
exclusion."""

_LONGEST_S = 600.0

AGREES = AXIS_GAIN / 3
"""Gain below which the mean of an axis agrees: well below the gain at which it is excluded (hysteresis)."""


@dataclass
class Exclusion:
    """Axes (indices) of one sensor (number) that are excluded since `since_ns`; the number of windows for which they
    have agreed again, and the number they need. `first` is the kind of fault in the window of detection, `kind` the
    final one, determined one window later (`named`). `drifted_si` is the size of a drift beyond its limit.
    """

    sensor: int
    axes: tuple[int, ...]
    since_ns: int
    gain: float
    needs: int
    agreed: int = 0
    named: bool = False
    drifted_si: float = 0.0
    first: FaultKind | None = None
    kind: FaultKind | None = None

    def update(self, agrees: Booleans) -> bool:
        """Count a window in which axes (m,) agree or not; return whether the axes are readmitted."""
        self.agreed = self.agreed + 1 if agrees[list(self.axes)].all() else 0
        return self.named and self.agreed >= self.needs


def needs(offences: int, window_s: float) -> int:
    """Return the number of windows for which a sensor must agree after its `offences`-th exclusion."""
    return max(1, round(min(AGREES_S * 2.0 ** (offences - 1), _LONGEST_S) / window_s))


def agreeing(residuals: WindowResiduals, normal: NormalModel, present: Booleans) -> Booleans:
    """Return (m,) the axes, included or not, whose readings agree with the included ones and the normal model."""
    mean = residuals.means**2 < AGREES * residuals.spread
    centred = np.where(residuals.residual == 0, 0.0, residuals.residual - residuals.means)
    variances = ((residuals.rows @ residuals.white.spread) * residuals.rows).sum(axis=1)
    known = residuals.regressors - residuals.regressors.mean(axis=1, keepdims=True)
    doubt = normal.doubt_within(known)
    total = normal.variance + variances + doubt
    energy = (centred**2).sum(axis=0) / total
    limit = energy_limit(len(residuals.triad), normal.colour, doubt / total)
    return np.asarray(mean & (energy < limit / 2) & present)


_UNKNOWN = FaultKind("bias", 0.0)
_ALL = (0, 1, 2)


class FaultReport:
    """The events of one quantity, whose sensors have these names."""

    def __init__(self, names: Sequence[str], quantity: str) -> None:
        self.events: list[FaultEvent] = []
        self.disagreements = 0
        """Number of windows in which all sensors disagree, so that none is suspected."""
        self._names, self._quantity = names, quantity

    def isolated(self, exclusion: Exclusion, kind: FaultKind | None) -> None:
        """Report excluded axes, with the time of detection; this is called one window later."""
        exclusion.named = True
        self._add(
            exclusion.sensor,
            exclusion.axes,
            exclusion.since_ns,
            kind or _UNKNOWN,
            "isolated",
            significance=float(np.sqrt(exclusion.gain)),
        )

    def readmitted(self, exclusion: Exclusion, time_ns: int) -> None:
        """Report axes that are used again."""
        kind = exclusion.kind or _UNKNOWN
        self._add(exclusion.sensor, exclusion.axes, time_ns, kind, "readmitted")

    def doubted(
        self, axes: Sequence[int], rivals: Sequence[int], time_ns: int, kind: FaultKind | None, gain: float
    ) -> None:
        """Report a fault of one sensor that other sensors may explain as well."""
        rival_names = tuple(self._names[rival] for rival in rivals)
        self._add(
            axes[0] // 3,
            axes,
            time_ns,
            kind or _UNKNOWN,
            "not isolated",
            significance=float(np.sqrt(gain)),
            others=rival_names,
        )

    def count_disagreement(self) -> None:
        """Count a window in which all sensors disagree."""
        self.disagreements += 1

    def silent(self, sensor: int, seconds: float, time_ns: int) -> None:
        """Report a sensor without valid readings for some time."""
        self._add(sensor, _ALL, time_ns, FaultKind("dropped_samples", seconds), "silent")

    def note_return(self, sensor: int, time_ns: int) -> None:
        """Report a sensor that gives valid readings again."""
        self._add(sensor, _ALL, time_ns, FaultKind("dropped_samples", 0.0), "back")

    def blind(self, sensor: int, time_ns: int) -> None:
        """Report that without this sensor the others can't be checked any more."""
        self._add(sensor, _ALL, time_ns, FaultKind("dropped_samples", 0.0), "no redundancy")

    def _add(self, sensor: int, axes: Sequence[int], time_ns: int, kind: FaultKind, state: State, **more: Any) -> None:
        """Append an event; `more` are further fields of `FaultEvent`."""
        labels = tuple("xyz"[axis % 3] for axis in axes)
        fields = {"significance": 0.0, "range": kind.range, **more}
        name = self._names[sensor]
        self.events.append(FaultEvent(time_ns, self._quantity, name, labels, kind.name, state, kind.size, **fields))
