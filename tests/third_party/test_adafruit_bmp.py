"""Adafruit's CircuitPython drivers of the BMP280 and the BMP3xx on the emulated chips, which are ideal here."""

from __future__ import annotations

import time
from typing import Any

import pytest

from firmware_emulator.world import WorldStimulus

REASON = "needs {}, which the test extra installs on Linux PCs only (it brings Blinka)"
WEATHER = [(101325.0, 25.0), (70000.0, -10.0), (108000.0, 60.0)]


@pytest.fixture(params=["bmp280", "bmp388"])
def barometer(request: pytest.FixtureRequest, busio: Any, boards: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The board with the chip, and the driver on it, whose sleeps pass on the board's clock."""
    board = boards(request.param, 0x77)
    package = {"bmp280": "adafruit_bmp280", "bmp388": "adafruit_bmp3xx"}[request.param]
    module = pytest.importorskip(package, reason=REASON.format(package))
    monkeypatch.setattr(*((module, "sleep") if hasattr(module, "sleep") else (time, "sleep")), board.sleep)
    make = {"bmp280": "Adafruit_BMP280_I2C", "bmp388": "BMP3XX_I2C"}[request.param]
    return board, getattr(module, make)(busio(board.wire))


@pytest.mark.parametrize(("pascal", "degc"), WEATHER)
def test_pressure_and_temperature_are_read(barometer: Any, pascal: float, degc: float) -> None:
    """The driver computes with real numbers; hPa and degC."""
    board, chip = barometer
    board.feel(WorldStimulus(pressure_pa=pascal, temperature_degc=degc))
    assert chip.temperature == pytest.approx(degc, abs=0.01)
    assert chip.pressure == pytest.approx(pascal / 100, abs=0.02)
