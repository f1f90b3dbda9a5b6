"""The axes of an array: where each points in the box frame, where it sits, how far it reaches and how it scatters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imuarray.calibrate import Calibration
from imuarray.calibrate.model import Described
from imuarray.units import SI_PER_UNIT

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Axis:
    """One sensor axis: where it points in the box frame (unit vector) and what it is.

    `range_si` is the end of the measuring range and `noise_si` the standard deviation of a reading (None: unknown), in
    m/s2 or rad/s; `position_m` where the sensor sits in the box frame.
    """

    sensor: str
    chip: str
    index: int
    direction_box: tuple[float, float, float]
    range_si: float
    noise_si: float | None
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def in_plane(self) -> bool:
        """True for x and y, which lie in the plane of the silicon; z stands on it."""
        return self.index < 2

    @property
    def label(self) -> str:
        """Sensor and axis as people say it: "Gyro1 y"."""
        return f"{self.sensor} {'xyz'[self.index]}"


def axes_of(sensors: Sequence[Described], calibration: Calibration) -> list[Axis]:
    """Every axis of `sensors`, in order."""
    axes = []
    for sensor in sensors:
        known = calibration.of(sensor)
        x_m, y_m, z_m = (1e-3 * float(part) for part in sensor.position_mm)
        for index, direction in enumerate(known.directions_box):
            noise = None if known.noise_lsb is None else float(known.noise_lsb[index] / known.lsb_per_si[index])
            x, y, z = (float(part) for part in direction)
            range_si = sensor.range * SI_PER_UNIT[sensor.unit]
            axes.append(Axis(sensor.name, sensor.chip, index, (x, y, z), range_si, noise, (x_m, y_m, z_m)))
    return axes


def directions(axes: Sequence[Axis]) -> Floats:
    """(m, 3) unit vectors of the axes in the box frame: values = directions @ truth_box + errors."""
    return np.array([axis.direction_box for axis in axes])
