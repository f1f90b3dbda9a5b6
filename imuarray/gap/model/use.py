"""Figures of use: the effect of a gap on users of the sensors."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class IntervalEstimate:
    """A figure with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Use:
    """A figure of use of a sensor, or of the array (`sensor` ""): its `name`, for example "heading error after coasting
    60 s", and its `unit`; its value in the recording (`real`), and in simulations `before` and `after` the causes were
    added.
    """

    name: str
    sensor: str
    unit: str
    real: IntervalEstimate
    before: IntervalEstimate
    after: IntervalEstimate
