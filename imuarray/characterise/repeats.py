"""Repeated readings: rows that equal the one before in all columns, and the rate of new readings that they imply.

A chip that is read more often than it measures returns each reading several times. New readings may also be equal by
chance, all columns at once, if the noise is small compared with a count; that probability is estimated from rows that
are `APART` rows apart, where neither repeats nor the correlation of filtered noise matter. (Noise that changes by less
than a count from row to row over longer times, in all columns, can't be distinguished from repeats.)

`Stalls` are frozen readings of an ICM-42688-P with its adaptive range on, where a rate passes 100 dps (TDK-18): the
chip has no new reading for 1 to 2 ms at each passage, so that the row before the passage equals the previous row in all
axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

import numpy as np
import numpy.typing as npt

from imuarray.log import SensorLog

Counts = npt.NDArray[np.integer]

APART = 64
"""Rows at this distance are equal by chance only, unless the chip measures less than once in this many rows."""

STALE_SHARE = 0.015
"""Share of repeated rows, beyond chance, that is reported."""

THRESHOLD_DPS = 100.0
LEAST_STALLS = 3
LEAST_SHARE = 0.5
"""Fewest stalls (`LEAST_STALLS`), and least share of the passages with a stall, that are reported: equal rows also
occur by chance.
"""

_BLOCK_ROWS = 4096


@dataclass(frozen=True)
class Repeats:
    """The share of rows that equal the one before; nan without two neighbouring rows.

    `repeat_share` is a share of the rows that have a row before them. `chance_share` is the share of rows that equal
    the one `APART` rows before (nan without such rows). `new_share` is the share of new readings, equal by chance or
    not: 1 - (repeat_share - chance_share) / (1 - chance_share), at most 1. The longest run of equal rows is `longest`
    rows long and starts at `longest_row`, counted from 0.
    """

    rows: int
    repeat_share: float
    chance_share: float
    new_share: float
    longest: int
    longest_row: int

    def update_rate_hz(self, rate_hz: float) -> float:
        """Return the new readings per second of a log with `rate_hz` rows per second, which is an upper limit."""
        return self.new_share * rate_hz


class LongestRuns:
    """Lengths of the two longest runs of equal readings, and the first row of the longest; the first of equal ones."""

    def __init__(self) -> None:
        self.longest = self.next_longest = self.first_row = 0
        self._start = 0

    def end_at(self, starts: npt.NDArray[np.int64]) -> None:
        """Add the runs that end where the next ones start, at rows `starts` (k,)."""
        if len(starts) == 0:
            return
        lengths = np.diff(starts, prepend=self._start)
        at = int(lengths.argmax())
        length = int(lengths[at])
        lengths[at] = 0
        if length > self.longest:
            self.next_longest = max(self.longest, int(lengths.max()))
            self.longest, self.first_row = length, int(starts[at]) - length
        else:
            self.next_longest = max(self.next_longest, length)
        self._start = int(starts[-1])


class RepeatTally:
    """Compares rows of counts with those before them."""

    def __init__(self) -> None:
        self._before: Counts | None = None
        self._compared = self._equal = self._far_compared = self._far_equal = 0
        self._rows = 0
        self._runs = LongestRuns()

    def update(self, counts: Counts) -> None:
        """Add the next rows (n, k) of the run."""
        if len(counts) == 0:
            return
        rows = counts if self._before is None else np.concatenate([self._before, counts])
        earlier = len(rows) - len(counts)
        begin = max(earlier, 1)
        equal = equal_rows(rows[begin:], rows[begin - 1 : -1])
        self._compared += len(equal)
        self._equal += int(np.count_nonzero(equal))
        far = max(earlier, APART)
        self._far_compared += max(0, len(rows) - far)
        if len(rows) > far:
            self._far_equal += int(np.count_nonzero(equal_rows(rows[far:], rows[far - APART : -APART])))
        self._runs.end_at(self._rows + begin - earlier + np.flatnonzero(~equal))
        self._rows += len(counts)
        self._before = rows[-APART:].copy(order="K")

    def end_run(self) -> None:
        """End a run at a gap: the next row is not compared with the one before."""
        self._runs.end_at(np.array([self._rows]))
        self._before = None

    def result(self) -> Repeats:
        """Return the statistics of all rows so far, and end the run."""
        self.end_run()
        share = self._equal / self._compared if self._compared else nan
        chance = self._far_equal / self._far_compared if self._far_compared else nan
        by_chance = 0.0 if np.isnan(chance) else chance
        new = min(1.0, (1 - share) / (1 - by_chance)) if self._compared and by_chance < 1 else nan
        return Repeats(self._rows, share, chance, new, self._runs.longest, self._runs.first_row)


class RunTally(LongestRuns):
    """The longest runs of equal codes of one axis, over `rows` rows."""

    def __init__(self) -> None:
        super().__init__()
        self.rows = 0
        self._before = np.zeros(0, np.int64)

    def update(self, codes: Counts) -> None:
        """Add the next codes (n,)."""
        column = np.concatenate([self._before, codes])
        self.end_at(self.rows - len(self._before) + 1 + np.flatnonzero(column[1:] != column[:-1]))
        self.rows += len(codes)
        self._before = column[-1:]

    def finish(self) -> None:
        """End the last run."""
        self.end_at(np.array([self.rows]))


def equal_rows(rows: Counts, others: Counts) -> npt.NDArray[np.bool_]:
    """Return (n,) which rows (n, k) are equal; column by column, 5 times as fast as over each row."""
    equal = np.ones(len(rows), bool)
    for row, other in zip(rows.T, others.T, strict=True):
        equal &= row == other
    return equal


@dataclass(frozen=True)
class Stalls:
    """Numbers of passages of an axis through 100 dps from row to row, and of those that follow a frozen reading."""

    passages: int
    stalled: int

    @property
    def is_adaptive(self) -> bool:
        """True if stalls are more frequent than by chance."""
        return self.stalled >= LEAST_STALLS and self.stalled >= LEAST_SHARE * self.passages


def find_stalls(sensor: SensorLog) -> Stalls | None:
    """Count stalls in all rows of a log; None for a chip without an adaptive range. Rows on either side of a missing
    one count as neighbours, which does not make readings equal.
    """
    if sensor.quantity != "angular_rate" or not sensor.chip.lower().startswith("icm42688") or not sensor.sensitivity:
        return None
    threshold = THRESHOLD_DPS * sensor.sensitivity
    passages = stalled = 0
    previous = np.empty((0, 3), np.int64)
    for block in sensor.blocks(_BLOCK_ROWS):
        rows = np.concatenate([previous, np.asarray(sensor.counts[block], np.int64)])
        inside = np.abs(rows) < threshold
        passed = (inside[2:] != inside[1:-1]).any(axis=1)
        passages += int(np.count_nonzero(passed))
        stalled += int(np.count_nonzero(passed & (rows[1:-1] == rows[:-2]).all(axis=1)))
        previous = rows[-2:]
    return Stalls(passages, stalled)
