"""The map of a text table: which column is what. Read from TOML; whatever can't be meant is refused with its place.

::

    [file]      delimiter = ","   skip_rows = 0   comment = "#"
    [time]      column = "t"  unit = "s" | "ms" | "us" | "ns"     or     rate_hz = 100
    [[sensor]]  name  chip  quantity  columns = [x, y, z]  range  unit  sensitivity
                values = "counts" | "physical"   axes = "+X+Y+Z"   position_mm = [x, y, z]   temperature_column
                thermometer = { zero_degc, lsb_per_degc }
    [[phase]]   name  rows = [first, last]

A column is a name (then the first row is a header) or an index counted from 0. Phases count data rows
from 0, last included.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from os import PathLike
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, model_validator

from imuarray.axes import face_up, orientation_of
from imuarray.toml_files import parse_toml, read_text

_STRICT = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

UNITS = {"specific_force": "g", "angular_rate": "dps", "magnetic_field": "gauss"}
"""The unit in which range and sensitivity of a sensor are given, for each quantity."""

NS_PER_UNIT = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}


def _column(value: Any) -> str | int:
    """A column's name or index; ValueError."""
    if (isinstance(value, str) and value) or (isinstance(value, int) and not isinstance(value, bool) and value >= 0):
        return value
    raise ValueError(f"{value!r}: allowed are a column's name or its index, counted from 0")


Column = Annotated[str | int, PlainValidator(_column)]
Positive = Annotated[float, Field(gt=0)]


class FileTable(BaseModel):
    """`[file]`: how the text is cut into cells."""

    model_config = _STRICT
    delimiter: Literal[",", ";", "\t", " ", "|"] = ","
    skip_rows: Annotated[int, Field(ge=0)] = 0
    comment: str = "#"


class TimeTable(BaseModel):
    """`[time]`: a column of times in a unit, or a rate at which the rows follow each other."""

    model_config = _STRICT
    column: Column | None = None
    unit: Literal["s", "ms", "us", "ns"] | None = None
    rate_hz: Annotated[float, Field(ge=0.001, le=1e6)] | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.column is None) == (self.rate_hz is None):
            raise ValueError("needs either column and unit, or rate_hz")
        if (self.column is None) != (self.unit is None):
            raise ValueError(f"unit goes with column; allowed are {', '.join(NS_PER_UNIT)}")
        return self


class ThermometerTable(BaseModel):
    """What the counts of `temperature_column` mean: `zero_degc` + counts / `lsb_per_degc`."""

    model_config = _STRICT
    zero_degc: Annotated[float, Field(ge=-1e6, le=1e6)]
    lsb_per_degc: Annotated[float, Field(ge=-1e6, le=1e6)]

    @model_validator(mode="after")
    def _changes(self) -> Self:
        if self.lsb_per_degc == 0:
            raise ValueError("lsb_per_degc 0: a thermometer's counts change with the temperature")
        return self


class SensorTable(BaseModel):
    """`[[sensor]]`: three columns that are one triad. `sensitivity` is in counts per `unit`; `values` says whether the
    columns hold counts or numbers in `unit`, which are turned into counts. `thermometer` is said where a chip's data
    sheet is not known to this package, or a unit has been calibrated.
    """

    model_config = _STRICT
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")]
    chip: Annotated[str, Field(min_length=1)]
    quantity: Literal["specific_force", "angular_rate", "magnetic_field"]
    columns: Annotated[list[Column], Field(min_length=3, max_length=3)]
    range: Positive
    unit: Literal["g", "dps", "gauss"]
    sensitivity: Positive
    values: Literal["counts", "physical"] = "counts"
    axes: str = "+X+Y+Z"
    position_mm: Annotated[list[float], Field(min_length=3, max_length=3)] = [0.0, 0.0, 0.0]
    temperature_column: Column | None = None
    thermometer: ThermometerTable | None = None

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.unit != UNITS[self.quantity]:
            raise ValueError(f"unit {self.unit!r}: allowed for {self.quantity} is {UNITS[self.quantity]}")
        if len(set(self.columns)) < 3:
            raise ValueError(f"columns {self.columns}: each column comes once")
        if self.thermometer is not None and self.temperature_column is None:
            raise ValueError("thermometer goes with temperature_column, of which it says what the counts mean")
        orientation_of(self.axes)
        return self


class PhaseTable(BaseModel):
    """`[[phase]]`: a named stretch of data rows, first and last included."""

    model_config = _STRICT
    name: Annotated[str, Field(min_length=1)]
    rows: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=2, max_length=2)]

    @model_validator(mode="after")
    def _forward(self) -> Self:
        if self.rows[1] < self.rows[0]:
            raise ValueError(f"rows {self.rows}: [first, last], last not before first")
        return self

    @property
    def up(self) -> str:
        """The box axis that points up in a phase called z_up, x_down, y_up_check, ...; "" for any other."""
        return face_up(self.name)


class TableMap(BaseModel):
    """The whole map."""

    model_config = _STRICT
    file: FileTable = FileTable()
    time: TimeTable
    sensor: Annotated[list[SensorTable], Field(min_length=1)]
    phase: list[PhaseTable] = []

    @model_validator(mode="after")
    def _names_once(self) -> Self:
        for name, count in Counter(sensor.name for sensor in self.sensor).items():
            if count > 1:
                raise ValueError(f"{count} sensors are called {name!r}; names are unique")
        return self

    def columns(self) -> Iterator[str | int]:
        """Every column that the map names, some more than once."""
        if self.time.column is not None:
            yield self.time.column
        for sensor in self.sensor:
            yield from sensor.columns
            if sensor.temperature_column is not None:
                yield sensor.temperature_column


def load_map(path: str | PathLike[str]) -> TableMap:
    """Read a map's TOML file; ConfigError names the file and every mistake in it."""
    return parse_toml(read_text(path), TableMap, str(path))
