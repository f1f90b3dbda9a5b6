"""A box that is tumbled by hand without rests: accelerometers from the magnitude of gravity along the path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imuarray.calibrate import TumbleResult, calibrate_tumble
from imuarray.calibrate.tumble import STRETCH_S, _middle
from imuarray.cli import main
from imuarray.errors import CalibrationError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import OVERRUN, SATURATED, SUSPECT
from tests.calibrate.conftest import EPOCH, Floats, accelerometer, gyroscope, ideal
from tests.selection import some

RATE_HZ, G = 100.0, 9.80665
PER_G = 2048.0
NAMES = ("A", "B", "C")


def tumbled(seconds: Floats, rng: np.random.Generator, *, turning_dps: float = 35.0, sway_m: float = 0.02) -> Floats:
    """Specific force (n, 3) in g of a box that is turned to all sides and sways: attitude by small steps of a rate that
    is a sum of slow sines, position by sines of 0.3 to 1 Hz, whose second derivative is in closed form.
    """
    step = seconds[1] - seconds[0]

    def sines(low_hz: float, high_hz: float, order: int = 0) -> Floats:
        hertz, phase = rng.uniform(low_hz, high_hz, (3, 3)), rng.uniform(0, 2 * np.pi, (3, 3))
        angle = 2 * np.pi * hertz[:, :, None] * seconds + phase[:, :, None]
        return np.asarray(((-((2 * np.pi * hertz[:, :, None]) ** 2)) ** order * np.sin(angle)).sum(axis=1).T)

    rate = np.radians(turning_dps) * sines(0.02, 0.12) / np.sqrt(4.5)
    attitude = [Rotation.random(random_state=rng)]
    for small in Rotation.from_rotvec(rate[:-1] * step):
        attitude.append(attitude[-1] * small)
    carried = sway_m / np.sqrt(4.5) * sines(0.3, 1.0, order=1) / G
    return np.asarray(Rotation.concatenate(attitude).inv().apply(np.array([0.0, 0.0, 1.0]) + carried))


def planted(rng: np.random.Generator) -> dict[str, tuple[Floats, Floats]]:
    """Responses whose mean is symmetric, so that it defines the box frame, and biases of 0.1 g."""
    found = {}
    for name in NAMES:
        lean = rng.normal(0, 0.02, (3, 3))
        found[name] = PER_G * (np.eye(3) + (lean + lean.T) / 2), rng.normal(0, 0.1 * PER_G, 3)
    return found


def record(path: Path, force: Floats, sensors: dict[str, tuple[Floats, Floats]], seed: int, gyro: bool = False) -> Path:
    """Noise of 5 mg."""
    rng = np.random.default_rng(seed)
    time = np.round(np.arange(len(force)) * 1e9 / RATE_HZ).astype(np.int64)
    status = np.zeros(len(time), np.uint16)
    headers = [accelerometer(name) for name in sensors] + ([gyroscope("G")] if gyro else [])
    with LogWriter(path, headers, source="simulated", epoch=EPOCH) as writer:
        for name, (response, bias) in sensors.items():
            counts = force @ response.T + bias + rng.normal(0, 0.005 * PER_G, force.shape)
            writer.append(name, Block(time, np.rint(counts).astype(np.int16), status))
        if gyro:
            turning = rng.normal(0, 3000, force.shape)
            writer.append("G", Block(time, np.rint(turning).astype(np.int16), status))
    return path


def found(path: Path) -> TumbleResult:
    with open_log(path) as log:
        return calibrate_tumble(log)


SECONDS = np.arange(0, 120, 1 / RATE_HZ)


@pytest.mark.slow
def test_a_path_without_stops_calibrates_accelerometers(tmp_path: Path) -> None:
    """Two minutes: biases of 100 mg to a few mg, scale factors to a per cent, within five standard errors each;
    gyroscopes are not calibrated.
    """
    rng = np.random.default_rng(1)
    truth = planted(rng)
    result = found(record(tmp_path / "run.h5", tumbled(SECONDS, rng), truth, 1, gyro=True))
    assert result.method == "path"
    assert set(result.calibration.sensors) == set(NAMES)
    assert any("G not calibrated" in warning for warning in result.warnings)
    for name, (response, bias) in truth.items():
        known = result.calibration.sensors[name]
        assert known.bias_sem_lsb is not None and known.response_sem_lsb_per_unit is not None
        assert (known.bias_sem_lsb < 0.01 * PER_G).all()
        assert (np.abs(known.bias_lsb - bias) < 5 * known.bias_sem_lsb).all()
        assert np.abs(known.response_lsb_per_unit - response).max() < 5 * known.response_sem_lsb_per_unit.max()
        assert known.response_sem_lsb_per_unit.max() < 0.01 * PER_G


@pytest.mark.parametrize(("hands", "most"), some([(3, 2.9), (10, 1.9)], 0, 1))
def test_bias_errors_agree_with_the_covariance(tmp_path: Path, hands: int, most: float) -> None:
    """Biases of several motions and boxes. A hand moves to and fro, so that errors of neighbouring segments have
    opposite signs, which the covariance ignores: errors are usually smaller than it states. Their normalised square is
    at least a tenth and at most `most`, which chi-square of three degrees of freedom for each motion exceeds in one of
    400 (the sensors of a box have common errors); no bias is off by four standard errors.
    """
    assert chi2.sf(most * 3 * hands, 3 * hands) < 1 / 400
    squares, worst = [], 0.0
    for seed in range(hands):
        rng = np.random.default_rng(100 + seed)
        truth = planted(rng)
        force = tumbled(SECONDS, rng, turning_dps=rng.uniform(25, 50), sway_m=rng.uniform(0.005, 0.03))
        result = found(record(tmp_path / f"{seed}.h5", force, truth, seed))
        for name, (_, bias) in truth.items():
            known = result.calibration.sensors[name]
            assert known.bias_covariance_lsb2 is not None and known.bias_sem_lsb is not None
            error = known.bias_lsb - bias
            squares.append(float(error @ np.linalg.solve(known.bias_covariance_lsb2, error)) / 3)
            worst = max(worst, float((np.abs(error) / known.bias_sem_lsb).max()))
    assert 0.1 < np.mean(squares) < most
    assert worst < 4


@pytest.mark.slow
def test_a_calm_path_gives_smaller_errors_than_a_fast_one(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    truth = planted(rng)
    sems = []
    for sway_m in (0.003, 0.03):
        force = tumbled(SECONDS, np.random.default_rng(4), sway_m=sway_m)
        known = found(record(tmp_path / f"{sway_m}.h5", force, truth, 1)).calibration.sensors["A"]
        assert known.bias_sem_lsb is not None
        sems.append(float(known.bias_sem_lsb.mean()))
    assert 3 < sems[1] / sems[0] < 30


@pytest.mark.slow
def test_turns_about_one_axis_and_short_paths_are_refused(tmp_path: Path) -> None:
    truth = {"A": (ideal("+X+Y+Z", PER_G), np.zeros(3))}
    flat = 2 * np.pi * SECONDS / 30
    plane = np.stack([np.sin(flat), np.zeros(len(flat)), np.cos(flat)], axis=1)
    with pytest.raises(CalibrationError, match="0 static poses, at least 9 are required, or the six faces; the path"):
        found(record(tmp_path / "plane.h5", plane, truth, 1))
    short = tumbled(SECONDS, np.random.default_rng(5))[: round(20 * STRETCH_S * RATE_HZ)]
    with pytest.raises(CalibrationError, match=r"slow stretches of 0\.5 s, at least 30 are required"):
        found(record(tmp_path / "short.h5", short, truth, 1))


@pytest.mark.slow
def test_the_command_names_the_method(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    run = record(tmp_path / "run.h5", tumbled(SECONDS, rng, sway_m=0.003)[:5000], planted(rng), 1)
    assert main(["calibrate", "tumble", str(run), "-o", str(tmp_path / "cal.toml")]) == 0
    assert "stretches of a path without stops, weighted by how little each moved" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("rows", "flag", "is_sound"),
    some([(5, 0, True), (4, 0, False), (5, SATURATED, False), (5, SUSPECT, False), (5, OVERRUN, True)], 2),
)
def test_the_middle_of_a_segment_by_a_parabola(tmp_path: Path, rows: int, flag: int, is_sound: bool) -> None:
    """1000 + 100 k + 10 k^2, k = -2 ... 2, plus 6 (1, -4, 6, -4, 1), which is orthogonal to every parabola: 36 * 70
    over 5 - 3 degrees of freedom. Four rows, or a saturated or suspect row, give no value.
    """
    k = np.arange(-2, 3)
    counts = np.repeat((1000 + 100 * k + 10 * k**2 + 6 * np.array([1, -4, 6, -4, 1]))[:rows, None], 3, axis=1)
    status = np.zeros(rows, np.uint16)
    status[1] = flag
    time = (np.arange(rows) * 100_000_000 + 50_000_000)[:rows]
    with LogWriter(tmp_path / "r.h5", [accelerometer("A")], source="simulated", epoch=EPOCH) as writer:
        writer.append("A", Block(time, counts.astype(np.int16), status))
    with open_log(tmp_path / "r.h5") as log:
        value, variance, number = _middle(log["A"], 0, 500_000_000)
    assert np.isfinite([value, variance, number]).all() == is_sound
    if is_sound:
        assert value == pytest.approx(1000.0) and variance == pytest.approx(36 * 70 / 2)
        assert number.tolist() == [5.0] * 3
