"""Uncertainty of a triad's fit: covariance of its parameters, and readings that scatter more than their noise.

Outliers are poses and turns in which the box moved, or which no calibration explains together with the others. They are
excluded from the fit and reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.pose_readings import Pose, PoseReadings
from imuarray.errors import CalibrationError
from imuarray.log import SensorLog
from imuarray.units import READABLE

MORE_THAN_NOISE = 0.01
"""Significance level: residuals that are less probable than this under noise alone have another cause, for example a
wandering bias or a box that leaned.
"""

DRIFTS = 1e-3
"""Significance level of a drift term."""

_ENOUGH = 6.0
"""Least number of degrees of freedom for an estimate of an axis's own scatter."""


@dataclass(frozen=True)
class TriadFit:
    """Straight lines of one sensor: counts as a function of the direction of gravity and of other terms.

    `coefficients` (3, p): rows are sensor axes, columns the response to box X, Y, Z, the bias, and drift terms if any;
    `covariance` (3 p, 3 p) is theirs, row by row. `chi_squared` compares the residuals with the noise within poses
    alone and has `freedom` degrees. `repeatability_lsb` (3,) is the scatter of an axis from pose to pose beyond that
    noise; it is included in the covariance, and zero where it is not significant.
    """

    coefficients: Floats
    covariance: Floats
    chi_squared: float
    freedom: float
    repeatability_lsb: Floats

    @property
    def reduced_chi_squared(self) -> float:
        """About 1 if noise within poses explains the residuals; nan without degrees of freedom."""
        return self.chi_squared / self.freedom if self.freedom > 0.5 else float("nan")

    @property
    def bias_covariance_lsb2(self) -> Floats:
        """Covariance (3, 3) of the bias over the sensor axes."""
        places = 3 + self._width * np.arange(3)
        return np.asarray(self.covariance[np.ix_(places, places)])

    @property
    def bias_sem_lsb(self) -> Floats:
        """Standard errors (3,) of the bias."""
        return np.sqrt(np.diag(self.bias_covariance_lsb2))

    @property
    def response_covariance(self) -> Floats:
        """Covariance (9, 9) of the response's entries, row by row."""
        places = (self._width * np.arange(3)[:, None] + np.arange(3)).ravel()
        return np.asarray(self.covariance[np.ix_(places, places)])

    @property
    def response_sem(self) -> Floats:
        """Standard errors (3, 3) of the response's entries."""
        return np.sqrt(np.diag(self.covariance)).reshape(3, self._width)[:, :3]

    @property
    def _width(self) -> int:
        return int(self.coefficients.shape[1])


def straight_lines(mean: Floats, variance: Floats, design: Floats) -> tuple[TriadFit, Floats]:
    """Fit readings (k, 3), with equal weights, to a design (k, p), response columns first, by least squares. Return the
    fit and its residuals (k, 3).

    Scatter beyond the noise `variance` (k, 3) is estimated for each axis, or for the three axes together if there are
    too few readings.
    """
    solver = np.linalg.pinv(design)
    coefficients = (solver @ mean).T
    residual = mean - design @ coefficients.T
    remaining = 1 - np.einsum("kp,pk->k", design, solver)
    freedom = len(design) - int(np.linalg.matrix_rank(design))
    squares, expected = (residual**2).sum(axis=0), np.maximum(remaining @ variance, 1e-300)
    chi_squared = freedom * squares / expected
    excess = np.maximum(squares - expected, 0.0) / max(freedom, 1)
    if freedom < _ENOUGH:
        excess = np.full(3, excess.mean()) * beyond_noise(float(chi_squared.sum()), 3 * freedom)
    else:
        excess = excess * [beyond_noise(float(value), freedom, 3) for value in chi_squared]
    p = design.shape[1]
    covariance = np.zeros((3 * p, 3 * p))
    for axis in range(3):
        place = slice(axis * p, (axis + 1) * p)
        covariance[place, place] = (solver * (variance[:, axis] + excess[axis])) @ solver.T
    return TriadFit(coefficients, covariance, float(chi_squared.sum()), 3.0 * freedom, np.sqrt(excess)), residual


def beyond_noise(chi_squared: float, freedom: float, cases: int = 1) -> bool:
    """Return whether residuals are significantly larger than noise (`MORE_THAN_NOISE`), for the largest of `cases`."""
    from scipy.special import chdtrc  # slow to import

    return freedom > 0.5 and float(chdtrc(freedom, chi_squared)) < MORE_THAN_NOISE / cases


def refuse_imprecise(sensor: SensorLog, sem_lsb: Floats, most: Mapping[str, float], message: str) -> None:
    """Raise CalibrationError if a standard error (3,) in counts exceeds the limit `most` of the sensor's quantity (in
    its unit); `message` is formatted with the worst `axis`, its `sem` and the `unit` in which that is printed.
    """
    sem = sem_lsb / sensor.sensitivity
    worst = int(sem.argmax())
    if sem[worst] > most[sensor.quantity]:
        factor, unit = READABLE[sensor.unit]
        text = message.format(axis="xyz"[worst], sem=f"{factor * sem[worst]:.3g}", unit=unit)
        raise CalibrationError(f"{sensor.where}: {text}")


MOVED_G = 0.005
"""Change of gravity between the halves of a pose, in g, above which the box moved (0.3 degrees). Warm-up changes biases
by less than a fifth of it during a pose (1 mg in 90 minutes in the paper's Table 3, 0.3 mg in 20 s in a recording of
MPU-9150).
"""

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
    return {int(index): reason for run in series if run is not main for index in run}


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
    """Return the probability that `number` readings have a misfit at least as large by chance: the F test of a mean
    shift.

    `with_it` and `without` are the weighted sums of squares of a fit with these readings and of a fit without them,
    which has `freedom` degrees of freedom; 1.0 if it has none.
    """
    if freedom <= 0 or number <= 0:
        return 1.0
    ratio = max(with_it - without, 0.0) / number / max(without / freedom, 1e-300)
    from scipy.special import fdtrc  # slow to import

    return float(fdtrc(number, freedom, ratio))


def find_outlier(p_values: Sequence[float], sizes: Floats, smallest: float) -> int | None:
    """Return the index of the least probable pose or turn with an error of at least `smallest` (in the unit of
    `sizes`), if it is significant for this number of them; otherwise None.
    """
    candidates = np.where(sizes >= smallest, p_values, 1.0)
    index = int(candidates.argmin())
    return index if candidates[index] < FALSE_ALARM / len(candidates) else None
