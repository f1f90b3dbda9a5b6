"""Adafruit's CircuitPython driver of the ADXL34x, package adafruit-circuitpython-adxl34x, on an emulated ADXL345."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import pytest

from firmware_emulator.world import STANDARD_GRAVITY, WorldStimulus

REASON = "needs adafruit-circuitpython-adxl34x, which the test extra installs on Linux PCs only (it brings Blinka)"


@pytest.fixture
def driver(busio: Any) -> Any:
    return pytest.importorskip("adafruit_adxl34x", reason=REASON)


@pytest.fixture
def accelerometer(driver: Any, busio: Any, boards: Any) -> Any:
    board = boards("adxl345", 0x53)
    return SimpleNamespace(board=board, driver=driver, chip=driver.ADXL345(busio(board.wire)))


FORCES = [(0.0, 0.0, STANDARD_GRAVITY), (-9.0, 3.0, 1.0), (5.0, -14.0, -7.5)]


@pytest.mark.parametrize("force", FORCES)
def test_acceleration_is_read_with_the_scale_of_the_driver(
    accelerometer: Any, force: tuple[float, float, float]
) -> None:
    """It takes 0.004 g a count, where the data sheet has 1/256 g (ADX-40): all its values are 2.4 % too large."""
    accelerometer.board.feel(WorldStimulus(force_box=force))
    count = 0.004 * STANDARD_GRAVITY
    for value, true in zip(accelerometer.chip.acceleration, force, strict=True):
        assert value == pytest.approx(true * 256 / 250, abs=count)
        if abs(true) > 9:
            assert value != pytest.approx(true, abs=2 * count)


@pytest.mark.parametrize("name", ["RANGE_2_G", "RANGE_4_G", "RANGE_8_G", "RANGE_16_G"])
def test_every_range_has_one_scale(accelerometer: Any, name: str) -> None:
    """The driver sets FULL_RES with a range, which keeps 256 counts a g in all four (ADX-40)."""
    value = getattr(accelerometer.driver.Range, name)
    accelerometer.chip.range = value
    assert accelerometer.chip.range == value
    accelerometer.board.feel(WorldStimulus(force_box=(0.0, 0.0, STANDARD_GRAVITY)))
    assert abs(accelerometer.chip.raw_z - 256) <= 1


def test_the_range_can_be_set_beyond_2_g(accelerometer: Any) -> None:
    strong = WorldStimulus(force_box=(10 * STANDARD_GRAVITY, 0.0, 0.0))
    accelerometer.board.feel(strong)
    assert accelerometer.chip.raw_x == 511  # 10 bits: ADX-41
    accelerometer.chip.range = accelerometer.driver.Range.RANGE_16_G
    accelerometer.board.feel(strong)
    assert abs(accelerometer.chip.raw_x - 2560) <= 1


def test_the_data_rate_can_be_set(accelerometer: Any) -> None:
    """Twice the code, twice the rate: at 25 Hz a reading changes 25 times a second."""
    rates = accelerometer.driver.DataRate
    for rate, per_second in ((rates.RATE_25_HZ, 25), (rates.RATE_100_HZ, 100)):
        accelerometer.chip.data_rate = rate
        assert accelerometer.chip.data_rate == rate
        read = []
        for step in range(400):
            accelerometer.board.feel(WorldStimulus(force_box=(0.04 * step, 0.0, 0.0)), settle_ns=2_500_000)
            read.append(accelerometer.chip.raw_x)
        changes = sum(before != after for before, after in itertools.pairwise(read))
        assert changes == pytest.approx(per_second, abs=0.15 * per_second)


def test_the_driver_accepts_any_chip_at_the_address(driver: Any, busio: Any, boards: Any) -> None:
    """It names the identity register and never reads it (ADX-10): a gyroscope at 0x53 passes for an accelerometer."""
    board = boards("l3g4200d", 0x53)
    assert len(driver.ADXL345(busio(board.wire)).acceleration) == 3


def test_a_missing_chip_is_refused(driver: Any, busio: Any, boards: Any) -> None:
    with pytest.raises(ValueError, match="No I2C device at address: 0x53"):
        driver.ADXL345(busio(boards("adxl345", 0x1D).wire))
