"""CSV: one file for each table, a row of names and rows of numbers, for spreadsheets and `pandas.read_csv`.

::

    time_s,counts_x,counts_y,counts_z,status        run_Acc.csv: seconds, exact to the nanosecond; units end the names
    {"imuarray_csv": 2, "epoch": "2013-...", ...}   run.json: everything else that is known

A single table (a fused result, one selected sensor) is the file itself. For several tables there is a file for each,
run_Acc.csv, run_events.csv, ..., and run.csv, written last, lists the files and their tables.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.atomic import whole_file
from imuarray.export.content import head_with, open_content
from imuarray.export.formats import (
    CSV_EVENTS,
    CSV_INDEX,
    CSV_PHASES,
    CSV_VERSION,
    ExportRequest,
    ExportSummary,
    Progress,
    csv_names,
)
from imuarray.export.tables import Content, ExportTable, Meter, TableColumn, number_names
from imuarray.printable import encodable


def write(request: ExportRequest, path: Path, force: bool, progress: Progress) -> ExportSummary:
    """Write a single table to `path`, or a file for each table next to it and their list to `path`."""
    with open_content(request) as content:
        meter = Meter(content, progress)
        described = path.with_suffix(".json")
        if len(content.tables) == 1 and (request.sensors or content.head["format"] != "imuarray-log"):
            (table,) = content.tables
            with whole_file(path, force=force) as draft, whole_file(described, force=force) as json_file:
                _write_head(json_file, content, table=table.name)
                _write_table(draft, table, meter)
            return content.exported(path, described)
        return content.exported(*_write_set(path, content, force, meter), described, path)


def _write_set(path: Path, content: Content, force: bool, meter: Meter) -> list[Path]:
    """Write a file for each table, for phases and for events, and their list; return the files."""
    phases = [(seconds(phase.start_ns), seconds(phase.end_ns), phase.name, phase.up) for phase in content.phases]
    events = [(seconds(event.time_ns), event.sensor, event.kind, event.message) for event in content.events]
    with file_set(path, content, path.with_suffix(".json"), force=force) as (index, (listed, described, *drafts)):
        for table, draft in zip(content.tables, drafts, strict=False):
            _write_table(draft, table, meter)
        _write_texts(drafts[-2], CSV_PHASES, phases)
        _write_texts(drafts[-1], CSV_EVENTS, events)
        _write_head(described, content, files={name: table for name, table, _ in index})
        with listed.open("w", encoding="utf-8", newline="") as text:
            csv.writer(text, lineterminator="\n").writerows([CSV_INDEX, *index])
    return [path.with_name(name) for name in file_names(path, content)]


@contextmanager
def file_set(
    path: Path, content: Content, *further: Path, force: bool
) -> Iterator[tuple[list[tuple[str, str, int]], list[Path]]]:
    """Open the files of a log: yield the rows of the list of files (file, table, number of rows), and a draft of the
    list at `path`, of the `further` files, and of the file of each table, of phases and of events. If one of them
    fails, none is written.
    """
    names = file_names(path, content)
    tables = [*((table.name, table.rows) for table in content.tables)]
    tables += [("phases", len(content.phases)), ("events", len(content.events))]
    index = [(encodable(name), table, rows) for name, (table, rows) in zip(names, tables, strict=True)]
    with ExitStack() as stack:  # files get their names at its end; the list was entered first and gets its name last
        targets = (path, *further, *map(path.with_name, names))
        yield index, [stack.enter_context(whole_file(file, force=force)) for file in targets]


def file_names(path: Path, content: Content) -> list[str]:
    """Return the names of the files of tables, phases and events: run_Acc.csv and so on. Equal names, and those that
    differ only in case, which some file systems do not distinguish, get a number.
    """
    sensors_by_name: dict[str, str] = {}
    for name in (*(table.short for table in content.tables), "phases", "events"):
        free = next(stem for stem in number_names(f"{path.stem}_{name}") if stem.lower() not in sensors_by_name)
        sensors_by_name[free.lower()] = f"{free}{path.suffix}"
    return list(sensors_by_name.values())


def _write_head(path: Path, content: Content, **more: Any) -> None:
    """Write everything except the columns as JSON, a line for each entry; the first states the format."""
    units = {table.name: dict(_columns(table)) for table in content.tables}
    head = {CSV_VERSION: 2, **head_with(content, **more, column_units=units)}
    entries = (f"{json.dumps(name)}: {json.dumps(value)}" for name, value in head.items())
    path.write_text("{" + ",\n ".join(entries) + "}\n", encoding="utf-8")


def _columns(table: ExportTable) -> Iterator[tuple[str, str]]:
    for column in table.columns:
        unit = "s" if column.name == "time" else column.unit
        yield from ((name, unit) for name in csv_names(column.name, column.cells, column.unit))


def _write_table(path: Path, table: ExportTable, meter: Meter) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow([name for name, _ in _columns(table)])
        for rows in table.blocks():
            cells = [texts for column in table.columns for texts in _texts(column, rows)]
            file.writelines(f"{line}\n" for line in map(",".join, zip(*cells, strict=True)))
            meter.add(rows.stop - rows.start, len(table.columns))


def _write_texts(path: Path, names: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n", quoting=csv.QUOTE_ALL).writerows([names, *rows])


def _texts(column: TableColumn, rows: slice) -> Iterator[list[str]]:
    """Yield the cells of a column as text from which exactly the same numbers can be read."""
    values: npt.NDArray[Any] = column.read(rows)
    if column.name == "time":
        yield [seconds(time_ns) for time_ns in values.tolist()]
    else:
        form = repr if np.dtype(column.kind).kind == "f" else str
        for cells in values.reshape(len(values), -1).T:
            yield list(map(form, cells.tolist()))


def seconds(time_ns: int) -> str:
    """Return the exact text of nanoseconds in seconds."""
    whole, rest = divmod(abs(time_ns), 1_000_000_000)
    return f"{'-' if time_ns < 0 else ''}{whole}.{rest:09d}"
