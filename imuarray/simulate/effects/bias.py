"""Biases: constant, different from boot to boot, and wandering."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Booleans, Integers
from imuarray.simulate.effect import Effect, per_axis, scalar
from imuarray.simulate.processes import gauss_markov, random_walk
from imuarray.simulate.signal import Analog, Place, Triple, per_row
from imuarray.simulate.streams import CHUNK


@dataclass(frozen=True)
class Bias(Effect):
    """y = x + offset, the same in every run, or in every run except the first `from_boot` ones (for example after a
    fall).

    `offset` in the sensor's unit: zero-g and zero-rate levels of BMA-112, BMA-113, ADX-60, ADX-61 and L3G-70; the
    paper's Tables 3 and 4 list those of its 27 axes. The part that changes from boot to boot is `turn_on_bias`, the
    part that changes with temperature is `thermal_bias`. In data: the mean of two opposite faces.
    """

    name: ClassVar[str] = "bias"
    meaning: ClassVar[str] = "the reading differs from zero at zero input"
    offset: Triple = per_axis(suffix="_{u}")
    from_boot: float = scalar(0.0, low=0.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Shift the signal."""
        if at.streams.boot < self.from_boot or not any(self.offset):
            return analog
        return replace(analog, value=analog.value + per_row(self.offset, analog.value))


@dataclass(frozen=True)
class TurnOnBias(Effect):
    """y = x + b, b ~ N(0, rms^2) drawn for each axis once a boot.

    `rms` in the sensor's unit. The spread of the means of 15 runs in the left half of the paper's Table 11: 2.4 to 7.7
    times the in-run variation for its gyroscopes. In data: run means that differ by more than the variation within runs
    explains.
    """

    name: ClassVar[str] = "turn_on_bias"
    meaning: ClassVar[str] = "the bias changes each time the sensor is switched on"
    rms: Triple = per_axis(suffix="_{u}", low=0.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the bias of this boot to the value."""
        if self.rms == (0.0, 0.0, 0.0):
            return analog
        x, y, z = (np.array(self.rms) * at.boot_generator(self.name).standard_normal(3)).tolist()
        return replace(analog, value=analog.value + per_row((x, y, z), analog.value))


@dataclass(frozen=True)
class BistableBias(Effect):
    """y = x + offset for a whole run, in a run with this probability, all three axes together.

    `offset` in the sensor's unit. At each power-on, the paper's Gyro3 has one of two sets of biases that differ by
    (-13, 6, -2) LSB (Table 7). In data: run means in two groups, the same ones on all axes.
    """

    name: ClassVar[str] = "bistable_bias"
    meaning: ClassVar[str] = "after some boots the bias is different"
    offset: Triple = per_axis(suffix="_{u}")
    probability: float = scalar(0.0, low=0.0, high=1.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the offset to the value."""
        if at.boot_generator(self.name).random() >= self.probability:
            return analog
        return replace(analog, value=analog.value + per_row(self.offset, analog.value))


_TIME_CONSTANT_RATIO = 4.0
"""Ratio of neighbouring time constants of flicker noise: the sum is 1/f within 1 % from the fastest to the slowest."""


@dataclass(frozen=True)
class BiasInstability(Effect):
    """y = x + b(t), b first-order Gauss-Markov: stationary, N(0, rms^2), correlation exp(-|t| / time_constant).

    `rms` in the sensor's unit, `time_constant_s` in s; axes are independent. It represents the in-run variation in the
    paper's Table 5 and in the right half of its Table 11. In data: the Allan deviation departs from its slope of -1/2;
    that of the process alone has a peak of 0.62 rms at 1.9 time constants (IEEE Std 952, Annex C).

    With `fastest_time_constant_s` it is flicker noise (1/f): n processes of variance rms^2 / n with time constants from
    `time_constant_s` down to `fastest_time_constant_s`, each a factor of 4 below the previous one. In data: an Allan
    deviation that is flat, rms / sqrt(n), between the fastest and the slowest (IEEE Std 952, Annex C, bias
    instability). 0: a single process.
    """

    name: ClassVar[str] = "bias_instability"
    meaning: ClassVar[str] = "the bias wanders within bounds"
    rms: Triple = per_axis(suffix="_{u}", low=0.0)
    time_constant_s: float = scalar(100.0, low=1e-3, high=1e9)
    fastest_time_constant_s: float = scalar(0.0, low=0.0, high=1e9)

    @property
    def time_constants_s(self) -> tuple[float, ...]:
        """Return the time constants of its processes, the slowest first."""
        fastest_s = max(self.fastest_time_constant_s, 1e-3)
        octaves = (
            math.log(self.time_constant_s / fastest_s, _TIME_CONSTANT_RATIO) if self.fastest_time_constant_s else 0.0
        )
        return tuple(
            self.time_constant_s / _TIME_CONSTANT_RATIO**step for step in range(1 + max(0, math.floor(octaves + 1e-9)))
        )

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the processes to the value."""
        if self.rms == (0.0, 0.0, 0.0):
            return analog
        value, times_s = analog.value, self.time_constants_s
        x, y, z = (size / math.sqrt(len(times_s)) for size in self.rms)
        for number, time_s in enumerate(times_s, 1 if len(times_s) > 1 else 0):
            value = gauss_markov(time_s, at, self.name, scale=(x, y, z), number=number).added_to(value, analog.first)
        return replace(analog, value=value)


@dataclass(frozen=True)
class RandomWalk(Effect):
    """y = x + b(t), a Wiener process: b = 0 at the first row, b(t + s) - b(t) ~ N(0, density^2 s).

    `density` in the sensor's unit per root second; axes are independent. In data: an Allan deviation of slope +1/2,
    density sqrt(tau / 3) (IEEE Std 952, Annex C: rate random walk).
    """

    name: ClassVar[str] = "random_walk"
    meaning: ClassVar[str] = "the bias wanders without bounds"
    density: Triple = per_axis(suffix="_{u}_per_sqrt_s", low=0.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the random walk to the value."""
        if self.density == (0.0, 0.0, 0.0):
            return analog
        process = random_walk(at, self.name, self.density)
        return replace(analog, value=process.added_to(analog.value, analog.first))


@dataclass(frozen=True)
class PopcornNoise(Effect):
    """y = x + amplitude * (u - high_share), where u of each axis jumps between 0 and 1: a random telegraph signal.

    `amplitude` is the distance from the lower to the upper level in the sensor's unit (may be negative),
    `switches_per_s` the mean number of jumps per second, `high_share` the share of the time at the upper level. (The
    share need not be one half: a trap may capture a charge quickly and hold it for a long time.) Times at either level
    are exponentially distributed; axes are independent. Mean 0, autocovariance amplitude^2 p (1 - p)
    exp(-switches_per_s |t| / (2 p (1 - p))), p the share (Machlup, J. Appl. Phys. 25, 1954). In data: two peaks in the
    histogram of smoothed readings, with areas in proportion to their shares; the spectrum is that of Gauss-Markov
    noise.

    The level is drawn again, independent of its previous value, at the instants of a Poisson process. The number of
    these instants in each chunk of rows, and the level after the last one, come from separate random streams. The level
    at the beginning of a chunk therefore follows from the chunks before it.
    """

    name: ClassVar[str] = "popcorn_noise"
    meaning: ClassVar[str] = "the bias jumps between two levels"
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
    """Return (3,) the level after chunks (c, 3): that of the last chunk with a draw, or else the level before them."""
    is_drawn, levels = np.vstack([np.ones((1, 3), bool), draws > 0]), np.vstack([level, last])
    return np.asarray(levels[len(is_drawn) - 1 - is_drawn[::-1].argmax(axis=0), np.arange(3)])


def _levels(
    places: np.random.Generator, draws: Integers, high_share: float, begin: Booleans, last: Booleans
) -> Booleans:
    """Return (CHUNK, 3) the level of each row. Each axis has its number of `draws`, at uniformly distributed rows."""
    columns = []
    for axis, count in enumerate(draws.tolist()):
        rows = np.sort(places.integers(CHUNK, size=count))
        drawn = np.concatenate([begin[axis : axis + 1], places.random(count) < high_share])
        if count:
            drawn[-1] = last[axis]
        columns.append(np.repeat(drawn, np.diff(rows, prepend=0, append=CHUNK)))
    return np.stack(columns, axis=1)


@dataclass(frozen=True)
class CommonMode(Effect):
    """y = x + rms c(t), c one Gauss-Markov process for all sensors of a chip design, or for all sensors that name the
    same `group`, along the own axes of each sensor.

    `rms` in the sensor's unit, `time_constant_s` in s: correlation exp(-|t| / time_constant). `axes_shared` is the
    share of the variance that the three axes have in common (0: independent; 1: one process, such as a supply voltage
    that affects all axes). The effect describes the influence of supply and environment that is the same for all units
    of one design, which anti-parallel mounting cancels (the paper's Section 2.1), or for all sensors on one supply.
    Sensors share the process row by row and must therefore have equal rates. In data: slow drift that correlates
    between sensors along their own axes, not along the box axes.
    """

    name: ClassVar[str] = "common_mode"
    meaning: ClassVar[str] = "the biases of all units of one design, or of one group, wander together"
    rms: Triple = per_axis(suffix="_{u}", low=0.0)
    time_constant_s: float = scalar(100.0, low=1e-3, high=1e9)
    axes_shared: float = scalar(0.0, low=0.0, high=1.0)
    group: str = field(default="")

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the common process to the value."""
        if self.rms == (0.0, 0.0, 0.0):
            return analog
        sharing = self.group or at.sensor.chip
        value = analog.value
        if self.axes_shared < 1:
            x, y, z = (rms * math.sqrt(1 - self.axes_shared) for rms in self.rms)
            value = gauss_markov(self.time_constant_s, at, self.name, sharing, (x, y, z)).added_to(value, analog.first)
        if self.axes_shared > 0:
            single = gauss_markov(self.time_constant_s, at, self.name, f"{sharing}, all axes")
            course = single.rows(analog.first, analog.first + len(value), value.dtype)[:, :1]
            value = value + course * np.asarray([rms * math.sqrt(self.axes_shared) for rms in self.rms], value.dtype)
        return replace(analog, value=value)
