"""Synchronisation pulses (INV-38, TDK-90, LSM-49): the rows that follow them have the time of the pulse."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_emulator.array import open_array, open_bus
from imuarray.acquire import record
from imuarray.array import ArrayConfig, parse_array
from imuarray.cli import main
from imuarray.errors import ConfigError
from imuarray.log import open_log
from tests.selection import some

PULSE_HZ = 7.0
DIES = {"icm42688": (0x68, 1000), "mpu6050": (0x68, 500), "mpu9250": (0x68, 500), "lsm6dso": (0x6A, 416)}
OSCILLATORS = {"A0": {"rate_error": 0.009, "pulse_hz": PULSE_HZ}, "A1": {"rate_error": -0.006, "pulse_hz": PULSE_HZ}}


def array_of(die: str, keys: str = "fifo = true\nsync_pulse = true\n", halves: str = "AG") -> ArrayConfig:
    address, rate_hz = DIES[die]
    text = '[array]\nname = "a"\n'
    for number in range(2):
        for half, full_scale in (("A", 4), ("G", 500)):
            if half in halves:
                text += f'[[sensor]]\nname = "{half}{number}"\nchip = "{die}"\naddress = {address + number}\n'
                text += f"range = {full_scale}\nrate_hz = {rate_hz}\n{keys}"
    return parse_array(text)


def recorded(array: ArrayConfig, path: Path, seconds: float, switches: Any = OSCILLATORS) -> int:
    """Record `array`; time 0 of the log on the clock of the bus."""
    starts_ns: list[int] = []
    with open_array(array, switches=switches) as bus:
        summary = record(
            array, bus, path, rate_hz=40.0, seconds=seconds, on_headers=lambda *_: starts_ns.append(bus.clock.now_ns())
        )
    assert not any(summary.lost.values())
    return starts_ns[0]


@pytest.mark.parametrize("die", some(DIES, 1))
def test_rows_after_pulses_contain_the_time_of_the_pulse(die: str, tmp_path: Path) -> None:
    """Pulses are at whole multiples of their period on the bus's clock; a row's time is uncertain as the log states."""
    seconds = 1.5 if die == "icm42688" else 6.0
    start_ns = recorded(array_of(die), tmp_path / "run.h5", seconds)
    period_ns = 1e9 / PULSE_HZ
    with open_log(tmp_path / "run.h5") as log:
        for name, sensor in log.sensors.items():
            if die == "lsm6dso" and name[0] == "A":  # only samples of the gyroscope are marked
                assert sensor.sync_pulse is None
                continue
            assert sensor.sync_pulse is not None
            assert sensor.time_uncertainty is not None
            ages_s = np.asarray(sensor.sync_pulse[:], float)
            marked = np.isfinite(ages_s)
            pulses_ns = sensor.time[:][marked] + start_ns - ages_s[marked] * 1e9
            numbers = np.rint(pulses_ns / period_ns)
            allowed_s = float(sensor.attributes["sync_pulse_error"]) + sensor.time_uncertainty[:][marked]
            assert (np.abs(pulses_ns - numbers * period_ns) <= 1e9 * allowed_s).all()
            assert (np.diff(numbers) == 1).all()  # every pulse marks one row
            assert len(numbers) == pytest.approx(seconds * PULSE_HZ, abs=2)
            assert not np.asarray(sensor.status[:]).any()


@pytest.mark.slow
def test_marks_of_pulses_are_removed_from_readings(tmp_path: Path) -> None:
    """The lowest bit of the temperature (MPU-6050) or of the gyroscope's z (LSM6DSO) is 0 in the log."""
    recorded(array_of("mpu6050"), tmp_path / "mpu.h5", 1.0)
    recorded(array_of("lsm6dso"), tmp_path / "lsm.h5", 1.0)
    with open_log(tmp_path / "mpu.h5") as log:
        temperature = log["A0"].temperature_counts
        assert temperature is not None
        assert not (np.asarray(temperature[:]) & 1).any()
        assert (np.asarray(log["G0"].counts[:]) & 1).any()
    with open_log(tmp_path / "lsm.h5") as log:
        even = (np.asarray(log["G0"].counts[:]) & 1).any(axis=0)
        assert even.tolist() == [True, True, False]


@pytest.mark.slow
@pytest.mark.parametrize("half", ["A", "G"])
def test_one_half_of_an_icm_42688_p_alone_has_pulses(half: str, tmp_path: Path) -> None:
    switches = {f"{half}{number}": OSCILLATORS[f"A{number}"] for number in range(2)}
    recorded(array_of("icm42688", halves=half), tmp_path / "run.h5", 1.5, switches)
    with open_log(tmp_path / "run.h5") as log:
        column = log[f"{half}1"].sync_pulse
        assert column is not None
        assert np.isfinite(column[:]).sum() == pytest.approx(10, abs=2)


@pytest.mark.slow
def test_a_queue_with_pulses_that_ran_over_is_flagged(tmp_path: Path) -> None:
    """Stamps do not show missing samples then (DEC-66): a drain from a queue that was full is discarded."""
    array = array_of("icm42688")
    with open_array(array, switches=OSCILLATORS) as bus:
        record(array, bus, tmp_path / "run.h5", rate_hz=5.0, seconds=3.0)
    with open_log(tmp_path / "run.h5") as log:
        rows = np.asarray(log["A0"].time[:])
        status = np.asarray(log["A0"].status[:])
        assert not ((np.diff(rows) > 2.5e6) & (status[1:] == 0)).any()
        assert any("ran over" in event.message or "queue" in event.message for event in log.events)


@pytest.mark.slow
def test_an_export_contains_the_pulses(tmp_path: Path) -> None:
    """The frequency is that of the URL; the column is in exports and in xarray."""
    config = tmp_path / "a.toml"
    config.write_text(array_of("mpu9250").text)
    words = ["log", str(config), "--bus", "emulated:?pulse_hz=20&oscillators=drawn&seed=4", "--seconds", "4"]
    assert main([*words, "-o", str(tmp_path / "run.h5")]) == 0
    assert main(["export", str(tmp_path / "run.h5"), "-o", str(tmp_path / "run.npz")]) == 0
    with np.load(tmp_path / "run.npz") as columns, open_log(tmp_path / "run.h5") as log:
        (key,) = [key for key in columns.files if key.startswith("A0") and key.endswith("sync_pulse")]
        column = log["A0"].sync_pulse
        assert column is not None
        np.testing.assert_array_equal(columns[key], column[:])
        assert np.isfinite(columns[key]).sum() == pytest.approx(80, abs=3)
        dataset = log["A0"].to_xarray()
        assert dataset["sync_pulse"].attrs["units"] == "s"


@pytest.mark.slow
def test_without_pulses_no_row_is_marked(tmp_path: Path) -> None:
    array = array_of("icm42688")
    with open_bus({"pulse_hz": "0"}, array) as bus:
        record(array, bus, tmp_path / "run.h5", rate_hz=40.0, seconds=0.3)
    with open_log(tmp_path / "run.h5") as log:
        column = log["G1"].sync_pulse
        assert column is not None
        assert len(column) > 200
        assert np.isnan(column[:]).all()


@pytest.mark.parametrize("value", ["-1", "2e6", "many"])
def test_invalid_frequencies_of_pulses_are_refused(value: str) -> None:
    with pytest.raises(ValueError, match="pulse_hz"):
        open_bus({"pulse_hz": value}, array_of("icm42688"))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            'chip = "l3g4200d"\naddress = 0x69\nrange = 250\nfifo = true\n',
            "the l3g4200d has no such input",
        ),
        ('chip = "mpu6050"\naddress = 0x68\nrange = 4\n', "sync_pulse: only with fifo = true"),
        (
            'chip = "icm42688"\naddress = 0x68\nrange = 16\nfifo = true\nhigh_resolution = true\n',
            "sync_pulse: not with high_resolution",
        ),
        (
            'chip = "icm42688"\naddress = 0x68\nrange = 4\nfifo = true\nexternal_clock_hz = 32768\n',
            "one pin for pulses and for external_clock_hz",
        ),
        (
            'chip = "icm42688"\naddress = 0x68\nrange = 4\nfifo = true\nrate_hz = 12.5\nbandwidth_hz = 10\n',
            "sync_pulse: only with rate_hz of 25 and more",
        ),
    ],
)
def test_a_sensor_that_cannot_have_pulses_is_refused(text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        parse_array(f'[array]\nname = "a"\n[[sensor]]\nname = "A"\n{text}sync_pulse = true\n')


def test_both_halves_of_a_chip_must_agree_on_pulses() -> None:
    text = array_of("mpu6050").text.replace("sync_pulse = true", "sync_pulse = false", 1)
    with pytest.raises(ConfigError, match="are one mpu6050: sync_pulse is the same for both"):
        parse_array(text)
