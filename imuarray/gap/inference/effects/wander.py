"""Effects that change a bias slowly: amplitudes and times of processes, by Allan variances and levels in closed
form.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from imuarray.arrays import Floats, triple
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.effects.levels import Levels, change_between_logs, levels, log_levels
from imuarray.gap.inference.effects.motion import takes_part
from imuarray.gap.inference.evidence import NATS_PER_NUMBER, Evidence, PhaseEvidence, Spell
from imuarray.gap.statistics.cross import Cross
from imuarray.simulate.effects.bias import BiasInstability, CommonMode, PopcornNoise, RandomWalk, TurnOnBias
from imuarray.simulate.signal import Triple

TRACES = (
    "wander",
    "mean_halves",
    "mean_return",
    "allan_8",
    "allan_32",
    "allan_128",
    "allan_512",
    "allan_2048",
    "allan_longest",
    "band_1",
    "band_2",
    "noise_excess",
    "run_scatter",
    "thermal_residual",
    "slow_own_axes",
    "slow_between_axes",
)
"""Probes that change if a slow process is present."""

BEYOND = 3.0
"""Deviation of a trace from the model, in standard scores, from which on a slow process is suggested."""

SLOWEST = 5.0
"""Largest time constant, in lengths of phases. A slower process is another bias in each boot; within one phase, a
process that is slower than the phase is a random walk.
"""

_FACTORS = 4
"""Overlapping terms per averaging time in an Allan variance: they are correlated."""

_NOT_WHITE = 0.1
"""Relative model error of an Allan variance: a filter reduces the shortest ones, which have most of the terms."""

_TIMES = 25
_SLOWER = 4.0


class Allan(NamedTuple):
    """Allan variances (o, 3) at averaging times (o,), in the sensor's unit squared, pooled over the phases at rest, and
    the number of independent terms of each (o,). For slower processes: `spread` (3,), the mean variance of the
    segments' means within phases, with the mean length `length_s` and the number of the `phases`.
    """

    time_s: Floats
    variance: Floats
    terms: Floats
    spread: Floats
    length_s: float
    phases: int


class Wander(NamedTuple):
    """(3,) rms of a first-order Gauss-Markov process with this time constant."""

    rms: Floats
    time_constant_s: float


def allan_of(evidence: Evidence) -> Allan:
    """Return the octaves with at least one independent term in all, less the part that follows the temperature in the
    model.
    """
    sums, terms = np.zeros((0, 3)), np.zeros(0)
    for phase in evidence.still:
        variance, count, _ = phase.raw.allan
        if not len(sums):
            sums, terms = np.zeros_like(variance), np.zeros(len(count))
        white = variance[:1] / 2.0 ** np.arange(len(count))[:, None]
        warming = _of_warming(phase, evidence.rows_per_s, len(count))
        variance = np.maximum(variance - warming, np.minimum(variance, white / 2))
        sums += np.nan_to_num(variance) * count[:, None]
        terms += count
    has_terms = terms >= _FACTORS
    times = 2.0 ** np.flatnonzero(has_terms) / evidence.rows_per_s
    free = terms[has_terms] / (_FACTORS * 2.0 ** np.maximum(np.flatnonzero(has_terms) - 2, 0))
    mean = sums[has_terms] / terms[has_terms, None]
    known = free * _FACTORS >= 1
    variance = mean[known] / evidence.header.sensitivity**2
    return Allan(np.asarray(times[known]), variance, np.maximum(free, 0.5)[known], *_spread(evidence))


def _of_warming(phase: PhaseEvidence, rows_per_s: float, octaves: int) -> Floats:
    """Return (o, 3) the Allan variance of a level that follows the temperature in the model, in counts squared: (rate
    tau)^2 / 2 of a straight line (IEEE Std 952, Annex C).
    """
    time_s, level = phase.raw.segments.time_s, phase.raw.segments.mean - phase.residual.segments.mean
    known = np.isfinite(level).all(axis=1) & np.isfinite(time_s)
    if known.sum() < 2:
        return np.zeros((octaves, 3))
    rate = np.diff(level[known], axis=0) / np.diff(time_s[known])[:, None]
    tau = 2.0 ** np.arange(octaves) / rows_per_s
    return np.asarray(tau[:, None] ** 2 * (rate**2).mean(axis=0) / 2)


def gauss_markov(time_s: Floats, time_constant_s: float) -> Floats:
    """Return the Allan variance of a first-order Gauss-Markov process of variance 1 (IEEE Std 952, Annex C)."""
    x = time_s / time_constant_s
    small = 2 * x / 3 * (1 - 0.75 * x)  # the other form loses all digits for small x
    whole = 2 / x * (1 - (3 - 4 * np.exp(-x) + np.exp(-2 * x)) / (2 * x))
    return np.asarray(np.where(x < 1e-3, small, whole))


def within(length_s: float, time_constant_s: float) -> float:
    """Return the variance, about their mean, of the values of a Gauss-Markov process of variance 1 in a stretch:
    1 - 2 (x - 1 + exp(-x)) / x^2.
    """
    x = length_s / time_constant_s
    return x / 3 if x < 1e-3 else 1 - 2 * (x - 1 + float(np.exp(-x))) / x**2


def size_of(allan: Allan, curve: Floats, spread: float) -> tuple[Floats, float]:
    """Return (3,) the squared size of the process with the Allan variance `curve` (o,) and the variance `spread` in a
    phase, fitted together with white noise, and the misfit of both.
    """
    sizes, misfit = np.zeros(3), 0.0
    white = np.append(allan.time_s[0] / allan.time_s, 0.0)
    curve, terms = np.append(curve, spread), np.append(allan.terms, 2.0 * allan.phases)
    for axis in range(3):
        observed = np.append(allan.variance[:, axis], allan.spread[axis])
        if not (observed > 0).all():
            continue
        weight = 1 / (observed * np.hypot(np.sqrt(2 / terms), _NOT_WHITE))
        table = np.stack([white, curve], axis=1) * weight[:, None]
        (_, sizes[axis]), residual_norm = nnls(table, observed * weight)
        misfit += residual_norm**2
    return sizes, misfit


def wander_of(evidence: Evidence) -> Wander | None:
    """Return the Gauss-Markov process that fits best; None if no phase is long enough, or if no process is fitted."""
    allan = allan_of(evidence)
    if len(allan.time_s) < 4:
        return None
    times = np.geomspace(3 / evidence.rows_per_s, 3 * longest_s(evidence), _TIMES)
    fits = [_gauss_markov_size(allan, time) for time in times]
    best = int(np.argmin([misfit for _, misfit in fits]))
    sizes = fits[best][0]
    return Wander(np.sqrt(sizes), float(times[best])) if sizes.any() else None


def flicker_of(evidence: Evidence) -> BiasInstability | None:
    """Return flicker noise, as processes with time constants from one row to several phases, with the size of the Allan
    variances; None if they are too few or if the size is 0.
    """
    allan = allan_of(evidence)
    if len(allan.time_s) < 4:
        return None
    unit = BiasInstability((1.0, 1.0, 1.0), SLOWEST * longest_s(evidence), 1 / evidence.rows_per_s)
    times_s = unit.time_constants_s
    curve = np.mean([gauss_markov(allan.time_s, time_s) for time_s in times_s], axis=0)
    spread = float(np.mean([within(allan.length_s, time_s) for time_s in times_s]))
    x, y, z = np.sqrt(size_of(allan, np.asarray(curve), spread)[0]).tolist()
    return replace(unit, rms=(x, y, z)) if x or y or z else None


def slower(evidence: Evidence, wander: Wander) -> Wander:
    """Return a process that is `_SLOWER` times slower and fits nearly as well; or `_SLOWER`^2 times faster, if phases
    are too short.
    """
    is_slow = wander.time_constant_s > longest_s(evidence)
    time_constant_s = wander.time_constant_s / (_SLOWER**2) if is_slow else _SLOWER * wander.time_constant_s
    return Wander(rms_at(evidence, time_constant_s), time_constant_s)


def over_logs(evidence: Evidence) -> Wander | None:
    """Return the process whose rms is that of the logs' levels, with the time constant by which the change within logs
    is 2 rms^2 / time constant; None if the levels do not wander, or if fewer than three logs are comparable.
    """
    _, means, errors = log_levels(levels(evidence))
    if len(means) < 3 or not evidence.is_odd("run_scatter", "run_spread", "mean", beyond=BEYOND):
        return None
    square = (means.var(axis=0, ddof=1) - errors.mean(axis=0)).clip(0.0)
    long_s = 10 * longest_s(evidence)
    pace = rms_at(evidence, long_s) ** 2 / long_s
    if not square.any() or not pace.any():
        return None
    time_constant_s = min(max(square.mean() / pace.mean(), longest_s(evidence) / 3), SLOWEST * longest_s(evidence))
    return Wander(square**0.5, time_constant_s)


def rms_at(evidence: Evidence, time_constant_s: float) -> Floats:
    """Return (3,) rms of a Gauss-Markov process with this time constant."""
    return np.asarray(np.sqrt(_gauss_markov_size(allan_of(evidence), time_constant_s)[0]))


def longest_s(evidence: Evidence) -> float:
    """Return the length of the longest phase at rest in s; 1 without one."""
    phases = [item.raw.phase for item in evidence.still]
    return max((1e-9 * (phase.end_ns - phase.start_ns) for phase in phases), default=1.0)


def sized(values: Floats, score: Floats) -> Iterator[Triple]:
    """Yield sizes by axis: 0 if the size is small and nothing shows on the axis, at least a quarter of the largest size
    if something shows. Also yield only those of the axes on which something shows, because Allan variances with few
    terms have a size by chance.
    """
    largest = float(values.max())
    shows = np.abs(score) > BEYOND
    sizes = np.where(shows, np.maximum(values, largest / 4), np.where(values < largest / 3, 0.0, values))
    for each in dict.fromkeys((tuple(sizes.tolist()), tuple(np.where(shows, sizes, 0.0).tolist()))):
        x, y, z = each
        if x or y or z:
            yield x, y, z


def _gauss_markov_size(allan: Allan, time_constant_s: float) -> tuple[Floats, float]:
    return size_of(allan, gauss_markov(allan.time_s, time_constant_s), within(allan.length_s, time_constant_s))


def _spread(evidence: Evidence) -> tuple[Floats, float, int]:
    """Return the mean, over the phases at rest, of the variance of the segments' means less that of independent
    readings, which is at least a tenth of the variance; the mean length of the phases, and their number.
    """
    variances, lengths = [], []
    for phase in evidence.still:
        part = phase.residual.segments
        has_rows = part.rows > 1
        if np.count_nonzero(has_rows) > 2:
            white = (part.steady_variance[has_rows] / (part.rows[has_rows, None] - 1)).mean(axis=0)
            variance = part.mean[has_rows].var(axis=0)
            variances.append(np.maximum(variance - white, variance / 10) / evidence.header.sensitivity**2)
            lengths.append(part.width_s * len(part.rows))
    return (np.mean(variances, axis=0), float(np.mean(lengths)), len(variances)) if variances else (np.zeros(3), 1.0, 0)


def guess_bias_instability(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the Gauss-Markov process that fits the Allan variances best; a slower one (a faster one, if the process
    is slower than phases are long); flicker noise; and a process with the scatter of the logs' levels, if these wander.
    """
    if not evidence.is_odd(*TRACES, beyond=BEYOND) or (wander := wander_of(evidence)) is None:
        return
    score, longest = evidence.score(*TRACES), longest_s(evidence)
    for process in (wander, slower(evidence, wander)):
        for rms in sized(process.rms, score):
            yield _process(rms, process.time_constant_s, longest)
    if (flicker := flicker_of(evidence)) is not None:
        for rms in sized(np.array(flicker.rms), score):
            yield Hypothesis((replace(flicker, rms=rms),), ("rms",))
    if (of_logs := over_logs(evidence)) is not None:
        for rms in sized(of_logs.rms, score):
            yield _process(rms, of_logs.time_constant_s, SLOWEST * longest)


def _process(rms: Triple, time_constant_s: float, slowest_s: float) -> Hypothesis:
    effect = BiasInstability(rms, time_constant_s)
    return Hypothesis((effect,), ("rms", "time_constant_s"), limits={"time_constant_s": (0.0, slowest_s)})


_WALKS_ALIKE = 2.0
"""Ratio from which on the densities by levels and by Allan variances are suggested separately."""


def guess_random_walk(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the density by the Allan variances, density^2 tau / 3, and the density by the differences of levels,
    density^2 t, if it is larger.
    """
    if not evidence.is_odd(*TRACES, beyond=BEYOND):
        return
    score = evidence.score(*TRACES)
    allan = allan_of(evidence)
    known = len(allan.time_s) > 3
    short = np.sqrt(size_of(allan, allan.time_s / 3, allan.length_s / 6)[0]) if known else np.zeros(3)
    far = _density_from_levels(evidence)
    for density in (short, far) if far.max() > _WALKS_ALIKE * short.max() else (short,):
        for sizes in sized(density, score):
            yield Hypothesis((RandomWalk(sizes),), ("density",))


def _density_from_levels(evidence: Evidence) -> Floats:
    """Return (3,) the density by the first and the last quarter of the segments of each log and face."""
    table, squares, seconds = levels(evidence), np.zeros(3), 0.0
    for at in table.groups():
        quarter = len(at) // 4
        if quarter == 0:
            continue
        first, last = at[:quarter], at[-quarter:]
        step = table.mean[last].mean(axis=0) - table.mean[first].mean(axis=0)
        error = (table.square_error[first].sum(axis=0) + table.square_error[last].sum(axis=0)) / quarter**2
        squares += (step**2 - error).clip(0.0)
        seconds += float(table.time_s[last].mean() - table.time_s[first].mean())
    return np.asarray(np.sqrt(squares / seconds)) if seconds > 0 else np.zeros(3)


_FREE_POPCORN = ("amplitude", "switches_per_s")
_SELDOM = 0.05
"""Least share of time at the rarer level in a first guess."""

_TELEGRAPH_RARITY = 2.0
"""Nats by which popcorn noise is rarer than a drift, if the segments' levels do not tell them apart."""

_MOST_NATS = 8.0
"""Most nats that the distribution of the segments' levels counts for or against two levels: two levels may also drift.
"""

_PARAMETER = 0.5
"""Nats that a further parameter of a distribution gains by chance, on average."""

_WANDERS = 3.0
"""Excess of the variance of the segments' levels over that of independent readings, in standard errors, from which on
their distribution is examined.
"""

_FEWEST_LEVELS = 16
"""Fewest segments whose distribution is examined."""

_FEWEST_JUMPS = 3.0
"""Fewest jumps in the longest phase that distinguish popcorn noise from a slow drift."""

_CLEAR_JUMP = 4.0
"""Least height of a jump, in standard errors of a segment's mean."""


def guess_popcorn_noise(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest popcorn noise with the autocovariance of the Gauss-Markov process that fits best (rms = amplitude / 2,
    the reciprocal of the time constant = twice the switches per second), and a slower one; the same with one level
    rarer than the other, if the distribution of the segments is asymmetric; and another by the jumps themselves, if
    segments show them. It is the less rare, the better two levels fit the segments.
    """
    if not evidence.is_odd(*TRACES, beyond=BEYOND):
        return
    score = evidence.score(*TRACES)
    wander = wander_of(evidence)
    rarity = _TELEGRAPH_RARITY - min(max(two_levels(levels(evidence)), -_MOST_NATS), _MOST_NATS)
    fewest_per_s = _FEWEST_JUMPS / longest_s(evidence)
    limits = {"switches_per_s": (fewest_per_s, np.inf)}
    is_uneven = evidence.is_odd("wander_uneven", beyond=BEYOND)
    for process in (wander, slower(evidence, wander)) if wander is not None else ():
        for amplitude in sized(2 * process.rms, score):
            effect = PopcornNoise(amplitude, 0.5 / process.time_constant_s)
            yield Hypothesis((effect,), _FREE_POPCORN, limits=limits, rarity=rarity)
        if is_uneven and process.rms.any():
            yield from _one_sided(evidence, process, score, limits, rarity)
    heights, switches_per_s = _jumps(evidence)
    for amplitude in sized(heights, score) if switches_per_s >= fewest_per_s else ():
        yield Hypothesis((PopcornNoise(amplitude, switches_per_s),), _FREE_POPCORN, limits=limits, rarity=rarity)


def two_levels(table: Levels) -> float:
    """Return the nats by which two levels with the noise of independent readings fit the segments better than a normal
    distribution of levels, over all groups and axes that wander. Successive segments with the correlation r count by
    1 - r^2: a wander with this correlation changes by as much from one segment to the next.
    """
    nats = 0.0
    for at in table.groups():
        if len(at) < _FEWEST_LEVELS:
            continue
        for axis in range(3):
            error = float(table.square_error[at, axis].mean())
            apart = table.mean[at, axis] - table.mean[at, axis].mean()
            variance = float(apart.var())
            if error == 0 or not variance > error * (1 + _WANDERS * math.sqrt(2 / len(at))):
                continue  # readings without noise have no likelihood
            correlation = float(apart[1:] @ apart[:-1]) / (len(at) * variance)
            nats += (1 - correlation**2) * (_log_ratio_of_two_levels(apart, variance, error) - _PARAMETER)
    return nats


def _log_ratio_of_two_levels(apart: Floats, variance: float, error: float) -> float:
    """Return the log of the ratio of the likelihood of values (n,) with the mean 0 and this `variance` under two levels
    with normal noise of the variance `error` to that under a normal distribution. The levels are the means of the
    values below and above the best limit.
    """
    ordered, count = np.sort(apart), len(apart)
    lower = np.arange(2, count - 1)
    sums = np.cumsum(ordered)[lower - 1]
    log_share, log_other = np.log(lower / count), np.log(1 - lower / count)
    below = log_share - (ordered[:, None] - sums / lower) ** 2 / (2 * error)
    above = log_other - (ordered[:, None] + sums / (count - lower)) ** 2 / (2 * error)
    by_two = float(np.logaddexp(below, above).sum(axis=0).max())
    return by_two + count / 2 * (math.log(variance / error) + 1)


def _one_sided(
    evidence: Evidence, wander: Wander, score: Floats, limits: Mapping[str, tuple[float, float]], rarity: float
) -> Iterator[Hypothesis]:
    """Suggest the share p of time at the rarer level by the skewness of the segments' means, (1 - 2 p) / sqrt(p (1 -
    p)), on the axis that wanders most. The variance is amplitude^2 p (1 - p), and the reciprocal of the time constant
    is the switches per second over 2 p (1 - p). The sign of the skewness of each axis is the sign of its amplitude.
    """
    level = levels(evidence)
    square = level.apart.var(axis=0) - level.square_error.mean(axis=0)
    skewness = (level.apart**3).mean(axis=0) / np.maximum(square, level.apart.var(axis=0) / 10) ** 1.5
    largest = float(np.abs(skewness[int(wander.rms.argmax())]))
    share = min(max((1 - largest / float(np.hypot(largest, 2.0))) / 2, _SELDOM), 0.5)
    half = float(np.sqrt(share * (1 - share)))
    limits = {**limits, "high_share": (_SELDOM / 2, 1 - _SELDOM / 2)}
    for sizes in sized(wander.rms / half, score):
        effect = PopcornNoise(
            triple(np.array(sizes) * np.where(skewness < 0, -1.0, 1.0) + 0.0),
            2 * half**2 / wander.time_constant_s,
            share,
        )
        yield Hypothesis((effect,), (*_FREE_POPCORN, "high_share"), limits=limits, rarity=rarity)


def _jumps(evidence: Evidence) -> tuple[Floats, float]:
    """Return (3,) heights of the jumps, 0 on an axis without a clear one, and their number per second on an axis that
    has any.
    """
    table, amplitude, rates = levels(evidence), np.zeros(3), []
    for axis in range(3):
        heights, jumps = [], 0
        for at in table.groups():
            height, crossings = _jumps_of_axis(
                table.mean[at, axis], float(np.sqrt(table.square_error[at, axis].mean()))
            )
            jumps += crossings
            heights += [height] * bool(crossings)
        if heights:
            amplitude[axis] = float(np.median(heights))
            rates.append(jumps / table.seconds)
    return amplitude, float(np.mean(rates)) if rates else 0.0


def _jumps_of_axis(mean: Floats, error: float) -> tuple[float, int]:
    """Return the height of the upper segments above the lower ones, and how often the level changes; 0 unless the
    height is clear.
    """
    middle = (mean.max() + mean.min()) / 2
    upper = mean > middle
    if upper.all() or not upper.any():
        return 0.0, 0
    height = float(np.median(mean[upper]) - np.median(mean[~upper]))
    beyond = np.abs(mean - middle) > height / 4
    state = upper[beyond]
    crossings = int(np.count_nonzero(state[1:] != state[:-1]))
    return (height, crossings) if height > _CLEAR_JUMP * error else (0.0, 0)


_COMMON_TRACES = ("slow_own_axes", "fast_own_axes", "slow_between_axes")
_FREE_COMMON = ("rms", "time_constant_s")
_BEYOND_COMMON = 2.7
_TIMES_APART, _TIMES_ALIKE = 5.0, 1.5
_FOR_EVER_S = 1e6
_LEAST_DEGC = 1.0
_LEAST_SEGMENTS = 4
_SPELLS = 4
"""Largest number of spells in which a common mode is tried."""

_PAIRED = 5.0
"""Standard scores from which on two units have a common noise that the others need not share."""

_LEAST_RATIO = 1.3
"""Ratio of the sizes of a common noise in two sensors from which on it is tried with a size of its own in each."""

_WHITE_S = 1e-3
"""Time constant in s of a noise that is common to simultaneous readings but not to successive ones: it is shorter than
the sample period of any unit.
"""

_PERFECT = 0.999
_TINY = 1e-30


def guess_common_mode(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest common noise. Its size follows from the covariance with the other units of the chip, of slow means and of
    faster ones, without the parts that depend linearly on temperature. Its time constant is that of the sensor's
    wander, within logs and between them, or a slower one; or all of this wander is common. For two or three logs,
    suggest the difference of their levels, constant within each: alone, and with the part that the others do not share.
    Noise that changes within a log is also tried in the spells of the sensor.
    """
    always = list(_common_mode_hypotheses(evidence))
    during = [_in_spell(trial, spell, evidence) for spell in evidence.spells[:_SPELLS] for trial in always]
    yield from (*always, *(trial for trial in during if trial is not None))


def _in_spell(trial: Hypothesis, spell: Spell, evidence: Evidence) -> Hypothesis | None:
    """Return the trial in a spell, with an rms that is larger the shorter the spell is; None for a change between
    logs.
    """
    share = sum(phase.raw.rows for phase in spell.phases) / max(sum(phase.raw.rows for phase in evidence.still), 1)
    if trial.needs_both or not 0 < share < 1:
        return None
    effects = [
        replace(effect, rms=_scaled_rms(effect.rms, 1 / math.sqrt(share))) if isinstance(effect, CommonMode) else effect
        for effect in trial.effects
    ]
    return replace(trial, effects=tuple(effects)).at(spell.when)


def _scaled_rms(rms: Triple, by: float) -> Triple:
    x, y, z = rms
    return x * by, y * by, z * by


def _common_mode_hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    yield from _common_between_logs(evidence)
    yield from _slow_or_fast(evidence)
    yield from _in_pairs(evidence)


def _slow_or_fast(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*_COMMON_TRACES, beyond=_BEYOND_COMMON):
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
    for time_s in _common_times_s(evidence, wander, over):
        rms = np.sqrt(np.maximum(_common_variance(pairs, evidence.header.name, partners, time_s), 0.0))
        if rms.any():
            yield Hypothesis(
                (CommonMode(triple(np.where(rms < rms.max() / 5, 0.0, rms)), time_s),), _FREE_COMMON, shared=True
            )
    score = evidence.score(*TRACES)
    for process in (None if wander is None else slower(evidence, wander), over):
        if process is not None:  # few values of a slow process are independent, so a covariance determines little
            for sizes in sized(process.rms, score):
                yield Hypothesis((CommonMode(sizes, process.time_constant_s),), _FREE_COMMON, shared=True)


class _Common(NamedTuple):
    """Covariances (3, 3) of two sensors, a row for each axis of the first one: of the means of windows within segments
    (`fast`), and of the means of segments (`slow`). `score` (3, 3): standard scores of `fast`.
    """

    fast: Floats
    slow: Floats
    score: Floats

    @property
    def own(self) -> float:
        """Score of the covariance of equal axes."""
        return float(np.trace(self.score) / math.sqrt(3))

    @property
    def across(self) -> float:
        """Score of the covariance of each axis with the other two."""
        return float((self.score.sum() - np.trace(self.score)) / math.sqrt(6))


def _in_pairs(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest noise that some units have in common, from one reading to the next or slower. The units are those of any
    chip, of the same quantity, whose correlation with the sensor is more than chance, each pair tested by itself; axis
    by axis, or the same on all axes. If there is a single partner, the sizes in both may differ.
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
        partner = next(iter(together)) if shared and len(together) == 1 else ""
        ratio = _size_ratio([cross for _, cross in pairs], evidence.header.name, partner) if partner else 1.0
        times_s = () if wander is None else (wander.time_constant_s, slower(evidence, wander).time_constant_s)
        for time_s in (_WHITE_S, *times_s):
            is_white = time_s == _WHITE_S
            covariance = fast * max(rows, 1.0) if is_white else (fast + slow) / within(length_s, time_s)
            if not any(rms := _common_rms(covariance, shared)):
                continue
            free = ("rms",) if is_white else _FREE_COMMON
            yield Hypothesis((CommonMode(rms, time_s, shared, group),), free, shared=True, members=members)
            if max(ratio, 1 / ratio) > _LEAST_RATIO:
                own, other = _common_rms_each(covariance, ratio)
                yield Hypothesis(
                    (CommonMode(own, time_s, shared, group),),
                    free,
                    shared=True,
                    sensor=evidence.header.name,
                    others=(partner,),
                    opposite=(CommonMode(other, time_s, shared, group),),
                    rarity=NATS_PER_NUMBER,
                )


def _common_rms(covariance: Floats, shared: float) -> Triple:
    """Return (3,) rms of a common noise that is equal in two sensors, by the covariances (3, 3) between them."""
    if shared:
        return triple(covariance.sum(axis=1).clip(0) / math.sqrt(max(float(covariance.sum()), _TINY)))
    return triple(np.sqrt(np.diag(covariance).clip(0)))


def _common_rms_each(covariance: Floats, ratio: float) -> tuple[Triple, Triple]:
    """Return the rms by axis of one process in two sensors, of which the first has `ratio` times the size of the
    second, by the covariances (3, 3) between them: the best product of a column and a row.
    """
    columns, values, rows = np.linalg.svd(covariance)
    sign = math.copysign(1.0, columns[:, 0].sum())
    own, other = ((sign * vector).clip(0) * math.sqrt(values[0]) for vector in (columns[:, 0], rows[0]))
    return triple(math.sqrt(ratio) * own), triple(other / math.sqrt(ratio))


def _size_ratio(crosses: Sequence[Cross], sensor: str, partner: str) -> float:
    """Return the ratio of the sizes of a common noise in the first and the second sensor, by the covariances between
    the axes of each; 1 if one of them has none.
    """
    own, other = (
        float(covariance.sum() - np.trace(covariance))
        for covariance in (_common(crosses, name, name).fast for name in (sensor, partner))
    )
    return math.sqrt(own / other) if min(own, other) > 0 else 1.0


def _common(crosses: Sequence[Cross], sensor: str, partner: str) -> _Common:
    """Return the covariances of two sensors over the phases. The score of a correlation r of n windows is artanh(r)
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


def _common_times_s(evidence: Evidence, wander: Wander | None, over: Wander | None) -> list[float]:
    """Return the distinct time constants, in s, of the sensor's wander within logs and between them."""
    first_s = wander.time_constant_s if wander is not None else longest_s(evidence) / 10
    times_s = [first_s, min(_TIMES_APART * first_s, 3 * longest_s(evidence))]
    if over is not None:
        times_s.append(over.time_constant_s)
    distinct_s: list[float] = []
    for time_s in times_s:
        if all(max(time_s / other, other / time_s) > _TIMES_ALIKE for other in distinct_s):
            distinct_s.append(time_s)
    return distinct_s


def _common_between_logs(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a change of level that the others share, and the sensor's difference from it as a turn-on bias."""
    change = change_between_logs(evidence)
    if not change.any():
        return
    individual = np.where(np.abs(evidence.score("level_apart")) > _BEYOND_COMMON, evidence.shift("level_apart"), 0.0)
    common = np.where(change == 0, 0.0, change - individual)
    if not common.any():
        return
    a, b, c = (np.abs(common) / np.sqrt(2)).tolist()
    shared = CommonMode((a, b, c), _FOR_EVER_S)
    yield Hypothesis((shared,), shared=True, whole=True)
    if individual.any():
        yield Hypothesis((shared, TurnOnBias(triple(np.abs(individual) / np.sqrt(2)))), shared=True, whole=True)


def _common_variance(
    pairs: Sequence[tuple[PhaseEvidence, Cross]], sensor: str, partners: Sequence[str], time_constant_s: float
) -> Floats:
    """Return (3,) the variance of a common process with this time constant: the mean covariance over phases and
    partners, for each of the chips' own axes, divided by the share of the variance that phases show about their means.
    """
    covariances, shares, weights = [], [], []
    for phase, cross in pairs:
        levels = _slow_means(phase, cross, sensor)
        known = np.isfinite(levels).all(axis=1)
        if known.sum() < _LEAST_SEGMENTS:
            continue
        slow = [np.mean((levels * _slow_means(phase, cross, partner))[known], axis=0) for partner in partners]
        fast = [np.diag(cross.fast[cross.columns(sensor), cross.columns(partner)]) for partner in partners]
        covariances.append(np.mean(slow, axis=0) + np.nan_to_num(np.mean(fast, axis=0)))
        shares.append(within(1e-9 * (cross.phase.end_ns - cross.phase.start_ns), time_constant_s))
        weights.append(len(levels))
    if not covariances:
        return np.zeros(3)
    return np.asarray(np.average(covariances, axis=0, weights=weights) / np.average(shares, weights=weights))


def _slow_means(phase: PhaseEvidence, cross: Cross, sensor: str) -> Floats:
    """Return (s, 3) means of segments less their mean, and less a straight line in the temperature if it changes."""
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
