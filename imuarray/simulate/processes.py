"""Slow random processes, Gauss-Markov and random walk, of which any stretch of rows can be generated alone.

A process is generated on knots, every `spacing` rows, and is linear in between. If every row is a knot, it is exact.
Otherwise knots are at most a five hundredth of a time constant apart (a tenth of a second for a random walk). This
omits less than 0.1 % of the variance of a Gauss-Markov process, at frequencies at which the white noise of every sensor
is many thousand times stronger. Between the knots of a process that is part of a sum (flicker noise) the faster
processes contribute more, so that knots may be further apart (`_OF_A_SUM`). The spacing of a Gauss-Markov process is a
power of two and its draws do not depend on the time constant. A slightly different time constant therefore gives a
slightly different process, unless the spacing changes.

Knots are grouped in chunks. The values at the beginning and end of each chunk are drawn first, from a separate stream
and with the exact law x[end] = phi**KNOTS x[begin] + w. The knots inside are drawn from another stream without regard
to the end, x' = phi x' + innovation, and then corrected to meet it (conditioning of jointly normal numbers). Every
chunk therefore costs the same.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Reals
from imuarray.recursion import first_order
from imuarray.simulate.signal import Place, Triple
from imuarray.simulate.streams import Stream

KNOTS = 4096
"""Knots per chunk of a process. Drawing them dominates the cost; few are drawn in vain beyond a requested stretch."""

_PER_TIME_CONSTANT = 500  # least number of knots
_OF_A_SUM = 16
"""Least number of knots in a time constant of a process that is part of a sum. At most 2 % of the variance of the
process is omitted, at frequencies above eight periods in its time constant. In 1/f noise the contribution of a process
there is 2 % of that of the faster ones.
"""

_RANDOM_WALK_KNOT_S = 0.1
_WIDEST = 256  # rows per knot above which knots cost little
_ENDS = 64  # chunks of knots whose ends are drawn together
_PIECE_ROWS = 8192  # rows that are interpolated in one product of 147,456 multiplications
_UNIT = (1.0, 1.0, 1.0)
_FORGOTTEN = 42.0  # time constants; exp(-42) of the past is below the last bit


class Recursion(NamedTuple):
    """The recursion x[k + 1] = exp(-decay) x[k] + w with w ~ N(0, step^2) and x[0] ~ N(0, initial^2); with `decay` 0 it
    is a random walk.
    """

    decay: float
    step: float
    initial: float


class SlowProcess:
    """Three independent axes of a `Recursion`, interpolated between its knots; built by the two functions below."""

    def __init__(self, spacing: int, recursion: Recursion, inside: Stream, ends: Stream, scale: Triple) -> None:
        self.spacing = spacing
        self._recursion = recursion
        self._decay, self._step, self._initial = recursion
        self._inside = inside
        self._draws = inside.without_memory()
        self._ends = ends
        self._scale = np.array(scale)
        self._piece_knots = max(1, _PIECE_ROWS // spacing)
        self._knots = lru_cache(maxsize=2)(self._recall_chunk)
        self._piece = lru_cache(maxsize=3)(self._interpolate)

    def rows(self, first: int, stop: int, dtype: npt.DTypeLike = np.float64) -> Reals:
        """Return (stop - first, 3) values for these rows."""
        return self.added_to(np.broadcast_to(np.zeros((), dtype), (stop - first, 3)), first)

    def added_to(self, values: Reals, first: int) -> Reals:
        """Return `values` (n, 3) of the rows from `first` on plus the process, as a new array."""
        length = self._piece_knots * self.spacing
        total, stop = np.empty(values.shape, values.dtype), first + len(values)
        for piece in range(first // length, max(stop - 1, first) // length + 1):
            begin, end = max(piece * length, first), min((piece + 1) * length, stop)
            rows = self._piece(piece, values.dtype.str)[begin - piece * length : end - piece * length]
            np.add(values[begin - first : end - first], rows, out=total[begin - first : end - first])
        return total

    def _interpolate(self, piece: int, dtype: str) -> Reals:
        """Return the rows of one piece.

        A matrix product turns two adjacent knots of three axes into the rows from the first knot to just before the
        second. All pieces have the same size, which is so small that BLAS uses a single thread: the rounding of a row
        does not depend on the requested stretch.
        """
        begin = piece * self._piece_knots
        knots = (self._find_knots(begin, begin + self._piece_knots) * self._scale).astype(dtype)
        if self.spacing == 1:
            return np.asarray(knots[:-1])
        pairs = np.concatenate([knots[:-1], knots[1:]], axis=1)
        rows: Reals = (pairs @ _weights(self.spacing, dtype)).reshape(-1, 3)
        rows.flags.writeable = False
        return rows

    def _find_knots(self, begin: int, end: int) -> Floats:
        """Return knots begin ... end. The first knot of a chunk is the end of the one before, which need not be drawn
        for it.
        """
        last = (end - 1) // KNOTS
        parts = []
        for chunk in range(begin // KNOTS, last + 1):
            start = chunk * KNOTS
            stop = end + 1 if chunk == last else start + KNOTS
            parts.append(self._knots(chunk)[max(begin - start, 0) : stop - start])
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _recall_chunk(self, chunk: int) -> Floats:
        """Return the knots (KNOTS + 1, 3) of one chunk, including its end."""
        return np.asarray(
            self._inside.recall(("knots", self._recursion, chunk), lambda: self._draw_chunk(chunk)), float
        )

    def _draw_chunk(self, chunk: int) -> Floats:
        """Return the knots (KNOTS + 1, 3) of one chunk, drawn without regard to its end and corrected to meet it."""
        start, end = self._edges(chunk)
        phi = math.exp(-self._decay)
        steps = self._draws.normal(chunk * KNOTS, (chunk + 1) * KNOTS).astype(float) * self._step
        steps[0] += phi * start
        free = first_order(steps, phi)
        inside = free + _bridge(self._decay)[:, None] * (end - free[-1])
        knots: Floats = np.concatenate([start[None], inside[:-1], end[None]])
        knots.flags.writeable = False
        return knots

    def _edges(self, chunk: int) -> tuple[Floats, Floats]:
        """Return the first and last value of a chunk, with the steps of earlier chunks that still have influence."""
        stimulus = math.ceil(_FORGOTTEN / (KNOTS * self._decay)) if self._decay else chunk
        earliest = max(0, chunk - stimulus)
        steps = self._ends.normal(earliest, chunk + 2).astype(float)
        steps[1:] *= self._step * math.sqrt(_growth(KNOTS, self._decay))
        if earliest == 0:
            steps[0] *= self._initial
        path = first_order(steps, math.exp(-KNOTS * self._decay))
        return path[-2], path[-1]


@lru_cache(maxsize=64)
def _weights(spacing: int, dtype: str) -> Reals:
    """Return the weights (6, 3 spacing) of two knots in each axis of each row between them."""
    share = np.arange(spacing) / spacing
    return np.concatenate([np.kron(1 - share, np.eye(3)), np.kron(share, np.eye(3))]).astype(dtype)


def _growth(steps: npt.ArrayLike, decay: float) -> Floats:
    """Return the variance after this number of steps from a known start, relative to the variance of one step."""
    count = np.asarray(steps, float)
    return np.asarray(np.expm1(-2 * decay * count) / math.expm1(-2 * decay)) if decay else count


@lru_cache(maxsize=64)
def _bridge(decay: float) -> Floats:
    """Return (KNOTS,) cov(x[k], x[K]) / var(x[K]) of a free path from a known start, k = 1 ... K = KNOTS: the share of
    a correction of the end that is applied to each knot.
    """
    steps = np.arange(1, KNOTS + 1)
    return np.asarray(np.exp((steps - KNOTS) * decay) * _growth(steps, decay) / _growth(KNOTS, decay))


def gauss_markov(
    time_constant_s: float, at: Place, effect: str, shared_by: str = "", scale: Triple = _UNIT, number: int = 0
) -> SlowProcess:
    """Return a stationary first-order Gauss-Markov process of rms `scale`: correlation exp(-|t| / time_constant).
    `number` is 1, 2, ... for the processes of a sum, which have independent draws, and 0 for a single process.
    """
    return at.kept(
        ("gauss_markov", time_constant_s, effect, at.copy, shared_by, scale, number),
        lambda: _gauss_markov(time_constant_s, at, effect, shared_by, scale, number),
    )


def _gauss_markov(
    time_constant_s: float, at: Place, effect: str, shared_by: str, scale: Triple, number: int
) -> SlowProcess:
    rows_per_constant = at.rows_per_s * time_constant_s
    knots = _OF_A_SUM if number else _PER_TIME_CONSTANT
    widest = min(max(1, math.floor(rows_per_constant / knots)), _WIDEST)
    spacing = 1 << (widest.bit_length() - 1)
    decay = spacing / rows_per_constant
    inside = at.stream(effect, f"inside, number {max(number, 1)}", shared_by=shared_by, chunk_rows=KNOTS)
    ends = at.stream(effect, f"ends, number {max(number, 1)}", shared_by=shared_by, chunk_rows=_ENDS)
    return SlowProcess(spacing, Recursion(decay, math.sqrt(-math.expm1(-2 * decay)), 1.0), inside, ends, scale)


def random_walk(at: Place, effect: str, scale: Triple = _UNIT) -> SlowProcess:
    """Return a Wiener process: its variance grows by the square of `scale` per second, from zero at row 0."""
    return at.kept(("random_walk", effect, at.copy, scale), lambda: _random_walk(at, effect, scale))


def _random_walk(at: Place, effect: str, scale: Triple) -> SlowProcess:
    spacing = min(max(1, math.floor(at.rows_per_s * _RANDOM_WALK_KNOT_S)), _WIDEST)
    inside = at.stream(effect, "inside", chunk_rows=KNOTS)
    ends = at.stream(effect, "ends", chunk_rows=_ENDS)
    return SlowProcess(spacing, Recursion(0.0, math.sqrt(spacing / at.rows_per_s), 0.0), inside, ends, scale)
