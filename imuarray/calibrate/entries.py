"""Tables of the calibration file: written from dataclasses, read back field by field.

A reader takes a value of the file with its place in it, and returns the value or raises a CalibrationError. The type of
each field of a dataclass is annotated with its reader. Fields without a default are required keys.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import numpy as np

from imuarray.arrays import Floats
from imuarray.errors import CalibrationError
from imuarray.toml_files import Place


@dataclass(frozen=True)
class EntryPlace:
    """The place of a value in a calibration file; its text is file, line and place: "cal.toml:7: sensor 1: unit"."""

    path: str
    lines: Mapping[Place, int]
    place: Place
    words: str

    def key(self, name: str) -> EntryPlace:
        """Return the place of a key in the table at this place."""
        return replace(self, place=(*self.place, name), words=f"{self.words}: {name}")

    def entry(self, number: int) -> EntryPlace:
        """Return the place of an entry, counted from 1, of the list at this place."""
        return replace(self, place=(*self.place, number - 1), words=f"{self.words} {number}")

    def __str__(self) -> str:
        around = (self.place[:length] for length in range(len(self.place), 0, -1))
        line = next((self.lines[place] for place in around if place in self.lines), 0)
        return f"{self.path}{f':{line}' if line else ''}: {self.words}"


Reader = Callable[[object, EntryPlace], object]
T = TypeVar("T")

_HUGE = 1e6
_BEYOND = 1e30
_NOTHING = 1e-60
"""Smaller magnitudes are read as zero: their square underflows, and later steps would divide by it."""
_ASYMMETRY = 1e-6
"""Rounding of a covariance to nine digits: deviation from symmetric and non-negative, relative to the largest entry."""


def to_table(record: object) -> dict[str, Any]:
    """Return a dataclass as a table without fields that are None or empty; arrays have nine digits."""
    if not is_dataclass(record):
        raise TypeError(f"{type(record).__name__} is not a dataclass")
    values = {item.name: getattr(record, item.name) for item in fields(record)}
    return {
        key: _plain(value)
        for key, value in values.items()
        if not (value is None or (isinstance(value, Mapping | tuple) and not value))
    }


def _plain(value: object) -> object:
    """Convert to the types of TOML: numbers, texts, lists, tables."""
    if isinstance(value, np.ndarray):
        return [_plain(item) for item in value] if value.ndim else float(f"{value:.9g}")
    if isinstance(value, np.floating):
        return float(f"{value:.9g}")
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return to_table(value) if is_dataclass(value) else value


def read_table(entry: object, where: EntryPlace, kind: type[T]) -> T:
    """Read a `kind` from a table; CalibrationError names a key that is missing, unknown or has an invalid value."""
    required = [item.name for item in fields(kind) if item.default is MISSING and item.default_factory is MISSING]  # type: ignore[arg-type]
    if not isinstance(entry, dict) or not set(required) <= set(entry):
        raise CalibrationError(f"{where}: a table is required with {', '.join(required)}")
    readers = _readers(kind)
    if unknown := set(entry) - set(readers):
        place = where.key(sorted(unknown)[0])
        raise CalibrationError(f"{place}: unknown key; allowed are {', '.join(sorted(readers))}")
    return kind(**{key: readers[key](value, where.key(key)) for key, value in entry.items()})


def _readers(kind: type) -> Mapping[str, Reader]:
    """Return the reader of each field of a dataclass, from the annotation of the field's type or of a part of it."""
    readers: dict[str, Reader] = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        readers[name] = next(part.__metadata__[0] for part in (hint, *get_args(hint)) if hasattr(part, "__metadata__"))
    return readers


def table(kind: type[T]) -> Reader:
    """Return a reader of one table."""
    return lambda value, where: read_table(value, where, kind)


def tables(kind: type[T]) -> Reader:
    """Return a reader of an array of tables, into a tuple."""

    def read(value: object, where: EntryPlace) -> tuple[T, ...]:
        return tuple(read_table(entry, where.entry(i), kind) for i, entry in enumerate(_list(value, where), 1))

    return read


def named_tables(kind: type[T], allowed: tuple[str, ...]) -> Reader:
    """Return a reader of a table of tables whose names are among `allowed`."""

    def read(value: object, where: EntryPlace) -> dict[str, T]:
        if not isinstance(value, dict) or not set(value) <= set(allowed):
            raise CalibrationError(f"{where}: tables called {', '.join(allowed)} are required")
        return {name: read_table(entry, where.key(name), kind) for name, entry in value.items()}

    return read


def numbers(*shape: int, lowest: float = -np.inf, highest: float = np.inf, unknown: bool = False) -> Reader:
    """Return a reader of an array of numbers from `lowest` to `highest`; nan (not known) is allowed if `unknown` is
    true.
    """

    def read(value: object, where: EntryPlace) -> Floats:
        array = _array(value, shape)
        if array is None or not (np.isfinite(array) | (unknown & np.isnan(array))).all():
            raise CalibrationError(f"{where} must have {' x '.join(map(str, shape))} finite numbers")
        if (array < lowest).any() or (array > highest).any():
            way = f"below {lowest:g}" if (array < lowest).any() else f"above {highest:g}"
            raise CalibrationError(f"{where} is {way}")
        return np.where(np.abs(array) < _NOTHING, 0.0, array)

    return read


def _array(value: object, shape: tuple[int, ...]) -> Floats | None:
    """Convert nested lists to an array; None if they have another shape or contain anything but numbers."""
    if not shape:
        return np.array(float(value)) if _is_number(value) else None  # type: ignore[arg-type]
    if not isinstance(value, list) or len(value) != shape[0]:
        return None
    rows = [_array(item, shape[1:]) for item in value]
    return None if any(row is None for row in rows) else np.array(rows, float)


def _is_number(value: object) -> bool:
    """Return whether a value is a number with a fourth power that does not overflow."""
    return isinstance(value, int | float) and not isinstance(value, bool) and (value != value or abs(value) < _BEYOND)


def covariance(size: int) -> Reader:
    """Return a reader of a covariance (size, size): symmetric, no negative variance in any direction."""

    def read(value: object, where: EntryPlace) -> Floats:
        matrix = np.asarray(numbers(size, size)(value, where))
        slack = _ASYMMETRY * float(np.abs(matrix).max())
        if np.abs(matrix - matrix.T).max() > slack or np.linalg.eigvalsh(matrix).min() < -slack:
            raise CalibrationError(f"{where} is not a covariance matrix: not symmetric, or a variance is negative")
        return matrix

    return read


def number(lowest: float = -_HUGE, highest: float = _HUGE) -> Reader:
    """Return a reader of one number from `lowest` to `highest`, which is not converted."""

    def read(value: object, where: EntryPlace) -> object:
        if not (_is_number(value) and lowest <= value <= highest):  # type: ignore[operator]
            raise CalibrationError(f"{where} is not a plausible number for a sensor")
        return value

    return read


def whole(value: object, where: EntryPlace) -> int:
    """Return a reader of a whole number from 0 to a million."""
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= _HUGE:
        raise CalibrationError(f"{where}: a whole number is required")
    return value


def text(*allowed: str, empty: bool = False) -> Reader:
    """Return a reader of a text, one of `allowed` if any are named."""

    def read(value: object, where: EntryPlace) -> str:
        if not isinstance(value, str) or not (value or empty) or (allowed and value not in allowed):
            choice = f"; allowed are {', '.join(allowed)}" if allowed else "; a text is required"
            raise CalibrationError(f"{where}: {value!r:.40}{choice}")
        return value

    return read


def several(reader: Reader, count: int | None = None) -> Reader:
    """Return a reader of a list, into a tuple, of `count` entries unless that is None."""

    def read(value: object, where: EntryPlace) -> tuple[object, ...]:
        entries = _list(value, where)
        if count not in (None, len(entries)):
            raise CalibrationError(f"{where}: {count} entries are required")
        return tuple(reader(entry, where) for entry in entries)

    return read


def _list(value: object, where: EntryPlace) -> list[object]:
    if not isinstance(value, list):
        raise CalibrationError(f"{where}: a list is required")
    return value


Triple = Annotated[Floats, numbers(3)]
"""Three numbers, one for each axis of a sensor."""
Sizes = Annotated[Floats, numbers(3, lowest=0.0)]
"""The same, none negative: standard errors and deviations."""
Matrix = Annotated[Floats, numbers(3, 3)]
"""Three rows of three numbers."""
Number = Annotated[float, number()]
Text = Annotated[str, text()]
