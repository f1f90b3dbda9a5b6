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


class _Found(NamedTuple):
    """What one probe says at one place."""

    log: int
    sensor: str
    phase: str
    phase_number: int
    probe: str
    value: Floats
    resolution: float


def statistics(campaign: Campaign) -> Statistics:
    """Every probe wherever it applies: phase by phase, log by log, then the logs of one kind together."""
    keys: list[Key] = []
    values: list[Floats] = []
    resolutions: list[float] = []
    for found in _all(campaign):
        value = np.atleast_1d(found.value)
        here = _keys(found.log, found.sensor, found.phase, found.phase_number, found.probe, len(value) == len(AXES))
        keys += here
        values.append(value)
        resolutions += [found.resolution] * len(here)
    joined = np.concatenate(values) if values else np.zeros(0)
    return Statistics(tuple(keys), joined, np.array(resolutions))


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
    for place, key in enumerate(keys):
        if power := _NOISE_POWERS.get(key.probe, 0):
            predicted[place] = power * math.log(noises[key.sensor][AXES.index(key.axis)])
    return predicted


@lru_cache(maxsize=1 << 15)
def _keys(log: int, sensor: str, phase: str, phase_number: int, probe: str, by_axis: bool) -> tuple[Key, ...]:
    """Of one probe at one place; every replicate has the same."""
    axes = AXES if by_axis else ("",)
    return tuple(Key(log, sensor, axis, phase, phase_number, PROBES[probe].domain, probe) for axis in axes)


def _all(campaign: Campaign) -> Iterator[_Found]:
    for number, log in enumerate(campaign.logs):
        for phase in log.phases:
            yield from _of_phase(number, phase)
        yield from _of_log(number, log)
    for kind, logs in campaign.series().items():
        yield from _of_runs(kind, logs)


def _of_phase(log: int, phase: PhaseSummary) -> Iterator[_Found]:
    still, name, number = phase.is_still, phase.phase.name, phase.number
    for sensor, summary in phase.sensors.items():
        crossed = phase.cross if _takes_part(phase, sensor) else None
        for probe_name, probe in PROBES.items():
            if isinstance(probe, PhaseProbe) and (still or probe.in_motion):
                value = probe.statistic(summary)
                yield _Found(log, sensor, name, number, probe_name, value, probe.resolution(summary))
            elif isinstance(probe, CrossProbe) and still != probe.in_motion and crossed is not None:
                yield _Found(log, sensor, name, number, probe_name, probe.statistic(crossed, sensor), 0.0)


def _takes_part(phase: PhaseSummary, sensor: str) -> bool:
    return phase.cross is not None and any(item.name == sensor for item in phase.cross.sensors)


def _of_log(log: int, summary: LogSummary) -> Iterator[_Found]:
    sensors = dict.fromkeys(sensor for phase in summary.phases for sensor in phase.sensors)
    for sensor in sensors:
        still = summary.still(sensor)
        for name, probe in PROBES.items():
            if isinstance(probe, LogProbe) and still:
                yield _Found(log, sensor, "", WHOLE_LOG, name, probe.statistic(still), probe.resolution)
            elif isinstance(probe, ArrayProbe) and still:
                yield _Found(log, sensor, "", WHOLE_LOG, name, probe.statistic(summary, sensor), 0.0)


def _of_runs(kind: str, logs: tuple[LogSummary, ...]) -> Iterator[_Found]:
    sensors = dict.fromkeys(sensor for phase in logs[0].phases for sensor in phase.sensors)
    for sensor in sensors:
        runs = runs_in(logs, sensor)
        for name, probe in PROBES.items():
            if isinstance(probe, RunsProbe) and runs is not None:
                yield _Found(ALL_LOGS, sensor, kind, WHOLE_LOG, name, probe.statistic(runs), 0.0)
