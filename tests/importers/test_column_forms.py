"""Forms of columns that a map describes: codes without 0x, a date and a time of day, torn cells at the end."""

from __future__ import annotations

from pathlib import Path

import pytest

from imuarray.errors import ConfigError, SourceError
from imuarray.importers.mapping import parse_map
from imuarray.importers.table import import_table
from imuarray.log import open_log

SENSOR = """
[[sensor]]
name = "A"
chip = "a"
quantity = "specific_force"
columns = ["x", "y", "z"]
unit = "g"
range = 8
sensitivity = 4096
values = "counts"
"""
DATED = '[time]\ncolumn = "time"\nunit = "%d.%m.%Y %H:%M:%S.%f"\ndate_column = "day"\n'
RATE = "[time]\nrate_hz = 100\n"


def imported(folder: Path, text: str, table_map: str) -> Path:
    (folder / "run.csv").write_text(text)
    (folder / "map.toml").write_text(table_map)
    import_table(folder / "run.csv", folder / "map.toml", folder / "run.h5")
    return folder / "run.h5"


def test_hexadecimal_codes_without_a_prefix(tmp_path: Path) -> None:
    """10 is sixteen, FFFF is -1 in two's complement of 16 bits."""
    text = "x,y,z\n10,FFFF,1000\n1f,8000,0xFF\n"
    with open_log(imported(tmp_path, text, RATE + SENSOR + "bits = 16\nhexadecimal = true\n")) as log:
        assert log["A"].counts[:].tolist() == [[16, -1, 4096], [31, -32768, 255]]


def test_a_date_and_a_time_of_day_in_two_columns(tmp_path: Path) -> None:
    """16 September 2013 0:00 UTC is 15964 days after 1970; midnight needs no rule, as the date changes."""
    text = "day,time,x,y,z\n16.09.2013,23:59:59.75,1,2,3\n17.09.2013,00:00:00.25,4,5,6\n"
    with open_log(imported(tmp_path, text, DATED + SENSOR)) as log:
        assert log["A"].time[:].tolist() == [15965 * 86_400 * 10**9 - 250_000_000, 15965 * 86_400 * 10**9 + 250_000_000]


@pytest.mark.parametrize("unit", ["s", "%H:%M:%S.%f"])
def test_a_date_column_needs_a_unit_of_dates(unit: str) -> None:
    text = f'[time]\ncolumn = "time"\nunit = "{unit}"\ndate_column = "day"\n' + SENSOR
    with pytest.raises(ConfigError, match="date_column requires a unit of dates and times"):
        parse_map(text, "map.toml")


def test_a_torn_cell_in_the_last_rows_is_left_out(tmp_path: Path) -> None:
    """4096 rows are one block; a torn cell in the few rows after them loses its row, not the import."""
    rows = [f"{row % 7},{row % 5},{row % 3}" for row in range(4096 + 20)]
    rows[4100] = "4,1$2,0"
    with open_log(imported(tmp_path, "\n".join(["x,y,z", *rows]) + "\n", RATE + SENSOR)) as log:
        assert len(log["A"]) == 4115
        assert log["A"].time[4100] == 41_010_000_000


def test_a_torn_cell_at_the_beginning_is_an_error(tmp_path: Path) -> None:
    """A short text may be no table of numbers at all."""
    with pytest.raises(SourceError, match="line 3, column 'y': '1\\$2' is not a number"):
        imported(tmp_path, "x,y,z\n1,2,3\n4,1$2,0\n" + "1,2,3\n" * 20, RATE + SENSOR)
