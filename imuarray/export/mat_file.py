"""MATLAB, version 5: a struct for each sensor with a field for each column, n-by-3; `load run.mat` reads it.

`time_ns` is exact, in int64; `time_s` is double. Times count from `imuarray.epoch`. One sensor at a time is in memory.
The format has no arrays of 2 GB or more. A larger log need not be exported: it is HDF5, which MATLAB reads with
`h5read("run.h5", "/sensors/Gyro1/counts")`, as 3-by-n, because MATLAB reverses the dimensions of HDF5.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import IO, Any

import numpy as np
from scipy.io import savemat

from imuarray.atomic import whole_file
from imuarray.errors import ExportError
from imuarray.export.content import head_with, open_content
from imuarray.export.formats import ExportRequest, ExportSummary, Progress
from imuarray.export.tables import Content, ExportTable, Meter, number_names

MOST_BYTES = (1 << 31) - 1
"""Largest size of an array in bytes: its length is stored in 32 bits (MATLAB MAT-File Format, R2019b, chapter 1)."""

_LONGEST_NAME = 63
_HEAD = "imuarray"


def write(request: ExportRequest, path: Path, force: bool, progress: Progress) -> ExportSummary:
    """Write all tables, phases and events to `path`; ExportError for more than `MOST_BYTES` of an array."""
    with open_content(request) as content:
        for table in content.tables:
            for column in table.columns:
                if table.rows * column.row_bytes > MOST_BYTES:
                    raise ExportError(
                        f"{path}: {table.name}: {table.rows} rows are more than an array of this format holds;"
                        ' read the log itself: h5read("RUN.h5", "/sensors/NAME/counts")'
                    )
        meter = Meter(content, progress)
        names = _names(content.tables)
        with whole_file(path, force=force) as draft, draft.open("wb") as file:
            _save(file, _HEAD, _head(content, names))
            for table, name in zip(content.tables, names, strict=True):
                _save(file, name, _struct(table, meter))
        return content.exported(path)


def _save(file: IO[bytes], name: str, struct: dict[str, Any]) -> None:
    """Append a variable to the file; scipy writes the head of an empty file."""
    savemat(file, {name: struct}, long_field_names=True, do_compression=True, oned_as="column")


def _head(content: Content, names: list[str]) -> dict[str, Any]:
    """Return the description of the file: some fields for readers, the complete description as JSON for programs."""
    columns = zip(*content.phases, strict=True) if content.phases else [[]] * 4
    start, end, phase, up = (list(column) for column in columns)
    columns = zip(*content.events, strict=True) if content.events else [[]] * 4
    time, sensor, kind, message = (list(column) for column in columns)
    return {
        "epoch": content.epoch,
        "units": content.units,
        "variables": _texts(names),
        "header_json": json.dumps(head_with(content)),
        "phases": {"start_ns": _times(start), "end_ns": _times(end), "name": _texts(phase), "up": _texts(up)},
        "events": {"time_ns": _times(time), "sensor": _texts(sensor), "kind": _texts(kind), "message": _texts(message)},
    }


def _times(values: list[Any]) -> Any:
    return np.array(values, np.int64)[:, None]


def _texts(values: list[Any]) -> Any:
    """Return a column of cells of text."""
    cells = np.empty((len(values), 1), object)
    cells[:, 0] = values
    return cells


def _struct(table: ExportTable, meter: Meter) -> dict[str, Any]:
    """Return a table as a struct, with the units of its columns and its description."""
    fields: dict[str, Any] = {}
    for column in table.columns:
        values = column.read(slice(0, table.rows))
        if column.name == "time":
            fields |= {"time_ns": values, "time_s": values / 1e9}
        else:
            fields[column.name] = values
        meter.add(table.rows)
    fields["units"] = {column.name: column.unit for column in table.columns if column.name != "time"}
    fields["cells"] = {column.name: _texts(list(column.cells)) for column in table.columns if column.cells}
    return fields | {"about_json": json.dumps(dict(table.about))}


def _names(tables: tuple[ExportTable, ...]) -> list[str]:
    """Return a unique variable name for each table: its own name, changed as MATLAB requires."""
    names: list[str] = []
    for table in tables:
        wish = re.sub(r"\W", "_", table.short, flags=re.ASCII)
        wish = (wish if wish[:1].isalpha() else f"x{wish}")[: _LONGEST_NAME - 5]
        names.append(next(name for name in number_names(wish) if name not in (_HEAD, *names)))
    return names
