"""`thermal_lag`: levels that follow the temperature of some time ago."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.levels import Levels, centre, levels
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.thermal import BEYOND, TRACES, fitted, is_warmed, warmth
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.model.rest import REFERENCE_DEGC
from imuarray.simulate.effects.temperature import ThermalLag

_TRIED = 30
_STEPS = 2000
"""Of a log, at which the reference is filtered."""

_CLEAR = 3.0
"""By so many nats a lag has to fit better than none."""

_CLEAR_PART = 8.0
"""By so many nats a lagging part has to improve the fit of an axis: the best of thirty lags on three axes."""

_APART = 3.0


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the time constant by which the lagged reference fits levels and the chip's own thermometer best; another
    by the coefficient of dT/dt, which is slope times lag.
    """
    for guess in with_removal(evidence, ThermalLag.name, _hypotheses(evidence)):
        is_of_element = any(isinstance(effect, ThermalLag) and not any(effect.slope) for effect in guess.effects)
        takes_place = bool(evidence.fitted.lag_s) and is_of_element  # the fitted lag is as long as is usual
        yield replace(guess, removed=ThermalLag.name) if takes_place else guess


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    table = levels(evidence)
    if not len(table.degc) or not is_warmed(table):
        return
    if not evidence.is_odd(*TRACES, beyond=BEYOND):
        return
    best_s, slow_s = _best(table), _from_change(evidence)
    for time_constant_s in (best_s, slow_s if not best_s or not 1 / _APART < slow_s / best_s < _APART else 0.0):
        if time_constant_s > 0:
            yield Hypothesis((ThermalLag(time_constant_s),), ("time_constant_s",))
    yield from _of_a_part(evidence, table)


def _of_a_part(evidence: Evidence, table: Levels) -> Iterator[Hypothesis]:
    """Suggest a lag of a part of the bias on the axes on which it is clear; the rest follows the temperature at once,
    by another slope than was fitted without the lag. What the thermometer feels does not lag with it. If all axes lag,
    it is the element.
    """
    times_s = _times_s(table)
    gains = np.array([_gains_of_part(table, time_s) for time_s in times_s]).reshape(-1, 3)
    if not (gains > _CLEAR_PART).any():
        return
    best, _ = np.unravel_index(int(gains.argmax()), gains.shape)
    time_constant_s, clear = float(times_s[best]), gains[best] > _CLEAR_PART
    if clear.all():
        return
    warm, lagged_warm = warmth(table), lagged(table, time_constant_s) - REFERENCE_DEGC
    fit = fitted(np.stack([lagged_warm, warm], axis=1), table.mean, table.group)
    slope, change = np.where(clear, fit.coefficient, 0.0)
    offset = np.median(table.mean - lagged_warm[:, None] * slope - warm[:, None] * change, axis=0)
    ordinary = evidence.fitted
    base_offset, base_slope = np.add(ordinary.offset, np.where(clear, offset, 0.0)), np.add(ordinary.slope, change)
    (x, y, z), (slope_x, slope_y, slope_z) = base_offset.tolist(), base_slope.tolist()
    part = ThermalLag(time_constant_s, tuple(slope.tolist()), REFERENCE_DEGC)
    yield Hypothesis(
        (part,),
        ("slope", "time_constant_s"),
        fitted=replace(ordinary, offset=(x, y, z), slope=(slope_x, slope_y, slope_z)),
    )


def _gains_of_part(table: Levels, time_constant_s: float) -> Floats:
    """Return (3,) nats by which levels over the temperature and over the lagged one are explained better than over the
    first alone.
    """
    warm = centre(np.stack([table.degc, lagged(table, time_constant_s)], axis=1), table.group)
    squares, squares_with_part = (
        ((table.apart - some @ np.linalg.lstsq(some, table.apart, rcond=None)[0]) ** 2).sum(axis=0)
        for some in (warm[:, :1], warm)
    )
    return np.asarray(len(warm) / 2 * np.log((squares + 1e-30) / (squares_with_part + 1e-30)))


def _times_s(table: Levels) -> Floats:
    """Return the time constants that are tried; none where no log lasts."""
    span_s = max(float(np.ptp(table.time_s[table.log == log])) for log in np.unique(table.log))
    return np.geomspace(span_s / _STEPS * 2, span_s, _TRIED) if span_s > 0 else np.zeros(0)


def _best(table: Levels) -> float:
    """0 if none is better than no lag."""
    times = _times_s(table)
    if not len(times):
        return 0.0
    misfit = [_misfit(table, table.degc)] + [_misfit(table, lagged(table, time)) for time in times]
    best = int(np.argmin(misfit))
    return float(times[best - 1]) if best and misfit[best] < misfit[0] - _CLEAR else 0.0


def lagged(table: Levels, time_constant_s: float) -> Floats:
    """Return (n,) temperature of an element behind the reference, in equilibrium when its log begins."""
    from scipy.signal import lfilter  # its weight is for those who ask

    degc = np.empty_like(table.degc)
    for log in np.unique(table.log):
        at = np.flatnonzero(table.log == log)
        order = at[np.argsort(table.time_s[at])]
        grid = np.linspace(table.time_s[order[0]], table.time_s[order[-1]], _STEPS)
        box = np.interp(grid, table.time_s[order], table.degc[order])
        phi = math.exp(-(grid[1] - grid[0]) / time_constant_s)
        half = (1 - phi) / 2
        element, _ = lfilter([half, half], [1.0, -phi], box, zi=[(1 - half) * box[0]])
        degc[at] = np.interp(table.time_s[at], grid, element)
    return degc


def _misfit(table: Levels, degc: Floats) -> float:
    """Negative log likelihood of levels, and of the thermometer if there is one, that follow this temperature."""
    known = np.isfinite(table.thermometer)
    total = 0.0
    # the base model took a straight line in the reference out: it goes back in
    warm = centre(np.stack([degc, table.degc], axis=1), table.group)
    residuals = table.apart - warm @ np.linalg.lstsq(warm, table.apart, rcond=None)[0]
    total += len(residuals) / 2 * float(np.log((residuals**2).sum(axis=0) + 1e-30).sum())
    if known.all():
        heat = centre(table.thermometer[:, None], table.group)
        heated = warm[:, :1]
        residual = heat - heated @ np.linalg.lstsq(heated, heat, rcond=None)[0]
        total += len(residual) / 2 * float(np.log((residual**2).sum() + 1e-30))
    return total


def _from_change(evidence: Evidence) -> float:
    """y = slope (T - lag dT/dt): the axes' coefficients of dT/dt, weighted with their slopes."""
    slope = np.array(evidence.fitted.slope)
    change = evidence.typical("thermal_change")
    return float(-(change @ slope) / (slope @ slope)) if slope.any() else 0.0


THERMAL_LAG = Candidate(
    ThermalLag.name, guesses, {"heating": "heat by 20 degC within 2 minutes and let cool for 20, twice"}
)
