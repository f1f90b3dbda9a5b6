"""Comparison of every technique on one log with known truth: errors, gains over the simple average, and covariances.

All techniques use the same sensors and the same calibration. Only frames that both the average and the technique
estimate are counted. The errors of a navigator that coasts on each result are compared as well
(`imuarray.fuse.coasting`). The interval of a ratio covers chance within this log; how a sensor came up this time is the
same in all of it.

An estimator of the whole array takes longer than all simple techniques together. With an executor another process
computes its frames in the meantime; the figures are the same as from one process.
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

from imuarray.calibrate import Calibration
from imuarray.errors import FusionError
from imuarray.fuse.coasting import Coasting, Errors, coasting
from imuarray.fuse.consistency import Consistency, consistency
from imuarray.fuse.evaluation import Error, ErrorFrames, ErrorFramesOnDisk, ErrorFrameSpool, error_of
from imuarray.fuse.fuse import AVERAGE, NAMES, Progress, fuse, fuse_together
from imuarray.fuse.gains import BLOCKS, FEWEST_BLOCKS, Ratio, block_squares, ratio_of
from imuarray.fuse.row_spool import AT_ONCE, RowSpool
from imuarray.fuse.techniques import TECHNIQUES
from imuarray.log import Log, open_log

_LOOK_S = 0.5
"""Time between two looks at how far the other process is."""

_HEAVY = 5.0
"""How much longer an estimator of the whole array takes than all simple techniques together."""

_SHARE = "share"
"""The file in which a process tells how far it is."""

AXES = ("X", "Y", "Z", "XYZ")
"""Box axes of a ratio; "XYZ" is the length of the error."""


@dataclass(frozen=True)
class Score:
    """One technique, one quantity: its `error` per box axis; `ratio`, its rms error over that of the simple average by
    box axis (`AXES`); whether its covariance holds (None: it claims none).
    """

    technique: str
    quantity: str
    error: Error
    ratio: Mapping[str, Ratio]
    consistency: Consistency | None


@dataclass(frozen=True)
class Comparison:
    """All scores, and each technique's errors of heading and velocity (none without both quantities)."""

    scores: tuple[Score, ...]
    coasting: Mapping[str, Coasting]


def technique_names() -> tuple[str, ...]:
    """Every name that `fuse` takes."""
    return NAMES


def compare(
    log: Log,
    calibration: Calibration,
    techniques: Sequence[str] = (),
    *,
    only: Collection[str] = (),
    progress: Progress = lambda share: None,
    executor: Executor | None = None,
) -> Comparison:
    """Fuse `log` by `techniques` (all of them, if none is named) and compare their errors, with `only` these sensors if
    any are named.

    `progress` is called with the share of the work that is done. Processes of the `executor` fuse by estimators of the
    whole array beside this one; the result is the same. FusionError without a truth, or with too few frames.
    """
    log.keep_rows()
    wanted = list(dict.fromkeys((AVERAGE, *(techniques or technique_names()))))
    each_alone = [technique for technique in wanted if technique in TECHNIQUES]
    parts = _Parts(progress, [1.0, *(_HEAVY for technique in wanted if technique not in TECHNIQUES)])
    scores, coasts = [], {}
    with ErrorFramesOnDisk(log) as errors, ExitStack() as stack:
        processes = {}
        for technique in wanted:
            if executor is not None and technique not in each_alone:
                processes[technique] = stack.enter_context(_OtherProcess(executor, log, calibration, technique, only))
        together = fuse_together(log, calibration, each_alone, only=only, progress=parts.next())
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
    return Comparison(tuple(scores), coasts)


class _OtherProcess:
    """The frames of one technique, made by a process of an executor in a folder that both see; a context manager."""

    def __init__(
        self, executor: Executor, log: Log, calibration: Calibration, technique: str, only: Collection[str]
    ) -> None:
        copyreg.pickle(MappingProxyType, _proxy_parts)
        self._folder = TemporaryDirectory(prefix="imuarray-")
        self._future = executor.submit(
            _write_error_frames, log.path, calibration, technique, tuple(only), Path(self._folder.name)
        )

    def files(self, progress: Progress) -> dict[str, Path]:
        """Wait for the files of frames by quantity; what `fuse` raises."""
        while True:
            try:
                return self._future.result(timeout=_LOOK_S)
            except TimeoutError:
                if self._future.done():
                    raise
                progress(_share_in(Path(self._folder.name)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._future.cancel()
        self._folder.cleanup()


def _proxy_parts(proxy: MappingProxyType[Any, Any]) -> tuple[Callable[..., Any], tuple[dict[Any, Any]]]:
    """Return how another process makes a read-only mapping anew; Python itself can't send one."""
    return _read_only, (dict(proxy),)


def _read_only(mapping: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    """Return the mapping, not to be written to."""
    return MappingProxyType(mapping)


def _write_error_frames(
    path: Path, calibration: Calibration, technique: str, only: Sequence[str], folder: Path
) -> dict[str, Path]:
    """Fuse a log by a technique and write the frames that have an error to a folder; return the files by quantity."""
    with open_log(path) as log, ErrorFramesOnDisk(log, folder) as errors:
        for block in fuse(log, calibration, technique, only=only, progress=lambda share: _tell_share(folder, share)):
            errors.add({technique: block})
        return errors.files(technique)


def _tell_share(folder: Path, share: float) -> None:
    """Tell the process that waits what share is done."""
    (folder / _SHARE).write_text(f"{share:.4f}")


def _share_in(folder: Path) -> float:
    """Return the share that was told last; 0 before, or while it is being written."""
    try:
        return float((folder / _SHARE).read_text())
    except (OSError, ValueError):
        return 0.0


class _Parts:
    """Progress of work in parts of these weights."""

    def __init__(self, progress: Progress, weights: Sequence[float]) -> None:
        self._progress, self._done = progress, 0.0
        self._weights = iter([weight / sum(weights) for weight in weights])

    def next(self) -> Progress:
        """Return the estimate of the next part."""
        begin, weight = self._done, next(self._weights)
        self._done += weight
        return lambda share: self._progress(begin + weight * share)


ErrorFrameSource = ErrorFrames | ErrorFrameSpool


def both(frames: Mapping[str, ErrorFrameSource]) -> Iterator[Errors]:
    """Yield the frames in which both quantities are known, as `coasting` takes them, block by block."""
    for rate, force in _common(frames["angular_rate"], frames["specific_force"]):
        yield Errors(rate.time, rate.errors, force.errors, rate.truth, force.truth)


def _common(first: ErrorFrameSource, second: ErrorFrameSource) -> Iterator[tuple[ErrorFrames, ErrorFrames]]:
    """Yield the frames of either at times that both have, in order, block by block."""
    end = 0
    for start in range(0, len(first), AT_ONCE):
        mine, begin = first[start : start + AT_ONCE], end
        end = bisect_right(range(len(second)), mine.time[-1], lo=begin, key=lambda row: second[row : row + 1].time[0])
        other = second[begin:end]
        if not np.array_equal(mine.time, other.time):  # mostly they are the same
            _, of_mine, of_other = np.intersect1d(mine.time, other.time, assume_unique=True, return_indices=True)
            mine, other = mine[of_mine], other[of_other]
        yield mine, other


def _score(technique: str, quantity: str, average: ErrorFrameSource, estimate: ErrorFrameSource) -> Score:
    """Compare an estimate with the simple average."""
    with RowSpool(6) as errors:  # of both, at common times
        for before, after in _common(average, estimate):
            errors.append(np.concatenate([before.errors, after.errors], axis=1))
        count = min(BLOCKS, len(errors) // 2)
        if count < FEWEST_BLOCKS:
            known = f"{len(errors)} values of {quantity} with a truth"
            raise FusionError(f"technique {technique}: {known}, too few to compare")
        squares = block_squares(errors, count)
    ratio = {axis: ratio_of(squares[:, k], squares[:, k + 3]) for k, axis in enumerate(AXES[:3])}
    ratio[AXES[3]] = ratio_of(squares[:, :3].sum(axis=1), squares[:, 3:].sum(axis=1))
    return Score(
        technique, quantity, error_of(estimate.errors), ratio, consistency(estimate.errors, estimate.covariances)
    )
