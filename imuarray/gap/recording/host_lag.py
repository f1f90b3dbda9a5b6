"""The lag of all sensors of a log behind the motion of its track: the time that the host's clock has gained."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from imuarray.arrays import Floats, Integers
from imuarray.log import SensorLog
from imuarray.simulate.motion.stimulus import Motion
from imuarray.units import SI_PER_UNIT

GRID_S = 0.01
_WINDOW, _MOST_LAG_ROWS = 400, 100
"""Number of grid rows in a window, and largest lag or lead, in rows, relative to the window before."""

WINDOWS = 64
"""Largest number of windows of a log that are used, those with the most motion. They are enough to show a drifting
rate.
"""

_LEAST_SHARE, _LEAST_RMS = 0.5, 1e-2
"""Largest share of the motion's variance that may remain unexplained, and least rms of the motion, in m/s^2 and in
rad/s.
"""

_UNIQUE = 1.5
"""The variance that remains with any other lag has to exceed this multiple of that with the best lag, plus the variance
that half a grid row makes. Otherwise the motion is periodic and the lag is ambiguous by a period.
"""


class HostLag(NamedTuple):
    """Lag `lag_s` of the sensors behind the track at `at_s` after the log's epoch (the middle of a window's motion),
    with standard error `error_s`.
    """

    at_s: float
    lag_s: float
    error_s: float


def host_lags(sensors: Sequence[SensorLog], motion: Motion) -> tuple[HostLag, ...]:
    """Return the common lag of the sensors (accelerometers and gyroscopes) in each window in which it is determined."""
    lags: list[HostLag] = []
    lag_s = 0.0
    for start_ns in _moving_windows(sensors, motion):
        lag = _in_window(sensors, motion, start_ns, lag_s)
        if lag is not None:
            lags.append(lag)
            lag_s = lag.lag_s
    return tuple(lags)


def _moving_windows(sensors: Sequence[SensorLog], motion: Motion) -> list[int]:
    """Return the begins of the windows with the most motion according to the track, in ns."""
    begin_ns = max((int(values.time[0]) for values in sensors), default=0)
    end_ns = min((int(values.time[-1]) for values in sensors), default=0)
    length_ns = _ns(_WINDOW)
    starts = np.arange(begin_ns, end_ns - length_ns, length_ns)
    size = np.zeros(len(starts))
    for at, start in enumerate(starts.tolist()):
        size[at] = max(
            np.sqrt(np.var(values, axis=0).sum()) for values in track_values(motion, _grid(start, 0)[::8]).values()
        )
    chosen = np.argsort(-size, kind="stable")[:WINDOWS]
    return sorted(starts[chosen[size[chosen] > _LEAST_RMS]].tolist())


def _in_window(sensors: Sequence[SensorLog], motion: Motion, start_ns: int, near_s: float) -> HostLag | None:
    """Return the lag in one window; None if no lag fits, or more than one."""
    near = round(near_s / GRID_S)
    reach = _grid(start_ns - _ns(near), _MOST_LAG_ROWS)
    readings, track = _read(sensors, _grid(start_ns, 0)), track_values(motion, reach)
    unexplained, square, noise = np.zeros(2 * _MOST_LAG_ROWS + 1), np.zeros(_WINDOW), 0.0
    for quantity, values in readings.items():
        expected = track[quantity]
        size = float(np.var(expected, axis=0).sum())
        if size < _LEAST_RMS**2:
            continue
        shifted = sliding_window_view(expected, _WINDOW, axis=0)[::-1]  # the first one has the largest lead
        difference = values.T - values.mean(axis=0)[:, None] - (shifted - shifted.mean(axis=2, keepdims=True))
        unexplained += (difference**2).sum(axis=(1, 2)) / size
        square += (np.gradient(expected, GRID_S, axis=0) ** 2).sum(axis=1)[_MOST_LAG_ROWS:-_MOST_LAG_ROWS] / size
        noise += _WINDOW
    best = int(np.argmin(unexplained))
    if not square.any() or not 0 < best < len(unexplained) - 1 or unexplained[best] > _LEAST_SHARE * noise:
        return None
    half_row = float(square.sum()) * (GRID_S / 2) ** 2
    if any(unexplained[at] < _UNIQUE * unexplained[best] + half_row for at in _dips(unexplained) if at != best):
        return None
    before, here, after = unexplained[best - 1 : best + 2].tolist()
    place = best - _MOST_LAG_ROWS + 0.5 * (before - after) / (before - 2 * here + after)
    middle_s = float(np.average(np.arange(_WINDOW), weights=square)) * GRID_S
    error_s = float(np.sqrt(here / noise / square.sum()))
    return HostLag(start_ns * 1e-9 + middle_s, (near + place) * GRID_S, error_s)


def _dips(values: Floats) -> Iterator[int]:
    """Yield the indices of the local minima."""
    yield from (1 + np.flatnonzero((values[1:-1] < values[:-2]) & (values[1:-1] <= values[2:]))).tolist()


def _read(sensors: Sequence[SensorLog], grid_ns: Integers) -> dict[str, Floats]:
    """Return the readings (n, 3) of each quantity at the times of the grid, in SI units along the box's axes, averaged
    over all sensors that have rows there.
    """
    readings: dict[str, list[Floats]] = {}
    for sensor in sensors:
        span = sensor.between(int(grid_ns[0]) - _ns(10), int(grid_ns[-1]) + _ns(10))
        times = np.asarray(sensor.time[span], np.int64)
        if len(times) < 2 or not sensor.sensitivity:
            continue
        box = np.asarray(sensor.counts[span], float) @ np.array(sensor.orientation).T
        at, known = (grid_ns - grid_ns[0]) * 1e-9, (times - grid_ns[0]) * 1e-9
        scale = SI_PER_UNIT[sensor.unit] / sensor.sensitivity
        readings.setdefault(sensor.quantity, []).append(
            np.stack([np.interp(at, known, axis) for axis in box.T], axis=1) * scale
        )
    return {quantity: np.mean(several, axis=0) for quantity, several in readings.items()}


def track_values(motion: Motion, time_ns: Integers) -> Mapping[str, Floats]:
    """Return the track's values (n, 3) of each quantity, in SI units along the box's axes."""
    stimulus = motion.stimulus(time_ns)
    return {
        "specific_force": np.asarray(stimulus.force_box, float),
        "angular_rate": np.asarray(stimulus.rate_box, float),
    }


def _grid(start_ns: int, more: int) -> Integers:
    """Return the times of a window, extended by `more` rows on either side."""
    return start_ns + _ns(1) * np.arange(-more, _WINDOW + more, dtype=np.int64)


def _ns(rows: int) -> int:
    return round(rows * GRID_S * 1e9)
