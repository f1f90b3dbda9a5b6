"""The quiet part of a phase at rest.

Labels are set by hand, a second early or late. A box at rest is touched, or stands on a desk at which somebody types,
or on a vehicle whose engine starts. A simulation contains none of these. If the noise of a single sensor rises, the
sensor causes it. If the noise of several sensors rises at the same time, the box is not at rest: these times are left
out, as are the ends of a phase in which the box still moves. If there are several sensors of a quantity, several of
them must show the motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Integers
from imuarray.gap.recording.source import RecordedSource
from imuarray.log import SensorLog
from imuarray.log.format import Phase
from imuarray.units import INERTIAL, SI_PER_UNIT

_BLOCK_S, _BLOCK_ROWS, _MOST_BLOCKS = 0.3, 32.0, 50_000
"""Least length of a block in s, least number of rows of the slowest sensor in it, and the largest number of blocks of a
phase.
"""

_FEWEST_EDGES = 4
"""Fewest edges of blocks, those of three blocks: with fewer, none can be quieter than the others."""

_QUIETEST, _LOUDER = 0.1, 1.5
"""Quantile of the variances of the blocks that is the noise of a box at rest, and the ratio to it above which a block
is restless. The ratio is larger if a variance is estimated from few rows.
"""

_CERTAIN, _AT_QUIETEST, _VARIANCES = 3.0, 1.3, 3.0
"""Number of standard deviations by which a variance exceeds chance, number of those by which the quantile is expected
below the mean, and the product of the rows and the squared relative standard deviation of a variance of steps.
"""

_CLEAR = 2.0
"""Ratio of an excess to the least significant one at which a single sensor shows a disturbance beyond doubt."""

_SHARE = 1 / 3
"""Least share of the sensors, and at least two of them, in which a block has to be restless."""

_MOVES: Mapping[str, float] = MappingProxyType({"specific_force": 0.1, "angular_rate": 0.009})
"""Least change of the mean reading (m/s2; rad/s: 0.5 dps) that is a motion rather than a drift."""

_HAND_S, _LEAST_S = 3.0, 2.0
"""Longest time, in s, by which a label may be early or late, and shortest rest, in s, that remains after a cut."""

_AROUND_S = 0.5
"""Time before and after restless blocks that is left out too, in s."""


_KNOCK_S, _KNOCK_ROWS, _AROUND_KNOCK_S = 0.15, 8.0, 0.1
"""Least length of a block of a motion in s, least number of rows of the slowest sensor in it, and time before and after
a knock that is left out too, in s.
"""

_LEAST_NOISE, _MOST_ROWS = 0.3, 500_000
"""Least noise in counts, that of rounding, and the largest number of rows of a phase that are used."""

_HARD, _EXCEPTIONAL, _FAST, _MOST_KNOCKED = 3.0, 4.0, 0.7, 0.5
"""Ratio of the second differences to the noise at rest, to the median over the motion, and to the first differences
(which are larger in a smooth motion), above which a sensor measures a knock; the largest share of a motion that may be
left out.
"""


class QuietRest(NamedTuple):
    """A phase at rest without its restless ends; `restless` are the spans (begin, end), in ns, in between that are left
    out, and `left_out_s` is the total time left out, ends included.
    """

    phase: Phase
    restless: tuple[tuple[int, int], ...] = ()
    left_out_s: float = 0.0


def quiet_rest(triads: Sequence[SensorLog], rest: Phase) -> QuietRest:
    """Return the quiet part of a phase at rest according to these sensors; all of it if fewer than two were read."""
    inertial = [sensor for sensor in triads if sensor.quantity in INERTIAL]
    rows = {sensor: RecordedSource(sensor).rows(rest.start_ns, rest.end_ns) for sensor in inertial}
    read = [sensor for sensor, count in rows.items() if count > _BLOCK_ROWS]
    edges_ns = _edges_ns(rest, min(rows[sensor] for sensor in read)) if len(read) > 1 else np.zeros(0, np.int64)
    if len(edges_ns) < _FEWEST_EDGES:
        return QuietRest(rest)
    blocks = [_blocks_of(sensor, edges_ns) for sensor in read]
    votes = np.sum([block.is_restless for block in blocks], axis=0)
    is_restless = (votes >= max(2.0, _SHARE * len(read))) | _is_hidden_from_others(read, blocks)
    moves = _moves(read, blocks)
    first = _cut(is_restless, moves, edges_ns)
    stop = len(is_restless) - _cut(is_restless[::-1], moves[::-1], edges_ns)
    around_ns = round(_AROUND_S * 1e9)
    start_ns = int(edges_ns[first]) + around_ns if first else rest.start_ns
    end_ns = int(edges_ns[stop]) - around_ns if stop < len(is_restless) else rest.end_ns
    if (end_ns - start_ns) * 1e-9 < _LEAST_S:
        return QuietRest(rest)
    restless = _spans(is_restless, edges_ns.clip(start_ns, end_ns), first, stop)
    left_out_ns = rest.end_ns - end_ns + start_ns - rest.start_ns + sum(end - begin for begin, end in restless)
    return QuietRest(rest._replace(start_ns=start_ns, end_ns=end_ns), restless, left_out_ns * 1e-9)


def knocks(triads: Sequence[SensorLog], motion: Phase, rests: Sequence[Phase]) -> tuple[tuple[int, int], ...]:
    """Return the spans (begin, end), in ns, of a motion in which several sensors measure a knock; none if the whole
    motion is rough. The noise of the sensors is that of the first of the `rests` in which they were read.
    """
    inertial = [sensor for sensor in triads if sensor.quantity in INERTIAL]
    rows = [RecordedSource(sensor).rows(motion.start_ns, motion.end_ns) for sensor in inertial]
    read = [sensor for sensor, count in zip(inertial, rows, strict=True) if count > _KNOCK_ROWS]
    if len(read) < 2:
        return ()
    seconds = (motion.end_ns - motion.start_ns) * 1e-9
    block_s = max(_KNOCK_S, _KNOCK_ROWS * seconds / min(count for count in rows if count > _KNOCK_ROWS))
    edges_ns = np.linspace(motion.start_ns, motion.end_ns, int(seconds / block_s) + 1).astype(np.int64)
    if len(edges_ns) < _FEWEST_EDGES or len(edges_ns) > _MOST_BLOCKS:
        return ()
    votes = np.sum([_is_knocked(sensor, edges_ns, rests) for sensor in read], axis=0)
    is_knocked = votes >= max(2.0, _SHARE * len(read))
    spans = _spans(is_knocked, edges_ns, 0, len(is_knocked), _AROUND_KNOCK_S)
    left_out_s = sum(end_ns - begin_ns for begin_ns, end_ns in spans) * 1e-9
    return spans if left_out_s < _MOST_KNOCKED * seconds else ()


def _is_knocked(sensor: SensorLog, edges_ns: Integers, rests: Sequence[Phase]) -> Booleans:
    """Return the blocks of a motion in which a sensor measures a knock."""
    change, roughness = _roughness(sensor, edges_ns)
    at_rest = [_roughness(sensor, np.array([rest.start_ns, rest.end_ns], np.int64))[1][0] for rest in rests]
    noise = next((level for level in at_rest if np.isfinite(level).all()), None)
    known = np.isfinite(roughness).all(axis=1)
    if noise is None or not known.any():
        return np.zeros(len(roughness), bool)
    least = np.maximum(_HARD * np.maximum(noise, _LEAST_NOISE), _EXCEPTIONAL * np.median(roughness[known], axis=0))
    is_fast = roughness > _FAST * change  # false for nan
    return np.asarray((is_fast & (roughness > least)).any(axis=1))


def _roughness(sensor: SensorLog, edges_ns: Integers) -> tuple[Floats, Floats]:
    """Return the root mean squares (b, 3) of the first and of the second differences of a sensor's readings in blocks,
    as noise of single readings in counts; nan for blocks with few readings. Readings that are repeated are left out.
    """
    first, stop = (sensor.between(int(edges_ns[0]), int(edges_ns[-1]))).indices(len(sensor))[:2]
    stop = min(stop, first + _MOST_ROWS)
    counts, time_ns = np.asarray(sensor.counts[first:stop], float), np.asarray(sensor.time[first:stop], np.int64)
    is_new = np.r_[True, np.diff(counts, axis=0).any(axis=1)] if len(counts) else np.zeros(0, bool)
    counts, time_ns = counts[is_new], time_ns[is_new]
    if len(counts) < _KNOCK_ROWS:
        nothing = np.full((len(edges_ns) - 1, 3), np.nan)
        return nothing, nothing
    places = np.searchsorted(time_ns[1:-1], edges_ns)
    changes = np.diff(places)[:, None]
    mean_squares = (
        np.diff(np.cumsum(np.vstack([np.zeros(3), steps**2]), axis=0)[places], axis=0) / np.maximum(changes, 1)
        for steps in (np.diff(counts, axis=0)[1:], np.diff(counts, n=2, axis=0))
    )
    first_square, second_square = (np.where(changes >= _KNOCK_ROWS / 2, square, np.nan) for square in mean_squares)
    return np.sqrt(first_square / 2), np.sqrt(second_square / 6)


def _is_hidden_from_others(sensors: Sequence[SensorLog], blocks: Sequence[_Blocks]) -> Booleans:
    """Return the blocks (b,) in which an accelerometer measures a disturbance that none of the others, one or more,
    could measure: a faint knock cannot be distinguished from an error of the least noisy one.
    """
    places = [at for at, sensor in enumerate(sensors) if sensor.quantity == "specific_force"]
    hidden = np.zeros(len(blocks[0].is_restless), bool)
    for at in places if len(places) > 1 else ():
        least = np.min([blocks[other].least for other in places if other != at], axis=0)
        is_clear = blocks[at].is_restless & (blocks[at].excess > _CLEAR * blocks[at].least)
        hidden |= is_clear & (blocks[at].excess < least)
    return hidden


def _moves(sensors: Sequence[SensorLog], blocks: Sequence[_Blocks]) -> Booleans:
    """Return the blocks (b,) in which the box moves. If there are several sensors of a quantity, at least two of them,
    and at least `_SHARE` of them, must measure the motion: the level of a single one also changes with its temperature,
    or by a corrupted reading.
    """
    is_moved = np.zeros(len(blocks[0].moves), bool)
    for quantity in INERTIAL:
        own = [block.moves for sensor, block in zip(sensors, blocks, strict=True) if sensor.quantity == quantity]
        if own:
            is_moved |= np.sum(own, axis=0) >= max(min(2, len(own)), _SHARE * len(own))
    return is_moved


class _Blocks(NamedTuple):
    """The blocks (b,) of a phase that are restless according to a sensor, and those in which it measures a motion; the
    largest excess of their variances over those at rest, and the least excess that is significant along all axes, both
    in squared SI units.
    """

    is_restless: Booleans
    moves: Booleans
    excess: Floats
    least: Floats


def _edges_ns(rest: Phase, rows: int) -> Integers:
    """Return the edges of the blocks of a phase; `rows` is the number of rows of its slowest sensor."""
    seconds = (rest.end_ns - rest.start_ns) * 1e-9
    block_s = max(_BLOCK_S, _BLOCK_ROWS * seconds / rows, seconds / _MOST_BLOCKS)
    return np.linspace(rest.start_ns, rest.end_ns, int(seconds / block_s) + 1).astype(np.int64)


def _blocks_of(sensor: SensorLog, edges_ns: Integers) -> _Blocks:
    """Return the blocks of a sensor, judged by the rows that differ from the one before: a repeated reading is not
    quiet.
    """
    sums = np.zeros((len(edges_ns) - 1, 8))
    for block in RecordedSource(sensor).blocks(int(edges_ns[0]), int(edges_ns[-1])):
        counts = np.asarray(block.counts, float)
        steps = np.diff(counts, axis=0, prepend=counts[:1])
        columns = np.column_stack([np.ones(len(counts)), counts, steps**2, steps.any(axis=1)])
        running = np.vstack([np.zeros(8), np.cumsum(columns, axis=0)])
        sums += np.diff(running[np.searchsorted(block.time, edges_ns)], axis=0)
    rows, new_rows = np.maximum(sums[:, :1], 1.0), np.maximum(sums[:, 7:], 1.0)
    has_rows = sums[:, 7] >= _BLOCK_ROWS / 2
    if not has_rows.any():
        return _Blocks(has_rows, has_rows, np.zeros(len(has_rows)), np.full(len(has_rows), np.inf))
    mean, variance = sums[:, 1:4] / rows, sums[:, 4:7] / new_rows / 2 + 1 / 12
    quietest = np.quantile(variance[has_rows], _QUIETEST, axis=0)
    deviation = np.sqrt(_VARIANCES / new_rows)
    limit = np.maximum(_LOUDER, (1 + _CERTAIN * deviation) / np.maximum(1 - _AT_QUIETEST * deviation, 0.1))
    apart = np.abs(mean - np.median(mean[has_rows], axis=0))
    least = _MOVES[sensor.quantity] / SI_PER_UNIT[sensor.unit] * sensor.sensitivity
    is_moved = apart > np.maximum(least, _CERTAIN * np.sqrt(np.median(variance[has_rows], axis=0) / rows))
    is_restless = (variance > limit * quietest).any(axis=1) & has_rows
    unit_square = (SI_PER_UNIT[sensor.unit] / sensor.sensitivity) ** 2
    excess, significant = (variance - quietest).max(axis=1), ((limit - 1) * quietest).max(axis=1)
    significant = np.where(has_rows, significant, np.inf)
    return _Blocks(is_restless, is_moved.any(axis=1) & has_rows, excess * unit_square, significant * unit_square)


def _cut(is_restless: Booleans, moves: Booleans, edges_ns: Integers) -> int:
    """Return the number of blocks at the beginning that are not at rest."""
    cut = int(np.argmin(is_restless | moves)) if not (is_restless | moves).all() else 0
    block_s = float(edges_ns[1] - edges_ns[0]) * 1e-9
    if np.count_nonzero(~is_restless[:cut]) * block_s > _HAND_S:
        return int(np.argmin(is_restless))
    return cut


def _spans(
    is_restless: Booleans, edges_ns: Integers, first: int, stop: int, around_s: float = _AROUND_S
) -> tuple[tuple[int, int], ...]:
    """Return the restless spans in these blocks, clipped to the first and the last edge, overlapping ones joined."""
    around_ns = round(around_s * 1e9)
    spans: list[tuple[int, int]] = []
    for at in (np.flatnonzero(is_restless[first:stop]) + first).tolist():
        begin_ns = max(int(edges_ns[at]) - around_ns, int(edges_ns[0]))
        end_ns = min(int(edges_ns[at + 1]) + around_ns, int(edges_ns[-1]))
        begin_ns = spans.pop()[0] if spans and begin_ns <= spans[-1][1] else begin_ns
        spans.append((begin_ns, end_ns))
    return tuple(spans)
