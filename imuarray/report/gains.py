"""What a technique gains over the simple average of the same sensors, on a log that knows the truth, with its
uncertainty.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imuarray.calibrate import Calibration
from imuarray.errors import FusionError
from imuarray.fuse import errors_of, fuse
from imuarray.log import Log
from imuarray.log.format import Phase

Floats = npt.NDArray[np.float64]

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
            before, after = (_ten_second_means(time, part) for part in (before, after))
        for axis in range(3):
            rows.append(_gain(technique, quantity, "XYZ"[axis], before[:, axis], after[:, axis]))
        rows.append(_gain(technique, quantity, "XYZ", *(np.linalg.norm(part, axis=1) for part in (before, after))))
    return rows


def _ten_second_means(time: npt.NDArray[np.int64], rows: Floats) -> Floats:
    """Means of ten seconds each, less the first: what standing still at the start would have taken out."""
    step = (time - time[0]) // 10_000_000_000
    _, first = np.unique(step, return_index=True)
    means = np.add.reduceat(rows, first) / np.diff(np.append(first, len(rows)))[:, None]
    return np.asarray(means - means[0])


def _gain(technique: str, quantity: str, box_axis: str, before: Floats, after: Floats) -> Gain:
    count = min(BLOCKS, len(before) // 2)
    if count < FEWEST_BLOCKS:
        raise FusionError(f"technique {technique}: {len(before)} values with a truth, too few to compare")
    parts = zip(np.array_split(before, count), np.array_split(after, count), strict=True)
    squares = np.array([[np.sum(b**2), np.sum(a**2)] for b, a in parts])
    total = squares.sum(axis=0)
    ratio = float(np.sqrt(total[1] / total[0]))
    left_out = np.sqrt((total[1] - squares[:, 1]) / (total[0] - squares[:, 0]))
    spread = float(np.sqrt((count - 1) / count * np.sum((left_out - left_out.mean()) ** 2)))
    average, error = (float(value) for value in np.sqrt(total / len(before)))
    return Gain(technique, quantity, box_axis, average, error, ratio, spread)
