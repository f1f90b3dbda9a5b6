"""Read back CSV files of `imuarray export`: the list (run.csv) with the files that it names, or the table of one
sensor. Data that are not columns are in run.json in the same folder; earlier versions wrote them in two comment lines
of every file.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from imuarray.errors import SourceError
from imuarray.export.formats import CSV_EVENTS, CSV_INDEX, CSV_MAGIC, CSV_PHASES, csv_names
from imuarray.importers import ImportSummary, open_source
from imuarray.importers.cells import CellBlock, CellColumn, TextTable, TimeColumn
from imuarray.importers.exported import (
    COLUMN_UNITS,
    MAX_HEADER_BYTES,
    Head,
    check_head,
    parse_header,
    read_notes,
    write_log,
)
from imuarray.importers.mapping import FileTable
from imuarray.log.journal import ColumnGroup, Columns
from imuarray.log.untrusted_input import MAX_TEXT_BYTES
from imuarray.printable import printable


def import_file(
    source: str | PathLike[str],
    output: str | PathLike[str],
    *,
    force: bool = False,
    progress: Callable[[int], None] = lambda done: None,
) -> ImportSummary:
    """Write the log that was exported to `source` as `output`; SourceError, OutputExistsError, LogError."""
    path = Path(source)
    path = path.with_suffix(".csv") if path.suffix.lower() == ".json" else path
    with open_source(path, output) as file:
        size = file.seek(0, 2)
        file.seek(0)
        header = _header(file, path)
        head = check_head(header, str(path))
        files: Files = {str(header["table"]): (path, None)} if "table" in header else _read_list(file, path, head)
    reader = _Tables(files, path, output, lambda share: progress(int(size * share)))
    notes = read_notes(reader.notes("phases", CSV_PHASES, 2), reader.notes("events", CSV_EVENTS, 1), str(path))
    return write_log(head, reader.rows, notes, output, str(path), force=force)


Files = dict[str, tuple[Path, int | None]]
"""The file of each table, and its required number of rows."""


def _header(file: BinaryIO, path: Path) -> dict[str, Any]:
    """Return the header of the tables, and leave the file at the row of names; SourceError."""
    if not _has_comments(file):
        described = path.with_suffix(".json")
        with open_source(described, path) as metadata:
            data = metadata.read(MAX_HEADER_BYTES + 1)
        if len(data) > MAX_HEADER_BYTES:
            raise SourceError(f"{described}: a header of more than {MAX_HEADER_BYTES} bytes")
        return parse_header(data, str(described))
    return _read_comments(file, path)


def _has_comments(file: BinaryIO) -> bool:
    """Return whether a file begins with the comment lines of earlier versions; the file is left at its beginning."""
    begin = file.read(len(CSV_MAGIC))
    file.seek(0)
    return begin == CSV_MAGIC.encode()


def _read_comments(file: BinaryIO, path: Path) -> dict[str, Any]:
    """Return the JSON of the second line and leave the file at the third; SourceError."""
    first, second = file.readline(1 << 12), file.readline(MAX_HEADER_BYTES + 1)
    if not first.startswith(CSV_MAGIC.encode()) or not first.endswith(b"\n") or not second.startswith(b"# {"):
        raise SourceError(f"{path}: does not begin with the two comment lines that `imuarray export` writes")
    if len(second) > MAX_HEADER_BYTES:
        raise SourceError(f"{path}: a header of more than {MAX_HEADER_BYTES} bytes")
    return parse_header(second[2:], str(path))


def _texts(file: BinaryIO, path: Path, names: Sequence[str]) -> list[list[str]]:
    """Return the rows of a short table of texts with the `names` as its first row; SourceError."""
    data = file.read(MAX_TEXT_BYTES + 1)
    if len(data) > MAX_TEXT_BYTES:
        raise SourceError(f"{path}: more than {MAX_TEXT_BYTES} bytes of text")
    try:
        rows = list(csv.reader(io.StringIO(data.decode("utf-8"), newline=""), strict=True))
    except (csv.Error, ValueError) as error:
        raise SourceError(f"{path}: {error}") from None
    if not rows or tuple(rows[0]) != tuple(names) or any(len(row) != len(names) for row in rows):
        raise SourceError(f"{path}: its columns differ from {', '.join(names)}")
    return rows[1:]


def _read_list(file: BinaryIO, path: Path, head: Head) -> Files:
    """Return the files of a list, which are in the same folder, one for each table of the header; SourceError."""
    files: Files = {}
    for name, table, rows in _texts(file, path, CSV_INDEX):
        if Path(name).name != name or "\0" in name or "\\" in name or not rows.isascii() or not rows.isdigit():
            raise SourceError(f"{path}: {printable(name)[:80]!r}: its files must be in the same folder, and have rows")
        files[table] = (path.with_name(name), int(rows[:18]))
    expected = {f"sensors/{header.name}" for header in head.preamble.sensors} | {*head.groups, "phases", "events"}
    if set(files) != expected:
        missing = ", ".join(sorted(expected ^ set(files)))
        raise SourceError(f"{path}: its list and its header differ: {printable(missing)[:200]}")
    return files


class _Tables:
    """The tables of an export, each in a file of its own."""

    def __init__(
        self, files: Files, path: Path, output: str | PathLike[str], progress: Callable[[float], None]
    ) -> None:
        self._files, self._path, self._output, self._progress = files, path, output, progress
        self._total = sum(rows or 0 for _, rows in files.values()) or 1
        self._done = 0

    def notes(self, table: str, names: Sequence[str], numbers: int) -> list[list[Any]]:
        """Return phases or events; an empty list without a file of them."""
        if table not in self._files:
            return []
        path, _ = self._files[table]
        file, _ = self._open(path)
        with file:
            rows = _texts(file, path, names)
        return [[*(_time(text, path) for text in row[:numbers]), *row[numbers:]] for row in rows]

    def _open(self, path: Path) -> tuple[BinaryIO, int]:
        """Open a file at its row of names, and return the number of lines before that; SourceError if it does not
        exist, is not a regular file, or begins with other comments.
        """
        if not path.is_file():
            raise SourceError(f"{path}: no such file, although {self._path.name} names it")
        file = open_source(path, self._output)
        if not _has_comments(file):
            return file, 0
        try:
            _read_comments(file, path)
        except SourceError:
            file.close()
            raise
        return file, 2

    def rows(self, group: ColumnGroup, cells: tuple[str, ...]) -> Iterator[Columns]:
        """Yield the rows of a group in blocks; SourceError."""
        if group.path not in self._files:
            raise SourceError(f"{self._path}: holds no {group.path}")
        path, expected = self._files[group.path]
        count, last_ns = 0, None
        with ExitStack() as stack:
            file, header_lines = self._open(path)
            stack.enter_context(file)
            table = TextTable(file, str(path), FileTable(), named=True)
            table.line += header_lines
            places = {
                name: list(map(table.index, csv_names(name, cells if tail else (), COLUMN_UNITS.get(name, ""))))
                for name, _, tail in group.columns
            }
            for block in table.blocks():
                columns = _columns(group, block, places, table.names, last_ns)
                last_ns = int(columns["time"][-1])
                count += len(columns["time"])
                self._done += len(columns["time"])
                self._progress(min(1.0, self._done / self._total))
                yield columns
        if expected is not None and count != expected:
            raise SourceError(f"{path}: {count} rows, {self._path.name} states {expected}")


def _columns(
    group: ColumnGroup, block: CellBlock, places: dict[str, list[int]], names: Sequence[str], last_ns: int | None
) -> dict[str, npt.NDArray[Any]]:
    columns: dict[str, npt.NDArray[Any]] = {}
    for name, kind, tail in group.columns:
        cells = [block.column(index, names[index]) for index in places[name]]
        if name == "time":
            columns[name] = TimeColumn("s", last_ns=last_ns).nanoseconds(cells[0])
        else:
            values = [_numbers(cell, np.dtype(kind)) for cell in cells]
            columns[name] = np.stack(values, axis=1) if tail else values[0]
    return columns


def _numbers(column: CellColumn, kind: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return (n,) numbers of a type; SourceError for a cell that is not one."""
    parse = float if kind.kind == "f" else int
    try:
        return np.array([parse(text) for text in column.texts], kind)
    except (ValueError, OverflowError):
        row = next(row for row, text in enumerate(column.texts) if not _fits(text, kind))
    raise column.refuse(row, f"{column.texts[row][:40]!r} is not a number of type {kind.name}")


def _fits(text: str, kind: np.dtype[Any]) -> bool:
    try:
        np.array([float(text) if kind.kind == "f" else int(text)], kind)
    except (ValueError, OverflowError):
        return False
    return True


def _time(text: str, path: Path) -> int:
    """Convert seconds to nanoseconds exactly; SourceError."""
    return int(TimeColumn("s").nanoseconds(CellColumn(str(path), "time", [0], [text]))[0])
