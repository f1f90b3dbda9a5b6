"""A calibration of unsuitable logs is refused; no figure is computed from motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate import calibrate_noise, calibrate_thermal, calibrate_turn_on
from imuarray.calibrate.motion import STILL, longest_rest, motion_in
from imuarray.calibrate.turn_on import MOST_SEM
from imuarray.cli import main
from imuarray.errors import CalibrationError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SensorHeader
from tests.calibrate.conftest import EPOCH, Floats
from tests.calibrate.motion_logs import RATE_HZ, Felt, record, resting


def carried(seconds: Floats) -> Floats:
    """Swung by a walker: half a g at 2 Hz about gravity."""
    return resting(seconds) + 0.5 * np.sin(2 * np.pi * np.outer(seconds, [2.0, 1.0, 2.0]))


def rolled(seconds: Floats) -> Floats:
    """Turned over within the log, too slowly for a window to detect."""
    angle = np.pi * seconds / seconds[-1]
    return np.stack([np.sin(angle), np.zeros(len(seconds)), np.cos(angle)], axis=1)


def leaning(degrees: float) -> Felt:
    return lambda seconds: np.tile([np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))], (len(seconds), 1))


@pytest.mark.slow
def test_turn_on_of_moving_logs_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [record(tmp_path / f"{seed}.h5", carried, seed) for seed in range(3)]
    assert main(["calibrate", "turn-on", *map(str, paths), "-o", str(tmp_path / "cal.toml")]) == 2
    text = capsys.readouterr().err
    assert "run 1" in text and "must be at rest, but moved" in text and "for 100 % of the time" in text
    assert len(text.splitlines()) == 1
    assert not (tmp_path / "cal.toml").exists()


@pytest.mark.slow
def test_runs_of_several_poses_are_refused_and_named(tmp_path: Path) -> None:
    tilts = (0.0, 1.0, 30.0, 0.5, 40.0)
    logs = [open_log(record(tmp_path / f"{i}.h5", leaning(tilt), i)) for i, tilt in enumerate(tilts)]
    with pytest.raises(CalibrationError, match=r"run 3, .*2\.h5, run 5, .*4\.h5: the box lay 3\d degrees away"):
        calibrate_turn_on(logs)
    for log in logs:
        log.close()


@pytest.mark.slow
def test_a_turn_on_change_too_uncertain_to_determine_is_refused(tmp_path: Path) -> None:
    """Three runs of a tenth of a second that scatter by 0.09 g: less than motion, far more than the required error."""
    logs = [open_log(record(tmp_path / f"{i}.h5", resting, i, seconds=0.1, noise_g=0.09)) for i in range(3)]
    with pytest.raises(CalibrationError, match=r"sensor A: these runs determine the change of the . bias"):
        calibrate_turn_on(logs)
    for log in logs:
        log.close()
    assert MOST_SEM["specific_force"] == 0.05  # BMA-113: 60 mg, and somewhat less


@pytest.mark.parametrize("felt", [carried, rolled])
def test_noise_of_a_phase_that_moves_is_refused(tmp_path: Path, felt: Felt) -> None:
    with (
        open_log(record(tmp_path / "run.h5", felt, 1, phase="static")) as log,
        pytest.raises(
            CalibrationError, match=r"phase 'static': the box must be at rest, but moved .*\(by up to \d\S* m?g\)"
        ),
    ):
        calibrate_noise(log)


@pytest.mark.slow
def test_slopes_of_a_moving_log_are_refused(tmp_path: Path) -> None:
    warm = np.array([[0.0, 100.0, 300.0], [20.0, 40.0, 25.0]])
    with (
        open_log(record(tmp_path / "run.h5", carried, 1, seconds=300.0, warm=warm)) as log,
        pytest.raises(CalibrationError, match=r"run\.h5: the box must be at rest, but moved"),
    ):
        calibrate_thermal(log)
    with open_log(record(tmp_path / "still.h5", resting, 1, seconds=300.0, warm=warm)) as log:
        assert set(calibrate_thermal(log).calibration.sensors) == {"A", "G"}


@pytest.mark.slow
def test_a_box_at_rest_is_not_reported_as_moving(tmp_path: Path) -> None:
    """20 logs with four times the noise of the paper's accelerometers, and a knock of two seconds in each."""

    def knocked(seconds: Floats) -> Floats:
        return resting(seconds) + 2.0 * ((seconds > 20) & (seconds < 22))[:, None] * np.sin(50 * seconds)[:, None]

    for seed in range(20):
        with open_log(record(tmp_path / f"{seed}.h5", knocked, seed, noise_g=STILL["specific_force"] / 1.5)) as log:
            assert motion_in(log, 0, 60 * 10**9) == ""


@pytest.mark.parametrize("quantity", ["magnetic_field", "angular_rate"])
def test_the_rest_is_detected_by_a_magnetometer_or_a_gyroscope(tmp_path: Path, quantity: str) -> None:
    """Ten seconds in which a field or a rate is steady, then two of turning."""
    unit, sigma = ("gauss", 0.002) if quantity == "magnetic_field" else ("dps", 0.1)
    rng, at_s = np.random.default_rng(2), np.arange(600) / RATE_HZ
    values = np.where(at_s < 10, 0.0, 100 * (at_s - 10))[:, None] * [1, 0.5, 0] * sigma + rng.normal(0, sigma, (600, 3))
    with LogWriter(
        tmp_path / "run.h5", [SensorHeader("S", "any", quantity, unit, 100.0, 1000.0)], source="simulated", epoch=EPOCH
    ) as writer:
        counts = np.rint(values * 1000).astype(np.int16)
        writer.append("S", Block(np.round(at_s * 1e9).astype(np.int64), counts, np.zeros(600, np.uint16)))
    with open_log(tmp_path / "run.h5") as log:
        rest = longest_rest(log)
    assert rest is not None
    assert rest.start_ns < 2e9 and 8e9 < rest.end_ns <= 10e9
