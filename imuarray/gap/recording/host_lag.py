"""How far all sensors of a log are behind the motion that its track tells: what the clock of the host has gained."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from imuarray.arrays import Floats, Integers
from imuarray.log import SensorLog
from imuarray.simulate.motion.felt import Motion
from imuarray.units import SI_PER_UNIT

GRID_S = 0.01
_WINDOW, _FURTHEST = 400, 100
"""Rows of the grid in a window, and by how many it may be behind, or ahead, more than the window before."""

WINDOWS = 64
"""Of a log, those in which it moves most; a rate that changes shows in as many."""

_LEAST, _MOVES = 0.5, 1e-2
"""Share of the sensors' variance that the motion has to explain, and least rms of it, in m/s^2 and rad/s."""

_SURE = 1.5
"""The next best place has to leave so many times the variance: else it may be a period more or less."""


class HostLag(NamedTuple):
    """At `at_s` after the log's epoch, in the middle of a window's motion, sensors are `lag_s` behind the track, with a
    standard error `error_s`.
    """

    at_s: float
    lag_s: float
    error_s: float


def behind(sensors: Sequence[SensorLog], motion: Motion) -> tuple[HostLag, ...]:
    """Of the sensors (accelerometers and gyroscopes) taken together, window by window, in those that tell it."""
    found: list[HostLag] = []
    lag_s = 0.0
    for start_ns in _moving(sensors, motion):
        one = _in_window(sensors, motion, start_ns, lag_s)
        if one is not None:
            found.append(one)
            lag_s = one.lag_s
    return tuple(found)


def _moving(sensors: Sequence[SensorLog], motion: Motion) -> list[int]:
    """When the windows begin, in ns, in which the box moves most by its track."""
    begin_ns = max((int(one.time[0]) for one in sensors), default=0)
    end_ns = min((int(one.time[-1]) for one in sensors), default=0)
    length_ns = _ns(_WINDOW)
    starts = np.arange(begin_ns, end_ns - length_ns, length_ns)
    size = np.zeros(len(starts))
    for at, start in enumerate(starts.tolist()):
        size[at] = max(np.sqrt(np.var(one, axis=0).sum()) for one in _told(motion, _grid(start, 0)[::8]).values())
    chosen = np.argsort(-size, kind="stable")[:WINDOWS]
    return sorted(starts[chosen[size[chosen] > _MOVES]].tolist())


def _in_window(sensors: Sequence[SensorLog], motion: Motion, start_ns: int, near_s: float) -> HostLag | None:
    """None where nothing, or more than one lag, fits."""
    near = round(near_s / GRID_S)
    reach = _grid(start_ns - _ns(near), _FURTHEST)
    read, told = _read(sensors, _grid(start_ns, 0)), _told(motion, reach)
    left, square, noise = np.zeros(2 * _FURTHEST + 1), np.zeros(_WINDOW), 0.0
    for quantity, own in read.items():
        moved = told[quantity]
        size = float(np.var(moved, axis=0).sum())
        if size < _MOVES**2:
            continue
        shifted = sliding_window_view(moved, _WINDOW, axis=0)[::-1]  # the first is the furthest behind
        apart = own.T - own.mean(axis=0)[:, None] - (shifted - shifted.mean(axis=2, keepdims=True))
        left += (apart**2).sum(axis=(1, 2)) / size
        square += (np.gradient(moved, GRID_S, axis=0) ** 2).sum(axis=1)[_FURTHEST:-_FURTHEST] / size
        noise += _WINDOW
    best = int(np.argmin(left))
    if not square.any() or not 0 < best < len(left) - 1 or left[best] > _LEAST * noise:
        return None
    if any(left[at] < _SURE * left[best] for at in _dips(left) if at != best):
        return None
    before, here, after = left[best - 1 : best + 2].tolist()
    place = best - _FURTHEST + 0.5 * (before - after) / (before - 2 * here + after)
    middle_s = float(np.average(np.arange(_WINDOW), weights=square)) * GRID_S
    error_s = float(np.sqrt(here / noise / square.sum()))
    return HostLag(start_ns * 1e-9 + middle_s, (near + place) * GRID_S, error_s)


def _dips(left: Floats) -> Iterator[int]:
    """Where it is less than on either side."""
    yield from (1 + np.flatnonzero((left[1:-1] < left[:-2]) & (left[1:-1] <= left[2:]))).tolist()


def _read(sensors: Sequence[SensorLog], grid_ns: Integers) -> dict[str, Floats]:
    """(n, 3) of each quantity, SI, box axes, the mean of all sensors that have rows there."""
    found: dict[str, list[Floats]] = {}
    for sensor in sensors:
        span = sensor.between(int(grid_ns[0]) - _ns(10), int(grid_ns[-1]) + _ns(10))
        times = np.asarray(sensor.time[span], np.int64)
        if len(times) < 2 or not sensor.sensitivity:
            continue
        box = np.asarray(sensor.counts[span], float) @ np.array(sensor.orientation).T
        at, known = (grid_ns - grid_ns[0]) * 1e-9, (times - grid_ns[0]) * 1e-9
        scale = SI_PER_UNIT[sensor.unit] / sensor.sensitivity
        found.setdefault(sensor.quantity, []).append(
            np.stack([np.interp(at, known, axis) for axis in box.T], axis=1) * scale
        )
    return {quantity: np.mean(several, axis=0) for quantity, several in found.items()}


def _told(motion: Motion, time_ns: Integers) -> Mapping[str, Floats]:
    """(n, 3) of each quantity, SI, box axes."""
    felt = motion.felt(time_ns)
    return {
        "specific_force": np.asarray(felt.force_box, float),
        "angular_rate": np.asarray(felt.rate_box, float),
    }


def _grid(start_ns: int, more: int) -> Integers:
    """The times of a window, and of so many rows more on either side."""
    return start_ns + _ns(1) * np.arange(-more, _WINDOW + more, dtype=np.int64)


def _ns(rows: int) -> int:
    return round(rows * GRID_S * 1e9)
