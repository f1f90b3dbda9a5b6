"""Parquet files, read by pyarrow: columns of numbers by name; times of a temporal type are ns since 1970, UTC."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.errors import MissingExtraError, SourceError
from imuarray.importers.cells import Blocks, CellBlock
from imuarray.printable import printable


def open_rows(path: Path, progress: Callable[[int], None]) -> ParquetRows:
    """Open the columns of a file; SourceError, MissingExtraError without pyarrow."""
    return ParquetRows(path, open_parquet(path), progress)


def open_parquet(path: Path) -> Any:
    """Open a file as pyarrow's `ParquetFile`; SourceError, MissingExtraError without pyarrow."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise MissingExtraError("pyarrow", "import") from None
    try:
        return parquet.ParquetFile(path)
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise SourceError(f"{path}: damaged, or not a Parquet file: {printable(str(error))[:200]}") from None


class ParquetRows:
    """An open file."""

    def __init__(self, path: Path, file: Any, progress: Callable[[int], None]) -> None:
        self._path, self._file, self._progress = path, file, progress
        self.remarks: list[str] = []
        self._names = [str(name) for name in file.schema_arrow.names]

    def names(self) -> Mapping[str, Sequence[str]]:
        """Return the names of all columns."""
        return {"": self._names}

    def _name(self, column: str | int) -> str:
        """Return a column's name; SourceError if there is none."""
        if isinstance(column, int) and column < len(self._names):
            return self._names[column]
        if isinstance(column, str) and column in self._names:
            return column
        raise SourceError(f"{self._path}: no column {column!r}; it has {printable(', '.join(self._names))[:200]}")

    def blocks(self, columns: Sequence[str | int], kind: str | None, rows: int) -> Blocks:
        """Yield the rows in batches; SourceError."""
        import pyarrow

        if kind is not None:
            raise SourceError(f"{self._path}: kind {kind!r}: a Parquet file has no kinds of rows")
        names = [self._name(column) for column in columns]
        start = 0
        try:
            for batch in self._file.iter_batches(batch_size=rows, columns=list(dict.fromkeys(names))):
                arrays = [self._numbers(batch.column(name), name) for name in names]
                yield CellBlock(str(self._path), range(start, start + batch.num_rows), arrays), list(range(len(names)))
                start += batch.num_rows
        except (pyarrow.ArrowException, OSError) as error:
            raise SourceError(f"{self._path}: damaged after row {start}: {printable(str(error))[:200]}") from None
        self._progress(self._path.stat().st_size)

    def _numbers(self, array: Any, name: str) -> npt.NDArray[np.number]:
        """Return (n,) numbers, nan for missing values; SourceError for a column of another type."""
        import pyarrow

        kind = array.type
        if pyarrow.types.is_timestamp(kind):
            array = array.cast(pyarrow.timestamp("ns"), safe=False).cast(pyarrow.int64())
        elif not (pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind)):
            raise SourceError(f"{self._path}: column {name!r} has type {kind} instead of numbers")
        return np.asarray(array.to_numpy(zero_copy_only=False))
