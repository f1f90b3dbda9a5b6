"""Alignment of sensors in time by the synchronisation pulses that their samples mark.

The time of a pulse as one sensor has it is the time of the marked row less the time since the pulse (`sync_pulse`),
which is scaled by the sensor's actual rate: chips measure it, or half a period, by their own oscillators. The mean
difference from the reference's times of the same pulses is the error of one sensor's times against the other's,
whatever the rows contain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.log import SensorLog
from imuarray.log.format import SYNC_PULSE_ERROR

WINDOW_S = 600.0
"""Duration of the stretch in the middle of a log in which pulses are compared."""
LEAST_PULSES = 5
_SHARE_OF_SPREAD = 0.5
"""Differences of pulses that fall at any phase of the samples scatter; if they scatter less than this share of what
uniform phases would make, they are at fixed phases, and their mean is known no better than each of them.
"""
_BLOCK_ROWS = 1 << 16


class PulseOffset(NamedTuple):
    """The number of pulses that a sensor and the reference have both marked, the mean time (s) by which the sensor has
    them later, and its error: the 95 % interval, or the largest possible error for pulses at fixed phases.
    """

    pulses: int
    offset_s: float
    error_s: float


def pulse_offsets(sensors: Sequence[SensorLog], rates_hz: Sequence[float]) -> dict[str, PulseOffset]:
    """Return the offsets of those of the `sensors`, with rows at these rates, that have at least `LEAST_PULSES` pulses
    in common with the first that has pulses; that one itself has 0. Empty for fewer than two.
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
    middle, half = len(sensor) // 2, round(WINDOW_S / 2 * rate_hz)
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
