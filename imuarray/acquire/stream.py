"""Records an array on a microcontroller, which polls the sensors and sends what it reads.

The host sends the plan of what to read in which frame once (`stream_plan`), receives the data in bulk, and decodes them
with the drivers that configured the chips. A row is written once every register of its chip was read back after it; the
microcontroller reads the registers in its lists, and two wrong reads in a row count (`StreamHealth`). To configure a
chip again, the stream is stopped for a moment, which costs the others a few readings; the same is done when the
microcontroller stops sending or its port disappears.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime

from imuarray.acquire.bus_segment import MuxChannel
from imuarray.acquire.clocks import Clocks, clock_reader
from imuarray.acquire.fault_episode import FaultEpisodes, event_writer
from imuarray.acquire.recording import RecordingCounts, RecordingOptions
from imuarray.acquire.sample_buffer import HELD_S, Intake, RegisterCheck, SampleBuffer, SensorRoute
from imuarray.acquire.sensor_health import StartUpCheck
from imuarray.acquire.stream_plan import LINK, ReadbackPlace, Rows, VisitPlace, plan, readings_at
from imuarray.acquire.stream_queue import rows_of
from imuarray.bus.protocol import OpenBus
from imuarray.bus.serial_bus import Samples, SerialBus
from imuarray.bus.serial_link import CAN_COUNT, LinkError
from imuarray.drivers.unattended import needs_counting, unattended_queue_of
from imuarray.errors import BusUrlError, SensorError
from imuarray.log.missed_frames import frames_in
from imuarray.log.rotate import RotatingWriter, Writer
from imuarray.printable import counted

Note = Callable[[Rows, str, str], None]
"""Arguments: rows of the sensor, kind of event, message."""


class StreamHealth:
    """The health of all sensors. `failed` are those that must be configured again."""

    def __init__(
        self, rows: Sequence[Rows], watched: Sequence[ReadbackPlace], start_up: StartUpCheck | None, note: Note
    ) -> None:
        self.failed: dict[int, Rows] = {}
        self._rows = rows
        self._start_up = start_up
        self._note = note
        self._places: list[tuple[Rows, RegisterCheck, VisitPlace]] = []
        for item in rows:
            places = [place for place in watched if place.route is item.buffer.route]
            item.buffer.checks = [RegisterCheck(item.buffer, place.setting) for place in places]
            self._places += [
                (item, check, readback.place) for check, readback in zip(item.buffer.checks, places, strict=True)
            ]

    def check_readback(self, samples_by_list: Mapping[int, Samples], rate: float) -> None:
        """Check the registers that were read back."""
        for rows, check, place in self._places:
            if place.number in samples_by_list:
                values = readings_at(place, samples_by_list[place.number], rate)
                for time_ns, part in zip(values.times_ns.tolist(), values.parts.tolist(), strict=True):
                    self._judge(rows, check, part[0], bisect_left(rows.buffer.times_ns, time_ns))

    def _judge(self, rows: Rows, check: RegisterCheck, value: int, rows_before: int) -> None:
        """Judge one value of one register, read after `rows_before` waiting rows."""
        setting = check.setting
        if setting is None or value & setting.mask == setting.value:
            check.note_right(rows_before)
        elif check.note_wrong() and id(rows) not in self.failed:
            self.failed[id(rows)] = rows
            self._note(rows, "configuration", setting.mismatch(value))

    def doubt_queue(self, rows: Rows) -> None:
        """Have the chip configured again, because the bytes from its queue are not a sequence of samples."""
        if id(rows) not in self.failed:
            self.failed[id(rows)] = rows
            self._note(rows, "configuration", rows.doubt)

    def note_idle(self, rows: Rows) -> None:
        """Have the chip configured again, because its queue does not fill."""
        if id(rows) not in self.failed:
            self.failed[id(rows)] = rows
            rows.buffer.distrust(rows.buffer.verified_rows)
            self._note(rows, "frozen", f"nothing in its queue for {rows.idle_ns * 1e-9:.1f} s")

    def tick(self, now_ns: int) -> None:
        """Look for frozen sensors and wrong start-up states."""
        for rows in self._rows:
            row = rows.buffer.frozen_since()
            if row is not None and id(rows) not in self.failed:
                lasted_s = (rows.buffer.times_ns[-1] - rows.buffer.still_since_ns(row)) * 1e-9
                rows.buffer.note_frozen()
                rows.buffer.distrust(row)
                self.failed[id(rows)] = rows
                self._note(rows, "frozen", f"the same reading for {lasted_s:.2f} s")
        self._judge_start(now_ns)

    def _judge_start(self, now_ns: int, *, last: bool = False) -> None:
        rows_of = {id(rows.buffer): rows for rows in self._rows}

        def configure(buffer: SampleBuffer) -> None:
            rows = rows_of[id(buffer)]
            self.failed[id(rows)] = rows

        if self._start_up is not None:
            self._start_up.judge(
                now_ns, lambda buffer, text: self._note(rows_of[id(buffer)], "start_up", text), configure, last=last
            )

    def configure_failed(self, now_ns: int) -> None:
        """Configure the failed sensors while the stream is stopped; one that can't be configured remains failed."""
        for key, rows in list(self.failed.items()):
            try:
                rows.buffer.driver.identify()
                rows.buffer.driver.configure()
            except (OSError, SensorError) as error:
                self._note(rows, "configuration", f"can't be set up again: {error}")
                continue
            del self.failed[key]
            rows.buffer.trust()
            rows.buffer.note_configured()
            rows.buffer.note_verified()
            self._note(rows, "reconfigured", "set up again")
            if self._start_up is not None:
                self._start_up.judge_again(rows.buffer, now_ns)

    def doubt_all(self) -> None:
        """Mark all chips as failed, and their rows since the last verification as suspect, because they may have lost
        their supply.
        """
        for rows in self._rows:
            rows.buffer.distrust(rows.buffer.verified_rows)
            self.failed[id(rows)] = rows

    def trusted_rows(self, rows: Rows) -> int:
        """Return how many of the waiting rows can be written; rows that nothing verified within `HELD_S` are written as
        suspect.
        """
        if self._start_up is not None and self._start_up.holds(rows.buffer):
            return 0
        buffer = rows.buffer
        waiting, held_rows = len(buffer.times_ns), buffer.held_rows
        if id(rows) in self.failed:  # flagged already
            return waiting
        if waiting - buffer.verified_rows > max(HELD_S * buffer.row_rate_hz, held_rows):
            buffer.flag_unverified()
        return max(0, min(buffer.verified_rows, waiting - held_rows))

    def finish(self, now_ns: int) -> None:
        """Read every register back twice after the stream was stopped, at the end of the log, and flag the rows that
        remain unverified.
        """
        self._judge_start(now_ns, last=True)
        for rows in self._rows:
            waiting = len(rows.buffer.times_ns)
            for check in rows.buffer.checks:
                setting, registers = check.setting, rows.buffer.driver.registers
                if setting is None:
                    continue
                try:
                    values = [registers.read_back(setting.register) for _ in range(2)]
                except OSError:
                    continue
                if any(value & setting.mask == setting.value for value in values):
                    check.good_rows = waiting
            first = rows.buffer.verified_rows
            frozen = rows.buffer.frozen_since()
            if frozen is not None:
                self._note(rows, "frozen", "the same reading until the end")
                first = min(first, frozen)
            if first < waiting:
                rows.buffer.distrust(first)


WRITE_NS = 1_000_000_000
"""Time between two writes, in ns."""
SILENCE_NS = 2_000_000_000
SILENT_PERIODS = 2.5
"""Time in ns, and multiple of the usual pauses, without data after which a microcontroller counts as reset or removed
(the longer of both).
"""
QUIET_S = 0.5
"""Duration of silence at the end, in s and in excess of two of the microcontroller's usual pauses, above which the link
is lost.
"""
PAUSE_NS = 3_000_000_000
"""Time in ns between two attempts to configure chips again, or to find the microcontroller."""


def streams(bus: OpenBus, routes: Sequence[SensorRoute]) -> bool:
    """Return whether `Streaming` records these routes: they are on a microcontroller that can drain every queue among
    them by itself. Otherwise all of them are polled through the link.
    """
    if not isinstance(bus, SerialBus):
        return False
    queues = [unattended_queue_of(route.driver) for route in routes if route.sensor.fifo]
    counts = bool(bus.capacity.features & CAN_COUNT)
    return all(queue is not None and (counts or not needs_counting(queue)) for queue in queues)


class Streaming:
    """One recording of `routes` on `bus` into `log`: call `run`, then read `summary`. Arguments as of `Poll`."""

    def __init__(
        self,
        routes: Sequence[SensorRoute],
        bus: OpenBus,
        log: Writer,
        options: RecordingOptions,
        epoch_ns: int,
    ) -> None:
        """`epoch_ns` is time 0 of the log on the bus's clock."""
        if not isinstance(bus, SerialBus):
            raise TypeError(f"{type(bus).__name__} can't stream")
        self._rate_hz = rate_hz = options.rate_hz
        self._bus, self._log, self._epoch_ns, self._options = bus, log, epoch_ns, options
        self.summary = RecordingCounts(lost={route.sensor.name: 0 for route in routes})
        self._faults = FaultEpisodes(event_writer(log, epoch_ns, options.on_event))
        self._intake = Intake(log, epoch_ns, options.on_block, self._faults, self.summary.lost)
        self._plan = plan(routes, rate_hz)
        self._rows = rows_of(routes, self._plan, rate_hz)
        now_ns = bus.clock.now_ns()
        start_up = StartUpCheck([rows.buffer for rows in self._rows], options.judge, now_ns) if options.judge else None
        self._health = StreamHealth(self._rows, self._plan.watched, start_up, self._note)
        self._link = self._faults.episode("", "link")
        self._refused = self._faults.episode("", "refused")
        self._refused_before = Counter(bus.refused)
        self._period_rate_hz = rate_hz * self._plan.split
        self._silence_ns = max(SILENCE_NS, round(SILENT_PERIODS * self._longest_pause_s() * 1e9))
        read_clocks = clock_reader(bus.clock, epoch_ns, options.wall_time or datetime.fromtimestamp(0, UTC))
        self._clocks = Clocks(read_clocks, epoch_ns, log.clocks, self._faults.note)
        self._periods: int | None = None  # number of periods to record; `split` of them are a frame
        self._earlier_periods = 0  # periods before the stream was last started
        self._newest = -1  # number of the newest period since
        self._received_ns = self._written_ns = now_ns
        self._repaired_ns = now_ns - PAUSE_NS

    def run(self, seconds: float | None, stopped: Callable[[], bool]) -> None:
        """Record for `seconds` of frames, or until `stopped()`."""
        clock = self._bus.clock
        self._periods = None if seconds is None else frames_in(seconds, self._rate_hz) * self._plan.split
        end_ns = None if seconds is None else clock.now_ns() + round(seconds * 1e9) + self._silence_ns
        self._start()
        if isinstance(self._log, RotatingWriter):
            self._log.starts(self._received_ns - self._epoch_ns)
        self._log.keep()
        try:
            while not self._complete() and not stopped():
                if end_ns is not None and clock.now_ns() > end_ns:
                    break
                self._step()
        finally:
            self._finish()

    def _complete(self) -> bool:
        if self._periods is None:
            return False
        split = self._plan.split
        last = max(place.offset for places in self._plan.visits for place in places)
        return self._earlier_periods + self._newest >= self._periods - split + min(last, split - 1)

    def _start(self) -> None:
        def begin() -> None:
            for rows in self._rows:
                rows.begin()

        try:
            self._bus.start(self._plan.lists, round(1e6 / self._period_rate_hz), begin)
        except OSError as error:
            raise BusUrlError(f"serial: the stream can't be started: {error.strerror or error}") from error
        self._received_ns = self._bus.clock.now_ns()

    def _step(self) -> None:
        try:
            if not self._bus.streaming:
                raise LinkError("it does not answer")
            self._take(self._receive())
            now_ns = self._bus.clock.now_ns()
            if now_ns - self._received_ns > self._silence_ns:
                self._find_link("it sends nothing")
            elif self._health.failed and now_ns - self._repaired_ns > PAUSE_NS:
                self._bus.stop()
                self._take(self._receive())
                self._repair()
        except OSError as error:
            self._find_link(str(error.strerror or error))
        now_ns = self._bus.clock.now_ns()
        if now_ns - self._written_ns > WRITE_NS:
            self._clocks.tick(now_ns)
            self._health.tick(now_ns)
            self._write()

    def _longest_pause_s(self) -> float:
        """Return the longest time between two frames in which the microcontroller sends something."""
        return min(poll_list.every for poll_list in self._plan.lists) / self._period_rate_hz

    def _count_frames(self) -> None:
        self.summary.frames = -(-(self._earlier_periods + self._newest + 1) // self._plan.split)

    def _receive(self) -> Mapping[int, Samples]:
        """Return the samples of the running stream, and report rejected frames."""
        samples = self._bus.receive()
        refused = Counter(self._bus.refused) - self._refused_before
        count = refused.total()
        if count:
            self._refused_before += refused
            self.summary.refused += count
            reasons = ", ".join(f"{number} {reason}" for reason, number in refused.most_common())
            text = f"{counted(count, 'frame')} of the link refused: {reasons}"
            self._refused.happened(self._bus.clock.now_ns(), text, count)
        return samples

    def _take(self, samples_by_list: Mapping[int, Samples]) -> None:
        """Distribute the samples to the sensors; frames after the last requested one are ignored."""
        if not samples_by_list:
            return
        self._received_ns = self._bus.clock.now_ns()
        self._newest = max(self._newest, *(int(samples.numbers[-1]) for samples in samples_by_list.values()))
        if self._periods is not None:
            remaining = self._periods - self._earlier_periods
            self._newest = min(self._newest, remaining - 1)
            samples_by_list = {number: _until(samples, remaining) for number, samples in samples_by_list.items()}
        self._count_frames()
        for rows in self._rows:
            missing, cause = rows.take(samples_by_list, self._bus.fit.rate)
            if missing or rows.missing(self._newest) > 1:
                self._report_lost(rows, missing, cause or LINK)
            if rows.doubt:
                self._health.doubt_queue(rows)
            elif rows.idle_ns:
                self._health.note_idle(rows)
        self._health.check_readback(samples_by_list, self._bus.fit.rate)

    def _report_lost(self, rows: Rows, count: int, cause: str) -> None:
        """Note that `count` readings of one sensor are known to be missing, and report it."""
        self._count_lost(rows, count)
        episode = self._faults.episode(rows.buffer.route.sensor.name, "lost")
        episode.happened(self._bus.clock.now_ns(), f"no reading: {cause}", count)

    def _find_link(self, cause: str) -> None:
        """Look for the microcontroller, and configure everything, since it may have supplied the chips."""
        self._link.happened(self._bus.clock.now_ns(), f"the microcontroller is lost: {cause}")
        try:
            self._bus.reconnect(patience_s=PAUSE_NS * 1e-9)
            self._health.doubt_all()
            self._repair()
        except OSError:
            self._bus.clock.sleep_until(self._bus.clock.now_ns() + PAUSE_NS // 10)

    def _repair(self) -> None:
        """Stop the stream, configure the failed sensors, count the readings lost meanwhile, and start again."""
        self._repaired_ns = self._bus.clock.now_ns()
        self._forget_channels()
        self._health.configure_failed(self._repaired_ns)
        self._earlier_periods += self._newest + 1
        for rows in self._rows:
            self._count_lost(rows, rows.interrupted(self._newest))
            rows.restart()
        self._newest = -1
        self._bus.start(self._plan.lists, round(1e6 / self._period_rate_hz), self._resume)
        now_ns = self._bus.clock.now_ns()
        left_out = max(0, round((now_ns - self._received_ns) * 1e-9 * self._period_rate_hz))
        for rows in self._rows:
            self._count_lost(rows, rows.left_out(left_out))
        self._earlier_periods += left_out
        self._received_ns = now_ns

    def _resume(self) -> None:
        for rows in self._rows:
            rows.resume()

    def _count_lost(self, rows: Rows, count: int) -> None:
        self.summary.lost[rows.buffer.route.sensor.name] += count

    def _forget_channels(self) -> None:
        """Make the drivers select channels again, because the microcontroller has switched the multiplexer."""
        for rows in self._rows:
            bus = rows.buffer.driver.registers.bus
            if isinstance(bus, MuxChannel):
                bus.mux.forget()

    def _finish(self) -> None:
        """Take the last samples, verify or flag them, and write all."""
        is_lost = not self._bus.streaming
        try:
            self._bus.stop()
            self._take(self._receive())
        except OSError as error:
            self._link.happened(self._bus.clock.now_ns(), f"the microcontroller is lost: {error.strerror or error}")
            is_lost = True
        self._count_silence(is_lost)
        self._forget_channels()
        self._health.finish(self._bus.clock.now_ns())
        for rows in self._rows:
            self._count_lost(rows, rows.unread(self._newest, self._bus.clock.now_ns()))
        self._write(last=True)
        now_ns = self._bus.clock.now_ns()
        self._faults.close(now_ns)
        self.summary.silent = [rows.buffer.route.sensor.name for rows in self._rows if rows.buffer.silent(now_ns)]

    def _count_silence(self, is_lost: bool) -> None:
        """Count the frames that were due since the last data as lost, if the link is lost: if `is_lost`, or if it has
        been silent for longer than any usual pause.
        """
        silent_s = (self._bus.clock.now_ns() - self._received_ns) * 1e-9
        if not is_lost and silent_s <= QUIET_S + 2 * self._longest_pause_s():
            return
        silent = round(silent_s * self._period_rate_hz)
        if self._periods is not None:
            silent = min(silent, self._periods - self._earlier_periods - self._newest - 1)
        self._newest += max(silent, 0)
        self._count_frames()

    def _write(self, *, last: bool = False) -> None:
        self._written_ns = self._bus.clock.now_ns()
        for rows in self._rows:
            count = len(rows.buffer.times_ns) if last else self._health.trusted_rows(rows)
            if count:
                self._intake.write(rows.buffer, count, self._written_ns)
        self._faults.settle(self._written_ns)
        self._options.progress(self.summary.frames)

    def _note(self, rows: Rows, kind: str, text: str) -> None:
        self._faults.episode(rows.buffer.route.sensor.name, kind).happened(self._bus.clock.now_ns(), text)


def _until(samples: Samples, number: int) -> Samples:
    """Return the samples of frames before `number`."""
    count = int((samples.numbers < number).sum())
    return samples._replace(
        numbers=samples.numbers[:count],
        sent_ns=samples.sent_ns[:count],
        sent_us=samples.sent_us[:count],
        payload=samples.payload[:count],
    )
