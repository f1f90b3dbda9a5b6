"""Every technique on one log that knows the truth, with the same calibration: errors, how they compare with the simple
average of the same sensors, whether covariances hold, and what a navigator makes of it.

Frames count that the average and the technique both know. An interval tells how far chance within this log could
change a ratio; how a sensor came up this time is the same in all of it.

An estimator of the whole array takes longer than all simple techniques together: with an executor another process makes
its frames in the meantime. Both processes do what one would do, so that the figures are the same.
"""

from __future__ import annotations

import copyreg
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from imuarray.arrays import Floats, Indices, Times
from imuarray.calibrate import Calibration
from imuarray.errors import FusionError
from imuarray.fuse.coasting import Coasting, Errors, coasting
from imuarray.fuse.evaluation import (
    Consistency,
    Error,
    ErrorFrames,
    ErrorFramesOnDisk,
    consistency,
    error_of,
)
from imuarray.fuse.fuse import AVERAGE, NAMES, Progress, fuse, fuse_together
from imuarray.fuse.gains import BLOCKS, FEWEST_BLOCKS, Ratio, block_squares, ratio_of
from imuarray.fuse.techniques import TECHNIQUES
from imuarray.log import Log, open_log

_LOOK_S = 0.5
"""Time between two looks at how far the other process is."""

_HEAVY = 5.0
"""By how much longer an estimator of the whole array takes than all simple techniques together."""

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
        average = {quantity: (frames.time, frames.errors) for quantity, frames in errors.of(AVERAGE).items()}
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


def both(frames: Mapping[str, ErrorFrames]) -> Errors:
    """The frames in which both quantities are known, as `coasting` takes them."""
    rate, force = frames["angular_rate"], frames["specific_force"]
    mine, other = _common(rate.time, force.time)
    return Errors(rate.time[mine], rate.errors[mine], force.errors[other], rate.truth[mine], force.truth[other])


def _common(first_times: Times, second_times: Times) -> tuple[Indices | slice, Indices | slice]:
    """Return which frames of either are at times that both have, in order: mostly all of them."""
    if np.array_equal(first_times, second_times):
        return slice(None), slice(None)
    _, mine, its = np.intersect1d(first_times, second_times, assume_unique=True, return_indices=True)
    return mine, its


def _score(technique: str, quantity: str, average: tuple[Times, Floats], estimate: ErrorFrames) -> Score:
    """`average`: the times and errors of the simple average."""
    mine, other = _common(average[0], estimate.time)
    of_average, of_estimate = average[1][mine], estimate.errors[other]
    count = min(BLOCKS, len(of_average) // 2)
    if count < FEWEST_BLOCKS:
        known = f"{len(of_average)} values of {quantity} with a truth"
        raise FusionError(f"technique {technique}: {known}, too few to compare")
    before, after = (block_squares(part, count) for part in (of_average, of_estimate))
    ratio = {axis: ratio_of(before[:, k], after[:, k]) for k, axis in enumerate(AXES[:3])}
    ratio[AXES[3]] = ratio_of(before.sum(axis=1), after.sum(axis=1))
    return Score(
        technique, quantity, error_of(estimate.errors), ratio, consistency(estimate.errors, estimate.covariances)
    )
