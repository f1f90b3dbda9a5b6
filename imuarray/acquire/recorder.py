"""Records an array into a log: connects its sensors, polls them or receives a stream, and names the phases.

The poll loop (`Poll`) reads frame after frame at a constant rate; bursts are stored as raw bytes, which are decoded and
written in blocks. A sensor that does not answer, has lost its configuration or repeats its reading is recovered during
its own visits (`imuarray.acquire.sensor_health`), while the others are read as before.
"""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from os import PathLike
from typing import Any

import numpy as np

from imuarray.acquire.bus_segment import (
    REMOVED,
    AdapterState,
    BusSegment,
    ConfigurationReadback,
    Polling,
    alternating_orders,
    connect,
)
from imuarray.acquire.clocks import Clocks, clock_reader
from imuarray.acquire.fault_episode import FaultEpisodes, event_writer
from imuarray.acquire.recording import RecordingCounts, RecordingOptions, Service
from imuarray.acquire.sample_buffer import Intake, SampleBuffer, SensorRoute
from imuarray.acquire.sensor_health import SensorHealth, StartUpCheck
from imuarray.acquire.stream import Streaming, streams
from imuarray.array import ArrayConfig
from imuarray.bus.protocol import OpenBus
from imuarray.log.format import Phase, SensorHeader
from imuarray.log.missed_frames import BUS_WAS_LATE, duration_s, frames_in
from imuarray.log.rotate import RotatingWriter, Writer
from imuarray.log.writer import LogWriter, Stimulus
from imuarray.printable import counted
from imuarray.wall_time import iso_text

BATCH = 1024
"""Largest number of frames between two writes, where `RecordingOptions.write_interval_s` has more."""
TICK_S = 0.2
"""Interval in s between two checks of conditions that change slowly."""
_NAP_NS = 200_000_000
_FAR_NS = 100_000_000
"""Least time in ns from a step of a configuration to the next frame for which the step does not wait for the frame. No
result of a conversion becomes too old in a shorter time (`imuarray.drivers.OnDemandDriver`).
"""


class Poll:
    """The state of one recording: `run` it, then read its `summary`."""

    def __init__(
        self,
        routes: Sequence[SensorRoute],
        bus: OpenBus,
        log: Writer,
        options: RecordingOptions,
        epoch_ns: int,
    ) -> None:
        """`epoch_ns` is time 0 of the log on the bus's clock."""
        self.clock = bus.clock
        self.log = log
        self.rate_hz = rate_hz = options.rate_hz
        self.epoch_ns = epoch_ns
        self.options = options
        self.summary = RecordingCounts(lost={route.sensor.name: 0 for route in routes})
        self.buffers = {id(route): SampleBuffer(route, rate_hz) for route in routes}
        items = list(self.buffers.values())
        self.faults = FaultEpisodes(event_writer(log, epoch_ns, options.on_event))
        self.intake = Intake(log, epoch_ns, options.on_block, self.faults, self.summary.lost)
        order = self._segments(routes)
        self.orders = order, order[::-1]
        self.places = [(segment, item) for segment in order for item in segment.items]
        start_ns = self.clock.now_ns()
        self.start_up = StartUpCheck(items, options.judge, start_ns) if options.judge else None
        self.readback = ConfigurationReadback(
            [item for segment in order for item in segment.items],
            rate_hz,
            lambda buffer, kind, text: self.health.note_lost_configuration(buffer, self.clock.now_ns(), kind, text),
            [witness for segment in order if segment.channel for witness in segment.channel.witnesses],
        )
        self.health = SensorHealth(items, self.readback, self.start_up, self.faults, self.summary.lost)
        read_clocks = clock_reader(self.clock, epoch_ns, options.wall_time or datetime.fromtimestamp(0, UTC))
        self.clocks = Clocks(read_clocks, epoch_ns, log.clocks, self.faults.note)
        self.missed = self.faults.episode("", "late")
        self._adapters = list({id(segment.adapter): segment.adapter for segment in order}.values())
        self._earlier_time_outs = 0
        self.part = 0
        self.tick_frames = max(1, round(TICK_S * rate_hz))
        self.batch_frames = min(BATCH, max(1, round(options.write_interval_s(self.clock) * rate_hz)))
        self.truth: Callable[[int], Any] | None = getattr(bus, "truth", None)
        self.truth_rows: list[tuple[int, Any]] = []

    def _segments(self, routes: Sequence[SensorRoute]) -> list[BusSegment]:
        """Group the sensors in the order of the configuration. The channels of one multiplexer, and its trunk, share an
        adapter; a separate bus has another.
        """
        shared, all_buffers = AdapterState(), list(self.buffers.values())
        polling = Polling(self.clock, self.rate_hz, self.faults, self.lose)
        return [
            BusSegment(
                [self.buffers[id(route)] for route in part],
                all_buffers,
                AdapterState() if isinstance(part[0].segment, str) else shared,
                polling,
            )
            for part in alternating_orders(routes)[0]
        ]

    def lose(self, adapter: AdapterState, at_ns: int) -> None:
        """Configure the sensors behind a removed adapter once it is back."""
        for segment in self.orders[0]:
            if segment.adapter is adapter:
                for buffer in segment.items:
                    self.health.configure_later(buffer, at_ns)

    def run(self, seconds: float | None, stopped: Callable[[], bool]) -> None:
        """Read frame after frame on a grid of times: a frame that begins late is counted as late, one whose time has
        passed as missed.
        """
        period_ns = round(1e9 / self.rate_hz)
        self.log.keep()
        due_ns = self.clock.now_ns()  # the first frame is due now: creating files took time, but no frame was missed
        end_ns = None if seconds is None else due_ns + frames_in(seconds, self.rate_hz) * period_ns
        if isinstance(self.log, RotatingWriter):
            self.log.starts(due_ns - self.epoch_ns)
        for buffer in self.buffers.values():
            if buffer.queue is not None:  # it overflowed while the others were configured
                with contextlib.suppress(OSError):
                    buffer.driver.fetch()
        try:
            while (end_ns is None or due_ns < end_ns) and not stopped():
                self._earlier_time_outs = self._time_outs()
                self.frame()
                due_ns += period_ns
                behind_ns = self.clock.now_ns() - due_ns
                if behind_ns > 0:
                    self.summary.late += 1
                    remaining_ns = behind_ns if end_ns is None else min(behind_ns, end_ns - due_ns)
                    due_ns += self.skip(max(remaining_ns, 0) // period_ns) * period_ns
                else:
                    self.wait(due_ns, stopped)
        finally:  # rows that were read are verified or flagged, and written
            self.finish()

    def _time_outs(self) -> int:
        return sum(adapter.all_time_outs for adapter in self._adapters)

    def skip(self, frames: int) -> int:
        """Count `frames` missed frames: polled sensors lose readings, sensors with a queue do not. Frames missed
        because a transaction timed out are attributed to the bus, all others to the machine.
        """
        if frames:
            by_bus = self._time_outs() > self._earlier_time_outs
            self.summary.missed += frames
            self.summary.missed_by_bus += frames if by_bus else 0
            text = (
                f"{counted(frames, 'frame')} missed: {BUS_WAS_LATE if by_bus else 'the previous frame ended too late'}"
            )
            now_ns = self.clock.now_ns()
            if isinstance(self.log, RotatingWriter):  # each part reports its own missed frames
                part = self.log.part_at(now_ns - self.epoch_ns)
                if part != self.part:
                    self.missed.close(now_ns)
                self.part = part
            self.missed.happened(now_ns, text, frames)
            for buffer in self.buffers.values():
                if buffer.queue is None and not buffer.route.sensor.spec.on_demand:
                    buffer.mark_lost()
        return frames

    def wait(self, due_ns: int, stopped: Callable[[], bool]) -> None:
        """Sleep until the next frame. Wake at intervals to check for a request to stop, and to do what must be done
        before a frame that is far away (`_soonest`).
        """
        visited: set[tuple[int, int]] = set()
        while (now_ns := self.clock.now_ns()) < due_ns:
            at_ns, place = self._soonest(due_ns, visited)
            self.clock.sleep_until(min(due_ns, now_ns + _NAP_NS, at_ns))
            now_ns = self.clock.now_ns()
            if at_ns <= now_ns < due_ns:
                visited.add((place, at_ns))
                segment, buffer = self.places[place]
                if buffer.recovery is None:
                    self.group(segment, buffer)
                else:
                    buffer.recovery.step(now_ns)
            if now_ns < due_ns and stopped():
                return

    def _soonest(self, due_ns: int, visited: set[tuple[int, int]]) -> tuple[int, int]:
        """Return when a sensor must be visited before the frame at `due_ns`, and its place; `due_ns` if none must be.

        The reasons are the result of a conversion that would be too old by then, and a configuration in progress, which
        takes up to ten steps and would otherwise last for many frames.
        """
        visits: list[tuple[int, int]] = []
        if self.rate_hz * _FAR_NS >= 1e9:
            return due_ns, 0
        for place, (segment, buffer) in enumerate(self.places):
            if segment.adapter.removed:
                continue
            at_ns = buffer.conversion_before(due_ns)
            if buffer.recovery is not None and (next_step_ns := buffer.recovery.next_step_ns) is not None:
                at_ns = next_step_ns if due_ns - next_step_ns > _FAR_NS else None
            if at_ns is not None and (place, at_ns) not in visited:
                visits.append((at_ns, place))
        return min(visits, default=(due_ns, 0))

    def frame(self) -> None:
        """Read every sensor that is due once, and run the checks that are due while their segment is selected."""
        if self.truth is not None:
            now_ns = self.clock.now_ns()
            self.truth_rows.append((now_ns, self.truth(now_ns)))
        due = self.readback.due()
        frames = self.summary.frames
        for segment in self.orders[frames % 2]:
            if self.group(segment):
                for check in due:
                    if check.buffer.route.segment == segment.key:
                        self.readback.run(check)
        self.summary.frames = frames = frames + 1
        if frames % self.tick_frames == 0:
            self.tick()
        if frames % self.batch_frames == 0:
            self.write()

    def group(self, segment: BusSegment, only: SampleBuffer | None = None) -> bool:
        """Read the sensors of one segment, or one of them, in order; return whether it was the right segment, so that
        checks are meaningful.

        The end of one reading is the start of the next, so that each lies between two readings of the clock.
        """
        adapter = segment.adapter
        now_ns = segment.begin()
        for buffer in segment.items:
            if (only is not None and only is not buffer) or not (buffer.always_due or buffer.due(now_ns)):
                continue
            if now_ns < adapter.silent_until_ns or (adapter.removed and not segment.has_returned(buffer)):
                self.health.lost(buffer, now_ns, None)
                continue
            if buffer.recovery is not None:
                error = self.health.step(buffer, now_ns)
                if error is not None:
                    segment.note_error(error)
            else:
                self.visit(buffer, segment, now_ns)
            now_ns = self.clock.now_ns()
        return segment.confirm(self.readback, self.summary.lost)

    def visit(self, buffer: SampleBuffer, segment: BusSegment, now_ns: int) -> None:
        """Read a sensor, twice if it does not acknowledge. If both fail, the reading is missing: it has no row, and an
        event reports the start of the silence.

        Before the second attempt the connected channel is verified: a silent address may be due to a wrong channel, and
        earlier readings of this visit may be another chip's.
        """
        is_repeated = False
        try:
            burst = buffer.driver.fetch()
        except OSError as error:
            segment.note_error(error)
            if error.errno in REMOVED:  # reported once for all sensors of the adapter
                self.health.lost(buffer, now_ns, None)
                return
            if error.errno == errno.ETIMEDOUT:  # a second attempt would take as long
                self.health.lost(buffer, now_ns, error)
                return
            if segment.channel is not None:
                segment.confirm(self.readback, self.summary.lost)
            now_ns, is_repeated = self.clock.now_ns(), True
            try:
                burst = buffer.driver.fetch()
            except OSError as second:
                segment.note_error(second)
                self.health.lost(buffer, now_ns, second)
                return
        if not burst:  # no reading is ready yet
            return
        adapter = segment.adapter
        if adapter.time_outs:
            segment.note_answer()
        start_ns, certain = adapter.start_of(now_ns, self.clock.now_ns(), buffer.clocks)
        self.summary.uncertain += not certain and buffer.queue is None  # times of a queue have bounds
        if buffer.has_failed:
            self.health.note_arrival(buffer, start_ns)
        buffer.add(burst, start_ns, doubtful=is_repeated or not certain)

    def tick(self) -> None:
        """Do what is not due in every frame."""
        now_ns = self.clock.now_ns()
        self.clocks.tick(now_ns)
        self.health.tick(now_ns)
        self.faults.settle(now_ns)

    def finish(self) -> None:
        """Verify or flag the waiting rows; write them; end all fault episodes."""
        self.readback.finish()
        self.health.finish(self.clock.now_ns())
        self.write(last=True)
        now_ns = self.clock.now_ns()
        self.faults.close(now_ns)
        self.summary.silent = [item.route.sensor.name for item in self.buffers.values() if item.silent(now_ns)]

    def write(self, *, last: bool = False) -> None:
        """Decode and write the waiting rows that are trusted."""
        now_ns = self.clock.now_ns()
        for buffer in self.buffers.values():
            count = len(buffer.times_ns) if last else self.health.trusted_rows(buffer, now_ns)
            if count > 0:
                block = self.intake.write(buffer, count, now_ns)
                if len(block.time):
                    self.health.note_written(buffer, block, self.epoch_ns)
        if self.truth_rows:
            self.log.stimulus("truth", _truth_block(self.truth_rows, self.epoch_ns))
            self.truth_rows = []
        self.options.progress(self.summary.frames)


def _truth_block(rows: Sequence[tuple[int, Any]], epoch_ns: int) -> Stimulus:
    """Return the true state of an emulated world as rows of `/truth`."""
    return Stimulus(
        np.array([at_ns for at_ns, _ in rows], np.int64) - epoch_ns,
        np.array([state.force_box for _, state in rows]),
        np.array([state.rate_box for _, state in rows]),
        np.array([state.temperature_degc for _, state in rows]),
    )


_OPEN_END_NS = 1 << 62


def record(
    array: ArrayConfig,
    bus: OpenBus,
    path: str | PathLike[str],
    options: RecordingOptions | None = None,
    **changes: Any,
) -> RecordingCounts:
    """Record `array` on `bus` into a new log at `path`.

    `changes` are fields of `RecordingOptions` by keyword: they replace those of `options`, or stand alone
    (``record(array, bus, "run.h5", rate_hz=50, seconds=60)``).

    Raises SensorError before the first frame if a sensor is missing or wrong, OutputExistsError if the log exists,
    LogBusyError if it is being written, DiskFullError if it had to be ended early.
    """
    options = RecordingOptions(**changes) if options is None else replace(options, **changes)
    routes = connect(array, bus)
    start_ns = bus.clock.now_ns()
    epoch = options.wall_time or getattr(bus, "epoch", None) or datetime.now(UTC)
    stopped = options.stopped
    if hasattr(bus, "begins"):  # a transcript stores when the log began and when it was stopped
        bus.begins(epoch)
    if hasattr(bus, "stopping"):
        stopped = bus.stopping(stopped)
    headers = [route.header for route in routes]
    service = options.service or Service()
    options.on_headers(iso_text(epoch), headers)
    with _writer(path, headers, options, epoch=iso_text(epoch), source=bus.source, config=array.text) as log:

        def report(frames: int) -> None:
            options.progress(frames)
            options.on_counts(recording.summary)
            service.stored(sum(log.acknowledged.values()))

        loop = Streaming if streams(bus, routes) else Poll
        recording = loop(routes, bus, log, replace(options, wall_time=epoch, progress=report), start_ns)
        whole = [Phase(0, _OPEN_END_NS, options.phase, options.up)] if options.phase else []
        phases = [*whole, *_since(options.phases, start_ns)]
        for phase in phases:  # before any row, so that an interrupted log has them too
            log.begins(phase)
        try:
            recording.run(options.seconds, stopped)
        finally:
            service.stopping()
        end_ns = bus.clock.now_ns() - start_ns
        for phase in [phase._replace(end_ns=min(phase.end_ns, end_ns)) for phase in phases if phase.start_ns < end_ns]:
            log.phase(phase)
    summary = recording.summary
    summary.seconds = duration_s(summary.frames, summary.missed, options.rate_hz)
    summary.logs = list(log.paths)
    return summary


def _writer(
    path: str | PathLike[str], headers: Sequence[SensorHeader], options: RecordingOptions, **attributes: Any
) -> Writer:
    """Create the writer of one log, or of one that is split into parts; `attributes` are those of the log."""
    attributes |= {"frame_rate_hz": options.rate_hz, "force": options.force}
    if options.rotate_s is None:
        return LogWriter(path, headers, **attributes)
    return RotatingWriter(path, headers, every_s=options.rotate_s, on_first_frame=options.on_first_frame, **attributes)


def _since(phases: Sequence[Phase], start_ns: int) -> list[Phase]:
    """Return the phases as seen by a log that began at `start_ns`, without what was before it."""
    return [
        phase._replace(start_ns=max(phase.start_ns - start_ns, 0), end_ns=phase.end_ns - start_ns)
        for phase in phases
        if phase.end_ns > start_ns
    ]
