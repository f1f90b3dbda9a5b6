"""Writes rows to chunked HDF5 columns, whole chunks past HDF5's own filters.

HDF5 copies every chunk several times before and between its filters, which takes as long as compressing it. Whole
chunks are therefore filtered here and written as they are stored in the file, with the bytes that HDF5 would write (if
it is built with the same zlib). A chunk that equals the one before, such as one without flags, is filtered once.
Without compiled code, and for columns without or with other filters, HDF5 writes the rows.
"""

from __future__ import annotations

import zlib

import h5py
import numpy as np
import numpy.typing as npt
from h5py import h5z

try:
    from imuarray.log._chunks import fletcher32, shuffle
except ImportError:  # installed without a C compiler
    COMPILED = False
else:
    COMPILED = True

_KNOWN = frozenset((h5z.FILTER_SHUFFLE, h5z.FILTER_DEFLATE, h5z.FILTER_FLETCHER32))
"""The filters that are applied here."""


class ColumnWriter:
    """Appends rows to a column whose chunks are as wide as its rows."""

    def __init__(self, column: h5py.Dataset) -> None:
        self._column = column
        self._rows: int = column.shape[0]
        plan = column.id.get_create_plist()
        self._filters = [plan.get_filter(number)[::2] for number in range(plan.get_nfilters())]
        is_plain = column.dtype.kind in "iuf" and column.dtype.isnative
        is_known = bool(self._filters) and _KNOWN.issuperset(code for code, _ in self._filters)
        self._is_direct = COMPILED and is_plain and is_known and column.chunks[1:] == column.shape[1:]
        self._last: tuple[bytes, bytes] = b"", b""

    def append(self, values: npt.NDArray[np.generic]) -> None:
        """Add rows (n, ...) after the last one; OSError."""
        begin, self._rows = self._rows, self._rows + len(values)
        self._column.resize(self._rows, axis=0)
        if not self._is_direct or values.dtype != self._column.dtype:
            self._column[begin:] = values
            return
        chunk = self._column.chunks[0]
        first = min(-begin % chunk, len(values))
        last = first + (len(values) - first) // chunk * chunk
        if first:
            self._column[begin : begin + first] = values[:first]
        for start in range(first, last, chunk):
            place = (begin + start, *[0] * (values.ndim - 1))
            self._column.id.write_direct_chunk(place, self._filter(values[start : start + chunk]))
        if last < len(values):
            self._column[begin + last :] = values[last:]

    def _filter(self, values: npt.NDArray[np.generic]) -> bytes:
        """Return the values of a chunk as they are stored."""
        plain = values.tobytes()
        if plain != self._last[0]:
            stored = plain
            for code, parameters in self._filters:
                if code == h5z.FILTER_SHUFFLE:
                    stored = _shuffle(stored, values.dtype.itemsize)
                elif code == h5z.FILTER_DEFLATE:
                    stored = zlib.compress(stored, parameters[0])
                else:
                    stored += fletcher32(stored).to_bytes(4, "little")
            self._last = plain, stored
        return self._last[1]


def _shuffle(data: bytes, width: int) -> bytes:
    """Return the first bytes of all values of `width` bytes, then the second ones, and so on."""
    planes = bytearray(len(data))
    shuffle((data, planes), (len(data) // width, width))
    return bytes(planes)
