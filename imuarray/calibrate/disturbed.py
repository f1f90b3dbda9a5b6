"""Poses that do not belong to the others: in which the box moved, or that no calibration explains together with the
rest. They are left out and named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.pose_readings import Pose, PoseReadings

MOVED_G = 0.005
"""A box whose gravity changes by more from one half of a pose to the other was moved: 0.3 degrees. Warming up changes
biases by less than a fifth of it in the time of a pose (1 mg in 90 minutes in the paper's Table 3, 0.3 mg in 20 s in a
recording of MPU-9150)."""

BREAK_S = 30.0
_BREAKS = 10.0
"""Poses form one series as long as no break is longer than this time and than this multiple of the usual break."""

_SURE = 5.0
"""Standard errors beyond which a change is no noise: by chance in one of a million."""

FALSE_ALARM = 1e-3
"""How often a sound log loses a pose by chance."""


@dataclass(frozen=True)
class Exclusion:
    """A pose or a turn that the fit does not use, the log that it is in, and why."""

    phase: str
    log: str
    reason: str


def exclusion_of(pose: Pose, reason: str) -> Exclusion:
    """The note of a pose that is not used."""
    return Exclusion(pose.label, "" if pose.log is None else str(pose.log.path), reason)


def another_go(poses: Sequence[Pose]) -> dict[int, str]:
    """The poses of one log, by place and in order of time, that are separated from most of the others by a long time
    without any, and why they are not used: biases wander on, and jump when a box is shaken.

    Nothing is left out where the others alone would not have the larger share.
    """
    starts = np.array([pose.phase.start_ns for pose in poses]) * 1e-9
    breaks_s = starts[1:] - np.array([pose.phase.end_ns for pose in poses[:-1]]) * 1e-9
    if len(breaks_s) == 0:
        return {}
    longest_s = max(BREAK_S, _BREAKS * float(np.median(breaks_s)))
    goes = np.split(np.arange(len(poses)), np.flatnonzero(breaks_s > longest_s) + 1)
    most = max(goes, key=len)
    if len(goes) == 1 or 2 * len(most) <= len(poses):
        return {}
    return {
        int(place): f"more than {longest_s:.0f} s passed between it and the {len(most)} poses that were"
        f" recorded together"
        for go in goes
        if go is not most
        for place in go
    }


def moved_within(readings: PoseReadings) -> dict[int, str]:
    """The poses, by place, in which the box moved, and how far in words.

    What most accelerometers say counts: the median over them of the change between a pose's halves, in the box frame,
    so that one chip's drift is not a movement.
    """
    sensitivity = readings.sensitivity[:, None, None]
    turns = np.array([sensor.orientation for sensor in readings.sensors])
    change_g = np.median(np.einsum("sij,skj->ski", turns, readings.change_lsb / sensitivity), axis=0)
    sem_g = (readings.change_sem_lsb / sensitivity).max(axis=2)
    # A median is at worst as sure as 1.2533 of a mean's error.
    sem_g = 1.2533 * np.sqrt(np.mean(sem_g**2, axis=0) / len(readings.sensors))
    far = np.linalg.norm(change_g, axis=1)
    moved = (far > MOVED_G) & (far > _SURE * sem_g)
    return {
        int(place): f"the box moved: gravity changed by {1e3 * far[place]:.1f} mg between its two halves"
        for place in np.flatnonzero(moved)
    }


def chance_of_misfit(with_it: float, without: float, number: int, freedom: float) -> float:
    """Probability that `number` readings fit as badly by chance: the F test of a mean shift.

    `with_it` and `without` are the sums of weighted squares of a fit with them and one without, which has `freedom`
    degrees of freedom; 1.0 if none are left to judge by.
    """
    if freedom <= 0 or number <= 0:
        return 1.0
    ratio = max(with_it - without, 0.0) / number / max(without / freedom, 1e-300)
    from scipy.special import fdtrc  # its weight is for those who ask

    return float(fdtrc(number, freedom, ratio))


def worst(chances: Sequence[float], sizes_g: Floats, least_g: float) -> int | None:
    """The place of the least likely pose, if it is too unlikely among so many and off by `least_g`, else None."""
    unlikely = np.where(sizes_g >= least_g, chances, 1.0)
    place = int(unlikely.argmin())
    return place if unlikely[place] < FALSE_ALARM / len(unlikely) else None
