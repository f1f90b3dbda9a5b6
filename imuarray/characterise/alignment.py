"""Alignment of an array's sensors in time: the rates of their rows, the distances of their rows in time, delays of
gyroscopes, in addition to their known filter delays, that are visible in motion, and times of synchronisation pulses.

Rows are compared with those of a reference, the first inertial sensor of the log. A delay d of a gyroscope is estimated
in the `WINDOW_S` with the most motion: its rate is a sum of the reference's rates, a bias, and -d times the derivative
of the reference's rate along the same axis. All of these are fitted at once by least squares, so that scale factors and
misalignments are not mistaken for a delay; the times are then shifted by d, and the fit is repeated.

A sensor's time of a synchronisation pulse is the time of the marked row minus the time since the pulse (`sync_pulse`).
That time is scaled by the sensor's actual rate, because chips measure it by their own oscillators; the same holds for
half a period where a chip does not measure it. The mean difference from the reference's times of the same pulses is the
error of the sensor's times relative to the reference, whatever the rows contain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Integers
from imuarray.log import Log, SensorLog
from imuarray.log.format import SATURATED, STALE, SUSPECT, SYNC_PULSE_ERROR
from imuarray.robust import MEDIAN_ABSOLUTE
from imuarray.units import INERTIAL

WINDOW_S = 60.0
ROWS = 4096
"""Number of rows of the reference, in the middle of the log, with which the rows of the others are compared."""
LEAST_ROWS = 200
LONGEST_ERROR_S = 1e-3
"""Greatest standard error of a delay that is reported."""
LEAST_MOTION = 100.0
"""Least variance of the rate's derivative over that of its noise: noise makes delays appear smaller, here by 1 %."""
_FITS = 3
_PIECES = 64
_SAME_PPM = 0.5
"""Largest difference of equal rates: time stamps have a resolution of nanoseconds. For queues the uncertainty of the
times, reduced by the median over `_PIECES` pieces, is added.
"""


@dataclass(frozen=True)
class SensorAlignment:
    """Alignment of one sensor with the reference: its rows per second, their excess over the reference in parts per
    million, and mean and standard deviation of the time from a row of the reference to the nearest row of this sensor
    (s).

    `row_apart_s` is the time in which the sensor gains or loses a row; None if the rates are equal. `delay_s`, with its
    standard error, is the delay of the sensor's response to a rotation; None if no motion determines it, and for
    sensors other than gyroscopes. `time_uncertainty_s` is the median of the largest errors of the sensor's times as
    stated in the log; None if not stated. `pulse_offset_s`, with its error, is the mean time by which this sensor's
    times of the `pulses` synchronisation pulses in common with the sensor `pulses_from` are later than that sensor's;
    None without pulses.
    """

    name: str
    rate_hz: float
    rate_ppm: float
    offset_s: float
    spread_s: float
    row_apart_s: float | None
    delay_s: float | None = None
    delay_error_s: float | None = None
    time_uncertainty_s: float | None = None
    pulses: int = 0
    pulse_offset_s: float | None = None
    pulse_error_s: float | None = None


@dataclass(frozen=True)
class Alignment:
    """Alignment of all inertial sensors of a log with `reference`; delays are those of the rotation from
    `motion_from_s` on (None: no motion determines them), relative to the gyroscope `delays_from`, and times of pulses
    relative to the sensor `pulses_from`.
    """

    reference: str
    sensors: tuple[SensorAlignment, ...]
    delays_from: str = ""
    pulses_from: str = ""
    motion_from_s: float | None = None

    @property
    def is_simultaneous(self) -> bool:
        """True if all rows have the times of the reference and no delay is known: there is nothing to report."""
        return all(
            sensor.offset_s == sensor.spread_s == 0.0
            and sensor.row_apart_s is sensor.delay_s is sensor.time_uncertainty_s is sensor.pulse_offset_s is None
            for sensor in self.sensors
        )


def find_alignment(log: Log) -> Alignment | None:
    """Return the alignment of a log's inertial sensors; None with fewer than two that have `LEAST_ROWS` rows. It reads
    a bounded part of the log, and the first gyroscope's counts.
    """
    sensors = [sensor for quantity in INERTIAL for sensor in log.of(quantity) if len(sensor) >= LEAST_ROWS]
    if len(sensors) < 2:
        return None
    reference = sensors[0]
    gyroscopes = [sensor for sensor in sensors if sensor.quantity == "angular_rate" and sensor.sensitivity]
    start_ns = _motion_from_ns(gyroscopes[0]) if len(gyroscopes) > 1 else None
    delays = {} if start_ns is None else _delays(gyroscopes, start_ns)
    rows = tuple(_align(reference, sensor, delays.get(sensor.name)) for sensor in sensors)
    pulses = pulse_offsets(sensors, [row.rate_hz for row in rows])
    rows = tuple(_add_pulses(row, pulses.get(row.name)) for row in rows)
    return Alignment(
        reference.name,
        rows,
        delays_from=gyroscopes[0].name if delays else "",
        pulses_from=next(iter(pulses), ""),
        motion_from_s=start_ns * 1e-9 if delays and start_ns is not None else None,
    )


def _add_pulses(row: SensorAlignment, pulses: PulseOffset | None) -> SensorAlignment:
    if pulses is None:
        return row
    return replace(row, pulses=pulses.pulses, pulse_offset_s=pulses.offset_s, pulse_error_s=pulses.error_s)


def _rate_hz(sensor: SensorLog) -> float:
    """Return the rows per second: of the median of `_PIECES` equal pieces, because pieces with gaps have fewer rows."""
    edges = np.linspace(0, len(sensor) - 1, min(_PIECES, len(sensor) // 16) + 1).astype(int)
    times_ns = np.array([int(sensor.time[edge]) for edge in edges.tolist()], np.int64)
    return float(np.median(np.diff(edges) / (np.diff(times_ns) * 1e-9)))


def _align(reference: SensorLog, sensor: SensorLog, delay: tuple[float, float] | None) -> SensorAlignment:
    """Compare one sensor's rates and rows with those of the reference."""
    rate_hz, reference_hz = _rate_hz(sensor), _rate_hz(reference)
    ppm = 1e6 * (rate_hz / reference_hz - 1)
    beyond = abs(rate_hz - reference_hz)
    uncertain_s = (_time_uncertainty_s(reference) or 0.0) + (_time_uncertainty_s(sensor) or 0.0)
    is_own = abs(ppm) > max(_SAME_PPM, 1e6 * math.sqrt(_PIECES) * uncertain_s * reference_hz / len(reference))
    offsets_s = _offsets_s(reference, sensor)
    delay_s, delay_error_s = delay or (None, None)
    return SensorAlignment(
        sensor.name,
        rate_hz,
        ppm if is_own else 0.0,
        float(offsets_s.mean()) if len(offsets_s) else math.nan,
        float(offsets_s.std()) if len(offsets_s) else math.nan,
        1 / beyond if is_own else None,
        delay_s,
        delay_error_s,
        _time_uncertainty_s(sensor),
    )


def _time_uncertainty_s(sensor: SensorLog) -> float | None:
    """Return the median of the time uncertainty that the log states, in the middle of its rows."""
    if sensor.time_uncertainty is None:
        return None
    middle = len(sensor) // 2
    return float(np.median(sensor.time_uncertainty[max(0, middle - ROWS // 2) : middle + ROWS // 2]))


def _offsets_s(reference: SensorLog, sensor: SensorLog) -> Floats:
    """Return (m,) the time from rows of the reference in the middle of the log to the nearest row of the sensor."""
    middle = len(reference) // 2
    rows = slice(max(0, middle - ROWS // 2), middle + ROWS // 2)
    at_ns = np.asarray(reference.time[rows], np.int64)
    span_ns = int(at_ns[-1] - at_ns[0]) // len(at_ns) + 1
    around = sensor.between(int(at_ns[0]) - 2 * span_ns, int(at_ns[-1]) + 2 * span_ns)
    others_ns = np.asarray(sensor.time[around], np.int64)
    if len(others_ns) < 2:
        return np.zeros(0)
    inside = at_ns[(at_ns >= others_ns[0]) & (at_ns <= others_ns[-1])]
    after = np.clip(np.searchsorted(others_ns, inside), 1, len(others_ns) - 1)
    later, earlier = others_ns[after] - inside, others_ns[after - 1] - inside
    nearest: Integers = np.where(later <= -earlier, later, earlier)
    return np.asarray(nearest * 1e-9, float)


def _motion_from_ns(gyroscope: SensorLog) -> int | None:
    """Return the start of the window of `WINDOW_S` with the largest sum of squared changes of the rates."""
    start_ns = int(gyroscope.time[0])
    seconds = int((int(gyroscope.time[-1]) - start_ns) * 1e-9) + 1
    squares = np.zeros(seconds)
    for block in gyroscope.blocks():
        at_s = ((np.asarray(gyroscope.time[block], np.int64) - start_ns) * 1e-9).astype(int)
        counts = np.asarray(gyroscope.counts[block], float)
        changes = np.square(np.diff(counts, axis=0)).sum(axis=1)
        squares += np.bincount(at_s[1:], weights=changes, minlength=seconds)[:seconds]
    if not squares.any():
        return None
    length = min(int(WINDOW_S), seconds)
    sums = np.convolve(squares, np.ones(length), "valid")
    return start_ns + int(sums.argmax()) * 1_000_000_000


def _delays(gyroscopes: Sequence[SensorLog], start_ns: int) -> dict[str, tuple[float, float]]:
    """Return delay and standard error of each gyroscope against the first, by name; empty if the motion is too weak."""
    end_ns = start_ns + round(WINDOW_S * 1e9)
    reference_s, reference = _rates(gyroscopes[0], start_ns, end_ns)
    if len(reference_s) < LEAST_ROWS or not _is_strong(reference_s, reference):
        return {}
    delays = {gyroscopes[0].name: (0.0, 0.0)}
    for gyroscope in gyroscopes[1:]:
        times_s, rates = _rates(gyroscope, start_ns, end_ns)
        if len(times_s) >= LEAST_ROWS:
            delay_s, error_s = _delay(reference_s, reference, times_s, rates)
            if error_s <= LONGEST_ERROR_S:
                delays[gyroscope.name] = delay_s, error_s
    return delays if len(delays) > 1 else {}


def _rates(gyroscope: SensorLog, start_ns: int, end_ns: int) -> tuple[Floats, Floats]:
    """Return the times (n,) in s after `start_ns`, without the known filter delay, and the rates (n, 3) in the box
    frame and the sensor's unit by its nominal sensitivity; nan where a row is flagged as saturated, stale or suspect.
    """
    rows = gyroscope.between(start_ns, end_ns)
    times_s = (np.asarray(gyroscope.time[rows], np.int64) - start_ns - gyroscope.delay_ns) * 1e-9
    rates = np.asarray(gyroscope.counts[rows], float) / gyroscope.sensitivity @ gyroscope.orientation.T
    rates[(np.asarray(gyroscope.status[rows]) & (SATURATED | STALE | SUSPECT)) != 0] = np.nan
    return np.asarray(times_s, float), rates


def _is_strong(times_s: Floats, rates: Floats) -> bool:
    """Return whether the motion is strong enough compared with the noise. The variance of the fourth differences of
    noise is 70 times that of the noise.
    """
    noise = np.nanmedian(np.abs(np.diff(rates, 4, axis=0)), axis=0) / MEDIAN_ABSOLUTE / math.sqrt(70)
    derivative = np.gradient(rates, times_s, axis=0)
    step_s = float(np.median(np.diff(times_s)))
    of_noise = noise**2 / (2 * step_s**2)
    return bool((np.nanvar(derivative, axis=0) > LEAST_MOTION * of_noise).any())


def _delay(reference_s: Floats, reference: Floats, times_s: Floats, rates: Floats) -> tuple[float, float]:
    """Return the delay of `rates` (m, 3) at `times_s` (m,) after `reference` (n, 3) at `reference_s` (n,), and standard
    error.
    """
    derivative = np.gradient(reference, reference_s, axis=0)
    delay_s, error_s = 0.0, math.inf
    for _ in range(_FITS):
        at_s = times_s - delay_s
        inside = (at_s >= reference_s[0]) & (at_s <= reference_s[-1])
        reference_at = np.stack([np.interp(at_s[inside], reference_s, column) for column in reference.T], axis=1)
        slopes = np.stack([np.interp(at_s[inside], reference_s, column) for column in derivative.T], axis=1)
        rates_inside = rates[inside]
        good = (
            np.isfinite(reference_at).all(axis=1)
            & np.isfinite(slopes).all(axis=1)
            & np.isfinite(rates_inside).all(axis=1)
        )
        reference_at, slopes, rates_inside = reference_at[good], slopes[good], rates_inside[good]
        if len(rates_inside) < LEAST_ROWS:
            return delay_s, math.inf
        steps, weights = np.zeros(3), np.zeros(3)
        for axis in range(3):
            table = np.column_stack([reference_at, np.ones(len(reference_at)), slopes[:, axis]])
            steps[axis], weights[axis] = _step(table, rates_inside[:, axis], axis)
        if not weights.sum():
            return delay_s, math.inf
        delay_s += float(steps @ weights / weights.sum())
        error_s = float(1 / math.sqrt(weights.sum()))
    return delay_s, error_s


def _step(table: Floats, rate: Floats, axis: int) -> tuple[float, float]:
    """Return the delay of one axis and the inverse of its variance, which includes the correlation of residuals."""
    solution, _, rank, _ = np.linalg.lstsq(table, rate, rcond=None)
    gain = solution[axis]
    if rank < table.shape[1] or abs(gain) < 0.5:
        return 0.0, 0.0
    residual = rate - table @ solution
    variance = residual @ residual / max(1, len(rate) - table.shape[1])
    lag1 = float(residual[1:] @ residual[:-1] / (residual @ residual)) if residual.any() else 0.0
    widened = (1 + max(lag1, 0.0)) / max(1 - max(lag1, 0.0), 1e-3)
    spread = variance * widened * np.linalg.inv(table.T @ table)[-1, -1] / gain**2
    return float(-solution[-1] / gain), float(1 / max(spread, 1e-18))


PULSE_WINDOW_S = 600.0
"""Duration of the stretch in the middle of a log in which pulses are compared."""
LEAST_PULSES = 5
_SHARE_OF_SPREAD = 0.5
"""Least scatter of the time differences of pulses, relative to that of pulses at uniformly distributed phases of the
samples. Below it the pulses are assumed to be at fixed phases, and the mean difference is no more precise than a single
one.
"""
_BLOCK_ROWS = 1 << 16


class PulseOffset(NamedTuple):
    """The number of pulses marked by both a sensor and the reference, the mean time (s) by which the sensor's times of
    them are later, and its error: the 95 % interval, or the largest possible error for pulses at fixed phases.
    """

    pulses: int
    offset_s: float
    error_s: float


def pulse_offsets(sensors: Sequence[SensorLog], rates_hz: Sequence[float]) -> dict[str, PulseOffset]:
    """Return the pulse offsets of `sensors`, which have rows at these rates, relative to the first sensor with pulses;
    the offset of that sensor is 0. Sensors with fewer than `LEAST_PULSES` pulses in common with it are omitted. Empty
    for fewer than two sensors.
    """
    trains = {
        sensor.name: train
        for sensor, rate_hz in zip(sensors, rates_hz, strict=True)
        if len((train := _pulse_train(sensor, rate_hz)).times_s) >= LEAST_PULSES
    }
    if len(trains) < 2:
        return {}
    reference = next(iter(trains.values()))
    offsets = {name: _offset(reference, train) for name, train in trains.items()}
    return {name: offset for name, offset in offsets.items() if offset.pulses >= LEAST_PULSES}


class _PulseTrain(NamedTuple):
    """Times (n,) of the pulses in s from a common instant, and the largest error of each."""

    times_s: Floats
    error_s: float


def _pulse_train(sensor: SensorLog, rate_hz: float) -> _PulseTrain:
    """Return the pulses in the middle of the log. A pulse that is longer than a period may mark several rows."""
    column = sensor.sync_pulse
    if column is None or not len(sensor):
        return _PulseTrain(np.zeros(0), 0.0)
    middle, half = len(sensor) // 2, round(PULSE_WINDOW_S / 2 * rate_hz)
    rows = slice(max(0, middle - half), min(len(sensor), middle + half))
    times = []
    was_marked = False
    for start in range(rows.start, rows.stop, _BLOCK_ROWS):
        block = slice(start, min(start + _BLOCK_ROWS, rows.stop))
        ages_s = np.asarray(column[block], float)
        marks = np.isfinite(ages_s)
        first = marks & ~np.concatenate([[was_marked], marks[:-1]])
        was_marked = bool(marks[-1])
        at_ns = np.asarray(sensor.time[block], np.int64)[first]
        scale = sensor.rate_hz / rate_hz if sensor.rate_hz else 1.0
        times.append(at_ns * 1e-9 - ages_s[first] * scale)
    stated = sensor.attributes.get(SYNC_PULSE_ERROR)
    error_s = float(stated) if isinstance(stated, int | float) else 0.5 / rate_hz
    return _PulseTrain(np.concatenate(times), error_s)


def _offset(reference: _PulseTrain, train: _PulseTrain) -> PulseOffset:
    """Compare the times of the pulses that both have; a pulse that one of them missed has no partner."""
    if train is reference:
        return PulseOffset(len(train.times_s), 0.0, 0.0)
    after = np.clip(np.searchsorted(reference.times_s, train.times_s), 1, len(reference.times_s) - 1)
    later, earlier = reference.times_s[after], reference.times_s[after - 1]
    nearest = np.where(later - train.times_s < train.times_s - earlier, later, earlier)
    apart_s = train.times_s - nearest
    apart_s = apart_s[np.abs(apart_s) < float(np.median(np.diff(reference.times_s))) / 4]
    count = len(apart_s)
    if count < LEAST_PULSES:
        return PulseOffset(count, math.nan, math.nan)
    if not apart_s.any():  # halves of one chip: the same samples
        return PulseOffset(count, 0.0, 0.0)
    spread_s = float(apart_s.std(ddof=1))
    bound_s = reference.error_s + train.error_s
    uniform_s = math.hypot(reference.error_s, train.error_s) / math.sqrt(3)
    if spread_s < _SHARE_OF_SPREAD * uniform_s:
        return PulseOffset(count, float(apart_s.mean()), bound_s)
    residual = apart_s - apart_s.mean()
    lag1 = max(0.0, float(residual[1:] @ residual[:-1] / (residual @ residual)))
    widened = math.sqrt((1 + lag1) / max(1 - lag1, 1e-3))
    return PulseOffset(count, float(apart_s.mean()), min(1.96 * widened * spread_s / math.sqrt(count), bound_s))
