"""MPU-6500, and the MPU-9250 that holds one: accelerometer and gyroscope of one die, two sensors that share a place.

InvenSense register map RM-MPU-9250A rev. 1.4; facts INV-70 ... INV-78. A burst is 0x3B ... 0x48, accelerometer,
thermometer and gyroscope, high byte first, as on the MPU-6050; 333.87 counts a degC, 0 at 21 degC (INV-76). Unlike on
the MPU-6050, the accelerometer has its own filter register (it is set to the same code), and the die is awake after
power-on. The magnetometer of the MPU-9250, an AK8963 on its auxiliary bus, is a separate sensor.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock
from imuarray.drivers.driver import Bytes, DecodedBursts, Limits, SelfTest, compared
from imuarray.drivers.six_axis import INVENSENSE, QueuedHalf, SixAxisHalf, factory_change, upward
from imuarray.drivers.six_axis_queue import EVERYTHING, DieQueue, MpuQueue
from imuarray.facts import mpu6500 as facts
from imuarray.facts.registers import Field, Register, Setting

_WAKE_S = 0.1  # the kernel's driver waits as long for the outputs to settle: INV-36
_BEST_CLOCK = 1  # the clock of a gyroscope once it runs: INV-71
_BASE_RATE_HZ = 1000.0  # with the low-pass filter on: INV-72
_FIFO_BYTES = 512  # INV-98
_IN_TEMPERATURE = 1  # its lowest bit marks a sample: INV-38
_SELF_TEST_SETTLE_S = 0.2  # settling time of the filter


@dataclass(frozen=True)
class _Half:
    """Properties in which the halves of the die differ."""

    full_scale: Field
    deflected: Field
    trim: Register
    limits: Limits
    allowed: str


_HALVES = {
    "acc": _Half(
        facts.ACCEL_RANGE, facts.ACCEL_SELF_TEST, facts.SELF_TEST_X_ACCEL, ((0.5, 1.5),) * 3, "0.5 to 1.5 allowed"
    ),
    "gyro": _Half(
        facts.GYRO_RANGE, facts.GYRO_SELF_TEST, facts.SELF_TEST_X_GYRO, ((0.5, np.inf),) * 3, "0.5 and more allowed"
    ),
}


class Mpu6500(SixAxisHalf):
    """Driver of one half of an MPU-6500 or an MPU-9250."""

    first: ClassVar[Register] = facts.ACCEL_XOUT_H
    marked: ClassVar[Register] = facts.I2C_SLV0_DO  # sent to a slave of a bus that is off: INV-71
    relatives: ClassVar[Mapping[int, str]] = INVENSENSE
    triads: ClassVar[Mapping[str, slice]] = {"acc": slice(0, 6), "gyro": slice(8, 14)}
    temperature: ClassVar[slice] = slice(6, 8)

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.own = _HALVES[self.half]
        ranges = tuple(sensor.spec.sensitivity)
        filter_code = 1 + sensor.spec.allowed_bandwidths_hz(self.rate_hz).index(sensor.chip_bandwidth_hz)
        marked = _IN_TEMPERATURE if sensor.sync_pulse else 0
        self.power = facts.PWR_MGMT_1[7:0](facts.CLOCK(_BEST_CLOCK).value)
        self.range_setting = self.own.full_scale(ranges.index(sensor.range or ranges[0])) | self.own.deflected(0)
        interface = facts.USER_CTRL[7:0](facts.I2C_OFF(int(self.on_spi)).value)  # INV-96
        self.settings = (
            facts.PWR_MGMT_2[7:0](0),
            facts.SMPLRT_DIV[7:0](round(_BASE_RATE_HZ / self.rate_hz) - 1),
            facts.CONFIG[7:0]((facts.DLPF(filter_code) | facts.EXT_SYNC(marked)).value),
            facts.ACCEL_CONFIG_2[7:0](facts.ACCEL_DLPF(filter_code).value),
            facts.GYRO_UNFILTERED(0),  # the divider has no effect otherwise: INV-72
            self.range_setting,
            interface,
        )
        self.watched = (self.power, *self.settings)

    def steps(self) -> Iterator[float]:
        """Wake the die, wait until it measures, then write every setting; bits of the other half keep their value."""
        self.registers.set(self.power)
        yield _WAKE_S
        for setting in self.settings:
            self.registers.store(setting)
            yield 0.0
        yield 2 / self.rate_hz

    def self_test(self) -> SelfTest:
        """Measure the change of the counts with the self-test on, as a share of the factory's, at the smallest range
        (INV-78).
        """
        own = self.own
        self.configure()
        trim = factory_change(self.registers.peek(own.trim, 3))
        if not trim.all():
            return SelfTest(None, "this chip holds no factory trim to compare with")
        self.registers.change(own.full_scale(0) | own.deflected(0))
        before = self.readings(_SELF_TEST_SETTLE_S) / trim
        self.registers.change(own.full_scale(0) | own.deflected(0b111))
        during = self.readings(_SELF_TEST_SETTLE_S) / trim
        self.configure()
        text = f"changes by {{change}} of the factory's; {own.allowed}"
        return compared(*upward(before, during), own.limits, text, still=0.05)


class Mpu6500Fifo(QueuedHalf, Mpu6500):
    """Driver of one half, read by the queue, whose records have the format of a burst."""

    def _new_queue(self) -> DieQueue:
        control = facts.USER_CTRL[7:0]((facts.FIFO_ON(1) | facts.I2C_OFF(int(self.on_spi))).value)
        return MpuQueue(self.registers, self.clock, self.rate_hz, _FIFO_BYTES, control, vars(facts))

    def _queue_settings(self) -> tuple[Setting, ...]:
        """Return the settings of a queue that holds everything (INV-98)."""
        control = facts.USER_CTRL[7:0]((facts.FIFO_ON(1) | facts.I2C_OFF(int(self.on_spi))).value)
        return control, facts.FIFO_EN[7:0](EVERYTHING)

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 16 bits, and the marks of synchronisation pulses."""
        return self.decode_marked_temperature(super().decode(bursts))
