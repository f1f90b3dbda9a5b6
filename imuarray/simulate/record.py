"""A simulation written as a log, with the same columns, attributes and phases as a recorded one, and with `/truth`."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from functools import partial
from os import PathLike
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Integers
from imuarray.log.format import Event, Phase
from imuarray.log.writer import Block, LogWriter
from imuarray.simulate.simulation import Simulation
from imuarray.simulate.streams import CHUNK

EPOCH = "2000-01-01T00:00:00.000000Z"
"""Time 0 of a simulated log by default: the same for every run, so that the whole log is reproducible."""

_AHEAD = 4
"""Blocks per worker that are computed ahead of writing."""


class Written(NamedTuple):
    """The contents of a written log: frames, seconds, rows by sensor, and dropped rows by sensor."""

    frames: int
    seconds: float
    rows: dict[str, int]
    lost: dict[str, int]


class _ArrivingRows(NamedTuple):
    """A stretch of one sensor's rows: those that arrive, and the due times of the first row of each gap."""

    sensor: str
    block: Block
    lost: int
    silent_ns: Integers


@dataclass(frozen=True)
class Origin:
    """The origin that a simulated log states: the wall time of time 0 (ISO 8601, UTC), and a note (model and seed) that
    becomes an event at time 0.
    """

    epoch: str = EPOCH
    note: str = ""


@dataclass(frozen=True)
class Division:
    """The division of the work: rows per block, and an executor that computes `workers` blocks at a time. Threads are
    sufficient, because random numbers are drawn outside the interpreter's lock. With blocks as short as one chunk of
    the file, the overhead of NumPy and HDF5 calls would take a seventh of the time.
    """

    block_rows: int = 4 * CHUNK
    executor: Executor | None = None
    workers: int = 1


def write_log(
    simulation: Simulation,
    path: str | PathLike[str],
    *,
    origin: Origin = Origin(),
    division: Division = Division(),
    progress: Callable[[int], None] = lambda rows: None,
    force: bool = False,
) -> Written:
    """Write every row of `simulation` to a new log at `path`; OutputExistsError, LogError.

    The result does not depend on the `division` of the work. `progress` is called with the number of rows, of
    `total_rows`, that are written.
    """
    block_rows = division.block_rows
    headers = [sensor.header for sensor in simulation.sensors.values()]
    written, lost = dict.fromkeys(simulation.sensors, 0), dict.fromkeys(simulation.sensors, 0)
    plan, frames = simulation.plan, simulation.plan.frames
    seconds = frames.rows * frames.period_ns * 1e-9
    with LogWriter(
        path,
        headers,
        source="simulated",
        epoch=origin.epoch,
        config=plan.config,
        frame_rate_hz=plan.frame_rate_hz,
        force=force,
    ) as log:
        if origin.note:
            log.event(Event(0, "", "simulated", origin.note))
        for phase in phases_within(simulation.motion.phases, round(seconds * 1e9)):
            log.phase(phase)
        for start in range(0, frames.rows, block_rows):
            log.stimulus("truth", simulation.truth(start, min(start + block_rows, frames.rows)))
        rows_done = 0
        silences: list[tuple[int, str]] = []
        for part in _compute_in_order(_stretches(simulation, block_rows), division.executor, division.workers):
            log.append(part.sensor, part.block)
            silences += [(at_ns, part.sensor) for at_ns in part.silent_ns.tolist()]
            written[part.sensor] += len(part.block.time)
            lost[part.sensor] += part.lost
            rows_done += len(part.block.time) + part.lost
            progress(rows_done)
        for at_ns, name in sorted(silences):
            log.event(Event(at_ns, name, "lost", "no reading: a dropped sample"))
    return Written(frames.rows, seconds, written, lost)


def total_rows(simulation: Simulation) -> int:
    """Return the number of rows of all sensors, to which `progress` counts."""
    return sum(sensor.rows for sensor in simulation.sensors.values())


def phases_within(phases: tuple[Phase, ...], end_ns: int) -> list[Phase]:
    """Return the phases that begin before the end of a log, cut off there."""
    return [phase._replace(end_ns=min(phase.end_ns, end_ns)) for phase in phases if phase.start_ns < end_ns]


def _stretches(simulation: Simulation, block_rows: int) -> Iterator[Callable[[], _ArrivingRows]]:
    """Yield the parts of the work, one block of each sensor in turn."""
    longest = max(sensor.rows for sensor in simulation.sensors.values())
    for start in range(0, longest, block_rows):
        for name, sensor in simulation.sensors.items():
            if start < sensor.rows:
                yield partial(_part, simulation, name, start, min(start + block_rows, sensor.rows))


def _part(simulation: Simulation, name: str, start: int, stop: int) -> _ArrivingRows:
    sensor = simulation.sensors[name]
    lost = sensor.lost_rows(max(start - 1, 0), stop)
    begins = lost[(np.diff(lost, prepend=-2) > 1) & (lost >= start)]
    silent = [int(sensor.timeline.stamps(row, row + 1)[0]) for row in begins.tolist()]
    return _ArrivingRows(name, sensor.block(start, stop), int((lost >= start).sum()), np.array(silent, np.int64))


def _compute_in_order(
    work: Iterator[Callable[[], _ArrivingRows]], executor: Executor | None, workers: int
) -> Iterator[_ArrivingRows]:
    """Yield the results in the order of the work; a few are computed ahead."""
    if executor is None:
        yield from (job() for job in work)
        return
    waiting: deque[Future[_ArrivingRows]] = deque()
    for job in work:
        waiting.append(executor.submit(job))
        if len(waiting) >= _AHEAD * workers:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()
