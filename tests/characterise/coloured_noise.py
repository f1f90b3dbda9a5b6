"""Noise of several colours."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter


def coloured(kind: str, rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """White noise, first-order noise with a corner at bin 8 of 512 rows, or noise of density 1 / f."""
    white = rng.normal(size=shape)
    if kind == "first order":
        return lfilter([1.0], [1.0, -0.9], white, axis=0)
    if kind == "1/f":
        bins = np.fft.rfft(white, axis=0)
        return np.fft.irfft(bins / np.sqrt(np.maximum(np.arange(len(bins)), 1))[:, np.newaxis], axis=0)
    return white
