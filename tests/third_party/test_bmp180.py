"""Milen Todorov's driver of the BMP180, package bmp180, through smbus2 and the emulated /dev/i2c-1.

It sleeps 5 ms of the machine's own time for each conversion, so that the emulated clock is the machine's too.
"""

from __future__ import annotations

from typing import Any

import pytest

from firmware_emulator.clock import RealClock
from firmware_emulator.world import WorldStimulus

bmp180 = pytest.importorskip("bmp180", reason="needs bmp180, installed by the test extra")


@pytest.fixture
def board(boards: Any, serve: Any) -> Any:
    board = boards("bmp180", 0x77, RealClock())
    serve(board)
    return board


@pytest.mark.parametrize(("degc", "pascal"), [(25.0, 101325.0), (-5.0, 84000.0), (41.3, 104000.0)])
def test_temperature_and_pressure_are_read(board: Any, degc: float, pascal: float) -> None:
    board.feel(WorldStimulus(temperature_degc=degc, pressure_pa=pascal), settle_ns=0)
    barometer = bmp180.BMP180()
    assert barometer.read_temperature() == pytest.approx(degc, abs=0.11)  # resolution 0.1 degC
    # Without oversampling a count is some 2 Pa in this part.
    assert barometer.read_pressure() == pytest.approx(pascal, abs=6)
    barometer.close()


def test_calibration_words_are_those_of_the_worked_example(board: Any) -> None:
    """Data sheet figure 4 (BMP-20 ... BMP-30), signs and byte order included; MB is not used and not read."""
    barometer = bmp180.BMP180()
    words = {
        name: getattr(barometer, name) for name in ("AC1", "AC2", "AC3", "AC4", "AC5", "AC6", "B1", "B2", "MC", "MD")
    }
    barometer.close()
    assert words == {
        "AC1": 408,
        "AC2": -72,
        "AC3": -14383,
        "AC4": 32741,
        "AC5": 32757,
        "AC6": 23153,
        "B1": 6190,
        "B2": 4,
        "MC": -8711,
        "MD": 2868,
    }


def test_the_driver_does_not_check_the_identity(boards: Any, serve: Any) -> None:
    """The identity at 0xD0 (BMP-11) is not read: an accelerometer passes for a barometer of words all 0 (BMP-31)."""
    serve(boards("adxl345", 0x77))
    barometer = bmp180.BMP180()
    assert (barometer.AC1, barometer.AC4, barometer.MD) == (0, 0, 0)
    barometer.close()
