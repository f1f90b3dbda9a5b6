"""The map of a recording: the meaning of its columns, read from TOML. Errors state the place of an invalid entry.

::

    [file]        delimiter = ","   decimal = "."   skip_rows = 0   comment = "#"   kind_column   labels = true
                  parts = [["run_1", "run_2"]]   format = "mimu4444"
    [time]        column = "t"  unit = "s" | "ms" | "us" | "ns" | "d" | "iso8601" | "%d.%m.%Y %H:%M:%S.%f"
                  or     rate_hz = 100
                  fraction_column = "nsec"   fraction_unit = "ns" | "us" | "ms"
                  ticks = 1   wraps_at = 4294967296   ties = true   sort = true   restarts = true
                  stamps = "reading" | "arrival"
    [[sensor]]    name  chip  quantity  columns = [x, y, z]  unit  range  sensitivity | scale
                  values = "counts" | "physical"   offset = 0   bits = 16   factor = 1   signs = "+++"
                  gravity_columns = [x, y, z] | attitude_columns = [w, x, y, z]
                  bandwidth_hz   axes = "+X+Y+Z"   position_mm = [x, y, z]
                  temperature_column   thermometer = { zero_degc, lsb_per_degc } | { unit = "degC" }
                  time_column   kind
    [[thermometer]]  name  column  unit = "degC" | "K" | "counts"   zero_degc   lsb_per_degc   time_column   kind
    [reference]   specific_force  angular_rate = { columns = [X, Y, Z], unit }   temperature = { column, unit }
                  time_column   kind
    [[phase]]     name  up = "+Z"   rows = [first, last] | seconds = [begin, end]

A column is a name (then the first row is a header) or an index counted from 0. Phases are in data rows counted from 0,
with the last row included, or in seconds from the first row.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from os import PathLike
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, PlainValidator, model_validator

from imuarray.axes import UP_AXES, face_up, orientation_of
from imuarray.toml_files import parse_toml, read_text
from imuarray.units import UNITS_OF, standard_unit

_STRICT = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

ISO = "iso8601"
"""Unit of times that are written as date and time (ISO 8601); they count from 1970."""

DATE_DIRECTIVES = re.compile(r"%[YymdjaAbBHIMSpfz]")
"""Directives of a date and time that a unit of times may have, as `datetime.strptime` understands them."""

NS_PER_UNIT = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1, "d": 86_400_000_000_000}
"""Nanoseconds of each unit of times; days are the serial dates of spreadsheets and MATLAB."""

TEMPERATURE_LSB_PER_DEGC = 100.0
"""Counts per degree of a log's thermometer if the recording has degrees without a resolution. A hundredth of a degree
is finer than any of these thermometers, and 16 bits then range from -327 to 327 degC.
"""

ZERO_OF_UNIT = {"degC": 0.0, "K": -273.15}
"""Degrees Celsius at 0 of each unit of temperature."""

UNIT_UNKNOWN, SCALE_UNKNOWN = "dps or rad/s", "not determined"
"""Comments in a proposed map at the unit of a gyroscope's values, or at the sensitivity of its codes, if nothing in the
recording shows it.
"""

PA_PER_UNIT = {"Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "mbar": 1e2, "bar": 1e5}


def _column(value: Any) -> str | int:
    """Validate a column's name or index; ValueError."""
    if (isinstance(value, str) and value) or (isinstance(value, int) and not isinstance(value, bool) and value >= 0):
        return value
    raise ValueError(f"{value!r}: allowed are a column's name or its index, counted from 0")


Column = Annotated[str | int, PlainValidator(_column)]
Positive = Annotated[float, Field(gt=0)]
Triad = Annotated[list[Column], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[Column], Field(min_length=4, max_length=4)]
Place = Annotated[int, Field(ge=0)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")]
Degrees = Annotated[float, Field(ge=-1e6, le=1e6)]


_TIME_SPELLINGS = {
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "days": "d",
    "msec": "ms",
    "usec": "us",
    "\u00b5s": "us",
    "\u03bcs": "us",
}
_DEGREE_SPELLINGS = {"C": "degC", "\u00b0C": "degC", "celsius": "degC", "Celsius": "degC", "kelvin": "K", "Kelvin": "K"}


def is_date_format(unit: str) -> bool:
    """Return whether a unit of times is a format of dates and times, such as "%d.%m.%Y %H:%M:%S.%f"."""
    return "%" in unit


def has_no_day(unit: str) -> bool:
    """Return whether a format of dates and times has only the time of day, which restarts at midnight."""
    return is_date_format(unit) and not re.search(r"%[dj]", unit)


def has_no_hour(unit: str) -> bool:
    """Return whether a format of times has only minutes and seconds, which restart every hour."""
    return is_date_format(unit) and not re.search(r"%[HI]", unit)


def _time_unit(unit: str) -> str:
    """Validate a unit of times; ValueError."""
    choices = f"allowed are {', '.join([*NS_PER_UNIT, ISO])}, or the format of dates, such as %d.%m.%Y %H:%M:%S.%f"
    if not is_date_format(unit):
        if unit not in (*NS_PER_UNIT, ISO):
            raise ValueError(f"{unit!r}: {choices}")
        return unit
    is_short = has_no_hour(unit) and not unit.startswith("%M")
    if "%" in DATE_DIRECTIVES.sub("", unit) or is_short:
        raise ValueError(
            f"{unit!r}: a format of dates has %H and others of %Y %y %m %d %j %b %B %I %M %S %p %f %z; or begins with"
            " %M"
        )
    return unit


def _respell(spellings: dict[str, str]) -> BeforeValidator:
    """Return a validator that replaces other spellings of a unit."""
    return BeforeValidator(lambda unit: spellings.get(unit, unit) if isinstance(unit, str) else unit)


class FileTable(BaseModel):
    """`[file]`: how a text is split into cells. If rows of several tables are mixed, `kind_column` (an index) names the
    table of a row; several indices name it together, as "IMU 0". With `labels`, values have labels ("ax: 0.02,
    ay: -0.98"): the labels, joined by commas, become the first cell, which is the kind of a row. `parts`: files of a
    folder, by their names without suffix, that are parts of one recording, in order; its `kind` is the first of them.
    `format`: a format that needs no map, so that the map adds phases only.
    """

    model_config = _STRICT
    delimiter: Literal[",", ";", "\t", " ", "|"] = ","
    decimal: Literal[".", ","] = "."
    skip_rows: Annotated[int, Field(ge=0)] = 0
    comment: str = "#"
    kind_column: Place | Annotated[list[Place], Field(min_length=1, max_length=4)] | None = None
    labels: bool = False
    parts: list[Annotated[list[str], Field(min_length=2)]] = []
    format: str | None = None

    @property
    def kind_columns(self) -> list[int]:
        """The indices of the cells that name the table of a row together; [] if there is one table."""
        if self.kind_column is None:
            return []
        return [self.kind_column] if isinstance(self.kind_column, int) else self.kind_column

    @model_validator(mode="after")
    def _tells_cells_apart(self) -> Self:
        if self.decimal == self.delimiter:
            raise ValueError("decimal and delimiter are both ','; a table with decimal commas needs another delimiter")
        return self


class TimeTable(BaseModel):
    """`[time]`: a column of times in a unit, or the rate of the rows.

    `fraction_column` is the fraction of a second, in `fraction_unit`, if `column` has whole seconds. `date_column` is
    the date, if `column` is the time of day: `unit` describes both, with a space in between. A column counts
    `ticks` of its unit (0.5: half a unit each) and wraps at `wraps_at`. With `ties`, rows of equal time are separated
    by 1 ns. With `sort`, late rows are sorted by their times, and rows that the file contains twice are kept once
    (`imuarray.importers.row_order`). With `restarts`, times that step back continue from the row before: the clock was
    set back (the end of daylight saving time, a leap second), or the recorder started again. A unit with `%` is a
    format of dates for `datetime.strptime`; a time of day without a date continues after midnight, and minutes and
    seconds without an hour continue after the hour. `stamps = "arrival"`: the times are those at which rows arrived in
    bursts; the log's times are then reconstructed (`imuarray.importers.row_order`), and the delays are stored.
    """

    model_config = _STRICT
    column: Column | None = None
    unit: Annotated[str, _respell(_TIME_SPELLINGS), AfterValidator(_time_unit)] | None = None
    rate_hz: Annotated[float, Field(ge=0.001, le=1e6)] | None = None
    ticks: Positive = 1.0
    wraps_at: Positive | None = None
    ties: bool = False
    sort: bool = False
    restarts: bool = False
    stamps: Literal["reading", "arrival"] = "reading"
    fraction_column: Column | None = None
    fraction_unit: Literal["ns", "us", "ms"] = "ns"
    date_column: Column | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.column is None) == (self.rate_hz is None):
            raise ValueError("needs either column and unit, or rate_hz")
        if (self.column is None) != (self.unit is None):
            raise ValueError(f"unit requires column; allowed are {', '.join([*NS_PER_UNIT, ISO])}")
        if self.column is None and (
            self.wraps_at is not None or self.ties or self.sort or self.restarts or self.stamps == "arrival"
        ):
            raise ValueError("wraps_at, ties, sort, restarts and stamps require column")
        if self.fraction_column is not None and (self.unit != "s" or self.wraps_at is not None or self.sort):
            raise ValueError(
                "fraction_column requires a column of unit 's', and can't be combined with wraps_at or sort"
            )
        if self.date_column is not None and (not self.is_date or has_no_day(self.unit or "") or self.sort):
            raise ValueError("date_column requires a unit of dates and times, and can't be combined with sort")
        if self.restarts and (self.sort or self.wraps_at is not None):
            raise ValueError("restarts can't be combined with sort or wraps_at, which explain falling times otherwise")
        if self.sort and (
            self.wraps_at is not None or (is_date_format(self.unit or "") and has_no_day(self.unit or ""))
        ):
            raise ValueError(
                "sort can't be combined with times that restart (wraps_at, or a time of day without a date)"
            )
        if self.is_date and (self.wraps_at is not None or self.ticks != 1):
            raise ValueError(f"ticks and wraps_at require a column of numbers, not of dates ({self.unit})")
        return self

    @property
    def is_date(self) -> bool:
        """True if the column contains dates or times of day."""
        return self.unit is not None and (self.unit == ISO or is_date_format(self.unit))

    @property
    def columns(self) -> list[str | int]:
        """The column of times, and that of their fractions or dates, if any."""
        return [column for column in (self.column, self.fraction_column, self.date_column) if column is not None]


class ThermometerTable(BaseModel):
    """The meaning of `temperature_column`: counts, which mean `zero_degc` + counts / `lsb_per_degc`; or values in
    `unit`, which are converted to such counts (`scale`).
    """

    model_config = _STRICT
    unit: Annotated[Literal["counts", "degC", "K"], _respell(_DEGREE_SPELLINGS)] = "counts"
    zero_degc: Degrees | None = None
    lsb_per_degc: Degrees | None = None

    @model_validator(mode="after")
    def _changes(self) -> Self:
        if self.lsb_per_degc == 0:
            raise ValueError("lsb_per_degc 0: a thermometer's counts change with the temperature")
        if self.unit == "counts" and (self.zero_degc is None or self.lsb_per_degc is None):
            raise ValueError("counts need zero_degc and lsb_per_degc; or, for values in degC or K, give unit")
        return self

    @property
    def scale(self) -> tuple[float, float]:
        """The temperature at count 0 of the log's thermometer in degC, and its counts per degC."""
        return self.zero_degc or 0.0, self.lsb_per_degc or TEMPERATURE_LSB_PER_DEGC


class RowSettings(BaseModel):
    """The rows and the time of an item: those of `[time]` unless `time_column` names another column; rows of `kind`
    only, if `[file] kind_column` distinguishes kinds or a recording contains several tables (the topics of a bag).
    """

    model_config = _STRICT
    time_column: Column | None = None
    kind: str | None = None


class LogColumn(RowSettings):
    """An item that becomes a sensor of the log."""

    name: Name


class OwnThermometer(LogColumn, ThermometerTable):
    """`[[thermometer]]`: a thermometer that is not part of a sensor's chip."""

    chip: str = "thermometer"
    column: Column


class BarometerTable(LogColumn):
    """`[[barometer]]`: a column of air pressures."""

    chip: str = "barometer"
    column: Column
    unit: Literal["Pa", "hPa", "kPa", "mbar", "bar"] = "Pa"


class SensorTable(LogColumn):
    """`[[sensor]]`: three columns that form a triad.

    `values` states whether they are counts or numbers in `unit`, which are converted to counts; without `sensitivity`
    and `scale` they are in `unit`. `range`, `sensitivity` (counts per `unit`) and `scale` (`unit` per count) are in
    `unit` too; for numbers in `unit` they are optional and inferred from the values. `offset` is subtracted from codes;
    with `bits` they are two's complement of that number of bits, even if they were read as unsigned. `hexadecimal`
    codes need no 0x. A log stores codes
    of up to 32 bits without loss: `bits`, or the number that range times sensitivity requires. Values of `columns`
    times `factor` are in `unit`; `signs` ("+-+") changes the sign of axes for which the columns have the opposite sign.
    `bandwidth_hz` is the configured -3 dB bandwidth of the chip, 0 if unknown. `gravity_columns` is the gravity that a
    program subtracted, in `unit`; it is added again. `attitude_columns` is the unit quaternion, w first, from the
    sensor's axes to a level frame with z up, which a program used to subtract gravity; 1 g is added again along up.
    `thermometer` is required if this package does not have the data sheet of the chip, or if the thermometer was
    calibrated.
    """

    chip: Annotated[str, Field(min_length=1)]
    quantity: Literal["specific_force", "angular_rate", "magnetic_field"]
    columns: Triad
    range: Positive | None = None
    unit: str
    sensitivity: Positive | None = None
    scale: Positive | None = None
    values: Literal["counts", "physical"] | None = None
    offset: int = 0
    bits: Annotated[int, Field(ge=8, le=32)] | None = None
    hexadecimal: bool = False
    factor: Positive | None = None
    signs: Annotated[str, Field(pattern=r"^[+-]{3}$")] = "+++"
    gravity_columns: Triad | None = None
    attitude_columns: Quaternion | None = None
    bandwidth_hz: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    axes: str = "+X+Y+Z"
    position_mm: Annotated[list[float], Field(min_length=3, max_length=3)] = [0.0, 0.0, 0.0]
    temperature_column: Column | None = None
    thermometer: ThermometerTable | None = None

    @model_validator(mode="before")
    @classmethod
    def _standard(cls, entries: Any) -> Any:
        return _respell_unit(entries, entries.get("quantity") if isinstance(entries, dict) else None)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        _check_unit(self.unit, self.quantity)
        if len(set(self.columns)) < 3:
            raise ValueError(f"columns {self.columns}: each column may appear only once")
        if self.thermometer is not None and self.temperature_column is None:
            raise ValueError("thermometer requires temperature_column: it states what the counts of that column mean")
        if self.sensitivity is not None and self.scale is not None:
            raise ValueError("sensitivity (counts per unit) and scale (units per count) are redundant; leave one out")
        if not self.is_physical:
            if self.range is None:
                raise ValueError("range: is missing")
            if self.counts_per_unit is None:
                raise ValueError("sensitivity: is missing, or scale; columns of counts need it")
        elif self.offset or self.bits:
            raise ValueError("offset and bits apply to counts, but these columns have a unit")
        gravity = [name for name in ("gravity_columns", "attitude_columns") if getattr(self, name) is not None]
        if not self.is_physical and (self.factor is not None or gravity):
            raise ValueError(
                f"{gravity[0] if gravity else 'factor'} applies to columns in a unit, but these hold counts"
            )
        if gravity and self.quantity != "specific_force":
            raise ValueError(f"{gravity[0]} apply to specific_force, but the quantity is {self.quantity}")
        if len(gravity) > 1:
            raise ValueError("gravity_columns and attitude_columns would add gravity twice; leave one out")
        orientation_of(self.axes)
        return self

    @property
    def is_physical(self) -> bool:
        """True if the columns are in `unit`."""
        return self.counts_per_unit is None if self.values is None else self.values == "physical"

    @property
    def counts_per_unit(self) -> float | None:
        """Counts per `unit`; None if the map does not state it."""
        return self.sensitivity if self.scale is None else 1 / self.scale

    @property
    def sign_of_axes(self) -> list[float]:
        """The factor of each axis that `signs` states."""
        return [1.0 if sign == "+" else -1.0 for sign in self.signs]

    @property
    def log_units(self) -> float:
        """The size of one `unit` in the log's unit (g, dps, gauss)."""
        return UNITS_OF[self.quantity][self.unit]


def _respell_unit(entries: Any, quantity: Any) -> Any:
    """Return the entries of a table with their unit spelt as in `imuarray.units`."""
    if isinstance(entries, dict) and isinstance(entries.get("unit"), str):
        return {**entries, "unit": standard_unit(entries["unit"], str(quantity))}
    return entries


def _check_unit(unit: str, quantity: str) -> None:
    """Raise ValueError for a unit of another quantity."""
    if unit not in UNITS_OF[quantity]:  # type: ignore[index]
        raise ValueError(f"unit {unit!r}: allowed for {quantity} are {', '.join(UNITS_OF[quantity])}")  # type: ignore[index]


class ReferenceForce(BaseModel):
    """Three columns of a reference instrument, in the box frame."""

    model_config = _STRICT
    columns: Triad
    unit: str


class ReferenceTemperature(BaseModel):
    """A column of a reference thermometer."""

    model_config = _STRICT
    column: Column
    unit: Annotated[Literal["degC", "K"], _respell(_DEGREE_SPELLINGS)] = "degC"


class ReferenceTable(RowSettings):
    """`[reference]`: readings of a reference instrument, in the box frame; they go to `/reference`."""

    specific_force: ReferenceForce | None = None
    angular_rate: ReferenceForce | None = None
    temperature: ReferenceTemperature | None = None

    @model_validator(mode="before")
    @classmethod
    def _standard(cls, entries: Any) -> Any:
        if not isinstance(entries, dict):
            return entries
        triads = ("specific_force", "angular_rate")
        return {name: _respell_unit(value, name) if name in triads else value for name, value in entries.items()}

    @model_validator(mode="after")
    def _has_something(self) -> Self:
        if self.specific_force is None and self.angular_rate is None and self.temperature is None:
            raise ValueError("names no column; specific_force, angular_rate and temperature are possible")
        for quantity in ("specific_force", "angular_rate"):
            if (triad := getattr(self, quantity)) is not None:
                _check_unit(triad.unit, quantity)
        return self


class PhaseTable(BaseModel):
    """`[[phase]]`: a named stretch of data rows, first and last included, or of seconds from the first row."""

    model_config = _STRICT
    name: Annotated[str, Field(min_length=1)]
    up: Literal["+X", "-X", "+Y", "-Y", "+Z", "-Z", ""] | None = None
    rows: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=2, max_length=2)] | None = None
    seconds: Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=2, max_length=2)] | None = None

    @model_validator(mode="after")
    def _forward(self) -> Self:
        if (self.rows is None) == (self.seconds is None):
            raise ValueError("needs either rows or seconds: [first, last]")
        if self.rows is not None and self.rows[1] < self.rows[0]:
            raise ValueError(f"rows {self.rows}: [first, last], last not before first")
        if self.seconds is not None and self.seconds[1] <= self.seconds[0]:
            raise ValueError(f"seconds {self.seconds}: [begin, end], end after begin")
        named = face_up(self.name)
        if self.up and named and self.up != named:
            raise ValueError(f"up {self.up!r}, but the name {self.name!r} says {named}")
        return self

    @property
    def box_up(self) -> str:
        """The box axis that points up: as stated, or from a name such as z_up, x_down, y_up_check; otherwise ""."""
        return self.up or face_up(self.name)


class TableMap(BaseModel):
    """The complete map."""

    model_config = _STRICT
    file: FileTable = FileTable()
    time: TimeTable | None = None
    sensor: list[SensorTable] = []
    thermometer: list[OwnThermometer] = []
    barometer: list[BarometerTable] = []
    reference: ReferenceTable | None = None
    phase: list[PhaseTable] = []

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.file.format is not None:
            if self.time is not None or self.recorded or self.reference is not None:
                raise ValueError("file: the format defines time and sensors: leave them out")
            return self
        if self.time is None:
            raise ValueError("time: is missing")
        if not self.sensor:
            raise ValueError("sensor: is missing")
        names = [item.name for item in self.recorded]
        for name, count in Counter(names).items():
            if count > 1:
                raise ValueError(f"{count} sensors are called {name!r}; names are unique")
        return self

    @property
    def recorded(self) -> list[LogColumn]:
        """The items that become sensors of the log."""
        return [*self.sensor, *self.thermometer, *self.barometer]

    @property
    def clock(self) -> TimeTable:
        """The `time` of a map with sensors."""
        assert self.time is not None  # noqa: S101, checked above
        return self.time

    def columns(self) -> Iterator[str | int]:
        """Yield every column in the map; some occur more than once."""
        yield from [] if self.time is None else self.time.columns
        streamed: list[RowSettings] = [*self.recorded, *([self.reference] if self.reference else [])]
        for item in streamed:
            yield from columns_of(item)


def columns_of(item: RowSettings) -> Iterator[str | int]:
    """Return the columns of one sensor, thermometer, barometer or reference."""
    if item.time_column is not None:
        yield item.time_column
    if isinstance(item, SensorTable):
        yield from item.columns
        yield from item.gravity_columns or ()
        yield from item.attitude_columns or ()
        if item.temperature_column is not None:
            yield item.temperature_column
    elif isinstance(item, OwnThermometer | BarometerTable):
        yield item.column
    elif isinstance(item, ReferenceTable):
        for triad in (item.specific_force, item.angular_rate):
            yield from triad.columns if triad else ()
        if item.temperature is not None:
            yield item.temperature.column


def load_map(path: str | PathLike[str]) -> TableMap:
    """Read a map's TOML file; ConfigError names the file and every mistake in it."""
    return parse_map(read_text(path), str(path))


def parse_map(text: str, where: str) -> TableMap:
    """Parse a map's TOML text; ConfigError, which begins with `where`."""
    return parse_toml(text, TableMap, where)


def face_name(up: str) -> str:
    """Return the name of a phase in which a box axis ("+Z") points up: z_up."""
    if up not in UP_AXES:
        raise ValueError(f"up {up!r}: allowed are {', '.join(UP_AXES)}")
    return f"{up[1].lower()}_{'up' if up[0] == '+' else 'down'}"
