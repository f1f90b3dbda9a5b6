"""Tables 5 and 11, and the bounds between a standard deviation and a range."""

from __future__ import annotations

from statistics import stdev

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.studies.paper.tables import tally
from imuarray.studies.paper.variation import deviation_bounds, group_members, impossible_deviations, table5, table11


def test_table_5_is_the_mean_of_table_11() -> None:
    assert tally(table5()) == {"std_of_5min_means_lsb": [10, 10]}
    assert [row["channel"] for row in group_members("BMA (1.5g) X&Y")] == ["BMA3 x", "BMA3 y", "BMA4 x", "BMA4 y"]
    assert [row["channel"] for row in group_members("Gyro (2kdps) Z")] == ["Gyro1 z", "Gyro2 z"]


def test_table_11_within_the_rounding_of_its_columns() -> None:
    """Rounding does not explain five ratios and two standard deviations, all of thermometers."""
    loose = tally(table11(), within_input_rounding=True)
    assert loose == {"runs_mean": [8, 8], "runs_std_of_means": [6, 8], "runs_range_of_means": [8, 8], "ratio": [29, 34]}
    off = {row.row["channel"] for row in table11() for cell in row.cells if not cell.within_input_rounding}
    assert off == {"BMA1 t", "BMA3 t", "BMA4 t", "Gyro2 t", "Gyro3 t"}


def test_table_11_of_bma1_and_gyro3_follows_from_their_runs() -> None:
    rows = {row.row["channel"]: row.as_json() for row in table11()}
    assert rows["BMA1 z"]["runs_std_of_means"] == 973.994
    assert rows["Gyro3 x"]["runs_range_of_means"] == 13.367
    assert "printed_runs_mean" not in rows["ADXL1 x"]


@given(st.lists(st.integers(-1000, 1000), min_size=2, max_size=20))
def test_every_sample_is_within_the_bounds(values: list[int]) -> None:
    smallest, largest = deviation_bounds(max(values) - min(values), len(values))
    assert smallest * (1 - 1e-12) <= stdev(values) <= largest * (1 + 1e-12)


@pytest.mark.parametrize("count", [2, 3, 14, 15])
def test_the_bounds_are_reached(count: int) -> None:
    middle = [0.0, *[0.5] * (count - 2), 1.0]
    ends = [0.0] * (count // 2) + [1.0] * (count - count // 2)
    assert deviation_bounds(1.0, count) == pytest.approx((stdev(middle), stdev(ends)))


def test_impossible_standard_deviations_are_all_of_thermometers() -> None:
    result = {(channel, column): str(deviation) for channel, column, deviation, _ in impossible_deviations()}
    assert result == {
        ("BMA1 t", "cont_std_of_means"): "0.090",
        ("BMA2 t", "runs_std_of_means"): "0.575",
        ("BMA2 t", "cont_std_of_means"): "0.096",
        ("BMA4 t", "runs_std_of_means"): "0.532",
    }
