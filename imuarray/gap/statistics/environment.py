"""What the box really felt told from what its sensors add to it: a table that tilts, a vibration.

Sensors of different chips have nothing in common but the box, and those of one chip at most an error of their design,
along their own axes. So sensors make groups for each axis of the box: the same chip with the same axis of its own, the
same way round. Whatever errors they have, group means turned into the box are independent, or (a chip's own error,
mounted either way) opposed; what all groups show alike is a stimulus.

Two paces are looked at. Slow means are taken apart into waves over the phase, of which those that stand out of the
noise are kept: in each, the groups' amplitudes are a vector that without a stimulus points anywhere, however large it
is, so the square of its cosine with (1, ..., 1) has a beta distribution, whatever the spectrum of the wander. What is
faster has correlations, whose Fisher's z are normal; of one chip alone they say nothing, since a line of its design is
in all of its units, in some of them by chance in step.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy.fft import dct
from scipy.stats import beta, chi2, norm

from imuarray.arrays import Floats
from imuarray.gap.statistics.campaign import Campaign, PhaseSummary
from imuarray.gap.statistics.cross import Cross
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import SensorHeader
from imuarray.units import INERTIAL

Pace = Literal["slow", "fast"]

LEVEL = 0.01
"""Share of campaigns without a stimulus in which one is found, all phases, axes and paces together (Bonferroni)."""

ALIKE = 1.5
"""Amplitudes within that factor are alike: chips differ in bandwidth and scale."""

OF_WANDER = 0.5
"""Share of the slow variance that is common, at least."""

_STANDS_OUT = 6.0
"""Power of a wave over the median of all that is more than white noise, which has it once in sixty (two groups)."""

_LEAST_SEGMENTS = 16
_TINY = 1e-300
_STEADY_DEGC = 1e-6


class Group(NamedTuple):
    """Sensors of one chip whose own axis `axis` points along the box axis, `sign` 1.0, or against it, -1.0."""

    sensors: tuple[str, ...]
    axis: int
    sign: float


@dataclass(frozen=True)
class SharedSignal:
    """What all groups of sensors of one quantity share along a box axis ("X", "Y", "Z") in a phase of log number `log`,
    without the errors of their chips. `correlation` between two groups (slow: of what stands out of the noise), `p` of
    its coming by chance, not corrected for the many that are looked at.
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
    """What the box itself felt in the phases at rest, the least probable by chance first.

    What follows the reference's temperature, or the chips' thermometers where it tells nothing, is no stimulus: each
    sensor has a slope of its own. An error of all sensors that comes of something else in common, such as the supply,
    can be taken for one if it happens to be as large, and to have the same sign, along the box.
    """
    looked = [
        one
        for log, summary in enumerate(campaign.logs)
        for part in summary.phases
        if part.is_still and part.cross is not None
        for one in _in_phase(log, part, part.cross)
    ]
    found = [one for one, matters in looked if matters and one.p * len(looked) <= level]
    return tuple(sorted(found, key=lambda one: one.p))


def groups_of(sensors: Sequence[SensorHeader], quantity: str, axis: int) -> tuple[Group, ...]:
    """The groups of sensors along a box axis (0, 1, 2)."""
    found: dict[tuple[str, int, float], list[str]] = {}
    for sensor in sensors:
        if sensor.quantity == quantity:
            row = np.array(sensor.orientation)[axis]
            own = int(np.abs(row).argmax())
            found.setdefault((sensor.chip, own, float(row[own])), []).append(sensor.name)
    return tuple(Group(tuple(names), own, sign) for (_, own, sign), names in found.items())


def slow_test(means: Floats) -> tuple[float, float]:
    """Of group means (s, c) over time: the correlation between groups of what is not noise, and its p.

    Wander and drift are tested apart, p is twice the smaller one: what a straight line, a parabola and a logarithm of
    time leave, by `wander_test`; and these together as one vector of drifts, since every sensor that warms up or creeps
    has the same course, and all that is left of it by chance is its size.
    """
    time = (np.arange(len(means)) + 0.5) / len(means)
    smooth = np.stack([np.ones_like(time), time, time**2, np.log(1 + len(means) * time)], axis=1)
    basis = np.linalg.qr(smooth)[0]
    drift = basis[:, 1:].T @ means
    tests = (wander_test(means - basis @ (basis.T @ means)), _directed(drift))
    correlation, p = min(tests, key=lambda test: test[1])
    return correlation, min(2 * p, 1.0)


def wander_test(means: Floats) -> tuple[float, float]:
    """Of group means (s, c) without drift: the correlation between groups of the waves that stand out of the noise, and
    its p. (0, 1) where none does.

    The p of each wave is uniform if the groups wander as much; if they don't, small ones are rarer. They are joined
    by Fisher's sum of logs.
    """
    waves = dct(means - means.mean(axis=0), type=2, norm="ortho", axis=0)[1:]
    power = (waves**2).sum(axis=1)
    chosen = power > _STANDS_OUT * np.median(power[len(power) // 2 :])
    if not chosen.any():
        return 0.0, 1.0
    chances = [_directed(wave[None])[1] for wave in waves[chosen]]
    p = chi2.sf(-2 * np.log(np.maximum(chances, _TINY)).sum(), 2 * len(chances))
    return _directed(waves[chosen])[0], float(p)


def _directed(vectors: Floats) -> tuple[float, float]:
    """Of vectors (k, c), groups' amplitudes: the correlation between groups, and how often a single vector that points
    anywhere points so nearly along (1, ..., 1) or against it.
    """
    groups = vectors.shape[1]
    power = float((vectors**2).sum())
    share = float((vectors.sum(axis=1) ** 2).sum()) / (groups * power) if power > 0 else 1 / groups
    return (groups * share - 1) / (groups - 1), float(beta.sf(share, 0.5, (groups - 1) / 2))


def fast_test(covariance: Floats, rows: Floats) -> tuple[float, float]:
    """Of the covariance (c, c) of group means and the effective number of `rows` (c, c) of each pair: the mean
    correlation and its p. Covariances that are not alike, and so no common stimulus, have p = 1.
    """
    size = np.sqrt(np.diag(covariance))
    first, second = np.triu_indices(len(covariance), 1)
    pairs, rows = covariance[first, second], np.maximum(rows[first, second], 4.0)
    scale = size[first] * size[second]
    correlation = np.clip(pairs / scale, -1 + 1e-12, 1 - 1e-12)
    weight = rows - 3
    z = float((weight * np.arctanh(correlation)).sum() / np.sqrt(weight.sum()))
    mean = float(np.average(pairs, weights=weight / scale**2))
    unlike = np.abs(pairs - mean) > (ALIKE - 1) * ALIKE * mean + 3 * scale / np.sqrt(weight)
    return float(correlation.mean()), 1.0 if mean <= 0 or unlike.any() else float(norm.sf(z))


def _in_phase(log: int, part: PhaseSummary, cross: Cross) -> Iterator[tuple[SharedSignal, bool]]:
    """Everything that is looked at in a phase, and whether it is large enough to be what wanders."""
    slow = _slow(part, cross)
    for quantity in INERTIAL:
        for axis in range(3):
            groups = groups_of(cross.sensors, quantity, axis)
            if len(groups) < 2:
                continue
            turn = _turn(cross, groups)
            names = tuple(name for group in groups for name in group.sensors)
            what = (quantity, "XYZ"[axis], names)
            if len(slow) >= _LEAST_SEGMENTS:
                correlation, p = slow_test(slow @ turn.T)
                yield SharedSignal(log, part.phase.name, "slow", *what, correlation, p), correlation > OF_WANDER
            chips = {cross.header(name).chip for name in names}
            if len(chips) > 1 and cross.windows and (np.diag(turn @ cross.fast @ turn.T) > 0).all():
                correlation, p = fast_test(turn @ cross.fast @ turn.T, _rows(cross, turn))
                yield SharedSignal(log, part.phase.name, "fast", *what, correlation, p), True


def _turn(cross: Cross, groups: Sequence[Group]) -> Floats:
    """(c, p) that makes group means in the box of the columns of a cross."""
    turn = np.zeros((len(groups), len(cross.fast)))
    for place, group in enumerate(groups):
        for name in group.sensors:
            turn[place, cross.columns(name).start + group.axis] = group.sign / len(group.sensors)
    return turn


def _rows(cross: Cross, turn: Floats) -> Floats:
    """(c, c) windows that count, since neighbours hang together: by Bartlett (1935) a pair counts 1 + 2 sum(r_k s_k)
    times less, if their correlations r_k, s_k over k windows go on through a segment as they are over two, which
    follows from the changes. White noise on top of a slow wander has that at most.
    """
    variance, changes = (np.diag(turn @ moments @ turn.T) for moments in (cross.fast, cross.changes))
    next_but_one = np.clip(1 - 2 * changes / variance, 0.0, 1.0)
    segments = np.isfinite(cross.slow).all(axis=1).sum()
    length = cross.windows / segments
    return np.asarray((cross.windows - segments) / (1 + np.outer(next_but_one, next_but_one) * (length - 1)))


def _slow(part: PhaseSummary, cross: Cross) -> Floats:
    """(s, p) segments' means without what follows the temperature."""
    means = cross.slow
    held = np.isfinite(means).all(axis=1)
    warm = _warmth(part, len(means))[held]
    design = np.concatenate([np.ones((len(warm), 1)), warm], axis=1)
    return np.asarray(means[held] - design @ np.linalg.lstsq(design, means[held], rcond=None)[0])


def _warmth(part: PhaseSummary, count: int) -> Floats:
    """(count, k) the reference's temperature and its change; of one that tells none, the chips' thermometers."""
    columns = _courses(part.sensors, "temperature_degc", count)[:1]
    if columns and count > 1:
        return np.stack([columns[0], np.gradient(columns[0])], axis=1)
    by_chip = {summary.header.chip: summary for summary in part.sensors.values()}
    columns = _courses(by_chip, "thermometer", count)
    return np.stack(columns, axis=1) if columns else np.zeros((count, 0))


def _courses(sensors: Mapping[str, Summary], name: str, count: int) -> list[Floats]:
    """Those that change, less their mean, over their range, at `count` equal parts of the phase."""
    found = []
    for summary in sensors.values():
        part, values = summary.segments, np.asarray(getattr(summary.segments, name), float)
        held = np.isfinite(part.time_s) & np.isfinite(values)
        if held.sum() > 2 and np.ptp(values[held]) > _STEADY_DEGC:
            at = np.linspace(part.time_s[held][0], part.time_s[held][-1], count)
            course = np.interp(at, part.time_s[held], values[held])
            found.append((course - course.mean()) / np.ptp(values[held]))
    return found
