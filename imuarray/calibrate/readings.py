"""Readings of many sensors over many poses as arrays, and how well their means are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imuarray.calibrate.poses import Pose, read_pose
from imuarray.log import SensorLog

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class PoseReadings:
    """What `sensors` (s) read in `poses` (k), in counts along their own axes.

    `mean_lsb`, its `variance_lsb2` by the scatter within poses, and `change_lsb`, the mean of a pose's second half
    less that of its first, with `change_sem_lsb`: all (s, k, 3).
    """

    sensors: tuple[SensorLog, ...]
    poses: tuple[Pose, ...]
    mean_lsb: Floats
    variance_lsb2: Floats
    change_lsb: Floats
    change_sem_lsb: Floats

    def only(self, kept: Sequence[int] | Indices) -> PoseReadings:
        """The same in some of the poses."""
        places = np.asarray(kept, int)
        columns = (self.mean_lsb, self.variance_lsb2, self.change_lsb, self.change_sem_lsb)
        mean, variance, change, sem = (column[:, places] for column in columns)
        return PoseReadings(self.sensors, tuple(self.poses[place] for place in places), mean, variance, change, sem)

    def force_box_g(self) -> Floats:
        """(s, k, 3) specific force in g in the box frame by the data sheets' sensitivities, biases and all."""
        turns = np.array([sensor.orientation / sensor.sensitivity for sensor in self.sensors])
        return np.asarray(np.einsum("sij,skj->ski", turns, self.mean_lsb))

    @property
    def sensitivity(self) -> Floats:
        """(s,) counts per unit by the data sheets."""
        return np.array([sensor.sensitivity for sensor in self.sensors])

    @property
    def middle_s(self) -> Floats:
        """(k,) middle of each pose, in s since the epoch of its log."""
        return np.array([(pose.phase.start_ns + pose.phase.end_ns) * 0.5e-9 for pose in self.poses])

    def powers_of_time(self, highest: int) -> Floats:
        """(k, highest + 1) orthogonal polynomials of time over the poses, mean square 1, the first all ones; nothing
        but that for poses of several logs, which have no common time, and for those that are too few.
        """
        if not self.one_run or len(self.poses) <= highest + 1:
            return np.ones((len(self.poses), 1))
        since = self.middle_s - self.middle_s.mean()
        powers = np.linalg.qr(np.vander(since / np.abs(since).max(), highest + 1, increasing=True))[0]
        powers *= np.sqrt(len(self.poses)) * np.sign(powers[-1])
        powers[:, 0] = 1.0
        return np.asarray(powers)

    @property
    def one_run(self) -> bool:
        """True if all poses are in one log, so that their times compare."""
        return len({id(pose.log) for pose in self.poses}) == 1


def read_poses(sensors: Sequence[SensorLog], poses: Sequence[Pose]) -> PoseReadings:
    """Read every sensor in every pose; CalibrationError if one read nothing sound there.

    An axis scatters in all poses alike: its variances are pooled, so that a pose that was calm by luck does not weigh
    more. Means of counts that hardly scatter keep an error of rounding, ``exp(-4 pi^2 sd^2) / 12`` (the first harmonic
    of a rounding's bias under a normal scatter sd).
    """
    readings = [[read_pose(sensor, pose) for pose in poses] for sensor in sensors]

    def column(name: str) -> Floats:
        return np.array([[getattr(reading, name) for reading in row] for row in readings], float)

    rows = column("rows")[:, :, None]
    scatter = np.mean(rows * column("sem_lsb") ** 2, axis=1, keepdims=True)
    rounding = np.exp(-4 * np.pi**2 * np.mean(column("sd_lsb") ** 2, axis=1, keepdims=True)) / 12
    variance = scatter / rows + rounding
    return PoseReadings(
        tuple(sensors), tuple(poses), column("mean_lsb"), variance, column("change_lsb"), 2 * np.sqrt(variance)
    )
