"""The bench world is independent and repeatable; closed forms check its chain, and three controls the diagnosis."""

from __future__ import annotations

import ast
import json
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import imuarray
from imuarray.log.reader import verify
from imuarray.simulate import EFFECTS
from tests.bench_world.__main__ import main
from tests.bench_world.arrays import adxl345, alone, bma180, l3g4200d
from tests.bench_world.cases import CASES
from tests.bench_world.chain import Unit, record
from tests.bench_world.chips import Sensor
from tests.bench_world.experiments import static
from tests.bench_world.faults import Fault, RateError
from tests.bench_world.filters import lag, low_pass
from tests.bench_world.motion import Course, grid, motion_of
from tests.bench_world.noise import PowerLaw, draw_noise
from tests.bench_world.parts import draw_part
from tests.bench_world.recorder import Recorder, draw_frames
from tests.bench_world.samples import AFTER_LOSS, SATURATED, STALE, Rows, Session
from tests.bench_world.writer import truth_of, write_case
from tests.selection import some

SMALL = ("c5", "s07")


def rows_at_rest(sensor: Sensor, faults: tuple[Fault, ...] = (), bias_g: float = 0.0, misses: int = 0) -> Rows:
    """Twenty seconds of an ideal accelerometer on its underside, at 100 frames a second."""
    stream = np.random.default_rng(5)
    part = replace(
        draw_part(sensor, stream, 2.5),
        matrix=np.eye(3),
        bias=np.array([0, 0, bias_g]),
        bias_slope=np.zeros(3),
        turn_on=0.0,
    )
    frames = draw_frames(Recorder(100, misses=misses), 20, stream)
    return record(Unit(sensor, part, faults), Session(0, static(stream, 20), frames, 0.0), 0.0, stream)


def test_only_numpy_h5py_and_the_standard_library_are_imported() -> None:
    allowed = set(sys.stdlib_module_names) | {"numpy", "h5py"}
    modules = [path for path in Path(__file__).parent.glob("*.py") if not path.name.startswith("test_")]
    assert len(modules) >= 10
    for path in modules:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                assert name.split(".")[0] in allowed or name.startswith("tests.bench_world"), f"{path.name}: {name}"


def test_there_are_nine_controls_and_21_cases_with_faults() -> None:
    assert Counter(case.kind for case in CASES.values()) == {"control": 9, "single": 15, "unknown": 3, "pair": 3}
    faults = Counter({"control": 0, "single": 1, "unknown": 1, "pair": 2})
    for name, case in CASES.items():
        assert len(case.faults) == faults[case.kind], name
        assert {fault.sensor for fault in case.faults} <= {sensor.name for sensor in case.sensors}, name
        assert all((fault.effect in EFFECTS) == (case.kind != "unknown") for fault in case.faults), name
    assert len({case.seed for case in CASES.values()}) == 30


@pytest.mark.parametrize("name", some(reversed(SMALL), 1))
def test_logs_open_and_are_valid(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    paths = write_case(name, case, tmp_path)
    assert len(paths) == len(case.experiments)
    for path in paths:
        with imuarray.open_log(path) as log:
            assert list(log.sensors) == [sensor.name for sensor in case.sensors]
            for sensor in case.sensors:
                assert log[sensor.name].sensitivity == pytest.approx(sensor.sensitivity)
        verification = verify(path)
        assert verification.problems == ()
        assert verification.remarks == ()


@pytest.mark.slow
def test_a_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    name, case = "s07", CASES["s07"]
    (first,), (again,) = (write_case(name, case, tmp_path / folder) for folder in ("first", "again"))
    (other,) = write_case(name, case, tmp_path / "other", seed_offset=1000)
    assert first.read_bytes() == again.read_bytes()
    assert first.read_bytes() != other.read_bytes()


@pytest.mark.slow
def test_the_command_writes_the_cases_of_a_kind_and_their_truth(tmp_path: Path) -> None:
    main([str(tmp_path), "--kind", "unknown", "--seed-offset", "1000"])
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert [case["case"] for case in truth] == ["u1", "u2", "u3"]
    assert [path.parent.name for path in sorted(tmp_path.glob("*/log1.h5"))] == ["u1", "u2", "u3"]
    assert truth[1]["faults"][0]["effect"] == "package_relaxation"
    assert truth[1]["faults"][0]["sensor"] == "A2"
    assert truth[1]["faults"][0]["time_constant_s"] == 5


def test_the_truth_of_a_control_has_no_fault() -> None:
    assert truth_of("c1", CASES["c1"])["faults"] == []


def test_sensitivities_are_those_of_the_data_sheets() -> None:
    assert bma180("B", 1.5, "+X+Y+Z", 10).sensitivity == 5460  # BMA-71
    assert adxl345("A", 16, "+X+Y+Z", 100).code_span == (-4096, 4095)  # ADX-46
    assert round(100 * l3g4200d("G", 250, "+X+Y+Z", 100, 12.5).sensitivity) == 11429  # L3G-45


def test_the_low_pass_is_a_butterworth_filter_in_its_steady_state() -> None:
    values = 3 + np.random.default_rng(1).normal(size=(4000, 2))
    expected = signal.lfilter(*signal.butter(2, 20, fs=400), values - values[0], axis=0) + values[0]
    np.testing.assert_allclose(low_pass(values, 400, 20), expected, atol=1e-9)
    assert low_pass(values, 400, None) is values


def test_the_lag_of_a_step_is_an_exponential() -> None:
    step = np.r_[0.0, np.ones(1000)]
    np.testing.assert_allclose(lag(step, 0.01, 2.0), 1 - np.exp(-0.01 * np.arange(1001) / 2.0), atol=1e-12)


@pytest.mark.parametrize("exponent", [1, 2])
def test_the_spectrum_of_noise_is_its_power_law(exponent: int) -> None:
    stream = np.random.default_rng(2)
    law = PowerLaw(exponent, 4e-6, 0.5)
    records = [draw_noise(law, 1 << 13, 100, stream) for _ in range(64)]
    frequency_hz, density = signal.periodogram(records, 100, "hann")
    band = (frequency_hz > 0.2) & (frequency_hz < 20)
    ratio = density.mean(0)[band] / (4e-6 * (0.5 / frequency_hz[band]) ** exponent)
    for part in np.array_split(ratio, 4):
        assert part.mean() == pytest.approx(1, abs=0.03)


def test_gravity_rotates_with_the_box() -> None:
    time_s = grid(3.0)
    rate = np.outer(np.ones_like(time_s), [0.5, 0, 0])
    motion = motion_of(Course(3.0, np.eye(3), rate, np.zeros_like(rate), np.full_like(time_s, 22), ()))
    expected = 9.8121 * np.stack([0 * time_s, np.sin(0.5 * time_s), np.cos(0.5 * time_s)], 1)
    np.testing.assert_allclose(motion.force_box, expected, atol=1e-9)


def test_a_frame_after_missed_frames_is_flagged() -> None:
    frames = draw_frames(Recorder(50, misses=4), 300, np.random.default_rng(3))
    longer = np.diff(frames.time_s, prepend=0.0) > 1.5 / 50
    assert frames.follows_loss.sum() == 4
    assert (frames.follows_loss == longer).all()
    rows = rows_at_rest(*alone(adxl345("A", 4, "+X+Y+Z", 100)), misses=4)
    assert (rows.status & AFTER_LOSS).astype(bool).sum() == 4


def test_rows_that_repeat_a_sample_are_flagged() -> None:
    slow = RateError(sensor="A", rate_hz=25.0, size="25 Hz instead of 100 Hz")
    rows = rows_at_rest(*alone(adxl345("A", 4, "+X+Y+Z", 100)), faults=(slow,))
    stale = (rows.status & STALE).astype(bool)
    assert stale.mean() == pytest.approx(0.75, abs=0.02)
    assert (rows.counts[stale] == rows.counts[np.flatnonzero(stale) - 1]).all()


def test_rows_at_the_limits_of_the_codes_are_flagged() -> None:
    rows = rows_at_rest(*alone(bma180("B", 1, "+X+Y+Z", 10)), bias_g=1 - 9.8121 / 9.80665)
    saturated = (rows.status & SATURATED).astype(bool)
    assert 0.1 < saturated.mean() < 0.9
    assert (saturated == (rows.counts == 8191).any(1)).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", some(["c1", "c3", "c5"], 1, 0))
def test_a_control_has_no_gap(tmp_path: Path, name: str) -> None:
    diagnosis = imuarray.diagnose(write_case(name, CASES[name], tmp_path), seed=1)
    assert diagnosis.verdict == "no gap"
    assert diagnosis.causes == ()
