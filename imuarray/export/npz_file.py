"""npz: numpy's archive with an array for each column and a header. It has no objects, so that it can be loaded with
`allow_pickle=False`.

`Gyro1_time` (ns) and `Gyro1_counts` are two of the arrays; `header` is the bytes of a JSON object, which
`json.loads(run["header"].item())` returns, with all data that are not columns. Its entry `arrays` states the name of
each array by table and column, in case two names would be equal. Arrays are written in blocks of rows, so that memory
doesn't grow with the log.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib import format as npy

from imuarray.atomic import whole_file
from imuarray.export.content import head_with, open_content
from imuarray.export.formats import NPZ_HEADER, ExportRequest, ExportSummary, Progress
from imuarray.export.tables import Content, ExportTable, Meter, TableColumn, number_names


def write(request: ExportRequest, path: Path, force: bool, progress: Progress) -> ExportSummary:
    """Write all tables, phases and events to `path`."""
    with (
        open_content(request) as content,
        whole_file(path, force=force) as draft,
        zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
    ):
        names = array_names(content.tables)
        meter = Meter(content, progress)
        _write_header(archive, content, names)
        for table in content.tables:
            for column in table.columns:
                with archive.open(f"{names[table.name][column.name]}.npy", "w", force_zip64=True) as file:
                    _write_column(file, table, column, meter)
        return content.exported(path)


def array_names(tables: Iterable[ExportTable]) -> dict[str, dict[str, str]]:
    """Return the name of the array of each column of each table: Gyro1_counts, or Gyro1_counts_2 if that is taken."""
    used = {NPZ_HEADER}
    names: dict[str, dict[str, str]] = {}
    for table in tables:
        for column in table.columns:
            free = next(name for name in number_names(f"{table.short}_{column.name}") if name not in used)
            used.add(free)
            names.setdefault(table.name, {})[column.name] = free
    return names


def _write_header(archive: zipfile.ZipFile, content: Content, names: dict[str, dict[str, str]]) -> None:
    """Write all data that are not columns, as bytes of ASCII: numpy's text type takes four bytes per character."""
    units = {table.name: {column.name: column.unit for column in table.columns} for table in content.tables}
    head = head_with(content, arrays=names, column_units=units, phases=content.phases, events=content.events)
    with archive.open(f"{NPZ_HEADER}.npy", "w", force_zip64=True) as file:
        npy.write_array(file, np.array(json.dumps(head).encode("ascii")), allow_pickle=False)


def _write_column(file: IO[bytes], table: ExportTable, column: TableColumn, meter: Meter) -> None:
    """Write the array of a column: numpy's header, then its rows."""
    shape = (table.rows, *column.tail)
    npy.write_array_header_1_0(file, {"descr": column.kind, "fortran_order": False, "shape": shape})
    for rows in table.blocks():
        file.write(np.ascontiguousarray(column.read(rows), column.kind).tobytes())
        meter.add(rows.stop - rows.start)
