"""The names, units and flags of a log, format 1, for every module that writes or reads one.

Times are int64 nanoseconds since the log's epoch, on a clock that never steps. Counts are raw signed register values.

The preamble is written before the first row: sensors with their headers, epoch, source, configuration. The journal
contains it as well, so that a log can be rebuilt from its journal alone.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from imuarray.axes import Matrix, orientation_of
from imuarray.errors import LogError
from imuarray.printable import printable
from imuarray.units import QUANTITIES, SI_PER_UNIT, TRIADS, Quantity

if TYPE_CHECKING:
    from imuarray.array import SensorConfig

FORMAT = "imuarray-log"
FORMAT_VERSION = 1
FUSED = "imuarray-fused"
"""The format of a fused result."""

PLOTS = "plots"
"""The group of a finished log that NeXus viewers open by default."""

CACHE_BYTES = 1 << 20
"""Bytes of the chunk cache of each column that is written; HDF5 2.0's default, 8 MB, is 400 MB for fifty columns."""

READ_CACHE_BYTES = 1 << 18
"""Bytes of the chunk cache of each column that is read: at least two chunks of any column. Rows are read in order, so a
larger cache would be filled without being used.
"""

STALE = 1
"""The same reading as the previous one: the chip had no newer one."""
OVERRUN = 2
"""The chip dropped readings before this one."""
SATURATED = 4
"""An axis is at an end of its range of codes."""
LOST_BEFORE = 8
"""Readings were lost just before this one; an event states why."""
RECONFIGURED = 16
"""First reading after the chip was configured again."""
SUSPECT = 32
"""The chip may not have been in its configured state."""

FLAGS: Mapping[str, int] = {
    "stale": STALE,
    "overrun": OVERRUN,
    "saturated": SATURATED,
    "lost_before": LOST_BEFORE,
    "reconfigured": RECONFIGURED,
    "suspect": SUSPECT,
}

MOST_SENSORS = 512
"""Largest number of sensors of a log: an array of a hundred six-axis chips has two hundred."""

THERMOMETER_ATTRIBUTES = ("thermometer_zero_degc", "thermometer_lsb_per_degc")
"""Attributes of a sensor whose log states the scale of its `temperature_counts`; both or none."""

ADJUSTMENT_ATTRIBUTES = ("asa_x", "asa_y", "asa_z")
"""Attributes of a magnetometer with a factory adjustment of its sensitivity: the field along each axis is counts /
`sensitivity` times (ASA + 128) / 256 (AKM-16).
"""

ARRIVAL = "arrival_delay"
"""Column (n,) of a sensor whose rows arrived in bursts and whose `time` was computed from their number: the delay in s
of each row. `time` plus this delay is the time of arrival, to the nanosecond.
"""

TIME_UNCERTAINTY = "time_uncertainty"
"""Column (n,) of a sensor whose queue was drained: the largest possible error of `time` in s."""

SYNC_PULSE = "sync_pulse"
"""Column (n,) of a sensor with an input for synchronisation pulses: the time in s from the pulse to the sample that it
marks, the first after it; nan in all other rows.
"""

SYNC_PULSE_ERROR = "sync_pulse_error"
"""Attribute of a sensor with the column `SYNC_PULSE`: the largest error of the times in it, in s."""

SINGLE_PRECISION = (TIME_UNCERTAINTY, SYNC_PULSE)
"""Columns in physical units that a log stores in 32 bits."""

SOURCES = ("i2c", "spi", "iio", "serial", "emulated", "simulated", "imported", "replay")

LONG_NAME: Mapping[str, str] = {
    "specific_force": "specific force along the sensor's axes",
    "angular_rate": "angular rate about the sensor's axes",
    "magnetic_field": "magnetic flux density along the sensor's axes",
    "pressure": "air pressure",
    "temperature": "temperature",
}

COUNT_BITS = "count_bits"
"""Attribute of a triad whose counts have more than 16 bits: the number of bits."""

RESOLUTION = "resolution"
"""Attribute of a sensor of an imported log whose counts are not the codes of a chip: `ASSUMED` or `DIGITS`."""

ASSUMED = "assumed"
"""Values without a grid of codes, rounded to counts that are as fine as 16 bits or the noise of the values allow."""

DIGITS = "digits"
"""Values that a program rounded to decimal digits; one count is one step of the last digit."""


class ThermometerScale(NamedTuple):
    """The scale of a chip's own thermometer: a temperature is `zero_degc` + counts / `lsb_per_degc`."""

    zero_degc: float
    lsb_per_degc: float

    @property
    def attributes(self) -> Mapping[str, float]:
        """The attributes of a log, and of the `extra` of a header."""
        return dict(zip(THERMOMETER_ATTRIBUTES, self, strict=True))


class Phase(NamedTuple):
    """A named stretch of a log; `up` is the box axis that points up ("+Z"), "" if none."""

    start_ns: int
    end_ns: int
    name: str
    up: str = ""


class Event(NamedTuple):
    """An event during recording; `sensor` is "" for the array as a whole."""

    time_ns: int
    sensor: str
    kind: str
    message: str


class ClockRow(NamedTuple):
    """A row of `/clocks`: the time of the log and four clocks of the machine (CLOCK_MONOTONIC, ..._RAW, CLOCK_BOOTTIME,
    CLOCK_REALTIME), in ns, read together. With these rows the wall time of any sample is known even if the wall clock
    was set.
    """

    time_ns: int
    monotonic_ns: int
    monotonic_raw_ns: int
    boottime_ns: int
    realtime_ns: int


class CountScale:
    """The scale of a sensor's counts, the same for its header and its recording."""

    quantity: str
    sensitivity: float

    @property
    def adjustment(self) -> tuple[float, float, float]:
        """The factory adjustment of `sensitivity` along x, y and z, 256 / (ASA + 128); 1 without one."""
        words = [self._adjustment_attributes.get(name) for name in ADJUSTMENT_ATTRIBUTES]
        x, y, z = (256 / (word + 128) if isinstance(word, int) and 0 <= word <= 255 else 1.0 for word in words)
        return x, y, z

    @property
    def axis_sensitivity(self) -> tuple[float, float, float]:
        """Counts per `unit` along x, y and z, with the factory adjustment if the log states one."""
        x, y, z = (self.sensitivity * factor for factor in self.adjustment)
        return x, y, z

    @property
    def is_triad(self) -> bool:
        """True for an inertial or magnetic sensor: three axes."""
        return self.quantity in TRIADS

    @property
    def _adjustment_attributes(self) -> Mapping[str, object]:
        raise NotImplementedError


@dataclass(frozen=True)
class SensorHeader(CountScale):
    """The header of one sensor in a log: the attributes of `/sensors/<NAME>`.

    `sensitivity` is the data sheet's typical counts per `unit`; `rate_hz` the chip's own update rate. `columns` are the
    names of the columns of `counts`; `extra` has attributes of particular chips (a barometer's calibration words).
    """

    name: str
    chip: str
    quantity: Quantity
    unit: str
    range: float
    sensitivity: float
    rate_hz: float = 0.0
    bandwidth_hz: float = 0.0
    axes: str = "+X+Y+Z"
    position_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    columns: tuple[str, ...] = ("x", "y", "z")
    has_temperature: bool = False
    compensated: tuple[str, ...] = ()
    delay_ns: int | None = None
    extra: Mapping[str, int | float | str] = field(default_factory=dict)

    @property
    def orientation(self) -> Matrix:
        """3x3, ``vector_box = orientation @ vector_sensor``."""
        return orientation_of(self.axes)

    @property
    def thermometer(self) -> ThermometerScale | None:
        """The scale of its thermometer, if the header has one."""
        zero_degc, lsb_per_degc = (self.extra.get(name) for name in THERMOMETER_ATTRIBUTES)
        if not isinstance(zero_degc, int | float) or not isinstance(lsb_per_degc, int | float) or not lsb_per_degc:
            return None
        return ThermometerScale(float(zero_degc), float(lsb_per_degc))

    @property
    def _adjustment_attributes(self) -> Mapping[str, object]:
        return self.extra

    @property
    def count_bits(self) -> int:
        """The number of bits of a triad's counts, which are stored in 16, or in 32 where there are more."""
        bits = self.extra.get(COUNT_BITS, 16)
        return int(bits) if isinstance(bits, int | float) else 16

    @property
    def where(self) -> str:
        """The name in errors."""
        return f"sensor {self.name}"


PREAMBLE = "preamble"
"""The attribute of an unfinished HDF5 file that contains the preamble; a finished file does not have it."""
PREAMBLE_CRC = "preamble_crc32"
"""The attribute with the checksum of the preamble's text (UTF-8), which HDF5 does not protect."""

_NO_TEXTS = frozenset({"sensors", "frame_rate_hz"})
_TUPLES = ("position_mm", "columns", "compensated")
_RESERVED = frozenset({"time", "counts", "status", "temperature_counts", "axis"})
_OWN_ATTRIBUTES = frozenset({"orientation", "NX_class", "signal"})
_NO_NAMES = frozenset({".", ".."})
_LONGEST_TEXT = 255
_MOST_COLUMNS = 32


@dataclass(frozen=True)
class Preamble:
    """The preamble of a log. `identity` distinguishes a log and its journal from other recordings. `frame_rate_hz` is
    the requested frame rate; 0 if there is none, as in an imported log.
    """

    sensors: tuple[SensorHeader, ...]
    source: str
    epoch: str
    config: str
    software: str
    identity: str = ""
    frame_rate_hz: float = 0.0

    def to_json(self) -> str:
        """Return the preamble as one line of JSON."""
        sensors = [asdict(header) | {"extra": dict(header.extra)} for header in self.sensors]
        return json.dumps(asdict(self) | {"sensors": sensors}, default=lambda number: number.item())

    @classmethod
    def from_json(cls, text: str | bytes) -> Preamble:
        """Return the preamble that `to_json` wrote; LogError for anything else."""
        try:
            values = json.loads(text)
            listed = values.pop("sensors")
            if not isinstance(listed, list) or len(listed) > MOST_SENSORS:
                raise TypeError(f"sensors are a list of at most {MOST_SENSORS}")
            sensors = tuple(_header(header) for header in listed)
            if len({header.name for header in sensors}) < len(sensors):
                raise TypeError("sensors have different names")
            preamble = cls(sensors=sensors, **values)
        except (ValueError, TypeError, AttributeError, KeyError, RecursionError) as error:
            raise LogError(f"the log's preamble can't be read: {printable(repr(error))[:_LONGEST_TEXT]}") from None
        texts = [getattr(preamble, field.name) for field in fields(cls) if field.name not in _NO_TEXTS]
        if not all(isinstance(text, str) and "\0" not in text for text in texts):
            raise LogError("the log's preamble can't be read: text is required")
        if not _is_number(preamble.frame_rate_hz) or preamble.frame_rate_hz < 0:
            raise LogError("the log's preamble can't be read: a frame rate is a positive number, or 0")
        return preamble


def _header(values: dict[str, Any]) -> SensorHeader:
    """Return a sensor's header from JSON; TypeError or ValueError unless the writer could have written it."""
    header = SensorHeader(**values | {name: tuple(values[name]) for name in _TUPLES})
    names = (header.name, *header.columns, *header.compensated)
    if not all(_is_word(name) for name in names) or not 0 < len(header.columns) <= len(names) <= _MOST_COLUMNS:
        raise TypeError("names of sensors and columns are words")
    if not _RESERVED.isdisjoint(header.compensated) or len(set(header.compensated)) < len(header.compensated):
        raise TypeError("a column of that name exists already")
    numbers = (header.range, header.sensitivity, header.rate_hz, header.bandwidth_hz, *header.position_mm)
    if len(header.position_mm) != 3 or not all(_is_number(number) for number in numbers):
        raise TypeError("finite numbers are required")
    texts = (header.chip, header.quantity, header.unit, header.axes)
    if not all(isinstance(text, str) for text in texts) or not isinstance(header.has_temperature, bool):
        raise TypeError("text is required")
    if header.quantity not in QUANTITIES or header.unit not in SI_PER_UNIT:
        raise ValueError(f"quantity {header.quantity}, unit {header.unit}")
    if not (header.delay_ns is None or (isinstance(header.delay_ns, int) and abs(header.delay_ns) < 1 << 63)):
        raise TypeError("delay_ns is a whole number")
    if not isinstance(header.extra, dict) or not all(_is_extra(*item) for item in header.extra.items()):
        raise TypeError("further attributes are numbers and words")
    orientation_of(header.axes)
    return header


def _is_word(name: Any) -> bool:
    """Return whether this can be a name in an HDF5 file and be displayed."""
    fits = isinstance(name, str) and 0 < len(name.encode(errors="replace")) <= _LONGEST_TEXT
    return fits and name.isprintable() and "/" not in name and name not in _NO_NAMES


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _is_extra(name: Any, value: Any) -> bool:
    """Return whether this can be an attribute of a particular chip."""
    names = {field.name for field in fields(SensorHeader)} | _OWN_ATTRIBUTES
    fits = _is_number(value) and abs(value) < 1 << 63
    return _is_word(name) and name not in names and (fits or (isinstance(value, str) and len(value) <= _LONGEST_TEXT))


def header_of(
    sensor: SensorConfig, extra: Mapping[str, int | float | str], *, is_estimated: bool = False
) -> SensorHeader:
    """Return the header of a configured sensor; `extra` holds attributes of its chip (such as a barometer's calibration
    words). With `is_estimated`, the times of its rows are estimates, and the log states their uncertainty.
    """
    spec = sensor.spec
    barometer = spec.quantity == "pressure"
    x, y, z = sensor.position_mm
    further = {COUNT_BITS: sensor.count_bits} if sensor.count_bits > 16 else {}
    pulses = {}
    if sensor.marks_pulses and spec.pulse_input is not None:
        pulses = {SYNC_PULSE_ERROR: spec.pulse_input.error_s(sensor.chip_rate_hz)}
    timing = (*((TIME_UNCERTAINTY,) if is_estimated else ()), *((SYNC_PULSE,) if pulses else ()))
    return SensorHeader(
        name=sensor.name,
        chip=sensor.chip,
        quantity=spec.quantity,
        unit=spec.unit,
        range=sensor.range or 0.0,
        sensitivity=sensor.sensitivity,
        rate_hz=sensor.chip_rate_hz,
        bandwidth_hz=sensor.chip_bandwidth_hz,
        axes=sensor.axes,
        position_mm=(x, y, z),
        columns=("ut", "up") if barometer else ("x", "y", "z"),
        has_temperature=spec.has_thermometer and (spec.fifo_has_temperature or not sensor.fifo),
        compensated=("temperature", "pressure") if barometer else timing,
        extra={**extra, **further, **pulses},
    )


ColumnTypes = tuple[tuple[str, str, tuple[int, ...]], ...]
"""Equally long columns: name, little-endian type, and shape of a row."""

STIMULUS: ColumnTypes = (
    ("time", "<i8", ()),
    ("specific_force", "<f8", (3,)),
    ("angular_rate", "<f8", (3,)),
    ("temperature", "<f8", ()),
)
CLOCKS: ColumnTypes = tuple((name.removesuffix("_ns"), "<i8", ()) for name in ClockRow._fields)

TRACK_COLUMNS: Mapping[str, ColumnTypes] = MappingProxyType(
    {"truth": STIMULUS, "reference": STIMULUS, "clocks": CLOCKS}
)
"""The groups that a log may have besides its sensors; a group exists if it has rows."""

TRACK_UNITS: Mapping[str, str] = MappingProxyType(
    {"specific_force": "m s-2", "angular_rate": "rad s-1", "temperature": "degC"}
    | {name: "ns" for name, _, _ in CLOCKS if name != "time"}
)
"""The units of the columns of these groups; `time` is in ns since the epoch."""

STIMULI = ("truth", "reference")

COMPENSATED_UNITS: Mapping[str, str] = MappingProxyType(
    {"temperature": "degC", "pressure": "Pa", ARRIVAL: "s", TIME_UNCERTAINTY: "s", SYNC_PULSE: "s"}
)
"""The units of the columns of a sensor that `SensorHeader.compensated` names."""
