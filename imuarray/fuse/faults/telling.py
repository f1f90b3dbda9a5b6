"""Puts what was decided into events."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imuarray.fuse.faults.events import FaultEvent, State
from imuarray.fuse.faults.exclusions import Exclusion
from imuarray.fuse.faults.kinds import Kind

_UNKNOWN = Kind("bias", 0.0)
_ALL = (0, 1, 2)


class Telling:
    """The events of one quantity, whose sensors have these names."""

    def __init__(self, names: Sequence[str], quantity: str) -> None:
        self.events: list[FaultEvent] = []
        self._names, self._quantity = names, quantity

    def isolated(self, exclusion: Exclusion, kind: Kind | None) -> None:
        """Axes are left out: known from the window after it, told with the time when it was found."""
        exclusion.named = True
        self._add(exclusion.sensor, exclusion.axes, exclusion.since_ns, kind or _UNKNOWN, "isolated", exclusion.gain)

    def readmitted(self, exclusion: Exclusion, time_ns: int) -> None:
        """They are used again."""
        kind = exclusion.kind or _UNKNOWN
        self._add(exclusion.sensor, exclusion.axes, time_ns, kind, "readmitted", 0.0)

    def doubted(self, axes: Sequence[int], rivals: Sequence[int], time_ns: int, kind: Kind | None, gain: float) -> None:
        """A fault that may be of one sensor as well as of others."""
        others = tuple(self._names[rival] for rival in rivals)
        self._add(axes[0] // 3, axes, time_ns, kind or _UNKNOWN, "not isolated", gain, others)

    def silent(self, sensor: int, seconds: float, time_ns: int) -> None:
        """A sensor has had nothing valid to say for some time."""
        self._add(sensor, _ALL, time_ns, Kind("dropped_samples", seconds), "silent", 0.0)

    def back(self, sensor: int, time_ns: int) -> None:
        """It says something again."""
        self._add(sensor, _ALL, time_ns, Kind("dropped_samples", 0.0), "back", 0.0)

    def blind(self, sensor: int, time_ns: int) -> None:
        """What is left besides this sensor can't be checked any more."""
        self._add(sensor, _ALL, time_ns, Kind("dropped_samples", 0.0), "no redundancy", 0.0)

    def _add(
        self,
        sensor: int,
        axes: Sequence[int],
        time_ns: int,
        kind: Kind,
        state: State,
        gain: float,
        others: tuple[str, ...] = (),
    ) -> None:
        labels = tuple("xyz"[axis % 3] for axis in axes)
        sigmas = float(np.sqrt(gain))
        told = (time_ns, self._quantity, self._names[sensor], labels, kind.name, state, kind.size, sigmas)
        self.events.append(FaultEvent(*told, others=others, range=kind.range))
