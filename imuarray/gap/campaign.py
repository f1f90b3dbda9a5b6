"""All logs of an array that are diagnosed together, recorded or simulated, summarised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from imuarray.characterise.stretch import FACE_NAMES, STILL_NAMES
from imuarray.gap.cross import Cross, CrossTally, window_ns
from imuarray.gap.runs import Runs, runs_of
from imuarray.gap.segments import Temperature
from imuarray.gap.source import Source
from imuarray.gap.summary import Grid, Summary, Tally
from imuarray.log.format import Phase
from imuarray.units import INERTIAL


@dataclass(frozen=True)
class Layout:
    """The grid of every sensor in a phase, and the common windows; simulations take those of the recorded phase."""

    grids: Mapping[str, Grid]
    window_ns: int


@dataclass(frozen=True)
class PhaseSummary:
    """One phase: its number in the log, a summary per sensor, and what inertial ones have in common (None: no two)."""

    phase: Phase
    number: int
    layout: Layout
    sensors: Mapping[str, Summary]
    cross: Cross | None

    @property
    def is_still(self) -> bool:
        """Whether the box is at rest in it, by its name."""
        return is_at_rest(self.phase)


@dataclass(frozen=True)
class LogSummary:
    """One log: what was done in it (`kind`: static, tumble, heating, turn-on, motion) and its phases in order."""

    kind: str
    phases: tuple[PhaseSummary, ...]

    def still(self, sensor: str) -> tuple[Summary, ...]:
        """The sensor's phases at rest."""
        return tuple(part.sensors[sensor] for part in self.phases if part.is_still and sensor in part.sensors)


@dataclass(frozen=True)
class Campaign:
    """Several logs of one array."""

    logs: tuple[LogSummary, ...]

    def series(self) -> dict[str, tuple[LogSummary, ...]]:
        """The logs by kind, of the kinds that there are several of."""
        kinds = dict.fromkeys(log.kind for log in self.logs)
        found = {kind: tuple(log for log in self.logs if log.kind == kind) for kind in kinds}
        return {kind: logs for kind, logs in found.items() if len(logs) > 1}


def is_at_rest(phase: Phase) -> bool:
    """Whether the box is at rest in a phase: it says which axis is up, or its name says it."""
    name = phase.name
    return bool(phase.up) or name in STILL_NAMES or name in FACE_NAMES or name.startswith(("run ", "pose "))


def summarise_log(
    kind: str,
    sources: Mapping[str, Source],
    phases: Sequence[Phase],
    temperature: Temperature,
    layouts: Sequence[Layout] | None = None,
) -> LogSummary:
    """Every triad in every phase, in one pass; `layouts`, one per phase, are those of the log to compare with."""
    found = [
        summarise_phase(sources, phase, number, temperature, None if layouts is None else layouts[number])
        for number, phase in enumerate(phases)
    ]
    return LogSummary(kind, tuple(found))


def summarise_phase(
    sources: Mapping[str, Source], phase: Phase, number: int, temperature: Temperature, layout: Layout | None = None
) -> PhaseSummary:
    """The sensors side by side: always the one that is furthest behind goes on, so that little has to be kept."""
    chosen = layout or layout_of(sources, phase)
    tallies = {name: Tally(source.header, phase, chosen.grids[name]) for name, source in sources.items()}
    cross = _cross(sources, phase, chosen.window_ns)
    waiting = {name: source.blocks(phase.start_ns, phase.end_ns) for name, source in sources.items()}
    reached = dict.fromkeys(sources, phase.start_ns)
    while waiting:
        name = min(waiting, key=reached.__getitem__)
        block = next(waiting[name], None)
        crossed = cross if cross is not None and name in cross.sensors else None
        if block is None:
            del waiting[name]
            if crossed is not None:
                crossed.end(name)
            continue
        reached[name] = int(block.time[-1])
        tallies[name].update(block)
        if crossed is not None:
            crossed.update(name, block)
    sensors = {name: tally.result(temperature) for name, tally in tallies.items()}
    return PhaseSummary(phase, number, chosen, sensors, None if cross is None else cross.result())


def layout_of(sources: Mapping[str, Source], phase: Phase) -> Layout:
    """How finely a phase can be looked at."""
    rows = {name: source.rows(phase.start_ns, phase.end_ns) for name, source in sources.items()}
    seconds = (phase.end_ns - phase.start_ns) * 1e-9
    rates = [rows[name] / seconds for name, source in sources.items() if source.header.quantity in INERTIAL]
    grids = {name: Grid.of(count) for name, count in rows.items()}
    return Layout(grids, window_ns([rate for rate in rates if rate] or [1.0]))


def runs_in(logs: Sequence[LogSummary], sensor: str) -> Runs | None:
    """A sensor's runs, each log's first phase at rest; None if it isn't in all of them."""
    phases = [log.still(sensor)[:1] for log in logs]
    return runs_of([phase for (phase,) in phases]) if all(phases) else None


def _cross(sources: Mapping[str, Source], phase: Phase, window: int) -> CrossTally | None:
    there = [source for source in sources.values() if source.rows(phase.start_ns, phase.end_ns)]
    headers = [source.header for source in there if source.header.quantity in INERTIAL]
    return CrossTally(headers, phase, window) if len(headers) > 1 else None
