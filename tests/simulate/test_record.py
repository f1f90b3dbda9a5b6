"""A simulated log: the structure of a recorded log, the same data for any workers."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from imuarray.acquire import record
from imuarray.array import ArrayConfig, load_array
from imuarray.bus import open_bus
from imuarray.errors import OutputExistsError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SensorHeader
from imuarray.simulate import EFFECTS, Simulation, plan_like, plan_of, total_rows, write_log
from imuarray.simulate.motion import Still, Tumble
from imuarray.simulate.motion.like import LikeLog
from imuarray.simulate.record import Division, Origin
from imuarray.simulate.streams import CHUNK
from tests.selection import some

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"


@pytest.fixture(scope="module")
def array() -> ArrayConfig:
    return load_array(CONFIG)


def simulation(array: ArrayConfig, seconds: float = 30.0, motion: Any = None, **options: Any) -> Simulation:
    effects = {
        sensor.name: [
            EFFECTS["white_noise"](rms=0.01),  # type: ignore[call-arg]
            EFFECTS["dropped_samples"](probability=0.01),  # type: ignore[call-arg]
        ]
        for sensor in array.sensors
        if sensor.name in ("BMA1", "Gyro1", "HMC1")
    }
    return Simulation(plan_of(array, 48.0, seconds), motion or Still(), effects, seed=3, **options)


def datasets(path: Path) -> dict[str, Any]:
    result: dict[str, Any] = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: result.update({name: item[...]}) if isinstance(item, h5py.Dataset) else None)
    return result


def shape(path: Path) -> dict[str, Any]:
    """The structure of a log: datasets with kind and width, groups with the names of their attributes."""
    result: dict[str, Any] = {}

    def note(name: str, item: Any) -> None:
        attributes = {key: np.asarray(value).shape for key, value in item.attrs.items()}
        if isinstance(item, h5py.Dataset):
            result[name] = (item.dtype.str, item.shape[1:], item.chunks, item.compression, attributes)
        else:
            result[name] = attributes

    with h5py.File(path) as file:
        result["/"] = sorted(file.attrs)
        file.visititems(note)
    return result


@pytest.mark.slow
def test_a_simulated_log_has_the_structure_of_a_recorded_log(array: ArrayConfig, tmp_path: Path) -> None:
    with open_bus("emulated:", array) as bus:
        record(array, bus, tmp_path / "recorded.h5", rate_hz=48.0, seconds=5.0, phase="static", up="+Z")
    write_log(simulation(array, 5.0), tmp_path / "simulated.h5", origin=Origin(note="x"))
    ours, theirs = shape(tmp_path / "simulated.h5"), shape(tmp_path / "recorded.h5")
    machine = {name for name in theirs if name.startswith("clocks")}  # a simulated log has no machine with clocks
    assert ours.keys() == theirs.keys() - machine
    for name, described in ours.items():
        assert theirs[name] == described, name


@pytest.mark.slow
@pytest.mark.parametrize(("block_rows", "workers"), some([(1000, 1), (16384, 2), (777, 3)], 1))
def test_neither_block_nor_workers_change_a_value(
    array: ArrayConfig, tmp_path: Path, block_rows: int, workers: int
) -> None:
    write_log(simulation(array), tmp_path / "one.h5")
    with ThreadPoolExecutor(workers) as threads:
        write_log(simulation(array), tmp_path / "other.h5", division=Division(block_rows, threads, workers))
    first, other = datasets(tmp_path / "one.h5"), datasets(tmp_path / "other.h5")
    assert first.keys() == other.keys()
    for name, values in first.items():
        np.testing.assert_array_equal(values, other[name], name)


@pytest.mark.slow
def test_dropped_rows_are_counted_and_are_events(array: ArrayConfig, tmp_path: Path) -> None:
    written = write_log(simulation(array), tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        assert len(log["BMA1"]) + written.lost["BMA1"] == written.frames
        assert written.lost["BMA1"] > 0
        silences = [event for event in log.events if event.sensor == "BMA1" and event.kind == "lost"]
        assert 0 < len(silences) <= written.lost["BMA1"]


def test_phases_and_truth_are_written(array: ArrayConfig, tmp_path: Path) -> None:
    motion = Tumble(face_s=4.0, turn_s=1.0)
    write_log(simulation(array, 12.0, motion), tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        assert [(phase.name, phase.up, phase.start_ns * 1e-9) for phase in log.phases] == [
            ("z_up", "+Z", 0.0), ("x_up", "+X", 5.0), ("y_up", "+Y", 10.0),
        ]  # fmt: skip
        assert log.phases[0].end_ns == 4_000_000_000
        assert log.phases[2].end_ns == pytest.approx(12e9, abs=1e9 / 48)
        assert log.truth is not None
        force = np.asarray(log.truth.specific_force)
        assert np.allclose(force[:100], [0, 0, 9.80665])
        assert len(force) == 576  # 12 s at 48 Hz


def test_progress_reaches_the_total_and_an_existing_log_is_not_overwritten(array: ArrayConfig, tmp_path: Path) -> None:
    counts: list[int] = []
    made = simulation(array, 3.0)
    write_log(made, tmp_path / "run.h5", progress=counts.append)
    assert counts == sorted(counts)
    assert counts[-1] == total_rows(made)
    with pytest.raises(OutputExistsError):
        write_log(made, tmp_path / "run.h5")


@pytest.mark.slow
def test_a_log_like_another_has_its_times_and_faces(array: ArrayConfig, tmp_path: Path) -> None:
    write_log(simulation(array, 20.0, Tumble(face_s=2.0, turn_s=1.0)), tmp_path / "first.h5")
    with open_log(tmp_path / "first.h5") as log:
        again = Simulation(plan_like(log), LikeLog(log), {})
        write_log(again, tmp_path / "again.h5", origin=Origin(log.epoch))
        with open_log(tmp_path / "again.h5") as copy:
            assert copy.phases == log.phases
            for name, sensor in log.sensors.items():
                np.testing.assert_array_equal(copy[name].time, sensor.time)
                assert (copy[name].axes, copy[name].range) == (sensor.axes, sensor.range)
            faces = np.asarray(copy["ADXL1"].counts)
            assert faces[10].tolist() == [0, 0, 256]


@pytest.mark.slow
def test_memory_does_not_grow_with_the_log(array: ArrayConfig, tmp_path: Path) -> None:
    import tracemalloc

    peaks = []
    for seconds in (4800.0, 14400.0):
        only = array.only(("BMA1",))
        effects = {"BMA1": [EFFECTS["white_noise"](rms=0.01), EFFECTS["random_walk"](density=0.01)]}  # type: ignore[call-arg]
        made = Simulation(plan_of(only, 48.0, seconds), Still(), effects, seed=3)
        tracemalloc.start()
        write_log(made, tmp_path / f"{seconds:.0f}.h5")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # both fill every chunk that is kept; 20 MB of rows more, three times the length
    assert peaks[1] < 1.1 * peaks[0]


def test_a_thermometer_of_unknown_scale_is_not_simulated(tmp_path: Path) -> None:
    """Of a chip that the package does not know by this name, in more rows than are computed at once."""
    header = SensorHeader("U", "unheard_of", "angular_rate", "dps", 250.0, 131.0, has_temperature=True)
    rows = CHUNK + 100
    path = tmp_path / "log.h5"
    with LogWriter(
        path, [header], source="imported", epoch="2024-01-01T00:00:00Z", config="[rig]\nowner = 'x'\n"
    ) as log:
        time, status = np.arange(rows) * 10_000_000, np.zeros(rows, np.uint16)
        log.append("U", Block(time, np.zeros((rows, 3), np.int16), status, np.full(rows, 7, np.int16)))
    with open_log(path) as log:
        simulated = Simulation(plan_like(log), LikeLog(log), {}).sensors["U"].block(0, rows)
    assert len(simulated.time) == rows
    assert simulated.temperature_counts is None
