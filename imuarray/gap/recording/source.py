"""Rows of one sensor, from a log or from a simulation in memory, in blocks of the same form.

Recorded and simulated rows can go through the same statistics only if both have the same form: times, counts and flags
without resampling, and never a whole log at once.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Hashable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Times
from imuarray.gap.recording.shared_stamps import RowSelection
from imuarray.log import SensorLog
from imuarray.log.format import OVERRUN, STALE, SensorHeader
from imuarray.log.row_timing import EvenRows
from imuarray.log.sensor_log import first_at, recorded_header
from imuarray.log.writer import Block
from imuarray.simulate.sensor import NO_READY_BIT, Demand, SimulatedSensor
from imuarray.simulate.simulation import EVERY_FLAG, Simulation
from imuarray.simulate.streams import CHUNK
from imuarray.simulate.timeline import GapFilledTimes, Timeline


class Source(Protocol):
    """The rows of one triad."""

    @property
    def header(self) -> SensorHeader:
        """The description of the sensor: nominal sensitivity, range, axes."""

    @property
    def cache(self) -> dict[Hashable, Any]:
        """Results already computed from its rows, by their keys; they are kept as long as the source exists."""

    def rows(self, start_ns: int, end_ns: int) -> int:
        """Return the number of rows that were due in [start_ns, end_ns); a simulation counts dropped ones too."""

    def blocks(self, start_ns: int, end_ns: int) -> Iterator[Block]:
        """Return the rows with times in [start_ns, end_ns), in order, in blocks of 1 to `CHUNK` rows."""


DOUBTFUL = 0x8000
"""Status of a new reading that the recorder flags as not new. Sources set it; no file contains it."""


class RecordedSource:
    """A sensor of an open log.

    A row that is flagged as not new but differs from the row before is new: the chip measured it after its flag was
    read and before its data were read. The flag is replaced by `DOUBTFUL`.
    """

    def __init__(self, sensor: SensorLog) -> None:
        self.header = _header_in(sensor)
        self.cache: dict[Hashable, Any] = {}
        self._flags = np.uint16(flags_of_chip(sensor.chip))
        self._columns = (sensor.time, sensor.counts, sensor.status, sensor.temperature_counts)
        self._row_at = lru_cache(maxsize=64)(partial(first_at, sensor.time))
        self._kind = np.int16 if sensor.count_bits <= 16 else np.int32

    def rows(self, start_ns: int, end_ns: int) -> int:
        """Return the number of rows of the log in [start_ns, end_ns)."""
        return self._row_at(end_ns) - self._row_at(start_ns)

    def blocks(self, start_ns: int, end_ns: int) -> Iterator[Block]:
        """Slices of the log, which end where its chunks end."""
        return self.slices(self._row_at(start_ns), self._row_at(end_ns))

    def slices(self, begin: int, end: int) -> Iterator[Block]:
        """Yield rows begin ... end - 1, in the same slices."""
        time, counts, status, temperature = self._columns
        for first, stop in _parts(begin, end):
            rows = np.asarray(counts[max(first - 1, 0) : stop], self._kind)
            is_new = (rows[1:] != rows[:-1]).any(axis=1)
            if first == 0:
                is_new = np.append(True, is_new)
            flags = np.asarray(status[first:stop], np.uint16) & self._flags
            yield Block(
                np.asarray(time[first:stop], np.int64),
                rows[-(stop - first) :],
                _without_doubtful(flags, is_new),
                None if temperature is None else np.asarray(temperature[first:stop], np.int16),
            )


class EvenSource:
    """A sensor of an open log with rows that arrived in bursts; they get the times at which they were read."""

    def __init__(self, sensor: SensorLog, line: EvenRows | RowSelection) -> None:
        self.header = _header_in(sensor)
        self.cache: dict[Hashable, Any] = {}
        self._source = RecordedSource(sensor)
        self._line = line

    def rows(self, start_ns: int, end_ns: int) -> int:
        """Return the number of rows that were read in [start_ns, end_ns)."""
        return self._row_at(end_ns) - self._row_at(start_ns)

    def blocks(self, start_ns: int, end_ns: int) -> Iterator[Block]:
        """Slices of the log, which end where its chunks end."""
        first = self._row_at(start_ns)
        for block in self._source.slices(first, self._row_at(end_ns)):
            stop = first + len(block.time)
            yield block._replace(time=self._line.stamps(first, stop))
            first = stop

    def _row_at(self, at_ns: int) -> int:
        """Return the first row stamped `at_ns` or later."""
        return bisect_left(range(self._line.rows), at_ns, key=lambda row: int(self._line.stamps(row, row + 1)[0]))


class SimulatedSource:
    """A simulated triad whose rows are computed on demand."""

    def __init__(self, sensor: SimulatedSensor, flags: int = EVERY_FLAG, demand: Demand = Demand.ANY) -> None:
        """Create the source; `flags` are those that the recorder sets."""
        self.header, self._demand = sensor.header, demand
        self._flags = flags & flags_of_chip(sensor.header.chip)
        self.cache: dict[Hashable, Any] = {}
        self._sensor = sensor
        self._row_at = lru_cache(maxsize=64)(self._find_row)

    def rows(self, start_ns: int, end_ns: int) -> int:
        """Return the number of rows that are read in [start_ns, end_ns), lost ones included."""
        return self._row_at(end_ns) - self._row_at(start_ns)

    def blocks(self, start_ns: int, end_ns: int) -> Iterator[Block]:
        """Yield the simulator's own chunks, so that none is computed twice. Flags are as in a log, except that the
        first row is not compared with the row before it.
        """
        last = None
        for first, stop in _parts(self._row_at(start_ns), self._row_at(end_ns)):
            block = self._sensor.block(first, stop, self._demand)
            if not len(block.time):
                continue
            flags = block.status & np.uint16(self._flags)
            if (flags & STALE).any():
                before = block.counts[:1] if last is None else last
                is_new = (np.diff(block.counts, axis=0, prepend=before) != 0).any(axis=1)
                flags = _without_doubtful(flags, is_new)
            last = block.counts[-1:]
            yield block._replace(status=flags)

    def _find_row(self, at_ns: int) -> int:
        """Return the first row stamped `at_ns` or later."""
        stamps = self._sensor.timeline.stamps
        return bisect_left(range(self._sensor.rows), at_ns, key=lambda row: int(stamps(row, row + 1)[0]))


class RowFilter:
    """A source without its rows at the ascending times `uncertain_ns` (u,), which were read at an unknown moment."""

    def __init__(self, source: Source, uncertain_ns: Times) -> None:
        self.header = source.header
        self.cache: dict[Hashable, Any] = {}
        self._source, self._uncertain_ns = source, uncertain_ns

    def rows(self, start_ns: int, end_ns: int) -> int:
        """Return the number of rows that were due, uncertain ones included."""
        return self._source.rows(start_ns, end_ns)

    def blocks(self, start_ns: int, end_ns: int) -> Iterator[Block]:
        """Yield the blocks of the source without the uncertain rows."""
        for block in self._source.blocks(start_ns, end_ns):
            first, last = np.searchsorted(self._uncertain_ns, block.time[[0, -1]] + (0, 1)).tolist()
            if first == last:
                yield block
                continue
            near_ns = self._uncertain_ns[first:last]
            is_certain = near_ns.take(np.searchsorted(near_ns, block.time), mode="clip") != block.time
            if is_certain.any():
                temperature = None if block.temperature_counts is None else block.temperature_counts[is_certain]
                yield Block(block.time[is_certain], block.counts[is_certain], block.status[is_certain], temperature)


def _without_doubtful(flags: npt.NDArray[np.uint16], is_new: Booleans) -> npt.NDArray[np.uint16]:
    """Return the flags (n,) of rows, with `DOUBTFUL` instead of `STALE` in rows that differ from the row before.

    Such a row was measured between the reading of the chip's ready bit and that of its data. Therefore no reading was
    lost next to it, and `OVERRUN` is removed from it and from both adjacent rows.
    """
    is_doubtful = is_new & ((flags & STALE) != 0)
    is_adjacent = is_doubtful.copy()
    is_adjacent[1:] |= is_doubtful[:-1]
    is_adjacent[:-1] |= is_doubtful[1:]
    flags = np.where(is_doubtful, flags & ~np.uint16(STALE) | np.uint16(DOUBTFUL), flags)
    return np.where(is_adjacent, flags & ~np.uint16(OVERRUN), flags)


def flags_of_chip(chip: str) -> int:
    """Return the flags that are meaningful for a chip.

    A recorder cannot determine whether a reading of a chip without a ready bit is new: some recorders flag a row that
    equals the row before, others flag no row. Repeated rows are counted without the flag.
    """
    return EVERY_FLAG & ~STALE if chip in NO_READY_BIT else EVERY_FLAG


def recorded_source(sensor: SensorLog, line: Timeline) -> RecordedSource | EvenSource:
    """Return the rows of a sensor of an open log, at the times of its timeline."""
    reading = line.recorded if isinstance(line, GapFilledTimes) else line
    if isinstance(reading, EvenRows) or (isinstance(reading, RowSelection) and isinstance(reading.whole, EvenRows)):
        return EvenSource(sensor, reading)
    return RecordedSource(sensor)


def simulated_sources(simulation: Simulation, demand: Demand = Demand.ANY) -> dict[str, Source]:
    """Return the triads of a simulation by name; `demand` states which rows will be required."""
    triads = ((name, sensor) for name, sensor in simulation.sensors.items() if isinstance(sensor, SimulatedSensor))
    return {name: SimulatedSource(sensor, simulation.plan.flags, demand) for name, sensor in triads}


def _parts(first: int, stop: int) -> Iterator[tuple[int, int]]:
    """Yield (begin, end) that cover first ... stop - 1 and end at multiples of `CHUNK`."""
    while first < stop:
        end = min((first // CHUNK + 1) * CHUNK, stop)
        yield first, end
        first = end


def _header_in(sensor: SensorLog) -> SensorHeader:
    """Return the header of a triad in a log, with 1 count per unit if its sensitivity is unknown. Raises ValueError for
    a sensor that is not a triad.
    """
    if not sensor.is_triad:
        raise ValueError(f"{sensor.where}: {sensor.quantity} has no three axes")
    header = recorded_header(sensor)
    return replace(header, sensitivity=header.sensitivity or 1.0, delay_ns=sensor.delay_ns or None)
