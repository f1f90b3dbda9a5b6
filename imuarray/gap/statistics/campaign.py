"""Summaries of all logs of one array that are diagnosed together, recorded or simulated."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from imuarray.gap.recording.course import Stretches
from imuarray.gap.recording.events import Events
from imuarray.gap.recording.phases import Up, is_at_rest
from imuarray.gap.recording.recordings import LogReference
from imuarray.gap.recording.source import Source
from imuarray.gap.statistics.cross import Cross, CrossTally, window_ns
from imuarray.gap.statistics.runs import Runs, runs_of
from imuarray.gap.statistics.summary import Grid, Summary, Tally
from imuarray.log.format import Phase
from imuarray.log.writer import Block
from imuarray.simulate.streams import CHUNK
from imuarray.units import INERTIAL


@dataclass(frozen=True)
class Layout:
    """Resolution at which a phase is summarised: the grid of every sensor and the length of the common windows.
    Simulations use the layout of the recorded phase. `unresolved`: the quantities with changes in a recorded motion
    that the rows do not resolve.
    """

    grids: Mapping[str, Grid]
    window_ns: int
    unresolved: tuple[str, ...] = ()


@dataclass(frozen=True)
class PhaseSummary:
    """Summary of one phase: its number in the log, a summary for each sensor, and `cross`, the joint moments of the
    inertial sensors and, in motion, of a track (None for fewer than two). `ups_box` are the directions up in the box's
    frame at the begin and end of a turn between two rests, or of a part of it; None at rest or if they are unknown.
    """

    phase: Phase
    number: int
    layout: Layout
    sensors: Mapping[str, Summary]
    cross: Cross | None
    ups_box: tuple[Up, Up] | None = None

    @property
    def is_still(self) -> bool:
        """True if the box is at rest in the phase, as its name says."""
        return is_at_rest(self.phase)


@dataclass(frozen=True)
class LogSummary:
    """Summary of one log.

    `kind` is the procedure (static, tumble, heating, turn-on, motion); `phases` are in order. A recorded log also has
    the `events` in single rows of each sensor, and the `spells` of each sensor: stretches in which its readings differ
    from those in the rest of the log, each with the summary of the log in these stretches.
    """

    kind: str
    phases: tuple[PhaseSummary, ...]
    events: Mapping[str, Events] = field(default_factory=dict)
    spells: Mapping[str, tuple[tuple[Stretches, LogSummary], ...]] = field(default_factory=dict)

    def of(self, sensor: str) -> tuple[Summary, ...]:
        """Return the summaries of the sensor in all phases."""
        return tuple(part.sensors[sensor] for part in self.phases if sensor in part.sensors)

    def still(self, sensor: str) -> tuple[Summary, ...]:
        """Return the summaries of the sensor in the phases at rest."""
        return tuple(part.sensors[sensor] for part in self.phases if part.is_still and sensor in part.sensors)

    def exchanged(self, first: str, second: str) -> LogSummary:
        """Return the log with the rows of two sensors exchanged; the joint moments (`cross`) are not changed."""
        names = {first: second, second: first}
        phases = [replace(part, sensors=_rename_sensors(part.sensors, names)) for part in self.phases]
        return replace(self, phases=tuple(phases))


def _rename_sensors(sensors: Mapping[str, Summary], names: Mapping[str, str]) -> dict[str, Summary]:
    """Return the summaries with names and headers exchanged as `names` maps them; sensors without a counterpart are
    left out.
    """
    rows = {name: sensors[names.get(name, name)] for name in sensors if names.get(name, name) in sensors}
    return {name: replace(summary, header=sensors[name].header) for name, summary in rows.items()}


@dataclass(frozen=True)
class Campaign:
    """Several logs of one array."""

    logs: tuple[LogSummary, ...]

    def series(self) -> dict[str, tuple[LogSummary, ...]]:
        """Return the logs of each kind that has several logs."""
        kinds = dict.fromkeys(log.kind for log in self.logs)
        by_kind = {kind: tuple(log for log in self.logs if log.kind == kind) for kind in kinds}
        return {kind: logs for kind, logs in by_kind.items() if len(logs) > 1}


def summarise_log(
    kind: str,
    sources: Mapping[str, Source],
    phases: Sequence[Phase],
    reference: LogReference,
    layouts: Sequence[Layout] | None = None,
) -> LogSummary:
    """Summarise every sensor in every phase, in one pass. `layouts`, one for each phase, are those of the log that the
    summary is compared with; None for a recorded log.
    """
    (summary,) = summarise_logs(kind, [sources], phases, reference, layouts)
    return summary


def summarise_logs(
    kind: str,
    replicates: Sequence[Mapping[str, Source]],
    phases: Sequence[Phase],
    reference: LogReference,
    layouts: Sequence[Layout] | None = None,
    at_rest: Collection[str] | None = None,
) -> list[LogSummary]:
    """Summarise several replicates of one log with the same sensors, as `summarise_log` does; in phases at rest only
    the sensors `at_rest` (None: all).
    """
    still = replicates if at_rest is None else [_select(sources, at_rest) for sources in replicates]
    # in motion only inertial sensors are summarised, since the magnetic field along the path is unknown
    moving = [_select(sources, _inertial_in(sources)) for sources in replicates]
    by_phase = [
        _summarise_phase(
            still if is_at_rest(phase) else moving,
            phase,
            number,
            reference,
            None if layouts is None else layouts[number],
        )
        for number, phase in enumerate(phases)
    ]
    return [LogSummary(kind, tuple(summaries[at] for summaries in by_phase)) for at in range(len(replicates))]


def _summarise_phase(
    replicates: Sequence[Mapping[str, Source]],
    phase: Phase,
    number: int,
    reference: LogReference,
    layout: Layout | None,
) -> list[PhaseSummary]:
    """Summarise one phase of each replicate: short phases of several replicates jointly, long ones one replicate at a
    time, to bound the memory.
    """
    used = layout or layout_of(replicates[0], phase, reference.unresolved(phase))
    survey = _PhaseSurvey(phase, number, reference, used, layout is None)
    rows = max((source.rows(phase.start_ns, phase.end_ns) for source in replicates[0].values()), default=0)
    at_once = max(CHUNK // max(rows, 1), 1)
    summaries: list[PhaseSummary] = []
    for first in range(0, len(replicates), at_once):
        some = replicates[first : first + at_once]
        is_short = layout is not None and rows * len(some) <= CHUNK
        summaries += survey.summarise_jointly(some) if is_short else [survey.summarise_in_one_pass(some[0])]
    return summaries


def _select(sources: Mapping[str, Source], names: Collection[str]) -> dict[str, Source]:
    """Return the sources with these names."""
    return {name: source for name, source in sources.items() if name in names}


def _inertial_in(sources: Mapping[str, Source]) -> Collection[str]:
    """Return the names of the inertial sensors."""
    return {name for name, source in sources.items() if source.header.quantity in INERTIAL}


class _PhaseSurvey(NamedTuple):
    """A phase that is summarised. Quantities that no statistic needs are computed only if it is `recorded`."""

    phase: Phase
    number: int
    reference: LogReference
    layout: Layout
    recorded: bool

    def summarise_jointly(self, replicates: Sequence[Mapping[str, Source]]) -> list[PhaseSummary]:
        """Summarise sensor by sensor; replicates whose rows have the same times are processed together."""
        blocks = [
            {name: list(source.blocks(self.phase.start_ns, self.phase.end_ns)) for name, source in sources.items()}
            for sources in replicates
        ]
        for name, first in replicates[0].items():
            grid = self.layout.grids[name]
            new = [at for at, sources in enumerate(replicates) if (self.phase, grid) not in sources[name].cache]
            for some in _simultaneous([block[name] for block in blocks], new):
                tally = Tally(first.header, self.phase, grid, len(some), outliers=self.recorded)
                for several in zip(*(blocks[at][name] for at in some), strict=True):
                    tally.update(*several)
                for at, summary in zip(some, tally.results(self.reference.temperature), strict=True):
                    replicates[at][name].cache[self.phase, grid] = summary
        crosses: dict[int, Cross | None] = {}
        for some in _simultaneous([list(chain(*block.values())) for block in blocks], range(len(replicates))):
            tallied = self._crosses(replicates[some[0]], [blocks[at] for at in some])
            crosses.update(zip(some, tallied, strict=True))
        return [
            self._summary(
                {name: source.cache[self.phase, self.layout.grids[name]] for name, source in sources.items()},
                crosses[at],
            )
            for at, sources in enumerate(replicates)
        ]

    def summarise_in_one_pass(self, sources: Mapping[str, Source]) -> PhaseSummary:
        """Summarise all sensors together, one block at a time."""
        phase, grids = self.phase, self.layout.grids
        known: dict[str, Summary] = {}
        if not self.recorded:
            places = {name: (phase, grids[name]) for name in sources}
            known = {name: sources[name].cache[at] for name, at in places.items() if at in sources[name].cache}
        tallies = {
            name: Tally(source.header, phase, grids[name], outliers=self.recorded)
            for name, source in sources.items()
            if name not in known
        }
        cross = self._cross_tally(sources, 1)
        waiting = {
            name: zip(source.blocks(phase.start_ns, phase.end_ns))
            for name, source in sources.items()
            if name in tallies or (cross is not None and name in cross.sensors)
        }
        for name, blocks in _interleave(waiting, phase):
            if blocks is not None and name in tallies:
                tallies[name].update(*blocks)
            if cross is not None and name in cross.sensors:
                cross.accept(name, blocks)
        new = {name: tally.result(self.reference.temperature) for name, tally in tallies.items()}
        for name, summary in () if self.recorded else new.items():
            sources[name].cache[phase, grids[name]] = summary
        sensors = {name: new[name] if name in new else known[name] for name in sources}
        return self._summary(sensors, None if cross is None else cross.result())

    def _summary(self, sensors: Mapping[str, Summary], cross: Cross | None) -> PhaseSummary:
        turned = None if is_at_rest(self.phase) else self.reference.turned
        ends_ns = (self.phase.start_ns, self.phase.end_ns)
        before, after = (None if turned is None else turned.up_in_movement(end_ns) for end_ns in ends_ns)
        ups_box = None if before is None or after is None else (before, after)
        return PhaseSummary(self.phase, self.number, self.layout, sensors, cross, ups_box)

    def _crosses(
        self, sources: Mapping[str, Source], blocks: Sequence[Mapping[str, Sequence[Block]]]
    ) -> Sequence[Cross | None]:
        """Return the joint moments of the inertial sensors in replicates whose blocks have the same times."""
        cross = self._cross_tally(sources, len(blocks))
        if cross is None:
            return [None] * len(blocks)
        waiting = {
            name: zip(*(block[name] for block in blocks), strict=True) for name in sources if name in cross.sensors
        }
        for name, several in _interleave(waiting, self.phase):
            cross.accept(name, several)
        return cross.results()

    def _cross_tally(self, sources: Mapping[str, Source], replicates: int) -> CrossTally | None:
        """Return the tally of the joint moments of the inertial sensors and, in motion, of a track; None if there are
        fewer than two of these.
        """
        there = [source for source in sources.values() if source.rows(self.phase.start_ns, self.phase.end_ns)]
        headers = [source.header for source in there if source.header.quantity in INERTIAL]
        moves = not is_at_rest(self.phase)
        track = self.reference.track if moves else None
        if len(headers) < 2 and not (headers and track):
            return None
        return CrossTally(
            headers, self.phase, self.layout.window_ns, replicates, changes=self.recorded or moves, track=track
        )


def _simultaneous(replicates: Sequence[Sequence[Block]], places: Iterable[int]) -> list[list[int]]:
    """Group the places of replicates whose blocks have the same times."""
    groups: list[list[int]] = []
    for at in places:
        blocks = replicates[at]
        for some in groups:
            others = replicates[some[0]]
            if len(blocks) == len(others) and all(map(_have_same_times, blocks, others)):
                some.append(at)
                break
        else:
            groups.append([at])
    return groups


def _have_same_times(first: Block, other: Block) -> bool:
    return np.array_equal(first.time, other.time)


def _interleave(
    blocks: Mapping[str, Iterator[tuple[Block, ...]]], phase: Phase
) -> Iterator[tuple[str, tuple[Block, ...] | None]]:
    """Yield the blocks of all sensors, and None after the last block of each. The sensor that is furthest behind in
    time comes next, so that few rows have to be kept.
    """
    waiting, reached = dict(blocks), dict.fromkeys(blocks, phase.start_ns)
    while waiting:
        name = min(waiting, key=reached.__getitem__)
        several = next(waiting[name], None)
        if several is None:
            del waiting[name]
        else:
            reached[name] = int(several[0].time[-1])
        yield name, several


def layout_of(sources: Mapping[str, Source], phase: Phase, unresolved: tuple[str, ...] = ()) -> Layout:
    """Return the layout of a phase, from the number of rows of each sensor and the quantities with `unresolved`
    changes, for which the windows are longer.
    """
    rows = {name: source.rows(phase.start_ns, phase.end_ns) for name, source in sources.items()}
    seconds = (phase.end_ns - phase.start_ns) * 1e-9
    rates = [rows[name] / seconds for name, source in sources.items() if source.header.quantity in INERTIAL]
    grids = {name: Grid.of(count) for name, count in rows.items()}
    known_rates = [rate for rate in rates if rate] or [1.0]
    return Layout(grids, window_ns(known_rates, is_resolved=not unresolved), unresolved)


def runs_in(logs: Sequence[LogSummary], sensor: str) -> Runs | None:
    """Return the runs of a sensor, each from the first phase at rest of a log; None if a log has no such phase of the
    sensor.
    """
    phases = [log.still(sensor)[:1] for log in logs]
    return runs_of([phase for (phase,) in phases]) if all(phases) else None
