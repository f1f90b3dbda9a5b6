"""The paper's Tables 1 to 11 as it prints them (`tables/tableNN_*.csv`), read with every digit.

A cell is text until it is read as a number; numbers are `decimal.Decimal`, because a printed 0.1 has no exact binary
form and recomputations are compared in the last printed digit. Units are in the column names (`_lsb` are raw counts).

`Cell` compares a printed number with its recomputation. `matches`: the recomputed value, rounded to the digits printed,
is the printed one. `within_input_rounding`: the printed value can be reached if each input changes by at most half a
unit of its own last printed digit (to first order), which is the limit of a recomputation from printed tables. If
neither holds, the cell is a slip.

A recomputed value can fall exactly half-way between two printable ones (six cells of Tables 2 to 9 do). Printed inputs
cannot resolve this tie, and the paper rounds some up and some down. Both neighbours are correct, so a tie matches
either of them.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from functools import cache
from importlib.resources import files
from typing import Any

Row = Mapping[str, str]
"""One printed row: column name to printed text."""

_MILLI = 1000
_LSB_PER_G: dict[tuple[str, str], Decimal] = {
    ("ADXL", "16g"): Decimal(256),  # full resolution, ADX-40
    ("BMA", "16g"): Decimal(512),  # BMA-76
    ("BMA", "1.5g"): Decimal(5460),  # BMA-71
}
_DPS_PER_LSB: dict[str, Decimal] = {
    "2k dps": Decimal("0.07"),  # L3G-42
    "250dps": Decimal("0.00875"),  # L3G-40
}
BMA180_LSB_PER_G: dict[str, Decimal] = {
    "1g": Decimal(8192),
    "1.5g": Decimal(5460),
    "2g": Decimal(4096),
    "3g": Decimal(2730),
    "4g": Decimal(2048),
    "8g": Decimal(1024),
    "16g": Decimal(512),
}
"""The BMA180's seven ranges, range (in both directions) to counts per g (BMA-70 ... BMA-76); it powers up at 2 g."""

FACES_DEGC = (26.23803, 26.45391, 26.47834, 26.42805, 26.49729, 26.49944, 26.68422)
"""Row "Indep. Temp" of Table 10 in degC, measured by the BMP180 next to the sensors: means over the faces in the order
in which they were up, the repeated first face last. The CSV files contain only the rows of the sensors.
"""
DEGC: Mapping[tuple[int, str], float] = {
    (10, "std_lsb"): 0.251412,
    (11, "runs_mean"): 24.505,
    (11, "runs_std"): 0.030,
    (11, "runs_std_of_means"): 0.131,
    (11, "runs_range_of_means"): 0.473,
    (11, "cont_mean"): 23.817,
    (11, "cont_std"): 0.019,
    (11, "cont_std_of_means"): 0.086,
    (11, "cont_range_of_means"): 0.193,
}
"""The same row of Tables 10 and 11 by table and the column's name in the CSV files, degC."""


@cache
def table(number: int) -> tuple[Row, ...]:
    """Return the rows of Table `number` (1 to 11) in printed order."""
    folder = files("imuarray.studies.paper").joinpath("tables")
    file = next(file for file in folder.iterdir() if re.fullmatch(rf"table{number:02}_\w+\.csv", file.name))
    return tuple(csv.DictReader(file.read_text(encoding="utf-8").splitlines()))


def row_of(number: int, channel: str) -> Row:
    """Return the row of a channel such as "Gyro1 y" in Table 3, 4, 8, 10 or 11."""
    return next(row for row in table(number) if row["channel"] == channel)


def number_in(row: Row, column: str) -> Decimal:
    """Return a printed number, exact."""
    return Decimal(row[column])


def numbers_in(row: Row, columns: Sequence[str]) -> tuple[Decimal, ...]:
    """Return several printed numbers of one row, exact."""
    return tuple(Decimal(row[column]) for column in columns)


def design_of(channel: str) -> str:
    """Return the sensor design of a channel or sensor name: "ADXL", "BMA" or "Gyro"."""
    return channel.split()[0].rstrip("0123456789")


def is_inertial(row: Row) -> bool:
    """Return whether a row is an accelerometer or gyroscope axis, not a chip's thermometer."""
    return row["range"] != "int"


def channels(number: int, design: str, range_name: str | None = None, axes: str = "xyz") -> tuple[Row, ...]:
    """Return the rows of one design in a table, optionally of only one range and of some axes."""
    return tuple(
        row
        for row in table(number)
        if design_of(row["channel"]) == design
        and range_name in (None, row["range"])
        and row["channel"].split()[1] in tuple(axes)
    )


def milli_g(row: Row, counts: Decimal) -> Decimal:
    """Return accelerometer counts in mg with the data sheet's typical sensitivity for the row's design and range."""
    return counts * _MILLI / _LSB_PER_G[design_of(row["channel"]), row["range"]]


def dps(range_name: str, counts: Decimal) -> Decimal:
    """Return L3G4200D counts in degrees per second with the data sheet's typical sensitivity for a range as printed."""
    return counts * _DPS_PER_LSB[range_name]


def physical(row: Row, counts: Decimal) -> Decimal:
    """Return counts in mg (accelerometers) or degrees per second (gyroscopes), with typical sensitivities."""
    return dps(row["range"], counts) if design_of(row["channel"]) == "Gyro" else milli_g(row, counts)


def mean(values: Sequence[Decimal]) -> Decimal:
    """Return the arithmetic mean in decimal arithmetic; at least one value."""
    return sum(values, Decimal(0)) / len(values)


Formula = Callable[[Sequence[Decimal]], Decimal]
"""Function from printed inputs to a recomputed number."""


@dataclass(frozen=True)
class Cell:
    """One recomputed cell: the value, what is printed, and whether the inputs explain the difference.

    A value that agrees has the printed digits; any other value has two more digits, which show the difference.
    """

    column: str
    value: float | str
    printed: float | str
    within_input_rounding: bool

    @property
    def matches(self) -> bool:
        """Return whether the recomputed value equals the printed one in every printed digit."""
        return self.value == self.printed


@dataclass(frozen=True)
class RecomputedRow:
    """A printed row, the cells recomputed in it, and columns that the paper does not have."""

    row: Row
    cells: tuple[Cell, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return the row under the table's own column names; a recomputed column `x` is followed by `printed_x`."""
        cells = {cell.column: cell for cell in self.cells}
        result: dict[str, Any] = {}
        for column, text in self.row.items():
            if column in cells:
                result[column] = cells[column].value
                result[f"printed_{column}"] = cells[column].printed
            else:
                result[column] = plain(text)
        return result | dict(self.extra)


def last_unit(value: Decimal) -> Decimal:
    """Return one unit of the last printed digit of a number: 0.001 for 1.230."""
    return Decimal(1).scaleb(int(value.as_tuple().exponent))


def half_unit(value: Decimal) -> Decimal:
    """Return half a unit of the last printed digit: the largest error of a correctly rounded number."""
    return last_unit(value) / 2


def round_like(value: Decimal, printed: Decimal) -> Decimal:
    """Return `value` with the decimals of `printed`; a tie is rounded to `printed` if it is one of the two. No -0."""
    if abs(value - printed) <= half_unit(printed):
        return printed + 0
    return value.quantize(last_unit(printed)) + 0


def reach(formula: Formula, inputs: Sequence[Decimal]) -> Decimal:
    """Return the change of `formula`, to first order, when each input changes by its `half_unit`."""
    centre = formula(inputs)
    moved = ([*inputs[:i], value + half_unit(value), *inputs[i + 1 :]] for i, value in enumerate(inputs))
    return sum((abs(formula(values) - centre) for values in moved), Decimal(0))


def numeric_cell(row: Row, column: str, formula: Formula, inputs: Sequence[Decimal]) -> Cell:
    """Return the cell of `column` recomputed as `formula(inputs)`, to the digits that `row` prints there if they
    agree.
    """
    printed, value = Decimal(row[column]), formula(inputs)
    is_within = abs(value - printed) <= half_unit(printed) + reach(formula, inputs)
    rounded = round_like(value, printed)
    if rounded != printed:
        rounded = value.quantize(last_unit(printed) / 100) + 0
    return Cell(column, float(rounded), float(printed), is_within)


def text_cell(row: Row, column: str, value: str) -> Cell:
    """Return a cell of words, such as the axis in Table 1."""
    return Cell(column, value, row[column], value == row[column])


def plain(text: str) -> float | int | str | None:
    """Return a printed cell as JSON: an empty one is null, whole numbers and words are unchanged."""
    if not text:
        return None
    try:
        value = Decimal(text)
    except InvalidOperation:
        return text
    return int(value) if "." not in text else float(value)


def tally(rows: Iterable[RecomputedRow], *, within_input_rounding: bool = False) -> dict[str, list[int]]:
    """Count for each recomputed column [agreeing cells, all]: to the printed digits, or within the inputs' rounding."""
    result: dict[str, list[int]] = {}
    for cell in (cell for row in rows for cell in row.cells):
        count = result.setdefault(cell.column, [0, 0])
        count[0] += cell.within_input_rounding if within_input_rounding else cell.matches
        count[1] += 1
    return result
