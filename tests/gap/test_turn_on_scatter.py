"""The tolerance of the scatter of a bias between power-ons covers the paper's parts (the left half of its Table 11, in
counts of the data sheets) by a factor of two at least, at narrow and wide ranges, and by 25 at most: they are one
batch.
"""

from __future__ import annotations

import pytest

from imuarray.gap.model.populations import turn_on_rms
from tests.gap.small_campaign import header

PARTS = (
    ("adxl345", "g", 16.0, 0.163 / 256),
    ("bma180", "g", 16.0, 0.293 / 512),
    ("l3g4200d", "dps", 2000.0, 0.520 * 0.07),
    ("l3g4200d", "dps", 250.0, 2.886 * 0.00875),
)
"""Chip, unit, range, largest scatter of an axis over the parts that came up in their configuration; Gyro3's x axis has
two states.
"""


@pytest.mark.parametrize(("chip", "unit", "range_", "scatter"), PARTS)
def test_the_papers_parts_are_within_the_tolerance(chip: str, unit: str, range_: float, scatter: float) -> None:
    sensor = header("A", chip=chip, unit=unit, range=range_)
    assert 2 * scatter < turn_on_rms(sensor) < 25 * scatter
