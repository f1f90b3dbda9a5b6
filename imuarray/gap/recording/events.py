"""What happened to single rows of a recorded sensor; a simulation happens to hit others, and is not asked."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.gap.recording.host_lag import HostLag, behind
from imuarray.gap.recording.neighbours import lone_beside
from imuarray.gap.recording.outliers import Outliers
from imuarray.gap.recording.repeated_rows import NOWHERE, RepeatedRows, held_in
from imuarray.gap.recording.resets import Reset, resets_in
from imuarray.gap.recording.source import recorded_source
from imuarray.log import Log
from imuarray.log.format import Phase
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.timeline import Filled, Timeline
from imuarray.simulate.waits import Awaited
from imuarray.units import INERTIAL

_END_NS = np.iinfo(np.int64).max


class Host(NamedTuple):
    """Of a log of so many `rows`, of all its sensors: before how many of them the host was kept waiting (`waits`), the
    sum of the squares of half of these times in s^2, and how many rows it `missed`; `behind`, how far all sensors are
    behind the track of the box's motion, if the log has one.
    """

    rows: int = 0
    waits: int = 0
    square_s2: float = 0.0
    missed: int = 0
    behind: tuple[HostLag, ...] = ()


IN_TIME = Host()


@dataclass(frozen=True)
class Events:
    """Of one sensor in one log: stretches in which its rows are `held`; which readings are `lone` beside other sensors,
    in each phase in which the box moves; and the `holes` in its rows, as `Filled.holes` gives them. `host` is what
    the times of all sensors tell of the host, `resets` are stretches in which the chip was not set as it should be.
    """

    held: RepeatedRows = NOWHERE
    lone: tuple[Outliers, ...] = ()
    holes: tuple[tuple[int, int, int], ...] = ()
    host: Host = IN_TIME
    resets: tuple[Reset, ...] = ()


def events_of(
    log: Log, timelines: Mapping[str, Timeline], moving: Sequence[Phase], motion: Motion | None = None
) -> Mapping[str, Events]:
    """Of the sensors with these timelines; `moving` are the phases in which the box moves, `motion` is what it felt if
    a track of the log tells.
    """
    inertial = [log[name] for name in timelines if log[name].quantity in INERTIAL]  # of a track that tells no field
    lags = behind(inertial, motion) if motion is not None and inertial else ()
    host = _host(timelines.values())._replace(behind=lags)
    return MappingProxyType(
        {name: _events(log, name, line, moving, timelines, host) for name, line in timelines.items()}
    )


def _host(timelines: Collection[Timeline]) -> Host:
    late = [line for line in timelines if isinstance(line, Awaited)]
    return Host(
        sum(line.rows for line in timelines),
        sum(len(line.waited) for line in late),
        sum(float(np.square(line.half_ns * 1e-9).sum()) for line in late),
        sum(len(line.missed) for line in late),
    )


def _events(log: Log, name: str, line: Timeline, moving: Sequence[Phase], known: Collection[str], host: Host) -> Events:
    sensor = log[name]
    others = [log[other] for other in known if other != name and log[other].quantity == sensor.quantity]
    own = line.own if isinstance(line, Awaited) else line
    return Events(
        held_in(recorded_source(sensor, line).blocks(0, _END_NS)),
        tuple(lone_beside(sensor, others, phase) for phase in moving),
        tuple(own.holes()) if isinstance(own, Filled) else (),
        host,
        resets_in(sensor),
    )
