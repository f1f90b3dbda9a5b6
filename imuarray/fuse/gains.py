"""Gain of a technique over the simple average of the same sensors, on a log with truth, with its uncertainty."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.calibrate import Calibration
from imuarray.errors import FusionError
from imuarray.fuse.evaluation import errors_of
from imuarray.fuse.fuse import fuse
from imuarray.fuse.row_spool import RowSource, parts_of, row_sum
from imuarray.log import Log
from imuarray.log.format import Phase

BLOCKS = 20
"""Stretches of a log that are left out in turn for the uncertainty of a ratio (jackknife, Tukey 1958)."""

FEWEST_BLOCKS = 5


@dataclass(frozen=True)
class Gain:
    """Rms error in SI of the average and of a technique along one box axis, and their ratio with its standard error.

    `box_axis` "XYZ" is the length of the error vector.
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
    """A row per quantity and box axis, and one for all three. `slow`: the rms of ten-second means less the first of
    them, which is drift and hardly noise.

    FusionError if the log has neither truth nor reference.
    """
    errors = [errors_of(log, fuse(log, calibration, name, only=only), phases) for name in ("mean", technique)]
    rows = []
    for quantity in errors[0]:
        time, mine, other = np.intersect1d(errors[0][quantity][0], errors[1][quantity][0], return_indices=True)
        before, after = errors[0][quantity][1][mine], errors[1][quantity][1][other]
        if slow:
            before, after = (ten_second_means(time, part) for part in (before, after))
        for axis in range(3):
            rows.append(_gain(technique, quantity, "XYZ"[axis], before[:, axis : axis + 1], after[:, axis : axis + 1]))
        rows.append(
            _gain(
                technique, quantity, "XYZ", *(np.linalg.norm(part, axis=1, keepdims=True) for part in (before, after))
            )
        )
    return rows


def ten_second_means(time: npt.NDArray[np.int64], rows: Floats) -> Floats:
    """Means of ten seconds each, less the first: what standing still at the start would have taken out."""
    step = (time - time[0]) // 10_000_000_000
    _, first = np.unique(step, return_index=True)
    means = np.add.reduceat(rows, first) / np.diff(np.append(first, len(rows)))[:, None]
    return np.asarray(means - means[0])


def _gain(technique: str, quantity: str, box_axis: str, before: Floats, after: Floats) -> Gain:
    count = min(BLOCKS, len(before) // 2)
    if count < FEWEST_BLOCKS:
        raise FusionError(f"technique {technique}: {len(before)} values with a truth, too few to compare")
    result = ratio_of(block_squares(before, count)[:, 0], block_squares(after, count)[:, 0])
    average, error = (float(np.sqrt(np.mean(rows**2))) for rows in (before, after))
    return Gain(technique, quantity, box_axis, average, error, result.ratio, result.ratio_se)


@dataclass(frozen=True)
class Ratio:
    """A ratio of rms errors, its jackknife standard error, and the ends of its 95 % interval."""

    ratio: float
    ratio_se: float
    low: float
    high: float


def ratio_of(before: Floats, after: Floats) -> Ratio:
    """The root of the ratio of two sums of squared errors from their parts (b,), blocks of a log or runs; b > 1.

    Each part is left out in turn (jackknife, Tukey 1958) from the ratio; the interval is that of its logarithm,
    Student's with b - 1 degrees of freedom: its ends stay positive, and are inverted with the ratio.
    """
    from scipy.special import stdtrit  # the inverse of Student's distribution without the weight of scipy.stats

    count = len(before)
    total = before.sum(), after.sum()
    if not total[0] > 0 or not total[1] > 0:
        same = 1.0 if total[0] == total[1] else float("inf") if total[0] == 0 else 0.0
        return Ratio(same, 0.0, same, same)
    ratio = float(np.sqrt(total[1] / total[0]))
    left_out = np.sqrt(np.maximum(total[1] - after, 0) / np.maximum(total[0] - before, 1e-300))
    spread = float(np.sqrt((count - 1) / count * np.sum((left_out - left_out.mean()) ** 2)))
    reach = float(np.exp(stdtrit(count - 1, 0.975) * spread / ratio))
    return Ratio(ratio, spread, ratio / reach, ratio * reach)


def block_squares(rows: RowSource, count: int = BLOCKS) -> Floats:
    """Return the sums of squares (count, k) of `count` consecutive stretches of rows (n, k)."""
    return np.array([row_sum(rows, begin, end, power=2) for begin, end in parts_of(len(rows), count)])
