"""Importers turn recordings of other programs into logs: known formats by name, any table of numbers with a map.

Counts remain as in the source; nothing is resampled, interpolated or repeated. Formats of a single instrument are
entries of `FORMATS`; other tables are imported with a map (`imuarray.importers.mapping`) and without further code.
Doubts about a recording are reported from the log that was imported (`imuarray.importers.plausibility`).
"""

from __future__ import annotations

import gzip
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO, Protocol, cast

from imuarray.errors import SourceError
from imuarray.export.formats import CSV_MAGIC, CSV_VERSION
from imuarray.spelling import guess_file

FORMATS: Mapping[str, str] = MappingProxyType({"mimu4444": "imuarray.importers.mimu4444"})
"""The named formats and the module of each, which is loaded on demand; its importer is `import_file`."""

NO_WALL_TIME = "1970-01-01T00:00:00.000000Z"
"""Epoch of a log from a source without wall time; an event of kind "imported" in the log states this."""

_GZIP = b"\x1f\x8b"
"""First bytes of a gzip file (RFC 1952)."""

CSV_HEAD = f'{{"{CSV_VERSION}": '.encode()
"""First bytes of the JSON file that accompanies CSV files."""

_CSV = "imuarray.importers.exported_csv"
MAGICS: Mapping[bytes, str] = MappingProxyType(
    {b"PK\x03\x04": "imuarray.importers.exported_npz", CSV_MAGIC.encode(): _CSV, CSV_HEAD: _CSV}
)
"""First bytes of a file, and the module that reads it."""


@dataclass(frozen=True)
class ImportSummary:
    """The result of an import: `rows` of each sensor over `seconds`; `lost` is the number of missing rows according to
    the source (None if it does not number its rows); the number of events of each kind. Without `same_rows`, `rows` is
    that of the sensor with the most rows. `remarks` are sentences on what the importer left out, inferred or changed,
    `doubts` those on guesses of the map that the recording does not confirm.
    """

    sensors: tuple[str, ...]
    rows: int
    lost: int | None
    seconds: float
    events: Mapping[str, int] = field(default_factory=dict)
    same_rows: bool = True
    remarks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


class Importer(Protocol):
    """Reads `source` and writes the log `output`; `progress` receives the number of bytes read.

    Raises SourceError, OutputExistsError, LogError; leaves no incomplete log behind.
    """

    def __call__(
        self,
        source: str | PathLike[str],
        output: str | PathLike[str],
        *,
        force: bool = False,
        progress: Callable[[int], None] = lambda done: None,
    ) -> ImportSummary:
        """Import `source` into `output`."""


def importer(name: str) -> Importer:
    """Return the importer of the format `name`; KeyError unless it is one of `FORMATS`."""
    return cast(Importer, import_module(FORMATS[name]).import_file)


def importer_of(source: str | PathLike[str]) -> Importer | None:
    """Return the importer of a file that `imuarray export` wrote, or None; SourceError if the file is unreadable."""
    path = Path(source)
    first = [_first_bytes(path)]
    described = path.with_suffix(".json")
    if path.suffix.lower() == ".csv" and described.is_file():
        first.append(_first_bytes(described))
    if first[0].startswith(b"PAR1"):
        parquet = import_module("imuarray.importers.exported_parquet")
        return cast(Importer, parquet.import_file) if parquet.is_exported(path) else None
    for magic, module in MAGICS.items():
        if any(begin.startswith(magic) for begin in first):
            return cast(Importer, import_module(module).import_file)
    return None


def _first_bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(max(map(len, MAGICS)))
    except OSError as error:
        raise unreadable(path, error) from None


def open_source(source: str | PathLike[str], output: str | PathLike[str]) -> BinaryIO:
    """Open a recording for reading; SourceError if it is unreadable, or if the log would replace it."""
    path = Path(source)
    if path.is_dir():
        raise SourceError(f"{path}: is a folder; a recording is one file")
    try:
        file = path.open("rb")
    except OSError as error:
        raise unreadable(path, error) from None
    if Path(output).exists() and Path(output).samefile(path):
        file.close()
        raise SourceError(f"{path}: is also the output; a log never replaces its source")
    return file


def decompress(file: BinaryIO) -> BinaryIO:
    """Return an open file, or its decompressed content if it is a gzip file (RFC 1952)."""
    begin = file.read(len(_GZIP))
    file.seek(0)
    return cast(BinaryIO, gzip.GzipFile(fileobj=file)) if begin == _GZIP else file


def unreadable(path: Path, error: OSError) -> SourceError:
    """Return the error of a recording that cannot be opened or read."""
    near = guess_file(path)
    return SourceError(f"{path}: {f'no such file{near}' if isinstance(error, FileNotFoundError) else error.strerror}")
