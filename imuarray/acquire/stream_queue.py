"""Rows of chips whose queues a microcontroller drains (`imuarray.drivers.unattended`).

The number of samples in a queue was counted between the START of its transaction and that of the next; both are known
on the microcontroller's counter. The times of the samples are first computed on that counter (`FifoClock`), then
converted to the host's clock, because the fit between the two clocks improves during the recording.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np

from imuarray.acquire.sample_buffer import SampleBuffer, SensorRoute
from imuarray.acquire.stream_plan import FAILURE_TEXTS, Rows, StreamPlan, VisitPlace, ages_at
from imuarray.bus.serial_bus import Samples
from imuarray.bus.serial_link import AGE_HELD, AGE_LONGEST
from imuarray.drivers.six_axis import QueuedHalf
from imuarray.drivers.six_axis_queue import UnattendedQueue
from imuarray.drivers.unattended import unattended_queue_of

_I2C_BYTE_NS = 9_000
"""Least time in ns of a byte on an I2C bus: 9 clocks at 1 MHz (fast-mode plus)."""
LONGEST_US = 1_000_000
"""Longest time in us of a transaction with the largest age that can be sent; a watchdog ends longer transactions."""
_COUNTER_NS = 2_000
"""Uncertainty in ns of a time minus an age: both are whole microseconds, and each is off by up to one."""
IDLE_REPORT_NS = 900_000_000
"""Time in ns within which an empty queue is reported, at the last drain before its end. A lost configuration is
reported earlier, because registers are read back twice in `SWEEP_S`.
"""
RAN_OVER = "the chip's queue ran over"


def rows_of(routes: Sequence[SensorRoute], plan: StreamPlan, rate_hz: float) -> list[Rows]:
    """Return the rows of each route; the first half of a chip with a queue fills the rows of both halves."""
    leaders: dict[int, QueueRows] = {}
    rows: list[Rows] = []
    for route, places in zip(routes, plan.visits, strict=True):
        buffer, queue = SampleBuffer(route, rate_hz), unattended_queue_of(route.driver)
        if queue is None:
            rows.append(Rows(buffer, places))
            continue
        half = QueueRows(buffer, places, queue, leaders.get(id(queue)))
        leaders.setdefault(id(queue), half)
        rows.append(half)
    return rows


class QueueRows(Rows):
    """Fills the rows of one half of a six-axis chip. Its `leader`, which may be itself, takes the bursts for both
    halves.
    """

    def __init__(
        self, buffer: SampleBuffer, places: tuple[VisitPlace, ...], queue: UnattendedQueue, leader: QueueRows | None
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
        self._byte_ns = 8e9 / sensor.spi_rules.clock_hz if sensor.on_spi else _I2C_BYTE_NS
        ages = places[0].ages[-len(queue.drain_requests(1)) :]
        self._ages = ages
        self._answers = [slice(start + 2, end) for start, end in zip(ages, (*ages[1:], places[0].stop), strict=True)]
        self._newest_ns: int | None = None
        self._empty_ns = self._pause_ns = 0
        self._visited_ns: int | None = None
        self._filled_ns: int | None = None  # when the queue was last seen with samples, or first seen
        self._lost = 0
        self._failure = ""

    def begin(self) -> None:
        """Implement `Rows.begin`; the queue overflowed while other chips were configured."""
        if self._leader is self:
            self._die_queue.empty()

    def resume(self) -> None:
        """Implement `Rows.resume`; meanwhile the queue may have overflowed."""
        if self._leader is self and not self._queue.survives_overrun:
            self._die_queue.distrust()
            with suppress(OSError):
                self._die_queue.empty()

    def restart(self) -> None:
        """Implement `Rows.restart`. The chip continued sampling; its samples show whether some are missing."""
        self._forget()
        self._empty_ns = self._pause_ns = 0
        self._filled_ns = self._visited_ns = None

    @property
    def idle_ns(self) -> int:
        """See `Rows.idle_ns`."""
        is_idle = self._empty_ns > self.buffer.idle_ns and self._empty_ns + self._pause_ns > IDLE_REPORT_NS
        return self._empty_ns if is_idle else 0

    def interrupted(self, number: int) -> int:
        """Implement `Rows.interrupted`: lost readings are counted when the next samples show them."""
        return 0

    def left_out(self, periods: int) -> int:
        """Implement `Rows.left_out`: lost readings are counted when the next samples show them."""
        return 0

    def unread(self, number: int, now_ns: int) -> int:
        """See `Rows.unread`."""
        if self._newest_ns is None or self.missing(number) <= 1:
            return 0
        return round((now_ns - self._newest_ns) / self._period_ns)

    @property
    def doubt(self) -> str:
        """See `Rows`."""
        if self._die_queue.is_trusted:
            return ""
        return "its queue ran over" if self._queue.ran_over else "its queue gave no valid samples"

    def take(self, samples_by_list: Mapping[int, Samples], rate: float) -> tuple[int, str]:
        """Add the samples of the bursts that arrived; return how many are missing before the last one, and why."""
        if self._leader is self:
            self._failure = ""
            samples = samples_by_list.get(self.places[0].number)
            if samples is not None:
                self._drain(samples, rate)
        count, self._lost = self._lost, 0
        return count, self._leader._failure

    def _drain(self, samples: Samples, rate: float) -> None:
        for index, start_us, end_us in self._visits(samples):
            number = int(samples.numbers[index])
            for half in self._halves:
                half._last = number
            answers = [samples.payload[index, part].tobytes() for part in self._answers]
            packets_ns = int(self._queue.packet_bytes(answers) * self._byte_ns)
            try:
                self._queue.accept(answers, (start_us * 1000, max(end_us * 1000 - packets_ns, start_us * 1000)))
            except OSError as error:
                self._failure = str(error.strerror)
                continue
            for half in self._halves:
                half._add(int(samples.sent_ns[index]), int(samples.sent_us[index]) * 1000, rate, samples.link_ns)

    def _visits(self, samples: Samples) -> Iterator[tuple[int, int, int]]:
        """Yield, for each visit that succeeded, its row in `samples` and the interval in which it took place, on the
        microcontroller's counter in us.
        """
        place, payload = self.places[0], samples.payload
        ages = [ages_at(payload, position) for position in place.ages]
        worst = np.max(ages, axis=0)
        age_after = np.zeros(len(payload), np.int64)
        following_at = self._ages[1] if len(self._ages) > 1 else place.stop
        if following_at + 2 <= payload.shape[1]:
            following = ages_at(payload, following_at)
            age_after = np.where(following < AGE_HELD, following, 0)
        own_ages = ages_at(payload, place.age)
        for index, age in enumerate(worst.tolist()):
            if age >= AGE_HELD:
                self._failure = FAILURE_TEXTS[age]
                if own_ages[index] < AGE_HELD and len(self._ages) > 1:  # counted, but unknown which were read
                    self._die_queue.distrust()
                continue
            sent_us = int(samples.sent_us[index])
            age_us = int(own_ages[index])
            yield index, sent_us - (age_us if age_us < AGE_LONGEST else LONGEST_US), sent_us - int(age_after[index])

    def _add(self, sent_host_ns: int, sent_ns: int, rate: float, link_ns: float) -> None:
        """Add the waiting samples of this half; `sent_ns` on the microcontroller's counter is `sent_host_ns` on the
        host's, which may be off by `link_ns`.
        """
        bursts = self._reader.take()
        if bursts or self._filled_ns is None:
            self._filled_ns = sent_host_ns
        self._empty_ns = sent_host_ns - self._filled_ns
        self._pause_ns = 0 if self._visited_ns is None else sent_host_ns - self._visited_ns
        self._visited_ns = sent_host_ns
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
        self.buffer.add_rows(
            times_ns,
            bursts,
            [0] if has_gap and not overrun else [],
            overrun=overrun,
            uncertainties_ns=[
                _COUNTER_NS + link_ns + uncertainty_ns for uncertainty_ns in self._reader.uncertainties_ns
            ],
        )
        self._newest_ns = times_ns[-1]
