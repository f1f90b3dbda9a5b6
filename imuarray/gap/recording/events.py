"""Events of single rows of a recorded sensor. A simulation has other ones, so these are not compared."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.gap.recording.host_lag import HostLag, host_lags
from imuarray.gap.recording.neighbours import outliers_in_motion
from imuarray.gap.recording.outliers import Outliers
from imuarray.gap.recording.repeated_rows import NO_REPEATED_ROWS, RepeatedRows, repeated_rows_in
from imuarray.gap.recording.resets import Reset, resets_in
from imuarray.gap.recording.source import recorded_source
from imuarray.log import Log
from imuarray.log.format import Phase
from imuarray.simulate.host_latency import DelayedTimes
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.timeline import GapFilledTimes, Timeline
from imuarray.units import INERTIAL

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
    own = line.own if isinstance(line, DelayedTimes) else line
    return Events(
        repeated_rows_in(recorded_source(sensor, line).blocks(0, _END_NS)),
        tuple(outliers_in_motion(sensor, others, phase) for phase in moving),
        tuple(own.holes()) if isinstance(own, GapFilledTimes) else (),
        host,
        resets_in(sensor),
    )
