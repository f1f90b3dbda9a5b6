"""The interface of every effect: a frozen dataclass of parameters, and up to four places in the chain where it acts.

The chain of one sensor, in physical order::

    instants  ->  stimulus  ->  analog  ->  codes
    times of      force,    the element's     codes on
    the readings  rate,     signal, before    the bus
                  field     the converter

An effect overrides the stages at which it acts; within a stage effects act in the order of `EFFECTS`. An effect made
without arguments does nothing: every default is the parameter's harmless value.

In model files and reports an effect is a table whose keys carry the units of its parameters (`to_table`).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import Field, dataclass, field, fields
from typing import Any, ClassVar, TypeVar

import numpy as np

from imuarray.errors import ConfigError
from imuarray.simulate.signal import Analog, BoxStimulus, Codes, Flags, Instants, Place, Triple
from imuarray.spelling import closest


def per_axis(default: float = 0.0, *, suffix: str = "", low: float = -np.inf, high: float = np.inf) -> Any:
    """Return a parameter with one value for each axis of the sensor; a single number stands for all three.

    `suffix` is what model files and reports append to its name, "{u}" being the sensor's unit: "_{u}_per_degc". Values
    outside `low` to `high` are refused.
    """
    return field(default=(default,) * 3, metadata={"suffix": suffix, "per_axis": True, "allowed": (low, high)})


def scalar(default: float, *, suffix: str = "", low: float = -np.inf, high: float = np.inf) -> Any:
    """Return a parameter with one value; the arguments are those of `per_axis`."""
    return field(default=default, metadata={"suffix": suffix, "allowed": (low, high)})


def choice(default: float | str, choices: tuple[float, ...] | tuple[str, ...]) -> Any:
    """Return a parameter with one of these values."""
    return field(default=default, metadata={"choices": choices})


def several(count: int, *, suffix: str = "", low: float = -np.inf, high: float = np.inf) -> Any:
    """Return a parameter of `count` finite numbers, by default all zero."""
    return field(default=(0.0,) * count, metadata={"suffix": suffix, "allowed": (low, high)})


def listed(*, suffix: str = "") -> Any:
    """Return a parameter of any number of numbers, by default none."""
    return field(default=(), metadata={"suffix": suffix})


UNBOUNDED = (-np.inf, np.inf)

FOREVER_S = 1e9
"""End of a span that has no end."""


@dataclass(frozen=True)
class Effect:
    """A cause of differences between truth and counts.

    It always acts, or only within its `spans`. A span has three numbers: the number of a run, and the beginning and end
    in that run, in seconds of the log's clock.
    """

    name: ClassVar[str] = ""
    meaning: ClassVar[str] = ""
    """What differs, in one clause."""
    spans: tuple[float, ...] = field(default=(), kw_only=True, metadata={"suffix": ""})

    def __post_init__(self) -> None:
        """Expand single numbers to the three axes, and make lists tuples of floats. ValueError for a value with another
        number of numbers than the parameter has, for invalid spans, and for values that the parameter does not allow.
        """
        object.__setattr__(self, "spans", _spans(self.spans))
        for item in fields(self):
            name, value = item.name, getattr(self, item.name)
            if isinstance(item.default, tuple) and name != "spans":
                value = _tuple(name, value, item)
                object.__setattr__(self, name, value)
            allowed = item.metadata.get("allowed", UNBOUNDED)
            if allowed != UNBOUNDED:
                for number in (min(value), max(value)) if isinstance(value, tuple) else (value,):
                    require(name, number, *allowed)
            if value not in item.metadata.get("choices", (value,)):
                raise ValueError(f"{name}: {_choice_text(value, item.metadata['choices'])}")

    def check_events(self, first: str, *others: str) -> None:
        """Raise ValueError unless these lists, which have one number for each event, have equal lengths and all numbers
        are finite and not negative.
        """
        count = len(getattr(self, first))
        for name in (first, *others):
            values = getattr(self, name)
            if len(values) != count:
                raise ValueError(f"{name}: {len(values)}; as many as {first}, {count}, are required")
            for value in values:
                require(name, value, 0.0, sys.float_info.max)

    def each_span(self) -> Iterator[tuple[float, float, float]]:
        """Yield run, beginning and end of each span."""
        return zip(self.spans[::3], self.spans[1::3], self.spans[2::3], strict=True)

    def active_axes(self) -> tuple[bool, ...]:
        """Return (3,) on which axes the effect acts, by its parameters per axis; False for all axes if it has none."""
        axis_fields = [item for item in fields(self) if item.metadata.get("per_axis")]
        idle = type(self)()
        return tuple(
            any(getattr(self, item.name)[axis] != getattr(idle, item.name)[axis] for item in axis_fields)
            for axis in range(3)
        )

    def lookback(self, at: Place) -> int:
        """Return the number of rows before a stretch that the effect needs to evaluate the stretch: any stretch can be
        simulated alone, so an effect with a memory must not depend on earlier rows than these.
        """
        return 0

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Return the instants at which rows are read, and which rows arrive."""
        return instants

    def flagged(self, status: Flags, instants: Instants, at: Place) -> Flags:
        """Return the flags (n,) that the logger sets in these rows."""
        return status

    def stimulus(self, stimulus: BoxStimulus, at: Place) -> BoxStimulus:
        """Return the stimulus at the sensor's place."""
        return stimulus

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Return the element's signal and the converter's settings."""
        return analog

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Return the codes that the bus delivers."""
        return codes


def _spans(values: Any) -> tuple[float, ...]:
    spans = tuple(float(value) for value in values)
    if len(spans) % 3 or any(not begin < end for begin, end in zip(spans[1::3], spans[2::3], strict=True)):
        raise ValueError(f"spans: {values}; three numbers each are required: a run, from when, and until when, in s")
    return spans


def _tuple(name: str, value: Any, item: Field[Any]) -> tuple[float, ...]:
    """Return a parameter of several numbers as floats; ValueError unless there are as many as it requires."""
    if item.metadata.get("per_axis"):
        triple = _triple(value, name)
        if np.isinf(triple).any() and isinstance(item.default, tuple) and np.inf not in item.default:
            raise ValueError(f"{name}: {value}; finite numbers are required")
        return triple
    count = len(item.default) if isinstance(item.default, tuple) else 0
    return numbers(name, value, count) if count else tuple(float(number) for number in value)


def _choice_text(value: float | str, choices: tuple[Any, ...]) -> str:
    if isinstance(value, str):
        return f"{value!r}; allowed are {', '.join(choices)}"
    return f"{value:g}; allowed are {' and '.join(f'{allowed:g}' for allowed in choices)}"


def _triple(value: Any, name: str) -> Triple:
    if type(value) is tuple and len(value) == 3 and all(type(number) is float and number == number for number in value):
        return value  # as usual: the general way takes ten times as long
    values = np.broadcast_to(np.asarray(value, float), (3,)) if np.size(value) in (1, 3) else np.array([np.nan])
    if np.isnan(values).any():
        raise ValueError(f"{name}: {value}; a number or one for each of x, y, z is required")
    x, y, z = values.tolist()
    return x, y, z


def require(name: str, value: float, low: float = -np.inf, high: float = np.inf) -> None:
    """Raise ValueError unless `value` lies in [low, high]."""
    if not low <= value <= high:
        raise ValueError(f"{name}: {value}; allowed is {low:g} to {high:g}")


Value = float | list[float] | str
SomeEffect = TypeVar("SomeEffect", bound=Effect)


def numbers(name: str, values: Any, count: int) -> tuple[float, ...]:
    """Return `values` as `count` floats; ValueError unless they are `count` finite numbers."""
    array = np.asarray(values, float)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ValueError(f"{name}: {values}; {count} finite numbers are required")
    return tuple(array.tolist())


def spelled(kind: type[Effect], unit: str) -> dict[str, Field[Any]]:
    """Return the keys of an effect's table for a sensor of this unit, in order: "offset_dps" for the field `offset`.
    The keys that all effects have in common are last.
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


def _plain(value: Any, item: Field[Any]) -> Value:
    if isinstance(value, tuple):
        return value[0] if item.metadata.get("per_axis") and len(set(value)) == 1 else list(value)
    return value if isinstance(value, str) else float(value)


def _same(value: Any, default: Any) -> bool:
    """Return whether two values are equal, or both nan."""
    return bool(value == default or (value != value and default != default))


def _complaint(value: object, item: Field[Any]) -> str:
    """Return the text that states what is required instead of `value`; "" if `value` is valid."""
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
    """Return an effect's error text "rms: ..." with the parameter's name replaced by the key of the file."""
    parameter, colon, rest = complaint.partition(":")
    return next((key for key, item in known.items() if item.name == parameter), parameter) + colon + rest
