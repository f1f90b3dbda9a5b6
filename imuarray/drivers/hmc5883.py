"""HMC5883 and HMC5883L magnetometers. Honeywell Form 900405 Rev A (2010) and Rev E; facts HMC-*.

Both answer "H43"; the configuration says which one it is, because their gains differ (HMC-30). Data comes as X, Z, Y,
high byte first (HMC-31); -4096 means that the converter overflowed (HMC-32). The register pointer is always written
(HMC-06)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock, sleep_for
from imuarray.drivers.driver import Bytes, Decoded, registers_for, saturated
from imuarray.facts import hmc5883 as facts

_CONTINUOUS = 0b00
_READY_S = 0.050  # after power-on: HMC-51


class Hmc5883:
    """Driver of one HMC5883 or HMC5883L."""

    burst: ClassVar[int] = 6
    tells_fresh: ClassVar[bool] = False  # the status register sits behind a wrap that data sheets dispute: HMC-06

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        self.registers = registers_for(sensor, bus)
        self.clock = clock
        self.rate_hz = sensor.chip_rate_hz
        ranges, rates = tuple(sensor.spec.sensitivity), sensor.spec.rates_hz
        self.settings = (  # codes count up along both tables: HMC-20 ... HMC-28
            facts.AVERAGING(0) | facts.OUTPUT_RATE(rates.index(self.rate_hz)) | facts.MEASUREMENT_BIAS(0),
            facts.GAIN(ranges.index(sensor.range or ranges[1])),
        )

    def identify(self) -> None:
        """The identity registers spell "H43" (HMC-17)."""
        self.registers.expect(facts.IDENTITY_A, facts.IDENTITY_B, facts.IDENTITY_C)

    def configure(self) -> None:
        """Rate, gain, continuous mode; read back; throw away the first set, which still has the old gain (HMC-36,
        HMC-37).

        The mode register is not read back: reading it locks the data registers of the L (HMC-34).
        """
        sleep_for(self.clock, _READY_S)
        for setting in self.settings:
            self.registers.poke(setting.register, setting.value)
            self.registers.verify(setting)
        self.registers.poke(facts.MODE, facts.OPERATION(_CONTINUOUS).value)
        sleep_for(self.clock, 3 / self.rate_hz)
        self.fetch()
        sleep_for(self.clock, 1 / self.rate_hz)

    def fetch(self) -> bytes:
        """0x03 ... 0x08, all six bytes, so that the data registers unlock again (HMC-33)."""
        return self.registers.peek(facts.DATA_X_MSB, self.burst)

    def decode(self, bursts: Bytes) -> Decoded:
        """Counts in the order x, y, z; saturated where the converter overflowed."""
        words = np.ascontiguousarray(bursts).view(">i2").astype(np.int16)
        counts = words[:, [0, 2, 1]]
        return Decoded(counts, None, saturated(counts, -2048, 2047))

    def header(self) -> Mapping[str, int]:
        """Nothing of its own."""
        return {}
