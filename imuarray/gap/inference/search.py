"""All rounds of the search: sensor by sensor, families where they differ together, until nothing is left or found."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imuarray.gap.inference.assessment import MORE
from imuarray.gap.inference.comparison import Comparison
from imuarray.gap.inference.effects import Candidate, Hypothesis
from imuarray.gap.inference.evidence import Evidence, ScoredStatistics, evidence_of
from imuarray.gap.inference.forward_selection import Evaluation, Round, guesses_of, placebo_of, replicated, searched
from imuarray.gap.inference.parameters import distinct
from imuarray.gap.inference.shared_causes import (
    is_told_twice,
    members_of,
    shared_wins,
    staying_beside,
    together,
    unlike,
)
from imuarray.gap.inference.unit_state import Unit, UnitState, compared, reads_another
from imuarray.gap.model.replication import SensorModel
from imuarray.gap.model.workers import Run
from imuarray.gap.statistics.pairs import scorer_of
from imuarray.gap.statistics.split import Side
from imuarray.gap.statistics.synthetic_likelihood import independent_share, likelihood_of
from imuarray.log.format import SensorHeader

ROUNDS = 6
"""More causes than this of one unit are not told apart."""

_IN_TIME = frozenset({"motion_delay", "motion_residual"})
"""When a sensor follows a motion: no level, scale or code moves these, however many of the others say the same."""

_FAMILY_ROUNDS = 1
_FAINT = 3.0
"""Nats by which what several share is rarer where only one of them differs, or what they have in common doesn't."""

_OWN = 0.5


@dataclass(frozen=True)
class SearchResult:
    """What every round found for each unit, and the models with the causes in."""

    rounds: Mapping[Unit, Sequence[Round]]
    models: Mapping[str, SensorModel]


def searches(
    found: Comparison,
    candidates: Mapping[str, Candidate],
    run: Run,
    progress: Callable[[str], None] = lambda what: None,
    known: Collection[str] = (),
) -> SearchResult:
    """All causes of what was found. Of the sensors `known` it is known that they have one of the candidates' effects:
    only these are looked at, and what is found first needs no proof.
    """
    names = list(known) or [node.path[-1] for node in found.located.root.found("sensor")]
    standings = _standing(found, [(name,) for name in names], run)
    rounds: dict[Unit, list[Round]] = {}
    for number in range(ROUNDS):
        todo = {unit: one for unit, one in standings.items() if _is_open(found, one, rounds.get(unit, ()))}
        if not todo:
            break
        todo = _with_other_models(found, todo, standings, run)
        progress(f"looking for causes, round {number + 1}: {len(todo)} sensors")
        guessed = _guessed(found, todo, candidates)
        placebos = {unit: one.placebo for unit, one in guessed.items()} if number == 0 else {}
        trials = {unit: one.alone for unit, one in guessed.items()}
        came = searched(todo, trials, placebos, run, known=bool(known) and number == 0)
        for unit in _deferred(found, came):
            del came[unit]
        for unit, one in came.items():
            rounds.setdefault(unit, []).append(one)
            if one.taken is not None:
                standings[unit] = one.taken.standing
        if number < _FAMILY_ROUNDS:
            _families(found, guessed, run, rounds, standings, known=bool(known))
    models = dict(found.bench.models())
    for standing in standings.values():
        models.update(standing.models)
    return SearchResult(rounds, models)


def _deferred(found: Comparison, came: Mapping[Unit, Round]) -> list[Unit]:
    """Units that wait for the next round: what they gain lies in how they move beside others of their quantity, one of
    which gains more, or has taken what it shows alone. The odd one out makes all others look odd, and who had something
    else to say of itself first was not asked yet whether it is the one.
    """
    quantities = {unit: found.bench.base.headers[unit[0]].quantity for unit in came}
    return [
        unit
        for unit, one in came.items()
        if one.taken is not None
        and one.taken.own_share < _OWN
        and any(
            _worth(other.taken) > _worth(one.taken) or other.taken.own_share >= _OWN
            for beside, other in came.items()
            if beside != unit and other.taken is not None and quantities[beside] == quantities[unit]
        )
    ]


def _worth(taken: Evaluation) -> float:
    """Its gain, less what it is rarer than others."""
    return taken.gain - taken.trial.rarity


def _with_other_models(
    found: Comparison, units: Mapping[Unit, UnitState], standings: Mapping[Unit, UnitState], run: Run
) -> dict[Unit, UnitState]:
    """Where `units` stand beside the others' present models, where that makes a difference."""
    models = {name: model for one in standings.values() for name, model in one.models.items() if model.added}
    if not found.bench.is_of_motion.any() or not models:
        return dict(units)
    asked = [
        replace(one, other_models={name: model for name, model in models.items() if name not in one.unit})
        for one in units.values()
    ]
    changed = [one for one in asked if one.other_models != standings[one.unit].other_models]
    again = {
        one.unit: replace(made, likelihood=compared(one, made.values)[0])
        for one, made in zip(changed, run(replicated, changed), strict=True)
    }
    return {**units, **again}


def _families(
    found: Comparison,
    guessed: Mapping[Unit, _Guessed],
    run: Run,
    rounds: dict[Unit, list[Round]],
    standings: dict[Unit, UnitState],
    known: bool,
) -> None:
    """Shared causes in the place of those of the members, where they are better; the best first, and none for a sensor
    that has one already. Causes of members that gain more than their part of the shared one stay beside it, if
    they explain something else.
    """
    trials = _shared_trials(found, guessed)
    missing = {(name,) for family in trials for name in family if (name,) not in standings}
    standings.update(_standing(found, sorted(missing), run))
    families = dict(_standing(found, list(trials), run))
    placebos = {family: next(one.placebo for (name,), one in guessed.items() if name in family) for family in trials}
    came = searched(families, trials, placebos, run, known)
    taken = {name: own[-1].taken for (name, *more), own in rounds.items() if not more}
    members = {family: [one for name in family if (one := taken.get(name)) is not None] for family in trials}
    staying = {family: _staying(found, came[family], members[family]) for family in trials}
    several = {family: trials[family] for family in trials if staying[family]}
    asked = [(families[family], staying[family]) for family in several]
    families.update({one.standing.unit: one.standing for one in run(together, asked)})
    came.update(searched({family: families[family] for family in several}, several, placebos, run))
    kept = {family: {name for one in staying[family] for name in one.standing.unit} for family in trials}
    others = [
        (families[one], tuple(own for own in members[one] if not kept[one] & set(own.standing.unit))) for one in trials
    ]
    alone = dict(zip(trials, run(together, others), strict=True))
    counts = {one: len(own) for one, (_, own) in zip(trials, others, strict=True)}
    won = {one: best for one in trials if (best := shared_wins(came[one], alone[one], counts[one])) is not None}
    served: set[str] = set()
    for family in sorted(won, key=lambda one: -won[one].gain):
        if served & set(family):
            continue
        served |= set(family)
        for name in set(family) - kept[family]:
            rounds.pop((name,), None)
        rounds[family] = [came[family]]
        standings.update(members_of(found.bench, won[family].standing, standings))


def _staying(found: Comparison, family: Round, members: Sequence[Evaluation]) -> tuple[Evaluation, ...]:
    """The members' causes that are something else than the shared one."""
    likely = staying_beside(family, members)
    return tuple(one for one in likely if not is_told_twice(found.bench, family, one))


def _shared_trials(found: Comparison, guessed: Mapping[Unit, _Guessed]) -> dict[Unit, list[Hypothesis]]:
    """What sensors share, by the sensors concerned: those of a chip of which two or more differ and whose common
    statistics do, or whose levels change from one part to the other; or some of them that have something in common;
    or one and the other whose data it has; or all sensors. Where only one of a chip differs, or what they have in
    common doesn't by itself, the others may still have the same, too faint to be sure of: that is rarer.
    """
    odd = {
        key.sensor
        for key, score in zip(found.pairs.keys, found.judged.scores.tolist(), strict=True)
        if key.domain == "cross_sensor" and abs(score) > found.judged.limit
    }
    headers = found.bench.base.headers
    units: dict[Unit, list[Hypothesis]] = {}
    for (name,), one in guessed.items():
        family = tuple(sorted(other for (other,) in guessed if _is_alike(headers[other], headers[name])))
        of_chip = tuple(sorted(other for other in headers if _is_alike(headers[other], headers[name])))
        for trial in one.shared:
            if trial.everywhere:
                unit = tuple(sorted(headers))
            elif trial.members:  # what it has in common with the others of the chip goes into one mean
                chips = {headers[member].chip for member in trial.members}
                same = {other for other, header in headers.items() if header.quantity == headers[name].quantity}
                unit = tuple(sorted(other for other in same if headers[other].chip in chips))
            else:
                unit = tuple(sorted({trial.sensor, *trial.others})) if trial.sensor else family
            if trial.whole or trial.opposite or trial.everywhere or trial.members or (odd & set(unit)):
                chosen = trial
            elif trial.sensor:
                continue
            else:
                unit = unit if len(unit) > 1 else of_chip
                chosen = replace(trial, rarity=trial.rarity + _FAINT)
            if len(unit) > 1:
                units.setdefault(unit, []).append(chosen)
    return {unit: unlike(trials) for unit, trials in units.items()}


def _is_alike(one: SensorHeader, other: SensorHeader) -> bool:
    return (one.chip, one.quantity) == (other.chip, other.quantity)


def _standing(found: Comparison, units: Sequence[Unit], run: Run) -> dict[Unit, UnitState]:
    """Where units stand under the base model."""
    bare = [_bare(found, unit) for unit in units]
    return {one.unit: one for one in run(replicated, bare)}


def _bare(found: Comparison, unit: Unit) -> UnitState:
    """Without replicates to compare changes by."""
    bench, columns = found.bench, found.bench.own(unit)
    chance = found.chance[:, columns]
    likelihood = likelihood_of(chance, bench.resolutions[columns])
    scores = likelihood.scores(chance)
    in_time = np.array([bench.keys[at].probe in _IN_TIME for at in columns], bool)
    apart = np.where(in_time, independent_share(scores[:, in_time]), 0.0) if in_time.any() else None
    return UnitState(
        unit,
        {name: model for name, model in bench.models().items() if name in unit},
        found.real.values[columns],
        likelihood,
        np.zeros((0, len(columns))),
        {name: found.real.fitted[name] for name in unit},
        independent_share(scores),
        probes=np.unique([bench.keys[at].probe for at in columns], return_inverse=True)[1],
        scatter_group=np.unique(bench.scatter_group[columns], return_inverse=True)[1],
        apart=apart,
    )


def _is_open(found: Comparison, standing: UnitState, rounds: Sequence[Round]) -> bool:
    """Whether something is left to explain, and the last round found something."""
    if any(map(reads_another, standing.models.values())):
        return False
    if not rounds:
        return True
    if rounds[-1].taken is None:
        return False
    pairs = found.bench.pairs(found.bench.own(standing.unit))
    scores = scorer_of(pairs, standing.likelihood, standing.values)(standing.real)
    return bool(np.nanmax(np.abs(scores)) > MORE * found.located.limit)


class _Guessed(NamedTuple):
    """What may explain what a sensor shows: trials for it `alone`, those that are `shared` with others, its placebo."""

    alone: list[Hypothesis]
    shared: list[Hypothesis]
    placebo: Hypothesis


def _guessed(
    found: Comparison, standings: Mapping[Unit, UnitState], candidates: Mapping[str, Candidate]
) -> dict[Unit, _Guessed]:
    """By what each sensor shows on the training part; what is not seen there is looked for in both."""
    train, both = found.bench.split.train(found.campaign), found.bench.split.both(found.campaign)
    guessed = {}
    for unit, standing in standings.items():
        evidence = _evidence(found, train, standing, False)
        lasting = [one for one in guesses_of(evidence, candidates) if not one.needs_both]
        everything = guesses_of(_evidence(found, both, standing, True), candidates)
        known = {(one.name, one.when) for one in lasting if not one.shared}
        alone = [one for one in everything if not one.shared]
        late = [replace(one, whole=True) for one in alone if one.needs_both or (one.name, one.when) not in known]
        brief = [one for one in everything if one.shared and one.needs_both]
        own = [*(one for one in lasting if not one.shared), *late]
        guessed[unit] = _Guessed(
            distinct(one if one.when.is_in_both(found.bench.split) else replace(one, whole=True) for one in own),
            [*(one for one in lasting if one.shared), *brief],
            placebo_of(evidence),
        )
    return guessed


def _evidence(found: Comparison, side: Side, standing: UnitState, whole: bool) -> Evidence:
    """What a lone sensor shows, on the training part or on both; what it shares with others is as under the base."""
    bench, (name,) = found.bench, standing.unit
    every, mine = bench.columns(standing.unit, cross=True), bench.among(standing.unit, standing.unit)
    expected, scores = found.judged.likelihood.location[every], found.judged.parts[every]
    expected[mine], scores[mine] = standing.likelihood.location, standing.scores
    chosen = np.ones(len(every), bool) if whole else ~bench.held_out[every]
    keys = [bench.keys[at] for at in every[chosen]]
    parts = bench.held_out[every][chosen].tolist()
    logs = bench.logs[every][chosen].tolist()
    scored = ScoredStatistics(keys, parts, found.real.values[every][chosen], expected[chosen], scores[chosen], logs)
    model = standing.models[name]
    effects = (*(one for one in bench.base.effects(0)[name] if one.name not in model.removed), *model.added)
    return evidence_of(bench, side, name, scored, model, effects)
