"""Noise of inertial sensors at rest: scatter of single readings, spectral lines, and the drift of the bias.

`calibrate noise` measures, for each axis while the box stands still, the standard deviation of single readings about
the means of segments, the correlation of neighbouring readings, the lines of the spectrum, and how the bias drifts.

The drift of the bias is the maximum likelihood of a first-order Gauss-Markov process in white noise. Means over
segments of T seconds of a process with variance v and time constant tau have the variance ``v 2 (tau/T)^2 (T/tau - 1 +
exp(-T/tau))`` and, d apart, the covariance ``v (2 tau/T sinh(T/2tau))^2 exp(-d/tau)``: those of a sampled process in
white noise, so a Kalman filter gives their exact likelihood. The level of each stretch is unknown and is integrated
out, which also corrects for its degree of freedom (restricted maximum likelihood: Patterson and Thompson, Biometrika
58, 1971). Several averaging times are used together: means over long times contain mostly the process, and those over
short times mostly white noise.

The filter runs for a grid of time constants and of ratios of drift to noise, first a coarse one, then a fine one about
the maximum. Standard errors and bounds weigh the grid by the likelihood, with a prior that is flat in the rms and in
the logarithm of the time constant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.model import Calibration, Drift, NoiseLine, SensorCalibration, Thermal, nominal
from imuarray.calibrate.motion import refuse_motion
from imuarray.calibrate.pose_readings import (
    SEGMENT_ROWS,
    Pose,
    SegmentReadings,
    Stretches,
    clock_of,
    find_poses,
    readings,
    runs_of,
)
from imuarray.calibrate.segments import SegmentMeans, segment_means, thermometer_of
from imuarray.characterise.correlation import Autocovariance
from imuarray.errors import CalibrationError
from imuarray.kernels import drift_sums
from imuarray.log import Log, SensorLog, require_logs
from imuarray.log.rests import steady_rests
from imuarray.units import INERTIAL

MOST_SEGMENTS = 512
LEAST_SEGMENTS = 16
"""Fewest segments of the longest stretch from which drift can be estimated."""

SHORTEST = 2.0
"""Shortest time constant, in segments; a faster process is coloured noise."""

_NEARLY = 0.99
"""Required length as a share of the nominal: segments at the ends of a stretch may be a little short."""

_RATIOS = np.geomspace(0.02, 500.0, 28)
_TIMES = 14
_FINE = 24
_LIKELY = 6.0
"""Log likelihood below the maximum at which the fine grid ends."""

_INTERVAL = 1.92
"""Log likelihood below the maximum at the ends of a 95 % interval: half the quantile of chi-squared."""

_CONFIDENCE = 0.95


def fit_drift(stretches: Sequence[SegmentMeans], width_s: float) -> Drift | None:
    """Estimate the drift of one sensor from the means over segments of `width_s` (times in s, counts (n, 3)) of its
    stretches at rest; None if the longest has fewer than 16 segments, or no axis scatters.
    """
    stretches = [part for part in stretches if len(part.time_s) > 1]
    spans = [float(part.time_s[-1] - part.time_s[0]) + width_s for part in stretches]
    if max(spans, default=0.0) < LEAST_SEGMENTS * width_s * _NEARLY:
        return None
    levelled = [SegmentMeans(part.time_s, part.mean - part.mean.mean(axis=0)) for part in stretches]
    scale = np.concatenate([part.mean for part in levelled]).std(axis=0)
    moving = np.flatnonzero(scale > 0)
    if len(moving) == 0:
        return None
    parts = [SegmentMeans(part.time_s, part.mean[:, moving] / scale[moving]) for part in levelled]
    times = np.geomspace(SHORTEST * width_s, max(spans), _TIMES)
    coarse = _likelihood(parts, width_s, times, _RATIOS[:, None])
    fine = _likelihood(parts, width_s, *coarse.about_maximum())
    figures = np.zeros((3, 3))
    figures[:, moving] = np.stack(fine.rms()) * scale[moving]
    best, interval = fine.time_constant()
    return Drift(figures[0], figures[1], best, figures[2], interval, max(spans))


class _Grid(NamedTuple):
    """Log likelihood (t, u, k) of k axes for time constants (t,) and ratios (u, k) of the drift's rms to the noise of a
    mean; `noise` (t, u, k) is the most likely rms of that noise.
    """

    times: Floats
    ratios: Floats
    log_likelihood: Floats
    noise: Floats

    def about_maximum(self) -> tuple[Floats, Floats]:
        """Return time constants and ratios of a finer grid over the likely range."""
        profile = self._joint()
        times = _closer(self.times, profile.max(axis=(1, 2)))
        ratios = [_closer(column, profile[:, :, k].max(axis=0)) for k, column in enumerate(self.ratios.T)]
        return times, np.stack(ratios, axis=1)

    def rms(self) -> tuple[Floats, Floats, Floats]:
        """Return the rms of the drift (k,): the most likely value, its standard error, and the upper bound."""
        rms = self.ratios * self.noise
        profile = self._joint()
        best, sem, upper = (np.zeros(rms.shape[2]) for _ in range(3))
        for k in range(rms.shape[2]):
            axis, likely = rms[:, :, k], profile[:, :, k]
            time, ratio = np.unravel_index(int(likely.argmax()), likely.shape)
            best[k] = axis[time, ratio] if self.ratios[ratio, k] > _RATIOS[0] else 0.0
            weight = np.exp(likely - likely.max()) * np.abs(np.gradient(axis, axis=1))
            order = np.argsort(axis, axis=None)
            share = np.cumsum(weight.ravel()[order]) / weight.sum()
            upper[k] = axis.ravel()[order][np.searchsorted(share, _CONFIDENCE)]
            mean = np.average(axis, weights=weight)
            sem[k] = np.sqrt(np.average((axis - mean) ** 2, weights=weight))
        return best, sem, upper

    def time_constant(self) -> tuple[float, Floats]:
        """Return the most likely time constant and its interval (2,), nan where that reaches the end of the grid."""
        profile = self.log_likelihood.max(axis=1).sum(axis=1)
        inside = np.flatnonzero(profile > profile.max() - _INTERVAL)
        low, high = int(inside[0]), int(inside[-1])
        ends = [np.nan if low == 0 else self.times[low], np.nan if high == len(profile) - 1 else self.times[high]]
        return float(self.times[int(profile.argmax())]), np.array(ends)

    def _joint(self) -> Floats:
        """Return log likelihood (t, u, k) of all axes, with the other axes at their maximum for the time constant."""
        best = self.log_likelihood.max(axis=1)
        of_others = best.sum(axis=1, keepdims=True) - best
        return np.asarray(self.log_likelihood + of_others[:, None, :])


def _closer(values: Floats, profile: Floats) -> Floats:
    """Return finer values (f,) over the likely ones, and one on either side."""
    inside = np.flatnonzero(profile > profile.max() - _LIKELY)
    low, high = max(0, int(inside[0]) - 1), min(len(values) - 1, int(inside[-1]) + 1)
    return np.geomspace(values[low], values[high], _FINE)


def _likelihood(parts: Sequence[SegmentMeans], width_s: float, times: Floats, ratios: Floats) -> _Grid:
    """Return the likelihood of a sampled process in white noise by Kalman filters for all points of the grid at once;
    `ratios` (u, k), or (u, 1) if all axes share them, so that their covariances are computed once.

    Covariances are in units of the noise's variance, which is estimated last; levels are integrated out.
    """
    share = (width_s / times)[:, None, None]
    shared = ratios**2 * (2 / share * np.sinh(share / 2)) ** 2
    noise = 1 + ratios**2 * 2 / share**2 * (share + np.expm1(-share)) - shared
    axes = parts[0].mean.shape[1]
    squares, logs, freedom = np.zeros((*shared.shape[:2], axes)), np.zeros(shared.shape), 0
    for part in parts:
        sums = _filter(part, times[:, None, None], shared, noise)
        squares += sums.values - sums.mixed**2 / sums.ones
        logs += sums.logs + np.log(sums.ones)
        freedom += len(part.time_s) - 1
    variance = squares / freedom
    ratios = np.broadcast_to(ratios, (len(ratios), axes))
    return _Grid(times, ratios, -(freedom * np.log(variance) + logs) / 2, np.sqrt(variance))


class _LikelihoodSums(NamedTuple):
    """Sums over a stretch, each divided by the variance: squared innovations of the means (`values`), those of a
    constant 1 (`ones`), their products (`mixed`), and the logarithms of the variance.
    """

    values: Floats
    ones: Floats
    mixed: Floats
    logs: Floats


def _filter(part: SegmentMeans, times: Floats, shared: Floats, noise: Floats) -> _LikelihoodSums:
    """Filter one stretch and return its sums; `shared` is the variance of the sampled process, `noise` that of a mean
    about it. Compiled code filters one point of the grid after the other; without it, all points are filtered at once.
    """
    steps = np.diff(part.time_s, append=np.inf)
    compiled = drift_sums(part.mean, np.exp(-steps[:, None] / times.ravel()), shared, noise)
    if compiled is not None:
        return _LikelihoodSums(*compiled)
    values, mixed, state = (np.zeros((*shared.shape[:2], part.mean.shape[1])) for _ in range(3))
    ones, logs, level, variance = *(np.zeros(shared.shape) for _ in range(3)), shared
    for mean, step in zip(part.mean, steps, strict=True):
        innovation_variance = variance + noise
        innovation, unit_innovation = mean - state, 1 - level
        values += innovation**2 / innovation_variance
        ones += unit_innovation**2 / innovation_variance
        mixed += innovation * unit_innovation / innovation_variance
        logs += np.log(innovation_variance)
        decay = np.exp(-step / times)
        gain = variance / innovation_variance
        state, level = decay * (state + gain * innovation), decay * (level + gain * unit_innovation)
        variance = decay**2 * variance * (1 - gain) + (1 - decay**2) * shared
    return _LikelihoodSums(values, ones, mixed, logs)


_ENOUGH_SEGMENTS = 16
"""Fewest segments from whose variances the standard error of the pooled variance is computed; with fewer, the formula
for white noise is used.
"""


@dataclass(frozen=True)
class ReadingNoise:
    """Noise of single readings: the standard deviation (3,) in counts about the means of segments and its standard
    error; the correlation of neighbouring readings (3,), 0 on an axis without scatter, None without neighbours; the
    spectral lines, axis by axis.
    """

    rms_lsb: Floats
    rms_sem_lsb: Floats
    correlation: Floats | None
    lines: tuple[NoiseLine, ...]


def reading_noise(stretches: Stretches, false_alarm: float | None) -> ReadingNoise | None:
    """Measure the noise of single readings, pooled over the `stretches` of one sensor at rest; None if no segment has
    two valid readings.

    `false_alarm` is the probability that a line is detected on an axis without lines; None: lines are not searched for.
    """
    clock = clock_of(stretches)
    products = Autocovariance(lags=1, columns=3, segment_rows=SEGMENT_ROWS)
    pooled = _PooledSquares()
    for sensor, rows in stretches:
        for part in readings(sensor, rows, clock.limit_ns):
            pooled.add(part)
            for is_first, run in runs_of(part):
                if is_first:
                    products.end_run()
                products.update(run)
        products.end_run()
    if pooled.freedom == 0:
        return None
    rms, lines = pooled.rms_lsb(), tuple[NoiseLine, ...]()
    if false_alarm is not None:
        from imuarray.calibrate.noise_lines import noise_lines  # slow to import

        lines = noise_lines(stretches, clock, rms, false_alarm)
    return ReadingNoise(rms, pooled.rms_sem_lsb(), _neighbours(products), lines)


class _PooledSquares:
    """Sums of squares about the means of segments, over all segments."""

    def __init__(self) -> None:
        self.freedom = 0
        self._segments = 0
        self._squares = np.zeros(3)
        self._freedom_squares = 0.0
        self._mixed = np.zeros(3)
        self._squares_squares = np.zeros(3)

    def add(self, part: SegmentReadings) -> None:
        """Add the readings of a block; blocks end at the end of a segment."""
        first_rows = np.flatnonzero(np.diff(part.segment, prepend=-1))  # segments are in order
        number = np.diff(first_rows, append=len(part.segment))
        means = np.add.reduceat(part.counts, first_rows, axis=0) / number[:, None]
        squares = np.add.reduceat((part.counts - np.repeat(means, number, axis=0)) ** 2, first_rows, axis=0)
        several = number > 1
        squares, freedom = squares[several], number[several] - 1
        self.freedom += int(freedom.sum())
        self._segments += len(freedom)
        self._squares += squares.sum(axis=0)
        self._freedom_squares += float((freedom.astype(float) ** 2).sum())
        self._mixed += freedom @ squares
        self._squares_squares += (squares**2).sum(axis=0)

    def rms_lsb(self) -> Floats:
        """Return the standard deviation of single readings."""
        return np.asarray(np.sqrt(self._squares / self.freedom))

    def rms_sem_lsb(self) -> Floats:
        """Return the standard error of `rms_lsb`, from the scatter of the segments' variances, which needs no
        assumption on correlation or distribution.
        """
        variance = self._squares / self.freedom
        if self._segments < _ENOUGH_SEGMENTS:
            return np.asarray(np.sqrt(variance / (2 * self.freedom)))
        squared_errors = self._squares_squares - 2 * variance * self._mixed + variance**2 * self._freedom_squares
        squared_errors = np.maximum(squared_errors, 0.0) * self._segments / (self._segments - 1)
        return np.asarray(
            np.sqrt(squared_errors) / self.freedom / (2 * np.sqrt(np.where(variance > 0, variance, np.inf)))
        )


def _neighbours(products: Autocovariance) -> Floats | None:
    """Return the correlation (3,) of neighbouring readings; None without neighbours."""
    correlation = products.correlation()
    if not np.isfinite(correlation[0]).any() and not products.result().rows:
        return None
    return np.asarray(np.clip(np.nan_to_num(correlation[1]), -1, 1))


_FALSE_ALARM = 0.01
"""Probability that a line is reported on any axis of a log without lines."""

_THERMOMETER_S = 5.0


def calibrate_noise(
    *logs: Log,
    known: Calibration | None = None,
    progress: Callable[[str, int, int], None] = lambda what, done, of: None,
) -> Calibration:
    """Measure the noise of single readings, its correlation and lines, and the drift of every inertial sensor, pooled
    over all still stretches of one log or several. Changes with temperature are removed from the drift by the slopes of
    `known`.

    Still stretches are the `steady_rests` among the phases; in a log without rests they are detected by the
    accelerometers. CalibrationError without still stretches. `progress` is called with the step, the number of
    sensors done, and their total.
    """
    require_logs(logs, "calibrate_noise(*logs)")
    return _calibrate(logs, known, _FALSE_ALARM, progress)


def _calibrate(
    logs: Sequence[Log],
    known: Calibration | None,
    false_alarm: float | None,
    progress: Callable[[str, int, int], None],
) -> Calibration:
    """Do what `calibrate_noise` does; `false_alarm` is the probability that a line is reported on any axis of a log
    without lines, None if lines are not searched for.
    """
    for log in logs:
        log.keep_rows()
    poses = [pose for log in logs for pose in _still_stretches(log)]
    first = logs[0]
    if not poses:
        raise CalibrationError(f"{first.path}: no stretch in which the box stood still")
    sensors = [sensor for sensor in first.sensors.values() if sensor.quantity in INERTIAL]
    if not sensors:
        raise CalibrationError(f"{first.path}: it has no inertial sensor")
    slopes = {} if known is None else {name: sensor.thermal for name, sensor in known.sensors.items()}
    result = {}
    of_axis = None if false_alarm is None else false_alarm / (3 * len(sensors))
    for number, sensor in enumerate(sensors, start=1):
        result[sensor.name] = _noise(sensor, poses, slopes.get(sensor.name), of_axis)
        progress("noise", number, len(sensors))
    return Calibration(result, tuple(str(log.path) for log in logs))


def with_noise_of(
    log: Log,
    calibration: Calibration,
    names: Sequence[str] = (),
    progress: Callable[[str, int, int], None] = lambda what, done, of: None,
) -> Calibration:
    """Return the calibration with the noise measured in the log at rest, for the sensors (only `names`, unless that is
    empty) without noise in the calibration; without spectral lines, which fusion does not use. CalibrationError if the
    log determines no noise. `progress` is called as by `calibrate_noise`.
    """
    calibrated = {
        sensor.name: calibration.or_nominal(sensor) for sensor in log.sensors.values() if sensor.quantity in INERTIAL
    }
    lacking = [name for name, each in calibrated.items() if each.noise_lsb is None and (not names or name in names)]
    if not lacking:
        return calibration
    measured = _calibrate([log], calibration, None, progress)
    return calibration.merged(Calibration({name: measured.sensors[name] for name in lacking}, measured.sources))


def _still_stretches(log: Log) -> list[Pose]:
    named = [Pose(phase, None, log) for phase in steady_rests(log.phases)]
    poses = named or find_poses(log)
    refuse_motion(
        log, [(f"phase {p.phase.name!r}" if named else p.phase.name, p.phase.start_ns, p.phase.end_ns) for p in poses]
    )
    return poses


def _noise(
    sensor: SensorLog, poses: Sequence[Pose], thermal: Thermal | None, false_alarm: float | None
) -> SensorCalibration:
    """Measure one sensor's noise; CalibrationError if it has no valid readings."""
    result = [(pose, *pose.rows_of(sensor)) for pose in poses]
    stretches = [(source, rows) for _, source, rows in result if rows.stop > rows.start]
    scatter = reading_noise(stretches, false_alarm) if stretches else None
    if scatter is None:
        raise CalibrationError(f"{sensor.where}: no valid readings while the box stood still")
    return replace(
        nominal(sensor),
        noise_lsb=scatter.rms_lsb,
        noise_sem_lsb=scatter.rms_sem_lsb,
        noise_correlation=scatter.correlation,
        noise_lines=scatter.lines,
        drift=_drift(result, thermal),
    )


def _drift(stretches: Sequence[tuple[Pose, SensorLog, slice]], thermal: Thermal | None) -> Drift | None:
    """Estimate the drift over the stretches; None if they are too short, or too many, to determine it."""
    rows = sum(part.stop - part.start for _, _, part in stretches)
    segment = max(SEGMENT_ROWS // 2, -(-rows // MOST_SEGMENTS))  # the shortest time constant is two segments
    long = [
        (pose, series, part) for pose, series, part in stretches if part.stop - part.start >= LEAST_SEGMENTS * segment
    ]
    if not long:
        return None
    _, series, part = max(long, key=lambda entry: entry[2].stop - entry[2].start)
    width_s = segment * _interval_s(series, part)
    return fit_drift([_means(pose, sensor, rows, width_s, thermal) for pose, sensor, rows in long], width_s)


def _interval_s(sensor: SensorLog, rows: slice) -> float:
    first, last = (int(sensor.time[row]) for row in (rows.start, rows.stop - 1))
    return float((last - first) / (rows.stop - rows.start - 1)) * 1e-9


def _means(pose: Pose, sensor: SensorLog, rows: slice, width_s: float, thermal: Thermal | None) -> SegmentMeans:
    """Return the means of a stretch, with changes by temperature removed; empty without valid readings."""
    try:
        means = segment_means(sensor, width_s, within=rows)
    except CalibrationError:
        return SegmentMeans(np.zeros(0), np.zeros((0, 3)))
    warm = None if thermal is None or pose.log is None else thermometer_of(pose.log, sensor, _THERMOMETER_S)
    if thermal is None or warm is None or (warm.kind == "relative") != (thermal.thermometer == "relative"):
        return means
    degc = warm.lagged(means.time_s, [thermal.significant_lag_s])[:, 0]
    return replace(means, mean=means.mean - thermal.bias_change_lsb(degc, float(degc[0])))
