"""Events of single rows of a recorded sensor. They happen at other moments in a simulation and are not compared."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Integers
from imuarray.gap.recording.host_lag import HostLag, host_lags
from imuarray.gap.recording.outliers import Outliers, outliers_in_motion
from imuarray.gap.recording.resets import Reset, resets_in
from imuarray.gap.recording.source import recorded_source
from imuarray.log import Log
from imuarray.log.format import Phase
from imuarray.log.writer import Block
from imuarray.simulate.host_latency import DelayedTimes, lost_rows
from imuarray.simulate.motion.stimulus import Motion
from imuarray.simulate.timeline import Timeline
from imuarray.units import INERTIAL

MOST_STRETCHES = 256
"""Largest number of stretches of a log that are kept, the longest ones."""

_FEWEST_REPETITIONS = 2
"""Fewest repetitions of a stretch."""


@dataclass(frozen=True)
class RepeatedRows:
    """The k longest stretches of a log in which every row equals the row before on all axes, in the order of time; at
    most `MOST_STRETCHES`, each with two such rows or more.

    `rows` (k,) is the number of these rows, `begin_ns` (k,) the time of the first, `end_ns` (k,) that of the last,
    `counts` (k, 3) the reading that they repeat.
    """

    rows: Integers
    begin_ns: Integers
    end_ns: Integers
    counts: Integers


_NONE = np.zeros(0, np.int64)
NO_REPEATED_ROWS = RepeatedRows(_NONE, _NONE, _NONE, np.zeros((0, 3), np.int64))


def repeated_rows_in(blocks: Iterable[Block]) -> RepeatedRows:
    """Collect the repeated rows of a sensor in bounded memory."""
    last = np.zeros((0, 3), np.int16)
    longest = open_run = np.zeros((0, 6), np.int64)  # columns: rows, begin_ns, end_ns, and three counts
    for block in blocks:
        counts = np.concatenate([last, block.counts])
        x, y, z = (counts[1:] == counts[:-1]).T
        still = x & y & z
        runs = _runs(block.time[len(block.time) - len(still) :], counts[1:], still)
        if len(open_run) and len(still) and still[0]:
            runs[0, 0] += open_run[0, 0]
            runs[0, 1] = open_run[0, 1]
        else:
            runs = np.concatenate([open_run, runs])
        complete = len(runs) - int(len(still) > 0 and still[-1])
        longest, open_run, last = _longest(np.concatenate([longest, runs[:complete]])), runs[complete:], counts[-1:]
    longest = _longest(np.concatenate([longest, open_run]))
    return RepeatedRows(longest[:, 0], longest[:, 1], longest[:, 2], longest[:, 3:])


def _runs(time_ns: Integers, counts: Integers, still: Booleans) -> Integers:
    """Return (k, 6), for each stretch the number of rows, the times of the first and the last one, and three counts."""
    change = np.diff(np.concatenate([[False], still, [False]]).astype(np.int8))
    begins, ends = np.flatnonzero(change > 0), np.flatnonzero(change < 0) - 1
    return np.column_stack([ends - begins + 1, time_ns[begins], time_ns[ends], counts[begins]])


def _longest(runs: Integers) -> Integers:
    """Return the longest stretches in the order of time; of two equally long ones, the earlier is kept."""
    runs = runs[runs[:, 0] >= _FEWEST_REPETITIONS]
    if len(runs) <= MOST_STRETCHES:
        return runs
    return np.asarray(runs[np.sort(np.argsort(-runs[:, 0], kind="stable")[:MOST_STRETCHES])])


_END_NS = np.iinfo(np.int64).max


class Host(NamedTuple):
    """Delays of the host over all sensors of a log.

    `rows` is the number of rows of the log, `waits` the number of rows before which the host was kept waiting,
    `square_s2` the sum of the squares of half these waiting times in s^2, and `missed` the number of rows that it
    missed. `lags` are the lags of all sensors behind the track of the box's motion, if the log has one.
    """

    rows: int = 0
    waits: int = 0
    square_s2: float = 0.0
    missed: int = 0
    lags: tuple[HostLag, ...] = ()


PUNCTUAL = Host()


@dataclass(frozen=True)
class Events:
    """Events of one sensor in one log.

    `repeated`: stretches in which its rows repeat; `outliers`: isolated readings in each phase in which the box moves,
    compared with the other sensors; `holes` in its rows in the form of `GapFilledTimes.holes`; `host`: the delays of
    the host, estimated from all sensors; `resets`: stretches in which the chip had lost its configuration.
    """

    repeated: RepeatedRows = NO_REPEATED_ROWS
    outliers: tuple[Outliers, ...] = ()
    holes: tuple[tuple[int, int, int], ...] = ()
    host: Host = PUNCTUAL
    resets: tuple[Reset, ...] = ()


def events_of(
    log: Log, timelines: Mapping[str, Timeline], moving: Sequence[Phase], motion: Motion | None = None
) -> Mapping[str, Events]:
    """Return the events of the sensors with these timelines.

    `moving` are the phases in which the box moves; `motion` is the motion of the log's track, if it has one.
    """
    inertial = [log[name] for name in timelines if log[name].quantity in INERTIAL]  # a track has no magnetic field
    lags = host_lags(inertial, motion) if motion is not None and inertial else ()
    host = _host(timelines.values())._replace(lags=lags)
    return MappingProxyType(
        {name: _events(log, name, line, moving, timelines, host) for name, line in timelines.items()}
    )


def _host(timelines: Collection[Timeline]) -> Host:
    late = [line for line in timelines if isinstance(line, DelayedTimes)]
    return Host(
        sum(line.rows for line in timelines),
        sum(len(line.waited) for line in late),
        sum(float(np.square(line.half_ns * 1e-9).sum()) for line in late),
        sum(len(line.missed) for line in late),
    )


def _events(log: Log, name: str, line: Timeline, moving: Sequence[Phase], known: Collection[str], host: Host) -> Events:
    sensor = log[name]
    others = [log[other] for other in known if other != name and log[other].quantity == sensor.quantity]
    return Events(
        repeated_rows_in(recorded_source(sensor, line).blocks(0, _END_NS)),
        tuple(outliers_in_motion(sensor, others, phase) for phase in moving),
        lost_rows(line),
        host,
        resets_in(sensor),
    )
