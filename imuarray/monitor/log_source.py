"""The sources of a monitor: a log that is being written, read through its journal (`Growing`), and any other (`Whole`).

The reader of a growing log continues from its last position, so that the cost of a refresh depends only on the new
rows. Rows from before the monitor began are read from the HDF5 file up to its last commits. `Backlog` counts delayed
and missed rows among them a piece at a time, so that no refresh of a long log takes longer.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from imuarray.errors import LogError
from imuarray.log import Log, SensorLog, open_log
from imuarray.log.commits import COMMITS, Commit, read_commits
from imuarray.log.format import Preamble
from imuarray.log.hdf5_writer import sensor_attributes
from imuarray.log.inspection import UnclosedFile, is_marked_open, refuse_hostile
from imuarray.log.interrupted import SENSORS, stored_preamble
from imuarray.log.journal import NOTES, ColumnGroup, JournalReader, is_running, journal_of
from imuarray.log.untrusted_input import DAMAGE
from imuarray.monitor.snapshot import FINISHED, INTERRUPTED, WRITTEN, EventCounts
from imuarray.monitor.window import STRIDE, Attributes, Gaps, LatestRows, gaps_of
from imuarray.units import INERTIAL

AT_ONCE = 1 << 19
"""Largest number of rows that one refresh counts."""


class Backlog:
    """The rows from before the monitor began, as (time column, number of rows) by sensor, which are counted in steps.
    `close` is called when all are counted.
    """

    def __init__(self, columns: Mapping[str, tuple[Any, int]], close: Callable[[], None] = lambda: None) -> None:
        self._columns = dict(columns)
        self._total = sum(rows for _, rows in columns.values())
        self._done = dict.fromkeys(columns, 0)
        self._gaps = dict.fromkeys(columns, Gaps())
        self._close: Callable[[], None] | None = close

    @property
    def counted(self) -> float:
        """The share of the rows that are counted."""
        return sum(self._done.values()) / self._total if self._total else 1.0

    def gaps(self, name: str) -> Gaps:
        """Return the gaps of a sensor that are counted so far."""
        return self._gaps.get(name, Gaps())

    def step(self, periods_ns: Mapping[str, float]) -> None:
        """Count some more rows; rows that can't be read and sensors whose period is unknown are skipped."""
        budget = AT_ONCE
        for name, (column, rows) in self._columns.items():
            start = self._done[name]
            stop = min(rows, start + budget)
            if stop > start:
                self._gaps[name] += _count_gaps(column, start, stop, periods_ns.get(name, 0.0))
                self._done[name] = stop
                budget -= stop - start
        if self.counted == 1.0:
            self.close()

    def close(self) -> None:
        """Release the columns."""
        if self._close is not None:
            self._close()
        self._columns, self._close = {}, None


def _count_gaps(column: Any, start: int, stop: int, period_ns: float) -> Gaps:
    """Return the gaps that begin in rows `start` to `stop`."""
    try:
        return gaps_of(np.asarray(column[start : min(stop + STRIDE, len(column))]), period_ns)
    except (LogError, *DAMAGE):
        return Gaps()


@dataclass
class ReadRows:
    """The rows of the last `span_ns` by sensor, and the events so far."""

    span_ns: int
    windows: dict[str, LatestRows] = field(default_factory=dict)
    events: EventCounts = field(default_factory=EventCounts)

    def expect(self, names: Iterable[str]) -> None:
        """Prepare windows for these sensors; existing windows are kept if the sensors are the same."""
        names = list(names)
        if list(self.windows) != names:
            self.windows = {name: LatestRows(self.span_ns) for name in names}


def identity(path: Path) -> tuple[int, int] | None:
    """Identify the file that has this name now; None if there is none."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_dev, stat.st_ino


def look(path: Path) -> tuple[object, ...]:
    """Identify the files of a log and its journal, to detect whether they change."""
    unclosed = False
    with contextlib.suppress(OSError):
        unclosed = is_marked_open(path)
    return identity(path), identity(journal_of(path)), unclosed


class Whole:
    """A log that is not being written: finished, or interrupted. LogError."""

    def __init__(self, path: Path, read_rows: ReadRows) -> None:
        self.path, self.read_rows = path, read_rows
        log = open_log(path)
        try:
            self.state = FINISHED if log.state == "finished" else INTERRUPTED
            self.source, self.epoch, self.frame_rate_hz = log.source, log.epoch, log.frame_rate_hz
            self.attributes: dict[str, Attributes] = {
                name: dict(sensor.attributes) for name, sensor in log.sensors.items()
            }
            self.row_bytes: dict[str, int] = {}
            self.backlog = Backlog({}, lambda: None)
            read_rows.expect(log.sensors)
            read_rows.events.take_events(sorted(log.events, key=lambda event: event.time_ns))
        except BaseException:
            log.close()
            raise
        self._log: Log | None = log

    def read(self) -> int:
        """Read the last rows at the first call; return the number of new rows."""
        if self._log is None:
            return 0
        log, self._log = self._log, None
        ends = [int(sensor.time[-1]) for sensor in log.sensors.values() if len(sensor)]
        start_ns = max(ends, default=0) - self.read_rows.span_ns
        columns: dict[str, tuple[Any, int]] = {}
        for name, sensor in log.sensors.items():
            if not len(sensor):
                continue
            first = sensor.between(start_ns, start_ns).start
            self.read_rows.windows[name].begins_behind(first, sensor.time)
            self.read_rows.windows[name].add(_rows_of(sensor, first))
            if sensor.quantity in INERTIAL:
                columns[name] = (sensor.time, first)
        self.backlog = Backlog(columns, log.close)
        return sum(len(sensor) for sensor in log.sensors.values())

    def close(self) -> None:
        """Close the file."""
        self.backlog.close()
        if self._log is not None:
            self._log.close()


def _rows_of(sensor: SensorLog, first: int) -> dict[str, Any]:
    """Return the columns of a sensor from the row `first`."""
    columns = {"time": sensor.time, "counts": sensor.counts, "status": sensor.status}
    if sensor.temperature_counts is not None:
        columns["temperature_counts"] = sensor.temperature_counts
    for name in ("temperature", "pressure") if sensor.quantity == "pressure" else ():
        try:
            columns[name] = sensor.compensated(name)
        except LogError:  # an imported log may lack it
            continue
    return {name: np.asarray(column[first:]) for name, column in columns.items()}


_MOST_BYTES = 1 << 25
"""Largest number of bytes of the journal that one refresh reads; after a long pause, several refreshes catch up."""


class Growing:
    """A log that is being written. LogError, OSError if it can't be read (yet)."""

    def __init__(self, path: Path, read_rows: ReadRows) -> None:
        """Begin early enough that the first `read` covers at least the last `read_rows.span_ns`."""
        self.path, self.state, self.read_rows = path, WRITTEN, read_rows
        self._journal_file = identity(journal_of(path))
        self._reader = JournalReader(path)
        try:
            self._begin()
        except BaseException:
            self._reader.close()
            raise

    def _begin(self) -> None:
        read_rows, preamble = self.read_rows, self._reader.preamble
        read_rows.expect(header.name for header in preamble.sensors)
        self.source, self.epoch, self.frame_rate_hz = preamble.source, preamble.epoch, preamble.frame_rate_hz
        groups = self._reader.groups
        self.row_bytes = {group.path: group.row_bytes for group in groups}
        file = _open_file(self.path, preamble)
        try:
            self.attributes: dict[str, Attributes] = {
                header.name: sensor_attributes(header) for header in preamble.sensors
            }
            commits = read_commits(file[COMMITS][:], preamble.identity, groups)
            commit = _last_commit(file, groups, commits, read_rows.span_ns)
            rows = commit.rows if commit else (0,) * len(groups)
            self._mark = commit.mark if commit else self._reader.start
            columns = {}
            for group, count in zip(groups, rows, strict=True):
                name = group.path.removeprefix(SENSORS)
                if group.path == NOTES:
                    read_rows.events.take_stored(file[NOTES]["text"], count)
                elif name in read_rows.windows and count:
                    read_rows.windows[name].begins_behind(count, file[group.path]["time"])
                    if self.attributes[name].get("quantity") in INERTIAL:
                        columns[name] = (file[group.path]["time"], count)
            self.backlog = Backlog(columns, file.close)
        except BaseException as error:
            file.close()
            if isinstance(error, DAMAGE):
                raise LogError(f"{self.path}: damaged or malformed") from None
            raise

    def read(self) -> int:
        """Read the new rows of the journal; if there are none, determine whether it is still being written."""
        count = self._drain()
        if not count and not (self._is_same_journal() and is_running(self.path)):
            count = self._drain()  # rows that were written meanwhile
            if not count:
                self.state = INTERRUPTED if self._is_same_journal() else FINISHED
        return count

    def _drain(self) -> int:
        rows, limit = 0, self._mark.position + _MOST_BYTES
        for record in self._reader.records(self._mark):
            self._mark = record.after
            group = self._reader.groups[record.group]
            if group.path == NOTES:
                self.read_rows.events.take(group.decode(record.payload, record.rows)["text"])
            elif group.path.startswith(SENSORS):
                window = self.read_rows.windows[group.path.removeprefix(SENSORS)]
                rows += window.add(group.decode(record.payload, record.rows))
            if record.after.position > limit:
                break
        return rows

    def _is_same_journal(self) -> bool:
        """Return whether the journal with that name is the one that is being read."""
        return identity(journal_of(self.path)) == self._journal_file

    def close(self) -> None:
        """Close the files."""
        self.backlog.close()
        self._reader.close()


LogSource = Whole | Growing
"""A log whose rows are read into `read_rows`; `attributes` of its sensors, `state` at the last refresh."""


def _open_file(path: Path, preamble: Preamble) -> h5py.File:
    """Open the HDF5 file of the log with this preamble; LogError."""
    try:
        file = h5py.File(UnclosedFile(path, check_heaps=False), "r")
    except DAMAGE:
        raise LogError(f"{path}: does not exist yet, or is damaged") from None
    try:
        with h5py.File(UnclosedFile(path), "r") as inspected:
            refuse_hostile(file, inspected, str(path))
        known = stored_preamble(path)
        if known is not None and known.identity != preamble.identity:
            raise LogError(f"{path}: its journal belongs to another log")
        return file
    except BaseException as error:
        file.close()
        if isinstance(error, DAMAGE):
            raise LogError(f"{path}: is not a log that is being written") from None
        raise


def _last_commit(file: h5py.File, groups: Sequence[ColumnGroup], commits: list[Commit], span_ns: int) -> Commit | None:
    """Return the last commit after which there are at least `span_ns` of rows; None if the whole journal is needed."""
    sensors = [(number, group.path) for number, group in enumerate(groups) if group.path.startswith(SENSORS)]

    def newest_ns(commit: Commit) -> int:
        times = (file[path]["time"][commit.rows[number] - 1] for number, path in sensors if commit.rows[number])
        return max((int(time) for time in times), default=0)

    if not commits:
        return None
    end_ns = newest_ns(commits[-1])
    return next((commit for commit in reversed(commits[:-1]) if end_ns - newest_ns(commit) >= span_ns), None)
