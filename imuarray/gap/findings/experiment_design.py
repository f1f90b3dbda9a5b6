"""What to record next: of a menu of experiments the one that tells two causes apart which fit what was recorded alike.

Both models of one sensor are simulated on every experiment; what is expected of it are the nats by which a recording
of the one would be likelier under the one than under the other (Kullback and Leibler 1951), per hour of work.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.findings.diagnosis import Cause, Unobservable, Where
from imuarray.gap.inference.effects.candidate import Kind
from imuarray.gap.inference.forward_selection import Evaluation, Round
from imuarray.gap.inference.search import SearchResult
from imuarray.gap.model.bench import Bench, bench_of
from imuarray.gap.model.replication import Models, Stage
from imuarray.gap.model.workers import Run
from imuarray.gap.recording.recordings import Experiment
from imuarray.gap.recording.source import simulated_sources
from imuarray.gap.statistics.campaign import Layout, layout_of
from imuarray.gap.statistics.split import split_of
from imuarray.gap.statistics.synthetic_likelihood import FORM, FREEDOM, LARGEST_SCORE
from imuarray.log.format import Phase
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.still import Still, turn_on_run
from imuarray.simulate.motion.tumble import Tumble
from imuarray.simulate.record import phases_within
from imuarray.simulate.simulation import Plan, Simulation
from imuarray.simulate.timeline import Polled

LEAST = 3.0
"""Nats from which on an experiment tells two causes apart: 20 to 1."""

ENOUGH = 12.0
"""More nats are worth nothing."""

REPLICATES = 6
_FIRST = 4_000_000


@dataclass(frozen=True)
class Offer:
    """An experiment: what happens to the box in each of its logs, hours that it takes with all handling, and what to
    do, in words.
    """

    motions: tuple[Motion, ...] = field(repr=False)
    hours: float
    words: str


MENU: Mapping[Kind, Offer] = MappingProxyType(
    {
        "static": Offer((Still(seconds=1800.0),), 0.55, "a static log: at rest for 30 minutes"),
        "tumble": Offer((Tumble(60.0, 5.0),), 0.25, "a tumble: all six faces and the first again, 1 minute each"),
        "heating": Offer(
            (Heating(scale=0.3),), 0.65, "a heating: warmer by 20 degC, by 30 degC, and cool again, in half an hour"
        ),
        "turn-on": Offer(
            tuple(turn_on_run(run, 60.0) for run in range(1, 13)),
            0.4,
            "a turn-on series: 12 runs of 1 minute, switched off in between",
        ),
        "motion": Offer(
            (HandShake(still_s=20.0, motion_s=60.0),), 0.1, "a motion: shaken and turned about every axis for 1 minute"
        ),
    }
)
"""By kind. The hours are ours: the logs, 3 minutes to set up, 1 minute for every switching on, 15 for every heat."""

_MORE: Mapping[str, Kind] = MappingProxyType(
    {
        "level": "tumble",
        "spread": "static",
        "distribution": "static",
        "codes": "static",
        "spectrum": "static",
        "autocorrelation": "static",
        "allan": "static",
        "temperature": "heating",
        "force": "tumble",
        "motion": "motion",
        "cross_sensor": "heating",
        "run_to_run": "turn-on",
        "timing": "static",
        "status": "static",
    }
)
"""What shows more of a domain's statistics."""


class Rivals(NamedTuple):
    """Two causes of one unit, one of which was taken, and the share of its statistics that is independent."""

    sensors: tuple[str, ...]
    taken: Evaluation
    rival: Evaluation
    independent: float


def next_experiment(
    bench: Bench,
    searched: SearchResult,
    causes: Sequence[Cause],
    unexplained: Sequence[Where],
    unshown: Sequence[Unobservable],
    run: Run,
) -> str:
    """What to record next, in words: what tells the most probable cause from its rivals; else what shows more of what
    is unexplained (worst first), else of what can't be told.
    """
    rivals = rivals_of(searched, causes)
    if rivals is not None:
        return _told_apart(bench, rivals, run)
    if unexplained:
        worst = unexplained[0]
        place = f"{worst.sensor} {worst.axis}".rstrip()
        offer = MENU[_MORE[worst.domain]]
        return (
            f"Record {offer.words} ({_hours(offer.hours)}): it shows more of the {worst.domain.replace('_', ' ')} of"
            f" {place}, which is not explained."
        )
    if unshown:
        first = unshown[0]
        return f"To see {first.effect.replace('_', ' ')}, which nothing recorded shows: {first.record}."
    return "Nothing: what was recorded tells all causes of the library apart."


def rivals_of(searched: SearchResult, causes: Sequence[Cause]) -> Rivals | None:
    """The most probable cause that is confusable with another one that was tried in the same round."""
    for cause in causes:
        for unit, rounds in searched.rounds.items():
            for one in rounds if cause.confusable_with and set(unit) <= set(cause.sensors) else ():
                pair = _pair(cause, one)
                if pair is not None:
                    return Rivals(unit, *pair, one.before.independent)
    return None


def separations(bench: Bench, rivals: Rivals, run: Run) -> dict[Kind, float]:
    """Nats expected of each experiment of the menu, of the unit's first two sensors (or its only one)."""
    sides = [_models_of(bench, rivals, one.standing.models) for one in (rivals.taken, rivals.rival)]
    wanted = rivals.sensors[:2]
    benches = run(_laid_out, [_Wanted(kind, sides[0]) for kind in MENU])
    numbers = range(_FIRST, _FIRST + REPLICATES)
    values = run(_replicates, [_Asked(own, side, wanted, numbers) for own in benches for side in sides])
    found: dict[Kind, float] = {}
    for kind, own, first, second in zip(MENU, benches, values[::2], values[1::2], strict=True):
        found[kind] = nats_between(first, second, own.resolutions[own.columns(wanted, cross=True)], rivals.independent)
    return found


def nats_between(first: Floats, second: Floats, floor: Floats, independent: float) -> float:
    """Nats by which a recording of the one model is likelier under it than under the other, from replicates (r, n) of
    both with the same draws. `floor` (n,) is the least scatter that means anything, `independent` the share of the n
    statistics that is.

    Each statistic counts by the squared distance of the means over the scatter of single recordings, bounded by
    Student's t as in the search; what r replicates make of nothing is taken off.
    """
    there = [np.isfinite(side).all(axis=0) for side in (first, second)]
    known = there[0] & there[1]
    strange = (there[0] & ~np.isfinite(second).any(axis=0)) | (there[1] & ~np.isfinite(first).any(axis=0))
    apart = first[:, known] - second[:, known]
    distance = apart.mean(axis=0)
    scatter = (first[:, known].var(axis=0, ddof=1) + second[:, known].var(axis=0, ddof=1)) / 2
    least = np.maximum(floor[known], _ROUNDING * (1 + np.abs(first[:, known].mean(axis=0))))
    freedom = 2 * (len(first) - 1)
    chance = apart.var(axis=0, ddof=1) / len(first) * freedom / (freedom - 2)  # 1 over the scatter is so much too large
    square = (distance**2 - chance) / (np.maximum(scatter, least**2) + (FORM * distance) ** 2)
    bounded = np.sign(square) * np.log1p(np.abs(square) / FREEDOM)
    total = bounded.sum() + np.count_nonzero(strange) * math.log1p(LARGEST_SCORE**2 / FREEDOM)
    return max(independent * (FREEDOM + 1) / 2 * float(total), 0.0)


def _told_apart(bench: Bench, rivals: Rivals, run: Run) -> str:
    found = separations(bench, rivals, run)
    what = f"{rivals.taken.trial.name} from {rivals.rival.trial.name} of {rivals.sensors[0]}"
    ranked = sorted(found, key=lambda kind: -min(found[kind], ENOUGH) / MENU[kind].hours)
    good = [kind for kind in ranked if found[kind] >= LEAST]
    if not good:
        most = max(found, key=found.__getitem__)
        return (
            f"Nothing on the menu ({', '.join(MENU)}) tells {what}: at most {_nats(found[most])} expected, from"
            f" {MENU[most].words}."
        )
    best = good[0]
    other = "static" if best != "static" else ranked[ranked[0] == best]
    return (
        f"Record {MENU[best].words}. It tells {what} ({_nats(found[best])} expected in {_hours(MENU[best].hours)};"
        f" {other} {_nats(found[other])} in {_hours(MENU[other].hours)})."
    )


def _pair(cause: Cause, one: Round) -> tuple[Evaluation, Evaluation] | None:
    """The best trials of the cause and of what it is confusable with."""
    taken = next((trial for trial in one.confirmed if _is(trial, cause)), None)
    rival = next((trial for trial in one.confirmed if trial.trial.name in cause.confusable_with), None)
    return None if taken is None or rival is None else (taken, rival)


def _is(trial: Evaluation, cause: Cause) -> bool:
    return (trial.trial.name, trial.trial.action) == (cause.effect, cause.action)


def _models_of(bench: Bench, rivals: Rivals, models: Models) -> Models:
    """Of the unit's first two sensors, and of those whose data they have."""
    own = {name: models[name] for name in rivals.sensors[:2]}
    drawn = bench.base.effects(0)
    sources = {getattr(one, "sensor", "") for name, model in own.items() for one in (*drawn[name], *model.added)}
    return {**{name: model for name, model in bench.models().items() if name in sources}, **own}


class _Wanted(NamedTuple):
    kind: Kind
    models: Models


class _Asked(NamedTuple):
    bench: Bench
    models: Models
    sensors: tuple[str, ...]
    numbers: Sequence[int]


def _laid_out(bench: Bench, wanted: _Wanted) -> Bench:
    """The bench of an experiment, as if the first replicate had been recorded."""
    base = replace(
        bench.base,
        headers={name: bench.base.headers[name] for name in wanted.models},
        fitted={name: model.fitted for name, model in wanted.models.items()},
    )
    motions = MENU[wanted.kind].motions
    phases = [phases_within(motion.phases, round(motion.seconds * 1e9)) for motion in motions]
    split = split_of([wanted.kind] * len(motions), phases)
    experiments = [Experiment(_plan(bench, wanted.models, motion.seconds), motion) for motion in motions]
    kinds = (wanted.kind,) * len(motions)
    layouts = tuple(_layouts(*one) for one in zip(experiments, split.phases(), strict=True))
    stage = Stage(kinds, split, layouts, tuple(experiments), base)
    return bench_of(stage.simulated(wanted.models, _FIRST), split, experiments, base)


def _replicates(_: Bench, asked: _Asked) -> Floats:
    """(r, n) statistics of the sensors that matter."""
    campaigns = asked.bench.campaigns([(asked.models, number) for number in asked.numbers])
    return np.array([one.values for one in asked.bench.each_measured(campaigns, asked.sensors)])


def _plan(bench: Bench, names: Collection[str], seconds: float) -> Plan:
    """Each sensor read as often as it was, at even times."""
    rates = {
        name: line.rows_per_s
        for experiment in bench.experiments
        for name, (_, line) in experiment.plan.sensors.items()
        if name in names
    }
    lines = {name: Polled(math.ceil(seconds * rate), round(1e9 / rate)) for name, rate in rates.items()}
    sensors = {name: (bench.base.headers[name], line) for name, line in lines.items()}
    return Plan(sensors, next(iter(lines.values())))


def _layouts(experiment: Experiment, phases: Sequence[Phase]) -> tuple[Layout, ...]:
    """How finely its phases can be looked at."""
    sources = simulated_sources(Simulation(experiment.plan, experiment.motion, {}))
    return tuple(layout_of(sources, phase) for phase in phases)


def _hours(hours: float) -> str:
    return f"{hours:.2g} h"


def _nats(nats: float) -> str:
    return f"{nats:.0f} nats" if nats >= 9.95 else f"{nats:.1f} nats"


_ROUNDING = 1e-9
