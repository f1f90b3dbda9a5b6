"""Cases: logs by the real drivers, which do not reveal their mechanisms; a sealed file that states them."""

from __future__ import annotations

import json
from itertools import combinations

import h5py
import numpy as np
import pytest

from firmware_emulator.cases import BenchCase, main
from firmware_emulator.mechanisms import MECHANISMS
from firmware_emulator.mechanisms.experiments import EXPERIMENTS, BenchExperiment
from firmware_emulator.world import HeatingWorld, Shaking, StillWorld
from imuarray.array import load_array
from imuarray.errors import OutputExistsError
from imuarray.log import open_log
from imuarray.shipped import configs
from tests.selection import some

ARRAY = load_array(configs() / "martin2013.toml").only(("BMA1", "BMA3", "Gyro1", "Gyro3"))
SIX_AXIS = load_array(configs() / "icm42688x8.toml").only(("IMU1_acc", "IMU1_gyro"))
SHORT = (
    BenchExperiment("static", StillWorld(), 6.0, phase="static"),
    BenchExperiment("boot", StillWorld(), 1.0, logs=2, phase="run"),
    BenchExperiment("motion", Shaking(peak_g=0.3, peak_dps=100.0, still_s=1.0, motion_s=2.0), 4.0),
)


def written(tmp_path, name, *mechanisms, seed=1, **settings):
    """The folder and the truth of one short case."""
    case = BenchCase.of(ARRAY, SHORT, *mechanisms, seed=seed, **settings)
    paths = case.write(tmp_path / name, tmp_path / "sealed" / f"{name}.json")
    return paths, json.loads((tmp_path / "sealed" / f"{name}.json").read_text())


def outside(path):
    """All names, attributes, shapes and events of a file: everything but its numbers."""
    shown = {}

    def look(name, item):
        pointers = ("REFERENCE_LIST", "DIMENSION_LIST")
        shown[name] = {key: str(value) for key, value in item.attrs.items() if key not in pointers}

    with h5py.File(path) as file:
        shown["/"] = {key: str(value) for key, value in file.attrs.items()}
        file.visititems(look)
    return shown


@pytest.mark.slow
def test_logs_of_two_cases_differ_in_their_numbers_only(tmp_path):
    plain, _ = written(tmp_path, "a")
    other, _ = written(tmp_path, "b", ("mains_ripple", 3.0, ("Gyro3",)), ("log_creep", 7.0, ("BMA3",)), seed=77)
    assert [path.name for path in plain] == [path.name for path in other]
    assert [path.name for path in plain] == ["static.h5", "boot_01.h5", "boot_02.h5", "motion.h5"]
    for first, two in zip(plain, other, strict=True):
        assert outside(first) == outside(two)
        text = two.read_bytes().lower()
        assert not any(word in text for word in (b"severity", b"mechanism", b"ripple", b"creep", b"seed", b"drawn"))
        with open_log(two) as log:
            assert log.truth is None
            assert log.source == "emulated"


@pytest.mark.slow
@pytest.mark.parametrize("name", some(["trapped_charges", "scheduler_latency"], 1, 0))
def test_equal_seeds_give_equal_logs_and_other_seeds_other_logs(tmp_path, name):
    first, two, three = (written(tmp_path, f"{at}", (name, 2.0, ()), seed=seed)[0] for at, seed in enumerate((3, 3, 4)))
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in two]
    assert first[0].read_bytes() != three[0].read_bytes()


@pytest.mark.slow
def test_units_are_the_same_and_noise_differs_between_logs(tmp_path):
    paths, _ = written(tmp_path, "a")
    with open_log(paths[0]) as static, open_log(paths[1]) as first, open_log(paths[2]) as second:
        readings = [log["Gyro3"].counts[:64] for log in (static, first, second)]
        limit = 5 * readings[0].std(axis=0) / np.sqrt(64 / 2)
        assert (np.abs(readings[0].mean(axis=0) - readings[1].mean(axis=0)) < limit).all()
        assert not any(np.array_equal(earlier, later) for earlier, later in combinations(readings, 2))
        assert [phase.name for log in (static, first, second) for phase in log.phases] == ["static", "run 1", "run 2"]


@pytest.mark.slow
def test_the_truth_states_mechanisms_sensors_and_logs(tmp_path):
    _, truth = written(tmp_path, "a", ("package_tilt", 2.0, ("BMA3",)), ("mux_hang", 20.0, ()), seed=9)
    assert truth["seed"] == 9
    tilt, hang = truth["mechanisms"]
    assert tilt == {
        "mechanism": "package_tilt",
        "severity": 2.0,
        "sensors": ["BMA3"],
        "parameters": {"tilt_deg": 4.0},
        "resembles": ["misalignment"],
    }
    assert hang["sensors"] == ["BMA1", "BMA3", "Gyro1", "Gyro3"]  # each begins its segment with a twin
    assert [log["log"] for log in truth["logs"]] == ["static.h5", "boot_01.h5", "boot_02.h5", "motion.h5"]
    assert "multiplexer hung" in truth["logs"][0]["notes"][0]


@pytest.mark.slow
def test_the_truth_states_which_sensors_had_readings_of_a_twin(tmp_path):
    """The first sensor of a segment, without a twin, isn't acknowledged: its order is repeated first."""
    array = load_array(configs() / "martin2013.toml").only(("ADXL1", "BMA1", "BMA3", "Gyro1", "Gyro3"))
    case = BenchCase.of(array, SHORT[:1], ("mux_hang", 20.0, ()))
    case.write(tmp_path / "logs", tmp_path / "truth.json")
    (hang,) = json.loads((tmp_path / "truth.json").read_text())["mechanisms"]
    assert hang["sensors"] == ["BMA3", "Gyro3"]


@pytest.mark.slow
def test_the_truth_in_the_folder_of_the_logs_is_refused(tmp_path):
    case = BenchCase.of(ARRAY, SHORT[:1])
    with pytest.raises(ValueError, match="in the folder of the logs"):
        case.write(tmp_path, tmp_path / "truth.json")
    case.write(tmp_path / "logs", tmp_path / "truth.json")
    with pytest.raises(OutputExistsError):
        case.write(tmp_path / "logs", tmp_path / "truth.json")


@pytest.mark.slow
def test_a_reference_records_the_commanded_course_or_is_omitted(tmp_path):
    heated = BenchExperiment("heating", HeatingWorld(scale=0.005), 6.0)
    complete, silent = (BenchCase.of(ARRAY, [heated], reference=reference) for reference in (True, False))
    (told_path,) = complete.write(tmp_path / "told", tmp_path / "told.json")
    (silent_path,) = silent.write(tmp_path / "silent", tmp_path / "silent.json")
    with open_log(told_path) as log:
        assert log.reference is not None
        assert max(log.reference.temperature[:]) == pytest.approx(52.0, abs=0.1)  # the second peak of section 5.2.5
        assert [phase.name for phase in log.phases] == ["room", "heat", "cool", "heat", "cool"]
    with open_log(silent_path) as log:
        assert log.reference is None
        assert log.truth is None


@pytest.mark.slow
def test_a_faster_reference_follows_a_moving_box(tmp_path):
    moved = BenchExperiment(
        "motion", Shaking(peak_g=0.3, peak_dps=100.0, still_s=1.0, motion_s=2.0), 4.0, reference_hz=500.0
    )
    (path,) = BenchCase.of(ARRAY, [moved], seed=6).write(tmp_path / "logs", tmp_path / "truth.json")
    with open_log(path) as log:
        reference, gyro = log.reference, log["Gyro1"]
        assert np.array_equal(np.diff(reference.time[:]), np.full(1999, 2_000_000))
        dps = np.degrees(reference.angular_rate[:] @ np.asarray(gyro.orientation))
        wanted = np.array([np.interp(gyro.time[:], reference.time[:], axis) for axis in dps.T]).T
        read = gyro.counts[:] * 0.07
        residual = read - read[-40:].mean(axis=0) - wanted
        assert np.abs(wanted).max() > 50
        assert residual.std() < 0.02 * wanted.std() + 0.3  # scale, alignment, 1 ms of age, noise of 0.18 dps


@pytest.mark.slow
@pytest.mark.parametrize("name", some(sorted(set(MECHANISMS)), 16, 0))
def test_every_mechanism_can_be_recorded_at_severity_20(tmp_path, name):
    sensors = ("BMA1", "BMA3") if MECHANISMS[name].place == "pair" else ()
    array = ARRAY if set(MECHANISMS[name].touches) & {"bma180", "l3g4200d"} else SIX_AXIS
    case = BenchCase.of(array, [BenchExperiment("motion", SHORT[2].world, 6.5)], (name, 20.0, sensors), seed=2)
    (path,) = case.write(tmp_path / "logs", tmp_path / "sealed.json")
    with open_log(path) as log:
        assert all(len(log[sensor].time) > 20 for sensor in log.sensors)


def test_the_plan_of_the_paper_takes_nine_minutes_of_emulated_time():
    assert sum(entry.seconds * entry.logs for entry in EXPERIMENTS.values()) == pytest.approx(647.0)


@pytest.mark.slow
def test_the_command_writes_a_case_and_refuses_bad_arguments(tmp_path, capsys):
    where = ["-o", str(tmp_path / "logs"), "--truth", str(tmp_path / "truth.json")]
    small = ["--only", "BMA1,Gyro1", "--experiments", "static", "--rate-hz", "4"]
    asked = ["--mechanism", "log_creep", "--severity", "3", "--sensor", "Gyro1", "--seed", "5"]
    assert main(["martin2013", *where, *small, *asked]) == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / "logs" / "static.h5")]
    assert json.loads((tmp_path / "truth.json").read_text())["mechanisms"][0]["severity"] == 3.0
    assert main(["martin2013", *where, *small]) == 2
    assert "truth.json" in capsys.readouterr().err
    for wrong, message in (
        (["--experiments", "dancing"], "experiment 'dancing'; allowed are static"),
        (["--severity", "3"], "as often as --mechanism"),
        (["--mechanism", "log_creep", "--sensor", "HMC9"], "sensor 'HMC9' for LogCreep"),
    ):
        assert main(["martin2013", *where, *small, *wrong, "--force"]) == 2
        assert message in capsys.readouterr().err


def test_mechanisms_are_described(capsys):
    """The properties of all mechanisms as JSON; a mechanism that is either on or off is not graded."""
    assert main(["--mechanisms"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report) == set(MECHANISMS)
    assert report["mains_ripple"] == {
        "touches": ["adxl345", "bma180", "l3g4200d"],
        "place": "sensor",
        "resembles": ["tone"],
        "graded": True,
    }
    assert not report["rotated_package"]["graded"]
    assert report["one_sided_noise"]["resembles"] == []
