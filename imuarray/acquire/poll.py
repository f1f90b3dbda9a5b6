"""The poll loop: frame after frame at a steady rate, bursts kept raw, decoded and written many at a time.

A sensor that does not answer, has lost its configuration or stands still gets well in its own place of the frame
(`imuarray.acquire.care`); the others are read as ever.
"""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from imuarray.acquire.adapter import REMOVED, Adapter
from imuarray.acquire.care import Care
from imuarray.acquire.clocks import Clocks, clocks_beside
from imuarray.acquire.pending import Pending
from imuarray.acquire.segments import Segment
from imuarray.acquire.start_up import Judge, StartUp
from imuarray.acquire.stations import Station, there_and_back
from imuarray.acquire.summary import Summary
from imuarray.acquire.trouble import Troubles
from imuarray.acquire.watch import Watch
from imuarray.bus.protocol import OpenBus
from imuarray.log.format import Event
from imuarray.log.rotate import RotatingWriter, Writer
from imuarray.log.writer import Block, Stimulus
from imuarray.printable import counted

BATCH = 1024
"""Frames between two writes, at most; `BATCH_S` seconds' worth otherwise."""
BATCH_S = 1.0
TICK_S = 0.2
"""Between two looks at what is too slow to be looked at every frame."""
_NAP_NS = 200_000_000


class Poll:
    """The state of one recording: `run` it, then read its `summary`."""

    def __init__(
        self,
        stations: Sequence[Station],
        bus: OpenBus,
        log: Writer,
        rate_hz: float,
        epoch_ns: int,
        progress: Callable[[int], None] = lambda frames: None,
        observe: Callable[[str, Block], None] = lambda sensor, block: None,
        *,
        wall_time: datetime | None = None,
        judge: Judge | None = None,
        tell: Callable[[Event], None] = lambda event: None,
    ) -> None:
        self.clock = bus.clock
        self.log = log
        self.rate_hz = rate_hz
        self.epoch_ns = epoch_ns
        self.progress = progress
        self.observe = observe
        self.tell = tell
        self.summary = Summary(lost={station.sensor.name: 0 for station in stations})
        self.pending = {id(station): Pending(station, rate_hz) for station in stations}
        items = list(self.pending.values())
        self.troubles = Troubles(self.event)
        forth = self._segments(stations)
        self.orders = forth, forth[::-1]
        start_ns = self.clock.now_ns()
        self.start_up = StartUp(items, judge, start_ns) if judge else None
        self.watch = Watch(
            [item for segment in forth for item in segment.items],
            rate_hz,
            lambda pending, kind, text: self.care.not_as_it_was(pending, self.clock.now_ns(), kind, text),
            [witness for segment in forth if segment.channel for witness in segment.channel.witnesses],
        )
        self.care = Care(items, self.watch, self.start_up, self.troubles, self.summary.lost)
        read = clocks_beside(self.clock, epoch_ns, wall_time or datetime.fromtimestamp(0, UTC))
        self.clocks = Clocks(read, epoch_ns, log.clocks, self.note)
        self.missed = self.troubles.of("", "late")
        self.tick_frames = max(1, round(TICK_S * rate_hz))
        self.batch_frames = min(BATCH, max(1, round(BATCH_S * rate_hz)))
        self.truth: Callable[[int], Any] | None = getattr(bus, "truth", None)
        self.truth_rows: list[tuple[int, Any]] = []

    def _segments(self, stations: Sequence[Station]) -> list[Segment]:
        """In the order of the configuration. Channels of one multiplexer, and its trunk, are one adapter; a bus of its
        own is another.
        """
        shared, everybody = Adapter(), list(self.pending.values())
        return [
            Segment(
                [self.pending[id(station)] for station in part],
                everybody,
                Adapter() if isinstance(part[0].segment, str) else shared,
                self.clock,
                self.rate_hz,
                self.troubles,
                self.lose,
            )
            for part in there_and_back(stations)[0]
        ]

    def lose(self, adapter: Adapter, at_ns: int) -> None:
        """An adapter was removed: what is behind it is set up when it is there again."""
        for segment in self.orders[0]:
            if segment.adapter is adapter:
                for pending in segment.items:
                    self.care.set_up_later(pending, at_ns)

    def run(self, seconds: float | None, stopped: Callable[[], bool]) -> None:
        """Frame after frame on a grid of their times: one that begins late is counted late, one whose time has passed
        is counted missed.
        """
        period_ns = round(1e9 / self.rate_hz)
        self.log.keep()
        due_ns = self.clock.now_ns()  # files take time, which no frame has missed
        end_ns = None if seconds is None else due_ns + round(seconds * 1e9)
        if isinstance(self.log, RotatingWriter):
            self.log.starts(due_ns - self.epoch_ns)
        for pending in self.pending.values():
            if pending.queue is not None:  # its queue ran over while the others were configured
                with contextlib.suppress(OSError):
                    pending.driver.fetch()
        try:
            while (end_ns is None or due_ns < end_ns) and not stopped():
                self.frame()
                due_ns += period_ns
                behind_ns = self.clock.now_ns() - due_ns
                if behind_ns > 0:
                    self.summary.late += 1
                    left = behind_ns if end_ns is None else min(behind_ns, end_ns - due_ns)
                    due_ns += self.skip(max(left, 0) // period_ns) * period_ns
                else:
                    self.wait(due_ns, stopped)
        finally:  # whatever ended it: what was read is vouched for or flagged, and written
            self.finish()

    def skip(self, frames: int) -> int:
        """So many frames were missed: what is polled has lost readings, what is queued has not."""
        if frames:
            self.summary.missed += frames
            text = f"{counted(frames, 'frame')} missed: the one before ended too late"
            self.missed.happened(self.clock.now_ns(), text, frames)
            for pending in self.pending.values():
                pending.missing |= pending.queue is None and not pending.station.sensor.spec.on_demand
        return frames

    def wait(self, due_ns: int, stopped: Callable[[], bool]) -> None:
        """Sleep until the next frame, waking now and then to hear whether somebody wants to stop."""
        while (now_ns := self.clock.now_ns()) < due_ns:
            self.clock.sleep_until(min(due_ns, now_ns + _NAP_NS))
            if self.clock.now_ns() < due_ns and stopped():
                return

    def frame(self) -> None:
        """Read every sensor that is due once, and check whose turn it is while its segment is selected."""
        if self.truth is not None:
            now_ns = self.clock.now_ns()
            self.truth_rows.append((now_ns, self.truth(now_ns)))
        due = self.watch.due()
        frames = self.summary.frames
        for segment in self.orders[frames % 2]:
            if self.group(segment):
                for check in due:
                    if check.pending.station.segment == segment.key:
                        self.watch.run(check)
        self.summary.frames = frames = frames + 1
        if frames % self.tick_frames == 0:
            self.tick()
        if frames % self.batch_frames == 0:
            self.write()

    def group(self, segment: Segment) -> bool:
        """Read one segment's sensors one after the other; whether it was the right segment, so that checks make sense.

        The end of one reading is the start of the next: each is known to lie between two readings of the clock.
        """
        adapter = segment.adapter
        now_ns = segment.begin()
        for pending in segment.items:
            if not (pending.always_due or pending.due(now_ns)):
                continue
            if now_ns < adapter.silent_until_ns or (adapter.removed and not segment.has_returned(pending)):
                self.care.lost(pending, now_ns, None)
                continue
            if pending.recovery is not None:
                error = self.care.step(pending, now_ns)
                if error is not None:
                    segment.failed(error)
            else:
                self.visit(pending, segment, now_ns)
            now_ns = self.clock.now_ns()
        return segment.confirm(self.watch, self.summary.lost)

    def visit(self, pending: Pending, segment: Segment, now_ns: int) -> None:
        """Fetch; once more if nobody acknowledged; then the reading is missing: no row, an event when silence begins.

        Before anything is sent again it is asked which channel is connected: a silent address may be a wrong channel,
        and what was read before in this visit another chip's.
        """
        again = False
        try:
            burst = pending.driver.fetch()
        except OSError as error:
            segment.failed(error)
            if error.errno in REMOVED:  # told once for all of its sensors
                self.care.lost(pending, now_ns, None)
                return
            if error.errno == errno.ETIMEDOUT:  # to ask again would cost as much time again
                self.care.lost(pending, now_ns, error)
                return
            if segment.channel is not None:
                segment.confirm(self.watch, self.summary.lost)
            now_ns, again = self.clock.now_ns(), True
            try:
                burst = pending.driver.fetch()
            except OSError as second:
                segment.failed(second)
                self.care.lost(pending, now_ns, second)
                return
        if not burst:  # nothing to give yet; maybe it was not even asked
            return
        adapter = segment.adapter
        if adapter.time_outs:
            segment.answered()
        start_ns, certain = adapter.start_of(now_ns, self.clock.now_ns(), pending.clocks)
        self.summary.uncertain += not certain
        pending.silent_since_ns = None
        if pending.failed:
            self.care.arrived(pending, start_ns)
        pending.add(burst, start_ns, doubtful=again or not certain)

    def tick(self) -> None:
        """What need not be looked at every frame."""
        now_ns = self.clock.now_ns()
        self.clocks.tick(now_ns)
        self.care.tick(now_ns)
        self.troubles.settle(now_ns)

    def note(self, at_ns: int, kind: str, text: str) -> None:
        """Something happened to the array as a whole."""
        self.troubles.of("", kind).happened(at_ns, text)

    def event(self, sensor: str, at_ns: int, kind: str, text: str) -> None:
        """Note that something happened to a sensor, or to the array."""
        event = Event(at_ns - self.epoch_ns, sensor, kind, text)
        self.log.event(event)
        self.tell(event)

    def finish(self) -> None:
        """Vouch for what was read, or flag it; write it; tell the end of what events began."""
        self.watch.finish()
        self.care.finish(self.clock.now_ns())
        self.write(last=True)
        now_ns = self.clock.now_ns()
        self.troubles.close(now_ns)
        self.summary.silent = [item.station.sensor.name for item in self.pending.values() if item.silent(now_ns)]

    def write(self, *, last: bool = False) -> None:
        """Decode and write what waits and is trusted."""
        now_ns = self.clock.now_ns()
        for pending in self.pending.values():
            count = len(pending.times_ns) if last else self.care.trusted_rows(pending, now_ns)
            if count > 0:
                block = pending.take(count, self.epoch_ns)
                self.log.append(pending.station.sensor.name, block)
                self.observe(pending.station.sensor.name, block)
                self.watch.taken(pending, count)
                self.care.written(pending, block, self.epoch_ns)
        if self.truth_rows:
            self.log.stimulus("truth", _truth_block(self.truth_rows, self.epoch_ns))
            self.truth_rows = []
        self.progress(self.summary.frames)


def _truth_block(rows: Sequence[tuple[int, Any]], epoch_ns: int) -> Stimulus:
    """What an emulated world says of itself, as rows of `/truth`."""
    return Stimulus(
        np.array([at_ns for at_ns, _ in rows], np.int64) - epoch_ns,
        np.array([felt.force_box for _, felt in rows]),
        np.array([felt.rate_box for _, felt in rows]),
        np.array([felt.temperature_degc for _, felt in rows]),
    )
