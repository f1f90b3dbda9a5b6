"""BMP388 barometer. Bosch data sheet BST-BMP388-DS001 rev. 1.0; facts BMP-201 to -223.

Forced mode, sixteen samples of pressure and two of temperature, no filter, as of the BMP280. The conversion of its
words to degrees and pascals is in `imuarray.barometer`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.arrays import Integers
from imuarray.barometer import Words
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock
from imuarray.drivers.driver import Bytes
from imuarray.drivers.on_demand_barometer import ForcedBarometer
from imuarray.errors import SensorError
from imuarray.facts import bmp388 as facts
from imuarray.facts.registers import Register, Setting

_SOFT_RESET = 0xB6  # BMP-204
_START_UP_S = 0.002  # BMP-212
_TIMES_2, _TIMES_16 = 0b001, 0b100  # BMP-206
_FORCED = 0b01  # BMP-207
_LONGEST_NS = 43_000_000  # BMP-209: 37.1 ms typically, and 15 % more
_BYTES = (2, 2, 1, 2, 2, 1, 1, 2, 2, 1, 1, 2, 1, 1)  # of each calibration word: BMP-203
_UNSIGNED = ("T1", "T2", "P5", "P6")  # BMP-203


class Bmp388(ForcedBarometer):
    """Driver of one BMP388."""

    relatives: ClassVar[Mapping[int, str]] = MappingProxyType({0x60: "a BMP390"})  # BMP-202
    conversions_ns: ClassVar[tuple[int, ...]] = (_LONGEST_NS,)
    first: ClassVar[Register] = facts.STATUS
    head: ClassVar[int] = 1
    force: ClassVar[Setting] = facts.MODE(_FORCED) | facts.TEMPERATURE_ON(1) | facts.PRESSURE_ON(1)
    limits_pa: ClassVar[tuple[float, float]] = (30_000.0, 125_000.0)  # BMP-222

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.watched = (
            facts.TEMPERATURE_OVERSAMPLING(_TIMES_2) | facts.PRESSURE_OVERSAMPLING(_TIMES_16),
            facts.FILTER(0),
        )

    def steps(self) -> Iterator[float]:
        """Reset, read the calibration words, set oversampling and filter; SensorError for an impossible word."""
        self.registers.poke(facts.CMD, _SOFT_RESET)
        yield _START_UP_S
        self.words = calibration_words(self.registers.peek(facts.CALIBRATION, sum(_BYTES)))
        for name in ("T1", "T2", "P5"):
            if self.words[name] in (0, 0xFFFF):
                raise SensorError(
                    f"{self.registers.label}: calibration word {name} reads {self.words[name]}: not a BMP388"
                )
        self.registers.set(*self.watched)
        self.begin()

    def is_over(self, head: bytes) -> bool:
        """Return whether both results are ready; a chip that was reset has none (BMP-205)."""
        return bool(facts.TEMPERATURE_READY.of(head[0]) and facts.PRESSURE_READY.of(head[0]))

    def words_of(self, bursts: Bytes) -> tuple[Integers, Integers]:
        """Return twenty-four bits each, low byte first, the pressure first (BMP-211)."""
        wide = bursts.astype(np.int64)
        up = wide[:, 0] | wide[:, 1] << 8 | wide[:, 2] << 16
        return wide[:, 3] | wide[:, 4] << 8 | wide[:, 5] << 16, up


def calibration_words(block: bytes) -> Words:
    """Return the fourteen words from the 21 bytes at 0x31 (BMP-203)."""
    words, first = {}, 0
    for name, count in zip(facts.CALIBRATION_WORDS, _BYTES, strict=True):
        words[name] = int.from_bytes(block[first : first + count], "little", signed=name not in _UNSIGNED)
        first += count
    return words
