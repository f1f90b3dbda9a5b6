"""All statistics of a campaign under keys that say where they are from, in an order that never changes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.campaign import Campaign, LogSummary, PhaseSummary, runs_in
from imuarray.gap.statistics.probes import PROBES
from imuarray.gap.statistics.probes.probe import ArrayProbe, CrossProbe, Domain, LogProbe, PhaseProbe, RunsProbe
from imuarray.gap.statistics.summary import Summary, side_by_side

ALL_LOGS = -1
"""The log's index of a statistic of several logs; their kind stands where others have their phase."""

WHOLE_LOG = -1
"""The phase's number of a statistic of several phases; its phase's name is empty."""

AXES = ("x", "y", "z")


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


class _Said(NamedTuple):
    """What one probe says at one place in each replicate, `values` (r, k) on three axes or one, and how small a
    difference of them means anything.
    """

    probe: str
    values: Floats
    resolution: Callable[[], float]


class ReplicateStatistics(NamedTuple):
    """`values` (r, n) of r replicates under the `keys`."""

    keys: tuple[Key, ...]
    values: Floats


def statistics(campaign: Campaign) -> Statistics:
    """Every probe wherever it applies: phase by phase, log by log, then the logs of one kind together."""
    said = list(_all([campaign]))
    keys, (values,) = _table(said, 1)
    least = [np.full(one.values.shape[1], one.resolution()) for _, several in said for one in several]
    return Statistics(keys, values, np.concatenate([np.zeros(0), *least]))


def replicate_statistics(campaigns: Sequence[Campaign], sensors: Collection[str]) -> ReplicateStatistics:
    """The same of these sensors in several replicates, which were looked at alike."""
    return _table(_all(campaigns, sensors), len(campaigns))


def _table(said: Iterable[tuple[_Place, list[_Said]]], replicates: int) -> ReplicateStatistics:
    """One row for each replicate."""
    keys: list[Key] = []
    values = [np.zeros((replicates, 0))]
    for place, several in said:
        keys += _keys(place, tuple([one.probe for one in several]), tuple([one.values.shape[1] for one in several]))
        values += [one.values for one in several]
    return ReplicateStatistics(tuple(keys), np.concatenate(values, axis=1))


@lru_cache(maxsize=1 << 12)
def _keys(place: _Place, probes: tuple[str, ...], sizes: tuple[int, ...]) -> tuple[Key, ...]:
    """Of these probes at one place; every replicate has the same."""
    log, sensor, phase, number = place
    return tuple(
        Key(log, sensor, axis, phase, number, PROBES[probe].domain, probe)
        for probe, size in zip(probes, sizes, strict=True)
        for axis in (AXES if size == len(AXES) else ("",))
    )


def _all(campaigns: Sequence[Campaign], sensors: Collection[str] | None = None) -> Iterator[tuple[_Place, list[_Said]]]:
    """Of replicates of one campaign, place by place."""
    logs = zip(*(campaign.logs for campaign in campaigns), strict=True)
    for number, replicates in enumerate(logs):
        for phases in zip(*(log.phases for log in replicates), strict=True):
            for sensor, said in _of_phase(phases, sensors).items():
                yield _Place(number, sensor, phases[0].phase.name, phases[0].number), said
        for sensor in _sensors(replicates[0].phases, sensors):
            yield _Place(number, sensor, "", WHOLE_LOG), _of_log(replicates, sensor)
    series = [campaign.series() for campaign in campaigns]
    for kind, own in series[0].items() if series else ():
        for sensor in _sensors(own[0].phases, sensors):
            yield _Place(ALL_LOGS, sensor, kind, WHOLE_LOG), _of_runs([one[kind] for one in series], sensor)


def _sensors(phases: Sequence[PhaseSummary], wanted: Collection[str] | None) -> list[str]:
    """Those that these phases have and that are wanted, each once."""
    there = dict.fromkeys(sensor for phase in phases for sensor in phase.sensors)
    return [sensor for sensor in there if wanted is None or sensor in wanted]


def _of_phase(replicates: Sequence[PhaseSummary], wanted: Collection[str] | None) -> dict[str, list[_Said]]:
    """By sensor; one probe after the other of all sensors is faster than one sensor after the other."""
    first = replicates[0]
    sensors = _sensors([first], wanted)
    single = {sensor: [phase.sensors[sensor] for phase in replicates] for sensor in sensors}
    together = {sensor: _together(several) for sensor, several in single.items()}
    crosses = [phase.cross for phase in replicates if phase.cross is not None]
    crossed = [item.name for item in crosses[0].sensors if item.name in single] if crosses else []
    said: dict[str, list[_Said]] = {sensor: [] for sensor in sensors}
    for name, probe in (_AT_REST if first.is_still else _IN_MOTION).items():
        if isinstance(probe, PhaseProbe):
            for sensor, several in single.items():
                values = _by_phase(probe, several, together[sensor])
                said[sensor].append(_Said(name, values, partial(probe.resolution, several[0])))
        elif isinstance(probe, CrossProbe):
            for sensor in crossed:
                found = np.array([probe.statistic(cross, sensor) for cross in crosses])
                said[sensor].append(_Said(name, found, _any))
    return said


def _together(replicates: Sequence[Summary]) -> list[tuple[list[int], Summary]]:
    """Those whose rows have the same times, by their places, side by side."""
    sets: dict[tuple[int, bytes, bytes], list[int]] = {}
    for at, one in enumerate(replicates):
        part = one.segments
        sets.setdefault((one.rows, part.rows.tobytes(), part.time_s.tobytes()), []).append(at)
    return [(places, side_by_side([replicates[at] for at in places])) for places in sets.values()]


def _by_phase(
    probe: PhaseProbe, replicates: Sequence[Summary], together: Sequence[tuple[list[int], Summary]]
) -> Floats:
    """(r, k) of each replicate, of those `together` at once if that will do."""
    if not probe.by_column:
        return _rows([probe.statistic(summary) for summary in replicates])
    values = np.empty((len(replicates), len(AXES)))
    for places, summary in together:
        values[places] = probe.statistic(summary).reshape(-1, len(AXES))
    return values


def _of_log(replicates: Sequence[LogSummary], sensor: str) -> list[_Said]:
    still = [log.still(sensor) for log in replicates]
    said: list[_Said] = []
    for name, probe in _OF_LOGS.items() if still[0] else ():
        if isinstance(probe, LogProbe):
            found = [probe.statistic(phases) for phases in still]
            said.append(_Said(name, _rows(found), partial(float, probe.resolution)))
        else:
            said.append(_Said(name, _rows([probe.statistic(log, sensor) for log in replicates]), _any))
    return said


def _of_runs(replicates: Sequence[tuple[LogSummary, ...]], sensor: str) -> list[_Said]:
    runs = [own for logs in replicates if (own := runs_in(logs, sensor)) is not None]
    if not runs or runs[0].header.quantity == "magnetic_field":  # nobody knows the field of another day
        return []
    return [_Said(name, _rows([probe.statistic(one) for one in runs]), _any) for name, probe in _OF_RUNS.items()]


def _rows(found: Sequence[Floats]) -> Floats:
    """(r, k) of what r replicates say on three axes or one."""
    return np.array(found).reshape(len(found), -1)


def _any() -> float:
    """Any difference means something."""
    return 0.0
