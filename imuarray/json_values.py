"""Conversion of values to those of JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

_PLAIN = frozenset((int, str, bool, type(None)))
_REAL = frozenset((float,))


def json_value(value: Any) -> Any:
    """Return dictionaries, lists, numbers and texts for dataclasses, mappings, sequences and arrays; None for numbers
    that are not finite, which JSON lacks.
    """
    kind = type(value)
    if kind in _PLAIN:
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if kind is dict:
        return {name: json_value(item) for name, item in value.items()}
    if kind is list or kind is tuple:
        return _json_list(value)
    if is_dataclass(value):
        return {item.name: json_value(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {name: json_value(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return _json_list(value)
    if hasattr(value, "tolist"):  # arrays and scalars of NumPy, which is not imported for values without them
        return json_value(value.tolist())
    return value


def _json_list(values: list[Any] | tuple[Any, ...]) -> list[Any]:
    """Return the list of a sequence. Long series of numbers are copied without a call for each of them."""
    kinds = set(map(type, values))
    if kinds <= _PLAIN or (kinds == _REAL and all(map(math.isfinite, values))):
        return list(values)
    return [json_value(item) for item in values]
