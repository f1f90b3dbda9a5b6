"""MPU-6500 accelerometer and gyroscope, and those of the MPU-9250: InvenSense RM-MPU-9250A rev. 1.4.

Facts INV-70 ... INV-79, DEC-80 and -81. The die is awake after power-on; samples are on its own grid, which begins
then. Not modelled: the fifth slot of the auxiliary bus, motion detection, low-power cycle, the settling of the
zero-rate level.
"""

from __future__ import annotations

import math
from functools import partial
from types import ModuleType
from typing import ClassVar

from firmware_emulator.chip import Triple
from firmware_emulator.chips.mpu_queue import BASE_PERIOD_NS, UNFILTERED_PERIOD_NS, MpuFamily
from firmware_emulator.six_axis import Die
from firmware_emulator.tolerances import Tolerances, typical
from imuarray.facts import mpu6500 as facts
from imuarray.facts.registers import Field, Register

GYRO_FILTERS = (
    *((250.0, 0.00097), (184.0, 0.0029), (92.0, 0.0039), (41.0, 0.0059), (20.0, 0.0099), (10.0, 0.01785)),
    *((5.0, 0.03348), (3600.0, 0.00017)),
)
"""Bandwidth (Hz) and delay (s) by DLPF_CFG: INV-73, INV-79. A filter reduces noise, but only delays motion."""
ACCEL_FILTERS = (
    *((460.0, 0.00194), (184.0, 0.0058), (92.0, 0.0078), (41.0, 0.0118), (20.0, 0.0198), (10.0, 0.0357)),
    *((5.0, 0.06696), (460.0, 0.00194)),
)
"""The same by A_DLPF_CFG: INV-74, INV-79."""
UNFILTERED_ACCEL = (1130.0, 0.00075)
TRIM_CODE = 120
"""Trim code of every axis by default: a deflection of 65 dps and of 0.52 g (DEC-81)."""


class Mpu6500Chip(MpuFamily):
    """The registers; `identity` is 0x71 for an MPU-9250."""

    table: ClassVar[ModuleType] = facts
    who_am_i: ClassVar[Register | None] = facts.WHO_AM_I
    reset_bit: ClassVar[Field] = facts.DEVICE_RESET
    fifo_bytes: ClassVar[int] = 512  # INV-98
    default_trim_code: ClassVar[int] = TRIM_CODE
    accel_push_range: ClassVar[int] = 0

    def power_on(self, at_ns: int) -> None:
        """Set every register to its reset value, awake (INV-71)."""
        super().power_on(at_ns)
        for register in (facts.SELF_TEST_X_GYRO, facts.SELF_TEST_X_ACCEL):
            self.page[register.address : register.address + 3] = bytes([self._trim_code] * 3)
        self._restart(facts.PWR_MGMT_1.address, at_ns)

    def low_passes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return bandwidth and delay of each filter (INV-73, INV-74)."""
        control = self.page[facts.ACCEL_CONFIG_2.address]
        unfiltered = facts.ACCEL_UNFILTERED.of(control)
        low_pass = UNFILTERED_ACCEL if unfiltered else ACCEL_FILTERS[facts.ACCEL_DLPF.of(control)]
        return low_pass, GYRO_FILTERS[facts.DLPF.of(self.page[facts.CONFIG.address])]

    def temperature_code(self, degc: float) -> int:
        """Return the code of a temperature (INV-76)."""
        return round((degc - 21.0) * 333.87)

    def accel_push(self) -> Triple:
        """Return the change that was measured at the factory for the smallest range, in codes (INV-78)."""
        push = 2620.0 * 1.01 ** (self._trim_code - 1) if self._trim_code else 0.0
        return push, push, push

    def gyro_push(self) -> Triple:
        """Return the same change as for the accelerometer."""
        return self.accel_push()

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Read a burst; all its bytes belong to one instant (INV-75)."""
        self.end_reset(at_ns)
        self._sync(at_ns)
        return super().read(count, at_ns, byte_ns)

    def _restart(self, address: int, at_ns: int) -> None:
        """Restart the grid if the rate changed or the die was woken up (DEC-80)."""
        config, gyro = self.page[facts.CONFIG.address], self.page[facts.GYRO_CONFIG.address]
        divided = 0 < facts.DLPF.of(config) < 7 and not facts.GYRO_UNFILTERED.of(gyro)
        period_ns = BASE_PERIOD_NS * (1 + self.page[facts.SMPLRT_DIV.address]) if divided else UNFILTERED_PERIOD_NS
        asleep = facts.SLEEP.of(self.page[facts.PWR_MGMT_1.address])
        self._grid.set(at_ns, 0 if asleep else self.own_period_ns(period_ns))


ACCELEROMETER_TOLERANCES = Tolerances(
    bias=(typical(0.060), typical(0.060), typical(0.080)),
    slope_per_degc=(typical(1.5e-3),) * 3,
    scale=typical(0.03),
    cross_axis=typical(0.02),
    noise=(300e-6 * math.sqrt(41.0),) * 3,
    noise_full_scale=2.0,
    noise_bandwidth_hz=41.0,
    scale_slope_per_degc=typical(2.6e-4),
)
"""The tolerances INV-80 ... INV-84; apart from the cross-axis sensitivity, alignment is not specified."""


_GYRO_SPAN_DEGC = 65.0  # from 25 degC to the far end of -40 ... 85 degC

GYROSCOPE_TOLERANCES = Tolerances(
    bias=(typical(5.0),) * 3,
    slope_per_degc=(typical(30.0 / _GYRO_SPAN_DEGC),) * 3,
    scale=typical(0.03),
    cross_axis=typical(0.02),
    noise=(0.01 * math.sqrt(41.0),) * 3,
    noise_full_scale=250.0,
    noise_bandwidth_hz=41.0,
    scale_slope_per_degc=typical(0.04 / _GYRO_SPAN_DEGC),
)
"""The tolerances INV-90 ... INV-94; a sensitivity to force is not printed."""


DIE = Die(Mpu6500Chip, (facts.ACCEL_XOUT_H, facts.GYRO_XOUT_H), (ACCELEROMETER_TOLERANCES, GYROSCOPE_TOLERANCES))
DIE_9250 = DIE._replace(build=partial(Mpu6500Chip, identity=0x71))  # INV-70
