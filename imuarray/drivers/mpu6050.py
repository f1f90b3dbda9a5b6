"""MPU-6050 (and the MPU-9150, which holds one): accelerometer and gyroscope of one die, two sensors that share a place.

InvenSense register map RM-MPU-6000A rev. 4.2; facts INV-*. Each half is a driver of its own that sets what both need
to the same values (the configuration is refused if they differ) and never resets the die, which would take the other
half's range. A burst is 0x3B ... 0x48, both triads and the thermometer, whose bytes are of one instant (INV-30). The
data-ready bit is cleared by whoever reads it (INV-22) and can't serve two readers: a reading is not new if all fourteen
bytes are those of the burst before, which noise in six axes prevents. That is why each half fetches both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.arrays import Floats
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock, sleep_for
from imuarray.drivers.driver import (
    Bytes,
    DecodedBursts,
    SelfTest,
    carry_out,
    compared,
    registers_for,
    saturated,
)
from imuarray.errors import NOT_ACKNOWLEDGED, SensorError
from imuarray.facts import mpu6050 as facts
from imuarray.facts.registers import Field, Setting

_WAKE_S = 0.1  # the kernel's driver waits as long for the outputs to settle: INV-36
_X_GYRO_CLOCK = 1  # steadier than the internal oscillator: INV-25
_BASE_RATE_HZ = 1000.0  # with the low-pass filter on: INV-11
_SELF_TEST_SAMPLES = 32
_SELF_TEST_SHARE = 0.14  # INV-45
_ACCEL_SELF_TEST_RANGE = 0b10  # 8 g: INV-46
_RELATIVES: Mapping[int, str] = MappingProxyType(
    {
        0x98: "a clone sold as MPU-6050 (an original says 68, an ICM-20689 says 98)",
        0x70: "an MPU-6500",
        0x71: "an MPU-9250",
        0x73: "an MPU-9255",
    }
)
"""By identity: what else is sold on boards for an MPU-6050 (INV-02, INV-03)."""


class _Half:
    """What both halves of the die have in common."""

    burst: ClassVar[int] = 14
    tells_fresh: ClassVar[bool] = False
    reading: ClassVar[slice] = slice(0, 14)
    triad: ClassVar[slice]
    full_scale: ClassVar[Field]
    deflected: ClassVar[Field]

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        self.registers = registers_for(sensor, bus)
        self.clock = clock
        self.rate_hz = sensor.chip_rate_hz
        ranges = tuple(sensor.spec.sensitivity)
        filter_code = 1 + sensor.spec.allowed_bandwidths_hz(self.rate_hz).index(sensor.chip_bandwidth_hz)
        self.power = facts.PWR_MGMT_1[7:0](facts.CLOCK(_X_GYRO_CLOCK).value)
        self.range_setting = self.full_scale(ranges.index(sensor.range or ranges[0])) | self.deflected(0)
        self.settings: tuple[Setting, ...] = (
            facts.PWR_MGMT_2[7:0](0),
            facts.SMPLRT_DIV[7:0](round(_BASE_RATE_HZ / self.rate_hz) - 1),
            facts.CONFIG[7:0](facts.DLPF(filter_code).value),
            self.range_setting,
            facts.USER_CTRL[7:0](0),
        )
        self.watched: tuple[Setting, ...] = (self.power, *self.settings)

    def identify(self) -> None:
        """WHO_AM_I is 0x68 (INV-02); SensorError names a relative or a clone as what it is."""
        try:
            identity = self.registers.peek(facts.WHO_AM_I)[0]
        except OSError as error:
            if error.errno in NOT_ACKNOWLEDGED:
                raise SensorError(f"{self.registers.label}: nobody acknowledges this address") from error
            raise SensorError(f"{self.registers.label}: the bus fails: {error.strerror or error}") from error
        if identity != facts.WHO_AM_I.reset:
            what = f", {_RELATIVES[identity]}" if identity in _RELATIVES else ""
            raise SensorError(
                f"{self.registers.label}: identity {identity:02x}{what}, expected {facts.WHO_AM_I.reset:02x}"
            )

    def configure(self) -> None:
        """All `steps`."""
        carry_out(self.clock, self.steps())

    def steps(self) -> Iterator[float]:
        """Wake the die, which sleeps after power-on (INV-25), wait until it measures, then write every setting."""
        self.registers.set(self.power)
        yield _WAKE_S
        for setting in self.settings:
            self.registers.set(setting)
            yield 0.0
        yield 2 / self.rate_hz

    def mark(self, code: int) -> bool:
        """Mark the die in the data byte of a slave that the auxiliary bus, which is off, would write to (INV-23).

        Both halves of a die are given the same code.
        """
        setting = facts.I2C_SLV0_DO[7:0](code)
        self.settings, self.watched = (*self.settings, setting), (*self.watched, setting)
        return True

    def self_test(self) -> SelfTest:
        """Change of the counts with the self-test on, in shares of the factory's: within 14 % (INV-45)."""
        self.configure()
        trim = self._trim_counts()
        if not trim.all():
            return SelfTest(None, "the factory's trim is not in this chip: there is nothing to compare with")
        still = self._self_test_range()
        self.registers.poke(still.register, still.value)
        before = self._readings() / trim
        self.registers.poke(still.register, still.value | self.deflected(0b111).value)
        during = self._readings() / trim
        self.configure()
        limits = ((1 - _SELF_TEST_SHARE, 1 + _SELF_TEST_SHARE),) * 3
        return compared(
            before, during, limits, "changes by {change} of the factory's; 0.86 to 1.14 allowed", still=0.05
        )

    def _trim_counts(self) -> Floats:
        """The factory's change (3,) in counts at the range of the self-test; 0 where none is stored."""
        raise NotImplementedError

    def _self_test_range(self) -> Setting:
        """The range at which the factory's change holds."""
        raise NotImplementedError

    def _readings(self) -> Floats:
        """Counts (n, 3), once the filter has settled."""
        sleep_for(self.clock, 0.2)
        counts = []
        for _ in range(_SELF_TEST_SAMPLES):
            sleep_for(self.clock, 1 / self.rate_hz)
            counts.append(np.frombuffer(self.fetch()[self.triad], ">i2"))
        return np.asarray(np.array(counts), np.float64)

    def fetch(self) -> bytes:
        """0x3B ... 0x48: accelerometer, thermometer, gyroscope."""
        return self.registers.peek(facts.ACCEL_XOUT_H, self.burst)

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Counts of 16 bits, high byte first; 340 counts per degC, -521 at 35 degC (INV-20, INV-42)."""
        counts = np.ascontiguousarray(bursts[:, self.triad]).view(">i2").astype(np.int16)
        temperature = np.ascontiguousarray(bursts[:, 6:8]).view(">i2")[:, 0].astype(np.int16)
        return DecodedBursts(counts, temperature, saturated(counts, -32768, 32767))

    def header(self) -> Mapping[str, int]:
        """No attributes of its own."""
        return {}


class Mpu6050Accelerometer(_Half):
    """Driver of the accelerometer of one MPU-6050."""

    triad: ClassVar[slice] = slice(0, 6)
    full_scale: ClassVar[Field] = facts.ACCEL_RANGE
    deflected: ClassVar[Field] = facts.ACCEL_SELF_TEST

    def _trim_counts(self) -> Floats:
        """4096 * 0.34 * (0.92 / 0.34)**((code - 1) / 30) counts (INV-46)."""
        x, y, z, low = self.registers.peek(facts.SELF_TEST_X, 4)
        codes = np.array(
            [
                facts.TRIM_ACCEL_X_HIGH.of(x) << 2 | facts.TRIM_ACCEL_X_LOW.of(low),
                facts.TRIM_ACCEL_Y_HIGH.of(y) << 2 | facts.TRIM_ACCEL_Y_LOW.of(low),
                facts.TRIM_ACCEL_Z_HIGH.of(z) << 2 | facts.TRIM_ACCEL_Z_LOW.of(low),
            ]
        )
        counts = 4096 * 0.34 * (0.92 / 0.34) ** ((codes - 1) / 30)
        return np.where(codes > 0, counts, 0.0)

    def _self_test_range(self) -> Setting:
        """8 g (INV-46)."""
        return facts.ACCEL_RANGE(_ACCEL_SELF_TEST_RANGE) | facts.ACCEL_SELF_TEST(0)


class Mpu6050Gyroscope(_Half):
    """Driver of the gyroscope of one MPU-6050."""

    triad: ClassVar[slice] = slice(8, 14)
    full_scale: ClassVar[Field] = facts.GYRO_RANGE
    deflected: ClassVar[Field] = facts.GYRO_SELF_TEST

    def _trim_counts(self) -> Floats:
        """25 * 131 * 1.046**(code - 1) counts, y with the other sign (INV-47)."""
        block = self.registers.peek(facts.SELF_TEST_X, 3)
        fields = (facts.TRIM_GYRO_X, facts.TRIM_GYRO_Y, facts.TRIM_GYRO_Z)
        codes = np.array([field.of(byte) for field, byte in zip(fields, block, strict=True)])
        counts = np.array([25.0, -25.0, 25.0]) * 131 * 1.046 ** (codes - 1)
        return np.where(codes > 0, counts, 0.0)

    def _self_test_range(self) -> Setting:
        """250 dps (INV-47)."""
        return facts.GYRO_RANGE(0) | facts.GYRO_SELF_TEST(0)
