"""The scripts in configs/examples do what they say."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "configs" / "examples"


def test_a_new_chip_holds_its_golden_conversation() -> None:
    """AN3308 prints these bytes for 350 mg, -350 mg and 0."""
    assert runpy.run_path(str(EXAMPLES / "new_chip.py"))["main"]() == [0.35, -0.35, 0.0]


def test_a_driver_that_departs_from_it_is_stopped() -> None:
    names = runpy.run_path(str(EXAMPLES / "new_chip.py"))
    bus = names["Conversation"](names["GOLDEN"])
    with pytest.raises(ValueError, match="WHO_AM_I"):
        bus.transfer(0x18, b"\x20", 1)


def test_from_a_log_to_numbers(tmp_path: Path) -> None:
    """Table 4 gives Gyro1 x a bias of 8.4 counts; the emulated unit's noise is 0.18 dps over 35 Hz at best (L3G-74)."""
    found = runpy.run_path(str(EXAMPLES / "night_to_numbers.py"))["main"](tmp_path)
    assert found["Gyro1 x bias in counts"] == pytest.approx(8.4, abs=2.0)
    assert 0.01 < found["Gyro1 x white noise, dps/sqrt(Hz), from"] < found["to"] < 0.06
    assert (tmp_path / "calibration.toml").exists()
