"""AK8975 magnetometer, as it is in the MPU-9150; facts AKM-21 ... AKM-28.

It measures only on command: a call reads the last measurement and starts the next, so that a reading was measured right
after the previous call, at most 100 times a second. Otherwise it is like the AK8963 (`imuarray.drivers.ak8963`): behind
the bypass of the MPU, with a fuse ROM, and with the same axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock
from imuarray.drivers.ak8963 import Ak8963
from imuarray.drivers.driver import Bytes, DecodedBursts, flagged
from imuarray.facts import ak8975 as facts
from imuarray.facts.registers import Setting
from imuarray.log.format import SATURATED, STALE

_SINGLE = 0b0001
_PERIOD_NS = 9_500_000
"""Shortest time from one measurement to the next at 100 Hz: a poll may be early."""
_LONGEST_NS = 20_000_000
"""A measurement that is not over after this time never began: twice the longest time that any source states
(AKM-25).
"""


class Ak8975(Ak8963):
    """Driver of one AK8975."""

    host_name: ClassVar[str] = "MPU-9150"
    host_identities: ClassVar[tuple[int, ...]] = (0x68,)  # INV-02
    self_test_limits: ClassVar[tuple[tuple[float, float], ...]] = ((-100.0, 100.0), (-100.0, 100.0), (-1000.0, -300.0))

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self._is_over, self._started_ns = True, -_PERIOD_NS

    def settings(self) -> tuple[Setting, tuple[Setting, ...]]:
        """Return the single-measurement mode, and the settings that remain as written: the mode does not (AKM-24)."""
        return facts.MODE(_SINGLE), (facts.SELF_TEST(0),)

    def _set_mode(self, mode: int) -> Iterator[float]:
        """Set a mode through power-down (AKM-24)."""
        self.registers.poke(facts.CNTL, facts.MODE(mode).value)
        yield 0.001

    def steps(self) -> Iterator[float]:
        """Set the chip up as the AK8963, to the first measurement."""
        yield from super().steps()
        self._is_over, self._started_ns = True, self.clock.now_ns() - _PERIOD_NS

    def start_measuring(self) -> None:
        """Start the first measurement; the chip powers down when it is over."""
        self.registers.poke(facts.CNTL, self.mode.value)

    def fetch(self) -> bytes:
        """Read 0x02 ... 0x09: ST1, x, y, z, ST2; then start a new measurement if that one is over: a write of the mode
        would abort it (AKM-23, DEC-235).
        """
        block = self.registers.peek(facts.ST1, self.burst)
        self._is_over |= bool(block[0] & facts.DATA_READY.mask)
        now_ns = self.clock.now_ns()
        if now_ns >= self._started_ns + (_PERIOD_NS if self._is_over else _LONGEST_NS):
            self.start_measuring()
            self._is_over, self._started_ns = False, now_ns
        return block

    def measured(self) -> bytes:
        """Return the burst of the self-test: no measurement follows it."""
        return self.registers.peek(facts.ST1, self.burst)

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 13 bits in words of 16, low byte first; stale where ST1 showed no new data, saturated where
        ST2 showed an overflow of the sensor (AKM-22, AKM-23).
        """
        counts = np.ascontiguousarray(bursts[:, self.reading]).view("<i2").astype(np.int16)
        status = flagged(~bursts[:, 0], facts.DATA_READY.mask, STALE)
        return DecodedBursts(counts, None, status | flagged(bursts[:, 7], facts.OVERFLOW.mask, SATURATED))
