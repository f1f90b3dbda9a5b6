"""Recording: connect, poll or listen, and name the parts of what is recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from os import PathLike
from typing import Any

from imuarray.acquire.poll import Poll
from imuarray.acquire.sensor_routes import connect
from imuarray.acquire.service import Service
from imuarray.acquire.start_up import Judge
from imuarray.acquire.stream import Streaming, streams
from imuarray.acquire.summary import Summary
from imuarray.array import ArrayConfig
from imuarray.bus.protocol import OpenBus
from imuarray.log.format import Event, Phase, SensorHeader
from imuarray.log.missed_frames import duration_s
from imuarray.log.preamble import header_of
from imuarray.log.rotate import RotatingWriter, Writer
from imuarray.log.writer import Block, LogWriter

_OPEN_END_NS = 1 << 62


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
    rotate_s: float | None = None,
    wall_time: datetime | None = None,
    stopped: Callable[[], bool] = lambda: False,
    progress: Callable[[int], None] = lambda frames: None,
    observe: Callable[[str, Block], None] = lambda sensor, block: None,
    tell: Callable[[Event], None] = lambda event: None,
    counted: Callable[[Summary], None] = lambda summary: None,
    judge: Judge | None = None,
    service: Service | None = None,
    begun: Callable[[str, Sequence[SensorHeader]], None] = lambda epoch, sensors: None,
    started: Callable[[int], None] = lambda time_ns: None,
    force: bool = False,
) -> Summary:
    """Record `array` on `bus` into a new log at `path`: `rate_hz` frames a second for `seconds`, or until `stopped()`.

    `phase` names the whole log, with `up` the box axis that points up; `phases` (times on the bus's clock) name parts
    of it. `observe` sees every block of a sensor's rows as it is written, `tell` every event, `counted` the summary so
    far. `judge` says how sensors came up; one that came up wrong is flagged and set up again. `rotate_s` cuts the log
    into parts of so many seconds, each a log of its own (`imuarray.log.rotate`). `service` is told how it goes (None:
    the one that this process belongs to). `begun` hears the log's epoch and what it says of its sensors before there is
    a log; what it raises ends the recording; `started` when the first of several parts begins. `wall_time` is the UTC
    time of the start (None: that of the transcript that is replayed, or the wall clock, read once).

    Raises SensorError before the first frame if a sensor is missing or wrong, OutputExistsError if the log exists,
    LogBusyError if it is being written, DiskFullError if it had to be ended early.
    """
    routes = connect(array, bus)
    start_ns = bus.clock.now_ns()
    epoch = wall_time or getattr(bus, "epoch", None) or datetime.now(UTC)
    if hasattr(bus, "begins"):  # a transcript notes when it was, and when it ends
        bus.begins(epoch)
    if hasattr(bus, "stopping"):
        stopped = bus.stopping(stopped)
    headers = [header_of(route.sensor, route.driver.header()) for route in routes]
    told = service or Service()
    begun(_iso(epoch), headers)
    about = {"source": bus.source, "epoch": _iso(epoch), "config": array.text, "frame_rate_hz": rate_hz, "force": force}
    with _writer(path, headers, rotate_s, started, **about) as log:
        loop = Streaming if streams(bus, routes) else Poll

        def written(frames: int) -> None:
            progress(frames)
            counted(recording.summary)
            told.stored(sum(log.acknowledged.values()))

        recording = loop(routes, bus, log, rate_hz, start_ns, written, observe, wall_time=epoch, judge=judge, tell=tell)
        named = [*([Phase(0, _OPEN_END_NS, phase, up)] if phase else []), *_since(phases, start_ns)]
        for part in named:  # at once: a log that is cut short has them too
            log.begins(part)
        try:
            recording.run(seconds, stopped)
        finally:
            told.stopping()
        end_ns = bus.clock.now_ns() - start_ns
        for part in _until(named, end_ns):
            log.phase(part)
    summary = recording.summary
    summary.seconds = duration_s(summary.frames, summary.missed, rate_hz)
    summary.logs = list(log.paths)
    return summary


def _writer(
    path: str | PathLike[str],
    headers: Sequence[SensorHeader],
    rotate_s: float | None,
    started: Callable[[int], None],
    **about: Any,
) -> Writer:
    """One log, or one cut into parts of so many seconds."""
    if rotate_s is None:
        return LogWriter(path, headers, **about)
    return RotatingWriter(path, headers, every_s=rotate_s, started=started, **about)


def _since(phases: Sequence[Phase], start_ns: int) -> list[Phase]:
    """Phases in the time of a log that began at `start_ns`, without what was before it."""
    return [
        part._replace(start_ns=max(part.start_ns - start_ns, 0), end_ns=part.end_ns - start_ns)
        for part in phases
        if part.end_ns > start_ns
    ]


def _until(phases: Sequence[Phase], end_ns: int) -> list[Phase]:
    """Phases of a log that ended at `end_ns`, without what would have been after it."""
    return [part._replace(end_ns=min(part.end_ns, end_ns)) for part in phases if part.start_ns < end_ns]


def _iso(moment: datetime) -> str:
    """ISO 8601 with microseconds and Z, whatever zone `moment` is in."""
    return moment.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
