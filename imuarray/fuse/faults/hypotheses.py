"""Which axis, or which whole sensor, explains best what a window shows: generalised likelihood ratios.

Two tests, for every axis and for every sensor as a whole:

- mean: the window's mean is off by a constant;
- energy: single readings scatter about their mean by more than their noise, whatever the course (spikes, noise, a
  fault that begins within the window, another scale).

The hypothesis with the largest gain wins; it is isolated if no other sensor gains nearly as much.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from imuarray.fuse.faults.normal import Normal
from imuarray.fuse.faults.window import Look

Floats = npt.NDArray[np.float64]

AXIS_GAIN = 50.0
"""Gain (7 standard deviations) from which the mean of an axis is off: 2e-12 per test for normal noise. The reserve is
for what is not normal."""

SENSOR_GAIN = 57.0
"""The same probability with three degrees of freedom."""

_MORE_AXES = 24.0
"""What a whole sensor has to gain over one of its axes, to be blamed as a whole."""

_ENERGY_NATS = 25.0
"""A sum of squares that white noise exceeds with a probability of e^-25 (bound of Laurent and Massart, Annals of
Statistics 28, 2000, lemma 1)."""

_MARGIN = 12.0
_MARGIN_SHARE = 0.3
"""By so much, and by this share of its gain, a hypothesis has to be better than any of another sensor."""


@dataclass(frozen=True)
class Suspect:
    """The best explanation: which axes (indices), its gain over no fault, by which test, and the sensors (numbers) that
    explain it nearly as well (none: it is isolated).
    """

    axes: tuple[int, ...]
    gain: float
    test: Literal["mean", "energy"]
    rivals: tuple[int, ...] = ()


def strongest(seen: Look, normal: Normal) -> Suspect | None:
    """The most likely fault of a window, None if it shows none."""
    axis, sensor = seen.slow.axis_gains(seen.means), seen.slow.sensor_gains(seen.means)
    energy, lasting = seen.energies(normal)
    limit = energy_limit(len(seen.triad), normal.colour, lasting)
    by_mean = max(float(axis.max()) / AXIS_GAIN, float(sensor.max()) / SENSOR_GAIN)
    by_energy = float((energy / limit).max())
    if max(by_mean, by_energy) < 1:
        return None
    if by_energy > by_mean:
        return _by_energy(energy, limit)
    return _by_mean(axis, sensor, seen)


def energy_limit(frames: int, colour: Floats, lasting: Floats) -> Floats:
    """(m,) the energy that noise of this `colour` (m,) doesn't exceed; what is doubt about calibration in it may be the
    same for all readings of the window, 7 standard deviations at most.
    """
    nats = _ENERGY_NATS * colour
    by_noise = frames + 2 * np.sqrt(frames * nats) + 2 * nats
    return np.asarray((1 - lasting) * by_noise + lasting * frames * AXIS_GAIN)


def least_energy_limit(frames: int) -> float:
    """What `energy_limit` is at least: that of white noise, or of doubt alone where that is less."""
    return float(min(energy_limit(frames, np.ones(1), np.zeros(1))[0], frames * AXIS_GAIN))


def _by_mean(axis: Floats, sensor: Floats, seen: Look) -> Suspect:
    """Of the means: the sensor that gains most, or the one axis of it that does nearly all of that."""
    best = int(sensor.argmax())
    members = np.arange(3 * best, 3 * best + 3)
    one = int(members[axis[members].argmax()])
    alone = sensor[best] - axis[one] < _MORE_AXES
    axes = (one,) if alone else tuple(int(index) for index in members if seen.included[index])
    gain = float(axis[one] if alone else sensor[best])
    return Suspect(axes, gain, "mean", _rivals(sensor, best, gain))


def _by_energy(energy: Floats, limit: Floats) -> Suspect:
    """Of the scatter: the sensor with the wildest axis, and its axes that are wild."""
    per_sensor = (energy / limit).reshape(-1, 3).max(axis=1)
    best = int(per_sensor.argmax())
    members = np.arange(3 * best, 3 * best + 3)
    wild = tuple(int(index) for index in members if energy[index] >= limit[index])
    gain = float(energy[members].max())
    strength = np.where(energy >= limit, energy, 0.0).reshape(-1, 3).max(axis=1)
    return Suspect(wild, gain, "energy", _rivals(strength, best, gain))


def _rivals(gains: Floats, best: int, gain: float) -> tuple[int, ...]:
    """The sensors whose gain comes too near that of the best one."""
    near = gains > gain - max(_MARGIN, _MARGIN_SHARE * gain)
    near[best] = False
    return tuple(int(sensor) for sensor in np.flatnonzero(near))
