"""ADXL345 accelerometer. Analog Devices data sheet Rev. E (2015); facts ADX-*.

There is no reset (ADX-31), so every register that matters is written. Full resolution: 256 counts per g in every
range (ADX-40), right-justified, low byte first (ADX-45). One burst carries INT_SOURCE, DATA_FORMAT and the triad,
0x30 ... 0x37."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock, sleep_for
from imuarray.drivers.driver import Bytes, Decoded, registers_for, saturated
from imuarray.facts import adxl345 as facts
from imuarray.log.format import STALE

_RANGE_CODES = {2.0: 0b00, 4.0: 0b01, 8.0: 0b10, 16.0: 0b11}  # ADX-26


class Adxl345:
    """Driver of one ADXL345."""

    burst: ClassVar[int] = 8
    tells_fresh: ClassVar[bool] = True

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        self.registers = registers_for(sensor, bus)
        self.clock = clock
        self.range_g = sensor.range or 16.0
        self.rate_hz = sensor.chip_rate_hz

    def identify(self) -> None:
        """DEVID is 0xE5 (ADX-10)."""
        self.registers.expect(facts.DEVID)

    def configure(self) -> None:
        """Standby, settings, measure; wait for the first sample (1/ODR + 1.1 ms, ADX-38)."""
        rate_code = 15 - round(np.log2(3200.0 / self.rate_hz))  # ADX-36
        settings = {
            facts.POWER_CTL: facts.MEASURE(0).value,
            facts.BW_RATE: facts.RATE(rate_code).value,
            facts.DATA_FORMAT: (facts.FULL_RES(1) | facts.RANGE(_RANGE_CODES[self.range_g])).value,
            facts.FIFO_CTL: facts.FIFO_MODE(0b00).value,
            facts.INT_ENABLE: 0,
            facts.OFSX: 0,
            facts.OFSY: 0,
            facts.OFSZ: 0,
        }
        for register, value in settings.items():
            self.registers.poke(register, value)
            self.registers.verify(register[7:0](value))
        self.registers.poke(facts.POWER_CTL, facts.MEASURE(1).value)
        self.registers.verify(facts.POWER_CTL[7:0](facts.MEASURE(1).value))
        sleep_for(self.clock, 1 / self.rate_hz + 1.1e-3)

    def fetch(self) -> bytes:
        """0x30 ... 0x37: what happened, how the data is formatted, x, y, z."""
        return self.registers.peek(facts.INT_SOURCE, self.burst)

    def decode(self, bursts: Bytes) -> Decoded:
        """Counts at 256 per g; stale where DATA_READY was clear."""
        counts = np.ascontiguousarray(bursts[:, 2:8]).view("<i2").astype(np.int16)
        half_span = int(self.range_g * 256)
        fresh = bursts[:, 0] & facts.DATA_READY.mask
        status = saturated(counts, -half_span, half_span - 1) | np.where(fresh, 0, STALE).astype(np.uint16)
        return Decoded(counts, None, status)

    def header(self) -> Mapping[str, int]:
        """Nothing of its own."""
        return {}
