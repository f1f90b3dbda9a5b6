"""Other people's drivers of six-axis chips and magnetometers, unmodified, on the emulated chips, which are ideal here.

Adafruit's CircuitPython drivers talk to the emulated wire, M. Ijtsma's mpu6050 (package mpu6050-raspberrypi) and J.
Menegazzo's driver of the MPU-9250 with its AK8963 (package mpu9250-jmdev) to the emulated /dev/i2c-1. Their sleeps pass
on the emulated clock.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from firmware_emulator.array import EmulatedBus, open_array
from firmware_emulator.board import Board
from firmware_emulator.clock import VirtualClock
from firmware_emulator.device_file import Adapter, device_files
from firmware_emulator.element import IDENTITY, SensingElement, UnitDeviations
from firmware_emulator.world import STANDARD_GRAVITY, WorldStimulus
from imuarray.array import parse_array

REASON = "needs {}, which the test extra installs on Linux PCs only (it brings Blinka)"
FORCES = [(0.0, 0.0, STANDARD_GRAVITY), (-9.0, 3.0, 1.0)]
RATES_DPS = [(0.0, 0.0, 0.0), (100.0, -50.0, 25.0), (-200.0, 5.0, 240.0)]
FIELD_GAUSS = (0.21, -0.05, 0.43)


class Bench:
    """An array of ideal chips on one bus, and their input."""

    def __init__(self, *sensors: tuple[str, int]) -> None:
        self.stimulus = WorldStimulus()
        bench = self

        class IdealBoard(Board):
            def element(self, sensor: Any) -> SensingElement:
                return SensingElement(
                    lambda at_ns: bench.stimulus, sensor.chip, sensor.name, IDENTITY, UnitDeviations()
                )

        text = '[array]\nname = "ideal"\n' + "".join(
            f'[[sensor]]\nname = "S{number}"\nchip = "{chip}"\naddress = {address:#x}\n{range_of(chip)}'
            for number, (chip, address) in enumerate(sensors)
        )
        self.bus: EmulatedBus = open_array(parse_array(text), board=IdealBoard)
        self.clock: VirtualClock = self.bus.clock  # type: ignore[assignment]

    def sleep(self, seconds: float) -> None:
        """The replacement of a driver's sleep."""
        self.clock.sleep_until(self.clock.now_ns() + round(1e9 * seconds))

    def feel(self, stimulus: WorldStimulus) -> None:
        """Change the world, and let filters settle."""
        self.stimulus = stimulus
        self.sleep(0.5)


def range_of(chip: str) -> str:
    ranges = {"acc": 4, "gyro": 500, "lis3mdl": 4, "ak8963": 49.12}
    return f"range = {ranges[chip.rpartition('_')[2]]}\n"


def halves(die: str, address: int) -> list[tuple[str, int]]:
    return [(f"{die}_acc", address), (f"{die}_gyro", address)]


def turning(rate_dps: tuple[float, float, float]) -> WorldStimulus:
    x, y, z = (math.radians(rate) for rate in rate_dps)
    return WorldStimulus(rate_box=(x, y, z))


def package(name: str, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The driver's module, whose sleeps pass on the bench's clock."""
    module: ModuleType = pytest.importorskip(name, reason=REASON.format(name))
    if hasattr(module, "sleep"):
        monkeypatch.setattr(module, "sleep", bench.sleep)
    return module


@pytest.fixture(params=["lsm6dso", "mpu6050"])
def circuit_python(request: pytest.FixtureRequest, busio: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Adafruit's driver on its chip, and counts per g and per dps at the ranges that it sets."""
    if request.param == "lsm6dso":
        bench = Bench(*halves("lsm6dso", 0x6A))
        package("adafruit_lsm6ds", bench, monkeypatch)
        module = package("adafruit_lsm6ds.lsm6dsox", bench, monkeypatch)
        chip = module.LSM6DSOX(busio(bench.bus.wire))  # its identity is 0x6C, too: LSM-03
        return SimpleNamespace(bench=bench, chip=chip, per_g=1 / 0.122e-3, per_dps=1 / 8.75e-3, dps=250.0)
    bench = Bench(*halves("mpu6050", 0x68))
    module = package("adafruit_mpu6050", bench, monkeypatch)
    return SimpleNamespace(
        bench=bench, chip=module.MPU6050(busio(bench.bus.wire)), per_g=16384.0, per_dps=65.5, dps=500.0
    )


@pytest.mark.parametrize("force", FORCES)
def test_circuit_python_reads_specific_force(circuit_python: Any, force: tuple[float, float, float]) -> None:
    circuit_python.bench.feel(WorldStimulus(force_box=force))
    count = STANDARD_GRAVITY / circuit_python.per_g
    assert circuit_python.chip.acceleration == pytest.approx(force, abs=count)


@pytest.mark.parametrize("rate_dps", RATES_DPS)
def test_circuit_python_reads_angular_rate(circuit_python: Any, rate_dps: tuple[float, float, float]) -> None:
    circuit_python.bench.feel(turning(rate_dps))
    true = [math.radians(rate) for rate in rate_dps]
    assert circuit_python.chip.gyro == pytest.approx(true, abs=math.radians(1 / circuit_python.per_dps) + 2e-6)


@pytest.mark.parametrize("degc", [-10.0, 25.0, 60.0])
def test_circuit_python_reads_temperature(circuit_python: Any, degc: float) -> None:
    circuit_python.bench.feel(WorldStimulus(temperature_degc=degc))
    assert circuit_python.chip.temperature == pytest.approx(degc, abs=0.01)


def test_circuit_python_refuses_another_chip(busio: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(*halves("mpu6500", 0x68))
    module = package("adafruit_mpu6050", bench, monkeypatch)
    with pytest.raises(RuntimeError, match="Failed to find MPU6050"):
        module.MPU6050(busio(bench.bus.wire))


def test_circuit_python_does_not_increment_the_register_of_a_lis3mdl(
    busio: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bit 7 of the register address increments it (LIS-03); the driver leaves it 0 and gets x's low byte again."""
    bench = Bench(("lis3mdl", 0x1C))
    module = package("adafruit_lis3mdl", bench, monkeypatch)
    chip = module.LIS3MDL(busio(bench.bus.wire))
    bench.feel(WorldStimulus(field_box=FIELD_GAUSS))
    counts = [round(value / 100 * 6842) for value in chip.magnetic]
    low = round(0.21 * 6842) & 0xFF
    assert {count & 0xFF for count in counts} == {low}
    assert {count >> 8 & 0xFF for count in counts} == {low}


@pytest.fixture
def served() -> Any:
    with ExitStack() as stack:

        def serve(bench: Bench) -> None:
            stack.enter_context(device_files({"/dev/i2c-1": Adapter(bench.bus.wire, "bcm2835")}))

        yield serve


@pytest.mark.parametrize("full_scale", [2, 4, 8, 16])
def test_ijtsmas_driver_reads_an_mpu6050(smbus: ModuleType, served: Callable[[Bench], None], full_scale: int) -> None:
    """It wakes the chip, which is asleep after power-on (INV-25), and reads byte by byte."""
    bench = Bench(*halves("mpu6050", 0x68))
    served(bench)
    module = pytest.importorskip("mpu6050", reason="needs mpu6050-raspberrypi, installed by the test extra")
    chip = module.mpu6050(0x68)
    chip.set_accel_range(getattr(chip, f"ACCEL_RANGE_{full_scale}G"))
    chip.set_gyro_range(chip.GYRO_RANGE_1000DEG)
    assert chip.read_accel_range() == full_scale
    bench.feel(WorldStimulus(force_box=(-9.0, 3.0, 1.0), rate_box=(1.0, -2.0, 3.0), temperature_degc=31.0))
    force, rate, degc = chip.get_accel_data(), chip.get_gyro_data(), chip.get_temp()
    assert list(force.values()) == pytest.approx([-9.0, 3.0, 1.0], abs=STANDARD_GRAVITY * full_scale / 32768)
    assert list(rate.values()) == pytest.approx([math.degrees(value) for value in (1.0, -2.0, 3.0)], abs=1 / 32.8)
    assert degc == pytest.approx(31.0, abs=1 / 340)
    chip.bus.close()


def test_menegazzos_driver_reads_an_mpu9250(served: Callable[[Bench], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """It opens the bypass, reads the fuse ROM of the AK8963 and puts the adjustment on its readings (AKM-16)."""
    bench = Bench(*halves("mpu9250", 0x68), ("ak8963", 0x0C))
    served(bench)
    module = pytest.importorskip("mpu9250_jmdev.mpu_9250", reason="needs mpu9250-jmdev, installed by the test extra")
    monkeypatch.setattr(time, "sleep", bench.sleep)
    chip = module.MPU9250(bus=1, gfs=module.GFS_1000, afs=module.AFS_4G)
    chip.configure()
    bench.feel(
        WorldStimulus(
            force_box=(-9.0, 3.0, 1.0),
            rate_box=(1.0, -2.0, 3.0),
            field_box=FIELD_GAUSS,
            temperature_degc=31.0,
        )
    )
    force = [value * STANDARD_GRAVITY for value in chip.readAccelerometerMaster()]
    assert force == pytest.approx([-9.0, 3.0, 1.0], abs=STANDARD_GRAVITY / 8192)
    # It takes 1000 dps for 32768 counts, where the product specification has 32.8 a dps (INV-77): 0.1 % too much.
    degrees = [math.degrees(value) * 32.8 * 1000 / 32768 for value in (1.0, -2.0, 3.0)]
    assert chip.readGyroscopeMaster() == pytest.approx(degrees, abs=1 / 32.8)
    assert chip.readTemperatureMaster() == pytest.approx(31.0, abs=0.01)
    microtesla = chip.readMagnetometerMaster()
    assert microtesla == pytest.approx([100 * gauss for gauss in FIELD_GAUSS], abs=0.2)
    chip.bus.close()
