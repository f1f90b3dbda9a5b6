"""The poll loop: frame after frame at a steady rate, bursts kept raw, decoded and written a thousand at a time."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from os import PathLike
from typing import Any

import numpy as np

from imuarray.acquire.pending import Pending
from imuarray.acquire.stations import Station, connect, there_and_back
from imuarray.acquire.watch import Watch
from imuarray.array import ArrayConfig
from imuarray.bus.mux import MuxChannel
from imuarray.bus.protocol import OpenBus
from imuarray.log.format import Event, Phase
from imuarray.log.headers import header_of
from imuarray.log.writer import Block, LogWriter, Stimulus

BATCH = 1024
"""Frames between two writes."""

_NAP_NS = 200_000_000


@dataclass
class Summary:
    """What happened while a log was recorded."""

    frames: int = 0
    late: int = 0
    """Frames that began after their time."""
    lost: dict[str, int] = field(default_factory=dict)
    """Readings that never arrived, by sensor."""
    seconds: float = 0.0


def record(
    array: ArrayConfig,
    bus: OpenBus,
    path: str | PathLike[str],
    *,
    rate_hz: float,
    seconds: float | None = None,
    phases: Sequence[Phase] = (),
    phase: str = "",
    up: str = "",
    wall_time: datetime | None = None,
    stopped: Callable[[], bool] = lambda: False,
    progress: Callable[[int], None] = lambda frames: None,
    observe: Callable[[str, Block], None] = lambda sensor, block: None,
    force: bool = False,
) -> Summary:
    """Record `array` on `bus` into a new log at `path`: `rate_hz` frames a second for `seconds`, or until `stopped()`.

    `phase` names the whole log, with `up` the box axis that points up; `phases` (times on the bus's clock) name parts
    of it. `observe` sees every block of a sensor's rows as it is written. `wall_time` is the UTC time of the start
    (None: read the wall clock, once). Raises SensorError before the first frame if a sensor is missing or wrong,
    OutputExistsError if `path` exists.
    """
    stations = connect(array, bus)
    start_ns = bus.clock.now_ns()
    epoch = wall_time or datetime.now(UTC)
    headers = [header_of(station.sensor, station.driver.header()) for station in stations]
    with LogWriter(path, headers, source=bus.source, epoch=_iso(epoch), config=array.text, force=force) as log:
        poll = _Poll(stations, bus, log, rate_hz, start_ns, progress, observe)
        poll.run(seconds, stopped)
        end_ns = bus.clock.now_ns() - start_ns
        if phase:
            log.phase(Phase(0, end_ns, phase, up))
        for part in phases:
            if part.start_ns < start_ns + end_ns and part.end_ns > start_ns:
                log.phase(
                    Phase(max(part.start_ns - start_ns, 0), min(part.end_ns - start_ns, end_ns), part.name, part.up)
                )
    poll.summary.seconds = end_ns * 1e-9
    return poll.summary


class _Poll:
    """The state of one recording."""

    def __init__(
        self,
        stations: Sequence[Station],
        bus: OpenBus,
        log: LogWriter,
        rate_hz: float,
        epoch_ns: int,
        progress: Callable[[int], None],
        observe: Callable[[str, Block], None],
    ) -> None:
        self.pending = {id(station): Pending(station) for station in stations}
        self.orders = [
            [[self.pending[id(station)] for station in part] for part in order] for order in there_and_back(stations)
        ]
        self.watch = Watch([item for segment in self.orders[0] for item in segment], rate_hz, self.lost_configuration)
        self.rate_hz = rate_hz
        self.clock = bus.clock
        self.log = log
        self.epoch_ns = epoch_ns
        self.progress = progress
        self.observe = observe
        self.summary = Summary(lost={station.sensor.name: 0 for station in stations})
        self.truth: Callable[[int], Any] | None = getattr(bus, "truth", None)
        self.truth_rows: list[tuple[int, Any]] = []

    def run(self, seconds: float | None, stopped: Callable[[], bool]) -> None:
        """Frame after frame; a frame that can't start in time is counted late, and none is skipped silently."""
        period_ns = round(1e9 / self.rate_hz)
        due_ns = self.clock.now_ns()
        end_ns = None if seconds is None else due_ns + round(seconds * 1e9)
        self.log.keep()
        for pending in self.pending.values():
            if pending.queue is not None:  # its queue ran over while the others were configured
                self.drain(pending)
        try:
            while (end_ns is None or due_ns < end_ns) and not stopped():
                self.frame()
                due_ns += period_ns
                if self.clock.now_ns() > due_ns:
                    self.summary.late += 1
                    due_ns = self.clock.now_ns()
                else:
                    self.wait(due_ns, stopped)
        finally:  # whatever ended it: what was read is vouched for and written
            self.watch.finish()
            self.write()

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
        for segment in self.orders[self.summary.frames % 2]:
            self.select(segment[0])
            for pending in segment:
                if pending.due(self.clock.now_ns(), self.rate_hz):
                    self.visit(pending)
            for check in due:
                if check.pending.station.segment == segment[0].station.segment:
                    self.watch.run(check)
        self.summary.frames += 1
        if self.summary.frames % BATCH == 0:
            self.write()

    def select(self, pending: Pending) -> None:
        """Connect a segment before its first reading is timed; if that fails the reading will fail too, and say so."""
        bus = pending.driver.registers.bus
        if isinstance(bus, MuxChannel):
            with contextlib.suppress(OSError):
                bus.select()

    def drain(self, pending: Pending) -> None:
        """Empty a queue of samples from before the log."""
        with contextlib.suppress(OSError):
            pending.driver.fetch()

    def visit(self, pending: Pending) -> None:
        """Fetch; once more if the bus fails; then the reading is missing: no row, an event when the silence begins."""
        for retry in (False, True):
            at_ns = self.clock.now_ns()
            try:
                pending.add(pending.driver.fetch(), at_ns)
                return
            except OSError as error:
                if retry:
                    self.lost(pending, at_ns, error)

    def lost(self, pending: Pending, at_ns: int, error: OSError) -> None:
        """A reading did not arrive."""
        self.summary.lost[pending.station.sensor.name] += 1
        if not pending.missing:
            self.event(pending, at_ns, "lost", f"no reading: {error.strerror or error} (errno {error.errno})")
        pending.missing = True

    def lost_configuration(self, pending: Pending, text: str) -> None:
        """The watch found that a chip is not configured as it was, or is again."""
        self.event(pending, self.clock.now_ns(), "configuration", text)

    def event(self, pending: Pending, at_ns: int, kind: str, text: str) -> None:
        """Note that something happened to a sensor."""
        self.log.event(Event(at_ns - self.epoch_ns, pending.station.sensor.name, kind, text))

    def write(self) -> None:
        """Decode and write what waits and is trusted."""
        for pending in self.pending.values():
            count = self.watch.trusted_rows(pending)
            if count:
                block = pending.take(count, self.epoch_ns, self.rate_hz)
                self.log.append(pending.station.sensor.name, block)
                self.observe(pending.station.sensor.name, block)
                self.watch.taken(pending, count)
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


def _iso(moment: datetime) -> str:
    """ISO 8601 with microseconds and Z, whatever zone `moment` is in."""
    return moment.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
