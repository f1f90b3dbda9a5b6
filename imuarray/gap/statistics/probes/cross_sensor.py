"""Probes of errors that sensors have in common: along the chips' own axes if the design of the chip causes them, along
the box's axes if motion does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.axes import Matrix
from imuarray.gap.statistics.campaign import LogSummary
from imuarray.gap.statistics.cross import Cross
from imuarray.gap.statistics.margins import CORRELATION, LEVEL
from imuarray.gap.statistics.probes.level import least_level, level
from imuarray.gap.statistics.probes.probe import NOTHING, ArrayProbe, CrossProbe, Probes, fisher_z, once
from imuarray.log.format import SensorHeader

AXES = np.arange(3)

Moments = Callable[[Cross], Floats]


@once
def _slow(cross: Cross) -> Floats:
    """Return (p, p) Fisher's z of correlations of the segments' means, along the sensors' axes."""
    return _correlations(cross.slow_covariance)


@once
def _fast(cross: Cross) -> Floats:
    """Return (p, p) Fisher's z of correlations within segments, along the sensors' axes."""
    return _correlations(cross.fast)


@once
def _slow_in_box(cross: Cross) -> Floats:
    return _correlations(_in_box(cross, cross.slow_covariance))


@once
def _fast_in_box(cross: Cross) -> Floats:
    return _correlations(_in_box(cross, cross.fast))


def own_axes(correlations: Moments, cross: Cross, sensor: str) -> Floats:
    """Return the mean Fisher's z (3,) of each axis with the same axis of the other sensors of this chip type."""
    return _mean_z(correlations(cross), cross, sensor, cross.others(sensor, family=True))


def box_axes(correlations: Moments, cross: Cross, sensor: str) -> Floats:
    """Return the mean Fisher's z (3,) along each box axis with the other sensors of this chip type, in the order of the
    sensor's axes that lie along the box axes.
    """
    return _as_own(cross, sensor, _mean_z(correlations(cross), cross, sensor, cross.others(sensor, family=True)))


def others(correlations: Moments, cross: Cross, sensor: str) -> Floats:
    """Return the same as `box_axes`, with the sensors of other chip types that measure the same quantity."""
    family = set(cross.others(sensor, family=True))
    strangers = [name for name in cross.others(sensor, family=False) if name not in family]
    return _as_own(cross, sensor, _mean_z(correlations(cross), cross, sensor, strangers))


def between_axes(correlations: Moments, cross: Cross, sensor: str) -> Floats:
    """Return Fisher's z (3,) of each axis with the next axis of the same sensor."""
    begin = cross.columns(sensor).start
    return np.asarray(correlations(cross)[begin + AXES, begin + (AXES + 1) % 3])


def level_apart(log: LogSummary, sensor: str) -> Floats:
    """Return the mean reading (3,) at rest in the log less the mean of those of the other sensors of this chip type,
    each along its own axes.
    """
    levels = _levels(log)
    header, sensor_level = levels[sensor]
    others = [
        other_level
        for name, (other, other_level) in levels.items()
        if name != sensor and (other.chip, other.quantity) == (header.chip, header.quantity)
    ]
    return sensor_level - np.mean(others, axis=0) if others else NOTHING


def least_level_apart(log: LogSummary, sensor: str) -> float:
    """Return the least meaningful difference from the other sensors, in the sensor's unit: that of its own mean. An
    attitude that is estimated from two opposed chips absorbs the difference of both.
    """
    return min(map(least_level, log.still(sensor)), default=0.0)


@once
def _levels(log: LogSummary) -> dict[str, tuple[SensorHeader, Floats]]:
    """Return the header and the level of every sensor with readings at rest."""
    names = dict.fromkeys(sensor for phase in log.phases for sensor in phase.sensors)
    still = {name: log.still(name) for name in names}
    return {name: (phases[0].header, level(phases)) for name, phases in still.items() if phases}


def _mean_z(correlation: Floats, cross: Cross, sensor: str, partners: Sequence[str]) -> Floats:
    """Return the correlation (3,) of each axis with the same column of the partners, averaged over the partners."""
    if not partners:
        return NOTHING
    columns = np.array([[cross.columns(partner).start] for partner in partners]) + AXES
    return np.asarray(correlation[cross.columns(sensor).start + AXES, columns].sum(axis=0) / len(partners))


def _as_own(cross: Cross, sensor: str, box: Floats) -> Floats:
    """Return (3,) the values of box axes in the order of the sensor's axes that lie along them."""
    return np.asarray(box[_nearest(cross.header(sensor).orientation)])


@lru_cache(maxsize=64)
def _nearest(orientation: Matrix) -> Indices:
    """Return (3,) the number of the box axis along which each axis of the sensor lies."""
    return np.asarray(np.abs(np.array(orientation)).argmax(axis=0))


def _in_box(cross: Cross, moments: Floats) -> Floats:
    """Return (p, p) the moments with every sensor's axes rotated into those of the box."""
    turn = np.eye(len(moments))
    for sensor in cross.sensors:
        turn[cross.columns(sensor.name), cross.columns(sensor.name)] = sensor.orientation
    return np.asarray(turn @ moments @ turn.T)


def _correlations(moments: Floats) -> Floats:
    """Return Fisher's z of the correlations; nan for columns without variance."""
    size = np.sqrt(np.diag(moments))
    size = np.where(size > 0, size, np.nan)
    return fisher_z(moments / size[:, None] / size)


def _probe(
    statistic: Callable[[Moments, Cross, str], Floats], correlations: Moments, about: str, *moved_by: str
) -> CrossProbe:
    pace = "slow" if correlations in (_slow, _slow_in_box) else "fast"
    return CrossProbe(
        "cross_sensor",
        f"{about}, {pace}",
        moved_by,
        CORRELATION,
        lambda cross, sensor: statistic(correlations, cross, sensor),
    )


_ALIKE = "correlation with units of one chip along the chips' axes"
_BOX = "correlation with units of one chip along the box's axes"
_NEXT = "correlation with the next axis of the sensor"

PROBES: Probes = {
    "slow_own_axes": _probe(own_axes, _slow, _ALIKE, "common_mode", "thermal_bias", "channel_swap"),
    "slow_box_axes": _probe(box_axes, _slow_in_box, _BOX, "common_mode", "channel_swap"),
    "slow_between_axes": _probe(between_axes, _slow, _NEXT, "thermal_bias", "common_mode"),
    "fast_own_axes": _probe(own_axes, _fast, _ALIKE, "common_mode", "channel_swap", "tone"),
    "fast_box_axes": _probe(box_axes, _fast_in_box, _BOX, "common_mode", "channel_swap", "tone"),
    "fast_between_axes": _probe(between_axes, _fast, _NEXT, "tone", "glitches"),
    "fast_other_chips": _probe(others, _fast_in_box, "correlation with other chips along the box's axes", "tone"),
    "level_apart": ArrayProbe(
        "cross_sensor",
        "mean reading of the whole log less that of the other units of the chip",
        ("turn_on_bias", "bistable_bias", "range_reset"),
        LEVEL,
        level_apart,
        unit="{u}",
        resolution=least_level_apart,
    ),
}
