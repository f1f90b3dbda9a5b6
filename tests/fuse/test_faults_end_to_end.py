"""Faults of sensors of the paper's array, from the file of a log to the result: detected within a second, excluded, and
reported; the result equals that of the array without them, down to one sensor and to none.
"""

from __future__ import annotations

import atexit
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from tempfile import mkdtemp
from typing import NamedTuple

import h5py
import numpy as np
import numpy.typing as npt
import pytest

from imuarray.array import load_array
from imuarray.calibrate import Calibration
from imuarray.calibrate.model import nominal
from imuarray.chips import CHIPS
from imuarray.fuse import FaultEvent, FusedBlock, Watch, fuse, live
from imuarray.fuse.fusion import Patience
from imuarray.log import open_log
from imuarray.log.format import SUSPECT
from imuarray.log.sensor_log import recorded_header
from imuarray.simulate import Simulation, load_model, plan_of, write_log
from imuarray.simulate.experiments import EXPERIMENTS, ExperimentOptions
from imuarray.simulate.simulation import effects_of
from tests.fuse.row_pushes import push_rows, read, same
from tests.selection import some

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

CONFIGS = Path(__file__).parents[2] / "configs"
RANGES = {name: chip.sensitivity for name, chip in CHIPS.items()}
ACCELEROMETERS = ("ADXL1", "ADXL2", "BMA1", "BMA2", "BMA3", "BMA4")
GYROSCOPES = ("Gyro1", "Gyro2", "Gyro3")
ARRAY = (*ACCELEROMETERS, *GYROSCOPES)
CALIBRATED = ("range_reset", "bias", "scale", "misalignment", "turn_on_bias")
"""Effects that a calibration would have taken out."""
FALLEN_BACK = {"bma180": {16.0: 2.0, 1.5: 2.0}, "l3g4200d": {2000.0: 250.0, 250.0: 2000.0}}
"""The range that each of the array's configured ones is taken for."""


class Scene(NamedTuple):
    """A simulated log of the array, and the onset of the fault."""

    experiment: str = "static"
    seconds: float = 16.0
    rate_hz: float = 50.0
    drive: str = "hand"
    onset_s: float = 8.03


AT_REST = Scene()
DRIVEN = Scene("motion", 60.0, 100.0, "vehicle", 25.04)


class Technique(NamedTuple):
    """A technique by its name, and whether it is causal."""

    name: str
    causal: bool = False


MEAN, PLANES, SMOOTHED, CAUSAL = (
    Technique("mean"),
    Technique("planes"),
    Technique("optimal"),
    Technique("optimal", True),
)


@lru_cache
def written(scene: Scene) -> tuple[Path, Calibration]:
    """The log without a fault, and a perfect calibration of it."""
    array, model = load_array(CONFIGS / "martin2013.toml"), load_model(CONFIGS / "models/martin2013.toml")
    plan = plan_of(array, scene.rate_hz, scene.seconds)
    effects = effects_of(plan, model, 1, without=CALIBRATED)
    motion = EXPERIMENTS[scene.experiment](ExperimentOptions(seconds=scene.seconds, drive=scene.drive))
    folder = mkdtemp(prefix="imuarray-faults-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = Path(folder) / "run.h5"
    write_log(Simulation(plan, motion, effects, seed=1), path)
    known = {}
    with open_log(path) as log:
        for name in ARRAY:
            rms = next(effect.rms for effect in effects[name] if effect.name == "white_noise")  # type: ignore[attr-defined]
            step = 2.0 if log[name].chip == "adxl345" else 1.0  # it gives only even codes
            noise = np.hypot(np.array(rms) * log[name].sensitivity, step / 12**0.5)
            known[name] = replace(nominal(log[name]), noise_lsb=noise)
    return path, Calibration(known)


Spoil = Callable[[Counts, Floats, float], Counts]
"""Counts (k, 3) from the onset on, the noise (3,) in counts and by what another range would scale them, to others."""


def stick(counts: Counts, noise: Floats, factor: float) -> Counts:
    return np.broadcast_to(counts[0], counts.shape)


def reset(counts: Counts, noise: Floats, factor: float) -> Counts:
    return np.rint(counts * factor).astype(np.int64)


def shift(counts: Counts, noise: Floats, factor: float) -> Counts:
    return np.rint(counts + 10 * noise).astype(np.int64)


FAULTS: dict[str, tuple[Spoil, str]] = {
    "stuck": (stick, "stuck"),
    "reset": (reset, "range_reset"),
    "biased": (shift, "bias"),
}
"""What is done to a sensor, and what it is to be called."""


def spoiled(scene: Scene, sensor: str, fault: str, folder: Path) -> Path:
    """A copy of the log in which a sensor fails."""
    path, known = written(scene)
    copy = folder / f"{sensor}_{fault}.h5"
    shutil.copy(path, copy)
    with h5py.File(copy, "r+") as file:
        group = file[f"sensors/{sensor}"]
        since = int(np.searchsorted(group["time"][:], scene.onset_s * 1e9))
        table, configured = RANGES[group.attrs["chip"]], float(group.attrs["range"])
        other = FALLEN_BACK.get(group.attrs["chip"], {}).get(configured, configured)
        factor = table[other] / table[configured]
        noise = np.asarray(known.sensors[sensor].noise_lsb)
        changed = FAULTS[fault][0](group["counts"][since:].astype(np.int64), noise, factor)
        group["counts"][since:] = np.clip(changed, -32768, 32767).astype(np.int16)
    return copy


def fused(
    path: Path, calibration: Calibration, technique: Technique, only: Sequence[str] = (), on: bool = True
) -> tuple[list[FusedBlock], list[FaultEvent]]:
    result: list[FaultEvent] = []
    with open_log(path) as log:
        blocks = fuse(
            log, calibration, technique.name, causal=technique.causal, only=only, watch=Watch(on, RANGES, result.append)
        )
        return list(blocks), result


def errors(path: Path, blocks: Sequence[FusedBlock], quantity: str, since_s: float) -> Floats:
    """(3,) rms against the log's truth from a moment on."""
    time = np.concatenate([block.time for block in blocks])
    triads = np.concatenate([block.triads[quantity] for block in blocks])
    with open_log(path) as log:
        assert log.truth is not None
        felt, at = np.asarray(getattr(log.truth, quantity)), np.asarray(log.truth.time)
    truth = np.stack([np.interp(time, at, felt[:, axis]) for axis in range(3)], axis=1)
    return np.asarray(np.sqrt(((triads - truth)[time >= since_s * 1e9] ** 2).mean(axis=0)))


@lru_cache
def without(scene: Scene, technique: Technique, sensor: str) -> Floats:
    """(3,) rms of the array that never had the sensor."""
    path, calibration = written(scene)
    blocks, _ = fused(path, calibration, technique, [name for name in ARRAY if name != sensor], on=False)
    return errors(path, blocks, quantity_of(sensor), scene.onset_s)


def quantity_of(sensor: str) -> str:
    return "specific_force" if sensor in ACCELEROMETERS else "angular_rate"


def check(scene: Scene, technique: Technique, sensor: str, fault: str, folder: Path) -> None:
    """Check that the sensor is detected and excluded within a second with the right kind of fault, that no other sensor
    is named, and that the error in x, y and z is at most 10 % above that of the array without the sensor, from the
    onset to the end of the log.
    """
    path = spoiled(scene, sensor, fault, folder)
    blocks, events = fused(path, written(scene)[1], technique)
    verdicts = [event for event in events if event.state in ("isolated", "not isolated")]
    assert {event.sensor for event in verdicts} == {sensor}
    assert {event.state for event in verdicts} == {"isolated"}
    assert 0 <= verdicts[0].time_ns * 1e-9 - scene.onset_s + 0.2 < 1.2  # the window before it may hold the onset
    assert verdicts[0].kind == FAULTS[fault][1]
    quantity = quantity_of(sensor)
    place = sorted(ACCELEROMETERS if sensor in ACCELEROMETERS else GYROSCOPES).index(sensor)
    time = np.concatenate([block.time for block in blocks])
    used = np.concatenate([block.used[quantity][:, place] for block in blocks])
    assert not used[time > (scene.onset_s + 1.0) * 1e9].any()
    assert (errors(path, blocks, quantity, scene.onset_s) < 1.1 * without(scene, technique, sensor)).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("technique", "sensor", "fault"),
    some(
        [
            (MEAN, "Gyro1", "biased"),
            (PLANES, "BMA1", "reset"),
            (SMOOTHED, "BMA4", "stuck"),
            (CAUSAL, "BMA2", "biased"),
        ],
        1,
    ),
    ids=["mean", "planes", "optimal", "causal"],
)
def test_a_fault_at_rest_is_isolated(technique: Technique, sensor: str, fault: str, tmp_path: Path) -> None:
    check(AT_REST, technique, sensor, fault, tmp_path)


EVERY = [(sensor, fault) for sensor in ARRAY for fault in FAULTS if (fault, sensor[:4]) != ("reset", "ADXL")]
"""An ADXL345 at full resolution has one scale whatever its range (ADX-40)."""


TECHNIQUES = {"mean": MEAN, "planes": PLANES, "optimal": SMOOTHED, "causal": CAUSAL}


@pytest.mark.slow
@pytest.mark.parametrize("sensor", some(ARRAY, 4, 0))
def test_a_fault_of_every_kind_at_rest_is_isolated(sensor: str, tmp_path: Path) -> None:
    """Each fault with another technique."""
    turn = ARRAY.index(sensor)
    for index, fault in enumerate(fault for name, fault in EVERY if name == sensor):
        check(AT_REST, list(TECHNIQUES.values())[(turn + index) % 4], sensor, fault, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("technique", "sensor", "fault"),
    [
        ("mean", "BMA2", "reset"),
        pytest.param("mean", "Gyro2", "reset", marks=pytest.mark.campaign),
        ("planes", "ADXL1", "stuck"),
        pytest.param("causal", "BMA1", "reset", marks=pytest.mark.campaign),
        ("causal", "Gyro1", "biased"),
        pytest.param("optimal", "Gyro3", "stuck", marks=pytest.mark.campaign),
    ],
)
def test_a_fault_in_a_vehicle_is_isolated(technique: str, sensor: str, fault: str, tmp_path: Path) -> None:
    """Where sensors are read one after the other, the slope that aligns them is not that of the faulty sensor."""
    check(DRIVEN, TECHNIQUES[technique], sensor, fault, tmp_path)


def edited(folder: Path, change: Callable[[str, h5py.Group], None]) -> Path:
    """A copy of the log at rest with each sensor's group changed."""
    copy = folder / "edited.h5"
    shutil.copy(written(AT_REST)[0], copy)
    with h5py.File(copy, "r+") as file:
        for name in ARRAY:
            change(name, file[f"sensors/{name}"])
    return copy


def flag(group: h5py.Group, since_s: float, until_s: float = np.inf) -> None:
    """Flags readings as suspect and makes them wrong."""
    time = group["time"][:] * 1e-9
    which = (time >= since_s) & (time < until_s)
    status, counts = group["status"][:], group["counts"][:]
    status[which] |= SUSPECT
    counts[which] += 300
    group["status"][:], group["counts"][:] = status, counts


@pytest.mark.slow
@pytest.mark.parametrize("technique", [MEAN, pytest.param(CAUSAL, marks=pytest.mark.slow)], ids=["mean", "optimal"])
def test_flags_of_the_log_are_respected(technique: Technique, tmp_path: Path) -> None:
    """From the first flagged reading on, with or without the monitor; the monitor reports the sensor as silent, and as
    back.
    """

    def flagged(name: str, group: h5py.Group) -> None:
        if name == "BMA1":
            flag(group, 8.03, 12.03)

    path = edited(tmp_path, flagged)
    blocks, events = fused(path, written(AT_REST)[1], technique)
    assert [(event.sensor, event.state) for event in events] == [("BMA1", "silent"), ("BMA1", "back")]
    assert [event.time_ns * 1e-9 for event in events] == pytest.approx([9.0, 13.0], abs=0.25)
    unwatched, _ = fused(path, written(AT_REST)[1], technique, on=False)
    for result in (blocks, unwatched):
        time = np.concatenate([block.time for block in result]) * 1e-9
        used = np.concatenate([block.used["specific_force"][:, 2] for block in result])
        assert not used[(time > 8.04) & (time < 12.02)].any()
        assert (used[(time < 8.02) | (time > 12.04)] == 7).all()
        assert (errors(path, result, "specific_force", 8.03) < 1.1 * without(AT_REST, technique, "BMA1")).all()


@pytest.mark.parametrize("technique", some([(technique,) for technique in TECHNIQUES.values()], 1), ids=TECHNIQUES)
def test_fusion_degrades_to_the_remaining_sensors_and_reports_it(technique: Technique, tmp_path: Path) -> None:
    """Every two or four seconds another sensor ends, until one of each quantity remains, and none."""
    ends_s = {name: 2.0 + 2 * index for index, name in enumerate(ACCELEROMETERS)}
    ends_s |= {name: 4.0 + 4 * index for index, name in enumerate(GYROSCOPES)}
    path = edited(tmp_path, lambda name, group: flag(group, ends_s[name]))
    blocks, events = fused(path, written(AT_REST)[1], technique)
    assert {event.sensor for event in events if event.state == "silent"} == set(ARRAY)
    time = np.concatenate([block.time for block in blocks]) * 1e-9
    for quantity, sensors in (("specific_force", ACCELEROMETERS), ("angular_rate", GYROSCOPES)):
        triads = np.concatenate([block.triads[quantity] for block in blocks])
        used = np.concatenate([block.used[quantity] for block in blocks])
        gone_s = np.array([ends_s[name] for name in sensors])
        there = time[:, None] < gone_s - 0.02
        last = gone_s.max()
        assert np.isfinite(triads[time < last - 0.02]).all()
        assert np.isnan(triads[time > last + 0.02]).all()
        assert (used[there] == 7).all()
        assert not used[time[:, None] > gone_s + 0.02].any()
        alone = (time > np.sort(gone_s)[-2] + 0.02) & (time < last - 0.02)
        felt = {"specific_force": 9.80665, "angular_rate": 0.0}[quantity]
        length = np.linalg.norm(triads[alone].mean(axis=0))
        assert length == pytest.approx(felt, abs={"specific_force": 1.0, "angular_rate": np.radians(1.0)}[quantity])


@pytest.mark.slow
def test_live_fusion_equals_fusion_of_the_log(tmp_path: Path) -> None:
    """Rows cut at random, with one sensor that fails: the same result, and the same events."""
    path, calibration = spoiled(AT_REST, "BMA3", "biased", tmp_path), written(AT_REST)[1]
    result: list[FaultEvent] = []
    with open_log(path) as log:
        headers = [recorded_header(sensor) for sensor in log.sensors.values()]
        stream = live(
            headers, calibration, "optimal", watch=Watch(True, RANGES, result.append), patience=Patience(10.0)
        )
        one = list(push_rows(stream, read(log), 7, 1.5))
    other, events = fused(path, calibration, CAUSAL)
    same(one, other)
    assert [event.sensor for event in result if event.state == "isolated"] == ["BMA3"]
    assert [event.sentence for event in result] == [event.sentence for event in events]


@pytest.mark.slow
def test_sensors_that_get_stuck_in_turn_are_isolated_except_the_last(tmp_path: Path) -> None:
    """The last sensor looks like a box at rest; the loss of redundancy is reported before."""

    def stuck(name: str, group: h5py.Group) -> None:
        if name in GYROSCOPES:
            since = int(np.searchsorted(group["time"][:], (6.0 + 3 * GYROSCOPES.index(name)) * 1e9))
            group["counts"][since:] = np.broadcast_to(group["counts"][since], group["counts"][since:].shape)

    blocks, events = fused(edited(tmp_path, stuck), written(AT_REST)[1], MEAN)
    states = [(event.sensor, event.state) for event in events]
    assert states == [("Gyro1", "isolated"), ("Gyro2", "isolated"), ("Gyro2", "no redundancy")]
    assert np.isfinite(np.concatenate([block.triads["angular_rate"] for block in blocks])).all()
