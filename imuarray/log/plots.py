"""Plots of a log: every sensor over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from imuarray.arrays import Reals
from imuarray.figures import time_series_figure
from imuarray.log.datasets import physical_values

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from imuarray.calibrate import Calibration
    from imuarray.log.sensor_log import SensorLog

_SI = {"specific_force": "m/s²", "angular_rate": "rad/s", "magnetic_field": "T"}


def log_figure(sensors: Sequence[SensorLog], calibration: Calibration | None = None) -> Figure:
    """Draw a panel for each sensor that has rows: physical values in the box frame, or counts; MissingExtraError."""
    panels: dict[str, tuple[Reals, Reals]] = {}
    for sensor in sensors:
        if not len(sensor):
            continue
        time_s = np.asarray(sensor.time[:]) * 1e-9
        if sensor.has_compensated("pressure"):
            panels[f"{sensor.name} (Pa)"] = time_s, np.asarray(sensor.compensated("pressure")[:])
            continue
        values = physical_values(sensor, calibration) if sensor.is_triad else None
        unit = "counts" if values is None else _SI[sensor.quantity]
        panels[f"{sensor.name} ({unit})"] = time_s, np.asarray(sensor.counts[:], float) if values is None else values
    return time_series_figure(panels)
