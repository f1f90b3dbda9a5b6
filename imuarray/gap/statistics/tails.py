"""Normal scores: a common measure of scores whose tails differ.

The scores of some statistics are nearly normal; those of others have heavy tails, for example a level that the fit
makes zero in most replicates, or the share of rare rows. One of the latter would be the largest of all scores in almost
every replicate and would mask any other deviation. Each score is therefore replaced by the normal score with the same
tail probability.

The tail is that of Student's t, fitted to the scores of one statistic of one sensor over phases, axes and replicates:
the scale is fitted to their 90 % quantile, and the degrees of freedom are the most probable of a few values.

Some statistics are mixtures: usually near zero and sometimes far from it, such as the share of stale rows of a poll
that is hardly slower than the sensor, or a slope that a few fits miss. If more scores are beyond a threshold than this
tail allows, those beyond it have an exponential one, with the share and the mean excess of all scores of the other
campaigns (peaks over threshold: Pickands, Ann. Stat. 3, 1975).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import gammaln, ndtr, ndtri, stdtr, stdtrit

from imuarray.arrays import Booleans, Floats, Indices
from imuarray.gap.statistics.catalogue import Key

FREEDOMS = (4.0, 6.0, 8.0, 12.0, 20.0, 40.0)
"""Degrees of freedom of tails that are tried, up to those of normal statistics whose scatter is estimated from 40
replicates.

A hundred scores do not determine the tail beyond the largest of them. With fewer than 4 degrees of freedom even a very
large score would not be significant: 100 scale units of a Cauchy distribution correspond to a normal score of 2.5.
"""

HEAVIER = 1.0
"""Log prior, in nats, against a tail with a tenth of the degrees of freedom. A hundred scores often do not determine
the degrees of freedom: without the prior a statistic with normal scores got 6 of them, which turn 8.1 standard
deviations into a normal score of 3.9. With the prior 60 of 72 cases with a mechanism were detected instead of 57.
"""

QUANTILE = 0.9
"""Quantile of the absolute scores to which the scale of a tail is fitted."""

THRESHOLD = 3.0
"""Normal score beyond which there may be a second part of a mixture."""

_SHARE = float(ndtr(-THRESHOLD))
"""Share of scores beyond the threshold if there is no second part."""

_MEAN_EXCESS = 0.3
"""Mean amount by which normal scores exceed the threshold, to one digit. It is the least one that is assumed, and
counts as one more score of a second part.
"""

_FREEDOM = np.array(FREEDOMS)
_AT_QUANTILE = stdtrit(_FREEDOM, (1 + QUANTILE) / 2)
_PRIOR = HEAVIER * np.log10(_FREEDOM / _FREEDOM.max())
_CONSTANT = gammaln((_FREEDOM + 1) / 2) - gammaln(_FREEDOM / 2) - np.log(_FREEDOM * np.pi) / 2

_AT_THRESHOLD = -stdtrit(_FREEDOM, _SHARE)

_LEAST_SIZE = 0.05
"""Absolute score at the quantile below which no tail is fitted: the statistic has nearly always the same value."""

_LEAST_SCALE = 0.5
"""Least scale of a tail. A statistic that has one value in nearly all replicates (rows with a flag, absent codes), or
that varies by less than its resolution, has smaller scores, which do not determine the scale.
"""

_LEAST_SHARE = 1e-300


@dataclass(frozen=True)
class Tail:
    """A tail: Student's t with `freedom` degrees of freedom, multiplied by `scale`."""

    freedom: float
    scale: float

    def normal(self, sizes: Floats) -> Floats:
        """Return the normal scores with the same tail probabilities as the absolute scores `sizes`."""
        share = np.maximum(stdtr(self.freedom, -sizes / self.scale), _LEAST_SHARE)
        return np.asarray(-ndtri(share))


@dataclass(frozen=True)
class RareTail:
    """The tail of a mixture: the `share` of absolute scores beyond a `threshold`, and their mean excess."""

    threshold: float
    share: float
    mean_excess: float

    def reduced(self, sizes: Floats, normal: Floats) -> Floats:
        """Return the `normal` scores (k,) of absolute scores `sizes` (k,), reduced beyond the threshold to those of the
        same tail probability, but not below `THRESHOLD`: the order is kept.
        """
        excess = np.maximum(np.nan_to_num(sizes) - self.threshold, 0.0)
        shares = np.maximum(self.share * np.exp(-excess / self.mean_excess), _LEAST_SHARE)
        return np.where(excess > 0, np.minimum(normal, np.maximum(-ndtri(shares), THRESHOLD)), normal)


@dataclass(frozen=True)
class Tails:
    """Tails by probe and sensor, and those of mixtures; scores of probes and sensors without a tail are not changed."""

    by_statistic: Mapping[tuple[str, str], Tail]
    mixtures: Mapping[tuple[str, str], RareTail] = field(default_factory=dict)

    def normal(self, scores: Floats, keys: Sequence[Key]) -> Floats:
        """Return the normal scores (m,) of the scores (m,) of the keys, with their signs."""
        values = np.array(scores)
        for statistic, places in _statistics(keys).items():
            sizes = np.abs(scores[places])
            normal = self.by_statistic[statistic].normal(sizes) if statistic in self.by_statistic else sizes
            if statistic in self.mixtures:
                normal = self.mixtures[statistic].reduced(sizes, normal)
            values[places] = np.copysign(normal, scores[places])
        return values


NO_TAILS = Tails({})
"""Tails that leave all scores unchanged."""


def tails_of(chance: Floats, keys: Sequence[Key]) -> Tails:
    """Return the tails fitted to the scores (b, m) of replicates without a gap."""
    by_statistic: dict[tuple[str, str], Tail] = {}
    mixtures: dict[tuple[str, str], RareTail] = {}
    for statistic, places in _statistics(keys).items():
        sizes = np.abs(chance[:, places])
        threshold, scale = THRESHOLD, 1.0
        fit = _fit(sizes)
        if fit is not None:
            best = int((fit.density.sum(axis=1) + _PRIOR).argmax())
            by_statistic[statistic] = fit.tail(best)
            threshold, scale = float(fit.thresholds[best]), float(fit.scales[best])
        excesses = _excesses(sizes, threshold).sum(axis=0)
        if _is_mixture(excesses, fit):
            mixtures[statistic] = _rare_tail(excesses, threshold, scale)
    return Tails(by_statistic, mixtures)


def normal_scores_by_others(scores: Floats, keys: Sequence[Key]) -> Floats:
    """Return the normal scores (b, m) of campaigns with scores (b, m), each by the degrees of freedom that are most
    probable for the others, by the common scale, and by the scores of the others beyond the threshold: if all campaigns
    have the same distribution, each is still equally likely to be the most extreme.
    """
    values = np.array(scores)
    for places in _statistics(keys).values():
        normal = _normal_by_others(np.abs(scores[:, places]))
        values[:, places] = np.copysign(normal, scores[:, places])
    return values


def _normal_by_others(sizes: Floats) -> Floats:
    """Return the absolute normal scores (b, k) of the absolute scores (b, k) of one statistic."""
    fit, normal = _fit(sizes), np.array(sizes)
    thresholds, scales = np.full(len(sizes), THRESHOLD), np.ones(len(sizes))
    if fit is not None:
        best = (fit.density.sum(axis=1, keepdims=True) - fit.density + _PRIOR[:, None]).argmax(axis=0)
        thresholds, scales = fit.thresholds[best], fit.scales[best]
        for at in np.unique(best).tolist():
            normal[best == at] = fit.tail(at).normal(sizes[best == at])
    excesses = _excesses(sizes, thresholds[:, None])
    others = excesses.sum(axis=0) - excesses
    for row in np.flatnonzero(_is_mixture(others, fit)).tolist():
        rare = _rare_tail(others[row], float(thresholds[row]), float(scales[row]))
        normal[row] = rare.reduced(sizes[row], normal[row])
    return normal


def _excesses(sizes: Floats, thresholds: Floats | float) -> Floats:
    """Return for each of b campaigns (b, 3) the numbers of known absolute scores (b, k) and of those beyond the
    thresholds, and the sum of the excesses of the latter.
    """
    excess = np.maximum(np.nan_to_num(sizes) - thresholds, 0.0)
    return np.stack([np.isfinite(sizes).sum(axis=1), (excess > 0).sum(axis=1), excess.sum(axis=1)], axis=1)


def _is_mixture(excesses: Floats, fit: _Fit | None) -> Booleans:
    """Return for sums (..., 3) of `_excesses` whether more scores are beyond the threshold than chance (three standard
    deviations and two scores) allows with twice the usual share. If no tail could be fitted, nearly all scores are
    zero, and the usual share is 0.
    """
    usual = 2 * _SHARE * excesses[..., 0] if fit is not None else np.zeros(excesses.shape[:-1])
    return np.asarray(excesses[..., 1] > usual + 3 * np.sqrt(usual) + 2)


def _rare_tail(excesses: Floats, threshold: float, scale: float) -> RareTail:
    """Return the tail of a mixture for a sum (3,) of `_excesses` beyond this threshold of a tail of this scale."""
    known, beyond, total = excesses.tolist()
    least = _MEAN_EXCESS * scale
    return RareTail(threshold, (beyond + 1) / (known + 2), max((total + least) / (beyond + 1), least))


@dataclass(frozen=True)
class _Fit:
    """Scale (f,) for each number of degrees of freedom, and the log `density` (f, b) of each campaign's scores."""

    scales: Floats
    density: Floats

    def tail(self, at: int) -> Tail:
        return Tail(FREEDOMS[at], float(self.scales[at]))

    @property
    def thresholds(self) -> Floats:
        """The absolute scores (f,) with the normal score `THRESHOLD`."""
        return np.asarray(self.scales * _AT_THRESHOLD)


def _fit(sizes: Floats) -> _Fit | None:
    """Return the fit to absolute scores (b, k); None if no tail can be fitted."""
    is_known = np.isfinite(sizes)
    if not is_known.any():
        return None
    size = float(np.quantile(sizes[is_known], QUANTILE))
    if size < _LEAST_SIZE:
        return None
    scales = np.maximum(size / _AT_QUANTILE, _LEAST_SCALE)
    squares = np.where(is_known, sizes, 0.0) ** 2
    density = np.empty((len(FREEDOMS), len(sizes)))
    for at, (freedom, scale) in enumerate(zip(FREEDOMS, scales.tolist(), strict=True)):
        each = _CONSTANT[at] - np.log(scale) - (freedom + 1) / 2 * np.log1p(squares / (freedom * scale**2))
        density[at] = np.where(is_known, each, 0.0).sum(axis=1)
    return _Fit(scales, density)


def _statistics(keys: Sequence[Key]) -> dict[tuple[str, str], Indices]:
    """Return the places of the keys by probe and sensor."""
    places: dict[tuple[str, str], list[int]] = {}
    for at, key in enumerate(keys):
        places.setdefault((key.probe, key.sensor), []).append(at)
    return {statistic: np.array(members, np.intp) for statistic, members in places.items()}
