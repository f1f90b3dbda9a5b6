"""Ordinary parameters behind missing codes: bias, slope and noise before a converter without some of its codes.

A fit takes means and variances as they are. Where readings leap over a stretch of codes that never come, a few of them
in a hundred are a stretch away from where they belong: the variance is that of the leaps, and a bias that warms up
towards the stretch seems to have another slope.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import comb
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.special import ndtr

from imuarray.arrays import Floats, Integers
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence
from imuarray.gap.model.rest import REFERENCE_DEGC, FittedParameters
from imuarray.gap.statistics.synthetic_likelihood import FREEDOM

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
