"""Uncertainty of a triad's fit: covariance of its parameters, and readings that scatter more than their noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.errors import CalibrationError
from imuarray.log import SensorLog
from imuarray.units import READABLE

MORE_THAN_NOISE = 0.01
"""Significance level: residuals whose probability under noise alone is lower have another cause, such as a wandering
bias or a box that leaned."""

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
    """Fit readings (k, 3), with equal weights, to a design (k, p), response columns first, by least squares. Returns
    also the residuals (k, 3).

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
        excess = excess * [beyond_noise(float(each), freedom, 3) for each in chi_squared]
    p = design.shape[1]
    covariance = np.zeros((3 * p, 3 * p))
    for axis in range(3):
        place = slice(axis * p, (axis + 1) * p)
        covariance[place, place] = (solver * (variance[:, axis] + excess[axis])) @ solver.T
    return TriadFit(coefficients, covariance, float(chi_squared.sum()), 3.0 * freedom, np.sqrt(excess)), residual


def beyond_noise(chi_squared: float, freedom: float, among: int = 1) -> bool:
    """Return whether residuals are significantly larger than noise (`MORE_THAN_NOISE`), for the largest of `among`."""
    from scipy.special import chdtrc  # slow to import

    return freedom > 0.5 and float(chdtrc(freedom, chi_squared)) < MORE_THAN_NOISE / among


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
