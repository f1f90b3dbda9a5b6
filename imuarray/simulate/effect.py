"""The interface of every effect: a frozen dataclass of parameters, and up to four places in the chain where it acts.

The chain of one sensor, in physical order::

    instants  ->  felt  ->  analog  ->  codes
    when          what      the element's     what the bus
    is sampled    the box   signal, before    delivers
                  feels     the converter

An effect overrides the stages at which it acts; within a stage effects act in the order of `EFFECTS`. An effect made
without arguments does nothing: every default is the parameter's harmless value.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import numpy as np

from imuarray.simulate.signal import Analog, Codes, Felt, Flags, Instants, Place, Triple


def per_axis(default: float = 0.0, *, suffix: str = "", low: float = -np.inf, high: float = np.inf) -> Any:
    """Return a parameter with one value for each axis of the sensor; a single number stands for all three.

    `suffix` is what model files and reports append to its name, "{u}" being the sensor's unit: "_{u}_per_degc". Values
    outside `low` to `high` are refused.
    """
    return field(default=(default,) * 3, metadata={"suffix": suffix, "per_axis": True, "allowed": (low, high)})


def scalar(default: float, *, suffix: str = "", low: float = -np.inf, high: float = np.inf) -> Any:
    """Return a parameter with one value; the arguments are those of `per_axis`."""
    return field(default=default, metadata={"suffix": suffix, "allowed": (low, high)})


UNBOUNDED = (-np.inf, np.inf)

FOREVER_S = 1e9
"""End of a span that has no end."""


@dataclass(frozen=True)
class Effect:
    """A cause of differences between truth and counts.

    It acts always, or only within its `spans`. A span has three numbers: the number of a run, and the beginning and end
    in that run, in seconds of the log's clock.
    """

    name: ClassVar[str] = ""
    meaning: ClassVar[str] = ""
    """What differs, in one clause."""
    spans: tuple[float, ...] = field(default=(), kw_only=True, metadata={"suffix": ""})

    def __post_init__(self) -> None:
        """Expand single numbers to the three axes. ValueError for a value that is not a triple of numbers, for invalid
        spans, and for values outside the limits of a parameter.
        """
        object.__setattr__(self, "spans", _spans(self.spans))
        for item in fields(self):
            name, of_axes = item.name, item.metadata.get("per_axis")
            if of_axes:
                object.__setattr__(self, name, _triple(getattr(self, name), name))
            allowed = item.metadata.get("allowed", UNBOUNDED)
            if allowed != UNBOUNDED:
                value = getattr(self, name)
                for number in (min(value), max(value)) if of_axes else (value,):
                    require(name, number, *allowed)

    def each_span(self) -> Iterator[tuple[float, float, float]]:
        """Return run, beginning and end of each span."""
        return zip(self.spans[::3], self.spans[1::3], self.spans[2::3], strict=True)

    def active_axes(self) -> tuple[bool, ...]:
        """Return (3,) on which axes the effect acts, by its parameters per axis; False for all axes if it has no such
        parameters.
        """
        axis_fields = [item for item in fields(self) if item.metadata.get("per_axis")]
        idle = type(self)()
        return tuple(
            any(getattr(self, item.name)[axis] != getattr(idle, item.name)[axis] for item in axis_fields)
            for axis in range(3)
        )

    def lookback(self, at: Place) -> int:
        """Return the number of rows before a stretch that the effect needs to evaluate the stretch."""
        return 0

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Return when rows are read, and which of them arrive."""
        return instants

    def flagged(self, status: Flags, instants: Instants, at: Place) -> Flags:
        """Return the logger's flags: (n,) flags of the rows."""
        return status

    def felt(self, felt: Felt, at: Place) -> Felt:
        """Return the stimulus at the sensor's place."""
        return felt

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


def _triple(value: Any, name: str) -> Triple:
    values = np.broadcast_to(np.asarray(value, float), (3,)) if np.size(value) in (1, 3) else np.array([np.nan])
    if np.isnan(values).any():
        raise ValueError(f"{name}: {value}; a number or one for each of x, y, z is required")
    x, y, z = values.tolist()
    return x, y, z


def require(name: str, value: float, low: float = -np.inf, high: float = np.inf) -> None:
    """Raise ValueError unless `value` lies in [low, high]."""
    if not low <= value <= high:
        raise ValueError(f"{name}: {value}; allowed is {low:g} to {high:g}")
