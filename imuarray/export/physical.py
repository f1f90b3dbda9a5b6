"""Counts as physical values: specific force, angular rate and magnetic flux density in the box frame, degrees, pascals.

A calibration's bias follows the temperature recorded in the log, where the calibration has slopes, as in fusion. Its
other corrections (g-sensitivity, the state in which a gyroscope came up) are not applied.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.segments import Thermometer, degc_of, has_zero
from imuarray.errors import LogError
from imuarray.export.tables import Column
from imuarray.fuse.element_temperature import element_temperatures
from imuarray.log import Log, SensorLog
from imuarray.log.format import ARRIVAL
from imuarray.units import SI_NAME, SI_PER_UNIT

_AXES = ("x", "y", "z")


def warmth(log: Log, calibration: Calibration) -> dict[str, Thermometer]:
    """The temperature that the bias of each sensor follows, of those whose slopes are known."""
    inertial = [*log.of("specific_force"), *log.of("angular_rate")]
    return element_temperatures(log, (sensor for sensor in inertial if len(sensor)), calibration)


def physical_columns(
    sensor: SensorLog, calibration: Calibration, units: str, warm: Mapping[str, Thermometer]
) -> tuple[Column, ...]:
    """The columns of a sensor, but for time and status, in `units` ("si" or "sensor"); CalibrationError if what is
    known does not fit, or nothing is. Counts stay where there is no way to a unit.
    """
    if sensor.is_triad:
        return (_triad(sensor, calibration.or_nominal(sensor), units, warm.get(sensor.name)), *_temperature(sensor))
    return compensated_columns(sensor)


def compensated_columns(sensor: SensorLog) -> tuple[Column, ...]:
    """Return the columns beside counts that have units of their own, if the log has them: what a barometer's
    calibration words made of them, how late a row arrived.
    """
    columns = []
    for name, unit in (("temperature", "degC"), ("pressure", "Pa"), (ARRIVAL, "s")):
        with suppress(LogError):
            columns.append(Column(name, "<f8", unit, (), _numbers(sensor.compensated(name))))
    return tuple(columns)


def _triad(sensor: SensorLog, known: SensorCalibration, units: str, warm: Thermometer | None) -> Column:
    scale = 1.0 if units == "si" else 1 / SI_PER_UNIT[sensor.unit]

    def read(rows: slice) -> npt.NDArray[np.float64]:
        counts = np.asarray(sensor.counts[rows], float)
        if warm is not None:
            counts -= known.bias_at(warm.at(np.asarray(sensor.time[rows]) * 1e-9)) - known.bias_lsb
        return known.stimulus_box(counts) * scale

    return Column(sensor.quantity, "<f8", SI_NAME[sensor.unit] if units == "si" else sensor.unit, _AXES, read)


def _temperature(sensor: SensorLog) -> tuple[Column, ...]:
    """The chip's own thermometer in degC, or its counts if it has no zero."""
    column = sensor.temperature_counts
    if column is None:
        return ()
    degc = degc_of(sensor)
    if degc is None or not has_zero(sensor):
        return (Column("temperature_counts", "<i2", "counts", (), lambda rows: np.asarray(column[rows])),)
    zero, step = degc
    return (Column("temperature", "<f8", "degC", (), lambda rows: zero + step * np.asarray(column[rows], float)),)


def _numbers(column: Any) -> Callable[[slice], npt.NDArray[np.float64]]:
    return lambda rows: np.asarray(column[rows], float)
