"""Normal scores: a common measure of scores whose tails differ.

The scores of some statistics are nearly normal; those of others have heavy tails, for example a level that the fit
makes zero in most replicates, or the share of rare rows. One of the latter would be the largest of all scores in almost
every replicate and would mask any other deviation. Each score is therefore replaced by the normal score with the same
tail probability.

The tail is that of Student's t, fitted to the scores of one statistic of one sensor over phases, axes and replicates:
the scale is fitted to their 90 % quantile, and the degrees of freedom are the most probable of a few values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, ndtri, stdtr, stdtrit

from imuarray.arrays import Floats, Indices
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

_FREEDOM = np.array(FREEDOMS)
_AT_QUANTILE = stdtrit(_FREEDOM, (1 + QUANTILE) / 2)
_PRIOR = HEAVIER * np.log10(_FREEDOM / _FREEDOM.max())
_CONSTANT = gammaln((_FREEDOM + 1) / 2) - gammaln(_FREEDOM / 2) - np.log(_FREEDOM * np.pi) / 2

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
class Tails:
    """Tails by probe and sensor; scores of probes and sensors without a tail are not changed."""

    by_statistic: Mapping[tuple[str, str], Tail]

    def normal(self, scores: Floats, keys: Sequence[Key]) -> Floats:
        """Return the normal scores (m,) of the scores (m,) of the keys, with their signs."""
        values = np.array(scores)
        for statistic, places in _statistics(keys).items():
            if statistic in self.by_statistic:
                statistic_scores = scores[places]
                values[places] = np.copysign(
                    self.by_statistic[statistic].normal(np.abs(statistic_scores)), statistic_scores
                )
        return values


NO_TAILS = Tails({})
"""Tails that leave all scores unchanged."""


def tails_of(chance: Floats, keys: Sequence[Key]) -> Tails:
    """Return the tails fitted to the scores (b, m) of replicates without a gap."""
    fits = {statistic: _fit(np.abs(chance[:, places])) for statistic, places in _statistics(keys).items()}
    return Tails(
        {name: fit.tail(int((fit.density.sum(axis=1) + _PRIOR).argmax())) for name, fit in fits.items() if fit}
    )


def normal_scores_by_others(scores: Floats, keys: Sequence[Key]) -> Floats:
    """Return the normal scores (b, m) of campaigns with scores (b, m), each by the degrees of freedom that are most
    probable for the others and the common scale: if all campaigns have the same distribution, each is still equally
    likely to be the most extreme.
    """
    values = np.array(scores)
    for places in _statistics(keys).values():
        statistic_scores = scores[:, places]
        fit = _fit(np.abs(statistic_scores))
        if fit is None:
            continue
        best = (fit.density.sum(axis=1, keepdims=True) - fit.density + _PRIOR[:, None]).argmax(axis=0)
        for at in np.unique(best).tolist():
            rows = best == at
            values[np.ix_(rows, places)] = np.copysign(
                fit.tail(at).normal(np.abs(statistic_scores[rows])), statistic_scores[rows]
            )
    return values


@dataclass(frozen=True)
class _Fit:
    """Scale (f,) for each number of degrees of freedom, and the log `density` (f, b) of each campaign's scores."""

    scales: Floats
    density: Floats

    def tail(self, at: int) -> Tail:
        return Tail(FREEDOMS[at], float(self.scales[at]))


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
