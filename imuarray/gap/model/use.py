"""Figures in units of use: what the gap means to who uses the sensors."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """A figure in units of use, with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Use:
    """What the gap means to who uses the sensor (or, `sensor` "", the array): `name` such as "heading error after
    coasting 60 s" in `unit`; of the recording, of simulations before and after the causes were added.
    """

    name: str
    sensor: str
    unit: str
    real: Figure
    before: Figure
    after: Figure
