"""The search for causes: guesses of every candidate, the likely ones refined, the best judged on held-out data.

Every round looks at each unit whose recording its models don't explain. Guesses are ranked by the training part, the
best few refined on it (`refine`), the best of these simulated again and again and scored on the held-out part, beside a
placebo: a line at a frequency that nobody saw, refined like the others. What makes the held-out part likelier, by more
than the placebo and chance do, is taken into the unit's models, and the next round asks what is still missing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects import Candidate, Hypothesis
from imuarray.gap.inference.evidence import Evidence, views
from imuarray.gap.inference.parameters import distinct, factors_of
from imuarray.gap.inference.refinement import FittedHypothesis, looks, refine
from imuarray.gap.inference.unit_state import LOOKS, NUMBERS, Unit, UnitState, compared, gains_of, touched_by
from imuarray.gap.inference.when import NUMBERS as EACH_NUMBER
from imuarray.gap.inference.when import in_logs, joined, since
from imuarray.gap.model.bench import Bench, StatisticValues
from imuarray.gap.model.replication import TOGETHER
from imuarray.gap.model.workers import Run
from imuarray.gap.statistics.synthetic_likelihood import independent_share
from imuarray.simulate.effects.tone import Tone

REFINED, CONFIRMED = 4, 3
"""So many trials of a unit are refined, and confirmed, in a round."""

WORTH = 2.0
"""Nats on the training part that a trial has to gain to be looked at further."""

ACCEPTED = 3.0
"""Nats on the held-out part that a cause has to gain, over the placebo's: 20 to 1."""

COST = 1.0
"""Nats that every free parameter costs: of two that explain as much the simpler one is the cause (Akaike 1974)."""

_BEHIND = 15.0
"""Nats by which a guess may be worse than the best one, and still be refined or confirmed; or half of its gain."""

_IN_TIME = frozenset(
    {"turn_on_bias", "bistable_bias", "bias_instability", "random_walk", "popcorn_noise", "thermal_bias", "thermal_lag"}
)
"""What changes by itself as time goes on: that a spell has more of it than the rest says nothing."""

_DIVIDED, _LOST = 3, 2.0
"""So many trials of a unit are tried in some logs alone, if the others lose so many nats by them."""

_BRIEF = 4.0
"""Nats that the choice of a moment costs."""

_OUTDONE, _FAR_LESS = 10.0, 0.5
"""Nats that it costs to leave twice as much as another one that gains as much."""

_FAINT, _NOWHERE = 0.05, (math.sqrt(5) - 1) / 4
"""Amplitude of the placebo over the noise, and its frequency over the rows' rate: no simple fraction."""


@dataclass(frozen=True)
class Evaluation:
    """A refined trial judged: the unit as it stands with it, and the nats that it gains on the training and on the
    held-out part; a brief one, which a part may not show, gains the mean of both. `own_share` of the gain comes from
    what the unit shows alone, not from how it moves beside others. `independent` is the share of the statistics that
    it moves which is independent with it in: a slow drift moves many of them together. `left` is the sum of the squared
    scores of the held-out part with it in, `closes` whether that got smaller.
    """

    tried: FittedHypothesis
    standing: UnitState
    train_gain: float
    gain: float
    own_share: float = 1.0
    independent: float = 1.0
    closes: bool = True
    left: float = 0.0

    @property
    def factors(self) -> int:
        """How many numbers were fitted."""
        return len(factors_of(self.tried.trial))

    @property
    def trial(self) -> Hypothesis:
        """What was tried."""
        return self.tried.trial


@dataclass(frozen=True)
class Round:
    """What one round found for a unit that stood as it did `before`: all that was confirmed, the likeliest first, the
    placebo's gain, and which was taken (None: nothing).
    """

    before: UnitState
    confirmed: tuple[Evaluation, ...]
    placebo_gain: float
    taken: Evaluation | None

    @property
    def log_odds(self) -> tuple[float, ...]:
        """Of each that was confirmed against nothing new: its gain, counted as far as statistics are independent with
        the best one in, less what its parameters cost.
        """
        return _log_odds(self.before, self.confirmed)


def guesses_of(evidence: Evidence, candidates: Mapping[str, Candidate]) -> list[Hypothesis]:
    """All trials that one sensor suggests, by all logs and by parts of them, those that are alike once."""
    return distinct(
        trial if not part.when.spans else trial.at(part.when)
        for part in views(evidence)
        for candidate in candidates.values()
        for trial in candidate.guesses(part)
        if not part.when.spans or not (trial.removed or trial.needs_both or trial.shared or trial.name in _IN_TIME)
    )


def placebo_of(evidence: Evidence) -> Hypothesis:
    """A weak line where none was seen, as free as a real one."""
    x, y, z = (_FAINT * evidence.noise).tolist()
    return Hypothesis((Tone((x, y, z), _NOWHERE * evidence.rows_per_s),), ("amplitude",))


def searched(
    standings: Mapping[Unit, UnitState],
    trials: Mapping[Unit, Sequence[Hypothesis]],
    placebos: Mapping[Unit, Hypothesis],
    run: Run,
    known: bool = False,
) -> dict[Unit, Round]:
    """One round over all units at once. Where it is `known` that one of the trials is right, none needs proof."""
    looks = _looked(run, standings, trials)
    for unit, own in _partly(run, standings, looks).items():
        looks[unit] += own
    likely = {unit: likeliest(own, REFINED) for unit, own in looks.items()}
    refined = _asked(run, _refine, standings, likely)
    best = {unit: likeliest(own, CONFIRMED) for unit, own in refined.items()}
    needed = {unit: [FittedHypothesis(placebos[unit])] for unit, own in best.items() if own and unit in placebos}
    fakes = _asked(run, _refine, standings, needed)
    confirmed = _asked(run, _confirm, standings, {unit: [*best[unit], *fakes.get(unit, ())] for unit in best})
    return {unit: _round(standings[unit], own, bool(fakes.get(unit)), known) for unit, own in confirmed.items()}


def likeliest(tried: Iterable[FittedHypothesis], count: int) -> list[FittedHypothesis]:
    """The best trials that are worth it and not left far behind, of each form at most two."""
    ranked = sorted((one for one in tried if one.models is not None), key=lambda one: -one.gain)
    least = ranked[0].gain - max(_BEHIND, ranked[0].gain / 2) if ranked else 0.0
    kept: list[FittedHypothesis] = []
    for one in ranked:
        same_form = sum(other.trial.form == one.trial.form for other in kept)
        if one.gain > least and one.gain * one.counts > WORTH and same_form < 2 and len(kept) < count:
            kept.append(one)
    return kept


def replicates_of(bench: Bench, standing: UnitState, numbers: Sequence[int]) -> list[StatisticValues]:
    """The unit's statistics in replicates of its models; what a lone sensor shares with others is left out."""
    found = bench.replicates([(standing.models, number) for number in numbers], other_models=standing.other_models)
    kept = bench.among(standing.unit, standing.unit)
    return [replace(one, values=one.values[kept]) for one in found]


def replicated(bench: Bench, standing: UnitState) -> UnitState:
    """With what replicates of its models make, and how far their noise is from the recording's."""
    came = replicates_of(bench, standing, NUMBERS)
    misfit = standing.misfit_of(bench.base.headers, [one.fitted for one in came])
    return replace(standing, values=np.array([one.values for one in came]), misfit=misfit)


def confirmed(bench: Bench, standing: UnitState, tried: FittedHypothesis) -> Evaluation:
    """The gains of a trial with its parameters, by replicates of both parts."""
    models = standing.models if tried.models is None else tried.models
    changed = replicated(bench, replace(standing, models=models))
    values, lost = changed.values, changed.misfit - standing.misfit
    likelihood, moved = compared(standing, values)
    columns, before = bench.own(standing.unit), standing.likelihood
    out = bench.held_out[columns]
    gains = gains_of(standing, likelihood, moved)
    train_gain, gain = (float(gains[part].sum()) - lost for part in (~out, out))
    if tried.trial.needs_both:
        gain = (train_gain + gain) / 2 - _BRIEF
    share = float(gains[~bench.is_of_motion[columns]].sum()) / max(float(gains.sum()), 1e-9)
    touched = touched_by(before, likelihood, moved)
    independent = independent_share(likelihood.scores(values)[:, touched]) if touched.any() else standing.independent
    stands = replace(changed, likelihood=likelihood)
    counted = np.ones_like(out) if tried.trial.needs_both else out
    left = _squares(stands.scores[counted])
    closes = left <= _squares(standing.scores[counted])
    return Evaluation(tried, stands, train_gain, gain, share, independent, closes, left)


class _Asked(NamedTuple):
    """What a job gets."""

    standing: UnitState
    tried: FittedHypothesis


def _looked(
    run: Run, standings: Mapping[Unit, UnitState], trials: Mapping[Unit, Sequence[Hypothesis]]
) -> dict[Unit, list[FittedHypothesis]]:
    """A look at all trials, a few of a unit in each job."""
    most = TOGETHER // LOOKS
    asked = [
        (unit, _Guesses(standings[unit], own[first : first + most]))
        for unit, own in trials.items()
        for first in range(0, len(own), most)
    ]
    found: dict[Unit, list[FittedHypothesis]] = {unit: [] for unit in trials}
    for (unit, _), result in zip(asked, run(_look, [one for _, one in asked]), strict=True):
        found[unit] += result
    return found


def _partly(
    run: Run, standings: Mapping[Unit, UnitState], looks: Mapping[Unit, Sequence[FittedHypothesis]]
) -> dict[Unit, list[FittedHypothesis]]:
    """Trials that explain some logs and make others less likely, in those logs, or parts of them, alone that they
    explain; and those of a part of a log that lasts to its end, in the logs after it too. Both parts of the campaign
    say which these are.
    """
    divided = {unit: [replace(one.trial, whole=True) for one in _divided(own)] for unit, own in looks.items()}
    divided = {unit: own for unit, own in divided.items() if own}
    alone = _looked(run, standings, divided) if divided else {}
    asked: dict[Unit, list[Hypothesis]] = {}
    for unit, own in looks.items():
        spells = [one for one in own if one.trial.when.spans and one.gain > 0]
        several = [*_where_it_gains(alone.get(unit, ()), spells), *_until_the_end(spells)]
        if several:
            asked[unit] = [replace(trial, whole=True) for trial in distinct(several)]
    return _looked(run, standings, asked) if asked else {}


def _where_it_gains(looks: Sequence[FittedHypothesis], spells: Sequence[FittedHypothesis]) -> Iterator[Hypothesis]:
    """Each trial in the logs that it explains; where a spell of the same effect explains a log better, in that."""
    for one in looks:
        best = {log: (gain, in_logs([log])) for log, gain in one.by_log.items() if gain > EACH_NUMBER}
        for spell in spells:
            log = spell.trial.when.spans[0].log
            gain = spell.by_log.get(log, 0.0)
            if spell.trial.form == one.trial.form and gain > best.get(log, (EACH_NUMBER, None))[0]:
                best[log] = (gain, spell.trial.when)
        when = joined(own for _, own in best.values())
        if when.spans and {span.log for span in when.spans if span.is_whole} != set(one.by_log):
            yield one.trial.at(when)


def _until_the_end(spells: Sequence[FittedHypothesis]) -> Iterator[Hypothesis]:
    for one in sorted(spells, key=lambda one: -one.gain)[:_DIVIDED]:
        last = one.trial.when.spans[-1]
        later = [log for log in one.by_log if log > last.log]
        if later and math.isinf(last.length_s):
            yield one.trial.at(since(last, later))


def _divided(looks: Sequence[FittedHypothesis]) -> list[FittedHypothesis]:
    """Those of which some logs gain enough, and others lose; what gains most first, one of each form."""
    found: dict[tuple[str, ...], tuple[float, FittedHypothesis]] = {}
    for one in looks:
        gain = sum(max(own, 0.0) for own in one.by_log.values())
        loss = sum(min(own, 0.0) for own in one.by_log.values())
        is_open = bool(one.trial.effects) and not one.trial.when.spans and not one.trial.is_brief
        if is_open and gain > WORTH and loss < -_LOST and gain > found.get(one.trial.form, (0.0, one))[0]:
            found[one.trial.form] = (gain, one)
    return [one for _, one in sorted(found.values(), key=lambda item: -item[0])][:_DIVIDED]


class _Guesses(NamedTuple):
    """What a look gets."""

    standing: UnitState
    trials: Sequence[Hypothesis]


def _look(bench: Bench, asked: _Guesses) -> list[FittedHypothesis]:
    return looks(bench, asked.standing, asked.trials)


def _refine(bench: Bench, asked: _Asked) -> FittedHypothesis:
    return refine(bench, asked.standing, asked.tried.trial)


def _confirm(bench: Bench, asked: _Asked) -> Evaluation:
    return confirmed(bench, asked.standing, asked.tried)


def _asked(
    run: Run,
    job: Callable[[Bench, Any], Any],
    standings: Mapping[Unit, UnitState],
    items: Mapping[Unit, Sequence[FittedHypothesis]],
) -> dict[Unit, list[Any]]:
    """The job's results for each unit's items."""
    flat = [(unit, _Asked(standings[unit], one)) for unit, own in items.items() for one in own]
    found: dict[Unit, list[Any]] = {unit: [] for unit in items}
    for (unit, _), result in zip(flat, run(job, [asked for _, asked in flat]), strict=True):
        found[unit].append(result)
    return found


def _round(standing: UnitState, found: Sequence[Evaluation], has_placebo: bool, known: bool = False) -> Round:
    """If it `has_placebo`, that is the last; of those of which one is `known` to be right the likeliest is taken."""
    real, bar = (found[:-1], _tempered(standing, found[-1]) * found[-1].gain) if has_placebo else (found, 0.0)
    odds = _log_odds(standing, real)
    ranked = tuple(real[at] for at in sorted(range(len(real)), key=lambda at: -odds[at]))
    if known:
        return Round(standing, ranked, bar, next((one for one in ranked if one.gain > 0), None))
    least = ACCEPTED + max(bar, 0.0)
    # what happens once has no more than one reason to show: all of its gain counts
    good = [
        one
        for one in ranked
        if one.closes
        and (1.0 if one.trial.needs_both else _tempered(standing, one)) * one.gain > least
        and (max(_tempered(standing, one), 1.0) * one.train_gain > WORTH or one.trial.needs_both)
    ]
    return Round(standing, ranked, bar, good[0] if good else None)


def _squares(scores: Floats) -> float:
    """Their sum; what says nothing counts nothing."""
    return float((np.nan_to_num(scores) ** 2).sum())


def _tempered(standing: UnitState, one: Evaluation) -> float:
    """How much a gain counts: a misalignment within what the chip's population has moves many statistics by about a
    standard deviation, all of them for one and the same reason. A bow over temperature moves a handful of which each
    says something of its own: that they are few among many that hang together takes nothing from them. How a sensor
    moves beside others hangs on these as well, and counts no more for that.
    """
    ratio = one.independent / standing.independent
    own = min(max(one.own_share, 0.0), 1.0)
    return min(ratio, 1.0) + own * max(ratio - 1.0, 0.0)


def _log_odds(standing: UnitState, found: Sequence[Evaluation]) -> tuple[float, ...]:
    if not found:
        return ()
    temper = _tempered(standing, max(found, key=lambda one: one.gain))
    return tuple(
        temper * one.gain - COST * one.factors - one.trial.rarity - _OUTDONE * _is_outdone(one, found) for one in found
    )


def _is_outdone(one: Evaluation, found: Sequence[Evaluation]) -> bool:
    """Whether another that gains as much leaves far less: a score of 100 costs little more nats than one of 30."""
    return any(other.gain >= one.gain and other.left < _FAR_LESS * one.left for other in found)
