"""Common parts of the drivers of six-axis chips: accelerometer and gyroscope of one die, two sensors in one place.

Each half is a separate driver that sets the shared registers to the same values (the configuration is refused if they
differ) and never resets the die, which would change the other half's range. A burst holds both triads and the
thermometer. The data-ready bits of these chips are cleared by reading them, or by reading the data, so they can't serve
two readers. Instead, a reading is not new if its bytes equal those of the previous burst; noise in six axes makes equal
bytes of new readings improbable. Each half therefore fetches both triads. The one queue of a die is drained once for
both halves (`imuarray.drivers.six_axis_queue`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.arrays import Booleans, Floats
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock
from imuarray.drivers.driver import (
    Bytes,
    ChipDriver,
    DecodedBursts,
    Limits,
    SelfTest,
    compare_readings,
    flag_saturated,
    words16,
)
from imuarray.drivers.six_axis_queue import DieQueue
from imuarray.facts.registers import Setting
from imuarray.log.format import SYNC_PULSE

INVENSENSE: Mapping[int, str] = MappingProxyType(
    {
        0x40: "an ICM-42600",
        0x41: "an ICM-42602",
        0x42: "an ICM-42605",
        0x44: "an ICM-42686-P",
        0x46: "an ICM-42622",
        0x47: "an ICM-42688-P",
        0x68: "an MPU-6050",
        0x70: "an MPU-6500",
        0x71: "an MPU-9250",
        0x73: "an MPU-9255",
        0x74: "an MPU-6515",
        0x78: "an MPU-6880",
        0x98: "a clone sold as MPU-6050 (an original says 68, an ICM-20689 says 98)",
    }
)
"""The chips that answer at 0x68 and 0x69, by identity; all have it in the same register (INV-02, -03, -70, TDK-03)."""


def factory_change(codes: bytes) -> Floats:
    """Return the counts (n,) by which the self-test changed the readings at the factory, from the codes that it stored:
    2620 * 1.01**(code - 1), and 0 where none is stored (INV-78, TDK-40).
    """
    stored = np.frombuffer(codes, np.uint8).astype(np.float64)
    return np.where(stored > 0, 2620 * 1.01 ** (stored - 1), 0.0)


@dataclass(frozen=True)
class HalfTest:
    """The self-test of one half of a die: `at_rest` and `deflected` are written before the two series of readings that
    it compares. `limits` are those of the change, in the unit of the test, and `allowed` states them in words; `still`
    is the largest standard deviation at rest. The sign of a change matters only if it `is_signed`.
    """

    at_rest: Setting
    deflected: Setting
    limits: Limits
    allowed: str
    still: float = 0.05
    is_signed: bool = False


class SixAxisHalf(ChipDriver):
    """One half of a die, `half`: "acc" or "gyro"; a chip's driver defines the place of its data and its set-up."""

    burst: ClassVar[int] = 14
    has_data_ready: ClassVar[bool] = False
    self_tests: ClassVar[Mapping[str, HalfTest]]
    places: ClassVar[Mapping[str, slice]]
    """Place of the triad of each half in a burst."""
    temperature: ClassVar[slice]
    order: ClassVar[str] = ">i2"
    settle_s: ClassVar[float]
    """Settling time of the filter in a self-test."""
    after_self_test: ClassVar[Setting | None] = None
    """Setting that ends a self-test."""

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.half = sensor.chip.rpartition("_")[2]
        self.rate_hz = sensor.chip_rate_hz
        self.on_spi = sensor.on_spi

    @property
    def reading(self) -> slice:
        """Both triads and the thermometer: with noise in six axes, two readings are practically never equal."""
        return slice(0, 14)

    def self_test_unit(self) -> Floats | float:
        """Return the unit of the self-test in counts at its range, (3,) or one for all axes; 0 where none is known."""
        raise NotImplementedError

    def self_test(self) -> SelfTest:
        """Measure the change of the readings with the self-test on, in `self_test_unit`."""
        test = self.self_tests[self.half]
        self.configure()
        unit = self.self_test_unit()
        if not np.all(unit):
            return SelfTest(None, "this chip holds no factory trim to compare with")
        self.registers.write(test.at_rest)
        before = self._readings() / unit
        self.registers.write(test.deflected)
        during = self._readings() / unit
        if self.after_self_test is not None:
            self.registers.write(self.after_self_test)
        self.configure()
        is_downward = (during.mean(axis=0) < before.mean(axis=0)) & (not test.is_signed)
        sign = np.where(is_downward, -1.0, 1.0)
        text = f"changes by {{change}} {test.allowed}"
        return compare_readings(before * sign, during * sign, test.limits, text, still=test.still)

    def _readings(self) -> Floats:
        """Return counts (n, 3) of this half, for a self-test."""
        place = self.places[self.half]
        return self.triads(
            lambda: self.registers.peek(self.first, 14)[place], self.settle_s, 1 / self.rate_hz, order=self.order
        )

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 16 bits."""
        counts = words16(bursts[:, self.places[self.half]], self.order)
        temperature = words16(bursts[:, self.temperature], self.order)[:, 0]
        return DecodedBursts(counts, temperature, flag_saturated(counts, -32768, 32767))


class QueuedHalf(SixAxisHalf):
    """One half whose die's queue is drained; another driver of the same die may `share` the queue."""

    has_data_ready: ClassVar[bool] = True  # a sample in the queue is always new

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.has_pulses, self.marks_pulses = sensor.sync_pulse, sensor.marks_pulses
        self._own = self.settings, self.watched
        self._use(self._new_queue())

    def _new_queue(self) -> DieQueue:
        raise NotImplementedError

    def _queue_settings(self) -> tuple[Setting, ...]:
        """Return the settings of the queue, with the halves that read it."""
        raise NotImplementedError

    def _use(self, queue: DieQueue) -> None:
        self.die_queue, self.queue = queue, queue.join(self.half)
        self._set_queue()

    def _set_queue(self) -> None:
        settings, watched = self._own
        queued = self._queue_settings()
        replaced = {setting.register for setting in queued}
        self.settings = (*(each for each in settings if each.register not in replaced), *queued)
        self.watched = (*(each for each in watched if each.register not in replaced), *queued)

    def share(self, other: QueuedHalf) -> None:
        """Read the queue of `other`, the driver of the other half; call it before either is set up."""
        self._use(other.die_queue)
        other._set_queue()

    def steps(self) -> Iterator[float]:
        """Set this half up, and empty the queue."""
        yield from super().steps()
        self.die_queue.empty(self.queue)

    def fetch(self) -> bytes:
        """Return every waiting row of this half, oldest first."""
        return self.die_queue.fetch(self.queue)

    def with_marks(
        self, decoded: DecodedBursts, marks: Booleans, ages_s: float | Floats | None = None
    ) -> DecodedBursts:
        """Return `decoded` with the time from the pulse to each of the rows that `marks` (n,) selects: `ages_s`, or
        half a period for a chip that does not measure it.
        """
        ages_s = 0.5 / self.rate_hz if ages_s is None else ages_s
        return decoded._replace(compensated={SYNC_PULSE: np.where(marks, ages_s, np.nan)})

    def decode_marked_temperature(self, decoded: DecodedBursts) -> DecodedBursts:
        """Return `decoded` with pulses marked, for chips that mark them in the temperature's lowest bit (INV-38)."""
        words = decoded.temperature_counts
        if not self.has_pulses or words is None:
            return decoded
        return self.with_marks(decoded._replace(temperature_counts=words & ~np.int16(1)), (words & 1) == 1)
