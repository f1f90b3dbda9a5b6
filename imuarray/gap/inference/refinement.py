"""The parameters of a trial, fitted to the training part by simulation, with the ordinary ones re-adapted.

Every free parameter is a guess times a factor. Gauss-Newton steps in the logs of the factors bring the statistics that
the simulation makes to those of the recording; the replicates are always the same draws, so that their differences show
what a step does and not what chance does. After each step the ordinary parameters move by as much as the fit of the
replicates misses that of the recording (indirect inference, Gourieroux, Monfort and Renault 1993).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.inference.parameters import Factor, active_axes, factors_of, moved, without
from imuarray.gap.inference.unit_state import LOOKS, NUMBERS, Came, UnitState, compared, counts_of, gains_of, touched_by
from imuarray.gap.model.bench import Bench, StatisticValues
from imuarray.gap.model.replication import Models
from imuarray.gap.statistics.catalogue import AXES
from imuarray.gap.statistics.synthetic_likelihood import FREEDOM, SyntheticLikelihood

STEPS = 2
_NUDGE = 0.25
"""Step in the log of a factor by which slopes are taken."""

_FURTHEST = 1.2
"""Largest step in the log of a factor; slopes hold no further."""

_PRIOR = 2.0
"""Standard deviation of the log of a factor before anything is known of it."""

_AXIS_GAIN = 1.5
"""An axis that gains fewer nats does without the effect."""

_MORE_LOOKS, _WIDER, _MUCH = 4, 1.5, 0.02
"""Of a change that makes more than that share of the statistics so many times wider, more replicates are looked at."""

_DONE = 0.03
_ADAPTED, _FITS = 2, 0.5
"""So often at most the noise is adapted, until that of the fit is missed by fewer nats."""


@dataclass(frozen=True)
class FittedHypothesis:
    """A trial as far as it was refined: the models with it, nats gained on the training part, how much more these count
    (`counts_of`); None as `models` if it wasn't, or can't be, simulated. `by_log` are the nats of single logs, by their
    numbers, of a look.
    """

    trial: Hypothesis
    models: Models | None = None
    gain: float = -np.inf
    counts: float = 1.0
    by_log: Mapping[int, float] = field(default_factory=dict)


def look(bench: Bench, standing: UnitState, trial: Hypothesis) -> FittedHypothesis:
    """The gain of a trial as it was guessed, whatever becomes of the noise: that isn't adapted yet."""
    (found,) = looks(bench, standing, [trial])
    return found


def looks(bench: Bench, standing: UnitState, trials: Sequence[Hypothesis]) -> list[FittedHypothesis]:
    """`look` at each."""
    models = [standing.changed(trial) for trial in trials]
    found = [FittedHypothesis(trial) for trial in trials]
    for whole in (False, True):
        places = [at for at, trial in enumerate(trials) if trial.needs_both == whole]
        came = _seen_each(bench, standing, [models[at] for at in places], whole, LOOKS)
        for at, seen in zip(places, came, strict=True):
            if seen is not None:
                gain, counts = _gain(standing, seen, trials[at]), _counts(standing, seen)
                found[at] = FittedHypothesis(trials[at], models[at], gain, counts, _by_log(bench, standing, seen))
    return found


def refine(bench: Bench, standing: UnitState, trial: Hypothesis) -> FittedHypothesis:
    """The trial with its free parameters fitted and the ordinary ones re-adapted; the best of all steps, each as it was
    simulated.
    """
    now = _simulated(bench, standing, trial, standing.changed(trial), LOOKS)
    if now is not None and _widens(standing, now.seen):
        now = _simulated(bench, standing, trial, standing.changed(trial), _MORE_LOOKS)
    if now is None:
        return FittedHypothesis(trial)
    now = best = _adapted(bench, standing, now)
    for _ in range(STEPS):
        factors = factors_of(now.tried.trial)
        if not factors:
            break
        steps = _step(standing, now.seen, _slopes(bench, standing, now.tried.trial, factors, now.seen))
        stepped = moved(now.tried.trial, factors, steps)
        changed = _with_fitted(standing.changed(stepped), now.seen.settled)
        after = _simulated(bench, standing, stepped, changed, len(now.seen.values))
        if after is None:
            break
        now, best = after, max(best, after, key=_gained)
        if np.abs(steps).max() < _DONE:
            break
    return _pruned(bench, standing, _adapted(bench, standing, best)).tried


def _adapted(bench: Bench, standing: UnitState, found: _Simulated) -> _Simulated:
    """The trial with the noise that goes with it, so that lines are not made larger where noise is to be smaller; as it
    was if that is no better.
    """
    trial, best, now, before = found.tried.trial, found, found, None
    for _ in range(_ADAPTED):
        if now.seen.misfit < standing.misfit + _FITS or now.tried.models is None:
            break
        settled = standing.settled(now.tried.models, now.seen.came, before)
        before = now.tried.models, now.seen.came
        changed = _with_fitted(standing.changed(trial), settled)
        after = _simulated(bench, standing, trial, changed, len(now.seen.values))
        if after is None:
            break
        now, best = after, max(best, after, key=_gained)
    return best


class _Seen(NamedTuple):
    """What models make: replicates (r, n), their likeness and shift, their fits, the models with ordinary parameters
    moved by these, and the nats that they lack.
    """

    values: Floats
    likelihood: SyntheticLikelihood
    moved: Floats
    came: Came
    settled: Models
    misfit: float


class _Simulated(NamedTuple):
    """A trial with the models that were simulated, and what these make."""

    tried: FittedHypothesis
    seen: _Seen


def _gained(one: _Simulated) -> float:
    return one.tried.gain


def _widens(standing: UnitState, seen: _Seen) -> bool:
    """Whether the change leaves much to chance: then two draws of it say little."""
    return bool(np.mean(seen.likelihood.scale > _WIDER * standing.likelihood.scale) > _MUCH)


def _simulated(bench: Bench, standing: UnitState, trial: Hypothesis, models: Models, looks: int) -> _Simulated | None:
    """A trial as it is with these models, by so many replicates; None for parameters that an effect refuses."""
    seen = _seen(bench, standing, models, trial.needs_both, looks)
    if seen is None:
        return None
    gain = _gain(standing, seen, trial) - seen.misfit + standing.misfit
    return _Simulated(FittedHypothesis(trial, models, gain, _counts(standing, seen)), seen)


def _seen(bench: Bench, standing: UnitState, models: Models, whole: bool, count: int) -> _Seen | None:
    """Of the training part, or of both (`whole`); None for parameters that an effect refuses."""
    (found,) = _seen_each(bench, standing, [models], whole, count)
    return found


def _seen_each(
    bench: Bench, standing: UnitState, several: Sequence[Models], whole: bool, count: int
) -> list[_Seen | None]:
    """`_seen`, of several models of the same sensors, in so many replicates of each."""
    if not several:
        return []
    asked = [(models, number) for models in several for number in NUMBERS[:count]]
    try:
        found = bench.replicates(asked, held_out=whole, other_models=standing.other_models)
    except ValueError:
        if len(several) == 1:
            return [None]
        alone = [_seen_each(bench, standing, [models], whole, count) for models in several]
        return [seen for one in alone for seen in one]
    parts = [found[first : first + count] for first in range(0, len(found), count)]
    return [_seen_in(bench, standing, models, part, whole) for models, part in zip(several, parts, strict=True)]


def _seen_in(bench: Bench, standing: UnitState, models: Models, found: Sequence[StatisticValues], whole: bool) -> _Seen:
    """What replicates of models show."""
    kept = bench.among(standing.unit, standing.unit)
    values = np.array([one.values[kept] for one in found])
    if not whole:
        out = bench.held_out[bench.own(standing.unit)]
        values[:, out] = standing.values[: len(values), out]
    likelihood, moved = compared(standing, values)
    came = [one.fitted for one in found]
    settled, misfit = standing.settled(models, came), standing.misfit_of(bench.base.headers, came)
    return _Seen(values, likelihood, moved, came, settled, misfit)


def _gain(standing: UnitState, seen: _Seen, trial: Hypothesis) -> float:
    """Of the training part, the rest stands as it was; of a trial that needs both parts the mean of what they gain,
    unless it is brief, and seen in one.
    """
    gain = float(gains_of(standing, seen.likelihood, seen.moved).sum())
    return gain / 2 if trial.needs_both and not trial.is_brief else gain


def _by_log(bench: Bench, standing: UnitState, seen: _Seen) -> dict[int, float]:
    """What statistics of single logs gain."""
    gains, logs = gains_of(standing, seen.likelihood, seen.moved), bench.logs[bench.own(standing.unit)]
    return {log: float(gains[logs == log].sum()) for log in np.unique(logs[logs >= 0]).tolist()}


def _counts(standing: UnitState, seen: _Seen) -> float:
    return counts_of(standing, seen.likelihood, seen.moved)


def _slopes(bench: Bench, standing: UnitState, trial: Hypothesis, factors: Sequence[Factor], seen: _Seen) -> Floats:
    """(n, k) change of each statistic with the log of each factor.

    The axes of one parameter are nudged together: what an axis reads depends on its own. What a whole sensor shows is
    shared out among them.
    """
    unit = standing.unit
    columns = bench.own(unit)
    of_axis = np.array([bench.keys[at].axis for at in columns])
    slopes = np.zeros((len(columns), len(factors)))
    groups: dict[tuple[int, str, int], list[int]] = {}
    for at, factor in enumerate(factors):
        groups.setdefault((factor.effect, factor.name, factor.turn), []).append(at)
    nudged = _nudged(bench, standing, trial, factors, seen, list(groups.values()))
    for members, (nudge, values) in zip(groups.values(), nudged, strict=True):
        change = np.nan_to_num((values - seen.values).mean(axis=0)) / nudge
        for at in members:
            axis = factors[at].axis
            own = np.ones(len(columns), bool) if axis is None else of_axis == AXES[axis]
            slopes[:, at] = np.where(own, change, np.where(of_axis == "", change / len(members), 0.0))
    return slopes


def _nudged(
    bench: Bench,
    standing: UnitState,
    trial: Hypothesis,
    factors: Sequence[Factor],
    seen: _Seen,
    groups: Sequence[list[int]],
) -> list[tuple[float, Floats]]:
    """For each group of factors the step in their logs, upwards or where that can't be simulated downwards, and the
    statistics then; those that were `seen` if neither can.
    """
    found = [(_NUDGE, seen.values)] * len(groups)
    left = list(range(len(groups)))
    for nudge in (_NUDGE, -_NUDGE):
        several = []
        for at in left:
            steps = np.zeros(len(factors))
            steps[groups[at]] = nudge
            several.append(_with_fitted(standing.changed(moved(trial, factors, steps)), seen.settled))
        came = dict(zip(left, _seen_each(bench, standing, several, trial.needs_both, len(seen.values)), strict=True))
        found = [(nudge, one.values) if (one := came.get(at)) is not None else old for at, old in enumerate(found)]
        left = [at for at, one in came.items() if one is None]
    return found


def _step(standing: UnitState, seen: _Seen, slopes: Floats) -> Floats:
    """(k,) best changes of the logs of the factors."""
    likelihood = seen.likelihood
    known = np.isfinite(likelihood.location) & np.isfinite(standing.real) & np.isfinite(likelihood.scale)
    apart = np.where(known, standing.real - likelihood.location, 0.0)
    scale = np.where(known, likelihood.scale, 1.0)
    scores = apart / scale
    weight = np.where(known, (FREEDOM + 1) / (FREEDOM + scores**2), 0.0) * standing.weight
    design = slopes / scale[:, None]
    return np.clip(regressed(design, scores, weight), -_FURTHEST, _FURTHEST)


def regressed(design: Floats, scores: Floats, weight: Floats) -> Floats:
    """(k,) coefficients by weighted least squares of scores (n,) by a design (n, k), drawn towards 0 by a prior.

    Columns that can't be told apart share what they explain, however large they are.
    """
    root, count = np.sqrt(weight), design.shape[1]
    rows = np.vstack([root[:, None] * design, np.eye(count) / _PRIOR])
    return np.asarray(np.linalg.lstsq(rows, np.append(root * scores, np.zeros(count)), rcond=None)[0])


def _with_fitted(models: Models, settled: Models) -> Models:
    """`models` with the ordinary parameters of `settled`."""
    return {name: replace(model, fitted=settled[name].fitted) for name, model in models.items()}


def _pruned(bench: Bench, standing: UnitState, found: _Simulated) -> _Simulated:
    """Without the axes that gain too little, unless more than that is lost: an axis of 0 is without the effect, but an
    offset that another range has on one is not.
    """
    active = active_axes(found.tried.trial)
    if len(active) < 2:
        return found
    gains = gains_of(standing, found.seen.likelihood, found.seen.moved) * found.tried.counts
    told = touched_by(standing.likelihood, found.seen.likelihood, found.seen.moved)
    idle = {axis for axis in active if _most_of(gains, told, _of_axis(bench, standing, axis)) < _AXIS_GAIN}
    if not idle or len(idle) == len(active):
        return found
    trial = found.tried.trial
    fewer = replace(trial, effects=tuple(without(effect, idle) for effect in trial.effects))
    models = _with_fitted(standing.changed(fewer), found.seen.settled)
    after = _simulated(bench, standing, fewer, models, len(found.seen.values))
    return after if after is not None and after.tried.gain > found.tried.gain - _AXIS_GAIN * len(idle) else found


def _most_of(gains: Floats, told: Booleans, own: Booleans) -> float:
    """Nats of an axis by all of its own statistics, or by those that tell of the effect, if that is more: a hundred
    levels that all lie a little aside for one reason cost as many times what one costs.
    """
    return max(float(gains[own].sum()), float(gains[own & told].sum()))


def _of_axis(bench: Bench, standing: UnitState, axis: int) -> Booleans:
    """Which of the unit's statistics are of one axis."""
    columns = bench.own(standing.unit)
    return np.array([bench.keys[at].axis == AXES[axis] for at in columns], bool)
