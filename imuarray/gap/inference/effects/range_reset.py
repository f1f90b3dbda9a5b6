"""`range_reset`: levels and noise scaled by sensitivities of the chip: always, in some boots, or from a row on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from imuarray.chips import CHIPS
from imuarray.gap.inference.effects.bias import RUN_TO_RUN, rarer
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.effects.levels import Onset, States, levels, log_levels, onsets, states_of_logs
from imuarray.gap.inference.effects.noise import with_noise
from imuarray.gap.inference.evidence import NATS_PER_NUMBER, Evidence, Span, stretches
from imuarray.simulate.effects.conversion import RangeReset
from imuarray.simulate.effects.timing import DroppedSamples

_WHOLE = ("force_own", "motion_gain", "thermal_slope", "code_ends", "saturated", "code_pile")
_LOGS = (*RUN_TO_RUN, "noise")
_WITHIN = ("noise_halves", "noise_uneven", "mean_halves", "wander", "arch", "kurtosis", "noise_excess", "mean_return")
_BEYOND = 2.7

_NEAR = 0.25
"""Largest difference between the log of a response and the log of a range's ratio of sensitivities."""

_FREE = ("offset", "noise_share", "probability")
_NOISE_SHARES = (0.1, 10.0)
_MOST = 3.0
"""Largest offset, as a multiple of the step of which it is a part."""

_SOON = 2.0
"""Rows that are lost within this many rows of the end of a stretch were lost while the chip was set up again."""

_OFFSET = 0.005
"""Scale of the differences between the offsets of ranges, as a share of the configured range; they have heavy tails."""

_NOISE_TOO = 0.3
"""Least change of the noise, as a share of the log of the ratio of sensitivities: part of the noise arises behind the
amplifier and does not change.
"""

_AS_CLEAR = 0.5
"""Least share of the clearest range's nats from which on a range is tried. The faces show which range it is, but a
slope over temperature that was fitted to the step too disturbs all of them.
"""

_HALF_WAY = 0.5
"""The noise of a log is that of another range if its logarithm has changed by more than this share of the change that
the other range causes.
"""

_RANGES = 2
"""Number of ranges that are tried: those that need the smallest offset and change of noise."""


def guess_range_reset(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest another range: always, by the response to force or motion; in some logs; while the recorder noticed that
    the chip had other settings; or from the row on at which level or noise change. The offset is the part of the level
    that the range does not explain, `noise_share` the part of the noise.
    """
    if evidence.header.chip not in CHIPS:
        return
    if evidence.is_odd(*_WHOLE, beyond=_BEYOND):
        yield from _always(evidence)
    if evidence.is_odd(*_LOGS, "motion_along", beyond=_BEYOND):
        yield from _by_logs(evidence)
    if evidence.resets and evidence.is_odd("doubt", *_WITHIN, beyond=_BEYOND):
        yield from _noticed(evidence)
    if evidence.is_odd(*_WITHIN, beyond=_BEYOND):
        yield from _within(evidence)


def _within(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a reset within a log, to each range whose step is about as clear as the clearest one. The ranges that
    need the smallest offset and change of noise are used. The noise must change as well (`_changes_noise`).
    """
    steps = {other: onsets(evidence, ratio) for other, ratio in _ratios(evidence).items()}
    guesses = [
        (guess, steps_of_range)
        for other, steps_of_range in steps.items()
        for guess in (_guesses(evidence, [steps_of_range[0].states]) if steps_of_range else ())
        if guess.effect.range == other and _changes_noise(evidence, guess, steps_of_range[0].states)
    ]
    least = _AS_CLEAR * max((steps_of_range[0].nats for _, steps_of_range in guesses), default=0.0)
    clear = [(guess, steps_of_range) for guess, steps_of_range in guesses if steps_of_range[0].nats >= least]
    for guess, steps_of_range in sorted(clear, key=lambda pair: pair[0].cost)[:_RANGES]:
        yield from _since(evidence, guess.effect, steps_of_range)


def _since(evidence: Evidence, first: RangeReset, steps: Sequence[Onset]) -> Iterator[Hypothesis]:
    """Suggest a reset in the log with the clearest step alone; one that lasts in the later logs too, because nothing
    sets the chip up again; and resets in all logs with a step that the same range explains.
    """
    clearest, *more = steps
    alone = replace(first, onset_s=clearest.onset_s, run=float(clearest.log))
    others = [
        replace(guess.effect, onset_s=step.onset_s, run=float(step.log))
        for step in more
        for guess in _cheapest(_guesses(evidence, [step.states]))
        if guess.effect.range == first.range
    ]
    if others:
        yield Hypothesis((alone, *others))
    later = sorted({float(phase.log) for phase in evidence.phases if phase.log > clearest.log})
    if later:
        yield Hypothesis((alone, replace(first, runs=tuple(later))), _FREE[:2], begin_bounds_s=clearest.begin_bounds_s)
    yield Hypothesis((alone,), _FREE[:2], begin_bounds_s=clearest.begin_bounds_s)


def _just_in(evidence: Evidence, states: States, logs: Sequence[int]) -> Iterator[Hypothesis]:
    """Suggest a reset in these logs alone, all of which may belong to one part of the data.

    The noise must change as well (`_changes_noise`). The level and noise of the sensor are those of the other logs.
    """
    others = [phase.residual for phase in evidence.still if phase.log not in logs and phase.raw.rows]
    level = np.median([np.nanmean(phase.segments.mean, axis=0) for phase in others], axis=0)
    x, y, z = (evidence.fitted.offset + level / evidence.header.sensitivity).tolist()
    usual = with_noise(evidence, np.log(states.noise_before / evidence.noise))
    for guess in _cheapest(_guesses(evidence, [states])):
        if _changes_noise(evidence, guess, states):
            effect = replace(guess.effect, runs=tuple(map(float, logs)))
            rarity = NATS_PER_NUMBER * len(logs) + _unlike(evidence, guess.size)
            yield Hypothesis((effect,), whole=True, rarity=rarity, fitted=replace(usual, offset=(x, y, z)))


def _by_logs(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a reset in the logs with the rarer of two levels, with a probability per boot and in these logs alone;
    and in the logs whose response or noise is that of another range.
    """
    logs, means, errors = log_levels(levels(evidence))
    rare = rarer(means, errors) if len(means) > 1 else None
    by_level: list[int] = [] if rare is None else logs[rare].tolist()
    if rare is not None and (states := states_of_logs(evidence, rare)) is not None:
        yield from _in_some_boots(evidence, states, float(rare.mean()))
        yield from _just_in(evidence, states, by_level)
    still = sorted({phase.log for phase in evidence.still})
    for by_response in sorted(_logs_by_response(evidence) - {tuple(by_level)}):
        is_other = np.isin(still, by_response)
        if 0 < is_other.sum() < len(still) and (states := states_of_logs(evidence, is_other)) is not None:
            yield from _just_in(evidence, states, by_response)


def _logs_by_response(evidence: Evidence) -> set[tuple[int, ...]]:
    """Return, for each other range, the logs whose response to motion, or else whose noise, is that of the range.
    Levels are not used, because they differ between logs for other reasons (faces, turn-on bias).
    """
    responses = {log: value for log, value in _by_log(evidence, "motion_along").items() if value > 0}
    noises = _by_log(evidence, "noise")
    logs_of_ranges = set()
    for log_ratio in map(np.log, _ratios(evidence).values()):
        usual = max(noises.values(), default=0.0) if log_ratio < 0 else min(noises.values(), default=0.0)
        is_other = {log: (noise - usual) / log_ratio > _HALF_WAY for log, noise in noises.items()}
        is_other |= {log: abs(np.log(response) - log_ratio) < _NEAR for log, response in responses.items()}
        logs_of_ranges.add(tuple(sorted(log for log, is_range in is_other.items() if is_range)))
    return logs_of_ranges


def _by_log(evidence: Evidence, probe: str) -> dict[int, float]:
    """Return the median of a probe over the phases and axes of each log in which it is known."""
    values = evidence.values.get(probe, np.zeros((0, 1)))
    logs = np.array(evidence.rows_of.get(probe, ()))
    rows = {int(log): values[logs == log] for log in np.unique(logs)}
    return {log: float(np.nanmedian(of_log)) for log, of_log in rows.items() if np.isfinite(of_log).any()}


def _noticed(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest resets in the stretches that the recorder noticed, however short. The range is the one that maps the
    readings before to those within a stretch, or the configured one if the chip lost another setting. Rows that were
    lost while the chip was set up again are part of the hypothesis.
    """
    resets = [reset for _, reset in evidence.resets]
    scale = evidence.header.sensitivity
    sides = [
        States(*(side / scale for side in (reset.before, reset.within, reset.noise_before, reset.noise_within)))
        for reset in resets
    ]
    row_s = 1 / evidence.rows_per_s
    lost = [
        hole
        for hole in evidence.holes
        if any(log == hole.log and abs(reset.end_s - hole.moment_s) < _SOON * row_s for log, reset in evidence.resets)
    ]
    known = stretches([Span(log, reset.moment_s, reset.end_s - reset.moment_s) for log, reset in evidence.resets])
    doubts_s = tuple(reset.moment_s - reset.doubt_s for reset in resets)
    missing = DroppedSamples(**stretches(lost))
    numbers = NATS_PER_NUMBER * (len(resets) + len(lost))
    ratios = {evidence.header.range: 1.0, **_ratios(evidence)}
    candidates = [(_unlike(evidence, guess.size), guess.effect) for guess in _guesses(evidence, sides, ratios)]
    for rarity, effect in sorted(candidates, key=lambda candidate: candidate[0])[
        :_RANGES
    ]:  # sorted by the offset alone: so few readings do not determine the noise
        reset_effect = replace(effect, **known, doubts_s=doubts_s, blanks_s=tuple(reset.blank_s for reset in resets))
        effects = (reset_effect, *([missing] if lost else []))
        yield Hypothesis(effects, whole=True, rarity=numbers + rarity)


def _unlike(evidence: Evidence, size: float) -> float:
    """Return the nats by which an offset of this size is rarer than none. A wrong range needs another offset."""
    return float(np.log1p((size / (_OFFSET * evidence.header.range)) ** 2))


def _ratios(evidence: Evidence) -> dict[float, float]:
    """Return the ratio of each other range's counts per unit to those of the configured range."""
    header = evidence.header
    sensitivities = CHIPS[header.chip].sensitivity
    return {
        other: sensitivity / header.sensitivity
        for other, sensitivity in sensitivities.items()
        if other != header.range and abs(sensitivity / header.sensitivity - 1) > 1e-3
    }


def _always(evidence: Evidence) -> Iterator[Hypothesis]:
    ratios = []
    if evidence.header.quantity == "specific_force":
        ratios.append(1 + float(np.nanmedian(evidence.typical("force_own"))))
    if "motion_gain" in evidence.values:
        ratios.append(float(np.nanmedian(np.append(evidence.values["motion_gain"], 1.0))))
    for other, ratio in _ratios(evidence).items():
        if any(level_shown > 0 and abs(np.log(level_shown / ratio)) < _NEAR for level_shown in ratios):
            yield Hypothesis((RangeReset(range=other),))


class _Guess(NamedTuple):
    """A guess with its cost and the root mean square of the offsets that the pairs of sides require."""

    cost: float
    size: float
    effect: RangeReset


def _in_some_boots(evidence: Evidence, states: States, probability: float) -> Iterator[Hypothesis]:
    """Suggest a range after some boots, by the levels before and after, r (x + offset), and the noises, which must
    change as well (`_changes_noise`).
    """
    free = _FREE if probability < 1 else _FREE[:2]
    for guess in _cheapest(_guesses(evidence, [states])):
        if not _changes_noise(evidence, guess, states):
            continue
        yield Hypothesis((replace(guess.effect, probability=probability),), free)


def _changes_noise(evidence: Evidence, guess: _Guess, states: States) -> bool:
    """Return whether the noise changes as that of the guessed range does. A bias does not change it: an offset and a
    share of the noise that compensate the other range resemble every step of a bias.
    """
    ratio = _ratios(evidence)[guess.effect.range]
    changed = np.log(states.noise_after / states.noise_before) / np.log(ratio)
    return bool(changed.min() > _NOISE_TOO)


def _guesses(
    evidence: Evidence, sides: Sequence[States], ratios: Mapping[float, float] | None = None
) -> Iterator[_Guess]:
    """Yield a guess for each range of `ratios` (default: the other ranges), with the median over all pairs of sides of
    the offset and noise that the range leaves unexplained.
    """
    step = float(np.median([np.linalg.norm(side.after - side.before) for side in sides]))
    for other, ratio in (_ratios(evidence) if ratios is None else ratios).items():
        offsets = np.array([side.after / ratio - side.before for side in sides])
        offset = np.median(offsets, axis=0)
        shares = np.array([side.noise_after / (ratio * side.noise_before) for side in sides])
        known = shares[np.isfinite(shares).all(axis=1)]
        share = np.median(known, axis=0) if len(known) else np.ones(3)
        if not ((share > _NOISE_SHARES[0]) & (share < _NOISE_SHARES[1])).all():
            continue
        size = float(np.sqrt(np.mean(np.square(offsets).sum(axis=1))))  # a wrong range needs another offset per face
        if size > _MOST * step:
            continue
        (x, y, z), (a, b, c) = offset.tolist(), share.tolist()
        cost = size / max(step, 1e-9) + float(np.abs(np.log(share)).mean())
        yield _Guess(cost, size, RangeReset(other, (x, y, z), (a, b, c)))


def _cheapest(candidates: Iterable[_Guess]) -> list[_Guess]:
    return sorted(candidates, key=lambda guess: guess.cost)[:_RANGES]
