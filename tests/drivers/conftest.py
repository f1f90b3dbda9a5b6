"""A chip on a separate wire, and a bus that drops some writes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from firmware_emulator.clock import VirtualClock
from firmware_emulator.wire import Wire
from imuarray.array import SensorConfig
from imuarray.drivers import DRIVERS, Driver


class Constant:
    """A sensing element with a constant input."""

    def __init__(
        self, vector: tuple[float, float, float], temperature_degc: float = 25.0, pressure_pa: float = 101325.0
    ) -> None:
        self.vector, self.temperature_degc, self.pressure_pa = vector, temperature_degc, pressure_pa

    def sample(self, at_ns: int, full_scale: float, bandwidth_hz: float) -> tuple[float, float, float]:
        return self.vector

    def temperature(self, at_ns: int) -> float:
        return self.temperature_degc

    def pressure(self, at_ns: int) -> float:
        return self.pressure_pa


class Tap:
    """A bus that records transactions and drops the writes to some registers, but acknowledges them."""

    def __init__(self, bus: Wire, drops: Callable[[int], bool] = lambda register: False) -> None:
        self.bus = bus
        self.drops = drops
        self.seen: list[tuple[int, bytes, int]] = []

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        self.seen.append((address, write, read))
        if len(write) > 1 and self.drops(write[0] & 0x7F):
            return b""
        return self.bus.transfer(address, write, read)

    @property
    def writes(self) -> list[bytes]:
        return [write for _, write, read in self.seen if len(write) > 1]


class Bench:
    """One chip on one wire, with the clock that both obey, and the driver of a sensor that is configured so."""

    def __init__(self, chip: Any, wire: Wire, clock: VirtualClock, sensor: SensorConfig) -> None:
        self.chip, self.wire, self.clock, self.sensor = chip, wire, clock, sensor
        self.tap = Tap(wire)
        self.driver: Driver = DRIVERS[sensor.chip](self.tap, sensor, clock)

    def write(self, *pairs: tuple[int, int]) -> None:
        """The writes of an earlier program."""
        for register, value in pairs:
            self.wire.transfer(self.sensor.address, bytes([register, value]))

    def register(self, address: int) -> int:
        """The value of a register of the chip."""
        return self.wire.transfer(self.sensor.address, bytes([address]), 1)[0]

    def wait(self, seconds: float) -> None:
        self.clock.sleep_until(self.clock.now_ns() + round(seconds * 1e9))

    def read(self) -> Any:
        """One reading, decoded."""
        import numpy as np

        burst = self.driver.fetch()
        return self.driver.decode(np.frombuffer(burst, np.uint8).reshape(1, -1))


@pytest.fixture
def bench() -> Callable[..., Bench]:
    """``bench(EmulatedChip, sensor, vector, **switches)``."""

    def build(
        chip: Callable[..., Any],
        sensor: SensorConfig,
        vector: Sequence[float] = (0.0, 0.0, 1.0),
        element: Any = None,
        **switches: Any,
    ) -> Bench:
        clock = VirtualClock()
        wire = Wire(clock)
        made = chip(sensor.address, element or Constant((vector[0], vector[1], vector[2])), 0, **switches)
        wire.connect(made)
        clock.sleep_until(1_000_000_000)
        return Bench(made, wire, clock, sensor)

    return build
