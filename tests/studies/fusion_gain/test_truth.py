"""The true calibration of a simulation: its logs, calibrated with it, have the truth and noise of the stated law."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.fuse import aligned
from imuarray.fuse.frames import Frames
from imuarray.log import open_log
from imuarray.simulate import EFFECTS, write_log
from imuarray.simulate.experiments import EXPERIMENTS as MOTIONS
from imuarray.simulate.experiments import ExperimentOptions
from imuarray.studies.fusion_gain.cramer_rao import OUTSIDE, ErrorLaw, law_of, true_calibration
from imuarray.studies.fusion_gain.gain_study import martin2013, perpendicular, simulate
from tests.selection import some

G = 9.80665


def errors_along_axes(
    folder: Path, experiment: str, seconds: float, without: tuple[str, ...], quantity: str, seed: int = 5
) -> tuple[Frames, np.ndarray, ErrorLaw]:
    """Calibrated readings minus the truth along each axis (n, m) in complete frames, and the law."""
    simulation = simulate(martin2013(), MOTIONS[experiment](ExperimentOptions(seconds=seconds)), seed, 0, without)
    write_log(simulation, folder / "run.h5")
    effects = {name: sensor.effects for name, sensor in simulation.sensors.items()}
    headers = [sensor.header for sensor in simulation.sensors.values() if sensor.header.quantity == quantity]
    calibration = true_calibration(headers, effects)
    with open_log(folder / "run.h5") as log:
        names = [sensor.name for sensor in log.of(quantity)]
        parts = [result[quantity] for result, _ in aligned(log, calibration, only=names)]
        part = Frames.joined(parts)
        truth = log.truth
        assert truth is not None
        column = truth.specific_force if quantity == "specific_force" else truth.angular_rate
        assert column is not None
        stimulus = np.asarray(column[:], float)[: len(part.time)]
    law = law_of(headers, effects)
    return part, part.values - stimulus @ law.directions_box.T, law


@pytest.mark.slow
@pytest.mark.parametrize(
    ("quantity", "steps"), some([("specific_force", 1 / 256), ("angular_rate", 0.07 * np.pi / 180)], 1)
)
def test_without_noise_the_true_calibration_gives_the_truth(tmp_path: Path, quantity: str, steps: float) -> None:
    """Faces of a tumble without random effects: the remainder is rounding (of the ADXL345 to two counts of 1/256 g, of
    the L3G4200D to one of 0.07 dps), whose mean over six faces is nearly zero.
    """
    drawn = ("white_noise", "turn_on_bias", "bias_instability", "thermometer")
    part, errors, _ = errors_along_axes(tmp_path, "tumble", 84.0, (*OUTSIDE, *drawn), quantity)
    step_s = np.diff(part.time) * 1e-9
    resting = np.abs(np.gradient(part.values, axis=0)).max(axis=1) < 1e-3
    assert resting.sum() * step_s.mean() > 50
    unit = G if quantity == "specific_force" else 1.0
    assert np.abs(errors[resting]).max() < 1.1 * steps * unit


@pytest.mark.slow
def test_noise_agrees_with_the_law(tmp_path: Path) -> None:
    """Scatter of neighbours over sqrt 2, to five of its standard errors of 1 / sqrt(2 n) 1.2."""
    for quantity in ("specific_force", "angular_rate"):
        (folder := tmp_path / quantity).mkdir()
        _, errors, law = errors_along_axes(folder, "static", 60.0, OUTSIDE, quantity)
        scatter = np.diff(errors, axis=0).std(axis=0) / np.sqrt(2)
        assert scatter / law.noise_si == pytest.approx(np.ones(len(scatter)), abs=5 * 1.2 / np.sqrt(2 * len(errors)))


@pytest.mark.parametrize(
    "boots", [pytest.param(6, marks=pytest.mark.slow), pytest.param(20, marks=pytest.mark.campaign)]
)
def test_slow_errors_agree_with_the_law(tmp_path: Path, boots: int) -> None:
    """Means of 30 s at 20 boots, squared, over the law's variance: a mean over 27 axes of 20 draws is known to
    sqrt(2 / 540) = 6 %, of 6 draws to 11 %; four of these.
    """
    shares = []
    for seed in range(boots):
        for quantity in ("specific_force", "angular_rate"):
            (folder := tmp_path / f"{quantity}{seed}").mkdir()
            _, errors, law = errors_along_axes(folder, "static", 30.0, OUTSIDE, quantity, seed)
            slow = sum(each.loading**2 for each in law.slow) + law.noise_si**2 / len(errors)
            shares.append(errors.mean(axis=0) ** 2 / slow)
    assert np.concatenate(shares).mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / (27 * boots)))


@pytest.mark.slow
def test_a_true_calibration_removes_thermal_slopes(tmp_path: Path) -> None:
    """28 degC in a minute, slopes removed with the barometer's temperature: half-minute means span at most six of their
    standard deviations (3.7 are usual for twenty).
    """
    _, errors, law = errors_along_axes(tmp_path, "heating", 600.0, OUTSIDE, "angular_rate")
    half_minute = np.array([rows.mean(axis=0) for rows in np.array_split(errors, 20)])
    constant = np.sqrt(sum(each.loading**2 for each in law.slow if each.time_constant_s < np.inf))
    assert (np.ptp(half_minute, axis=0) < 6 * np.hypot(constant, law.noise_si / np.sqrt(len(errors) / 20))).all()
    assert np.degrees(np.ptp(half_minute, axis=0)).max() < 0.1  # slopes of 0.008 to 0.036 dps/degC: up to 1 dps


def test_effects_inside_and_outside_the_law() -> None:
    assert set(OUTSIDE) < set(EFFECTS)
    assert {"tone", "g_sensitivity", "bandwidth", "bistable_bias", "range_reset"} <= set(OUTSIDE)
    assert not {"white_noise", "turn_on_bias", "bias_instability", "thermal_bias"} & set(OUTSIDE)


def test_the_perpendicular_boards() -> None:
    """One z along Z, the other along X: each box axis has an axis in a plane of silicon."""
    first, second = (np.array(sensor.orientation) for sensor in perpendicular().sensors if sensor.chip == "adxl345")
    assert first[:, 2].tolist() == [0, 0, 1]
    assert second[:, 2].tolist() == [1, 0, 0]
    assert np.linalg.det(second) == pytest.approx(1.0)
