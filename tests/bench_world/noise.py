"""Noise whose spectrum is a power of the frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.bench_world.chips import Array


@dataclass(frozen=True)
class PowerLaw:
    """A one-sided spectrum `density` (corner_hz / f) ** `exponent`, in units²/Hz."""

    exponent: float
    density: float
    corner_hz: float


def draw_noise(law: PowerLaw, rows: int, rate_hz: float, stream: np.random.Generator) -> Array:
    """Return noise (rows,) without its mean, cut out of a record at least four times as long, so that it also has
    frequencies below that of its own length.
    """
    padded = int(2 ** np.ceil(np.log2(4 * rows)))
    frequency_hz = np.fft.rfftfreq(padded, 1 / rate_hz)
    frequency_hz[0] = frequency_hz[1]
    density = law.density * (law.corner_hz / frequency_hz) ** law.exponent
    real = stream.normal(size=len(density))
    spectrum = (real + 1j * stream.normal(size=len(density))) * np.sqrt(density * rate_hz * padded / 4)
    spectrum[0] = 0
    noise = np.fft.irfft(spectrum, padded)[:rows]
    return np.asarray(noise - noise.mean())
