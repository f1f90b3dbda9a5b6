"""The paper's Tables 1 to 11 as it prints them (`tables/tableNN_*.csv`), read with every digit.

A cell is text until somebody asks for a number; numbers are `decimal.Decimal`, because 0.1 printed is not 0.1 binary
and the last printed digit is what a recomputation is judged by. Units stand in the column names (`_lsb` are raw
counts).
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from decimal import Decimal
from functools import cache
from importlib.resources import files
from types import MappingProxyType

Row = Mapping[str, str]
"""One printed row: column name to printed text."""

TABLES: dict[int, str] = {
    1: "table01_orientation.csv",
    2: "table02_gyro_high_rate.csv",
    3: "table03_accel_systematic.csv",
    4: "table04_gyro_systematic.csv",
    5: "table05_in_run_summary.csv",
    6: "table06_bma1_runs.csv",
    7: "table07_gyro3_runs.csv",
    8: "table08_temperature_fit.csv",
    9: "table09_gyro_noise.csv",
    10: "table10_six_position.csv",
    11: "table11_turn_on.csv",
}

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
"""The BMA180's seven ranges, +-range to counts per g (BMA-70 ... BMA-76); it powers up at 2 g."""

FACES_DEGC = (26.23803, 26.45391, 26.47834, 26.42805, 26.49729, 26.49944, 26.68422)
"""Row "Indep. Temp" of Table 10, which the BMP180 beside the sensors read: means over the faces in the order in which
they were up, the repeated first one last. The CSV files hold the rows of the sensors only.
"""
DEGC: Mapping[tuple[int, str], float] = MappingProxyType(
    {
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
)
"""The same row of Tables 10 and 11 by table and the column's name in the CSV files, degC."""


@cache
def table(number: int) -> tuple[Row, ...]:
    """The rows of Table `number` (1 to 11) in printed order."""
    text = files("imuarray.paper").joinpath("tables", TABLES[number]).read_text(encoding="utf-8")
    return tuple(csv.DictReader(text.splitlines()))


def row_of(number: int, channel: str) -> Row:
    """The row of a channel such as "Gyro1 y" in Table 3, 4, 8, 10 or 11."""
    return next(row for row in table(number) if row["channel"] == channel)


def number_in(row: Row, column: str) -> Decimal:
    """A printed number, exact."""
    return Decimal(row[column])


def numbers_in(row: Row, columns: Sequence[str]) -> tuple[Decimal, ...]:
    """Several printed numbers of one row, exact."""
    return tuple(Decimal(row[column]) for column in columns)


def design_of(channel: str) -> str:
    """The sensor design that a channel or sensor name stands for: "ADXL", "BMA" or "Gyro"."""
    return channel.split()[0].rstrip("0123456789")


def is_inertial(row: Row) -> bool:
    """Whether a row is an accelerometer or gyroscope axis, not a chip's thermometer."""
    return row["range"] != "int"


def channels(number: int, design: str, range_name: str | None = None, axes: str = "xyz") -> tuple[Row, ...]:
    """The rows of one design in a table, if wanted of one range and of some axes only."""
    return tuple(
        row
        for row in table(number)
        if design_of(row["channel"]) == design
        and range_name in (None, row["range"])
        and row["channel"].split()[1] in tuple(axes)
    )


def milli_g(row: Row, counts: Decimal) -> Decimal:
    """Accelerometer counts in mg with the data sheet's typical sensitivity for the row's design and range."""
    return counts * _MILLI / _LSB_PER_G[design_of(row["channel"]), row["range"]]


def dps(range_name: str, counts: Decimal) -> Decimal:
    """L3G4200D counts in degrees per second with the data sheet's typical sensitivity for a range as printed."""
    return counts * _DPS_PER_LSB[range_name]


def physical(row: Row, counts: Decimal) -> Decimal:
    """Counts in mg (accelerometers) or degrees per second (gyroscopes), typical sensitivities."""
    return dps(row["range"], counts) if design_of(row["channel"]) == "Gyro" else milli_g(row, counts)


def mean(values: Sequence[Decimal]) -> Decimal:
    """Arithmetic mean in decimal arithmetic; at least one value."""
    return sum(values, Decimal(0)) / len(values)
