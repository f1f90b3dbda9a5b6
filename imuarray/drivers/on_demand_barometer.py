"""Barometers that measure once on command and sleep otherwise.

No call waits for a measurement: each call of `fetch` checks whether the started one must be over by now, and starts the
next when it is due. Every reading is therefore new, and its time is known.
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.arrays import Integers
from imuarray.barometer import BAROMETERS, Words
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock, sleep_for
from imuarray.drivers.driver import Bytes, ChipDriver, DecodedBursts, SelfTest, barometer_readings
from imuarray.facts.registers import Register, Setting

_CALLS = 3
"""The number of late calls in a row after which calls are considered rare rather than interrupted."""


class OnDemandBarometer(ChipDriver):
    """The common part of their drivers: the time at which a result is read, and a check in place of the missing
    self-test.

    `limits_pa`: the operating range of the pressure.
    """

    burst: ClassVar[int] = 6
    reading: ClassVar[slice] = slice(0, 6)
    tells_fresh: ClassVar[bool] = True
    conversions_ns: ClassVar[tuple[int, ...]]
    lasting_ns: ClassVar[int] = 100_000_000
    """An older result is not used as a new one, unless every call is so late."""
    limits_pa: ClassVar[tuple[float, float]]

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.period_ns = round(1e9 / sensor.chip_rate_hz)
        self.watched: tuple[Setting, ...] = ()
        self.words: Words = {}
        self.arithmetic = BAROMETERS[sensor.chip]
        self._due_ns = 0
        self._done_ns: int | None = None
        self._called_ns: int | None = None
        self._intervals_ns: deque[int] = deque(maxlen=_CALLS)

    @property
    def ready_ns(self) -> int | None:
        """The end of the measurement in progress; None if there is none."""
        return self._done_ns

    def begin(self) -> None:
        """Discard the measurement in progress: the next call of `fetch` starts another."""
        self._due_ns, self._done_ns = self.clock.now_ns(), None

    def fetch(self) -> bytes:
        """Return a reading when a measurement is over; empty otherwise."""
        raise NotImplementedError

    def words_of(self, bursts: Bytes) -> tuple[Integers, Integers]:
        """Return UT (n,) and UP (n,)."""
        raise NotImplementedError

    def self_test(self) -> SelfTest:
        """Check one measurement, whose temperature and pressure must lie within the operating range; the chip has no
        self-test.
        """
        self.configure()
        burst, tries, longest_ns = b"", 0, 0
        while not burst and tries < 100:
            asked_ns = self.clock.now_ns()
            sleep_for(self.clock, 0.005)
            burst, tries = self.fetch(), tries + 1
            longest_ns = max(longest_ns, self.clock.now_ns() - asked_ns)
        if not burst and longest_ns > self.lasting_ns // 2:
            slow = f"the bus takes {longest_ns * 1e-6:.0f} ms per transaction"
            return SelfTest(None, f"no self-test in the chip; {slow}, too slow to wait for a measurement")
        if not burst:
            return SelfTest(False, "no measurement within half a second")
        values = self.decode(np.frombuffer(burst, np.uint8).reshape(1, self.burst)).compensated
        temperature_degc, pressure_pa = float(values["temperature"][0]), float(values["pressure"][0])
        low, high = self.limits_pa
        passed = -40 <= temperature_degc <= 85 and low <= pressure_pa <= high
        return SelfTest(passed, f"no self-test in the chip; reads {temperature_degc:.1f} degC, {pressure_pa:.0f} Pa")

    def _result_due_ns(self, now_ns: int) -> int | None:
        """Return the end of the measurement in progress; None if there is none, or if its result would be too old in
        this call. Where calls are rare, it may be as old as the call interval.
        """
        seldom_ns = min(self._intervals_ns) if len(self._intervals_ns) == _CALLS else 0
        if self._called_ns is not None:
            self._intervals_ns.append(now_ns - self._called_ns)
        self._called_ns = now_ns
        if self._done_ns is not None and now_ns > self._done_ns + max(self.lasting_ns, 2 * seldom_ns):
            self._done_ns = None
        return self._done_ns

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return UT and UP as counts, with temperature in degC and pressure in Pa."""
        ut, up = self.words_of(bursts)
        temperature_degc, pressure_pa = self.arithmetic.compensate(ut, up, self.words)
        return barometer_readings(ut, up, temperature_degc, pressure_pa)

    def header(self) -> Mapping[str, int]:
        """Return the calibration words, which the conversion of the counts requires."""
        return {**self.words, **self.arithmetic.settings}


class ForcedBarometer(OnDemandBarometer):
    """The common part of drivers of chips that measure temperature and pressure at once ("forced mode").

    `first`: the register at which a read of the chip begins; `head` bytes come before the reading; `busy`: bits of the
    first byte that are set while the chip measures. `force`: the setting that starts a measurement.
    """

    first: ClassVar[Register]
    head: ClassVar[int]
    busy: ClassVar[int] = 0
    force: ClassVar[Setting]

    def is_over(self, head: bytes) -> bool:
        """Return whether the requested measurement is over, by the bytes before the reading."""
        raise NotImplementedError

    def fetch(self) -> bytes:
        """Return six bytes when a measurement is over; empty otherwise.

        A call that fails with OSError changes nothing and can be repeated, except EIO, where the chip did not measure:
        the next call starts a measurement.
        """
        now_ns = self.clock.now_ns()
        done_ns = self._result_due_ns(now_ns)
        if done_ns is None:
            if now_ns >= self._due_ns:
                self.registers.poke(self.force.register, self.force.value)
                self._done_ns = now_ns + self.conversions_ns[0]
                self._due_ns = max(self._due_ns + self.period_ns, now_ns)
            return b""
        if now_ns < done_ns:
            return b""
        block = self.registers.peek(self.first, self.head + self.burst)
        self._done_ns = None
        if not self.is_over(block[: self.head]):
            raise OSError(errno.EIO, f"{self.registers.label}: measurement not finished in time, or lost")
        return block[self.head :]
