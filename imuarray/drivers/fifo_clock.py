"""Estimates when the samples of a chip's queue were taken, from their numbers and the times of counting.

A chip samples by its own oscillator, which is some percent off (BMA-107 states 10 % for one chip). A count gives two
bounds: the newest counted sample existed at the end of the count, and the next one did not exist at its beginning. Each
is a bound on a straight line, time over number of the sample. All counts of the last seconds leave a small region of
possible lines (offset and period), a convex polygon that every count cuts; the estimate is its centre, the uncertainty
its extent. A host that is late by milliseconds gives wide bounds, which have no effect. The method is set-membership
estimation (Milanese and Vicino, Automatica 27, 1991): it assumes no distribution of delays.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

TOLERANCE = 0.15
"""Largest relative error of a chip's oscillator."""
DRIFT = 2e-4
"""Largest relative change of a chip's rate within a window; warming by a few degrees changes it by less."""
WINDOW_NS = 5e9
"""Time in ns after which a new window begins. The previous window is used until then, so that no bound is more than
twice as old.
"""

SLIVER_NS = 1e3
"""Least time in ns that a bound must cut off; a bound that cuts off less adds a vertex without information."""
MANY_VERTICES = 16
SAME_NS = 10.0
"""Number of vertices above which close vertices are merged, and their largest distance in ns. If counts are always at
the same phase of the samples, all bounds meet near one vertex. Periods must agree within a ten-thousandth of the
distance, because a window has thousands of them.
"""

Vertices = list[tuple[float, float]]


class _Window:
    """The possible lines: vertices (time of the sample number `first` in ns after `origin_ns`, period in ns)."""

    def __init__(self, first: int, from_ns: float, until_ns: float, periods: tuple[float, float]) -> None:
        self.first = first
        self.origin_ns = from_ns
        width, (low, high) = until_ns - from_ns, periods
        self.vertices: Vertices = [(-low, low), (width, low), (width, high), (-high, high)]
        self._center: tuple[float, float] | None = None

    def cut(self, newest: int, from_ns: float, until_ns: float) -> bool:
        """Apply a count: sample number `newest` existed at `until_ns`, and the next one not before `from_ns`. Return
        False if no line remains.
        """
        steps = newest - self.first
        before, after = until_ns - self.origin_ns, from_ns - self.origin_ns
        late = [start + steps * period - before for start, period in self.vertices]
        if max(late) > SLIVER_NS:
            self.vertices, self._center = _clip_polygon(self.vertices, late), None
        early = [after - start - (steps + 1) * period for start, period in self.vertices]
        if early and max(early) > SLIVER_NS:
            self.vertices, self._center = _clip_polygon(self.vertices, early), None
        return len(self.vertices) > 2

    @property
    def center(self) -> tuple[float, float]:
        if self._center is None:
            self._center = _centroid(self.vertices)
        return self._center

    @property
    def periods(self) -> tuple[float, float]:
        """The smallest and largest possible period, with the drift of a window."""
        periods = [period for _, period in self.vertices]
        return min(periods) * (1 - DRIFT), max(periods) * (1 + DRIFT)

    def half_extent_ns(self, number: int) -> float:
        """Return half the extent of the possible times of a sample."""
        times = [start + (number - self.first) * period for start, period in self.vertices]
        return (max(times) - min(times)) / 2

    def uncertainty_ns(self, number: int) -> float:
        """Return the largest distance of a possible time of a sample from the estimate."""
        steps = number - self.first
        times = [start + steps * period for start, period in self.vertices]
        center_ns = self.center[0] + steps * self.center[1]
        return max(max(times) - center_ns, center_ns - min(times))


def _clip_polygon(vertices: Vertices, excess: list[float]) -> Vertices:
    """Return the part of a convex polygon on which `excess` is not positive; it is given at the vertices, linear in
    between.
    """
    kept: Vertices = []
    before, beyond = vertices[-1], excess[-1]
    for vertex, over in zip(vertices, excess, strict=True):
        if (over > 0) != (beyond > 0):
            share = beyond / (beyond - over)
            kept.append((before[0] + share * (vertex[0] - before[0]), before[1] + share * (vertex[1] - before[1])))
        if over <= 0:
            kept.append(vertex)
        before, beyond = vertex, over
    if len(kept) <= MANY_VERTICES:
        return kept
    apart = [vertex for vertex, last in zip(kept, [kept[-1], *kept], strict=False) if not _is_same(vertex, last)]
    return apart if len(apart) > 2 else kept


def _is_same(vertex: tuple[float, float], other: tuple[float, float]) -> bool:
    """Return whether two vertices are so close that one is sufficient."""
    return abs(vertex[0] - other[0]) < SAME_NS and abs(vertex[1] - other[1]) < SAME_NS * 1e-4


def _centroid(vertices: Vertices) -> tuple[float, float]:
    """Return the centre of area of a convex polygon; the mean of its vertices if it has no area."""
    x0, y0 = vertices[0]
    area = x = y = 0.0
    for (xa, ya), (xb, yb) in pairwise(vertices[1:]):
        ax, ay, bx, by = xa - x0, ya - y0, xb - x0, yb - y0
        part = ax * by - ay * bx
        area += part
        x += part * (ax + bx)
        y += part * (ay + by)
    if area == 0:
        count = len(vertices)
        return sum(vertex[0] for vertex in vertices) / count, sum(vertex[1] for vertex in vertices) / count
    return x0 + x / (3 * area), y0 + y / (3 * area)


class FifoClock:
    """Times of consecutive samples of one chip of nominal rate `rate_hz`.

    `drained` and `overrun` describe the last count: the times of its samples, and whether the queue had overflowed.
    `uncertainty_ns`: the largest possible error of these times, if the chip counted within the times that `times`
    received and its rate was constant since the window began (up to twice `WINDOW_NS`).
    """

    def __init__(self, rate_hz: float) -> None:
        self.nominal_ns = 1e9 / rate_hz
        self.restart()

    @property
    def gaps(self) -> Sequence[int]:
        """See `QueueTimes`."""
        return (0,) if self.overrun and self.drained else ()

    @property
    def uncertainties_ns(self) -> Sequence[float]:
        """See `QueueTimes`."""
        return [self.uncertainty_ns] * len(self.drained)

    def restart(self) -> None:
        """Discard the state: the chip was set up again."""
        self.period_ns = self.nominal_ns
        self.uncertainty_ns = self.nominal_ns / 2
        self.drained: list[int] = []
        self.overrun = False
        self._periods = self.nominal_ns * (1 - TOLERANCE), self.nominal_ns * (1 + TOLERANCE)
        self._taken = 0
        self._latest_ns = -(1 << 62)
        self._window: _Window | None = None
        self._next: _Window | None = None

    def times(
        self, level: int, at_ns: int, overrun: bool = False, *, until_ns: int | None = None, unread: int = 0
    ) -> list[int]:
        """Return the times in ns of the oldest `level` samples of a queue that was counted between `at_ns` and
        `until_ns` (`at_ns` unless given), oldest first, strictly increasing; `unread` newer ones were counted and stay
        in the queue.

        After an overrun samples are missing before them, and the estimate restarts with the known period.
        """
        self.overrun = overrun
        if not level:
            self.drained = []
            return self.drained
        from_ns, end_ns = float(at_ns), float(at_ns if until_ns is None else max(until_ns, at_ns))
        newest = self._taken + level + unread - 1
        if self._window is None or overrun or not self._cut(newest, from_ns, end_ns):
            self._begin()
        window = self._window
        if window is None:  # the first count: the newest sample is half a period old, with half a period of error
            start_ns, first = (from_ns + end_ns - self.period_ns) / 2, newest
            low, high = self._periods
            slack_ns = max(self.period_ns - low, high - self.period_ns)
            self.uncertainty_ns = (end_ns - from_ns + high) / 2 + (level + unread) * slack_ns
            self._window = _Window(newest, from_ns, end_ns, self._periods)
        else:
            start_ns, self.period_ns = window.center
            start_ns, first = start_ns + window.origin_ns, window.first
            edges = (self._taken, self._taken + level - 1)  # in between it is less: the distances are convex
            self.uncertainty_ns = max(map(window.uncertainty_ns, edges))
        oldest_ns = start_ns + (self._taken - first) * self.period_ns
        self.drained = self._increasing(oldest_ns, level)
        shifts = (self.drained[0] - oldest_ns, self.drained[-1] - oldest_ns - (level - 1) * self.period_ns)
        self.uncertainty_ns += max(map(abs, shifts))
        self._taken += level
        return self.drained

    def look(self, waiting: int, from_ns: int, until_ns: int) -> None:
        """Apply a count of `waiting` samples of which none is drained."""
        if self._window is not None and not self._cut(self._taken + waiting - 1, float(from_ns), float(until_ns)):
            self._begin()

    def best_look_ns(self, now_ns: int, wanted_ns: float) -> int | None:
        """Return the time of the next count that halves the uncertainty: the middle of the possible times of the next
        sample. None if it is known to `wanted_ns`, or if no sample is known yet.
        """
        if self._window is None or self._window.half_extent_ns(self._taken) <= wanted_ns:
            return None
        start_ns, period_ns = self._window.center
        next_ns = start_ns + self._window.origin_ns + (self._taken - self._window.first) * period_ns
        steps = max(0, -int((next_ns - now_ns) // period_ns))
        return round(next_ns + steps * period_ns)

    def _cut(self, newest: int, from_ns: float, end_ns: float) -> bool:
        """Apply a count; return False if no window is consistent with it, and the estimate must restart."""
        window, following = self._window, self._next
        if following is not None and not following.cut(newest, from_ns, end_ns):
            following = self._next = None
        if window is not None and not window.cut(newest, from_ns, end_ns):
            window, self._next = following, None
        if window is not None and self._next is None:
            self._next = _Window(newest, from_ns, end_ns, window.periods)
        elif window is not None and self._next is not None and from_ns - self._next.origin_ns > WINDOW_NS:
            window, self._next = self._next, _Window(newest, from_ns, end_ns, self._next.periods)
        self._window = window
        return window is not None

    def _begin(self) -> None:
        """Discard the times of samples. After an overrun, keep the period of the last window; otherwise (no window, or
        none that is consistent with the count) return to the nominal period.
        """
        if self._window is not None and self.overrun:
            self._periods = self._window.periods
        else:
            self._periods = self.nominal_ns * (1 - TOLERANCE), self.nominal_ns * (1 + TOLERANCE)
        self._window = self._next = None

    def _increasing(self, oldest_ns: float, level: int) -> list[int]:
        """Return `level` times from `oldest_ns` on, all later than earlier ones."""
        period_ns, latest_ns = self.period_ns, self._latest_ns
        times: list[int] = np.rint(oldest_ns + np.arange(level) * period_ns).astype(np.int64).tolist()
        if times[0] <= latest_ns:
            end_ns = max(times[-1], latest_ns + level)
            step_ns = (end_ns - latest_ns) / level
            times = [round(latest_ns + (index + 1) * step_ns) for index in range(level)]
        self._latest_ns = times[-1]
        return times
