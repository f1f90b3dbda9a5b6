"""Prior error model of an array, by which `Optimal` weights its readings: standard deviations of every error.

A reading of axis i of a sensor, along that axis, in SI::

    y = (s + d) . u + bias + drift + c + (slope + common slope) (T - T_bias) + noise

u is the specific force or angular rate at the sensor's position, s the axis's calibrated direction and d its error:
scale along s, misalignment perpendicular to it. c and the common slope belong to a design: all its sensors share them
along the same own axis, whatever its direction in the box (paper, section 2.1).

`error_model` takes the standard deviations from a calibration, or, where the calibration has none, typical ones. The
typical figures are those of the paper's array, consumer sensors of 2013: standard deviations over its units, as
`configs/models/martin2013.toml` derives them from the paper's tables. A figure that grows with a unit's noise (which is
larger for a larger measuring range) is given relative to the noise of its readings.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.model import BIAS, SensorDescription, TurnOn
from imuarray.calibrate.turns import TOLERANCE
from imuarray.errors import FusionError
from imuarray.fuse.frames import Axis
from imuarray.fuse.response_change import response_shares
from imuarray.units import STANDARD_GRAVITY


@dataclass(frozen=True)
class AxisErrors:
    """Standard deviations of one axis's errors, in m/s2 or rad/s.

    `noise` of a single reading and its `correlation` with the next one; `bias`: the constant error after calibration,
    including changes since; `drift`: a first-order Gauss-Markov process of `drift_time_constant_s` (infinite: a
    constant); `slope_per_degc` with respect to `bias_degc`, the temperature at which the bias is valid (None: the first
    known temperature); `response`: of each component of d, relative; `timing_s` of the time of a reading.
    `shares_wander`, `shares_slope`: whether it has the common errors of its design (`DesignErrors`).
    """

    noise: float
    correlation: float = 0.0
    bias: float = 0.0
    drift: float = 0.0
    drift_time_constant_s: float = 600.0
    slope_per_degc: float = 0.0
    response: float = 0.0
    bias_degc: float | None = None
    timing_s: float = 0.0
    shares_wander: bool = True
    shares_slope: bool = True

    def __post_init__(self) -> None:
        """FusionError for impossible values."""
        spreads = (self.bias, self.drift, self.slope_per_degc, self.response, self.timing_s)
        if not (0 < self.noise < np.inf and all(0 <= spread < np.inf for spread in spreads)):
            raise FusionError(f"error model: noise {self.noise:g}, spreads {spreads}: positive and finite are required")
        if not (abs(self.correlation) < 1 and self.drift_time_constant_s > 0):
            raise FusionError(
                f"error model: correlation {self.correlation:g}, time constant {self.drift_time_constant_s:g} s: within"
                " -1 to 1, and positive, are required"
            )

    @property
    def noise_of_means(self) -> float:
        """Standard deviation of white noise with the same variance of means over many readings: first-order correlation
        r increases that variance by (1 + r) / (1 - r).
        """
        return float(self.noise * np.sqrt((1 + self.correlation) / (1 - self.correlation)))


@dataclass(frozen=True)
class DesignErrors:
    """Standard deviations of the errors that the sensors of one design share along one of their own axes.

    `common`: a Gauss-Markov process of `common_time_constant_s` (infinite: a constant); `slope_per_degc`.
    """

    common: float = 0.0
    common_time_constant_s: float = 600.0
    slope_per_degc: float = 0.0

    def __post_init__(self) -> None:
        """FusionError for impossible values."""
        if not (0 <= self.common < np.inf and 0 <= self.slope_per_degc < np.inf and self.common_time_constant_s > 0):
            raise FusionError(f"error model: {self}: spreads of at least 0 and a positive time constant are required")


@dataclass(frozen=True)
class ErrorModel:
    """The errors of every axis, by sensor and index of the axis, and of every design, by chip and index.

    `bias_covariances` (3, 3), by sensor, are added to the axes' own `bias`: the joint covariance of the three axes
    after calibration. `response_covariances` (9, 9), by sensor, row by row, replace the axes' own `response`.
    """

    axes: Mapping[tuple[str, int], AxisErrors]
    designs: Mapping[tuple[str, int], DesignErrors] = field(default_factory=lambda: MappingProxyType({}))
    bias_covariances: Mapping[str, Floats] = field(default_factory=lambda: MappingProxyType({}))
    response_covariances: Mapping[str, Floats] = field(default_factory=lambda: MappingProxyType({}))

    def of(self, axes: Sequence[Axis]) -> list[AxisErrors]:
        """Return the errors of these axes, in order; FusionError for an axis that is not in the model."""
        for axis in axes:
            if (axis.sensor, axis.index) not in self.axes:
                raise FusionError(f"sensor {axis.sensor} axis {'xyz'[axis.index]}: it is not in the error model")
        return [self.axes[axis.sensor, axis.index] for axis in axes]


_DPS = np.pi / 180


@dataclass(frozen=True)
class DesignDefaults:
    """Typical standard deviations in SI, or relative to the noise of a reading (`turn_on_share`, `drift_share`);
    `common_share` is the share of a slope's variance that the same axes of a design have in common; `g_sensitivity` is
    the effect of 1 g on a gyroscope.
    """

    bias: float
    slope_per_degc: float
    turn_on_share: float
    drift_share: float
    response: float
    common_share: float
    g_sensitivity: float = 0.0


USUAL: Mapping[str, DesignDefaults] = MappingProxyType(
    {
        # bias: of BMA180s; slopes: Table 8; turn-on: Table 11, deviation of the runs' means over that of readings;
        # drift: the same of the uninterrupted run, less the means' own noise
        "specific_force": DesignDefaults(0.125 * STANDARD_GRAVITY, 5e-4 * STANDARD_GRAVITY, 0.033, 0.02, 0.03, 0.5),
        "angular_rate": DesignDefaults(0.84 * _DPS, 0.022 * _DPS, 0.17, 0.04, TOLERANCE, 0.8, 0.0083 * _DPS),
    }
)
"""Keyed by quantity. Response: of accelerometers Table 10's misalignments, 2 degrees, and half of that of its scales;
of gyroscopes L3G-72, and as much of misalignment. G-sensitivity: Table 4. Common shares: in Table 8 that of the
gyroscopes is 1.0 along y, 0.6 along x, and 0 along z. The error of the paper's array with the best weights is least if
the slopes are assumed common; with 0.8 it is 2 % larger, with 0.5, the mean of the three axes, 8 % larger.
"""

STEEP: Mapping[tuple[str, int], float] = MappingProxyType({("adxl345", 2): 1.2e-3 * STANDARD_GRAVITY})
"""Slopes per degC of axes, by chip and index, that differ from the typical ones: ADX-62, and Table 8."""

DRIFT_TIME_CONSTANT_S = 600.0
"""Time constant of drift if it was not measured; the paper's tables give it within a factor of ten only."""

TIMING_S = 0.5e-3
"""Standard deviation of the times of readings of a chip whose rate is unknown."""

_AGE = 1 / np.sqrt(12)
"""Standard deviation, in periods of a chip's own rate, of the age of a reading at an arbitrary time; its mean is
corrected.
"""

UNWATCHED_DEGC = 3.0
"""Standard deviation, within `UNWATCHED_S`, of a temperature without a thermometer."""

UNWATCHED_S = 1000.0


def error_model(
    sensors: Sequence[SensorDescription], calibration: Calibration, *, watched: Container[str] | None = None
) -> ErrorModel:
    """Return the errors of the inertial `sensors` of a log after `calibration`.

    `watched` are the sensors with a known temperature (None: all); for others, the effect of slopes becomes drift.
    FusionError for a sensor whose noise is not known.
    """
    axes: dict[tuple[str, int], AxisErrors] = {}
    designs: dict[tuple[str, int], DesignErrors] = {}
    covariances: dict[str, Floats] = {}
    responses: dict[str, Floats] = {}
    for sensor in sensors:
        parameters, has_temperature = calibration.or_nominal(sensor), watched is None or sensor.name in watched
        usual = USUAL[sensor.quantity]
        slopes = np.array([STEEP.get((sensor.chip, index), usual.slope_per_degc) for index in range(3)])
        timing_s = _AGE / sensor.rate_hz if sensor.rate_hz > 0 else TIMING_S
        own_slopes = slopes * np.sqrt(1 - usual.common_share)
        for index, errors in enumerate(_sensor_errors(parameters, usual, own_slopes, has_temperature)):
            wander = 0.0 if parameters.drift is not None else usual.drift_share * errors.noise
            slope = 0.0 if parameters.thermal is not None else float(slopes[index] * np.sqrt(usual.common_share))
            shared = _design_errors(wander, slope, has_temperature)
            axes[sensor.name, index] = replace(
                errors,
                timing_s=timing_s,
                shares_wander=shared.common > 0,
                shares_slope=shared.slope_per_degc > 0,
            )
            place = (sensor.chip, index)
            designs[place] = _common_errors(designs[place], shared) if place in designs else shared
        if parameters.bias_covariance_lsb2 is not None:
            covariances[sensor.name] = parameters.bias_covariance_lsb2 / np.outer(
                parameters.lsb_per_si, parameters.lsb_per_si
            )
        shares = response_shares(parameters)
        if shares is not None:
            responses[sensor.name] = shares
    return ErrorModel(
        MappingProxyType(axes), MappingProxyType(designs), MappingProxyType(covariances), MappingProxyType(responses)
    )


def _design_errors(wander: float, slope: float, has_temperature: bool) -> DesignErrors:
    """Return the common errors of a design, which are not measured: the common wander is assumed as large as that of a
    single unit. Measured errors of a unit include the common ones, and nothing is added.
    """
    if has_temperature:
        return DesignErrors(wander, DRIFT_TIME_CONSTANT_S, slope)
    return DesignErrors(float(np.hypot(wander, UNWATCHED_DEGC * slope)), UNWATCHED_S)


def _common_errors(first: DesignErrors, second: DesignErrors) -> DesignErrors:
    """Return the common errors of two units: the smaller wander above zero, and the steeper slope."""
    wandering = [design for design in (first, second) if design.common > 0] or [first]
    slope = max(first.slope_per_degc, second.slope_per_degc)
    return replace(min(wandering, key=lambda design: design.common), slope_per_degc=slope)


def _sensor_errors(
    parameters: SensorCalibration, usual: DesignDefaults, slopes_per_degc: Floats, has_temperature: bool
) -> list[AxisErrors]:
    """Return the errors of the three axes of one sensor; `slopes_per_degc` are their own if none were measured."""
    if parameters.noise_lsb is None:
        raise FusionError(
            f"sensor {parameters.name}: its noise is not known; run `imuarray calibrate noise` and pass the file"
        )
    noise = parameters.noise_lsb / parameters.lsb_per_si
    for index in np.flatnonzero(~(noise > 0)):
        raise FusionError(
            f"sensor {parameters.name} axis {'xyz'[index]}: noise {noise[index]:g}: its readings never change"
        )
    drift, time_constant_s = _drift(parameters, usual, noise)
    bias, response = _bias(parameters, usual, noise, drift), _response(parameters, usual)
    slope, bias_degc = _slope(parameters, slopes_per_degc)
    if not has_temperature:  # the bias does not follow measured slopes either
        slope = (
            slope
            if parameters.thermal is None
            else np.hypot(slope, parameters.thermal.slope_lsb_per_degc / parameters.lsb_per_si)
        )
        drift, slope = np.hypot(drift, UNWATCHED_DEGC * slope), np.zeros(3)
    correlation = parameters.noise_correlation
    return [
        AxisErrors(
            noise=float(noise[index]),
            correlation=0.0 if correlation is None else float(np.clip(correlation[index], 0.0, _COLOURED)),
            bias=float(bias[index]),
            drift=float(drift[index]),
            drift_time_constant_s=time_constant_s,
            slope_per_degc=float(slope[index]),
            response=float(response[index]),
            bias_degc=bias_degc,
        )
        for index in range(3)
    ]


_COLOURED = 0.99
"""Largest correlation of neighbouring readings."""


def _bias(parameters: SensorCalibration, usual: DesignDefaults, noise: Floats, drift: Floats) -> Floats:
    """Return the standard deviations (3,) of independent errors of a bias: that of the calibration if it has no
    covariance, the turn-on change, both now and at the calibration, the drift at the calibration, and the effect of
    gravity on a gyroscope, which is nearly constant at rest.
    """
    if parameters.bias_sem_lsb is None:
        return np.full(3, usual.bias)
    measured = (
        np.zeros(3) if parameters.bias_covariance_lsb2 is not None else parameters.bias_sem_lsb / parameters.lsb_per_si
    )
    turn_on, states = usual.turn_on_share * noise, np.zeros(3)
    if parameters.turn_on is not None:
        turn_on = np.hypot(parameters.turn_on.rms_lsb, parameters.turn_on.rms_sem_lsb) / parameters.lsb_per_si
        states = _state_variance(parameters.turn_on) / parameters.lsb_per_si**2
    gravity = np.full(3, usual.g_sensitivity)
    if parameters.g_sensitivity_sem_lsb_per_g is not None:
        gravity = np.sqrt(np.mean(parameters.g_sensitivity_sem_lsb_per_g**2, axis=1)) / parameters.lsb_per_si
    at_calibration = (turn_on**2 + drift**2) * _calibration_share(parameters)
    return np.asarray(np.sqrt(measured**2 + turn_on**2 + at_calibration + states + gravity**2))


def _calibration_share(parameters: SensorCalibration) -> float:
    """Return the share of the variance between switch-ons in a calibrated bias: 1 over the number of logs, each of
    which began with a switch-on; 0 for a bias that was not measured in logs.
    """
    origin = parameters.provenance.get("bias")
    return 0.0 if origin is None or not origin.logs else 1 / len(origin.logs)


def _state_variance(turn_on: TurnOn) -> Floats:
    """Return the variance (3,) in counts of the change of state between two random runs."""
    if len(turn_on.states) < 2:
        return np.zeros(3)
    biases, shares = (np.array([getattr(state, name) for state in turn_on.states]) for name in ("bias_lsb", "share"))
    mean = np.average(biases, axis=0, weights=shares)
    return np.asarray(2 * np.average((biases - mean) ** 2, axis=0, weights=shares))


def _drift(parameters: SensorCalibration, usual: DesignDefaults, noise: Floats) -> tuple[Floats, float]:
    """Return the rms (3,) and the time constant of the drift."""
    drift = parameters.drift
    if drift is None:
        return usual.drift_share * noise, DRIFT_TIME_CONSTANT_S
    return np.hypot(drift.rms_lsb, drift.rms_sem_lsb) / parameters.lsb_per_si, float(drift.time_constant_s)


def _response(parameters: SensorCalibration, usual: DesignDefaults) -> Floats:
    """Return the relative standard deviations (3,) of the response."""
    shares = response_shares(parameters)
    if shares is None:
        return np.full(3, usual.response)
    return np.asarray(np.sqrt(np.diag(shares)).reshape(3, 3).max(axis=1))


def _slope(parameters: SensorCalibration, usual_per_degc: Floats) -> tuple[Floats, float | None]:
    """Return the standard deviation (3,) of the slopes in SI per degC, and the temperature at which the bias is valid.

    A slope that may be one of scale is not applied to the bias, so its full size is uncertainty.
    """
    thermal = parameters.thermal
    if thermal is None:
        return usual_per_degc, parameters.temperature_degc if parameters.bias_sem_lsb is not None else None
    is_ambiguous = np.array([meaning != BIAS for meaning in thermal.meaning])
    whole = np.hypot(thermal.slope_lsb_per_degc, thermal.slope_sem_lsb_per_degc)
    deviation = np.where(is_ambiguous, whole, thermal.slope_sem_lsb_per_degc) / parameters.lsb_per_si
    if thermal.thermometer == "relative":
        return deviation, thermal.reference_degc
    return deviation, thermal.reference_degc if parameters.temperature_degc is None else parameters.temperature_degc
