"""Recordings made by other programs, turned into logs: known formats by name, any table of numbers by a map.

Counts stay as the source holds them; nothing is resampled, filled in or repeated. Formats of one instrument are entries
of `FORMATS`; everything that is a table needs no code but a map (`imuarray.importers.mapping`). What is doubtful in a
recording is said of the log that was made of it (`imuarray.importers.plausibility`).
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

FORMATS: Mapping[str, str] = MappingProxyType({"mimu4444": "imuarray.importers.mimu4444"})
"""Every format that has a name; the module (loaded when it is asked for) holds its importer as `import_file`."""

NO_WALL_TIME = "1970-01-01T00:00:00.000000Z"
"""Epoch of a log whose source names no wall time; such a log says so in an event of kind "imported"."""

_GZIP = b"\x1f\x8b"
"""First bytes of what gzip has packed (RFC 1952)."""


@dataclass(frozen=True)
class Summary:
    """What an import wrote: `rows` of each sensor over `seconds`; `lost` rows that the source shows to be missing
    (None: it numbers nothing, so nobody knows); how often each kind of event happened. Without `same_rows`, `rows` are
    those of the sensor that has most. `remarks` say what the importer left out, learnt or changed.
    """

    sensors: tuple[str, ...]
    rows: int
    lost: int | None
    seconds: float
    events: Mapping[str, int] = field(default_factory=dict)
    same_rows: bool = True
    remarks: tuple[str, ...] = ()


class Importer(Protocol):
    """Reads `source` and writes the log `output`; `progress` is told how many bytes of the source are done.

    Raises SourceError, OutputExistsError, LogError; leaves no half-written log behind.
    """

    def __call__(
        self,
        source: str | PathLike[str],
        output: str | PathLike[str],
        *,
        force: bool = False,
        progress: Callable[[int], None] = lambda done: None,
    ) -> Summary:
        """Import `source` into `output`."""


def importer(name: str) -> Importer:
    """The importer of the format called `name`; KeyError unless it is one of `FORMATS`."""
    return cast(Importer, import_module(FORMATS[name]).import_file)


def open_source(source: str | PathLike[str], output: str | PathLike[str]) -> BinaryIO:
    """Open a recording for reading; SourceError if it can't be, or if the log would replace it."""
    path = Path(source)
    if path.is_dir():
        raise SourceError(f"{path}: is a folder; a recording is one file")
    try:
        file = path.open("rb")
    except OSError as error:
        raise unreadable(path, error) from None
    if Path(output).exists() and Path(output).samefile(path):
        file.close()
        raise SourceError(f"{path}: is the output too; a log never replaces what it was made from")
    return file


def unpacked(file: BinaryIO) -> BinaryIO:
    """An open file, or what is in it if gzip (RFC 1952) has packed it."""
    begin = file.read(len(_GZIP))
    file.seek(0)
    return cast(BinaryIO, gzip.GzipFile(fileobj=file)) if begin == _GZIP else file


def unreadable(path: Path, error: OSError) -> SourceError:
    """What there is to say of a recording that can't be opened or read."""
    return SourceError(f"{path}: {'no such file' if isinstance(error, FileNotFoundError) else error.strerror}")
