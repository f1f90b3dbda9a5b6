"""Refinement of a trial: its parameters fitted to the training part by simulation, with the ordinary ones re-adapted.

The free parameters of a trial are guesses, each multiplied by a factor. Gauss-Newton steps in the logs of the factors
bring the simulated statistics to the recorded ones. The replicates always use the same draws, so their differences are
due to a step and not to chance. After each step the ordinary parameters are corrected by the difference between the
fits of the replicates and of the recording (indirect inference, Gourieroux, Monfort and Renault 1993).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.inference.unit_state import (
    LOOKS,
    NUMBERS,
    FitsOfReplicates,
    UnitState,
    affected_mask,
    counts_of,
    gains_of,
    update_likelihood,
)
from imuarray.gap.model.bench import Bench
from imuarray.gap.model.replication import Models
from imuarray.gap.statistics.catalogue import AXES
from imuarray.gap.statistics.synthetic_likelihood import FREEDOM, SyntheticLikelihood
from imuarray.simulate.effect import Effect

_SAME_FREE, _SAME = 0.2, 0.01
"""Relative difference of a refined and of a fixed number within which two trials are the same."""


class Factor(NamedTuple):
    """A free parameter of a trial's effect, or one number of it.

    `place` in the list of numbers, `axis` 0, 1 or 2 of the number, and its position `turn` on that axis (a 3x3 response
    has three numbers for each axis); None: the parameter has no axes.
    """

    effect: int
    name: str
    place: int | None = None
    axis: int | None = None
    turn: int = 0


def factors_of(trial: Hypothesis) -> list[Factor]:
    """Return the free parameters that are not 0, axis by axis."""
    factors = []
    for name in trial.free:
        at = next(number for number, effect in enumerate(trial.effects) if hasattr(effect, name))
        value = getattr(trial.effects[at], name)
        if isinstance(value, tuple):
            each = len(value) // 3
            factors += [
                Factor(at, name, place, place // each, place % each)
                for place, item in enumerate(value)
                if item and np.isfinite(item)
            ]
        elif value and np.isfinite(value):
            factors.append(Factor(at, name))
    return factors


def move_factors(trial: Hypothesis, factors: Sequence[Factor], steps: Floats) -> Hypothesis:
    """Return the trial with its factors multiplied by exp(steps); those of the other sensors' effects of the same kind
    too. Probabilities stay at 1 or below, and other parameters within the trial's limits.
    """
    effects, opposite = list(trial.effects), list(trial.opposite)
    for factor, step in zip(factors, steps.tolist(), strict=True):
        kind = type(effects[factor.effect])
        for side in (effects, opposite):
            if factor.effect < len(side) and isinstance(side[factor.effect], kind):
                side[factor.effect] = _scale(side[factor.effect], factor, float(np.exp(step)), trial.limits)
    return replace(trial, effects=tuple(effects), opposite=tuple(opposite))


def _scale(effect: Effect, factor: Factor, by: float, limits: Mapping[str, tuple[float, float]]) -> Effect:
    value: Any = getattr(effect, factor.name)
    if factor.place is not None:
        changed: Any = tuple(item * by if place == factor.place else item for place, item in enumerate(value))
    else:
        low, high = limits.get(factor.name, (0.0, 1.0 if factor.name == "probability" else np.inf))
        changed = min(max(value * by, low), high)
    try:
        return replace(effect, **{factor.name: changed})
    except ValueError:
        return effect


def distinct(trials: Iterable[Hypothesis]) -> list[Hypothesis]:
    """Return the trials without those that begin so near an earlier one that both would be refined to the same
    result.
    """
    by_form: dict[tuple[object, ...], list[tuple[Floats, Floats]]] = {}
    distinct_trials = []
    for trial in trials:
        whose = (trial.shared, trial.sensor, trial.others, trial.members, trial.everywhere)
        target = (trial.removed, whose, trial.whole, trial.free)
        numbers, reach = _numbers(trial)
        of_form = by_form.setdefault((trial.form, target, trial.fitted, trial.opposite_fitted, len(numbers)), [])
        if not any(_near(numbers, other, np.minimum(reach, other_reach)) for other, other_reach in of_form):
            of_form.append((numbers, reach))
            distinct_trials.append(trial)
    return distinct_trials


def _numbers(trial: Hypothesis) -> tuple[Floats, Floats]:
    """Return all numbers and texts of the effects, and the relative difference within which each counts as the same."""
    numbers: list[float] = []
    reach: list[float] = []
    for effect in (*trial.effects, *trial.opposite):
        for item in fields(effect):
            value = getattr(effect, item.name)
            several = value if isinstance(value, tuple) else (value,)
            plain = [
                float(zlib.crc32(element.encode())) if isinstance(element, str) else float(element)
                for element in several
            ]
            numbers += plain
            reach += [_SAME_FREE if item.name in trial.free else _SAME] * len(plain)
    return np.array(numbers), np.array(reach)


def _near(first: Floats, other: Floats, reach: Floats) -> bool:
    same = (first == other) | (np.isnan(first) & np.isnan(other))
    with np.errstate(invalid="ignore"):
        return bool((same | (np.abs(first - other) <= reach * np.fmin(np.abs(first), np.abs(other)))).all())


def active_axes(trial: Hypothesis) -> list[int]:
    """Return the axes on which the trial's first effect acts, if it has amplitudes by axis."""
    amplitudes = [getattr(trial.effects[0], name) for name in _amplitudes(trial.effects[0])] if trial.effects else []
    return [axis for axis in range(3) if any(value[axis] for value in amplitudes)]


def _amplitudes(effect: Effect) -> Iterator[str]:
    """Return the names of the parameters by axis with which the effect does not act on an axis if they are 0."""
    return (item.name for item in fields(effect) if item.metadata.get("per_axis") and item.default == (0.0, 0.0, 0.0))


def without(effect: Effect, axes: set[int]) -> Effect:
    """Return the effect without these axes."""
    changes = {
        name: tuple(0.0 if axis in axes else item for axis, item in enumerate(getattr(effect, name)))
        for name in _amplitudes(effect)
    }
    return replace(effect, **changes)


STEPS = 2
_NUDGE = 0.25
"""Step in the log of a factor for numerical slopes."""

_FURTHEST = 1.2
"""Largest step in the log of a factor; slopes are not valid further away."""

_PRIOR = 2.0
"""Prior standard deviation of the log of a factor."""

_AXIS_GAIN = 1.5
"""Least gain in nats of an axis on which the effect is kept."""

_MORE_LOOKS, _WIDER, _MUCH = 4, 1.5, 0.02
"""A change is simulated in `_MORE_LOOKS` replicates if it makes more than the share `_MUCH` of the statistics more than
`_WIDER` times wider.
"""

_OF_RESPONSE = frozenset({"scale", "misalignment", "g_sensitivity"})
"""Effects that add to the response of a part, which each replicate draws and fits within the tolerance. What the fit
leaves differs from replicate to replicate, even if two agree by chance: `_MORE_LOOKS` replicates.
"""

WORTH = 2.0
"""Gain in nats on the training part from which on a trial is pursued."""

_HOPELESS = 10.0
"""Nats that a trial loses in its first replicates if no further ones are needed to see that it explains nothing."""

_DONE, _CONVERGED = 0.03, 0.1
"""Step in the log of each factor, and change of the gain in nats by a step, expected or simulated, below which no
further step is made.
"""

_DISPLACED = 4.0
"""Difference between the offsets of a trial's models and those that the recording has, from which on the trial is
simulated with the latter before a step: in standard deviations of the offsets of replicates, in which parts differ, and
of a reading.
"""

_ADAPTED, _FITS = 2, 0.5
"""Largest number of adaptations of the noise, and the misfit in nats above the present models' below which they end."""


@dataclass(frozen=True)
class FittedHypothesis:
    """A trial with its refined parameters: the models with it, its gain in nats on the training part, and the factor by
    which the gain counts (`counts_of`). `models` is None if the trial was not, or cannot be, simulated. After a look,
    `by_log` are the gains of single logs, by their numbers, and `values` (r, n) the statistics of its replicates.
    """

    trial: Hypothesis
    models: Models | None = None
    gain: float = -np.inf
    counts: float = 1.0
    by_log: Mapping[int, float] = field(default_factory=dict)
    values: Floats | None = field(default=None, repr=False, compare=False)


def looks(bench: Bench, standing: UnitState, trials: Sequence[Hypothesis]) -> list[FittedHypothesis]:
    """Return each trial with its gain as guessed, without its effect on the noise, which is not adapted yet.

    A trial that needs more than `LOOKS` replicates, but has no hope after these, is not simulated again.
    """
    models = [standing.changed(trial) for trial in trials]
    fitted = [FittedHypothesis(trial) for trial in trials]
    for whole in (False, True):
        places = [at for at, trial in enumerate(trials) if trial.needs_both == whole]
        fitted = _look_again_at(bench, standing, models, fitted, places, NUMBERS[:LOOKS])
        for count in sorted({_count_of(standing, trials[at]) for at in places} - {LOOKS}):
            some = [at for at in places if _count_of(standing, trials[at]) == count and has_hope(fitted[at])]
            fitted = _look_again_at(bench, standing, models, fitted, some, NUMBERS[LOOKS:count])
    return fitted


def _look_again_at(
    bench: Bench,
    standing: UnitState,
    models: Sequence[Models],
    fitted: Sequence[FittedHypothesis],
    places: Sequence[int],
    numbers: Sequence[int],
) -> list[FittedHypothesis]:
    """Return the looks with further replicates of the models at these places, all for one part or for both. A look at
    parameters that an effect refuses is not changed.
    """
    seen, several = list(fitted), [models[at] for at in places]
    whole = any(fitted[at].trial.needs_both for at in places)
    for at, item in zip(places, _simulate_each(bench, standing, several, whole, numbers), strict=True):
        if item is not None:
            before = fitted[at].values
            values = item.values if before is None else np.vstack([before, item.values])
            seen[at] = look_again(bench, standing, replace(fitted[at], models=models[at], values=values))
    return seen


def has_hope(look: FittedHypothesis) -> bool:
    """Return whether more replicates may show that a trial gains, in all logs or in some of them."""
    gain_of_logs = sum(max(gain, 0.0) for gain in look.by_log.values())
    return look.models is not None and (look.gain > -_HOPELESS or gain_of_logs > WORTH)


def _count_of(standing: UnitState, trial: Hypothesis) -> int:
    """Return the number of replicates of a look at the trial, of those that the state has."""
    return min(_MORE_LOOKS, len(standing.values)) if trial.name in _OF_RESPONSE else LOOKS


def look_again(bench: Bench, standing: UnitState, look: FittedHypothesis) -> FittedHypothesis:
    """Return a look judged by a state of the same models with more replicates, the first of which it has seen."""
    if look.values is None:
        return look
    likelihood, shift = update_likelihood(standing, look.values)
    return replace(
        look,
        gain=_gain(standing, likelihood, shift, look.trial),
        counts=counts_of(standing, likelihood, shift),
        by_log=_by_log(bench, standing, likelihood, shift),
    )


def refine(bench: Bench, standing: UnitState, trial: Hypothesis) -> FittedHypothesis:
    """Return the trial with its free parameters fitted and the ordinary ones re-adapted; the best of all steps, each as
    simulated.
    """
    now = _simulate(bench, standing, trial, standing.changed(trial), _count_of(standing, trial))
    if now is not None and _widens(standing, now.statistics):
        now = _simulate(bench, standing, trial, standing.changed(trial), _MORE_LOOKS)
    if now is None:
        return FittedHypothesis(trial)
    now = best = _adapt(bench, standing, now)
    if _is_displaced(bench, standing, now):
        changed = _with_fitted(standing.changed(trial), now.statistics.settled)
        after = _simulate(bench, standing, trial, changed, len(now.statistics.values))
        if after is not None:
            now, best = after, max(best, after, key=_gained)
    for _ in range(STEPS):
        factors = factors_of(now.hypothesis.trial)
        if not factors:
            break
        slopes = _slopes(bench, standing, now, factors)
        steps, expected_gain = _step(standing, now.statistics, slopes)
        if expected_gain < _CONVERGED:
            break
        stepped = move_factors(now.hypothesis.trial, factors, steps)
        changed = _with_fitted(standing.changed(stepped), now.statistics.settled)
        after = _simulate(bench, standing, stepped, changed, len(now.statistics.values))
        if after is None:
            break
        change = abs(_gained(after) - _gained(now))
        now, best = after, max(best, after, key=_gained)
        if np.abs(steps).max() < _DONE or change < _CONVERGED:
            break
    return _prune(bench, standing, _adapt(bench, standing, best)).hypothesis


def _adapt(bench: Bench, standing: UnitState, start: _TrialState) -> _TrialState:
    """Return the trial with its noise adapted, so that lines do not grow if the noise has to shrink; unchanged if that
    is no better.
    """
    trial, best, now, before = start.hypothesis.trial, start, start, None
    for _ in range(_ADAPTED):
        if now.statistics.misfit < standing.misfit + _FITS or now.hypothesis.models is None:
            break
        settled = standing.settled(now.hypothesis.models, now.statistics.fits, before)
        before = now.hypothesis.models, now.statistics.fits
        changed = _with_fitted(standing.changed(trial), settled)
        after = _simulate(bench, standing, trial, changed, len(now.statistics.values))
        if after is None:
            break
        now, best = after, max(best, after, key=_gained)
    return best


def _is_displaced(bench: Bench, standing: UnitState, state: _TrialState) -> bool:
    """Return whether the levels of the trial's models are still far from those that the recording has: a bias that was
    fitted to two ranges displaces every level of the second one, and a step would change the trial instead.
    """
    models = state.hypothesis.models
    if models is None:
        return False
    for name, settled in state.statistics.settled.items():
        noise = standing.target[name].noise(bench.base.headers[name])
        spread = np.std([fitted[name].offset for fitted in state.statistics.fits], axis=0, ddof=1)
        displacement = np.abs(np.subtract(settled.fitted.offset, models[name].fitted.offset))
        if (displacement > _DISPLACED * np.hypot(spread, noise)).any():
            return True
    return False


class _TrialStatistics(NamedTuple):
    """Replicates of models: values (r, n), likelihood and shift, their fits, the models with ordinary parameters that
    are corrected by the fits, and the misfit in nats.
    """

    values: Floats
    likelihood: SyntheticLikelihood
    shift: Floats
    fits: FitsOfReplicates
    settled: Models
    misfit: float


class _TrialState(NamedTuple):
    """A trial with the simulated models, and their replicates."""

    hypothesis: FittedHypothesis
    statistics: _TrialStatistics


def _gained(state: _TrialState) -> float:
    return state.hypothesis.gain


def _widens(standing: UnitState, statistics: _TrialStatistics) -> bool:
    """Return whether the change adds so much scatter that two draws of it do not determine its effect."""
    return bool(np.mean(statistics.likelihood.scale > _WIDER * standing.likelihood.scale) > _MUCH)


def _simulate(bench: Bench, standing: UnitState, trial: Hypothesis, models: Models, looks: int) -> _TrialState | None:
    """Simulate a trial with these models in `looks` replicates; None for parameters that an effect refuses."""
    statistics = _replicate(bench, standing, models, trial.needs_both, looks)
    if statistics is None:
        return None
    gain = _gain(standing, statistics.likelihood, statistics.shift, trial) - statistics.misfit + standing.misfit
    counts = counts_of(standing, statistics.likelihood, statistics.shift)
    return _TrialState(FittedHypothesis(trial, models, gain, counts), statistics)


def _replicate(bench: Bench, standing: UnitState, models: Models, whole: bool, count: int) -> _TrialStatistics | None:
    """Return replicates of the training part, or of both (`whole`); None for parameters that an effect refuses."""
    (replicated,) = _replicate_each(bench, standing, [models], whole, count)
    return replicated


def _replicate_each(
    bench: Bench, standing: UnitState, several: Sequence[Models], whole: bool, count: int
) -> list[_TrialStatistics | None]:
    """Return `_replicate` for several models of the same sensors, with `count` replicates of each."""
    replicated = _simulate_each(bench, standing, several, whole, NUMBERS[:count])
    return [
        None if replicates is None else _statistics_of(bench, standing, models, replicates)
        for models, replicates in zip(several, replicated, strict=True)
    ]


class _Replicates(NamedTuple):
    """Replicates of models: the unit's statistics (r, n), and the parameters fitted to each replicate."""

    values: Floats
    fits: FitsOfReplicates


def _simulate_each(
    bench: Bench, standing: UnitState, several: Sequence[Models], whole: bool, numbers: Sequence[int]
) -> list[_Replicates | None]:
    """Return replicates with these numbers of several models of the same sensors; None for parameters that an effect
    refuses. If only the training part is simulated, the statistics of the other part are those of the state.
    """
    if not several or not numbers:
        return [None] * len(several)
    # replicates of one number follow each other, because they share draws, motions and neighbours
    requests = [(models, number) for number in numbers for models in several]
    try:
        simulated = bench.replicates(requests, held_out=whole, other_models=standing.other_models)
    except ValueError:
        if len(several) == 1:
            return [None]
        return [_simulate_each(bench, standing, [models], whole, numbers)[0] for models in several]
    columns = bench.among(standing.unit, standing.unit)
    out = np.zeros(len(standing.real), bool) if whole else bench.held_out[bench.own(standing.unit)]
    replicates: list[_Replicates | None] = []
    for first in range(len(several)):
        own = simulated[first :: len(several)]
        values = np.array([replicate.values[columns] for replicate in own])
        values[:, out] = standing.values[list(numbers)][:, out]
        replicates.append(_Replicates(values, [replicate.fitted for replicate in own]))
    return replicates


def _statistics_of(bench: Bench, standing: UnitState, models: Models, replicates: _Replicates) -> _TrialStatistics:
    """Return the likelihood, shift and fits from the first replicates of models."""
    values, fits = replicates
    likelihood, shift = update_likelihood(standing, values)
    settled, misfit = standing.settled(models, fits), standing.misfit_of(bench.base.headers, fits)
    return _TrialStatistics(values, likelihood, shift, fits, settled, misfit)


def _gain(standing: UnitState, likelihood: SyntheticLikelihood, shift: Floats, trial: Hypothesis) -> float:
    """Return the gain on the training part; for a trial that needs both parts, the mean of both gains, or their sum if
    it is brief, because one part alone may show it.
    """
    gain = float(gains_of(standing, likelihood, shift).sum())
    return gain / 2 if trial.needs_both and not trial.is_brief else gain


def _by_log(bench: Bench, standing: UnitState, likelihood: SyntheticLikelihood, shift: Floats) -> dict[int, float]:
    """Return the gains of the statistics of single logs."""
    gains, logs = gains_of(standing, likelihood, shift), bench.logs[bench.own(standing.unit)]
    return {log: float(gains[logs == log].sum()) for log in np.unique(logs[logs >= 0]).tolist()}


def _slopes(bench: Bench, standing: UnitState, state: _TrialState, factors: Sequence[Factor]) -> Floats:
    """Return the change (n, k) of each statistic with the log of each factor.

    The axes of one parameter are changed together, because an axis depends on its own factor. The change of a statistic
    of the whole sensor is divided among them.
    """
    columns, statistics = bench.own(standing.unit), state.statistics
    of_axis = np.array([bench.keys[at].axis for at in columns])
    slopes = np.zeros((len(columns), len(factors)))
    groups: dict[tuple[int, str, int], list[int]] = {}
    for at, factor in enumerate(factors):
        groups.setdefault((factor.effect, factor.name, factor.turn), []).append(at)
    nudged = _nudge(bench, standing, state, factors, list(groups.values()))
    for members, (nudge, values) in zip(groups.values(), nudged, strict=True):
        change = np.nan_to_num((values - statistics.values[: len(values)]).mean(axis=0)) / nudge
        for at in members:
            axis = factors[at].axis
            is_of_axis = np.ones(len(columns), bool) if axis is None else of_axis == AXES[axis]
            slopes[:, at] = np.where(is_of_axis, change, np.where(of_axis == "", change / len(members), 0.0))
    return slopes


def _nudge(
    bench: Bench,
    standing: UnitState,
    state: _TrialState,
    factors: Sequence[Factor],
    groups: Sequence[list[int]],
) -> list[tuple[float, Floats]]:
    """Return, for each group of factors, the step in their logarithms and the statistics after it, all with the same
    ordinary parameters: a slope must not contain the change of these.

    The step is upwards, or downwards if an upward step cannot be simulated; if neither can, the statistics are the old
    ones. A response whose parts are drawn needs more replicates for its effect, but not for a slope: a step changes
    every replicate alike.
    """
    trial, statistics = state.hypothesis.trial, state.statistics
    models = statistics.settled if state.hypothesis.models is None else state.hypothesis.models
    count = LOOKS if trial.name in _OF_RESPONSE else len(statistics.values)
    outcomes = [(_NUDGE, statistics.values)] * len(groups)
    open_groups = list(range(len(groups)))
    for nudge in (_NUDGE, -_NUDGE):
        several = []
        for at in open_groups:
            steps = np.zeros(len(factors))
            steps[groups[at]] = nudge
            several.append(_with_fitted(standing.changed(move_factors(trial, factors, steps)), models))
        replicated = dict(
            zip(
                open_groups,
                _replicate_each(bench, standing, several, trial.needs_both, count),
                strict=True,
            )
        )
        outcomes = [
            (nudge, outcome.values) if (outcome := replicated.get(at)) is not None else old
            for at, old in enumerate(outcomes)
        ]
        open_groups = [at for at, outcome in replicated.items() if outcome is None]
    return outcomes


def _step(standing: UnitState, statistics: _TrialStatistics, slopes: Floats) -> tuple[Floats, float]:
    """Return the best changes (k,) of the logs of the factors, and the gain in nats that they have if the statistics
    change by the slopes.
    """
    likelihood = statistics.likelihood
    known = np.isfinite(likelihood.location) & np.isfinite(standing.real) & np.isfinite(likelihood.scale)
    deviation = np.where(known, standing.real - likelihood.location, 0.0)
    scale = np.where(known, likelihood.scale, 1.0)
    scores = deviation / scale
    weight = np.where(known, (FREEDOM + 1) / (FREEDOM + scores**2), 0.0) * standing.weight
    design = slopes / scale[:, None]
    steps = np.clip(regress(design, scores, weight), -_FURTHEST, _FURTHEST)
    return steps, float((weight * (scores**2 - (scores - design @ steps) ** 2)).sum()) / 2


def regress(design: Floats, scores: Floats, weight: Floats) -> Floats:
    """Return the coefficients (k,) by weighted least squares of scores (n,) on a design (n, k), with a prior towards 0.
    Collinear columns share what they explain, however large it is.
    """
    root, count = np.sqrt(weight), design.shape[1]
    rows = np.vstack([root[:, None] * design, np.eye(count) / _PRIOR])
    return np.asarray(np.linalg.lstsq(rows, np.append(root * scores, np.zeros(count)), rcond=None)[0])


def _with_fitted(models: Models, settled: Models) -> Models:
    """Return `models` with the ordinary parameters of `settled`."""
    return {name: replace(model, fitted=settled[name].fitted) for name, model in models.items()}


def _prune(bench: Bench, standing: UnitState, state: _TrialState) -> _TrialState:
    """Return the trial without the axes that gain too little, unless that costs more. An amplitude of 0 on an axis
    removes the effect from it, but the offset of another range does not.
    """
    active = active_axes(state.hypothesis.trial)
    if len(active) < 2:
        return state
    gains = gains_of(standing, state.statistics.likelihood, state.statistics.shift) * state.hypothesis.counts
    touched = affected_mask(standing.likelihood, state.statistics.likelihood, state.statistics.shift)
    idle = {axis for axis in active if _most_of(gains, touched, _of_axis(bench, standing, axis)) < _AXIS_GAIN}
    if not idle or len(idle) == len(active):
        return state
    trial = state.hypothesis.trial
    fewer = replace(trial, effects=tuple(without(effect, idle) for effect in trial.effects))
    models = _with_fitted(standing.changed(fewer), state.statistics.settled)
    after = _simulate(bench, standing, fewer, models, len(state.statistics.values))
    return (
        after if after is not None and after.hypothesis.gain > state.hypothesis.gain - _AXIS_GAIN * len(idle) else state
    )


def _most_of(gains: Floats, touched: Booleans, is_of_axis: Booleans) -> float:
    """Return the gain in nats of an axis by all of its own statistics, or by those that the effect changes, if that is
    more: a hundred levels that deviate slightly for one reason cost a hundred times as much as one.
    """
    return max(float(gains[is_of_axis].sum()), float(gains[is_of_axis & touched].sum()))


def _of_axis(bench: Bench, standing: UnitState, axis: int) -> Booleans:
    """Return the mask of the unit's statistics that are of one axis."""
    columns = bench.own(standing.unit)
    return np.array([bench.keys[at].axis == AXES[axis] for at in columns], bool)
