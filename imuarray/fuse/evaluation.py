"""Errors of a fused result against what the box really felt, where a log knows: emulated and simulated logs, or a
reference.

Whether errors are as large as their covariances say: the normalised error squared against its chi-square interval.

``e' P^-1 e / 3`` has mean 1 if P is right (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 5.4). Its mean over n frames would be chi-square of 3 n degrees of freedom over 3 n if the
errors forgot from frame to frame. They don't: biases stay. The variance of the mean of normal errors with lagged
correlations C(k) (3, 3) is ``2 / n sum over k of (1 - |k| / n) |C(k)|^2``, |.| the Frobenius norm, so that the interval
is taken for the degrees of freedom of a chi-square with that variance. C(k) is about zero, not about the mean: a
constant error correlates with itself for ever, and a log of it counts little.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields
from io import SEEK_END
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Self

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats
from imuarray.errors import FusionError
from imuarray.fuse.alignment import between_gaps
from imuarray.fuse.frames import FusedBlock
from imuarray.log import Log, Track, first_at
from imuarray.log.format import Phase
from imuarray.units import INERTIAL

SEGMENT = 256
"""Frames of one segment of `quiet_noise`."""

_SLOW_MEANS = 16
"""Of whose spread drift is told."""

_AT_ONCE = 1 << 15
"""Errors that are read at once."""

_ROW_BYTES, _FRAME_BYTES = 24, 104
"""Of an error, and of a frame: time, error, truth and covariance."""

_MARGIN = 32
"""Rows of truth on either side of a block, so that the spline does not depend on where blocks end."""


@dataclass(frozen=True)
class Error:
    """Error of one quantity over a stretch, per box axis (3,) in SI: its mean, its scatter from frame to frame, its
    rms, its drift (spread of sixteen slow means), and how many frames.
    """

    mean: Floats
    noise: Floats
    rms: Floats
    drift: Floats
    frames: int


def evaluate(log: Log, blocks: Iterable[FusedBlock], phases: Iterable[Phase] = ()) -> dict[str, Error]:
    """Errors of a fused result against `/truth` (or `/reference`) by quantity; only inside `phases` if there are any.

    FusionError if the log has neither.

    >>> from imuarray import load_calibration, open_log
    >>> from imuarray.fuse import fuse
    >>> with open_log("run.h5") as log:
    ...     errors = evaluate(log, fuse(log, load_calibration("cal.toml"), "mean"))
    >>> errors["specific_force"].rms.shape  # along x, y and z of the box
    (3,)
    """
    with Evaluation(log, phases) as evaluation:
        for block in blocks:
            evaluation.add({"": block})
        return evaluation.errors().get("", {})


class Evaluation:
    """Errors of several results against `/truth` (or `/reference`), block by block as they are made: what is kept of
    them lies on the disk. A context manager.
    """

    def __init__(self, log: Log, phases: Iterable[Phase] = ()) -> None:
        """Evaluate frames only inside `phases`, if there are any. FusionError if the log has neither."""
        self._track = _track_of(log)
        self._stretches = [(phase.start_ns, phase.end_ns) for phase in phases]
        self._stack = ExitStack()
        self._kept: dict[str, dict[str, _ErrorSpool]] = {}

    def add(self, together: Mapping[str, FusedBlock]) -> None:
        """The next block of each result by its name, all of the same frames."""
        for name, quantity, frames in _errors_in(self._track, self._stretches, together):
            kept = self._kept.setdefault(name, {})
            if quantity not in kept:
                kept[quantity] = self._stack.enter_context(_ErrorSpool())
            kept[quantity].add(frames.errors)

    def errors(self) -> dict[str, dict[str, Error]]:
        """Return the errors by name and quantity, for those with at least two frames."""
        return {
            name: {quantity: kept[quantity].figures() for quantity in INERTIAL if _frames(kept, quantity) > 1}
            for name, kept in self._kept.items()
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()


def quiet_noise(blocks: Iterable[FusedBlock]) -> dict[str, Floats]:
    """Scatter (3,) in SI from frame to frame where a fused result is quietest, by quantity: it needs no truth."""
    noise = QuietNoise()
    for block in blocks:
        noise.add(block)
    return noise.scatter()


class QuietNoise:
    """The scatter of `quiet_noise`, block by block.

    The lower quartile over segments of `SEGMENT` frames of the standard deviation of differences over sqrt 2; a motion
    that lasts does not count, a box that never rests makes it too large.
    """

    def __init__(self) -> None:
        self._scatters: dict[str, list[Floats]] = {quantity: [] for quantity in INERTIAL}
        self._rest: dict[str, Floats] = {quantity: np.zeros((0, 3)) for quantity in INERTIAL}

    def add(self, block: FusedBlock) -> None:
        """The next frames."""
        for quantity, triad in block.triads.items():
            frames = np.concatenate([self._rest[quantity], triad])
            whole = len(frames) // SEGMENT * SEGMENT
            self._rest[quantity] = frames[whole:]
            self._scatters[quantity].append(_scatters(frames[:whole].reshape(-1, SEGMENT, 3)))

    def scatter(self) -> dict[str, Floats]:
        """Return the standard deviation of all frames so far, (3,) by quantity."""
        result = {}
        for quantity, parts in self._scatters.items():
            every = np.concatenate([*parts, _scatters(self._rest[quantity][None])])
            if len(every):
                result[quantity] = np.quantile(every, 0.25, axis=0)
        return result


def _scatters(segments: Floats) -> Floats:
    """(s, 3) the scatter from frame to frame of those of the segments (s, n, 3) that have no hole."""
    steps = np.diff(segments, axis=1)
    whole = steps[np.isfinite(steps).all(axis=(1, 2))]
    return np.asarray(np.std(whole, axis=1) / np.sqrt(2) if steps.shape[1] > 1 else np.zeros((0, 3)))


@dataclass(frozen=True)
class ErrorFrames:
    """n frames of one quantity: time (n,) ns, fused less true triad (n, 3), the truth (n, 3), and the covariance
    (n, 6) that the fused result claims (`frames.ENTRIES`; NaN where it claims none), SI, box frame.
    """

    time: npt.NDArray[np.int64]
    errors: Floats
    truth: Floats
    covariances: Floats


def errors_of(
    log: Log, blocks: Iterable[FusedBlock], phases: Iterable[Phase] = ()
) -> dict[str, tuple[npt.NDArray[np.int64], Floats]]:
    """Time (n,) and fused less true triad (n, 3) by quantity, where both are known. FusionError if nothing is known."""
    result = error_frames(log, blocks, phases)
    return {quantity: (frames.time, frames.errors) for quantity, frames in result.items()}


def error_frames(log: Log, blocks: Iterable[FusedBlock], phases: Iterable[Phase] = ()) -> dict[str, ErrorFrames]:
    """The same with the truth and the covariances."""
    track, stretches = _track_of(log), [(phase.start_ns, phase.end_ns) for phase in phases]
    result: dict[str, list[ErrorFrames]] = {quantity: [] for quantity in INERTIAL}
    for block in blocks:
        for _, quantity, frames in _errors_in(track, stretches, {"": block}):
            result[quantity].append(frames)
    return {quantity: _joined(parts) for quantity, parts in result.items() if parts}


class ErrorFramesOnDisk:
    """Frames with an error of several results, block by block as they are made, on the disk until they are asked for:
    memory holds those of one result at a time. A context manager.
    """

    def __init__(self, log: Log, folder: Path | None = None) -> None:
        """Keep the frames' errors on disk; with a `folder`, in files there that stay. FusionError if the log knows no
        truth.
        """
        self._track, self._folder = _track_of(log), folder
        self._stack = ExitStack()
        self._kept: dict[str, dict[str, _ErrorFramesSpool]] = {}

    def add(self, together: Mapping[str, FusedBlock]) -> None:
        """The next block of each result by its name, all of the same frames."""
        for name, quantity, frames in _errors_in(self._track, (), together):
            kept = self._kept.setdefault(name, {})
            if quantity not in kept:
                path = None if self._folder is None else self._folder / f"{name}.{quantity}"
                kept[quantity] = self._stack.enter_context(_ErrorFramesSpool(path))
            kept[quantity].add(frames)

    def files(self, name: str) -> dict[str, Path]:
        """Complete the files of one result in the folder; return them by quantity."""
        return {quantity: kept.complete() for quantity, kept in self._kept.get(name, {}).items()}

    def take(self, name: str, files: Mapping[str, Path]) -> None:
        """Take the frames of one result from such files, which may be of another process and must stay until they are
        asked for.
        """
        kept = self._kept.setdefault(name, {})
        for quantity, path in files.items():
            kept[quantity] = self._stack.enter_context(_ErrorFramesSpool(path, "rb"))

    def __contains__(self, name: str) -> bool:
        return name in self._kept

    def of(self, name: str) -> dict[str, ErrorFrames]:
        """Return the frames of one result by quantity."""
        return {quantity: kept.frames() for quantity, kept in self._kept.get(name, {}).items()}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()


def _track_of(log: Log) -> Track:
    """Return the log's track of the motion; FusionError if it has none."""
    track = log.truth or log.reference
    if track is None:
        raise FusionError(f"{log.path}: has neither /truth nor /reference to compare with")
    return track


def _frames(kept: Mapping[str, _ErrorSpool], quantity: str) -> int:
    return kept[quantity].frames if quantity in kept else 0


def _errors_in(
    track: Track, stretches: Sequence[tuple[int, int]], together: Mapping[str, FusedBlock]
) -> Iterator[tuple[str, str, ErrorFrames]]:
    """Technique, quantity and frames with an error of one block of each technique; only inside the `stretches` (start
    and end in ns), if there are any.
    """
    time = next(iter(together.values())).time
    inside = np.ones(len(time), bool)
    if stretches:
        inside = np.any([(time >= start) & (time < end) for start, end in stretches], axis=0)
    for quantity in INERTIAL:
        if not any(quantity in block.triads for block in together.values()):
            continue
        felt = _felt(track, quantity, time)
        if felt is None:
            continue
        for name, block in together.items():
            errors = block.triads[quantity] - felt
            keep = inside & np.isfinite(errors).all(axis=1)
            claimed = np.asarray(block.covariances.get(quantity, np.full((len(errors), 6), np.nan)), float)
            yield name, quantity, ErrorFrames(time[keep], errors[keep], felt[keep], claimed[keep])


def error_of(rows: Floats) -> Error:
    """The figures of errors (n, 3), n > 1.

    Noise is the scatter between neighbours (over sqrt 2), drift the spread of sixteen slow means.
    """
    slow = np.array([part.mean(axis=0) for part in np.array_split(rows, min(_SLOW_MEANS, len(rows)))])
    return Error(
        mean=rows.mean(axis=0),
        noise=np.std(np.diff(rows, axis=0), axis=0) / np.sqrt(2),
        rms=np.sqrt(np.mean(rows**2, axis=0)),
        drift=np.ptp(slow, axis=0),
        frames=len(rows),
    )


class _ErrorSpool:
    """Errors of one quantity on the disk until it is known how many there are: memory does not grow with the log. A
    context manager.
    """

    def __init__(self) -> None:
        self._file = TemporaryFile()  # noqa: SIM115, it lives as long as this
        self.frames = 0

    def add(self, errors: Floats) -> None:
        """Add more of them, (n, 3)."""
        self._file.write(np.ascontiguousarray(errors, np.float64).tobytes())
        self.frames += len(errors)

    def figures(self) -> Error:
        """Return `error_of` all errors; at least two frames."""
        slow = np.array([self._sum(begin, end) / (end - begin) for begin, end in pairwise(self._sixteenths())])
        steps = self.frames - 1
        change = (self._rows(steps, steps + 1)[0] - self._rows(0, 1)[0]) / steps
        squares = changes = np.zeros(3)
        for begin in range(0, self.frames, _AT_ONCE):
            rows = self._rows(begin, min(begin + _AT_ONCE + 1, self.frames))  # and the first of the next ones
            changes = changes + ((np.diff(rows, axis=0) - change) ** 2).sum(axis=0)
            squares = squares + (rows[:_AT_ONCE] ** 2).sum(axis=0)
        return Error(
            mean=self._sum(0, self.frames) / self.frames,
            noise=np.sqrt(changes / steps) / np.sqrt(2),
            rms=np.sqrt(squares / self.frames),
            drift=np.ptp(slow, axis=0),
            frames=self.frames,
        )

    def _sixteenths(self) -> list[int]:
        """Return the first rows of the parts of `numpy.array_split`, and the end of the last one."""
        parts = min(_SLOW_MEANS, self.frames)
        size, longer = divmod(self.frames, parts)
        return [part * size + min(part, longer) for part in range(parts + 1)]

    def _sum(self, begin: int, end: int) -> Floats:
        blocks = (self._rows(first, min(first + _AT_ONCE, end)) for first in range(begin, end, _AT_ONCE))
        return np.asarray(sum((rows.sum(axis=0) for rows in blocks), np.zeros(3)))

    def _rows(self, begin: int, end: int) -> Floats:
        self._file.seek(begin * _ROW_BYTES)
        return np.frombuffer(self._file.read((end - begin) * _ROW_BYTES)).reshape(-1, 3)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()


class _ErrorFramesSpool:
    """Frames of one quantity in a temporary file, or in one with a name. A context manager."""

    def __init__(self, path: Path | None = None, mode: str = "w+b") -> None:
        self._path = path
        self._file: IO[bytes] = TemporaryFile() if path is None else path.open(mode)  # noqa: SIM115, lives as long

    def add(self, frames: ErrorFrames) -> None:
        """Add more of them."""
        time = np.ascontiguousarray(frames.time, np.int64).view(np.float64)  # the same bits
        rows = np.concatenate([time[:, None], frames.errors, frames.truth, frames.covariances], axis=1)
        self._file.write(rows.tobytes())

    def complete(self) -> Path:
        """Put everything into the file that has a name, and return it; ValueError for one without."""
        if self._path is None:
            raise ValueError("a temporary file has no name")
        self._file.flush()
        return self._path

    def frames(self) -> ErrorFrames:
        """Return all of them."""
        count = self._file.seek(0, SEEK_END) // _FRAME_BYTES
        time, errors, truth, covariances = (np.empty((count, width)) for width in (1, 3, 3, 6))
        self._file.seek(0)
        for start in range(0, count, _AT_ONCE):  # so that it is not in memory twice
            part = slice(start, min(start + _AT_ONCE, count))
            rows = np.frombuffer(self._file.read((part.stop - start) * _FRAME_BYTES)).reshape(-1, 13)
            time[part], errors[part], truth[part], covariances[part] = np.split(rows, (1, 4, 7), axis=1)
        return ErrorFrames(time[:, 0].view(np.int64), errors, truth, covariances)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()


def _joined(parts: Sequence[ErrorFrames]) -> ErrorFrames:
    return ErrorFrames(*(np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(ErrorFrames)))


def _felt(track: Track, quantity: str, time: npt.NDArray[np.int64]) -> Floats | None:
    """The truth (n, 3) at `time`, by a cubic spline through its rows: between them a shaken box does not move in
    straight lines.
    """
    column = track.specific_force if quantity == "specific_force" else track.angular_rate
    if column is None:
        return None
    first = max(0, first_at(track.time, int(time[0])) - _MARGIN)
    last = first_at(track.time, int(time[-1])) + _MARGIN
    known, rows = np.asarray(track.time[first:last]), np.asarray(column[first:last], float)
    if len(known) < 2:
        return np.full((len(time), 3), np.nan)
    return between_gaps(known, rows, time, gap_ns=5 * float(np.median(np.diff(known))))


_FEWEST = 20


@dataclass(frozen=True)
class Consistency:
    """Mean normalised error squared over its expectation; the 95 % interval in which it lies if covariances are right;
    the degrees of freedom that the errors' correlation leaves.
    """

    normalised: float
    low: float
    high: float
    freedom: float

    @property
    def holds(self) -> bool:
        """Return whether it lies in its interval."""
        return self.low <= self.normalised <= self.high


def consistency(errors: Floats, covariances: Floats) -> Consistency | None:
    """Return the consistency of errors (n, 3) with covariances (n, 6) (`frames.ENTRIES`); None if fewer than twenty
    have one.
    """
    from scipy.special import gammaincinv  # the inverse chi-squared distribution without the weight of scipy.stats

    known = np.isfinite(covariances).all(axis=1) & np.isfinite(errors).all(axis=1)
    white, definite = _whitened(errors[known], covariances[known])
    if not definite.all():
        white = white[definite]
    if len(white) < _FEWEST:
        return None
    normalised = float(np.mean(white**2))
    freedom = _freedom(white)
    low, high = 2 * gammaincinv(freedom / 2, [0.025, 0.975]) / freedom
    return Consistency(normalised, float(low), float(high), freedom)


def _whitened(errors: Floats, covariances: Floats) -> tuple[Floats, Booleans]:
    """Errors (n, 3) times the inverse of the lower Cholesky factor of their covariances (n, 6), and which of these are
    positive definite (n,): written out, for all frames at a time, in a twentieth of the time of a routine for matrices.
    """
    xx, yy, zz, xy, xz, yz = covariances.T
    with np.errstate(invalid="ignore", divide="ignore"):
        first = np.sqrt(xx)
        second_first, third_first = xy / first, xz / first
        second = np.sqrt(yy - second_first**2)
        third_second = (yz - third_first * second_first) / second
        third = np.sqrt(zz - third_first**2 - third_second**2)
        x = errors[:, 0] / first
        y = (errors[:, 1] - second_first * x) / second
        z = (errors[:, 2] - third_first * x - third_second * y) / third
    definite: Booleans = np.asarray((first > 0) & (second > 0) & (third > 0))
    return np.stack([x, y, z], axis=1), definite


def _freedom(white: Floats) -> float:
    """18 over the variance of the mean of |x|^2, where x (n, 3) has unit variance: 3 n if nothing is remembered.

    Lags up to half the length are added up one by one, less what chance makes of them; beyond they are as large as
    from a quarter of the length to half of it.
    """
    from scipy.fft import next_fast_len

    rows, half = len(white), len(white) // 2
    size = next_fast_len(2 * rows, real=True)
    spectra = np.fft.rfft((white / np.sqrt(np.mean(white**2))).T, size)
    share = 1 - np.arange(1, half + 1) / rows
    squares = -9 / (rows * share)
    for item, other in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        lagged = np.fft.irfft(spectra[item].conj() * spectra[other], size) / rows
        squares += (lagged[1 : half + 1] / share) ** 2
        if item != other:  # the other way round
            squares += (lagged[: -half - 1 : -1] / share) ** 2
    remembered = share @ squares + rows / 8 * squares[half // 2 :].mean()
    return float(np.clip(18 / (2 / rows * (3 + 2 * max(remembered, 0.0))), 1.0, 3 * rows))
