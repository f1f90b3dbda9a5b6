"""Effects of temperature: fits of the levels over all phases at rest, less the mean level of each log and face."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Integers, triple
from imuarray.gap.inference.effects.candidate import Hypothesis, with_removal
from imuarray.gap.inference.effects.levels import Levels, centre, levels
from imuarray.gap.inference.effects.response import DOUBTFUL, ODD, response, size_of_score
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.model.populations import scale_slope_tolerance, scale_tolerance, steepest_slope
from imuarray.gap.model.rest import REFERENCE_DEGC
from imuarray.log.format import SensorHeader
from imuarray.simulate.effects.temperature import ThermalBias, ThermalLag, ThermalScale

_TRACES = (
    *("thermal_slope", "thermal_square", "thermal_change", "thermal_residual"),
    *("mean_halves", "wander", "mean_return", "mean", "allan_longest", "slow_own_axes", "slow_between_axes"),
)
"""Probes that change if a level does not depend linearly on the temperature."""

_BEYOND = 2.7
_LEAST_DEGC = 1.0
"""Least span of temperatures that determines a slope, in degC."""


class _Fit(NamedTuple):
    """(c, 3) coefficients of columns for one axis each, and their standard errors; 0 and infinite if the columns cannot
    be distinguished.
    """

    coefficient: Floats
    error: Floats


def _warmth(table: Levels) -> Floats:
    """Return (n,) degC above the reference temperature of biases."""
    return np.asarray(table.degc - REFERENCE_DEGC)


def _is_warmed(table: Levels) -> bool:
    """Return whether the temperature changed within a log and face."""
    return any(np.ptp(table.degc[at]) >= _LEAST_DEGC for at in table.groups())


def _fit_levels(columns: Floats, values: Floats, group: Integers | None) -> _Fit:
    """Return the least-squares fit of values (n, 3) by columns (n, c), both less the means of their groups (None:
    nothing is subtracted).
    """
    if group is not None:
        columns, values = centre(columns, group), centre(values, group)
    size = np.sqrt((columns**2).sum(axis=0))
    scaled = columns / np.where(size > 0, size, 1.0)
    nothing = np.zeros((columns.shape[1], values.shape[1]))
    if len(columns) <= columns.shape[1] + 1 or np.linalg.matrix_rank(scaled, tol=1e-2) < columns.shape[1]:
        return _Fit(nothing, np.full_like(nothing, np.inf))
    solution = np.linalg.lstsq(scaled, values, rcond=None)[0]
    residuals = values - scaled @ solution
    variance = (residuals**2).sum(axis=0) / (len(columns) - columns.shape[1])
    inverse = np.diag(np.linalg.inv(scaled.T @ scaled))
    return _Fit(solution / size[:, None], np.sqrt(inverse[:, None] * variance) / size[:, None])


_CLEAR = 2.0
"""Standard errors from which on a coefficient differs from 0."""


def guess_thermal_bias(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the quadratic term by least squares; and a linear term if it is one that the base model does not fit: too
    steep for a part, or a change since an earlier recording, or determined only by the levels of several logs.
    """
    table = levels(evidence)
    if not len(table.degc) or not evidence.is_odd(*_TRACES, beyond=_BEYOND):
        return
    if _is_warmed(table):
        yield from _squares(table)
        yield from _unfitted_slope(evidence)
    elif np.ptp(table.degc) >= _LEAST_DEGC:
        yield from _slope_between_logs(table)


def _squares(table: Levels) -> Iterator[Hypothesis]:
    """Suggest quadratic terms with the slope that belongs to them: the fitted straight line follows the curve at the
    temperatures of the recording, and a square that is merely added would deviate from it there.
    """
    warm = _warmth(table)
    fit = _fit_levels(np.stack([warm, warm**2], axis=1), table.mean, table.group)
    clear = np.abs(fit.coefficient[1]) > _CLEAR * fit.error[1]
    if clear.any():
        slope, quadratic = np.where(clear, fit.coefficient, 0.0).tolist()
        yield Hypothesis((ThermalBias(tuple(slope), tuple(quadratic)),), ("quadratic",))


def _unfitted_slope(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a slope that is too steep for a part, or one that has changed since an earlier recording, to which the
    base model was fitted.
    """
    slope = np.nan_to_num(evidence.typical("thermal_slope"))
    odd = np.abs(evidence.score("thermal_slope")) > _BEYOND
    if evidence.is_refitted:
        odd &= np.abs(slope) > steepest_slope(evidence.header)
    x, y, z = np.where(odd, slope, 0.0).tolist()
    if any((x, y, z)):
        yield Hypothesis((ThermalBias(slope=(x, y, z)),), ("slope",))


def _slope_between_logs(table: Levels) -> Iterator[Hypothesis]:
    """Suggest a slope by the levels on one face at several temperatures."""
    faces = np.unique(np.nan_to_num(table.applied_g.round(3), nan=9.0), axis=0, return_inverse=True)[1].reshape(-1)
    fit = _fit_levels(_warmth(table)[:, None], table.mean, faces)
    if fit.coefficient.any():
        yield Hypothesis((ThermalBias(slope=triple(fit.coefficient[0])),), ("slope",))


_TRIED_LAGS = 30
_GRID_STEPS = 2000
"""Steps into which a log is divided to filter the reference temperature."""

_CLEAR_LAG = 3.0
"""Nats by which a lag must fit better than no lag."""

_CLEAR_PART = 8.0
"""Nats by which a lagging part must improve the fit of an axis: it is the best of thirty lags on three axes."""

_LAGS_APART = 3.0


def guess_thermal_lag(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the time constant with which the lagged reference fits the levels and the chip's own thermometer best,
    and another by the coefficient of dT/dt, which is slope times lag.
    """
    for guess in with_removal(evidence, ThermalLag.name, _thermal_lag_hypotheses(evidence)):
        of_all = any(isinstance(effect, ThermalLag) and _concerns_all_axes(effect) for effect in guess.effects)
        takes_place = bool(evidence.fitted.lag_s) and of_all  # the fitted lag has its usual value
        yield replace(guess, removed=ThermalLag.name) if takes_place else guess


def _concerns_all_axes(lag: ThermalLag) -> bool:
    """Return whether the whole element lags, or a part of the bias of every axis."""
    return not any(lag.slope) or all(lag.slope)


def _thermal_lag_hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    table = levels(evidence)
    if not len(table.degc) or not _is_warmed(table):
        return
    if not evidence.is_odd(*_TRACES, beyond=_BEYOND):
        return
    best_s, slow_s = _best_lag_s(table), _lag_from_change(evidence)
    for time_constant_s in (
        best_s,
        slow_s if not best_s or not 1 / _LAGS_APART < slow_s / best_s < _LAGS_APART else 0.0,
    ):
        if time_constant_s > 0:
            yield Hypothesis((ThermalLag(time_constant_s),), ("time_constant_s",))
    yield from _of_a_part(evidence, table, best_s > 0)


def _of_a_part(evidence: Evidence, table: Levels, lags: bool) -> Iterator[Hypothesis]:
    """Suggest a lag of a part of the bias on the axes on which it is clear. The rest follows the temperature at once,
    with another slope than the fit without the lag. The thermometer does not lag with this part. If all axes lag, and
    the sensor `lags` more than is fitted, either the element lags, which needs fewer parameters, or a part of the bias
    of each axis.
    """
    times_s = _lags_s(table)
    gains = np.array([_gains_of_part(table, time_s) for time_s in times_s]).reshape(-1, 3)
    if not (gains > _CLEAR_PART).any():
        return
    best, _ = np.unravel_index(int(gains.argmax()), gains.shape)
    time_constant_s, clear = float(times_s[best]), gains[best] > _CLEAR_PART
    if clear.all() and not lags:
        return
    warm, lagged_warm = _warmth(table), lagged(table, time_constant_s) - REFERENCE_DEGC
    ordinary, mean = evidence.fitted, table.mean
    if clear.all() and ordinary.lag_s:  # the part replaces the fitted lag
        mean = mean + np.outer(lagged(table, ordinary.lag_s) - table.degc, ordinary.slope)
    fit = _fit_levels(np.stack([lagged_warm, warm], axis=1), mean, table.group)
    slope, change = np.where(clear, fit.coefficient, 0.0)
    offset = np.median(mean - lagged_warm[:, None] * slope - warm[:, None] * change, axis=0)
    base_offset, base_slope = np.add(ordinary.offset, np.where(clear, offset, 0.0)), np.add(ordinary.slope, change)
    (x, y, z), (slope_x, slope_y, slope_z) = base_offset.tolist(), base_slope.tolist()
    part = ThermalLag(time_constant_s, tuple(slope.tolist()), REFERENCE_DEGC)
    yield Hypothesis(
        (part,),
        ("slope", "time_constant_s"),
        fitted=replace(ordinary, offset=(x, y, z), slope=(slope_x, slope_y, slope_z)),
    )


def _gains_of_part(table: Levels, time_constant_s: float) -> Floats:
    """Return (3,) nats by which the temperature and the lagged temperature explain the levels better than the
    temperature alone.
    """
    warm = centre(np.stack([table.degc, lagged(table, time_constant_s)], axis=1), table.group)
    squares, squares_with_part = (
        ((table.apart - some @ np.linalg.lstsq(some, table.apart, rcond=None)[0]) ** 2).sum(axis=0)
        for some in (warm[:, :1], warm)
    )
    return np.asarray(len(warm) / 2 * np.log((squares + 1e-30) / (squares_with_part + 1e-30)))


def _lags_s(table: Levels) -> Floats:
    """Return the time constants in s that are tried; none if no log has a duration."""
    span_s = max(float(np.ptp(table.time_s[table.log == log])) for log in np.unique(table.log))
    return np.geomspace(span_s / _GRID_STEPS * 2, span_s, _TRIED_LAGS) if span_s > 0 else np.zeros(0)


def _best_lag_s(table: Levels) -> float:
    """Return the time constant in s that fits best; 0 if none is better than no lag."""
    times = _lags_s(table)
    if not len(times):
        return 0.0
    misfit = [_lag_misfit(table, table.degc)] + [_lag_misfit(table, lagged(table, time)) for time in times]
    best = int(np.argmin(misfit))
    return float(times[best - 1]) if best and misfit[best] < misfit[0] - _CLEAR_LAG else 0.0


def lagged(table: Levels, time_constant_s: float) -> Floats:
    """Return (n,) temperature of an element that lags the reference and is in equilibrium when its log begins."""
    from scipy.signal import lfilter  # imported only on use, because it is slow

    degc = np.empty_like(table.degc)
    for log in np.unique(table.log):
        at = np.flatnonzero(table.log == log)
        order = at[np.argsort(table.time_s[at])]
        grid = np.linspace(table.time_s[order[0]], table.time_s[order[-1]], _GRID_STEPS)
        box = np.interp(grid, table.time_s[order], table.degc[order])
        phi = math.exp(-(grid[1] - grid[0]) / time_constant_s)
        half = (1 - phi) / 2
        element, _ = lfilter([half, half], [1.0, -phi], box, zi=[(1 - half) * box[0]])
        degc[at] = np.interp(table.time_s[at], grid, element)
    return degc


def _lag_misfit(table: Levels, degc: Floats) -> float:
    """Return the negative log likelihood of levels, and of the thermometer if there is one, that follow this
    temperature.
    """
    known = np.isfinite(table.thermometer)
    total = 0.0
    # the base model subtracted a straight line in the reference: the fit includes it again
    warm = centre(np.stack([degc, table.degc], axis=1), table.group)
    residuals = table.apart - warm @ np.linalg.lstsq(warm, table.apart, rcond=None)[0]
    total += len(residuals) / 2 * float(np.log((residuals**2).sum(axis=0) + 1e-30).sum())
    if known.all():
        heat = centre(table.thermometer[:, None], table.group)
        heated = warm[:, :1]
        residual = heat - heated @ np.linalg.lstsq(heated, heat, rcond=None)[0]
        total += len(residual) / 2 * float(np.log((residual**2).sum() + 1e-30))
    return total


def _lag_from_change(evidence: Evidence) -> float:
    """Return the lag in s by y = slope (T - lag dT/dt): the axes' coefficients of dT/dt, weighted with their slopes."""
    slope = np.array(evidence.fitted.slope)
    change = evidence.typical("thermal_change")
    return float(-(change @ slope) / (slope @ slope)) if slope.any() else 0.0


def guess_thermal_scale(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest, for an accelerometer, the part of the slope that has the sign of the force. On a single face it cannot
    be distinguished from a slope of the bias, which is fitted, and is not suggested. Also suggest the slope that
    explains the error of the scale at the temperature of the faces: no other experiment distinguishes the two.
    """
    table = levels(evidence)
    if evidence.header.quantity != "specific_force" or not len(table.degc) or np.ptp(table.degc) < _LEAST_DEGC:
        return
    if not evidence.is_odd(*_TRACES, "force_own", "motion_gain", beyond=_BEYOND):
        return
    slope = [_scale_slope(table, axis) for axis in range(3)]
    if any(slope):
        yield Hypothesis((ThermalScale((slope[0], slope[1], slope[2])),), ("slope",))
    error, warm_degc = _scale_error(evidence, table)
    if error.any():
        rarity = _rarity_of_slope(evidence.header, error, warm_degc)
        yield Hypothesis((ThermalScale(triple(error / warm_degc)),), ("slope",), rarity=rarity)


def _rarity_of_slope(header: SensorHeader, error: Floats, warm_degc: float) -> float:
    """Return the nats by which a slope of the scale that amounts to this error (3,) at a temperature is rarer than an
    error of the scale itself. Both have Cauchy distributions, as wide as what the data sheet allows a part.
    """
    shown = np.abs(error[error != 0])
    widths = np.array([abs(warm_degc) * scale_slope_tolerance(header), scale_tolerance(header)])[:, None]
    by_slope, by_scale = (np.log1p((shown / widths) ** 2) + np.log(widths)).sum(axis=1).tolist()
    return float(by_slope - by_scale)


def _scale_error(evidence: Evidence, table: Levels) -> tuple[Floats, float]:
    """Return the error (3,) of the scale on faces, 0 if it is not determined, and how many degC the faces were above
    the reference temperature.
    """
    measured_response, known = response(evidence), np.isfinite(table.applied_g).all(axis=1)
    if measured_response is None or not known.any():
        return np.zeros(3), 0.0
    faces, of_face = np.unique(table.applied_g[known], axis=0, return_inverse=True)
    warm = float(np.mean([_warmth(table)[known][of_face.ravel() == at].mean() for at in range(len(faces))]))
    score = size_of_score(evidence, "force_own")
    if abs(warm) < _LEAST_DEGC or not (score > ODD).any():
        return np.zeros(3), warm
    return np.where(score > DOUBTFUL, np.diag(measured_response.error), 0.0), warm


def _scale_slope(table: Levels, axis: int) -> float:
    """Return the slope of the scale by the slopes within logs, or else by the levels of all; 0 if neither determines
    it.
    """
    known = np.isfinite(table.applied_g[:, axis])
    applied, warm, mean = table.applied_g[known, axis], _warmth(table)[known], table.mean[known, axis : axis + 1]
    if not known.any():
        return 0.0
    within = _fit_levels(np.stack([warm, warm * applied], axis=1), mean, table.group[known])
    whole = _fit_levels(np.stack([np.ones_like(warm), warm, applied, warm * applied], axis=1), mean, None)
    for fit in (within, whole):
        if np.abs(fit.coefficient[-1, 0]) > _CLEAR * fit.error[-1, 0]:
            return float(fit.coefficient[-1, 0])
    return 0.0
