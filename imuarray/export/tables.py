"""Tables of an export: groups of equally long columns, which are read a block of rows at a time, with descriptions.

All writers use the same tables, whether they come from a log, in counts or in physical units, or from a fused file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.export.formats import ExportSummary, Progress
from imuarray.log.format import Event, Phase

ROWS = 1 << 14
"""Rows that are in memory at a time; the output does not depend on it."""


@dataclass(frozen=True)
class TableColumn:
    """A column of a table with one number per row, or one for each of `cells`; `kind` is its numpy type, `unit` is
    spelled as in CF ("counts" for raw values, "1" for flags).
    """

    name: str
    kind: str
    unit: str
    cells: tuple[str, ...]
    read: Callable[[slice], npt.NDArray[Any]]

    @property
    def tail(self) -> tuple[int, ...]:
        """The shape of a row."""
        return (len(self.cells),) if self.cells else ()

    @property
    def row_bytes(self) -> int:
        """Bytes of a row."""
        return np.dtype(self.kind).itemsize * max(1, len(self.cells))


@dataclass(frozen=True)
class ExportTable:
    """Columns of equal length, with time in ns first; `name` is its group in the file ("sensors/Gyro1", "truth")."""

    name: str
    rows: int
    columns: tuple[TableColumn, ...]
    about: Mapping[str, Any]

    @property
    def short(self) -> str:
        """The sensor's name, or that of the group."""
        return self.name.rsplit("/", 1)[-1]

    def blocks(self, rows: int = ROWS) -> Iterator[slice]:
        """Return the slices that cover the table."""
        return (slice(start, min(start + rows, self.rows)) for start in range(0, self.rows, rows))


@dataclass(frozen=True)
class Content:
    """An open log or fused file as tables; `head` has the other data, without phases and events, as values for JSON."""

    units: str
    epoch: str
    head: Mapping[str, Any]
    tables: tuple[ExportTable, ...]
    phases: tuple[Phase, ...] = ()
    events: tuple[Event, ...] = ()
    uncalibrated: tuple[str, ...] = ()

    def exported(self, *files: Path) -> ExportSummary:
        """Return the summary of the export to `files`, after all of it is written."""
        rows = {table.name: table.rows for table in self.tables}
        return ExportSummary(files, rows, self.units, self.uncalibrated)


def number_names(wish: str) -> Iterator[str]:
    """Return an endless sequence of names: the name itself, then name_2, name_3, ..., so that a name in use can be
    replaced by the next one.
    """
    return chain([wish], (f"{wish}_{number}" for number in count(2)))


class Meter:
    """Counts the exported rows of columns and reports their share of the total."""

    def __init__(self, content: Content, progress: Progress) -> None:
        self._total = sum(table.rows * len(table.columns) for table in content.tables) or 1
        self._done, self._progress = 0, progress

    def add(self, rows: int, columns: int = 1) -> None:
        """Count `rows` rows of `columns` columns as exported."""
        self._done += rows * columns
        self._progress(min(1.0, self._done / self._total))
