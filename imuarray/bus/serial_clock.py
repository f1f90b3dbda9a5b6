"""Converts the microcontroller's counters to the host's clock.

Counters on the link are 16 and 32 bits wide and wrap; `nearest` determines the number of wraps.

A frame can arrive late but never early. The true straight line through (sent, arrived) therefore lies below every
point, and close to the earliest: it is estimated by the edge of the lower convex hull that spans the middle of the
data, which is the line under all points with the least sum of distances to them (Moon, Skelly and Towsley, "Estimation
and removal of clock skew from network delay measurements", INFOCOM 1999; Zhang, Liu and Xia, INFOCOM 2002, for the
hull). Late deliveries do not affect it, independent of their number and delay.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import islice

import numpy as np

from imuarray.arrays import Floats, Times

MAX_DRIFT = 0.01
"""Largest relative drift of a clock: ceramic resonators are accurate to half a percent, and a fit with more than twice
that error has wrong data.
"""
BLOCK_NS = 100_000_000
"""Duration in ns of a block; only the earliest arrival of a block is kept."""
WINDOW_BLOCKS = 600
"""Number of blocks in the window, at least a minute: long compared with the jitter of a delivery, short compared with
the warming up of an oscillator.
"""
MIN_SPAN_NS = 200_000_000
"""Least span of the data in ns for an estimate of the drift; a shorter span has no information on it."""
REFIT_NS = 1_000_000_000
SLEW_NS = 2_000_000_000
"""Time in ns over which converted times approach a new fit, instead of a step."""
RECENT_BLOCKS = 64
"""Number of latest blocks whose quickest delivery determines the present count of the microcontroller."""


def nearest(values: Times, modulus: int, expected: int) -> Times:
    """Return the numbers (n,) whose counter of `modulus` (even) steps shows `values` (n,), nearest to `expected`; of
    two equally near ones the lower.
    """
    half = modulus // 2
    numbers: Times = expected - half + (values - expected + half) % modulus
    return numbers


class ClockFit:
    """The host's time as a line over the microcontroller's, with a slope of `rate`.

    `latency_ns` is the delay of the quickest delivery, which is subtracted. Converted times stay in order when the fit
    changes.
    """

    def __init__(self, latency_ns: int = 0) -> None:
        self.latency_ns = latency_ns
        self.restart()

    def restart(self) -> None:
        """Discard all data: the microcontroller's counter has restarted."""
        self.rate = 1.0
        self._sent_ns: deque[int] = deque(maxlen=WINDOW_BLOCKS)
        self._arrived_ns: deque[int] = deque(maxlen=WINDOW_BLOCKS)
        self._block_ns = 0  # the start of the newest block
        self._fitted_ns: int | None = None
        self._line = (0, 0.0)  # a time of the microcontroller, and that of the host
        self._slew: tuple[int, float] = 0, 0.0  # start (microcontroller's time) and size of a decaying correction
        self._given_ns: int | None = None
        self._above_ns = 0.0  # median distance of the earliest arrivals of the blocks from the line

    def add(self, sent_ns: int, arrived_ns: int) -> None:
        """Add a frame that was sent at `sent_ns` of the microcontroller's time and arrived by `arrived_ns` of the
        host's.
        """
        if not self._sent_ns or sent_ns - self._block_ns >= BLOCK_NS:
            self._block_ns = sent_ns
            self._sent_ns.append(sent_ns)
            self._arrived_ns.append(arrived_ns)
        elif arrived_ns - self._arrived_ns[-1] < self.rate * (sent_ns - self._sent_ns[-1]):
            self._sent_ns[-1], self._arrived_ns[-1] = sent_ns, arrived_ns

    @property
    def newest_arrival_ns(self) -> int:
        """The arrival time of the newest frame; ValueError before the first."""
        if not self._arrived_ns:
            raise ValueError("a clock fit without data")
        return self._arrived_ns[-1]

    def latest_sent_ns(self, arrived_ns: int) -> int | None:
        """Return the microcontroller's time at which a frame that arrives at `arrived_ns` was sent, if its delivery was
        as quick as the quickest of the last seconds; None before the first frame.
        """
        recent = zip(reversed(self._sent_ns), reversed(self._arrived_ns), strict=True)
        return max(
            (sent + round((arrived_ns - arrived) / self.rate) for sent, arrived in islice(recent, RECENT_BLOCKS)),
            default=None,
        )

    @property
    def uncertainty_ns(self) -> float:
        """Return the largest error of the newest converted times if the quickest deliveries of the window take between
        zero and twice `latency_ns`, with twice the usual scatter of the quickest of a block.

        The sum of this latency, of that scatter, of the correction of an earlier fit that is still in progress, and,
        while the rate is not known (the first `MIN_SPAN_NS`), of the largest drift over the window.
        """
        span_ns = self._sent_ns[-1] - self._sent_ns[0] if self._sent_ns else 0
        drift_ns = MAX_DRIFT * span_ns if span_ns < MIN_SPAN_NS else 0.0
        return self.latency_ns + 2 * self._above_ns + abs(self._slew[1]) + drift_ns

    def host_ns(self, sent_ns: Times) -> Times:
        """Return the host's times (n,) at times (n,) of the microcontroller; ValueError before the first frame."""
        if not self._sent_ns:
            raise ValueError("a clock fit without data")
        newest_ns = self._sent_ns[-1]
        young = newest_ns - self._sent_ns[0] < 5 * REFIT_NS
        if self._fitted_ns is None or young or newest_ns - self._fitted_ns >= REFIT_NS:
            self._fit()
        if len(sent_ns):
            self._given_ns = int(sent_ns[-1])
        return self._map_times(sent_ns)

    def _map_times(self, sent_ns: Times) -> Times:
        at_ns, here_ns = self._line
        slewed_from_ns, slew_ns = self._slew
        ahead = (sent_ns - at_ns).astype(np.float64)
        made_up = slew_ns * np.clip(1 - (sent_ns - slewed_from_ns) / SLEW_NS, 0.0, 1.0)
        host: Times = np.rint(ahead * self.rate + made_up + (here_ns - round(here_ns))).astype(np.int64)
        return host + round(here_ns) - self.latency_ns

    def _fit(self) -> None:
        """Fit the line below all points; converted times approach it from the end of the previous line."""
        given = None if self._given_ns is None else np.array([self._given_ns])
        before = None if given is None else int(self._map_times(given)[0])
        at_ns, base_ns = self._sent_ns[0], self._arrived_ns[0]
        sent = np.array(self._sent_ns, np.int64) - at_ns
        arrived = np.array(self._arrived_ns, np.int64) - base_ns
        self.rate, least = line_under(sent.astype(np.float64), arrived.astype(np.float64))
        self._above_ns = float(np.median(arrived - self.rate * sent - least))
        self._line, self._fitted_ns = (at_ns, base_ns + least), self._sent_ns[-1]
        self._slew = (0, 0.0)
        if given is not None and before is not None:
            self._slew = (int(given[0]), float(before - int(self._map_times(given)[0])))


def line_under(sent: Floats, arrived: Floats) -> tuple[float, float]:
    """Return slope and intercept of the line below all points (n,), in ns, with the least sum of distances to them.

    The slope is 1 if the span of the points is too short, and within `MAX_DRIFT` of 1."""
    slope = 1.0
    if sent[-1] - sent[0] >= MIN_SPAN_NS:
        (x0, y0), (x1, y1) = _edge(_lower_hull(sent.tolist(), arrived.tolist()), float(sent.mean()))
        slope = min(max((y1 - y0) / (x1 - x0), 1 - MAX_DRIFT), 1 + MAX_DRIFT)
    return slope, float((arrived - slope * sent).min())


Point = tuple[float, float]


def _lower_hull(xs: Sequence[float], ys: Sequence[float]) -> list[Point]:
    """Return the corners of the lower convex hull, from left to right; `xs` increase (Andrew's monotone chain)."""
    hull: list[Point] = []
    for x, y in zip(xs, ys, strict=True):
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2:]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break
            hull.pop()
        hull.append((x, y))
    return hull


def _edge(hull: Sequence[Point], middle: float) -> tuple[Point, Point]:
    """Return the edge of the hull above which `middle` lies."""
    right = next(index for index, (x, _) in enumerate(hull) if x >= middle and index > 0)
    return hull[right - 1], hull[right]
