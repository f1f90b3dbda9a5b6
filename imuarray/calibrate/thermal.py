"""Thermal calibration: slopes of counts over temperature from heatings, with curvature, drift and thermal lag.

The model of one axis in one heating is ``counts = offset + slope (T - reference) + quadratic (T - reference)^2 + drift
t + noise``, where T passes a first-order lag that the three axes share and the noise wanders. The lag has no closed
form: a grid of lags is fitted, each weighted by its likelihood, so that the uncertainty of the lag is part of a slope's
standard error.

Every fit includes the curvature, significant or not. Without it, a ramp that spends most of its time at one end would
give the slope at that end, with a standard error that ignores the other temperatures, and a curvature would be mistaken
for a lag.

An axis that carries the gravity g (in units of g) has the slope ``bias slope + g * sensitivity * scale slope``. One
orientation gives one such equation with two unknowns (section 5.2.5 of the paper); logs of opposite faces give both.
The result also states the cancellation by pairs of opposing axes (`imuarray.calibrate.opposed`).

Slopes are fitted by least squares, by cosine transform, in noise with an unknown slow part. The noise of the rows
(means of segments, one step apart) is modelled as white noise plus a wander: a random walk, or a Gauss-Markov process
of some correlation time. Cosines of the row number (DCT-II) are the principal components of a random walk with unknown
level (its increments' Neumann boundary), and nearly those of the Gauss-Markov processes; the constant is the zeroth
cosine and drops out. With ``lambda_k = 2 - 2 cos(pi k / n)`` a cosine then has the variance::

    S_k = 1 + a^2 / (n (lambda_k + (step / correlation time)^2)),     times an unknown variance

Slopes depend on the few slowest cosines. The restricted likelihood of a whole log contains little information about
these, so it only determines their weights. The uncertainty of an estimate is scaled by the residuals of the slow
cosines themselves, with their few degrees of freedom (as in Lazarus, Lewis, Stock and Watson, J. Bus. Econ. Stat. 36,
2018). Intervals of 95 % then contained the truth in 97 to 98 % of logs with white noise, and in 90 to 99 % of those
with wander, random walks and flicker noise of any size; with the likelihood alone, they did so in only 76 to 93 % of
logs with random walks or flicker noise.

A gap between rows counts as one step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from imuarray.arrays import Floats
from imuarray.axes import UP_AXES, up_vector
from imuarray.calibrate.fits import refuse_imprecise
from imuarray.calibrate.model import BIAS, BIAS_OR_SCALE, Calibration, SensorCalibration, Thermal, nominal
from imuarray.calibrate.motion import refuse_motion
from imuarray.calibrate.opposed import OpposedSlopes, opposed_slopes
from imuarray.calibrate.pose_readings import sensor_in
from imuarray.calibrate.segments import SegmentMeans, TemperatureSeries, segment_means, thermometer_of, weights
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog, require_logs
from imuarray.log.format import Phase
from imuarray.log.rests import MOVING_NAMES
from imuarray.printable import counted
from imuarray.units import INERTIAL

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_AMPLITUDES = 14
_FAINTEST = 0.1
"""Smallest amplitude of a wander: the standard deviation at the end of a random walk relative to the white noise of a
row."""

_FULL = 20.0
"""Largest amplitude, as a multiple of the square root of the number of rows: white noise is then negligible."""

_CORRELATION_TIMES = (0.5, 0.15, 0.05, 0.015)
"""Correlation times as shares of the log's length; together they have the prior probability of a random walk."""

_SLOWEST = 8
"""Fewest cosines of which the residuals scale a standard error: five or more degrees of freedom with three slow
regressors.
"""

_CONTRIBUTION = 0.8
"""Share of an estimate's variance in the cosines whose residuals scale its standard error."""


@dataclass(frozen=True)
class SlowFit:
    """Coefficients (p,), their variance (p,), and the degrees of freedom (p,) of that variance."""

    coefficients: Floats
    variance: Floats
    freedom: Floats


def cosines(columns: Floats) -> Floats:
    """Return the cosine transform (n - 1, ...) of columns (n, ...), without the constant."""
    from scipy.fft import dct  # slow to import

    return np.asarray(dct(columns, axis=0, norm="ortho")[1:])


def spectra_of_wander(rows: int) -> tuple[Floats, Floats]:
    """Return the variances (g, rows - 1) of the cosines under g noises, and the prior probabilities (g,) of these."""
    curvature = 2 - 2 * np.cos(np.pi * np.arange(1, rows) / rows)
    amplitudes = np.geomspace(_FAINTEST, _FULL * np.sqrt(rows), _AMPLITUDES)
    spectra, prior = [np.ones(rows - 1)], [1.0]
    for share in (np.inf, *_CORRELATION_TIMES):
        slow = 1 / (rows * (curvature + 1 / (share * rows) ** 2))
        spectra += [1 + amplitude**2 * slow for amplitude in amplitudes]
        prior += [1.0 if np.isinf(share) else 1 / len(_CORRELATION_TIMES)] * len(amplitudes)
    return np.array(spectra), np.array(prior) / sum(prior)


class SlowRegression:
    """Fits of one series (n,) to designs (n - 1, p) of cosines, under all noises of `spectra_of_wander`."""

    def __init__(self, series: Floats, designs: Sequence[Floats]) -> None:
        self._series = cosines(series)
        self._designs = designs
        self._spectra, self._prior = spectra_of_wander(len(series))
        likelihoods = [self._likelihood(design) for design in designs]
        self.likelihood: Floats = np.array([profile.max() for profile, _ in likelihoods])
        """(d,) logarithm of the profile likelihood of each design, at its likeliest noise."""
        self._restricted = np.array([restricted for _, restricted in likelihoods])

    def _likelihood(self, design: Floats) -> tuple[Floats, Floats]:
        """Return the logarithms of the profile and of the restricted likelihood (g,) of one design."""
        weight = 1 / self._spectra
        count = design.shape[1]
        columns = np.column_stack([design, self._series])
        pairs = (columns[:, :, None] * columns[:, None, :]).reshape(len(columns), -1)
        sums = (weight @ pairs).reshape(-1, count + 1, count + 1)
        inner, cross, whole = sums[:, :count, :count], sums[:, :count, count], sums[:, count, count]
        remaining = whole - np.einsum("gi,gi->g", np.linalg.solve(inner, cross[:, :, None])[:, :, 0], cross)
        remaining = np.maximum(remaining, 1e-12 * np.maximum(whole, 1e-300))
        rows = len(columns)
        determinant = np.log(self._spectra).sum(axis=1)
        profile = -(determinant + rows * np.log(remaining)) / 2
        restricted = -(determinant + np.linalg.slogdet(inner)[1] + (rows - count) * np.log(remaining)) / 2
        return profile, restricted

    def fits(self, share: Floats) -> list[SlowFit]:
        """Return the fit of each design, under the expected noise if the designs have the probabilities `share`
        (d,).
        """
        probable = weights(self._restricted + np.log(self._prior), axis=1)
        expected = share @ probable @ self._spectra
        return [_fit(self._series, design, expected) for design in self._designs]

    def straight_line(self, share: Floats, column: Floats) -> SlowFit:
        """Return the ordinary least-squares fit to one `column` (n - 1,) of cosines, with its uncertainty by the noise
        around the likeliest design, because the part that this design fits is not noise.
        """
        probable = weights(self._restricted + np.log(self._prior), axis=1)
        spectrum = share @ probable @ self._spectra
        design = self._designs[int(share.argmax())]
        row = (column / (column @ column))[None]
        variance, freedom = _scale_variance(row, self._series, design, spectrum)
        return SlowFit(row @ self._series, variance, freedom)


def _fit(series: Floats, design: Floats, spectrum: Floats) -> SlowFit:
    """Solve weighted least squares."""
    estimate = _estimator(design, spectrum)
    variance, freedom = _scale_variance(estimate, series, design, spectrum)
    return SlowFit(estimate @ series, variance, freedom)


def _estimator(design: Floats, spectrum: Floats) -> Floats:
    """Return the matrix (p, n - 1) of weighted least squares."""
    weighted = (design / spectrum[:, None]).T
    return np.asarray(np.linalg.inv(weighted @ design) @ weighted)


def _scale_variance(rows: Floats, series: Floats, design: Floats, spectrum: Floats) -> tuple[Floats, Floats]:
    """Return the variance (k,) of the linear estimates ``rows @ series``, scaled by the residuals of the cosines that
    contribute to each, and its degrees of freedom (k,).
    """
    estimate = _estimator(design, spectrum)
    residuals = (series - design @ (estimate @ series)) ** 2 / spectrum
    free = 1 - np.einsum("ki,ik->k", design, estimate)
    contribution = np.cumsum(rows**2 * spectrum, axis=1)
    variance, freedom = np.empty(len(rows)), np.empty(len(rows))
    for k, part in enumerate(contribution):
        slow = max(_SLOWEST, int(np.searchsorted(part, _CONTRIBUTION * part[-1])) + 1)
        freedom[k] = max(float(free[:slow].sum()), 1.0)
        variance[k] = part[-1] * residuals[:slow].sum() / freedom[k]
    return variance, freedom


_LAGS = 16
_REFINEMENTS = 4
_FEWEST_INSIDE = 4
"""Fewest lags of the grid within the interval; with fewer the grid is refined around it."""

_LONGEST_LAG = 1 / 4
"""Longest lag as a share of the log's duration: a slower lag can't be separated from drift."""

_INTERVAL_DROP = 1.92
"""Half the 95 % quantile of chi-squared with one degree of freedom: a likelihood interval's ends."""

_CURVED = 1e-3
"""Significance level of a reported quadratic term."""

_STRAIGHT = 1e-6
"""Least share of the variance of squared temperatures that is not linear in temperature and time; below it (two levels,
for example) no curvature is fitted.
"""


@dataclass(frozen=True)
class AxesFit:
    """Fit of the three axes of one sensor, arrays (3,) in counts, degC and s. The slope is the one at the reference,
    fitted together with a curvature; `quadratic_lsb_per_degc2` is 0 if not significant, its standard error nan if not
    fitted; `lag_interval_s` (2,) is the 95 % likelihood interval of the lag. `line_lsb_per_degc` is the slope of a
    straight line through the means, over the temperature without lag: for a curve, this is about the slope at the
    temperature where the log spent most of its time.
    """

    reference_degc: float
    offset_lsb: Floats
    slope_lsb_per_degc: Floats
    slope_sem_lsb_per_degc: Floats
    drift_lsb_per_s: Floats
    drift_sem_lsb_per_s: Floats
    quadratic_lsb_per_degc2: Floats
    quadratic_sem_lsb_per_degc2: Floats
    lag_s: float
    lag_interval_s: Floats
    line_lsb_per_degc: Floats
    line_sem_lsb_per_degc: Floats


def fit_axes(segments: SegmentMeans, thermometer: TemperatureSeries, reference_degc: float) -> AxesFit:
    """Fit the segment means (n, 3) of one sensor; n is at least 20."""
    span_s = float(segments.time_s[-1] - segments.time_s[0])
    shortest_s = float(np.median(np.diff(segments.time_s))) / 2
    half_s = span_s / 2
    clock = (segments.time_s - segments.time_s.mean()) / half_s
    lags_s = np.concatenate([[0.0], np.geomspace(shortest_s, span_s * _LONGEST_LAG, _LAGS)])
    for _ in range(_REFINEMENTS):
        warm = thermometer.lagged(segments.time_s, lags_s.tolist()) - reference_degc
        curved = _determines_curvature(clock, warm[:, 0])
        regressors = [[warm[:, lag], clock, warm[:, lag] ** 2][: 2 + curved] for lag in range(len(lags_s))]
        designs = [_Design(np.column_stack(columns)) for columns in regressors]
        axes = [_Axis(column, designs) for column in segments.mean.T]
        likelihood = np.sum([axis.likelihood for axis in axes], axis=0)
        inside = np.flatnonzero(likelihood >= likelihood.max() - _INTERVAL_DROP)
        interval_s = lags_s[[max(0, inside[0] - 1), min(len(lags_s) - 1, inside[-1] + 1)]]  # the next lags of the grid
        if len(inside) >= _FEWEST_INSIDE or lags_s[inside[0]] == 0:
            break
        lags_s = np.geomspace(max(interval_s[0], shortest_s / 2), interval_s[1], _LAGS)
    share = weights(likelihood)
    offset, slope, slope_sem, drift, drift_sem, quadratic, quadratic_sem = np.array(
        [axis.result(share) for axis in axes]
    ).T
    line, line_sem = np.array([axis.straight_line(share, thermometer.at(segments.time_s)) for axis in axes]).T
    return AxesFit(
        reference_degc,
        offset,
        slope,
        slope_sem,
        drift / half_s,
        drift_sem / half_s,
        quadratic,
        quadratic_sem,
        _peak(lags_s, likelihood),
        interval_s,
        line,
        line_sem,
    )


class _Design:
    """The regressors (n, p) at one lag: their means (p,), and their cosines (n - 1, p) scaled to unit spread."""

    def __init__(self, columns: Floats) -> None:
        self.mean = columns.mean(axis=0)
        self.spread = np.maximum(columns.std(axis=0), 1e-300)
        self.cosines = cosines(columns / self.spread)


class _Axis:
    """The fits of one axis at all lags."""

    def __init__(self, counts: Floats, designs: Sequence[_Design]) -> None:
        self._designs = designs
        self._mean = float(counts.mean())
        self._scale = float(counts.std()) or 1.0
        self._regression = SlowRegression((counts - self._mean) / self._scale, [each.cosines for each in designs])
        self.likelihood = self._regression.likelihood

    def result(self, share: Floats) -> tuple[float, ...]:
        """Return offset, slope, drift and quadratic term, the last three each followed by its standard error, averaged
        over lags of probabilities `share` (l,).
        """
        from scipy.special import stdtr  # slow to import

        fits = self._regression.fits(share)
        values = np.array([fit.coefficients / design.spread for fit, design in zip(fits, self._designs, strict=True)])
        variances = np.array([fit.variance / design.spread**2 for fit, design in zip(fits, self._designs, strict=True)])
        freedom = share @ np.array([fit.freedom for fit in fits])
        offset = share @ np.array(
            [-float(value @ design.mean) for value, design in zip(values, self._designs, strict=True)]
        )
        mean = share @ values
        variance = share @ variances + share @ (values - mean) ** 2
        sem = self._scale * _normal_sem(variance, freedom)
        slope, drift = (self._scale * mean[:2]).tolist()
        quadratic, quadratic_sem = 0.0, np.nan
        if len(mean) > 2:
            chance = 2 * stdtr(freedom[2], -abs(mean[2]) / np.sqrt(max(variance[2], 1e-300)))
            quadratic, quadratic_sem = self._scale * float(mean[2]) * (chance < _CURVED), float(sem[2])
        offset = self._mean + self._scale * float(offset)
        return offset, slope, float(sem[0]), drift, float(sem[1]), quadratic, quadratic_sem

    def straight_line(self, share: Floats, degc: Floats) -> tuple[float, float]:
        """Return the slope of a straight line over temperatures (n,), and its standard error."""
        fit = self._regression.straight_line(share, cosines(degc))
        return self._scale * float(fit.coefficients[0]), self._scale * float(_normal_sem(fit.variance, fit.freedom)[0])


def _normal_sem(variance: Floats, freedom: Floats) -> Floats:
    """Return standard errors that are enlarged so that a normal 95 % interval equals that of Student's t."""
    from scipy.special import ndtri, stdtrit  # slow to import

    return np.asarray(np.sqrt(variance) * stdtrit(freedom, 0.975) / ndtri(0.975))


def _determines_curvature(clock: Floats, warm: Floats) -> bool:
    """Return whether squares of temperatures (n,) are linearly independent of temperature and time."""
    squares = warm**2
    design = np.column_stack([np.ones(len(warm)), clock, warm])
    residual = squares - design @ np.linalg.lstsq(design, squares, rcond=None)[0]
    return bool(np.var(residual) > _STRAIGHT * np.var(warm) ** 2)


def _peak(lags_s: Floats, likelihood: Floats) -> float:
    """Return the most likely lag: the vertex of a parabola through the best lag of the grid and its neighbours, over
    the logarithm of the lag.
    """
    best = int(likelihood.argmax())
    if best <= 1 or best == len(lags_s) - 1:
        return float(lags_s[best])
    before, top, after = likelihood[best - 1 : best + 2]
    step = np.log(lags_s[best + 1] / lags_s[best])
    return float(lags_s[best] * np.exp(step * (before - after) / (2 * (before - 2 * top + after))))


SEGMENT_S = 5.0

CARRIES_G = 0.5
"""Least component of gravity along an axis that carries it, and least difference of that component between two
orientations that separate bias from scale."""

_FEWEST_SEGMENTS = 20

MOST_SEM_PER_DEGC: Mapping[str, float] = MappingProxyType({"specific_force": 0.01, "angular_rate": 0.5})
"""Largest standard error of a measured slope, per degC, by quantity in its unit: ten times the slope in the data sheets
(ADX-62, BMA-115, L3G-71).
"""
_IMPRECISE = (
    "these logs determine the slope of axis {axis} only to {sem} {unit}/degC; other changes, such as drift, are larger"
)
_LEAST_CHANGE_DEGC = 2.0
_LEAST_BEND = 0.05


@dataclass(frozen=True)
class HeatingFit:
    """Fit of one sensor in one log: its axes, the kind of thermometer and the lowest and highest temperature
    (`span_degc`), and the gravity (3,) in g along its axes.
    """

    sensor: str
    log: str
    thermometer: str
    span_degc: tuple[float, float]
    gravity_g: Floats
    fit: AxesFit


@dataclass(frozen=True, repr=False)
class ThermalResult:
    """Result of `calibrate_thermal`: the calibration (of `thermal` only), the fit of every sensor in every log, and the
    slopes of pairs of opposing axes.
    """

    calibration: Calibration
    heatings: tuple[HeatingFit, ...]
    pairs: tuple[OpposedSlopes, ...]

    def plot(self) -> Figure:
        """Plot the slope of every axis with two standard errors, in mg or dps per degree; MissingExtraError without
        matplotlib.
        """
        return self.calibration.plot("thermal")

    def __repr__(self) -> str:
        logs = len({heating.log for heating in self.heatings})
        return f"<ThermalResult: slopes of {len(self.calibration.sensors)} sensors from {counted(logs, 'log')}>"

    def _repr_html_(self) -> str:
        """Return a table of slopes with their standard errors, for notebooks."""
        from imuarray.calibrate.plots import slope_rows
        from imuarray.html_table import html_table

        heading = ("axis", "unit", "slope per degC", "standard error", "lag, s", "slope of")
        return html_table(repr(self), heading, slope_rows(self.calibration))


def calibrate_thermal(*logs: Log, segment_s: float = SEGMENT_S) -> ThermalResult:
    """Measure the slopes with temperature of every inertial sensor from one log, or from several logs of the same array
    in different orientations.

    The box must stand still in a log, except in phases called `motion`, which are ignored. CalibrationError for a log
    without a thermometer, that is too short, whose temperature hardly changed, or that has several orientations.
    """
    require_logs(logs, "calibrate_thermal(*logs)")
    first = logs[0]
    sensors = [sensor for sensor in first.sensors.values() if sensor.quantity in INERTIAL and len(sensor)]
    if not sensors:
        raise CalibrationError(f"{first.path}: it has no inertial sensor")
    for log in logs:
        _refuse_moving(log)
    ups = [up_of(log, segment_s) for log in logs]
    result = {sensor.name: _heatings(sensor, logs, ups, segment_s) for sensor in sensors}
    fitted = {sensor.name: _combine(sensor, result[sensor.name]) for sensor in sensors}
    for sensor in sensors:
        if (thermal := fitted[sensor.name].thermal) is not None:
            refuse_imprecise(sensor, thermal.slope_sem_lsb_per_degc, MOST_SEM_PER_DEGC, _IMPRECISE)
    return ThermalResult(
        Calibration(fitted, tuple(str(log.path) for log in logs)).stamped(logs),
        tuple(heating for heatings in result.values() for heating in heatings),
        tuple(opposed_slopes(sensors, fitted)),
    )


def _motions(log: Log) -> list[Phase]:
    """Return the phases with the name of a motion, which are ignored."""
    return [phase for phase in log.phases if phase.name in MOVING_NAMES]


def _refuse_moving(log: Log) -> None:
    """Raise CalibrationError for a log in which the box moved outside the phases `motion`."""
    times = [(int(sensor.time[0]), int(sensor.time[len(sensor) - 1])) for sensor in log.sensors.values() if len(sensor)]
    if times:
        whole = ("", min(times)[0], max(end for _, end in times))
        refuse_motion(log, [whole], _motions(log))


def up_of(log: Log, segment_s: float = SEGMENT_S) -> Floats | None:
    """Return the unit vector (3,) in the box frame that pointed up in a log, as its phases state or its accelerometers
    measured; None without either. CalibrationError if the phases state several.
    """
    named = {phase.up for phase in log.phases if phase.up}
    if len(named) > 1 or not named <= set(UP_AXES):
        raise CalibrationError(
            f"{log.path}: its phases have up {', '.join(sorted(named))}; each log must have one orientation"
        )
    if named:
        return np.array(up_vector(named.pop()))
    forces_g = [
        sensor.orientation @ segment_means(sensor, segment_s).mean.mean(axis=0) / sensor.sensitivity
        for sensor in log.of("specific_force")
        if len(sensor) and sensor.sensitivity > 0
    ]
    mean = np.sum(forces_g, axis=0) if forces_g else np.zeros(3)
    return np.asarray(mean / np.linalg.norm(mean)) if mean.any() else None


def _heatings(
    sensor: SensorLog, logs: Sequence[Log], ups: Sequence[Floats | None], segment_s: float
) -> list[HeatingFit]:
    """Fit the sensor in every log, with the middle of the first log's temperatures as reference: the slope of a
    parabola there is the mean slope over the range, wherever the box spent most of its time.
    """
    results: list[HeatingFit] = []
    for log, up in zip(logs, ups, strict=True):
        sensor_of_log = sensor_in(log, sensor)
        thermometer = thermometer_of(log, sensor_of_log, segment_s)
        if thermometer is None:
            raise CalibrationError(f"{sensor_of_log.where}: no thermometer: no barometer, reference or chip has one")
        if results and thermometer.kind != results[0].thermometer:
            raise CalibrationError(f"{sensor_of_log.where}: the thermometer differs from {sensor.where}")
        reference = (
            results[0].fit.reference_degc
            if results
            else round(float(thermometer.degc.min() + thermometer.degc.max()) / 2, 2)
        )
        results.append(_heating(sensor_of_log, log, up, thermometer, reference, segment_s))
    return results


def _heating(
    sensor: SensorLog,
    log: Log,
    up: Floats | None,
    thermometer: TemperatureSeries,
    reference_degc: float,
    segment_s: float,
) -> HeatingFit:
    """Fit one sensor of one log; CalibrationError if the data are not sufficient for a fit."""
    segments = segment_means(sensor, segment_s, _motions(log))
    if len(segments.time_s) < _FEWEST_SEGMENTS:
        raise CalibrationError(
            f"{sensor.where}: {counted(len(segments.time_s), 'segment')} of {segment_s:g} s with valid readings;"
            f" {_FEWEST_SEGMENTS} are required"
        )
    degc = thermometer.at(segments.time_s)
    span = (float(degc.min()), float(degc.max()))
    if span[1] - span[0] < _LEAST_CHANGE_DEGC:
        raise CalibrationError(
            f"{sensor.where}: the temperature changed by {np.ptp(degc):.1f} degC; {_LEAST_CHANGE_DEGC:g} are required"
        )
    steady = np.polynomial.Polynomial.fit(segments.time_s, degc, 1)(segments.time_s)
    if np.std(degc - steady) < _LEAST_BEND * np.std(degc):
        raise CalibrationError(f"{sensor.where}: the temperature changed so steadily that its effect could be drift")
    gravity = np.zeros(3) if up is None else np.asarray(sensor.orientation.T @ up)
    fit = fit_axes(segments, thermometer, reference_degc)
    return HeatingFit(sensor.name, str(log.path), thermometer.kind, span, gravity, fit)


def _combine(sensor: SensorLog, heatings: Sequence[HeatingFit]) -> SensorCalibration:
    """Combine the slopes of one sensor from all its heatings; the lag is the one with the narrowest interval."""
    slopes, sems = (
        np.array([getattr(h.fit, f"slope_{name}") for h in heatings]) for name in ("lsb_per_degc", "sem_lsb_per_degc")
    )
    curves, curve_sems = (
        np.array([getattr(h.fit, f"quadratic_{name}") for h in heatings])
        for name in ("lsb_per_degc2", "sem_lsb_per_degc2")
    )
    curve_sem = np.sqrt(np.sum(curve_sems**2, axis=0)) / len(heatings)
    gravity = np.array([heating.gravity_g for heating in heatings])
    is_accelerometer = sensor.quantity == "specific_force"
    axes = [_axis(slopes[:, k], sems[:, k], gravity[:, k] * is_accelerometer, sensor.sensitivity) for k in range(3)]
    bias, bias_sem, scale, scale_sem = np.array([values for values, _ in axes]).T
    sharpest = min(heatings, key=lambda heating: float(np.diff(np.log(heating.fit.lag_interval_s + 1.0))[0]))
    thermal = Thermal(
        slope_lsb_per_degc=bias,
        slope_sem_lsb_per_degc=bias_sem,
        reference_degc=heatings[0].fit.reference_degc,
        meaning=tuple(meaning for _, meaning in axes),
        thermometer=heatings[0].thermometer,
        lag_s=sharpest.fit.lag_s,
        lag_interval_s=sharpest.fit.lag_interval_s,
        quadratic_lsb_per_degc2=np.mean(curves, axis=0) if curves.any() else None,
        scale_slope_per_degc=scale if np.isfinite(scale).any() else None,
        scale_slope_sem_per_degc=scale_sem if np.isfinite(scale).any() else None,
        quadratic_sem_lsb_per_degc2=curve_sem if np.isfinite(curve_sem).all() else None,
    )
    return replace(nominal(sensor), thermal=thermal)


def _axis(slopes: Floats, sems: Floats, gravity_g: Floats, sensitivity: float) -> tuple[tuple[float, ...], str]:
    """Return the slope of one axis, its standard error, the relative slope of its scale and its standard error (nan if
    not determined), from slopes (n,) at n gravities; and the meaning of the slope.

    The fit is weighted least squares; the standard errors are enlarged if the slopes scatter more than expected.
    """
    separable = float(np.ptp(gravity_g)) > CARRIES_G
    sems = np.maximum(sems, 1e-12)  # counts that never changed
    design = np.column_stack([np.ones(len(slopes)), gravity_g])[:, : 2 if separable else 1]
    weighted = design / sems[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    values = covariance @ weighted.T @ (slopes / sems)
    freedom = len(slopes) - design.shape[1]
    excess = float(np.sum(((slopes - design @ values) / sems) ** 2)) / freedom if freedom else 1.0
    errors = np.sqrt(np.diag(covariance) * max(1.0, excess))
    if separable:
        return (values[0], errors[0], values[1] / sensitivity, errors[1] / sensitivity), BIAS
    meaning = BIAS_OR_SCALE if np.abs(gravity_g).max() > CARRIES_G else BIAS
    return (values[0], errors[0], np.nan, np.nan), meaning
