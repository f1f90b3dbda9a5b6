"""What a sensor shares with others: along the chips' own axes if it comes of their design, along the box's if it is
motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from imuarray.gap.cross import Cross
from imuarray.gap.probes.probe import NOTHING, CrossProbe, Floats, fisher_z

AXES = np.arange(3)

Moments = Callable[[Cross], Floats]


def _slow(cross: Cross) -> Floats:
    return cross.slow_covariance


def _fast(cross: Cross) -> Floats:
    return cross.fast


def own_axes(moments: Moments, cross: Cross, sensor: str) -> Floats:
    """Mean Fisher's z with the same axis of the other sensors of this chip."""
    return _mean_z(moments(cross), cross, sensor, cross.others(sensor, family=True), in_box=False)


def box_axes(moments: Moments, cross: Cross, sensor: str) -> Floats:
    """Mean Fisher's z, box axis by box axis, with the other sensors of this chip; told for the sensor's axis that lies
    along the box axis.
    """
    return _mean_z(moments(cross), cross, sensor, cross.others(sensor, family=True), in_box=True)


def others(moments: Moments, cross: Cross, sensor: str) -> Floats:
    """The same with the sensors of other chips that measure the same."""
    family = set(cross.others(sensor, family=True))
    strangers = [name for name in cross.others(sensor, family=False) if name not in family]
    return _mean_z(moments(cross), cross, sensor, strangers, in_box=True)


def between_axes(moments: Moments, cross: Cross, sensor: str) -> Floats:
    """Fisher's z of each axis with the next one of the same sensor."""
    own = cross.columns(sensor)
    correlation = _normalised(moments(cross)[own, own])
    return fisher_z(correlation[AXES, (AXES + 1) % 3])


def _mean_z(moments: Floats, cross: Cross, sensor: str, partners: Sequence[str], *, in_box: bool) -> Floats:
    if not partners:
        return NOTHING
    return np.asarray(np.mean([_z(moments, cross, sensor, partner, in_box) for partner in partners], axis=0))


def _z(moments: Floats, cross: Cross, sensor: str, partner: str, in_box: bool) -> Floats:
    """(3,) of a pair, in the order of the first one's axes."""
    places = np.concatenate([np.r_[cross.columns(name)] for name in (sensor, partner)])
    pair = moments[np.ix_(places, places)]
    if not in_box:
        return fisher_z(_normalised(pair)[AXES, AXES + 3])
    first, second = (np.array(cross.header(name).orientation) for name in (sensor, partner))
    turn = np.block([[first, np.zeros((3, 3))], [np.zeros((3, 3)), second]])
    z = fisher_z(_normalised(turn @ pair @ turn.T)[AXES, AXES + 3])
    return np.asarray(z[np.abs(first).argmax(axis=0)])


def _normalised(moments: Floats) -> Floats:
    """Correlations; nan of what never changes."""
    size = np.sqrt(np.diag(moments))
    size = np.where(size > 0, size, np.nan)
    return np.asarray(moments / size[:, None] / size)


def _probe(statistic: Callable[[Moments, Cross, str], Floats], slow: bool, about: str, *moved_by: str) -> CrossProbe:
    moments = _slow if slow else _fast
    pace = "slow" if slow else "fast"
    return CrossProbe(
        "cross_sensor", f"{about}, {pace}", "", moved_by, lambda cross, sensor: statistic(moments, cross, sensor)
    )


_ALIKE = "correlation with units of one chip along the chips' axes"
_BOX = "correlation with units of one chip along the box's axes"

SLOW_OWN = _probe(own_axes, True, _ALIKE, "common_mode", "thermal_bias", "channel_swap")
SLOW_BOX = _probe(box_axes, True, _BOX, "common_mode", "channel_swap")
FAST_OWN = _probe(own_axes, False, _ALIKE, "common_mode", "channel_swap", "tone")
FAST_BOX = _probe(box_axes, False, _BOX, "common_mode", "channel_swap", "tone")
FAST_OTHERS = _probe(others, False, "correlation with other chips along the box's axes", "tone")
FAST_BETWEEN = _probe(between_axes, False, "correlation with the next axis of the sensor", "tone", "glitches")
SLOW_BETWEEN = _probe(between_axes, True, "correlation with the next axis of the sensor", "thermal_bias", "common_mode")
