"""All statistics of a campaign in a fixed order, each with a key that gives its origin."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.campaign import Campaign, LogSummary, PhaseSummary, runs_in
from imuarray.gap.statistics.probes import PROBES
from imuarray.gap.statistics.probes.probe import (
    ArrayProbe,
    CampaignProbe,
    CrossProbe,
    Domain,
    LogProbe,
    PhaseProbe,
    RunsProbe,
    TurnProbe,
)
from imuarray.gap.statistics.summary import Summary, side_by_side

ALL_LOGS = -1
"""Log number of a statistic of several logs. Its phase name is the kind of the logs, or empty for a statistic of all
logs of the campaign.
"""

WHOLE_LOG = -1
"""Phase number of a statistic of several phases."""

AXES = ("x", "y", "z")


_OF_PHASES = {name: probe for name, probe in PROBES.items() if isinstance(probe, PhaseProbe | CrossProbe)}
_IN_MOTION = {name: probe for name, probe in _OF_PHASES.items() if probe.in_motion}
_AT_REST = {name: probe for name, probe in _OF_PHASES.items() if isinstance(probe, PhaseProbe) or not probe.in_motion}
_OF_LOGS = {name: probe for name, probe in PROBES.items() if isinstance(probe, LogProbe | ArrayProbe | TurnProbe)}
_OF_RUNS = {name: probe for name, probe in PROBES.items() if isinstance(probe, RunsProbe)}
_OF_CAMPAIGNS = {name: probe for name, probe in PROBES.items() if isinstance(probe, CampaignProbe)}


class Key(NamedTuple):
    """Place, domain and probe of a statistic; `axis` is "" for a statistic of the whole sensor."""

    log: int
    sensor: str
    axis: str
    phase: str
    phase_number: int
    domain: Domain
    probe: str


@dataclass(frozen=True)
class Statistics:
    """Statistics of a campaign: `values` (n,) of the `keys`, nan where a probe has no value, and the least meaningful
    difference of each, `resolutions` (n,), 0 if any difference is meaningful.
    """

    keys: tuple[Key, ...]
    values: Floats
    resolutions: Floats

    def __getitem__(self, key: Key) -> float:
        """The value of a key; KeyError for an unknown key."""
        return float(self.values[self._places[key]])

    @cached_property
    def _places(self) -> dict[Key, int]:
        return {key: place for place, key in enumerate(self.keys)}


class _Place(NamedTuple):
    """Place of the statistics of all axes."""

    log: int
    sensor: str
    phase: str
    phase_number: int


class _ProbeValues(NamedTuple):
    """Values of one probe at one place: `values` (r, k) of r replicates, with k = 3 axes or k = 1, and a function that
    returns their least meaningful difference, one or (k,).
    """

    probe: str
    values: Floats
    resolution: Callable[[], Floats | float]


class ReplicateStatistics(NamedTuple):
    """Statistics of r replicates: `values` (r, n) of the n `keys`."""

    keys: tuple[Key, ...]
    values: Floats


def statistics(campaign: Campaign) -> Statistics:
    """Compute every probe wherever it applies: for each phase, each log, the logs of each kind, and all logs."""
    by_place = list(_by_place([campaign]))
    keys, (values,) = _table(by_place, 1)
    least = [np.full(probe.values.shape[1], probe.resolution()) for _, several in by_place for probe in several]
    return Statistics(keys, values, np.concatenate([np.zeros(0), *least]))


def replicate_statistics(campaigns: Sequence[Campaign], sensors: Collection[str]) -> ReplicateStatistics:
    """Compute the statistics of the given sensors in several replicates that were summarised with the same layouts."""
    return _table(_by_place(campaigns, sensors), len(campaigns))


def _table(by_place: Iterable[tuple[_Place, list[_ProbeValues]]], replicates: int) -> ReplicateStatistics:
    """Return the values as a table with one row for each replicate."""
    keys: list[Key] = []
    values = [np.zeros((replicates, 0))]
    for place, several in by_place:
        keys += _keys(
            place, tuple([probe.probe for probe in several]), tuple([probe.values.shape[1] for probe in several])
        )
        values += [probe.values for probe in several]
    return ReplicateStatistics(tuple(keys), np.concatenate(values, axis=1))


@lru_cache(maxsize=1 << 12)
def _keys(place: _Place, probes: tuple[str, ...], sizes: tuple[int, ...]) -> tuple[Key, ...]:
    """Return the keys of probes at one place, which are the same for every replicate."""
    log, sensor, phase, number = place
    return tuple(
        Key(log, sensor, axis, phase, number, PROBES[probe].domain, probe)
        for probe, size in zip(probes, sizes, strict=True)
        for axis in (AXES if size == len(AXES) else ("",))
    )


def _by_place(
    campaigns: Sequence[Campaign], sensors: Collection[str] | None = None
) -> Iterator[tuple[_Place, list[_ProbeValues]]]:
    """Yield the values of all probes in replicates of one campaign, place by place."""
    logs = zip(*(campaign.logs for campaign in campaigns), strict=True)
    for number, replicates in enumerate(logs):
        for phases in zip(*(log.phases for log in replicates), strict=True):
            for sensor, values in _of_phase(phases, sensors).items():
                yield _Place(number, sensor, phases[0].phase.name, phases[0].number), values
        for sensor in _sensors(replicates[0].phases, sensors):
            yield _Place(number, sensor, "", WHOLE_LOG), _of_log(replicates, sensor)
    series = [campaign.series() for campaign in campaigns]
    for kind, series_logs in series[0].items() if series else ():
        for sensor in _sensors(series_logs[0].phases, sensors):
            yield _Place(ALL_LOGS, sensor, kind, WHOLE_LOG), _of_runs([by_kind[kind] for by_kind in series], sensor)
    for sensor in _sensors([phase for log in campaigns[0].logs for phase in log.phases], sensors) if campaigns else ():
        yield _Place(ALL_LOGS, sensor, "", WHOLE_LOG), _of_campaign(campaigns, sensor)


def _sensors(phases: Sequence[PhaseSummary], only: Collection[str] | None) -> list[str]:
    """Return the sensors of these phases without repetition, restricted to `only` unless it is None."""
    there = dict.fromkeys(sensor for phase in phases for sensor in phase.sensors)
    return [sensor for sensor in there if only is None or sensor in only]


def _of_phase(replicates: Sequence[PhaseSummary], only: Collection[str] | None) -> dict[str, list[_ProbeValues]]:
    """Return the values of the probes of a phase by sensor. The outer loop is over probes, which is faster than over
    sensors.
    """
    first = replicates[0]
    sensors = _sensors([first], only)
    single = {sensor: [phase.sensors[sensor] for phase in replicates] for sensor in sensors}
    together = {sensor: _group(several) for sensor, several in single.items()}
    crosses = [phase.cross for phase in replicates if phase.cross is not None]
    crossed = [item.name for item in crosses[0].sensors if item.name in single] if crosses else []
    by_sensor: dict[str, list[_ProbeValues]] = {sensor: [] for sensor in sensors}
    for name, probe in (_AT_REST if first.is_still else _IN_MOTION).items():
        if isinstance(probe, PhaseProbe):
            for sensor, several in single.items():
                values = _by_phase(probe, several, together[sensor])
                by_sensor[sensor].append(_ProbeValues(name, values, partial(probe.resolution, several[0])))
        elif isinstance(probe, CrossProbe):
            for sensor in crossed:
                values = np.array([probe.statistic(cross, sensor) for cross in crosses])
                by_sensor[sensor].append(_ProbeValues(name, values, partial(_least_of_cross, probe, first, sensor)))
    return by_sensor


def _least_of_cross(probe: CrossProbe, phase: PhaseSummary, sensor: str) -> Floats | float:
    """Return the least meaningful difference of a probe in a phase, of each axis (3,) or of all; larger if the motion
    hardly determines it or is not resolved.
    """
    if phase.cross is None:
        return probe.resolution
    least = np.maximum(probe.resolution, probe.uncertainty(phase.cross, sensor))
    is_resolved = phase.sensors[sensor].header.quantity not in phase.layout.unresolved
    return least if is_resolved else np.maximum(least, probe.unresolved(phase.cross))


def _group(replicates: Sequence[Summary]) -> list[tuple[list[int], Summary]]:
    """Group replicates whose rows have the same times; return the places and the joint summary of each group."""
    sets: dict[tuple[int, bytes, bytes], list[int]] = {}
    for at, summary in enumerate(replicates):
        part = summary.segments
        sets.setdefault((summary.rows, part.rows.tobytes(), part.time_s.tobytes()), []).append(at)
    return [(places, side_by_side([replicates[at] for at in places])) for places in sets.values()]


def _by_phase(
    probe: PhaseProbe, replicates: Sequence[Summary], together: Sequence[tuple[list[int], Summary]]
) -> Floats:
    """Return the values (r, k) of a probe in each replicate; if the probe works column by column, each group of
    replicates is computed at once.
    """
    if not probe.by_column:
        return _rows([probe.statistic(summary) for summary in replicates])
    values = np.empty((len(replicates), len(AXES)))
    for places, summary in together:
        values[places] = probe.statistic(summary).reshape(-1, len(AXES))
    return values


def _of_log(replicates: Sequence[LogSummary], sensor: str) -> list[_ProbeValues]:
    still = [log.still(sensor) for log in replicates]
    values: list[_ProbeValues] = []
    for name, probe in _OF_LOGS.items() if still[0] else ():
        if isinstance(probe, LogProbe):
            by_replicate = [probe.statistic(phases) for phases in still]
            values.append(_ProbeValues(name, _rows(by_replicate), partial(probe.resolution, still[0])))
        elif isinstance(probe, TurnProbe):
            if any(phase.ups_box for phase in replicates[0].phases):
                by_replicate = [probe.statistic(log, sensor) for log in replicates]
                values.append(_ProbeValues(name, _rows(by_replicate), partial(float, probe.resolution)))
        else:
            by_replicate = [probe.statistic(log, sensor) for log in replicates]
            values.append(_ProbeValues(name, _rows(by_replicate), partial(probe.resolution, replicates[0], sensor)))
    return values


def _of_runs(replicates: Sequence[tuple[LogSummary, ...]], sensor: str) -> list[_ProbeValues]:
    runs = [replicate_runs for logs in replicates if (replicate_runs := runs_in(logs, sensor)) is not None]
    if not runs or runs[0].header.quantity == "magnetic_field":  # the field of another day is unknown
        return []
    return [
        _ProbeValues(name, _rows([probe.statistic(of_replicate) for of_replicate in runs]), _any_difference)
        for name, probe in _OF_RUNS.items()
    ]


def _of_campaign(replicates: Sequence[Campaign], sensor: str) -> list[_ProbeValues]:
    phases = [[summary for log in replicate.logs for summary in log.of(sensor)] for replicate in replicates]
    return [
        _ProbeValues(name, _rows([probe.statistic(each) for each in phases]), partial(probe.resolution, phases[0]))
        for name, probe in _OF_CAMPAIGNS.items()
    ]


def _rows(values: Sequence[Floats]) -> Floats:
    """Return the values of r replicates as a table (r, k), with k = 3 axes or k = 1."""
    return np.array(values).reshape(len(values), -1)


def _any_difference() -> float:
    """Return the resolution of a statistic in which any difference is meaningful."""
    return 0.0
