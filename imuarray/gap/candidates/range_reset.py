"""`range_reset`: levels and noise scaled by sensitivities of the chip: always, in some boots, or from a row on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.chips import CHIPS
from imuarray.gap.candidates.bistable_bias import rarer
from imuarray.gap.candidates.candidate import Candidate, Trial
from imuarray.gap.candidates.levels import levels, log_levels
from imuarray.gap.candidates.removal import with_removal
from imuarray.gap.candidates.steps import Onset, States, onsets, states_of_logs
from imuarray.gap.evidence import Evidence
from imuarray.simulate.effects.range_reset import RangeReset

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

_WHOLE = ("force_own", "motion_gain", "thermal_slope", "code_ends", "saturated", "code_pile")
_LOGS = ("run_spread", "run_scatter", "run_two_states", "run_outlier", "mean", "noise")
_WITHIN = ("noise_halves", "noise_uneven", "mean_halves", "wander", "arch", "kurtosis", "noise_excess", "mean_return")
_BEYOND = 2.7

_NEAR = 0.25
"""A response is that of another range if its log is as near to that of the ratio of sensitivities."""

_FREE = ("offset", "noise_share", "probability")
_NOISE_SHARES = (0.1, 10.0)
_MOST = 3.0
"""An offset is not larger than so many times the step that it takes part in."""

_RANGES = 2
"""So many ranges are tried, those that need the smallest offset and change of noise."""


def guesses(evidence: Evidence) -> Iterator[Trial]:
    """Another range always, by the response to force or motion; in some logs, or from the row on at which level or
    noise change: the offset is what the range leaves of the level, `noise_share` what it leaves of the noise.
    """
    yield from with_removal(evidence, RangeReset.name, _found(evidence))


def _found(evidence: Evidence) -> Iterator[Trial]:
    if evidence.header.chip not in CHIPS:
        return
    if evidence.is_odd(*_WHOLE, beyond=_BEYOND):
        yield from _always(evidence)
    if evidence.is_odd(*_LOGS, beyond=_BEYOND):
        _, means, errors = log_levels(levels(evidence))
        rare = rarer(means, errors) if len(means) > 1 else None
        if rare is not None and (states := states_of_logs(evidence, rare)) is not None:
            yield from _reset(evidence, states, 0.0, float(rare.mean()))
    if evidence.is_odd(*_WITHIN, beyond=_BEYOND) and (found := onsets(evidence)):
        yield from _within(evidence, found)


def _within(evidence: Evidence, found: Sequence[Onset]) -> Iterator[Trial]:
    """A reset in the log with the clearest step; and in all others in which the same range is left of one."""
    clearest, *more = found
    for trial in _reset(evidence, clearest.states, 0.0, 1.0):
        (first,) = (effect for effect in trial.effects if isinstance(effect, RangeReset))
        alone = replace(first, onset_s=clearest.onset_s, run=float(clearest.log))
        others = [
            replace(effect, onset_s=one.onset_s, run=float(one.log))
            for one in more
            for other in _reset(evidence, one.states, 0.0, 1.0)
            for effect in other.effects
            if isinstance(effect, RangeReset) and effect.range == first.range
        ]
        if others:
            yield Trial((alone, *others))
        yield replace(trial, effects=(alone,))


def _ratios(evidence: Evidence) -> dict[float, float]:
    """Counts per unit of the other ranges over those of the one that is configured."""
    header = evidence.header
    sensitivities = CHIPS[header.chip].sensitivity
    return {
        other: sensitivity / header.sensitivity
        for other, sensitivity in sensitivities.items()
        if other != header.range and abs(sensitivity / header.sensitivity - 1) > 1e-3
    }


def _always(evidence: Evidence) -> Iterator[Trial]:
    shown = []
    if evidence.header.quantity == "specific_force":
        shown.append(1 + float(np.nanmedian(evidence.typical("force_own"))))
    if "motion_gain" in evidence.values:
        shown.append(float(np.nanmedian(np.append(evidence.values["motion_gain"], 1.0))))
    for other, ratio in _ratios(evidence).items():
        if any(one > 0 and abs(np.log(one / ratio)) < _NEAR for one in shown):
            yield Trial((RangeReset(range=other),))


class _Guess(NamedTuple):
    cost: float
    trial: Trial


def _reset(evidence: Evidence, states: States, onset_s: float, probability: float) -> Iterator[Trial]:
    """By the levels and noises before and after, of the true ones: r (x + offset), r share noise."""
    found: list[_Guess] = []
    free = _FREE if probability < 1 else _FREE[:2]
    for other, ratio in _ratios(evidence).items():
        offset = states.after / ratio - states.before
        share = states.noise_after / (ratio * states.noise_before)
        if not ((share > _NOISE_SHARES[0]) & (share < _NOISE_SHARES[1])).all():
            continue
        step, size = float(np.linalg.norm(states.after - states.before)), float(np.linalg.norm(offset))
        if size > _MOST * step:
            continue
        cost = size / step + float(np.abs(np.log(share)).mean())
        (x, y, z), (a, b, c) = offset.tolist(), share.tolist()
        effect = RangeReset(other, (x, y, z), (a, b, c), onset_s, probability)
        found.append(_Guess(cost, Trial((effect,), free)))
    for guess in sorted(found, key=lambda one: one.cost)[:_RANGES]:
        yield guess.trial


RANGE_RESET = Candidate(
    RangeReset.name,
    guesses,
    {
        "tumble": "all six faces, 1 minute each",
        "turn-on": "20 boots of 1 minute",
        "static": "still for an hour, on a face that the sensor's z axis feels",
        "motion": "turns and strokes along every axis, 1 minute",
    },
)
