"""How warm each sensor's element was: what its bias follows, where a calibration says how, and what a calibration that
was made at another temperature is worth.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from imuarray.calibrate import Calibration
from imuarray.calibrate.model import Described
from imuarray.calibrate.segments import Thermometer, thermometer_of
from imuarray.calibrate.stability import BIAS, Thermal
from imuarray.calibrate.thermal import SEGMENT_S
from imuarray.fuse.optimal.from_calibration import STEEP, USUAL
from imuarray.log import Log, SensorLog
from imuarray.units import READABLE

Floats = npt.NDArray[np.float64]

AWAY_DEGC = 5.0
"""A log whose temperature differs by more from that of a calibration is told of: a bias changes by more than a good
calibration leaves of it (2.5 mg by BMA-115's 0.5 mg per degC).
"""

SCALE_PER_DEGC = 1.6e-4
"""Standard deviation of what a scale factor changes by per degC, a share: 2 % over 125 degC (L3G-72)."""

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


@dataclass(frozen=True)
class Away:
    """How far a log is from where a sensor was calibrated: its temperature then and its mean one in the log (degC), the
    root mean square of the difference, and what the bias (3,) is uncertain by for each degree, in counts.
    """

    sensor: str
    calibrated_degc: float
    mean_degc: float
    rms_degc: float
    unsure_lsb_per_degc: Floats

    @property
    def bias_sd_lsb(self) -> Floats:
        """(3,) standard deviation of what the temperature does to the bias."""
        return self.rms_degc * self.unsure_lsb_per_degc


def away_from(log: Log, sensors: Iterable[SensorLog], calibration: Calibration) -> dict[str, Away]:
    """By sensor, of those whose bias was calibrated at a temperature that is known and that the log knows, too.

    A bias that follows the log's temperature is uncertain by the standard errors of its slopes; one that does not, by
    what such slopes usually are.
    """
    found: dict[str, Away] = {}
    shared: Thermometer | None = None
    for sensor in sensors:
        known = calibration.or_nominal(sensor)
        if known.temperature_degc is None or known.bias_sem_lsb is None:
            continue
        thermometer = shared or thermometer_of(log, sensor, SEGMENT_S)
        if thermometer is None or thermometer.kind == "relative":
            continue
        shared = thermometer if thermometer.kind in _OF_THE_BOX else None
        off = thermometer.degc - known.temperature_degc
        usual = [STEEP.get((sensor.chip, axis), USUAL[sensor.quantity].slope_per_degc) for axis in range(3)]
        unsure = np.array(usual) * known.lsb_per_si
        thermal = known.thermal
        if thermal is not None and thermal.thermometer != "relative":
            follows = np.array([meaning == BIAS for meaning in thermal.meaning])
            doubt = np.hypot(thermal.slope_lsb_per_degc, thermal.slope_sem_lsb_per_degc)
            unsure = np.where(follows, thermal.slope_sem_lsb_per_degc, doubt)
        mean, rms = known.temperature_degc + float(off.mean()), float(np.sqrt(np.mean(off**2)))
        found[sensor.name] = Away(sensor.name, known.temperature_degc, mean, rms, unsure)
    return found


def allowing_for(calibration: Calibration, away: Mapping[str, Away]) -> Calibration:
    """The calibration with covariances of bias and response that hold at the temperatures of a log."""
    sensors = dict(calibration.sensors)
    for name, each in away.items():
        known = sensors[name]
        bias = known.bias_covariance_lsb2
        if bias is None and known.bias_sem_lsb is not None:
            bias = np.diag(known.bias_sem_lsb**2)
        response = known.response_covariance()
        if response is not None:
            rows = known.response_lsb_per_unit
            scale = np.zeros((3, 3, 3, 3))
            for axis, row in enumerate(rows):
                scale[axis, :, axis] = (SCALE_PER_DEGC * each.rms_degc) ** 2 * np.outer(row, row)
            response = response + scale.reshape(9, 9)
        sensors[name] = replace(
            known,
            bias_covariance_lsb2=None if bias is None else bias + np.diag(each.bias_sd_lsb**2),
            response_covariance_lsb2_per_unit2=response,
        )
    return replace(calibration, sensors=sensors)


def away_sentences(calibration: Calibration, away: Mapping[str, Away]) -> Iterator[str]:
    """A line for all sensors that were calibrated at one temperature, if the log is far from it."""
    far = [each for each in away.values() if each.rms_degc > AWAY_DEGC]
    for calibrated_degc in sorted({round(each.calibrated_degc, 1) for each in far}):
        group = [each for each in far if round(each.calibrated_degc, 1) == calibrated_degc]
        most: dict[str, float] = {}
        for each in group:
            known = calibration.sensors[each.sensor]
            factor, unit = READABLE[known.unit]
            worst = factor * float((each.bias_sd_lsb / known.scale_lsb_per_unit).max())
            most[unit] = max(most.get(unit, 0.0), worst)
        names = ", ".join(each.sensor for each in group)
        sizes = " and ".join(f"{size:.2g} {unit}" for unit, size in most.items())
        yield (
            f"calibrated at {calibrated_degc:.1f} degC, this log is at {np.mean([e.mean_degc for e in group]):.1f}:"
            f" {names}; biases are sure to {sizes} only, which the covariances allow for"
        )
