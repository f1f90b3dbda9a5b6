"""Read back Parquet files of `imuarray export`: the list (run.parquet) with the files that it names, or the table of
one sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.errors import SourceError
from imuarray.export.formats import CSV_INDEX, PARQUET_HEAD, csv_names
from imuarray.importers import ImportSummary, open_source
from imuarray.importers.exported import (
    COLUMN_UNITS,
    MAX_HEADER_BYTES,
    check_head,
    parse_header,
    read_notes,
    write_log,
)
from imuarray.importers.parquet import open_parquet
from imuarray.log.journal import ColumnGroup, Columns
from imuarray.printable import printable
from imuarray.wall_time import unix_ns

_ROWS = 1 << 16
_MOST_NOTES = 1 << 20
_PHASES, _EVENTS = ("start_ns", "end_ns", "name", "up"), ("time_ns", "sensor", "kind", "message")


def is_exported(path: Path) -> bool:
    """Return whether a Parquet file states that `imuarray export` wrote it; False without pyarrow."""
    try:
        from pyarrow import parquet
    except ImportError:
        return False
    try:
        return PARQUET_HEAD.encode() in (parquet.read_schema(path).metadata or {})
    except Exception:  # another reader reports the fault of the file
        return False


def import_file(
    source: str | PathLike[str],
    output: str | PathLike[str],
    *,
    force: bool = False,
    progress: Callable[[int], None] = lambda done: None,
) -> ImportSummary:
    """Write the log that was exported to `source` as `output`; SourceError, OutputExistsError, LogError."""
    path = Path(source)
    open_source(path, output).close()
    header = _header(path)
    head = check_head(header, str(path))
    if "table" in header:
        files = {str(header["table"]): path}
    else:
        listed = _texts(path, CSV_INDEX)
        files = {str(table): path.with_name(str(name)) for name, table, _ in listed}
        if any(Path(str(name)).name != name for name, _, _ in listed):
            raise SourceError(f"{path}: names a file of another folder; its files must be in the same folder")
    expected = {f"sensors/{header.name}" for header in head.preamble.sensors} | set(head.groups)
    if missing := expected - set(files):
        raise SourceError(f"{path}: holds no {printable(min(missing))}")
    phases = _texts(files["phases"], _PHASES) if "phases" in files else []
    events = _texts(files["events"], _EVENTS) if "events" in files else []

    def read(group: ColumnGroup, cells: tuple[str, ...]) -> Iterator[Columns]:
        yield from _rows(files[group.path], group, cells, head.preamble.epoch)

    return write_log(head, read, read_notes(phases, events, str(path)), output, str(path), force=force)


def _header(path: Path) -> dict[str, Any]:
    """Return the header of the file; SourceError."""
    text = (open_parquet(path).schema_arrow.metadata or {}).get(PARQUET_HEAD.encode(), b"")
    if len(text) > MAX_HEADER_BYTES:
        raise SourceError(f"{path}: a header of more than {MAX_HEADER_BYTES} bytes")
    return parse_header(text, str(path))


def _texts(path: Path, names: tuple[str, ...]) -> list[list[Any]]:
    """Return the rows of a short table; SourceError."""
    import pyarrow

    file = open_parquet(path)
    if tuple(file.schema_arrow.names) != names or file.metadata.num_rows > _MOST_NOTES:
        raise SourceError(f"{path}: its columns differ from {', '.join(names)}")
    try:
        columns = file.read().to_pydict()
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise SourceError(f"{path}: damaged: {printable(str(error))[:200]}") from None
    return [list(row) for row in zip(*(columns[name] for name in names), strict=True)]


def _rows(path: Path, group: ColumnGroup, cells: tuple[str, ...], epoch: str) -> Iterator[Columns]:
    """Yield the rows of a group in blocks; SourceError."""
    import pyarrow

    file = open_parquet(path)
    stored_names = set(file.schema_arrow.names)
    zero_ns = unix_ns(epoch)
    time = "time_ns" if zero_ns is None else "time"
    where = {
        name: [time] if name == "time" else csv_names(name, cells if tail else (), COLUMN_UNITS.get(name, ""))
        for name, _, tail in group.columns
    }
    if missing := [name for names in where.values() for name in names if name not in stored_names]:
        raise SourceError(f"{path}: no column {printable(missing[0])!r}")
    try:
        for batch in file.iter_batches(batch_size=_ROWS, columns=[name for names in where.values() for name in names]):
            columns: dict[str, npt.NDArray[Any]] = {}
            for name, kind, tail in group.columns:
                values = [
                    _numbers(batch.column(cell), np.dtype(kind), f"{path}: column {cell}") for cell in where[name]
                ]
                columns[name] = np.stack(values, axis=1) if tail else values[0]
            columns["time"] = columns["time"] - (zero_ns or 0)
            yield columns
    except (pyarrow.ArrowException, OSError) as error:
        raise SourceError(f"{path}: damaged: {printable(str(error))[:200]}") from None


def _numbers(array: Any, kind: np.dtype[Any], where: str) -> npt.NDArray[Any]:
    """Return (n,) numbers of a type; SourceError for a column of another, or with missing values."""
    import pyarrow

    if pyarrow.types.is_timestamp(array.type):
        array = array.cast(pyarrow.int64())
    if array.type != pyarrow.from_numpy_dtype(kind) or array.null_count:
        raise SourceError(f"{where} has type {array.type} or missing values; required are numbers of type {kind.name}")
    return np.asarray(array.to_numpy(zero_copy_only=False))
