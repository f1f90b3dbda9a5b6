"""A track of the box's motion without the noise of the instrument that recorded it.

A simulated sensor that follows a recorded track would measure the noise of the track as motion, which the real sensor
did not. The noise is white and is estimated from stretches at rest; it is reduced in the spectrum of each stretch in
between.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from imuarray.arrays import Floats, Integers, Reals

_ENDS, _BINS, _ABOVE_NOISE = 5, 25, 1.5
"""Number of rows that are averaged for either end of a stretch; number of neighbouring bins of a spectrum that are
averaged; and the multiple of the noise power above which their mean power is taken to be motion. The mean power of
noise alone rarely exceeds this multiple.
"""

_NEAR_BINS = 3
"""Number of nearest bins whose mean power has to exceed the noise, too: a pendulum moves at a single frequency, and the
noise of the bins around it is no motion.
"""

_FEWEST_ROWS = 64
"""Minimum number of rows of a stretch, both for estimating the noise and for reducing it."""

_EVEN = 1.5
"""Largest ratio of an interval of a stretch to its median interval. If one is longer, rows are not evenly spaced and
the noise is not reduced.
"""


def without_track_noise(time_ns: Integers, columns: Reals, rests: Sequence[tuple[int, int]]) -> Reals:
    """Return the columns (n, 6) of a track, force and rate of the box, with reduced noise between the `rests`,
    stretches in ns from which the noise is estimated. Without rests, and in stretches with missing rows, the columns
    are unchanged.

    Each frequency keeps the share of its power that exceeds the noise (Wiener filter). The regression of a sensor on
    the result gives its response to the motion; on a track with noise, it would be too small by the share of the noise.
    """
    edges = np.searchsorted(time_ns, np.array(rests, np.int64).reshape(-1, 2))
    still = [columns[first:stop] for first, stop in edges.tolist() if stop - first >= _FEWEST_ROWS]
    if not still:
        return columns
    # White noise of variance 1 has second differences of variance 6.
    variance = np.median([np.diff(part, n=2, axis=0).var(axis=0) / 6 for part in still], axis=0)
    reduced = np.array(columns, float)
    bounds = np.concatenate([[0], edges.ravel(), [len(time_ns)]])
    for first, stop in zip(bounds[::2].tolist(), bounds[1::2].tolist(), strict=True):
        intervals = np.diff(time_ns[first:stop])
        if stop - first >= _FEWEST_ROWS and intervals.max() <= _EVEN * np.median(intervals):
            for triad in (slice(0, 3), slice(3, 6)):
                reduced[first:stop, triad] = reduce_noise(columns[first:stop, triad], variance[triad])
    return reduced


def reduce_noise(values: Reals, variance: Reals, *, keeps_power: bool = False) -> Floats:
    """Return values (w, 3) with noise of this variance reduced: (3,) if the noise is white, or (w // 2 + 1, 3) as the
    variance that white noise of the same density at each frequency would have. A straight line between the ends is
    subtracted first. Of the residual, each frequency keeps the share of its amplitude by which its power exceeds that
    of the noise (Wiener filter); with `keeps_power` it keeps the square root of that share, so that the result has the
    variance of the motion (spectral subtraction).

    This is done along the principal axes. If the box rotates about a single axis that is oblique to its own, no noise
    about the other two principal axes may remain, because it would make the axes of simulated sensors distinguishable.
    """
    count = len(values)
    ends = values[:_ENDS].mean(axis=0), values[-_ENDS:].mean(axis=0)
    line = ends[0] + np.linspace(0, 1, count)[:, None] * (ends[1] - ends[0])
    moved = values - line
    principal = np.linalg.eigh(moved.T @ moved)[1]
    spectrum = np.fft.rfft(moved @ principal, axis=0)
    squares = np.abs(spectrum) ** 2 / count
    wide, near = (uniform_filter1d(squares, bins, axis=0, mode="nearest") for bins in (_BINS, _NEAR_BINS))
    power = np.minimum(wide, near)
    noise = variance @ principal**2
    share = np.where(power > _ABOVE_NOISE * noise, 1 - noise / np.maximum(power, 1e-30), 0.0)
    kept = np.sqrt(share) if keeps_power else share
    return np.asarray(line + np.fft.irfft(kept * spectrum, count, axis=0) @ principal.T)
