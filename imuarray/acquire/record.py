"""The poll loop: frame after frame at a steady rate, bursts kept raw, decoded and written a thousand at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.acquire.stations import Station, connect, there_and_back
from imuarray.array import ArrayConfig
from imuarray.bus.protocol import OpenBus
from imuarray.log.format import LOST_BEFORE, STALE, Event, Phase, SensorHeader
from imuarray.log.writer import Block, LogWriter, Stimulus

BATCH = 1024
"""Frames between two writes."""


@dataclass
class Summary:
    """What happened while a log was recorded."""

    frames: int = 0
    late: int = 0
    """Frames that began after their time."""
    lost: dict[str, int] = field(default_factory=dict)
    """Readings that never arrived, by sensor."""
    seconds: float = 0.0


@dataclass
class _Pending:
    """Bursts of one station that wait to be decoded and written."""

    station: Station
    times_ns: list[int] = field(default_factory=list)
    bursts: bytearray = field(default_factory=bytearray)
    lost_before: list[int] = field(default_factory=list)
    last: npt.NDArray[Any] | None = None
    missing: bool = False

    def block(self, epoch_ns: int) -> Block:
        """Decode everything that waits, and forget it."""
        driver = self.station.driver
        decoded = driver.decode(np.frombuffer(self.bursts, np.uint8).reshape(-1, driver.burst))
        status = decoded.status.copy()
        status[self.lost_before] |= LOST_BEFORE
        if not driver.tells_fresh:
            status |= self._repeated(decoded.counts)
        block = Block(
            np.array(self.times_ns, np.int64) - epoch_ns,
            decoded.counts,
            status,
            decoded.temperature_counts,
            decoded.compensated,
        )
        self.times_ns, self.bursts, self.lost_before = [], bytearray(), []
        return block

    def _repeated(self, counts: npt.NDArray[Any]) -> npt.NDArray[np.uint16]:
        """STALE where a triad equals the one before it; all a chip without a ready bit lets us know."""
        before = np.concatenate([counts[:1] - 1 if self.last is None else self.last, counts[:-1]])
        self.last = counts[-1:]
        return np.where((counts == before).all(axis=1), STALE, 0).astype(np.uint16)


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
    force: bool = False,
) -> Summary:
    """Record `array` on `bus` into a new log at `path`: `rate_hz` frames a second for `seconds`, or until `stopped()`.

    `phase` names the whole log, with `up` the box axis that points up; `phases` (times on the bus's clock) name parts
    of it. `wall_time` is the UTC time of the start (None: read the wall clock, once). Raises SensorError before the
    first frame if a sensor is missing or wrong, OutputExistsError if `path` exists."""
    stations = connect(array, bus)
    start_ns = bus.clock.now_ns()
    epoch = wall_time or datetime.now(UTC)
    headers = [_header(station) for station in stations]
    with LogWriter(path, headers, source=bus.source, epoch=_iso(epoch), config=array.text, force=force) as log:
        poll = _Poll(stations, bus, log, start_ns, progress)
        poll.run(rate_hz, seconds, stopped)
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
        self, stations: Sequence[Station], bus: OpenBus, log: LogWriter, epoch_ns: int, progress: Callable[[int], None]
    ) -> None:
        self.pending = {id(station): _Pending(station) for station in stations}
        self.orders = there_and_back(stations)
        self.bus = bus
        self.clock = bus.clock
        self.log = log
        self.epoch_ns = epoch_ns
        self.progress = progress
        self.summary = Summary(lost={station.sensor.name: 0 for station in stations})
        self.truth: Callable[[int], Any] | None = getattr(bus, "truth", None)
        self.truth_rows: list[tuple[int, Any]] = []

    def run(self, rate_hz: float, seconds: float | None, stopped: Callable[[], bool]) -> None:
        """Frame after frame; a frame that can't start in time is counted late, and none is skipped silently."""
        period_ns = round(1e9 / rate_hz)
        due_ns = self.clock.now_ns()
        end_ns = None if seconds is None else due_ns + round(seconds * 1e9)
        visits = [[self.pending[id(station)] for station in order] for order in self.orders]
        self.log.keep()
        while (end_ns is None or due_ns < end_ns) and not stopped():
            self.frame(visits[self.summary.frames % 2])
            due_ns += period_ns
            if self.clock.now_ns() > due_ns:
                self.summary.late += 1
                due_ns = self.clock.now_ns()
            else:
                self.clock.sleep_until(due_ns)
        self.write()

    def frame(self, visits: Sequence[_Pending]) -> None:
        """Read every sensor once."""
        now_ns = self.clock.now_ns
        if self.truth is not None:
            self.truth_rows.append((now_ns(), self.truth(now_ns())))
        for pending in visits:
            at_ns = now_ns()
            try:
                burst = pending.station.driver.fetch()
            except OSError as error:
                at_ns = now_ns()
                retried = self.retry(pending, error)
                if retried is None:
                    continue
                burst = retried
            if burst:
                if pending.missing:
                    pending.lost_before.append(len(pending.times_ns))
                    pending.missing = False
                pending.times_ns.append(at_ns)
                pending.bursts += burst
        self.summary.frames += 1
        if self.summary.frames % BATCH == 0:
            self.write()

    def retry(self, pending: _Pending, error: OSError) -> bytes | None:
        """Ask once more; if that fails too the reading is missing: no row, and an event when the silence begins."""
        try:
            return pending.station.driver.fetch()
        except OSError:
            name = pending.station.sensor.name
            self.summary.lost[name] += 1
            if not pending.missing:
                at_ns = self.clock.now_ns() - self.epoch_ns
                self.log.event(
                    Event(at_ns, name, "lost", f"no reading: {error.strerror or error} (errno {error.errno})")
                )
            pending.missing = True
            return None

    def write(self) -> None:
        """Decode and write what waits."""
        for pending in self.pending.values():
            if pending.times_ns:
                self.log.append(pending.station.sensor.name, pending.block(self.epoch_ns))
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


def _header(station: Station) -> SensorHeader:
    """What the log says of a station."""
    sensor, spec = station.sensor, station.sensor.spec
    barometer = spec.quantity == "pressure"
    return SensorHeader(
        name=sensor.name,
        chip=sensor.chip,
        quantity=spec.quantity,
        unit=spec.unit,
        range=sensor.range or 0.0,
        sensitivity=sensor.sensitivity,
        rate_hz=sensor.chip_rate_hz,
        bandwidth_hz=sensor.chip_bandwidth_hz,
        axes=sensor.axes,
        position_mm=(sensor.position_mm[0], sensor.position_mm[1], sensor.position_mm[2]),
        columns=("ut", "up") if barometer else ("x", "y", "z"),
        has_temperature=sensor.chip in ("bma180", "l3g4200d"),
        compensated=("temperature", "pressure") if barometer else (),
        extra=station.driver.header(),
    )


def _iso(moment: datetime) -> str:
    """ISO 8601 with microseconds and Z, whatever zone `moment` is in."""
    return (moment.astimezone(UTC) + timedelta(0)).isoformat(timespec="microseconds").replace("+00:00", "Z")
