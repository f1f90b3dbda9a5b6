"""The error model from a calibration: figures of two real units of the paper, in SI by hand."""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.model import BiasState, Drift, Provenance, Thermal, TurnOn
from imuarray.errors import FusionError
from imuarray.fuse.frames import axes_of
from imuarray.fuse.optimal import ErrorModel, Optimal, error_model
from imuarray.log import SensorLog, open_log
from tests.fuse.conftest import DPS, G, Part, WriteRun, calibration
from tests.fuse.optimal.conftest import frames_of

GYRO = Part("Gyro1", "+X+Y+Z", "angular_rate", "l3g4200d", 2000.0, 100.0, sigma=0.17)
OTHER = GYRO._replace(name="Gyro2", axes="-Y-X-Z", sigma=0.34)
BMA = Part("BMA1", sigma=(0.016, 0.018, 0.017))


@pytest.fixture
def model(write_run: WriteRun) -> Callable[..., ErrorModel]:
    """The model of these parts, their calibration changed by sensor."""

    def made(*parts: Part, watched: Container[str] | None = None, **changes: dict[str, Any]) -> ErrorModel:
        known = calibration(parts).sensors
        changed = {name: replace(one, **changes.get(name, {})) for name, one in known.items()}
        with open_log(write_run(parts, frames=5)) as log:
            sensors: list[SensorLog] = [log[part.name] for part in parts]
            result = error_model(sensors, Calibration(changed), watched=watched)
            Optimal(
                {part.quantity: axes_of([log[part.name]], Calibration(changed)) for part in parts},
                result,
                period_s=0.01,
            )
            return result

    return made


def test_measured_figures_are_used(model: Callable[..., ErrorModel]) -> None:
    measured = {
        "bias_sem_lsb": np.array([3.0, 4.0, 5.0]),
        "turn_on": TurnOn(np.array([4.0, 3.0, 12.0]), np.zeros(3), np.zeros(3), np.zeros(3), 15),
        "response_sem_lsb_per_unit": np.array([0.2, 0.1, 0.3]),
        "thermal": Thermal(np.ones(3), np.array([0.1, 0.2, 0.3]), 25.0, ("bias", "bias", "bias or scale"), "barometer"),
        "temperature_degc": 22.0,
    }
    result = model(GYRO, Gyro1=measured)
    of = [result.axes["Gyro1", index] for index in range(3)]
    lsb = 0.01 * DPS  # 100 counts per dps
    assert [one.noise for one in of] == pytest.approx([17 * lsb] * 3)
    # in addition, Table 4: 0.0083 dps of 1 g, which is not measured here
    assert [one.bias for one in of] == pytest.approx(np.hypot([5 * lsb, 5 * lsb, 13 * lsb], 0.0083 * DPS))
    # nonlinearity: L3G-73, 0.2 % of the range
    assert [one.response for one in of] == pytest.approx(np.hypot([0.002, 0.001, 0.003], 0.002))
    assert [one.slope_per_degc for one in of] == pytest.approx([0.1 * lsb, 0.2 * lsb, np.hypot(1, 0.3) * lsb])
    assert {one.bias_degc for one in of} == {22.0}


def test_a_covariance_of_biases_replaces_their_standard_errors(model: Callable[..., ErrorModel]) -> None:
    covariance = np.array([[9.0, 1, 0], [1, 16, 2], [0, 2, 25]])
    measured = {
        "bias_sem_lsb": np.sqrt(np.diag(covariance)),
        "bias_covariance_lsb2": covariance,
        "turn_on": TurnOn(np.full(3, 6.0), np.full(3, 8.0), np.zeros(3), np.zeros(3), 15),
    }
    result = model(BMA, BMA1=measured)
    lsb = G / 2048
    assert result.bias_covariances["BMA1"] == pytest.approx(covariance * lsb**2)
    assert result.axes["BMA1", 0].bias == pytest.approx(10 * lsb)


def test_two_states_of_a_bias_widen_its_uncertainty(model: Callable[..., ErrorModel]) -> None:
    """Half of the runs 12 counts from the others (as Table 7's Gyro3): a run differs from another by 12 or 0, a mean
    square of 72.
    """
    states = tuple(BiasState(np.array([bias, 0.0, 0.0]), 0.5) for bias in (100.0, 112.0))
    turn_on = TurnOn(np.full(3, 3.0), np.full(3, 4.0), np.zeros(3), np.zeros(3), 15, states)
    measured = {"bias_sem_lsb": np.zeros(3), "turn_on": turn_on, "g_sensitivity_sem_lsb_per_g": np.full((3, 3), 2.0)}
    result = model(GYRO, Gyro1=measured)
    assert result.axes["Gyro1", 0].bias == pytest.approx(np.sqrt(25 + 72 + 4) * 0.01 * DPS)
    assert result.axes["Gyro1", 1].bias == pytest.approx(np.sqrt(25 + 4) * 0.01 * DPS)


def test_figures_that_were_not_measured_are_those_of_the_population(model: Callable[..., ErrorModel]) -> None:
    """Table 11's turn-on: a sixth of a gyroscope's noise; Table 8's slopes, 0.8 of their square common."""
    result = model(GYRO, OTHER, Gyro1={"bias_sem_lsb": np.zeros(3)})
    calibrated, raw = result.axes["Gyro1", 1], result.axes["Gyro2", 1]
    assert calibrated.bias == pytest.approx(np.hypot(0.17 * 0.17, 0.0083) * DPS)
    assert raw.bias == pytest.approx(0.84 * DPS)
    assert calibrated.slope_per_degc == pytest.approx(0.022 * np.sqrt(0.2) * DPS)
    assert calibrated.response == pytest.approx(0.02)
    assert calibrated.drift == pytest.approx(0.04 * 0.17 * DPS)
    design = result.designs["l3g4200d", 1]
    assert design.slope_per_degc == pytest.approx(0.022 * np.sqrt(0.8) * DPS)
    assert design.common == pytest.approx(0.04 * 0.17 * DPS)  # of its quieter unit


def test_without_a_thermometer_slopes_become_drift(model: Callable[..., ErrorModel]) -> None:
    result = model(GYRO, watched=())
    assert result.axes["Gyro1", 0].slope_per_degc == result.designs["l3g4200d", 0].slope_per_degc == 0.0
    assert result.axes["Gyro1", 0].drift == pytest.approx(np.hypot(0.04 * 0.17, 3 * 0.022 * np.sqrt(0.2)) * DPS)
    assert result.designs["l3g4200d", 0].common == pytest.approx(np.hypot(0.04 * 0.17, 3 * 0.022 * np.sqrt(0.8)) * DPS)


def test_known_slopes_become_drift_without_a_thermometer(model: Callable[..., ErrorModel]) -> None:
    """A slope of 4 counts and its standard error of 3, over 3 degC."""
    thermal = Thermal(np.full(3, 4.0), np.full(3, 3.0), 25.0, ("bias",) * 3, "barometer")
    result = model(GYRO, OTHER, watched=["Gyro2"], Gyro1={"thermal": thermal}, Gyro2={"thermal": thermal})
    assert result.axes["Gyro1", 2].drift == pytest.approx(np.hypot(0.04 * 0.17, 3 * 5 * 0.01) * DPS)
    assert result.axes["Gyro2", 2].drift == pytest.approx(0.04 * 0.34 * DPS)
    assert result.axes["Gyro2", 2].slope_per_degc == pytest.approx(3 * 0.01 * DPS)


@pytest.mark.parametrize("noise", [None, np.array([1.0, 0.0, 1.0])])
def test_an_unknown_or_impossible_noise_is_refused(model: Callable[..., ErrorModel], noise: Any) -> None:
    why = "its noise is not known; run" if noise is None else "axis y: noise 0: its readings never change"
    with pytest.raises(FusionError, match=f"sensor BMA1.*{why}"):
        model(BMA, BMA1={"noise_lsb": noise})


def test_measured_noise_correlation_and_drift_are_used(model: Callable[..., ErrorModel]) -> None:
    if "noise_correlation" not in SensorCalibration.__dataclass_fields__:
        pytest.skip("this calibration does not know them")
    from imuarray.calibrate.model import Drift

    drift = Drift(np.array([3.0, 0, 0]), np.array([4.0, 1, 1]), 250.0)
    result = model(BMA, BMA1={"noise_correlation": np.array([0.4, -0.1, 0.0]), "drift": drift})
    assert [result.axes["BMA1", index].correlation for index in range(3)] == [0.4, 0.0, 0.0]
    assert result.axes["BMA1", 0].drift == pytest.approx(5 * G / 2048)
    assert result.axes["BMA1", 0].drift_time_constant_s == 250.0


def test_exactly_known_figures_have_no_added_error(model: Callable[..., ErrorModel]) -> None:
    """Standard errors of zero, as in a study that knows the truth: noise and a clock's error remain."""
    zero = np.zeros(3)
    known = {
        "bias_sem_lsb": zero,
        "turn_on": TurnOn(zero, zero, zero, zero, 0),
        "response_sem_lsb_per_unit": zero,
        "g_sensitivity_sem_lsb_per_g": np.zeros((3, 3)),
        "thermal": Thermal(np.ones(3), zero, 25.0, ("bias",) * 3, "barometer"),
        "drift": Drift(zero, zero, 600.0),
    }
    result = model(GYRO, OTHER, BMA, Gyro1=known, Gyro2=known, BMA1=known)
    for errors in result.axes.values():
        assert (errors.bias, errors.drift, errors.slope_per_degc, errors.response) == (0, 0, 0, 0)
    assert {(design.common, design.slope_per_degc) for design in result.designs.values()} == {(0, 0)}


def test_a_measured_response_has_an_allowance_for_change(model: Callable[..., ErrorModel]) -> None:
    """With any precision of the measurement: nonlinearity of 0.2 % (L3G-73)."""
    measured = model(GYRO, Gyro1={"response_sem_lsb_per_unit": np.full(3, 1e-9)})
    assert [measured.axes["Gyro1", index].response for index in range(3)] == pytest.approx([0.002] * 3)


def test_units_without_measured_drift_share_that_of_the_design(
    model: Callable[..., ErrorModel],
) -> None:
    measured = {
        "drift": Drift(np.full(3, 5.0), np.zeros(3), 600.0),
        "thermal": Thermal(np.ones(3), np.full(3, 3.0), 25.0, ("bias",) * 3, "barometer"),
    }
    result = model(GYRO, OTHER, Gyro1=measured)
    assert not (result.axes["Gyro1", 0].shares_wander or result.axes["Gyro1", 0].shares_slope)
    assert result.axes["Gyro2", 0].shares_wander and result.axes["Gyro2", 0].shares_slope
    design = result.designs["l3g4200d", 0]
    assert design.slope_per_degc == pytest.approx(0.022 * np.sqrt(0.8) * DPS)
    assert design.common == pytest.approx(0.04 * 0.34 * DPS)


def test_the_bias_error_includes_turn_on_of_the_calibration_logs(model: Callable[..., ErrorModel]) -> None:
    """Turn-on 4 counts, drift 3, two logs: 16 now, and (16 + 9) / 2 of the calibration's; drift now is a state."""
    zero = np.zeros(3)
    measured = {
        "bias_sem_lsb": zero,
        "turn_on": TurnOn(np.full(3, 4.0), zero, zero, zero, 15),
        "g_sensitivity_sem_lsb_per_g": np.zeros((3, 3)),
        "drift": Drift(np.full(3, 3.0), zero, 600.0),
        "provenance": {"bias": Provenance(("a.h5", "b.h5"))},
    }
    result = model(GYRO, Gyro1=measured)
    assert result.axes["Gyro1", 0].bias == pytest.approx(np.sqrt(16 + 25 / 2) * 0.01 * DPS)
    assert result.axes["Gyro1", 0].drift == pytest.approx(3 * 0.01 * DPS)


TURNED = [GYRO._replace(name=f"Gyro{number}", axes="+X+Y+Z", sigma=0.05) for number in (1, 2, 3, 4)]


def shaken_error(run: Path, change: float | None = None) -> float:
    """The error of `optimal` over that of the mean: four gyroscopes without a calibration of turns about Y. About Y,
    each determines the sum of x and z to 1 % only, along directions u that differ by some 5e-3; all other elements have
    a stated error of 3e-6. In truth, every element has an error of 5e-4. The calibration states the `change` of
    responses.
    """
    rng = np.random.default_rng(5)
    sensors = calibration(TURNED).sensors
    for name in sensors:
        u = np.zeros(9)
        u[[1, 7]] = 1.0, 1.0 + rng.normal(0, 5e-3)  # responses of x and z to the rate about Y, for each row
        covariance = 1e-11 * np.eye(9) + 0.01**2 * np.outer(u, u)
        sensors[name] = replace(
            sensors[name],
            response_sem_lsb_per_unit=np.ones(3),
            response_covariance_lsb2_per_unit2=100.0**2 * covariance,
            response_change=change,
        )
    known = Calibration(sensors)
    with open_log(run) as log:
        logs = [log[part.name] for part in TURNED]
        model, axes = error_model(logs, known), axes_of(logs, known)
    truth = np.radians(300) * np.sin(np.arange(1000)[:, None] * [0.011, 0.013, 0.017] + np.arange(3.0))
    responses = np.eye(3) + rng.normal(0, 5e-4, (4, 3, 3))
    values = np.einsum("sij,nj->nsi", responses, truth).reshape(len(truth), -1)
    values += rng.normal(0, 0.05 * DPS, values.shape)
    estimate = Optimal({"angular_rate": axes}, model, period_s=0.01)({"angular_rate": frames_of(values)})
    ours, mean = estimate["angular_rate"].triad_box, values.reshape(len(truth), 4, 3).mean(axis=1)
    return float(np.sqrt(((ours - truth) ** 2).mean() / ((mean - truth) ** 2).mean()))


@pytest.mark.slow
def test_an_unmodelled_difference_of_responses_is_not_amplified(write_run: WriteRun) -> None:
    """With equal noise, the mean is the best estimate of the common part; `RESPONSE_CHANGE`."""
    run = write_run(TURNED, frames=5)
    assert shaken_error(run) < 1.1
    assert shaken_error(run, change=0.0) > 10
