"""A chip on a wire of its own, behind a sensing element whose input is known."""

from __future__ import annotations

from collections.abc import Callable

from firmware_emulator.chip import Chip, Triple
from firmware_emulator.clock import VirtualClock
from firmware_emulator.wire import Wire

MS = 1_000_000


class KnownElement:
    """An element with an input that grows by `slope` each second, or that is a function of time; records requests."""

    def __init__(
        self, value: Triple | Callable[[int], Triple], slope: Triple = (0.0, 0.0, 0.0), degc: float = 25.0
    ) -> None:
        self.value, self.slope, self.degc = value, slope, degc
        self.asked: list[tuple[int, float, float]] = []

    def sample(self, at_ns: int, full_scale: float, bandwidth_hz: float) -> Triple:
        self.asked.append((at_ns, full_scale, bandwidth_hz))
        if callable(self.value):
            return self.value(at_ns)
        x, y, z = (value + slope * at_ns * 1e-9 for value, slope in zip(self.value, self.slope, strict=True))
        return x, y, z

    def temperature(self, at_ns: int) -> float:
        return self.degc

    def pressure(self, at_ns: int) -> float:
        return 101325.0


class ChipBench:
    """A chip on a wire."""

    def __init__(self, chip: Chip, bit_rate_hz: int = 400_000) -> None:
        self.chip = chip
        self.clock = VirtualClock()
        self.wire = Wire(self.clock, bit_rate_hz)
        self.wire.connect(chip)

    def write(self, *pairs: int) -> None:
        """Registers and values, each pair in a transaction of its own."""
        for register, value in zip(pairs[::2], pairs[1::2], strict=True):
            self.wire.transfer(self.chip.address, bytes([register, value]))

    def read(self, register: int, count: int = 1) -> bytes:
        return self.wire.transfer(self.chip.address, bytes([register]), count)

    def wait(self, ms: float) -> None:
        self.clock.advance(round(ms * MS))
