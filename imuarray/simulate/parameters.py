"""Parameters of effects in model files and reports: keys that carry their units, plain numbers and texts as values."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import Field, field, fields
from typing import Any, TypeVar

import numpy as np

from imuarray.errors import ConfigError
from imuarray.simulate.effect import Effect, require
from imuarray.spelling import closest

Value = float | list[float] | str
SomeEffect = TypeVar("SomeEffect", bound=Effect)


def several(count: int, *, suffix: str = "") -> Any:
    """Return a parameter of `count` numbers, by default all zero; its effect passes it through `numbers`."""
    return field(default=(0.0,) * count, metadata={"suffix": suffix})


def listed(*, suffix: str = "") -> Any:
    """Return a parameter of any number of numbers, by default none."""
    return field(default=(), metadata={"suffix": suffix})


def numbers(name: str, values: Any, count: int) -> tuple[float, ...]:
    """Return `values` as `count` floats; ValueError unless they are `count` finite numbers."""
    array = np.asarray(values, float)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ValueError(f"{name}: {values}; {count} finite numbers are required")
    return tuple(array.tolist())


def alongside(**lists: Any) -> dict[str, tuple[float, ...]]:
    """Return lists that have a number for every event, as floats; ValueError unless they are equally long, finite and
    not negative.
    """
    (first, first_values), *_ = lists.items()
    return {name: _of_events(name, values, first, len(first_values)) for name, values in lists.items()}


def spelled(kind: type[Effect], unit: str) -> dict[str, Field[Any]]:
    """Return the keys of an effect's table for a sensor of this unit, in order: "offset_dps" for the field `offset`.
    Keys that all effects have are last.
    """
    ordered = sorted(fields(kind), key=lambda item: item.name == "spans")
    return {item.name + item.metadata.get("suffix", "").format(u=unit): item for item in ordered}


def to_table(effect: Effect, unit: str) -> dict[str, Value]:
    """Return every parameter that differs from its default; three equal numbers, one for each axis, become one."""
    entries = ((key, item, getattr(effect, item.name)) for key, item in spelled(type(effect), unit).items())
    return {key: _plain(value, item) for key, item, value in entries if not _same(value, item.default)}


def from_table(kind: type[SomeEffect], table: Mapping[str, object], unit: str, where: str) -> SomeEffect:
    """Return the effect that a table describes; ConfigError names `where`, the key and what is allowed."""
    keys = spelled(kind, unit)
    arguments: dict[str, Any] = {}
    for key, value in table.items():
        if key not in keys:
            raise ConfigError(f"{where}: {_unknown(key, list(keys))}")
        if complaint := _complaint(value, keys[key]):
            raise ConfigError(f"{where}: {key}: {value!r:.40}: {complaint} is required")
        arguments[keys[key].name] = value
    try:
        return kind(**arguments)
    except ValueError as error:
        raise ConfigError(f"{where}: {_respell(str(error), keys)}") from None


def _of_events(name: str, values: Any, first: str, count: int) -> tuple[float, ...]:
    numbers_ = tuple(float(value) for value in values)
    if len(numbers_) != count:
        raise ValueError(f"{name}: {len(numbers_)}; as many as {first}, {count}, are required")
    for value in numbers_:
        require(name, value, 0.0, sys.float_info.max)
    return numbers_


def _plain(value: Any, item: Field[Any]) -> Value:
    if isinstance(value, tuple):
        return value[0] if item.metadata.get("per_axis") and len(set(value)) == 1 else list(value)
    return value if isinstance(value, str) else float(value)


def _same(value: Any, default: Any) -> bool:
    """Return whether two values are equal, or both nan."""
    return bool(value == default or (value != value and default != default))


def _complaint(value: object, item: Field[Any]) -> str:
    """Return what is required instead of `value`; "" if it is valid."""
    if isinstance(item.default, str):
        return "" if isinstance(value, str) else "a text in quotes"
    if not isinstance(item.default, tuple):
        return "" if _is_number(value) else "a number without quotes"
    count, single = len(item.default), bool(item.metadata.get("per_axis"))
    is_list = isinstance(value, list | tuple) and count in (0, len(value)) and all(map(_is_number, value))
    if is_list or (single and _is_number(value)):
        return ""
    if not count:
        return "a list of numbers"
    return f"a number, or a list of {count}," if single else f"a list of {count} numbers"


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _unknown(key: str, allowed: list[str]) -> str:
    near = closest(key, allowed, cutoff=0.5)
    guess = f" (did you mean {near!r}?)" if near else ""
    return f"{key}: unknown key{guess}; allowed are {', '.join(allowed)}"


def _respell(complaint: str, known: Mapping[str, Field[Any]]) -> str:
    """Return an effect's complaint "rms: ..." with the key of the file instead of the name of the parameter."""
    parameter, colon, rest = complaint.partition(":")
    return next((key for key, item in known.items() if item.name == parameter), parameter) + colon + rest
