"""BMP280 barometer. Bosch data sheet BST-BMP280-DS001 rev. 1.23; facts BMP-101 to -126.

Forced mode, sixteen samples of pressure and two of temperature, no filter: the measurement with the least noise that is
independent of earlier ones (BMP-106). The conversion of its words to degrees and pascals is in `imuarray.barometer`.
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
from imuarray.facts import bmp280 as facts
from imuarray.facts.registers import Register, Setting

_SOFT_RESET = 0xB6  # BMP-104
_START_UP_S = 0.002  # BMP-113
_TIMES_2, _TIMES_16 = 0b010, 0b101  # BMP-106
_FORCED = 0b01  # BMP-107
_LONGEST_NS = 43_225_000  # 1.25 ms + 2.3 ms a sample + 0.575 ms: BMP-109
_UNSIGNED = ("T1", "P1")  # BMP-103


class Bmp280(ForcedBarometer):
    """Driver of one BMP280."""

    relatives: ClassVar[Mapping[int, str]] = MappingProxyType({0x55: "a BMP180", 0x60: "a BME280"})  # BMP-102
    conversions_ns: ClassVar[tuple[int, ...]] = (_LONGEST_NS,)
    first: ClassVar[Register] = facts.STATUS
    head: ClassVar[int] = 4  # status, both settings, and a register that is not there
    busy: ClassVar[int] = facts.MEASURING.mask
    force: ClassVar[Setting] = (
        facts.TEMPERATURE_OVERSAMPLING(_TIMES_2) | facts.PRESSURE_OVERSAMPLING(_TIMES_16) | facts.MODE(_FORCED)
    )
    limits_pa: ClassVar[tuple[float, float]] = (30_000.0, 110_000.0)  # BMP-124

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.watched = (facts.STANDBY(0) | facts.FILTER(0) | facts.SPI_THREE_WIRE(0),)

    def steps(self) -> Iterator[float]:
        """Reset, read the twelve calibration words, switch the filter off; SensorError for an impossible word."""
        self.registers.poke(facts.SOFT_RESET, _SOFT_RESET)
        yield _START_UP_S
        self.words = calibration_words(self.registers.peek(facts.CALIBRATION, 2 * len(facts.CALIBRATION_WORDS)))
        for name in ("T1", "T2", "P1"):  # the formulas multiply and divide by these: BMP-103
            if self.words[name] in (0, 0xFFFF, -1):
                raise SensorError(
                    f"{self.registers.label}: calibration word {name} reads {self.words[name]}: not a BMP280"
                )
        self.registers.set(*self.watched)
        self.begin()

    def is_over(self, head: bytes) -> bool:
        """Return whether it sleeps, with the configured oversampling: a chip that was reset has none (BMP-105,
        BMP-107).
        """
        asleep = Setting(self.force.register, self.force.mask, self.force.value & ~facts.MODE.mask)
        return not facts.MEASURING.of(head[0]) and head[1] == asleep.value

    def words_of(self, bursts: Bytes) -> tuple[Integers, Integers]:
        """Return twenty bits each, the pressure first (BMP-111)."""
        wide = bursts.astype(np.int64)
        up = wide[:, 0] << 12 | wide[:, 1] << 4 | wide[:, 2] >> 4
        return wide[:, 3] << 12 | wide[:, 4] << 4 | wide[:, 5] >> 4, up


def calibration_words(block: bytes) -> Words:
    """Return the twelve words from the 24 bytes at 0x88: least significant byte first, T1 and P1 unsigned (BMP-103)."""
    return {
        name: int.from_bytes(block[2 * index : 2 * index + 2], "little", signed=name not in _UNSIGNED)
        for index, name in enumerate(facts.CALIBRATION_WORDS)
    }
