"""Changes of a bias after its calibration: with temperature, from one switch-on to the next, and during operation; the
spectral lines of a sensor's noise; and the provenance of each figure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.calibrate.entries import Number, Sizes, Triple, number, numbers, several, tables, text, whole

BIAS = "bias"
BIAS_OR_SCALE = "bias or scale"
"""Meaning of a slope on an axis that carried gravity while it was heated in one orientation only, which does not
distinguish the two (section 5.2.5 of the paper leaves it open).
"""

THERMOMETERS = ("barometer", "reference", "chip", "relative")
"""Kinds of thermometers: the log's barometer, its `/reference`, a chip's thermometer with a zero (BMA180: BMA-63) and a
chip's thermometer without one (L3G4200D: L3G-60).
"""


NotNegative = Annotated[float, number(0.0)]
Share = Annotated[float, number(0.0, 1.0)]
Runs = Annotated[tuple[int, ...], several(whole)]
"""Numbers of runs."""


@dataclass(frozen=True)
class Thermal:
    """The change of one sensor's counts with temperature: ``slope (T - reference) + quadratic (T - reference)^2`` with
    T the temperature of the `thermometer` after a first-order lag of `lag_s`.

    Arrays are (3,), one figure per sensor axis, except `lag_interval_s` (2,), the 95 % likelihood interval. `meaning`
    states what the slope of an axis is: "bias", or "bias or scale" if one orientation does not distinguish them.
    `scale_slope_per_degc` is relative to the scale factor, nan without two orientations. The degrees of a "relative"
    thermometer have no zero and are comparable with readings of the same thermometer only. The standard error of the
    quadratic term is known if a curvature was fitted, the term itself if it was significant; the slope is the one at
    the reference in both cases.
    """

    slope_lsb_per_degc: Triple
    slope_sem_lsb_per_degc: Sizes
    reference_degc: Number
    meaning: Annotated[tuple[str, ...], several(text(BIAS, BIAS_OR_SCALE), 3)]
    thermometer: Annotated[str, text(*THERMOMETERS)]
    lag_s: NotNegative = 0.0
    lag_interval_s: Annotated[Floats | None, numbers(2, lowest=0.0)] = None
    quadratic_lsb_per_degc2: Triple | None = None
    scale_slope_per_degc: Annotated[Floats | None, numbers(3, unknown=True)] = None
    scale_slope_sem_per_degc: Annotated[Floats | None, numbers(3, lowest=0.0, unknown=True)] = None
    quadratic_sem_lsb_per_degc2: Sizes | None = None

    @property
    def significant_lag_s(self) -> float:
        """The lag, or 0 if its interval includes 0; a lag without an interval counts as significant."""
        return self.lag_s if self.lag_interval_s is None or self.lag_interval_s[0] > 0 else 0.0

    def bias_change_lsb(self, to_degc: npt.ArrayLike, from_degc: float) -> Floats:
        """Return the bias change (3,) or (n, 3) in counts between lagged temperatures; 0 if the slope may be scale."""
        is_bias = np.array([meaning == BIAS for meaning in self.meaning], float)
        return is_bias * (self._counts(np.asarray(to_degc, float)) - self._counts(np.asarray(from_degc, float)))

    def _counts(self, degc: Floats) -> Floats:
        rise = (degc - self.reference_degc)[..., None]
        curve = 0.0 if self.quadratic_lsb_per_degc2 is None else self.quadratic_lsb_per_degc2
        return np.asarray(rise * self.slope_lsb_per_degc + rise**2 * curve)


@dataclass(frozen=True)
class BiasState:
    """One of the biases (3,) with which a sensor starts, in counts; the share of the runs in it, and their numbers."""

    bias_lsb: Triple
    share: Share
    runs: Runs = ()


@dataclass(frozen=True)
class TurnOn:
    """The change of a bias from run to run, per sensor axis (3,), in counts.

    `rms_lsb` is the standard deviation from run to run about the run's state, corrected for the scatter within runs and
    for temperature, with its standard error; `spread_lsb` is the same including the scatter within runs, as in a run
    mean. `p_value` is that of no change about the states, nan if the scatter within runs is not known (`rms_lsb` then
    includes it). `runs` is the number of runs used, `apart` the numbers of those with a start-up fault. `states` has
    one entry for a sensor with a single state. `gravity_lsb` is the gravity assumed in the runs' pose (accelerometers).
    """

    rms_lsb: Sizes
    rms_sem_lsb: Sizes
    spread_lsb: Sizes
    p_value: Annotated[Floats, numbers(3, lowest=0.0, highest=1.0, unknown=True)]
    runs: Annotated[int, whole]
    states: Annotated[tuple[BiasState, ...], tables(BiasState)] = ()
    apart: Runs = ()
    gravity_lsb: Triple | None = None


@dataclass(frozen=True)
class Drift:
    """The drift of a bias during operation, per axis (3,), in counts: a first-order Gauss-Markov process with the
    autocorrelation ``rms^2 exp(-t / time_constant_s)``; changes with temperature are removed if slopes are known.

    `rms_lsb` is the most likely value (0 without drift), `rms_sem_lsb` its standard error and `rms_upper_lsb` its 95 %
    upper bound. The three axes share one time constant; `time_constant_interval_s` (2,) is its 95 % interval, nan at an
    end that the log does not determine. Drift slower than `span_s`, the longest stretch, is not included.
    """

    rms_lsb: Sizes
    rms_sem_lsb: Sizes
    time_constant_s: Annotated[float, number(1e-6)]
    rms_upper_lsb: Sizes | None = None
    time_constant_interval_s: Annotated[Floats | None, numbers(2, lowest=0.0, unknown=True)] = None
    span_s: NotNegative | None = None


@dataclass(frozen=True)
class NoiseLine:
    """A periodic part of one axis's noise (`axis` "x", "y" or "z"): frequency and amplitude of its sine, with standard
    errors if known, and its `share` of the variance of single readings. `range_hz` (2,) is the lowest and highest
    frequency of a line that wandered, else None.
    """

    axis: Annotated[str, text("x", "y", "z")]
    frequency_hz: NotNegative
    amplitude_lsb: NotNegative
    share: Share
    frequency_sem_hz: NotNegative | None = None
    amplitude_sem_lsb: NotNegative | None = None
    range_hz: Annotated[Floats | None, numbers(2, lowest=0.0)] = None


@dataclass(frozen=True)
class Provenance:
    """Origin of a group of figures: the logs, the software that computed it, the epoch of the first log (ISO 8601 UTC),
    and the mean temperature (degC).
    """

    logs: Annotated[tuple[str, ...], several(text(empty=True))] = ()
    software: Annotated[str, text(empty=True)] = ""
    epoch: Annotated[str, text(empty=True)] = ""
    temperature_degc: Number | None = None
