"""Probes of the response to a motion that other sensors of the same quantity measure too: gain, direction, delay, lever
arm and nonlinearity.

The reference is the mean of the other sensors that measure the same quantity, along this sensor's nominal axes; with
fewer than two others it is the mean of these and of the log's track. The noise of the reference makes gains slightly
too small, but equally in a simulation of the same motion.

The readings of a polled chip are up to one of its periods old, and if its clock is in step with the polls they are
always equally old; this delay is not an error. The residual of a sensor is therefore the variance that remains for any
delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.campaign import LogSummary
from imuarray.gap.statistics.cross import SQUARES, Cross
from imuarray.gap.statistics.margins import CORRELATION, VARIANCE, response
from imuarray.gap.statistics.probes.probe import NOTHING, ArrayProbe, CrossProbe, Probes, fisher_z, log, once_by_sensor

AXES = np.arange(3)
_REFERENCE, _BENDING = slice(3, 6), np.arange(6, 9)

_STILL, _STILL_FOR_DELAYS = 1e-3, 1e-2
"""Share of the mean square motion over the axes that regularises the gains against a track, and delays. Along an axis
with less motion the readings are mostly cross-talk by misalignment, 6 degrees of which are a share of 0.01. Cross-talk
has no delay of its own, and against a noise-free reference any gain would fit.
"""

_LARGEST_BEND = 0.99
"""Limit of the correlation with a power of the rate. A rate that is nearly constant has a constant power, which an
error of the bias resembles: the artanh of the correlation then depends on its last digits.
"""

_MOVES = 1e-2
"""Share of the mean (or, over phases, of the largest) mean square motion that an axis or phase must exceed for a single
gain, a nonlinearity or a delay rate. The rate along an axis with less motion is mostly the sensor's own noise and
cross-talk.
"""

_TURNS_ABOUT_ALL = 0.01
"""Least variance of the motion along any direction, as a share of that along the strongest direction, for which the
responses to motion along the three axes are estimated separately. With less, they are determined by the noise, which
differs between sensors.
"""

_ACROSS = 0.25
"""Share of the power of a motion along an axis below which the motion counts as perpendicular to the axis."""

_ENDS = 0.02
"""Least share of the residual variance that remains after a delay is fitted: about the share of the windows at the ends
of segments, for which the change is not known.
"""


def gain(ahead: int, cross: Cross, sensor: str) -> Floats:
    """Return the response (3,) of each axis to motion along it (`ahead` 0), along the next axis (1), or along the axis
    after the next (2), as a ratio to that motion.
    """
    return np.asarray(_separate_gains(cross, sensor)[AXES, (AXES + ahead) % 3])


def along(cross: Cross, sensor: str) -> Floats:
    """Return the response (3,) of each axis to motion along it, from a regression on that motion alone; nan for axes
    with hardly any motion. Unlike `gain` it is also determined by a rotation about a single direction, for which the
    motions along the three axes are proportional and cannot be separated.
    """
    joint = _joint_moments(cross, sensor)
    if joint is None:
        return NOTHING
    motion, shares = np.diag(joint.moments)[AXES + 3], joint.moments[AXES, AXES + 3]
    return np.asarray(np.divide(shares, motion, out=NOTHING.copy(), where=motion > _MOVES * motion.mean()))


def across(cross: Cross, sensor: str) -> Floats:
    """Return the response (3,) of each axis to a rotation about, or a motion along, a single direction, less the
    component of that direction along the axis. nan for axes near that direction, if `gain` separates the motions along
    three axes, and without another sensor of the quantity.
    """
    joint = _joint_moments(cross, sensor)
    if joint is None or not cross.others(sensor, family=False):
        return NOTHING
    strengths, ways = np.linalg.eigh(joint.moments[np.ix_(AXES + 3, AXES + 3)])
    if not strengths[2] > 0 or strengths[0] > _TURNS_ABOUT_ALL * strengths[2]:
        return NOTHING
    way = ways[:, 2] * np.sign(ways[np.abs(ways[:, 2]).argmax(), 2])
    shares = joint.moments[np.ix_(AXES, AXES + 3)] @ way / strengths[2]
    return np.where(way**2 < _ACROSS, shares - way, np.nan)


def delay(cross: Cross, sensor: str) -> Floats:
    """Return the delay (3,) of each axis, in seconds, relative to p, the product of its gains and the reference; nearly
    0 for an axis with hardly any motion.

    y(t) = p(t - delay) is about p - delay dp/dt, so the delay is the projection of p - y on the change of p.
    """
    joint = _joint_moments(cross, sensor)
    if joint is None:
        return NOTHING
    gains, reference = _gains(cross, sensor), AXES + 3
    turning, square = joint.turning[np.ix_(reference, reference)], _changes_of(joint, gains)
    lacks = np.einsum("oa,ab,ob->o", gains, turning, gains) - np.einsum(
        "ob,ob->o", joint.turning[np.ix_(AXES, reference)], gains
    )
    damped = square**2 + (_STILL_FOR_DELAYS * np.diag(joint.changes)[reference].mean()) ** 2
    return np.asarray(np.divide(lacks * square, damped, out=NOTHING.copy(), where=damped > 0) * cross.window_s)


def delay_rate(log: LogSummary, sensor: str) -> Floats:
    """Return the change per second of a sensor's delay relative to the track, over the phases of a log in which the box
    moves. The result is one number; nan with fewer than `_FEWEST_MOTIONS` of these phases, and for a sensor without
    columns of the track.

    A clock that is fast increases the delay of the sensor continually, whatever the delay of its filter and the offset
    of its clock are.
    """
    crosses = [part.cross for part in log.phases if not part.is_still and part.cross is not None]
    crosses = [cross for cross in crosses if sensor in cross.with_track and cross.windows]
    changes, lacks = np.array([_behind_track(cross, sensor) for cross in crosses]).reshape(-1, 2).T
    moves = changes > _MOVES * changes.max(initial=0.0)
    if np.count_nonzero(moves) < _FEWEST_MOTIONS:
        return np.array(np.nan)
    middle_s = np.array([cross.phase.start_ns + cross.phase.end_ns for cross in crosses])[moves] * 0.5e-9
    apart_s = middle_s - middle_s.mean()
    return np.asarray(apart_s @ (lacks[moves] / changes[moves]) / (apart_s @ apart_s))


def _behind_track(cross: Cross, sensor: str) -> tuple[float, float]:
    """Return the mean square of dp/dt of the track p, summed over the axes of a sensor y, and the mean product of p - y
    and dp/dt, which for a late sensor is the delay times the former. Errors of scale or alignment contribute nothing if
    p is the same at the begin and the end.
    """
    every = np.eye(cross.fast.shape[0])
    track = np.array(cross.header(sensor).orientation).T @ every[cross.track_columns(sensor)]
    lacks = track - every[cross.columns(sensor)]
    change = np.einsum("ap,pq,aq->", track, cross.changes, track) / cross.window_s**2
    return float(change), float(np.einsum("ap,pq,aq->", lacks, cross.turning, track) / cross.window_s)


_FEWEST_MOTIONS = 3
"""Least number of phases with motion from which the change of a delay is estimated."""

_OF_CRYSTALS = 5e-5
"""Usual relative difference between the clocks of two instruments, each with a crystal oscillator."""


def quadrature(cross: Cross, sensor: str) -> Floats:
    """Return the component (3,) of each axis in quadrature to the reference r along it, in seconds: the projection of
    r - y on the change of r. It equals the delay if that is short, and sin(w d) / w for a sine of angular frequency w
    that is delayed by d.
    """
    joint = _joint_moments(cross, sensor)
    if joint is None:
        return NOTHING
    axes, reference = AXES, AXES + 3
    lacks = joint.turning[reference, reference] - joint.turning[axes, reference]
    square = joint.changes[reference, reference]
    return np.asarray(np.divide(lacks, square, out=NOTHING.copy(), where=square > 0) * cross.window_s)


def information_on_delay(cross: Cross, sensor: str) -> Floats:
    """Return the inverse variance (3,) of each axis's delay, in s^-2, from the variance that the delay does not
    explain; nan without a reference.
    """
    joint = _joint_moments(cross, sensor)
    if joint is None:
        return NOTHING
    square = _changes_of(joint, _gains(cross, sensor)) / cross.window_s**2
    left_over = _residual_variance(joint, AXES + 3)
    return np.asarray(
        cross.windows * np.divide(square, left_over, out=np.zeros(3), where=(left_over > 0) & np.isfinite(square))
    )


def uncertainty_of_delay(cross: Cross, sensor: str) -> Floats:
    """Return the least meaningful difference (3,) of the delays, in s: `_UNCERTAIN` standard deviations by the noise,
    at most the phase; 0 without a reference.
    """
    information = information_on_delay(cross, sensor)
    longest_s = (cross.phase.end_ns - cross.phase.start_ns) * 1e-9
    deviation_s = 1 / np.sqrt(np.maximum(np.nan_to_num(information), 1 / longest_s**2))
    return np.where(np.isfinite(information), _UNCERTAIN * deviation_s, 0.0)


_UNCERTAIN = 2.0
"""Standard deviations of a delay, by the noise of the sensor, below which a difference has no meaning. Of an axis about
which the box hardly turns, the delay is that of cross-talk and noise, and its distribution has long tails.
"""


def _changes_of(joint: _JointMoments, gains: Floats) -> Floats:
    """Return the mean square (3,) of the change from window to window of the product of gains (3, 3) and reference."""
    changes = joint.changes[np.ix_(AXES + 3, AXES + 3)]
    return np.asarray(np.einsum("oa,ab,ob->o", gains, changes, gains))


@once_by_sensor
def residual(cross: Cross, sensor: str) -> Floats:
    """Return the log of the variance (3,) that the reference does not explain for any delay."""
    joint = _joint_moments(cross, sensor)
    return NOTHING if joint is None else log(_residual_variance(joint, AXES + 3))


def coupling(cross: Cross, sensor: str) -> Floats:
    """Return the log of the ratio of that variance to the residual variance with further explaining columns: products
    of angular rates and angular accelerations for an accelerometer, the mean specific force for a gyroscope.
    """
    joint = _joint_moments(cross, sensor)
    if joint is None or joint.moments.shape[0] == 6:
        return NOTHING
    everything = np.arange(3, joint.moments.shape[0])
    return np.asarray(residual(cross, sensor) - log(_residual_variance(joint, everything)))


def square(cross: Cross, sensor: str) -> Floats:
    """Return the artanh (3,) of the partial correlation of a gyroscope's readings with the square of the rate along
    each axis, given the reference.
    """
    return _bend(cross, sensor, [cross.kinematic.start + at for at in SQUARES])


def cube(cross: Cross, sensor: str) -> Floats:
    """Return the same as `square` for the cube of the rate."""
    return _bend(cross, sensor, list(range(cross.cubes.start, cross.cubes.stop)))


def _bend(cross: Cross, sensor: str, columns: Sequence[int]) -> Floats:
    """Return the artanh (3,) of the partial correlation of each axis with the one of three columns that belongs to the
    nearest box axis; nan for an axis along which the box hardly moves, and for sensors other than gyroscopes.
    """
    header, reference = cross.header(sensor), cross.reference(sensor)
    if header.quantity != "angular_rate" or reference is None or not cross.windows:
        return NOTHING
    every = np.eye(cross.fast.shape[0])
    nearest = np.abs(np.array(header.orientation)).argmax(axis=0)
    weights = np.concatenate([every[cross.columns(sensor)], reference, every[np.array(columns)[nearest]]])
    moments = weights @ cross.fast @ weights.T
    reference_moments = moments[_REFERENCE, _REFERENCE]
    remaining = (
        moments
        - moments[:, _REFERENCE] @ np.linalg.pinv(reference_moments, rcond=1e-9, hermitian=True) @ moments[_REFERENCE]
    )
    sizes = np.diag(remaining)[AXES] * np.diag(remaining)[_BENDING]
    products, motion = remaining[AXES, _BENDING], np.diag(reference_moments)
    shows = (sizes > 0) & (motion > _MOVES * motion.mean())
    bend = np.divide(products, np.sqrt(np.maximum(sizes, 0.0)), out=NOTHING.copy(), where=shows)
    return fisher_z(bend.clip(-_LARGEST_BEND, _LARGEST_BEND))


class _JointMoments(NamedTuple):
    """Moments of the sensor's axes, of the reference's axes, and of further explaining columns: `moments` (the `fast`
    ones), `turning` and `changes` (q, q) as in `Cross`.
    """

    moments: Floats
    turning: Floats
    changes: Floats


@once_by_sensor
def _joint_moments(cross: Cross, sensor: str) -> _JointMoments | None:
    """Return the joint moments of a sensor; None without a reference, or without windows."""
    reference = cross.reference(sensor)
    if reference is None or not cross.windows:
        return None
    header = cross.header(sensor)
    sensor_rows = np.zeros((3, cross.fast.shape[0]))
    sensor_rows[:, cross.columns(sensor)] = np.eye(3)
    turn = np.array(header.orientation).T
    more = [reference]
    if header.quantity == "specific_force":
        more.append(np.eye(cross.fast.shape[0])[cross.kinematic])
    else:
        feel = [item.name for item in cross.sensors if item.quantity == "specific_force"]
        more += [turn @ cross.mean_box(feel)] if feel else []
    weights = np.concatenate([sensor_rows, *more])
    joint = _JointMoments(*(weights @ moments @ weights.T for moments in (cross.fast, cross.turning, cross.changes)))
    if not cross.others(sensor, family=False):  # the mean of other sensors is regularised by its own noise
        joint.moments[AXES + 3, AXES + 3] += _STILL * np.diag(joint.moments)[AXES + 3].mean()
    return joint


def _separate_gains(cross: Cross, sensor: str) -> Floats:
    """Return the gains (3, 3); nan if the reference is a noisy mean of others and the motion does not determine the
    gains to all three axes.
    """
    joint = _joint_moments(cross, sensor)
    if joint is None or not cross.others(sensor, family=False):
        return _gains(cross, sensor)
    smallest, _, largest = np.linalg.eigvalsh(joint.moments[np.ix_(AXES + 3, AXES + 3)])
    return _gains(cross, sensor) if smallest > _TURNS_ABOUT_ALL * largest else np.full((3, 3), np.nan)


def joint_gains(crosses: Sequence[Cross], sensor: str) -> Floats:
    """Return the response (3, 3) of the sensor's axes (rows) to the reference's (columns) over several phases together.
    Turns about single axes determine it if they are about different axes; nan if the motion does not determine it.
    """
    moments = np.zeros((6, 6))
    for cross in crosses:
        joint = _joint_moments(cross, sensor) if sensor in {item.name for item in cross.sensors} else None
        if joint is not None:
            moments += cross.windows * joint.moments[:6, :6]
    smallest, _, largest = np.linalg.eigvalsh(moments[3:, 3:])
    if not smallest > _TURNS_ABOUT_ALL * largest:
        return np.full((3, 3), np.nan)
    return _coefficients(moments, AXES, AXES + 3).T


@once_by_sensor
def _gains(cross: Cross, sensor: str) -> Floats:
    """Return the response (3, 3) of the sensor's axes (rows) to the reference's (columns)."""
    joint = _joint_moments(cross, sensor)
    return np.full((3, 3), np.nan) if joint is None else _coefficients(joint.moments, AXES, AXES + 3).T


def _coefficients(moments: Floats, of: np.ndarray, by: np.ndarray) -> Floats:
    """Return the least-squares coefficients (b, o) of columns `of` (o,) in terms of columns `by` (b,)."""
    size = np.sqrt(np.diag(moments)[by])
    size = np.where(size > 0, size, 1.0)
    scaled = moments[np.ix_(by, by)] / size[:, None] / size
    return np.asarray(np.linalg.lstsq(scaled, moments[np.ix_(by, of)] / size[:, None], rcond=1e-12)[0] / size[:, None])


def _residual_variance(joint: _JointMoments, by: np.ndarray) -> Floats:
    """Return the variances (3,) of the sensor's axes that neither the columns `by` nor the changes of the reference
    explain.
    """
    moments, reference = joint.moments, AXES + 3
    coefficients = _coefficients(moments, AXES, by)
    variance = np.asarray(np.diag(moments)[AXES] - np.einsum("bo,bo->o", coefficients, moments[np.ix_(by, AXES)]))
    lagging = joint.turning[np.ix_(AXES, reference)] - coefficients.T @ joint.turning[np.ix_(by, reference)]
    changes = joint.changes[np.ix_(reference, reference)]
    if not np.isfinite(changes).all():
        return variance
    delayed = np.einsum("or,rs,os->o", lagging, np.linalg.pinv(changes, hermitian=True), lagging)
    return np.asarray(np.maximum(variance - delayed, _ENDS * variance))


_CROSS = ("misalignment", "axis_error", "channel_swap")
_GAIN = ("scale", "axis_error", "range_reset")
_BEND = "artanh of the correlation with the {} of the rate along the axis, beyond what the others read"

_OF_A_SLIP = 0.03
"""Correlation with a power of the rate that is caused by a delay that varies as the polls slip against the data clock.
"""

_OF_GAINS, _OF_VARIANCES, _OF_WINDOWS = 0.25, 4.0, 0.3
"""Least meaningful differences in a motion with changes that the rows do not resolve: of gains and correlations, of
logs of variances, and of delays as a share of a window. In recordings of healthy sensors that are turned by hand, swung
or carried they differ from simulations of the estimated motion by up to 0.2, 1.9 and 0.16 of a window of five rows. A
score that varies by less than the least difference is enlarged up to three times, by `pairs.LEAST` and the least scale
of a tail.
"""

_OF_A_CONVERSION_S = 1e-4
"""Delay between the axes of chips that convert them one after the other (BMA-94); a row has a single time for all axes.
"""


_probe = partial(CrossProbe, "motion", in_motion=True, unresolved=lambda _: _OF_GAINS)

PROBES: Probes = {
    "motion_gain": _probe("share of motion along the axis", _GAIN, response, partial(gain, 0)),
    "motion_along": _probe("share of motion along the axis, by that motion alone", _GAIN, response, along),
    "motion_next": _probe("share of motion along the next axis", _CROSS, response, partial(gain, 1)),
    "motion_after": _probe("share of motion along the axis after the next", _CROSS, response, partial(gain, 2)),
    "motion_across": _probe("share of a motion across the axis", _CROSS, response, across),
    "motion_delay": _probe(
        "delay behind the others",
        ("skew", "clock_error", "stale_samples", "own_clock"),
        response,
        delay,
        unit="s",
        resolution=_OF_A_CONVERSION_S,
        uncertainty=uncertainty_of_delay,
        unresolved=lambda cross: _OF_WINDOWS * cross.window_s,
    ),
    "motion_delay_rate": ArrayProbe(
        "motion",
        "change per second of the delay behind the track",
        ("clock_error",),
        response,
        delay_rate,
        lambda _, __: _OF_CRYSTALS,
        in_motion=True,
        unit="s/s",
    ),
    "motion_residual": _probe(
        "log of the variance that the others don't explain",
        ("jitter", "size_effect", "nonlinearity", "skew", "saturation", "own_clock"),
        VARIANCE,
        residual,
        unit="log {u}^2",
        unresolved=lambda _: _OF_VARIANCES,
    ),
    "motion_coupling": _probe(
        "log of how much of it rotation or force explains",
        ("size_effect", "g_sensitivity"),
        VARIANCE,
        coupling,
        unresolved=lambda _: _OF_VARIANCES,
    ),
    "motion_square": _probe(_BEND.format("square"), ("nonlinearity",), CORRELATION, square, resolution=_OF_A_SLIP),
    "motion_cube": _probe(_BEND.format("cube"), ("nonlinearity",), CORRELATION, cube, resolution=_OF_A_SLIP),
}
