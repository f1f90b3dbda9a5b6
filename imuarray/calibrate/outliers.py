"""Outliers among poses and turns: the box moved, or no calibration explains the pose together with the others. They are
excluded from the fit and reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.pose_readings import Pose, PoseReadings

MOVED_G = 0.005
"""If gravity changes by more between the halves of a pose, the box moved (0.3 degrees). Warm-up changes biases by less
than a fifth of it during a pose (1 mg in 90 minutes in the paper's Table 3, 0.3 mg in 20 s in a recording of
MPU-9150)."""

BREAK_S = 30.0
_BREAKS = 10.0
"""Poses belong to one series unless a break between them exceeds both this time and this multiple of the usual break.
"""

_SURE = 5.0
"""Number of standard errors above which a change is not noise: exceeded by chance once in a million."""

FALSE_ALARM = 1e-3
"""Probability that a pose of a good log is excluded by chance."""


@dataclass(frozen=True)
class Outlier:
    """A pose or a turn that the fit excludes, the log that contains it, and the reason."""

    phase: str
    log: str
    reason: str


def outlier_of(pose: Pose, reason: str) -> Outlier:
    """Return the record of an excluded pose."""
    return Outlier(pose.label, "" if pose.log is None else str(pose.log.path), reason)


def separated_poses(poses: Sequence[Pose]) -> dict[int, str]:
    """Return the indices of the poses of one log, in order of time, that a long break separates from most others, with
    the reason: biases drift during a break, and change when the box is shaken.

    Empty unless more than half of the poses form one series.
    """
    starts = np.array([pose.phase.start_ns for pose in poses]) * 1e-9
    breaks_s = starts[1:] - np.array([pose.phase.end_ns for pose in poses[:-1]]) * 1e-9
    if len(breaks_s) == 0:
        return {}
    longest_s = max(BREAK_S, _BREAKS * float(np.median(breaks_s)))
    series = np.split(np.arange(len(poses)), np.flatnonzero(breaks_s > longest_s) + 1)
    main = max(series, key=len)
    if len(series) == 1 or 2 * len(main) <= len(poses):
        return {}
    reason = f"more than {longest_s:.0f} s passed between it and the {len(main)} poses that were recorded together"
    return {int(index): reason for each in series if each is not main for index in each}


def moving_poses(readings: PoseReadings) -> dict[int, str]:
    """Return the indices of the poses in which the box moved, with the reason.

    The change between the halves of a pose is the median over the accelerometers in the box frame, so that the drift of
    one chip does not count as motion.
    """
    sensitivity = readings.sensitivity[:, None, None]
    orientations = np.array([sensor.orientation for sensor in readings.sensors])
    change_g = np.median(np.einsum("sij,skj->ski", orientations, readings.change_lsb / sensitivity), axis=0)
    sem_g = (readings.change_sem_lsb / sensitivity).max(axis=2)
    # The standard error of a median of normal numbers is at most sqrt(pi / 2) times that of their mean.
    sem_g = 1.2533 * np.sqrt(np.mean(sem_g**2, axis=0) / len(readings.sensors))
    far = np.linalg.norm(change_g, axis=1)
    moved = (far > MOVED_G) & (far > _SURE * sem_g)
    return {
        int(index): f"the box moved: gravity changed by {1e3 * far[index]:.1f} mg between its two halves"
        for index in np.flatnonzero(moved)
    }


def misfit_probability(with_it: float, without: float, number: int, freedom: float) -> float:
    """Return the probability that `number` readings fit so badly by chance: the F test of a mean shift.

    `with_it` and `without` are the weighted sums of squares of a fit with these readings and of a fit without them,
    which has `freedom` degrees of freedom; 1.0 if it has none.
    """
    if freedom <= 0 or number <= 0:
        return 1.0
    ratio = max(with_it - without, 0.0) / number / max(without / freedom, 1e-300)
    from scipy.special import fdtrc  # slow to import

    return float(fdtrc(number, freedom, ratio))


def find_outlier(p_values: Sequence[float], sizes: Floats, smallest: float) -> int | None:
    """Return the index of the least probable pose or turn whose error is at least `smallest` (in the unit of `sizes`),
    if it is significant among so many; else None.
    """
    candidates = np.where(sizes >= smallest, p_values, 1.0)
    index = int(candidates.argmin())
    return index if candidates[index] < FALSE_ALARM / len(candidates) else None
