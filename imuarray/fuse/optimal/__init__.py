"""The estimator of the whole array: one error model, whose slow errors a Kalman filter and smoother estimate."""

from __future__ import annotations

from imuarray.fuse.optimal.optimal import SEGMENT_S, Optimal, Temperatures
from imuarray.fuse.optimal.prior import AxisErrors, DesignErrors, ErrorModel, error_model
from imuarray.fuse.pipeline import LearnedBias

__all__ = [
    "SEGMENT_S",
    "AxisErrors",
    "DesignErrors",
    "ErrorModel",
    "LearnedBias",
    "Optimal",
    "Temperatures",
    "error_model",
]
