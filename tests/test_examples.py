"""The scripts in configs/examples run with the stated results."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "configs" / "examples"


def test_the_driver_of_a_new_chip_follows_its_golden_conversation() -> None:
    """AN3308 prints these bytes for 350 mg, -350 mg and 0."""
    assert runpy.run_path(str(EXAMPLES / "new_chip.py"))["main"]() == [0.35, -0.35, 0.0]


def test_a_driver_that_departs_from_the_conversation_is_refused() -> None:
    names = runpy.run_path(str(EXAMPLES / "new_chip.py"))
    bus = names["Conversation"](names["GOLDEN"])
    with pytest.raises(ValueError, match="WHO_AM_I"):
        bus.transfer(0x18, b"\x20", 1)


@pytest.mark.slow
def test_the_script_from_a_night_to_numbers_gives_bias_and_noise(tmp_path: Path) -> None:
    """Table 4 gives Gyro1 x a bias of 8.4 counts; the emulated unit's noise is 0.18 dps over 35 Hz at best (L3G-74)."""
    results = runpy.run_path(str(EXAMPLES / "night_to_numbers.py"))["main"](tmp_path)
    assert results["Gyro1 x bias in counts"] == pytest.approx(8.4, abs=2.0)
    assert 0.01 < results["Gyro1 x white noise, dps/sqrt(Hz), from"] < results["to"] < 0.06
    assert (tmp_path / "calibration.toml").exists()


@pytest.mark.slow
def test_the_simulators_missing_tone_is_diagnosed(tmp_path: Path) -> None:
    """The script adds a tone of 0.6 dps at 11 Hz to Gyro2, which its simulator does not have."""
    assert len((EXAMPLES / "sim_to_real.py").read_text().splitlines()) < 50
    results = runpy.run_path(str(EXAMPLES / "sim_to_real.py"))["main"](tmp_path)
    (cause,) = results["diagnosis"].causes
    assert (cause.effect, cause.sensors) == ("tone", ("Gyro2",))
    assert cause.parameters["frequency_hz"] == pytest.approx(11.0, abs=0.05)
    assert cause.parameters["amplitude_dps"] == pytest.approx([0.6, 0.6, 0.6], rel=0.1)
    assert np.linalg.norm(results["fused"].specific_force.mean(axis=0)) == pytest.approx(9.80665, abs=0.03)
    assert {path.name for path in tmp_path.glob("*.svg")} == {"allan.svg", "diagnosis.svg"}
