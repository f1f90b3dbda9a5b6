"""The fitted model against the printed tables, each group by an independent computation."""

from __future__ import annotations

import subprocess
import sys
from math import exp, pi, sqrt
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.stats import norm

from imuarray.array import load_array
from imuarray.axes import orientation_of
from imuarray.log.format import header_of
from imuarray.simulate.model import parse_model
from imuarray.simulate.streams import Streams
from imuarray.studies.paper.array_model import (
    CUTOFF_HZ,
    about_zero,
    bma1_reset_offset_g,
    covariance_of_means,
    expected_scatter,
    fit_text,
    gyro3_other_state_lsb,
    rms_before_rounding,
    spread,
    unit_of,
    units,
    variance_of_mean,
)
from imuarray.studies.paper.tables import FACES_DEGC, row_of, table

CONFIGS = Path(__file__).parents[3] / "configs"
SHIPPED = CONFIGS / "models" / "martin2013.toml"
UP = {"z_up": (0, 0, 1), "x_up": (1, 0, 0), "y_up": (0, 1, 0), "x_down": (-1, 0, 0), "y_down": (0, -1, 0)}
UP |= {"z_down": (0, 0, -1)}
NOMINAL = {"ADXL": 256.0, "BMA 16g": 512.0, "BMA 1.5g": 5460.0, "Gyro 2k dps": 1 / 0.07, "Gyro 250dps": 1 / 0.00875}
ACCELEROMETERS = ("ADXL1", "ADXL2", "BMA1", "BMA2", "BMA3", "BMA4")
GYROSCOPES = ("Gyro1", "Gyro2", "Gyro3")

array = load_array(CONFIGS / "martin2013.toml")


def nominal(name: str) -> float:
    design = name.rstrip("1234")
    row = row_of(10, f"{name} x")
    return NOMINAL[design if design == "ADXL" else f"{design} {row['range']}"]


def printed(number: int, name: str, column: str) -> np.ndarray:
    return np.array([float(row_of(number, f"{name} {axis}")[column]) for axis in "xyz"])


def test_the_shipped_file_is_that_of_the_fit() -> None:
    assert SHIPPED.read_text(encoding="utf-8") == fit_text()


@pytest.mark.slow
def test_the_module_prints_the_fit() -> None:
    ran = subprocess.run(
        [sys.executable, "-m", "imuarray.studies.paper.array_model"], capture_output=True, text=True, check=True
    )
    assert ran.stdout == fit_text()


def test_every_sensor_of_the_array_is_a_known_unit() -> None:
    model = parse_model(fit_text())
    for unit in units():
        sensor = array[unit.name]
        parts = model.parts(header_of(sensor, {}))
        assert parts["bias"].name == unit.name
        assert parts["white_noise"].name == unit.name
        assert ("scale" in parts) == (sensor.chip != "l3g4200d")


@pytest.mark.parametrize("name", ACCELEROMETERS)
def test_the_model_reproduces_the_six_faces_of_accelerometers(name: str) -> None:
    """The equations of the model, written out: the residual is the disagreement of pairs of faces, 0 on average."""
    unit, sensor = unit_of(name), array[name]
    tangents = np.eye(3)
    tangents[~np.eye(3, dtype=bool)] = np.tan(np.radians(unit.angles_deg))
    directions = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
    left = []
    for (face, up), degc in zip(UP.items(), FACES_DEGC, strict=False):
        force = np.array(orientation_of(sensor.axes)).T @ up
        value = (directions @ force) * (1 + unit.scale_error) + unit.bias + unit.slope * (degc - 25)
        left.append(printed(10, name, face) - value * nominal(name))
    faces = dict(zip(UP, left, strict=True))
    for k in "xyz":
        np.testing.assert_allclose(faces[f"{k}_up"], faces[f"{k}_down"], atol=2e-3)  # Table 10's digits
    np.testing.assert_allclose(sum(left), 0, atol=1e-2)


@pytest.mark.parametrize("name", ACCELEROMETERS)
def test_scale_and_bias_equal_table_3(name: str) -> None:
    unit = unit_of(name)
    drift = np.mean(FACES_DEGC[:6]) - 25
    slope = printed(8, name, "slope_lsb_per_degc")
    bias = printed(3, name, "bias_lsb") - slope * drift
    np.testing.assert_allclose(unit.bias * nominal(name), bias, atol=6e-4)
    scale = np.abs(printed(3, name, "scale_lsb_per_g"))
    off = np.abs((1 + unit.scale_error) * nominal(name) - scale)
    assert (off <= 0.01 + 0.14 * np.abs(slope)).all()  # faces differ by 0.26 degC at most, half of which contributes


@pytest.mark.parametrize("name", GYROSCOPES)
def test_the_response_to_force_is_half_of_table_4(name: str) -> None:
    unit = unit_of(name)
    slope = printed(8, name, "slope_lsb_per_degc")
    degc = dict(zip(UP, FACES_DEGC, strict=False))
    in_box = unit.response @ np.array(orientation_of(array[name].axes)).T * nominal(name)
    for index, k in enumerate("xyz"):
        difference = printed(4, name, f"dbias_{k}_lsb") - slope * (degc[f"{k}_up"] - degc[f"{k}_down"])
        np.testing.assert_allclose(2 * in_box[:, index], difference, atol=6e-4)


def test_the_faulty_run_is_reproduced() -> None:
    others = np.mean([[float(row[f"{a}_lsb"]) for a in "xyz"] for row in table(6) if row["run"] != "10"], axis=0)
    faulty = 4096 * (others / 512 + bma1_reset_offset_g())
    np.testing.assert_allclose(faulty, [31.79535, -124.464, 4308.719], rtol=1e-9)


def test_the_two_states_of_gyro3_are_reproduced() -> None:
    """Finding 15: about (0, 70, 2) and (-12.6, 75, 0.7) LSB."""
    np.testing.assert_allclose(gyro3_other_state_lsb(), [-12.5, 5.2, -1.4], atol=0.05)
    gyro = unit_of("Gyro3")
    ten = gyro.bias / 0.00875 + gyro3_other_state_lsb() + printed(8, "Gyro3", "slope_lsb_per_degc") * 1.4325
    np.testing.assert_allclose(ten, [-10.8, 80.5, -6.2], atol=0.06)  # means of Table 10's faces


@pytest.mark.parametrize("name", [*ACCELEROMETERS, *GYROSCOPES])
def test_noise_is_between_the_printed_deviations(name: str) -> None:
    unit = unit_of(name)
    columns = ((10, "std_lsb"), (11, "runs_std"), (11, "cont_std"))
    stds = np.array([printed(number, name, column) for number, column in columns])
    step = 2.0 if name.startswith("ADXL") else 1.0
    tone = np.array([0, unit_of("Gyro1").lsb and 0.0761 * nominal(name), 0]) if name.startswith("Gyro") else 0.0
    total = np.sqrt((unit.noise * nominal(name)) ** 2 + step**2 / 12 + np.square(tone) / 2)
    assert (total > stds.min(axis=0)).all()
    assert (total < stds.max(axis=0)).all()


@pytest.mark.parametrize("name", [*ACCELEROMETERS, *GYROSCOPES])
def test_in_run_and_turn_on_add_up_to_table_11(name: str) -> None:
    unit, lsb = unit_of(name), 1 / nominal(name)
    slope = printed(8, name, "slope_lsb_per_degc")
    cont = printed(11, name, "cont_sem") ** 2 + (slope * 0.086) ** 2 + (unit.in_run / lsb) ** 2 * expected_scatter()
    printed_cont = printed(11, name, "cont_std_of_means") ** 2
    fitted = unit.in_run > 0
    np.testing.assert_allclose(cont[fitted], printed_cont[fitted], rtol=1e-9)
    assert (cont[~fitted] >= printed_cont[~fitted]).all()
    if name in ("BMA1", "Gyro3"):
        return  # their columns contain a fault and two states
    runs = printed(11, name, "runs_sem") ** 2 + (slope * 0.131) ** 2 + (unit.turn_on / lsb) ** 2
    runs = runs + (unit.in_run / lsb) ** 2 * variance_of_mean(300.0)
    fitted = unit.turn_on > 0
    np.testing.assert_allclose(runs[fitted], printed(11, name, "runs_std_of_means")[fitted] ** 2, rtol=1e-9)
    assert (runs[~fitted] >= printed(11, name, "runs_std_of_means")[~fitted] ** 2).all()


def test_neighbours_correlate_as_in_figure_13() -> None:
    assert exp(-2 * pi * CUTOFF_HZ / 350) == pytest.approx(0.4, abs=1e-3)


@pytest.mark.parametrize(("window_s", "time_constant_s"), [(300.0, 600.0), (900.0, 100.0)])
def test_variance_and_covariance_of_means_equal_double_integrals(window_s: float, time_constant_s: float) -> None:
    def integral(shift_s: float, low: float, high: float) -> float:
        value, _ = dblquad(lambda t, s: exp(-abs(t - s - shift_s) / time_constant_s), 0, window_s, low, high)
        return float(value) / window_s**2

    below, _ = dblquad(lambda t, s: exp(-(s - t) / time_constant_s), 0, window_s, 0, lambda s: s)
    assert variance_of_mean(window_s, time_constant_s) == pytest.approx(2 * below / window_s**2, rel=1e-6)
    apart = integral(2 * window_s, 0, window_s)
    assert covariance_of_means(2, window_s, time_constant_s) == pytest.approx(apart, rel=1e-6)


def test_expected_scatter_is_that_of_a_covariance_matrix() -> None:
    lag = np.abs(np.subtract.outer(np.arange(15), np.arange(15)))
    row = np.array([variance_of_mean(300.0), *(covariance_of_means(k, 300.0) for k in range(1, 15))])
    covariance = row[lag]
    assert expected_scatter() == pytest.approx((np.trace(covariance) - covariance.mean() * 15) / 14)


@pytest.mark.parametrize("rms", [0.05, 0.2, 0.35, 0.8])
def test_noise_before_rounding_is_recovered(rms: float) -> None:
    """Variance of a rounded normal number, from the probabilities of the codes, averaged over the
    position of its mean.
    """
    codes = np.arange(-8, 9)
    variances = []
    for mean in np.arange(0, 1, 1 / 256) + 1 / 512:
        share = norm.cdf((codes + 0.5 - mean) / rms) - norm.cdf((codes - 0.5 - mean) / rms)
        variances.append(share @ codes**2 - (share @ codes) ** 2)
    assert rms_before_rounding(float(np.mean(variances))) == pytest.approx(rms, rel=1e-3)


def test_the_prediction_of_a_third_unit_from_two() -> None:
    result = spread(np.array([[1.0, 2.0], [3.0, 4.0]]), count=2)
    assert (result.mean, result.limit) == (2.5, None)
    assert result.shared == pytest.approx(1 / 3)
    assert result.sigma == pytest.approx(sqrt(5 / 3) * sqrt(1.5))
    assert spread(np.array([1.0, 3.0]), count=2, positive=True).limit == 2.0  # sqrt(2) sqrt(1.5) thrice is beyond 0
    assert about_zero(np.array([3.0, -4.0]), count=3).sigma == pytest.approx(sqrt(12.5) * sqrt(4 / 3))


@pytest.mark.slow
def test_virtual_units_are_drawn_with_common_design_errors() -> None:
    model = parse_model(fit_text())
    header = header_of(array["Gyro1"], {})
    slopes = []
    for seed in range(200):
        effects = {e.name: e for e in model.effects(header, Streams(seed), population=True)}
        assert min(effects["white_noise"].rms) > 0  # type: ignore[attr-defined]
        assert "bistable_bias" not in effects
        slopes.append(effects["thermal_bias"].slope)  # type: ignore[attr-defined]
    # mean 0.0134, sigma 0.0186 of 600 draws, a quarter of the variance common to units of one seed; 4 sigma: 6e-5
    assert np.mean(slopes) == pytest.approx(0.0134, abs=4 * 0.0186 / sqrt(200))
    assert np.std(slopes) == pytest.approx(0.0186, rel=0.15)


def test_the_faults_belong_to_single_units() -> None:
    model = parse_model(fit_text())
    result = {name: model.parts(header_of(array[name], {})) for name in ("BMA1", "BMA2", "Gyro1", "Gyro3")}
    assert "range_reset" in result["BMA1"]
    assert "range_reset" not in result["BMA2"]
    assert "bistable_bias" in result["Gyro3"]
    assert "bistable_bias" not in result["Gyro1"]
    at_250 = model.parts(SimpleNamespace(chip="l3g4200d", name="Gyro1", range=250.0, unit="dps"))  # type: ignore[arg-type]
    assert (at_250["bias"].range, at_250["white_noise"].range) == (250.0, None)
