"""What happened to single rows of a recorded sensor; a simulation happens to hit others, and is not asked."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from imuarray.gap.beside import lone_beside
from imuarray.gap.held import NOWHERE, Held, held_in
from imuarray.gap.lone import Lone
from imuarray.gap.source import RecordedSource
from imuarray.log import Log
from imuarray.log.format import Phase
from imuarray.simulate.timeline import Filled, Timeline

_END_NS = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Events:
    """Of one sensor in one log: stretches in which its rows are `held`; which readings are `lone` beside other sensors,
    in each phase in which the box moves; and the `holes` in its rows, as `Filled.holes` gives them.
    """

    held: Held = NOWHERE
    lone: tuple[Lone, ...] = ()
    holes: tuple[tuple[int, int, int], ...] = ()


def events_of(log: Log, timelines: Mapping[str, Timeline], moving: Sequence[Phase]) -> Mapping[str, Events]:
    """Of the sensors with these timelines; `moving` are the phases in which the box moves."""
    return MappingProxyType({name: _events(log, name, line, moving, timelines) for name, line in timelines.items()})


def _events(log: Log, name: str, line: Timeline, moving: Sequence[Phase], known: Collection[str]) -> Events:
    sensor = log[name]
    others = [log[other] for other in known if other != name and log[other].quantity == sensor.quantity]
    return Events(
        held_in(RecordedSource(sensor).blocks(0, _END_NS)),
        tuple(lone_beside(sensor, others, phase) for phase in moving),
        tuple(line.holes()) if isinstance(line, Filled) else (),
    )
