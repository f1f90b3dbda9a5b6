"""Rows of chips whose queues a microcontroller drains (`imuarray.drivers.unattended`).

The number of samples in a queue was counted between the START of its transaction and that of the next, both known on
the microcontroller's counter. The samples are timed on that counter (`FifoClock`), and only then on the host's clock,
whose fit improves during the recording.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from imuarray.acquire.sample_buffer import SampleBuffer
from imuarray.acquire.sensor_routes import SensorRoute
from imuarray.acquire.stream_plan import WHY, Rows, StreamPlan, VisitPlace, ages_at
from imuarray.bus.serial_bus import Samples
from imuarray.bus.serial_link import AGE_HELD, AGE_LONGEST
from imuarray.drivers.six_axis import QueuedHalf
from imuarray.drivers.six_axis_queue import BurstQueue
from imuarray.drivers.unattended import burst_queue_of

_I2C_BYTE_NS = 9_000
"""Least time of a byte on an I2C bus: 9 clocks at 1 MHz (fast-mode plus)."""
LONGEST_US = 1_000_000
"""A transaction whose age is the longest that can be told took place within this time: a watchdog would have ended it.
"""
RAN_OVER = "the chip's queue ran over"


def rows_of(routes: Sequence[SensorRoute], plan: StreamPlan, rate_hz: float) -> list[Rows]:
    """The rows of each route; those of both halves of a die with a queue are filled by the half that comes first."""
    leaders: dict[int, QueueRows] = {}
    rows: list[Rows] = []
    for route, places in zip(routes, plan.visits, strict=True):
        buffer, queue = SampleBuffer(route, rate_hz), burst_queue_of(route.driver)
        if queue is None:
            rows.append(Rows(buffer, places))
            continue
        half = QueueRows(buffer, places, queue, leaders.get(id(queue)))
        leaders.setdefault(id(queue), half)
        rows.append(half)
    return rows


class QueueRows(Rows):
    """Fills the rows of one half of a die. Its `leader`, which may be itself, takes the bursts for both halves."""

    def __init__(
        self, buffer: SampleBuffer, places: tuple[VisitPlace, ...], queue: BurstQueue, leader: QueueRows | None
    ) -> None:
        if not isinstance(buffer.driver, QueuedHalf):
            raise TypeError(f"{buffer.route.sensor.name} has no queue")
        super().__init__(buffer, places)
        self._queue, self._reader = queue, buffer.driver.queue
        self._die_queue = buffer.driver.die_queue
        self._leader = leader or self
        self._halves: list[QueueRows] = []
        self._leader._halves.append(self)
        sensor = buffer.route.sensor
        self._period_ns = 1e9 / sensor.chip_rate_hz
        byte_ns = 8e9 / sensor.spi_rules.clock_hz if sensor.on_spi else _I2C_BYTE_NS
        counted_bytes = queue.burst(0)[1]
        self._packets_ns = int((places[0].stop - places[0].start - counted_bytes) * byte_ns)
        self._newest_ns: int | None = None
        self._lost = 0
        self._failure = ""

    def begin(self) -> None:
        """See `Rows.begin`; the queue ran over while other chips were set up."""
        if self._leader is self:
            self._die_queue.empty()

    def restart(self) -> None:
        """See `Rows.restart`. The chip went on: its samples tell whether some are missing."""
        self._forget()

    def interrupted(self, number: int) -> int:
        """See `Rows.interrupted`: counted when the next samples tell."""
        return 0

    def left_out(self, periods: int) -> int:
        """See `Rows.left_out`: counted when the next samples tell."""
        return 0

    def unread(self, number: int, now_ns: int) -> int:
        """See `Rows.unread`."""
        if self._newest_ns is None or self.missing(number) <= 1:
            return 0
        return round((now_ns - self._newest_ns) / self._period_ns)

    @property
    def is_doubtful(self) -> bool:
        """See `Rows`."""
        return not self._die_queue.is_trusted

    def take(self, samples_by_list: Mapping[int, Samples], rate: float) -> tuple[int, str]:
        """Add the samples of the bursts that arrived; how many are missing before the last of them, and why."""
        if self._leader is self:
            self._failure = ""
            samples = samples_by_list.get(self.places[0].number)
            if samples is not None:
                self._drain(samples, rate)
        lost, self._lost = self._lost, 0
        return lost, self._leader._failure

    def _drain(self, samples: Samples, rate: float) -> None:
        """Take all bursts, in order, for all halves."""
        place = self.places[0]
        for index, start_us, end_us in self._visits(samples):
            number = int(samples.numbers[index])
            for half in self._halves:
                half._last = number
            burst = samples.payload[index, place.start : place.stop].tobytes()
            counted_ns = start_us * 1000, max(end_us * 1000 - self._packets_ns, start_us * 1000)
            try:
                self._queue.accept(burst, counted_ns)
            except OSError as error:
                self._failure = str(error.strerror)
                continue
            for half in self._halves:
                half._add(int(samples.sent_ns[index]), int(samples.sent_us[index]) * 1000, rate)

    def _visits(self, samples: Samples) -> Iterator[tuple[int, int, int]]:
        """Yield the row in `samples` of each visit that succeeded, and between which times on the microcontroller's
        counter (us) it took place.
        """
        place, payload = self.places[0], samples.payload
        ages = [ages_at(payload, position) for position in place.ages]
        worst = np.max(ages, axis=0)
        after = np.zeros(len(payload), np.int64)
        if place.stop + 2 <= payload.shape[1]:
            following = ages_at(payload, place.stop)
            after = np.where(following < AGE_HELD, following, 0)
        own = ages_at(payload, place.age)
        for index, age in enumerate(worst.tolist()):
            if age >= AGE_HELD:
                self._failure = WHY[age]
                continue
            sent_us = int(samples.sent_us[index])
            age_us = int(own[index])
            yield index, sent_us - (age_us if age_us < AGE_LONGEST else LONGEST_US), sent_us - int(after[index])

    def _add(self, sent_host_ns: int, sent_ns: int, rate: float) -> None:
        """Add what waits for this half; `sent_ns` on the microcontroller's counter is `sent_host_ns` on the host's."""
        bursts = self._reader.take()
        if not bursts:
            return
        times = np.array(self._reader.drained, np.int64) - sent_ns
        times_ns = (sent_host_ns + np.rint(times * rate).astype(np.int64)).tolist()
        has_gap = self._reader.overrun
        if has_gap:
            if self._newest_ns is not None:
                self._lost += max(1, round((times_ns[0] - self._newest_ns) / self._period_ns) - 1)
            if self._queue.ran_over:
                self._leader._failure = RAN_OVER
        overrun = has_gap and self._queue.ran_over
        self.buffer.add_rows(times_ns, bursts, [0] if has_gap and not overrun else [], overrun=overrun)
        self._newest_ns = times_ns[-1]
