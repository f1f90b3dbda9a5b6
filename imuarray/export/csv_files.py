"""CSV: one table a file, two comment lines, a row of names, numbers.

::

    # imuarray-csv 1: sensors/Acc of run.h5, units counts; time_s since 2013-09-16T08:30:00.000000Z
    # {"format": "imuarray-log", ...}                   everything else that is known, one line of JSON
    time_s,counts_x,counts_y,counts_z,status            seconds, exact to the nanosecond; units end the names

One table (a fused result, one chosen sensor) is the file itself. A log of several is a file for each beside it,
run_Acc.csv, run_events.csv, ..., and run.csv, written last, says which file holds what.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from imuarray.atomic import whole_file
from imuarray.export.content import head_with, open_content
from imuarray.export.formats import (
    CSV_EVENTS,
    CSV_INDEX,
    CSV_MAGIC,
    CSV_PHASES,
    ExportRequest,
    ExportSummary,
    Progress,
    csv_names,
)
from imuarray.export.tables import Column, Content, Meter, Table, numbered
from imuarray.printable import printable


def write(request: ExportRequest, path: Path, force: bool, progress: Progress) -> ExportSummary:
    """Write one table to `path`, or a file for each table beside it and what they hold to `path`."""
    with open_content(request) as content:
        meter = Meter(content, progress)
        if len(content.tables) == 1 and (request.sensors or content.head["format"] != "imuarray-log"):
            (table,) = content.tables
            with whole_file(path, force=force) as draft:
                _write_table(draft, content, table, head_with(content, table=table.name), meter)
            return content.exported(path)
        return content.exported(*_write_set(path, content, force, meter), path)


def _write_set(path: Path, content: Content, force: bool, meter: Meter) -> list[Path]:
    """A file for each table, for phases and for events, and their list: all of them or, if one can't be, none."""
    names = [*(table.short for table in content.tables), "phases", "events"]
    files = [path.with_name(name) for name in _file_names(path, names)]
    phases = [(seconds(one.start_ns), seconds(one.end_ns), one.name, one.up) for one in content.phases]
    events = [(seconds(one.time_ns), one.sensor, one.kind, one.message) for one in content.events]
    with ExitStack() as stack:  # files get their names when it is left, the list, entered first, after all others
        listed, *drafts = (stack.enter_context(whole_file(file, force=force)) for file in (path, *files))
        for table, draft in zip(content.tables, drafts, strict=False):
            about = {"table": table.name, "epoch": content.epoch, "units": content.units, "about": dict(table.about)}
            _write_table(draft, content, table, about, meter)
        _write_texts(drafts[-2], "phases", content, CSV_PHASES, phases)
        _write_texts(drafts[-1], "events", content, CSV_EVENTS, events)
        held = [
            *((table.name, table.rows) for table in content.tables),
            ("phases", len(phases)),
            ("events", len(events)),
        ]
        index = [(file.name, table, rows) for file, (table, rows) in zip(files, held, strict=True)]
        with listed.open("w", encoding="utf-8", newline="") as text:
            _begin(text, "what each file holds", content, head_with(content))
            csv.writer(text, lineterminator="\n").writerows([CSV_INDEX, *index])
    return files


def _file_names(path: Path, names: Sequence[str]) -> list[str]:
    """run_Acc.csv and so on; where names differ in case only, which not every disk tells apart, or a sensor is called
    as a group is, with a number.
    """
    taken: dict[str, str] = {}
    for name in names:
        free = next(one for one in numbered(f"{path.stem}_{name}") if one.lower() not in taken)
        taken[free.lower()] = f"{free}{path.suffix}"
    return list(taken.values())


def _begin(file: IO[str], what: str, content: Content, head: Mapping[str, Any]) -> None:
    """The two lines of comment."""
    source = content.head.get("log", "")
    zero = f"time_s since {content.epoch}"
    file.write(f"{CSV_MAGIC}{printable(f'{what} of {source}, units {content.units}; {zero}')}\n# {json.dumps(head)}\n")


def _write_table(path: Path, content: Content, table: Table, head: Mapping[str, Any], meter: Meter) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        _begin(file, table.name, content, head)
        names = [name for one in table.columns for name in csv_names(one.name, one.cells, one.unit)]
        csv.writer(file, lineterminator="\n").writerow(names)
        for rows in table.blocks():
            cells = [texts for column in table.columns for texts in _texts(column, rows)]
            file.writelines(f"{line}\n" for line in map(",".join, zip(*cells, strict=True)))
            meter.add(rows.stop - rows.start, len(table.columns))


def _write_texts(path: Path, table: str, content: Content, names: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        _begin(file, table, content, {"table": table, "epoch": content.epoch})
        csv.writer(file, lineterminator="\n", quoting=csv.QUOTE_ALL).writerows([names, *rows])


def _texts(column: Column, rows: slice) -> Iterator[list[str]]:
    """The cells of a column as text that gives the same numbers again."""
    values: npt.NDArray[Any] = column.read(rows)
    if column.name == "time":
        yield [seconds(time_ns) for time_ns in values.tolist()]
    else:
        form = repr if np.dtype(column.kind).kind == "f" else str
        for cells in values.reshape(len(values), -1).T:
            yield list(map(form, cells.tolist()))


def seconds(time_ns: int) -> str:
    """Nanoseconds as seconds, exactly."""
    whole, rest = divmod(abs(time_ns), 1_000_000_000)
    return f"{'-' if time_ns < 0 else ''}{whole}.{rest:09d}"
