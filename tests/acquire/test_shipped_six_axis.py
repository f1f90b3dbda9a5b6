"""The arrays of six-axis chips in configs/, recorded from the emulated bus and read back in physical units."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from firmware_emulator.array import open_array
from imuarray.acquire import connect
from imuarray.acquire.detection import explore, propose
from imuarray.array import load_array, parse_array
from imuarray.calibrate.segments import degc_of
from imuarray.cli import main
from imuarray.errors import SensorError
from imuarray.log import open_log
from tests.selection import some

CONFIGS = Path(__file__).parents[2] / "configs"
SHIPPED = {
    "icm42688x8": ("icm42688", 16, (0.060, 1.0, 5.0)),
    "mpu9250x4": ("mpu9250", 8, (0.150, 6.0, 1.0)),
    "lsm6dso_pair": ("lsm6dso", 4, (0.040, 1.5, 15.0)),
}
"""By array: die, sensors, and how far g, dps and degC may be off at rest: the data sheet's zero, scale and cross-axis
tolerances added up, with room for the mean of the noise (TDK-51 ... TDK-64, LSM-33 ... LSM-62, INV-81 ... INV-94).
"""


class Reset(NamedTuple):
    """What resets a die at `address`, how its data read then (None: it measures, at another range), and the
    accelerometer's own register (address, value) at 4 g and the default rate; `data` are the data registers.
    """

    address: int
    write: bytes
    counts: int | None
    own: tuple[int, int]
    data: range


RESETS = {
    "icm42688": Reset(0x68, b"\x11\x01", -32768, (0x50, 0x46), range(0x1D, 0x2B)),  # TDK-13, -14, -15, -20
    "mpu6500": Reset(0x68, b"\x6b\x80", None, (0x1C, 0x08), range(0x3A, 0x49)),  # INV-71, INV-75
    "lsm6dso": Reset(0x6A, b"\x12\x01", 0, (0x10, 0x58), range(0x1E, 0x2E)),  # LSM-10, -14, -15, -16
}


@pytest.mark.parametrize("name", some(reversed(SHIPPED), 1))
def test_recorded_values_are_read_back_in_physical_units(name: str, tmp_path: Path) -> None:
    die, sensors, (g, dps, degc) = SHIPPED[name]
    path = tmp_path / "run.h5"
    words = ["log", str(CONFIGS / f"{name}.toml"), "--bus", "emulated:?up=-Y", "-o", str(path), "--seconds", "0.3"]
    assert main(words) == 0
    with open_log(path) as log:
        assert len(log.sensors) == sensors
        for sensor in log.sensors.values():
            assert sensor.chip == die + ("_acc" if sensor.quantity == "specific_force" else "_gyro")
            assert not np.asarray(sensor.status[:]).any()
            physical = sensor.counts[:].mean(axis=0) / sensor.sensitivity
            felt = sensor.orientation @ physical
            still, allowed = ((0.0, -1.0, 0.0), g) if sensor.quantity == "specific_force" else ((0.0, 0.0, 0.0), dps)
            assert felt == pytest.approx(still, abs=allowed)
            assert sensor.temperature_counts is not None
            zero_degc, per_count = degc_of(sensor) or (np.nan, np.nan)
            assert zero_degc + per_count * sensor.temperature_counts[:].mean() == pytest.approx(25.0, abs=degc)


@pytest.mark.parametrize("name", SHIPPED)
def test_the_proposal_matches_the_array(name: str) -> None:
    on_i2c = Path(__file__).parents[1] / "data" / f"{name}_i2c.toml"  # on SPI there is no address to search
    array = load_array(on_i2c if on_i2c.exists() else CONFIGS / f"{name}.toml")
    with open_array(array) as bus:
        proposed = parse_array(propose(explore(bus), "emulated:"))
    places = {(sensor.channel, sensor.address, sensor.chip) for sensor in array.sensors}
    assert {(sensor.channel, sensor.address, sensor.chip) for sensor in proposed.sensors} == places


@pytest.mark.parametrize(
    ("name", "identity", "message"),
    [
        ("icm42688x8", 0x42, "identity 42, an ICM-42605, expected 47"),  # TDK-03: the kernel's
        ("icm42688x8", 0x68, "identity 68, an MPU-6050, expected 47"),  # INV-02: the same register
        ("lsm6dso_pair", 0x6A, "identity 6a, an LSM6DSL, LSM6DSM or LSM6DS3TR-C, expected 6c"),  # LSM-03: the kernel's
        ("mpu9250x4", 0x70, "identity 70, an MPU-6500, expected 71"),  # INV-70
        ("mpu9250x4", 0x98, "identity 98, a clone sold as MPU-6050 .*, expected 71"),  # INV-03
        ("icm42688x8", 0x00, "identity 00, which is a line that no chip drives, expected 47"),
    ],
)
def test_another_chip_is_named_by_its_type(name: str, identity: int, message: str) -> None:
    array = load_array(CONFIGS / f"{name}.toml")
    switches = {array.sensors[2].name: {"identity": identity}}
    with open_array(array, switches=switches) as bus, pytest.raises(SensorError, match=message) as refused:
        connect(array, bus)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("die", RESETS)
def test_either_half_sets_up_a_reset_die_and_does_not_touch_the_other(die: str) -> None:
    reset = RESETS[die]
    text = f'[array]\nname = "a"\n[[sensor]]\nname = "A"\nchip = "{die}_acc"\nrange = 4\naddress = {reset.address}\n'
    text += f'[[sensor]]\nname = "G"\nchip = "{die}_gyro"\nrange = 500\naddress = {reset.address}\n'
    array = parse_array(text)
    with open_array(array) as bus:
        accelerometer, gyroscope = (route.driver for route in connect(array, bus))
        page = bus.chips["A"].page
        bus.transfer(reset.address, reset.write)
        bus.clock.sleep_until(bus.clock.now_ns() + 100_000_000)
        counts = accelerometer.decode(np.frombuffer(accelerometer.fetch(), np.uint8).reshape(1, -1)).counts
        assert reset.counts is None or (counts == reset.counts).all()
        gyroscope.configure()
        before = bytes(page)
        accelerometer.configure()
        changed = {address for address, byte in enumerate(bytes(page)) if byte != before[address]}
        own, value = reset.own
        assert own in changed
        assert changed <= {own, *reset.data}
        assert page[own] == value


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name == "lsm6dso_pair" else (pytest.mark.slow,)) for name in SHIPPED],
)
def test_a_die_that_is_reset_while_it_is_logged_is_flagged_and_set_up_again(name: str, tmp_path: Path) -> None:
    """Both halves; the readings that are not flagged stay within six deviations of the median of all."""
    faults, path = tmp_path / "faults.toml", tmp_path / "run.h5"
    faults.write_text('[[fault]]\nkind = "reset"\nsensor = "IMU2_acc"\nat_s = 2.0\n')
    words = ["log", str(CONFIGS / f"{name}.toml"), "--bus", f"emulated:?faults={faults}", "-o", str(path)]
    assert main([*words, "--seconds", "4"]) == 0
    with open_log(path) as log:
        events = {(event.sensor, event.kind) for event in log.events}
        for half in ("acc", "gyro"):
            sensor, other = log[f"IMU2_{half}"], log[f"IMU1_{half}"]
            assert {(sensor.name, "configuration"), (sensor.name, "reconfigured")} <= events
            good = np.asarray(sensor.status[:]) == 0
            assert (sensor.time[:][~good].max() - sensor.time[:][~good].min()) < 1.2e9
            assert good[-25:].all()
            counts = sensor.counts[:][good]
            assert (np.abs(counts - np.median(counts, axis=0)) <= 6 * other.counts[:].std(axis=0) + 1).all()
            assert not np.asarray(other.status[:]).any()
