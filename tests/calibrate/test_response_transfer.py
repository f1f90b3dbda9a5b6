"""Gyroscopes that were turned about two axes, completed by the rates of another gyroscope in the same box."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from imuarray.calibrate import Calibration, calibrate_noise, calibrate_tumble
from imuarray.calibrate.response_transfer import transfer_response
from imuarray.fuse.comparison import compare
from imuarray.fuse.fusion import complete_responses, prepare_inputs
from imuarray.log import Log, open_log
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.noise import WhiteNoise
from tests.calibrate.hand_tumble import HandTumble, attitudes, record
from tests.calibrate.true_responses import true_response
from tests.calibrate.turn_effects import ACCELEROMETERS, about, effects
from tests.selection import some

NAMES = (*ACCELEROMETERS, "Gyro1", "Gyro3")
NOISE = (0.017, 0.18)


def half_known(folder: Path, seed: int) -> Calibration:
    """Gyro1 turned about all axes, Gyro3 about X and Z only; the noise of the paper's chips."""
    parts = []
    for motion in (attitudes(16, np.random.default_rng(900 + seed)), about("XZ", 16, np.random.default_rng(seed))):
        path = record(folder / f"{seed}_{len(parts)}.h5", HandTumble(motion), effects(*NOISE), seed=seed, only=NAMES)
        with open_log(path) as log:
            parts.append(calibrate_tumble(log).calibration.merged(calibrate_noise(log)))
    whole, half = parts
    assert (whole.sensors["Gyro1"].uncertain_axes(), half.sensors["Gyro3"].uncertain_axes()) == ("", "Y")
    return Calibration({**half.sensors, "Gyro1": whole.sensors["Gyro1"]})


def moved(folder: Path, seed: int, turn_s: float = 5.0, axes: str = "XYZ") -> Path:
    motion = HandTumble(about(axes, 12, np.random.default_rng(70 + seed)), rest_s=1.0, turn_s=turn_s)
    return record(folder / f"moved_{seed}_{axes}.h5", motion, effects(*NOISE), seed=77 + seed, only=NAMES)


@pytest.mark.slow
def test_the_third_column_is_within_its_covariance(tmp_path: Path) -> None:
    """Over four worlds, with turns of 2 s and of 5 s: the normalised error squared of the nine entries is chi-square,
    error rate 1e-3; the third column, which the data sheet states to 2 %, within half a per cent.
    """
    squares = []
    for seed in range(4):
        known = half_known(tmp_path, seed)
        with open_log(moved(tmp_path, seed, 2.0 if seed % 2 else 5.0)) as log:
            transfer = transfer_response(log, known)
            true = true_response(log["Gyro3"].sensitivity, log["Gyro3"].orientation)
            assert (transfer.axes, transfer.references, transfer.refused) == ({"Gyro3": "Y"}, ("Gyro1",), ())
            complete = transfer.calibration.sensors["Gyro3"]
            error = complete.response_lsb_per_unit - true
            assert np.abs(error[:, 1]).max() < 0.005 * log["Gyro3"].sensitivity
            assert transfer.calibration.sensors["Gyro1"] is known.sensors["Gyro1"]
        covariance = complete.response_covariance_lsb2_per_unit2
        squares.append(error.ravel() @ np.linalg.solve(covariance, error.ravel()))  # type: ignore[arg-type]
    low, high = chi2.ppf((0.0005, 0.9995), 9 * len(squares))
    assert low < np.sum(squares) < high


def errors_over_noise(log: Log, calibration: Calibration) -> list[float]:
    """Errors of the angular rate in a log by four techniques, each over the noise of its result."""
    scores = compare(log, calibration, ("mean", "opposed", "planes", "ranges")).scores
    errors = [score.error for score in scores if score.quantity == "angular_rate"]
    assert len(errors) == 4
    return [float(np.linalg.norm(error.rms) / np.linalg.norm(error.noise)) for error in errors]


@pytest.mark.slow
def test_every_technique_improves_by_the_transfer(tmp_path: Path) -> None:
    """In motion about all axes the error is at most 1.1 times the noise (before, more than 1.2); `fuse` reports it."""
    known = half_known(tmp_path, 0)
    with open_log(moved(tmp_path, 0)) as log:
        inputs = complete_responses(log, prepare_inputs(log, known))
        assert "response of Gyro3 to rates about box Y determined in this log, from Gyro1" in inputs.remarks
        before, after = (errors_over_noise(log, calibration) for calibration in (known, inputs.calibration))
    assert all(ratio > 1.2 for ratio in before)
    assert all(ratio < 1.1 for ratio in after)


def without_reference(folder: Path, seed: int) -> Calibration:
    """Gyro3 alone, turned about X and Z only, and two accelerometers."""
    motion = HandTumble(about("XZ", 16, np.random.default_rng(seed)))
    path = record(folder / f"half_{seed}.h5", motion, effects(*NOISE), seed=seed, only=(*ACCELEROMETERS, "Gyro3"))
    with open_log(path) as log:
        return calibrate_tumble(log).calibration.merged(calibrate_noise(log))


def rested(folder: Path, seed: int, turn_s: float, bias_g: float = 0.1, axes: str = "XYZ") -> Path:
    """Twelve rests and turns; the accelerometers' bias along x is 0.1 g in the calibration."""
    motion = HandTumble(about(axes, 12, np.random.default_rng(70 + seed)), rest_s=3.0, turn_s=turn_s)
    still = {name: (WhiteNoise((NOISE[0],) * 3), Bias((bias_g, -0.05, 0.02))) for name in ACCELEROMETERS}
    made = {**effects(*NOISE), **still}
    return record(
        folder / f"rested_{seed}_{bias_g}_{axes}.h5", motion, made, seed=77 + seed, only=(*ACCELEROMETERS, "Gyro3")
    )


@pytest.mark.slow
@pytest.mark.parametrize(("bias_g", "most"), some([(0.1, 0.005), (0.12, 0.02)], 1, 0))
def test_the_third_column_from_gravity_is_within_its_covariance(bias_g: float, most: float, tmp_path: Path) -> None:
    """No other gyroscope is known. Over four worlds the normalised error squared of the nine entries is chi-square,
    error rate 1e-3, also if the accelerometers' bias has changed by 20 mg since (1.1 degrees of direction: turns then
    end further off, and the covariance includes it). Then it is at most chi-square: the errors at the ends of a turn
    are one bias, taken to be independent. The third column, which the data sheet states to 2 %, is known to half a per
    cent.
    """
    squares = []
    for seed in range(4):
        known = without_reference(tmp_path, seed)
        with open_log(rested(tmp_path, seed, 2.0 if seed % 2 else 5.0, bias_g)) as log:
            transfer = transfer_response(log, known)
            true = true_response(log["Gyro3"].sensitivity, log["Gyro3"].orientation)
            assert (transfer.axes, transfer.references, transfer.refused) == ({"Gyro3": "Y"}, ("gravity",), ())
            complete = transfer.calibration.sensors["Gyro3"]
            error = complete.response_lsb_per_unit - true
            assert np.abs(error[:, 1]).max() < most * log["Gyro3"].sensitivity
        covariance = complete.response_covariance_lsb2_per_unit2
        squares.append(error.ravel() @ np.linalg.solve(covariance, error.ravel()))  # type: ignore[arg-type]
    low, high = chi2.ppf((0.0005, 0.9995), 9 * len(squares))
    assert (low if bias_g == 0.1 else 0) < np.sum(squares) < high


@pytest.mark.slow
def test_every_technique_improves_by_gravity(tmp_path: Path) -> None:
    """In motion about all axes the error is at most 1.1 times the noise (before, more than 1.4); `fuse` reports it."""
    known = without_reference(tmp_path, 0)
    with open_log(rested(tmp_path, 0, 5.0)) as log:
        inputs = complete_responses(log, prepare_inputs(log, known))
        assert "response of Gyro3 to rates about box Y determined in this log, from gravity" in inputs.remarks
        before, after = (errors_over_noise(log, calibration) for calibration in (known, inputs.calibration))
    assert all(ratio > 1.4 for ratio in before)
    assert all(ratio < 1.1 for ratio in after)


@pytest.mark.slow
def test_uninformative_or_contradicting_gravity_changes_nothing(tmp_path: Path) -> None:
    """Turns about the known axes alone, and rests too short to be detected, leave the calibration as it is; a scale
    factor that is wrong by a fifth in the calibration is contradicted by gravity.
    """
    known = without_reference(tmp_path, 1)
    with open_log(rested(tmp_path, 1, 2.0, axes="XZ")) as log:
        same = transfer_response(log, known)
        assert (same.axes, same.calibration.sensors["Gyro3"].uncertain_axes()) == ({}, "Y")
    hasty = HandTumble(about("XYZ", 12, np.random.default_rng(71)), rest_s=0.2, turn_s=2.0)
    never = record(tmp_path / "never.h5", hasty, effects(*NOISE), only=(*ACCELEROMETERS, "Gyro3"))
    with open_log(never) as log:
        assert transfer_response(log, known).calibration.sensors["Gyro3"] is known.sensors["Gyro3"]
    with open_log(rested(tmp_path, 1, 2.0)) as log:
        alone = Calibration({"Gyro3": known.sensors["Gyro3"]})
        assert transfer_response(log, alone).calibration.sensors == alone.sensors
        response = 1.2 * known.sensors["Gyro3"].response_lsb_per_unit
        wrong = replace(known.sensors["Gyro3"], response_lsb_per_unit=response)
        refusal = transfer_response(log, Calibration({**known.sensors, "Gyro3": wrong}))
        assert (refusal.refused, refusal.axes) == (("Gyro3",), {})


@pytest.mark.slow
def test_responses_that_cannot_be_transferred_stay(tmp_path: Path) -> None:
    """Motion about the known axes alone does not determine the third; without a reference nothing changes; a reference
    whose scale factor has changed by a fifth is detected by the known columns, and is not used.
    """
    known = half_known(tmp_path, 1)
    with open_log(moved(tmp_path, 1, axes="XZ")) as log:
        same = transfer_response(log, known)
        assert (same.axes, same.calibration.sensors["Gyro3"].uncertain_axes()) == ({}, "Y")
        alone = Calibration({"Gyro3": known.sensors["Gyro3"]})
        assert transfer_response(log, alone).calibration.sensors == alone.sensors
    scaled = replace(known.sensors["Gyro1"], response_lsb_per_unit=1.2 * known.sensors["Gyro1"].response_lsb_per_unit)
    with open_log(moved(tmp_path, 1)) as log:
        refusal = transfer_response(log, Calibration({**known.sensors, "Gyro1": scaled}))
        assert (refusal.refused, refusal.axes) == (("Gyro3",), {})
        assert refusal.calibration.sensors["Gyro3"] is known.sensors["Gyro3"]
        contradicted = Calibration({**known.sensors, "Gyro1": scaled})
        remarks = complete_responses(log, prepare_inputs(log, contradicted)).remarks
        assert any(text.startswith("rates of Gyro3 contradict its calibration") for text in remarks)
