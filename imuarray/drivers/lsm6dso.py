"""LSM6DSO: accelerometer and gyroscope of one die, two sensors that share a place.

ST DS12140 Rev 2; facts LSM-*. A burst is 0x20 ... 0x2D, thermometer, gyroscope and accelerometer, low byte first, with
IF_INC (LSM-12); 256 counts per degC, 0 at 25 degC (LSM-32). BDU keeps the two bytes of each number together (LSM-13); a
new sample during a burst may still arrive between two axes. Each half has its own register for rate and range, and is
on if its rate is not 0. Both filters keep their settings of power-on: their bandwidths follow the rate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock
from imuarray.drivers.driver import Bytes, DecodedBursts, flag_saturated, words16
from imuarray.drivers.six_axis import HalfTest, QueuedHalf, SixAxisHalf
from imuarray.drivers.six_axis_queue import DieQueue, Lsm6dsoQueue
from imuarray.facts import lsm6dso as facts
from imuarray.facts.registers import Register, Setting

_START_S = 0.15  # ST's own program waits as long for the gyroscope, and 0.1 s for the accelerometer: LSM-17
_RATE_CODES = {104.0: 4, 208.0: 5, 416.0: 6, 833.0: 7, 1666.0: 8}  # LSM-15
_SELF_TEST_RATE = 5  # 208 Hz: LSM-20
_QUEUE_ON = facts.FIFO_CTRL4[7:0](
    (facts.FIFO_MODE(0b110) | facts.TEMPERATURE_BATCH_RATE(0b11)).value  # the oldest is lost; 52 temperatures a second
)
_LATCHED = 0b011  # the first sample after a pulse is marked: LSM-49
_MARKS = facts.CTRL9_XL[7:0]((facts.MARK_Z(1) | facts.PULSE_ACTIVE_HIGH(1)).value)  # of the gyroscope


_RANGE_CODES = {  # LSM-14
    "acc": {2.0: 0, 4.0: 2, 8.0: 3, 16.0: 1},
    "gyro": {125.0: 1, 250.0: 0, 500.0: 2, 1000.0: 4, 2000.0: 6},
}
_SELF_TEST_RANGES = {"acc": 4.0, "gyro": 2000.0}


def _range_and_rate(half: str, full_scale: float, rate_code: int) -> Setting:
    range_code = _RANGE_CODES[half][full_scale]
    if half == "acc":
        return facts.CTRL1_XL[7:0]((facts.ACCEL_RANGE(range_code) | facts.ACCEL_RATE(rate_code)).value)
    return facts.CTRL2_G[7:0]((facts.GYRO_RANGE(range_code) | facts.GYRO_RATE(rate_code)).value)


_SELF_TESTS = {
    "acc": HalfTest(
        at_rest=_range_and_rate("acc", _SELF_TEST_RANGES["acc"], _SELF_TEST_RATE),
        deflected=facts.CTRL5_C[7:0](facts.ACCEL_SELF_TEST(0b01).value),
        limits=((0.05, 1.7),) * 3,
        allowed="g; 0.05 to 1.7 g allowed",
        still=0.02,
    ),
    "gyro": HalfTest(
        at_rest=_range_and_rate("gyro", _SELF_TEST_RANGES["gyro"], _SELF_TEST_RATE),
        deflected=facts.CTRL5_C[7:0](facts.GYRO_SELF_TEST(0b01).value),
        limits=((150.0, 700.0),) * 3,
        allowed="dps; 150 to 700 dps allowed",
        still=10.0,
    ),
}


class Lsm6dso(SixAxisHalf):
    """Driver of one half of an LSM6DSO."""

    first: ClassVar[Register] = facts.OUT_TEMP_L
    unused: ClassVar[Register | None] = facts.FIFO_CTRL1  # the watermark of the queue, which is off: LSM-18
    relatives: ClassVar[Mapping[int, str]] = MappingProxyType(  # LSM-03
        {
            0x69: "an LSM6DS3",
            0x6A: "an LSM6DSL, LSM6DSM or LSM6DS3TR-C",
            0x6B: "an LSM6DSR",
            0x6D: "an LSM6DST",
            0x70: "an LSM6DSV",
        }
    )
    places: ClassVar[Mapping[str, slice]] = {"acc": slice(8, 14), "gyro": slice(2, 8)}
    temperature: ClassVar[slice] = slice(0, 2)
    order: ClassVar[str] = "<i2"
    self_tests: ClassVar[Mapping[str, HalfTest]] = _SELF_TESTS
    settle_s: ClassVar[float] = 0.1  # LSM-20

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.sensitivity = sensor.spec.sensitivity
        full_scale = sensor.range or min(_RANGE_CODES[self.half])
        self.settings = (
            facts.FUNC_CFG_ACCESS[7:0](0),
            facts.CTRL3_C[7:0]((facts.BLOCK_UPDATE(1) | facts.AUTO_INCREMENT(1)).value),
            facts.CTRL4_C[7:0](facts.I2C_OFF(int(self.on_spi)).value),  # LSM-71
            facts.CTRL5_C[7:0](0),
            facts.CTRL6_C[7:0](facts.EDGE_MODE(_LATCHED if sensor.sync_pulse else 0).value),
            facts.CTRL7_G[7:0](0),
            facts.CTRL8_XL[7:0](0),
            *((_MARKS,) if sensor.sync_pulse else ()),
            _range_and_rate(self.half, full_scale, _RATE_CODES[self.rate_hz]),
        )
        self.watched = self.settings

    def steps(self) -> Iterator[float]:
        """Write every setting; the last one switches this half on. Wait until it measures."""
        yield from self.registers.set_step_by_step(*self.settings)
        yield _START_S
        yield 2 / self.rate_hz

    def self_test_unit(self) -> float:
        """Return the counts per g or dps (LSM-20, LSM-21)."""
        return self.sensitivity[_SELF_TEST_RANGES[self.half]]


class Lsm6dsoFifo(QueuedHalf, Lsm6dso):
    """Driver of one half, read by the queue: a row is a tag and the triad, and the last temperature (LSM-41)."""

    burst: ClassVar[int] = 9

    @property
    def reading(self) -> slice:
        """The triad."""
        return slice(1, 7)

    def _new_queue(self) -> DieQueue:
        return Lsm6dsoQueue(self.registers, self.clock, self.rate_hz, _QUEUE_ON)

    def _queue_settings(self) -> tuple[Setting, ...]:
        """Return the queue's settings: the data rate of its halves, a temperature at intervals (LSM-42, LSM-43)."""
        rates = dict.fromkeys(self.die_queue.halves, _RATE_CODES[self.rate_hz])
        batches = facts.GYRO_BATCH_RATE(rates.get("gyro", 0)) | facts.ACCEL_BATCH_RATE(rates.get("acc", 0))
        return facts.FIFO_CTRL3[7:0](batches.value), _QUEUE_ON

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 16 bits, low byte first; with pulses, bit 0 of the gyroscope's z is the mark (LSM-49)."""
        counts, temperature = words16(bursts[:, 1:7]), words16(bursts[:, 7:9])[:, 0]
        decoded = DecodedBursts(counts, temperature, flag_saturated(counts, -32768, 32767))
        if not self.marks_pulses:
            return decoded
        marks = (counts[:, 2] & 1) == 1
        counts[:, 2] &= ~np.int16(1)
        return self.with_marks(decoded, marks)
