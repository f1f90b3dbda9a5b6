"""The rows of a recording: a text, arrays in a file (.npz, .npy, .mat, .parquet), messages in a bag.

The first bytes determine the kind of file (`open_rows`). Texts, bags and Parquet files are streamed. The arrays of
.npz, .npy and .mat files and JSON documents are read completely, because of their format.
"""

from __future__ import annotations

import shutil
import weakref
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from itertools import zip_longest
from os import PathLike
from pathlib import Path
from tempfile import mkdtemp
from typing import Protocol, cast

import numpy as np

from imuarray.errors import SourceError
from imuarray.importers import decompress, open_source, unreadable
from imuarray.importers.cells import Blocks, CellBlock, TextTable
from imuarray.importers.mapping import TableMap
from imuarray.importers.records import is_of_records
from imuarray.importers.row_files import folder_of_rows
from imuarray.importers.row_order import select_rows
from imuarray.printable import counted, listed

Reference = str | int
"""A column by its name or its index."""

Row = tuple[str, ...]
"""The cells of a row of a text."""

Progress = Callable[[int], None]


class RecordingRows(Protocol):
    """A recording's rows. SourceError if they are unreadable."""

    @property
    def remarks(self) -> Sequence[str]:
        """Remarks about the file and on omitted parts, as sentences."""

    def names(self) -> Mapping[str, Sequence[str]]:
        """Return the columns' names by kind of rows ("" if there is only one kind)."""

    def blocks(self, columns: Sequence[Reference], kind: str | None, rows: int) -> Blocks:
        """Yield the rows (of a kind), `rows` at a time, with the index of each of the `columns` in the block."""


class TextRows:
    """The rows of a text, compressed by gzip or not."""

    def __init__(
        self, source: str | PathLike[str], output: str | PathLike[str], table_map: TableMap, progress: Progress
    ) -> None:
        self._source, self._output, self._map, self._progress = source, output, table_map, progress
        self.remarks: list[str] = []

    def names(self) -> Mapping[str, Sequence[str]]:
        """Return the names in the first row."""
        with open_source(self._source, self._output) as file:
            return {"": TextTable(decompress(file), str(self._source), self._map.file, named=True).names}

    def blocks(self, columns: Sequence[Reference], kind: str | None, rows: int) -> Blocks:
        """Yield the rows from the beginning of the file."""
        named = any(isinstance(column, str) for column in self._map.columns())
        with open_source(self._source, self._output) as file:
            table = TextTable(decompress(file), str(self._source), self._map.file, named)
            places = [table.index(column) for column in columns]
            for block in table.blocks(rows, kind):
                yield block, places
                self._progress(file.tell())
            self.remarks += [text for text in table.remarks() if text not in self.remarks]


class FolderRows:
    """The rows of the texts in a folder or a zip file: one file for each sensor, as phones export them. The name of a
    file, without its suffix, is the kind of its rows. Files that the map declares as parts of one recording are joined,
    and rows that two of them have in common are kept once.
    """

    def __init__(
        self, source: str | PathLike[str], output: str | PathLike[str], table_map: TableMap, progress: Progress
    ) -> None:
        self._source = source
        folder = Path(source)
        if folder.is_file():
            folder = unpack_texts(folder)
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self._files = {name: TextRows(path, output, table_map, progress) for name, path in texts_in(folder).items()}
        self._parts = {group[0]: group[1:] for group in table_map.file.parts}
        self.overlaps: dict[str, int] = {}
        """Number of rows of each part that repeat rows of the parts before it."""

    @property
    def remarks(self) -> list[str]:
        """Remarks about the files that were read."""
        remarks = [f"{name}: {text}" for name, file in self._files.items() for text in file.remarks]
        remarks += [f"{listed([first, *others])} joined in this order" for first, others in self._parts.items()]
        for name, rows in self.overlaps.items():
            if rows:
                remarks.append(f"{name}: its first {counted(rows, 'row')} are in the file before it, too: kept once")
        return remarks

    def names(self) -> Mapping[str, Sequence[str]]:
        """Return the names in the first row of each file."""
        return {name: file.names()[""] for name, file in self._files.items()}

    def blocks(self, columns: Sequence[Reference], kind: str | None, rows: int) -> Blocks:
        """Yield the rows of the file that `kind` names, and of the parts that follow it; SourceError without this file,
        or if parts overlap with different rows.
        """
        names = [kind or "", *self._parts.get(kind or "", ())]
        for name in names:
            if name not in self._files:
                problem = f"no file {name!r}" if name else "kind is missing"
                raise SourceError(
                    f"{self._source}: {problem}; the kind of a sensor of a folder is the name of its file: "
                    + ", ".join(self._files)
                )
        self.overlaps.update(dict.fromkeys(names[1:], 0))
        repeated: list[Row] = []
        for name, later in zip_longest(names, names[1:]):
            first = None if later is None else self._first_row(later, columns)
            tail: list[Row] = []
            for block, where in self._files[name].blocks(columns, None, rows):
                fresh = self._drop_repeated(repeated, block, where, name)
                cells = list(zip(*(fresh.columns[at] for at in where), strict=True)) if first is not None else []
                begin = 0 if tail else next((place for place, row in enumerate(cells) if row == first), len(cells))
                tail += cells[begin:]
                if len(fresh.lines):
                    yield fresh, where
            repeated = tail

    def _first_row(self, name: str, columns: Sequence[Reference]) -> Row | None:
        """Return the cells of the first row of a file; None without rows."""
        for block, where in self._files[name].blocks(columns, None, 1):
            return tuple(str(block.columns[at][0]) for at in where)
        return None

    def _drop_repeated(self, repeated: list[Row], block: CellBlock, where: Sequence[int], name: str) -> CellBlock:
        """Return the rows of a block that are not `repeated` from the file before, and remove these from the list;
        SourceError if a row differs from its counterpart.
        """
        count = min(len(repeated), len(block.lines))
        for place in range(count):
            row = tuple(str(block.columns[at][place]) for at in where)
            if row != repeated[place]:
                raise SourceError(
                    f"{block.source}: line {block.lines[place]}: {name} overlaps the file before it, but this row"
                    f" differs from its counterpart there: {', '.join(row)[:100]} against"
                    f" {', '.join(repeated[place])[:100]}; files that are not copies of each other cannot be joined"
                )
        del repeated[:count]
        self.overlaps[name] = self.overlaps.get(name, 0) + count
        return select_rows(block, np.arange(count, len(block.lines))) if count else block


_TEXTS = (".csv", ".txt", ".tsv", ".csv.gz", ".txt.gz", ".tsv.gz")


def texts_in(folder: Path) -> dict[str, Path]:
    """Return the texts of a folder by their names without suffix."""
    paths = sorted(path for path in folder.iterdir() if path.is_file() and path.name.lower().endswith(_TEXTS))
    return {stem_of(path): path for path in paths}


def stem_of(path: Path) -> str:
    """Return the name of a text without its suffix; other dots in it are kept, for example those in times."""
    name = path.name.lower()
    suffix = next((suffix for suffix in sorted(_TEXTS, key=len, reverse=True) if name.endswith(suffix)), path.suffix)
    return path.name[: len(path.name) - len(suffix)] if suffix else path.name


MOST_UNPACKED = 1 << 34
"""Maximum size in bytes of all texts in a zip file."""


def zipped_texts(path: Path) -> list[zipfile.ZipInfo]:
    """Return the texts in a zip file: those in the uppermost folder with texts; [] if the file is not a zip file or
    contains arrays of NumPy.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = [member for member in archive.infolist() if not member.is_dir()]
    except (OSError, zipfile.BadZipFile):
        return []
    if any(member.filename.endswith(".npy") for member in members):
        return []
    texts = [member for member in members if member.filename.lower().endswith(_TEXTS)]
    depth = min((member.filename.count("/") for member in texts), default=0)
    return [member for member in texts if member.filename.count("/") == depth and "__MACOSX" not in member.filename]


def unpack_texts(path: Path) -> Path:
    """Unpack the texts of a zip file into a temporary folder, which the caller removes; SourceError."""
    members = zipped_texts(path)
    if sum(member.file_size for member in members) > MOST_UNPACKED:
        raise SourceError(f"{path}: its texts have more than {MOST_UNPACKED} bytes; unpack it, and import the folder")
    folder = Path(mkdtemp(prefix="imuarray-"))
    try:
        with zipfile.ZipFile(path) as archive:
            for member in members:
                with archive.open(member) as packed, (folder / Path(member.filename).name).open("wb") as text:
                    shutil.copyfileobj(packed, text)
    except (OSError, zipfile.BadZipFile, zlib.error, RuntimeError, NotImplementedError) as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise SourceError(f"{path}: cannot be unpacked: {error}") from None
    return folder


READERS: Mapping[bytes, str] = {
    b"PK\x03\x04": "arrays",
    b"\x93NUMPY": "arrays",
    b"MATLAB 5.0 MAT-file": "arrays",
    b"MATLAB 7.3 MAT-file": "arrays",
    b"\x89HDF\r\n\x1a\n": "arrays",
    b"PAR1": "parquet",
    b"#ROSBAG V2.0": "bags",
    b"\x89MCAP0\r\n": "bags",
    b"SQLite format 3\0": "bags",
}
"""First bytes of a binary file, and the module that reads it as `open_rows(source, output, progress)`."""


def reader_of(source: str | PathLike[str]) -> str | None:
    """Return the module that reads a binary file, a text of records or a folder of rows; None for a table of text, or a
    folder of these. A folder with a metadata.yaml is assumed to be a ROS 2 bag.
    """
    path = Path(source)
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return "bags"
        if folder_of_rows(path) is not None:
            return "row_files"
        if not texts_in(path):
            raise SourceError(
                f"{path}: is a folder without a metadata.yaml, so no ROS 2 bag, and has no {', '.join(_TEXTS[:3])}"
            )
        return None
    try:
        with path.open("rb") as file:
            first = file.read(max(map(len, READERS)))
    except OSError as error:
        raise unreadable(path, error) from None
    packer = next((name for magic, name in PACKERS.items() if first.startswith(magic)), None)
    if packer is not None:
        raise SourceError(
            f"{path}: compressed by {packer}; decompress it first, or give the folder of a ROS 2 bag, not a file in it"
        )
    module = next((module for magic, module in READERS.items() if first.startswith(magic)), None)
    if module is None and is_of_records(path):
        return "records"
    if module is None and path.suffix.lower() in _BINARY and any(byte < 9 or byte > 126 for byte in first):
        raise SourceError(
            f"{path}: does not begin as {path.suffix.lower()} files do: it is damaged, or has a wrong name"
        )
    return ZIP if module == "arrays" and first.startswith(b"PK") and zipped_texts(path) else module


_BINARY = (".npy", ".npz", ".mat", ".h5", ".hdf5", ".parquet", ".bag", ".db3", ".mcap", ".zip")
"""Suffixes of binary files; some texts have them, too (`save -ascii` of MATLAB)."""

PACKERS: Mapping[bytes, str] = {
    b"\x28\xb5\x2f\xfd": "zstd", b"\xfd7zXZ\0": "xz", b"BZh": "bzip2",
    b"7z\xbc\xaf\x27\x1c": "7-Zip", b"Rar!\x1a\x07": "RAR",
}  # fmt: skip
"""First bytes of compressed files that are not read, and the name of their format."""

ZIP = "zip"
"""Name of the reader of a zip file with texts, which is read like a folder of texts."""


def open_rows(
    source: str | PathLike[str], output: str | PathLike[str], table_map: TableMap, progress: Progress
) -> RecordingRows:
    """Open the rows of any recording that a map can describe; SourceError, MissingExtraError."""
    reader = reader_of(source)
    if reader == ZIP or (reader is None and Path(source).is_dir()):
        return FolderRows(source, output, table_map, progress)
    if reader is None:
        return TextRows(source, output, table_map, progress)
    if not Path(source).is_dir():
        open_source(source, output).close()
    module = import_module(f"imuarray.importers.{reader}")
    return cast(RecordingRows, module.open_rows(Path(source), progress))
