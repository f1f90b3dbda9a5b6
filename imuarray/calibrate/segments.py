"""Means of a long log over segments of some seconds, and of the temperature over the same time.

Rows are read block by block; one row per segment is kept.

Means of segments of a sensor's output are correlated, because its bias wanders. Their covariance is modelled as white
noise plus a first-order Gauss-Markov process::

    C[i, j] = (1 - white) exp(-|t_i - t_j| / correlation time) + white (i = j),     times an unknown variance

Correlation time and white share are unknown, and uncertainties from the best-fitting pair alone are too small.
Therefore a grid of pairs is used, which is refined around the likely ones. Each pair is weighted by its restricted
likelihood (Harville, J. Am. Stat. Assoc. 72, 1977, p. 320); their differences are part of the variance. The differences
of neighbours z_i = y_i - r_i y_(i-1), r_i = exp(-dt_i / correlation time), have a tridiagonal covariance, so every pair
costs one pass over the data.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.calibrate.model import SensorDescription
from imuarray.errors import CalibrationError, LogError
from imuarray.log import Log, SensorLog
from imuarray.log.columns import NamedColumn
from imuarray.log.format import SATURATED, STALE, SUSPECT, Phase
from imuarray.thermometers import thermometer_scale

_MOST_SEGMENTS = 20_000
_FULL = 0.5
"""Least share of the usual number of rows in a segment."""

FEWEST_ALIKE = 3
"""Fewest chips of one kind for the median of their thermometers: the median of two is only their mean."""

WITHOUT_ZERO = ("l3g4200d",)
"""Chips whose thermometer measures changes only (L3G-60)."""


def degc_of(sensor: SensorDescription) -> tuple[float, float] | None:
    """Return degrees at count 0 and degrees per count of a sensor's own thermometer, as its log states or else the data
    sheet of its chip; None if it has no thermometer, or neither states it.
    """
    has_thermometer = sensor.temperature_counts is not None if isinstance(sensor, SensorLog) else sensor.has_temperature
    if not has_thermometer:
        return None
    scale = sensor.thermometer or thermometer_scale(sensor.chip)
    return None if scale is None else (scale.zero_degc, 1 / scale.lsb_per_degc)


def has_zero(sensor: SensorDescription) -> bool:
    """Return whether a sensor's thermometer measures absolute temperature, and not only changes."""
    return sensor.thermometer is not None or sensor.chip not in WITHOUT_ZERO


@dataclass(frozen=True)
class SegmentMeans:
    """Means of rows: mid times (n,) in s since the log's epoch, and means (n, k) over the rows of each segment."""

    time_s: Floats
    mean: Floats


@dataclass(frozen=True)
class TemperatureSeries:
    """Temperatures (m,) in degC at times (m,) in s since the log's epoch; `kind` is one of `model.THERMOMETERS`.
    Readings are multiples of `step_degc` (0: not known).
    """

    kind: str
    time_s: Floats
    degc: Floats
    step_degc: float = 0.0

    def at(self, time_s: Floats) -> Floats:
        """Return the temperature at other times, by linear interpolation."""
        return np.interp(time_s, self.time_s, self.degc)

    def lagged(self, time_s: Floats, lags_s: Sequence[float]) -> Floats:
        """Return the temperature (len(time_s), len(lags_s)) after first-order lags, each in equilibrium at the first
        reading.

        Exact for straight lines between the readings: with slope s, a lag L gives x1 - s L + (y0 - x0 + s L)
        exp(-dt / L).
        """
        lags = np.maximum(np.asarray(lags_s, float), 1e-9)
        steps = np.diff(self.time_s)
        slopes = np.diff(self.degc) / steps
        lagged = np.empty((len(self.degc), len(lags)))
        lagged[0] = self.degc[0]
        decay = np.exp(-steps[:, None] / lags)
        for i, slope in enumerate(slopes):
            late = slope * lags
            lagged[i + 1] = self.degc[i + 1] - late + (lagged[i] - self.degc[i] + late) * decay[i]
        return np.stack([np.interp(time_s, self.time_s, column) for column in lagged.T], axis=1)


def segment_means(
    sensor: SensorLog, width_s: float, left_out: Sequence[Phase] = (), within: slice | None = None
) -> SegmentMeans:
    """Return mean counts (n, k) of a sensor over segments of `width_s` (longer if there would be more than 20000), of
    all rows or of the rows `within`.

    Stale, saturated and suspect rows and rows inside the phases `left_out` are ignored. CalibrationError if no rows
    remain.
    """

    def sound(rows: slice) -> npt.NDArray[np.bool_]:
        counted = np.asarray((np.asarray(sensor.status[rows]) & (STALE | SATURATED | SUSPECT)) == 0)
        time = np.asarray(sensor.time[rows]) if left_out else np.zeros(0, np.int64)
        for phase in left_out:
            counted &= (time < phase.start_ns) | (time >= phase.end_ns)
        return counted

    rows = slice(0, len(sensor)) if within is None else within
    return _means(sensor.time, lambda part: np.asarray(sensor.counts[part], float), sound, width_s, sensor.where, rows)


def _means(
    time: NamedColumn,
    values: Callable[[slice], Floats],
    sound: Callable[[slice], npt.NDArray[np.bool_]],
    width_s: float,
    where: str,
    rows: slice,
) -> SegmentMeans:
    """Return the means of columns of values over segments of some rows."""
    if rows.stop <= rows.start:
        raise CalibrationError(f"{where}: no readings")
    begin = int(time[rows.start])
    span_ns = int(time[rows.stop - 1]) - begin + 1
    width_ns = max(round(width_s * 1e9), -(-span_ns // _MOST_SEGMENTS))
    count = -(-span_ns // width_ns)
    number, moments, sums = np.zeros(count), np.zeros(count), np.zeros((0, 0))
    for start in range(rows.start, rows.stop, 1 << 16):
        part = slice(start, min(start + (1 << 16), rows.stop))
        counted = sound(part)
        rows_used = slice(None) if counted.all() else counted  # avoids a copy
        since = (np.asarray(time[part])[rows_used] - begin).astype(np.int64)
        segment, value = since // width_ns, values(part)[rows_used]
        if len(segment) and (segment.min() < 0 or segment.max() >= count):
            raise CalibrationError(f"{where}: time does not increase")
        sums = np.zeros((count, value.shape[1])) if sums.size == 0 else sums
        starts = np.flatnonzero(np.diff(segment, prepend=-1))
        if len(starts):
            places = segment[starts]
            np.add.at(number, places, np.diff(starts, append=len(segment)))
            np.add.at(moments, places, np.add.reduceat(since.astype(float), starts))
            np.add.at(sums, places, np.add.reduceat(value, starts, axis=0))
    if not number.any():
        raise CalibrationError(f"{where}: no valid readings")
    full = number >= _FULL * np.median(number[number > 0])
    return SegmentMeans((begin + moments[full] / number[full]) * 1e-9, sums[full] / number[full, None])


def thermometer_of(log: Log, sensor: SensorLog, width_s: float) -> TemperatureSeries | None:
    """Return the best thermometer for `sensor` in its log, averaged over `width_s`: the barometer's, that of
    `/reference`, the chip's own, or another chip's (those with a zero first); None if there is none.
    """
    for barometer in log.of("pressure"):
        with suppress(CalibrationError, LogError):  # for example if it was imported without a temperature
            return _read("barometer", barometer.time, barometer.compensated("temperature"), 0.0, 1.0, width_s)
    track = log.reference
    if track is not None and track.temperature is not None:
        with suppress(CalibrationError):
            return _read("reference", track.time, track.temperature, 0.0, 1.0, width_s)
    return _chip_thermometer(log, sensor, width_s)


def chip_thermometer(log: Log, width_s: float) -> TemperatureSeries | None:
    """Return the thermometer of a log, averaged over `width_s`: a thermometer with a known zero (preferably a separate
    one, otherwise a chip's), or else one that measures changes only ("relative"); None without any.

    For three or more chips of one kind it is the median, which a single late or failed thermometer does not affect.
    """
    sensors = [*log.of("temperature"), *(sensor for sensor in log.sensors.values() if sensor.is_triad)]
    thermometers = [sensor for sensor in sensors if len(sensor) and degc_of(sensor) is not None]
    thermometers.sort(key=has_zero, reverse=True)
    first = _chip_thermometer(log, thermometers[0], width_s) if thermometers else None
    of_same_chip = [sensor for sensor in thermometers if sensor.is_triad and sensor.chip == thermometers[0].chip]
    if first is None or not thermometers[0].is_triad or len(of_same_chip) < FEWEST_ALIKE:
        return first
    other_series = [_chip_thermometer(log, sensor, width_s) for sensor in of_same_chip[1:]]
    degc = [first.degc, *(other.at(first.time_s) for other in other_series if other is not None)]
    means = [series.mean() for series in degc]
    changes = np.median([series - mean for series, mean in zip(degc, means, strict=True)], axis=0)
    return replace(first, degc=np.median(means) + changes)


def _chip_thermometer(log: Log, sensor: SensorLog, width_s: float) -> TemperatureSeries | None:
    others = sorted(log.sensors.values(), key=lambda other: (other.name != sensor.name, not has_zero(other)))
    for other in others:
        column, degc = other.temperature_counts, degc_of(other)
        if column is not None and degc is not None and len(other):
            return _read("chip" if has_zero(other) else "relative", other.time, column, *degc, width_s)
    return None


def _read(
    kind: str, time: NamedColumn, column: NamedColumn, zero: float, step: float, width_s: float
) -> TemperatureSeries:
    """Return the segment means of a temperature column, without values that are not finite; CalibrationError if no
    value is finite.
    """

    def values(rows: slice) -> Floats:
        return np.asarray(np.nan_to_num(np.asarray(column[rows], float), posinf=0.0, neginf=0.0)[:, None])

    means = _means(
        time,
        values,
        lambda part: np.isfinite(np.asarray(column[part], float)),
        width_s,
        column.name,
        slice(0, int(time.shape[0])),
    )
    return TemperatureSeries(kind, means.time_s, zero + step * means.mean[:, 0], abs(step))


_CELLS = 6
_ENOUGH = 8.0
"""Effective number of grid points under the likelihood; with fewer the grid is refined."""

_RIDGE = 1e-12
"""Relative ridge for the normal equations of collinear regressors, whose standard errors become very large."""

_LOG_ODDS = (-4.0, 6.0)
"""Limits of the log odds of the white share: 0.02 to 0.998."""


@dataclass(frozen=True)
class CorrelatedNoise:
    """A correlation time and the share of the variance that is white."""

    correlation_s: float
    white: float


def likely_noises(
    score: Callable[[Sequence[CorrelatedNoise]], Floats], shortest_s: float, longest_s: float
) -> tuple[CorrelatedNoise, ...]:
    """Return a grid of noises (g) around the likely ones by their log likelihoods `score`, within these times."""
    box = np.array([np.log([shortest_s, max(longest_s, 2 * shortest_s)]), _LOG_ODDS])
    for _ in range(4):
        points = np.array(list(product(*(np.linspace(low, high, _CELLS) for low, high in box))))
        noises = tuple(CorrelatedNoise(float(np.exp(time)), float(1 / (1 + np.exp(-odds)))) for time, odds in points)
        share = weights(score(noises))
        if 1 / (share**2).sum() > _ENOUGH:
            break
        centre = share @ points
        reach = np.maximum(3 * np.sqrt(share @ (points - centre) ** 2), np.diff(box)[:, 0] / (_CELLS - 1))
        box = np.clip(np.stack([centre - reach, centre + reach], axis=1), box[:, :1], box[:, 1:])
    return noises


def products(columns: Floats, gaps_s: Floats, noise: CorrelatedNoise) -> tuple[Floats, float]:
    """Return ``columns.T @ inverse(C) @ columns`` (k, k) for columns (n, k), and the logarithm of C's determinant.

    `gaps_s` (n - 1,) are the times between neighbours; an infinite gap separates two independent series.
    """
    from scipy.linalg.lapack import dpttrf, dpttrs  # slow to import

    decay = np.exp(-gaps_s / noise.correlation_s)
    steps = columns.copy()
    steps[1:] -= decay[:, None] * columns[:-1]
    diagonal = np.concatenate([[1.0], (1 - noise.white) * (1 - decay**2) + noise.white * (1 + decay**2)])
    diagonal, subdiagonal, _ = dpttrf(diagonal, -noise.white * decay)
    solved, _ = dpttrs(diagonal, subdiagonal, steps)
    return np.asarray(steps.T @ solved), float(np.log(diagonal).sum())


def regress(sums: Floats, log_determinant: Floats, rows: int) -> tuple[Floats, Floats]:
    """Solve least squares from `products` (g, 1 + p, 1 + p) of a series (first) and its p regressors, over `rows`,
    under g noises. Return the coefficients' covariances (g, p, p) and log restricted likelihoods (g,).
    """
    cross = sums[..., 1:, 0]
    inner = sums[..., 1:, 1:] * (1 + _RIDGE * np.eye(sums.shape[-1] - 1))
    inverse = np.linalg.inv(inner)
    freedom = rows - inner.shape[-1]
    remaining = sums[..., 0, 0] - np.einsum("...i,...ij,...j->...", cross, inverse, cross)
    # The residual of a series that is exactly a combination of its regressors is zero.
    remaining = np.maximum(remaining, 1e-12 * np.maximum(sums[..., 0, 0], 1e-300))
    likelihood = -(log_determinant + np.linalg.slogdet(inner)[1] + freedom * np.log(remaining)) / 2
    return (remaining / freedom)[..., None, None] * inverse, likelihood


def weights(log_likelihood: Floats, axis: int | tuple[int, ...] = -1) -> Floats:
    """Return likelihoods divided by their sum along `axis`."""
    raised = np.exp(log_likelihood - log_likelihood.max(axis=axis, keepdims=True))
    return np.asarray(raised / raised.sum(axis=axis, keepdims=True))


@dataclass(frozen=True)
class MeanVariance:
    """Variance of a run's mean: values (g,) under g noises, their probabilities `share`, and the freedom of each."""

    values: Floats
    share: Floats
    own_freedom: int

    @property
    def mean(self) -> float:
        """The expected variance."""
        return float(self.share @ self.values)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of a chi-squared of this mean and variance."""
        scatter = float(self.share @ (self.values**2 * (1 + 2 / self.own_freedom))) - self.mean**2
        return 2 * self.mean**2 / scatter if scatter > 0 else float(self.own_freedom)

    def chance_of(self, variance: float, freedom: int) -> float:
        """Return the probability that noise alone gives run means such a variance: F's upper tail over the noises."""
        from scipy.special import fdtrc  # slow to import

        ratios = variance / np.maximum(self.values, 1e-300)
        return float(self.share @ fdtrc(freedom, self.own_freedom, ratios))


def mean_of_series(values: Floats, gaps_s: Floats, starts: npt.NDArray[np.int64]) -> MeanVariance:
    """Return the variance of the mean of a run, averaged over several runs.

    `values` (n,) are all runs in sequence, with infinite `gaps_s` (n - 1,) between runs, which begin at rows `starts`
    (r,). All runs have the same noise and different means.
    """
    finite = gaps_s[np.isfinite(gaps_s)]
    lengths = np.diff([*starts, len(values)])
    member = np.zeros((len(values), len(starts)))
    member[np.arange(len(values)), np.repeat(np.arange(len(starts)), lengths)] = 1.0
    step = float(np.median(finite)) if len(finite) else 1.0
    centred = values - np.repeat(np.add.reduceat(values, starts) / lengths, lengths)
    columns = np.column_stack([centred, member])

    def fit(noises: Sequence[CorrelatedNoise]) -> tuple[Floats, Floats]:
        sums = [products(columns, gaps_s, noise) for noise in noises]
        return regress(np.array([total for total, _ in sums]), np.array([total for _, total in sums]), len(values))

    noises = likely_noises(lambda grid: fit(grid)[1], step / 2, 2 * step * float(lengths.max()))
    covariances, likelihood = fit(noises)
    variances = np.diagonal(covariances, axis1=-2, axis2=-1).mean(axis=1)
    return MeanVariance(variances, weights(likelihood), len(values) - len(starts))
