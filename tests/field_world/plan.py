"""What a case consists of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from tests.field_world.chips import Sensor
from tests.field_world.faults import Fault
from tests.field_world.recorder import Logger
from tests.field_world.surroundings import World

KINDS = ("control", "effect", "unknown", "pair")


@dataclass(frozen=True)
class Case:
    """A scene: its kind, sensors, recorder, the worlds of its logs from a key, and its faults.

    `flags` says which bits the status column has: "full", "identical" (repeats are recognised by their codes) or
    "none". The rest says what the log file has.
    """

    name: str
    kind: str
    text: str
    sensors: Sequence[Sensor]
    logger: Logger
    worlds: Callable[[Any], World | list[World]]
    faults: Sequence[Fault] = ()
    flags: str = "full"
    source: str | None = None
    software: str | None = None
    labels: Sequence[str] | None = None
    has_scales: bool = True
    has_dimensions: bool = True
    has_clocks: bool = False
    has_multiplexer: bool = True
    has_reference_temperature: bool = False
    has_frame_rate: bool = True
