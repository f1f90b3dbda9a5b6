"""Recorded logs as the diagnosis takes them: what was done in each, which sensors were read when, how the box lay.

What a log says is believed: phases that say which axis was up, `/truth` or `/reference` on how the box moved. Where it
says nothing, static poses are found and their attitudes estimated from the accelerometers
(`imuarray.gap.recording.attitude`); a motion that nothing tells of is left out. Every such decision is a note.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.errors import LogError
from imuarray.gap.recording.phases import attitudes_of, kind_of, phases_of, unknown_temperature
from imuarray.gap.recording.source import RecordedSource, Source
from imuarray.log import Log, SensorLog
from imuarray.log.format import Phase, SensorHeader
from imuarray.log.writer import Block
from imuarray.simulate.converters import THERMOMETERS
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.motion.like import LikeLog
from imuarray.simulate.motion.posed import Posed
from imuarray.simulate.simulation import Plan, plan_like
from imuarray.simulate.timeline import filled
from imuarray.simulate.waits import awaited
from imuarray.units import INERTIAL

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]
Temperature = Callable[[Times], npt.NDArray[np.floating]]
"""Times (n,) in ns to degC (n,): one reference for all sensors, recorded or simulated."""


class Experiment(NamedTuple):
    """What happened in one log: which sensors were read when, and what the box did."""

    plan: Plan
    motion: Motion


@dataclass(frozen=True)
class Recording:
    """A recorded log, named as its file; `kind` is what was done (static, tumble, heating, turn-on, motion), `phases`
    the stretches that are compared, `experiment` what a simulation of it needs, rows that were lost included, `notes`
    what was assumed or left out.

    The log stays open.
    """

    name: str
    log: Log
    kind: str
    phases: tuple[Phase, ...]
    experiment: Experiment
    notes: tuple[str, ...] = ()


def recording_of(log: Log, only: Collection[str] = ()) -> Recording:
    """One log, of its inertial sensors or `only` those named.

    LogError for a sensor that it doesn't have, and for a log in which nothing can be compared.
    """
    chosen, left_out = _chosen(log, only)
    plan = plan_like(log, chosen)
    lines = awaited({name: filled(log[name]) for name in plan.sensors}, log.sensors)
    sensors = {name: (_without_strange_thermometer(header), lines[name]) for name, (header, _) in plan.sensors.items()}
    motion = LikeLog(log)
    phases, skipped = phases_of(log, motion)
    attitudes, assumed = attitudes_of(log, phases, motion)
    notes = (*left_out, *skipped, *assumed, *unknown_temperature(log))
    posed = Posed(attitudes, motion) if any(attitude.estimated for attitude in attitudes) else motion
    experiment = Experiment(replace(plan, sensors=sensors), posed)
    return Recording(log.path.name, log, kind_of(phases, attitudes), phases, experiment, notes)


def recordings_of(logs: Sequence[Log], only: Collection[str] = ()) -> tuple[Recording, ...]:
    """Several logs of one array, in the order in which they were recorded if all of them say when; a sensor that one
    lacks is left out there, with a note.

    LogError for one that none has, or that was set otherwise in another log.
    """
    found: list[Recording] = []
    first: dict[str, SensorLog] = {}
    if all(log.epoch for log in logs):
        logs = sorted(logs, key=lambda log: log.epoch)
    names = dict.fromkeys(
        only or (name for log in logs for name, sensor in log.sensors.items() if _is_inertial(sensor))
    )
    for name in names:
        if not any(name in log.sensors for log in logs):
            raise LogError(f"{logs[0].path}: no sensor {name!r}, nor in any other log")
    for log in logs:
        here = [name for name in names if name in log.sensors and len(log[name])]
        for name in here:
            _same(first.setdefault(name, log[name]), log[name])
        if not here:
            raise LogError(f"{log.path}: none of the sensors {', '.join(names)} was read in it")
        recording = recording_of(log, here)
        lacking = tuple(f"{name} is left out: it was not read in this log." for name in names if name not in here)
        found.append(replace(recording, notes=(*lacking, *recording.notes)))
    return tuple(found)


def temperature_of(motion: Motion) -> Temperature:
    """The reference temperature that a motion tells."""

    def temperature(time_ns: Times) -> Floats:
        return np.asarray(motion.felt(time_ns).temperature_degc, float)

    return temperature


def sources_of(recording: Recording) -> dict[str, Source]:
    """Its sensors' rows, as a simulation of it has them: without the counts of thermometers whose scale is unknown."""
    sources: dict[str, Source] = {}
    for name, (header, _) in recording.experiment.plan.sensors.items():
        source = RecordedSource(recording.log[name])
        strange = source.header.has_temperature and not header.has_temperature
        sources[name] = _NoThermometer(source) if strange else source
    return sources


class _NoThermometer:
    """A source without the counts of a thermometer of which nobody knows what they mean."""

    def __init__(self, source: Source) -> None:
        self.header = replace(source.header, has_temperature=False)
        self.known: dict[Hashable, Any] = {}
        self._source = source

    def rows(self, start_ns: int, end_ns: int) -> int:
        return self._source.rows(start_ns, end_ns)

    def blocks(self, start_ns: int, end_ns: int) -> Iterator[Block]:
        return (block._replace(temperature_counts=None) for block in self._source.blocks(start_ns, end_ns))


def _chosen(log: Log, only: Collection[str]) -> tuple[list[str], list[str]]:
    """Names of sensors, and notes on those left out."""
    wanted = [log[name] for name in only] or [sensor for sensor in log.sensors.values() if _is_inertial(sensor)]
    for sensor in wanted:
        if not sensor.is_triad:
            raise LogError(f"{sensor.where}: {sensor.quantity} has no three axes; allowed are triads")
    notes = [f"{sensor.name} is left out: its sensitivity is not known." for sensor in wanted if not sensor.sensitivity]
    chosen = [sensor.name for sensor in wanted if sensor.sensitivity and len(sensor)]
    if not chosen:
        raise LogError(f"{log.path}: no accelerometer or gyroscope with readings and a known sensitivity")
    return chosen, notes


def _is_inertial(sensor: SensorLog) -> bool:
    return sensor.quantity in INERTIAL


def _same(one: SensorLog, other: SensorLog) -> None:
    for name in ("chip", "quantity", "unit", "range", "sensitivity", "axes"):
        if (here := getattr(other, name)) != (there := getattr(one, name)):
            raise LogError(f"{other.where}: {name} is {here}, but {there} in {one.where}")


def _without_strange_thermometer(header: SensorHeader) -> SensorHeader:
    return replace(header, has_temperature=header.has_temperature and header.chip in THERMOMETERS)
