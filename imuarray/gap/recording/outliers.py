"""Readings that stand alone: far from both of their neighbours, which are near each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats, Integers

MOST = 16
"""So many of each axis are kept, unless told otherwise."""

_ALONE = 1.5
"""So many times further than both neighbours from theirs: a lone reading is twice as far, one beside a step as far."""

_ASIDE = 2
"""Rows on either side that have to be known."""


_ROBUST = 1.4826
"""Standard deviation over median absolute deviation of Gaussian numbers: 1 / 0.6745."""


@dataclass(frozen=True)
class Outliers:
    """The k readings of a phase that are furthest from the middle of their two neighbours, some of each axis: their
    `axis` (k,), times `time_ns` (k,) and signed distances `apart` (k,) in counts. Of none but such as stand
    alone; the first two and the last two of a phase are left out.
    """

    axis: Integers
    time_ns: Integers
    apart: Floats


class OutlierTally:
    """Takes rows as they come; keeps so many of each axis."""

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._time, self._line = np.zeros(0, np.int64), np.zeros((3, 0))
        self._found: list[list[tuple[float, int, float]]] = [[], [], []]

    def update(self, time_ns: Integers, apart: Floats) -> None:
        """The next rows: times (n,), and (3, n) distances of counts from an origin."""
        time = np.concatenate([self._time, time_ns])
        line = np.concatenate([self._line, apart], axis=1)
        self._time, self._line = time[-2 * _ASIDE :], line[:, -2 * _ASIDE :].copy()
        if len(time) <= 2 * _ASIDE:
            return
        off = line[:, 1:-1] - (line[:, :-2] + line[:, 2:]) / 2
        size = np.abs(off)
        inner = size[:, 1:-1]
        alone = inner > _ALONE * np.maximum(size[:, :-2], size[:, 2:])
        for axis in range(3):
            (places,) = alone[axis].nonzero()
            far = inner[axis, places]
            if len(places) > self._most:
                places = places[far >= np.partition(far, -self._most)[-self._most]]
            rows = [
                (float(inner[axis, at]), int(time[at + _ASIDE]), float(off[axis, at + 1])) for at in places.tolist()
            ]
            self._found[axis] = sorted([*self._found[axis], *rows], reverse=True)[: self._most]

    def result(self) -> Outliers:
        """All that came so far, axis by axis, the furthest first."""
        rows = [(axis, time, by) for axis, own in enumerate(self._found) for _, time, by in own]
        axes, times, apart = zip(*rows, strict=True) if rows else ((), (), ())
        return Outliers(np.array(axes, np.int64), np.array(times, np.int64), np.array(apart, float))


def robust_std(values: Floats) -> Floats:
    """Per column of (r, k), from the median absolute deviation."""
    return np.asarray(_ROBUST * np.median(np.abs(values - np.median(values, axis=0)), axis=0))
