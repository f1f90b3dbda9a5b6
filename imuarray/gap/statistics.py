"""All statistics of a campaign under keys that say where they are from, in an order that never changes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.gap.base_model import Base, residual
from imuarray.gap.campaign import Campaign, LogSummary, PhaseSummary, runs_in
from imuarray.gap.probes import PROBES
from imuarray.gap.probes.probe import ArrayProbe, CrossProbe, Domain, LogProbe, PhaseProbe, RunsProbe
from imuarray.simulate.motion.felt import Motion

Floats = npt.NDArray[np.float64]

ALL_LOGS = -1
"""The log's index of a statistic of several logs; their kind stands where others have their phase."""

WHOLE_LOG = -1
"""The phase's number of a statistic of several phases; its phase's name is empty."""

AXES = ("x", "y", "z")

_NOISE_POWERS = {"noise": 1, "motion_residual": 2, "run_spread": 1}
"""Statistics in logs of the sensor's unit to a power: as many logs of the fitted noise are taken from them."""


_OF_PHASES = {name: probe for name, probe in PROBES.items() if isinstance(probe, PhaseProbe | CrossProbe)}
_IN_MOTION = {name: probe for name, probe in _OF_PHASES.items() if probe.in_motion}
_AT_REST = {name: probe for name, probe in _OF_PHASES.items() if isinstance(probe, PhaseProbe) or not probe.in_motion}
_OF_LOGS = {name: probe for name, probe in PROBES.items() if isinstance(probe, LogProbe | ArrayProbe)}
_OF_RUNS = {name: probe for name, probe in PROBES.items() if isinstance(probe, RunsProbe)}


class Key(NamedTuple):
    """Where a statistic is from; `axis` is "" for the whole sensor."""

    log: int
    sensor: str
    axis: str
    phase: str
    phase_number: int
    domain: Domain
    probe: str


@dataclass(frozen=True)
class Statistics:
    """`values` (n,) of the `keys`, nan where a probe says nothing, and the least difference that means anything in each
    (`resolutions`, (n,), 0: any).
    """

    keys: tuple[Key, ...]
    values: Floats
    resolutions: Floats

    def __getitem__(self, key: Key) -> float:
        """One value; KeyError."""
        return float(self.values[self._places[key]])

    @cached_property
    def _places(self) -> dict[Key, int]:
        return {key: place for place, key in enumerate(self.keys)}


class _Place(NamedTuple):
    """Where statistics are from, but for their axes."""

    log: int
    sensor: str
    phase: str
    phase_number: int


_Said = tuple[str, Floats, float]
"""What one probe says at one place: its name, the value, its resolution."""


def statistics(campaign: Campaign) -> Statistics:
    """Every probe wherever it applies: phase by phase, log by log, then the logs of one kind together."""
    keys: list[Key] = []
    values: list[Floats] = [np.zeros(0)]
    resolutions: list[Floats] = [np.zeros(0)]
    for place, said in _all(campaign):
        if not said:
            continue
        probes, found, least = zip(*said, strict=True)
        flat = [value.reshape(-1) for value in found]
        sizes = tuple([len(value) for value in flat])
        keys += _keys(place, probes, sizes)
        values += flat
        resolutions.append(np.repeat(least, sizes))
    return Statistics(tuple(keys), np.concatenate(values), np.concatenate(resolutions))


def residual_statistics(campaign: Campaign, motions: Sequence[Motion], base: Base) -> Statistics:
    """Statistics of what a fit leaves, to the campaign or to another part of it: of levels less the predicted ones, of
    noises over the fitted ones.
    """
    found = statistics(residual(campaign, motions, base))
    return replace(found, values=found.values - _predictions(found.keys, base))


def _predictions(keys: Sequence[Key], base: Base) -> Floats:
    """(n,) what the noise that was fitted makes of statistics in logs, 0 of others."""
    noises = {name: fitted.noise(base.headers[name]).tolist() for name, fitted in base.fitted.items()}
    predicted = np.zeros(len(keys))
    for place in [place for place, key in enumerate(keys) if key.probe in _NOISE_POWERS]:
        key = keys[place]
        predicted[place] = _NOISE_POWERS[key.probe] * math.log(noises[key.sensor][AXES.index(key.axis)])
    return predicted


@lru_cache(maxsize=1 << 12)
def _keys(place: _Place, probes: tuple[str, ...], sizes: tuple[int, ...]) -> tuple[Key, ...]:
    """Of these probes at one place; every replicate has the same."""
    log, sensor, phase, number = place
    return tuple(
        Key(log, sensor, axis, phase, number, PROBES[probe].domain, probe)
        for probe, size in zip(probes, sizes, strict=True)
        for axis in (AXES if size == len(AXES) else ("",))
    )


def _all(campaign: Campaign) -> Iterator[tuple[_Place, list[_Said]]]:
    for number, log in enumerate(campaign.logs):
        for phase in log.phases:
            for sensor, said in _of_phase(phase).items():
                yield _Place(number, sensor, phase.phase.name, phase.number), said
        for sensor in dict.fromkeys(sensor for phase in log.phases for sensor in phase.sensors):
            yield _Place(number, sensor, "", WHOLE_LOG), _of_log(log, sensor)
    for kind, logs in campaign.series().items():
        for sensor in dict.fromkeys(sensor for phase in logs[0].phases for sensor in phase.sensors):
            yield _Place(ALL_LOGS, sensor, kind, WHOLE_LOG), _of_runs(logs, sensor)


def _of_phase(phase: PhaseSummary) -> dict[str, list[_Said]]:
    """By sensor; one probe after the other of all sensors is faster than one sensor after the other."""
    said: dict[str, list[_Said]] = {sensor: [] for sensor in phase.sensors}
    crossed = [item.name for item in phase.cross.sensors if item.name in said] if phase.cross is not None else []
    for name, probe in (_AT_REST if phase.is_still else _IN_MOTION).items():
        if isinstance(probe, PhaseProbe):
            for sensor, summary in phase.sensors.items():
                said[sensor].append((name, probe.statistic(summary), probe.resolution(summary)))
        elif phase.cross is not None:
            for sensor in crossed:
                said[sensor].append((name, probe.statistic(phase.cross, sensor), 0.0))
    return said


def _of_log(log: LogSummary, sensor: str) -> list[_Said]:
    still = log.still(sensor)
    said: list[_Said] = []
    for name, probe in _OF_LOGS.items() if still else ():
        if isinstance(probe, LogProbe):
            said.append((name, probe.statistic(still), probe.resolution))
        else:
            said.append((name, probe.statistic(log, sensor), 0.0))
    return said


def _of_runs(logs: tuple[LogSummary, ...], sensor: str) -> list[_Said]:
    runs = runs_in(logs, sensor)
    return [(name, probe.statistic(runs), 0.0) for name, probe in _OF_RUNS.items()] if runs is not None else []
