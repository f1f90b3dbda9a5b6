"""Forward selection of causes: guesses of every candidate, the likely ones refined, the best judged on held-out data.

Every round treats each unit whose recording its models do not explain. Guesses are ranked by the training part. The
best few are refined on it (`refine`), and the best of these are simulated repeatedly and scored on the held-out part,
together with a placebo: a line at an arbitrary frequency, refined like the others. The best hypothesis that makes the
held-out part likelier, by more than the placebo and chance do, is added to the unit's models. The next round searches
for what is still missing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, TypeVar

import numpy as np

from imuarray.arrays import Floats, triple
from imuarray.gap.inference.effects import Candidate, Hypothesis
from imuarray.gap.inference.evidence import NATS_PER_NUMBER, Evidence, When, in_logs, join_spans, since, views
from imuarray.gap.inference.refinement import (
    WORTH,
    FittedHypothesis,
    active_axes,
    distinct,
    factors_of,
    looks,
    refine,
    without,
)
from imuarray.gap.inference.unit_state import (
    LOOKS,
    NUMBERS,
    Unit,
    UnitState,
    affected_mask,
    gains_of,
    update_likelihood,
)
from imuarray.gap.model.bench import Bench, StatisticValues
from imuarray.gap.model.replication import TOGETHER, Models
from imuarray.gap.model.workers import Run
from imuarray.gap.statistics.synthetic_likelihood import SyntheticLikelihood, independent_share
from imuarray.simulate.effects.bias import Bias, PopcornNoise
from imuarray.simulate.effects.noise import Tone

Item = TypeVar("Item")

REFINED, CONFIRMED = 4, 3
"""Largest number of trials of a unit that are refined, and that are confirmed, in a round."""

_OF_FORM, _OF_EFFECT = 2, 2
"""Largest number of trials of one form that are refined or confirmed; and of one effect, while there are others."""

_CONFIRMED_TOGETHER = 2
"""Number of trials of a unit that one job confirms: they share draws and the other sensors, and two processes are
busy.
"""

ACCEPTED = 3.0
"""Gain in nats of a cause on the held-out part, beyond the placebo's, from which on it is accepted: odds of 20 to 1."""

_BEYOND_PLACEBOS = 30.0
"""Gain in nats, beyond `ACCEPTED`, that no placebo reaches: a cause that gains more needs no comparison with one."""

COST = 1.0
"""Cost in nats of each free parameter: of two trials that explain the same, the simpler one is the cause (Akaike 1974).
"""

_MOST_BEHIND = 15.0
"""Nats by which the gain of a guess that is refined or confirmed may be less than the best gain; or half of that
gain, if that is more.
"""

_TIME_VARYING = frozenset(
    {"turn_on_bias", "bistable_bias", "bias_instability", "random_walk", "popcorn_noise", "thermal_bias", "thermal_lag"}
)
"""Effects that change in time by themselves: a stronger effect in a spell than in the rest is then not a difference."""

_WANDERS = frozenset({"bias_instability", "random_walk"})
"""Effects that make a bias wander slowly."""

_AS_SLOW = 2.0
"""Ratio of two time constants below which a process of one of them shows in much the same statistics as the other."""

_DIVIDED, _LOST = 3, 2.0
"""Most trials of a unit that are tried in some logs alone, and the nats that the other logs must lose by a trial."""

_NARROWINGS, _MOMENTS = 4, 6
"""Number of times that the beginning of a trial is narrowed down, and of moments tried each time: to 1/150 of a motion.
"""

_SAME_GAIN = 0.1
"""Difference in nats up to which two beginnings explain the same, as those in a motion that is not compared."""

BRIEF = 4.0
"""Cost in nats, to the mean of both parts, of the choice of a moment. The cost to their sum is twice this, the log of
thousands of moments.
"""

_INDIFFERENT = 0.1
"""Nats that a held-out part may lose by a cause that it does not show."""

_OUTDONE, _FAR_LESS = 10.0, 0.5
"""Cost in nats of a trial if another one gains as much and leaves less than this share of its squared scores."""

_FAINT, _NOWHERE = 0.05, (math.sqrt(5) - 1) / 4
"""Amplitude of the placebo relative to the noise, and its frequency relative to the rate of rows: not a simple
fraction.
"""


@dataclass(frozen=True)
class Evaluation:
    """Evaluation of a refined trial: the state of the unit with it, and its gain in nats on the training part and on
    the held-out part (for a trial that needs both parts, the mean of both).

    `own_share` is the share of the gain that the unit's own statistics contribute, as opposed to its motion relative to
    others. `independent` is the independent share of the statistics that the trial changes, with the trial in the
    model: a slow drift changes many of them together. `squared_scores` is the sum of squared scores of the held-out
    part with the trial (`scores_by_wider`); `closes` is true if the trial does not increase it.
    """

    hypothesis: FittedHypothesis
    standing: UnitState
    train_gain: float
    gain: float
    own_share: float = 1.0
    independent: float = 1.0
    closes: bool = True
    squared_scores: float = 0.0

    @property
    def factors(self) -> int:
        """The number of fitted parameters."""
        return len(factors_of(self.hypothesis.trial))

    @property
    def gain_of_both(self) -> float:
        """Gain in nats on both parts together; for a trial that needs both, less the cost of the choice of a moment."""
        return 2 * self.gain if self.trial.needs_both else self.train_gain + self.gain

    @property
    def trial(self) -> Hypothesis:
        """The hypothesis that was evaluated."""
        return self.hypothesis.trial


@dataclass(frozen=True)
class Round:
    """The result of one round for a unit in the state `before`: all confirmed trials, the likeliest first, the
    placebo's gain (0 without a placebo), and the selected trial (None: none).
    """

    before: UnitState
    confirmed: tuple[Evaluation, ...]
    placebo_gain: float
    selection: Evaluation | None

    @property
    def log_odds(self) -> tuple[float, ...]:
        """Log odds of each confirmed trial against no change: its gain, tempered by the independence of the statistics
        of the trial that gains most, less the cost of its parameters.
        """
        return _log_odds(self.before, self.confirmed)


def guesses_of(evidence: Evidence, candidates: Mapping[str, Candidate]) -> list[Hypothesis]:
    """Return all trials that one sensor's evidence suggests, from all logs and from parts of them, without
    duplicates.
    """
    return distinct(
        trial if not part.when.spans else trial.at(part.when)
        for part in views(evidence)
        for candidate in candidates.values()
        for trial in candidate.guesses(part)
        if not part.when.spans or not (trial.removed or trial.needs_both or trial.shared or trial.name in _TIME_VARYING)
    )


def placebo_of(evidence: Evidence) -> Hypothesis:
    """Return a weak line at a frequency without a detected line, with the free parameters of a real line."""
    return Hypothesis((Tone(triple(_FAINT * evidence.noise), _NOWHERE * evidence.rows_per_s),), ("amplitude",))


def search_round(
    standings: Mapping[Unit, UnitState],
    trials: Mapping[Unit, Sequence[Hypothesis]],
    placebos: Mapping[Unit, Hypothesis],
    run: Run,
    known: bool = False,
) -> dict[Unit, Round]:
    """Perform one round over all units at once. If it is `known` that one of the trials is right, no proof is
    needed.
    """
    return round_of_looks(standings, look_in_turns(run, standings, trials), placebos, run, known)


def round_of_looks(
    standings: Mapping[Unit, UnitState],
    looks: Mapping[Unit, Sequence[FittedHypothesis]],
    placebos: Mapping[Unit, Hypothesis],
    run: Run,
    known: bool = False,
) -> dict[Unit, Round]:
    """Perform one round, as `search_round` does, with looks at all trials."""
    seen = {unit: list(unit_looks) for unit, unit_looks in looks.items()}
    for unit, looks_at_parts in _partly(run, standings, seen).items():
        seen[unit] += looks_at_parts
    for unit, narrowed in _narrow(run, standings, seen).items():
        seen[unit] += narrowed
    likely = {unit: likeliest(unit_looks, REFINED) for unit, unit_looks in seen.items()}
    refined = _results_of(run, _refine, standings, likely)
    best = {unit: likeliest(hypotheses, CONFIRMED) for unit, hypotheses in refined.items()}
    confirmed = _confirm_all(run, standings, best)
    needed = {
        unit: [FittedHypothesis(placebos[unit])]
        for unit, evaluations in confirmed.items()
        if evaluations and unit in placebos and _needs_placebo(standings[unit], evaluations)
    }
    fakes = _confirm_all(run, standings, _results_of(run, _refine, standings, needed))
    return {
        unit: _round(standings[unit], [*evaluations, *fakes.get(unit, ())], bool(fakes.get(unit)), known)
        for unit, evaluations in confirmed.items()
    }


def _needs_placebo(standing: UnitState, evaluations: Sequence[Evaluation]) -> bool:
    """Return whether a placebo may change the selection, or what is reported of a sensor without a cause.

    It raises the gain that a cause needs: it is not needed if no trial of a family gains enough, or if the selected
    trial gains far more than any placebo.
    """
    selection = _round(standing, evaluations, False).selection
    if selection is None:
        return len(standing.unit) == 1
    return _counted_gain(standing, selection) < ACCEPTED + _BEYOND_PLACEBOS


def likeliest(trials: Iterable[FittedHypothesis], count: int) -> list[FittedHypothesis]:
    """Return the best trials that gain enough and are not far behind, at most two of each form; a third of one effect,
    such as a slow wander in other logs, only if no other effect needs its place.

    The best trial of another form than the first one's is always included, because a guess of a wrong form may fit the
    training part best.

    Gains on the training part alone and on both parts cannot be compared: if the `count` best are all of one kind, the
    best of the other kind is added.
    """
    several = [trial for trial in trials if trial.models is not None]
    likely = _likeliest(several, count)
    kinds = {trial.trial.needs_both for trial in likely}
    for needs_both in {True, False} - kinds if kinds else ():
        likely += _likeliest([trial for trial in several if trial.trial.needs_both == needs_both], 1)
    return likely


def _likeliest(trials: Sequence[FittedHypothesis], count: int) -> list[FittedHypothesis]:
    ranked = sorted(trials, key=lambda trial: -trial.gain)
    ranked = [trial for trial in ranked if trial.gain * trial.counts > WORTH]
    least = ranked[0].gain - max(_MOST_BEHIND, ranked[0].gain / 2) if ranked else 0.0
    likely: list[FittedHypothesis] = []
    for most_of_effect in (_OF_EFFECT, count):
        for trial in ranked:
            same_form = sum(other.trial.form == trial.trial.form for other in likely)
            of_effect = sum(other.trial.name == trial.trial.name for other in likely)
            is_rival = not same_form and all(other.trial.form == ranked[0].trial.form for other in likely)
            is_good = (trial.gain > least or is_rival) and same_form < _OF_FORM and of_effect < most_of_effect
            if is_good and len(likely) < count and not any(trial is other for other in likely):
                likely.append(trial)
    return sorted(likely, key=lambda trial: -trial.gain)


def replicates_of(bench: Bench, standing: UnitState, numbers: Sequence[int]) -> list[StatisticValues]:
    """Return the unit's statistics in replicates of its models, without those that a single sensor shares with
    others.
    """
    (replicates,) = replicates_of_each(bench, standing, [standing.models], numbers)
    return replicates


def replicates_of_each(
    bench: Bench, standing: UnitState, several: Sequence[Models], numbers: Sequence[int]
) -> list[list[StatisticValues]]:
    """Return, for each of several models of the unit, what `replicates_of` returns. A few numbers of all models are
    simulated together, since models share the draws of a number and the other sensors.
    """
    together = max(TOGETHER // len(several), 1)
    columns = bench.among(standing.unit, standing.unit)
    replicates: list[list[StatisticValues]] = [[] for _ in several]
    for first in range(0, len(numbers), together):
        requests = [(models, number) for number in numbers[first : first + together] for models in several]
        values = bench.replicates(requests, other_models=standing.other_models)
        for at, replicate in enumerate(values):
            replicates[at % len(several)].append(replace(replicate, values=replicate.values[columns]))
    return replicates


def replicate_state(bench: Bench, standing: UnitState) -> UnitState:
    """Return the state with replicates of its models, and the misfit of their noise."""
    return with_replicates(bench, standing, replicates_of(bench, standing, NUMBERS))


def with_replicates(bench: Bench, standing: UnitState, replicates: Sequence[StatisticValues]) -> UnitState:
    """Return the state with these replicates of its models, which have the unit's statistics only."""
    misfit = standing.misfit_of(bench.base.headers, [replicate.fitted for replicate in replicates])
    return replace(standing, values=np.array([replicate.values for replicate in replicates]), misfit=misfit)


def look_state(bench: Bench, standing: UnitState) -> UnitState:
    """Return the state with the few replicates of its models that a look at a trial needs."""
    replicates = replicates_of(bench, standing, NUMBERS[:LOOKS])
    return replace(standing, values=np.array([replicate.values for replicate in replicates]))


def confirm(bench: Bench, standing: UnitState, hypothesis: FittedHypothesis) -> Evaluation:
    """Return the gains of a trial with its parameters, by replicates of both parts."""
    (evaluation,) = confirm_each(bench, standing, [hypothesis])
    return evaluation


def confirm_each(bench: Bench, standing: UnitState, hypotheses: Sequence[FittedHypothesis]) -> list[Evaluation]:
    """Return what `confirm` returns for each of several hypotheses; faster than single calls."""
    several = [standing.models if hypothesis.models is None else hypothesis.models for hypothesis in hypotheses]
    replicated = replicates_of_each(bench, standing, several, NUMBERS)
    return [
        _evaluate(bench, standing, hypothesis, with_replicates(bench, replace(standing, models=models), replicates))
        for hypothesis, models, replicates in zip(hypotheses, several, replicated, strict=True)
    ]


def _evaluate(bench: Bench, standing: UnitState, hypothesis: FittedHypothesis, changed: UnitState) -> Evaluation:
    """Return the gains of a trial by the replicates of the state `changed` by it."""
    values, misfit = changed.values, changed.misfit - standing.misfit
    likelihood, shift = update_likelihood(standing, values)
    columns, before = bench.own(standing.unit), standing.likelihood
    out = bench.held_out[columns]
    gains = gains_of(standing, likelihood, shift)
    train_gain, gain = (float(gains[part].sum()) - misfit for part in (~out, out))
    share = float(gains[~bench.is_of_motion[columns]].sum()) / max(float(gains.sum()), 1e-9)
    touched = affected_mask(before, likelihood, shift)
    independent = independent_share(likelihood.scores(values)[:, touched]) if touched.any() else standing.independent
    state = replace(changed, likelihood=likelihood)
    if independent > standing.independent and min(train_gain, gain) > WORTH:
        hypothesis = replace(hypothesis, trial=_shown_by_each_part(hypothesis.trial))
    if hypothesis.trial.needs_both:
        gain = (train_gain + gain) / 2 - BRIEF
    counted = np.ones_like(out) if hypothesis.trial.needs_both else out
    squared_scores = _squares(scores_by_wider(before, likelihood, standing.real)[counted])
    closes = squared_scores <= _squares(standing.scores[counted])
    return Evaluation(hypothesis, state, train_gain, gain, share, independent, closes, squared_scores)


def _shown_by_each_part(trial: Hypothesis) -> Hypothesis:
    """Return a trial that each part shows by itself: if its events recur in both, it does not need both. What the
    choice of their moments costs is part of its rarity.
    """
    return replace(trial, whole=False, rarity=trial.rarity + 2 * BRIEF) if trial.whole else trial


def look_in_turns(
    run: Run, standings: Mapping[Unit, UnitState], trials: Mapping[Unit, Sequence[Hypothesis]]
) -> dict[Unit, list[FittedHypothesis]]:
    """Return a look at all trials, without those that cannot gain because none of their `precursors` gains."""
    before = {unit: precursors(several) for unit, several in trials.items()}
    seen: dict[Unit, dict[int, FittedHypothesis]] = {unit: {} for unit in trials}
    waiting = {unit: list(range(len(several))) for unit, several in trials.items()}
    while any(waiting.values()):
        ready = {
            unit: [at for at in places if not set(before[unit][at]) & set(places)] for unit, places in waiting.items()
        }
        due = {
            unit: [
                at
                for at in places
                if not before[unit][at] or _any_gains(seen[unit], before[unit][at], trials[unit][at].when)
            ]
            for unit, places in ready.items()
        }
        looks = _look_at_all(
            run, standings, {unit: [trials[unit][at] for at in places] for unit, places in due.items()}
        )
        for unit, places in due.items():
            seen[unit].update(zip(places, looks[unit], strict=True))
            waiting[unit] = [at for at in waiting[unit] if at not in ready[unit]]
    return {unit: [looks_at[at] for at in sorted(looks_at)] for unit, looks_at in seen.items()}


def _any_gains(looks: Mapping[int, FittedHypothesis], places: Sequence[int], when: When) -> bool:
    """Return whether any of the trials at these places that were looked at gains in the spans `when` of another
    trial.
    """
    return any(at in looks and _gains(looks[at], {span.log for span in when.spans}) for at in places)


def _gains(look: FittedHypothesis, logs: Collection[int]) -> bool:
    """Return whether a trial gains: in one of these `logs`, if it is shared, acts in other logs too and shows in these;
    otherwise in all logs together, or in one of them if a part of the logs may have the effect (`_is_divisible`).
    """
    by_log = look.by_log if look.trial.shared and _is_divisible(look.trial) else {}
    shown = [by_log[log] for log in logs if by_log.get(log)]
    return (
        max(shown) > NATS_PER_NUMBER if shown else look.gain > 0 or max(by_log.values(), default=0.0) > NATS_PER_NUMBER
    )


def precursors(trials: Sequence[Hypothesis]) -> list[list[int]]:
    """Return, for each trial, the places of its precursors: it can gain only if one of them gains.

    For an effect on several axes, the precursors are the same effect on some of these axes: guesses are made for the
    axes that show it, and for all. For telegraph noise, whose autocovariance is that of Gauss-Markov noise, they are
    all slow wanders. For an effect that sensors share for a while, they are the effect that they always share, of any
    size and of about the same time constant if there is one: it gains in the logs that contain the while. An effect
    without a size, as another sensor's readings, has no precursor: what it explains in a part of a log may cost more in
    the rest.
    """
    wanders = [at for at, trial in enumerate(trials) if trial.name in _WANDERS and not trial.needs_both]
    narrower: list[list[int]] = [
        [at for at, other in enumerate(trials) if _is_narrower(other, trial)] for trial in trials
    ]
    first = [at for at in wanders if not narrower[at]]
    lasting = [at for at, trial in enumerate(trials) if trial.shared and not trial.when.spans and not narrower[at]]

    def others(trial: Hypothesis) -> list[int]:
        if trial.shared and trial.when.spans and trial.free:
            same = [at for at in lasting if _is_same_in_time(trials[at], trial)]
            return [at for at in same if _is_as_slow(trials[at], trial)] or same
        return first if trial.name == PopcornNoise.name and not trial.needs_both else []

    return [before or others(trial) for trial, before in zip(trials, narrower, strict=True)]


def _is_same_in_time(trial: Hypothesis, other: Hypothesis) -> bool:
    """Return whether two trials have the same form and concern the same sensors."""
    same = (trial.form, trial.sensor, trial.others, trial.members, trial.everywhere)
    return same == (other.form, other.sensor, other.others, other.members, other.everywhere)


def _is_as_slow(trial: Hypothesis, other: Hypothesis) -> bool:
    """Return whether the time constants of two trials of one form, if they have any, are about the same."""
    times_s = [
        [getattr(effect, "time_constant_s", 1.0) for effect in several] for several in (trial.effects, other.effects)
    ]
    return all(max(first / second, second / first) < _AS_SLOW for first, second in zip(*times_s, strict=False))


def _is_narrower(trial: Hypothesis, other: Hypothesis) -> bool:
    """Return whether a trial is the same as another one on fewer axes."""
    if trial.form != other.form or len(trial.effects) != len(other.effects):
        return False
    fewer, more = set(active_axes(trial)), set(active_axes(other))
    if not fewer or not fewer < more:
        return False
    effects = tuple(without(effect, more - fewer) for effect in other.effects)
    return replace(other, effects=effects) == trial


def _look_at_all(
    run: Run, standings: Mapping[Unit, UnitState], trials: Mapping[Unit, Sequence[Hypothesis]]
) -> dict[Unit, list[FittedHypothesis]]:
    """Return a look at all trials, a few trials of a unit in each job."""
    parts = {unit: _parts(unit_trials, TOGETHER) for unit, unit_trials in trials.items()}
    looks = _results_of(run, look_at, standings, parts)
    return {unit: list(chain.from_iterable(unit_looks)) for unit, unit_looks in looks.items()}


def _partly(
    run: Run, standings: Mapping[Unit, UnitState], looks: Mapping[Unit, Sequence[FittedHypothesis]]
) -> dict[Unit, list[FittedHypothesis]]:
    """Return looks at trials in parts of the campaign.

    A trial that explains some logs and makes others less likely is tried in only the logs, or the parts of logs, that
    it explains. A trial in a part of a log that lasts to its end is tried in the later logs too. Both parts of the
    campaign determine these logs.
    """
    divided = {
        unit: [replace(look.trial, whole=True) for look in _divided(unit_looks)] for unit, unit_looks in looks.items()
    }
    divided = {unit: hypotheses for unit, hypotheses in divided.items() if hypotheses}
    alone = _look_at_all(run, standings, divided) if divided else {}
    requests: dict[Unit, list[Hypothesis]] = {}
    for unit, unit_looks in looks.items():
        spells = [look for look in unit_looks if look.trial.when.spans and look.gain > 0]
        several = [*_where_it_gains(alone.get(unit, ()), spells), *_until_the_end(spells)]
        if several:
            requests[unit] = [replace(trial, whole=True) for trial in distinct(several)]
    return _look_at_all(run, standings, requests) if requests else {}


def _narrow(
    run: Run, standings: Mapping[Unit, UnitState], looks: Mapping[Unit, Sequence[FittedHypothesis]]
) -> dict[Unit, list[FittedHypothesis]]:
    """Return the best trial of each unit and effect whose beginning lies between known moments, as in a motion, with
    the beginning that explains most; of moments that explain the same, the middle one. A trial that gains no more by
    another beginning is left out.
    """
    best: dict[Unit, list[FittedHypothesis]] = {}
    before: dict[Unit, dict[str, float]] = {}
    for unit, unit_looks in looks.items():
        several = [look for look in unit_looks if look.trial.begin_bounds_s is not None and look.gain > WORTH]
        if several:
            best[unit] = _best_of_effects(several)
            before[unit] = {look.trial.name: look.gain for look in best[unit]}
    for _ in range(_NARROWINGS if best else 0):
        requests: dict[Unit, list[Hypothesis]] = {unit: [] for unit in best}
        for unit, unit_looks in best.items():
            for trial in (look.trial for look in unit_looks):
                if trial.begin_bounds_s is not None:
                    moments_s = np.linspace(*trial.begin_bounds_s, _MOMENTS + 2).tolist()
                    requests[unit] += [trial.narrowed(moments_s, at) for at in range(1, _MOMENTS + 1)]
        best = {
            unit: _best_of_effects(unit_looks, _SAME_GAIN)
            for unit, unit_looks in _look_at_all(run, standings, requests).items()
        }
    return {
        unit: [look for look in unit_looks if look.gain > before[unit][look.trial.name] + _SAME_GAIN]
        for unit, unit_looks in best.items()
    }


def _best_of_effects(looks: Iterable[FittedHypothesis], same: float = 0.0) -> list[FittedHypothesis]:
    """Return, for each effect, the look that gains most; the middle one of several that gain the `same` nats."""
    of_effect: dict[str, list[FittedHypothesis]] = {}
    for look in looks:
        of_effect.setdefault(look.trial.name, []).append(look)
    best: list[FittedHypothesis] = []
    for several in of_effect.values():
        most = max(look.gain for look in several)
        equal = [look for look in several if look.gain >= most - same]
        best.append(equal[(len(equal) - 1) // 2])
    return best


def _where_it_gains(looks: Sequence[FittedHypothesis], spells: Sequence[FittedHypothesis]) -> Iterator[Hypothesis]:
    """Yield each trial in the logs that it explains; in a spell, if a spell of the same effect explains the log
    better. A bias that a later log lacks is not divided: it is that of a state after power-on.
    """
    for look in looks:
        if look.trial.name == Bias.name and _returns(look.by_log):
            continue
        best = {log: (gain, in_logs([log])) for log, gain in look.by_log.items() if gain > NATS_PER_NUMBER}
        for spell in spells:
            log = spell.trial.when.spans[0].log
            gain = spell.by_log.get(log, 0.0)
            if spell.trial.form == look.trial.form and gain > best.get(log, (NATS_PER_NUMBER, None))[0]:
                best[log] = (gain, spell.trial.when)
        when = join_spans(part for _, part in best.values())
        if when.spans and {span.log for span in when.spans if span.is_whole} != set(look.by_log):
            yield look.trial.at(when)


def _returns(gain_of_log: Mapping[int, float]) -> bool:
    """Return whether a log after one that gains loses by the same change."""
    gaining = [log for log, gain in gain_of_log.items() if gain > NATS_PER_NUMBER]
    return bool(gaining) and any(gain < -NATS_PER_NUMBER for log, gain in gain_of_log.items() if log > min(gaining))


def _until_the_end(spells: Sequence[FittedHypothesis]) -> Iterator[Hypothesis]:
    for spell in sorted(spells, key=lambda spell: -spell.gain)[:_DIVIDED]:
        last = spell.trial.when.spans[-1]
        later = [log for log in spell.by_log if log > last.log]
        if later and math.isinf(last.length_s):
            yield spell.trial.at(since(last, later))


def gaining_of(looks: Sequence[FittedHypothesis]) -> list[FittedHypothesis]:
    """Return the looks at trials that may be pursued: those that gain in all logs or in a part of them."""
    divided = [look.trial for look in _divided(looks)]
    return [look for look in looks if look.gain > 0 or any(look.trial is trial for trial in divided)]


def _divided(looks: Sequence[FittedHypothesis]) -> list[FittedHypothesis]:
    """Return the looks with which some logs gain enough and others lose; the largest gain first, one of each form."""
    best_of_form: dict[tuple[str, ...], tuple[float, FittedHypothesis]] = {}
    for look in looks:
        gain = sum(max(log_gain, 0.0) for log_gain in look.by_log.values())
        loss = sum(min(log_gain, 0.0) for log_gain in look.by_log.values())
        is_divided = _is_divisible(look.trial) and gain > WORTH and loss < -_LOST
        if is_divided and gain > best_of_form.get(look.trial.form, (0.0, look))[0]:
            best_of_form[look.trial.form] = (gain, look)
    return [look for _, look in sorted(best_of_form.values(), key=lambda item: -item[0])][:_DIVIDED]


def _is_divisible(trial: Hypothesis) -> bool:
    """Return whether a part of the logs may have the effect that the trial adds to all."""
    return bool(trial.effects) and not trial.when.spans and not trial.is_brief


def _confirm_all(
    run: Run, standings: Mapping[Unit, UnitState], hypotheses: Mapping[Unit, Sequence[FittedHypothesis]]
) -> dict[Unit, list[Evaluation]]:
    """Return the evaluations of all hypotheses, a few of a unit in each job."""
    parts = {unit: _parts(several, _CONFIRMED_TOGETHER) for unit, several in hypotheses.items()}
    evaluated = _results_of(run, _confirm, standings, parts)
    return {unit: list(chain.from_iterable(several)) for unit, several in evaluated.items()}


def _parts(items: Sequence[Item], size: int) -> list[Sequence[Item]]:
    return [items[first : first + size] for first in range(0, len(items), size)]


def look_at(bench: Bench, request: tuple[UnitState, Sequence[Hypothesis]]) -> list[FittedHypothesis]:
    """Return a look at each hypothesis."""
    return looks(bench, *request)


def _refine(bench: Bench, request: tuple[UnitState, FittedHypothesis]) -> FittedHypothesis:
    return refine(bench, request[0], request[1].trial)


def _confirm(bench: Bench, request: tuple[UnitState, Sequence[FittedHypothesis]]) -> list[Evaluation]:
    return confirm_each(bench, *request)


def _results_of(
    run: Run,
    job: Callable[[Bench, Any], Any],
    standings: Mapping[Unit, UnitState],
    items: Mapping[Unit, Sequence[object]],
) -> dict[Unit, list[Any]]:
    """Return the job's results for each unit's items, each with the state of the unit."""
    flat = [(unit, (standings[unit], item)) for unit, unit_items in items.items() for item in unit_items]
    results: dict[Unit, list[Any]] = {unit: [] for unit in items}
    for (unit, _), result in zip(flat, run(job, [request for _, request in flat]), strict=True):
        results[unit].append(result)
    return results


def _round(standing: UnitState, evaluations: Sequence[Evaluation], has_placebo: bool, known: bool = False) -> Round:
    """Return the round's result; the last evaluation is the placebo's if `has_placebo`. If one trial is `known` to be
    right, the likeliest is selected.
    """
    real, bar = (
        (evaluations[:-1], _tempering(standing, evaluations[-1]) * evaluations[-1].gain)
        if has_placebo
        else (evaluations, 0.0)
    )
    ranked = _rank(standing, real)
    if known:
        return Round(standing, ranked, bar, next((evaluation for evaluation in ranked if evaluation.gain > 0), None))
    least = ACCEPTED + max(bar, 0.0)
    selection = _select(standing, ranked, least)
    if selection is None or selection.trial.needs_both:  # judge the other trials by both parts too
        on_both = (_on_both_parts(standing, each) if _needs_both_parts(standing, each) else each for each in ranked)
        ranked_on_both = _rank(standing, tuple(on_both))
        if (likeliest_on_both := _select(standing, ranked_on_both, least)) is not None:
            ranked, selection = ranked_on_both, likeliest_on_both
    return Round(standing, ranked, bar, selection)


def _rank(standing: UnitState, evaluations: Sequence[Evaluation]) -> tuple[Evaluation, ...]:
    """Return the evaluations, those with the best odds first."""
    odds = _log_odds(standing, evaluations)
    return tuple(evaluations[at] for at in sorted(range(len(evaluations)), key=lambda at: -odds[at]))


def _select(standing: UnitState, ranked: Sequence[Evaluation], least: float) -> Evaluation | None:
    """Return the first of the evaluations that is good enough."""
    good = (evaluation for evaluation in ranked if evaluation.closes and _counted_gain(standing, evaluation) > least)
    return next(good, None)


def _needs_both_parts(standing: UnitState, evaluation: Evaluation) -> bool:
    """Return true for a lasting cause that the training part alone shows, even with a choice among thousands, if the
    held-out part does not contradict it: some motions reach the end of a range only once, and a box is heated once.
    """
    if evaluation.trial.needs_both or evaluation.gain < -_INDIFFERENT:
        return False
    train_gain = _tempering(standing, evaluation) * evaluation.train_gain
    return train_gain - COST * evaluation.factors - 2 * BRIEF > ACCEPTED


def _on_both_parts(standing: UnitState, evaluation: Evaluation) -> Evaluation:
    """Return the evaluation as that of a cause that needs both parts. The choice costs `BRIEF` nats of independent
    statistics, which are fewer of the nats that are not yet tempered.
    """
    trial = replace(evaluation.trial, whole=True)
    choice = BRIEF / max(_tempering(standing, evaluation), 1.0)
    return replace(
        evaluation,
        hypothesis=replace(evaluation.hypothesis, trial=trial),
        gain=(evaluation.train_gain + evaluation.gain) / 2 - choice,
    )


def _counted_gain(standing: UnitState, evaluation: Evaluation) -> float:
    """Return the gain in nats by which a trial is selected.

    The trial must also gain on the training part, to which its parameters are fitted. A trial without parameters (an
    exchange of axes) may gain on the held-out part alone, if that contains all the faces, or the only motion. It is
    then judged like an effect that occurs once, by the sum of both parts, less the cost of that choice.
    """
    if evaluation.trial.needs_both:
        return evaluation.gain_of_both  # one part alone may show a single event: both count, untempered
    temper = _tempering(standing, evaluation)
    if max(temper, 1.0) * evaluation.train_gain > WORTH:
        return temper * evaluation.gain
    if evaluation.factors or evaluation.train_gain < 0:
        return -math.inf
    return temper * (evaluation.train_gain + evaluation.gain - 2 * BRIEF)


def scores_by_wider(before: SyntheticLikelihood, after: SyntheticLikelihood, real: Floats) -> Floats:
    """Return the scores (n,) of the recording after a change, by the larger of the scatters before and after it.

    A change of the times of rows draws all noise anew. With few replicates, hundreds of statistics then scatter by half
    or twice as much by chance, and the narrower ones would hide that a cause closes the gap.
    """
    return replace(after, scale=np.fmax(before.scale, after.scale)).scores(real)


def _squares(scores: Floats) -> float:
    """Return the sum of squared scores; nan counts as 0."""
    return float((np.nan_to_num(scores) ** 2).sum())


def _tempering(standing: UnitState, evaluation: Evaluation) -> float:
    """Return the factor by which a gain is multiplied.

    A misalignment within the chip's population changes many statistics by about a standard deviation, all for one
    reason, so its gain counts less. A curved response over temperature changes a few independent statistics, which the
    dependence of the others does not affect. Gains from motion relative to others depend on these as well, and never
    count more.
    """
    ratio = evaluation.independent / standing.independent
    own_share = min(max(evaluation.own_share, 0.0), 1.0)
    return min(ratio, 1.0) + own_share * max(ratio - 1.0, 0.0)


def _log_odds(standing: UnitState, evaluations: Sequence[Evaluation]) -> tuple[float, ...]:
    if not evaluations:
        return ()
    temper = _tempering(standing, max(evaluations, key=lambda evaluation: evaluation.gain))
    return tuple(
        temper * evaluation.gain
        - COST * evaluation.factors
        - evaluation.trial.rarity
        - _OUTDONE * _is_outdone(evaluation, evaluations)
        for evaluation in evaluations
    )


def _is_outdone(evaluation: Evaluation, evaluations: Sequence[Evaluation]) -> bool:
    """Return whether another trial gains at least as much and leaves far smaller scores: in nats, a score of 100 costs
    little more than a score of 30.
    """
    return any(
        other.gain >= evaluation.gain and other.squared_scores < _FAR_LESS * evaluation.squared_scores
        for other in evaluations
    )
