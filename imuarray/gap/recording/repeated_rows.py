"""Stretches of a recorded log in which a sensor repeats the same reading.

The whole log is searched: a reading that is repeated at rest may have been taken while the box was turned.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Booleans, Integers
from imuarray.log.writer import Block

MOST = 256
"""The most stretches of a log that are kept, the longest."""

_LEAST = 2
"""Fewest repetitions of a stretch."""


@dataclass(frozen=True)
class RepeatedRows:
    """The k longest stretches of a log in which every row equals the one before on all axes, at most `MOST`, of two
    such `rows` (k,) or more, in the order of time: `begin_ns` (k,) is the first of these rows, `end_ns` (k,) the last.
    """

    rows: Integers
    begin_ns: Integers
    end_ns: Integers


NO_REPEATED_ROWS = RepeatedRows(*np.zeros((3, 0), np.int64))


def repeated_rows_in(blocks: Iterable[Block]) -> RepeatedRows:
    """Collects the repeated rows of a sensor in bounded memory."""
    last = np.zeros((0, 3), np.int16)
    longest = open_run = np.zeros((0, 3), np.int64)  # each of so many rows, from when, until when
    for block in blocks:
        counts = np.concatenate([last, block.counts])
        x, y, z = (counts[1:] == counts[:-1]).T
        still = x & y & z
        runs = _runs(block.time[len(block.time) - len(still) :], still)
        if len(open_run) and len(still) and still[0]:
            runs[0, 0] += open_run[0, 0]
            runs[0, 1] = open_run[0, 1]
        else:
            runs = np.concatenate([open_run, runs])
        done = len(runs) - int(len(still) > 0 and still[-1])
        longest, open_run, last = _longest(np.concatenate([longest, runs[:done]])), runs[done:], counts[-1:]
    longest = _longest(np.concatenate([longest, open_run]))
    return RepeatedRows(longest[:, 0], longest[:, 1], longest[:, 2])


def _runs(time_ns: Integers, still: Booleans) -> Integers:
    """Rows, first and last time (k, 3) of each stretch."""
    change = np.diff(np.concatenate([[False], still, [False]]).astype(np.int8))
    begins, ends = np.flatnonzero(change > 0), np.flatnonzero(change < 0) - 1
    return np.stack([ends - begins + 1, time_ns[begins], time_ns[ends]], axis=1)


def _longest(runs: Integers) -> Integers:
    """The longest stretches in the order of time; the earlier of two equally long ones."""
    runs = runs[runs[:, 0] >= _LEAST]
    if len(runs) <= MOST:
        return runs
    return np.asarray(runs[np.sort(np.argsort(-runs[:, 0], kind="stable")[:MOST])])
