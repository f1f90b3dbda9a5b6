"""BMA180 accelerometer. Bosch data sheet v2.5 (2010); facts BMA-*.

The image registers share bytes with factory trim and are locked: unlock with ee_w, read-modify-write, read back
(BMA-51, section 2.10 of the facts). Writes are (register, value) pairs (BMA-05); nothing at or above 0x40 is ever
written (BMA-55). Codes have 14 bits, left-justified, with a new-data flag in bit 0 of each low byte (BMA-60, BMA-62).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.arrays import Floats
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock, sleep_for
from imuarray.drivers.driver import Bytes, ChipDriver, DecodedBursts, SelfTest, carry_out, flag_saturated
from imuarray.facts import bma180 as facts
from imuarray.facts.registers import Register, Setting
from imuarray.log.format import STALE
from imuarray.printable import counted

_RANGE_CODES = {
    1.0: 0b000,
    1.5: 0b001,
    2.0: 0b010,
    3.0: 0b011,
    4.0: 0b100,
    8.0: 0b101,
    16.0: 0b110,
}  # BMA-70 ... BMA-76
_BANDWIDTH_CODES = {10.0: 0, 20.0: 1, 40.0: 2, 75.0: 3, 150.0: 4, 300.0: 5, 600.0: 6, 1200.0: 7}  # BMA-81 ... BMA-88
_SOFT_RESET = 0xB6
_EEPROM_DOWNLOAD_S = 0.020  # the 10 us of the data sheet are not enough: BMA-53
_SELF_TEST_NS = 12_000_000  # the test lasts less than 10 ms: BMA-104
_SELF_TEST_LSB = 200
_SELF_TEST_REST_S = 0.0015  # between readings at rest: eight take as long as the test, and show motion
_SELF_TEST_GAP_NS = 2_000_000
"""Longest interval in ns between two readings in self-test: the deflection lasts less than 10 ms in total (BMA-104)."""
_SELF_TEST_SIGMAS = 4.0
"""Number of standard deviations at rest that a deflection must also exceed, so that noise and motion do not pass the
test.
"""
_SLOWEST_SETTLING_S = 253 / 2400  # samples to settle at 10 Hz, the narrowest low-pass: BMA-81


class Bma180(ChipDriver):
    """Driver of one BMA180."""

    burst: ClassVar[int] = 7
    first: ClassVar[Register] = facts.ACC_X_LSB  # x, y, z, low byte first for the shadow, and temperature: BMA-99
    unused: ClassVar[Register | None] = facts.CD1  # a byte for the user; the EEPROM is unchanged: BMA-35
    has_data_ready: ClassVar[bool] = True
    reading: ClassVar[slice] = slice(0, 6)

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.settings = (
            facts.BANDWIDTH(_BANDWIDTH_CODES[sensor.chip_bandwidth_hz]),
            facts.MODE_CONFIG(0b00),  # low noise: BMA-96
            facts.SHADOW_DIS(0),  # low and high byte of an axis from one conversion: BMA-99
            facts.RANGE(_RANGE_CODES[sensor.range or 2.0]) | facts.SMP_SKIP(0),
            facts.READOUT_12BIT(0),  # the EEPROM of a used part may differ: BMA-59, BMA-61
        )
        self.watched = self.settings

    def steps(self) -> Iterator[float]:
        """Reset, wait for the EEPROM download, unlock, change, read back, lock, let the filter settle."""
        yield from self._set_up(self.settings)
        self.registers.change(facts.EE_W(0))
        yield _SLOWEST_SETTLING_S

    def _set_up(self, settings: Sequence[Setting]) -> Iterator[float]:
        """Configure from any state, and read the settings back; the image remains unlocked."""
        self.registers.poke(facts.RESET, _SOFT_RESET)
        yield _EEPROM_DOWNLOAD_S
        self.registers.change(facts.EE_W(1))
        for setting in settings:
            self.registers.change(setting)
            yield 0.0
        for setting in settings:
            self.registers.verify(setting)
            yield 0.0

    def self_test(self) -> SelfTest:
        """Measure the largest deflection while st0 is set, at 2 g and 1200 Hz: more than 200 counts on every axis
        (BMA-104).
        """
        quick = (facts.BANDWIDTH(_BANDWIDTH_CODES[1200.0]), facts.RANGE(_RANGE_CODES[2.0]) | facts.SMP_SKIP(0))
        carry_out(self.clock, self._set_up(quick))
        sleep_for(self.clock, 0.005)
        before = np.array([self._counts_after(_SELF_TEST_REST_S) for _ in range(8)])
        rest = before.mean(axis=0)
        test = facts.SELF_TEST_0(1)
        order = test.into(self.registers.peek(test.register)[0])
        looked_ns = begun_ns = self.clock.now_ns()  # the test begins within the next transaction
        longest_ns = looks = 0
        self.registers.poke(test.register, order)
        deflection = np.zeros(3)
        while looked_ns < begun_ns + _SELF_TEST_NS:
            deflection = np.maximum(deflection, np.abs(self._counts_after(0.0) - rest))
            now_ns = self.clock.now_ns()
            longest_ns, looked_ns, looks = max(longest_ns, now_ns - looked_ns), now_ns, looks + 1
            sleep_for(self.clock, 0.0005)
        self.configure()
        text = f"deflects {', '.join(f'{value:.0f}' for value in deflection)} counts; over {_SELF_TEST_LSB} required"
        noise = _SELF_TEST_SIGMAS * before.std(axis=0)
        passed = bool((deflection > np.maximum(noise, _SELF_TEST_LSB)).all())
        if not passed and noise.max() > _SELF_TEST_LSB:
            return SelfTest(None, f"{text}; it moved during the test: keep it at rest and try again")
        if not passed and longest_ns > _SELF_TEST_GAP_NS:
            slow = f"the bus allowed {counted(looks, 'look')} in {(looked_ns - begun_ns) * 1e-6:.0f} ms"
            return SelfTest(None, f"{text}; {slow}, and the deflection lasts 10 ms at most")
        return SelfTest(passed, text)

    def _counts_after(self, seconds: float) -> Floats:
        """Return one reading (3,) in counts, after a wait."""
        sleep_for(self.clock, seconds)
        burst = np.frombuffer(self.fetch(), np.uint8).reshape(1, self.burst)
        return np.asarray(self.decode(burst).counts[0], float)

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 14 bits; temperature at 0.5 K per count, 0 at 24 degC (BMA-63); stale if no axis is new."""
        words = np.ascontiguousarray(bursts[:, 0:6]).view("<i2")
        counts = (words >> 2).astype(np.int16)
        fresh = (words & facts.NEW_DATA_X.mask).any(axis=1)
        status = flag_saturated(counts, -8192, 8191) | np.where(fresh, 0, STALE).astype(np.uint16)
        return DecodedBursts(counts, bursts[:, 6].view(np.int8).astype(np.int16), status)
