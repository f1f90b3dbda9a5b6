"""Gyroscopes of one box whose angular rates contradict each other: their axes or range are wrong in the configuration,
or a sensor is faulty. Their mean is then a wrong rate, down to zero for two in opposite directions.

The rates are compared in a few stretches, those with the fastest rotations about each axis of the box, which are found
in a limited number of readings. In short windows, the medians of the rates ``w_i`` and ``w_j`` (3,) of two gyroscopes,
less their means, give the response ``C_ji u / (u' C_ii u)`` of the second one to rotations along each eigenvector u of
``C_ii``. It is u for two gyroscopes that agree; -u or another axis for wrong axes; 0 for a sensor that does not move.
Delays of filters and queues are allowed for: two gyroscopes agree if they do so with a delay of a window.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate import Calibration
from imuarray.log import SensorLog
from imuarray.log.format import SATURATED, SUSPECT
from imuarray.log.sensor_log import first_at
from imuarray.printable import listed

_WINDOW_S, _WINDOW_ROWS = 0.1, 4.0
"""Least length of a window in s, and in intervals of the slowest gyroscope: a hand turns a box at up to two or three
Hertz, and filters of gyroscopes delay their rows by up to 67 ms.
"""

_STRETCH_S = 5.0
"""Length of a stretch in s."""

_PLACES = 2
"""Number of stretches for each axis of the box."""

_MOST_READINGS = 1 << 14
"""Largest number of readings of a gyroscope in which rotations are searched: two a second in a log of two hours."""

_MOST_DENSE = 2.0
"""Largest ratio of the rate of rows in a stretch to that of the whole log; further rows are not read."""

_FEWEST_ROWS = 3
"""Fewest rows in a window: a single outlier does not change their median."""

_CLEAR_RATE = np.radians(30.0)
"""Least rate, in rad/s, of a clear rotation. Biases drift by a few degrees per second while a box warms up."""

_CLEAR_S = 2.0
"""Time in s at `_CLEAR_RATE`, or that of the same sum of squares, that a comparison requires."""

_CONTRADICTION = 0.6
"""Least size of the difference between a response and the rotation, relative to the rotation, that is reported: an
exchanged or inverted axis has 1.4 or 2, a sensor that does not move 1. Scale factors, misalignment and delays of
uncalibrated chips have less than 0.35.
"""


def rate_contradictions(sensors: Sequence[SensorLog], calibration: Calibration) -> Iterator[str]:
    """Yield a sentence for each gyroscope whose rates contradict those of most others, or one sentence on all
    gyroscopes if no side is the majority. Nothing is yielded without a clear rotation.
    """
    gyroscopes = [sensor for sensor in sensors if sensor.quantity == "angular_rate" and len(sensor)]
    scouts = gyroscopes[:2] if len(gyroscopes) > 1 else []  # the second one, if the first one does not move
    starts_ns = next(filter(None, (_stretches(scout, calibration) for scout in scouts)), [])
    if not starts_ns:
        return
    width_s = max(_WINDOW_S, _WINDOW_ROWS * max(map(_interval_s, gyroscopes)))
    rates = [_window_rates(sensor, calibration, starts_ns, width_s) for sensor in gyroscopes]
    disagree = np.array([[_is_contradicted(first, second, _CLEAR_S / width_s) for second in rates] for first in rates])
    disagree |= disagree.T
    if not disagree.any():
        return
    names = [sensor.name for sensor in gyroscopes]
    agrees = ~disagree[int(np.argmin(disagree.sum(axis=1)))]
    majority = [name for name, is_usual in zip(names, agrees.tolist(), strict=True) if is_usual]
    others = [name for name in names if name not in majority]
    check = "check their `axes` and range in the configuration or map; if these are right, a sensor is faulty"
    if len(majority) <= len(others):
        yield f"{listed(names)}: their angular rates contradict each other: {check}"
        return
    for name in others:
        yield f"{name}: its angular rates contradict those of {listed(majority)}: {check.replace('their', 'its')}"


def _stretches(sensor: SensorLog, calibration: Calibration) -> list[int]:
    """Return the times (ns) at which stretches begin: those of the fastest rotations about each axis of the box, and
    the quietest one; none without a clear rotation.
    """
    step = -(-len(sensor) // _MOST_READINGS)
    counts = [np.asarray(sensor.counts[part])[-part.start % step :: step] for part in sensor.blocks()]
    rates = calibration.or_nominal(sensor).stimulus_box(np.concatenate(counts))
    rates = np.abs(rates - np.median(rates, axis=0))
    around = int(_STRETCH_S / (_interval_s(sensor) * step))
    rows = [int(rates.sum(axis=1).argmin())]
    for axis in np.repeat(range(3), _PLACES).tolist():
        fastest = int(rates[:, axis].argmax())
        if rates[fastest, axis] >= _CLEAR_RATE:
            rows.append(fastest)
            rates[max(fastest - around, 0) : fastest + around + 1] = 0.0
    half_ns = round(_STRETCH_S * 5e8)
    return [int(sensor.time[row * step]) - half_ns for row in rows] if len(rows) > 1 else []


def _interval_s(sensor: SensorLog) -> float:
    """Return the mean interval between the rows of a sensor, in s."""
    return max((int(sensor.time[-1]) - int(sensor.time[0])) * 1e-9 / len(sensor), 1e-6)


def _window_rates(sensor: SensorLog, calibration: Calibration, starts_ns: Sequence[int], width_s: float) -> Floats:
    """Return the median rates (s, w, 3) of a sensor in the w windows of each stretch, in rad/s in the box frame; NaN
    for windows with few rows, or with saturated or suspect ones.
    """
    width_ns, windows = round(width_s * 1e9), int(_STRETCH_S / width_s)
    medians = np.full((len(starts_ns), windows, 3), np.nan)
    most_rows = int(_MOST_DENSE * _STRETCH_S / _interval_s(sensor)) + 1
    for median, start_ns in zip(medians, starts_ns, strict=True):
        first = first_at(sensor.time, start_ns)
        times = np.asarray(sensor.time[first : first + most_rows], np.int64)
        times = times[: np.searchsorted(times, start_ns + windows * width_ns)]
        rows, places = slice(first, first + len(times)), (times - start_ns) // width_ns
        flagged = np.asarray(sensor.status[rows]) & (SATURATED | SUSPECT) != 0
        counts, number = np.asarray(sensor.counts[rows], float), np.bincount(places, minlength=windows)
        usable = (number >= _FEWEST_ROWS) & (np.bincount(places, flagged, windows) == 0)
        middles = (np.cumsum(number) - number + number // 2)[usable]
        for axis in range(3):
            order = np.lexsort((counts[:, axis], places))
            median[usable, axis] = counts[order[middles], axis]
    return calibration.or_nominal(sensor).stimulus_box(medians.reshape(-1, 3)).reshape(medians.shape)


def _is_contradicted(first: Floats, second: Floats, clear_windows: float) -> bool:
    """Return whether the response of the second gyroscope to a clear rotation that the first one measures is another
    one, with no delay and with one of a window either way. The rates are (s, w, 3).
    """
    windows = first.shape[1]
    pairs = [
        (first[:, max(-late, 0) : windows - max(late, 0)], second[:, max(late, 0) : windows - max(-late, 0)])
        for late in (0, 1, -1)
    ]
    return all(_has_another_response(*pair, clear_windows) for pair in pairs)


def _has_another_response(first: Floats, second: Floats, clear_windows: float) -> bool:
    """Return whether the second gyroscope responds otherwise than the first one to a clear rotation along any axis."""
    known = np.isfinite(first).all(axis=2) & np.isfinite(second).all(axis=2)
    if np.count_nonzero(known) < clear_windows:
        return False
    turned, response = (rates[known] - rates[known].mean(axis=0) for rates in (first, second))
    squares, axes = np.linalg.eigh(turned.T @ turned)
    clear = squares > clear_windows * _CLEAR_RATE**2
    responses = response.T @ turned @ axes[:, clear] / squares[clear]
    return bool((np.linalg.norm(responses - axes[:, clear], axis=0) > _CONTRADICTION).any())
