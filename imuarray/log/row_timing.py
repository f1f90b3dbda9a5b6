"""Timing of the rows of a recorded sensor: steady, with stalls, or in bursts.

A recorder that stalls reads nothing for a while and continues at the usual rate. A host that is late reads in a burst
what a chip has buffered, or gives time stamps to what a driver has buffered: the times are then those of arrival and
not of the readings. The rows after a gap distinguish the two: the length of a burst corresponds to the gap before it,
the number of rows after a stall does not. Rows that are flagged as lost never arrive, in a burst or otherwise.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from imuarray.arrays import Booleans, Floats, Integers, Times
from imuarray.log import SensorLog
from imuarray.log.format import LOST_BEFORE
from imuarray.printable import percent

Kind = Literal["steady", "stalls", "bursts"]

GAP = 3.0
"""Least length of a gap, in usual intervals (the median): an interval with one lost row or one late poll is shorter."""

LEAST_SHARE = 0.05
"""Least share of the time in gaps for a timing that is not steady; less is due to the usual jitter of a host."""

LEAST_GAPS = 8
"""Least number of gaps that can show a pattern."""

FOLLOWS = 0.5
"""Least correlation between the length of a gap and the number of rows after it for bursts. If they are independent,
`LEAST_GAPS` gaps exceed it in one of five logs, a hundred gaps never.
"""

REGULAR = 0.05
"""Scatter of gap lengths, as a share of their median, below which their correlation with the number of rows after them
has no meaning: rows are then a burst only if they arrive `HURRY` times as fast as on average.
"""

HURRY = 10.0

LEAST_HURRY = 1.5
"""Least rate of the rows of bursts, relative to the average rate, or after a gap to the usual rate; slower rows do not
make up for a gap.
"""

LOST_SHARE = 0.5
"""Share of gaps with rows flagged as lost above which rows after gaps are not a burst."""

SAME = 0.8
"""Least share of gaps with the same number of rows between them for stalls to have a period."""

IRREGULAR = 0.1
"""Share of gaps in the intervals, without a period, from which on intervals are called irregular and not stalls."""

_STAMPED_TOGETHER = 100.0
"""Usual rate of rows, relative to the average rate, from which on rows are stamped together: a gap is then an interval
longer than the average, because `GAP` times the usual interval is only the time for a stamp.
"""

_STRETCHES, _STRETCH_ROWS = 16, 4096
"""Number of stretches of a long recording, and rows of each, from which the usual interval is determined."""

_KNOT_ROWS = 2048
"""Number of rows between the knots of mean arrival times: a host is late by some hundredths of a second, the mean of
this number of rows by less than a thousandth, and the drift of oscillators is slower.
"""


@dataclass(frozen=True)
class RowTiming:
    """Timing of `rows` over `seconds`, usually `usual_s` apart (the median).

    `gaps`: the number of intervals longer than `GAP` times that, `gap_s` their median length, `gaps_s` their total;
    `period_rows`: the number of rows between most of them, 0 if it varies.
    """

    kind: Kind
    rows: int
    seconds: float
    usual_s: float
    gaps: int = 0
    gap_s: float = 0.0
    gaps_s: float = 0.0
    period_rows: int = 0

    @property
    def rate_hz(self) -> float:
        """Mean rate in rows per second over the whole log."""
        return (self.rows - 1) / self.seconds if self.seconds > 0 else 0.0

    @property
    def sentence(self) -> str:
        """Describe the timing for the reader of a log; "" if it is steady."""
        if self.kind == "stalls" and not self.period_rows and self.gaps > IRREGULAR * (self.rows - 1):
            return (
                f"intervals between rows are irregular: {1e3 * self.usual_s:.3g} ms in the median, but "
                f"{1e3 * self.gap_s:.3g} ms in the median of the longest {percent(self.gaps / (self.rows - 1))}; the "
                f"mean rate is {self.rate_hz:.4g} Hz"
            )
        if self.kind == "stalls":
            pattern = f" after every {self.period_rows} rows" if self.period_rows else f", {self.gaps} times"
            return (
                f"rows stall for {self.gap_s:.3g} s{pattern}: no rows in {self.gaps_s:.0f} of {self.seconds:.0f} s; "
                f"between the stalls they are {1e3 * self.usual_s:.3g} ms apart ({1 / self.usual_s:.4g} Hz)"
            )
        if self.kind == "bursts":
            return (
                f"rows arrive in bursts, {1e3 * self.usual_s:.3g} ms apart after gaps of {1e3 * self.gap_s:.3g} ms "
                f"that the bursts make up for: the times are those of arrival at the host. The true rate is "
                f"{self.rate_hz:.4g} Hz, and rows are assumed to have been read at that rate"
            )
        return ""


def row_timing(sensor: SensorLog) -> RowTiming:
    """Determine the timing of a sensor's rows; read its times once."""
    rows = len(sensor)
    if rows < 2:
        return RowTiming("steady", rows, 0.0, 0.0)
    seconds = (int(sensor.time[-1]) - int(sensor.time[0])) * 1e-9
    usual_s = float(np.median(_intervals_ns(sensor))) * 1e-9
    mean_s = seconds / (rows - 1)
    hurry = mean_s / max(usual_s, 1e-9)
    gap_rows, length_s, next_s, is_lost = _gaps(sensor, GAP * usual_s if hurry < _STAMPED_TOGETHER else mean_s)
    steady = RowTiming("steady", rows, seconds, usual_s)
    if len(gap_rows):
        steady = replace(steady, gaps=len(gap_rows), gap_s=float(np.median(length_s)), gaps_s=float(length_s.sum()))
    if len(gap_rows) < LEAST_GAPS or length_s.sum() < LEAST_SHARE * seconds:
        return steady
    rows_after = np.diff(np.append(gap_rows, rows - 1))
    rows_between = np.diff(gap_rows)
    period_rows = int(np.median(rows_between))
    is_periodic = np.mean(rows_between == period_rows) >= SAME
    makes_up = hurry > LEAST_HURRY or float(np.median(next_s)) < usual_s / LEAST_HURRY
    in_bursts = makes_up and _is_burst(length_s, rows_after, hurry)
    if in_bursts and np.mean(is_lost) > LOST_SHARE:
        return steady
    kind: Kind = "bursts" if in_bursts else "stalls"
    return replace(steady, kind=kind, period_rows=period_rows if is_periodic else 0)


def _intervals_ns(sensor: SensorLog) -> Integers:
    """Return the intervals (k,) between rows: all of a short recording; of a long one those of stretches throughout it,
    because its beginning may have another rate than the rest.
    """
    rows = len(sensor)
    if rows <= _STRETCHES * _STRETCH_ROWS:
        return _intervals_of(sensor, 0, rows)
    firsts = np.linspace(0, rows - _STRETCH_ROWS, _STRETCHES).astype(int).tolist()
    return np.concatenate([_intervals_of(sensor, first, first + _STRETCH_ROWS) for first in firsts])


def _intervals_of(sensor: SensorLog, first: int, stop: int) -> Integers:
    times_ns = np.asarray(sensor.time[first:stop], np.int64)
    return np.asarray(times_ns[1:] - times_ns[:-1])


def _gaps(sensor: SensorLog, least_s: float) -> tuple[Integers, Floats, Floats, Booleans]:
    """Return the row before each gap (k,), its length (k,) in s, the second interval after it (k,) in s, and whether
    rows in it are flagged as lost (k,). The first interval after a gap may only bring the rows back to the grid of the
    frames.
    """
    gap_rows, length_s, next_s, is_lost = [np.zeros(0, np.int64)], [np.zeros(0)], [np.zeros(0)], [np.zeros(0, bool)]
    for block in sensor.blocks():
        first = max(block.start - 1, 0)
        times_ns = np.asarray(sensor.time[first : block.stop], np.int64)
        intervals_s = (times_ns[1:] - times_ns[:-1]).astype(float) * 1e-9
        long = np.flatnonzero(intervals_s > least_s)
        gap_rows.append(first + long)
        length_s.append(intervals_s[long])
        next_s.append(intervals_s[np.minimum(long + 2, len(intervals_s) - 1)])
        flags = np.asarray(sensor.status[first : block.stop])[long + 1] if len(long) else np.zeros(0, np.uint16)
        is_lost.append((flags & LOST_BEFORE) != 0)
    return np.concatenate(gap_rows), np.concatenate(length_s), np.concatenate(next_s), np.concatenate(is_lost)


def _is_burst(length_s: Floats, rows_after: Integers, hurry: float) -> bool:
    """Return whether the rows after gaps (k,) make up for the gaps; `hurry` is the usual rate over the average rate."""
    if np.std(length_s) < REGULAR * np.median(length_s) or not rows_after.std() > 0:
        return hurry > HURRY
    return bool(np.corrcoef(length_s, rows_after)[0, 1] > FOLLOWS)


@dataclass(frozen=True, eq=False)
class EvenRows:
    """Rows that arrived in bursts, at the times at which they were read; a timeline (`imuarray.simulate.timeline`).

    The times are evenly spaced between `knots_ns` (k,), the mean arrival times of stretches whose middle rows are
    `knot_rows` (k,).
    """

    rows: int
    knot_rows: Floats
    knots_ns: Floats

    @property
    def rows_per_s(self) -> float:
        """Mean rate over the whole log."""
        return float(1e9 * (self.knot_rows[-1] - self.knot_rows[0]) / (self.knots_ns[-1] - self.knots_ns[0]))

    def stamps(self, start: int, stop: int) -> Times:
        """Return (stop - start,) ns since the log's epoch."""
        rows, knots_ns = np.arange(start, stop, dtype=float), self.knots_ns - self._origin_ns
        piece = np.clip(np.searchsorted(self.knot_rows, rows, side="right") - 1, 0, len(self.knot_rows) - 2)
        slope = np.diff(knots_ns) / np.diff(self.knot_rows)
        times_ns = knots_ns[piece] + slope[piece] * (rows - self.knot_rows[piece])  # extrapolated beyond the knots
        return np.asarray(np.rint(times_ns) + self._origin_ns, np.int64)

    @cached_property
    def _origin_ns(self) -> int:
        """The first knot, subtracted before floating-point arithmetic: a day in ns has more digits than a float."""
        return int(self.knots_ns[0])


def even_rows(sensor: SensorLog) -> EvenRows:
    """Return evenly spaced times for a sensor whose rows arrive in bursts; reads its times once."""
    rows = len(sensor)
    stretches = max(2, rows // _KNOT_ROWS)
    edges = np.arange(stretches + 1) * rows // stretches
    origin_ns = int(sensor.time[0])
    means = [
        float(np.mean(np.asarray(sensor.time[start:stop], np.int64) - origin_ns))
        for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    ]
    return EvenRows(rows, (edges[:-1] + edges[1:] - 1) / 2, np.array(means) + origin_ns)


def notes_of(timings: Iterable[tuple[str, RowTiming]]) -> list[str]:
    """Return one sentence for all sensors with the same timing that is not steady."""
    sensors: dict[str, list[str]] = {}
    for name, timing in timings:
        if timing.sentence:
            sensors.setdefault(timing.sentence, []).append(name)
    return [f"{', '.join(names)}: {sentence}." for sentence, names in sensors.items()]
