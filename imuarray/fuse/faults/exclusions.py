"""Exclusions: the axes that are left out, the conditions for their return, and the events that report both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from imuarray.arrays import Booleans
from imuarray.fuse.faults.hypotheses import AXIS_GAIN, energy_limit
from imuarray.fuse.faults.kinds import FaultKind
from imuarray.fuse.faults.normal import NormalModel
from imuarray.fuse.faults.window import WindowResiduals
from imuarray.units import READABLE_SI

UNIT: Mapping[str, str] = MappingProxyType({"specific_force": "g", "angular_rate": "dps"})
"""Unit of measuring ranges."""

_PLURAL: Mapping[str, str] = MappingProxyType(
    {
        "agrees": "agree",
        "gives": "give",
        "gave": "gave",
        "is": "are",
        "has": "have",
        "reads": "read",
        "scatters": "scatter",
    }
)
"""The verbs of the sentences, of one axis and of two."""

State = Literal["isolated", "not isolated", "readmitted", "silent", "back", "no redundancy"]


@dataclass(frozen=True)
class FaultEvent:
    """One thing that a person should know of a sensor.

    `time_ns` of the first frame of the window in which it was found, in the log's time; `sensor` and its `axes` ("x",
    "y", "z"); `kind` is the name of an effect (`bias`, `scale`, `stuck`, `range_reset`, `glitches`, `white_noise`,
    `random_walk`: the baseline walked off; `dropped_samples`: nothing valid comes). `state` says what was done:
    "isolated" leaves the axes out, "not isolated" leaves all in, because others explain it as well. `size_si` in m/s2
    or rad/s, of `scale` and `range_reset` a factor, of `white_noise` the ratio to the usual noise, of `dropped_samples`
    seconds. `significance` in standard deviations.
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
        """The same for a person."""
        axes = "" if len(self.axes) == 3 else " " + " and ".join(self.axes)
        words = self._words()
        if len(self.axes) == 2:  # two axes are a plural; a whole sensor is not
            verb, rest = words.split(" ", 1)
            words = f"{_PLURAL[verb]} {rest}"
        return f"{self.time_ns * 1e-9:.2f} s: {self.sensor}{axes} {words}"

    def _words(self) -> str:
        """Return the sentence that names the fault and what is done about it, of one axis."""
        if self.state == "readmitted":
            return "agrees with the others again: back in use"
        if self.state == "back":
            return "gives valid readings again"
        if self.state == "silent":
            return f"gave no valid reading for {self.size_si:.1f} s; fused from the others"
        if self.state == "no redundancy":
            return "is left out; the remaining axes can't check each other: no further fault can be detected"
        significance = f"{self.significance:.0f} sigma"
        if self.state == "not isolated":
            others = " or ".join(self.others)
            return f"{self._fault()} ({significance}), or the fault is in {others}: not isolated, all stay in use"
        return f"{self._fault()} ({significance}): left out"

    def _fault(self) -> str:
        """Return the words that name the fault, of one axis."""
        factor, unit = READABLE_SI[self.quantity]
        size = f"{factor * self.size_si:.3g} {unit}"
        span = f"{self.range or 0:g} {UNIT[self.quantity]}"
        reset = f"has {self.size_si:.3g} times its scale, as if set to a range of {span}"
        words = {
            "bias": f"is off by {size}",
            "random_walk": f"has drifted by {size}",
            "scale": f"reads {self.size_si:.3g} times what the others read",
            "range_reset": reset,
            "stuck": "is stuck",
            "glitches": f"has readings that are off by up to {size}",
            "white_noise": f"scatters {self.size_si:.3g} times as much as before",
        }
        return words[self.kind]

    def as_json(self) -> dict[str, Any]:
        """JSON-ready."""
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
"""For so long a sensor that was left out has to agree with the others before it is used again; twice as long after
each further time."""

_LONGEST_S = 600.0

AGREES = AXIS_GAIN / 3
"""Gain below which the mean of an axis agrees: well under what leaves it out (hysteresis)."""


@dataclass
class Exclusion:
    """Axes (indices) of one sensor (number) that are left out since `since_ns`, how long they have agreed again and how
    long they have to, in windows. `first` is what it looked like when it was found, `kind` what it is: `named` a window
    later. `drifted_si` for a walk-off.
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

    def hears(self, agrees: Booleans) -> bool:
        """Counts one more window in which its axes agreed, or not; whether they may come back."""
        self.agreed = self.agreed + 1 if agrees[list(self.axes)].all() else 0
        return self.named and self.agreed >= self.needs


def needs(offences: int, window_s: float) -> int:
    """Windows for which a sensor has to agree after it was left out for the `offences`-th time."""
    return max(1, round(min(AGREES_S * 2.0 ** (offences - 1), _LONGEST_S) / window_s))


def agreeing(seen: WindowResiduals, normal: NormalModel, present: Booleans) -> Booleans:
    """(m,) the axes whose readings, included or not, are what the included ones and the normal model say."""
    mean = seen.means**2 < AGREES * seen.spread
    centred = np.where(seen.residual == 0, 0.0, seen.residual - seen.means)
    others = ((seen.rows @ seen.white.spread) * seen.rows).sum(axis=1)
    known = seen.regressors - seen.regressors.mean(axis=1, keepdims=True)
    lasting = normal.doubt_within(known)
    total = normal.variance + others + lasting
    energy = (centred**2).sum(axis=0) / total
    limit = energy_limit(len(seen.triad), normal.colour, lasting / total)
    return np.asarray(mean & (energy < limit / 2) & present)


_UNKNOWN = FaultKind("bias", 0.0)
_ALL = (0, 1, 2)


class FaultReport:
    """The events of one quantity, whose sensors have these names."""

    def __init__(self, names: Sequence[str], quantity: str) -> None:
        self.events: list[FaultEvent] = []
        self.disagreements = 0
        """Windows in which all sensors disagree, so that none is suspected."""
        self._names, self._quantity = names, quantity

    def isolated(self, exclusion: Exclusion, kind: FaultKind | None) -> None:
        """Axes are left out: known from the window after it, told with the time when it was found."""
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
        """Note that they are used again."""
        kind = exclusion.kind or _UNKNOWN
        self._add(exclusion.sensor, exclusion.axes, time_ns, kind, "readmitted")

    def doubted(
        self, axes: Sequence[int], rivals: Sequence[int], time_ns: int, kind: FaultKind | None, gain: float
    ) -> None:
        """A fault that may be of one sensor as well as of others."""
        others = tuple(self._names[rival] for rival in rivals)
        self._add(
            axes[0] // 3,
            axes,
            time_ns,
            kind or _UNKNOWN,
            "not isolated",
            significance=float(np.sqrt(gain)),
            others=others,
        )

    def count_disagreement(self) -> None:
        """Count a window in which all sensors disagree."""
        self.disagreements += 1

    def silent(self, sensor: int, seconds: float, time_ns: int) -> None:
        """A sensor has had nothing valid to say for some time."""
        self._add(sensor, _ALL, time_ns, FaultKind("dropped_samples", seconds), "silent")

    def back(self, sensor: int, time_ns: int) -> None:
        """Note that it gives readings again."""
        self._add(sensor, _ALL, time_ns, FaultKind("dropped_samples", 0.0), "back")

    def blind(self, sensor: int, time_ns: int) -> None:
        """Return true if the sensors left besides this one can't be checked any more."""
        self._add(sensor, _ALL, time_ns, FaultKind("dropped_samples", 0.0), "no redundancy")

    def _add(self, sensor: int, axes: Sequence[int], time_ns: int, kind: FaultKind, state: State, **more: Any) -> None:
        """Appends an event; `more` are further fields of `FaultEvent`."""
        labels = tuple("xyz"[axis % 3] for axis in axes)
        fields = {"significance": 0.0, "range": kind.range, **more}
        name = self._names[sensor]
        self.events.append(FaultEvent(time_ns, self._quantity, name, labels, kind.name, state, kind.size, **fields))
