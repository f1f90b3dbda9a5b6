"""Pairs of Table 8: literals computed by hand from the printed slopes."""

from __future__ import annotations

import pytest

from imuarray.studies.paper.systematic import pair_of, pairs, table8


@pytest.mark.parametrize(
    ("first", "second", "relation", "fused", "reduction"),
    [
        ("Gyro1 x", "Gyro2 x", "parallel", 0.378, 1.0),  # (0.235 + 0.521) / 2
        ("Gyro1 y", "Gyro2 y", "opposed", 0.002, 131.5),  # (0.265 - 0.261) / 2
        ("Gyro1 z", "Gyro2 z", "opposed", 0.017, 12.0),  # (0.221 - 0.187) / 2
        ("ADXL1 z", "ADXL2 z", "parallel", -0.273, 1.0),
        ("BMA1 x", "BMA2 x", "opposed", 0.1195, 1.0),
        ("BMA1 y", "BMA2 y", "parallel", -0.2285, 1.0),  # they would be opposed by Table 1 as printed
        ("BMA1 z", "BMA2 z", "opposed", -0.152, 2.26),
        ("BMA3 y", "BMA4 y", "parallel", 0.9175, 1.0),
        ("BMA3 z", "BMA4 z", "opposed", -3.3755, 1.0),
    ],
)
def test_the_fused_slope_of_a_pair(first: str, second: str, relation: str, fused: float, reduction: float) -> None:
    pair = pair_of(first, second).as_json()
    assert pair["relation"] == relation
    assert pair["fused_slope_lsb_per_degc"] == fused
    assert pair["reduction"] == reduction


def test_pairs_have_the_same_design_range_and_axis() -> None:
    result = [(pair.first["channel"], pair.second["channel"]) for pair in pairs()]
    assert len(result) == 12
    sensors = {(a.split()[0], b.split()[0]) for a, b in result}
    assert sensors == {("ADXL1", "ADXL2"), ("BMA1", "BMA2"), ("BMA3", "BMA4"), ("Gyro1", "Gyro2")}
    assert all(a.split()[1] == b.split()[1] for a, b in result)


def test_the_fused_slope_with_one_adxl345_reversed() -> None:
    pair = pair_of("ADXL1 z", "ADXL2 z").as_json()
    assert pair["fused_slope_if_turned_lsb_per_degc"] == -0.079
    assert pair["carries_1g"] is True
    assert pair_of("Gyro1 z", "Gyro2 z").as_json()["carries_1g"] is False


def test_slopes_in_physical_units() -> None:
    rows = {row.row["channel"]: row.as_json() for row in table8()}
    assert (rows["Gyro1 y"]["slope_per_degc"], rows["Gyro1 y"]["unit"]) == (0.01855, "dps")  # 0.265 * 0.07
    assert rows["BMA1 z"]["slope_per_degc"] == 0.375  # 0.192 / 512 g
