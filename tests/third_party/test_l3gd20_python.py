"""jackw01's driver of the L3GD20, package l3gd20-python, on the L3G4200D, whose registers and scales it shares.

It uses smbus2 (in place of the smbus that it imports) and the emulated /dev/i2c-1. Its only address is
0x6B, so the chip is at that address.
"""

from __future__ import annotations

import math
from typing import Any

import pytest

from firmware_emulator.world import WorldStimulus

REASON = "needs l3gd20-python, installed by the test extra"
RATES_DPS = [(0.0, 0.0, 0.0), (100.0, -50.0, 25.0), (-200.0, 5.0, 240.0)]


@pytest.fixture
def driver(smbus: Any) -> Any:
    return pytest.importorskip("l3gd20", reason=REASON)


def turning(rate_dps: tuple[float, float, float]) -> WorldStimulus:
    x, y, z = (math.radians(rate) for rate in rate_dps)
    return WorldStimulus(rate_box=(x, y, z))


@pytest.mark.parametrize("rate_dps", RATES_DPS)
@pytest.mark.parametrize(
    ("name", "dps_per_count"), [("RANGE_250DPS", 0.00875), ("RANGE_500DPS", 0.0175), ("RANGE_2000DPS", 0.07)]
)
def test_angular_rate_is_read(
    driver: Any,
    smbus: Any,
    boards: Any,
    serve: Any,
    name: str,
    dps_per_count: float,
    rate_dps: tuple[float, float, float],
) -> None:
    board = boards("l3g4200d", 0x6B)
    serve(board)
    with smbus.SMBus(1) as bus:
        gyroscope = driver.L3GD20(bus)
        gyroscope.set_range(getattr(driver, name))
        board.feel(turning(rate_dps), settle_ns=10**9)
        reading = gyroscope.read()
    for axis, true in zip(reading, rate_dps, strict=True):
        assert axis == pytest.approx(true, abs=dps_per_count)  # L3G-40 ... L3G-42


def test_the_driver_leaves_block_data_update_off(driver: Any, smbus: Any, boards: Any, serve: Any) -> None:
    """CTRL_REG4 gets the range and nothing else, so that a reading may mix two samples (L3G-50)."""
    board = boards("l3g4200d", 0x6B)
    serve(board)
    with smbus.SMBus(1) as bus:
        driver.L3GD20(bus).set_range(driver.RANGE_2000DPS)
        assert bus.read_byte_data(0x6B, 0x23) == 0x20


def test_rate_code_0_is_100_hz_and_not_12_5_hz(driver: Any, smbus: Any, boards: Any, serve: Any) -> None:
    """Its comment takes rate code 00 for 12.5 Hz; in the L3G4200D that is the cut-off, the rate is 100 Hz (L3G-30)."""
    board = boards("l3g4200d", 0x6B)
    serve(board)
    read = []
    with smbus.SMBus(1) as bus:
        gyroscope = driver.L3GD20(bus)
        board.feel(turning((0.0, 0.0, 0.0)), settle_ns=10**9)
        for step in range(500):
            board.feel(turning((step * 0.4, 0.0, 0.0)), settle_ns=2_000_000)
            read.append(gyroscope.read()[0])
    assert len(set(read)) == pytest.approx(500 * 0.0022 * 100, rel=0.1)  # 2 ms and a transaction of some 0.2 ms a step


def test_the_driver_does_not_check_the_identity(driver: Any, smbus: Any, boards: Any, serve: Any) -> None:
    """WHO_AM_I of the chip it was written for is 0xD4; ours is 0xD3 (L3G-10) and is accepted."""
    board = boards("l3g4200d", 0x6B)
    serve(board)
    with smbus.SMBus(1) as bus:
        driver.L3GD20(bus)
        assert bus.read_byte_data(0x6B, driver.L3GD20_REGISTER_WHO_AM_I) == 0xD3
