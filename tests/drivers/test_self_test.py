"""Self-tests have three outcomes: passed, failed and undetermined; a slow bus or a moving box never gives "failed"."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import pytest

from firmware_emulator.array import open_array
from firmware_emulator.world import Shaking, StillWorld
from imuarray.array import parse_array
from imuarray.drivers import DRIVERS
from tests.selection import some

MS = 1_000_000
SENSORS = {
    "adxl345": "address = 0x53\nrange = 4\nrate_hz = 400\n",
    "bma180": "address = 0x40\nrange = 4\n",
    "l3g4200d": "address = 0x68\nrange = 500\nrate_hz = 400\nbandwidth_hz = 50\n",
    "mpu6050_acc": "address = 0x68\nrange = 4\n",
    "mpu6050_gyro": "address = 0x68\nrange = 500\n",
    "mpu6500_acc": "address = 0x68\nrange = 4\n",
    "mpu9250_gyro": "address = 0x68\nrange = 500\n",
    "icm42688_acc": "address = 0x68\nrange = 4\n",
    "icm42688_gyro": "address = 0x68\nrange = 500\n",
    "lsm6dso_acc": "address = 0x6A\nrange = 8\n",
    "lsm6dso_gyro": "address = 0x6A\nrange = 500\n",
    "bmp180": "address = 0x77\n",
    "bmp280": "address = 0x76\n",
    "bmp388": "address = 0x76\n",
    "hmc5883": "address = 0x1E\nrange = 1.2\nrate_hz = 15\n",
    "hmc5883l": "address = 0x1E\nrange = 1.3\nrate_hz = 15\n",
    "lis3mdl": "address = 0x1C\nrange = 4\n",
    "mmc5983": "address = 0x30\nrange = 8\n",
    "ak8963": "address = 0x0C\nrange = 49.12\n",
    "ak8975": "address = 0x0C\nrange = 12.29\n",
}
DEAD_WITHOUT = {
    "adxl345": (0x31, 0x80),
    "bma180": (0x0D, 0x04),
    "l3g4200d": (0x23, 0x06),
    "mpu6050_acc": (0x1C, 0xE0),
    "mpu6050_gyro": (0x1B, 0xE0),
    "mpu6500_acc": (0x1C, 0xE0),
    "mpu9250_gyro": (0x1B, 0xE0),
    "icm42688_acc": (0x70, 0x38),
    "icm42688_gyro": (0x70, 0x07),
    "lsm6dso_acc": (0x14, 0x03),
    "lsm6dso_gyro": (0x14, 0x0C),
    "lis3mdl": (0x20, 0x01),
    "ak8963": (0x0C, 0x40),
    "ak8975": (0x0C, 0x40),
}
"""Register and bits that start the self-test (ADX-26, BMA-21, L3G-14, INV-13, -14, -75, TDK-41, LSM-20, LIS-16,
AKM-15): without them a chip is dead.
"""


class Slow:
    """A bus whose transactions take so long, before what happens and after; `dead` chips ignore some bits."""

    def __init__(self, bus: Any, delays_ms: Iterator[tuple[float, float]], dead: tuple[int, int] | None = None) -> None:
        self.bus, self.delays_ms, self.dead = bus, delays_ms, dead

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        before_ms, after_ms = next(self.delays_ms)
        if self.dead is not None and len(write) == 2 and write[0] & 0x7F == self.dead[0]:
            write = bytes([write[0], write[1] & ~self.dead[1]])
        self.wait(before_ms)
        answer: bytes = self.bus.transfer(address, write, read)
        self.wait(after_ms)
        return answer

    def wait(self, ms: float) -> None:
        self.bus.clock.sleep_until(self.bus.clock.now_ns() + round(ms * MS))


def outcome(chip: str, delays: Iterator[tuple[float, float]], *, dead: bool = False, world: Any = None) -> Any:
    array = parse_array(f'[array]\nname = "a"\n[[sensor]]\nname = "S"\nchip = "{chip}"\n{SENSORS[chip]}')
    with open_array(array, world=world or StillWorld()) as bus:
        bus.clock.sleep_until(20_000 * MS)
        slow = Slow(bus, delays, DEAD_WITHOUT[chip] if dead else None)
        driver = DRIVERS[chip](slow, array.sensors[0], bus.clock)
        return driver.self_test()


def steady(before_ms: float, after_ms: float) -> Iterator[tuple[float, float]]:
    return itertools.repeat((before_ms, after_ms))


@pytest.mark.parametrize("ms", some([0.0, 0.5, 1.0, 3.0, 7.0, 20.0, 50.0, 100.0], 1))
@pytest.mark.parametrize("chip", SENSORS)
def test_a_working_chip_never_fails(chip: str, ms: float) -> None:
    """For any share of the delay before the transfer."""
    for share in (0.0, 0.5, 1.0):
        verdict = outcome(chip, steady(share * ms, (1 - share) * ms))
        assert verdict.passed is not False, (share, verdict.text)
        # A deflection that lasts as long as its bit is set can be read at any time.
        if ms <= 0.5 or chip not in ("bma180", "bmp180", "bmp280"):
            assert verdict.passed, (share, verdict.text)
        if verdict.passed is None:
            assert "the bus" in verdict.text, share


@pytest.mark.parametrize("pattern", [(0.0, 40.0), (0.2, 0.2, 0.2, 30.0), (25.0, 0.1)])
def test_a_working_chip_does_not_fail_on_a_bus_that_stalls(pattern: tuple[float, ...]) -> None:
    for shift in range(len(pattern)):
        delays = itertools.cycle([(ms, 0.0) for ms in (*pattern[shift:], *pattern[:shift])])
        verdict = outcome("bma180", delays)
        assert verdict.passed is not False, verdict.text


@pytest.mark.parametrize("chip", DEAD_WITHOUT)
def test_a_dead_chip_fails(chip: str) -> None:
    verdict = outcome(chip, steady(0.0, 0.0), dead=True)
    assert verdict.passed is False, verdict.text


@pytest.mark.parametrize("chip", some(DEAD_WITHOUT, 3))
@pytest.mark.parametrize("ms", [20.0, 100.0])
def test_a_dead_chip_never_passes_on_a_slow_bus(chip: str, ms: float) -> None:
    verdict = outcome(chip, steady(ms, 0.0), dead=True)
    assert verdict.passed is (None if chip == "bma180" else False), verdict.text


def test_a_self_test_needs_reads_at_2_ms_at_most() -> None:
    """The limit is 2 ms between reads: a test that lasts 10 ms at most (BMA-104) is then seen five times."""
    assert outcome("bma180", steady(0.7, 0.0), dead=True).passed is False  # the command and a read: 1.8 ms
    assert outcome("bma180", steady(1.0, 0.0), dead=True).passed is None
    assert "the bus allowed 1 look in " in outcome("bma180", steady(30.0, 0.0), dead=True).text


@pytest.mark.parametrize("chip", ["adxl345", "bma180", "l3g4200d"])
@pytest.mark.parametrize("dead", [True, False])
def test_the_self_test_of_a_moving_box_is_undetermined(chip: str, dead: bool) -> None:
    verdict = outcome(chip, steady(0.0, 0.0), dead=dead, world=Shaking())
    assert verdict.passed is None, verdict.text
    assert verdict.text.endswith("it moved during the test: keep it at rest and try again")
