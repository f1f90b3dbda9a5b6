"""Half an hour of array time without a lost frame or a growing process (`soak.py` measures a day)."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from soak import RATE_HZ, soak

HOURS = 0.5


@pytest.mark.slow
def test_nothing_grows_and_nothing_is_lost() -> None:
    counted = soak(HOURS, every_h=HOURS / 24)
    assert counted["frames"] == pytest.approx(HOURS * 3600 * RATE_HZ, abs=2)
    assert counted["late"] == counted["missed"] == counted["lost"] == counted["events"] == 0
    assert not any(counted["flagged"].values())
    for name, rows in counted["rows"].items():
        every = 3 if name.startswith("HMC") else 12 if name == "BMP180" else 1  # slower chips: 15 Hz, 4 Hz
        assert rows == pytest.approx(counted["frames"] / every, abs=2)
    settled = [mib for hours, mib in counted["mib"] if hours > HOURS / 4]
    assert max(settled) - settled[0] < 1.0
