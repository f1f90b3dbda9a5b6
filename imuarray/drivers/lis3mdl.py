"""LIS3MDL magnetometer. ST data sheet DocID024204 Rev 6; facts LIS-*.

Bit 7 of the register address requests auto-increment (LIS-03). BDU keeps the two bytes of an axis together (LIS-13). It
averages as many samples as its data rate allows: ultra-high performance (LIS-11). The temperature is read separately,
before status and triad: a burst does not continue from the triad to the temperature (LIS-18).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from types import MappingProxyType
from typing import ClassVar

from imuarray.array import SensorConfig
from imuarray.arrays import Floats
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock
from imuarray.drivers.driver import (
    Bytes,
    ChipDriver,
    DecodedBursts,
    SelfTest,
    compare_readings,
    flag_freshness,
    flag_saturated,
    words16,
)
from imuarray.facts import lis3mdl as facts

_CONTINUOUS = 0b00  # LIS-12
_ULTRA_HIGH = 0b11  # LIS-11
_FASTEST_HZ = 155.0  # of ultra-high performance, with the fast bit: LIS-11
_OFFSETS = (
    *(facts.OFFSET_X_L, facts.OFFSET_X_H, facts.OFFSET_Y_L),
    *(facts.OFFSET_Y_H, facts.OFFSET_Z_L, facts.OFFSET_Z_H),
)
_RANGE_CODES = {4.0: 0, 8.0: 1, 12.0: 2, 16.0: 3}  # LIS-10
_START_S = 0.020  # LIS-15
_SELF_TEST_RANGE = 12.0  # LIS-16
_SELF_TEST_RATE = 0b111  # 80 Hz
_SELF_TEST_GAUSS = ((1.0, 3.0), (1.0, 3.0), (0.1, 1.0))  # LIS-16
_SELF_TEST_SETTLE_S = 0.060
_SELF_TEST_SAMPLES = 8
_SELF_TEST_STILL = 0.05  # gauss; noise is 4 mG: LIS-21


class Lis3mdl(ChipDriver):
    """Driver of one LIS3MDL."""

    burst: ClassVar[int] = 9
    has_data_ready: ClassVar[bool] = True
    reading: ClassVar[slice] = slice(3, 9)
    relatives: ClassVar[Mapping[int, str]] = MappingProxyType(
        {0x3C: "an LSM303DLHC or LSM303DLM", 0x40: "an LIS2MDL or LSM303AGR"}  # LIS-02
    )

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.rate_hz = sensor.chip_rate_hz
        self.sensitivity = sensor.spec.sensitivity
        is_fast = self.rate_hz == _FASTEST_HZ
        rate = 0 if is_fast else sensor.spec.rates_hz.index(self.rate_hz)  # codes count up: LIS-11
        self.settings = (
            *(register[7:0](0) for register in _OFFSETS),
            facts.TEMPERATURE_ON(1)
            | facts.XY_PERFORMANCE(_ULTRA_HIGH)
            | facts.DATA_RATE(rate)
            | facts.FAST_RATE(int(is_fast))
            | facts.SELF_TEST(0),
            facts.FULL_SCALE(_RANGE_CODES[sensor.range or 4.0]) | facts.REBOOT(0) | facts.SOFT_RESET(0),
            facts.Z_PERFORMANCE(_ULTRA_HIGH) | facts.BIG_ENDIAN(0),
            facts.FAST_READ(0) | facts.BLOCK_UPDATE(1),
            facts.INT_THS_L[7:0](0),
            facts.LOW_POWER(0) | facts.SPI_THREE_WIRE(0) | facts.OPERATION(_CONTINUOUS),
        )
        self.watched = self.settings[len(_OFFSETS) :]

    def steps(self) -> Iterator[float]:
        """Set offsets to zero, every setting, and continuous measurement last; then wait for its first samples."""
        yield from self.registers.set_step_by_step(*self.settings)
        yield _START_S
        yield 2 / self.rate_hz

    def mark(self, code: int) -> bool:
        """Mark the chip in the threshold of the interrupt, which is off (LIS-17)."""
        marked = facts.INT_THS_L[7:0](code)
        self.settings = (*self.settings[:-2], marked, self.settings[-1])
        self.watched = (*self.watched[:-2], marked, self.watched[-1])
        return True

    def self_test(self) -> SelfTest:
        """Measure the change of the field with the self-test on, at 12 gauss and 80 Hz (LIS-16)."""
        self.configure()
        normal = facts.XY_PERFORMANCE(_ULTRA_HIGH) | facts.DATA_RATE(_SELF_TEST_RATE)
        self.registers.poke(facts.CTRL_REG2, facts.FULL_SCALE(_RANGE_CODES[_SELF_TEST_RANGE]).value)
        self.registers.poke(facts.CTRL_REG1, normal.value)
        before = self._readings_gauss()
        self.registers.poke(facts.CTRL_REG1, (normal | facts.SELF_TEST(1)).value)
        during = self._readings_gauss()
        self.configure()
        wanted = ", ".join(f"{low:g} to {high:g}" for low, high in _SELF_TEST_GAUSS)
        text = f"changes by {{change}} gauss; limits {wanted}"
        return compare_readings(before, during, _SELF_TEST_GAUSS, text, still=_SELF_TEST_STILL)

    def _readings_gauss(self) -> Floats:
        """Return fields (n, 3) in gauss."""
        read = partial(self.registers.peek_counting, facts.OUT_X_L, 6)
        counts = self.triads(read, _SELF_TEST_SETTLE_S, 1.1 / 80, count=_SELF_TEST_SAMPLES)
        return counts / self.sensitivity[_SELF_TEST_RANGE]

    def fetch(self) -> bytes:
        """Read 0x2E and 0x2F, then 0x27 ... 0x2D, with auto-increment: temperature; status, x, y, z."""
        return self.registers.peek_counting(facts.TEMP_OUT_L, 2) + self.registers.peek_counting(facts.STATUS_REG, 7)

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 16 bits, low byte first (LIS-14), as the temperature. Stale where ZYXDA was clear, overrun
        where ZYXOR was set (LIS-12).
        """
        counts, temperature = words16(bursts[:, self.reading]), words16(bursts[:, 0:2])[:, 0]
        fresh = flag_freshness(bursts[:, 2], facts.ZYX_AVAILABLE, facts.ZYX_OVERRUN)
        return DecodedBursts(counts, temperature, flag_saturated(counts, -32768, 32767) | fresh)
