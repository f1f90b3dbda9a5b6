"""The preamble of a log, written before its first row: sensors with their headers, epoch, source, configuration.

The journal contains it as well, so that a log can be rebuilt from its journal alone.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

from imuarray.axes import orientation_of
from imuarray.errors import LogError
from imuarray.log.format import COUNT_BITS, MOST_SENSORS, TIME_UNCERTAINTY, SensorHeader
from imuarray.printable import printable
from imuarray.units import QUANTITIES, SI_PER_UNIT

if TYPE_CHECKING:
    from imuarray.array import SensorConfig


PREAMBLE = "preamble"
"""The attribute of an unfinished HDF5 file that holds it; a finished one has none."""
PREAMBLE_CRC = "preamble_crc32"
"""The check sum of that text (UTF-8), which HDF5 does not guard."""

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
                raise TypeError("sensors have names of their own")
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
        raise TypeError("a column of that name is there already")
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
    known = {field.name for field in fields(SensorHeader)} | _OWN_ATTRIBUTES
    fits = _is_number(value) and abs(value) < 1 << 63
    return _is_word(name) and name not in known and (fits or (isinstance(value, str) and len(value) <= _LONGEST_TEXT))


def header_of(
    sensor: SensorConfig, extra: Mapping[str, int | float | str], *, is_estimated: bool = False
) -> SensorHeader:
    """Return the header of a configured sensor; `extra` holds attributes of its chip (such as a barometer's calibration
    words). With `is_estimated`, the times of its rows are estimates, and the log states their uncertainty.
    """
    spec = sensor.spec
    barometer = spec.quantity == "pressure"
    x, y, z = sensor.position_mm
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
        compensated=("temperature", "pressure") if barometer else (TIME_UNCERTAINTY,) if is_estimated else (),
        extra={**extra, COUNT_BITS: sensor.count_bits} if sensor.count_bits > 16 else extra,
    )
