"""Reads untrusted files: opens or rejects them with a clear error, reads texts in pieces, and checks phases and
events.

`imuarray.log.inspection` checks the structure of a file before anything in it is trusted.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5t

from imuarray.errors import LogError
from imuarray.log.format import FORMAT, READ_CACHE_BYTES
from imuarray.spelling import guess_file

TEXT = h5t.py_create(h5py.string_dtype())
"""The type in memory of a text of varying length, for h5py's functions of HDF5."""

MAX_TEXT_BYTES = 1 << 24
"""Largest number of bytes of all texts in a column: the messages of a hundred thousand events."""
_BLOCK_BYTES = 1 << 22
"""Number of bytes that are read at a time, as estimated from the length of previous texts."""
_FIRST_ROWS = 4
"""Rows that are read before any length is known: the names of all axes, or four texts of the longest heaps (64 MB)."""
_IMPORTED = (".csv", ".npz", ".txt", ".bin")
"""Suffixes of recordings that can be imported."""

DAMAGE = (
    OSError, KeyError, RuntimeError, ValueError, TypeError, AttributeError, IndexError, ArithmeticError, MemoryError,
)  # fmt: skip
"""The exceptions of h5py on malformed input."""


def open_file(path: Path) -> h5py.File:
    """Open an HDF5 file for reading; LogError if it is missing, truncated or something else."""
    if not path.is_file():
        kind = "is a folder" if path.is_dir() else "is a device or a pipe; a log is a file" if path.exists() else ""
        raise LogError(f"{path}: {kind or f'no such file{guess_file(path)}'}")
    try:
        return h5py.File(path, "r", rdcc_nbytes=READ_CACHE_BYTES)
    except OSError as error:
        kind = "is truncated" if "truncated" in str(error) else "is not an HDF5 file, or is damaged"
        suffix = path.suffix.lower()
        hint = f"; imuarray import makes a log of a {suffix}" if suffix in _IMPORTED else ""
        raise LogError(f"{path}: {kind}; a log is an HDF5 file of format {FORMAT!r}{hint}") from None


def plain_value(value: Any) -> Any:
    """Return an attribute as HDF5 programs mean it: text as str, and the element of an array with one element, which
    MATLAB and others write for a number.
    """
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(-1)[0]
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def positive(value: Any) -> float:
    """Return an attribute if it is one positive, finite number, else 0."""
    value = plain_value(value)
    number = value.item() if isinstance(value, np.generic) else value
    fits = isinstance(number, int | float) and not isinstance(number, bool) and 0 < number < math.inf
    return float(number) if fits else 0.0


def check_note(fields: Any, numbers: int) -> None:
    """Raise ValueError unless these are the fields of a phase or an event: `numbers` times, followed by texts."""
    times, texts = fields[:numbers], fields[numbers:]
    if not isinstance(fields, list) or not all(isinstance(text, str) for text in texts):
        raise ValueError("a note is times and texts")
    if not all(isinstance(time, int) and not isinstance(time, bool) and abs(time) < 1 << 63 for time in times):
        raise ValueError("times are whole numbers of 64 bits")


def read_texts(column: Any) -> list[Any]:
    """Read a whole column of texts or numbers, a few rows at a time, because each text may be as long as a heap and all
    may refer to the same one. ValueError for more than `MAX_TEXT_BYTES`, TypeError for anything but a column.
    """
    if not isinstance(column, h5py.Dataset) or column.dtype.kind != "O":
        return list(column[:].tolist())
    if column.ndim != 1:
        raise ValueError("texts are one column")
    values: list[Any] = []
    rows, size, step = int(column.shape[0]), 0, _FIRST_ROWS
    while len(values) < rows:
        block = column[len(values) : len(values) + step].tolist()
        longest = max(map(len, block))
        size += sum(map(len, block))
        if size > MAX_TEXT_BYTES:
            raise ValueError(f"texts of more than {MAX_TEXT_BYTES} bytes")
        values += block
        step = max(1, min(2 * step, 4096, _BLOCK_BYTES // max(1, longest)))
    return values
