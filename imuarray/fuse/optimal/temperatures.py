"""How warm the sensors were: those whose slopes are known, and those whose slopes are left to be found out."""

from __future__ import annotations

from collections.abc import Sequence

from imuarray.calibrate import Calibration
from imuarray.calibrate.segments import Thermometer, thermometer_of
from imuarray.calibrate.thermal import SEGMENT_S
from imuarray.fuse.thermal import element_temperatures, slopes_of
from imuarray.log import Log, SensorLog


def temperatures(log: Log, sensors: Sequence[SensorLog], calibration: Calibration) -> dict[str, Thermometer]:
    """By sensor: what its bias follows where slopes are known (see `element_temperatures`), else the best thermometer
    of the log, unless that has no zero and compares with no other's. Sensors without either are not in it.
    """
    found = element_temperatures(log, sensors, calibration)
    for sensor in sensors:
        if slopes_of(calibration, sensor) is None:
            thermometer = thermometer_of(log, sensor, SEGMENT_S)
            if thermometer is not None and thermometer.kind != "relative":
                found[sensor.name] = thermometer
    return found
