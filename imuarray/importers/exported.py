"""Read back the raw counts of a log that `imuarray export` wrote: the result is the same log.

The first bytes of a file determine its format (`importer_of`). Its content is validated before use: the header like
that of any log, and the tables against the header. This module is common to all formats.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from os import PathLike
from types import MappingProxyType
from typing import Any

import numpy as np

from imuarray.axes import orientation_of
from imuarray.errors import LogError, SourceError
from imuarray.importers import ImportSummary
from imuarray.log import Block, LogWriter, Stimulus
from imuarray.log.format import (
    COMPENSATED_UNITS,
    FORMAT,
    FORMAT_VERSION,
    SOURCES,
    STIMULI,
    TRACK_COLUMNS,
    TRACK_UNITS,
    ClockRow,
    Event,
    Phase,
    Preamble,
    SensorHeader,
)
from imuarray.log.journal import ColumnGroup, Columns, sensor_group
from imuarray.log.untrusted_input import check_note
from imuarray.printable import printable

COLUMN_UNITS: Mapping[str, str] = MappingProxyType({**COMPENSATED_UNITS, **TRACK_UNITS})
"""Units in the names of an exported table's columns, by column of the log."""

MAX_HEADER_BYTES = 1 << 26
"""Maximum size of a JSON header with phases and events."""

_FIELDS = tuple(field.name for field in fields(SensorHeader))
_NOT_READABLE = (ValueError, TypeError, AttributeError, KeyError, RecursionError)

Read = Callable[[ColumnGroup, tuple[str, ...]], Iterator[Columns]]
"""Reads the rows of a group in blocks; the names are those of the cells of tables with several columns."""


@dataclass(frozen=True)
class Head:
    """The validated header of an export: the log's preamble, and the groups other than sensors."""

    preamble: Preamble
    groups: Mapping[str, tuple[str, ...]]
    """The columns of the groups other than sensors; a reference may lack some."""


def parse_header(text: str | bytes, where: str) -> dict[str, Any]:
    """Parse a JSON object; SourceError."""
    try:
        head = json.loads(text)
    except _NOT_READABLE:
        head = None
    if not isinstance(head, dict):
        raise SourceError(f"{where}: no header written by `imuarray export`")
    return head


def check_head(head: Mapping[str, Any], where: str) -> Head:
    """Validate the header of a log's raw counts; SourceError."""
    if head.get("format") != FORMAT or head.get("format_version") != FORMAT_VERSION:
        raise SourceError(f"{where}: not the export of a log of format {FORMAT_VERSION}; only logs can be read back")
    if head.get("units") != "counts":
        raise SourceError(f"{where}: has physical values; only raw counts make a log: export with --units counts")
    if head.get("source") not in SOURCES:
        raise SourceError(f"{where}: source is {str(head.get('source'))[:40]!r}; allowed are {', '.join(SOURCES)}")
    try:
        tables = {str(name): dict(table) for name, table in head["tables"].items()}
        sensors = [table for name, table in tables.items() if name not in TRACK_COLUMNS]
        preamble_fields = {name: head[name] for name in ("source", "epoch", "config", "software")}
        preamble_fields["frame_rate_hz"] = head.get("frame_rate_hz", 0.0)  # missing in earlier exports
        listed = [{name: table[name] for name in _FIELDS} for table in sensors]
        preamble = Preamble.from_json(json.dumps({**preamble_fields, "sensors": listed}))
        expected_tables = {f"sensors/{header.name}" for header in preamble.sensors} | set(tables).intersection(
            TRACK_COLUMNS
        )
        if set(tables) != expected_tables or not preamble.sensors:
            raise ValueError("tables and sensors have different names")
        for header, table in zip(preamble.sensors, sensors, strict=True):
            if not np.allclose(np.array(table["orientation"], float), orientation_of(header.axes), atol=1e-9):
                raise ValueError(f"sensor {header.name}: its orientation is not a multiple of quarter turns")
    except LogError as error:
        raise SourceError(f"{where}: {error}") from None
    except _NOT_READABLE as error:
        raise SourceError(f"{where}: its header is unreadable: {printable(str(error))[:200]}") from None
    groups = {name: _columns_of(name, tables[name].get("columns"), where) for name in TRACK_COLUMNS if name in tables}
    return Head(preamble, groups)


def _columns_of(name: str, listed: Any, where: str) -> tuple[str, ...]:
    """Return the columns of a group other than a sensor: those in the list, or all without a list; SourceError."""
    all_columns = tuple(column for column, _, _ in TRACK_COLUMNS[name])
    if listed is None:
        return all_columns
    if not isinstance(listed, list) or "time" not in listed or (name not in STIMULI and len(listed) < len(all_columns)):
        raise SourceError(f"{where}: its header is unreadable: columns of {name}")
    if unknown := [column for column in listed if column not in all_columns]:
        raise SourceError(f"{where}: {name} has no column {printable(str(unknown[0]))[:40]!r}")
    return tuple(column for column in all_columns if column in listed)


def read_notes(phases: Any, events: Any, where: str) -> tuple[list[Phase], list[Event]]:
    """Return phases and events from lists of their fields; SourceError."""
    try:
        for row in phases:
            check_note(row, 2)
        for row in events:
            check_note(row, 1)
        notes = [Phase(*row) for row in phases], [Event(*row) for row in events]
        if any("\0" in text for row in (*notes[0], *notes[1]) for text in row if isinstance(text, str)):
            raise ValueError("a text with a NUL")
    except _NOT_READABLE as error:
        raise SourceError(f"{where}: phases or events are unreadable: {error}") from None
    return notes


def write_log(
    head: Head,
    read: Read,
    notes: tuple[list[Phase], list[Event]],
    output: str | PathLike[str],
    where: str,
    *,
    force: bool,
) -> ImportSummary:
    """Write the log `output` table by table as `read` returns them; SourceError, OutputExistsError, LogError."""
    preamble, (phases, events) = head.preamble, notes
    rows: dict[str, int] = {}
    ends_ns: list[int] = []
    try:
        with LogWriter(
            output,
            preamble.sensors,
            source=preamble.source,
            epoch=preamble.epoch,
            config=preamble.config,
            frame_rate_hz=preamble.frame_rate_hz,
            force=force,
        ) as log:
            for header in preamble.sensors:
                rows[header.name] = 0
                for columns in read(sensor_group(header), header.columns):
                    log.append(header.name, _block(columns, header))
                    rows[header.name] += len(columns["time"])
                    ends_ns += columns["time"][[0, -1]].tolist() if len(columns["time"]) else []
            for name in head.groups:
                columns_of_group = tuple(column for column in TRACK_COLUMNS[name] if column[0] in head.groups[name])
                for columns in read(ColumnGroup(name, columns_of_group), ("x", "y", "z")):
                    _append_beside(log, name, columns)
            for phase in phases:
                log.phase(phase)
            for event in events:
                log.event(event)
    except (ValueError, OverflowError) as error:
        raise SourceError(f"{where}: {error}") from None
    kinds = Counter(event.kind for event in events)
    same = len(set(rows.values())) == 1
    seconds = (max(ends_ns, default=0) - min(ends_ns, default=0)) * 1e-9
    return ImportSummary(tuple(rows), max(rows.values()), None, seconds, dict(kinds), same_rows=same)


def _block(columns: Columns, header: SensorHeader) -> Block:
    compensated = {name: columns[name] for name in header.compensated}
    degrees = columns["temperature_counts"] if header.has_temperature else None
    return Block(columns["time"], columns["counts"], columns["status"], degrees, compensated)


def _append_beside(log: LogWriter, name: str, columns: Columns) -> None:
    if name in STIMULI:
        missing = {
            column: np.full((len(columns["time"]), *tail), np.nan)
            for column, _, tail in TRACK_COLUMNS[name]
            if column not in columns
        }
        log.stimulus(name, Stimulus(**columns, **missing))
        return
    for row in zip(*(columns[column].tolist() for column, _, _ in TRACK_COLUMNS[name]), strict=True):
        log.clocks(ClockRow(*row))
