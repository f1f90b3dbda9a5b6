"""HMC5883 and HMC5883L magnetometers. Honeywell Form 900405 Rev A (2010) and Rev E; facts HMC-*.

Both identify themselves as "H43"; the configuration must name the chip, because their gains differ (HMC-30). Data are
in the order X, Z, Y, high byte first (HMC-31); -4096 means that the converter overflowed (HMC-32). The register pointer
is always written (HMC-06).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock
from imuarray.drivers.driver import (
    Bytes,
    ChipDriver,
    DecodedBursts,
    SelfTest,
    compare_readings,
    flag_saturated,
    within,
    words16,
)
from imuarray.facts import hmc5883 as facts
from imuarray.facts.registers import Register

_XZY = [0, 2, 1]
_CONTINUOUS = 0b00
_SELF_TEST_GAIN = 5
_SELF_TEST_L = ((243.0, 575.0),) * 3  # HMC-41, at gain code 5
# The plain HMC5883 responds with about +655, +655, -604 at its default 1024 LSB/G (HMC-42): half to twice that.
_SELF_TEST_PLAIN = tuple((min(v * k, v / k), max(v * k, v / k)) for v, k in ((231.0, 2), (231.0, 2), (-213.0, 2)))
_SELF_TEST_STILL = 50.0  # counts; a quarter of the smallest response, and noise is one count: HMC-53
_READY_S = 0.050  # after power-on: HMC-51


class Hmc5883(ChipDriver):
    """Driver of one HMC5883 or HMC5883L."""

    burst: ClassVar[int] = 6
    first: ClassVar[Register] = facts.DATA_X_MSB  # all six bytes, so that the data registers unlock again: HMC-33
    reading: ClassVar[slice] = slice(0, 6)
    has_data_ready: ClassVar[bool] = False  # the status register follows a wrap on which data sheets differ: HMC-06

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.rate_hz = sensor.chip_rate_hz
        ranges, rates = tuple(sensor.spec.sensitivity), sensor.spec.rates_hz
        self.settings = (  # codes count up along both tables: HMC-20 ... HMC-28
            facts.AVERAGING(0) | facts.OUTPUT_RATE(rates.index(self.rate_hz)) | facts.MEASUREMENT_BIAS(0),
            facts.GAIN(ranges.index(sensor.range or ranges[1])),
        )
        self.mode = facts.HIGH_SPEED(0) | facts.OPERATION(_CONTINUOUS)
        # Reading the mode locks the data of the L until the next fetch (HMC-34); unread, a reset would not be detected.
        self.watched = (*self.settings, self.mode)
        self.is_l = sensor.chip == "hmc5883l"

    def identify(self) -> None:
        """Check that the identity registers contain "H43" (HMC-17); SensorError."""
        self.registers.expect(facts.IDENTITY_A, facts.IDENTITY_B, facts.IDENTITY_C)

    def steps(self) -> Iterator[float]:
        """Set rate, gain and continuous mode, and verify them; the first set still has the old gain and is discarded
        (HMC-36).

        Reading the mode register locks the data registers of the L until all six have been read (HMC-34).
        """
        yield _READY_S
        yield from self.registers.set_step_by_step(*self.settings, self.mode)
        self.fetch()
        yield 3 / self.rate_hz
        self.fetch()
        yield 1 / self.rate_hz

    def self_test(self) -> SelfTest:
        """Measure the response to the chip's own field at gain code 5; the chip subtracts the earth's field (HMC-41,
        HMC-42).
        """
        biased = facts.AVERAGING(0) | facts.OUTPUT_RATE(0b110) | facts.MEASUREMENT_BIAS(0b01)
        self.registers.set(biased, facts.GAIN(_SELF_TEST_GAIN))
        self.registers.poke(facts.MODE, facts.OPERATION(_CONTINUOUS).value)
        words = self.triads(self.fetch, 0.0, 2 / 75, count=7, order=">i2")
        answers = words[3:, _XZY]
        self.configure()
        both = (_SELF_TEST_L, "hmc5883l"), (_SELF_TEST_PLAIN, "hmc5883")
        (limits, _), (other, name) = both if self.is_l else both[::-1]
        wanted = ", ".join(f"{low:+.0f} to {high:+.0f}" for low, high in limits)
        text = f"answers {{change}} counts; limits {wanted}"
        verdict = compare_readings(np.zeros((1, 3)), answers, limits, text, still=_SELF_TEST_STILL)
        if verdict.passed is False and within(answers.mean(axis=0), other):
            return SelfTest(False, f"{verdict.text}; fits an {name}: is it one?")
        return verdict

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts in the order x, y, z; saturated where the converter overflowed."""
        counts = words16(bursts, ">i2")[:, _XZY]
        return DecodedBursts(counts, None, flag_saturated(counts, -2048, 2047))
