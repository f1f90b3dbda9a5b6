"""Fault hypotheses, an axis or a whole sensor for each, compared by generalised likelihood ratios; and the kinds of
faults with their characteristics: another range, stuck, biased, drifting, noisy, with glitches.

There are two tests, for every axis and for every sensor as a whole:

- mean: the window's mean has a constant error;
- energy: single readings scatter about their mean by more than their noise, with any waveform (glitches, noise, a fault
  that begins within the window, another scale).

The hypothesis with the largest gain is selected; it is isolated if no other sensor gains nearly as much. Sensors that
parity cannot separate are separated by symptoms of the single sensor (`separate_rivals`). `Baseline` measures the slow
drift of each axis since its start and detects a drift beyond its limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.calibrate.runs import Ranges
from imuarray.fuse.faults.window import (
    DELAY_S,
    DecisionWindow,
    NormalModel,
    Spaces,
    WindowResiduals,
    window_residuals,
)
from imuarray.fuse.frames import Axis
from imuarray.units import STANDARD_GRAVITY

QUIET = 0.1
"""Share of the usual mean square of changes from reading to reading below which a triad is stuck, or measures in a
wider range: chi-squared with some 20 degrees of freedom is never so small."""

_SCALE_TOLERANCE = 0.15
"""Relative tolerance of a ratio of readings by another range: each range has an offset of its own (BMA-79)."""

_NOISE_TOLERANCE = 0.35
"""Relative tolerance of a ratio of noise by another range."""

_LEAST_SIGNAL = 8.0
"""Least signal, in standard deviations of a reading, from which a ratio of readings is determined."""

_LOW, _LOW_SIGMAS = 0.4, 0.524
"""Four of ten readings are within 0.524 standard deviations of normal noise."""

_USUAL = 3.0
"""Largest scatter of these four of ten readings, relative to the usual scatter, in a window with glitches."""


@dataclass(frozen=True)
class FaultKind:
    """A kind of fault: the name of its effect, its size (see `FaultEvent.size_si`), whether it affects the whole
    sensor, and the range of a `range_reset`.
    """

    name: str
    size: float
    whole: bool = False
    range: float | None = None


@dataclass(frozen=True)
class TriadComparison:
    """One triad compared with the other sensors, for its valid readings: its `own` readings less its normal errors, and
    the `expected` readings (n, 3) along its axes; `noise` (3,) of a single reading; whether all are `stale`.
    """

    own: Floats
    expected: Floats
    noise: Floats
    quiet: float
    """Mean square of its changes over the usual one."""
    stale: bool

    @property
    def ratio(self) -> float:
        """Ratio of the triad's readings to the expected ones; NaN if the signal is too small."""
        power = float((self.expected**2).mean(axis=0).sum())
        if not power > _LEAST_SIGNAL**2 * float((self.noise**2).sum()) / len(self.expected):
            return np.nan
        return float((self.own * self.expected).sum() / (self.expected**2).sum())

    @property
    def noise_ratios(self) -> Floats:
        """Scatter (3,) of each axis about the expected readings, relative to the usual scatter."""
        return np.asarray((self.own - self.expected).std(axis=0) / self.noise)


def compare_triad(
    residuals: WindowResiduals, window: DecisionWindow, normal: NormalModel, axes: Sequence[int]
) -> TriadComparison | None:
    """Compare a triad (its three `axes`) with the axes included in `residuals`; None for too few valid readings."""
    members = list(axes)
    rows = window.valid[:, members].all(axis=1)
    if rows.sum() < 3:
        return None
    expected = residuals.triad @ residuals.rows[members].T
    with np.errstate(invalid="ignore"):
        quiet = float(np.mean(window.changes[members] / normal.change[members]))
    stale = bool(window.stale is not None and window.stale[rows][:, members].all())
    own = expected[rows] + residuals.residual[rows][:, members]
    return TriadComparison(own, expected[rows], np.sqrt(normal.variance[members]), quiet, stale)


def reset_to(view: TriadComparison, axis: Axis, ranges: Ranges, unit_si: float) -> tuple[float, float] | None:
    """Return the range of the chip that explains the ratio of a triad's readings (or, without a signal, of its
    scatter), and the factor of that range; None if there is none.
    """
    table = ranges.get(axis.chip, {})
    configured = min(table, key=lambda span: abs(span * unit_si - axis.range_si), default=0.0)
    factors = {span: table[span] / table[configured] for span in table if table[span] != table[configured]}
    if not factors:
        return None
    ratio, tolerance = view.ratio, _SCALE_TOLERANCE
    if not np.isfinite(ratio):
        quiet = view.quiet < QUIET
        each = np.full(3, np.sqrt(view.quiet)) if quiet else view.noise_ratios
        ratio, tolerance = float(np.exp(np.log(np.maximum(each, 1e-9)).mean())), _NOISE_TOLERANCE
        if each.max() > 2.5 * each.min() or 0.5 < ratio < 1.8:
            return None
    best = min(factors, key=lambda span: abs(np.log(factors[span] / max(ratio, 1e-9))))
    return (best, factors[best]) if abs(ratio / factors[best] - 1) < tolerance else None


def fault_kind(view: TriadComparison, which: Sequence[int], reset: tuple[float, float] | None) -> FaultKind:
    """Return the kind of fault of the axes `which` (0, 1, 2) of a triad."""
    if view.stale or (view.quiet < QUIET and reset is None):
        return FaultKind("stuck", 0.0, whole=True)
    if reset is not None:
        return FaultKind("range_reset", reset[1], whole=True, range=reset[0])
    chosen = list(which)
    off = (view.own - view.expected)[:, chosen]
    size = float(off.mean(axis=0)[np.abs(off.mean(axis=0)).argmax()])
    about = off - off.mean(axis=0)
    noise = view.noise[chosen]
    scatter = float((about**2).mean(axis=0).max() ** 0.5 / noise.max())
    if abs(size) * np.sqrt(len(off)) < 6 * scatter * noise.max() and scatter > 2:
        return _scatter_fault(off, noise, scatter)
    return _scale_fault(view, chosen, about) or FaultKind("bias", size)


def _scale_fault(view: TriadComparison, chosen: Sequence[int], about: Floats) -> FaultKind | None:
    """Return a fault of scale if it explains a window much better than a bias; else None."""
    expected, own = view.expected[:, chosen], view.own[:, chosen]
    power = (expected**2).sum(axis=0)
    if not power.min() > _LEAST_SIGNAL**2 * float((view.noise[chosen] ** 2).max()):
        return None
    factor = (own * expected).sum(axis=0) / power
    remaining = ((own - factor * expected) ** 2).sum()
    return (
        FaultKind("scale", float(factor[np.abs(factor - 1).argmax()])) if remaining < 0.3 * (about**2).sum() else None
    )


def _scatter_fault(off: Floats, noise: Floats, scatter: float) -> FaultKind:
    """Distinguish glitches, which leave most readings as usual, from noise."""
    about = np.abs(off - np.median(off, axis=0))
    if (np.quantile(about, _LOW, axis=0) < _USUAL * _LOW_SIGMAS * noise).all():
        return FaultKind("glitches", float(about.max()))
    return FaultKind("white_noise", scatter)


AXIS_GAIN = 50.0
"""Least gain of an error in the mean of an axis, 7 standard deviations: a probability of 2e-12 per test for normal
noise, with a margin for noise that is not normal."""

SENSOR_GAIN = 57.0
"""Least gain of an error in a whole sensor: the same probability with three degrees of freedom."""

_MORE_AXES = 24.0
"""Least additional gain of the whole sensor over its best axis."""

_ENERGY_NATS = 25.0
"""Negative logarithm of the probability that white noise exceeds the limit of a sum of squares (bound of Laurent and
Massart, Annals of Statistics 28, 2000, lemma 1)."""

_MARGIN = 12.0
_MARGIN_SHARE = 0.3
"""Least margin, as a share of its gain, by which a hypothesis has to be better than any of another sensor."""


@dataclass(frozen=True)
class Suspect:
    """The best hypothesis: its axes (indices), its gain over no fault, the test, and the sensors (numbers) that explain
    the window nearly as well (empty: it is isolated).
    """

    axes: tuple[int, ...]
    gain: float
    test: Literal["mean", "energy"]
    rivals: tuple[int, ...] = ()


def strongest(residuals: WindowResiduals, normal: NormalModel, disagreement: float = 0.0) -> Suspect | None:
    """Return the most likely fault of a window, None if it shows none.

    `disagreement` is the variance of single readings (SI) by which the sensors differ from each other beyond noise in
    this window.
    """
    axis, sensor = residuals.slow.axis_gains(residuals.means), residuals.slow.sensor_gains(residuals.means)
    energy, lasting = residuals.energies(normal)
    if disagreement > 0:
        known = residuals.doubt / (residuals.doubt + disagreement)
        axis, sensor = axis * known, sensor * known.reshape(-1, 3).max(axis=1)
        energy = energy * normal.variance / (normal.variance + disagreement)
    limit = energy_limit(len(residuals.triad), normal.colour, lasting)
    by_mean = max(float(axis.max()) / AXIS_GAIN, float(sensor.max()) / SENSOR_GAIN)
    by_energy = float((energy / limit).max())
    if max(by_mean, by_energy) < 1:
        return None
    if by_energy > by_mean:
        return _energy_suspect(energy, limit)
    return _mean_suspect(axis, sensor, residuals)


_FEWEST_SENSORS = 4
"""Fewest sensors by which a common change can be distinguished from a change of a single sensor."""

_FEWEST_READINGS = 3

_UNEVEN = 9.0
"""Ratio of the largest to the median variance of a disagreement over the sensors: those at the ends of a board are
affected more than those in its middle."""

_USUAL_SCATTER = 3.0
"""Largest usual mean square of a few normal readings, over their variance."""

_USUAL_READING = 9.0
"""Largest usual square of a single normal reading, over its variance: three standard deviations."""


def disagreement(residuals: WindowResiduals, normal: NormalModel) -> float:
    """Return the variance (SI) of single readings by which at least half of the sensors differ from the others in this
    window, beyond noise, on average or in one frame; 0 if fewer do, infinite if too few have three complete readings,
    for example if most clip.

    Chips sample a knock, or motion that is too fast for the rate of the rows, at different times, so that all of them
    disagree at once; a knock may end within one frame. One faulty sensor of four or more does not contribute, because
    each is compared with the median.
    """
    shown: Booleans = np.asarray((residuals.residual != 0).T.reshape(-1, 3, len(residuals.triad)).all(axis=1))  # (s, n)
    used: Booleans = np.asarray(residuals.included.reshape(-1, 3).any(axis=1))
    if used.sum() < _FEWEST_SENSORS:
        return 0.0
    frames = shown[used].sum(axis=0) >= _FEWEST_SENSORS
    whole = used & (shown[:, frames].sum(axis=1) >= _FEWEST_READINGS)
    if whole.sum() < _FEWEST_SENSORS or not shown[whole][:, frames].any(axis=0).all():
        return np.inf
    residual = residuals.residual[frames].T.reshape(len(used), 3, -1)[whole]
    off = np.linalg.solve(residuals.rows.reshape(-1, 3, 3)[whole], residual)  # (s, 3, n), along the box
    off[np.repeat(~shown[whole][:, None, frames], 3, axis=1)] = np.nan
    squares = (off - np.nanmedian(off, axis=0)) ** 2
    noise = normal.variance.reshape(-1, 3)[whole].max(axis=1)
    middle = (len(noise) - 1) // 2
    excess = np.sort(np.nanmean(squares, axis=2).max(axis=1) - _USUAL_SCATTER * noise)[middle]
    single = np.where(np.isnan(squares), 0.0, squares).max(axis=1)  # (s, n)
    over = np.sort(single - _USUAL_READING * noise[:, None], axis=0)[middle]
    knock = np.sort(single - noise[:, None], axis=0)[middle][over > 0]
    return _UNEVEN * float(max(0.0, excess, *knock))


_SLOW_ROWS_S = 0.04
"""Least time between rows from which motion by hand, up to some 5 Hz, may be too fast for them."""

_CERTAIN_MOTION = 100.0
"""Least mean square of the changes of the triad, over that by noise, that counts as motion."""


def unresolved_motion(window: DecisionWindow, residuals: WindowResiduals) -> float:
    """Return the variance (SI) of single readings by motion that is too fast for the rate of the rows; 0 if there is no
    such motion.

    A reading that is late by `DELAY_S` is off by that times the slope of the motion. In rows T apart, a sine of
    frequency f has first differences with a mean square of ``2 sin(pi f T)^2`` and second differences with ``(2 sin(pi
    f T))^2`` times that. Where f T is above 1/6, that factor is above 1, and the slope that the normal model derives
    from the neighbouring rows is too small; it vanishes at f T = 1/2. First differences over T are too small by
    ``sin(pi f T) / (pi f T)``, which is at least 2 / pi for f T up to 1/2.
    """
    first = np.diff(residuals.triad, axis=0)
    periods_s = np.diff(window.time) * 1e-9
    if len(first) < 2 or periods_s.min() < _SLOW_ROWS_S or not np.isfinite(first).all():
        return 0.0
    square, second = float((first**2).sum() / len(first)), float((np.diff(first, axis=0) ** 2).sum() / (len(first) - 1))
    if square < 2 * _CERTAIN_MOTION * float(np.trace(residuals.white.spread)) or second < square:
        return 0.0
    slopes = first / periods_s[:, None]
    return float((np.pi / 2 * DELAY_S) ** 2 * (slopes**2).mean(axis=0).max())


def energy_limit(frames: int, colour: Floats, lasting: Floats) -> Floats:
    """Return the limit (m,) of the energy of noise of this `colour` (m,). The share `lasting` (m,) of the variance, the
    uncertainty of the calibration, may be the same error in all readings of the window, of at most 7 standard
    deviations.
    """
    nats = _ENERGY_NATS * colour
    by_noise = frames + 2 * np.sqrt(frames * nats) + 2 * nats
    return np.asarray((1 - lasting) * by_noise + lasting * frames * AXIS_GAIN)


def _mean_suspect(axis: Floats, sensor: Floats, residuals: WindowResiduals) -> Suspect:
    """Return the hypothesis for the means: the sensor with the greatest gain, or its one axis with nearly all of that
    gain.
    """
    best = int(sensor.argmax())
    members = np.arange(3 * best, 3 * best + 3)
    item = int(members[axis[members].argmax()])
    alone = sensor[best] - axis[item] < _MORE_AXES
    axes = (item,) if alone else tuple(int(index) for index in members if residuals.included[index])
    gain = float(axis[item] if alone else sensor[best])
    return Suspect(axes, gain, "mean", _rivals(sensor, best, gain))


def _energy_suspect(energy: Floats, limit: Floats) -> Suspect:
    """Return the hypothesis for the scatter: the sensor with the noisiest axis, and its axes beyond the limit."""
    per_sensor = (energy / limit).reshape(-1, 3).max(axis=1)
    best = int(per_sensor.argmax())
    members = np.arange(3 * best, 3 * best + 3)
    wild = tuple(int(index) for index in members if energy[index] >= limit[index])
    gain = float(energy[members].max())
    strength = np.where(energy >= limit, energy, 0.0).reshape(-1, 3).max(axis=1)
    return Suspect(wild, gain, "energy", _rivals(strength, best, gain))


def _rivals(gains: Floats, best: int, gain: float) -> tuple[int, ...]:
    """Return the sensors whose gain is too near that of the best one."""
    near = gains > gain - max(_MARGIN, _MARGIN_SHARE * gain)
    near[best] = False
    return tuple(int(sensor) for sensor in np.flatnonzero(near))


DRIFT_SI: Mapping[str, float] = MappingProxyType(
    {"specific_force": 0.1 * STANDARD_GRAVITY, "angular_rate": np.radians(3.0)}
)
"""Limit of the drift of an axis in a run: twice that of the worst axis of the paper's Table 8 over its 28 degC (1.4 mg
and 0.05 dps per degC)."""

_SETTLED = 3
_SIGMAS = 4.0
_CLEARLY = 0.7
"""Share of the largest drift above which another sensor may be the faulty one as well."""


class DriftLimits(NamedTuple):
    """Limits that `Baseline.departed` uses once every axis is settled: the first `state` (m, 5) of each axis and its
    `covariance` (m, 5, 5), the shares (m, m) of the axes' drifts in the departure of each axis from the others, and the
    limit of a drift in SI, to which `sigmas` standard deviations are added.
    """

    state: Floats
    covariance: Floats
    shares: Floats
    limit: float
    sigmas: float


class Baseline:
    """The initial state of each axis, and its drift since then."""

    def __init__(self, rows: Floats, quantity: str) -> None:
        self._spaces = Spaces(rows)
        self._limit = DRIFT_SI[quantity]
        self._windows = np.zeros(len(rows))
        self._state: Floats | None = None
        self._covariance: Floats | None = None

    def departed(self, included: Booleans, usual: Floats, normal: NormalModel) -> tuple[Suspect | None, float]:
        """Return, among the axes `included` (m,) with the mean regressors `usual` (m, 5), the one whose drift exceeds
        the limit most, and the drift in SI; None if there is none.

        Call it at equal intervals: an axis is settled after `_SETTLED` of them.
        """
        self._settle(included, normal)
        shares = self._shares(included & (self._windows >= _SETTLED), usual, normal)
        if shares is None:
            return None, 0.0
        share, departure, allowed = shares
        worst = int(share.argmax())
        if share[worst] < 1:
            return None, 0.0
        sensors = share.reshape(-1, 3).max(axis=1) > _CLEARLY * share[worst]
        sensors[worst // 3] = False
        gain = float((departure[worst] / allowed[worst] * _SIGMAS) ** 2)
        return Suspect((worst,), gain, "mean", tuple(np.flatnonzero(sensors).tolist())), float(departure[worst])

    def limits(self, included: Booleans) -> DriftLimits | None:
        """Return the limits with these axes (m,); None while one of them has not settled, so that they will change."""
        if self._state is None or self._covariance is None or (included & (self._windows < _SETTLED)).any():
            return None
        space = self._spaces(included.astype(float))
        shares = np.zeros((len(included), len(included))) if space is None else space.deleted * included
        return DriftLimits(self._state, self._covariance, shares, self._limit, _SIGMAS)

    def stayed(self, included: Booleans, times: int = 1) -> None:
        """Count the axes, as `departed` does, so many times."""
        self._windows += included * times

    def _shares(self, begun: Booleans, usual: Floats, normal: NormalModel) -> tuple[Floats, Floats, Floats] | None:
        """Return the drift of each axis over its limit, the drift, and the limit, all (m,); None if the axes that have
        `begun` do not determine a triad.
        """
        space = self._spaces(begun.astype(float))
        if space is None or self._state is None or self._covariance is None:
            return None
        moved = np.where(begun, ((normal.state - self._state) * usual).sum(axis=1), 0.0)
        unknown = np.einsum("mi,mij,mj->m", usual, self._covariance, usual)
        deleted = space.deleted
        departure = deleted @ moved
        allowed = self._limit + _SIGMAS * np.sqrt(deleted**2 @ np.where(begun, unknown, 0.0))
        return np.where(space.observable, np.abs(departure) / allowed, 0.0), departure, allowed

    def reset(self, axis: int, normal: NormalModel) -> None:
        """Reset the state of an axis in `normal` to its initial one: a drift beyond its limit is not a calibration
        error.
        """
        if self._state is not None and self._covariance is not None:
            normal.state[axis], normal.covariance[axis] = self._state[axis], self._covariance[axis]

    def _settle(self, included: Booleans, normal: NormalModel) -> None:
        """Store the state of each axis when it has been in use for long enough."""
        self._windows += included
        if self._state is None or self._covariance is None:
            self._state, self._covariance = normal.state.copy(), normal.covariance.copy()
        now = included & (self._windows == _SETTLED)
        self._state[now], self._covariance[now] = normal.state[now], normal.covariance[now]


Resets = Callable[[TriadComparison, int], tuple[float, float] | None]
"""Returns the range (and factor) that explains the comparison of a sensor (number) with the others."""

_WILD = 6.0
"""Least ratio of the mean square of changes from reading to reading to the usual one for a noisy sensor."""

_CALM = 2.0
"""Largest such ratio of all other sensors, which shows that the box is at rest."""


def separate_rivals(
    suspect: Suspect, window: DecisionWindow, residuals: WindowResiduals, normal: NormalModel, resets: Resets
) -> Suspect | None:
    """Return the suspect or one of its rivals, as a whole sensor, if it is the only one that stands still, that reads
    as in another range of its chip, or that is noisy while all others are as usual; None if there is none or several.
    """
    views = {}
    for sensor in (suspect.axes[0] // 3, *suspect.rivals):
        members = np.arange(3 * sensor, 3 * sensor + 3)
        rest = residuals.included.copy()
        rest[members] = False
        without = window_residuals(window, normal, residuals.rows, rest, Spaces(residuals.rows))
        view = None if without is None else compare_triad(without, window, normal, members.tolist())
        if view is None:
            return None
        views[sensor] = view
    tests: tuple[Callable[[int], bool], ...] = (
        lambda sensor: views[sensor].stale or views[sensor].quiet < QUIET,
        lambda sensor: resets(views[sensor], sensor) is not None,
        lambda sensor: (
            views[sensor].quiet > _WILD and max(views[other].quiet for other in views if other != sensor) < _CALM
        ),
    )
    for test in tests:
        result = [sensor for sensor in views if test(sensor)]
        if len(result) == 1:
            axes = tuple(range(3 * result[0], 3 * result[0] + 3))
            return replace(suspect, axes=axes, rivals=())
    return None
