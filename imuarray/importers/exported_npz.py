"""Read back an npz file of `imuarray export` in blocks of rows.

The declared type, shape and size of an array are validated against the header and the archive before a row is read.
Nothing is unpickled, and nothing is unpacked onto the disk.
"""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from os import PathLike
from typing import IO, Any

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from imuarray.errors import SourceError
from imuarray.export.formats import NPZ_HEADER
from imuarray.importers import ImportSummary, open_source
from imuarray.importers.exported import MAX_HEADER_BYTES, check_head, parse_header, read_notes, write_log
from imuarray.log.inspection import MOST_DEFLATED
from imuarray.log.journal import ColumnGroup, Columns
from imuarray.printable import printable

MAX_MEMBERS = 4096
_ROWS = 1 << 14
_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError, struct.error)
"""The exceptions of zipfile for a damaged archive."""
_ENCRYPTED = 1
_OVERHEAD = 1 << 12
"""Bytes by which a short array may exceed the limit from its compressed size."""


def import_file(
    source: str | PathLike[str],
    output: str | PathLike[str],
    *,
    force: bool = False,
    progress: Callable[[int], None] = lambda done: None,
) -> ImportSummary:
    """Write the log that was exported to `source` as `output`; SourceError, OutputExistsError, LogError."""
    with open_source(source, output) as file:
        size = file.seek(0, 2)
        file.seek(0)
        try:
            with zipfile.ZipFile(file) as archive:
                arrays = _Arrays(archive, str(source), size, progress)
                head = parse_header(arrays.header(), str(source))
                checked = check_head(head, str(source))
                arrays.names = head.get("arrays")
                notes = read_notes(head.get("phases"), head.get("events"), str(source))
                return write_log(checked, arrays.rows, notes, output, str(source), force=force)
        except _DAMAGED as error:
            raise SourceError(f"{source}: damaged, or not an npz file: {printable(str(error))[:200]}") from None


class _Arrays:
    """The arrays of an archive; `names` maps table and column to the name of the array."""

    def __init__(self, archive: zipfile.ZipFile, where: str, size: int, progress: Callable[[int], None]) -> None:
        """Validate the archive's directory; SourceError."""
        self._archive, self._where, self._size, self._progress = archive, where, size, progress
        self.names: Any = {}
        self._done = 0
        members = archive.infolist()
        if len(members) > MAX_MEMBERS or len({member.filename for member in members}) < len(members):
            raise SourceError(f"{where}: {len(members)} arrays, or one of them twice; at most {MAX_MEMBERS}")
        self._members: Mapping[str, zipfile.ZipInfo] = {member.filename: member for member in members}
        self._total = sum(member.file_size for member in members) or 1
        for member in members:
            self._validate(member)

    def _validate(self, member: zipfile.ZipInfo) -> None:
        """Raise SourceError for a compression that numpy does not use, or for an impossible size."""
        place = f"{self._where}: {printable(member.filename)[:80]}"
        if member.flag_bits & _ENCRYPTED or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise SourceError(f"{place}: encrypted, or compressed by a method that NumPy does not use")
        if member.compress_size > self._size or member.file_size > member.compress_size * MOST_DEFLATED + _OVERHEAD:
            raise SourceError(f"{place}: declares {member.file_size} bytes, more than {member.compress_size} can hold")

    def header(self) -> bytes:
        info = self._member(f"{NPZ_HEADER}.npy")
        if info.file_size > MAX_HEADER_BYTES:
            raise SourceError(f"{self._where}: a header of {info.file_size} bytes; at most {MAX_HEADER_BYTES}")
        with self._archive.open(info) as file:
            dtype, shape = self._read_declaration(file, NPZ_HEADER)
            if dtype.kind != "S" or shape != ():
                raise SourceError(
                    f"{self._where}: its array {NPZ_HEADER!r} is not a header written by `imuarray export`"
                )
            return file.read(dtype.itemsize)

    def _member(self, name: str) -> zipfile.ZipInfo:
        info = self._members.get(name)
        if info is None:
            raise SourceError(f"{self._where}: no array {printable(name.removesuffix('.npy'))[:80]!r} in it")
        return info

    def _read_declaration(self, file: IO[bytes], name: str) -> tuple[np.dtype[Any], tuple[int, ...]]:
        """Return the declared type and shape of an array; SourceError."""
        try:
            version = npy.read_magic(file)
            if version != (1, 0):
                raise ValueError(f"npy format {version}")
            shape, fortran, dtype = npy.read_array_header_1_0(file)
            if fortran or dtype.hasobject:
                raise ValueError("column-major order or objects; row-major numbers are required")
        except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError) as error:
            raise SourceError(f"{self._where}: array {printable(name)[:80]}: {printable(str(error))[:100]}") from None
        return dtype, shape

    def rows(self, group: ColumnGroup, cells: tuple[str, ...]) -> Iterator[Columns]:
        """Yield the rows of a group in blocks, from all its arrays in parallel; SourceError."""
        del cells
        with ExitStack() as stack:
            files: dict[str, IO[bytes]] = {}
            lengths = set()
            for name, kind, tail in group.columns:
                info = self._member(f"{self._array_name(group.path, name)}.npy")
                files[name] = stack.enter_context(self._archive.open(info))
                lengths.add(self._check(files[name], info, np.dtype(kind), tail))
            if len(lengths) != 1:
                raise SourceError(f"{self._where}: {group.path}: arrays of different lengths")
            (length,) = lengths
            for start in range(0, length, _ROWS):
                count = min(_ROWS, length - start)
                yield {
                    name: self._read(files[name], np.dtype(kind), (count, *tail)) for name, kind, tail in group.columns
                }

    def _array_name(self, table: str, column: str) -> str:
        names = self.names.get(table) if isinstance(self.names, dict) else None
        name = names.get(column) if isinstance(names, dict) else None
        if not isinstance(name, str):
            raise SourceError(f"{self._where}: its header names no array for {column} of {table}")
        return name

    def _check(self, file: IO[bytes], info: zipfile.ZipInfo, kind: np.dtype[Any], tail: tuple[int, ...]) -> int:
        """Return the number of rows of an array after validating its type, row shape and size; SourceError."""
        dtype, shape = self._read_declaration(file, info.filename)
        if dtype != kind or shape[1:] != tail or not shape:
            declared = f"{dtype.str} {shape}"
            raise SourceError(
                f"{self._where}: {printable(info.filename)}: {declared}; required are rows of {kind.str} {tail}"
            )
        bytes_declared = kind.itemsize * math.prod(shape)
        if shape[0] < 0 or file.tell() + bytes_declared != info.file_size:
            raise SourceError(
                f"{self._where}: {printable(info.filename)}: declares the shape {shape}, which differs from its size"
            )
        return int(shape[0])

    def _read(self, file: IO[bytes], kind: np.dtype[Any], shape: tuple[int, ...]) -> npt.NDArray[Any]:
        """Return the next rows of an array; SourceError if it is too short."""
        size = kind.itemsize * math.prod(shape)
        data = file.read(size)
        if len(data) != size:
            raise SourceError(f"{self._where}: {printable(str(file.name))}: ends too early")
        self._done += size
        self._progress(int(self._size * min(1.0, self._done / self._total)))
        return np.frombuffer(data, kind).reshape(shape)
