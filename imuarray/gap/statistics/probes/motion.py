"""How a sensor follows a motion that the others of its kind feel too: in size, in direction, in time, in place.

The reference is the mean of the other sensors that measure the same, along the axes that this one nominally has. It is
noisy itself, which makes gains a little too small; as much so in a simulation of the same motion.

A polled chip's readings are up to one of its periods old, and in step with the polls always as old: a delay that says
nothing. What is left of a sensor's motion is what no delay of it explains either.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.cross import Cross
from imuarray.gap.statistics.probes.probe import NOTHING, CrossProbe, log, once

AXES = np.arange(3)

_ENDS = 0.02
"""Share of what is left that is kept: about that of the windows at segments' ends, whose change is not known."""


def gain(cross: Cross, sensor: str) -> Floats:
    """What the axis shows of motion along it, as a share."""
    return np.asarray(_gains(cross, sensor)[AXES, AXES])


def next_axis(cross: Cross, sensor: str) -> Floats:
    """What the axis shows of motion along the next one."""
    return np.asarray(_gains(cross, sensor)[AXES, (AXES + 1) % 3])


def axis_after(cross: Cross, sensor: str) -> Floats:
    """What the axis shows of motion along the one after that."""
    return np.asarray(_gains(cross, sensor)[AXES, (AXES + 2) % 3])


def delay(cross: Cross, sensor: str) -> Floats:
    """By how many seconds the axis is behind: y(t) = r(t - delay) is about r - delay dr/dt, and so the delay is what y
    lacks of r, along the change of r.
    """
    found = _beside(cross, sensor)
    if found is None:
        return NOTHING
    own, reference = AXES, AXES + 3
    lacks = found.turning[reference, reference] - found.turning[own, reference]
    square = found.changes[reference, reference]
    ratio = np.divide(lacks, square, out=NOTHING.copy(), where=square > 0)
    return np.asarray(ratio * cross.window_s)


def residual(cross: Cross, sensor: str) -> Floats:
    """Log of the variance that the reference doesn't explain, whatever the delay behind it."""
    found = _beside(cross, sensor)
    return NOTHING if found is None else log(_left(found, AXES + 3))


def coupling(cross: Cross, sensor: str) -> Floats:
    """Log of that variance over what is left when an accelerometer's is explained by products of angular rates and
    angular accelerations too, a gyroscope's by the force that accelerometers feel.
    """
    found = _beside(cross, sensor)
    if found is None or found.moments.shape[0] == 6:
        return NOTHING
    everything = np.arange(3, found.moments.shape[0])
    return np.asarray(log(_left(found, AXES + 3)) - log(_left(found, everything)))


class _Beside(NamedTuple):
    """Of the sensor's axes, the reference's and what else may explain them: `moments`, `turning` and `changes` (q, q)
    as `Cross` has them.
    """

    moments: Floats
    turning: Floats
    changes: Floats


def _beside(cross: Cross, sensor: str) -> _Beside | None:
    """None for the only sensor of its kind, or without windows."""
    return _all_beside(cross)[sensor]


@once
def _all_beside(cross: Cross) -> dict[str, _Beside | None]:
    return {item.name: _put_beside(cross, item.name) for item in cross.sensors}


def _put_beside(cross: Cross, sensor: str) -> _Beside | None:
    others = cross.others(sensor, family=False)
    if not others or not cross.windows:
        return None
    header = cross.header(sensor)
    own = np.zeros((3, cross.fast.shape[0]))
    own[:, cross.columns(sensor)] = np.eye(3)
    turn = np.array(header.orientation).T
    more = [turn @ _mean_box(cross, others)]
    if header.quantity == "specific_force":
        more.append(np.eye(cross.fast.shape[0])[cross.kinematic])
    else:
        feel = [item.name for item in cross.sensors if item.quantity == "specific_force"]
        more += [turn @ _mean_box(cross, feel)] if feel else []
    weights = np.concatenate([own, *more])
    return _Beside(*(weights @ moments @ weights.T for moments in (cross.fast, cross.turning, cross.changes)))


def _mean_box(cross: Cross, sensors: tuple[str, ...] | list[str]) -> Floats:
    """(3, p) the mean of these along the box's axes."""
    weights = np.zeros((3, cross.fast.shape[0]))
    for name in sensors:
        weights[:, cross.columns(name)] = np.array(cross.header(name).orientation) / len(sensors)
    return weights


def _gains(cross: Cross, sensor: str) -> Floats:
    """(3, 3) response of the sensor's axes (rows) to the reference's (columns)."""
    return _all_gains(cross)[sensor]


@once
def _all_gains(cross: Cross) -> dict[str, Floats]:
    nothing = np.full((3, 3), np.nan)
    return {
        name: nothing if found is None else _coefficients(found.moments, AXES, AXES + 3).T
        for name, found in _all_beside(cross).items()
    }


def _coefficients(moments: Floats, of: np.ndarray, by: np.ndarray) -> Floats:
    """Least-squares coefficients (b, o)."""
    size = np.sqrt(np.diag(moments)[by])
    size = np.where(size > 0, size, 1.0)
    scaled = moments[np.ix_(by, by)] / size[:, None] / size
    return np.asarray(np.linalg.lstsq(scaled, moments[np.ix_(by, of)] / size[:, None], rcond=1e-12)[0] / size[:, None])


def _left(beside: _Beside, by: np.ndarray) -> Floats:
    """Variances (3,) of the sensor's axes that are left without what these columns explain, and of that without what
    the reference's changes do.
    """
    moments, reference = beside.moments, AXES + 3
    found = _coefficients(moments, AXES, by)
    left = np.asarray(np.diag(moments)[AXES] - np.einsum("bo,bo->o", found, moments[np.ix_(by, AXES)]))
    lagging = beside.turning[np.ix_(AXES, reference)] - found.T @ beside.turning[np.ix_(by, reference)]
    changes = beside.changes[np.ix_(reference, reference)]
    if not np.isfinite(changes).all():
        return left
    delayed = np.einsum("or,rs,os->o", lagging, np.linalg.pinv(changes, hermitian=True), lagging)
    return np.asarray(np.maximum(left - delayed, _ENDS * left))


_CROSS = ("misalignment", "axis_error", "channel_swap")

GAIN = CrossProbe("motion", "share of motion along the axis", "", ("scale", "axis_error", "range_reset"), gain, True)
NEXT = CrossProbe("motion", "share of motion along the next axis", "", _CROSS, next_axis, True)
AFTER = CrossProbe("motion", "share of motion along the axis after the next", "", _CROSS, axis_after, True)
DELAY = CrossProbe(
    "motion", "delay behind the others", "s", ("skew", "clock_error", "stale_samples", "own_clock"), delay, True
)
RESIDUAL = CrossProbe(
    "motion",
    "log of the variance that the others don't explain",
    "log {u}^2",
    ("jitter", "size_effect", "nonlinearity", "skew", "saturation", "own_clock"),
    residual,
    True,
)
COUPLING = CrossProbe(
    "motion", "log of how much of it rotation or force explains", "", ("size_effect", "g_sensitivity"), coupling, True
)
