"""ADXL345 accelerometer. Analog Devices data sheet Rev. E (2015); facts ADX-*.

There is no reset (ADX-31), so every register that affects readings is written. Full resolution has 256 counts per g in
every range (ADX-40), right-justified, low byte first (ADX-45). One burst contains INT_SOURCE, DATA_FORMAT and the
triad, 0x30 ... 0x37. A transaction reads one set of the queue (ADX-05, ADX-55).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import ClassVar

import numpy as np

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
from imuarray.drivers.fifo_clock import FifoClock
from imuarray.facts import adxl345 as facts
from imuarray.facts.registers import Register

_RANGE_CODES = {2.0: 0b00, 4.0: 0b01, 8.0: 0b10, 16.0: 0b11}  # ADX-26
_BYPASS, _STREAM = 0b00, 0b10  # ADX-28
_FIFO_DEPTH = 32  # ADX-51
_LSB_PER_G = 256.0  # ADX-40
_SELF_TEST_RATE = 0xC  # 400 Hz, among the rates at which the limits hold: ADX-58
_SELF_TEST_SAMPLES = 32
_SELF_TEST_STILL_G = 0.05  # a quarter of the smallest limit; the noise at 400 Hz is at most 0.009 g: ADX-68
_SELF_TEST_G = ((0.20, 2.10 * 1.77), (-2.10 * 1.77, -0.20), (0.30, 3.40 * 1.47))  # 2.5 V to 3.3 V: ADX-58


class Adxl345(ChipDriver):
    """Driver of one ADXL345."""

    burst: ClassVar[int] = 8
    first: ClassVar[Register] = facts.INT_SOURCE  # events, the data format, x, y, z
    unused: ClassVar[Register | None] = facts.THRESH_TAP  # taps are off: ADX-11
    has_data_ready: ClassVar[bool] = True
    reading: ClassVar[slice] = slice(2, 8)
    fifo_mode: ClassVar[int] = _BYPASS

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.range_g = sensor.range or 16.0
        self.rate_hz = sensor.chip_rate_hz
        rate_code = 15 - round(np.log2(3200.0 / self.rate_hz))  # ADX-36
        self.settings = (
            facts.BW_RATE[7:0](facts.RATE(rate_code).value),
            facts.DATA_FORMAT[7:0]((facts.FULL_RES(1) | facts.RANGE(_RANGE_CODES[self.range_g])).value),
            facts.FIFO_CTL[7:0](facts.FIFO_MODE(self.fifo_mode).value),
            facts.INT_ENABLE[7:0](0),
            facts.OFSX[7:0](0),
            facts.OFSY[7:0](0),
            facts.OFSZ[7:0](0),
        )
        self.power = facts.POWER_CTL[7:0](facts.MEASURE(1).value)
        self.watched = (self.power, *self.settings[:3])

    def steps(self) -> Iterator[float]:
        """Set standby, the settings and measurement; wait for the first sample (1/ODR + 1.1 ms, ADX-38)."""
        yield from self.registers.set_step_by_step(facts.POWER_CTL[7:0](0), *self.settings, self.power)
        yield 1 / self.rate_hz + 1.1e-3

    def self_test(self) -> SelfTest:
        """Measure the deflection with SELF_TEST set, against the limits of ADX-58 from 2.5 V to 3.3 V."""
        still = (facts.FULL_RES(1) | facts.RANGE(0b11)).value
        self.registers.poke(facts.FIFO_CTL, 0)
        self.registers.poke(facts.BW_RATE, facts.RATE(_SELF_TEST_RATE).value)
        self.registers.poke(facts.POWER_CTL, facts.MEASURE(1).value)
        self.registers.poke(facts.DATA_FORMAT, still)
        before = self._readings_g()
        self.registers.poke(facts.DATA_FORMAT, still | facts.SELF_TEST.mask)
        during = self._readings_g()
        self.registers.poke(facts.DATA_FORMAT, still)
        self.configure()
        limits = ", ".join(f"{low:+.2f} to {high:+.2f}" for low, high in _SELF_TEST_G)
        text = f"deflects {{change}} g; limits {limits} g"
        return compare_readings(before, during, _SELF_TEST_G, text, still=_SELF_TEST_STILL_G)

    def _readings_g(self) -> Floats:
        """Return specific forces (n, 3) in g, after the four samples that the filter needs (ADX-58)."""
        read = partial(self.registers.peek, facts.DATAX0, 6)
        return self.triads(read, 5 / 400, 1 / 400, count=_SELF_TEST_SAMPLES) / _LSB_PER_G

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts at 256 per g; stale if DATA_READY was clear, overrun if a set was replaced unread (ADX-52)."""
        decoded, fresh = self._triads(bursts[:, 2:8]), flag_freshness(bursts[:, 0], facts.DATA_READY, facts.OVERRUN)
        return decoded._replace(status=decoded.status | fresh)

    def _triads(self, data: Bytes) -> DecodedBursts:
        counts = words16(data)
        half_span = int(self.range_g * _LSB_PER_G)
        highest = half_span - (2 if self.rate_hz > 800 else 1)  # only even codes at 1600 and 3200 Hz: ADX-47
        return DecodedBursts(counts, None, flag_saturated(counts, -half_span, highest))


class Adxl345Fifo(Adxl345):
    """The same chip with its queue of 32 sets drained: one transaction counts them, one more fetches each."""

    burst: ClassVar[int] = 6
    reading: ClassVar[slice] = slice(0, 6)
    fifo_mode: ClassVar[int] = _STREAM

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.queue = FifoClock(self.rate_hz)

    def steps(self) -> Iterator[float]:
        """Configure as without the queue; its clock starts again."""
        yield from super().steps()
        self.queue.restart()

    def fetch(self) -> bytes:
        """Return every set in the queue, oldest first; those that were read before the bus failed are kept."""
        at_ns = self.clock.now_ns()
        entries = facts.ENTRIES.of(self.registers.peek(facts.FIFO_STATUS)[0])
        until_ns = self.clock.now_ns()
        sets: list[bytes] = []
        try:
            while len(sets) < entries:
                sets.append(self.registers.peek(facts.DATAX0, self.burst))
        except OSError:
            if not sets:
                raise
        unread = entries - len(sets)  # newer than the sets that were read, and still in the queue
        self.queue.times(len(sets), at_ns, entries >= _FIFO_DEPTH, until_ns=until_ns, unread=unread)
        return b"".join(sets)

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts at 256 per g; a set in the queue is always new."""
        return self._triads(bursts)
