"""Import any recording with a map that names its columns (`imuarray.importers.mapping`), streamed into a log."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Times
from imuarray.errors import ConfigError, SourceError
from imuarray.importers import NO_WALL_TIME, ImportSummary, importer
from imuarray.importers.cells import (
    INT32,
    ROWS,
    Blocks,
    CellBlock,
    CellColumn,
    CodeConversion,
    TimeColumn,
    counts,
    numbers,
)
from imuarray.importers.clipped import flag_clipped
from imuarray.importers.mapping import (
    PA_PER_UNIT,
    SCALE_UNKNOWN,
    UNIT_UNKNOWN,
    ZERO_OF_UNIT,
    BarometerTable,
    LogColumn,
    OwnThermometer,
    PhaseTable,
    ReferenceTable,
    RowSettings,
    SensorTable,
    TableMap,
    ThermometerTable,
    columns_of,
    face_name,
    has_no_day,
    load_map,
)
from imuarray.importers.resolution import FULL_SPAN, SAMPLE_ROWS, Resolution, bits_of, resolution_of
from imuarray.importers.row_order import RowOrder, count_out
from imuarray.importers.sources import RecordingRows, Reference, open_rows
from imuarray.log import Block, LogWriter, Stimulus, open_log
from imuarray.log.format import (
    ARRIVAL,
    COUNT_BITS,
    LOST_BEFORE,
    SATURATED,
    Event,
    Phase,
    SensorHeader,
    ThermometerScale,
)
from imuarray.log.sensor_log import first_at
from imuarray.printable import counted, listed
from imuarray.toml_files import read_text
from imuarray.units import SI_PER_UNIT, UNITS_OF

VANISHED = 0.3
"""Difference of neighbouring values (rms, in counts) below which the noise of a column is lost by rounding."""

_GUESSED_TIME = re.compile(r"^\s*(rate_hz|ticks)\s*=[^#\n]*#\s*\?", re.MULTILINE)
"""Pattern of a rate, or of the duration of a count, that `imuarray import --guess` marked as doubtful."""

_GUESSED_SCALE = re.compile(
    rf"^\s*(unit|sensitivity)\s*=[^#\n]*#\s*\?\s*(?:{UNIT_UNKNOWN}|{SCALE_UNKNOWN})", re.MULTILINE
)
"""Pattern of a gyroscope's unit or sensitivity that `imuarray import --guess` could not determine."""


def import_table(
    source: str | PathLike[str],
    map_path: str | PathLike[str],
    output: str | PathLike[str],
    *,
    force: bool = False,
    progress: Callable[[int], None] = lambda done: None,
    up: str = "",
) -> ImportSummary:
    """Import the recording `source` (a text table, compressed by gzip or not, .npz, .mat, .parquet, a bag) with the map
    at `map_path` into the log `output`. `up`: the box axis that pointed up all the time ("+Z"), "" if unknown.

    Raises ConfigError for the map, SourceError for the recording (file, line, column), OutputExistsError, LogError.
    """
    table_map = load_map(map_path)
    if table_map.file.format is not None:
        return _import_format(table_map, source, map_path, output, force, progress)
    if up:
        if table_map.phase:
            raise ConfigError(
                f"{map_path}: names phases, so --up {up}, a phase of the whole recording, can't be given as well"
            )
        face_name(up)
    rows = open_rows(source, output, table_map, progress)
    streams = _streams(table_map)
    learnt = {
        sensor.name: resolution for stream in streams for sensor, resolution in _infer(stream, rows, table_map, ROWS)
    }
    headers = [_header(sensor, table_map, learnt.get(sensor.name)) for sensor in table_map.sensor]
    headers += [_thermometer_header(item) for item in table_map.thermometer]
    headers += [_barometer_header(item) for item in table_map.barometer]
    with LogWriter(output, headers, source="imported", epoch=NO_WALL_TIME, force=force) as log:
        recording = _Recording(log, table_map, {header.name: header for header in headers}, streams)
        for stream in recording.streams:
            for block, places in stream.in_order(rows.blocks(stream.plan.columns, stream.plan.kind, ROWS)):
                stream.add(block, places)
        recording.finish(str(source), str(map_path), up)
        remarks = [*rows.remarks, *recording.remarks(learnt)]
        remarks += flag_clipped(log, [header for header in headers if header.is_triad])
    rows_of_sensor = {name: count for stream in recording.streams for name, count in stream.rows_of.items()}
    return ImportSummary(
        tuple(header.name for header in headers),
        max(rows_of_sensor.values()),
        None,
        recording.seconds,
        same_rows=len(set(rows_of_sensor.values())) == 1,
        remarks=tuple(remarks),
        doubts=tuple(_guesses(read_text(map_path), table_map, output)),
    )


def _guesses(map_text: str, table_map: TableMap, output: str | PathLike[str]) -> Iterator[str]:
    """Yield a sentence on each guess of the map, marked with "# ?", that changes all numbers: the time of the rows, and
    the scale of gyroscopes, unless the rotation of gravity in the log `output` shows it.
    """
    clock = table_map.clock
    if match := _GUESSED_TIME.search(map_text):
        what = (
            f"the rate of {clock.rate_hz:g} rows a second"
            if match[1] == "rate_hz"
            else f"the duration of a count of the time column, {clock.ticks:g} {clock.unit}"
        )
        yield f"{what}, from which all times follow, is a guess; {_CONFIRM.format(match[1])}"
    scales = [match[1] for match in _GUESSED_SCALE.finditer(map_text)]
    if not scales:
        return
    from imuarray.importers.plausibility import turns_of

    with open_log(output) as log:
        if turns_of(log) is not None:
            return
    keys = listed(list(dict.fromkeys(scales)))
    names = listed([sensor.name for sensor in table_map.sensor if sensor.quantity == "angular_rate"])
    yield f"{names}: the scale of the gyroscope is a guess, and no rotation shows it; {_CONFIRM.format(keys)}"


_CONFIRM = "if it is true, remove the question mark at {} in the map"


def _import_format(
    table_map: TableMap,
    source: str | PathLike[str],
    map_path: str | PathLike[str],
    output: str | PathLike[str],
    force: bool,
    progress: Callable[[int], None],
) -> ImportSummary:
    """Import a recording of a named format; ConfigError for entries that are not allowed with it."""
    name = str(table_map.file.format)
    try:
        import_file = importer(name)
    except KeyError:
        raise ConfigError(f"{map_path}: file: format {name!r}: no such format") from None
    if table_map.phase:
        raise ConfigError(f"{map_path}: phase: a recording of format {name!r} has none")
    return import_file(source, output, force=force, progress=progress)


class RowGroup(NamedTuple):
    """The items of the map that share rows, with the same time column (None: a rate) and kind."""

    time_column: Reference | None
    kind: str | None
    items: tuple[RowSettings, ...]
    second_column: Reference | None = None
    """The column of the fraction of a second."""

    @property
    def columns(self) -> list[Reference]:
        """Every column once, that of time first."""
        named = [column for column in (self.time_column, self.second_column) if column is not None]
        return list(dict.fromkeys([*named, *(column for item in self.items for column in columns_of(item))]))


def _streams(table_map: TableMap) -> list[RowGroup]:
    items: list[RowSettings] = list(table_map.recorded)
    items += [table_map.reference] if table_map.reference is not None else []
    together: dict[tuple[Reference | None, str | None], list[RowSettings]] = {}
    for item in items:
        column = table_map.clock.column if item.time_column is None else item.time_column
        together.setdefault((column, item.kind), []).append(item)
    clock = table_map.clock
    return [
        RowGroup(column, kind, tuple(group), next(iter(clock.columns[1:]), None) if column == clock.column else None)
        for (column, kind), group in together.items()
    ]


def _infer(
    plan: RowGroup, rows: RecordingRows, table_map: TableMap, block_rows: int
) -> Iterator[tuple[SensorTable, Resolution]]:
    """Infer the settings that the map does not state: range and sensitivity of columns in a unit, and the number of
    bits of codes with a range of more than 16 bits. The recording is read once more for this.
    """
    open_ = [item for item in plan.items if isinstance(item, SensorTable) and _is_open(item)]
    largest = dict.fromkeys((sensor.name for sensor in open_), 0.0)
    samples: dict[str, list[list[Floats]]] = {sensor.name: [[], [], []] for sensor in open_}
    row_count = 0
    if open_:
        for block, places in rows.blocks(plan.columns, plan.kind, block_rows):
            column_at = dict(zip(plan.columns, places, strict=True))
            for sensor in open_:
                cells = _triad_of(
                    {name: block.column(column_at[name], repr(name)) for name in columns_of(sensor)}, sensor
                )
                complete = ~_missing(cells)
                for axis, cell in zip(samples[sensor.name], cells, strict=True):
                    values = numbers(cell.where(complete))
                    values = values * sensor.log_units if sensor.is_physical else values - sensor.offset
                    largest[sensor.name] = max(largest[sensor.name], float(np.abs(values).max(initial=0.0)))
                    if row_count < SAMPLE_ROWS:
                        axis.append(values)
            row_count += len(block.lines)
    for sensor in open_:
        if not sensor.is_physical:
            per_unit, range_ = sensor.counts_per_unit or 1.0, sensor.range or 0.0
            bits = bits_of(largest[sensor.name], per_unit * range_)
            yield sensor, Resolution(per_unit / sensor.log_units, range_ * sensor.log_units, True, bits)
            continue
        sample = [np.concatenate([np.zeros(0), *axis]) for axis in samples[sensor.name]]
        known = None if sensor.counts_per_unit is None else sensor.counts_per_unit / sensor.log_units
        stated = None if sensor.range is None else sensor.range * sensor.log_units
        yield sensor, resolution_of(sensor.quantity, sample, largest[sensor.name], stated, known)


def _is_open(sensor: SensorTable) -> bool:
    """Return whether range, sensitivity or bits of a sensor must be inferred from the recording."""
    if sensor.is_physical:
        return sensor.range is None or sensor.counts_per_unit is None or _has_wide_range(sensor)
    return sensor.bits is None and _has_wide_range(sensor)


def _has_wide_range(sensor: SensorTable) -> bool:
    """Return whether the range in the map requires more than 16 bits."""
    return (sensor.range or 0.0) * (sensor.counts_per_unit or 0.0) > FULL_SPAN


def _header(sensor: SensorTable, table_map: TableMap, learnt: Resolution | None) -> SensorHeader:
    x, y, z = sensor.position_mm
    scale = None if sensor.thermometer is None else ThermometerScale(*sensor.thermometer.scale)
    per_unit = sensor.counts_per_unit
    bits = (sensor.bits or 16) if learnt is None else learnt.bits
    resolution = learnt.attributes(sensor.log_units) if learnt and sensor.is_physical else {}
    return SensorHeader(
        name=sensor.name,
        chip=sensor.chip,
        quantity=sensor.quantity,
        unit=next(iter(UNITS_OF[sensor.quantity])),
        range=learnt.range if learnt else float(sensor.range or 0.0) * sensor.log_units,
        sensitivity=learnt.sensitivity if learnt else float(per_unit or 0.0) / sensor.log_units,
        rate_hz=table_map.clock.rate_hz or 0.0,
        bandwidth_hz=sensor.bandwidth_hz,
        axes=sensor.axes,
        position_mm=(x, y, z),
        has_temperature=sensor.temperature_column is not None,
        compensated=(ARRIVAL,) if table_map.clock.stamps == "arrival" else (),
        extra={
            **({} if scale is None else scale.attributes),
            **resolution,
            **({COUNT_BITS: bits} if bits > 16 else {}),
        },
    )


def _thermometer_header(item: OwnThermometer) -> SensorHeader:
    scale = ThermometerScale(*item.scale)
    return SensorHeader(
        name=item.name,
        chip=item.chip,
        quantity="temperature",
        unit="degC",
        range=0.0,
        sensitivity=abs(scale.lsb_per_degc),
        columns=("t",),
        has_temperature=True,
        compensated=("temperature",),
        extra=scale.attributes,
    )


def _barometer_header(item: BarometerTable) -> SensorHeader:
    return SensorHeader(
        name=item.name,
        chip=item.chip,
        quantity="pressure",
        unit="Pa",
        range=0.0,
        sensitivity=0.0,
        columns=("pa",),
        compensated=("pressure",),
    )


def _is_copy(cells: Iterable[CellColumn], row: int) -> bool:
    """Return whether a row has the same cells as the row before."""
    columns = (cell.texts if cell.values is None else cell.values for cell in cells)
    return all(column[row] == column[row - 1] for column in columns)


def _missing(cells: Sequence[CellColumn]) -> Booleans:
    """Return (n,) rows in which at least one cell of a sensor has no value, or the text of a damaged line: a triad with
    two axes is not a reading.
    """
    return np.asarray(np.any([cell.blank() | cell.torn() for cell in cells], axis=0), bool)


def _blank(cells: Sequence[CellColumn]) -> Booleans:
    """Return (n,) rows in which no cell of a sensor has a value: they belong to other sensors of the table."""
    return np.asarray(np.all([cell.blank() for cell in cells], axis=0), bool)


def _triad_of(cells: Mapping[Reference, CellColumn], sensor: SensorTable) -> list[CellColumn]:
    """Return the cells of a sensor's axes, with factor, signs and gravity of the map applied."""
    triad = [cells[column] for column in sensor.columns]
    if sensor.hexadecimal:
        triad = [cell._replace(texts=list(map(_add_prefix, cell.texts))) for cell in triad]
    is_plain = sensor.gravity_columns is None and sensor.attitude_columns is None
    if sensor.factor is None and sensor.signs == "+++" and is_plain:
        return triad
    values = np.stack([_numbers_or_nan(cell) for cell in triad])
    if sensor.gravity_columns is not None:
        values += np.stack([_numbers_or_nan(cells[column]) for column in sensor.gravity_columns])
    values *= sensor.factor or 1.0
    values *= np.array(sensor.sign_of_axes)[:, None]
    if sensor.attitude_columns is not None:
        quaternion = np.stack([_numbers_or_nan(cells[column]) for column in sensor.attitude_columns])
        values += _up_in_sensor(quaternion) / sensor.log_units
    return [
        CellColumn(cell.source, cell.label, cell.lines, (), column) for cell, column in zip(triad, values, strict=True)
    ]


def _add_prefix(code: str) -> str:
    """Return a hexadecimal code with 0x, as `number_of` requires; other cells as they are."""
    return f"0x{code.strip()}" if _HEXADECIMAL.fullmatch(code.strip()) else code


_HEXADECIMAL = re.compile(r"[0-9A-Fa-f]{1,8}")


def _add_date(time: CellColumn, date: CellColumn) -> CellColumn:
    """Return the times of day with their dates before them; SourceError unless both columns are texts."""
    if time.values is not None or date.values is not None:
        raise time.refuse(0, "times with a date_column must be texts")
    return time._replace(
        texts=[f"{day.strip()} {clock.strip()}" for day, clock in zip(date.texts, time.texts, strict=True)]
    )


_UNIT_LENGTH = 0.05
"""Largest deviation of the length of a quaternion from 1; other values, for example zeros before a program has an
estimate, are not attitudes.
"""


def _up_in_sensor(quaternion: Floats) -> Floats:
    """Return the upward direction (3, n) in the sensor's axes from unit quaternions (4, n), w first, that turn these
    axes to a level frame; nan where the length is not 1. It is the third row of the rotation matrix (Diebel,
    "Representing attitude", 2006, equation 125).
    """
    length = np.linalg.norm(quaternion, axis=0)
    is_unit = np.abs(length - 1) < _UNIT_LENGTH
    w, x, y, z = np.where(is_unit, quaternion / np.where(is_unit, length, 1.0), np.nan)
    return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), w**2 - x**2 - y**2 + z**2])


def _numbers_or_nan(cell: CellColumn) -> Floats:
    """Return the numbers (n,) of a column, nan for blank cells; SourceError for text."""
    blank = cell.blank()
    values = np.full(cell.rows, np.nan)
    values[~blank] = numbers(cell.where(~blank))
    return values


class _Rounding:
    """Statistics of values in a unit that were rounded to counts."""

    def __init__(self, is_learnt: bool) -> None:
        self.is_learnt = is_learnt
        self.rows = 0
        self._off = self._steps = np.zeros(3)

    def add(self, values: npt.NDArray[np.float64], whole: npt.NDArray[np.signedinteger]) -> None:
        self.rows += len(values)
        self._off = self._off + ((values - whole) ** 2).sum(axis=0)
        self._steps = self._steps + (np.diff(values, axis=0) ** 2).sum(axis=0) / 2

    def remark(self, name: str, unit: str, sensitivity: float) -> str:
        """Return a sentence if the rounding matters, otherwise ""."""
        if self.rows < 2:
            return ""
        off, noise = np.sqrt(self._off / self.rows), np.sqrt(self._steps / (self.rows - 1))
        vanishing = (noise > 0) & (noise < VANISHED)  # values that never change are not lost by rounding
        if vanishing.any() and (off > 1e-3).any():
            axes = "".join("xyz"[axis] for axis in np.flatnonzero(vanishing))
            change = float(noise[vanishing].min())
            return (
                f"{name} {axes}: its values change by {change:.2g} counts only and are rounded away:"
                f" {sensitivity:.6g} counts per {unit} are too few, or the unit is wrong"
            )
        if (off > 0.1).any() and not self.is_learnt:
            return f"{name}: its values are not whole counts at {sensitivity:.6g} per {unit}; they were rounded"
        return ""


class _Stream:
    """Sensors that share their rows, written into a log."""

    def __init__(
        self, log: LogWriter, plan: RowGroup, table_map: TableMap, headers: dict[str, SensorHeader], ends: set[int]
    ) -> None:
        time = table_map.clock
        self.log, self.plan, self._time, self._headers = log, plan, time, headers
        has_fraction = plan.second_column is not None and plan.second_column == time.fraction_column
        unit = "ns" if has_fraction else time.unit or "ns"
        self._clock = TimeColumn(unit, time.ticks, time.wraps_at, time.ties, restarts=time.restarts)
        self._order = RowOrder(self._stamps) if time.sort and plan.time_column is not None else None
        self._last_stamp: Times = np.zeros(0, np.int64)
        self._phase_rows = ends
        self.time_of: dict[int, int] = {}
        self.count = self.padding = 0
        self._ties_are_copies = True
        self.first_ns = self.last_ns = 0
        names = [item.name for item in plan.items if isinstance(item, LogColumn)]
        self.rows_of = dict.fromkeys(names, 0)
        self._incomplete: Counter[str] = Counter()
        self._flagged_losses: Counter[str] = Counter()
        triads = [item for item in plan.items if isinstance(item, SensorTable)]
        self._rounding = {item.name: _Rounding(item.counts_per_unit is None) for item in triads if item.is_physical}

    def in_order(self, blocks: Blocks) -> Blocks:
        return self._order.in_order(blocks) if self._order is not None else blocks

    def _stamps(self, block: CellBlock, places: Sequence[int]) -> Times:
        """Return the time of each row; a row without time, or of zeros (padding), has the time of the row before."""
        cell = block.column(places[0], repr(self.plan.time_column))
        timed = ~(cell.blank() | _zeros(cell))
        stamps = np.concatenate([self._last_stamp, self._clock.stamps(cell.where(timed))])
        if not len(stamps):
            return np.zeros(cell.rows, np.int64)
        self._last_stamp, earlier_count = stamps[-1:], len(self._last_stamp)
        return np.asarray(stamps[np.maximum(np.cumsum(timed) + earlier_count - 1, 0)])

    def add(self, block: CellBlock, places: Sequence[int]) -> None:
        cells = {
            column: block.column(index, repr(column)) for column, index in zip(self.plan.columns, places, strict=True)
        }
        cells = self._drop_padding(cells)
        length = next(iter(cells.values())).rows
        if not length:
            return
        time = self._times(cells, length)
        if self._ties_are_copies:
            ties = np.flatnonzero(self._clock.tied_rows[1:]) + 1 if self.plan.time_column is not None else ()
            self._ties_are_copies = all(_is_copy(cells.values(), int(row)) for row in ties)
        if self.count == 0:
            self.first_ns = int(time[0])
        inside = range(self.count, self.count + length)
        self.time_of |= {row: int(time[row - self.count]) for row in self._phase_rows if row in inside}
        self.count += length
        self.last_ns = int(time[-1])
        for item in self.plan.items:
            if isinstance(item, SensorTable):
                self._add_triad(item, cells, time)
            elif isinstance(item, OwnThermometer):
                self._add_degrees(item, cells, time)
            elif isinstance(item, BarometerTable):
                self._add_pressures(item, cells, time)
            elif isinstance(item, ReferenceTable):
                self._add_reference(item, cells, time)

    def _drop_padding(self, cells: dict[Reference, CellColumn]) -> dict[Reference, CellColumn]:
        """Remove trailing rows of zeros, including time, which a program reserved and did not fill; and rows without
        time, in which no sensor has a reading.
        """
        column = self.plan.time_column
        if column is None:
            return cells
        blank = cells[column].blank()
        if blank.any():
            blank = blank & np.all([cell.blank() for cell in cells.values()], axis=0)
        zero = _zeros(cells[column])
        if zero.any():
            began = self._clock.last_ns is not None and self._clock.last_ns > 0
            zero &= began | np.logical_or.accumulate(~zero)
            zero = np.all([zero, *(_zeros(cell) for cell in cells.values())], axis=0)
            self.padding += int(np.count_nonzero(zero))
        is_reading = ~(zero | blank)
        return cells if is_reading.all() else {name: cell.where(is_reading) for name, cell in cells.items()}

    def _times(self, cells: dict[Reference, CellColumn], length: int) -> Times:
        """Return (n,) ns from the time column, or from the rate."""
        if self.plan.time_column is not None:
            cell = cells[self.plan.time_column]
            second = None if self.plan.second_column is None else cells[self.plan.second_column]
            if second is not None and self._time.date_column is not None:
                cell = _add_date(cell, second)
            elif second is not None:
                rest = TimeColumn(self._time.fraction_unit).stamps(second)
                cell = CellColumn(cell.source, cell.label, cell.lines, (), TimeColumn("s").stamps(cell) + rest)
            return self._clock.nanoseconds(cell)
        period_ns = 1_000_000_000 / Fraction(self._time.rate_hz or 1.0).limit_denominator(1_000_000)
        rows = range(self.count, self.count + length)
        return np.array([row * period_ns.numerator // period_ns.denominator for row in rows], np.int64)

    def _add_triad(self, sensor: SensorTable, cells: dict[Reference, CellColumn], time: Times) -> None:
        triad = _triad_of(cells, sensor)
        missing = _missing(triad)
        complete = ~missing
        header = self._headers[sensor.name]
        per_unit = header.sensitivity * sensor.log_units if sensor.is_physical else None
        codes = CodeConversion(per_unit, sensor.offset, sensor.bits, header.count_bits)
        triads = np.stack([counts(cell.where(complete), codes) for cell in triad], axis=1)
        if per_unit is not None:
            values = np.stack([numbers(cell.where(complete)) for cell in triad], axis=1) * per_unit
            self._rounding[sensor.name].add(values, triads)
        full = ((triads == codes.span[0]) | (triads == codes.span[1])).any(axis=1)
        degrees = None
        if sensor.temperature_column is not None:
            cell = cells[sensor.temperature_column].where(complete)
            if cell.blank().any():
                raise cell.refuse(
                    int(np.argmax(cell.blank())),
                    f"no temperature; a column with blank cells is a [[thermometer]] of its own, not the"
                    f" temperature_column of {sensor.name}",
                )
            degrees = _degrees(cell, sensor.thermometer)
        late = {name: np.zeros(len(triads)) for name in header.compensated}
        status = np.where(full, SATURATED, 0).astype(np.uint16)
        status |= self._flag_lost(sensor.name, missing & ~_blank(triad), complete)
        if self._clock.restarted.any():
            status[np.searchsorted(np.flatnonzero(complete), np.flatnonzero(self._clock.restarted & complete))] |= (
                LOST_BEFORE
            )
        self.log.append(sensor.name, Block(time[complete], triads, status, degrees, late))
        self.rows_of[sensor.name] += len(triads)

    def _flag_lost(self, name: str, incomplete: Booleans, complete: Booleans) -> npt.NDArray[np.uint16]:
        """Return the flags (k,) of the `complete` rows (n,): a row is flagged as lost before if `incomplete` rows (n,)
        precede it, also those of an earlier block.
        """
        losses = self._incomplete[name] + np.cumsum(incomplete)
        lost = np.diff(losses[complete], prepend=self._flagged_losses[name]) > 0
        self._incomplete[name] = int(losses[-1])
        if complete.any():
            self._flagged_losses[name] = int(losses[complete][-1])
        return np.where(lost, LOST_BEFORE, 0).astype(np.uint16)

    def _add_degrees(self, item: OwnThermometer, cells: dict[Reference, CellColumn], time: Times) -> None:
        filled = ~cells[item.column].blank()
        degrees = _degrees(cells[item.column].where(filled), item)
        zero_degc, lsb_per_degc = item.scale
        status = np.zeros(len(degrees), np.uint16)
        warm = {"temperature": zero_degc + degrees / lsb_per_degc}
        self.log.append(item.name, Block(time[filled], degrees[:, None].astype(np.int32), status, degrees, warm))
        self.rows_of[item.name] += len(degrees)

    def _add_pressures(self, item: BarometerTable, cells: dict[Reference, CellColumn], time: Times) -> None:
        """Write pressures, and their values in whole pascals as counts."""
        filled = ~cells[item.column].blank()
        pressure = numbers(cells[item.column].where(filled)) * PA_PER_UNIT[item.unit]
        whole = np.clip(np.rint(pressure), INT32[0], INT32[1]).astype(np.int32)
        status = np.zeros(len(pressure), np.uint16)
        self.log.append(item.name, Block(time[filled], whole[:, None], status, None, {"pressure": pressure}))
        self.rows_of[item.name] += len(pressure)

    def _add_reference(self, item: ReferenceTable, cells: dict[Reference, CellColumn], time: Times) -> None:
        filled = ~_blank([cells[column] for column in columns_of(item)])
        triads = []
        for quantity in ("specific_force", "angular_rate"):
            triad = item.specific_force if quantity == "specific_force" else item.angular_rate
            if triad is None:
                triads.append(np.full((int(filled.sum()), 3), np.nan))
                continue
            unit, factor = next(iter(UNITS_OF[quantity])), UNITS_OF[quantity][triad.unit]
            values = np.stack([numbers(cells[column].where(filled)) for column in triad.columns], axis=1)
            triads.append(values * factor * SI_PER_UNIT[unit])
        warm = np.full(int(filled.sum()), np.nan)
        if item.temperature is not None:
            warm = numbers(cells[item.temperature.column].where(filled)) + ZERO_OF_UNIT[item.temperature.unit]
        self.log.stimulus("reference", Stimulus(time[filled], triads[0], triads[1], warm))

    def remarks(self) -> Iterator[str]:
        if self.padding:
            yield f"{counted(self.padding, 'row')} of zeros only, time included, left out as padding"
        if self._order is not None and self._order.late:
            rows = counted(self._order.late, "row")
            yield f"{rows} out of order in the file sorted by time; the file's order is not kept"
        if self._order is not None and self._order.repeated:
            yield f"{counted(self._order.repeated, 'row')} that the file holds twice kept once"
        if self._clock.tied:
            copies = ", all with equal cells: the file may hold rows twice" if self._ties_are_copies else ""
            yield f"{counted(self._clock.tied, 'row')} with the time of the row before put 1 ns later{copies}"
        if self._clock.set_back_ns:
            back = ", ".join(f"{ns * 1e-9:.6g} s" for ns in self._clock.set_back_ns[:3])
            more = ", ..." if len(self._clock.set_back_ns) > 3 else ""
            yield (
                f"the times went back {counted(len(self._clock.set_back_ns), 'time')}, by {back}{more}; the rows after"
                " that continue at the usual interval, because the time in between is unknown"
            )
        if self._clock.wrapped:
            yield f"the time column wrapped {counted(self._clock.wrapped, 'time')}"
        names_by_remark: dict[str, list[str]] = {}
        for name, count in self.rows_of.items():
            incomplete = self._incomplete[name]
            if blank := self.count - count - incomplete:
                remark = f"no reading in {blank} of {self.count} rows, whose cells are blank"
                names_by_remark.setdefault(remark, []).append(name)
            if incomplete:
                rows = counted(incomplete, "row")
                remark = f"{rows} left out in which an axis has no value; the next row is flagged (lost before)"
                names_by_remark.setdefault(remark, []).append(name)
        yield from (f"{listed(names)}: {remark}" for remark, names in names_by_remark.items())
        for name, rounding in self._rounding.items():
            header = self._headers[name]
            if text := rounding.remark(name, header.unit, header.sensitivity):
                yield text


def _zeros(cell: CellColumn) -> Booleans:
    if cell.values is not None:
        return np.asarray(cell.values == 0, bool)
    return np.array([text != "" and not text.strip("0.+- ") for text in cell.texts], bool)


def _degrees(cell: CellColumn, thermometer: ThermometerTable | None) -> npt.NDArray[np.int16]:
    """Return (n,) counts of a thermometer."""
    if thermometer is None or thermometer.unit == "counts":
        return counts(cell).astype(np.int16)
    zero_degc, lsb_per_degc = thermometer.scale
    values = (numbers(cell) + ZERO_OF_UNIT[thermometer.unit] - zero_degc) * lsb_per_degc
    return counts(CellColumn(cell.source, cell.label, cell.lines, (), np.rint(values))).astype(np.int16)


class _Recording:
    """All streams of one import, and remarks on the whole."""

    def __init__(
        self, log: LogWriter, table_map: TableMap, headers: dict[str, SensorHeader], plans: Sequence[RowGroup]
    ) -> None:
        self._log, self._map, self._headers = log, table_map, headers
        rows = {row for phase in table_map.phase for row in phase.rows or ()}
        self.streams = [_Stream(log, plan, table_map, headers, rows) for plan in plans]
        self._counted_out: list[str] = []

    @property
    def seconds(self) -> float:
        """The time from the first row of all sensors to the last."""
        with_rows = [stream for stream in self.streams if stream.count]
        first, last = min(stream.first_ns for stream in with_rows), max(stream.last_ns for stream in with_rows)
        return (last - first) * 1e-9

    def finish(self, source: str, map_path: str, up: str) -> None:
        """Write clock, phases, and source; SourceError without rows, ConfigError for a phase beyond them."""
        for stream in self.streams:
            empty = next((name for name, count in stream.rows_of.items() if not count), None)
            if stream.count == 0 or empty is not None:
                of_kind = f" of kind {stream.plan.kind!r}" if stream.plan.kind else ""
                holding = "" if stream.count == 0 else f" with a reading of {empty}"
                raise SourceError(
                    f"{source}: no data rows{of_kind}{holding}; expected rows of numbers as {map_path} describes them"
                )
        first = self.streams[0]
        times = dict(first.time_of)
        sensor = next(iter(first.rows_of))
        if self._map.clock.stamps == "arrival":
            places = {row: first_at(self._log[sensor].time, time_ns) for row, time_ns in times.items()}
            for stream in self.streams:
                for name in stream.rows_of:
                    if ARRIVAL in self._headers[name].compensated:
                        self._counted_out += count_out(self._log, name)
            read = self._log[sensor].time
            times = {row: int(read[place]) for row, place in places.items()}
        for number, phase in enumerate(self._map.phase, start=1):
            if phase.rows is not None and phase.rows[1] not in times:
                problem = f"rows {phase.rows}, but {source} has data rows 0 to {first.count - 1}"
                raise ConfigError(f"{map_path}: phase {number} {phase.name!r}: {problem}")
            self._log.phase(_phase(phase, times, first.first_ns))
        if up:
            begin = min(stream.first_ns for stream in self.streams)
            end = max(stream.last_ns for stream in self.streams)
            self._log.phase(Phase(begin, end + 1, face_name(up), up))
        clock = self._map.clock
        zero = f"column {clock.column!r}" if clock.column is not None else "the first row"
        wall = (
            "the times are UTC"
            if clock.is_date and not has_no_day(clock.unit or "")
            else f"no wall time: the epoch stands for the zero of {zero}"
        )
        self._log.event(
            Event(first.first_ns, "", "imported", f"from {Path(source).name} by {Path(map_path).name}; {wall}")
        )
        for text in self._changes():
            self._log.event(Event(first.first_ns, "", "import", text))

    def _changes(self) -> list[str]:
        return [*(text for stream in self.streams for text in stream.remarks()), *self._counted_out]

    def remarks(self, learnt: dict[str, Resolution]) -> list[str]:
        names_by_remark: dict[str, list[str]] = {}
        of_codes = {sensor.name for sensor in self._map.sensor if not sensor.is_physical}
        for name, resolution in learnt.items():
            unit, bits = self._headers[name].unit, resolution.bits
            if name in of_codes and bits == 16:
                continue
            basis = "as the map says" if name in of_codes else "as the grid of its values says"
            if not resolution.is_exact:
                basis = f"assumed so that {bits} bits hold its values"
                basis += "; state both in the map if several files are of one array"
            width = f", stored without loss as counts of {bits} bits" if bits > 16 and resolution.is_exact else ""
            remark = (
                f"{resolution.sensitivity:.9g} counts per {unit}, range {resolution.range:g} {unit}, {basis}{width}"
            )
            names_by_remark.setdefault(remark, []).append(name)
        remarks = [f"{listed(names)}: {remark}" for remark, names in names_by_remark.items()]
        remarks += [
            f"{sensor.name}: 1 g is added along up in the attitude of {', '.join(map(str, sensor.attitude_columns))};"
            " its noise and delay are those of the program that computed both"
            for sensor in self._map.sensor
            if sensor.attitude_columns is not None
        ]
        return list(dict.fromkeys([*remarks, *self._changes()]))


def _phase(phase: PhaseTable, time_of: dict[int, int], first_ns: int) -> Phase:
    """Return the stretch with its first and last row; a log's phases end before `end_ns`."""
    if phase.rows is not None:
        first, last = phase.rows
        return Phase(time_of[first], time_of[last] + 1, phase.name, phase.box_up)
    begin_s, end_s = phase.seconds or (0.0, 0.0)
    return Phase(first_ns + round(begin_s * 1e9), first_ns + round(end_s * 1e9), phase.name, phase.box_up)
