"""MPU-6050 accelerometer and gyroscope: InvenSense RM-MPU-6000A rev. 4.2, PS-MPU-6000A rev. 3.4.

Facts: INV-*, DEC-250 to -254.

Samples are on the die's own grid, which begins when it wakes up. Not modelled: auxiliary bus, motion detection, the
low-power cycle, standby of single axes, and the settling of the zero-rate level.
"""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any, ClassVar

from firmware_emulator.chip import Triple
from firmware_emulator.chips.mpu_queue import BASE_PERIOD_NS, DATA, UNFILTERED_PERIOD_NS, MpuFamily
from firmware_emulator.six_axis import Die
from firmware_emulator.tolerances import Tolerances, typical
from imuarray.facts import mpu6050 as facts
from imuarray.facts.registers import Field, Register

ACCEL_FILTERS = (
    *((260.0, 0.0), (184.0, 0.002), (94.0, 0.003), (44.0, 0.0049), (21.0, 0.0085), (10.0, 0.0138), (5.0, 0.019)),
    (260.0, 0.0),
)
"""Bandwidth (Hz) and delay (s) by DLPF_CFG: INV-12, DEC-252. A filter reduces noise, but only delays motion."""
GYRO_FILTERS = (
    *((256.0, 0.00098), (188.0, 0.0019), (98.0, 0.0028), (42.0, 0.0048), (20.0, 0.0083), (10.0, 0.0134), (5.0, 0.0186)),
    (256.0, 0.00098),
)
CLOCK_INPUTS_HZ = {4: 32_000.0, 5: 19_200_000.0}
"""Frequency at CLKIN, by CLKSEL, with which the nominal 1 kHz is exact; with 32.768 kHz it is 1.024 kHz (INV-37)."""
UNFILTERED = (0, 7)  # the gyroscope then delivers 8 kHz: INV-11
TRIM_CODE = 17
"""Trim code of every axis by default: the middle of the range of codes (DEC-253)."""


class Mpu6050Chip(MpuFamily):
    """The registers and the queue of 1024 bytes; `identity` is 0x98 for a clone (INV-03), `clock_input_hz` the
    frequency at CLKIN (0: no clock is connected).
    """

    table: ClassVar[ModuleType] = facts
    who_am_i: ClassVar[Register | None] = facts.WHO_AM_I
    reset_bit: ClassVar[Field] = facts.DEVICE_RESET
    fifo_bytes: ClassVar[int] = 1024  # INV-27
    default_trim_code: ClassVar[int] = TRIM_CODE
    accel_push_range: ClassVar[int] = 0b10

    def __init__(self, *arguments: Any, clock_input_hz: float = 0.0, **switches: Any) -> None:
        self._clock_input_hz = clock_input_hz
        super().__init__(*arguments, **switches)

    def power_on(self, at_ns: int) -> None:
        """Set every register to its reset value, asleep, with an empty queue (INV-10, INV-25)."""
        super().power_on(at_ns)
        code = self._trim_code
        high, low = (code >> 2) << 5 | code, code & 0b11
        self.page[facts.SELF_TEST_X.address : facts.SELF_TEST_A.address + 1] = bytes(
            (high, high, high, low << 4 | low << 2 | low)
        )

    def own_period_ns(self, period_ns: float) -> int:
        """Return the same period as `SixAxis.own_period_ns`, or that by the clock at CLKIN if PWR_MGMT_1 selects it; 0
        if no clock is connected (INV-37, DEC-254).
        """
        source = facts.CLOCK.of(self.page[facts.PWR_MGMT_1.address])
        if source not in CLOCK_INPUTS_HZ:
            return super().own_period_ns(period_ns)
        return round(period_ns * CLOCK_INPUTS_HZ[source] / self._clock_input_hz) if self._clock_input_hz else 0

    def low_passes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return bandwidth and delay of both filters, which one code sets (INV-12)."""
        code = facts.DLPF.of(self.page[facts.CONFIG.address])
        return ACCEL_FILTERS[code], GYRO_FILTERS[code]

    def temperature_code(self, degc: float) -> int:
        """Return the code of a temperature (INV-42)."""
        return round((degc - 35.0) * 340.0 - 521.0)

    def accel_push(self) -> Triple:
        """Return the change by the self-test in codes at 8 g (INV-46)."""
        push = 1392.64 * (0.92 / 0.34) ** ((self._trim_code - 1) / 30) if self._trim_code else 0.0
        return push, push, push

    def gyro_push(self) -> Triple:
        """Return the change by the self-test in codes at 250 dps, which is subtracted from y (INV-47)."""
        push = 3275.0 * 1.046 ** (self._trim_code - 1) if self._trim_code else 0.0
        return push, -push, push

    # Reading --------------------------------------------------------------------------------------------------------

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Read a burst. Its bytes belong to one instant: the data registers do not change until STOP (INV-30)."""
        self.end_reset(at_ns)
        self._sync(at_ns)
        data = bytes(self.page[DATA.start : DATA.stop])
        first = self.pointer - DATA.start
        if first >= 0 and first + count <= len(data):
            self.pointer += count
            answer = data[first : first + count]
        else:
            answer = super().read(count, at_ns, byte_ns)
        if facts.INT_READ_CLEAR.of(self.page[facts.INT_PIN_CFG.address]):
            self._flags = 0  # INV-22
        return answer

    def _restart(self, address: int, at_ns: int) -> None:
        """Restart the grid of samples if the rate changed or the die was woken up (DEC-250)."""
        if address not in (facts.PWR_MGMT_1.address, facts.SMPLRT_DIV.address, facts.CONFIG.address):
            return
        fast = facts.DLPF.of(self.page[facts.CONFIG.address]) in UNFILTERED
        base_ns = UNFILTERED_PERIOD_NS if fast else BASE_PERIOD_NS
        period_ns = base_ns * (1 + self.page[facts.SMPLRT_DIV.address])
        asleep = facts.SLEEP.of(self.page[facts.PWR_MGMT_1.address])
        self._grid.set(at_ns, 0 if asleep else self.own_period_ns(period_ns))


_ACCEL_SPAN_DEGC = 45.0  # from 25 degC to the end of the range over which the change is printed

ACCELEROMETER_TOLERANCES = Tolerances(
    bias=(typical(0.050), typical(0.050), typical(0.080)),
    slope_per_degc=(
        typical(0.035 / _ACCEL_SPAN_DEGC),
        typical(0.035 / _ACCEL_SPAN_DEGC),
        typical(0.060 / _ACCEL_SPAN_DEGC),
    ),
    scale=typical(0.03),
    cross_axis=typical(0.02),
    noise=(400e-6 * math.sqrt(44.0),) * 3,
    noise_full_scale=2.0,
    noise_bandwidth_hz=44.0,
    scale_slope_per_degc=typical(2e-4),
    thermometer_degc=typical(1.0),
)
"""The tolerances INV-50 ... INV-55; apart from the cross-axis sensitivity, alignment is not specified."""


_GYRO_SPAN_DEGC = 65.0  # from 25 degC to the far end of -40 ... 85 degC

GYROSCOPE_TOLERANCES = Tolerances(
    bias=(typical(20.0),) * 3,
    slope_per_degc=(typical(20.0 / _GYRO_SPAN_DEGC),) * 3,
    scale=typical(0.03),
    cross_axis=typical(0.02),
    noise=(0.005 * math.sqrt(42.0),) * 3,
    noise_full_scale=250.0,
    noise_bandwidth_hz=42.0,
    scale_slope_per_degc=typical(0.02 / _GYRO_SPAN_DEGC),
    g_sensitivity=typical(0.1),
    thermometer_degc=typical(1.0),
)
"""The tolerances INV-60 ... INV-66."""


DIE = Die(Mpu6050Chip, (facts.ACCEL_XOUT_H, facts.GYRO_XOUT_H), (ACCELEROMETER_TOLERANCES, GYROSCOPE_TOLERANCES))
