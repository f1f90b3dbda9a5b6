"""Causes in words and numbers: what the search took, how probable each is, what else would explain as much."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from imuarray.gap.findings.closure import DeviatingStatistics, deviating, deviating_in_either
from imuarray.gap.findings.diagnosis import Cause, Judged, Origin
from imuarray.gap.findings.verdict import calibrated_probability
from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.inference.forward_selection import Evaluation, Round
from imuarray.gap.inference.unit_state import Unit, UnitState
from imuarray.gap.model.bench import Bench
from imuarray.gap.model.replication import SensorModel
from imuarray.gap.model.rest import REFERENCE_DEGC
from imuarray.gap.statistics.catalogue import AXES
from imuarray.log.format import SensorHeader
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.thermal_bias import ThermalBias
from imuarray.simulate.parameters import to_table

TEMPER = 0.3
"""The log odds of a trial count so much in its probability."""

ALTERNATIVE = 0.1
"""An effect that is less probable than that is not told as a cause."""

LEAST = 0.03
"""What closes no more than that of what was left is no cause of the gap, though the sensor may have it."""

CONFUSABLE = 0.05
"""Odds, against the cause that was taken, from which on an effect is confusable with it: 1 to 20."""

_SAME, _SAME_FREQUENCY = 1.25, 1.01
"""Parameters of two sensors within that factor are the same; lines are told apart more finely."""

_METADATA = frozenset({"axis_error", "channel_swap", "clock_error"})
"""Causes that lie in what is said of a log, or of the array, and not in a sensor."""


def probabilities(one: Round, beside: Collection[str] = ()) -> list[float]:
    """Of each trial that was confirmed, the rest being that it is none of them; effects that are there `beside` it are
    no rivals, and have none.
    """
    odds = TEMPER * np.array([*one.log_odds, 0.0])
    rivals = np.array([*(trial.trial.name not in beside for trial in one.confirmed), True])
    weights = np.where(rivals, np.exp(odds - odds.max(initial=0.0, where=rivals)), 0.0)
    return list((weights / weights.sum())[:-1].tolist())


def causes_of(bench: Bench, rounds: Mapping[Unit, Sequence[Round]], seed: int) -> tuple[Cause, ...]:
    """All causes, most probable first; the same one in several sensors of a chip is told once."""
    single = [cause for unit, own in rounds.items() for cause in _of_unit(bench, unit, own, seed)]
    merged = [
        replace(one, probability=calibrated_probability(one.share, one.all_closed)) for one in _merged(bench, single)
    ]
    return tuple(sorted(merged, key=lambda cause: (-cause.probability, -cause.gain)))


def judged_of(rounds: Mapping[Unit, Sequence[Round]]) -> tuple[Judged, ...]:
    """Everything that was confirmed, and the placebos."""
    found = []
    for unit, own in rounds.items():
        for one in own:
            found += [
                Judged(trial.trial.name, trial.trial.action, unit, trial.train_gain, trial.gain, trial is one.taken)
                for trial in one.confirmed
            ]
        if own[0].confirmed:
            found.append(Judged("", "add", unit, math.nan, own[0].placebo_gain, False))
    return tuple(found)


def _of_unit(bench: Bench, unit: Unit, rounds: Sequence[Round], seed: int) -> Iterator[Cause]:
    """What the rounds took and what of it stayed, each with what else was likely."""
    first = rounds[0].before
    all_closed = _all_closed(bench, first, rounds, seed)
    taken = {one.taken.trial.name for one in rounds if one.taken is not None}
    for number, one in enumerate(rounds):
        if one.taken is None or _is_undone(one.taken, rounds[number + 1 :]):
            continue
        by_name: dict[str, tuple[float, Evaluation]] = {}
        beside = taken - {one.taken.trial.name}
        for chance, trial in zip(probabilities(one, beside), one.confirmed, strict=True):
            before = by_name.get(trial.trial.name, (0.0, trial))
            by_name[trial.trial.name] = (before[0] + chance, trial if trial is one.taken else before[1])
        own = by_name[one.taken.trial.name][0]
        likely = {name for name, (chance, _) in by_name.items() if chance > CONFUSABLE * own}
        for name, (chance, trial) in by_name.items():
            if name in beside:
                continue
            if (trial is one.taken or chance > ALTERNATIVE) and not _undoes(trial, one.before):
                cause = _cause(bench, unit, first, one.before, trial, chance, tuple(sorted(likely - {name})), seed)
                if cause.closed is None or cause.closed > LEAST:
                    yield replace(cause, all_closed=all_closed)


def _all_closed(bench: Bench, first: UnitState, rounds: Sequence[Round], seed: int) -> float | None:
    """The share of a unit's gap that is closed by everything that was taken."""
    taken = [one.taken for one in rounds if one.taken is not None]
    last = taken[-1].standing if taken else first
    in_either = bool(taken) and all(one.trial.needs_both for one in taken)
    before, after = (_deviating(bench, first, one, in_either) for one in (first, last))
    return replace(before, after=after.after).shrunk(seed).closed


def _is_undone(taken: Evaluation, later: Sequence[Round]) -> bool:
    """Whether a later round took the effect out again, or put another of its kind in its place."""
    return any(one.taken is not None and one.taken.trial.removed == taken.trial.name for one in later)


def _undoes(trial: Evaluation, before: UnitState) -> bool:
    """Whether it only takes out what an earlier round put in."""
    added = {effect.name for model in before.models.values() for effect in model.added}
    return not trial.trial.effects and trial.trial.removed in added


def _cause(
    bench: Bench,
    unit: Unit,
    first: UnitState,
    before: UnitState,
    taken: Evaluation,
    share: float,
    confusable: tuple[str, ...],
    seed: int,
) -> Cause:
    counted = _deviating(bench, first, before, taken.trial.needs_both)
    with_it = _deviating(bench, first, taken.standing, taken.trial.needs_both)
    shrunk = replace(counted, before=counted.after, after=with_it.after).shrunk(seed)
    effect = taken.trial.effects[0] if taken.trial.effects else None
    own, others = taken.trial.sensor, taken.trial.others if taken.trial.opposite else ()
    sensors = (own, *others) if own else taken.trial.members or unit
    effects = dict.fromkeys(sensors, effect) | dict.fromkeys(others, next(iter(taken.trial.opposite), None))
    models = taken.standing.models
    whole = {name: _with_fitted(one, models.get(name)) if one else None for name, one in effects.items()}
    each = {name: to_table(one, bench.base.headers[name].unit) if one else {} for name, one in whole.items()}
    return Cause(
        taken.trial.name,
        taken.trial.action,
        sensors,
        _axes(effect),
        share,
        each[sensors[0]],
        shrunk.closed,
        shrunk.interval,
        confusable,
        _origin(taken.trial),
        taken.gain,
        each,
        taken.trial.needs_both,
        share,
    )


def _with_fitted(effect: Effect, model: SensorModel | None) -> Effect:
    """A `thermal_bias` with the slope that is fitted to every sensor: what it adds to that tells nobody anything."""
    if model is None or not isinstance(effect, ThermalBias) or effect.reference_degc != REFERENCE_DEGC:
        return effect
    x, y, z = np.add(effect.slope, model.fitted.slope).tolist()
    return replace(effect, slope=(x, y, z))


def _deviating(bench: Bench, first: UnitState, then: UnitState, in_either: bool) -> DeviatingStatistics:
    """What deviated of a unit at first, with its scores then; of both parts if one may not show it."""
    pairs = bench.pairs(bench.own(first.unit))
    if in_either:
        return deviating_in_either(pairs, first.scores, then.scores)
    return deviating(pairs, first.scores, then.scores, first.likelihood.is_silent)


def _axes(effect: Effect | None) -> tuple[str, ...]:
    """The axes on which an effect acts; none if on all, or if it has no axes."""
    if effect is None:
        return ()
    idle = type(effect)()
    active = [False] * 3
    for name, item in type(effect).__dataclass_fields__.items():
        if item.metadata.get("per_axis"):
            pairs = zip(getattr(effect, name), getattr(idle, name), strict=True)
            active = [on or value != default for on, (value, default) in zip(active, pairs, strict=True)]
    return () if all(active) or not any(active) else tuple(axis for axis, on in zip(AXES, active, strict=True) if on)


def _origin(trial: Hypothesis) -> Origin:
    effect = trial.effects[0] if trial.effects else None
    from_boot = (
        trial.name == "range_reset"
        and getattr(effect, "onset_s", 1.0) <= 0
        and getattr(effect, "probability", 0.0) >= 1
    )
    return "metadata" if trial.name in _METADATA or trial.everywhere or from_boot else "sensor"


def _merged(bench: Bench, causes: Sequence[Cause]) -> list[Cause]:
    """Causes that are the same in several sensors of a chip, joined."""
    kept: list[Cause] = []
    for cause in causes:
        twin = next((at for at, other in enumerate(kept) if _is_same(bench.base.headers, other, cause)), None)
        if twin is None:
            kept.append(cause)
        else:
            kept[twin] = _joined(kept[twin], cause)
    return kept


def _is_same(headers: Mapping[str, SensorHeader], one: Cause, other: Cause) -> bool:
    chips = {headers[name].chip for name in (*one.sensors, *other.sensors)}
    is_same_effect = (one.effect, one.action, one.axes) == (other.effect, other.action, other.axes)
    return (
        is_same_effect
        and len(chips) == 1
        and not set(one.sensors) & set(other.sensors)
        and _agree(one.parameters, other.parameters)
    )


def _agree(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    if one.keys() != other.keys():
        return False
    for key, value in one.items():
        first, second = np.atleast_1d(value), np.atleast_1d(other[key])
        if first.dtype.kind not in "if" or second.dtype.kind not in "if":
            if value != other[key]:
                return False
            continue
        if len(first) != len(second) and 1 not in (len(first), len(second)):
            return False  # lists of events, of which one sensor had more
        first, second = np.broadcast_arrays(first.astype(float), second.astype(float))
        finite = np.isfinite(first)  # an axis without a limit has an infinite one
        if (finite != np.isfinite(second)).any():
            return False
        first, second = first[finite], second[finite]
        largest = np.fmax(np.abs(first), np.abs(second))
        factor = _SAME_FREQUENCY if "frequency" in key else _SAME
        if (np.abs(first - second) > (factor - 1) * largest).any():
            return False
    return True


def _joined(one: Cause, other: Cause) -> Cause:
    """Two that are the same: odds are multiplied, shares closed weighed by what they gain."""
    odds = [cause.share / max(1 - cause.share, 1e-9) for cause in (one, other)]
    both = odds[0] * odds[1]
    return replace(
        one,
        sensors=(*one.sensors, *other.sensors),
        share=max(one.share, other.share, both / (1 + both)),
        all_closed=_mean(one.all_closed, other.all_closed, len(one.sensors)),
        closed=_mean(one.closed, other.closed, len(one.sensors)),
        closed_ci95=_widest(one, other),
        confusable_with=tuple(sorted({*one.confusable_with} & {*other.confusable_with})),
        gain=one.gain + other.gain,
        each={**one.each, **other.each},
        needs_both=one.needs_both or other.needs_both,
    )


def _mean(one: float | None, other: float | None, weight: int) -> float | None:
    if one is None or other is None:
        return one if other is None else other
    return (weight * one + other) / (weight + 1)


def _widest(one: Cause, other: Cause) -> tuple[float, float] | None:
    known = [cause.closed_ci95 for cause in (one, other) if cause.closed_ci95 is not None]
    return (min(low for low, _ in known), max(high for _, high in known)) if known else None
