"""Half an hour of array time without a lost frame or a growing process (`soak.py` measures a day)."""

from __future__ import annotations

import pytest

from tests.reliability.soak import RATE_HZ, soak


@pytest.mark.parametrize(
    "hours", [pytest.param(0.1, marks=pytest.mark.slow), pytest.param(0.5, marks=pytest.mark.campaign)]
)
def test_memory_does_not_grow_and_no_row_is_lost(hours: float) -> None:
    counted = soak(hours, every_h=hours / 24)
    assert counted["frames"] == pytest.approx(hours * 3600 * RATE_HZ, abs=2)
    assert counted["late"] == counted["missed"] == counted["lost"] == counted["events"] == 0
    assert not any(counted["flagged"].values())
    for name, rows in counted["rows"].items():
        every = 3 if name.startswith("HMC") else 12 if name == "BMP180" else 1  # slower chips: 15 Hz, 4 Hz
        assert rows == pytest.approx(counted["frames"] / every, abs=2)
    settled = [mib for at_h, mib in counted["mib"] if at_h > hours / 4]
    assert max(settled) - settled[0] < 1.0
