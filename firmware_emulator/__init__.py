"""An emulated bus that behaves like the real one: chips, multiplexer, time, and the world that acts on the sensors.

::

    world (callable of time) -> element (one chip's imperfections) -> chip (registers, converter) -> mux -> wire

It shares only register facts with the drivers (`imuarray.facts`): byte order, signs, timing and every scale factor are
implemented here a second time, so that errors of a driver are detected.

The faults of an array are in `firmware_emulator.mechanisms`; `firmware_emulator.cases` records logs with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from firmware_emulator.array import EmulatedBus
    from firmware_emulator.board import ArrayLike

__all__ = ["open_bus"]


def open_bus(query: Mapping[str, str], array: ArrayLike) -> EmulatedBus:
    """Return the bus of the emulated `array` with the parameters of its URL: see `firmware_emulator.array.open_bus`."""
    from firmware_emulator import array as emulated

    return emulated.open_bus(query, array)
