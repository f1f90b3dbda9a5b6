"""Chips by their own oscillators, and ICM-42688-P (TDK-24, TDK-25) or MPU-6050 (INV-37) that share a clock."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from firmware_emulator.array import open_array, open_bus
from imuarray.acquire import record
from imuarray.array import ArrayConfig, parse_array
from imuarray.characterise.alignment import find_alignment
from imuarray.errors import ConfigError
from imuarray.log import open_log

OSCILLATORS = {"A1": {"rate_error": 0.008}, "A2": {"rate_error": -0.006}}


def array_of(keys: str = "", *, high_resolution: bool = False) -> ArrayConfig:
    text = '[array]\nname = "a"\n'
    for number in (1, 2):
        for half, full_scale in (("A", 16), ("G", 2000)):
            text += f'[[sensor]]\nname = "{half}{number}"\nchip = "icm42688"\nbus = "/dev/spidev0.{number}"\n'
            text += f"range = {full_scale}\nrate_hz = 1000\nfifo = true\n{keys}\n"
            text += "high_resolution = true\n" if high_resolution else ""
    return parse_array(text)


def periods_ns(path: Path) -> dict[str, float]:
    """The mean period of the rows of each sensor in the second half, since it is estimated in the first seconds."""
    with open_log(path) as log:
        assert not list(log.events)
        times = {name: np.asarray(sensor.time[:], float) for name, sensor in log.sensors.items()}
    return {name: float(t[-1] - t[len(t) // 2]) / (len(t) - 1 - len(t) // 2) for name, t in times.items()}


@pytest.mark.slow
@pytest.mark.parametrize("clock_hz", [32_768.0, 48_000.0])
def test_an_external_clock_keeps_chips_in_step(clock_hz: float, tmp_path: Path) -> None:
    """The rate of rows is that of the clock, 1 kHz times its frequency over 32 kHz, for any oscillators."""
    array = array_of(f"external_clock_hz = {clock_hz}")
    with open_array(array, switches=OSCILLATORS) as bus:
        summary = record(array, bus, tmp_path / "run.h5", rate_hz=40.0, seconds=4.0)
    assert not any(summary.lost.values())
    periods = periods_ns(tmp_path / "run.h5")
    assert list(periods.values()) == pytest.approx([1e6 * 32_000 / clock_hz] * 4, rel=2e-4)
    with open_log(tmp_path / "run.h5") as log:
        assert log["A1"].rate_hz == pytest.approx(1000 * clock_hz / 32_000)


@pytest.mark.slow
@pytest.mark.parametrize(("clock_hz", "rate_hz"), [(32_768.0, 512.0), (32_768.0 * 1.003, 513.536), (19.2e6, 500.0)])
def test_mpu_6050_share_an_external_clock(clock_hz: float, rate_hz: float, tmp_path: Path) -> None:
    """Of 32.768 kHz they make 1.024 kHz, of 19.2 MHz 1 kHz (INV-37), halved here."""
    text = '[array]\nname = "a"\n'
    for number in (1, 2):
        for half, full_scale in (("A", 16), ("G", 2000)):
            text += f'[[sensor]]\nname = "{half}{number}"\nchip = "mpu6050"\naddress = {0x67 + number}\n'
            text += f"range = {full_scale}\nrate_hz = 500\nfifo = true\nexternal_clock_hz = {clock_hz}\n"
    with open_array(parse_array(text), switches=OSCILLATORS) as bus:
        summary = record(parse_array(text), bus, tmp_path / "run.h5", rate_hz=40.0, seconds=4.0)
    assert not any(summary.lost.values())
    assert list(periods_ns(tmp_path / "run.h5").values()) == pytest.approx([1e9 / rate_hz] * 4, rel=2e-4)
    with open_log(tmp_path / "run.h5") as log:
        assert log["A1"].rate_hz == pytest.approx(rate_hz)


@pytest.mark.slow
def test_chips_without_an_external_clock_drift_apart(tmp_path: Path) -> None:
    array = array_of()
    with open_array(array, switches=OSCILLATORS) as bus:
        record(array, bus, tmp_path / "run.h5", rate_hz=40.0, seconds=4.0)
    periods = periods_ns(tmp_path / "run.h5")
    assert periods["A1"] == pytest.approx(1e6 / 1.008, rel=2e-4)
    assert periods["G2"] == pytest.approx(1e6 / 0.994, rel=2e-4)


@pytest.mark.slow
def test_time_stamps_in_high_resolution_follow_the_external_clock(tmp_path: Path) -> None:
    array = array_of("external_clock_hz = 40000", high_resolution=True)
    with open_array(array, switches=OSCILLATORS) as bus:
        summary = record(array, bus, tmp_path / "run.h5", rate_hz=40.0, seconds=1.5)
    assert not any(summary.lost.values())
    assert periods_ns(tmp_path / "run.h5")["A2"] == pytest.approx(0.8e6, rel=2e-3)


@pytest.mark.slow
def test_a_clock_that_is_not_connected_is_reported(tmp_path: Path) -> None:
    """The chip stops (DEC-65): that is reported within a second, and the other chip is not affected."""
    array = array_of("external_clock_hz = 32768")
    with open_array(array, switches={"A1": {"clock_input_hz": 0.0}}) as bus:
        record(array, bus, tmp_path / "run.h5", rate_hz=40.0, seconds=2.0)
    with open_log(tmp_path / "run.h5") as log:
        first = {event.sensor: event for event in reversed(list(log.events))}
        assert set(first) == {"A1", "G1"}
        assert "nothing in its queue for 0." in first["A1"].message
        assert first["A1"].time_ns < 1.0e9
        assert len(log["A1"]) == len(log["G1"]) == 0
        assert len(log["A2"]) == pytest.approx(2 * 1024, abs=60)


@pytest.mark.slow
def test_the_emulated_array_draws_oscillators_on_request(tmp_path: Path) -> None:
    array = array_of()
    query = {"oscillators": "drawn", "seed": "3", "world": "shaking", "still_s": "0.1", "motion_s": "10"}
    with open_bus(query, array) as bus:
        record(array, bus, tmp_path / "run.h5", rate_hz=40.0, seconds=4.0)
    periods = periods_ns(tmp_path / "run.h5")
    assert periods["A1"] == pytest.approx(periods["G1"], rel=2e-4)
    assert abs(periods["A1"] / periods["A2"] - 1) > 1e-3
    assert max(abs(period / 1e6 - 1) for period in periods.values()) < 0.0105
    with open_log(tmp_path / "run.h5") as log:
        alignment = find_alignment(log)
    assert alignment is not None
    sensors = {sensor.name: sensor for sensor in alignment.sensors}
    assert sensors["G2"].rate_ppm == pytest.approx(1e6 * (periods["A1"] / periods["A2"] - 1), abs=200)
    assert sensors["G2"].delay_s == pytest.approx(0.0, abs=50e-6)  # both are timed by their queues


def test_an_unknown_value_for_oscillators_is_refused() -> None:
    with pytest.raises(ValueError, match="oscillators=wild; allowed are exact, drawn"):
        open_bus({"oscillators": "wild"}, array_of())


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('chip = "lsm6dso"\naddress = 0x6A\nrange = 4\n', "external_clock_hz: the lsm6dso_acc has no clock input"),
        ('chip = "icm42688"\naddress = 0x68\nrange = 4\n', "external_clock_hz 12000: .* supports 31000 to 50000 Hz"),
        (
            'chip = "mpu6050"\naddress = 0x68\nrange = 4\n',
            "external_clock_hz 12000: .* supports 32440 to 33096 Hz or 19008000 to 19392000 Hz",
        ),
        ('chip = "mpu6500"\naddress = 0x68\nrange = 4\n', "external_clock_hz: the mpu6500_acc has no clock input"),
    ],
)
def test_an_external_clock_that_the_chip_cannot_use_is_refused(text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        parse_array(f'[array]\nname = "a"\n[[sensor]]\nname = "A"\n{text}external_clock_hz = 12000\n')


def test_both_halves_of_a_chip_must_have_the_same_clock() -> None:
    text = array_of("external_clock_hz = 32768").text.replace(
        "external_clock_hz = 32768", "external_clock_hz = 32000", 1
    )
    with pytest.raises(ConfigError, match="are one icm42688: external_clock_hz is the same for both"):
        parse_array(text)
