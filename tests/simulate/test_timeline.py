"""When rows are read: the recorder's own poll loop over the emulated bus is the other derivation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.acquire import record
from imuarray.array import ArrayConfig, load_array, parse_array
from imuarray.bus import open_bus
from imuarray.log import open_log
from imuarray.simulate.timeline import Recorded, frames_in, poll

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"


@pytest.fixture(scope="module")
def array() -> ArrayConfig:
    return load_array(CONFIG)


@pytest.fixture(scope="module")
def recorded(array: ArrayConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("timeline") / "run.h5"
    with open_bus("emulated:", array) as bus:
        record(array, bus, path, rate_hz=48.0, seconds=20.0)
    return path


def test_rows_come_when_the_recorder_reads_them(array: ArrayConfig, recorded: Path) -> None:
    lines = poll(array, 48.0, 20.0)
    with open_log(recorded) as log:
        for name, sensor in log.sensors.items():
            if sensor.quantity == "pressure":
                continue  # depends on when it was first asked
            stamps = lines[name].stamps(0, lines[name].rows)
            times = np.asarray(sensor.time)
            assert len(stamps) == len(times), name
            # spacing alternates on the way there and back; to within a third of a millisecond of polls and self-checks
            assert np.abs(np.diff(stamps) - np.diff(times)).max() < 400_000, name


def test_the_barometer_gives_as_many_rows(array: ArrayConfig, recorded: Path) -> None:
    lines = poll(array, 48.0, 20.0)
    with open_log(recorded) as log:
        assert abs(lines["BMP180"].rows - len(log["BMP180"])) <= 1


def test_stamps_increase_and_any_stretch_is_the_same(array: ArrayConfig) -> None:
    for line in poll(array, 48.0, 30.0).values():
        whole = line.stamps(0, line.rows)
        assert (np.diff(whole) > 0).all()
        np.testing.assert_array_equal(line.stamps(5, 17), whole[5:17])
        assert whole[-1] < 30e9 + 1e7


def test_a_queue_gives_a_row_for_every_sample() -> None:
    array = parse_array(
        '[array]\nname = "a"\n[[sensor]]\nname = "G"\nchip = "l3g4200d"\naddress = 0x68\nrange = 250\nrate_hz = 400\n'
        "fifo = true"
    )
    line = poll(array, 50.0, 10.0)["G"]
    assert (line.rows, line.rows_per_s) == (4000, 400.0)
    assert line.stamps(0, 3).tolist() == [0, 2_500_000, 5_000_000]


def test_frames_are_counted_as_the_recorder_does() -> None:
    assert frames_in(48.0, 20.0) == (961, 20_833_333)  # the 961st begins 20 ns before the end
    assert frames_in(50.0, 1.0) == (50, 20_000_000)


def test_a_recorded_sensors_own_times(recorded: Path) -> None:
    with open_log(recorded) as log:
        line = Recorded(log["Gyro1"])
        np.testing.assert_array_equal(line.stamps(10, 20), log["Gyro1"].time[10:20])
        assert line.rows_per_s == pytest.approx(48.0, rel=1e-3)
