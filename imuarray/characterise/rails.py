"""Clipping of readings: the codes beyond which a sensor gives none, from its range and from its readings.

A rail is an end of the codes' bits; the code of range times sensitivity, where readings reach it and none is beyond; or
a pile of readings at the largest code, because a range, a filter or a driver may end elsewhere. A density falls towards
its ends, so the last code is no more frequent than any of those before it; a pile that this law excludes is a rail if
it is near the range's end, or, if smooth motion that turns there does not explain it, if the other axes move in it. (At
rest, a coarse sensor with one face down piles up its readings, too, but then the other axes don't move.)
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np
import numpy.typing as npt
from scipy.special import bdtrc

from imuarray.characterise.codes import NARROW, NOTHING, Histogram, histogram, usual_step
from imuarray.log import SensorLog

Counts = npt.NDArray[np.int64]

SPAN = (-32768, 32767)
"""Ends of codes of 16 bits."""

LEAST_PILE = 5
"""Fewer readings are no pile: a pair of equal peaks is no chance of one in a million."""

BEFORE = 8
"""Codes before the last one that it is compared with."""

FALLING = 1 / (BEFORE + 1)
TURNING = FALLING**0.5
"""Share of the last code among itself and those before it: at most the first where the density falls to its end, the
second where a smooth motion turns (the time that x = x_max - t^2 spends beyond a code grows with the square root).
"""

SURE = 1e-6
"""The probability of a pile by chance below which it is reported."""

NOMINAL = 2
"""Codes by which the end of a range may lie off range times sensitivity: 2047 or 2048, rounded or cut."""

NEAR_RANGE = 0.1
"""A pile is near its range's end if it is so near as a share of it: chips' ranges are a little more than they say."""

MOVING_STEPS = 20.0
"""Spread of another axis, in steps of its codes, from which on the box moves while readings pile up: noise alone seldom
has so much, and a coarse sensor at rest has none."""

_BLOCK_ROWS = 4096
"""A chunk of a log: an import, which reads so much at once, takes no more memory for it."""


@dataclass(frozen=True)
class Rails:
    """Lowest and highest code (3,) of each axis, at and beyond which it clips: -inf, inf where it does not. `rows`
    (3,): how many readings do.
    """

    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    rows: Counts

    def clipped(self, counts: npt.NDArray[np.integer]) -> npt.NDArray[np.bool_]:
        """(n,) which rows (n, 3) clip."""
        return np.asarray(((counts <= self.low) | (counts >= self.high)).any(axis=1))


def find_rails(sensor: SensorLog) -> Rails:
    """Find the rails of a triad; its rows are read twice at most."""
    seen = [NOTHING] * 3
    for block in sensor.blocks(_BLOCK_ROWS):
        counts = np.asarray(sensor.counts[block], np.int64)
        seen = [known.merge(histogram(column)) for known, column in zip(seen, counts.T, strict=True)]
    low, high = np.full(3, -inf), np.full(3, inf)
    if not len(sensor):
        return Rails(low, high, np.zeros(3, np.int64))
    nominal = round(sensor.range * sensor.sensitivity)
    span = -(1 << sensor.count_bits - 1), (1 << sensor.count_bits - 1) - 1
    doubtful: list[tuple[int, int]] = []
    for axis, codes in enumerate(seen):
        for side in (-1, 1):
            code = int(codes.codes[-1 if side > 0 else 0])
            verdict = code == span[side > 0] or _at_end(codes, side, nominal)
            if verdict:
                (high if side > 0 else low)[axis] = code
            elif verdict is None:
                doubtful.append((axis, code))
    for axis, code in _moving(sensor, doubtful, [max(1, usual_step(codes)) for codes in seen]):
        if code == seen[axis].codes[-1]:
            high[axis] = code
        else:
            low[axis] = code
    rows = [
        int(codes.counts[(codes.codes <= low[axis]) | (codes.codes >= high[axis])].sum())
        for axis, codes in enumerate(seen)
    ]
    return Rails(low, high, np.array(rows, np.int64))


def _at_end(seen: Histogram, side: int, nominal: int) -> bool | None:
    """Return whether the last code on a side is a rail; None if that depends on whether the box moved."""
    code = int(seen.codes[-1 if side > 0 else 0])
    away = side * code
    if 0 < nominal - NOMINAL <= away <= nominal:
        return True
    is_near = abs(away - nominal) <= NEAR_RANGE * nominal
    if not _is_pile(seen, side, FALLING if is_near else TURNING):
        return False
    return True if is_near else None


def _is_pile(seen: Histogram, side: int, share: float) -> bool:
    """Return whether the last code on a side comes more often than `share` of it and the codes before it allows."""
    code = int(seen.codes[-1 if side > 0 else 0])
    count = int(seen.counts[-1 if side > 0 else 0])
    step = usual_step(seen)
    if count < LEAST_PILE or step == 0:
        return False
    mean = float(seen.codes @ seen.counts) / float(seen.counts.sum())
    if float(seen.counts @ (seen.codes - mean) ** 2) / float(seen.counts.sum()) < (NARROW * step) ** 2:
        return False
    inwards = side * (code - seen.codes)
    before = int(seen.counts[(inwards > 0) & (inwards <= BEFORE * step)].sum())
    return bool(bdtrc(count - 1, count + before, share) < SURE)


def _moving(sensor: SensorLog, piles: list[tuple[int, int]], steps: list[int]) -> list[tuple[int, int]]:
    """Return the piles (axis, code) during which another axis moves."""
    sums = np.zeros((len(piles), 3, 3))
    for block in sensor.blocks(_BLOCK_ROWS) if piles else ():
        counts = np.asarray(sensor.counts[block], float)
        for number, (axis, code) in enumerate(piles):
            rows = counts[counts[:, axis] == code]
            sums[number] += [np.full(3, float(len(rows))), rows.sum(axis=0), (rows**2).sum(axis=0)]
    moving = []
    for (axis, code), (rows, total, squares) in zip(piles, sums, strict=True):
        spread = np.sqrt(np.maximum(squares / rows - (total / rows) ** 2, 0.0)) / np.array(steps)
        if np.delete(spread, axis).max() > MOVING_STEPS:
            moving.append((axis, code))
    return moving
