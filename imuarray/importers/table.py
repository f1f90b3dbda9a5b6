"""Any table of numbers in a text file, by its map (`imuarray.importers.mapping`), streamed into a log."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from os import PathLike
from pathlib import Path

import numpy as np
import numpy.typing as npt

from imuarray.errors import ConfigError, SourceError
from imuarray.importers import NO_WALL_TIME, Summary, open_source, unpacked
from imuarray.importers.cells import INT16, ROWS, Block, Table, counts, nanoseconds
from imuarray.importers.mapping import NS_PER_UNIT, PhaseTable, SensorTable, TableMap, load_map
from imuarray.log import Block as LogBlock
from imuarray.log import LogWriter
from imuarray.log.format import SATURATED, Event, Phase, SensorHeader, ThermometerScale

Times = npt.NDArray[np.int64]


def import_table(
    source: str | PathLike[str],
    map_path: str | PathLike[str],
    output: str | PathLike[str],
    *,
    force: bool = False,
    progress: Callable[[int], None] = lambda done: None,
    block_rows: int = ROWS,
) -> Summary:
    """Write the table `source`, packed by gzip or not, as the map at `map_path` describes it, to the log `output`.

    Raises ConfigError for the map, SourceError for the table (file, line, column), OutputExistsError, LogError.
    """
    table_map = load_map(map_path)
    headers = [_header(sensor, table_map) for sensor in table_map.sensor]
    with (
        open_source(source, output) as file,
        LogWriter(output, headers, source="imported", epoch=NO_WALL_TIME, force=force) as log,
    ):
        named = any(isinstance(column, str) for column in table_map.columns())
        table = Table(unpacked(file), str(source), table_map.file, named)
        where = {column: table.index(column) for column in table_map.columns()}
        rows = _Rows(log, table_map, where)
        for block in table.blocks(block_rows):
            rows.add(block)
            progress(file.tell())
        rows.finish(str(source), str(map_path))
    return Summary(tuple(header.name for header in headers), rows.count, None, (rows.last_ns - rows.first_ns) * 1e-9)


def _header(sensor: SensorTable, table_map: TableMap) -> SensorHeader:
    x, y, z = sensor.position_mm
    thermometer = sensor.thermometer
    return SensorHeader(
        name=sensor.name,
        chip=sensor.chip,
        quantity=sensor.quantity,
        unit=sensor.unit,
        range=sensor.range,
        sensitivity=sensor.sensitivity,
        rate_hz=table_map.time.rate_hz or 0.0,
        axes=sensor.axes,
        position_mm=(x, y, z),
        has_temperature=sensor.temperature_column is not None,
        extra={} if thermometer is None else ThermometerScale(**thermometer.model_dump()).attributes,
    )


class _Rows:
    """The state of one import: rows and time so far, and the times of the rows that phases begin and end with."""

    def __init__(self, log: LogWriter, table_map: TableMap, where: dict[str | int, int]) -> None:
        self.log = log
        self.map = table_map
        self.where = where
        self.count = self.first_ns = self.last_ns = 0
        self.wanted = {row for phase in table_map.phase for row in phase.rows}
        self.time_of: dict[int, int] = {}

    def add(self, block: Block) -> None:
        """Write the rows of one block."""
        time = self._time(block)
        if self.count == 0:
            self.first_ns = int(time[0])
        for sensor in self.map.sensor:
            self.log.append(sensor.name, self._rows_of(sensor, block, time))
        inside = range(self.count, self.count + len(time))
        self.time_of |= {row: int(time[row - self.count]) for row in self.wanted if row in inside}
        self.count += len(time)
        self.last_ns = int(time[-1])

    def _time(self, block: Block) -> Times:
        """(n,) ns from the time column, or from the rate."""
        column, unit, rate_hz = self.map.time.column, self.map.time.unit, self.map.time.rate_hz
        if column is not None and unit is not None:
            cells = block.column(self.where[column], repr(column))
            return nanoseconds(cells, NS_PER_UNIT[unit], self.last_ns if self.count else None)
        period_ns = 1_000_000_000 / Fraction(rate_hz or 1.0).limit_denominator(1_000_000)
        rows = range(self.count, self.count + len(block.lines))
        return np.array([row * period_ns.numerator // period_ns.denominator for row in rows], np.int64)

    def _rows_of(self, sensor: SensorTable, block: Block, time: Times) -> LogBlock:
        """One sensor's part of a block."""
        sensitivity = sensor.sensitivity if sensor.values == "physical" else None
        axes = [counts(block.column(self.where[column], repr(column)), sensitivity) for column in sensor.columns]
        triads = np.stack(axes, axis=1)
        full = ((triads == INT16[0]) | (triads == INT16[1])).any(axis=1)
        degrees = None
        if sensor.temperature_column is not None:
            degrees = counts(block.column(self.where[sensor.temperature_column], repr(sensor.temperature_column)))
        return LogBlock(time, triads, np.where(full, SATURATED, 0).astype(np.uint16), degrees)

    def finish(self, source: str, map_path: str) -> None:
        """The phases, and where the log came from; SourceError without rows, ConfigError for a phase beyond them."""
        if self.count == 0:
            raise SourceError(f"{source}: no data rows; expected rows of numbers as {map_path} describes them")
        for number, phase in enumerate(self.map.phase, start=1):
            if phase.rows[1] not in self.time_of:
                problem = f"rows {phase.rows}, but {source} has data rows 0 to {self.count - 1}"
                raise ConfigError(f"{map_path}: phase {number} {phase.name!r}: {problem}")
            self.log.phase(_phase(phase, self.time_of))
        clock = f"column {self.map.time.column!r}" if self.map.time.column is not None else "the first row"
        note = (
            f"from {Path(source).name} by {Path(map_path).name}; no wall time: the epoch stands for the zero of {clock}"
        )
        self.log.event(Event(self.first_ns, "", "imported", note))


def _phase(phase: PhaseTable, time_of: dict[int, int]) -> Phase:
    """The stretch that holds both its first and its last row; a log's phases end before `end_ns`."""
    first, last = phase.rows
    return Phase(time_of[first], time_of[last] + 1, phase.name, phase.up)
