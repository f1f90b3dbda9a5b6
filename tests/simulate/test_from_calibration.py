"""Calibrations as effects: applied in order they reproduce the calibration's map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.axes import orientation_of
from imuarray.calibrate.model import Calibration, SensorCalibration, Thermal
from imuarray.errors import CalibrationError
from imuarray.log.format import SensorHeader
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.response import Scale
from imuarray.simulate.effects.temperature import ThermalBias, ThermalLag
from imuarray.simulate.from_calibration import calibrated
from imuarray.simulate.model import Model, parse_model
from imuarray.simulate.signal import Analog
from imuarray.simulate.streams import Streams

Floats = npt.NDArray[np.float64]
MakeSensor = Callable[..., SensorHeader]
MakeAnalog = Callable[..., Analog]

EMPTY = Model("m", "", (), ())
FORCE_ROWS = 40

DESIGNS = """
[model]
name = "design"
[[design]]
chip = "l3g4200d"
bias.offset_dps = { sigma = 10.0 }
scale.error = 0.02
axis_error.axes = "-X+Y+Z"
misalignment.angles_deg = { sigma = 1.0 }
g_sensitivity.response_dps_per_g = [1, 2, 3, 4, 5, 6, 7, 8, 9]
thermal_bias = { slope_dps_per_degc = { sigma = 0.04 }, reference_degc = 20.0 }
thermal_scale.slope_per_degc = 0.001
"""


def measured(header: SensorHeader, response: Floats, **more: Any) -> SensorCalibration:
    """A calibration of this sensor with all groups measured."""
    known: dict[str, Any] = {
        "bias_lsb": np.array([10.5, -300.25, 7.125]),
        "bias_sem_lsb": np.ones(3),
        "response_sem_lsb_per_unit": np.ones(3),
        "range": header.range,
        **more,
    }
    return SensorCalibration(header.name, header.quantity, header.unit, response_lsb_per_unit=response, **known)


def askew(header: SensorHeader, rng: np.random.Generator, spread: float) -> Floats:
    """A response whose scale factors and directions are off by shares of up to `spread`."""
    nominal = header.sensitivity * np.array(orientation_of(header.axes)).T
    return np.asarray(nominal @ (np.eye(3) + rng.uniform(-spread, spread, (3, 3))))


def counts_of(
    model: Model, header: SensorHeader, stimulus_box: Floats, force_box_g: Floats, degc: float, place: Any, analog: Any
) -> Floats:
    """The output of a sensor's effects for a stimulus in its unit: counts before they are rounded."""
    orientation = np.array(orientation_of(header.axes))
    signal: Analog = analog(0, len(stimulus_box))
    signal = replace(
        signal,
        value=stimulus_box @ orientation,
        force_g=force_box_g @ orientation,
        temperature_degc=np.full(len(stimulus_box), degc),
        sensitivity=header.sensitivity,
    )
    for effect in model.effects(header, Streams(3), without=frozenset({"white_noise"})):
        signal = effect.analog(signal, place(header))
    return np.asarray(signal.value * header.sensitivity)


@pytest.mark.parametrize("axes", ["+X+Y+Z", "-Y+X+Z", "+Y+X-Z", "-X-Y+Z"])
@pytest.mark.parametrize(
    ("chip", "range_"), [("adxl345", 16.0), ("bma180", 1.5), ("l3g4200d", 2000.0), ("hmc5883", 1.2)]
)
@pytest.mark.parametrize("designs", [EMPTY, parse_model(DESIGNS)], ids=["alone", "over designs"])
def test_the_effects_reproduce_the_calibrations_map(
    axes: str, chip: str, range_: float, designs: Model, sensor: MakeSensor, place: Any, analog: MakeAnalog
) -> None:
    """counts = response @ stimulus + g_sensitivity @ force + bias, in the box frame, at the temperature of then."""
    header = sensor(chip, "S1", range_, axes=axes)
    rng = np.random.default_rng(len(axes) + int(range_))
    stimulus, force = rng.normal(0, range_ / 3, (FORCE_ROWS, 3)), rng.normal(0, 1, (FORCE_ROWS, 3))
    response, pull = askew(header, rng, 0.05), rng.normal(0, 0.5, (3, 3))
    unit = measured(header, response, g_sensitivity_lsb_per_g=pull, temperature_degc=31.5)
    model = parse_model(calibrated(designs, Calibration({"S1": unit}), [header]).to_toml())
    wanted = stimulus @ response.T + force @ pull.T + np.array([10.5, -300.25, 7.125])
    counts = counts_of(model, header, stimulus, force, 31.5, place, analog)
    assert counts == pytest.approx(wanted, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("really", ["-X+Y+Z", "+Y+X+Z", "+Z+X+Y", "-X-Y-Z", "+X-Z+Y"])
def test_wrongly_mounted_axes_become_an_axis_error(
    really: str, sensor: MakeSensor, place: Any, analog: MakeAnalog
) -> None:
    """A response near other signed axes than the header's, left-handed ones included (the paper's Table 1 has two)."""
    header = sensor("l3g4200d", "S1", 2000.0, axes="+Y+X-Z")
    rng = np.random.default_rng(7)
    exchange = np.zeros((3, 3))
    for row in range(3):
        exchange[row, "XYZ".index(really[2 * row + 1])] = 1 if really[2 * row] == "+" else -1
    lean = np.eye(3) + rng.uniform(-0.08, 0.08, (3, 3))
    response = header.sensitivity * lean @ exchange @ np.array(orientation_of("+Y+X-Z")).T
    pull = rng.normal(0, 0.5, (3, 3))
    unit = measured(header, response, g_sensitivity_lsb_per_g=pull)
    model = calibrated(EMPTY, Calibration({"S1": unit}), [header])
    assert model.sensors[0].effects["axis_error"] == ({"axes": really},)
    stimulus, force = rng.normal(0, 700, (FORCE_ROWS, 3)), rng.normal(0, 1, (FORCE_ROWS, 3))
    counts = counts_of(model, header, stimulus, force, 25.0, place, analog)
    wanted = stimulus @ response.T + force @ pull.T + unit.bias_lsb
    assert counts == pytest.approx(wanted, rel=1e-9, abs=1e-9)


def test_known_angles_and_scales_are_recovered(sensor: MakeSensor) -> None:
    """x leans 3 degrees towards y, z counts 1 % too much, the bias is 51.2 counts of 512: 0.1 g."""
    header = sensor("bma180", "S1", 16.0)
    lean = np.radians(3.0)
    response = 512 * np.array([[np.cos(lean), np.sin(lean), 0], [0, 1, 0], [0, 0, 1.01]])
    unit = measured(header, response, bias_lsb=np.array([51.2, 0, 0]))
    effects = calibrated(EMPTY, Calibration({"S1": unit}), [header]).sensors[0].effects
    assert set(effects) == {"misalignment", "scale", "bias"}
    (misalignment,), (scale,), (bias,) = (effects[name] for name in ("misalignment", "scale", "bias"))
    assert misalignment["angles_deg"] == pytest.approx((3.0, 0, 0, 0, 0, 0), abs=1e-12)
    assert scale["error"] == pytest.approx((0, 0, 0.01), abs=1e-12)
    assert bias["offset_g"] == pytest.approx((0.1, 0, 0))


@pytest.mark.parametrize(
    ("chip", "rate_hz", "noise_lsb", "rms_lsb"),
    [
        ("bma180", 2400.0, 2.0, np.sqrt(4 - 1 / 12)),
        ("adxl345", 1600.0, 6.0, np.sqrt(36 - 4 / 12)),  # even codes alone (ADX-47): steps of two
        ("adxl345", 800.0, 6.0, np.sqrt(36 - 1 / 12)),
        ("bma180", 2400.0, 0.2, 0.0),
    ],
)
def test_rounding_noise_is_subtracted(
    sensor: MakeSensor, chip: str, rate_hz: float, noise_lsb: float, rms_lsb: float
) -> None:
    header = sensor(chip, "S1", 16.0, rate_hz=rate_hz)
    unit = measured(header, header.sensitivity * np.eye(3), noise_lsb=np.full(3, noise_lsb))
    model = calibrated(EMPTY, Calibration({"S1": unit}), [header])
    noise = [effect for effect in model.effects(header, Streams(0)) if isinstance(effect, WhiteNoise)]
    rms = noise[0].rms if noise else (0.0, 0.0, 0.0)
    assert rms == pytest.approx((rms_lsb / header.sensitivity,) * 3)


def test_rounding_to_coarser_codes_of_the_model_is_subtracted(sensor: MakeSensor) -> None:
    header = sensor("bma180", "S1", 16.0)
    text = '[model]\nname = "m"\n[[design]]\nchip = "bma180"\nquantisation.step_lsb = 4\n'
    unit = measured(header, 512 * np.eye(3), noise_lsb=np.full(3, 5.0))
    (part,) = calibrated(parse_model(text), Calibration({"S1": unit}), [header]).sensors
    assert part.effects["white_noise"][0]["rms_g"] == pytest.approx(np.sqrt(25 - 16 / 12) / 512)


def test_noise_scales_with_the_bandwidth(sensor: MakeSensor) -> None:
    header = sensor("bma180", "S1", 16.0, bandwidth_hz=150.0)
    unit = measured(header, 512 * np.eye(3), noise_lsb=np.full(3, 8.0))
    model = calibrated(EMPTY, Calibration({"S1": unit}), [header])
    at = {
        hz: next(e for e in model.effects(replace(header, bandwidth_hz=hz), Streams(0)) if isinstance(e, WhiteNoise))
        for hz in (150.0, 600.0)
    }
    assert at[600.0].rms == pytest.approx([2 * rms for rms in at[150.0].rms])


def test_unmeasured_groups_are_those_of_the_model(sensor: MakeSensor) -> None:
    """`calibrate noise` leaves bias and response at the data sheet's: they are not zero, they are unknown."""
    header = sensor("l3g4200d", "S1", 2000.0)
    designs = parse_model(DESIGNS)
    unit = measured(header, header.sensitivity * np.eye(3), bias_lsb=np.zeros(3), bias_sem_lsb=None)
    unit = replace(unit, response_sem_lsb_per_unit=None, noise_lsb=np.full(3, 3.0))
    before, after = (
        model.effects(header, Streams(1))
        for model in (designs, calibrated(designs, Calibration({"S1": unit}), [header]))
    )
    assert [effect for effect in after if not isinstance(effect, WhiteNoise)] == list(before)
    assert any(isinstance(effect, WhiteNoise) for effect in after)


def test_figures_without_uncertainty_are_used_if_they_differ_from_the_data_sheet(sensor: MakeSensor) -> None:
    """A calibration written by hand."""
    header = sensor("bma180", "S1", 16.0)
    unit = measured(header, 520 * np.eye(3), bias_lsb=np.full(3, 5.12))
    unit = replace(unit, bias_sem_lsb=None, response_sem_lsb_per_unit=None)
    effects = calibrated(EMPTY, Calibration({"S1": unit}), [header]).effects(header, Streams(0))
    assert Bias(0.01) in effects  # type: ignore[arg-type]
    assert Scale(520 / 512 - 1) in effects  # type: ignore[arg-type]


def test_a_perfect_unit_replaces_the_errors_of_a_model(sensor: MakeSensor) -> None:
    header = sensor("l3g4200d", "S1", 2000.0)
    unit = measured(header, header.sensitivity * np.eye(3), bias_lsb=np.zeros(3))
    effects = calibrated(parse_model(DESIGNS), Calibration({"S1": unit}), [header]).effects(header, Streams(1))
    assert Bias() in effects
    assert Scale() in effects


def test_the_reference_temperature_is_that_of_the_calibration(sensor: MakeSensor) -> None:
    """Same slope, drawn as before, from another temperature on."""
    header = sensor("l3g4200d", "S1", 2000.0)
    designs = parse_model(DESIGNS)
    unit = measured(header, header.sensitivity * np.eye(3), temperature_degc=37.0)
    models = (designs, calibrated(designs, Calibration({"S1": unit}), [header]))
    before, after = (
        next(effect for effect in model.effects(header, Streams(1)) if isinstance(effect, ThermalBias))
        for model in models
    )
    assert (before.reference_degc, after.reference_degc) == (20.0, 37.0)
    assert before.slope == after.slope != (0.0, 0.0, 0.0)


def sloped(thermometer: str = "barometer", **more: Any) -> Thermal:
    """Slopes of 2, -1 and 4 counts per degC at 30 degC, the first one bent."""
    return Thermal(
        slope_lsb_per_degc=np.array([2.0, -1.0, 4.0]),
        slope_sem_lsb_per_degc=np.full(3, 0.1),
        reference_degc=30.0,
        meaning=("bias", "bias", "bias or scale"),
        thermometer=thermometer,
        quadratic_lsb_per_degc2=np.array([0.1, 0.0, 0.0]),
        **more,
    )


@pytest.mark.parametrize("measured_at", [None, 20.0])
@pytest.mark.parametrize("designs", [EMPTY, parse_model(DESIGNS)], ids=["alone", "over designs"])
def test_measured_slopes_are_the_models_slopes(
    designs: Model, measured_at: float | None, sensor: MakeSensor, place: Any, analog: MakeAnalog
) -> None:
    """At rest at 42 degC: 2 * 12 + 0.1 * 144 = 38.4, -12 and 48 counts more than at 30 degC.

    A bias of 20 degC is 2 * -10 + 0.1 * 100 = -10, 10 and -40 counts from that of 30, so that 48.4, -22 and 88 count.
    """
    header = sensor("l3g4200d", "S1", 2000.0)
    thermal = sloped(lag_s=80.0, lag_interval_s=np.array([60.0, 100.0]))
    unit = measured(header, header.sensitivity * np.eye(3), thermal=thermal, temperature_degc=measured_at)
    model = parse_model(calibrated(designs, Calibration({"S1": unit}), [header]).to_toml())
    counts = counts_of(
        replace(model, designs=()), header, np.zeros((FORCE_ROWS, 3)), np.zeros((FORCE_ROWS, 3)), 42.0, place, analog
    )
    more = [38.4, -12.0, 48.0] if measured_at is None else [48.4, -22.0, 88.0]
    assert counts == pytest.approx(np.tile(unit.bias_lsb + more, (FORCE_ROWS, 1)), rel=1e-9)
    assert ThermalLag(80.0) in model.effects(header, Streams(0))


@pytest.mark.parametrize(
    ("thermometer", "lag_interval_s", "reference_degc"),
    [("barometer", (0.0, 100.0), 30.0), ("chip", (60.0, 100.0), 30.0), ("relative", (60.0, 100.0), 25.0)],
)
def test_other_lags_and_thermometers_give_no_thermal_lag(
    thermometer: str, lag_interval_s: tuple[float, float], reference_degc: float, sensor: MakeSensor
) -> None:
    """Nor does a thermometer without a zero define the temperature of a bias."""
    header = sensor("l3g4200d", "S1", 2000.0)
    thermal = sloped(thermometer, lag_s=80.0, lag_interval_s=np.array(lag_interval_s))
    unit = measured(header, header.sensitivity * np.eye(3), thermal=thermal)
    effects = calibrated(EMPTY, Calibration({"S1": unit}), [header]).effects(header, Streams(0))
    assert not any(isinstance(effect, ThermalLag) for effect in effects)
    (bias,) = (effect for effect in effects if isinstance(effect, ThermalBias))
    assert bias.reference_degc == reference_degc


def test_slopes_about_an_impossible_temperature_are_refused(sensor: MakeSensor) -> None:
    header = sensor("l3g4200d", "S1", 2000.0)
    unit = measured(header, header.sensitivity * np.eye(3), thermal=replace(sloped(), reference_degc=5000.0))
    with pytest.raises(CalibrationError, match="sensor S1: thermal: reference_degc: 5000"):
        calibrated(EMPTY, Calibration({"S1": unit}), [header])


def test_known_units_keep_their_unmeasured_effects(sensor: MakeSensor) -> None:
    """Another sensor's table, and another effect of the same sensor."""
    head = '[model]\nname = "m"\n'
    units = "".join(
        f'[[sensor]]\nname = "{name}"\nchip = "bma180"\nrange = 16\nbias.offset_g = 9.0\nscale.error = 0.5\n'
        for name in ("S1", "S2")
    )
    header = sensor("bma180", "S1", 16.0)
    unit = measured(header, 512 * np.eye(3), response_sem_lsb_per_unit=None)
    model = calibrated(parse_model(head + units), Calibration({"S1": unit, "other": unit}), [header])
    first, second = model.sensors
    assert first.effects["scale"] == ({"error": 0.5},)
    assert first.effects["bias"][0]["offset_g"] == pytest.approx((10.5 / 512, -300.25 / 512, 7.125 / 512))
    assert second == parse_model(head + units).sensors[1]
    assert parse_model(model.text) == model


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"range": 2.0}, "sensor S1: calibrated at a range of 2 g, but it is at 16$"),
        (
            {"quantity": "angular_rate", "unit": "dps"},
            "sensor S1: calibrated as angular_rate in dps, but it is specific_force$",
        ),
        (
            {"response_lsb_per_unit": 4096 * np.eye(3)},
            "S1: calibrated at 4096 counts per g, nominal are 512: another range",
        ),
        ({"response_lsb_per_unit": 512 * np.array([[1, 0, 0], [0, 1, 0], [0.995, 0, 0.1]])}, "S1: .* too oblique"),
    ],
)
def test_a_calibration_that_does_not_fit_is_refused(
    sensor: MakeSensor, changes: dict[str, Any], complaint: str
) -> None:
    header = sensor("bma180", "S1", 16.0)
    unit = replace(measured(header, 512 * np.eye(3)), **changes)
    with pytest.raises(CalibrationError, match=complaint):
        calibrated(EMPTY, Calibration({"S1": unit}), [header])


def test_a_sensor_without_a_sensitivity_is_refused(sensor: MakeSensor) -> None:
    header = replace(sensor("bma180", "S1", 16.0), chip="other", sensitivity=0.0)
    with pytest.raises(CalibrationError, match="sensor S1: no model describes a other at 16 g"):
        calibrated(EMPTY, Calibration({"S1": measured(header, 512 * np.eye(3))}), [header])


def test_a_model_of_an_unknown_chip_states_its_unit(sensor: MakeSensor) -> None:
    header = replace(sensor("bma180", "S1", 16.0), chip="mpu9150", sensitivity=2048.0)
    made = calibrated(EMPTY, Calibration({"S1": measured(header, 2050 * np.eye(3))}), [header])
    again = parse_model(made.to_toml())
    assert again.sensors[0].unit == "g"
    result = {effect.name: effect for effect in again.effects(header, Streams(0))}
    np.testing.assert_allclose(result["scale"].error, 2050 / 2048 - 1, rtol=1e-6)  # type: ignore[attr-defined]
    gyroscope = replace(header, quantity="angular_rate", unit="dps")
    assert again.effects(gyroscope, Streams(0)) == ()
