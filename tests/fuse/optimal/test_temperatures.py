"""Which thermometer a sensor's slopes, known or not, go with."""

from __future__ import annotations

from pathlib import Path

import pytest

from imuarray.calibrate import Calibration
from imuarray.fuse.optimal import temperatures
from imuarray.log import open_log
from tests.fuse.test_thermal import WARM, heating


@pytest.mark.parametrize(
    ("thermometer", "expected"),
    [("barometer", {"A1", "A2", "G1"}), ("bma180", {"A1", "A2", "G1"}), ("l3g4200d", set()), ("none", set())],
)
def test_sensors_without_slopes_take_what_compares(tmp_path: Path, thermometer: str, expected: set[str]) -> None:
    """Barometer and BMA180 have a zero, an L3G4200D has none; all see 25 to 43 degC here."""
    with open_log(heating(tmp_path / "heat.h5", thermometer)) as log:
        found = temperatures(log, [log[name] for name in ("A1", "A2", "G1")], Calibration())
    assert set(found) == expected
    for one in found.values():
        assert one.degc[[0, -1]] == pytest.approx([WARM[0], WARM[-1]], abs=0.6)
