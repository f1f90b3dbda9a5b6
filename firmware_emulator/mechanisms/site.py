"""One sensor as a mechanism finds it: where to act, how large, and random numbers of its own."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from firmware_emulator.chip import Chip, Triple
from firmware_emulator.element import SENSED, Matrix, stream
from firmware_emulator.mechanisms.element import Chain
from firmware_emulator.mechanisms.line import Links
from firmware_emulator.world import World

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

ACCELEROMETERS = ("adxl345", "bma180")
GYROSCOPES = ("l3g4200d",)
INERTIAL = ACCELEROMETERS + GYROSCOPES
WHILE_SET_UP_S = 5.0
"""Faults of the wiring begin that long after power-on: an array whose chips can't be set up is never logged."""


@dataclass
class Site:
    """The sensor `name`: a `chip` in a range of `full_scale` (g or dps), box = `orientation` @ sensor.

    `world` is a function of ns since power-on, like everything that mechanisms are asked.

    `run` counts the times that the array was powered up, from 0. `chain` and `links` are where mechanisms act on its
    signal and on its wiring; `kinds` changes the chip itself, `switches` its keyword arguments; `notes` says what
    happened, for the sealed truth, and `touched` to whom, by the mechanisms that leave that to chance.
    """

    name: str
    chip: str
    full_scale: float
    orientation: Matrix
    world: World
    seed: int
    run: int
    notes: list[str]
    touched: dict[Any, set[str]] = field(default_factory=dict)
    chain: Chain = field(default_factory=Chain)
    links: Links = field(default_factory=Links)
    kinds: list[Callable[[Callable[..., Chip]], Callable[..., Chip]]] = field(default_factory=list)
    switches: dict[str, Any] = field(default_factory=dict)

    def by_unit(self, g: float, dps: float) -> float:
        """`g` for an accelerometer, `dps` for a gyroscope."""
        return g if SENSED[self.chip][0] == "force_box" else dps

    def unit_random(self, key: str) -> np.random.Generator:
        """Random numbers of this part, the same after every power-up."""
        return stream(self.seed, f"{key} in {self.name}")

    def run_random(self, key: str) -> np.random.Generator:
        """Random numbers of this part and this power-up."""
        return stream(self.seed, f"{key} in {self.name}, run {self.run}")

    def direction(self, key: str) -> Triple:
        """Return how strongly each axis of this part is affected: a random direction of length sqrt(3), so that axes
        are 1 on average.
        """
        drawn = self.unit_random(f"direction of {key}").standard_normal(3)
        x, y, z = (drawn * (math.sqrt(3) / float(np.linalg.norm(drawn)))).tolist()
        return x, y, z

    def note(self, what: str) -> None:
        """Note for the truth: something happened here."""
        self.notes.append(f"{self.name}: {what}")


class Stopwatch:
    """Seconds since the previous call; 0 at the first."""

    def __init__(self) -> None:
        self._before_ns: int | None = None

    def __call__(self, at_ns: int) -> float:
        """`at_ns` never falls."""
        before = at_ns if self._before_ns is None else self._before_ns
        self._before_ns = at_ns
        return (at_ns - before) * 1e-9


def plus(value: Triple, direction: Triple, factor: float) -> Triple:
    """value + factor * direction."""
    x, y, z = value
    dx, dy, dz = direction
    return x + factor * dx, y + factor * dy, z + factor * dz
