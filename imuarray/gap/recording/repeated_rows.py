"""Stretches of a recorded log in which a sensor says the same again and again: when each began and ended.

They are of the whole log: what is held while the box lies still may be what was felt while it was turned.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Booleans, Integers
from imuarray.log.writer import Block

MOST = 256
"""So many of a log are kept, the longest."""

_LEAST = 2
"""Fewer repetitions are no stretch."""


@dataclass(frozen=True)
class RepeatedRows:
    """The k longest stretches of a log in which every row equals the one before on all axes, at most `MOST`, of two
    such `rows` (k,) or more, in the order of time: `begin_ns` (k,) is the first of these rows, `end_ns` (k,) the last.
    """

    rows: Integers
    begin_ns: Integers
    end_ns: Integers


NOWHERE = RepeatedRows(*np.zeros((3, 0), np.int64))


def held_in(blocks: Iterable[Block]) -> RepeatedRows:
    """Of all rows of a sensor, in memory that does not grow with them."""
    last = np.zeros((0, 3), np.int16)
    found = lasting = np.zeros((0, 3), np.int64)  # each of so many rows, from when, until when
    for block in blocks:
        counts = np.concatenate([last, block.counts])
        x, y, z = (counts[1:] == counts[:-1]).T
        still = x & y & z
        runs = _runs(block.time[len(block.time) - len(still) :], still)
        if len(lasting) and len(still) and still[0]:
            runs[0, 0] += lasting[0, 0]
            runs[0, 1] = lasting[0, 1]
        else:
            runs = np.concatenate([lasting, runs])
        done = len(runs) - int(len(still) > 0 and still[-1])
        found, lasting, last = _longest(np.concatenate([found, runs[:done]])), runs[done:], counts[-1:]
    found = _longest(np.concatenate([found, lasting]))
    return RepeatedRows(found[:, 0], found[:, 1], found[:, 2])


def _runs(time_ns: Integers, still: Booleans) -> Integers:
    """(k, 3) rows, times of the first and of the last row of each stretch."""
    change = np.diff(np.concatenate([[False], still, [False]]).astype(np.int8))
    begins, ends = np.flatnonzero(change > 0), np.flatnonzero(change < 0) - 1
    return np.stack([ends - begins + 1, time_ns[begins], time_ns[ends]], axis=1)


def _longest(runs: Integers) -> Integers:
    """The longest of stretches in the order of time; the earlier one of two that are as long."""
    runs = runs[runs[:, 0] >= _LEAST]
    if len(runs) <= MOST:
        return runs
    return np.asarray(runs[np.sort(np.argsort(-runs[:, 0], kind="stable")[:MOST])])
