"""AKM's magnetometers in InvenSense's chips: AK8963 in the MPU-9250 (AKM data sheet MS1356-E-02, 2013; facts AKM-01 to
-16), and AK8975 in the MPU-9150 (facts AKM-21 to -28).

They are on the auxiliary bus of the MPU, and answer on the array's bus while its bypass is open (INV-97): the driver
opens it. One burst is ST1, x, y, z low byte first, and ST2, which must be read last: it unlocks the data registers
(AKM-12). The factory's adjustment of the sensitivity, a byte for each axis, is in the header of a log; counts are not
adjusted. Their x is along the y of the MPU, their y along x, their z opposite to z (AKM-03).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import ModuleType
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
    Limits,
    Registers,
    SelfTest,
    carry_out,
    flag_bits,
    within,
    words16,
)
from imuarray.errors import SensorError
from imuarray.facts import ak8963, ak8975, mpu6500
from imuarray.facts.registers import Register, Setting
from imuarray.log.format import OVERRUN, SATURATED, STALE

_MODES = {8.0: 0b0010, 100.0: 0b0110}  # AKM-13
_POWER_DOWN, _SELF_TEST_MODE, _FUSE_ROM = 0b0000, 0b1000, 0b1111
_MODE_CHANGE_S = 0.001  # 100 us: AKM-13
_MEASURED_S = 0.010  # at most 9 ms: AKM-14


class Ak8963(ChipDriver):
    """Driver of one AK8963."""

    table: ClassVar[ModuleType] = ak8963
    burst: ClassVar[int] = 8
    first: ClassVar[Register] = ak8963.ST1  # ST1, x, y, z, ST2: AKM-12, AKM-23
    has_data_ready: ClassVar[bool] = True
    reading: ClassVar[slice] = slice(1, 7)
    host_name: ClassVar[str] = "MPU-9250"
    host_identities: ClassVar[tuple[int, ...]] = (0x71, 0x73)  # MPU-9250, MPU-9255: INV-03
    self_test_limits: ClassVar[Limits] = ((-200.0, 200.0), (-200.0, 200.0), (-3200.0, -800.0))  # AKM-15, adjusted
    overrun_bit: ClassVar[int] = ak8963.DATA_OVERRUN.mask

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.rate_hz = sensor.chip_rate_hz
        self.mode = self.mode_setting(_MODES[self.rate_hz])
        self.watched = (self.mode, ak8963.SELF_TEST(0))
        self.adjustment = bytes(3)

    def mode_setting(self, code: int) -> Setting:
        """Return the setting of a mode, with counts of 16 bits (AKM-13)."""
        return ak8963.SIXTEEN_BITS(1) | ak8963.MODE(code)

    def open_bypass(self) -> None:
        """Open the bypass of the MPU on this bus, if there is one; SensorError for two of them, whose magnetometers
        have one address.
        """
        hosts = []
        for address in mpu6500.ADDRESSES:
            host = Registers(self.registers.bus, address, self.registers.label)
            try:
                if host.peek(mpu6500.WHO_AM_I)[0] in self.host_identities:
                    hosts.append(host)
            except OSError:
                continue
        if len(hosts) > 1:
            raise SensorError(
                f"{self.registers.label}: two {self.host_name} are on this bus, and their magnetometers have one"
                " address: connect them to two channels"
            )
        for host in hosts:
            if mpu6500.MASTER_ON.of(host.peek(mpu6500.USER_CTRL)[0]):  # set by another program; it closes the bypass
                host.change(mpu6500.MASTER_ON(0))
            host.change(mpu6500.BYPASS(1))

    def identify(self) -> None:
        """Check the identity, with the bypass open (AKM-02); SensorError."""
        self.open_bypass()
        super().identify()

    def steps(self) -> Iterator[float]:
        """Open the bypass, read the fuse ROM, then measure continuously; SensorError if the ROM holds no adjustment."""
        self.open_bypass()
        yield from self._set_mode(_POWER_DOWN)
        self.registers.set(self.table.SELF_TEST(0))
        yield from self._set_mode(_FUSE_ROM)
        self.adjustment = self.registers.peek(self.table.ASAX, 3)
        if not all(self.adjustment):
            raise SensorError(f"{self.registers.label}: the fuse ROM reads {self.adjustment.hex(' ')}: not an AK8963")
        yield from self._set_mode(_POWER_DOWN)
        self.start_measuring()
        yield 2 / self.rate_hz

    def start_measuring(self) -> None:
        """Write the mode, and verify it."""
        self.registers.set(self.mode)

    def _set_mode(self, mode: int) -> Iterator[float]:
        """Set a mode through power-down (AKM-13, AKM-24)."""
        setting = self.mode_setting(mode)
        self.registers.poke(setting.register, setting.value)
        yield _MODE_CHANGE_S

    @property
    def factors(self) -> Floats:
        """Return the factors (3,) of the counts: (ASA + 128) / 256 (AKM-16)."""
        return (np.frombuffer(self.adjustment, np.uint8).astype(float) + 128) / 256

    def self_test(self) -> SelfTest:
        """Measure the field of the self-test, adjusted (AKM-15)."""
        self.configure()
        carry_out(self.clock, self._set_mode(_POWER_DOWN))
        self.registers.poke(self.table.ASTC, self.table.SELF_TEST(1).value)
        carry_out(self.clock, self._set_mode(_SELF_TEST_MODE))
        sleep_for(self.clock, _MEASURED_S)
        burst = self.registers.peek(self.first, self.burst)
        decoded = self.decode(np.frombuffer(burst, np.uint8).reshape(1, -1))
        self.registers.poke(self.table.ASTC, 0)
        answer = decoded.counts[0] * self.factors
        self.configure()
        limits = ", ".join(f"{low:.0f} to {high:.0f}" for low, high in self.self_test_limits)
        readings = ", ".join(f"{value:+.0f}" for value in answer)
        if decoded.status[0] & STALE:
            return SelfTest(False, "no answer to the self-test in 10 ms")
        return SelfTest(within(answer, self.self_test_limits), f"answers {readings} counts; limits {limits}")

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return words of 16 bits, low byte first; stale where ST1 showed no new data, overrun where it showed skipped
        data, saturated where ST2 showed an overflow of the sensor (AKM-11, AKM-12, AKM-22, AKM-23).
        """
        status = flag_bits(~bursts[:, 0], self.table.DATA_READY.mask, STALE)
        status |= flag_bits(bursts[:, 0], self.overrun_bit, OVERRUN)
        status |= flag_bits(bursts[:, 7], self.table.OVERFLOW.mask, SATURATED)
        return DecodedBursts(words16(bursts[:, self.reading]), None, status)

    def header(self) -> Mapping[str, int]:
        """Return the adjustment of the sensitivity: the field is counts * (asa + 128) / 256 / sensitivity (AKM-16)."""
        return dict(zip(("asa_x", "asa_y", "asa_z"), self.adjustment, strict=True))


_SINGLE = 0b0001
_PERIOD_NS = 9_500_000
"""Shortest time in ns from one measurement to the next at 100 Hz: less than a period, because a poll may be early."""
_LONGEST_NS = 20_000_000
"""Time in ns after which a measurement that is not finished counts as not started: twice the longest time that any
source states (AKM-25).
"""


class Ak8975(Ak8963):
    """Driver of one AK8975. It measures only on command: a call reads the last measurement and starts the next. A
    reading was therefore measured right after the previous call, at most 100 times per second.
    """

    table: ClassVar[ModuleType] = ak8975
    first: ClassVar[Register] = ak8975.ST1
    host_name: ClassVar[str] = "MPU-9150"
    host_identities: ClassVar[tuple[int, ...]] = (0x68,)  # INV-02
    self_test_limits: ClassVar[Limits] = ((-100.0, 100.0), (-100.0, 100.0), (-1000.0, -300.0))
    overrun_bit: ClassVar[int] = 0  # there is none: a measurement is started only after the last one was read

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.mode = self.mode_setting(_SINGLE)
        self.watched = (ak8975.SELF_TEST(0),)  # the mode does not remain as written: AKM-24
        self._is_over, self._started_ns = True, -_PERIOD_NS

    def mode_setting(self, code: int) -> Setting:
        """Return the setting of a mode (AKM-24)."""
        return ak8975.MODE(code)

    def steps(self) -> Iterator[float]:
        """Set the chip up as the AK8963, to the first measurement."""
        yield from super().steps()
        self._is_over, self._started_ns = True, self.clock.now_ns() - _PERIOD_NS

    def start_measuring(self) -> None:
        """Start the first measurement; the chip powers down when it is over."""
        self.registers.poke(ak8975.CNTL, self.mode.value)

    def fetch(self) -> bytes:
        """Read a burst; then start a new measurement if the last one is finished: a write of the mode would abort it
        (AKM-23, DEC-235).
        """
        block = super().fetch()
        self._is_over |= bool(block[0] & ak8975.DATA_READY.mask)
        now_ns = self.clock.now_ns()
        if now_ns >= self._started_ns + (_PERIOD_NS if self._is_over else _LONGEST_NS):
            self.start_measuring()
            self._is_over, self._started_ns = False, now_ns
        return block
