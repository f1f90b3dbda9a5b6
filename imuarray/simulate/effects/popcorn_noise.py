"""`popcorn_noise`: the bias jumps to and fro between two levels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from imuarray.simulate.effect import Effect, per_axis, require, scalar
from imuarray.simulate.signal import Analog, Integers, Place, Triple, per_row
from imuarray.simulate.streams import CHUNK


@dataclass(frozen=True)
class PopcornNoise(Effect):
    """y = x +- amplitude / 2, the sign of each axis switching at the instants of a Poisson process: a random telegraph.

    `amplitude` is the height of a jump in the sensor's unit, `switches_per_s` how many there are on average; axes are
    independent. Mean 0, autocovariance (amplitude / 2)^2 exp(-2 switches_per_s |t|) (Machlup, J. Appl. Phys. 25, 1954).
    In data: two humps in the histogram of smoothed readings; its spectrum is that of Gauss-Markov noise.

    How often an axis switches in each chunk of rows comes from one stream, where in it from the chunk's own: the sign
    that a chunk begins with follows from the numbers of switches before it.
    """

    name: ClassVar[str] = "popcorn_noise"
    amplitude: Triple = per_axis(suffix="_{u}")
    switches_per_s: float = scalar(0.0)

    def __post_init__(self) -> None:
        """ValueError for less than 0 or more than a million switches a second."""
        super().__post_init__()
        require("switches_per_s", self.switches_per_s, 0.0, 1e6)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Adds to the value."""
        if self.amplitude == (0.0, 0.0, 0.0):
            return analog
        high = self._high(analog.first, analog.first + len(analog.value), at)
        level = (high - 0.5).astype(analog.value.dtype)
        return replace(analog, value=analog.value + level * per_row(self.amplitude, level))

    def _high(self, first: int, stop: int, at: Place) -> Integers:
        """(stop - first, 3): 1 where an axis is at its upper level, else 0."""
        begin, end = first // CHUNK, -(-stop // CHUNK)
        mean = self.switches_per_s * CHUNK / at.rows_per_s
        switches = at.stream(self.name, "numbers").generator().poisson(mean, (end, 3))
        before = at.boot_generator(self.name).integers(2, size=3) + switches[:begin].sum(axis=0)
        parts = []
        for chunk in range(begin, end):
            parts.append(before + _switched(at.stream(self.name, "places").generator(chunk), switches[chunk]))
            before = before + switches[chunk]
        return np.asarray(np.concatenate(parts)[first - begin * CHUNK : stop - begin * CHUNK] % 2)


def _switched(places: np.random.Generator, switches: npt.NDArray[np.int64]) -> Integers:
    """(CHUNK, 3): how often each axis has switched up to each row of a chunk, all rows being as likely."""
    rows = [np.bincount(places.integers(CHUNK, size=count), minlength=CHUNK) for count in switches]
    return np.cumsum(np.stack(rows, axis=1), axis=0)
