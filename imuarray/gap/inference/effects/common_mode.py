"""`common_mode`: slow drift that correlates between the units of a chip along their own axes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.in_motion import takes_part
from imuarray.gap.inference.effects.levels import change_between_logs
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.slow import (
    TRACES,
    Wander,
    longest_s,
    over_logs,
    sized,
    slower,
    wander_of,
    within,
)
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence, Spell
from imuarray.gap.statistics.cross import Cross
from imuarray.simulate.effects.bias import CommonMode, TurnOnBias
from imuarray.simulate.signal import Triple

_TRACES = ("slow_own_axes", "fast_own_axes", "slow_between_axes")
_FREE = ("rms", "time_constant_s")
_BEYOND = 2.7
_APART, _ALIKE = 5.0, 1.5
_FOR_EVER_S = 1e6
_LEAST_DEGC = 1.0
_LEAST = 4
_SPELLS = 4
"""Most spells in which a common course is tried."""

_PAIRED = 5.0
"""Standard deviations by which two units have something in common that others needn't have."""

_WHITE_S = 1e-3
"""Time constant of what one reading has in common with another's, and not with the next: no unit is read as often."""

_PERFECT = 0.999
_TINY = 1e-30


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Its size by the covariance with the other units of the chip, of slow means and of what is faster, temperature
    and straight lines taken out; its time constant by that of the sensor's wander, in logs and between them, another
    one slower; or all of this wander. Of two logs, what they differ by, constant within each: alone, and with what the
    others don't share of it. What lasts within a log is tried in the spells of the sensor, too.
    """
    always = list(_hypotheses(evidence))
    during = [_during(trial, spell, evidence) for spell in evidence.spells[:_SPELLS] for trial in always]
    yield from with_removal(evidence, CommonMode.name, [*always, *(trial for trial in during if trial is not None)])


def _during(trial: Hypothesis, spell: Spell, evidence: Evidence) -> Hypothesis | None:
    """Return the trial in a spell, the larger the less of the time that takes; None for what changes between logs."""
    share = sum(phase.raw.rows for phase in spell.phases) / max(sum(phase.raw.rows for phase in evidence.still), 1)
    if trial.needs_both or not 0 < share < 1:
        return None
    effects = [
        replace(effect, rms=_scale(effect.rms, 1 / math.sqrt(share))) if isinstance(effect, CommonMode) else effect
        for effect in trial.effects
    ]
    return replace(trial, effects=tuple(effects)).at(spell.when)


def _scale(rms: Triple, by: float) -> Triple:
    x, y, z = rms
    return x * by, y * by, z * by


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    yield from _between_logs(evidence)
    yield from _slow_or_fast(evidence)
    yield from _in_pairs(evidence)


def _slow_or_fast(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*_TRACES, beyond=_BEYOND):
        return
    pairs = [
        (phase, phase.cross)
        for phase in evidence.still
        if phase.cross is not None and takes_part(evidence, phase.cross)
    ]
    partners = pairs[0][1].others(evidence.header.name, family=True) if pairs else ()
    if not partners:
        return
    wander, over = wander_of(evidence), over_logs(evidence)
    for time_s in _times_s(evidence, wander, over):
        rms = np.sqrt(np.maximum(_variance(pairs, evidence.header.name, partners, time_s), 0.0))
        if rms.any():
            x, y, z = np.where(rms < rms.max() / 5, 0.0, rms).tolist()
            yield Hypothesis((CommonMode((x, y, z), time_s),), _FREE, shared=True)
    score = evidence.score(*TRACES)
    for process in (None if wander is None else slower(evidence, wander), over):
        if process is not None:  # few values of a slow process are independent: a covariance says little
            for sizes in sized(process.rms, score):
                yield Hypothesis((CommonMode(sizes, process.time_constant_s),), _FREE, shared=True)


class _Common(NamedTuple):
    """Covariances (3, 3) of two sensors, a row for each axis of the first one: of the means of windows within segments
    (`fast`), whose standard scores follow, and of the means of segments (`slow`).
    """

    fast: Floats
    slow: Floats
    score: Floats

    @property
    def own(self) -> float:
        """Score of what the same axes have in common."""
        return float(np.trace(self.score) / math.sqrt(3))

    @property
    def across(self) -> float:
        """Score of what each axis has in common with the other two."""
        return float((self.score.sum() - np.trace(self.score)) / math.sqrt(6))


def _in_pairs(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the noise that some units have in common, from one reading to the next: those of any chip that measure
    the same, with which a unit has more in common than chance makes, each pair by itself; axis by axis, or all axes
    alike.
    """
    pairs = [
        (phase, phase.cross)
        for phase in evidence.still
        if phase.cross is not None and takes_part(evidence, phase.cross)
    ]
    partners = pairs[0][1].others(evidence.header.name, family=False) if pairs else ()
    common = {partner: _common([cross for _, cross in pairs], evidence.header.name, partner) for partner in partners}
    if not pairs:
        return
    rows = evidence.rows_per_s * float(np.median([cross.window_s for _, cross in pairs]))
    length_s = float(np.median([1e-9 * (cross.phase.end_ns - cross.phase.start_ns) for _, cross in pairs]))
    wander = wander_of(evidence)
    for shared in (0.0, 1.0):
        together = {
            name: covariance
            for name, covariance in common.items()
            if (covariance.across if shared else covariance.own) > _PAIRED
        }
        if not together or (not shared and any(covariance.across > _PAIRED for covariance in together.values())):
            continue
        members = tuple(sorted((evidence.header.name, *together)))
        group = "+".join(members)
        fast, slow = (
            np.mean([getattr(covariance, pace) for covariance in together.values()], axis=0)
            for pace in ("fast", "slow")
        )
        if any(rms := _each(fast * max(rows, 1.0), shared)):
            effect = CommonMode(rms, _WHITE_S, shared, group)
            yield Hypothesis((effect,), ("rms",), shared=True, members=members)
        for time_s in () if wander is None else (wander.time_constant_s, slower(evidence, wander).time_constant_s):
            if any(rms := _each((fast + slow) / within(length_s, time_s), shared)):
                yield Hypothesis((CommonMode(rms, time_s, shared, group),), _FREE, shared=True, members=members)


def _each(covariance: Floats, shared: float) -> Triple:
    """Sizes by axis of what two sensors have in common alike, by its covariances (3, 3)."""
    if shared:
        x, y, z = (covariance.sum(axis=1).clip(0) / math.sqrt(max(float(covariance.sum()), _TINY))).tolist()
    else:
        x, y, z = np.sqrt(np.diag(covariance).clip(0)).tolist()
    return x, y, z


def _common(crosses: Sequence[Cross], sensor: str, partner: str) -> _Common:
    """Return what two sensors have in common over the phases. The score of a correlation r of n windows is artanh(r)
    sqrt(n).
    """
    fast, slow, scores, weights = [], [], [], []
    for cross in crosses:
        if not any(item.name == partner for item in cross.sensors) or not cross.windows:
            continue
        columns, other_columns = cross.columns(sensor), cross.columns(partner)
        size = np.sqrt(np.outer(np.diag(cross.fast)[columns], np.diag(cross.fast)[other_columns]))
        ratio = np.divide(cross.fast[columns, other_columns], size, out=np.zeros((3, 3)), where=size > 0)
        scores.append(np.arctanh(ratio.clip(-_PERFECT, _PERFECT)) * math.sqrt(cross.windows))
        fast.append(cross.fast[columns, other_columns])
        slow.append(np.nan_to_num(cross.slow_covariance[columns, other_columns]))
        weights.append(cross.windows)
    if not weights:
        return _Common(*np.zeros((3, 3, 3)))
    mean_fast, mean_slow = (np.average(each, axis=0, weights=weights) for each in (fast, slow))
    return _Common(mean_fast, mean_slow, np.sum(scores, axis=0) / math.sqrt(len(scores)))


def _times_s(evidence: Evidence, wander: Wander | None, over: Wander | None) -> list[float]:
    """Return the time constants that are apart, by how the sensor itself wanders in logs, and between them."""
    first_s = wander.time_constant_s if wander is not None else longest_s(evidence) / 10
    times_s = [first_s, min(_APART * first_s, 3 * longest_s(evidence))]
    if over is not None:
        times_s.append(over.time_constant_s)
    distinct_s: list[float] = []
    for time_s in times_s:
        if all(max(time_s / other, other / time_s) > _ALIKE for other in distinct_s):
            distinct_s.append(time_s)
    return distinct_s


def _between_logs(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a change of level that the others share, and the sensor's difference from it as a turn-on bias."""
    change = change_between_logs(evidence)
    if not change.any():
        return
    individual = np.where(np.abs(evidence.score("level_apart")) > _BEYOND, evidence.shift("level_apart"), 0.0)
    common = np.where(change == 0, 0.0, change - individual)
    if not common.any():
        return
    a, b, c = (np.abs(common) / np.sqrt(2)).tolist()
    shared = CommonMode((a, b, c), _FOR_EVER_S)
    yield Hypothesis((shared,), shared=True, whole=True)
    if individual.any():
        x, y, z = (np.abs(individual) / np.sqrt(2)).tolist()
        yield Hypothesis((shared, TurnOnBias((x, y, z))), shared=True, whole=True)


def _variance(
    pairs: Sequence[tuple[PhaseEvidence, Cross]], sensor: str, partners: Sequence[str], time_constant_s: float
) -> Floats:
    """Return (3,) mean covariance over phases and partners, axis by axis along the chips' own, over what phases, about
    their means, show of a process of this time constant.
    """
    covariances, shares, weights = [], [], []
    for phase, cross in pairs:
        levels = _slow(phase, cross, sensor)
        known = np.isfinite(levels).all(axis=1)
        if known.sum() < _LEAST:
            continue
        slow = [np.mean((levels * _slow(phase, cross, partner))[known], axis=0) for partner in partners]
        fast = [np.diag(cross.fast[cross.columns(sensor), cross.columns(partner)]) for partner in partners]
        covariances.append(np.mean(slow, axis=0) + np.nan_to_num(np.mean(fast, axis=0)))
        shares.append(within(1e-9 * (cross.phase.end_ns - cross.phase.start_ns), time_constant_s))
        weights.append(len(levels))
    if not covariances:
        return np.zeros(3)
    return np.asarray(np.average(covariances, axis=0, weights=weights) / np.average(shares, weights=weights))


def _slow(phase: PhaseEvidence, cross: Cross, sensor: str) -> Floats:
    """Return (s, 3) means less their mean, and less what follows the temperature if it changes."""
    means, part = cross.slow[:, cross.columns(sensor)], phase.raw.segments
    known, is_usable = np.isfinite(means).all(axis=1), np.isfinite(part.time_s) & np.isfinite(part.temperature_degc)
    if not known.any() or not is_usable.any():
        return means
    design = np.ones((len(means), 1))
    if np.ptp(part.temperature_degc[is_usable]) > _LEAST_DEGC:
        at = np.linspace(part.time_s[is_usable][0], part.time_s[is_usable][-1], len(means))
        degc = np.interp(at, part.time_s[is_usable], part.temperature_degc[is_usable])
        design = np.stack([np.ones_like(degc), degc - degc.mean()], axis=1)
    return np.asarray(means - design @ np.linalg.lstsq(design[known], means[known], rcond=None)[0])


COMMON_MODE = Candidate(
    CommonMode.name,
    guesses,
    {"static": "all units of the chip, two of them anti-parallel, still for an hour at one temperature"},
)
