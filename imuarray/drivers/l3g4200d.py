"""L3G4200D gyroscope. ST data sheet Doc ID 17116 Rev 3 (2010); facts L3G-*.

Bit 7 of the register address requests auto-increment (L3G-03). BDU keeps the two bytes of an axis together (L3G-50).
The bandwidth bits act only where Out_Sel routes the data through the second low-pass (L3G-36, L3G-37). One burst
carries temperature, status and the triad, 0x26 ... 0x2D.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.arrays import Floats
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock, sleep_for
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
from imuarray.facts import l3g4200d as facts
from imuarray.facts.registers import Setting

_RATE_CODES = {100.0: 0b00, 200.0: 0b01, 400.0: 0b10, 800.0: 0b11}  # L3G-30 ... L3G-33
_RANGE_CODES = {250.0: 0b00, 500.0: 0b01, 2000.0: 0b10}  # L3G-40 ... L3G-42
_BYPASS, _STREAM = 0b000, 0b010  # L3G-20
_SELF_TEST_DPS = {250.0: 130.0, 500.0: 200.0, 2000.0: 530.0}  # L3G-62
_SELF_TEST_SAMPLES = 32
_TURN_ON_S = 0.3  # from power-down; not in the data sheet: L3G-65


class L3g4200d(ChipDriver):
    """Driver of one L3G4200D."""

    burst: ClassVar[int] = 8
    has_data_ready: ClassVar[bool] = True
    reading: ClassVar[slice] = slice(2, 8)
    fifo: ClassVar[bool] = False

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.rate_hz = sensor.chip_rate_hz
        self.range_dps = sensor.range or 250.0
        self.sensitivity = sensor.spec.sensitivity[self.range_dps]
        bandwidths = sensor.spec.allowed_bandwidths_hz(self.rate_hz)
        # At 100 Hz three of the four codes are 25 Hz; the first is used.
        bandwidth_code = bandwidths.index(sensor.chip_bandwidth_hz) if sensor.chip_bandwidth_hz in bandwidths else 0
        self.power = (
            facts.DATA_RATE(_RATE_CODES[self.rate_hz])
            | facts.BANDWIDTH(bandwidth_code)
            | facts.POWER_ON(1)
            | facts.AXES_ON(0b111)
        )
        self.settings = (
            facts.HIGH_PASS_MODE(0) | facts.HIGH_PASS_CUTOFF(0),
            facts.CTRL_REG3[7:0](0),
            facts.BLOCK_DATA_UPDATE(1)
            | facts.BIG_ENDIAN(0)
            | facts.FULL_SCALE(_RANGE_CODES[self.range_dps])
            | facts.SELF_TEST(0),
            facts.FIFO_EN(int(self.fifo)) | facts.HIGH_PASS_EN(0) | facts.OUT_SELECT(0b10),
            facts.FIFO_MODE(_STREAM if self.fifo else _BYPASS) | facts.FIFO_WATERMARK(0),
        )
        self.watched = (self.power, *self.settings[2:])

    def steps(self) -> Iterator[float]:
        """Write every control register, because the chip has no reset, then the power bit; wait for the turn-on."""
        yield from self.registers.set_step_by_step(*self.settings, self.power)
        yield _TURN_ON_S

    def mark(self, code: int) -> bool:
        """Mark the chip in the watermark of the queue, which is unused (L3G-20)."""
        queue = self.settings[-1]
        marked = Setting(queue.register, queue.mask, queue.value | facts.FIFO_WATERMARK(code).value)
        self.settings, self.watched = (*self.settings[:-1], marked), (*self.watched[:-1], marked)
        return True

    def self_test(self) -> SelfTest:
        """Measure the change of the output with the self-test on, positive sign; limits are a third of the typical
        change and three times it (L3G-62).
        """
        normal = self.settings[2]
        self.registers.set(*self.settings[:2], facts.OUT_SELECT(0b00), normal, facts.FIFO_MODE(_BYPASS), self.power)
        sleep_for(self.clock, _TURN_ON_S)
        before = self._readings_dps()
        self.registers.poke(normal.register, (normal.value & ~facts.SELF_TEST.mask) | facts.SELF_TEST(0b01).value)
        during = self._readings_dps()
        self.configure()
        typical = _SELF_TEST_DPS[self.range_dps]
        text = f"changes by {{change}} dps; {typical:+.0f} is typical"
        return compare_readings(before, during, ((typical / 3, typical * 3),) * 3, text, still=typical / 12)

    def _readings_dps(self) -> Floats:
        """Return angular rates (n, 3) in dps, once the filter has settled."""
        read = partial(self.registers.peek_counting, facts.OUT_X_L, 6)
        return self.triads(read, 0.1, 1 / self.rate_hz, count=_SELF_TEST_SAMPLES) / self.sensitivity

    def fetch(self) -> bytes:
        """Read 0x26 ... 0x2D with auto-increment: temperature, status, x, y, z."""
        return self.registers.peek_counting(facts.OUT_TEMP, self.burst)

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 16 bits, low byte first; the temperature decreases by one count per degC (L3G-60).

        Stale where ZYXDA was clear, overrun where ZYXOR was set: new data replaced unread data (L3G-52).
        """
        triads, fresh = _triads(bursts[:, 2:8]), flag_freshness(bursts[:, 1], facts.ZYX_AVAILABLE, facts.ZYX_OVERRUN)
        return DecodedBursts(triads.counts, bursts[:, 0].view(np.int8).astype(np.int16), triads.status | fresh)


class L3g4200dFifo(L3g4200d):
    """The same chip with its queue of 32 sets drained: one transaction reads their number, one fetches all of them.

    The address wraps from 0x2D to 0x28 (L3G-05), so that a drain is one burst. The thermometer is before the wrap and
    is not read.
    """

    burst: ClassVar[int] = 6
    reading: ClassVar[slice] = slice(0, 6)
    fifo: ClassVar[bool] = True

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.queue = FifoClock(self.rate_hz)

    def steps(self) -> Iterator[float]:
        """Configure as without the queue, then through bypass, which empties it (L3G-54); its clock starts again."""
        yield from super().steps()
        self.registers.set(facts.FIFO_MODE(_BYPASS), self.settings[-1])
        self.queue.restart()

    def fetch(self) -> bytes:
        """Return every set in the queue, oldest first."""
        at_ns = self.clock.now_ns()
        source = self.registers.peek(facts.FIFO_SRC_REG)[0]
        until_ns = self.clock.now_ns()
        overrun = facts.FIFO_OVERRUN.of(source)
        level = facts.FIFO_LEVEL.of(source) + overrun  # five bits can't express 32: L3G-58
        sets = self.registers.peek_counting(facts.OUT_X_L, self.burst * level) if level else b""
        self.queue.times(level, at_ns, bool(overrun), until_ns=until_ns)
        return sets

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 16 bits, low byte first; a set in the queue is always new."""
        return _triads(bursts)


def _triads(data: Bytes) -> DecodedBursts:
    counts = words16(data)
    return DecodedBursts(counts, None, flag_saturated(counts, -32768, 32767))
