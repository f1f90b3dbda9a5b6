"""Lag of a sensor behind the motion of the others, phase by phase, also where it is no small part of a period."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.statistics.cross import Cross
from imuarray.gap.statistics.probes.motion import along, quadrature
from imuarray.log.format import Phase

ODD = 2.5
"""Scores beyond which there is something to explain."""


class Lag(NamedTuple):
    """`lag_s` behind the others, `at_s` after the log's epoch, in a motion of mean period 2 pi / `pace`; `weight` is
    how much moved.
    """

    at_s: float
    lag_s: float
    pace: float
    weight: float

    @property
    def is_large(self) -> bool:
        """True if it may be any number of periods more or less."""
        return abs(self.lag_s * self.pace) > 1


def odd_lags(evidence: Evidence) -> list[Lag]:
    """Return the lag in each phase of motion, if the lags are odd, by themselves or because a sensor that is far behind
    shares none of the motion.
    """
    all_lags = list(lags(evidence))
    large = any(lag.is_large for lag in all_lags) and bool((evidence.score("motion_residual") > ODD).any())
    return all_lags if large or evidence.is_odd("motion_delay", beyond=ODD) else []


def mean_of(lags_seen: Sequence[Lag], name: str) -> float:
    """Return the mean of the field with this name, weighted by the amount of motion."""
    return float(np.average([getattr(lag, name) for lag in lags_seen], weights=[lag.weight for lag in lags_seen]))


def lags(evidence: Evidence) -> Iterator[Lag]:
    """Yield the lag in each phase of motion, averaged over the axes by their motion. The gain of an axis is that by its
    own motion alone: a rotation about a single axis does not determine the response to each of three.
    """
    usual_s, share = _usual(evidence, "motion_delay", 0.0), _usual(evidence, "motion_along", 1.0)
    share = np.where(share > 0, share, np.nan)
    sensor = evidence.header.name
    for phase, cross in motions(evidence):
        rate, weight = _pace(cross, sensor)
        pace = np.arcsin(np.minimum(rate * cross.window_s, 1.0)) / cross.window_s
        lag_of_axis = np.arctan2(rate * (quadrature(cross, sensor) - usual_s), along(cross, sensor) / share) / pace
        known = np.isfinite(lag_of_axis) & (weight > 0)
        if known.any():
            middle_s = (phase.start_ns + phase.end_ns) * 0.5e-9
            lag_s, mean_pace = (float(np.average(item[known], weights=weight[known])) for item in (lag_of_axis, pace))
            yield Lag(middle_s, lag_s, mean_pace, float(weight[known].sum()))


def motions(evidence: Evidence) -> Iterator[tuple[Phase, Cross]]:
    """Yield the phases in which the box moves, and what the sensor and others have in common there."""
    for phase in evidence.phases:
        cross = None if phase.is_still else phase.cross
        if cross is not None and any(item.name == evidence.header.name for item in cross.sensors):
            yield phase.raw.phase, cross


def speed_squared(cross: Cross, sensor: str) -> Floats:
    """Return (3,) mean square of the change of readings per second, squared units."""
    return np.asarray(np.diag(cross.changes)[cross.columns(sensor)] / cross.window_s**2)


def _pace(cross: Cross, sensor: str) -> tuple[Floats, Floats]:
    """Return (3,) root of the mean square of change per second over that of the signal, 1/s, and the speed's square."""
    speed = speed_squared(cross, sensor)
    square = np.diag(cross.fast)[cross.columns(sensor)]
    ratio = np.divide(speed, square, out=np.full(3, np.nan), where=(square > 0) & (speed > 0))
    return np.sqrt(ratio), speed


def _usual(evidence: Evidence, probe: str, otherwise: float) -> Floats:
    """Return (3,) what the model makes of a probe, in the median over phases."""
    rows = evidence.expected.get(probe, np.zeros((0, 3)))
    known = rows[np.isfinite(rows).all(axis=1)]
    return np.asarray(np.median(known, axis=0)) if len(known) else np.full(3, otherwise)
