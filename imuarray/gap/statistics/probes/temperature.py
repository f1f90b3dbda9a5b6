"""Probes of the dependence on the reference temperature: linear, quadratic, and on its rate of change."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial

import numpy as np

from imuarray.arrays import Floats, Integers
from imuarray.gap.statistics.margins import CURVATURE, RATE, SLOPE, VARIANCE, VARIANCE_SLOPE, Margin
from imuarray.gap.statistics.probes.probe import NOTHING, LogProbe, Probes, log
from imuarray.gap.statistics.summary import Summary

_LEAST_DEGC = 1.0
"""Least range of temperatures from which a slope is estimated."""


def coefficient(column: int, phases: Sequence[Summary]) -> Floats:
    """Return the coefficient (3,) of T - mean (`column` 1), of its square (2), or of dT/dt (3), in the sensor's unit,
    from a fit of the segments' means with the terms up to this one.
    """
    table = _table(phases)
    if table is None:
        return NOTHING
    design, means, _ = table
    return np.asarray(np.linalg.lstsq(design[:, : column + 1], means, rcond=None)[0][column])


def residual(phases: Sequence[Summary]) -> Floats:
    """Return the log of the ratio of the residual variance of the segments' means after the full fit to that expected
    for independent readings.
    """
    table = _table(phases)
    if table is None:
        return NOTHING
    design, means, expected = table
    residuals = means - design @ np.linalg.lstsq(design, means, rcond=None)[0]
    return np.asarray(log((residuals**2).sum(axis=0) / (len(design) - design.shape[1])) - log(expected))


def noise_slope(phases: Sequence[Summary]) -> Floats:
    """Return the slope (3,) of the segments' log variance over temperature, in 1/degC; nan if it has a small range."""
    part = _SegmentColumns(phases)
    if not part.is_warmed:
        return NOTHING
    is_usable = part.rows > 3
    is_usable &= (part.variance > 0).all(axis=1)
    if np.count_nonzero(is_usable) < 4 or np.ptp(part.degc[is_usable]) < _LEAST_DEGC:
        return NOTHING
    warm = part.degc[is_usable] - part.degc[is_usable].mean()
    return np.asarray(warm @ np.log(part.variance[is_usable]) / (warm @ warm))


class _SegmentColumns:
    """Segments of several phases, concatenated; a column is computed only when it is used."""

    def __init__(self, phases: Sequence[Summary]) -> None:
        self._parts = [phase.segments for phase in phases]

    @property
    def is_warmed(self) -> bool:
        """True if the range of temperatures is sufficient for a slope; tested first, since it usually is not."""
        return bool(np.fmax.reduce(self.degc) - np.fmin.reduce(self.degc) >= _LEAST_DEGC)

    @cached_property
    def rows(self) -> Integers:
        return np.concatenate([part.rows for part in self._parts])

    @cached_property
    def degc(self) -> Floats:
        return np.concatenate([part.temperature_degc for part in self._parts])

    @property
    def warming(self) -> Floats:
        return np.concatenate([part.warming_degc_per_s for part in self._parts])

    @property
    def mean(self) -> Floats:
        return np.concatenate([part.mean for part in self._parts])

    @cached_property
    def variance(self) -> Floats:
        return np.concatenate([part.steady_variance for part in self._parts])


def _table(phases: Sequence[Summary]) -> tuple[Floats, Floats, Floats] | None:
    """Return the columns 1, T - mean, its square and dT/dt (s, 4), the means (s, 3) in the sensor's unit, and their
    expected variance (3,). None if the phases are on different faces, if the range of temperatures is less than
    `_LEAST_DEGC`, or with fewer than 8 segments.
    """
    if len({phase.phase.up for phase in phases}) > 1:
        return None
    part = _SegmentColumns(phases)
    if not part.is_warmed:
        return None
    is_usable = (part.rows > 1) & np.isfinite(part.degc)
    if np.count_nonzero(is_usable) < 8 or np.ptp(part.degc[is_usable]) < _LEAST_DEGC:
        return None
    degc = part.degc[is_usable] - part.degc[is_usable].mean()
    design = np.stack([np.ones_like(degc), degc, degc**2, part.warming[is_usable]], axis=1)
    scale = phases[0].header.sensitivity
    expected = (part.variance[is_usable] / (part.rows[is_usable, None] - 1)).mean(axis=0)
    return design, part.mean[is_usable] / scale, expected / scale**2


def _probe(about: str, moved_by: tuple[str, ...], margin: Margin, column: int, unit: str) -> LogProbe:
    return LogProbe("temperature", about, moved_by, margin, partial(coefficient, column), unit=unit)


_BIAS_AND_SCALE = ("thermal_bias", "thermal_scale")

PROBES: Probes = {
    "thermal_slope": _probe("slope of the mean over temperature", _BIAS_AND_SCALE, SLOPE, 1, "{u}/degC"),
    "thermal_square": _probe("coefficient of T^2", ("thermal_bias",), CURVATURE, 2, "{u}/degC^2"),
    "thermal_change": _probe("coefficient of dT/dt", ("thermal_lag", "clock_error"), RATE, 3, "{u} s/degC"),
    "thermal_residual": LogProbe(
        "temperature", "log of the variance beside the fit", ("thermal_lag", "random_walk"), VARIANCE, residual
    ),
    "thermal_noise": LogProbe(
        "temperature", "slope of the log variance over temperature", (), VARIANCE_SLOPE, noise_slope, unit="1/degC"
    ),
}
