"""Kinds of faults and their characteristics: another range, stuck, biased, drifting, noisy, with glitches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.fuse.faults.normal import NormalModel
from imuarray.fuse.faults.window import DecisionWindow, WindowResiduals
from imuarray.fuse.frames import Axis

Ranges = Mapping[str, Mapping[float, float]]
"""Counts per unit at each measuring range, keyed by chip, as in `imuarray.chips.CHIPS`."""

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
    seen: WindowResiduals, window: DecisionWindow, normal: NormalModel, axes: Sequence[int]
) -> TriadComparison | None:
    """Compare a triad (its three `axes`) with the axes included in `seen`; None if it has too few valid readings."""
    members = list(axes)
    rows = window.valid[:, members].all(axis=1)
    if rows.sum() < 3:
        return None
    expected = seen.triad @ seen.rows[members].T
    with np.errstate(invalid="ignore"):
        quiet = float(np.mean(window.changes[members] / normal.change[members]))
    stale = bool(window.stale is not None and window.stale[rows][:, members].all())
    own = expected[rows] + seen.residual[rows][:, members]
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
        return _scattered(off, noise, scatter)
    return _by_scale(view, chosen, about) or FaultKind("bias", size)


def _by_scale(view: TriadComparison, chosen: Sequence[int], about: Floats) -> FaultKind | None:
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


def _scattered(off: Floats, noise: Floats, scatter: float) -> FaultKind:
    """Distinguish glitches, which leave most readings as usual, from noise."""
    about = np.abs(off - np.median(off, axis=0))
    if (np.quantile(about, _LOW, axis=0) < _USUAL * _LOW_SIGMAS * noise).all():
        return FaultKind("glitches", float(about.max()))
    return FaultKind("white_noise", scatter)
