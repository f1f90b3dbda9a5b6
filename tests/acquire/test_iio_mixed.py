"""An array that mixes sensors that the kernel serves with chips on an I2C bus is logged, calibrated, fused and
diagnosed as any other. The kernel's device has the same input as the emulated chips; its bias and scale are known.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_emulator.array import EmulatedBus, open_array
from firmware_emulator.clock import VirtualClock
from firmware_emulator.world import StillWorld, TumbleWorld
from imuarray import load_calibration
from imuarray.acquire import record
from imuarray.array import ArrayConfig, parse_array
from imuarray.bus.iio import IioBus
from imuarray.cli import main
from imuarray.fuse import read_fused, read_fused_head
from imuarray.log import open_log
from imuarray.log.format import LOST_BEFORE, OVERRUN, Phase
from tests.bus.iio_machine import ACCEL, KernelDevice, KernelMachine, scan

pytestmark = pytest.mark.slow

TEXT = """
[array]
name = "mixed buses"
bus = "iio:"

[[sensor]]
name = "Kernel"
chip = "kx023"
quantity = "specific_force"
bus = "iio:kx023"
rate_hz = 50
fifo = true
axes = "+Y-X+Z"

[[sensor]]
name = "Old"
chip = "adxl345"
bus = "/dev/i2c-1"
address = 0x53
range = 4
rate_hz = 400
axes = "-X-Y+Z"

[[sensor]]
name = "New_acc"
chip = "mpu6050"
bus = "/dev/i2c-1"
address = 0x68
range = 4

[[sensor]]
name = "New_gyro"
chip = "mpu6050"
bus = "/dev/i2c-1"
address = 0x68
range = 500
"""
PERIOD_NS = 20_000_000
CODES_PER_G = 9.80665 / 0.000598205  # the scale that the device names
BIAS_G, SCALE = np.array([0.020, -0.035, 0.050]), np.array([1.01, 0.99, 1.02])
NOISE_G = 0.002


class TickedClock(VirtualClock):
    """A virtual clock that calls `ticked(now_ns)` whenever time has passed."""

    def __init__(self) -> None:
        super().__init__(1_000_000_000)
        self.ticked: Callable[[int], None] = lambda now_ns: None

    def advance(self, ns: int) -> None:
        super().advance(ns)
        self.ticked(self.now_ns())

    def sleep_until(self, ns: int) -> None:
        super().sleep_until(ns)
        self.ticked(self.now_ns())


class MixedBus(IioBus):
    """The devices of a machine, and the I2C buses of an emulated array."""

    def __init__(self, root: Path, wired: EmulatedBus) -> None:
        super().__init__(root, clock=wired.clock)
        self.channel_bus = wired.channel_bus  # type: ignore[method-assign]
        self.claim = wired.claim  # type: ignore[method-assign]


def play(device: KernelDevice, array: ArrayConfig, wired: EmulatedBus, clock: TickedClock) -> None:
    """Put a sample of the present input into the device's buffer every 20 ms."""
    generator, turn = np.random.default_rng(5), np.array(array["Kernel"].orientation).T
    begun_ns, count = clock.now_ns(), 0

    def ticked(now_ns: int) -> None:
        nonlocal count
        while (at_ns := begun_ns + count * PERIOD_NS) <= now_ns:
            count += 1
            if device.read("buffer/enable") != "1":
                continue
            felt = turn @ np.array(wired.truth(at_ns).force_box) / 9.80665
            codes = np.round((SCALE * felt + BIAS_G + NOISE_G * generator.standard_normal(3)) * CODES_PER_G)
            device.feed(scan([*((int(code), 2, "little") for code in codes), (at_ns, 8, "little")]))

    clock.ticked = ticked


def log_of(folder: Path, name: str, world: StillWorld | TumbleWorld, seconds: float) -> Path:
    """A log of the array in a world."""
    array, clock, path = parse_array(TEXT), TickedClock(), folder / f"{name}.h5"
    (folder / name).mkdir()
    machine = KernelMachine(folder / name)
    device = machine.add("kx023", "i2c-2/2-001e", {**ACCEL, "in_accel_scale": "0.000598205"})
    parts = TEXT.split("[[sensor]]")
    wired_text = "[[sensor]]".join(part for part in parts if "kx023" not in part).replace('bus = "iio:"', "")
    wired = open_array(parse_array(wired_text), clock=clock, world=world, seed=3)
    phases = [Phase(*phase) for phase in wired.phases] if isinstance(world, TumbleWorld) else []
    play(device, array, wired, clock)
    up = "" if phases else "+Z"
    with MixedBus(machine.root, wired) as bus:
        record(array, bus, path, rate_hz=50, seconds=seconds, phases=phases, phase="" if phases else "static", up=up)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("mixed")
    log_of(place, "still", StillWorld(), 40.0)
    log_of(place, "tumble", TumbleWorld(face_s=5.0), 46.0)
    return place


def test_every_sensor_is_logged_without_a_gap(folder: Path) -> None:
    with open_log(folder / "still.h5") as log:
        assert set(log.sensors) == {"Kernel", "Old", "New_acc", "New_gyro"}
        for name, sensor in log.sensors.items():
            assert len(sensor) == pytest.approx(2000, abs=20), name
            assert not (sensor.status[1:] & (LOST_BEFORE | OVERRUN)).any(), name
        assert log["Kernel"].attributes["time_source"] == "CLOCK_MONOTONIC of the kernel's driver"
        assert "time_source" not in log["Old"].attributes


def test_the_kernels_sensor_is_calibrated_and_fused_with_the_others(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "cal.toml"
    assert main(["calibrate", "tumble", str(folder / "tumble.h5"), "-o", str(path)]) == 0
    calibration = load_calibration(path)
    assert {"Kernel", "Old", "New_acc", "New_gyro"} <= set(calibration.sensors)
    kernel = calibration.sensors["Kernel"]
    # the mean of 250 samples a face, and a tenth of a milli-g for the calibration's alignment of faces
    error_g = 6 * NOISE_G / np.sqrt(250) + 1e-4
    assert np.array(kernel.bias_lsb) / CODES_PER_G == pytest.approx(BIAS_G, abs=error_g)
    assert np.array(kernel.scale_lsb_per_unit) / CODES_PER_G == pytest.approx(SCALE, abs=error_g)

    fused = tmp_path / "fused.h5"
    words = ["fuse", str(folder / "tumble.h5"), "--calibration", str(path), "-o", str(fused)]
    assert main([*words, "--technique", "optimal"]) == 0
    head = read_fused_head(fused)
    assert set(head.sensors["specific_force"]) == {"Kernel", "Old", "New_acc"}
    forces = np.concatenate([block.triads["specific_force"] for block in read_fused(fused)])
    assert np.nanmedian(np.linalg.norm(forces, axis=1)) == pytest.approx(9.80665, rel=2e-3)  # at rest on its faces


def test_the_log_of_a_mixed_array_is_reported_and_diagnosed(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "report.html"
    assert main(["report", str(folder / "still.h5"), "-o", str(page)]) == 0
    assert "Kernel" in page.read_text()
    capsys.readouterr()
    assert main(["gap", "diagnose", str(folder / "still.h5"), "--seed", "1", "--json"]) == 0
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert answer["verdict"] in ("no gap", "explained", "partly explained")
