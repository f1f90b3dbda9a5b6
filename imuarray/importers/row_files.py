"""A folder with a text for each row, as in the KITTI data set for the readings of its inertial unit:
`data/0000000000.txt`, ..., the times in `timestamps.txt`, and the meaning of the values in `dataformat.txt`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from imuarray.errors import SourceError
from imuarray.importers.cells import Blocks, CellBlock

FEWEST_FILES = 16
"""Fewest numbered files that are rows of a recording."""

TIME = "timestamp"
"""Name of the column of times."""

_NUMBERED = re.compile(r"\d+\.txt")
_DESCRIBED = re.compile(r"(?P<name>[A-Za-z]\w*):\s+(?P<words>.*)")
_UNIT = re.compile(r"\((m/s\^2|rad/s|m/s|rad|deg|m)\)")

_OXTS = (
    "lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu", "ax", "ay", "az", "af", "al", "au",
    "wx", "wy", "wz", "wf", "wl", "wu", "pos_accuracy", "vel_accuracy", "navstat", "numsats", "posmode", "velmode",
    "orimode",
)  # fmt: skip
"""The thirty values of a row of KITTI (Geiger et al. 2013, table 2), for a folder without their description."""
_OXTS_UNITS = {"a": "m/s^2", "w": "rad/s"}


def folder_of_rows(path: Path) -> Path | None:
    """Return the folder with the numbered files in or below `path`; None without one."""
    for folder in (path, path / "data", path / "oxts" / "data"):
        if folder.is_dir() and len(_files(folder, FEWEST_FILES)) == FEWEST_FILES:
            return folder
    return None


def _files(folder: Path, most: int | None = None) -> list[Path]:
    """Return the numbered files of a folder, in order; `most` of them, in any order."""
    files: list[Path] = []
    for path in folder.iterdir():
        if _NUMBERED.fullmatch(path.name):
            files.append(path)
            if len(files) == most:
                return files
    return sorted(files, key=lambda path: int(path.stem))


def open_rows(path: Path, progress: Callable[[int], None]) -> FileRows:
    """Open the rows in a folder; SourceError."""
    return FileRows(path, progress)


class FileRows:
    """The rows of a folder with a text for each row."""

    def __init__(self, path: Path, progress: Callable[[int], None]) -> None:
        self._path, self._progress = path, progress
        folder = folder_of_rows(path) or path
        self._files = _files(folder)
        self.remarks: list[str] = []
        first = _cells(self._files[0])
        described = _find_file(folder, "dataformat.txt")
        self._names = [] if described is None else _read_description(described)
        if len(self._names) != len(first):
            self._names = _value_names(len(first))
        stamps = _find_file(folder, "timestamps.txt")
        self._stamps = None if stamps is None else _lines(stamps)
        if self._stamps is not None and len(self._stamps) != len(self._files):
            count = len(self._files)
            raise SourceError(
                f"{stamps}: {len(self._stamps)} times; allowed is one for each of {count} files in {folder}"
            )

    def names(self) -> Mapping[str, Sequence[str]]:
        """Return the names of the values in a row."""
        return {"": [*([TIME] if self._stamps is not None else []), *self._names]}

    def blocks(self, columns: Sequence[str | int], kind: str | None, rows: int) -> Blocks:
        """Yield the rows in the order of their numbers; SourceError for a row with another number of values."""
        names = self.names()[""]
        places = []
        for column in columns:
            if column not in names:
                raise SourceError(f"{self._path}: no column {column!r}; it has {', '.join(names)}")
            places.append(names.index(str(column)))
        for start in range(0, len(self._files), rows):
            files = self._files[start : start + rows]
            cells = []
            for number, file in enumerate(files, start=start):
                row = _cells(file)
                if len(row) != len(self._names):
                    raise SourceError(f"{file}: {len(row)} values, the first file has {len(self._names)}")
                cells.append([*([self._stamps[number]] if self._stamps is not None else []), *row])
            lines = range(start, start + len(files))
            yield CellBlock(str(self._path), lines, list(zip(*cells, strict=True))), places


def _find_file(folder: Path, name: str) -> Path | None:
    """Return a file in a folder or in its parent; None if neither has it."""
    return next((place / name for place in (folder, folder.parent) if (place / name).is_file()), None)


def _lines(path: Path) -> list[str]:
    try:
        return [line for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(f"{path}: cannot be read: {error}") from None


def _cells(path: Path) -> list[str]:
    lines = _lines(path)
    if len(lines) != 1:
        raise SourceError(f"{path}: {len(lines)} lines; allowed is one row of values")
    return lines[0].replace(",", " ").split()


def _read_description(path: Path) -> list[str]:
    """Return the names of values, with their units in brackets, from a description file."""
    names = []
    for line in _lines(path):
        if (match := _DESCRIBED.match(line.strip())) is not None:
            unit = _UNIT.search(match["words"])
            names.append(match["name"] + (f" [{unit[1]}]" if unit else ""))
    return names


def _value_names(width: int) -> list[str]:
    if width != len(_OXTS):
        return [f"value[{at}]" for at in range(width)]
    return [f"{name} [{_OXTS_UNITS[name[0]]}]" if len(name) == 2 and name[0] in _OXTS_UNITS else name for name in _OXTS]
