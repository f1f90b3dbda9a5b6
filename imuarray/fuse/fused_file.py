"""A fused file read back (`imuarray.fuse.store` says what is in it): nothing of it is believed before it is checked.

Columns that this format has not are passed over.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.errors import LogError
from imuarray.fuse.frames import ENTRIES, Floats, FusedBlock
from imuarray.fuse.store import COVARIANCE, FORMAT, FORMAT_VERSION, USED
from imuarray.fuse.stored_events import FusedEvent, events_in
from imuarray.log.column import NamedColumn
from imuarray.log.guard import DAMAGE, open_file
from imuarray.log.inspection import refuse_hostile
from imuarray.log.unclosed import Unclosed, says_unclosed
from imuarray.printable import printable
from imuarray.units import INERTIAL

MOST_SENSORS = 1024
"""Of which a file may tell the use."""


_KINDS = MappingProxyType({"i": "int64", "f": "float", "u": "uint8"})


@dataclass(frozen=True)
class FusedHead:
    """What a fused file says of itself: `log` and `calibration` are the paths it was made from, `sensors` names, per
    quantity, those whose use it tells.
    """

    technique: str
    log: str
    calibration: str
    epoch: str
    frames: int
    sensors: Mapping[str, tuple[str, ...]]


def is_fused(path: Path) -> bool:
    """Whether a file says that it is a fused result; nothing else in it was looked at."""
    with suppress(*DAMAGE), h5py.File(Unclosed(path), "r") as file:
        return bool(file.attrs.get("format") == FORMAT)
    return False


def read_fused_head(path: str | PathLike[str]) -> FusedHead:
    """The head of a file that `write_fused` wrote; LogError for another one, or one built to do harm."""
    with fused_columns(path) as (said, columns):
        sensors = {
            name.removesuffix(USED): texts_of(column.attrs, "sensors")
            for name, column in columns.items()
            if name.endswith(USED)
        }
        technique, log, calibration, epoch = (
            said.get(name, "") for name in ("technique", "log", "calibration", "epoch")
        )
        return FusedHead(technique, log, calibration, epoch, rows_of(columns), sensors)


def read_fused(path: str | PathLike[str], block: int = 1 << 14) -> Iterator[FusedBlock]:
    """The blocks of a file that `write_fused` wrote, `block` frames at a time; LogError for one that is damaged or
    built to do harm.
    """
    with fused_columns(path) as (_, columns):
        frames = rows_of(columns)
        for start in range(0, frames, block):
            rows = slice(start, min(start + block, frames))
            triads: dict[str, Floats] = {
                name: _finite(columns[name][rows], name, path) for name in INERTIAL if name in columns
            }
            yield FusedBlock(
                columns["time"][rows], triads, _parts(columns, COVARIANCE, rows), _parts(columns, USED, rows)
            )


def read_fused_events(path: str | PathLike[str]) -> tuple[FusedEvent, ...]:
    """What became of sensors, in the order in which it was found; none of a file that does not say. LogError."""
    with fused_columns(path) as (_, columns):
        return events_in(columns["time"].file, str(path))


@contextmanager
def fused_columns(path: str | PathLike[str]) -> Iterator[tuple[dict[str, str], dict[str, NamedColumn]]]:
    """The texts of a fused file's head, and its columns by name, `time` first: of the types and shapes that the format
    says. LogError for another file, or one that is damaged or built to do harm.
    """
    with _opened(Path(path)) as file:
        try:
            with h5py.File(Unclosed(Path(path)), "r") as inspected:
                refuse_hostile(file, inspected, str(path))
            said = {name: _text(value) for name, value in file.attrs.items() if isinstance(value, str | bytes)}
            version = file.attrs.get("format_version")
            group = file.get("fused")
            if said.get("format") != FORMAT or not isinstance(group, h5py.Group) or "time" not in group:
                raise LogError(f"{path}: no fused result")
            if version != FORMAT_VERSION:
                raise LogError(f"{path}: format_version is {version!s:.20}; this software reads {FORMAT_VERSION}")
            columns = _checked(group, str(path))
        except DAMAGE as error:
            raise LogError(f"{path}: damaged or malformed: {printable(' '.join(str(error).split()))}") from None
        yield said, columns


def _opened(path: Path) -> h5py.File:
    """The file, be it that it is being written, or that its writing was cut short; LogError."""
    if not path.is_file() or not says_unclosed(path):
        return open_file(path)
    try:
        return h5py.File(Unclosed(path, looks=False), "r")
    except OSError:
        raise LogError(f"{path}: was never closed, and is damaged") from None


def _checked(group: h5py.Group, where: str) -> dict[str, NamedColumn]:
    """The columns of a fused file, each as the format says; LogError."""
    wanted: dict[str, tuple[str, int]] = {"time": ("i", 0)}
    for quantity in INERTIAL:
        wanted |= {quantity: ("f", 3), quantity + COVARIANCE: ("f", len(ENTRIES)), quantity + USED: ("u", -1)}
    found: dict[str, NamedColumn] = {}
    for name, (kind, width) in wanted.items():
        if name not in group:
            continue
        column = group[name]
        place = f"{where}: fused/{name}"
        if not isinstance(column, h5py.Dataset) or column.dtype.kind != kind:
            raise LogError(f"{place}: no column of numbers of type {_KINDS[kind]}")
        shape = column.shape or ()
        tail = (shape[1:] if width < 0 else (width,)) if width else ()
        if len(shape) != (2 if width else 1) or shape[1:] != tail or max(tail, default=0) > MOST_SENSORS:
            raise LogError(f"{place}: its shape is {shape}; wanted is {_wanted(width)}")
        found[name] = NamedColumn(column, place)
    return found


def rows_of(columns: Mapping[str, NamedColumn]) -> int:
    """The frames of which every column tells: a writing that was cut short leaves some of them longer than others."""
    return min(map(len, columns.values()))


def _wanted(width: int) -> str:
    """A shape in words."""
    if width == 0:
        return "(n,)"
    return f"(n, {width})" if width > 0 else f"(n, sensors), at most {MOST_SENSORS} of these"


def _finite(triads: Floats, name: str, path: str | PathLike[str]) -> Floats:
    """Rows in which nothing is infinite; LogError."""
    if np.isinf(triads).any():
        raise LogError(f"{path}: fused/{name}: infinite values; what can't be told is NaN")
    return triads


def _parts(columns: Mapping[str, NamedColumn], suffix: str, rows: slice) -> dict[str, npt.NDArray[Any]]:
    """Rows of the columns with a suffix, by quantity."""
    return {name.removesuffix(suffix): column[rows] for name, column in columns.items() if name.endswith(suffix)}


def texts_of(attributes: Mapping[str, Any], name: str) -> tuple[str, ...]:
    """An attribute that is a list of texts; empty for any other, and where there is none."""
    value = attributes.get(name)
    listed = value.tolist() if isinstance(value, np.ndarray) and value.ndim == 1 else []
    return tuple(map(_text, listed)) if all(isinstance(one, str | bytes) for one in listed) else ()


def _text(value: str | bytes) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
