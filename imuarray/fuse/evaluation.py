"""Errors of a fused result with respect to the truth of emulated and simulated logs or to a reference, and the gain of
a technique over the simple average of the same sensors, with its uncertainty.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Self

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Indices
from imuarray.calibrate import Calibration
from imuarray.errors import FusionError
from imuarray.fuse.alignment import between_gaps
from imuarray.fuse.error_consistency import whiten
from imuarray.fuse.frames import FusedBlock
from imuarray.fuse.fusion import AVERAGE, fuse
from imuarray.fuse.spools import AT_ONCE, RowSource, RowSpool, parts_of, row_blocks, square_sum
from imuarray.log import Log, Track, first_at
from imuarray.log.format import Phase
from imuarray.units import INERTIAL

SEGMENT = 256
"""Number of frames in a segment of `quiet_noise`."""

_SLOW_MEANS = 16
"""Number of means whose spread is the drift."""

_MARGIN = 32
"""Number of rows of truth on either side of a block, so that the spline does not depend on where blocks end."""


@dataclass(frozen=True)
class Error:
    """Error of one quantity over a stretch, per box axis (3,) in SI: its mean, its scatter from frame to frame, its
    rms, its drift (spread of sixteen slow means), and the number of frames.
    """

    mean: Floats
    noise: Floats
    rms: Floats
    drift: Floats
    frames: int


def evaluate(log: Log, blocks: Iterable[FusedBlock], phases: Iterable[Phase] = ()) -> dict[str, Error]:
    """Return the errors of a fused result with respect to `/truth` (or `/reference`) by quantity, inside `phases`
    (empty: everywhere).

    FusionError if the log has neither.

    >>> from imuarray import load_calibration, open_log
    >>> from imuarray.fuse import fuse
    >>> with open_log("run.h5") as log:
    ...     errors = evaluate(log, fuse(log, load_calibration("cal.toml"), "mean"))
    >>> errors["specific_force"].rms.shape  # along x, y and z of the box
    (3,)
    """
    with ErrorEvaluation(log, phases) as evaluation:
        for block in blocks:
            evaluation.add({"": block})
        return evaluation.errors().get("", {})


class ErrorEvaluation:
    """Errors of several results with respect to `/truth` (or `/reference`), block by block, stored on disk. A context
    manager.
    """

    def __init__(self, log: Log, phases: Iterable[Phase] = ()) -> None:
        """Evaluate frames in `phases` (empty: all frames). FusionError if the log has neither truth nor reference."""
        self._track = _track_of(log)
        self._stretches = [(phase.start_ns, phase.end_ns) for phase in phases]
        self._stack = ExitStack()
        self._spools: dict[str, dict[str, RowSpool]] = {}

    def add(self, together: Mapping[str, FusedBlock]) -> None:
        """Add the next block of each result, by name; all blocks have the same frames."""
        for name, quantity, frames in _errors_in(self._track, self._stretches, together):
            spools = self._spools.setdefault(name, {})
            if quantity not in spools:
                spools[quantity] = self._stack.enter_context(RowSpool(3))
            spools[quantity].append(frames.errors)

    def errors(self) -> dict[str, dict[str, Error]]:
        """Return the errors by name and quantity, for those with at least two frames."""
        return {
            name: {quantity: error_of(spools[quantity]) for quantity in INERTIAL if len(spools.get(quantity, ())) > 1}
            for name, spools in self._spools.items()
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()


def quiet_noise(blocks: Iterable[FusedBlock]) -> dict[str, Floats]:
    """Return the scatter (3,) in SI from frame to frame where a fused result is quietest, by quantity; it needs no
    truth.
    """
    noise = QuietNoise()
    for block in blocks:
        noise.add(block)
    return noise.scatter()


class QuietNoise:
    """The scatter of `quiet_noise`, computed block by block.

    It is the lower quartile, over segments of `SEGMENT` frames, of the standard deviation of differences over sqrt 2. A
    motion has no effect if the box rests at times; it is too large for a box that never rests. Frames without a
    quantity, for example every second frame if its sensors are half as fast as the frames, are skipped.
    """

    def __init__(self) -> None:
        self._scatters: dict[str, list[Floats]] = {quantity: [] for quantity in INERTIAL}
        self._rest: dict[str, Floats] = {quantity: np.zeros((0, 3)) for quantity in INERTIAL}

    def add(self, block: FusedBlock) -> None:
        """Add the next frames."""
        for quantity, triad in block.triads.items():
            finite = triad[np.isfinite(triad).all(axis=1)]
            frames = np.concatenate([self._rest[quantity], finite])
            whole = len(frames) // SEGMENT * SEGMENT
            self._rest[quantity] = frames[whole:]
            self._scatters[quantity].append(_scatters(frames[:whole].reshape(-1, SEGMENT, 3)))

    def scatter(self) -> dict[str, Floats]:
        """Return the standard deviation of all frames so far, (3,) by quantity."""
        result = {}
        for quantity, parts in self._scatters.items():
            scatters = np.concatenate([*parts, _scatters(self._rest[quantity][None])])
            if len(scatters):
                result[quantity] = np.quantile(scatters, 0.25, axis=0)
        return result


def _scatters(segments: Floats) -> Floats:
    """Return the scatter (s, 3) from frame to frame of segments (s, n, 3)."""
    steps = np.diff(segments, axis=1)
    return np.asarray(np.std(steps, axis=1) / np.sqrt(2) if steps.shape[1] > 1 else np.zeros((0, 3)))


@dataclass(frozen=True)
class MotionErrors:
    """n frames of one quantity in SI in the box frame: time (n,) ns, fused less true triad (n, 3), the truth (n, 3)."""

    time: npt.NDArray[np.int64]
    errors: Floats
    truth: Floats

    def __len__(self) -> int:
        return len(self.time)

    def times(self, frames: slice) -> npt.NDArray[np.int64]:
        """Return the times of some of them, in ns."""
        return self.time[frames]

    def __getitem__(self, frames: slice | Indices) -> MotionErrors:
        """Return some of the frames."""
        return MotionErrors(self.time[frames], self.errors[frames], self.truth[frames])


@dataclass(frozen=True)
class ErrorFrames(MotionErrors):
    """`MotionErrors` with the covariance (n, 6) that the fused result states (`frames.ENTRIES`; NaN if it states
    none).
    """

    covariances: Floats

    def __getitem__(self, frames: slice | Indices) -> ErrorFrames:
        """Return some of the frames."""
        return ErrorFrames(self.time[frames], self.errors[frames], self.truth[frames], self.covariances[frames])


def errors_of(
    log: Log, blocks: Iterable[FusedBlock], phases: Iterable[Phase] = ()
) -> dict[str, tuple[npt.NDArray[np.int64], Floats]]:
    """Return time (n,) and fused less true triad (n, 3) by quantity, where both are known. FusionError without a
    truth.
    """
    result = error_frames(log, blocks, phases)
    return {quantity: (frames.time, frames.errors) for quantity, frames in result.items()}


def error_frames(log: Log, blocks: Iterable[FusedBlock], phases: Iterable[Phase] = ()) -> dict[str, ErrorFrames]:
    """Return frames with errors, truth and covariances by quantity. FusionError without a truth."""
    return error_frames_together(log, ({"": block} for block in blocks), phases).get("", {})


def error_frames_together(
    log: Log, blocks: Iterable[Mapping[str, FusedBlock]], phases: Iterable[Phase] = ()
) -> dict[str, dict[str, ErrorFrames]]:
    """Return frames with errors, truth and covariances by the name of the result and by quantity, from blocks of all
    results with the same frames. FusionError without a truth.
    """
    track, stretches = _track_of(log), [(phase.start_ns, phase.end_ns) for phase in phases]
    result: dict[str, dict[str, list[ErrorFrames]]] = {}
    for together in blocks:
        for name, quantity, frames in _errors_in(track, stretches, together):
            result.setdefault(name, {quantity: [] for quantity in INERTIAL})[quantity].append(frames)
    return {
        name: {
            quantity: ErrorFrames(
                *(np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(ErrorFrames))
            )
            for quantity, parts in by_quantity.items()
            if parts
        }
        for name, by_quantity in result.items()
    }


class ErrorFramesOnDisk:
    """Frames with an error of several results, block by block, stored on disk. Results with the same frames share
    their times and their truth. A context manager.
    """

    def __init__(self, log: Log, folder: Path | None = None) -> None:
        """Store the frames in temporary files, or in permanent files in `folder`. FusionError without a truth."""
        self._track, self._folder = _track_of(log), folder
        self._stack = ExitStack()
        self._spools: dict[str, dict[str, ErrorFrameSpool]] = {}

    def add(self, together: Mapping[str, FusedBlock]) -> None:
        """Add the next block of each result, by name; all blocks have the same frames."""
        first: dict[str, tuple[ErrorFrameSpool, ErrorFrames]] = {}
        for name, quantity, frames in _errors_in(self._track, (), together):
            spools = self._spools.setdefault(name, {})
            if quantity not in spools:
                path = None if self._folder is None else self._folder / f"{name}.{quantity}"
                motion = first[quantity][0].motion if quantity in first and path is None else None
                spools[quantity] = self._stack.enter_context(ErrorFrameSpool(path, motion=motion))
            spools[quantity].add(frames, *first.get(quantity, ()))
            first.setdefault(quantity, (spools[quantity], frames))

    def files(self, name: str) -> dict[str, Path]:
        """Complete the files of one result in the folder; return them by quantity."""
        return {quantity: spool.complete() for quantity, spool in self._spools.get(name, {}).items()}

    def take(self, name: str, files: Mapping[str, Path]) -> None:
        """Take the frames of one result from files of `files`, maybe of another process; they must exist until read."""
        spools = self._spools.setdefault(name, {})
        for quantity, path in files.items():
            spools[quantity] = self._stack.enter_context(ErrorFrameSpool(path, "rb"))

    def __contains__(self, name: str) -> bool:
        return name in self._spools

    def of(self, name: str) -> dict[str, ErrorFrameSpool]:
        """Return the frames of one result by quantity."""
        return dict(self._spools.get(name, {}))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()


def _track_of(log: Log) -> Track:
    """Return the log's track of the motion; FusionError if it has none."""
    track = log.motion_track
    if track is None:
        raise FusionError(f"{log.path}: has neither /truth nor /reference of a motion to compare with")
    return track


def _errors_in(
    track: Track, stretches: Sequence[tuple[int, int]], together: Mapping[str, FusedBlock]
) -> Iterator[tuple[str, str, ErrorFrames]]:
    """Yield technique, quantity and the frames with an error, of one block of each technique, inside the `stretches`
    (start and end in ns; empty: everywhere).
    """
    time = next(iter(together.values())).time
    inside = np.ones(len(time), bool)
    if stretches:
        inside = np.any([(time >= start) & (time < end) for start, end in stretches], axis=0)
    quantities = [quantity for quantity in INERTIAL if any(quantity in block.triads for block in together.values())]
    for quantity, truth in _truth_at(track, quantities, time).items():
        for name, block in together.items():
            errors = block.triads[quantity] - truth
            finite = np.isfinite(errors)
            keep = slice(None) if inside.all() and finite.all() else inside & finite.all(axis=1)
            stated = np.asarray(block.covariances.get(quantity, np.full((len(errors), 6), np.nan)), float)
            yield name, quantity, ErrorFrames(time[keep], errors[keep], truth[keep], stated[keep])


def error_of(rows: RowSource) -> Error:
    """Return the figures of errors (n, 3), n > 1, which are read block by block, once.

    Noise is the scatter between neighbours (over sqrt 2), drift the spread of sixteen slow means.
    """
    frames = len(rows)
    ends = np.array([end for _, end in parts_of(frames, min(_SLOW_MEANS, frames))])
    steps = frames - 1
    change = ((rows[steps:frames][0] - rows[0:1][0]) / steps)[:, None]
    sums, squares, changes = np.zeros((len(ends), 3)), np.zeros(3), np.zeros(3)
    rows_done, previous = 0, np.zeros((3, 0))
    for block in row_blocks(rows):
        columns = np.ascontiguousarray(block.T)  # several times as fast
        cuts = [*(ends[(ends > rows_done) & (ends < rows_done + len(block))] - rows_done).tolist(), len(block)]
        first = int(np.searchsorted(ends, rows_done, "right"))
        for part, (start, end) in enumerate(pairwise([0, *cuts]), first):
            sums[part] += columns[:, start:end].sum(axis=1)
        squares += np.square(columns).sum(axis=1)
        changes += np.square(np.diff(columns, prepend=previous) - change).sum(axis=1)
        rows_done, previous = rows_done + len(block), columns[:, -1:]
    return Error(
        mean=sums.sum(axis=0) / frames,
        noise=np.sqrt(changes / steps) / np.sqrt(2),
        rms=np.sqrt(squares / frames),
        drift=np.ptp(sums / np.diff(ends, prepend=0)[:, None], axis=0),
        frames=frames,
    )


class MotionSpool:
    """Time (n,) in ns and true triad (n, 3) of frames in temporary files, or in files whose names begin with a path. A
    context manager.
    """

    def __init__(self, path: Path | None = None, mode: str = "w+b") -> None:
        self._time, self._truth = (
            RowSpool(k, _column_path(path, name), mode) for name, k in (("time", 1), ("truth", 3))
        )

    def append(self, time: npt.NDArray[np.int64], truth: Floats) -> None:
        """Add more frames."""
        self._time.append(np.ascontiguousarray(time, np.int64).view(np.float64)[:, None])  # the same bits
        self._truth.append(truth)

    def times(self, frames: slice) -> npt.NDArray[np.int64]:
        """Read the times of some frames, in ns."""
        return self._time[frames][:, 0].view(np.int64)

    def truth(self, frames: slice) -> Floats:
        """Read the truth of some frames."""
        return self._truth[frames]

    def copy(self, frames: int) -> MotionSpool:
        """Return a copy of the first frames in temporary files."""
        copy = MotionSpool()
        for start in range(0, frames, AT_ONCE):
            part = slice(start, min(start + AT_ONCE, frames))
            copy.append(self.times(part), self.truth(part))
        return copy

    def complete(self) -> None:
        """Write everything to the files that have names; ValueError for those without."""
        self._time.complete()
        self._truth.complete()

    def close(self) -> None:
        """Close the files."""
        self._time.close()
        self._truth.close()


class ErrorFrameSpool:
    """The errors (n, 3) of one quantity, and the errors `white` (k, 3) by their covariances (`whiten`), in temporary
    files, or in files whose names begin with a path; only requested frames are read. Several spools may share a
    `motion` if they have the same frames. A context manager.
    """

    def __init__(self, path: Path | None = None, mode: str = "w+b", *, motion: MotionSpool | None = None) -> None:
        self._path, self._is_own = path, motion is None
        self.motion = MotionSpool(path, mode) if motion is None else motion
        self.errors, self.white = (RowSpool(3, _column_path(path, name), mode) for name in ("errors", "white"))

    def add(
        self, frames: ErrorFrames, first: ErrorFrameSpool | None = None, its_frames: MotionErrors | None = None
    ) -> None:
        """Add more frames. `its_frames` were added to the `first` spool, with which this one may share its motion."""
        shares = first is not None and its_frames is not None and self.motion is first.motion
        if shares and its_frames is not None and not np.array_equal(its_frames.time, frames.time):
            self.motion, self._is_own, shares = self.motion.copy(len(self)), True, False
        if not shares:
            self.motion.append(frames.time, frames.truth)
        self.errors.append(frames.errors)
        self.white.append(whiten(frames.errors, frames.covariances))

    def __len__(self) -> int:
        return len(self.errors)

    def times(self, frames: slice) -> npt.NDArray[np.int64]:
        """Read the times of some of them, in ns."""
        return self.motion.times(self._within(frames))

    def __getitem__(self, frames: slice) -> MotionErrors:
        """Read some of the frames."""
        part = self._within(frames)
        return MotionErrors(self.motion.times(part), self.errors[part], self.motion.truth(part))

    def _within(self, frames: slice) -> slice:
        """Return the slice without open ends; the motion may have more frames."""
        begin, end, _ = frames.indices(len(self))
        return slice(begin, end)

    def complete(self) -> Path:
        """Write everything to the files that have names, and return how these begin; ValueError for those without."""
        if self._path is None:
            raise ValueError("temporary files have no names")
        self.motion.complete()
        for spool in (self.errors, self.white):
            spool.complete()
        return self._path

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        for spool in (self.errors, self.white):
            spool.close()
        if self._is_own:
            self.motion.close()


def _column_path(path: Path | None, name: str) -> Path | None:
    """Return the file of a column, whose name begins with a path; None without one."""
    return None if path is None else path.with_name(f"{path.name}.{name}")


def _truth_at(track: Track, quantities: Sequence[str], time: npt.NDArray[np.int64]) -> dict[str, Floats]:
    """Return the truth (n, 3) at `time` by quantity, for the quantities of the track, by a cubic spline through its
    rows: a straight line would not follow a shaken box between rows.
    """
    columns = {"specific_force": track.specific_force, "angular_rate": track.angular_rate}
    measured = {quantity: column for quantity in quantities if (column := columns[quantity]) is not None}
    first = max(0, first_at(track.time, int(time[0])) - _MARGIN)
    last = first_at(track.time, int(time[-1])) + _MARGIN
    times = np.asarray(track.time[first:last])
    if len(times) < 2:
        return {quantity: np.full((len(time), 3), np.nan) for quantity in measured}
    gap_ns = 5 * float(np.median(np.diff(times)))
    return {
        quantity: between_gaps(times, np.asarray(column[first:last], float), time, gap_ns)
        for quantity, column in measured.items()
    }


BLOCKS = 20
"""Number of stretches of a log that are omitted in turn for the uncertainty of a ratio (jackknife, Tukey 1958)."""

FEWEST_BLOCKS = 5


@dataclass(frozen=True)
class Gain:
    """Rms error in SI of the average and of a technique along one box axis ("XYZ": the length of the error vector), and
    their ratio with its standard error.
    """

    technique: str
    quantity: str
    box_axis: str
    average: float
    technique_error: float
    ratio: float
    ratio_se: float


def gains(
    log: Log,
    calibration: Calibration,
    technique: str,
    *,
    only: Collection[str] = (),
    phases: Sequence[Phase] = (),
    slow: bool = False,
) -> list[Gain]:
    """Return the gains of a technique per quantity and box axis, and for all three axes together. With `slow`, of
    ten-second means less the first of them, which show drift and hardly noise.

    FusionError if the log has neither truth nor reference.
    """
    names = (AVERAGE, technique)
    frames = {name: error_frames(log, fuse(log, calibration, name, only=only), phases) for name in names}
    return gains_in(frames, technique, slow=slow)


def gains_in(frames: Mapping[str, Mapping[str, ErrorFrames]], technique: str, *, slow: bool = False) -> list[Gain]:
    """Return the gains of a technique from the frames of the simple average and of the technique, as `gains`."""
    rows = []
    averages, estimates = frames[AVERAGE], frames[technique]
    for quantity in averages:
        average, estimate = averages[quantity], estimates[quantity]
        time, first, second = np.intersect1d(average.time, estimate.time, return_indices=True)
        average_errors, technique_errors = average.errors[first], estimate.errors[second]
        if slow:
            average_errors, technique_errors = (
                ten_second_means(time, part) for part in (average_errors, technique_errors)
            )
        for axis in range(3):
            rows.append(
                _gain(
                    technique,
                    quantity,
                    "XYZ"[axis],
                    average_errors[:, axis : axis + 1],
                    technique_errors[:, axis : axis + 1],
                )
            )
        lengths = (np.linalg.norm(part, axis=1, keepdims=True) for part in (average_errors, technique_errors))
        rows.append(_gain(technique, quantity, "XYZ", *lengths))
    return rows


def ten_second_means(time: npt.NDArray[np.int64], rows: Floats) -> Floats:
    """Return means over ten seconds, less the first, which a rest at the start would remove."""
    step = (time - time[0]) // 10_000_000_000
    _, first = np.unique(step, return_index=True)
    means = np.add.reduceat(rows, first) / np.diff(np.append(first, len(rows)))[:, None]
    return np.asarray(means - means[0])


def _gain(technique: str, quantity: str, box_axis: str, average_errors: Floats, technique_errors: Floats) -> Gain:
    count = min(BLOCKS, len(average_errors) // 2)
    if count < FEWEST_BLOCKS:
        raise FusionError(f"technique {technique}: {len(average_errors)} values with a truth, too few to compare")
    result = ratio_of(block_squares(average_errors, count)[:, 0], block_squares(technique_errors, count)[:, 0])
    average, error = (float(np.sqrt(np.mean(rows**2))) for rows in (average_errors, technique_errors))
    return Gain(technique, quantity, box_axis, average, error, result.ratio, result.ratio_se)


@dataclass(frozen=True)
class Ratio:
    """A ratio of rms errors, its jackknife standard error, and the ends of its 95 % interval."""

    ratio: float
    ratio_se: float
    low: float
    high: float


def ratio_of(average_squares: Floats, technique_squares: Floats) -> Ratio:
    """Return the root of the ratio of two sums of squared errors from their parts (b,), blocks of a log or runs; b > 1.

    Its standard error is that of the jackknife (Tukey 1958), with each part omitted in turn. The interval is Student's
    of the logarithm with b - 1 degrees of freedom, so that its ends are positive and invert with the ratio.
    """
    from scipy.special import stdtrit  # scipy.stats is slow to import

    count = len(average_squares)
    total = average_squares.sum(), technique_squares.sum()
    if not total[0] > 0 or not total[1] > 0:
        same = 1.0 if total[0] == total[1] else float("inf") if total[0] == 0 else 0.0
        return Ratio(same, 0.0, same, same)
    ratio = float(np.sqrt(total[1] / total[0]))
    omitted = np.sqrt(np.maximum(total[1] - technique_squares, 0) / np.maximum(total[0] - average_squares, 1e-300))
    standard_error = float(np.sqrt((count - 1) / count * np.sum((omitted - omitted.mean()) ** 2)))
    reach = float(np.exp(stdtrit(count - 1, 0.975) * standard_error / ratio))
    return Ratio(ratio, standard_error, ratio / reach, ratio * reach)


def block_squares(rows: RowSource, count: int = BLOCKS) -> Floats:
    """Return the sums of squares (count, k) of `count` consecutive stretches of rows (n, k)."""
    return np.array([square_sum(rows, start, end) for start, end in parts_of(len(rows), count)])
