"""A model made from a calibration: the measured parameters of each unit as effects.

The calibration's affine map, counts = response @ stimulus_box + g_sensitivity @ force_box + bias, is decomposed, in the
sensor's nominal axes and with its nominal sensitivity, into `axis_error`, `misalignment`, `scale`, `g_sensitivity` and
`bias`; applied in this order they give the same map again. Slopes with temperature become `thermal_bias` and
`thermal_lag`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from imuarray.arrays import Floats, Integers, triple
from imuarray.calibrate.model import Calibration, SensorCalibration
from imuarray.errors import CalibrationError
from imuarray.log.format import SensorHeader
from imuarray.simulate.converters import even_step
from imuarray.simulate.effect import Effect, to_table
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.conversion import Quantisation
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.response import AxisError, GSensitivity, Misalignment, Scale
from imuarray.simulate.effects.temperature import ThermalBias, ThermalLag
from imuarray.simulate.model import TRIADS, Model, Part, noise_bandwidth_hz
from imuarray.simulate.population import Recipe, figure_of
from imuarray.simulate.streams import Streams

_THERMAL = ("thermal_scale", "thermal_bias")


def calibrated(model: Model, calibration: Calibration, headers: Iterable[SensorHeader]) -> Model:
    """Return `model` with the parameters of these sensors that `calibration` measured, in its [[sensor]] tables;
    everything else is unchanged. Temperature effects of a sensor that was calibrated at a known temperature are
    relative to that temperature. CalibrationError for a calibration that does not fit its sensor.
    """
    parts = {(part.name, part.chip, part.range): part for part in model.sensors}
    for header in headers:
        if header.name in calibration.sensors:
            unit = _part(model, calibration.sensors[header.name], header)
            older = parts.get((unit.name, unit.chip, unit.range), unit)
            parts[unit.name, unit.chip, unit.range] = replace(unit, effects={**older.effects, **unit.effects})
    changed = replace(model, sensors=tuple(parts.values()))
    return replace(changed, text=changed.to_toml())


def _part(model: Model, unit: SensorCalibration, header: SensorHeader) -> Part:
    """Return the model of a sensor in which measured parameters replace those of the model."""
    _check_fit(unit, header)
    model_parts = model.parts(header)
    effects: dict[str, tuple[Recipe, ...]] = {}
    if unit.temperature_degc is not None:
        warm = {"reference_degc": unit.temperature_degc}
        effects |= {
            kind: tuple({**recipe, **warm} for recipe in model_parts[kind].effects[kind])
            for kind in _THERMAL
            if kind in model_parts
        }
    noise = _noise(unit, header, _step_lsb(model, header))
    for effect in (*_affine(unit, header), *_thermal(unit, header), *noise):
        if effect.name in model_parts or effect != type(effect)():
            table = to_table(effect, header.unit)
            effects[effect.name] = ({key: figure_of(value, key) for key, value in table.items()},)
    bandwidth_hz = noise_bandwidth_hz(header) or None
    if "white_noise" not in effects and "white_noise" in model_parts:
        bandwidth_hz = model_parts["white_noise"].noise_bandwidth_hz
    foreign = "" if header.chip in TRIADS else header.unit
    return Part(header.chip, header.range, header.name, bandwidth_hz, effects, foreign)


def _affine(unit: SensorCalibration, header: SensorHeader) -> Iterator[Effect]:
    """Yield the effects that reproduce the calibration's map. A data-sheet value in the map was not measured, so no
    effect is made from it.
    """
    orientation = np.array(header.orientation)
    sensed = unit.response_lsb_per_unit @ orientation / header.sensitivity
    exchange = np.eye(3)
    if unit.response_sem_lsb_per_unit is not None or not np.allclose(sensed, np.eye(3), rtol=0, atol=1e-12):
        exchange = _nearest_axes(sensed)
        yield from _response(sensed @ exchange.T, exchange, header)
    if unit.g_sensitivity_lsb_per_g is not None:
        stimulus = unit.g_sensitivity_lsb_per_g @ orientation / header.sensitivity @ exchange.T
        yield GSensitivity(tuple(stimulus.ravel().tolist()))
    if unit.bias_sem_lsb is not None or np.any(unit.bias_lsb):
        yield Bias(triple(unit.bias_lsb / header.sensitivity))


def _response(sensed: Floats, exchange: Floats, header: SensorHeader) -> Iterator[Effect]:
    """Yield the effects of a response `sensed` (3, 3): its rows are the sensor's axes, its columns the exchanged axes
    from which they are misaligned.
    """
    axis_of_row = np.abs(exchange).argmax(axis=1)
    yield AxisError(
        "".join("+-"[int(row[axis] < 0)] + "XYZ"[axis] for row, axis in zip(exchange, axis_of_row, strict=True))
    )
    leaning = np.degrees(np.arctan(sensed / np.diag(sensed)[:, None]))[~np.eye(3, dtype=bool)]
    try:
        yield Misalignment(tuple(leaning.tolist()))
    except ValueError:
        raise CalibrationError(f"sensor {header.name}: its calibrated axes are too oblique to be a triad's") from None
    yield Scale(triple(np.linalg.norm(sensed, axis=1) - 1))


def _nearest_axes(sensed: Floats) -> Floats:
    """Return (3, 3) of 0, 1 and -1: the signed axes that are closest to the rows of `sensed`, each used once."""
    from scipy.optimize import linear_sum_assignment  # imported late because SciPy takes long to load

    rows, columns = linear_sum_assignment(-np.abs(sensed / np.linalg.norm(sensed, axis=1, keepdims=True)))
    nearest = np.zeros((3, 3))
    nearest[rows, columns] = np.sign(sensed[rows, columns])
    return nearest


def _thermal(unit: SensorCalibration, header: SensorHeader) -> Iterator[Effect]:
    """Yield the slopes at the temperature at which the bias holds; CalibrationError for a slope that no sensor can
    have. A slope that may belong to the scale factor is assumed to belong to the bias, because at rest both produce the
    same counts. A lag relative to the chip's own thermometer is not a lag relative to the box, whose temperature the
    simulator uses.
    """
    if unit.thermal is None:
        return
    thermal = unit.thermal
    relative = thermal.thermometer == "relative"  # only differences of its degrees are meaningful
    unknown = ThermalBias().reference_degc if relative else thermal.reference_degc
    holds_at = unknown if unit.temperature_degc is None else unit.temperature_degc
    curve = np.zeros(3) if thermal.quadratic_lsb_per_degc2 is None else thermal.quadratic_lsb_per_degc2
    slope = thermal.slope_lsb_per_degc + 2 * curve * (0.0 if relative else holds_at - thermal.reference_degc)
    try:
        yield ThermalBias(triple(slope / header.sensitivity), triple(curve / header.sensitivity), holds_at)
        if thermal.significant_lag_s and thermal.thermometer in ("barometer", "reference"):
            yield ThermalLag(thermal.significant_lag_s)
    except ValueError as error:
        raise CalibrationError(f"sensor {header.name}: thermal: {error}") from None


def _noise(unit: SensorCalibration, header: SensorHeader, step_lsb: Integers) -> Iterator[Effect]:
    """Yield the measured noise without that of rounding, step^2 / 12 (Sheppard's correction)."""
    if unit.noise_lsb is not None:
        yield WhiteNoise(triple(np.sqrt(np.maximum(unit.noise_lsb**2 - step_lsb**2 / 12, 0)) / header.sensitivity))


def _step_lsb(model: Model, header: SensorHeader) -> Integers:
    """Return (3,) the step between neighbouring codes of each axis."""
    effects = model.effects(header, Streams(0))
    steps = [np.array(effect.step_lsb, int) for effect in effects if isinstance(effect, Quantisation)]
    return np.asarray(np.lcm.reduce([np.full(3, even_step(header.chip, header.rate_hz)), *steps]))


def _check_fit(unit: SensorCalibration, header: SensorHeader) -> None:
    """Raise CalibrationError unless the calibration is of this sensor at this range and models support the chip."""
    where = f"sensor {header.name}"
    chip = TRIADS.get(header.chip)
    if not header.sensitivity or (chip is not None and header.range not in chip.sensitivity):
        raise CalibrationError(f"{where}: no model describes a {header.chip} at {header.range:g} {header.unit}")
    if (unit.quantity, unit.unit) != (header.quantity, header.unit):
        raise CalibrationError(f"{where}: calibrated as {unit.quantity} in {unit.unit}, but it is {header.quantity}")
    if unit.range not in (None, header.range):
        raise CalibrationError(
            f"{where}: calibrated at a range of {unit.range:g} {unit.unit}, but it is at {header.range:g}"
        )
    ratio = unit.scale_lsb_per_unit / header.sensitivity
    if (np.abs(np.log2(ratio)) > 1).any():  # no chip deviates by a factor of two, but another range does
        raise CalibrationError(
            f"{where}: calibrated at {unit.scale_lsb_per_unit[0]:.4g} counts per {unit.unit}, nominal are"
            f" {header.sensitivity:.4g}: another range"
        )
