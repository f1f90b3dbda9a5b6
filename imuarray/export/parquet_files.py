"""Parquet: one table per file, which `pandas.read_parquet`, Polars, DuckDB and others open with types, times and units.
The column `time` has dates in UTC, to the nanosecond (`time_ns`, counted from the epoch, if the epoch is not a date); a
triad is three columns, named as in CSV. The unit of a column is in its metadata; all other data are in the metadata of
the file, as JSON under "imuarray". As in CSV, a single table is the file itself; for several tables there is a file for
each next to it, run_Acc.parquet, ..., and run.parquet lists the files and their tables. Rows are written in groups, so
that memory doesn't grow with the log. Importing this module raises MissingExtraError without pyarrow.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imuarray.atomic import whole_file
from imuarray.errors import MissingExtraError
from imuarray.export.content import head_with, open_content
from imuarray.export.csv_files import file_names, file_set
from imuarray.export.formats import CSV_INDEX, PARQUET_HEAD, ExportRequest, ExportSummary, Progress, csv_names
from imuarray.export.tables import Content, ExportTable, Meter, TableColumn
from imuarray.wall_time import unix_ns

try:
    import pyarrow
    import pyarrow.parquet as parquet
except ImportError:
    raise MissingExtraError("pyarrow", "parquet") from None

_GROUP_ROWS = 1 << 16
"""Rows of a group, which a reader loads at once."""


def write(request: ExportRequest, path: Path, force: bool, progress: Progress) -> ExportSummary:
    """Write one table to `path`, or a file for each table next to it and their list to `path`."""
    with open_content(request) as content:
        meter = Meter(content, progress)
        if len(content.tables) == 1 and (request.sensors or content.head["format"] != "imuarray-log"):
            (table,) = content.tables
            with whole_file(path, force=force) as draft:
                _write_table(draft, table, content, head_with(content, table=table.name), meter)
            return content.exported(path)
        return content.exported(*_write_set(path, content, force, meter), path)


def _write_set(path: Path, content: Content, force: bool, meter: Meter) -> list[Path]:
    """Write a file for each table, for phases and for events, and their list; return the files."""
    with file_set(path, content, force=force) as (index, (listed, *drafts)):
        for table, draft in zip(content.tables, drafts, strict=False):
            _write_table(draft, table, content, {"table": table.name, "about": dict(table.about)}, meter)
        _write_texts(drafts[-2], ("start", "end", "name", "up"), content.phases, {"table": "phases"})
        _write_texts(drafts[-1], ("time", "sensor", "kind", "message"), content.events, {"table": "events"})
        _write_texts(listed, CSV_INDEX, index, head_with(content))
    return [path.with_name(name) for name in file_names(path, content)]


def _write_table(path: Path, table: ExportTable, content: Content, head: Mapping[str, Any], meter: Meter) -> None:
    zero_ns = unix_ns(content.epoch)
    fields = [field for column in table.columns for field in _fields(column, zero_ns)]
    schema = pyarrow.schema(fields, metadata=_metadata(head))
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for rows in table.blocks(_GROUP_ROWS):
            arrays = [array for column in table.columns for array in _arrays(column, rows, zero_ns)]
            writer.write_table(pyarrow.Table.from_arrays(arrays, schema=schema))
            meter.add(rows.stop - rows.start, len(table.columns))


def _fields(column: TableColumn, zero_ns: int | None) -> Iterator[pyarrow.Field]:
    if column.name == "time":
        kind = pyarrow.int64() if zero_ns is None else pyarrow.timestamp("ns", tz="UTC")
        yield pyarrow.field("time_ns" if zero_ns is None else "time", kind, nullable=False)
        return
    kind = pyarrow.from_numpy_dtype(np.dtype(column.kind))
    for name in csv_names(column.name, column.cells, column.unit):
        yield pyarrow.field(name, kind, nullable=False, metadata={"unit": column.unit})


def _arrays(column: TableColumn, rows: slice, zero_ns: int | None) -> Iterator[pyarrow.Array]:
    values = np.asarray(column.read(rows), column.kind)
    if column.name == "time" and zero_ns is not None:
        yield pyarrow.array(values + zero_ns, pyarrow.timestamp("ns", tz="UTC"))
        return
    for cell in values.reshape(len(values), -1).T:
        yield pyarrow.array(np.ascontiguousarray(cell))


def _write_texts(path: Path, names: Sequence[str], rows: Sequence[Sequence[Any]], head: Mapping[str, Any]) -> None:
    """Write a short table of texts and integers; times are in ns since the epoch."""
    columns = zip(*rows, strict=True) if rows else [()] * len(names)
    kinds = {"start": pyarrow.int64(), "end": pyarrow.int64(), "time": pyarrow.int64(), "rows": pyarrow.int64()}
    arrays = [
        pyarrow.array(list(column), kinds.get(name, pyarrow.string()))
        for name, column in zip(names, columns, strict=True)
    ]
    called = [f"{name}_ns" if name in ("start", "end", "time") else name for name in names]
    table = pyarrow.Table.from_arrays(arrays, names=called).replace_schema_metadata(_metadata(head))
    parquet.write_table(table, path)


def _metadata(head: Mapping[str, Any]) -> dict[str, str]:
    return {PARQUET_HEAD: json.dumps(head)}
