"""Low-pass filter of second order, and first-order lag."""

from __future__ import annotations

from math import exp

import numpy as np

from tests.bench_world.chips import Array


def low_pass(values: Array, rate_hz: float, cutoff_hz: float | None) -> Array:
    """Return `values` (n, k) after a Butterworth low-pass of second order (BMA-92), by the bilinear transform, that
    was in its steady state at the first row. No cutoff, or one near half the rate, changes nothing.
    """
    if not cutoff_hz or cutoff_hz >= 0.49 * rate_hz:
        return values
    start, rows = values[:1], len(values)
    padded = int(2 ** np.ceil(np.log2(rows + int(8 * rate_hz / cutoff_hz))))
    delay = np.exp(-2j * np.pi * np.arange(padded // 2 + 1) / padded)
    warp = np.tan(np.pi * cutoff_hz / rate_hz)
    scale = 1 + np.sqrt(2) * warp + warp * warp
    recursion = (
        1 + 2 * (warp * warp - 1) / scale * delay + (1 - np.sqrt(2) * warp + warp * warp) / scale * delay * delay
    )
    response = warp * warp / scale * (1 + delay) ** 2 / recursion
    spectrum = np.fft.rfft(values - start, padded, axis=0) * response[:, None]
    return np.asarray(start + np.fft.irfft(spectrum, padded, axis=0)[:rows])


def lag(values: Array, step_s: float, time_constant_s: float) -> Array:
    """Return `values` (n,) after a first-order lag that was in its steady state at the first row."""
    share = 1 - exp(-step_s / time_constant_s)
    state = float(values[0])
    follower = []
    for value in values.tolist():
        state += share * (value - state)
        follower.append(state)
    return np.array(follower)
