"""The whole search: rounds over single sensors and over families that deviate together, until nothing remains or is
detected; and shared causes: one cause that several sensors of a chip share, against one cause for each of them.

Common errors show only between sensors, so a family is simulated as a whole and its statistics contain the correlations
of its members. The shared cause wins if it makes the data of all members likelier than their single causes do.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imuarray.gap.inference.assessment import MORE
from imuarray.gap.inference.comparison import Comparison
from imuarray.gap.inference.effects import Candidate, Hypothesis
from imuarray.gap.inference.evidence import Evidence, ScoredStatistics, evidence_of
from imuarray.gap.inference.forward_selection import (
    ACCEPTED,
    Evaluation,
    Round,
    confirm,
    gaining_of,
    guesses_of,
    look_in_turns,
    look_state,
    placebo_of,
    replicate_state,
    round_of_looks,
    search_round,
    with_replicates,
)
from imuarray.gap.inference.refinement import FittedHypothesis, distinct, look_again
from imuarray.gap.inference.unit_state import LOOKS, REPLICATES, Unit, UnitState, reads_another, update_likelihood
from imuarray.gap.model.base_model import fit
from imuarray.gap.model.bench import Bench
from imuarray.gap.model.replication import Models, SensorModel
from imuarray.gap.model.workers import Run
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.pairs import scorer_of
from imuarray.gap.statistics.split import Side
from imuarray.gap.statistics.synthetic_likelihood import independent_share, likelihood_of
from imuarray.log.format import SensorHeader
from imuarray.simulate.effects.bias import CommonMode

_MOST = 0.5
"""Share of a member's gain above which a shared cause explains it, so that the member's own cause is redundant."""

_RESPONSES = frozenset({"scale", "misalignment", "nonlinearity", "g_sensitivity", "size_effect", "axis_error"})
"""Effects on the response to motion and gravity, which no noise resembles."""

_EXACT = 0.05
"""Share of the gain of several fitted causes by which a shared cause without fitted parameters may be worse."""


def together(bench: Bench, request: tuple[UnitState, tuple[Evaluation, ...]]) -> Evaluation:
    """Return the evaluation of the family as a whole with the causes of members; without any it gains nothing."""
    family, members = request
    if not members:
        return Evaluation(FittedHypothesis(Hypothesis(()), family.models, 0.0), family, 0.0, 0.0)
    return confirm(bench, family, FittedHypothesis(members[0].trial, _with_causes(family, members), 0.0))


def look_together(bench: Bench, request: tuple[UnitState, tuple[Evaluation, ...]]) -> UnitState:
    """Return the state of the family with the causes of single members, with the few replicates that a look needs."""
    family, members = request
    if not members:
        return family
    state = look_state(bench, replace(family, models=_with_causes(family, members)))
    return replace(state, likelihood=update_likelihood(family, state.values)[0])


def _with_causes(family: UnitState, members: Sequence[Evaluation]) -> Models:
    """Return the models of the family with the causes of these members."""
    models = dict(family.models)
    for member in members:
        models.update({name: model for name, model in member.standing.models.items() if name in models})
    return models


def shared_wins(family: Round, members: Evaluation, count: int = 1) -> Evaluation | None:
    """Return the shared cause if it is accepted and, less its rarity, beats the `count` causes of the members, each of
    which must also be worth its acceptance.

    The held-out part has shown that there is a cause. Both parts decide whether it is one cause or several, since both
    hypotheses were fitted with the same number of parameters. A shared cause without parameters, such as an exchange of
    two sensors, may explain slightly less than causes that are fitted to each sensor: by chance it would not explain
    nearly as much.
    """
    best = family.selection
    if best is None:
        return None
    more = 2 * ACCEPTED * max(count - 1, 0) - best.trial.rarity
    if count > 1 and not best.factors:
        more += _EXACT * max(members.gain_of_both, 0.0)
    return best if best.gain_of_both + more > members.gain_of_both else None


def separate_causes(family: Round, members: Sequence[Evaluation]) -> tuple[Evaluation, ...]:
    """Return the causes of members, other than the shared one, that gain more than their part of the shared gain."""
    best = family.selection
    if best is None:
        return ()
    part = best.gain / len(best.standing.unit)
    return tuple(member for member in members if member.gain > part and member.trial.name != best.trial.name)


def is_redundant(bench: Bench, family: Round, member: Evaluation) -> bool:
    """Return whether the shared cause explains most of what a member's own cause explains.

    Of two sensors with a common wander, the one that shows it better gains nearly as much by a wander of its own. The
    next round searches for what the shared cause does not explain of the member.
    """
    if family.selection is None:
        return False
    columns, real = bench.among(member.standing.unit, family.selection.standing.unit), member.standing.real
    before, shared = (
        state.likelihood.of(columns).log_density(real) for state in (family.before, family.selection.standing)
    )
    gains = np.maximum(member.standing.likelihood.log_density(real) - before, 0.0)
    return bool(np.minimum(gains, np.maximum(shared - before, 0.0)).sum() > _MOST * gains.sum())


def responses(trials: Sequence[Hypothesis], members: Sequence[Evaluation]) -> tuple[Evaluation, ...]:
    """Return the causes of members that change their response to motion and gravity, if all shared trials are noise:
    noise does not resemble them, so shared effects are searched in addition to them.
    """
    if any(trial.name != CommonMode.name for trial in trials):
        return ()
    return tuple(member for member in members if {effect.name for effect in member.trial.effects} & _RESPONSES)


def members_of(bench: Bench, family: UnitState, standings: Mapping[Unit, UnitState]) -> dict[Unit, UnitState]:
    """Return the state of each member of a family with the family's models."""
    states: dict[Unit, UnitState] = {}
    for name in family.unit:
        unit: Unit = (name,)
        columns = bench.among(unit, family.unit)
        states[unit] = replace(
            standings[unit],
            models={name: family.models[name]},
            likelihood=family.likelihood.of(columns),
            values=family.values[:, columns],
        )
    return states


def without_duplicates(trials: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the trials, each once: several members suggest the same shared cause, and both sensors suggest an
    exchange.
    """
    return list({min(repr(trial), repr(_mirror(trial))): trial for trial in trials}.values())


def _mirror(trial: Hypothesis) -> Hypothesis:
    """Return the trial as the other sensor of an exchange suggests it."""
    if not trial.opposite or len(trial.others) != 1:
        return trial
    (other,) = trial.others
    return replace(
        trial,
        effects=trial.opposite,
        sensor=other,
        others=(trial.sensor,),
        opposite=trial.effects,
        fitted=trial.opposite_fitted,
        opposite_fitted=trial.fitted,
    )


ROUNDS = 6
"""Largest number of causes of one unit."""

_DELAY_PROBES = frozenset({"motion_delay", "motion_residual"})
"""Statistics of a sensor's delay: a level, scale or code does not change them, however dependent other statistics are.
"""

_THERMAL = frozenset({"thermal_bias", "thermal_lag", "thermal_scale"})
"""Effects whose guesses from both parts are tried as well: the temperatures of one half of a heating hardly determine
those of the other half.
"""

_OF_EXTREMES = frozenset({"saturation"})
"""Effects of the largest readings, likewise: one part may reach another end of the range than the other part."""

_FAMILY_ROUNDS = 1
"""Number of rounds in which shared causes are searched."""

_FAINT = 3.0
"""Nats by which a shared cause is rarer if only one sensor deviates, or if their common statistics do not."""

_OWN = 0.5


@dataclass(frozen=True)
class SearchResult:
    """The result of all rounds for each unit, and the models with the causes."""

    rounds: Mapping[Unit, Sequence[Round]]
    models: Mapping[str, SensorModel]


def search_causes(
    comparison: Comparison,
    candidates: Mapping[str, Candidate],
    run: Run,
    progress: Callable[[str], None] = lambda what: None,
    known: Collection[str] = (),
) -> SearchResult:
    """Search for all causes of a gap. If sensors are `known` to have one of the candidates' effects, only these are
    searched, and their first cause needs no proof.
    """
    names = list(known) or [node.path[-1] for node in comparison.localisation.root.significant("sensor")]
    standings = _states_of(comparison, [(name,) for name in names], run)
    rounds: dict[Unit, list[Round]] = {}
    for number in range(ROUNDS):
        todo = {unit: item for unit, item in standings.items() if _is_open(comparison, item, rounds.get(unit, ()))}
        if not todo:
            break
        todo = _with_other_models(comparison, todo, standings, run)
        progress(f"looking for causes, round {number + 1}: {len(todo)} sensors")
        guessed = _guesses_of(comparison, todo, candidates)
        placebos = {unit: item.placebo for unit, item in guessed.items()} if number == 0 else {}
        trials = {unit: item.alone for unit, item in guessed.items()}
        results = search_round(todo, trials, placebos, run, known=bool(known) and number == 0)
        for unit in _deferred(comparison, results):
            del results[unit]
        for unit, item in results.items():
            rounds.setdefault(unit, []).append(item)
            if item.selection is not None:
                standings[unit] = item.selection.standing
        if number < _FAMILY_ROUNDS:
            _families(comparison, guessed, run, rounds, standings, known=bool(known))
    models = dict(comparison.bench.models())
    for standing in standings.values():
        models.update(standing.models)
    return SearchResult(rounds, models)


def _deferred(comparison: Comparison, results: Mapping[Unit, Round]) -> list[Unit]:
    """Return the units that wait for the next round.

    Their gain comes from motion relative to others of their quantity, and one of these gains more, or has a cause in
    its own statistics. One deviating sensor makes all others appear to deviate, and a sensor with another cause has not
    been tested yet for being the deviating one.
    """
    quantities = {unit: comparison.bench.base.headers[unit[0]].quantity for unit in results}
    return [
        unit
        for unit, result in results.items()
        if result.selection is not None
        and result.selection.own_share < _OWN
        and any(
            _worth(other.selection) > _worth(result.selection) or other.selection.own_share >= _OWN
            for neighbour, other in results.items()
            if neighbour != unit and other.selection is not None and quantities[neighbour] == quantities[unit]
        )
    ]


def _worth(evaluation: Evaluation) -> float:
    """Return the mean gain of both parts, less the rarity. Rivals that explain one difference between sensors by
    parameters of their own are nearly equal, and one part of the data shows less than both.
    """
    return evaluation.gain_of_both / 2 - evaluation.trial.rarity


def _with_other_models(
    comparison: Comparison, units: Mapping[Unit, UnitState], standings: Mapping[Unit, UnitState], run: Run
) -> dict[Unit, UnitState]:
    """Return the `units` with the present models of the other sensors, if these affect their statistics."""
    models = {name: model for state in standings.values() for name, model in state.models.items() if model.added}
    if not comparison.bench.is_of_motion.any() or not models:
        return dict(units)
    requests = [
        replace(state, other_models={name: model for name, model in models.items() if name not in state.unit})
        for state in units.values()
    ]
    changed = [state for state in requests if state.other_models != standings[state.unit].other_models]
    again = {
        state.unit: replace(new_state, likelihood=update_likelihood(state, new_state.values)[0])
        for state, new_state in zip(changed, run(replicate_state, changed), strict=True)
    }
    return {**units, **again}


def _families(
    comparison: Comparison,
    guessed: Mapping[Unit, _Guesses],
    run: Run,
    rounds: dict[Unit, list[Round]],
    standings: dict[Unit, UnitState],
    known: bool,
) -> None:
    """Replace causes of members by shared causes if these are better, the best first, at most one for a sensor. Causes
    of members that gain more than their part of the shared gain are kept if they explain something else: the family is
    then searched with them in its models, from the beginning if they are of another kind (`responses`).
    """
    selections = {
        name: rounds_of_member[-1].selection for (name, *more), rounds_of_member in rounds.items() if not more
    }
    shared = _shared_trials(comparison, guessed)
    members = {
        family: [evaluation for name in family if (evaluation := selections.get(name)) is not None] for family in shared
    }
    placebos = {
        family: next(guesses.placebo for (name,), guesses in guessed.items() if name in family) for family in shared
    }
    families, results, staying = _search_families(comparison, shared, members, placebos, run, known)
    kept_sensors = {
        family: {name for evaluation in staying[family] for name in evaluation.standing.unit} for family in results
    }
    accepted = [family for family, result in results.items() if result.selection is not None]
    others = [
        (
            families[family],
            tuple(
                evaluation for evaluation in members[family] if not kept_sensors[family] & set(evaluation.standing.unit)
            ),
        )
        for family in accepted
    ]
    alone = dict(zip(accepted, run(together, others), strict=True))
    counts = {family: len(evaluations) for family, (_, evaluations) in zip(accepted, others, strict=True)}
    won = {
        family: best
        for family in accepted
        if (best := shared_wins(results[family], alone[family], counts[family])) is not None
    }
    missing = {(name,) for family in won for name in family if (name,) not in standings}
    standings.update(_states_of(comparison, sorted(missing), run))
    served: set[str] = set()
    for family in sorted(won, key=lambda family: -won[family].gain):
        if served & set(family):
            continue
        served |= set(family)
        for name in set(family) - kept_sensors[family]:
            rounds.pop((name,), None)
        rounds[family] = [results[family]]
        standings.update(members_of(comparison.bench, won[family].standing, standings))
    for unit in missing:  # sensors that do not deviate and have no part in a cause are not searched
        if unit[0] not in served:
            del standings[unit]


def _search_families(
    comparison: Comparison,
    shared: Mapping[Unit, Sequence[Hypothesis]],
    members: Mapping[Unit, Sequence[Evaluation]],
    placebos: Mapping[Unit, Hypothesis],
    run: Run,
    known: bool,
) -> tuple[dict[Unit, UnitState], dict[Unit, Round], dict[Unit, tuple[Evaluation, ...]]]:
    """Return the states and rounds of the families of which a `shared` trial gains, and the causes of members that stay
    in the models of each family. A family is searched again if some stay that were not there from the beginning.
    """
    staying = {family: responses(trials, members[family]) for family, trials in shared.items()}
    looks = _promising(comparison, shared, staying, run)
    families = dict(_states_of(comparison, list(looks), run))
    first = {family: staying[family] for family in looks if staying[family]}
    families.update(_states_together(families, first, run))
    seen = {
        family: [look_again(comparison.bench, families[family], look) for look in family_looks]
        for family, family_looks in looks.items()
    }
    rounds = round_of_looks({family: families[family] for family in seen}, seen, placebos, run, known)
    again = {
        family: causes
        for family in looks
        if family not in first and (causes := _staying(comparison, rounds[family], members[family]))
    }
    staying.update(again)
    families.update(_states_together(families, again, run))
    trials = {family: [look.trial for look in looks[family]] for family in again}
    rounds.update(search_round({family: families[family] for family in again}, trials, placebos, run))
    return families, rounds, staying


def _promising(
    comparison: Comparison,
    trials: Mapping[Unit, Sequence[Hypothesis]],
    causes: Mapping[Unit, tuple[Evaluation, ...]],
    run: Run,
) -> dict[Unit, Sequence[FittedHypothesis]]:
    """Return the looks at the shared trials of each family that gain in addition to the `causes` of members, without
    the families in which none gains.

    All are looked at first, which needs few replicates of a family's state. All replicates of a state that no trial
    improves would cost more than the looks.
    """
    bare = _states_of(comparison, list(trials), run, LOOKS).values()
    states = {state.unit: state for state in run(look_together, [(state, causes[state.unit]) for state in bare])}
    looks = look_in_turns(run, states, trials)
    gaining = {family: gaining_of(looks_of) for family, looks_of in looks.items()}
    return {family: several for family, several in gaining.items() if several}


def _states_together(
    families: Mapping[Unit, UnitState], causes: Mapping[Unit, tuple[Evaluation, ...]], run: Run
) -> dict[Unit, UnitState]:
    """Return the states of families with causes of their members."""
    evaluations = run(together, [(families[family], several) for family, several in causes.items()])
    return {evaluation.standing.unit: evaluation.standing for evaluation in evaluations}


def _staying(comparison: Comparison, family: Round, members: Sequence[Evaluation]) -> tuple[Evaluation, ...]:
    """Return the members' causes that differ from the shared one."""
    likely = separate_causes(family, members)
    return tuple(evaluation for evaluation in likely if not is_redundant(comparison.bench, family, evaluation))


def _shared_trials(comparison: Comparison, guessed: Mapping[Unit, _Guesses]) -> dict[Unit, list[Hypothesis]]:
    """Return the shared hypotheses by the sensors that they concern.

    These sensors are those of a chip of which two or more deviate, if their common statistics deviate too, or if their
    levels change from one part to the other; or some of them with something in common; or a sensor and the one whose
    data it has; or all sensors. If only one sensor of a chip deviates, or if their common statistics do not, the others
    may have the same cause, too faint to show; that is rarer.
    """
    odd = {
        key.sensor
        for key, score in zip(comparison.pairs.keys, comparison.assessment.normal.tolist(), strict=True)
        if key.domain == "cross_sensor" and abs(score) > comparison.assessment.limit
    }
    headers = comparison.bench.base.headers
    units: dict[Unit, list[Hypothesis]] = {}
    for (name,), guess in guessed.items():
        family = tuple(sorted(other for (other,) in guessed if _is_same_chip(headers[other], headers[name])))
        of_chip = tuple(sorted(other for other in headers if _is_same_chip(headers[other], headers[name])))
        for trial in guess.shared:
            if trial.everywhere:
                unit = tuple(sorted(headers))
            elif trial.members:  # its noise in common with the others of the chip enters a single mean
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
    return {unit: distinct(without_duplicates(trials)) for unit, trials in units.items()}


def _is_same_chip(first: SensorHeader, other: SensorHeader) -> bool:
    return (first.chip, first.quantity) == (other.chip, other.quantity)


def _states_of(
    comparison: Comparison, units: Sequence[Unit], run: Run, count: int = REPLICATES
) -> dict[Unit, UnitState]:
    """Return the states of units under the base model, with all replicates or with the `LOOKS` that a look needs.

    They are those of the comparison, unless these have other fits than the replicates of a unit alone: because other
    sensors determine the attitudes, or because they are compared with earlier recordings.
    """
    bench, bare = comparison.bench, [_initial_state(comparison, unit) for unit in units]
    known = comparison.replicates[:count]
    if len(known) < count or comparison.earlier is not None or bench.estimates_attitudes:
        states = run(replicate_state if count == REPLICATES else look_state, bare)
        return {state.unit: state for state in states}
    return {
        state.unit: with_replicates(
            bench, state, [replace(each, values=each.values[bench.own(state.unit)]) for each in known]
        )
        for state in bare
    }


def _initial_state(comparison: Comparison, unit: Unit) -> UnitState:
    """Return the state of a unit without replicates."""
    bench, columns = comparison.bench, comparison.bench.own(unit)
    chance = comparison.chance[:, columns]
    likelihood = likelihood_of(chance, bench.resolutions[columns])
    scores = likelihood.scores(chance)
    in_time = np.array([bench.keys[at].probe in _DELAY_PROBES for at in columns], bool)
    separate_share = np.where(in_time, independent_share(scores[:, in_time]), 0.0) if in_time.any() else None
    return UnitState(
        unit,
        {name: model for name, model in bench.models().items() if name in unit},
        comparison.real.values[columns],
        likelihood,
        np.zeros((0, len(columns))),
        {name: comparison.real.fitted[name] for name in unit},
        independent_share(scores),
        probes=np.unique([bench.keys[at].probe for at in columns], return_inverse=True)[1],
        scatter_group=np.unique(bench.scatter_group[columns], return_inverse=True)[1],
        separate_share=separate_share,
    )


def _is_open(comparison: Comparison, standing: UnitState, rounds: Sequence[Round]) -> bool:
    """Return whether something remains to be explained, and the last round selected a cause."""
    if any(map(reads_another, standing.models.values())):
        return False
    if not rounds:
        return True
    if rounds[-1].selection is None:
        return False
    pairs = comparison.bench.pairs(comparison.bench.own(standing.unit))
    scores = scorer_of(pairs, standing.likelihood, standing.values)(standing.real)
    scores = comparison.assessment.tails.normal(scores, pairs.keys)
    return bool(np.nanmax(np.abs(scores)) > MORE * comparison.localisation.limit)


class _Guesses(NamedTuple):
    """Hypotheses for a sensor: `alone`, `shared` with others, and its placebo."""

    alone: list[Hypothesis]
    shared: list[Hypothesis]
    placebo: Hypothesis


def _with_rarities(trials: Sequence[Hypothesis], of_both: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the trials from the training part with the rarities that both parts give the same effect at the same time,
    if these agree: the more segments, the clearer is the distribution of their levels.
    """
    rarities: dict[tuple[object, ...], set[float]] = {}
    for trial in of_both:
        rarities.setdefault((trial.name, trial.when, trial.shared), set()).add(trial.rarity)
    known = {key: min(values) for key, values in rarities.items() if len(values) == 1}
    return [replace(trial, rarity=known.get((trial.name, trial.when, trial.shared), trial.rarity)) for trial in trials]


def _guesses_of(
    comparison: Comparison, standings: Mapping[Unit, UnitState], candidates: Mapping[str, Candidate]
) -> dict[Unit, _Guesses]:
    """Return the hypotheses from the training part, and from both parts if the training part does not show them."""
    train, both = comparison.bench.split.train(comparison.campaign), comparison.bench.split.both(comparison.campaign)
    guessed = {}
    for unit, standing in standings.items():
        evidence = _evidence(comparison, train, standing, False)
        lasting = [trial for trial in guesses_of(evidence, candidates) if not trial.needs_both]
        everything = guesses_of(_evidence(comparison, both, standing, True), candidates)
        lasting = _with_rarities(lasting, everything)
        of_both = _OF_EXTREMES
        if any(phase.kind == "heating" for phase in evidence.phases):
            of_both |= _THERMAL
        known = {(trial.name, trial.when, trial.shared) for trial in lasting}
        late = [
            replace(trial, whole=True)
            for trial in everything
            if trial.needs_both or trial.name in of_both or (trial.name, trial.when, trial.shared) not in known
        ]
        every = [
            trial if trial.when.is_in_both(comparison.bench.split) else replace(trial, whole=True)
            for trial in (*lasting, *late)
        ]
        every = [
            replace(trial, shared=False) if trial.everywhere and _is_alone(comparison) else trial for trial in every
        ]
        alone, shared = (distinct(trial for trial in every if trial.shared == side) for side in (False, True))
        shared = [_with_fit_of_exchanged(comparison, train, trial) for trial in shared]
        guessed[unit] = _Guesses(alone, shared, placebo_of(evidence))
    return guessed


def _is_alone(comparison: Comparison) -> bool:
    """Return whether the array has one sensor: an effect of all sensors is then its own."""
    return len(comparison.bench.base.headers) == 1


def _with_fit_of_exchanged(comparison: Comparison, train: Side, trial: Hypothesis) -> Hypothesis:
    """Return an exchange of two sensors' data in whole logs with the ordinary parameters that each sensor has in its
    own data: slopes and filters were fitted to the other's data, and an offset belongs to its slope. Delays stay as
    guessed.
    """
    whole = {span.log for span in trial.when.spans if span.is_whole}
    partly = {span.log for span in trial.when.spans} - whole
    kept = [at for at, number in enumerate(train.logs) if number not in partly]
    if not whole or not trial.opposite or trial.fitted is None or trial.opposite_fitted is None or not kept:
        return trial
    bench, (other,) = comparison.bench, trial.others
    logs = [(train.logs[at], train.campaign.logs[at]) for at in kept]
    campaign = Campaign(tuple(log.exchanged(trial.sensor, other) if at in whole else log for at, log in logs))
    base = fit(
        campaign,
        [bench.motions[at] for at, _ in logs],
        model=bench.base.model,
        seed=bench.base.seed,
        vibrations=[bench.experiments[at].vibrations for at, _ in logs],
    )
    if not {trial.sensor, other} <= set(base.fitted):
        return trial
    own, opposite = (
        replace(base.fitted[name], delay=guess.delay)
        for name, guess in ((trial.sensor, trial.fitted), (other, trial.opposite_fitted))
    )
    return replace(trial, fitted=own, opposite_fitted=opposite)


def _evidence(comparison: Comparison, side: Side, standing: UnitState, whole: bool) -> Evidence:
    """Return the evidence of a single sensor in the training part or in both. Statistics that it shares with others are
    those under the base model.
    """
    bench, (name,) = comparison.bench, standing.unit
    every, mine = bench.columns(standing.unit, cross=True), bench.among(standing.unit, standing.unit)
    expected, scores = comparison.assessment.likelihood.location[every], comparison.assessment.parts[every]
    expected[mine], scores[mine] = standing.likelihood.location, standing.scores
    chosen = np.ones(len(every), bool) if whole else ~bench.held_out[every]
    keys = [bench.keys[at] for at in every[chosen]]
    parts = bench.held_out[every][chosen].tolist()
    logs = bench.logs[every][chosen].tolist()
    scored = ScoredStatistics(
        keys, parts, comparison.real.values[every][chosen], expected[chosen], scores[chosen], logs
    )
    model = standing.models[name]
    effects = (*(effect for effect in bench.base.effects(0)[name] if effect.name not in model.removed), *model.added)
    return evidence_of(bench, side, name, scored, model, effects)
