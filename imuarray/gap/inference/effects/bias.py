"""Effects on the level of readings: a bias that changes within or between logs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Indices, triple
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.effects.levels import Levels, change_between_logs, levels, log_levels
from imuarray.gap.inference.evidence import Evidence, Span, When
from imuarray.gap.recording.course import changes
from imuarray.gap.statistics.probes.probe import once
from imuarray.gap.statistics.runs import divide
from imuarray.simulate.effects.bias import Bias, BistableBias, TurnOnBias

RUN_TO_RUN = ("run_spread", "run_scatter", "run_rms", "run_two_states", "run_shared_states", "run_outlier", "mean")
"""Probes that change if boots differ."""

_BEYOND_RUNS = 2.7
_SMALL_SPREAD = 0.2


def guess_turn_on_bias(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the spread of the logs' levels on the faces that they share; for two logs, their difference."""
    change = change_between_logs(evidence)
    if change.any():
        yield Hypothesis((TurnOnBias(triple(np.abs(change) / np.sqrt(2))),), whole=True)
    if not evidence.is_odd(*RUN_TO_RUN, beyond=_BEYOND_RUNS):
        return
    _, means, errors = log_levels(levels(evidence))
    if len(means) < 2:
        return
    is_unusual = evidence.score("run_scatter") >= 0  # negative if the levels scatter less than those of usual parts
    rms = np.sqrt(np.maximum(means.var(axis=0, ddof=1) - errors.mean(axis=0), 0.0)) * is_unusual
    if rms.any():
        x, y, z = np.where(
            rms < _SMALL_SPREAD * rms.max(), np.where(np.abs(evidence.score(*RUN_TO_RUN)) > _BEYOND_RUNS, rms, 0.0), rms
        )
        yield Hypothesis((TurnOnBias((float(x), float(y), float(z))),), ("rms",))


_SEPARATION, _SHARED_SEPARATION = math.log(5), math.log(3)
"""Thresholds of the log of the ratio of the scatter of all levels to the scatter within two groups: on a single axis,
where a drift has log 4; and over three axes, which chance rarely changes together. There are two groups above it.
"""


def guess_bistable_bias(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the two groups of logs that scatter least within themselves: the distance between their levels, and the
    frequency of the rarer group.
    """
    if not evidence.is_odd(*RUN_TO_RUN, beyond=_BEYOND_RUNS):
        return
    _, means, errors = log_levels(levels(evidence))
    if len(means) < 2 or (rare := rarer(means, errors)) is None:
        return
    yield Hypothesis(
        (BistableBias(triple(means[rare].mean(axis=0) - means[~rare].mean(axis=0)), float(rare.mean())),),
        ("offset", "probability"),
    )


def rarer(means: Floats, variances: Floats) -> Booleans | None:
    """Return (l,) which levels (l, 3) are in the smaller of two groups; None for one group. `variances` (l, 3) are
    those of the levels' errors.
    """
    groups = [(*divide(means, variances, least=1), _SHARED_SEPARATION)]
    for axis in range(means.shape[1]):
        groups.append((*divide(means[:, [axis]], variances[:, [axis]], least=1), _SEPARATION))
    upper, separation, least = max(groups, key=lambda group: np.nan_to_num(group[1] - group[2], nan=-math.inf))
    if not separation > least:
        return None
    return upper if upper.sum() * 2 <= len(upper) else ~upper


_TRACES = ("mean", "level", "run_spread", "run_scatter", "run_rms", "run_outlier")
_WITHIN = ("mean_halves", "wander", "mean_return", "noise_excess", "allan_longest", "band_1", "mean", "level")
"""Probes that change if the level steps within a log."""

_CLEAR = 8.0
"""Nats by which two levels must fit better than one."""

_FEWEST = 3
"""Fewest logs that are divided by a step. A difference between two logs is suggested as a turn-on bias instead."""

_SMALL = 0.1

_FEWEST_SEGMENTS = 8
_STRETCHES = 3
"""Most stretches of a log with another level. More of them are popcorn noise."""

_STEADY = 1.5
"""Largest scatter of the levels, without the step, as a multiple of their scatter from each segment to the next. Above
it the levels drift, and a step does not explain them.
"""

_SURE = 4.0
"""Standard errors from which on an axis is part of a step."""

_WITH_HEAT = 6.0
"""Nats by which a bias is rarer if it lasts as long as the box warms up or cools down. The usual cause then is an
element whose temperature lags behind that of the box.
"""

_WARMING_DEGC = 1.0
_OTHER_RATE = 0.75
"""The box warms up or cools down in the stretches if its temperature changes by at least `_WARMING_DEGC` (degC) in
them, and the rate of change inside and outside differ by at least the share `_OTHER_RATE` of the larger rate.
"""

_ODD = 3.0
"""Standard deviations from which on the level of an axis may have changed since an earlier recording."""


def guess_bias(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the steps of the level within a log; the level of all logs, if the base model's comes from an earlier
    recording; and the step that best divides the logs in the order of their recording.
    """
    for step in level_steps(evidence):
        x, y, z = step.size.tolist()
        rarity = _WITH_HEAT if step.is_with_heat else 0.0
        bias = Hypothesis((Bias((x, y, z)),), ("offset",), rarity=rarity).at(step.when)
        yield replace(bias, begin_bounds_s=step.begin_bounds_s)
    if not evidence.is_odd(*_TRACES):
        return
    if not evidence.is_refitted:
        yield from _changed_since(evidence)
    logs, means, errors = log_levels(levels(evidence))
    if len(means) < _FEWEST:
        return
    gains = [_gain_of_step(means, errors, at) for at in range(1, len(means))]
    at = int(np.argmax(gains)) + 1
    if gains[at - 1] > _CLEAR:
        step = means[at:].mean(axis=0) - means[:at].mean(axis=0)
        yield Hypothesis(
            (Bias(triple(np.where(np.abs(step) > _SMALL * np.abs(step).max(), step, 0.0)), float(logs[at])),),
            ("offset",),
        )


class LevelStep(NamedTuple):
    """A step of the levels by `size` (3,), in the sensor's unit, during stretches of a log (`when`). `begin_bounds_s`:
    the moments between which the last stretch begins, if no segment at rest shows its beginning, as in a motion; else
    None. `is_with_heat`: the level returns, and the temperature rises or falls as long as the stretches last.
    """

    size: Floats
    when: When
    begin_bounds_s: tuple[float, float] | None
    is_with_heat: bool = False


@once
def level_steps(evidence: Evidence) -> tuple[LevelStep, ...]:
    """Return, for each log that has them, the stretches of another level (one to three), if the level is steady apart
    from them.
    """
    return tuple(_level_steps(evidence)) if evidence.is_odd(*_WITHIN) else ()


def _level_steps(evidence: Evidence) -> Iterator[LevelStep]:
    table = levels(evidence)
    for log in np.unique(table.log).tolist():
        rows = np.flatnonzero(table.log == log)
        order = rows[np.argsort(table.time_s[rows])]
        mean, error = table.mean[order], np.sqrt(table.square_error[order])
        if len(order) < _FEWEST_SEGMENTS:
            continue
        for change in islice(changes(mean, np.median(error, axis=0)), 1):
            inside = ~change.inside if change.inside[0] else change.inside  # the first level is the usual one
            edges = np.flatnonzero(np.diff(inside.astype(np.int8))) + 1
            step = mean[inside].mean(axis=0) - mean[~inside].mean(axis=0)
            without_step = np.where(inside[:, None], mean - step, mean)
            scatter = np.sqrt((np.diff(without_step, axis=0) ** 2).mean(axis=0) / 2)
            sure = np.abs(step) > _SURE * scatter * math.sqrt(1 / inside.sum() + 1 / (~inside).sum())
            is_steady = without_step.std(axis=0) < _STEADY * scatter
            if len(edges) <= 2 * _STRETCHES and (sure & is_steady).any() and not (sure & ~is_steady).any():
                when = _when(log, table, order, inside, edges)
                with_heat = not inside[-1] and is_with_heat(table.degc[order], table.time_s[order], inside)
                yield LevelStep(np.where(sure, step, 0.0), when, _begin_bounds_s(table, order, inside), with_heat)


def is_with_heat(degc: Floats, time_s: Floats, inside: Booleans) -> bool:
    """Return whether the temperature (n,) changes in the segments `inside`, at another rate than in the others."""
    rate = np.gradient(degc, time_s)
    known = np.isfinite(rate)
    if not known[inside].any() or not known[~inside].any():
        return False
    rate_inside, rate_outside = float(np.median(rate[inside & known])), float(np.median(rate[~inside & known]))
    is_other_rate = abs(rate_inside - rate_outside) > _OTHER_RATE * max(abs(rate_inside), abs(rate_outside))
    return is_other_rate and abs(rate_inside) * float(np.ptp(time_s[inside])) > _WARMING_DEGC


def _begin_bounds_s(table: Levels, order: Indices, inside: Booleans) -> tuple[float, float] | None:
    """Return the gap between segments at rest in which the last stretch begins; None if the segments touch."""
    begin = int(np.flatnonzero(inside[1:] & ~inside[:-1])[-1])
    before_s, after_s = table.time_s[order][begin : begin + 2].tolist()
    half_s = float(table.width_s[order][begin : begin + 2].mean()) / 2
    bounds_s = before_s + half_s, after_s - half_s
    return bounds_s if bounds_s[1] - bounds_s[0] > 2 * half_s else None


def _when(log: int, table: Levels, order: Indices, inside: Booleans, edges: Indices) -> When:
    """Return the stretches between `edges`. Each edge divides one of the two segments next to it; its moment follows
    from the shares of the step in the means of both.
    """
    time_s, mean, width_s = table.time_s[order], table.mean[order], table.width_s[order]
    low, high = (np.median(mean[side], axis=0) for side in (~inside, inside))
    axis = int(np.abs(high - low).argmax())
    shares = np.clip((mean[:, axis] - low[axis]) / (high - low)[axis], 0.0, 1.0)
    moments = []
    for at in edges.tolist():
        early_s = width_s[at] * (float(shares[at - 1 : at + 1].sum()) - 1)
        moments.append(float(time_s[at - 1 : at + 1].mean()) + (-early_s if inside[at] else early_s))
    ends = [*moments, math.inf] if len(moments) % 2 else moments
    return When(tuple(Span(log, begin, end - begin) for begin, end in zip(ends[::2], ends[1::2], strict=True)))


def _changed_since(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a bias that has changed since an earlier recording."""
    shift = evidence.typical("mean")
    size = np.abs(evidence.score("mean", "level"))
    x, y, z = np.where((size > _ODD) & np.isfinite(shift), shift, 0.0).tolist()
    if any((x, y, z)):
        yield Hypothesis((Bias((x, y, z)),), ("offset",))


def _gain_of_step(means: Floats, errors: Floats, at: int) -> float:
    """Return the nats by which a level of the first `at` logs and a level of the rest explain the means (l, 3) better
    than one level of all.
    """
    whole = ((means - means.mean(axis=0)) ** 2 + errors).sum(axis=0)
    parts = sum(
        ((part - part.mean(axis=0)) ** 2 + error).sum(axis=0)
        for part, error in ((means[:at], errors[:at]), (means[at:], errors[at:]))
    )
    return float(len(means) / 2 * np.log(whole / parts).sum())
