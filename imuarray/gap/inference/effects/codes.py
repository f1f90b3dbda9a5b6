"""Effects on codes: steps, missing codes and ends.

A fit takes means and variances as they are. Where readings leap over a stretch of codes that never come, a few of them
in a hundred are a stretch away from where they belong: the variance is that of the leaps, and a bias that warms up
towards the stretch seems to have another slope. `behind` fits bias, slope and noise before such a converter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import reduce
from math import comb
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.special import ndtr

from imuarray.arrays import Booleans, Floats, Integers
from imuarray.characterise.codes import NOTHING, Histogram
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence
from imuarray.gap.model.rest import REFERENCE_DEGC, FittedParameters
from imuarray.gap.statistics.synthetic_likelihood import FREEDOM
from imuarray.simulate.converters import CodeSpan, code_span
from imuarray.simulate.effects.conversion import Quantisation, Saturation

Coded = Callable[[Integers], Integers]
"""What comes of whole counts (n,)."""

UNITS_DIFFER = 0.015
"""Of what is felt: a scale, and an angle, of a chip's population; a face's level lies so far from the nominal one."""

_BIN_DEGC = 0.5
_FINE = 4
"""Places to a count at which moments are worked out."""

_REACH = 5
"""Standard deviations of noise."""

_LEAST_LSB = 0.2
_SHARES = np.geomspace(0.35, 1.4, 9)
"""Noises that are tried, over the fitted one, which the leaps are in."""

_OFFSETS, _SLOPES = 96, 41
_STRETCHES = 1.25
"""Offsets are looked for so many stretches to either side of the fitted one."""

_FORM_MEAN, _FORM_VARIANCE = 0.03, 0.1
"""By how much of the noise a mean, and of itself a variance, may be another one."""


class _Bins(NamedTuple):
    """Parts of phases at one temperature, of one axis, in counts: `face` numbers what was up; (b,) rows, what is felt,
    temperature less that of reference, mean, variance.
    """

    face: Integers
    rows: Floats
    felt: Floats
    warm_degc: Floats
    mean: Floats
    variance: Floats


class _Moments(NamedTuple):
    """At each of the places in one period of the codes: shift of the mean, variance, variance of the variance."""

    shift: Floats
    variance: Floats
    unsure: Floats


def behind(evidence: Evidence, coded: Coded, period: int, stretch: int) -> FittedParameters | None:
    """Return parameters with which `coded`, that does with all codes what it does with those of one `period`, and moves
    none by more than a `stretch`, makes the means and variances that the phases at rest have; None without such phases.
    """
    scale, parameters = evidence.header.sensitivity, []
    for axis in range(3):
        bins = _bins(evidence, axis)
        if bins is None:
            return None
        fitted = evidence.fitted
        start = np.array([fitted.offset[axis], fitted.slope[axis], evidence.noise[axis]]) * scale
        parameters.append(_behind(bins, start, coded, period, stretch) / scale)
    offset, slope, rms = (tuple(column) for column in np.array(parameters).T.tolist())
    return FittedParameters(rms, offset, slope)


def _bins(evidence: Evidence, axis: int) -> _Bins | None:
    scale, faces = evidence.header.sensitivity, {phase.raw.phase.up for phase in evidence.still}
    numbers = {face: number for number, face in enumerate(sorted(faces))}
    offset, slope = (getattr(evidence.fitted, name)[axis] * scale for name in ("offset", "slope"))
    rows = [
        (numbers[phase.raw.phase.up], *part) for phase in evidence.still for part in _parts(phase, axis, offset, slope)
    ]
    if not rows:
        return None
    face, *columns = np.array(rows).T
    return _Bins(face.astype(np.int64), *columns)


def _parts(phase: PhaseEvidence, axis: int, offset: float, slope: float) -> Iterator[tuple[float, ...]]:
    """Yield sums of each temperature as `_Bins` has them, except the face."""
    raw, residual = phase.raw.segments, phase.residual.segments
    is_usable = (raw.rows > 1) & np.isfinite(raw.temperature_degc)
    warm = raw.temperature_degc - REFERENCE_DEGC
    felt = raw.mean[:, axis] - residual.mean[:, axis] - offset - slope * warm
    variance = raw.steady_variance[:, axis] * raw.rows / np.maximum(raw.rows - 1, 1)
    degc = np.zeros(len(warm), np.int64)
    degc[is_usable] = np.floor(raw.temperature_degc[is_usable] / _BIN_DEGC)
    for number in np.unique(degc[is_usable]):
        at = is_usable & (degc == number)
        weight = raw.rows[at]
        middle = [float(np.average(values[at], weights=weight)) for values in (felt, warm, raw.mean[:, axis], variance)]
        yield float(weight.sum()), *middle


def _behind(bins: _Bins, start: Floats, coded: Coded, period: int, stretch: int) -> Floats:
    """Return (3,) offset, slope, noise in counts, from those of the fit."""
    offset, slope, noise = start
    units = UNITS_DIFFER * float(np.abs(bins.felt).max()) if np.ptp(bins.felt) > 1 else 0.0
    offsets = offset + np.linspace(-_STRETCHES, _STRETCHES, 2 * _OFFSETS + 1) * stretch
    span = float(np.ptp(bins.warm_degc))
    slopes = slope + np.linspace(-1.0, 1.0, _SLOPES) * stretch / span if span > 1 else np.array([slope])
    least_cost, parameters = np.inf, start
    for sigma in np.maximum(_SHARES * noise, _LEAST_LSB):
        table = _moments(coded, period, float(sigma))
        for steep in slopes if units == 0 else [slope]:
            cost = _over_faces(bins, offsets, float(steep), float(sigma), table, period, units)
            at = int(cost.argmin())
            if cost[at] < least_cost:
                least_cost, parameters = float(cost[at]), np.array([offsets[at], steep, sigma])
    return (
        _nearer(bins, parameters, coded, period, stretch, span)
        if not units
        else _quieter(bins, parameters, coded, period, units)
    )


def _nearer(bins: _Bins, start: Floats, coded: Coded, period: int, stretch: int, span: float) -> Floats:
    """Refine the best parameters of the grid."""
    size = np.array([stretch / _OFFSETS, stretch / (_SLOPES * max(span, 1.0)), 0.1 * start[2]])

    def cost(by: Floats) -> float:
        offset, slope, sigma = start + by * size
        sigma = max(float(sigma), _LEAST_LSB)
        table = _moments(coded, period, sigma)
        return float(_costs(bins, np.array([offset]), float(slope), sigma, table, period).sum())

    optimum = minimize(cost, np.zeros(3), method="Nelder-Mead", options={"maxfev": 200, "xatol": 0.02, "fatol": 0.02})
    nearer = start + np.asarray(optimum.x) * size
    return np.array([nearer[0], nearer[1], max(float(nearer[2]), _LEAST_LSB)])


def _quieter(bins: _Bins, start: Floats, coded: Coded, period: int, units: float) -> Floats:
    """Refine the noise between the values of the grid."""
    offset, slope, sigma = start

    def cost(by: float) -> float:
        table = _moments(coded, period, sigma * by)
        return float(_over_faces(bins, np.array([offset]), slope, sigma * by, table, period, units)[0])

    optimum = minimize_scalar(cost, bounds=(_SHARES[0] / _SHARES[1], _SHARES[1] / _SHARES[0]), method="bounded")
    return np.array([offset, slope, sigma * float(optimum.x)])


def _over_faces(
    bins: _Bins, offsets: Floats, slope: float, sigma: float, table: _Moments, period: int, units: float
) -> Floats:
    """Return (o,) cost of each offset; the level on each face is off by as much as a unit's may be, whichever suits
    best.
    """
    costs = _costs(bins, offsets, slope, sigma, table, period)
    if not units:
        return np.asarray(costs.sum(axis=1))
    away = (offsets[:, None] - offsets) ** 2 / (2 * units**2)
    each = [(costs[:, bins.face == face].sum(axis=1)[None] + away).min(axis=1) for face in np.unique(bins.face)]
    return np.asarray(np.sum(each, axis=0))


def _costs(bins: _Bins, offsets: Floats, slope: float, sigma: float, table: _Moments, period: int) -> Floats:
    """Return (o, b) nats, but for a constant, that the mean and the variance of each bin cost."""
    level = bins.felt + slope * bins.warm_degc + offsets[:, None]
    at = np.rint(level * (len(table.shift) / period)).astype(np.int64) % len(table.shift)
    variance = table.variance[at]
    mean_square = variance / bins.rows + (_FORM_MEAN * sigma) ** 2
    variance_square = table.unsure[at] / bins.rows + (_FORM_VARIANCE * variance) ** 2
    apart = (bins.mean - level - table.shift[at]) ** 2 / mean_square
    wider = (bins.variance - variance) ** 2 / variance_square
    student = (FREEDOM + 1) / 2 * (np.log1p(apart / FREEDOM) + np.log1p(wider / FREEDOM))
    return np.asarray(student + np.log(mean_square * variance_square) / 2)


def _moments(coded: Coded, period: int, sigma: float) -> _Moments:
    """Moments of readings with that noise (standard deviation, in counts) about each place of a period."""
    from scipy.signal import correlate  # its weight is for those who ask

    fine = _FINE if period <= 1024 / _FINE else 1
    reach = int(np.ceil(_REACH * sigma)) + 1
    counts = np.arange(-reach, period + reach)
    displacement = (coded(counts) - counts).astype(float)
    powers = [displacement**power for power in range(_POWERS + 1)]
    raw = np.empty((_POWERS + 1, period, fine))
    for part in range(fine):
        apart = np.arange(-reach, reach + 1) - part / fine
        share = np.diff(ndtr((np.arange(-reach, reach + 2) - 0.5 - part / fine) / sigma))
        share /= share.sum()
        for power in range(1, _POWERS + 1):
            raw[power, :, part] = (share * apart**power).sum()
            for order in range(1, power + 1):
                kernel = comb(power, order) * share * apart ** (power - order)
                raw[power, :, part] += correlate(powers[order], kernel, "valid")
    _, first, second, third, fourth = raw.reshape(_POWERS + 1, -1)
    variance = second - first**2
    about = fourth - 4 * first * third + 6 * first**2 * second - 3 * first**4
    return _Moments(first, np.maximum(variance, _TINY), np.maximum(about - variance**2, _TINY))


_POWERS = 4
_TINY = 1e-3


_STEP_PROBES = ("odd_codes", "second_bit", "absent_codes", "repeats")
_LEAPS = ("kurtosis", "extreme", "noise_excess", "force_square")
"""Probes that move where readings leap from one stretch of codes to another."""

_STEPS = tuple(2**bits for bits in range(1, 13))
_ODD_ONES = 0.01
"""Share of codes that are anything: glitches."""

_HIGHEST_BIT = 12

_FURTHEST_CARRY = 64
"""Carries of coarser bits are looked for so many codes from a multiple at most: a histogram of more codes than a chip's
noise spans has gaps by itself.
"""

_LEAST_EXPECTED = 14.0
"""Readings that missing codes would hold if they were as frequent as their neighbours. Chance leaves out so many at one
of 64 places of 12 carries in one recording of a thousand: exp(-14) 64 12 < 0.001.
"""

_FEWEST_CODES = 3
"""Fewer different codes have a common divisor by chance."""


def guess_quantisation(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the greatest step of which (nearly) all codes are multiples, and the power of two in it, or those of each
    axis where not all have one; bits that are never set, though codes leap over where they would be; codes before a
    carry that never come.
    """
    usual = code_span(evidence.header).step
    if not evidence.is_odd(*_STEP_PROBES, *_LEAPS):
        return
    of_axes = [[phase.raw.codes[axis] for phase in evidence.phases] for axis in range(3)]
    codes = [codes for axis in of_axes for codes in axis if len(codes.codes)]
    merged = reduce(Histogram.merge, codes, NOTHING)
    divisor = _divisor(merged)
    for step in dict.fromkeys(_with_power(divisor)):
        if step > usual:
            yield Hypothesis((Quantisation((float(step),) * 3),))
    if divisor not in (0, usual):
        return
    each = [_divisor(reduce(Histogram.merge, axis, NOTHING)) for axis in of_axes]
    if max(each) > usual:
        for steps in dict.fromkeys(zip(*map(_with_power, each), strict=True)):
            x, y, z = (float(step) if step > usual else 1.0 for step in steps)
            yield Hypothesis((Quantisation((x, y, z)),))
        return
    for bit in range(_HIGHEST_BIT):
        if _is_dead(bit, merged, codes):
            yield from _with_what_hides(evidence, Quantisation(dead_bits=float(1 << bit)), 2 << bit, 1 << bit)
    short = {carry: place for carry in _STEPS[1:] if (place := _before_a_carry(carry, merged, codes))[0]}
    if short:  # of every 16 all but two are, of every four, two
        carry = max(short, key=lambda carry: short[carry][0] / carry)
        missing, at = map(float, short[carry])
        coarse = Quantisation(carry_lsb=float(carry), missing_lsb=missing, carry_at_lsb=at)
        yield from _with_what_hides(evidence, coarse, carry, short[carry][0])


def _with_power(divisor: int) -> tuple[int, int]:
    """Return the divisor, and the greatest power of two in it; itself where there is none."""
    return divisor, max((step for step in _STEPS if divisor and divisor % step == 0), default=divisor)


def _with_what_hides(evidence: Evidence, coarse: Quantisation, period: int, stretch: int) -> Iterator[Hypothesis]:
    """Suggest the step with the fitted parameters, and with those that the sensor has before its codes are rounded."""
    yield Hypothesis((coarse,))
    fitted = behind(evidence, coarse.coded, period, stretch)
    if fitted is not None:
        yield Hypothesis((coarse,), fitted=fitted)


def _divisor(merged: Histogram) -> int:
    """Greatest common divisor of all codes but a hundredth of the readings; 0 without one."""
    least = (1 - _ODD_ONES) * merged.counts.sum()
    for step in np.flatnonzero(_are_divisors(merged, least))[::-1].tolist():
        on = merged.codes % step == 0
        if np.count_nonzero(on) >= _FEWEST_CODES and merged.counts[on].sum() >= least:
            return int(step)
    return 0


def _are_divisors(merged: Histogram, least: float) -> Booleans:
    """Return which numbers up to the largest step have only prime factors that `least` readings are multiples of."""
    possible = np.arange(_STEPS[-1] + 1) > 1
    for prime in range(2, len(possible)):
        if possible[prime] and merged.counts[merged.codes % prime == 0].sum() < least:
            possible[prime::prime] = False
    return possible


def _is_dead(bit: int, merged: Histogram, each: Sequence[Histogram]) -> bool:
    """Return whether a bit is clear in all codes but a hundredth of the readings, though those of an axis in a phase
    leap over a stretch in which it would be set.
    """
    clear = merged.counts[merged.codes >> bit & 1 == 0].sum()
    return bool(clear >= (1 - _ODD_ONES) * merged.counts.sum()) and any(_leaps(bit, codes) for codes in each)


def _leaps(bit: int, codes: Histogram) -> bool:
    low, high = _usual_span(codes)
    return low >> (bit + 1) != high >> (bit + 1)


def _usual_span(codes: Histogram) -> tuple[int, int]:
    """Return the lowest and the highest one, but for a hundredth of the readings at either end."""
    upto = np.cumsum(codes.counts)
    low, high = codes.codes[np.searchsorted(upto, np.array([_ODD_ONES, 1 - _ODD_ONES]) * upto[-1])].tolist()
    return low, high


def _before_a_carry(carry: int, merged: Histogram, each: Sequence[Histogram]) -> tuple[int, int]:
    """Return how many codes before every carry never come, but that of the carry in their place, and how far from a
    multiple of `carry` these are; (0, 0) if none are missing. Carries are at multiples, unless an offset moved them.
    """
    counts = np.bincount(merged.codes % carry, weights=merged.counts, minlength=carry)
    spans = np.array([_usual_span(codes) for codes in each])
    for at in range(min(carry, _FURTHEST_CARRY)):
        if missing := _missing(carry, np.roll(counts, -at), spans - at):
            return missing, at
    return 0, 0


def _missing(carry: int, counts: Floats, spans: Integers) -> int:
    """Return how many codes before every multiple of `carry` never come, of readings `counts` (carry,) by what is left
    of their codes, though readings of an axis in a phase, from and to `spans` (p, 2), lie on either side; 0 if none.
    """
    upto = np.cumsum(counts[::-1])  # of so many and one codes before the carry
    few = upto <= _ODD_ONES * counts.sum() * np.arange(1, carry + 1) / carry
    missing = int(np.argmin(few)) if few[0] else 0
    there = counts[1 : carry - missing]
    edges = np.concatenate([there[:2], there[-2:]])
    if not missing or not len(there) or missing * edges.mean() < _LEAST_EXPECTED:
        return 0
    if counts[0] < (1 + missing / 2) * edges.mean():
        return 0
    return missing if ((spans[:, 0] - 1) // carry < (spans[:, 1] - 1) // carry).any() else 0


_END_PROBES = ("code_pile", "skewness", "kurtosis", "motion_residual", "motion_gain", "force_square", "force_own")
_PILE = 3.0
"""Standard deviations by which the last code outnumbers the one before."""

_MOST_LIMITS = 2


def guess_saturation(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the largest codes at which an axis piles up, as the limits of all axes; those of each axis that piles up
    alone; and both ends of each axis, about a centre of its own, where an axis piles up at both, or at one and passes
    the opposite of it at the other, which then is the converter's.
    """
    if not evidence.is_odd(*_END_PROBES):
        return
    span = code_span(evidence.header)
    ends: list[set[int]] = [set(), set(), set()]
    for phase in evidence.phases:
        for axis_ends, codes in zip(ends, phase.raw.codes, strict=True):
            axis_ends |= {end for end in _piled(codes) if span.lowest < end < span.highest and end}
    limits = [{abs(end) for end in axis_ends} for axis_ends in ends]
    for limit in _distinct_limits(sorted(set().union(*limits), reverse=True))[:_MOST_LIMITS]:
        yield Hypothesis((Saturation((limit / evidence.header.sensitivity,) * 3),), ("limit",))
    if any(limits) and not all(limits):
        x, y, z = (
            max(axis_limits) / evidence.header.sensitivity if axis_limits else math.inf for axis_limits in limits
        )
        yield Hypothesis((Saturation((x, y, z)),), ("limit",))
    both = [_both_ends(axis_ends, _extremes(evidence, axis), span) for axis, axis_ends in enumerate(ends)]
    if any(both):
        scale = 2 * evidence.header.sensitivity
        x, y, z = ((max(codes) - min(codes)) / scale if codes else math.inf for codes in both)
        centre_x, centre_y, centre_z = ((max(codes) + min(codes)) / scale if codes else 0.0 for codes in both)
        yield Hypothesis((Saturation((x, y, z), (centre_x, centre_y, centre_z)),))


def _extremes(evidence: Evidence, axis: int) -> list[int]:
    """Return the lowest and the highest code of an axis in each phase."""
    histograms = [phase.raw.codes[axis] for phase in evidence.phases]
    return [int(end) for histogram in histograms if len(histogram.codes) for end in histogram.codes[[0, -1]]]


def _both_ends(ends: Collection[int], codes: Collection[int], span: CodeSpan) -> tuple[int, ...]:
    """Return the codes at which an axis ends: those with a pile, or one with a pile and the end of the converter's
    span, if the axis passes the opposite of the pile; () if it may end at opposite codes.
    """
    if len(ends) == 1:
        (end,) = ends
        if end > 0 and min(codes) < -end:
            return span.lowest, end
        return (end, span.highest) if end < 0 and max(codes) > -end else ()
    return tuple(ends)


def _piled(histogram: Histogram) -> Iterator[int]:
    """Yield the ends with a pile; the root of a Poisson count scatters by 1/2."""
    if len(histogram.codes) < 2:
        return
    for last, before in ((0, 1), (-1, -2)):
        here, roots = np.sqrt(histogram.counts[[last, before]] + 3 / 8)
        if np.sqrt(2) * (here - roots) > _PILE:
            yield int(histogram.codes[last])


def _distinct_limits(limits: list[int]) -> list[int]:
    """Descending codes without those that are the one before, rounded otherwise."""
    return [code for at, code in enumerate(limits) if at == 0 or limits[at - 1] - code > 1]
