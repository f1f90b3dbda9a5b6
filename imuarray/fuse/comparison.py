"""Comparison of every technique on one log with known truth: errors, gains over the simple average, and covariances.

All techniques use the same sensors and the same calibration. Only frames that both the average and the technique
estimate are counted. The errors of a coasting navigator are compared as well (`imuarray.fuse.coasting_errors`). The
interval of a ratio covers chance within this log; the turn-on bias of a sensor is the same throughout it.

An estimator of the whole array takes longer than all simple techniques together. With an executor another process
computes its frames at the same time; the figures are the same as from one process.
"""

from __future__ import annotations

import copyreg
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate import Calibration
from imuarray.errors import FusionError
from imuarray.fuse.coasting_errors import Coasting, Errors, coasting
from imuarray.fuse.error_consistency import Consistency, consistency_of
from imuarray.fuse.evaluation import (
    BLOCKS,
    FEWEST_BLOCKS,
    Error,
    ErrorFramesOnDisk,
    ErrorFrameSpool,
    MotionErrors,
    Ratio,
    block_squares,
    error_of,
    ratio_of,
)
from imuarray.fuse.fusion import AVERAGE, NAMES, Progress, fuse, fuse_together
from imuarray.fuse.spools import AT_ONCE, RowSource, RowSpool
from imuarray.fuse.techniques import TECHNIQUES
from imuarray.log import Log, open_log

_POLL_S = 0.5
"""Interval in s between two reads of the other process's progress."""

_HEAVY = 5.0
"""Assumed duration of an estimator of the whole array, relative to that of all simple techniques together."""

_SHARE = "share"
"""Name of the file to which a process writes its progress."""

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
    """The frames of one technique, computed by a process of an executor, exchanged in a folder; a context manager."""

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


ErrorFrameSource = MotionErrors | ErrorFrameSpool


def both(frames: Mapping[str, ErrorFrameSource]) -> Iterator[Errors]:
    """Yield the frames in which both quantities are known, block by block, as input of `coasting`."""
    for rate, force in _common(frames["angular_rate"], frames["specific_force"]):
        yield Errors(rate.time, rate.errors, force.errors, rate.truth, force.truth)


def _common(first: ErrorFrameSource, second: ErrorFrameSource) -> Iterator[tuple[MotionErrors, MotionErrors]]:
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


def _score(technique: str, quantity: str, average: ErrorFrameSpool, estimate: ErrorFrameSpool) -> Score:
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
    return Score(technique, quantity, error_of(estimate.errors), ratio, consistency_of(estimate.white))


def _have_the_same_times(first: ErrorFrameSource, second: ErrorFrameSource) -> bool:
    """Return whether both have the same frames, which is usual."""
    parts = (slice(start, start + AT_ONCE) for start in range(0, len(first), AT_ONCE))
    return len(first) == len(second) and all(np.array_equal(first.times(part), second.times(part)) for part in parts)


def _squares_of(technique: str, quantity: str, average_errors: RowSource, technique_errors: RowSource) -> Floats:
    """Return the sums (b, 6) of squared errors before and after in successive stretches; FusionError if there are too
    few errors.
    """
    count = min(BLOCKS, len(technique_errors) // 2)
    if count < FEWEST_BLOCKS:
        counts_text = f"{len(technique_errors)} values of {quantity} with a truth"
        raise FusionError(f"technique {technique}: {counts_text}, too few to compare")
    return np.concatenate([block_squares(average_errors, count), block_squares(technique_errors, count)], axis=1)
