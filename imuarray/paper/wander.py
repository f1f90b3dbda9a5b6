"""Means of a Gauss-Markov process over windows: what Table 11's columns show of a slow wander.

x is stationary with unit variance and correlation exp(-|t| / time_constant). Windows of T seconds follow on each other;
with r = time_constant / T and d = exp(-1 / r), integrating the correlation over one window or over two gives

    var(mean) = 2 r (1 - r (1 - d)),        cov(means k windows apart) = r^2 (1 - d)^2 d^(k - 1),  k >= 1.
"""

from __future__ import annotations

from math import exp

WINDOW_S = 300.0
"""Table 11's means are over five minutes (section 4)."""
PARTS = 15
"""Windows in a row, and runs, of which Table 11 gives the standard deviation."""
TIME_CONSTANT_S = 600.0
"""Time constant of the in-run wander, one for all channels. The paper prints none; three columns bracket it.

Longer than 100 s: first and last face of Table 10 differ, drift with temperature taken out, by a median of 1.6 of
Table 11's in-run deviations, where a wander of 100 s makes it 0.64, one of 600 s 0.94 and one of 3000 s 1.4; and range
over deviation of Table 11's fifteen windows is 3.39 on average, where windows that know nothing of each other have
3.54 and those of a wander of 600 s 3.45. Shorter than 1000 s: BMA3's x and y vary less from run to run than within one.
"""


def variance_of_mean(window_s: float, time_constant_s: float = TIME_CONSTANT_S) -> float:
    """Variance of the mean over one window, as a share of the process's."""
    ratio = time_constant_s / window_s
    return 2 * ratio * (1 - ratio * (1 - exp(-1 / ratio)))


def covariance_of_means(apart: int, window_s: float, time_constant_s: float = TIME_CONSTANT_S) -> float:
    """Covariance of the means over two windows of which the second begins `apart` >= 1 windows later."""
    ratio = time_constant_s / window_s
    decay = exp(-1 / ratio)
    return ratio**2 * (1 - decay) ** 2 * decay ** (apart - 1)


def expected_scatter(window_s: float = WINDOW_S, time_constant_s: float = TIME_CONSTANT_S, parts: int = PARTS) -> float:
    """Expected sample variance of the means of `parts` windows in a row."""
    pairs = sum((parts - k) * covariance_of_means(k, window_s, time_constant_s) for k in range(1, parts))
    return variance_of_mean(window_s, time_constant_s) - 2 * pairs / (parts * (parts - 1))
