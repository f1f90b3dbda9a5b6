"""A text table, read a block of rows at a time and turned into whole numbers; complaints name line, column and text."""

from __future__ import annotations

import csv
import io
import math
import zlib
from collections.abc import Iterator, Sequence
from decimal import Decimal, InvalidOperation
from gzip import BadGzipFile
from itertools import islice
from typing import BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.errors import SourceError
from imuarray.importers.mapping import FileTable

ROWS = 4096
"""Rows per block."""

LINE_CHARACTERS = 65536
"""A longer line is no row of a table."""

INT16 = (-32768, 32767)

_LAST_NS = 2**62


class Column(NamedTuple):
    """The cells of one column in one block, with the line that each stands in."""

    source: str
    label: str
    lines: Sequence[int]
    texts: Sequence[str]

    def refuse(self, row: int, complaint: str) -> SourceError:
        """The error that says what is wrong with one cell."""
        return SourceError(f"{self.source}: line {self.lines[row]}, column {self.label}: {complaint}")


class Table:
    """The rows of an open file, `[file]` applied. With `named` the first row holds the columns' names."""

    def __init__(self, file: BinaryIO, source: str, layout: FileTable, named: bool) -> None:
        self._text = io.TextIOWrapper(file, encoding="utf-8-sig", errors="replace")
        self._layout = layout
        self._reader = csv.reader(self._lines(), delimiter=layout.delimiter, skipinitialspace=True)
        self.source = source
        self.line = 0
        self.names: list[str] = [name.strip() for name in self._row()] if named else []
        self.width = len(self.names)

    def _lines(self) -> Iterator[str]:
        """The lines that hold cells."""
        comment = self._layout.comment
        while line := self._read_line():
            self.line += 1
            if len(line) > LINE_CHARACTERS:
                raise SourceError(
                    f"{self.source}: line {self.line}: longer than {LINE_CHARACTERS} characters; is this a table?"
                )
            line = line.strip(" \r\n")
            if self.line > self._layout.skip_rows and line and not (comment and line.startswith(comment)):
                yield line

    def _read_line(self) -> str:
        """The next line, or its beginning if it is longer than any of a table; "" at the end of the file."""
        try:
            return self._text.readline(LINE_CHARACTERS + 1)
        except (BadGzipFile, EOFError, zlib.error) as error:
            raise SourceError(f"{self.source}: behind line {self.line}: packed by gzip and damaged: {error}") from None

    def _row(self) -> list[str]:
        """The next row; [] at the end of the file."""
        try:
            return next(self._reader, [])
        except csv.Error as error:
            raise SourceError(f"{self.source}: line {self.line}: {error}") from None

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        """Line number and cells of every row; all rows are equally long, or cells would change their column unseen."""
        while row := self._row():
            self.width = self.width or len(row)
            if len(row) != self.width:
                raise SourceError(f"{self.source}: line {self.line}: {len(row)} cells, the first row has {self.width}")
            yield self.line, row

    def index(self, column: str | int) -> int:
        """Where a column is; SourceError if a header does not have it, or twice."""
        if isinstance(column, int):
            return column
        if self.names.count(column) != 1:
            problem = "several columns are called" if column in self.names else "no column"
            header = _shortened(", ".join(self.names), 200)
            raise SourceError(f"{self.source}: line {self.line}: {problem} {column!r}; the header has {header}")
        return self.names.index(column)

    def blocks(self, rows: int = ROWS) -> Iterator[Block]:
        """All rows, `rows` at a time."""
        remaining = self._rows()
        while block := list(islice(remaining, rows)):
            lines, cells = zip(*block, strict=True)
            yield Block(self.source, lines, list(zip(*cells, strict=True)))


class Block(NamedTuple):
    """Some rows, column by column."""

    source: str
    lines: Sequence[int]
    columns: Sequence[Sequence[str]]

    def column(self, index: int, label: str) -> Column:
        """One column; SourceError if the rows are not that long."""
        if index >= len(self.columns):
            cells = f"{len(self.columns)} cells, so there is no column {label} (counted from 0)"
            raise SourceError(f"{self.source}: line {self.lines[0]}: {cells}")
        return Column(self.source, label, self.lines, self.columns[index])


def counts(column: Column, sensitivity: float | None = None) -> npt.NDArray[np.int16]:
    """(n,) counts; with a `sensitivity` (counts per unit) the cells are in that unit. SourceError for a cell that is no
    number, no whole one, or no 16-bit count.
    """
    values = _numbers(column)
    whole = np.rint(values if sensitivity is None else values * sensitivity)
    if sensitivity is None and (whole != values).any():
        row = int(np.argmax(whole != values))
        hint = "if the column is in a unit, the map says values = 'physical'"
        raise column.refuse(row, f"{_shortened(column.texts[row])} is no whole number of counts; {hint}")
    outside = (whole < INT16[0]) | (whole > INT16[1])
    if outside.any():
        row = int(np.argmax(outside))
        came = _shortened(column.texts[row]) + ("" if sensitivity is None else f" is {whole[row]:.6g} counts")
        raise column.refuse(row, f"{came}; allowed are {INT16[0]} to {INT16[1]}")
    return whole.astype(np.int16)


def nanoseconds(column: Column, unit_ns: int, last_ns: int | None) -> npt.NDArray[np.int64]:
    """(n,) int64 ns, exact, of cells in units of `unit_ns`; SourceError unless each is later than the one before.

    `last_ns` is the time of the row before the first one here, None if there is none.
    """
    times = np.array([_nanoseconds(column, row, unit_ns) for row in range(len(column.texts))], np.int64)
    before = np.concatenate([[-_LAST_NS * 2 if last_ns is None else last_ns], times[:-1]])
    if (times <= before).any():
        row = int(np.argmax(times <= before))
        raise column.refuse(
            row, f"{_shortened(column.texts[row])} is not later than the row before; allowed are increasing times"
        )
    return times


def _nanoseconds(column: Column, row: int, unit_ns: int) -> int:
    """One time; through decimal numbers, because a day count in floating seconds has no nanoseconds left."""
    text = column.texts[row]
    try:
        value = Decimal(text.strip())
    except InvalidOperation:
        raise column.refuse(row, f"{_shortened(text)!r} is no number") from None
    if not value.is_finite() or value.copy_abs() > _LAST_NS // unit_ns:
        raise column.refuse(row, f"{_shortened(text)} is no time; allowed are numbers up to {_LAST_NS // unit_ns}")
    return int((value * unit_ns).to_integral_value())


def _numbers(column: Column) -> npt.NDArray[np.float64]:
    """(n,) finite numbers; SourceError."""
    try:
        values = [float(text) for text in column.texts]
        row = next((row for row, value in enumerate(values) if not math.isfinite(value)), None)
    except ValueError:
        row = next(row for row, text in enumerate(column.texts) if not _is_number(text))
    if row is not None:
        raise column.refuse(row, f"{_shortened(column.texts[row])!r} is no number")
    return np.array(values)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _shortened(text: str, length: int = 40) -> str:
    """`text`, cut where it gets too long for a message."""
    return text if len(text) <= length else text[:length] + "..."
