"""`popcorn_noise`: the bias jumps between two levels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Booleans, Integers
from imuarray.simulate.effect import Effect, per_axis, scalar
from imuarray.simulate.signal import Analog, Place, Triple, per_row
from imuarray.simulate.streams import CHUNK


@dataclass(frozen=True)
class PopcornNoise(Effect):
    """y = x + amplitude * (u - high_share), where u of each axis jumps between 0 and 1: a random telegraph signal.

    `amplitude` is the distance from the lower to the upper level in the sensor's unit (may be negative),
    `switches_per_s` the mean number of jumps per second, `high_share` the share of the time at the upper level. (A trap
    may hold a charge for a long time, however soon it captures one.) Times at either level are exponential, axes are
    independent. Mean 0, autocovariance amplitude^2 p (1 - p) exp(-switches_per_s |t| / (2 p (1 - p))), p the share
    (Machlup, J. Appl. Phys. 25, 1954). In data: two peaks in the histogram of smoothed readings, sized by their shares;
    its spectrum is that of Gauss-Markov noise.

    The level is drawn again, independent of its previous value, at the instants of a Poisson process. The number of
    these instants in each chunk of rows, and the level after the last one, come from separate random streams. The level
    at the beginning of a chunk therefore follows from the chunks before it.
    """

    name: ClassVar[str] = "popcorn_noise"
    amplitude: Triple = per_axis(suffix="_{u}")
    switches_per_s: float = scalar(0.0, low=0.0, high=1e6)
    high_share: float = scalar(0.5, low=0.01, high=0.99)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the telegraph signal to the value."""
        if self.amplitude == (0.0, 0.0, 0.0):
            return analog
        high = self._high(analog.first, analog.first + len(analog.value), at)
        level = (high - self.high_share).astype(analog.value.dtype)
        return replace(analog, value=analog.value + level * per_row(self.amplitude, level))

    def _high(self, first: int, stop: int, at: Place) -> Booleans:
        """Return (stop - first, 3) whether an axis is at its upper level."""
        begin, end = first // CHUNK, -(-stop // CHUNK)
        draws_per_s = self.switches_per_s / (2 * self.high_share * (1 - self.high_share))
        draws = at.stream(self.name, "numbers").generator().poisson(draws_per_s * CHUNK / at.rows_per_s, (end, 3))
        last = at.stream(self.name, "lasts").generator().random((end, 3)) < self.high_share
        level = _last_level(at.boot_generator(self.name).random(3) < self.high_share, draws[:begin], last[:begin])
        parts = []
        for chunk in range(begin, end):
            places = at.stream(self.name, "places").generator(chunk)
            parts.append(_levels(places, draws[chunk], self.high_share, level, last[chunk]))
            level = _last_level(level, draws[chunk : chunk + 1], last[chunk : chunk + 1])
        return np.concatenate(parts)[first - begin * CHUNK : stop - begin * CHUNK]


def _last_level(level: Booleans, draws: Integers, last: Booleans) -> Booleans:
    """Return (3,) the level after chunks (c, 3): that of the last chunk with a draw, or the previous level if there is
    none.
    """
    is_drawn, levels = np.vstack([np.ones((1, 3), bool), draws > 0]), np.vstack([level, last])
    return np.asarray(levels[len(is_drawn) - 1 - is_drawn[::-1].argmax(axis=0), np.arange(3)])


def _levels(
    places: np.random.Generator, draws: Integers, high_share: float, begin: Booleans, last: Booleans
) -> Booleans:
    """Return (CHUNK, 3) the level of each row. Each axis has a given number of `draws`, at rows that are uniformly
    distributed.
    """
    columns = []
    for axis, count in enumerate(draws.tolist()):
        rows = np.sort(places.integers(CHUNK, size=count))
        drawn = np.concatenate([begin[axis : axis + 1], places.random(count) < high_share])
        if count:
            drawn[-1] = last[axis]
        columns.append(np.repeat(drawn, np.diff(rows, prepend=0, append=CHUNK)))
    return np.stack(columns, axis=1)
