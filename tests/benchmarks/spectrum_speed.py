"""Welch's method on 10 million samples, fed in blocks, beside scipy.signal.welch on the whole series at once.

Both sides get the same series in memory and the same segments: 4096 rows, Hann, overlapping by half, less their mean.
SciPy transforms float64; ours is the default, single precision, and the option for double stands beside it. Turns are
taken alternately and the least of each side counts. Peak memory is what Python and NumPy allocate (tracemalloc) beyond
the series itself, which a log would give in blocks.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable

import numpy as np
from compare import Row, row
from scipy.signal import welch

from imuarray.characterise.spectrum import Precision, Welch

ROWS, BLOCK, SEGMENT, RATE_HZ = 10_000_000, 1 << 16, 4096, 400.0
TURNS = 5


def rows() -> list[Row]:
    """Samples per second and peak memory."""
    series = np.random.default_rng(1).normal(size=ROWS)
    single, double, peer = (
        lambda: streamed(series, "single"),
        lambda: streamed(series, "double"),
        lambda: welch(series, RATE_HZ, nperseg=SEGMENT),
    )
    times = [[seconds(call) for call in (single, double, peer)] for _ in range(TURNS)]
    speeds = [ROWS / min(column) / 1e6 for column in zip(*times, strict=True)]
    name = "Welch spectrum of 1e7 samples against scipy.signal.welch"
    return [
        row(f"{name}, single precision", speeds[0], speeds[2], "1e6 samples/s", 4.0, "higher"),
        row(f"{name}, double precision", speeds[1], speeds[2], "1e6 samples/s", 2.0, "higher"),
        row(f"{name}, peak memory", peak_mb(single), peak_mb(peer), "MB", 1 / 5, "lower"),
    ]


def streamed(series: np.ndarray, precision: Precision) -> None:
    """Ours, a block at a time."""
    estimate = Welch(RATE_HZ, SEGMENT, 1, precision)
    for start in range(0, len(series), BLOCK):
        estimate.update(series[start : start + BLOCK])
    estimate.result()


def seconds(call: Callable[[], object]) -> float:
    """Time on the wall of one call."""
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


def peak_mb(call: Callable[[], object]) -> float:
    """The most memory that one call allocates."""
    tracemalloc.start()
    call()
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return most / 1e6


if __name__ == "__main__":
    for found in rows():
        print(found)
