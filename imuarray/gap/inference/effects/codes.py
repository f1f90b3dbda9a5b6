"""Effects on codes: steps, missing codes and ends.

A fit uses means and variances as they are. If readings leap over a stretch of codes that never occur, a few percent of
them are displaced by a stretch. The variance is then that of the leaps, and a bias that approaches the stretch as the
sensor warms up seems to have another slope. `behind` fits bias, slope and noise before such a converter.
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
"""The codes (n,) that a converter makes of whole counts (n,)."""

UNITS_DIFFER = 0.015
"""Share of the force by which a unit's level on a face may differ from the nominal level: the standard deviation of
scale errors and misalignments, in rad, of a chip's population.
"""
_BIN_DEGC = 0.5
_FINE = 4
"""Points per count at which moments are computed."""

_REACH = 5
"""Extent of the noise distribution that moments include, in standard deviations."""

_LEAST_LSB = 0.2
_SHARES = np.geomspace(0.35, 1.4, 9)
"""Noises that are tried, as multiples of the fitted noise, which includes the leaps."""

_OFFSETS, _SLOPES = 96, 41
_STRETCHES = 1.25
"""Largest distance of the tried offsets from the fitted one, in stretches."""

_FORM_MEAN, _FORM_VARIANCE = 0.03, 0.1
"""Model errors that are allowed: of a mean, as a share of the noise; of a variance, as a share of itself."""


class _Bins(NamedTuple):
    """Parts of phases at one temperature, of one axis, in counts. `face` numbers the face that was up; (b,) rows,
    expected reading without bias, temperature less the reference temperature, mean, variance.
    """

    face: Integers
    rows: Floats
    applied: Floats
    warm_degc: Floats
    mean: Floats
    variance: Floats


class _Moments(NamedTuple):
    """At each point in one period of the codes: shift of the mean, variance, variance of the variance."""

    shift: Floats
    variance: Floats
    unsure: Floats


def behind(evidence: Evidence, coded: Coded, period: int, stretch: int) -> FittedParameters | None:
    """Return the parameters with which `coded` makes the means and variances of the phases at rest; None without such
    phases. `coded` has the given `period` in counts and moves no code by more than a `stretch`.
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
    """Yield the entries of `_Bins` for each temperature, except the face."""
    raw, residual = phase.raw.segments, phase.residual.segments
    is_usable = (raw.rows > 1) & np.isfinite(raw.temperature_degc)
    warm = raw.temperature_degc - REFERENCE_DEGC
    applied = raw.mean[:, axis] - residual.mean[:, axis] - offset - slope * warm
    variance = raw.steady_variance[:, axis] * raw.rows / np.maximum(raw.rows - 1, 1)
    degc = np.zeros(len(warm), np.int64)
    degc[is_usable] = np.floor(raw.temperature_degc[is_usable] / _BIN_DEGC)
    for number in np.unique(degc[is_usable]):
        at = is_usable & (degc == number)
        weight = raw.rows[at]
        middle = [
            float(np.average(values[at], weights=weight)) for values in (applied, warm, raw.mean[:, axis], variance)
        ]
        yield float(weight.sum()), *middle


def _behind(bins: _Bins, start: Floats, coded: Coded, period: int, stretch: int) -> Floats:
    """Return (3,) offset, slope and noise in counts, starting from the fitted ones."""
    offset, slope, noise = start
    units = UNITS_DIFFER * float(np.abs(bins.applied).max()) if np.ptp(bins.applied) > 1 else 0.0
    offsets = offset + np.linspace(-_STRETCHES, _STRETCHES, 2 * _OFFSETS + 1) * stretch
    span = float(np.ptp(bins.warm_degc))
    slopes = slope + np.linspace(-1.0, 1.0, _SLOPES) * stretch / span if span > 1 else np.array([slope])
    least_cost, parameters = np.inf, start
    for sigma in np.maximum(_SHARES * noise, _LEAST_LSB):
        table = _moments(coded, period, float(sigma))
        for steep in slopes if units == 0 else [slope]:
            costs = _costs(bins, offsets, float(steep), float(sigma), table, period)
            cost = _over_faces(costs, bins.face, offsets, units)
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
        costs = _costs(bins, np.array([offset]), slope, sigma * by, table, period)
        return float(_over_faces(costs, bins.face, np.array([offset]), units)[0])

    optimum = minimize_scalar(cost, bounds=(_SHARES[0] / _SHARES[1], _SHARES[1] / _SHARES[0]), method="bounded")
    return np.array([offset, slope, sigma * float(optimum.x)])


def _over_faces(costs: Floats, face: Integers, offsets: Floats, units: float) -> Floats:
    """Return (o,) the cost of each offset, from those of bins (o, b) on faces (b,). The level on each face may deviate
    as a unit's does, with the standard deviation `units` in counts; the deviation with the least cost counts.
    """
    if not units:
        return np.asarray(costs.sum(axis=1))
    away = (offsets[:, None] - offsets) ** 2 / (2 * units**2)
    each = [(costs[:, face == each_face].sum(axis=1)[None] + away).min(axis=1) for each_face in np.unique(face)]
    return np.asarray(np.sum(each, axis=0))


def _costs(bins: _Bins, offsets: Floats, slope: float, sigma: float, table: _Moments, period: int) -> Floats:
    """Return (o, b) the cost of the mean and the variance of each bin in nats, up to a constant."""
    level = bins.applied + slope * bins.warm_degc + offsets[:, None]
    at = np.rint(level * (len(table.shift) / period)).astype(np.int64) % len(table.shift)
    variance = table.variance[at]
    mean_square = variance / bins.rows + (_FORM_MEAN * sigma) ** 2
    variance_square = table.unsure[at] / bins.rows + (_FORM_VARIANCE * variance) ** 2
    apart = (bins.mean - level - table.shift[at]) ** 2 / mean_square
    wider = (bins.variance - variance) ** 2 / variance_square
    student = (FREEDOM + 1) / 2 * (np.log1p(apart / FREEDOM) + np.log1p(wider / FREEDOM))
    return np.asarray(student + np.log(mean_square * variance_square) / 2)


def _moments(coded: Coded, period: int, sigma: float) -> _Moments:
    """Return the moments of readings with this noise (standard deviation, in counts) at each point of a period."""
    from scipy.signal import correlate  # imported only on use, because it is slow

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
"""Probes that change if readings leap from one stretch of codes to another."""

_STEPS = tuple(2**bits for bits in range(1, 13))
_ODD_ONES = 0.01
"""Share of the codes that is ignored because it may be due to glitches."""

_HIGHEST_BIT = 12

_FURTHEST_CARRY = 64
"""Largest distance, in codes, from a multiple at which carries of coarser bits are searched. A histogram that spans
more codes than a chip's noise has gaps by itself.
"""

_LEAST_EXPECTED = 14.0
"""Fewest readings that the missing codes would hold if they were as frequent as their neighbours. By chance, this many
are missing at one of 64 places of 12 carries in less than one of a thousand recordings: exp(-14) 64 12 < 0.001.
"""

_FEWEST_CODES = 3
"""Fewest different codes whose common divisor counts: fewer have one by chance."""


def guess_quantisation(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the greatest step of which (nearly) all codes are multiples, and the power of two in it; or one step per
    axis if the axes do not share one. Otherwise suggest bits that are never set, although codes lie on both sides of
    those with the bit set; and codes that are missing before each carry.
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
    if short:  # if all but two of 16 codes are missing, two of every four are missing too
        carry = max(short, key=lambda carry: short[carry][0] / carry)
        missing, at = map(float, short[carry])
        coarse = Quantisation(carry_lsb=float(carry), missing_lsb=missing, carry_at_lsb=at)
        yield from _with_what_hides(evidence, coarse, carry, short[carry][0])


def _with_power(divisor: int) -> tuple[int, int]:
    """Return the divisor, and the greatest power of two in it; the divisor itself if it is odd."""
    return divisor, max((step for step in _STEPS if divisor and divisor % step == 0), default=divisor)


def _with_what_hides(evidence: Evidence, coarse: Quantisation, period: int, stretch: int) -> Iterator[Hypothesis]:
    """Suggest the step with the fitted parameters, and with the parameters of the sensor before its codes are
    rounded.
    """
    yield Hypothesis((coarse,))
    fitted = behind(evidence, coarse.coded, period, stretch)
    if fitted is not None:
        yield Hypothesis((coarse,), fitted=fitted)


def _divisor(merged: Histogram) -> int:
    """Return the greatest common divisor of the codes, except for a hundredth of the readings; 0 without one."""
    least = (1 - _ODD_ONES) * merged.counts.sum()
    for step in np.flatnonzero(_are_divisors(merged, least))[::-1].tolist():
        on = merged.codes % step == 0
        if np.count_nonzero(on) >= _FEWEST_CODES and merged.counts[on].sum() >= least:
            return int(step)
    return 0


def _are_divisors(merged: Histogram, least: float) -> Booleans:
    """Return which numbers up to the largest step consist of prime factors that each divide `least` readings."""
    possible = np.arange(_STEPS[-1] + 1) > 1
    for prime in range(2, len(possible)):
        if possible[prime] and merged.counts[merged.codes % prime == 0].sum() < least:
            possible[prime::prime] = False
    return possible


def _is_dead(bit: int, merged: Histogram, each: Sequence[Histogram]) -> bool:
    """Return whether a bit is clear in all but a hundredth of the readings, although the codes of an axis in a phase
    lie on both sides of a stretch in which it would be set.
    """
    clear = merged.counts[merged.codes >> bit & 1 == 0].sum()
    return bool(clear >= (1 - _ODD_ONES) * merged.counts.sum()) and any(_leaps(bit, codes) for codes in each)


def _leaps(bit: int, codes: Histogram) -> bool:
    low, high = _usual_span(codes)
    return low >> (bit + 1) != high >> (bit + 1)


def _usual_span(codes: Histogram) -> tuple[int, int]:
    """Return the lowest and the highest code, without a hundredth of the readings at either end."""
    upto = np.cumsum(codes.counts)
    low, high = codes.codes[np.searchsorted(upto, np.array([_ODD_ONES, 1 - _ODD_ONES]) * upto[-1])].tolist()
    return low, high


def _before_a_carry(carry: int, merged: Histogram, each: Sequence[Histogram]) -> tuple[int, int]:
    """Return how many codes before every carry are missing, with the code of the carry in their place, and the distance
    of the carries from multiples of `carry`; (0, 0) if none are missing. Carries are at multiples, unless an offset
    shifts them.
    """
    counts = np.bincount(merged.codes % carry, weights=merged.counts, minlength=carry)
    spans = np.array([_usual_span(codes) for codes in each])
    for at in range(min(carry, _FURTHEST_CARRY)):
        if missing := _missing(carry, np.roll(counts, -at), spans - at):
            return missing, at
    return 0, 0


def _missing(carry: int, counts: Floats, spans: Integers) -> int:
    """Return how many codes are missing before every multiple of `carry`; 0 if none. `counts` (carry,) are readings by
    the remainder of their codes. Readings of an axis in a phase, with the lowest and highest codes `spans` (p, 2), must
    lie on either side of a multiple.
    """
    upto = np.cumsum(counts[::-1])  # readings of the last one, two, ... codes before the carry
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
"""Standard deviations by which the last code must be more frequent than the code before it."""

_MOST_LIMITS = 2


def guess_saturation(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the largest codes at which an axis piles up, as the limits of all axes; those of each axis that piles up,
    alone; and both ends of each axis, about its own centre, if an axis piles up at both ends, or if it piles up at one
    end and exceeds the opposite code at the other, which then is the end of the converter.
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
    """Return the codes at which an axis ends: those with a pile, or the code with a pile and the end of the converter's
    span, if the axis exceeds the opposite of the pile; () if it may end at opposite codes.
    """
    if len(ends) == 1:
        (end,) = ends
        if end > 0 and min(codes) < -end:
            return span.lowest, end
        return (end, span.highest) if end < 0 and max(codes) > -end else ()
    return tuple(ends)


def _piled(histogram: Histogram) -> Iterator[int]:
    """Yield the ends with a pile. The square root of a Poisson count has a standard deviation of 1/2."""
    if len(histogram.codes) < 2:
        return
    for last, before in ((0, 1), (-1, -2)):
        here, roots = np.sqrt(histogram.counts[[last, before]] + 3 / 8)
        if np.sqrt(2) * (here - roots) > _PILE:
            yield int(histogram.codes[last])


def _distinct_limits(limits: list[int]) -> list[int]:
    """Return descending codes, without those that differ from the one before only by rounding."""
    return [code for at, code in enumerate(limits) if at == 0 or limits[at - 1] - code > 1]
