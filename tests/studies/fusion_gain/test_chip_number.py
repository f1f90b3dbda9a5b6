"""The gain by number and mounting of gyroscopes, against closed forms for white noise and slopes."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from imuarray.array import load_array, parse_array
from imuarray.cli import main
from imuarray.errors import ConfigError
from imuarray.studies.fusion_gain.chip_number import study_numbers

CONFIGS = Path(__file__).parents[3] / "configs"


@pytest.mark.slow
def test_the_command_computes_eight_icm42688(capsys: pytest.CaptureFixture[str]) -> None:
    """0.0028 dps per root Hz (TDK-60), one-sided, is 0.119 deg per root hour; its mean decreases with the root of n. A
    common slope does not decrease with one direction of mounting, and the four pairs of the array cancel it.
    """
    assert main(["study", "--array", "icm42688x8", "--seeds", "2", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["count"] for row in rows] == [1, 2, 4, 8]
    one = 60 * 0.0028 / math.sqrt(2)
    for row in rows:
        assert row["random_walk"] == pytest.approx(one / math.sqrt(row["count"]), rel=0.15)
        assert row["drift_alike"] == pytest.approx(rows[0]["drift_alike"], rel=0.1)
        assert row["bus_us"] == pytest.approx(row["count"] * 8 * 15 / 24)  # 15 bytes of 8 bits at 24 MHz
    assert rows[3]["drift_mounted"] < 0.1 * rows[3]["drift_alike"]
    assert rows[3]["drift_own"] < 0.7 * rows[0]["drift_own"]


@pytest.mark.slow
def test_the_bus_time_of_an_opposed_pair_on_i2c() -> None:
    """One clock per bit, nine bits per byte, 14 bytes, two addresses and a register: 382.5 us per chip at 400 kHz."""
    study = study_numbers(load_array(CONFIGS / "lsm6dso_pair.toml"), 1)
    assert [row.count for row in study.rows] == [1, 2]
    assert study.rows[1].bus_us == pytest.approx(2 * 382.5)


def test_fewer_than_two_gyroscopes_are_refused() -> None:
    text = (
        '[array]\nname = "a"\n[[sensor]]\nname = "G"\nchip = "l3g4200d"\naddress = 0x68\nrange = 250\nrate_hz = 400\n'
    )
    with pytest.raises(ConfigError, match="array a: 1 gyroscopes; at least two are compared"):
        study_numbers(parse_array(text), 1)


def test_a_folder_as_configuration_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "--array", "icm42688x8", "-o", str(tmp_path / "s")]) == 2
    assert "--output can't be combined with --array" in capsys.readouterr().err
