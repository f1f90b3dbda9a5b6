"""Arrays as columns: NumPy's .npz and .npy, and MATLAB's .mat of versions 5 and 7.3 (HDF5).

A one-dimensional array is a column of its name; the columns of an array `acc` are `acc[0]`, `acc[1]`, ...; fields of
structs are `imu.acc`. The columns of a file with a single table can also be selected by index. Nothing is unpickled.
"""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import h5py
import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from imuarray.errors import SourceError
from imuarray.importers.cells import Blocks, CellBlock
from imuarray.printable import printable

Array = npt.NDArray[Any]

MOST_COLUMNS = 64
"""Maximum number of columns of an array; a longer dimension is that of the rows."""

MOST_BYTES = 1 << 33
"""Maximum size of the arrays of a file; an hour of fifty sensors at a kilohertz takes 4 GB."""

_MATLAB73 = b"MATLAB 7.3 MAT-file"


def open_rows(path: Path, progress: Callable[[int], None]) -> ArrayRows:
    """Open the arrays of a file; SourceError."""
    with path.open("rb") as file:
        first = file.read(len(_MATLAB73))
    try:
        if first.startswith(b"PK"):
            arrays = dict(_read_npz(path))
        elif first.startswith(npy.MAGIC_PREFIX):
            with path.open("rb") as file:
                arrays = dict(_read_npy("", file, path.stat().st_size))
        elif first.startswith((b"\x89HDF", _MATLAB73)):
            arrays = dict(_read_hdf5(path))
        else:
            arrays = dict(_read_mat(path))
    except (
        ValueError,
        TypeError,
        OSError,
        EOFError,
        KeyError,
        MemoryError,
        NotImplementedError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise SourceError(f"{path}: damaged, or without readable arrays: {printable(str(error))[:200]}") from None
    return ArrayRows(path, arrays, progress)


class ArrayRows:
    """Arrays of numbers, (n,) or (n, k), by name."""

    def __init__(self, path: Path, arrays: Mapping[str, Array], progress: Callable[[int], None]) -> None:
        self._path, self._progress = path, progress
        self.remarks: list[str] = []
        tables = [(name, _stand_upright(array)) for name, array in arrays.items()]
        self._columns: dict[str, Array] = {}
        for name, array in tables:
            if array.ndim == 1:
                self._columns[name] = array
            else:
                self._columns |= {f"{name}[{index}]": array[:, index] for index in range(array.shape[1])}
        wide = [array for _, array in tables if array.ndim == 2]
        self._only = wide[0] if len(wide) == 1 else None
        if not self._columns:
            raise SourceError(f"{path}: contains no array of numbers")

    def names(self) -> Mapping[str, Sequence[str]]:
        """Return the names of all columns."""
        return {"": list(self._columns)}

    def _column(self, column: str | int) -> Array:
        """Return a column; SourceError if no column has that name or index."""
        if isinstance(column, int):
            if self._only is None or column >= self._only.shape[1]:
                raise SourceError(
                    f"{self._path}: no column {column}; an index selects a column only in a file with a single array"
                )
            return np.asarray(self._only[:, column])
        if column not in self._columns:
            names = ", ".join(self._columns)
            raise SourceError(f"{self._path}: no column {column!r}; it has {printable(names)[:200]}")
        return self._columns[column]

    def blocks(self, columns: Sequence[str | int], kind: str | None, rows: int) -> Blocks:
        """Yield the rows of columns of equal length; SourceError."""
        if kind is not None:
            raise SourceError(
                f"{self._path}: kind {kind!r}: arrays have no kinds of rows; each sensor names its columns"
            )
        arrays = [self._column(column) for column in columns]
        lengths = {len(array) for array in arrays}
        if len(lengths) > 1:
            listed = ", ".join(f"{column} {len(array)}" for column, array in zip(columns, arrays, strict=True))
            raise SourceError(
                f"{self._path}: columns of different lengths: {listed}; does each sensor have its own time_column?"
            )
        (length,) = lengths
        for start in range(0, length, rows):
            part = slice(start, min(start + rows, length))
            block = CellBlock(str(self._path), range(part.start, part.stop), [array[part] for array in arrays])
            yield block, list(range(len(columns)))
        self._progress(self._path.stat().st_size)


def _stand_upright(array: Array) -> Array:
    """Return the array with rows along the first dimension: it has more rows than columns."""
    if array.ndim == 2 and array.shape[0] < array.shape[1] and array.shape[0] <= MOST_COLUMNS:
        array = array.T
    return array[:, 0] if array.ndim == 2 and array.shape[1] == 1 else array


def _is_column(array: Any) -> bool:
    """Return whether it is an array of numbers with the shape of columns."""
    if not isinstance(array, np.ndarray | h5py.Dataset) or array.dtype.kind not in "iufb":
        return False
    return array.size > 1 and (len(array.shape) == 1 or (len(array.shape) == 2 and min(array.shape) <= MOST_COLUMNS))


def _read_npz(path: Path) -> Iterator[tuple[str, Array]]:
    """Yield every array of numbers, and every field of a structured one."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if sum(member.file_size for member in members) > MOST_BYTES:
            raise ValueError(f"more than {MOST_BYTES} bytes")
        arrays = [member for member in members if member.filename.endswith(".npy")]
        if not arrays:
            raise ValueError("a zip file without arrays of NumPy; unpack it, or save a spreadsheet as CSV")
        for member in arrays:
            with archive.open(member) as file:
                yield from _read_npy(member.filename.removesuffix(".npy"), file, member.file_size)


def _read_npy(name: str, file: IO[bytes], size: int) -> Iterator[tuple[str, Array]]:
    """Yield an array of numbers, or every field of a structured one; `name` is "" if it is alone in its file.

    ValueError if the header states an array that is larger than the file of `size` bytes: no memory is reserved for it.
    """
    read_header = npy.read_array_header_1_0 if npy.read_magic(file) == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read_header(file)
    stated = math.prod(shape) * dtype.itemsize
    if stated > size:
        raise ValueError(f"its header states an array of {stated} bytes, the file has {size}")
    file.seek(0)
    array: Array = npy.read_array(file, allow_pickle=False)
    if array.dtype.names:
        parts = (part for part in array.dtype.names if _is_column(array[part]))
        yield from ((f"{name}.{part}" if name else part, array[part]) for part in parts)
    elif _is_column(array):
        yield name or "data", array


def _read_mat(path: Path) -> Iterator[tuple[str, Array]]:
    """Yield every array of a MATLAB file of version 5, including those in structs."""
    from scipy.io import loadmat

    def inside(name: str, value: Any) -> Iterator[tuple[str, Array]]:
        if isinstance(value, dict):
            for key, item in value.items():
                yield from inside(f"{name}.{key}" if name else str(key), item)
        elif _is_column(value):
            yield name, value

    yield from inside("", loadmat(path, simplify_cells=True))


def _read_hdf5(path: Path) -> Iterator[tuple[str, Array]]:
    """Yield every array of an HDF5 file as it is stored; MATLAB 7.3 files store dimensions in reverse order."""
    with h5py.File(path, "r") as file:
        arrays: dict[str, Array] = {}
        names: list[str] = []
        file.visit(names.append)
        total = 0
        for name in names:
            item = file.get(name, getlink=False)
            if name.startswith("#") or not _is_column(item):
                continue
            total += item.size * item.dtype.itemsize
            if total > MOST_BYTES:
                raise ValueError(f"more than {MOST_BYTES} bytes")
            values = np.asarray(item[()])
            arrays[name.replace("/", ".")] = values[0] if values.ndim == 2 and values.shape[0] == 1 else values
        yield from arrays.items()
