"""How warm each sensor's element was: what its bias follows, where a calibration says how."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from imuarray.calibrate import Calibration
from imuarray.calibrate.model import Described
from imuarray.calibrate.segments import Thermometer, thermometer_of
from imuarray.calibrate.stability import BIAS, Thermal
from imuarray.calibrate.thermal import SEGMENT_S
from imuarray.log import Log, SensorLog

_OF_THE_BOX = ("barometer", "reference")


def slopes_of(calibration: Calibration, sensor: Described) -> Thermal | None:
    """The slopes of a sensor's bias; None where none were measured, or none of its axes is known to be one of bias."""
    thermal = calibration.or_nominal(sensor).thermal
    return thermal if thermal is not None and BIAS in thermal.meaning else None


def element_temperatures(
    log: Log, sensors: Iterable[SensorLog], calibration: Calibration, *, of_all: bool = False
) -> dict[str, Thermometer]:
    """The temperature that the bias of each sensor follows, behind its lag, by sensor: one row for 5 s, or longer.

    Read as `calibrate thermal` reads it: barometer, `/reference`, the chip's own thermometer, that of another chip.
    Without the sensors whose bias has no slopes, and those that have none of these here; slopes over a thermometer
    without a zero go with no other kind, and slopes over another not with it. `of_all`: of sensors without slopes too,
    without a lag.
    """
    found: dict[str, Thermometer] = {}
    shared: Thermometer | None = None
    for sensor in sensors:
        thermal = slopes_of(calibration, sensor)
        if of_all or thermal is not None:
            thermometer = shared or thermometer_of(log, sensor, SEGMENT_S)
            if thermometer is not None and thermometer.kind in _OF_THE_BOX:
                shared = thermometer
            if thermometer is not None and goes_with(thermometer.kind, thermal):
                found[sensor.name] = thermometer if thermal is None else _behind(thermometer, thermal)
    return found


def goes_with(kind: str, thermal: Thermal | None) -> bool:
    """Whether slopes can be taken over a thermometer of a kind: both have a zero, or neither has. Slopes that nobody
    measured want one that compares with the temperature of the bias.
    """
    return (kind == "relative") == (thermal is not None and thermal.thermometer == "relative")


def _behind(thermometer: Thermometer, thermal: Thermal) -> Thermometer:
    """The thermometer behind the lag of the slopes, unless their interval holds no lag at all."""
    lag_s = thermal.significant_lag_s
    if lag_s == 0:
        return thermometer
    lagged = thermometer.lagged(thermometer.time_s, [lag_s])[:, 0]
    return replace(thermometer, degc=np.asarray(lagged))
