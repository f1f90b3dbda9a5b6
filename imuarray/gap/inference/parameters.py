"""The free numbers of a trial, each changed by a factor, and the trial with them changed."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects import Hypothesis
from imuarray.simulate.effect import Effect

_SAME_FREE, _SAME = 0.2, 0.01
"""Relative difference of a refined and of a fixed number within which two trials are the same."""


class Factor(NamedTuple):
    """A free parameter of a trial's effect, or one number of it.

    `place` in its list, of an `axis` 0, 1, 2, with the number `turn` on that axis (a 3x3 response has three for each);
    None: it has no axes.
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
    """Return the trial with its factors times exp(steps); shares and probabilities stay below 1."""
    effects = list(trial.effects)
    for factor, step in zip(factors, steps.tolist(), strict=True):
        effects[factor.effect] = _scale(effects[factor.effect], factor, float(np.exp(step)), trial.limits)
    return replace(trial, effects=tuple(effects))


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
    """Return the trials except those that begin so near an earlier one that both would be refined
    to the same result.
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
    """Return all numbers and texts of the effects, and the relative difference within which each is the same."""
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
    """Return the axes on which the trial's first effect does something, if it has amplitudes by axis."""
    amplitudes = [getattr(trial.effects[0], name) for name in _amplitudes(trial.effects[0])] if trial.effects else []
    return [axis for axis in range(3) if any(value[axis] for value in amplitudes)]


def _amplitudes(effect: Effect) -> Iterator[str]:
    """Return parameters by axis that do nothing where they are 0."""
    return (item.name for item in fields(effect) if item.metadata.get("per_axis") and item.default == (0.0, 0.0, 0.0))


def without(effect: Effect, axes: set[int]) -> Effect:
    """Return the effect with nothing on these axes."""
    changes = {
        name: tuple(0.0 if axis in axes else item for axis, item in enumerate(getattr(effect, name)))
        for name in _amplitudes(effect)
    }
    return replace(effect, **changes)
