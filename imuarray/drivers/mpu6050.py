"""MPU-6050 (and the MPU-9150, which holds one): accelerometer and gyroscope of one die, two sensors that share a place.

InvenSense register map RM-MPU-6000A rev. 4.2; facts INV-*. A burst is 0x3B ... 0x48, accelerometer, thermometer and
gyroscope, whose bytes are of one instant (INV-30), high byte first; 340 counts a degC, -521 at 35 degC (INV-20, -42).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.arrays import Floats
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock
from imuarray.drivers.driver import Bytes, DecodedBursts, Registers, SelfTest, compared
from imuarray.drivers.six_axis import INVENSENSE, QueuedHalf, SixAxisHalf
from imuarray.drivers.six_axis_queue import EVERYTHING, DieQueue, MpuQueue
from imuarray.facts import mpu6050 as facts
from imuarray.facts.registers import Field, Register, Setting

_WAKE_S = 0.1  # the kernel's driver waits as long for the outputs to settle: INV-36
_X_GYRO_CLOCK = 1  # more stable than the internal oscillator: INV-25
_EXTERNAL_CLOCKS = (4, 5)  # 32.768 kHz and 19.2 MHz: INV-37
_BASE_RATE_HZ = 1000.0  # with the low-pass filter on: INV-11
_FIFO_BYTES = 1024  # INV-27
_IN_TEMPERATURE = 1  # its lowest bit marks a sample: INV-38
_SELF_TEST_SETTLE_S = 0.2  # settling time of the filter
_SELF_TEST_SHARE = 0.14  # INV-45
_ACCEL_SELF_TEST_RANGE = 0b10  # 8 g: INV-46


def _accelerometer_trim(registers: Registers) -> Floats:
    """Return 4096 * 0.34 * (0.92 / 0.34)**((code - 1) / 30) counts (3,), 0 where no code is stored (INV-46)."""
    x, y, z, low = registers.peek(facts.SELF_TEST_X, 4)
    codes = np.array(
        [
            facts.TRIM_ACCEL_X_HIGH.of(x) << 2 | facts.TRIM_ACCEL_X_LOW.of(low),
            facts.TRIM_ACCEL_Y_HIGH.of(y) << 2 | facts.TRIM_ACCEL_Y_LOW.of(low),
            facts.TRIM_ACCEL_Z_HIGH.of(z) << 2 | facts.TRIM_ACCEL_Z_LOW.of(low),
        ]
    )
    counts = 4096 * 0.34 * (0.92 / 0.34) ** ((codes - 1) / 30)
    return np.where(codes > 0, counts, 0.0)


def _gyroscope_trim(registers: Registers) -> Floats:
    """Return 25 * 131 * 1.046**(code - 1) counts (3,), y with the other sign, 0 where no code is stored (INV-47)."""
    block = registers.peek(facts.SELF_TEST_X, 3)
    fields = (facts.TRIM_GYRO_X, facts.TRIM_GYRO_Y, facts.TRIM_GYRO_Z)
    codes = np.array([field.of(byte) for field, byte in zip(fields, block, strict=True)])
    counts = np.array([25.0, -25.0, 25.0]) * 131 * 1.046 ** (codes - 1)
    return np.where(codes > 0, counts, 0.0)


@dataclass(frozen=True)
class _Half:
    """Properties in which the halves of the die differ; `trim` returns the factory's change (3,) by the self-test in
    counts at the range of `self_test`.
    """

    full_scale: Field
    deflected: Field
    trim: Callable[[Registers], Floats]
    self_test: Setting


_HALVES = {
    "acc": _Half(
        facts.ACCEL_RANGE,
        facts.ACCEL_SELF_TEST,
        _accelerometer_trim,
        facts.ACCEL_RANGE(_ACCEL_SELF_TEST_RANGE) | facts.ACCEL_SELF_TEST(0),
    ),
    "gyro": _Half(
        facts.GYRO_RANGE,
        facts.GYRO_SELF_TEST,
        _gyroscope_trim,
        facts.GYRO_RANGE(0) | facts.GYRO_SELF_TEST(0),  # 250 dps: INV-47
    ),
}


class Mpu6050(SixAxisHalf):
    """Driver of one half of an MPU-6050."""

    first: ClassVar[Register] = facts.ACCEL_XOUT_H
    marked: ClassVar[Register] = facts.I2C_SLV0_DO  # sent to a slave of a bus that is off: INV-23
    relatives: ClassVar[Mapping[int, str]] = INVENSENSE
    triads: ClassVar[Mapping[str, slice]] = {"acc": slice(0, 6), "gyro": slice(8, 14)}
    temperature: ClassVar[slice] = slice(6, 8)

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.own = _HALVES[self.half]
        ranges = tuple(sensor.spec.sensitivity)
        nominal_rate_hz = sensor.nominal_rate_hz
        filter_code = 1 + sensor.spec.allowed_bandwidths_hz(nominal_rate_hz).index(sensor.chip_bandwidth_hz)
        external_hz = sensor.external_clock_hz
        source = _X_GYRO_CLOCK if external_hz is None else _EXTERNAL_CLOCKS[external_hz > 1e6]
        marked = _IN_TEMPERATURE if sensor.sync_pulse else 0
        self.power = facts.PWR_MGMT_1[7:0](facts.CLOCK(source).value)
        self.range_setting = self.own.full_scale(ranges.index(sensor.range or ranges[0])) | self.own.deflected(0)
        self.settings = (
            facts.PWR_MGMT_2[7:0](0),
            facts.SMPLRT_DIV[7:0](round(_BASE_RATE_HZ / nominal_rate_hz) - 1),
            facts.CONFIG[7:0]((facts.DLPF(filter_code) | facts.EXT_SYNC(marked)).value),
            self.range_setting,
            facts.USER_CTRL[7:0](0),
        )
        self.watched = (self.power, *self.settings)

    def steps(self) -> Iterator[float]:
        """Wake the die, which sleeps after power-on (INV-25), wait until it measures, then write every setting."""
        self.registers.set(self.power)
        yield _WAKE_S
        for setting in self.settings:
            self.registers.set(setting)
            yield 0.0
        yield 2 / self.rate_hz

    def self_test(self) -> SelfTest:
        """Measure the change of the counts with the self-test on, as a share of the factory's: within 14 % (INV-45)."""
        self.configure()
        trim = self.own.trim(self.registers)
        if not trim.all():
            return SelfTest(None, "this chip holds no factory trim to compare with")
        still = self.own.self_test
        self.registers.poke(still.register, still.value)
        before = self.readings(_SELF_TEST_SETTLE_S) / trim
        self.registers.poke(still.register, still.value | self.own.deflected(0b111).value)
        during = self.readings(_SELF_TEST_SETTLE_S) / trim
        self.configure()
        limits = ((1 - _SELF_TEST_SHARE, 1 + _SELF_TEST_SHARE),) * 3
        return compared(
            before, during, limits, "changes by {change} of the factory's; 0.86 to 1.14 allowed", still=0.05
        )


class Mpu6050Fifo(QueuedHalf, Mpu6050):
    """Driver of one half, read by the queue, whose records have the format of a burst."""

    def _new_queue(self) -> DieQueue:
        control = facts.USER_CTRL[7:0](facts.FIFO_ON(1).value)
        return MpuQueue(self.registers, self.clock, self.rate_hz, _FIFO_BYTES, control, vars(facts))

    def _queue_settings(self) -> tuple[Setting, ...]:
        """Return the settings of a queue that holds everything (INV-27)."""
        return facts.USER_CTRL[7:0](facts.FIFO_ON(1).value), facts.FIFO_EN[7:0](EVERYTHING)

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 16 bits, and the marks of synchronisation pulses."""
        return self.decode_marked_temperature(super().decode(bursts))
