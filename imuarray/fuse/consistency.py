"""Consistency of errors with their covariances: the normalised error squared against its chi-square interval.

``e' P^-1 e / 3`` has mean 1 if P is right (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 5.4). Its mean over n frames would be chi-square of 3 n degrees of freedom over 3 n if the
errors of different frames were independent. They are not: biases persist. The variance of the mean of normal errors
with lagged correlations C(k) (3, 3) is ``2 / n sum over k of (1 - |k| / n) |C(k)|^2``, |.| the Frobenius norm, so the
interval is that of a chi-square with this variance. C(k) is about zero, not about the mean: a constant error stays
correlated at every lag, and many frames of it count as few.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.fuse.row_spool import RowSource, RowSpool, row_blocks

_FEWEST = 20

_SEGMENT = 1 << 17
"""Rows whose spectrum is taken at once."""


@dataclass(frozen=True)
class Consistency:
    """Mean normalised error squared over its expectation; the 95 % interval in which it lies if covariances are right;
    the degrees of freedom that the errors' correlation leaves.
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
    """Return the consistency of errors (n, 3) with covariances (n, 6) (`frames.ENTRIES`), block by block; None if fewer
    than twenty have one.
    """
    from scipy.special import gammaincinv  # the inverse chi-squared distribution without the weight of scipy.stats

    with RowSpool(3) as white:
        squares = 0.0
        for error, covariance in zip(row_blocks(errors), row_blocks(covariances), strict=True):
            known = np.isfinite(covariance).all(axis=1) & np.isfinite(error).all(axis=1)
            block, definite = _whitened(error[known], covariance[known])
            block = block[definite]
            squares += float(np.sum(block**2))
            white.append(block)
        if len(white) < _FEWEST:
            return None
        normalised = squares / (3 * len(white))
        freedom = _freedom(white, normalised)
    low, high = 2 * gammaincinv(freedom / 2, [0.025, 0.975]) / freedom
    return Consistency(normalised, float(low), float(high), freedom)


def _whitened(errors: Floats, covariances: Floats) -> tuple[Floats, Booleans]:
    """Errors (n, 3) times the inverse of the lower Cholesky factor of their covariances (n, 6), and which of these are
    positive definite (n,): written out, for all frames at a time, in a twentieth of the time of a routine for matrices.
    """
    xx, yy, zz, xy, xz, yz = covariances.T
    with np.errstate(invalid="ignore", divide="ignore"):
        first = np.sqrt(xx)
        second_first, third_first = xy / first, xz / first
        second = np.sqrt(yy - second_first**2)
        third_second = (yz - third_first * second_first) / second
        third = np.sqrt(zz - third_first**2 - third_second**2)
        x = errors[:, 0] / first
        y = (errors[:, 1] - second_first * x) / second
        z = (errors[:, 2] - third_first * x - third_second * y) / third
    definite: Booleans = np.asarray((first > 0) & (second > 0) & (third > 0))
    return np.stack([x, y, z], axis=1), definite


def _freedom(white: RowSource, mean_square: float) -> float:
    """18 over the variance of the mean of |x|^2, where x (n, 3) has unit variance: 3 n if nothing is remembered.

    Lags up to half the length are added up one by one, less what chance makes of them; beyond they are as large as
    from a quarter of the length to half of it. `mean_square` of `white` makes x of it.
    """
    rows, half = len(white), len(white) // 2
    near, far = 0.0, 0.0
    for first, products in _lagged_products(white, half):
        lags = np.arange(first, first + len(products))
        share = 1 - lags / rows
        squares = products / (rows * mean_square * share) ** 2 - 9 / (rows * share)
        near += float(share @ squares)
        far += float(squares[lags > half // 2].sum())
    remembered = near + rows / 8 * far / (half - half // 2)
    return float(np.clip(18 / (2 / rows * (3 + 2 * max(remembered, 0.0))), 1.0, 3 * rows))


def _lagged_products(white: RowSource, last: int) -> Iterator[tuple[int, Floats]]:
    """Yield a lag k > 0 and, for that and those that follow it, up to the `last`, the squared Frobenius norm of the sum
    over i of x(i) x(i + k)'.

    Correlations of segments are products of their spectra (T. G. Stockham, "High-speed convolution and correlation",
    1966): those of all pairs of segments that are as far apart are added up before they are transformed back. What the
    sum of one distance says of shorter lags goes with that of the distance before.
    """
    from scipy.fft import next_fast_len

    rows = len(white)
    segment = min(_SEGMENT, rows)
    size = next_fast_len(2 * segment, real=True)
    width = size // 2 + 1
    count = -(-rows // segment)
    with RowSpool(6 * width) as spectra:
        for begin in range(0, rows, segment):
            spectrum = np.fft.rfft(white[begin : begin + segment].T, size)
            spectra.append(np.ascontiguousarray(spectrum).view(np.float64).reshape(1, -1))

        def correlations(distance: int) -> Floats:
            total = np.zeros((3, 3, width), complex)
            for number in range(count - distance):
                earlier, later = (
                    spectra[place : place + 1].view(np.complex128).reshape(3, width)
                    for place in (number, number + distance)
                )
                np.conj(earlier, out=earlier)
                for total_of, of_axis in zip(total, earlier, strict=True):
                    total_of += of_axis * later
            return np.fft.irfft(total, size)

        lagged = correlations(0)[..., :segment].copy()
        for distance in range(last // segment + 1):
            ahead = correlations(distance + 1)
            lagged[..., 1:] += ahead[..., size - segment + 1 :]
            first = distance * segment
            products = np.einsum("ijk,ijk->k", lagged, lagged)[: last + 1 - first]
            yield (first, products) if first else (1, products[1:])
            lagged[...] = ahead[..., :segment]
            del ahead  # before the next one is made
