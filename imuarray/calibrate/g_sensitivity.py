"""Bias and g-sensitivity of gyroscopes from any static poses (the method of the paper's Table 4, the whole matrix).

The model is ``mean counts = g_sensitivity @ up + bias (+ drift)``, with the directions of gravity from the
accelerometers. The paper's caveat holds: a change of the bias from pose to pose, by temperature above all, looks like
g-sensitivity. A steady drift is part of the fit where it is significant, and the residuals raise the standard errors.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.disturbed import chance_of_misfit
from imuarray.calibrate.fits import DRIFTS, TriadFit, straight_lines
from imuarray.calibrate.model import SensorCalibration, nominal
from imuarray.calibrate.pose_readings import Pose, PoseReadings, read_poses
from imuarray.log import SensorLog

_MOST_DRIFT = 2


def fit_g_sensitivity(
    sensor: SensorLog, poses: tuple[Pose, ...], up_box: Floats
) -> tuple[SensorCalibration, TriadFit, Floats]:
    """One gyroscope from its readings in `poses` (k), in which `up_box` (k, 3) pointed up: its calibration with the
    mean bias over the poses, the fit, and the drift (3,) in counts, first pose less last.
    """
    readings = read_poses([sensor], poses)
    fit, terms = _fit(readings, up_box)
    fitted = replace(
        nominal(sensor),
        bias_lsb=fit.coefficients[:, 3],
        bias_sem_lsb=fit.bias_sem_lsb,
        bias_covariance_lsb2=fit.bias_covariance_lsb2,
        g_sensitivity_lsb_per_g=fit.coefficients[:, :3],
        g_sensitivity_sem_lsb_per_g=fit.response_sem,
    )
    return fitted, fit, fit.coefficients[:, 3:] @ (terms[0] - terms[-1])


def _fit(readings: PoseReadings, up_box: Floats) -> tuple[TriadFit, Floats]:
    """Straight lines with as many powers of time as fit better beyond chance, and those terms (k, q)."""
    powers = readings.powers_of_time(_MOST_DRIFT)
    fits = [_line(readings, up_box, powers[:, :count]) for count in range(1, powers.shape[1] + 1)]
    used = 0
    for (_, squares), (better, fewer) in pairwise(fits):
        if chance_of_misfit(squares, fewer, 3, int(better.freedom)) > DRIFTS:
            break
        used += 1
    return fits[used][0], powers[:, : used + 1]


def _line(readings: PoseReadings, up_box: Floats, terms: Floats) -> tuple[TriadFit, float]:
    """One fit and its weighted squares."""
    fit, residual = straight_lines(readings.mean_lsb[0], readings.variance_lsb2[0], np.column_stack([up_box, terms]))
    return fit, float((residual**2 / readings.variance_lsb2[0]).sum())
