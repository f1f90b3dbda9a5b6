"""Drained queues: every sample of a fast chip arrives, however slowly it is polled, with times that fit its rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray import open_bus, open_log
from imuarray.acquire import record
from imuarray.array import ArrayConfig, parse_array
from imuarray.errors import ConfigError
from imuarray.log.format import OVERRUN

TEXT = """
[array]
name = "queues"
[[sensor]]
name = "Acc"
chip = "adxl345"
address = 0x53
range = 16
rate_hz = 400
fifo = true
[[sensor]]
name = "Gyro"
chip = "l3g4200d"
address = 0x68
range = 250
rate_hz = 800
bandwidth_hz = 110
fifo = true
"""


@pytest.fixture
def array() -> ArrayConfig:
    return parse_array(TEXT)


@pytest.mark.slow
def test_every_sample_of_a_queue_is_logged(tmp_path: Path, array: ArrayConfig) -> None:
    with open_bus("emulated:", array) as bus:
        record(array, bus, tmp_path / "run.h5", rate_hz=40.0, seconds=5.0)
    with open_log(tmp_path / "run.h5") as log:
        for name, rate_hz in (("Acc", 400.0), ("Gyro", 800.0)):
            time = np.asarray(log[name].time)
            assert len(time) == pytest.approx(5.0 * rate_hz, abs=0.05 * rate_hz)
            spacing_ns = np.diff(time)
            assert spacing_ns.min() > 0
            assert np.median(spacing_ns) == pytest.approx(1e9 / rate_hz, rel=0.01)
            assert not (np.asarray(log[name].status) & OVERRUN).any()


def test_a_poll_that_is_too_slow_is_flagged_as_overrun(tmp_path: Path, array: ArrayConfig) -> None:
    """32 sets at 800 Hz last 40 ms; five frames a second are far too few."""
    with open_bus("emulated:", array) as bus:
        record(array, bus, tmp_path / "run.h5", rate_hz=5.0, seconds=2.0)
    with open_log(tmp_path / "run.h5") as log:
        status = np.asarray(log["Gyro"].status)
        assert np.count_nonzero(status & OVERRUN) >= 8
        assert (np.diff(np.asarray(log["Gyro"].time)) > 0).all()


@pytest.mark.slow
def test_queued_counts_have_the_statistics_of_polled_counts(tmp_path: Path, array: ArrayConfig) -> None:
    """The same chip in the same world: mean and scatter agree within their errors (five of them)."""
    polled = parse_array(TEXT.replace("fifo = true", ""))
    logs = {}
    for name, setting, rate_hz in (("queue", array, 40.0), ("poll", polled, 400.0)):
        with open_bus("emulated:?seed=5", setting) as bus:
            record(setting, bus, tmp_path / f"{name}.h5", rate_hz=rate_hz, seconds=5.0)
        with open_log(tmp_path / f"{name}.h5") as log:
            logs[name] = np.asarray(log["Acc"].counts, float)
    error = np.std(logs["poll"], axis=0) / np.sqrt(len(logs["poll"]))
    assert (np.abs(logs["queue"].mean(axis=0) - logs["poll"].mean(axis=0)) < 5 * np.sqrt(2) * error).all()
    assert np.std(logs["queue"], axis=0) == pytest.approx(np.std(logs["poll"], axis=0), rel=0.1)


def test_a_chip_without_a_queue_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"fifo true: the bma180 has none; allowed for adxl345, l3g4200d"):
        parse_array('[array]\nname="x"\n[[sensor]]\nname="A"\nchip="bma180"\naddress=0x40\nrange=2\nfifo=true\n')


@pytest.mark.slow
def test_a_polled_chip_overruns_only_where_every_sample_was_meant_to_be_read(tmp_path: Path) -> None:
    """100 Hz polled at 250: nothing is lost. Polled at 40: two of three samples pass unread, as they are meant to."""
    array = parse_array('[array]\nname="x"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=2\nrate_hz=100\n')
    for rate_hz in (250.0, 40.0):
        path = tmp_path / f"{rate_hz:.0f}.h5"
        with open_bus("emulated:", array) as bus:
            record(array, bus, path, rate_hz=rate_hz, seconds=2.0)
        with open_log(path) as log:
            assert not (np.asarray(log["A"].status)[1:] & OVERRUN).any()


@pytest.mark.slow
def test_a_late_frame_that_costs_a_sample_is_flagged(tmp_path: Path) -> None:
    """100 Hz polled at 120, and once the poll sleeps for 50 ms: the next reading is flagged for unread samples."""
    array = parse_array('[array]\nname="x"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=2\nrate_hz=100\n')
    with open_bus("emulated:", array) as bus:
        asked = [0]

        def dawdle() -> bool:
            asked[0] += 1
            if asked[0] == 100:
                bus.clock.sleep_until(bus.clock.now_ns() + 50_000_000)
            return False

        record(array, bus, tmp_path / "run.h5", rate_hz=120.0, seconds=2.0, stopped=dawdle)
    with open_log(tmp_path / "run.h5") as log:
        assert np.flatnonzero(np.asarray(log["A"].status)[1:] & OVERRUN).tolist() == [98]
