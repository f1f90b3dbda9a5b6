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
"""Residuals that noise alone makes so large less often than this are no noise: a bias wandered or the box did not
stand as it was said to. Below, what looks like more is taken for luck."""

DRIFTS = 1e-3
"""Drift terms that fit so much better by chance less often than this are real."""

_ENOUGH = 6.0
"""The number of degrees of freedom from which an axis's own scatter is used."""


@dataclass(frozen=True)
class TriadFit:
    """One sensor's straight lines, counts on directions of gravity and other terms.

    `coefficients` (3, p): rows sensor axes, columns the response to box X, Y, Z, the bias, and drift terms if any;
    `covariance` (3 p, 3 p) over them row by row. `chi_squared` of the residuals by the noise within poses alone, with
    `freedom` degrees; `repeatability_lsb` (3,): what readings of one axis scatter beyond that noise from pose to pose,
    which is in the covariance; zero where nothing says so.
    """

    coefficients: Floats
    covariance: Floats
    chi_squared: float
    freedom: float
    repeatability_lsb: Floats

    @property
    def reduced_chi_squared(self) -> float:
        """About 1 if noise within poses explains the residuals; nan if nothing is left to tell."""
        return self.chi_squared / self.freedom if self.freedom > 0.5 else float("nan")

    @property
    def bias_covariance_lsb2(self) -> Floats:
        """(3, 3) over the sensor axes."""
        places = 3 + self._width * np.arange(3)
        return np.asarray(self.covariance[np.ix_(places, places)])

    @property
    def bias_sem_lsb(self) -> Floats:
        """(3,)."""
        return np.sqrt(np.diag(self.bias_covariance_lsb2))

    @property
    def response_covariance(self) -> Floats:
        """(9, 9) over the response's entries, row by row."""
        places = (self._width * np.arange(3)[:, None] + np.arange(3)).ravel()
        return np.asarray(self.covariance[np.ix_(places, places)])

    @property
    def response_sem(self) -> Floats:
        """(3, 3) standard errors of the response's entries."""
        return np.sqrt(np.diag(self.covariance)).reshape(3, self._width)[:, :3]

    @property
    def _width(self) -> int:
        return int(self.coefficients.shape[1])


def straight_lines(mean: Floats, variance: Floats, design: Floats) -> tuple[TriadFit, Floats]:
    """Least squares of readings (k, 3), each as heavy as the next, on a design (k, p), response columns first; and the
    residuals (k, 3).

    Scatter beyond the noise `variance` (k, 3) is each axis's own, or pooled over the three where one has too few
    readings to tell.
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
    """Return whether residuals are larger than noise makes them in one of a hundred cases, if the largest of `among` is
    tested.
    """
    from scipy.special import chdtrc  # its weight is for those who ask

    return freedom > 0.5 and float(chdtrc(freedom, chi_squared)) < MORE_THAN_NOISE / among


def refuse_imprecise(sensor: SensorLog, sem_lsb: Floats, most: Mapping[str, float], message: str) -> None:
    """CalibrationError if a standard error (3,) in counts exceeds the limit `most` of the sensor's quantity (in its
    unit); `message` gets the worst `axis`, its `sem` and the `unit` in which people read it.
    """
    sem = sem_lsb / sensor.sensitivity
    worst = int(sem.argmax())
    if sem[worst] > most[sensor.quantity]:
        factor, unit = READABLE[sensor.unit]
        text = message.format(axis="xyz"[worst], sem=f"{factor * sem[worst]:.3g}", unit=unit)
        raise CalibrationError(f"{sensor.where}: {text}")
