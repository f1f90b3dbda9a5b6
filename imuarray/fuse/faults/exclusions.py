"""Exclusions: the axes that are left out, the conditions for their return, and the events that report both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imuarray.arrays import Booleans
from imuarray.fuse.faults.events import FaultEvent, State
from imuarray.fuse.faults.hypotheses import AXIS_GAIN, energy_limit
from imuarray.fuse.faults.kinds import FaultKind
from imuarray.fuse.faults.normal import NormalModel
from imuarray.fuse.faults.window import WindowResiduals

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
