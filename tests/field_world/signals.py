"""Signals on uniform grids: noise in a band, flicker, a lag, interpolation, a smooth step."""

from __future__ import annotations

import numpy as np
from scipy import signal

FLICKER_TIMES_S = (0.7, 2.8, 11.0, 45.0, 180.0, 720.0)
"""Time constants of the processes whose sum wanders like 1/f."""


def band_noise(g, n, fs, lo, hi, rms, c=None, order=2):
    """Return `n` values (`c` columns) of noise between `lo` and `hi` Hz with this rms; without `lo`, it is low-pass."""
    x = g.standard_normal(n if c is None else (n, c))
    hi = min(hi, 0.47 * fs)
    if lo:
        sos = signal.butter(order, [lo, hi], "band", fs=fs, output="sos")
    else:
        sos = signal.butter(order, hi, "low", fs=fs, output="sos")
    y = signal.sosfiltfilt(sos, x, axis=0, padlen=0)
    return y * (rms / (np.std(y, axis=0) + 1e-30))


def lag(x, fs, tau):
    """Return `x` behind a lag of first order with the time constant `tau` (s), which starts in equilibrium."""
    a = np.exp(-1.0 / (fs * tau))
    y, _ = signal.lfilter([1 - a], [1, -a], x, axis=0, zi=a * x[:1])
    return y


def flicker(g, n, fs, level, c=3):
    """Return `n` rows of a wander like 1/f, whose Allan deviation has its floor near `level`."""
    y = np.zeros((n, c))
    for tau in FLICKER_TIMES_S:
        a = np.exp(-1.0 / (fs * tau))
        s = 0.85 * level
        w = g.standard_normal((n, c)) * s * np.sqrt(1 - a * a)
        w[0] = g.standard_normal(c) * s
        y += signal.lfilter([1.0], [1, -a], w, axis=0)
    return y


def interpolate(x, t0, fs, t):
    """Return `x`, which is given on a grid that begins at `t0`, at the instants `t`, linearly between its values."""
    p = (t - t0) * fs
    i = np.clip(p.astype(np.int64), 0, len(x) - 2)
    u = p - i
    if x.ndim == 2:
        u = u[:, None]
    return x[i] * (1 - u) + x[i + 1] * u


def smooth_step(u):
    """Return the step of least jerk: 0 up to `u` = 0, 1 from `u` = 1 on."""
    u = np.clip(u, 0, 1)
    return u**3 * (10 - 15 * u + 6 * u * u)
