"""Wander of a bias: sizes and times of slow processes by closed forms from Allan variances and levels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.levels import levels, log_levels
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence
from imuarray.simulate.effects.bias import BiasInstability
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
"""Probes that a slow process moves."""

BEYOND = 3.0
"""A trace that far from what the model makes is followed up."""

SLOWEST = 5.0
"""A process that is slower than so many phases is another bias in each boot; within one phase it is a random walk if it
is slower than that."""

_FACTORS = 4
"""Starts in an averaging time: terms that hang together."""

_NOT_WHITE = 0.1
"""Relative error allowed to an Allan variance: a filter takes that from the shortest, which have most of the terms."""

_TIMES = 25
_APART = 4.0


class Allan(NamedTuple):
    """Allan variances (o, 3) at averaging times (o,), in the sensor's unit squared, pooled over the phases at rest, and
    how many independent terms each has (o,); `spread` (3,) the mean variance of segments' means in these, `length_s`
    and number of the `phases`, for what is slower.
    """

    time_s: Floats
    variance: Floats
    terms: Floats
    spread: Floats
    length_s: float
    phases: int


class Wander(NamedTuple):
    """(3,) rms of a first-order Gauss-Markov process of this time constant."""

    rms: Floats
    time_constant_s: float


def allan_of(evidence: Evidence) -> Allan:
    """Octaves with at least one independent term in all; less what follows the temperature as the model lets it."""
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
    """Return (o, 3) what a level that the model lets follow the temperature adds, in counts squared: (rate tau)^2 / 2
    of a straight line (IEEE Std 952, Annex C).
    """
    time_s, level = phase.raw.segments.time_s, phase.raw.segments.mean - phase.residual.segments.mean
    known = np.isfinite(level).all(axis=1) & np.isfinite(time_s)
    if known.sum() < 2:
        return np.zeros((octaves, 3))
    rate = np.diff(level[known], axis=0) / np.diff(time_s[known])[:, None]
    tau = 2.0 ** np.arange(octaves) / rows_per_s
    return np.asarray(tau[:, None] ** 2 * (rate**2).mean(axis=0) / 2)


def gauss_markov(time_s: Floats, time_constant_s: float) -> Floats:
    """Allan variance of a first-order Gauss-Markov process of variance 1 (IEEE Std 952, Annex C)."""
    x = time_s / time_constant_s
    small = 2 * x / 3 * (1 - 0.75 * x)  # the rest cancels to rounding
    whole = 2 / x * (1 - (3 - 4 * np.exp(-x) + np.exp(-2 * x)) / (2 * x))
    return np.asarray(np.where(x < 1e-3, small, whole))


def within(length_s: float, time_constant_s: float) -> float:
    """Return the variance about their mean of the values of such a process in a stretch: 1 - 2 (x -
    1 + exp(-x)) / x^2.
    """
    x = length_s / time_constant_s
    return x / 3 if x < 1e-3 else 1 - 2 * (x - 1 + float(np.exp(-x))) / x**2


def size_of(allan: Allan, curve: Floats, spread: float) -> tuple[Floats, float]:
    """Return (3,) squared size of the process with this Allan variance (o,), and this variance in a phase, beside white
    noise, and how badly both fit.
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
    """Return the Gauss-Markov process that fits best, None where no phase is long enough to tell or none is there."""
    allan = allan_of(evidence)
    if len(allan.time_s) < 4:
        return None
    times = np.geomspace(3 / evidence.rows_per_s, 3 * longest_s(evidence), _TIMES)
    fits = [_gauss_markov_size(allan, time) for time in times]
    best = int(np.argmin([misfit for _, misfit in fits]))
    sizes = fits[best][0]
    return Wander(np.sqrt(sizes), float(times[best])) if sizes.any() else None


def flicker_of(evidence: Evidence) -> BiasInstability | None:
    """Flicker noise, of processes from one row to several phases, as large as the Allan variances say."""
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
    """One that is `_APART` times slower, and fits nearly as well; faster by its square, if phases are too short."""
    is_slow = wander.time_constant_s > longest_s(evidence)
    time_constant_s = wander.time_constant_s / (_APART**2) if is_slow else _APART * wander.time_constant_s
    return Wander(rms_at(evidence, time_constant_s), time_constant_s)


def over_logs(evidence: Evidence) -> Wander | None:
    """Logs' levels say how large it is, what goes on within them 2 rms^2 / time constant, how fast; None where these
    don't wander, or there are less than three.
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
    """Return (3,) rms of a Gauss-Markov process of this time constant."""
    return np.asarray(np.sqrt(_gauss_markov_size(allan_of(evidence), time_constant_s)[0]))


def longest_s(evidence: Evidence) -> float:
    """Length of the longest phase at rest."""
    phases = [item.raw.phase for item in evidence.still]
    return max((1e-9 * (phase.end_ns - phase.start_ns) for phase in phases), default=1.0)


def sized(values: Floats, score: Floats) -> Iterator[Triple]:
    """Sizes by axis: 0 where it is small and nothing shows, a little where something shows and the size is small; and
    those of the axes alone on which something shows, as Allan variances of few terms have a size by chance.
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
    """Return the mean over the phases at rest of the variance of segments' means less that of independent readings, at
    least a tenth of it; the phases' mean length, and how many there are.
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
