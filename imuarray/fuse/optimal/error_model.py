"""What is known beforehand of the errors of an array: the model that `Optimal` weighs its readings by.

A reading of axis i of a sensor, along that axis, in SI::

    y = (s + d) . u + bias + drift + c + (slope + common slope) (T - T_bias) + noise

u is the specific force or angular rate at the sensor's place, s the axis's calibrated direction and d what is wrong
with it: scale along s, misalignment across it. c and the common slope belong to a design: all its sensors share them
along the same own axis, whichever way that points in the box (paper, section 2.1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from imuarray.errors import FusionError
from imuarray.fuse.axes import Axis

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class AxisErrors:
    """Standard deviations of one axis's errors, in m/s2 or rad/s.

    `noise` of a single reading and its `correlation` with the next one; `bias`: what a calibration left and what
    changed since, constant; `drift`: a first-order Gauss-Markov process of `drift_time_constant_s` (infinite: a
    constant); `slope_per_degc` away from `bias_degc`, the temperature at which the bias holds (None: the first that is
    told); `response`: of each component of d, a share; `timing_s` of the time at which a reading holds.
    `shares_wander`, `shares_slope`: whether it has what its design has in common (`DesignErrors`).
    """

    noise: float
    correlation: float = 0.0
    bias: float = 0.0
    drift: float = 0.0
    drift_time_constant_s: float = 600.0
    slope_per_degc: float = 0.0
    response: float = 0.0
    bias_degc: float | None = None
    timing_s: float = 0.0
    shares_wander: bool = True
    shares_slope: bool = True

    def __post_init__(self) -> None:
        """FusionError for what no axis can have."""
        spreads = (self.bias, self.drift, self.slope_per_degc, self.response, self.timing_s)
        if not (0 < self.noise < np.inf and all(0 <= spread < np.inf for spread in spreads)):
            raise FusionError(f"error model: noise {self.noise:g}, spreads {spreads}: positive and finite are wanted")
        if not (abs(self.correlation) < 1 and self.drift_time_constant_s > 0):
            raise FusionError(
                f"error model: correlation {self.correlation:g}, time constant {self.drift_time_constant_s:g} s: within"
                " -1 to 1, and positive, are wanted"
            )

    @property
    def noise_of_means(self) -> float:
        """Standard deviation that white noise would need for means over many readings to scatter as these do:
        first-order correlation r widens their variance by (1 + r) / (1 - r).
        """
        return float(self.noise * np.sqrt((1 + self.correlation) / (1 - self.correlation)))


@dataclass(frozen=True)
class DesignErrors:
    """Standard deviations of what the sensors of one design share along one of their own axes.

    `common`: a Gauss-Markov process of `common_time_constant_s` (infinite: a constant); `slope_per_degc`.
    """

    common: float = 0.0
    common_time_constant_s: float = 600.0
    slope_per_degc: float = 0.0

    def __post_init__(self) -> None:
        """FusionError for what no design can have."""
        if not (0 <= self.common < np.inf and 0 <= self.slope_per_degc < np.inf and self.common_time_constant_s > 0):
            raise FusionError(f"error model: {self}: spreads of at least 0 and a positive time constant are wanted")


@dataclass(frozen=True)
class ErrorModel:
    """The errors of every axis, by sensor and index of the axis, and of every design, by chip and index.

    `bias_covariances` (3, 3), by sensor, come on top of the axes' own `bias`: what a calibration left of the three
    axes together. `response_covariances` (9, 9), by sensor, row by row, come in place of the axes' own `response`.
    """

    axes: Mapping[tuple[str, int], AxisErrors]
    designs: Mapping[tuple[str, int], DesignErrors] = field(default_factory=lambda: MappingProxyType({}))
    bias_covariances: Mapping[str, Floats] = field(default_factory=lambda: MappingProxyType({}))
    response_covariances: Mapping[str, Floats] = field(default_factory=lambda: MappingProxyType({}))

    def of(self, axes: Sequence[Axis]) -> list[AxisErrors]:
        """The errors of these axes, in their order; FusionError for one that is not in the model."""
        for axis in axes:
            if (axis.sensor, axis.index) not in self.axes:
                raise FusionError(f"sensor {axis.sensor} axis {'xyz'[axis.index]}: the error model does not know it")
        return [self.axes[axis.sensor, axis.index] for axis in axes]
