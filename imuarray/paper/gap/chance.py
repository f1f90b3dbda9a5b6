"""How far means over windows scatter by chance: covariances of white noise, wander and random walk.

A random walk w of unit density has, for windows that begin at a and, later, at b and last s seconds, cov = a + s / 2
and var = a + s / 3.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from imuarray.paper.gap.sensor import Floats, Sensor
from imuarray.paper.noise import FACE_SECONDS
from imuarray.paper.replica import experiments
from imuarray.paper.wander import PARTS, TIME_CONSTANT_S, WINDOW_S, covariance_of_means, variance_of_mean
from imuarray.simulate.motion.heating import Heating


@cache
def array_rate_hz(number: int) -> float:
    """The array's logging rate by Table 10 or 11."""
    return experiments.array_rate_hz(number)


@cache
def run_temperatures() -> Floats:
    """(15,) degC of the runs of Table 11."""
    return experiments.run_temperatures()


class Windows(NamedTuple):
    """(n, n) covariances of the means over windows in a row for unit wander and unit random walk; seconds of one."""

    wander: Floats
    walk: Floats
    seconds: float

    def covariance(self, sensor: Sensor, axis: int, rate_hz: float) -> Floats:
        """(n, n) of a sensor's axis, counts^2."""
        white = sensor.rounded_noise[axis] ** 2 / (rate_hz * self.seconds)
        slow = sensor.in_run[axis] ** 2 * self.wander + sensor.walk[axis] ** 2 * self.walk
        return np.asarray(slow + white * np.eye(len(slow)))


@cache
def windows(count: int, seconds: float) -> Windows:
    """Windows one after the other from switching on."""
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    by_distance = [variance_of_mean(seconds), *(covariance_of_means(k, seconds) for k in range(1, count))]
    begins = np.minimum.outer(np.arange(count), np.arange(count)) * seconds
    walk = begins + np.where(apart == 0, seconds / 3, seconds / 2)
    return Windows(np.array(by_distance)[apart], walk, seconds)


FACES = windows(7, float(FACE_SECONDS))
PARTS_OF_RUN = windows(PARTS, WINDOW_S)
ONE_RUN = windows(1, WINDOW_S)


class Line(NamedTuple):
    """A straight line through readings while the box is heated: mean temperature; variance of slope (per degC) and of
    the level at that temperature for unit white noise of single readings, wander and walk.
    """

    degc: float
    slope: Floats
    level: Floats

    def variances(self, sensor: Sensor, axis: int) -> tuple[float, float]:
        """(slope, level) of a sensor's axis, counts^2."""
        of = np.array([sensor.rounded_noise[axis], sensor.in_run[axis], sensor.walk[axis]]) ** 2
        return float(of @ self.slope), float(of @ self.level)


@cache
def heated_line() -> Line:
    """By the temperature every half minute."""
    motion = Heating()
    seconds = np.arange(0.0, motion.seconds, 30.0)
    degc = np.asarray(motion.felt((seconds * 1e9).astype(np.int64)).temperature_degc, float)
    away = degc - degc.mean()
    weights, even = away / (away @ away), np.full(len(away), 1 / len(away))
    wander = np.exp(-np.abs(np.subtract.outer(seconds, seconds)) / TIME_CONSTANT_S)
    walk = np.minimum.outer(seconds, seconds)
    readings = array_rate_hz(10) * motion.seconds
    slope = [1 / (readings * degc.var()), weights @ wander @ weights, weights @ walk @ weights]
    return Line(float(degc.mean()), np.array(slope), np.array([1 / readings, even @ wander @ even, even @ walk @ even]))


def log_deviation(covariance: Floats, pattern: Floats, wild: float = 0.0) -> tuple[float, float]:
    """(expected deviation, standard deviation of its logarithm) of normal numbers (n,) with this covariance about a
    `pattern` (n,), and others of variance `wild` times a chi-square of one degree: half the relative spread of a
    quadratic form.
    """
    freedom = len(covariance) - 1
    centred, away = covariance - covariance.mean(axis=0), pattern - pattern.mean()
    total = (float(np.trace(centred)) + float(away @ away)) / freedom + wild
    spread = (2 * float(np.trace(centred @ centred)) + 4 * float(away @ covariance @ away)) / freedom**2 + 2 * wild**2
    return total**0.5, spread**0.5 / (2 * total)
