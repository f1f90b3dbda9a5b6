"""The field world is independent and repeatable; closed forms check its chain, and two controls the diagnosis."""

from __future__ import annotations

import ast
import json
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import imuarray
from imuarray.log.reader import verify
from imuarray.simulate import EFFECTS
from tests.field_world.__main__ import main
from tests.field_world.barometer import compensate, raw_codes
from tests.field_world.cases import CASES
from tests.field_world.chain import convert
from tests.field_world.chips import Sensor
from tests.field_world.faults import Displacement, Fault, Quadratic, ScaleError
from tests.field_world.parts import Part
from tests.field_world.plan import KINDS
from tests.field_world.severity import matched_statistic
from tests.field_world.signals import lag, smooth_step
from tests.field_world.surroundings import FACE, UP, World
from tests.field_world.writer import write_case
from tests.selection import some

SMALL = ("lone_gyro", "fast_single")
KEY = ("test",)
DATA_SHEET_WORDS = {
    "AC1": 408,
    "AC2": -72,
    "AC3": -14383,
    "AC4": 32741,
    "AC5": 32757,
    "AC6": 23153,
    "B1": 6190,
    "B2": 4,
    "MB": -32768,
    "MC": -8711,
    "MD": 2868,
}


def still(duration_s: float, face: str = "z_up") -> World:
    """A box at rest on a level table without vibration."""
    world = World(KEY, duration_s, 400)
    world.q = np.tile(FACE[face], (world.n, 1))
    return world.finish()


def values_of(sensor: Sensor, world: World, *faults: Fault) -> np.ndarray:
    """The measured values of a sensor before conversion to codes, in its unit."""
    return convert(world, sensor, Part(KEY, sensor), KEY, 0, faults, 0).real / sensor.sensitivity


@pytest.mark.slow
def test_only_numpy_scipy_h5py_and_the_standard_library_are_imported() -> None:
    allowed = set(sys.stdlib_module_names) | {"numpy", "scipy", "h5py"}
    modules = [path for path in Path(__file__).parent.glob("*.py") if not path.name.startswith("test_")]
    assert len(modules) >= 10
    for path in modules:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                assert name.split(".")[0] in allowed or name.startswith("tests.field_world"), f"{path.name}: {name}"


def test_there_are_20_controls_and_25_cases_with_faults() -> None:
    cases = {name: make() for name, make in CASES.items()}
    assert Counter(case.kind for case in cases.values()) == {"control": 20, "effect": 17, "unknown": 4, "pair": 4}
    for name, case in cases.items():
        assert case.name == name
        assert len(case.faults) == {"control": 0, "effect": 1, "unknown": 1, "pair": 2}[case.kind], name
        assert {fault.sensor for fault in case.faults} <= {sensor.name for sensor in case.sensors}, name
    assert {case.kind for case in cases.values()} == set(KINDS)


def test_the_diagnosis_knows_the_names_of_all_effects() -> None:
    for name, make in CASES.items():
        case = make()
        for fault in case.faults:
            assert (fault.name is None) if case.kind == "unknown" else (fault.name in EFFECTS), name
            assert set(fault.also_acceptable) <= set(EFFECTS), name


@pytest.mark.parametrize("name", some(SMALL, 1))
def test_logs_open_and_are_valid(tmp_path: Path, name: str) -> None:
    case = CASES[name]()
    truth = write_case(case, tmp_path)
    assert truth["effects"] == []
    (path,) = (tmp_path / name).glob("*.h5")
    with imuarray.open_log(path) as log:
        assert set(log.sensors) == {sensor.name for sensor in case.sensors}
        for sensor in case.sensors:
            assert log[sensor.name].sensitivity == pytest.approx(sensor.sensitivity)
    assert verify(path).problems == ()


@pytest.mark.slow
def test_a_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    for folder, offset in (("first", "0"), ("again", "0"), ("other", "1000")):
        main([str(tmp_path / folder), "--seed-offset", offset, "--only", "lone_gyro"])
    first, again, other = (
        [(tmp_path / folder / path).read_bytes() for path in ("lone_gyro/run_1.h5", "truth.json")]
        for folder in ("first", "again", "other")
    )
    assert first == again
    assert first[0] != other[0]
    assert list(json.loads(first[1])) == ["lone_gyro"]


@pytest.mark.parametrize("face", FACE)
def test_gravity_is_along_the_up_axis(face: str) -> None:
    expected = np.zeros(3)
    expected["XYZ".index(UP[face][1])] = 9.80665 if UP[face][0] == "+" else -9.80665
    np.testing.assert_allclose(still(2, face).f, np.tile(expected, (len(still(2, face).f), 1)), atol=0.015)


def test_the_noise_in_the_pass_band_has_the_density_of_the_part() -> None:
    sensor = Sensor("A", "bma180", "acc", 2, 0, 150)
    values = values_of(sensor, still(60))
    rate_hz = 2400 * Part(KEY, sensor).clock
    frequency_hz, power = signal.welch(values, rate_hz, nperseg=4096, axis=0)
    density = np.sqrt(power[(frequency_hz > 5) & (frequency_hz < 40)].mean(0))
    np.testing.assert_allclose(density, Part(KEY, sensor).density, rtol=0.03)
    assert (np.abs(density / 150e-6 - 1) < 0.15).all()  # BMA-110


def test_faults_change_the_readings_by_their_size() -> None:
    sensor, world = Sensor("A", "bma180", "acc", 2, 0, 150), still(10)
    part = Part(KEY, sensor)
    gain = (1 + part.scale[2]) * 0.998
    plain = values_of(sensor, world)
    bent = values_of(sensor, world, Quadratic("A", "z", 0.009)) - plain
    scaled = values_of(sensor, world, ScaleError("A", "z", 0.003)) - plain
    assert bent[:, 2].mean() == pytest.approx(0.009 * gain, rel=0.05)
    assert scaled[:, 2].mean() == pytest.approx(0.003 * gain, rel=0.05)
    assert not bent[:, :2].any()
    moved = Displacement("A", None, 8.0, direction=[0, 0, 2]).position(None, np.zeros(3))
    np.testing.assert_allclose(moved, [0, 0, 0.008])


def test_the_matched_statistic_of_a_line_in_white_noise() -> None:
    noise = np.random.default_rng(4).normal(0, 2.0, (20000, 3))
    line = np.zeros((20000, 3))
    line[:, 1] = 0.1 * np.sin(2 * np.pi * 0.2 * np.arange(20000))
    assert matched_statistic(line, noise) == pytest.approx(0.1 * np.sqrt(20000 / 2) / 2.0, rel=0.05)


def test_the_lag_of_a_step_is_an_exponential() -> None:
    step = np.r_[0.0, np.ones(1000)]
    np.testing.assert_allclose(lag(step, 100, 2.0), 1 - np.exp(-0.01 * np.arange(1001) / 2.0), atol=1e-12)


def test_the_smooth_step_begins_and_ends_at_rest() -> None:
    np.testing.assert_allclose(smooth_step(np.array([-1, 0, 0.5, 1, 2])), [0, 0, 0.5, 1, 1])


def test_the_barometer_computes_the_example_of_its_data_sheet() -> None:
    temperature_c, pressure_pa = compensate(DATA_SHEET_WORDS, np.array([27898]), np.array([23843]), 0)
    assert (temperature_c.item(), pressure_pa.item()) == (15.0, 69964.0)  # BMP-60, BMP-63
    codes = raw_codes(DATA_SHEET_WORDS, np.array([15.0]), np.array([69964.0]), 0)
    again = compensate(DATA_SHEET_WORDS, *codes, 0)
    assert again[0].item() == pytest.approx(15.0, abs=0.11)
    assert again[1].item() == pytest.approx(69964, abs=4)


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["morning_starts", "lone_gyro"])
def test_a_control_has_no_gap(tmp_path: Path, name: str) -> None:
    """Half a minute each; the slow half has a control of tests/bench_world."""
    write_case(CASES[name](), tmp_path)
    diagnosis = imuarray.diagnose(sorted((tmp_path / name).glob("*.h5")), seed=1)
    assert diagnosis.verdict == "no gap"
    assert diagnosis.causes == ()
