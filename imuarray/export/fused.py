"""A fused file (`imuarray.fuse.fused_file`) as a table: specific force and angular rate in SI in the box frame,
covariances, sensors used.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from imuarray.errors import ExportError
from imuarray.export.formats import ExportRequest
from imuarray.export.tables import Content, ExportTable, TableColumn
from imuarray.fuse.fused_file import FORMAT, FORMAT_VERSION, UNITS, fused_columns, rows_of, texts_of
from imuarray.log.columns import NamedColumn


@contextmanager
def fused_content(request: ExportRequest) -> Iterator[Content]:
    """Open the table of a fused file; ExportError for options that apply only to a log, LogError for a damaged or
    hostile file.
    """
    path = request.source
    if request.sensors or request.calibration is not None or request.units not in (None, "si"):
        raise ExportError(f"{path}: a fused result; it has no sensors to choose or convert, and is in SI")
    with fused_columns(path) as (attributes, columns):
        head: dict[str, Any] = {"format": FORMAT, "format_version": FORMAT_VERSION, "units": "si"}
        head |= {name: attributes.get(name, "") for name in ("epoch", "technique", "log", "calibration", "software")}
        listed = sorted(columns.items(), key=lambda item: (item[0] != "time", item[0]))
        table = ExportTable(
            "fused",
            rows_of(columns),
            tuple(_column(column, name) for name, column in listed),
            {"name": "fused", "frame": "box"},
        )
        yield Content("si", head["epoch"], head, (table,))


def _column(column: NamedColumn, name: str) -> TableColumn:
    kind = "<i8" if name == "time" else column.dtype.newbyteorder("<").str
    unit = "ns" if name == "time" else UNITS.get(name, "1")
    return TableColumn(name, kind, unit, _cells(column), lambda rows: np.asarray(column[rows], kind))


def _cells(column: NamedColumn) -> tuple[str, ...]:
    """Return the names of the cells of a row: x, y, z, the entries of a covariance, or a flag for each sensor."""
    if len(column.shape) == 1:
        return ()
    count = column.shape[1]
    names = texts_of(column.attrs, "columns") or texts_of(column.attrs, "sensors") or ("x", "y", "z")
    return names if len(names) == len(set(names)) == count else tuple(str(index) for index in range(count))
