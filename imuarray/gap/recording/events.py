"""Events of single rows of a recorded sensor. A simulation has other ones, so these are not compared."""

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
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.timeline import Timeline
from imuarray.units import INERTIAL

MOST_STRETCHES = 256
"""The most stretches of a log that are kept, the longest."""

_FEWEST_REPETITIONS = 2
"""Fewest repetitions of a stretch."""


@dataclass(frozen=True)
class RepeatedRows:
    """The k longest stretches of a log in which every row equals the one before on all axes, at most `MOST_STRETCHES`,
    of two such `rows` (k,) or more, in the order of time: `begin_ns` (k,) is the first of these rows, `end_ns` (k,) the
    last, `counts` (k, 3) what they read.
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
    longest = open_run = np.zeros((0, 6), np.int64)  # each of so many rows, from when, until when, and three counts
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
    """Return rows, first and last time, and the counts (k, 6) of each stretch."""
    change = np.diff(np.concatenate([[False], still, [False]]).astype(np.int8))
    begins, ends = np.flatnonzero(change > 0), np.flatnonzero(change < 0) - 1
    return np.column_stack([ends - begins + 1, time_ns[begins], time_ns[ends], counts[begins]])


def _longest(runs: Integers) -> Integers:
    """Return the longest stretches in the order of time; the earlier of two equally long ones."""
    runs = runs[runs[:, 0] >= _FEWEST_REPETITIONS]
    if len(runs) <= MOST_STRETCHES:
        return runs
    return np.asarray(runs[np.sort(np.argsort(-runs[:, 0], kind="stable")[:MOST_STRETCHES])])


_END_NS = np.iinfo(np.int64).max


class Host(NamedTuple):
    """Delays of the host over all sensors of a log.

    `rows` of the log, before how many of them the host was kept waiting (`waits`), the sum of the squares of half of
    these times in s^2, and how many rows it `missed`; `lags` of all sensors behind the track of the box's motion, if
    the log has one.
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

    `repeated`: stretches in which its rows repeat; `outliers` against the other sensors in each phase in which the box
    moves; `holes` in its rows as `GapFilledTimes.holes` gives them; `host`, the delays of the host seen in all sensors;
    `resets`, stretches in which the chip's configuration was lost.
    """

    repeated: RepeatedRows = NO_REPEATED_ROWS
    outliers: tuple[Outliers, ...] = ()
    holes: tuple[tuple[int, int, int], ...] = ()
    host: Host = PUNCTUAL
    resets: tuple[Reset, ...] = ()


def events_of(
    log: Log, timelines: Mapping[str, Timeline], moving: Sequence[Phase], motion: Motion | None = None
) -> Mapping[str, Events]:
    """Events of the sensors with these timelines.

    `moving` are the phases in which the box moves; `motion` is what it felt, if the log has a track.
    """
    inertial = [log[name] for name in timelines if log[name].quantity in INERTIAL]  # of a track that tells no field
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
