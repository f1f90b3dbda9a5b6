"""Comparison of every technique on one log with known truth: errors, gains over the simple average, and covariances.

All techniques use the same sensors and the same calibration. Only frames that both the average and the technique
estimate are counted. The errors of a coasting navigator are compared as well (`imuarray.fuse.coasting_errors`). The
interval of a ratio covers chance within this log; the turn-on bias of a sensor is the same throughout it.

An estimator of the whole array takes longer than all simple techniques together. With an executor another process
computes its frames at the same time; the figures are the same as from one process.

Errors are consistent with their covariances if the normalised error squared is within its chi-square interval: ``e'
P^-1 e / 3`` has mean 1 if P is right (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 5.4). Its mean over n frames would be chi-square of 3 n degrees of freedom over 3 n if the
errors of different frames were independent. They are not: biases persist. The variance of the mean of normal errors
with lagged correlations C(k) (3, 3) is ``2 / n sum over k of (1 - |k| / n) |C(k)|^2``, |.| the Frobenius norm, so the
interval is that of a chi-square with this variance. C(k) is taken about zero, not about the mean, so that a constant
error is correlated at every lag and many frames of it count as few.
"""

from __future__ import annotations

import copyreg
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate import Calibration
from imuarray.errors import FusionError
from imuarray.fuse.coasting_errors import Coasting, Errors, coasting
from imuarray.fuse.evaluation import (
    BLOCKS,
    FEWEST_BLOCKS,
    Error,
    ErrorFrames,
    ErrorFramesOnDisk,
    ErrorFrameSpool,
    Ratio,
    block_squares,
    error_of,
    ratio_of,
)
from imuarray.fuse.fusion import AVERAGE, NAMES, Progress, fuse, fuse_together
from imuarray.fuse.spools import AT_ONCE, RowSource, RowSpool, row_blocks
from imuarray.fuse.techniques import TECHNIQUES
from imuarray.log import Log, open_log

_FEWEST = 20

_SEGMENT = 1 << 17
"""Number of rows of one spectrum of long errors."""

_AT_ONCE = 4
"""Number of such segments up to which one spectrum for all rows needs no more memory than those of the segments."""


@dataclass(frozen=True)
class Consistency:
    """Mean normalised error squared over its expectation; its 95 % interval under correct covariances; the effective
    degrees of freedom under the errors' correlation.
    """

    normalised: float
    low: float
    high: float
    freedom: float

    @property
    def holds(self) -> bool:
        """Return whether it lies in its interval."""
        return self.low <= self.normalised <= self.high


def consistency(errors: RowSource, covariances: RowSource) -> Consistency | None:
    """Return the consistency of errors (n, 3) with covariances (n, 6) (`frames.ENTRIES`), read block by block; None if
    fewer than twenty frames have both.
    """
    from scipy.special import gammaincinv  # the inverse chi-squared distribution without the weight of scipy.stats

    with RowSpool(3) as white:
        squares = 0.0
        for error, covariance in zip(row_blocks(errors), row_blocks(covariances), strict=True):
            block = _whitened(*_finite(error, covariance))
            squares += float(np.sum(block**2))
            white.append(block)
        if len(white) < _FEWEST:
            return None
        normalised = squares / (3 * len(white))
        freedom = _freedom(white, normalised)
    low, high = 2 * gammaincinv(freedom / 2, [0.025, 0.975]) / freedom
    return Consistency(normalised, float(low), float(high), freedom)


def _finite(errors: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Return the rows that are finite in both; a sum that is finite shows at once that all are."""
    with np.errstate(invalid="ignore"):
        if np.isfinite(errors.sum() + covariances.sum()):
            return errors, covariances
    is_finite = np.isfinite(covariances).all(axis=1) & np.isfinite(errors).all(axis=1)
    return errors[is_finite], covariances[is_finite]


def _whitened(errors: Floats, covariances: Floats) -> Floats:
    """Return errors (n, 3) times the inverse of the lower Cholesky factor of their covariances (n, 6), without rows
    whose covariance is not positive definite. It is written out for all frames at once, twenty times as fast as a
    matrix routine.
    """
    xx, yy, zz, xy, xz, yz = np.ascontiguousarray(covariances.T)
    of_x, of_y, of_z = np.ascontiguousarray(errors.T)
    with np.errstate(invalid="ignore", divide="ignore"):
        first = np.sqrt(xx)
        second_first, third_first = xy / first, xz / first
        second = np.sqrt(yy - second_first**2)
        third_second = (yz - third_first * second_first) / second
        third = np.sqrt(zz - third_first**2 - third_second**2)
        x = of_x / first
        y = (of_y - second_first * x) / second
        z = (of_z - third_first * x - third_second * y) / third
    white = np.stack([x, y, z], axis=1)
    definite = (first > 0) & (second > 0) & (third > 0)
    return white if definite.all() else white[definite]


def _freedom(white: RowSource, mean_square: float) -> float:
    """Return the effective degrees of freedom: 18 over the variance of the mean of |x|^2, where x (n, 3) is `white`
    scaled to unit variance by its `mean_square`; 3 n without correlation.

    Lags up to half the length are added up, less their expectation by chance; correlations at longer lags are assumed
    as large as from a quarter of the length to half of it.
    """
    rows, half = len(white), len(white) // 2
    near, far = 0.0, 0.0
    for first, products in _lagged_products(white, half):
        lags = np.arange(first, first + len(products))
        share = 1 - lags / rows
        squares = products / (rows * mean_square * share) ** 2 - 9 / (rows * share)
        near += float(share @ squares)
        far += float(squares[lags > half // 2].sum())
    correlated = near + rows / 8 * far / (half - half // 2)
    return float(np.clip(18 / (2 / rows * (3 + 2 * max(correlated, 0.0))), 1.0, 3 * rows))


def _lagged_products(white: RowSource, last: int) -> Iterator[tuple[int, Floats]]:
    """Yield a lag k > 0 and, for it and the lags that follow, up to `last`, the squared Frobenius norm of the sum over
    i of x(i) x(i + k)'.

    Correlations of segments are products of their spectra (T. G. Stockham, "High-speed convolution and correlation",
    1966); the products of all pairs of segments at one distance are added up before the inverse transform. The shorter
    lags of one distance are added to the result of the distance before.
    """
    from scipy.fft import next_fast_len

    rows = len(white)
    if rows <= _AT_ONCE * _SEGMENT:
        yield 1, _lagged_products_at_once(white[:rows], last, next_fast_len(rows + last, real=True))
        return
    segment = _SEGMENT
    size = next_fast_len(2 * segment, real=True)
    width = size // 2 + 1
    count = -(-rows // segment)
    with RowSpool(6 * width) as spectra:
        for start in range(0, rows, segment):
            spectrum = np.fft.rfft(white[start : start + segment].T, size)
            spectra.append(np.ascontiguousarray(spectrum).view(np.float64).reshape(1, -1))

        def correlations(distance: int) -> Floats:
            total = np.zeros((3, 3, width), complex)
            for number in range(count - distance):
                earlier, later = (
                    spectra[place : place + 1].view(np.complex128).reshape(3, width)
                    for place in (number, number + distance)
                )
                np.conj(earlier, out=earlier)
                for total_of, of_axis in zip(total, earlier, strict=True):
                    total_of += of_axis * later
            return np.fft.irfft(total, size)

        lagged = correlations(0)[..., :segment].copy()
        for distance in range(last // segment + 1):
            ahead = correlations(distance + 1)
            lagged[..., 1:] += ahead[..., size - segment + 1 :]
            first = distance * segment
            products = np.einsum("ijk,ijk->k", lagged, lagged)[: last + 1 - first]
            yield (first, products) if first else (1, products[1:])
            lagged[...] = ahead[..., :segment]
            del ahead  # frees memory before the next one is computed


def _lagged_products_at_once(white: Floats, last: int, size: int) -> Floats:
    """Return the products of the lags from 1 to `last` by a spectrum of `size` values of each column of `white` (n, 3),
    n + `last` or more, so that no product of distant rows is added. The correlation of one axis with a later one has
    that of the later with the earlier one at its negative lags.
    """
    from scipy.fft import irfft  # transforms several columns at once faster than one by one

    spectra = [np.fft.rfft(column, size) for column in np.ascontiguousarray(white.T)]
    products = np.zeros(last)
    pairs = list(combinations_with_replacement(range(3), 2))
    for at in range(0, len(pairs), 2):
        some = pairs[at : at + 2]
        lagged = irfft(np.stack([spectra[first].conj() * spectra[second] for first, second in some]), size)
        for (first, second), of_pair in zip(some, lagged, strict=True):
            products += of_pair[1 : last + 1] ** 2
            if first != second:
                products += of_pair[: -last - 1 : -1] ** 2
    return products


_POLL_S = 0.5
"""Time between two readings of the other process's progress."""

_HEAVY = 5.0
"""Duration of an estimator of the whole array relative to all simple techniques together."""

_SHARE = "share"
"""The file to which a process writes its progress."""

AXES = ("X", "Y", "Z", "XYZ")
"""Box axes of a ratio; "XYZ" is the length of the error."""


@dataclass(frozen=True)
class Score:
    """Result of one technique for one quantity: its `error` per box axis; `ratio`, its rms error over that of the
    simple average by box axis (`AXES`); the consistency of its covariance (None: it has none).
    """

    technique: str
    quantity: str
    error: Error
    ratio: Mapping[str, Ratio]
    consistency: Consistency | None


@dataclass(frozen=True)
class TechniqueComparison:
    """The scores of all techniques, and their errors of heading and velocity (empty unless both quantities are
    fused).
    """

    scores: tuple[Score, ...]
    coasting: Mapping[str, Coasting]


def technique_names() -> tuple[str, ...]:
    """Return the names of all techniques of `fuse`."""
    return NAMES


def compare(
    log: Log,
    calibration: Calibration,
    techniques: Sequence[str] = (),
    *,
    only: Collection[str] = (),
    progress: Progress = lambda share: None,
    executor: Executor | None = None,
) -> TechniqueComparison:
    """Fuse `log` by `techniques` (empty: all) and compare their errors, with `only` these sensors (empty: all).

    `progress` is called with the share of the work that is done. Processes of the `executor` run the estimators of the
    whole array concurrently; the result is the same. FusionError without a truth, or with too few frames.
    """
    log.keep_rows()
    names = list(dict.fromkeys((AVERAGE, *(techniques or technique_names()))))
    simple = [technique for technique in names if technique in TECHNIQUES]
    parts = _ProgressParts(progress, [1.0, *(_HEAVY for technique in names if technique not in TECHNIQUES)])
    scores, coasts = [], {}
    with ErrorFramesOnDisk(log) as errors, ExitStack() as stack:
        processes = {}
        for technique in names:
            if executor is not None and technique not in simple:
                processes[technique] = stack.enter_context(_OtherProcess(executor, log, calibration, technique, only))
        together = fuse_together(log, calibration, simple, only=only, progress=parts.next())
        for blocks in together:
            errors.add(blocks)
        average = errors.of(AVERAGE)
        for technique in techniques or technique_names():
            if technique not in errors:
                if technique in processes:
                    errors.take(technique, processes[technique].files(parts.next()))
                else:
                    for block in fuse(log, calibration, technique, only=only, progress=parts.next()):
                        errors.add({technique: block})
            result = errors.of(technique)
            scores += [_score(technique, quantity, average[quantity], frames) for quantity, frames in result.items()]
            if len(result) == 2:
                coasts[technique] = coasting(both(result))
    return TechniqueComparison(tuple(scores), coasts)


class _OtherProcess:
    """The frames of one technique, computed by a process of an executor and exchanged in a folder; a context
    manager.
    """

    def __init__(
        self, executor: Executor, log: Log, calibration: Calibration, technique: str, only: Collection[str]
    ) -> None:
        copyreg.pickle(MappingProxyType, _proxy_parts)
        self._folder = TemporaryDirectory(prefix="imuarray-")
        self._future = executor.submit(
            _write_error_frames, log.path, calibration, technique, tuple(only), Path(self._folder.name)
        )

    def files(self, progress: Progress) -> dict[str, Path]:
        """Wait for the files of frames by quantity; raises what `fuse` raises."""
        share = 0.0
        while True:
            try:
                return self._future.result(timeout=_POLL_S)
            except TimeoutError:
                if self._future.done():
                    raise
                share = max(share, _share_in(Path(self._folder.name)))  # 0 while the file is being written
                progress(share)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._future.cancel()
        self._folder.cleanup()


def _proxy_parts(proxy: MappingProxyType[Any, Any]) -> tuple[Callable[..., Any], tuple[dict[Any, Any]]]:
    """Return the constructor and arguments of a read-only mapping for pickle, which does not support it."""
    return _read_only, (dict(proxy),)


def _read_only(mapping: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    """Return a read-only view of the mapping."""
    return MappingProxyType(mapping)


def _write_error_frames(
    path: Path, calibration: Calibration, technique: str, only: Sequence[str], folder: Path
) -> dict[str, Path]:
    """Fuse a log by a technique and write the frames that have an error to a folder; return the files by quantity."""
    with open_log(path) as log, ErrorFramesOnDisk(log, folder) as errors:
        for block in fuse(log, calibration, technique, only=only, progress=lambda share: _write_share(folder, share)):
            errors.add({technique: block})
        return errors.files(technique)


def _write_share(folder: Path, share: float) -> None:
    """Write the share of the work that is done for the waiting process."""
    (folder / _SHARE).write_text(f"{share:.4f}")


def _share_in(folder: Path) -> float:
    """Return the share that was written last; 0 before, or while it is being written."""
    try:
        return float((folder / _SHARE).read_text())
    except (OSError, ValueError):
        return 0.0


class _ProgressParts:
    """Progress of work that consists of parts with these weights."""

    def __init__(self, progress: Progress, weights: Sequence[float]) -> None:
        self._progress, self._completed = progress, 0.0
        self._weights = iter([weight / sum(weights) for weight in weights])

    def next(self) -> Progress:
        """Return the progress callback of the next part."""
        start, weight = self._completed, next(self._weights)
        self._completed += weight
        return lambda share: self._progress(start + weight * share)


ErrorFrameSource = ErrorFrames | ErrorFrameSpool


def both(frames: Mapping[str, ErrorFrameSource]) -> Iterator[Errors]:
    """Yield the frames in which both quantities are known, block by block, as input of `coasting`."""
    for rate, force in _common(frames["angular_rate"], frames["specific_force"]):
        yield Errors(rate.time, rate.errors, force.errors, rate.truth, force.truth)


def _common(first: ErrorFrameSource, second: ErrorFrameSource) -> Iterator[tuple[ErrorFrames, ErrorFrames]]:
    """Yield the frames of both at their common times, block by block."""
    end = 0
    for start in range(0, len(first), AT_ONCE):
        block, begin = first[start : start + AT_ONCE], end
        end = bisect_right(
            range(len(second)), block.time[-1], lo=begin, key=lambda row: second.times(slice(row, row + 1))[0]
        )
        second_block = second[begin:end]
        if not np.array_equal(block.time, second_block.time):  # they are usually equal
            _, rows, second_rows = np.intersect1d(
                block.time, second_block.time, assume_unique=True, return_indices=True
            )
            block, second_block = block[rows], second_block[second_rows]
        yield block, second_block


def _score(technique: str, quantity: str, average: ErrorFrameSource, estimate: ErrorFrameSource) -> Score:
    """Compare an estimate with the simple average."""
    if _have_the_same_times(average, estimate):
        squares = _squares_of(technique, quantity, average.errors, estimate.errors)
    else:
        with RowSpool(3) as average_errors, RowSpool(3) as technique_errors:
            for block, estimated in _common(average, estimate):
                average_errors.append(block.errors)
                technique_errors.append(estimated.errors)
            squares = _squares_of(technique, quantity, average_errors, technique_errors)
    ratio = {axis: ratio_of(squares[:, k], squares[:, k + 3]) for k, axis in enumerate(AXES[:3])}
    ratio[AXES[3]] = ratio_of(squares[:, :3].sum(axis=1), squares[:, 3:].sum(axis=1))
    return Score(
        technique, quantity, error_of(estimate.errors), ratio, consistency(estimate.errors, estimate.covariances)
    )


def _have_the_same_times(first: ErrorFrameSource, second: ErrorFrameSource) -> bool:
    """Return whether both have the same frames, which is usual."""
    parts = (slice(start, start + AT_ONCE) for start in range(0, len(first), AT_ONCE))
    return len(first) == len(second) and all(np.array_equal(first.times(part), second.times(part)) for part in parts)


def _squares_of(technique: str, quantity: str, average_errors: RowSource, technique_errors: RowSource) -> Floats:
    """Return the sums (b, 6) of squared errors before and after in consecutive stretches; FusionError for too few
    errors.
    """
    count = min(BLOCKS, len(technique_errors) // 2)
    if count < FEWEST_BLOCKS:
        counts_text = f"{len(technique_errors)} values of {quantity} with a truth"
        raise FusionError(f"technique {technique}: {counts_text}, too few to compare")
    return np.concatenate([block_squares(average_errors, count), block_squares(technique_errors, count)], axis=1)
