"""Reads a diagnosis from its JSON (`gap.json`), except its curves and the repaired model."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from math import nan
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from imuarray.errors import LogError
from imuarray.gap.findings import diagnosis as parts
from imuarray.gap.findings.diagnosis import JSON_NAMES, NOT_IN_JSON, Diagnosis

_DEPTH = 12
_HUGE = 1e30
"""Limit of the figures of a diagnosis."""


def diagnosis_of(table: object, where: str = "gap.json") -> Diagnosis:
    """Return the diagnosis of a table that `Diagnosis.as_json` made; numbers that JSON could not represent are nan.
    LogError for anything else.
    """
    hints = get_type_hints(Diagnosis, {**vars(parts), "Model": object})
    if not isinstance(table, Mapping):
        raise LogError(f"{where}: not a diagnosis: it must be an object")
    values: dict[str, Any] = dict(NOT_IN_JSON)
    for item in fields(Diagnosis):
        if item.name in NOT_IN_JSON:
            continue
        key = JSON_NAMES.get(item.name, item.name)
        if key not in table and item.default is not MISSING:
            continue  # files of earlier versions lack it
        if key not in table:
            raise LogError(f"{where}: not a diagnosis: {key} is missing")
        values[item.name] = _read(table[key], hints[item.name], f"{where}: {key}", _DEPTH)
    diagnosis = Diagnosis(**values)
    shape = (len(diagnosis.map.sensors), len(diagnosis.map.domains))
    if diagnosis.map.before.shape != shape or diagnosis.map.after.shape != shape:
        raise LogError(f"{where}: map: its size must be {shape[0]} sensors by {shape[1]} domains")
    return diagnosis


def _read(value: Any, kind: Any, where: str, depth: int) -> Any:
    """Return a value of the type that a field has; LogError if it can't be one."""
    origin, inside = get_origin(kind), get_args(kind)
    if depth == 0:
        raise LogError(f"{where}: nested without end")
    if origin in (Union, types.UnionType):
        option = next(each for each in inside if each is not type(None))
        return None if value is None else _read(value, option, where, depth)
    if is_dataclass(kind):
        return _dataclass(value, kind, where, depth)
    if origin is tuple:
        if not isinstance(value, list) or (inside[-1] is not Ellipsis and len(value) != len(inside)):
            raise LogError(f"{where}: must be a list")
        kinds = [inside[0]] * len(value) if inside[-1] is Ellipsis else inside
        return tuple(_read(item, each, where, depth - 1) for item, each in zip(value, kinds, strict=True))
    if origin is np.ndarray or kind is np.ndarray:
        return _array(value, where)
    if origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            raise LogError(f"{where}: must be an object")
        return {_text(key, where): _read(item, inside[1], where, depth - 1) for key, item in value.items()}
    if kind is Any or kind is object:
        return _anything(value, where, depth)
    return _plain(value, kind, where)


def _dataclass(value: Any, kind: Any, where: str, depth: int) -> Any:
    if not isinstance(value, Mapping):
        raise LogError(f"{where}: must be an object")
    hints = get_type_hints(kind)
    known = [item.name for item in fields(kind) if item.name in value]
    try:
        return kind(**{name: _read(value[name], hints[name], f"{where}.{name}", depth - 1) for name in known})
    except TypeError as error:
        raise LogError(f"{where}: {error}") from None


def _array(value: Any, where: str) -> Any:
    try:
        rows = [[nan if item is None else float(item) for item in row] for row in value]
        table = np.array(rows, float).reshape(len(value), -1)
        if (np.abs(table) >= _HUGE).any():
            raise ValueError("beyond any figure of a diagnosis")
        return table
    except (TypeError, ValueError, OverflowError):
        raise LogError(f"{where}: must be rows of numbers") from None


def _plain(value: Any, kind: Any, where: str) -> Any:
    """Return a text, a number or a flag."""
    if kind is float:
        return nan if value is None else _number(value, where)
    if get_origin(kind) is Literal:
        if value not in get_args(kind):
            raise LogError(f"{where}: {value!r:.40}; allowed are {', '.join(get_args(kind))}")
        return value
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise LogError(f"{where}: {value!r:.40} has the wrong type")
    if kind is int:
        _number(value, where)
    return _text(value, where) if kind is str else value


def _anything(value: Any, where: str, depth: int) -> Any:
    """Return a value of any type, without what a float or a file cannot hold."""
    if depth == 0:
        raise LogError(f"{where}: nested without end")
    if isinstance(value, Mapping):
        return {_text(key, where): _anything(item, where, depth - 1) for key, item in value.items()}
    if isinstance(value, list):
        return [_anything(item, where, depth - 1) for item in value]
    if isinstance(value, str):
        return _text(value, where)
    return value if value is None or isinstance(value, bool) else _number(value, where)


def _number(value: Any, where: str) -> float:
    """Return a number in the allowed range; JSON's integers are unbounded."""
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) >= _HUGE:
        raise LogError(f"{where}: {str(value)[:40]!r} is not a number in the allowed range")
    return value


def _text(value: str, where: str) -> str:
    """Return a text that a file can hold; JSON can encode halves of characters."""
    try:
        value.encode()
    except UnicodeEncodeError:
        raise LogError(f"{where}: {value!r:.40} contains half a character") from None
    return value
