"""`calibrate thermal`: counts against temperature, with drift and thermal lag allowed for; what the slope of an axis
that carries 1 g is, where that can be told; and what opposing axes cancel.

A slope of an axis that carries g gs of gravity is ``bias slope + g * sensitivity * scale slope``. One orientation gives
one such equation and two unknowns (section 5.2.5 of the paper); logs of opposite faces give both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from imuarray.axes import UP_AXES, up_vector
from imuarray.calibrate.model import Calibration, SensorCalibration, nominal
from imuarray.calibrate.motion import refuse_motion
from imuarray.calibrate.opposed import OpposedSlopes, opposed_slopes
from imuarray.calibrate.segments import Thermometer, segment_means, thermometer_of
from imuarray.calibrate.stability import BIAS, BIAS_OR_SCALE, Thermal
from imuarray.calibrate.thermal_fit import AxesFit, fit_axes
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog
from imuarray.units import INERTIAL, READABLE

Floats = npt.NDArray[np.float64]

SEGMENT_S = 5.0

CARRIES_G = 0.5
"""An axis with more gravity along it than this carries it; slopes at gravities that differ by more tell bias from
scale."""

_FEWEST_SEGMENTS = 20

UNTOLD_PER_DEGC: Mapping[str, float] = MappingProxyType({"specific_force": 0.01, "angular_rate": 0.5})
"""Standard error of a slope per degC, by quantity in its unit, from which on nothing was measured: ten times what data
sheets promise of the slope itself (ADX-62, BMA-115, L3G-71).
"""
_LEAST_CHANGE_DEGC = 2.0
_LEAST_BEND = 0.05


@dataclass(frozen=True)
class Heating:
    """One sensor in one log: the fit of its axes, the thermometer's kind and span (coldest, warmest, degC), and the
    gravity (3,) in g along its axes.
    """

    sensor: str
    log: str
    thermometer: str
    span_degc: tuple[float, float]
    gravity_g: Floats
    fit: AxesFit

    @property
    def carries_gravity(self) -> tuple[bool, ...]:
        """For each axis, whether more than half a g lay along it."""
        return tuple((np.abs(self.gravity_g) > CARRIES_G).tolist())


@dataclass(frozen=True)
class ThermalResult:
    """What was found: the calibration (with nothing in it but `thermal`), every sensor in every log, and the pairs."""

    calibration: Calibration
    heatings: tuple[Heating, ...]
    pairs: tuple[OpposedSlopes, ...]


def calibrate_thermal(*logs: Log, segment_s: float = SEGMENT_S) -> ThermalResult:
    """Slopes of every inertial sensor of one log, or of several of the same array in different orientations.

    The box stands still in a log; what it does in a phase called `motion` is left out. CalibrationError says which log
    has no thermometer, is too short, or hardly changed its temperature, and which was not of one orientation.
    """
    first = logs[0]
    sensors = [sensor for sensor in first.sensors.values() if sensor.quantity in INERTIAL and len(sensor)]
    if not sensors:
        raise CalibrationError(f"{first.path}: no inertial sensor in it")
    for log in logs:
        _refuse_moving(log)
    ups = [up_of(log, segment_s) for log in logs]
    found = {sensor.name: _heatings(sensor, logs, ups, segment_s) for sensor in sensors}
    fitted = {sensor.name: _combined(sensor, found[sensor.name]) for sensor in sensors}
    for sensor in sensors:
        _refuse_unknown(sensor, fitted[sensor.name].thermal)
    return ThermalResult(
        Calibration(fitted, tuple(str(log.path) for log in logs)).stamped(logs),
        tuple(heating for each in found.values() for heating in each),
        tuple(opposed_slopes(sensors, fitted)),
    )


def _refuse_moving(log: Log) -> None:
    """CalibrationError for a log in which the box moved outside the phases `motion`."""
    times = [(int(sensor.time[0]), int(sensor.time[len(sensor) - 1])) for sensor in log.sensors.values() if len(sensor)]
    if times:
        whole = ("", min(times)[0], max(end for _, end in times))
        refuse_motion(log, [whole], [phase for phase in log.phases if phase.name == "motion"])


def _refuse_unknown(sensor: SensorLog, thermal: Thermal | None) -> None:
    """CalibrationError for slopes that the logs don't tell."""
    if thermal is None:
        return
    per_degc = thermal.slope_sem_lsb_per_degc / sensor.sensitivity
    worst = int(per_degc.argmax())
    if per_degc[worst] > UNTOLD_PER_DEGC[sensor.quantity]:
        factor, unit = READABLE[sensor.unit]
        raise CalibrationError(
            f"{sensor.where}: these logs tell the slope of its axis {'xyz'[worst]} to no better than"
            f" {factor * per_degc[worst]:.3g} {unit}/degC: what else changes, or drifts, is larger"
        )


def up_of(log: Log, segment_s: float = SEGMENT_S) -> Floats | None:
    """The unit vector (3,) in the box frame that pointed up in a log: what its phases say, else what its
    accelerometers felt; None without either. CalibrationError if the phases name several.
    """
    named = {phase.up for phase in log.phases if phase.up}
    if len(named) > 1 or not named <= set(UP_AXES):
        raise CalibrationError(
            f"{log.path}: its phases say up {', '.join(sorted(named))}; one orientation a log is wanted"
        )
    if named:
        return np.array(up_vector(named.pop()))
    felt = [
        sensor.orientation @ segment_means(sensor, segment_s).mean.mean(axis=0) / sensor.sensitivity
        for sensor in log.of("specific_force")
        if len(sensor) and sensor.sensitivity > 0
    ]
    mean = np.sum(felt, axis=0) if felt else np.zeros(3)
    return np.asarray(mean / np.linalg.norm(mean)) if mean.any() else None


def _heatings(sensor: SensorLog, logs: Sequence[Log], ups: Sequence[Floats | None], segment_s: float) -> list[Heating]:
    """The sensor in every log, all about the middle of the first one's temperatures: a parabola's slope there is the
    mean one over them, wherever the box spent most of its time.
    """
    found: list[Heating] = []
    for log, up in zip(logs, ups, strict=True):
        here = log[sensor.name]
        if (here.range, here.axes, here.sensitivity) != (sensor.range, sensor.axes, sensor.sensitivity):
            raise CalibrationError(f"{here.where}: another range or other axes than in {sensor.where}")
        thermometer = thermometer_of(log, here, segment_s)
        if thermometer is None:
            raise CalibrationError(f"{here.where}: no thermometer: no barometer, no reference, and none in the chips")
        if found and thermometer.kind != found[0].thermometer:
            raise CalibrationError(f"{here.where}: another thermometer than in {sensor.where}")
        reference = (
            found[0].fit.reference_degc
            if found
            else round(float(thermometer.degc.min() + thermometer.degc.max()) / 2, 2)
        )
        found.append(_heating(here, log, up, thermometer, reference, segment_s))
    return found


def _heating(
    sensor: SensorLog, log: Log, up: Floats | None, thermometer: Thermometer, reference_degc: float, segment_s: float
) -> Heating:
    """Fit one sensor of one log; CalibrationError if there is too little to fit."""
    segments = segment_means(sensor, segment_s, [phase for phase in log.phases if phase.name == "motion"])
    if len(segments.time_s) < _FEWEST_SEGMENTS:
        raise CalibrationError(
            f"{sensor.where}: {len(segments.time_s)} segments of {segment_s:g} s; {_FEWEST_SEGMENTS} are wanted"
        )
    degc = thermometer.at(segments.time_s)
    span = (float(degc.min()), float(degc.max()))
    if span[1] - span[0] < _LEAST_CHANGE_DEGC:
        raise CalibrationError(
            f"{sensor.where}: the temperature changed by {np.ptp(degc):.1f} degC; {_LEAST_CHANGE_DEGC:g} are wanted"
        )
    steady = np.polynomial.Polynomial.fit(segments.time_s, degc, 1)(segments.time_s)
    if np.std(degc - steady) < _LEAST_BEND * np.std(degc):
        raise CalibrationError(f"{sensor.where}: the temperature changed so steadily that its effect could be drift")
    gravity = np.zeros(3) if up is None else np.asarray(sensor.orientation.T @ up)
    fit = fit_axes(segments, thermometer, reference_degc)
    return Heating(sensor.name, str(log.path), thermometer.kind, span, gravity, fit)


def _combined(sensor: SensorLog, heatings: Sequence[Heating]) -> SensorCalibration:
    """One sensor's slopes from all its heatings; the lag of the one that knows it best."""
    slopes, sems = (
        np.array([getattr(h.fit, f"slope_{name}") for h in heatings]) for name in ("lsb_per_degc", "sem_lsb_per_degc")
    )
    curves, curve_sems = (
        np.array([getattr(h.fit, f"quadratic_{name}") for h in heatings])
        for name in ("lsb_per_degc2", "sem_lsb_per_degc2")
    )
    curve_sem = np.sqrt(np.sum(curve_sems**2, axis=0)) / len(heatings)
    gravity = np.array([heating.gravity_g for heating in heatings])
    feels = sensor.quantity == "specific_force"
    axes = [_axis(slopes[:, k], sems[:, k], gravity[:, k] * feels, sensor.sensitivity) for k in range(3)]
    bias, bias_sem, scale, scale_sem = np.array([values for values, _ in axes]).T
    sharpest = min(heatings, key=lambda heating: float(np.diff(np.log(heating.fit.lag_interval_s + 1.0))[0]))
    thermal = Thermal(
        slope_lsb_per_degc=bias,
        slope_sem_lsb_per_degc=bias_sem,
        reference_degc=heatings[0].fit.reference_degc,
        meaning=tuple(meaning for _, meaning in axes),
        thermometer=heatings[0].thermometer,
        lag_s=sharpest.fit.lag_s,
        lag_interval_s=sharpest.fit.lag_interval_s,
        quadratic_lsb_per_degc2=np.mean(curves, axis=0) if curves.any() else None,
        scale_slope_per_degc=scale if np.isfinite(scale).any() else None,
        scale_slope_sem_per_degc=scale_sem if np.isfinite(scale).any() else None,
        quadratic_sem_lsb_per_degc2=curve_sem if np.isfinite(curve_sem).all() else None,
    )
    return replace(nominal(sensor), thermal=thermal)


def _axis(slopes: Floats, sems: Floats, gravity_g: Floats, sensitivity: float) -> tuple[tuple[float, ...], str]:
    """(slope, its standard error, scale slope as a share, its standard error) of one axis from its slopes (n,) at n
    gravities, nan for a scale slope that can't be told; and what the slope means.

    Weighted least squares; slopes that scatter more than their standard errors say make these larger.
    """
    apart = float(np.ptp(gravity_g)) > CARRIES_G
    sems = np.maximum(sems, 1e-12)  # counts that never moved
    design = np.column_stack([np.ones(len(slopes)), gravity_g])[:, : 2 if apart else 1]
    weighted = design / sems[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    values = covariance @ weighted.T @ (slopes / sems)
    freedom = len(slopes) - design.shape[1]
    excess = float(np.sum(((slopes - design @ values) / sems) ** 2)) / freedom if freedom else 1.0
    errors = np.sqrt(np.diag(covariance) * max(1.0, excess))
    if apart:
        return (values[0], errors[0], values[1] / sensitivity, errors[1] / sensitivity), BIAS
    meaning = BIAS_OR_SCALE if np.abs(gravity_g).max() > CARRIES_G else BIAS
    return (values[0], errors[0], np.nan, np.nan), meaning
