"""Consistency of the errors of a fused result with the covariances that it states.

Errors are consistent with their covariances if the normalised error squared is within its chi-square interval: ``e'
P^-1 e / 3`` has mean 1 if P is right (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 5.4). Its mean over n frames would be chi-square of 3 n degrees of freedom over 3 n if the
errors of different frames were independent. They are not: biases persist. The variance of the mean of normal errors
with lagged correlations C(k) (3, 3) is ``2 / n sum over k of (1 - |k| / n) |C(k)|^2``, |.| the Frobenius norm, so the
interval is that of a chi-square with this variance. C(k) is taken about zero, not about the mean, so that a constant
error is correlated at every lag and many frames of it count as few.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.fuse.spools import RowSource, RowSpool, row_blocks

_FEWEST = 20

_SEGMENT = 1 << 17
"""Largest number of rows of one spectrum."""

_CACHED = 1 << 12
"""Number of frequencies whose products are computed together, so that they stay in the cache: half the time."""


@dataclass(frozen=True)
class Consistency:
    """Mean normalised error squared over its expectation; its 95 % interval under correct covariances; the effective
    degrees of freedom under the errors' correlation.
    """

    normalised: float
    low: float
    high: float
    freedom: float

    @property
    def holds(self) -> bool:
        """Return whether it lies in its interval."""
        return self.low <= self.normalised <= self.high


def consistency(errors: RowSource, covariances: RowSource) -> Consistency | None:
    """Return the consistency of errors (n, 3) with covariances (n, 6) (`frames.ENTRIES`), read block by block; None if
    fewer than twenty frames have both.
    """
    with RowSpool(3) as white:
        for error, covariance in zip(row_blocks(errors), row_blocks(covariances), strict=True):
            white.append(whiten(error, covariance))
        return consistency_of(white)


def consistency_of(white: RowSource) -> Consistency | None:
    """Return the consistency of `whiten` errors (n, 3), read block by block; None for fewer than twenty."""
    from scipy.special import gammaincinv  # for the inverse chi-squared distribution: scipy.stats is slow to import

    if len(white) < _FEWEST:
        return None
    normalised = sum(float(np.sum(block**2)) for block in row_blocks(white)) / (3 * len(white))
    freedom = _freedom(white, normalised)
    low, high = 2 * gammaincinv(freedom / 2, [0.025, 0.975]) / freedom
    return Consistency(normalised, float(low), float(high), freedom)


def whiten(errors: Floats, covariances: Floats) -> Floats:
    """Return errors (n, 3) times the inverse of the lower Cholesky factor of their covariances (n, 6), without rows
    that are not finite or whose covariance is not positive definite. It is written out for all frames at once, twenty
    times as fast as a matrix routine.
    """
    errors, covariances = _finite(errors, covariances)
    xx, yy, zz, xy, xz, yz = np.ascontiguousarray(covariances.T)
    of_x, of_y, of_z = np.ascontiguousarray(errors.T)
    with np.errstate(invalid="ignore", divide="ignore"):
        first = np.sqrt(xx)
        second_first, third_first = xy / first, xz / first
        second = np.sqrt(yy - second_first**2)
        third_second = (yz - third_first * second_first) / second
        third = np.sqrt(zz - third_first**2 - third_second**2)
        x = of_x / first
        y = (of_y - second_first * x) / second
        z = (of_z - third_first * x - third_second * y) / third
    white = np.stack([x, y, z], axis=1)
    definite = (first > 0) & (second > 0) & (third > 0)
    return white if definite.all() else white[definite]


def _finite(errors: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Return the rows that are finite in both arrays; a finite sum shows quickly that all rows are."""
    with np.errstate(invalid="ignore"):
        if np.isfinite(errors.sum() + covariances.sum()):
            return errors, covariances
    is_finite = np.isfinite(covariances).all(axis=1) & np.isfinite(errors).all(axis=1)
    return errors[is_finite], covariances[is_finite]


def _freedom(white: RowSource, mean_square: float) -> float:
    """Return the effective degrees of freedom: 18 over the variance of the mean of |x|^2, where x (n, 3) is `white`
    scaled to unit variance by its `mean_square`; 3 n without correlation.

    Lags up to half the length are added up, less their expectation by chance; correlations at longer lags are assumed
    as large as from a quarter of the length to half of it.
    """
    rows, half = len(white), len(white) // 2
    near, far = 0.0, 0.0
    for first, products in _lagged_products(white, half):
        lags = np.arange(first, first + len(products))
        share = 1 - lags / rows
        squares = products / (rows * mean_square * share) ** 2 - 9 / (rows * share)
        near += float(share @ squares)
        far += float(squares[lags > half // 2].sum())
    correlated = near + rows / 8 * far / (half - half // 2)
    return float(np.clip(18 / (2 / rows * (3 + 2 * max(correlated, 0.0))), 1.0, 3 * rows))


def _lagged_products(white: RowSource, last: int) -> Iterator[tuple[int, Floats]]:
    """Yield a lag k > 0 and, for it and the lags that follow, up to `last`, the squared Frobenius norm of the sum over
    i of x(i) x(i + k)'.

    Correlations of segments are products of their spectra (T. G. Stockham, "High-speed convolution and correlation",
    1966); the products of all pairs of segments at one distance are added up before the inverse transform. The shorter
    lags of one distance are added to the result of the distance before.
    """
    from scipy.fft import next_fast_len

    rows = len(white)
    count = -(-rows // _SEGMENT)
    segment = -(-rows // count)
    size = next_fast_len(2 * segment, real=True)
    width = size // 2 + 1
    with RowSpool(6 * width) as spectra:
        for start in range(0, rows, segment):
            spectrum = np.fft.rfft(white[start : start + segment].T, size)
            spectra.append(np.ascontiguousarray(spectrum).view(np.float64).reshape(1, -1))

        def correlations(distance: int) -> Floats:
            if distance >= count:
                return np.zeros((3, 3, size))
            total = np.zeros((3, 3, width), complex)
            for number in range(count - distance):
                earlier, later = (
                    spectra[place : place + 1].view(np.complex128).reshape(3, width)
                    for place in (number, number + distance)
                )
                for first in range(0, width, _CACHED):
                    part = slice(first, first + _CACHED)
                    total[..., part] += np.conj(earlier[:, np.newaxis, part]) * later[:, part]
            return np.fft.irfft(total, size)

        lagged = correlations(0)[..., :segment].copy()
        for distance in range(last // segment + 1):
            ahead = correlations(distance + 1)
            lagged[..., 1:] += ahead[..., size - segment + 1 :]
            first = distance * segment
            products = np.einsum("ijk,ijk->k", lagged, lagged)[: last + 1 - first]
            yield (first, products) if first else (1, products[1:])
            lagged[...] = ahead[..., :segment]
            del ahead  # frees memory before the next one is computed
