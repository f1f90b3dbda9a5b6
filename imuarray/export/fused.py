"""A fused file (`imuarray.fuse.store`) as a table: specific force and angular rate in SI in the box frame, covariances,
sensors used.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import h5py
import numpy as np

from imuarray.errors import ExportError, LogError
from imuarray.export.formats import Wanted
from imuarray.export.tables import Column, Content, Table
from imuarray.fuse.store import UNITS
from imuarray.log.column import NamedColumn
from imuarray.log.guard import DAMAGE, open_file
from imuarray.log.heaps import Inspected
from imuarray.log.inspection import refuse_hostile

FUSED = "imuarray-fused"


@contextmanager
def fused_content(wanted: Wanted) -> Iterator[Content]:
    """The one table of a fused file; ExportError for what only a log can be asked for, LogError for a file that is
    damaged or built to do harm.
    """
    path = wanted.source
    if wanted.sensors or wanted.calibration is not None or wanted.units not in (None, "si"):
        raise ExportError(f"{path}: a fused result; it has no sensors to choose or convert, and is in SI")
    with open_file(path) as file:
        try:
            with h5py.File(Inspected(path), "r") as inspected:
                refuse_hostile(file, inspected, str(path))
            content = _content(file, wanted)
        except DAMAGE as error:
            raise LogError(f"{path}: damaged or malformed: {' '.join(str(error).split())}") from None
        yield content


def _content(file: h5py.File, wanted: Wanted) -> Content:
    names = ("epoch", "technique", "log", "calibration", "software")
    head: dict[str, Any] = {"format": FUSED, "format_version": 1, "units": "si"}
    head |= {name: _text(file.attrs.get(name, "")) for name in names}
    group = file.get("fused")
    rows = 0 if group is None else int(group["time"].shape[0])
    columns = [] if group is None else [_column(group[name], name, rows, wanted) for name in group]
    columns.sort(key=lambda column: (column.name != "time", column.name))
    table = Table("fused", rows, tuple(columns), {"name": "fused", "frame": "box"})
    return Content("si", head["epoch"], head, (table,))


def _column(dataset: Any, name: str, rows: int, wanted: Wanted) -> Column:
    where = f"{wanted.source}: fused/{name}"
    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "iuf" or dataset.shape[:1] != (rows,):
        raise LogError(f"{where}: no column of numbers as long as time")
    if dataset.ndim > 2 or (name == "time" and (dataset.ndim > 1 or dataset.dtype.kind != "i")):
        raise LogError(f"{where}: no column")
    column = NamedColumn(dataset, where)
    kind = "<i8" if name == "time" else dataset.dtype.newbyteorder("<").str
    unit = "ns" if name == "time" else UNITS.get(name, "1")
    return Column(name, kind, unit, _cells(dataset), lambda rows: np.asarray(column[rows], kind))


def _cells(dataset: Any) -> tuple[str, ...]:
    """What a row holds: x, y, z, the entries of a covariance, or a flag for each sensor."""
    if dataset.ndim == 1:
        return ()
    count = int(dataset.shape[1])
    stored = dataset.attrs.get("columns", dataset.attrs.get("sensors", ("x", "y", "z")))
    names = tuple(_text(name) for name in np.atleast_1d(np.asarray(stored)).tolist())
    return names if len(set(names)) == count else tuple(str(index) for index in range(count))


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
