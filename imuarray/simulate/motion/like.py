"""The motion of a recorded log, as far as the log contains it: its columns as smooth functions of time, read block by
block.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Integers, Reals
from imuarray.axes import UP_AXES
from imuarray.calibrate.segments import TemperatureSeries, chip_thermometer
from imuarray.errors import LogError
from imuarray.log.columns import NamedColumn, Track
from imuarray.log.format import Phase
from imuarray.log.reader import Log
from imuarray.simulate.motion.faces import (
    FIELD_LEVEL,
    GRAVITY_LEVEL,
    ROOM_DEGC,
    PhaseField,
    field_at,
    resting,
    standing_on,
)
from imuarray.simulate.motion.stimulus import BoxStimulus

BLOCK = 16384
"""Rows per block; a multiple of the log's chunks."""

_KEPT_PIECES = 4
"""Minimum number of blocks kept in memory."""

_MANY = 256
"""Number of times below which the pieces that contain them are searched instead of computed by a division."""

_GAP = 8.0
"""Ratio of an interval to the shorter of its neighbours above which it is a gap. Slopes at its ends are not valid for
the time in between, and a cubic piece with these slopes would overshoot both rows.
"""

_KEPT_BYTES = 1 << 24
"""Size in bytes up to which more blocks are kept, because replicates of a log read them repeatedly. Two hours of a
temperature at 28 Hz take 6 MB, and a box at rest takes the same amount again.
"""


_MOST_TRACK_ROWS = 1 << 20
"""Maximum number of rows of a track that is read whole to reduce its noise. A longer one is followed as recorded."""


class _CubicPieces(NamedTuple):
    """Rows at times (k,) ns, the last row being the first of the next block, and the k - 1 cubic pieces between them,
    p0 + x (p1 + x (p2 + x p3)) for each column with 0 <= x <= 1. p0 of all pieces is `start` (c, k - 1). `moves` (k,)
    counts the pieces before a row that are not constant; the lengths `length_s` (m,) and `curve` (3, c, m), p1, p2, p3,
    are stored only for these m pieces. A single row has one piece, which is constant.
    """

    time_ns: Integers
    start: Reals
    moves: Integers
    length_s: Reals
    curve: Reals

    @property
    def bytes(self) -> int:
        arrays = (self.time_ns, self.moves, self.length_s, self.curve)
        return sum(array.nbytes for array in arrays) + (self.start.nbytes if self.start.strides[1] else 0)

    def row_before(self, time_ns: Integers) -> npt.NDArray[np.intp]:
        """Return the number of the piece that contains a time within the block."""
        rows = self._evenly(time_ns)
        if rows is None:
            rows = np.searchsorted(self.time_ns, time_ns, side="right") - 1
        return np.clip(rows, 0, self.start.shape[1] - 1)

    def _evenly(self, time_ns: Integers) -> npt.NDArray[np.intp] | None:
        """Return the same by division, if the rows are sufficiently even: five times as fast as a search."""
        last = len(self.time_ns) - 1
        if last < 1 or len(time_ns) < _MANY:
            return None
        step_ns = (self.time_ns[-1] - self.time_ns[0]) / last
        rows = ((time_ns - self.time_ns[0]) / step_ns).astype(np.intp)
        if rows.min() < 0 or rows.max() >= last:
            np.clip(rows, 0, last - 1, out=rows)
        rows += time_ns >= self.time_ns.take(rows + 1)
        if rows.max() >= last:
            return None
        is_right = (self.time_ns.take(rows) <= time_ns) & (time_ns < self.time_ns.take(rows + 1))
        return rows if is_right.all() else None


@dataclass(frozen=True, eq=False)
class SplineColumns:
    """`columns` (n,) or (n, 3) at `time` (n,) ns, joined by cubic pieces. The slope at a row is computed from the rows
    before and after it (three-point formula; from one neighbour at the ends), so that values and slopes have no jumps.
    Across a gap the pieces are monotonic.

    Only a few blocks of rows are in memory at any time, up to `_KEPT_BYTES`. `where` is the place that the LogError
    names if rows are not finite or their times do not increase.
    """

    time: NamedColumn | Integers
    columns: tuple[NamedColumn | npt.NDArray[np.float64], ...]
    where: str

    def at(self, time_ns: Integers) -> tuple[Reals, Reals]:
        """Return (n, c) values, all columns side by side, and (n, c) their derivatives per s, in any order of times.

        Before the first row and after the last one, these rows are returned, with derivative 0. If nothing changes
        between the first and the last of the times, one row is broadcast (read-only).
        """
        within = np.clip(time_ns, self.first_ns, self.last_ns)
        constant = self._constant(within)
        if constant is not None:
            return constant, np.broadcast_to(np.zeros(constant.shape[1]), constant.shape)
        values, slopes = np.split(self._join_blocks(within, _values_and_slopes, 2), 2)
        return np.ascontiguousarray(values.T), np.ascontiguousarray(np.where(time_ns == within, slopes, 0.0).T)

    def values_at(self, time_ns: Integers) -> Reals:
        """Return the values (n, c) only."""
        within = np.clip(time_ns, self.first_ns, self.last_ns)
        constant = self._constant(within)
        return np.ascontiguousarray(self._join_blocks(within, _values, 1).T) if constant is None else constant

    def _constant(self, within: Integers) -> Reals | None:
        """Return one broadcast row (n, c) if all values from first to last of the times are equal; otherwise None."""
        if len(within) == 0:
            return None
        ends = np.array([within.min(), within.max()])
        first, last = self._numbers(ends).tolist()
        if last - first >= _KEPT_PIECES:  # these blocks would be read twice
            return None
        for number in range(first, last + 1):
            block = self._block(number)
            begin, end = block.row_before(ends).tolist()
            if block.moves[end + 1] > block.moves[begin]:
                return None
        value = block.start[:, end] + 0.0
        return np.broadcast_to(value, (len(within), len(value)))

    def _join_blocks(
        self, within: Integers, worked_out: Callable[[_CubicPieces, Integers], Reals], of_each: int
    ) -> Reals:
        """Return (c * of_each, n): the results of `worked_out`, called for each block with the times within it."""
        if (within[1:] >= within[:-1]).all():
            return self._evaluate_ascending(within, worked_out, of_each)
        order = np.argsort(within, kind="stable")
        result = np.empty((of_each * sum(self._widths), len(within)))
        result[:, order] = self._evaluate_ascending(within[order], worked_out, of_each)
        return result

    def _evaluate_ascending(
        self, within: Integers, worked_out: Callable[[_CubicPieces, Integers], Reals], of_each: int
    ) -> Reals:
        """Return the same for ascending times."""
        first, last = self._numbers(within[[0, -1]]).tolist() if len(within) else (0, 0)
        if first == last:
            return worked_out(self._block(first), within)
        edges = [0, *np.searchsorted(within, self._starts_ns[first + 1 : last + 1]).tolist(), len(within)]
        result = np.empty((of_each * sum(self._widths), len(within)))
        for number, (begin, end) in enumerate(pairwise(edges), start=first):
            if end > begin:
                result[:, begin:end] = worked_out(self._block(number), within[begin:end])
        return result

    def _numbers(self, within: Integers) -> npt.NDArray[np.intp]:
        return np.searchsorted(self._starts_ns, within, side="right") - 1

    @cached_property
    def first_ns(self) -> int:
        """The time of the first row."""
        return int(self.time[0])

    @cached_property
    def last_ns(self) -> int:
        """The time of the last row."""
        return int(self.time[-1])

    @property
    def _widths(self) -> tuple[int, ...]:
        return tuple(1 if column.ndim == 1 else int(column.shape[1]) for column in self.columns)

    @cached_property
    def _starts_ns(self) -> Integers:
        """The time (blocks,) of the first row of each block."""
        rows = range(0, max(len(self.time) - 1, 1), BLOCK)
        return np.array([self.time[row] for row in rows], np.int64)

    @cached_property
    def _blocks(self) -> dict[int, _CubicPieces]:
        """The blocks in memory, the most recently used last."""
        return {}

    def _block(self, number: int) -> _CubicPieces:
        blocks = self._blocks
        block = blocks.pop(number, None)
        if block is not None:
            blocks[number] = block
            return block
        blocks[number] = block = self._read(number)
        while len(blocks) > _KEPT_PIECES and sum(block.bytes for block in blocks.values()) > _KEPT_BYTES:
            del blocks[next(iter(blocks))]
        return block

    def _read(self, number: int) -> _CubicPieces:
        """Return one block; slopes are computed with an additional row on either side."""
        start = number * BLOCK
        rows_before = min(start, 1)
        rows = slice(start - rows_before, start + BLOCK + 2)
        time_ns, values = self._rows(rows)
        if not np.isfinite(values).all() or (np.diff(time_ns) <= 0).any():
            raise LogError(
                f"{self.where}: rows {start} to {start + len(time_ns)}: finite numbers are required, in order"
            )
        own = slice(rows_before, rows_before + BLOCK + 1)
        slopes = _slopes(time_ns, values)
        pieces = slice(rows_before, rows_before + len(time_ns[own]) - 1)
        return _cubic_pieces(time_ns[own], values[own], slopes[own], _gaps(time_ns)[pieces])

    def _rows(self, rows: slice) -> tuple[Integers, Reals]:
        try:
            columns = [np.asarray(column[rows], float) for column in self.columns]
            return np.asarray(self.time[rows], np.int64), np.concatenate(
                [column.reshape(len(column), -1) for column in columns], axis=1
            )
        except (OSError, TypeError, ValueError) as error:
            raise LogError(f"{self.where}: {' '.join(str(error).split())}") from None


def _slopes(time_ns: Integers, rows: Reals) -> Reals:
    """Return slopes (k, c) per s by the three-point formula; exactly 0 between equal rows, for which the formula gives
    rounding errors.
    """
    if len(rows) == 1:
        return np.zeros_like(rows)
    is_still = np.pad(np.diff(rows, axis=0) == 0, ((1, 1), (0, 0)), constant_values=True)
    if is_still.all():
        return np.zeros_like(rows)
    slopes = np.gradient(rows, (time_ns - time_ns[0]) * 1e-9, axis=0)
    return np.where(is_still[:-1] & is_still[1:], 0.0, slopes)


def _gaps(time_ns: Integers) -> Booleans:
    """Return a mask (k - 1,) of the intervals that are gaps."""
    lengths = np.diff(time_ns)
    if len(lengths) < 2:
        return np.zeros(len(lengths), bool)
    neighbours = np.pad(lengths.astype(float), 1, constant_values=math.inf)
    return np.asarray(lengths > _GAP * np.minimum(neighbours[:-2], neighbours[2:]))


def _cubic_pieces(time_ns: Integers, rows: Reals, slopes: Reals, is_gap: Booleans) -> _CubicPieces:
    """Return the cubic pieces (Hermite) between rows (k, c) with these slopes per s.

    In gaps (k - 1,) they are monotonic: no slope exceeds three times the mean slope or has the opposite sign (Fritsch
    and Carlson, SIAM J. Numer. Anal. 17, 1980).
    """
    if len(rows) == 1:
        return _CubicPieces(time_ns, rows.T.copy(), np.zeros(2, np.int64), np.zeros(0), np.zeros((3, rows.shape[1], 0)))
    length_s = np.diff(time_ns) * 1e-9
    start, rise = rows[:-1].T, rows[1:].T - rows[:-1].T
    begin, end = slopes[:-1].T * length_s, slopes[1:].T * length_s
    if is_gap.any():
        low, high = np.minimum(0.0, 3 * rise[:, is_gap]), np.maximum(0.0, 3 * rise[:, is_gap])
        begin[:, is_gap], end[:, is_gap] = (np.clip(slope[:, is_gap], low, high) for slope in (begin, end))
    moving = ((rise != 0) | (begin != 0) | (end != 0)).any(axis=0)
    moves = np.concatenate([[0], np.cumsum(moving)])
    if not moving.any():
        still = np.broadcast_to(start[:, :1].copy(), start.shape)
        return _CubicPieces(time_ns, still, moves, np.zeros(0), np.zeros((3, len(start), 0)))
    rise, begin, end = rise[:, moving], begin[:, moving], end[:, moving]
    curve = np.stack([begin, 3 * rise - 2 * begin - end, begin + end - 2 * rise])
    return _CubicPieces(time_ns, np.ascontiguousarray(start), moves, length_s[moving], curve)


def _values(block: _CubicPieces, time_ns: Integers) -> Reals:
    """Return values (c, n) at times within the block."""
    row = block.row_before(time_ns)
    start: Reals = block.start.take(row, axis=1)
    moving = _moving(block, row)
    if len(moving) == len(row) and len(row):
        x, _, (begin, square, cube) = _pieces(block, time_ns, row)
        start += x * (begin + x * (square + x * cube))
    elif len(moving):
        x, _, (begin, square, cube) = _pieces(block, time_ns[moving], row[moving])
        start[:, moving] += x * (begin + x * (square + x * cube))
    return start


def _values_and_slopes(block: _CubicPieces, time_ns: Integers) -> Reals:
    """Return (2 c, n): the values, and below them their derivatives per s."""
    row = block.row_before(time_ns)
    moving = _moving(block, row)
    columns = len(block.start)
    result = np.zeros((2 * columns, len(row)))
    block.start.take(row, axis=1, out=result[:columns], mode="clip")
    if len(moving):
        x, length_s, (begin, square, cube) = _pieces(block, time_ns[moving], row[moving])
        result[:columns, moving] += x * (begin + x * (square + x * cube))
        result[columns:, moving] = (begin + x * (2 * square + x * (3 * cube))) / length_s
    return result


def _moving(block: _CubicPieces, row: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    return np.flatnonzero(block.moves.take(row + 1) > block.moves.take(row))


def _pieces(block: _CubicPieces, time_ns: Integers, row: npt.NDArray[np.intp]) -> tuple[Reals, Reals, Reals]:
    """Return, for times in pieces that are not constant: (n,) their position in the piece, 0 to 1; (n,) the length of
    the piece in s; (3, c, n) p1, p2, p3.
    """
    piece = block.moves.take(row)
    length_s = block.length_s.take(piece)
    return ((time_ns - block.time_ns.take(row)) * 1e-9) / length_s, length_s, block.curve.take(piece, axis=2)


CHIP_S, SHORT_CHIP_S, CHIP_SHARE = 10.0, 2.0, 1 / 15
"""Time in s over which the readings of a chip's own thermometer are averaged: at most `CHIP_S`, for a shorter log the
share `CHIP_SHARE` of its length, but at least `SHORT_CHIP_S`. Averaging is necessary because steps and noise of the
thermometer are not changes of the temperature; it is short because a heating may last for only a part of the log.
"""

FINEST_CHIP_S = 0.5
"""Shortest averaging time in s if the temperature changes by more than steps and noise."""

_FEW_READINGS, _SIGNIFICANT = 5, 3.0
"""Minimum number of readings from which the noise of a thermometer is estimated, and the scatter, as a multiple of this
noise, above which the temperature is considered to change. Otherwise a straight line is used, because the noise of a
thermometer is not a change of the temperature.
"""

_MEDIAN_OF_SECOND_DIFFERENCES = 0.6745 * math.sqrt(6)
"""Median absolute second difference of independent normal readings, in standard deviations."""

TemperatureSource = Literal["truth", "reference", "barometer", "chip", "nothing"]

_FEW = 256
"""Largest number of instants whose stimulus is cached: the same few, all over a phase, are requested repeatedly."""
_KEPT = 512

_LAST = 8
"""Number of stretches whose values are cached: trials of a model request the same ones in turn."""


@dataclass(frozen=True, eq=False)
class LikeLog:
    """The motion of the box of `log`, at the log's own times.

    Force and rate are interpolated by splines (`SplineColumns`) from `/truth`, otherwise from `/reference` if it has
    both. The angular acceleration is the derivative of that rate and does not contain motion between two rows. Without
    these groups the box is assumed to stand still with the face up that a phase names, until the next phase that names
    one (before the first of them, with that of the first; +Z if no phase names one). Turns, shaking and tilts are then
    missing.

    The temperature is the first available of: that of the same rows; that of a barometer of the log, including noise
    and offset; that of a chip's own thermometer with a known zero, averaged over at most `CHIP_S`; 25 degC. It is
    corrected for the lag `lead_s` of the thermometer. The field is that of `fields`, if any are given, otherwise the
    earth's on that face, also while the box moves; the pressure is that of height 0. In `rests`, stretches from and to
    a time in ns, force and rate are the means of the track. Between them the noise of a reference is reduced
    (`without_track_noise`) unless the reference is very long, because noise is not motion. The log stays open. LogError
    for a phase whose `up` is not a box axis, or for invalid rows.
    """

    log: Log
    fields: tuple[PhaseField, ...] = ()
    rests: tuple[tuple[int, int], ...] = ()
    lead_s: float = 0.0

    def __post_init__(self) -> None:
        for phase in self.log.phases:
            if phase.up and phase.up not in UP_AXES:
                choices = ", ".join(UP_AXES)
                raise LogError(f"{self.log.path}: phase {phase.name!r}: up {phase.up!r}; allowed are {choices}")

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phases of the log."""
        return tuple(sorted(self.log.phases))

    @cached_property
    def seconds(self) -> float:
        """The end of the log's last phase or of its last reading, whichever is later."""
        times = [int(sensor.time[-1]) for sensor in self.log.sensors.values() if len(sensor)]
        return max([0, *times, *(phase.end_ns for phase in self.log.phases)]) * 1e-9

    @cached_property
    def source(self) -> str:
        """The source of force and rate: "truth", "reference" or "phases"."""
        return self._track[0]

    @property
    def temperature_source(self) -> TemperatureSource:
        """The source of the temperature; "nothing" means that 25 degC is assumed."""
        return self._warming[0]

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimulus by the log's rows or phases; read-only for few instants."""
        if len(time_ns) > _FEW:
            return self._stimulus_before(time_ns)
        return self._remember(np.asarray(time_ns, np.int64).tobytes())

    def _stimulus_before(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimulus at many instants; the latest stretches are cached."""
        kept, key = self._stretches, (len(time_ns), int(time_ns[0]), int(time_ns[-1]))
        remembered = kept.pop(key, None)
        if remembered is None or not np.array_equal(remembered.time_ns, time_ns):
            remembered = self._stimulus(time_ns)
        kept[key] = remembered
        if len(kept) > _LAST:
            del kept[next(iter(kept))]
        return remembered

    @cached_property
    def _stretches(self) -> dict[tuple[int, int, int], BoxStimulus]:
        """A cache of stretches, by number, first and last of their instants; the most recently used are last."""
        return {}

    def __reduce__(self) -> tuple[type[LikeLog], tuple[object, ...]]:
        """Return the fields to pickle: the log, which reopens itself, without the data that were read from it."""
        return LikeLog, (self.log, self.fields, self.rests, self.lead_s)

    @cached_property
    def _remember(self) -> Callable[[bytes], BoxStimulus]:
        return lru_cache(maxsize=_KEPT)(lambda times: self._stimulus(np.frombuffer(times, np.int64)))

    def _stimulus(self, time_ns: Integers) -> BoxStimulus:
        stimulus = self._stimulus_at_rest(time_ns)
        if self.fields:
            stimulus = replace(stimulus, field_box=field_at(self.fields, time_ns))
        if self._moving is None:
            return stimulus
        values, slopes = self._moving.at(time_ns)
        if self._means:
            values, slopes = values.copy(), slopes.copy()
        for start_ns, end_ns, mean in self._means:
            is_at_rest = (start_ns <= time_ns) & (time_ns < end_ns)
            values[is_at_rest], slopes[is_at_rest] = mean, 0.0
        return replace(
            stimulus, force_box=values[:, :3], rate_box=values[:, 3:], angular_acceleration_box=slopes[:, 3:]
        )

    def temperature_at(self, time_ns: Integers) -> Reals:
        """Return the temperature (n,) at times (n,); read-only if it is constant."""
        warming = self._warming[1]
        if warming is None:
            return np.broadcast_to(np.array(ROOM_DEGC), (len(time_ns),))
        if not self.lead_s:
            return warming.values_at(time_ns)[:, 0]
        values, slopes = warming.at(time_ns)
        return np.asarray(values[:, 0] + self.lead_s * slopes[:, 0])

    def _stimulus_at_rest(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimulus of the box at rest, at the temperature of that time."""
        degc = self.temperature_at(time_ns)
        ends = np.array([time_ns.min(), time_ns.max()]) if len(time_ns) else np.zeros(1, np.int64)
        first, last = self._face_at(ends)[[0, -1]].tolist()
        if first == last:
            return resting(time_ns, self._attitudes[first], degc)
        face = self._face_at(time_ns)
        turned = replace(resting(time_ns, np.eye(3), degc), field_box=(FIELD_LEVEL @ self._attitudes)[face])
        return turned if self._moving is not None else replace(turned, force_box=self._gravity[face])

    def _face_at(self, time_ns: Integers) -> npt.NDArray[np.intp]:
        """Return (n,) the number of the face on which the box stands."""
        return np.clip(np.searchsorted(self._starts_ns, time_ns, side="right") - 1, 0, None)

    @cached_property
    def _faces(self) -> tuple[Phase, ...]:
        return tuple(phase for phase in self.phases if phase.up) or (Phase(0, 0, "static", "+Z"),)

    @cached_property
    def _starts_ns(self) -> Integers:
        return np.array([phase.start_ns for phase in self._faces])

    @cached_property
    def _attitudes(self) -> Reals:
        return np.array([standing_on(phase.up) for phase in self._faces])

    @cached_property
    def _gravity(self) -> Reals:
        """The force (k, 3) on the named faces."""
        return np.asarray(GRAVITY_LEVEL @ self._attitudes)

    @cached_property
    def _track(self) -> tuple[str, Track | None]:
        for name, track in (("truth", self.log.truth), ("reference", self.log.reference)):
            complete = track is not None and track.specific_force is not None and track.angular_rate is not None
            if track is not None and complete and len(track.time):
                return name, track
        return "phases", None

    @cached_property
    def _moving(self) -> SplineColumns | None:
        name, track = self._track
        if track is None or track.specific_force is None or track.angular_rate is None:
            return None
        where = f"{self.log.path}, {name}"
        if name == "truth" or not self.rests or len(track.time) > _MOST_TRACK_ROWS:
            return SplineColumns(track.time, (track.specific_force, track.angular_rate), where)
        from imuarray.simulate.motion.track_noise import without_track_noise  # imported late: SciPy takes long to load

        time_ns = track.time[:]
        rows = np.hstack([track.specific_force[:], track.angular_rate[:]])
        columns = np.asarray(without_track_noise(time_ns, rows, sorted(self.rests)), np.float64)
        return SplineColumns(time_ns, (columns[:, :3], columns[:, 3:]), where)

    @cached_property
    def _means(self) -> tuple[tuple[int, int, Reals], ...]:
        """Return the phases at rest, each with the mean force and rate (6,) of the track's rows in it; phases without
        rows are omitted.
        """
        _, track = self._track
        if not self.rests or track is None or track.specific_force is None or track.angular_rate is None:
            return ()
        time_ns = track.time[:]
        means = []
        for start_ns, end_ns in self.rests:
            first, stop = np.searchsorted(time_ns, [start_ns, end_ns]).tolist()
            if stop > first:
                rows = np.hstack([track.specific_force[first:stop], track.angular_rate[first:stop]])
                means.append((start_ns, end_ns, np.asarray(rows.mean(axis=0))))
        return tuple(means)

    @cached_property
    def _warming(self) -> tuple[TemperatureSource, SplineColumns | None]:
        """Return the source of the temperature, and the temperature itself."""
        tracks: tuple[tuple[TemperatureSource, Track | None], ...]
        tracks = ("truth", self.log.truth), ("reference", self.log.reference)
        for name, track in tracks:
            if track is not None and track.temperature is not None and len(track.time):
                return name, SplineColumns(track.time, (track.temperature,), f"{self.log.path}, {name}")
        for sensor in self.log.of("pressure"):
            with suppress(LogError):  # a barometer that was imported without temperatures
                if len(sensor):
                    return "barometer", SplineColumns(sensor.time, (sensor.compensated("temperature"),), sensor.where)
        chip = chip_thermometer(self.log, FINEST_CHIP_S)
        if chip is None:
            return "nothing", None
        time_s, degc = _average(chip, min(CHIP_S, max(SHORT_CHIP_S, CHIP_SHARE * self.seconds)))
        if not _changes(degc):
            line = np.polynomial.Polynomial.fit(time_s, degc, 1)
            time_s = time_s[[0, -1]]
            degc = line(time_s)
        time_ns = np.rint(time_s * 1e9).astype(np.int64)
        return "chip", SplineColumns(time_ns, (degc,), f"{self.log.path}, temperature_counts")


def _average(chip: TemperatureSeries, longest_s: float) -> tuple[Floats, Floats]:
    """Return means (k,) of the times and readings of a thermometer over `longest_s`. Intervals are halved as long as
    the means of the halves differ by more than a step of the thermometer and by more than its noise.
    """
    degc = chip.degc
    noise = float(np.median(np.abs(np.diff(degc, n=2)))) / _MEDIAN_OF_SECOND_DIFFERENCES if len(degc) > 2 else 0.0
    edges = np.searchsorted(chip.time_s, np.arange(chip.time_s[0], chip.time_s[-1], longest_s)).tolist() or [0]
    windows = [(first, stop) for first, stop in pairwise([*edges, len(degc)]) if stop > first]
    means = []
    while windows:
        first, stop = windows.pop()
        middle = (first + stop) // 2
        if middle > first:
            change = abs(float(degc[first:middle].mean() - degc[middle:stop].mean()))
            if change > max(
                chip.step_degc, _SIGNIFICANT * noise * math.sqrt(1 / (middle - first) + 1 / (stop - middle))
            ):
                windows += [(first, middle), (middle, stop)]
                continue
        means.append((chip.time_s[first:stop].mean(), degc[first:stop].mean()))
    time_s, averages = np.array(sorted(means)).T
    return time_s, averages


def _changes(degc: Reals) -> bool:
    """Return True if averaged readings (k,) of a thermometer change by more than noise, or are too few to decide."""
    if len(degc) < _FEW_READINGS:
        return True
    noise = math.sqrt(float(np.mean(np.diff(degc, n=2) ** 2)) / 6)  # expected for independent readings
    return float(np.std(degc)) > _SIGNIFICANT * noise
