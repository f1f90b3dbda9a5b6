"""Stimuli of the box itself at rest, for example a tilting table or a vibration, separated from sensor errors.

Sensors of different chip types have only the box in common, and those of one chip type at most an error of their design
along their own axes. For each axis of the box, a group consists of the sensors of one chip type that have the same own
axis along it, in the same direction. Group means rotated into the box's axes then have independent errors, or opposed
ones if an error of one design is mounted in both directions; a signal that all groups share is a stimulus.

Slow and fast signals are tested separately. Slow means are decomposed into cosine waves over the phase, and the waves
above the noise are kept. The amplitudes of the groups in one wave are a vector. Without a stimulus it has a random
direction, so that the square of its cosine with (1, ..., 1) has a beta distribution whatever the spectrum of the
wander. Fast signals are tested by correlations, whose Fisher's z are normal. Sensors of only one chip type are not
tested for fast signals, since a spectral line of the design is present in all of its units and is in phase in some of
them by chance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy.fft import dct
from scipy.special import betaincc, chdtrc, ndtr  # distributions without the weight of scipy.stats

from imuarray.arrays import Floats
from imuarray.gap.statistics.campaign import Campaign, PhaseSummary
from imuarray.gap.statistics.cross import Cross
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import SensorHeader
from imuarray.units import INERTIAL

Pace = Literal["slow", "fast"]

LEVEL = 0.01
"""Significance level: share of campaigns without a stimulus in which one is reported, over all phases, axes and paces
(Bonferroni correction).
"""

AMPLITUDE_RATIO = 1.5
"""Largest ratio between the amplitudes of one stimulus in two groups, since chips differ in bandwidth and scale."""

LEAST_COMMON_SHARE = 0.5
"""Least correlation between groups, as a share of the slow variance, at which a slow signal is reported."""

_STANDS_OUT = 6.0
"""Ratio of the power of a wave to the median power from which on the wave is considered above white noise. With two
groups one wave of white noise in sixty exceeds it.
"""

_LEAST_SEGMENTS = 16
_TINY = 1e-300
_STEADY_DEGC = 1e-6


class Group(NamedTuple):
    """Sensors of one chip type whose own axis `axis` points along the box axis (`sign` 1.0) or against it (-1.0)."""

    sensors: tuple[str, ...]
    axis: int
    sign: float


@dataclass(frozen=True)
class SharedSignal:
    """Signal that all groups of sensors of one quantity share along a box axis ("X", "Y", "Z") in a phase of log number
    `log`.

    `correlation`: mean correlation between two groups (slow: of the waves above the noise). `p`: probability that it
    occurs by chance, not corrected for the number of tests.
    """

    log: int
    phase: str
    pace: Pace
    quantity: str
    axis: str
    sensors: tuple[str, ...]
    correlation: float
    p: float


def environment_of(campaign: Campaign, level: float = LEVEL) -> tuple[SharedSignal, ...]:
    """Detect stimuli of the box in the phases at rest, in ascending order of p.

    Signals that follow the reference temperature, or the chips' thermometers if there is no reference, are removed from
    slow signals, since each sensor has its own temperature coefficient. An error with another common cause, for example
    the supply, can be mistaken for a stimulus if it has the same size and sign along the box in all sensors.
    """
    tests = [
        test
        for log, summary in enumerate(campaign.logs)
        for part in summary.phases
        if part.is_still and part.cross is not None
        for test in _in_phase(log, part, part.cross)
    ]
    significant = [signal for signal, is_large in tests if is_large and signal.p * len(tests) <= level]
    return tuple(sorted(significant, key=lambda signal: signal.p))


def groups_of(sensors: Sequence[SensorHeader], quantity: str, axis: int) -> tuple[Group, ...]:
    """Return the groups of sensors along a box axis (0, 1, 2)."""
    names_of_group: dict[tuple[str, int, float], list[str]] = {}
    for sensor in sensors:
        if sensor.quantity == quantity:
            row = np.array(sensor.orientation)[axis]
            sensor_axis = int(np.abs(row).argmax())
            names_of_group.setdefault((sensor.chip, sensor_axis, float(row[sensor_axis])), []).append(sensor.name)
    return tuple(Group(tuple(names), sensor_axis, sign) for (_, sensor_axis, sign), names in names_of_group.items())


def slow_test(means: Floats) -> tuple[float, float]:
    """Return the correlation between groups of the signal above the noise, and its p, from group means (s, c) over
    time.

    Wander and drift are tested separately; p is twice the smaller one. Drift is the fit of a straight line, a parabola
    and a logarithm of time; the three are tested as one vector, since all sensors that warm up or creep have the same
    shape and only their sizes are random. Wander is the residual of this fit, tested by `wander_test`.
    """
    time = (np.arange(len(means)) + 0.5) / len(means)
    smooth = np.stack([np.ones_like(time), time, time**2, np.log(1 + len(means) * time)], axis=1)
    basis = np.linalg.qr(smooth)[0]
    drift = basis[:, 1:].T @ means
    tests = (wander_test(means - basis @ (basis.T @ means)), _alignment_test(drift))
    correlation, p = min(tests, key=lambda test: test[1])
    return correlation, min(2 * p, 1.0)


def wander_test(means: Floats) -> tuple[float, float]:
    """Return the correlation between groups of the waves above the noise, and its p, from group means (s, c) without
    drift; (0, 1) if no wave is above the noise.

    The p of each wave is uniformly distributed if all groups wander equally; otherwise small values are rarer. They are
    combined by Fisher's method (sum of logs).
    """
    waves = dct(means - means.mean(axis=0), type=2, norm="ortho", axis=0)[1:]
    power = (waves**2).sum(axis=1)
    chosen = power > _STANDS_OUT * np.median(power[len(power) // 2 :])
    if not chosen.any():
        return 0.0, 1.0
    chances = [_alignment_test(wave[None])[1] for wave in waves[chosen]]
    p = chdtrc(2 * len(chances), -2 * np.log(np.maximum(chances, _TINY)).sum())
    return _alignment_test(waves[chosen])[0], float(p)


def _alignment_test(vectors: Floats) -> tuple[float, float]:
    """Return the correlation between groups from their amplitudes (k, c), and the probability that a single vector of
    random direction is at least as nearly parallel to (1, ..., 1).
    """
    groups = vectors.shape[1]
    power = float((vectors**2).sum())
    share = float((vectors.sum(axis=1) ** 2).sum()) / (groups * power) if power > 0 else 1 / groups
    return (groups * share - 1) / (groups - 1), float(betaincc(0.5, (groups - 1) / 2, min(share, 1.0)))


def fast_test(covariance: Floats, rows: Floats) -> tuple[float, float]:
    """Return the mean correlation of the groups and its p, from the covariance (c, c) of group means and the effective
    number of `rows` (c, c) of each pair.

    p is 1 if the mean covariance is not positive, or if the covariances of pairs differ by more than `AMPLITUDE_RATIO`
    and noise allow: a common stimulus has nearly the same amplitude in all groups.
    """
    size = np.sqrt(np.diag(covariance))
    first, second = np.triu_indices(len(covariance), 1)
    pairs, rows = covariance[first, second], np.maximum(rows[first, second], 4.0)
    scale = size[first] * size[second]
    correlation = np.clip(pairs / scale, -1 + 1e-12, 1 - 1e-12)
    weight = rows - 3
    z = float((weight * np.arctanh(correlation)).sum() / np.sqrt(weight.sum()))
    mean = float(np.average(pairs, weights=weight / scale**2))
    without_duplicates = np.abs(pairs - mean) > (AMPLITUDE_RATIO - 1) * AMPLITUDE_RATIO * mean + 3 * scale / np.sqrt(
        weight
    )
    return float(correlation.mean()), 1.0 if mean <= 0 or without_duplicates.any() else float(ndtr(-z))


def _in_phase(log: int, part: PhaseSummary, cross: Cross) -> Iterator[tuple[SharedSignal, bool]]:
    """Yield the signals of all tests of a phase, and for each whether it is large enough to be reported."""
    slow = _slow(part, cross)
    for quantity in INERTIAL:
        for axis in range(3):
            groups = groups_of(cross.sensors, quantity, axis)
            if len(groups) < 2:
                continue
            turn = _group_weights(cross, groups)
            names = tuple(name for group in groups for name in group.sensors)
            what = (quantity, "XYZ"[axis], names)
            if len(slow) >= _LEAST_SEGMENTS:
                correlation, p = slow_test(slow @ turn.T)
                yield (
                    SharedSignal(log, part.phase.name, "slow", *what, correlation, p),
                    correlation > LEAST_COMMON_SHARE,
                )
            chips = {cross.header(name).chip for name in names}
            if len(chips) > 1 and cross.windows and (np.diag(turn @ cross.fast @ turn.T) > 0).all():
                correlation, p = fast_test(turn @ cross.fast @ turn.T, _rows(cross, turn))
                yield SharedSignal(log, part.phase.name, "fast", *what, correlation, p), True


def _group_weights(cross: Cross, groups: Sequence[Group]) -> Floats:
    """Return the matrix (c, p) that converts the columns of a `Cross` to group means along the box axis."""
    weights = np.zeros((len(groups), len(cross.fast)))
    for place, group in enumerate(groups):
        for name in group.sensors:
            weights[place, cross.columns(name).start + group.axis] = group.sign / len(group.sensors)
    return weights


def _rows(cross: Cross, turn: Floats) -> Floats:
    """Return the effective number of windows (c, c) for each pair of groups, which is reduced because neighbouring
    windows are correlated.

    By Bartlett (1935) the number for a pair is divided by 1 + 2 sum(r_k s_k), where r_k, s_k are the autocorrelations
    at a lag of k windows. They are assumed to keep the value at two windows, which follows from the changes, through
    the whole segment. This is the largest divisor for white noise on a slow wander.
    """
    variance, changes = (np.diag(turn @ moments @ turn.T) for moments in (cross.fast, cross.changes))
    next_but_one = np.clip(1 - 2 * changes / variance, 0.0, 1.0)
    segments = np.isfinite(cross.slow).all(axis=1).sum()
    length = cross.windows / segments
    return np.asarray((cross.windows - segments) / (1 + np.outer(next_but_one, next_but_one) * (length - 1)))


def _slow(part: PhaseSummary, cross: Cross) -> Floats:
    """Return the segments' means (s, p) less their regression on the temperature."""
    means = cross.slow
    is_known = np.isfinite(means).all(axis=1)
    warm = _temperatures(part, len(means))[is_known]
    design = np.concatenate([np.ones((len(warm), 1)), warm], axis=1)
    return np.asarray(means[is_known] - design @ np.linalg.lstsq(design, means[is_known], rcond=None)[0])


def _temperatures(part: PhaseSummary, count: int) -> Floats:
    """Return normalised temperatures (count, k): the reference and its derivative, or the chips' thermometers if the
    reference is constant or missing.
    """
    columns = _normalise(part.sensors, "temperature_degc", count)[:1]
    if columns and count > 1:
        return np.stack([columns[0], np.gradient(columns[0])], axis=1)
    by_chip = {summary.header.chip: summary for summary in part.sensors.values()}
    columns = _normalise(by_chip, "thermometer", count)
    return np.stack(columns, axis=1) if columns else np.zeros((count, 0))


def _normalise(sensors: Mapping[str, Summary], name: str, count: int) -> list[Floats]:
    """Return the sensors' segment values `name` that vary, at `count` equally spaced times of the phase, less their
    mean and divided by their range; an empty list if `count` is 0.
    """
    courses: list[Floats] = []
    for summary in sensors.values() if count else ():
        part, values = summary.segments, np.asarray(getattr(summary.segments, name), float)
        is_known = np.isfinite(part.time_s) & np.isfinite(values)
        if is_known.sum() > 2 and np.ptp(values[is_known]) > _STEADY_DEGC:
            at = np.linspace(part.time_s[is_known][0], part.time_s[is_known][-1], count)
            course = np.interp(at, part.time_s[is_known], values[is_known])
            courses.append((course - course.mean()) / np.ptp(values[is_known]))
    return courses
