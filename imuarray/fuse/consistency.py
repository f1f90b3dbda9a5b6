"""Whether errors are as large as their covariances say: the normalised error squared against its chi-square interval.

``e' P^-1 e / 3`` has mean 1 if P is right (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 5.4). Its mean over n frames would be chi-square of 3 n degrees of freedom over 3 n if the
errors forgot from frame to frame. They don't: biases stay. The variance of the mean of normal errors with lagged
correlations C(k) (3, 3) is ``2 / n sum over k of (1 - |k| / n) |C(k)|^2``, |.| the Frobenius norm, so that the interval
is taken for the degrees of freedom of a chi-square with that variance. C(k) is about zero, not about the mean: a
constant error correlates with itself for ever, and a log of it counts little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imuarray.fuse.frames import matrices

Floats = npt.NDArray[np.float64]

_FEWEST = 20


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
        """Whether it lies in its interval."""
        return self.low <= self.normalised <= self.high


def consistency(errors: Floats, covariances: Floats) -> Consistency | None:
    """Of errors (n, 3) with covariances (n, 6) (`frames.ENTRIES`); None where fewer than twenty have one."""
    from scipy.special import gammaincinv  # the inverse chi-squared distribution without the weight of scipy.stats

    known = np.flatnonzero(np.isfinite(covariances).all(axis=1) & np.isfinite(errors).all(axis=1))
    known = known[np.linalg.det(matrices(covariances[known])) > 0]
    if len(known) < _FEWEST:
        return None
    factors = np.linalg.cholesky(matrices(covariances[known]))
    white = np.linalg.solve(factors, errors[known][:, :, None])[:, :, 0]
    normalised = float(np.mean(white**2))
    freedom = _freedom(white)
    low, high = 2 * gammaincinv(freedom / 2, [0.025, 0.975]) / freedom
    return Consistency(normalised, float(low), float(high), freedom)


def _freedom(white: Floats) -> float:
    """18 over the variance of the mean of |x|^2, where x (n, 3) has unit variance: 3 n if nothing is remembered.

    Lags up to half the length are added up one by one, less what chance makes of them; beyond they are as large as
    from a quarter of the length to half of it.
    """
    from scipy.fft import next_fast_len

    rows, half = len(white), len(white) // 2
    size = next_fast_len(2 * rows, real=True)
    spectra = np.fft.rfft((white / np.sqrt(np.mean(white**2))).T, size)
    share = 1 - np.arange(1, half + 1) / rows
    squares = -9 / (rows * share)
    for one, other in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        lagged = np.fft.irfft(spectra[one].conj() * spectra[other], size) / rows
        squares += (lagged[1 : half + 1] / share) ** 2
        if one != other:  # the other way round
            squares += (lagged[: -half - 1 : -1] / share) ** 2
    remembered = share @ squares + rows / 8 * squares[half // 2 :].mean()
    return float(np.clip(18 / (2 / rows * (3 + 2 * max(remembered, 0.0))), 1.0, 3 * rows))
