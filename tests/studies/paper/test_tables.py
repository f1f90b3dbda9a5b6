"""The shipped tables against cells read off the printed page."""

from __future__ import annotations

from decimal import Decimal

import pytest

from imuarray.studies.paper.tables import channels, design_of, dps, is_inertial, milli_g, number_in, row_of, table

ROWS = {1: 9, 2: 6, 3: 18, 4: 9, 5: 10, 6: 15, 7: 15, 8: 27, 9: 8, 10: 34, 11: 34}


@pytest.mark.parametrize(("number", "rows"), ROWS.items())
def test_every_table_is_shipped_completely(number: int, rows: int) -> None:
    assert len(table(number)) == rows
    assert len({tuple(row) for row in table(number)}) == 1


@pytest.mark.parametrize(
    ("number", "channel", "column", "printed"),
    [
        (3, "BMA4 x", "scale_lsb_per_g", "-5369.79"),
        (4, "Gyro3 y", "drift_lsb", "2.4205"),
        (8, "Gyro3 z", "slope_lsb_per_degc", "-2.782"),
        (10, "ADXL1 x", "std_lsb", "5.811277"),
        (11, "BMA1 z", "ratio", "10285.99"),
    ],
)
def test_cells_keep_their_printed_digits(number: int, channel: str, column: str, printed: str) -> None:
    assert row_of(number, channel)[column] == printed
    assert str(number_in(row_of(number, channel), column)) == printed


def test_rows_are_selected_by_design_range_and_axis() -> None:
    assert [row["channel"] for row in channels(8, "BMA", "1.5g", "z")] == ["BMA3 z", "BMA4 z"]
    assert len(channels(8, "ADXL")) == 6
    assert design_of("Gyro3 x") == "Gyro"
    assert [row["channel"] for row in table(10) if not is_inertial(row)][:2] == ["BMA1 t", "BMA2 t"]


def test_typical_sensitivities_are_those_of_the_data_sheets() -> None:
    assert milli_g(row_of(10, "ADXL1 x"), Decimal(256)) == 1000  # ADX-40
    assert milli_g(row_of(10, "BMA1 x"), Decimal(512)) == 1000  # BMA-76
    assert milli_g(row_of(10, "BMA3 x"), Decimal(5460)) == 1000  # BMA-71
    assert dps("250dps", Decimal(1000)) == Decimal("8.75")  # L3G-40
    assert dps("2k dps", Decimal(1000)) == 70  # L3G-42
