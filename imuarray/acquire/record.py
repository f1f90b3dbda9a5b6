"""Records an array into a log: connects its sensors, polls them or listens to a stream, and names the phases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from os import PathLike
from typing import Any

from imuarray.acquire.poll import Poll
from imuarray.acquire.recording import RecordingOptions, Summary
from imuarray.acquire.sensor_routes import connect
from imuarray.acquire.service import Service
from imuarray.acquire.stream import Streaming, streams
from imuarray.array import ArrayConfig
from imuarray.bus.protocol import OpenBus
from imuarray.log.format import Phase, SensorHeader
from imuarray.log.missed_frames import duration_s
from imuarray.log.rotate import RotatingWriter, Writer
from imuarray.log.writer import LogWriter

_OPEN_END_NS = 1 << 62


def record(
    array: ArrayConfig,
    bus: OpenBus,
    path: str | PathLike[str],
    options: RecordingOptions | None = None,
    **changes: Any,
) -> Summary:
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
    if hasattr(bus, "begins"):  # a transcript notes when it was, and when it ends
        bus.begins(epoch)
    if hasattr(bus, "stopping"):
        stopped = bus.stopping(stopped)
    headers = [route.header for route in routes]
    service = options.service or Service()
    options.begun(_iso(epoch), headers)
    with _writer(path, headers, options, epoch=_iso(epoch), source=bus.source, config=array.text) as log:

        def report(frames: int) -> None:
            options.progress(frames)
            options.counted(recording.summary)
            service.stored(sum(log.acknowledged.values()))

        loop = Streaming if streams(bus, routes) else Poll
        recording = loop(routes, bus, log, replace(options, wall_time=epoch, progress=report), start_ns)
        whole = [Phase(0, _OPEN_END_NS, options.phase, options.up)] if options.phase else []
        phases = [*whole, *_since(options.phases, start_ns)]
        for phase in phases:  # at once: a log that is cut short has them too
            log.begins(phase)
        try:
            recording.run(options.seconds, stopped)
        finally:
            service.stopping()
        end_ns = bus.clock.now_ns() - start_ns
        for phase in _until(phases, end_ns):
            log.phase(phase)
    summary = recording.summary
    summary.seconds = duration_s(summary.frames, summary.missed, options.rate_hz)
    summary.logs = list(log.paths)
    return summary


def _writer(
    path: str | PathLike[str], headers: Sequence[SensorHeader], options: RecordingOptions, **about: Any
) -> Writer:
    """One log, or one that is split into parts; `about` is what the log says of itself."""
    about |= {"frame_rate_hz": options.rate_hz, "force": options.force}
    if options.rotate_s is None:
        return LogWriter(path, headers, **about)
    return RotatingWriter(path, headers, every_s=options.rotate_s, started=options.started, **about)


def _since(phases: Sequence[Phase], start_ns: int) -> list[Phase]:
    """The phases in the time of a log that began at `start_ns`, without what was before it."""
    return [
        phase._replace(start_ns=max(phase.start_ns - start_ns, 0), end_ns=phase.end_ns - start_ns)
        for phase in phases
        if phase.end_ns > start_ns
    ]


def _until(phases: Sequence[Phase], end_ns: int) -> list[Phase]:
    """The phases of a log that ended at `end_ns`, without what would have been after it."""
    return [phase._replace(end_ns=min(phase.end_ns, end_ns)) for phase in phases if phase.start_ns < end_ns]


def _iso(moment: datetime) -> str:
    """ISO 8601 with microseconds and Z, in whatever zone `moment` is."""
    return moment.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
