"""Curves of the paper's Figures 6 to 19, from the simulated experiments: plain arrays, to be drawn elsewhere."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import signal

from imuarray.arrays import Floats
from imuarray.simulate.motion.heating import Heating
from imuarray.studies.paper.array_model import WINDOW_S
from imuarray.studies.paper.replica.comparison import autocorrelation
from imuarray.studies.paper.replica.simulation import ExperimentData, Series

SEGMENT = 2048
"""Rows of a segment of a spectrum, which is averaged over all segments."""
LAGS = 31
_STEP_S = 10.0


class TimeCurve(NamedTuple):
    """A curve over time: seconds (n,), LSB (n, k)."""

    seconds: Floats
    lsb: Floats


class Scatter(NamedTuple):
    """An axis against temperature: degC (n,), LSB (n,) of some of the readings, and the line through all of them."""

    degc: Floats
    lsb: Floats
    slope: float
    intercept: float


def rate_hz(series: Series) -> float:
    """Return the readings per second."""
    return float((len(series.time_ns) - 1) / (series.time_ns[-1] - series.time_ns[0]) * 1e9)


def smoothed(series: Series, window_s: float = WINDOW_S, step_s: float = _STEP_S) -> TimeCurve:
    """Return the moving average minus the total mean, every `step_s`, at the middle of the window (Figure 6)."""
    rows, step = (max(1, round(seconds * rate_hz(series))) for seconds in (window_s, step_s))
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(series.counts, axis=0, dtype=float)])
    starts = np.arange(0, len(sums) - rows, step)
    means = (sums[starts + rows] - sums[starts]) / rows
    middle = (series.time_ns[starts] + series.time_ns[starts + rows - 1]) / 2e9
    return TimeCurve(middle, means - series.counts.mean(axis=0))


def profile(step_s: float = _STEP_S) -> TimeCurve:
    """Return the temperature (degC, in place of LSB) of the box while it is heated (Figure 7)."""
    motion = Heating()
    seconds = np.arange(0.0, motion.seconds + step_s / 2, step_s)
    degc = np.asarray(motion.stimulus((seconds * 1e9).astype(np.int64)).temperature_degc, float)
    return TimeCurve(seconds, degc[:, None])


_SCATTER_S = 4.0
"""Time in s between the readings of Figures 8 and 9."""
_HALF_MINUTE_S = 30.0


def against_temperature(observed: ExperimentData, channel: str) -> Scatter:
    """Return a channel such as "Gyro2 x" of a sensor of `WARMED` against temperature (Figures 8 and 9)."""
    name, letter = channel.split()
    axis, series, line = "xyz".index(letter), observed.warm[name], observed.heated[name]
    sampled = slice(None, None, max(1, round(_SCATTER_S * rate_hz(series))))
    degc = np.asarray(Heating().stimulus(series.time_ns[sampled]).temperature_degc, float)
    lsb = series.counts[sampled, axis].astype(float)
    return Scatter(degc, lsb, float(line.slope[axis]), float(line.intercept[axis]))


def opposed(observed: ExperimentData) -> TimeCurve:
    """Return Gyro1 y, Gyro2 y and half of their difference while heated, averaged over half a minute (Figure 10)."""
    means = []
    for name in ("Gyro1", "Gyro2"):
        series = observed.warm[name]
        rows = round(_HALF_MINUTE_S * rate_hz(series))
        whole = len(series.counts) // rows * rows
        means.append(series.counts[:whole, 1].reshape(-1, rows).mean(axis=1))
    first, second = means
    seconds = np.asarray((np.arange(len(first)) + 0.5) * _HALF_MINUTE_S, float)
    return TimeCurve(seconds, np.column_stack([first, second, (first - second) / 2]))


def correlogram(counts: npt.NDArray[np.int16]) -> Floats:
    """Return (31, 3) autocorrelation at lags 0 to 30 (Figure 13)."""
    return np.array([autocorrelation(counts, lag) if lag else np.ones(3) for lag in range(LAGS)])


def spectrum(counts: npt.NDArray[np.int16], rate: float) -> tuple[Floats, Floats]:
    """Return Hz (k,) and amplitude density (k, 3) in LSB/sqrt(Hz) by Welch (Figures 14, 17 and 19), without 0 Hz and
    the Nyquist frequency, which are half a bin wide.
    """
    hz, power = signal.welch(counts.astype(float), rate, nperseg=SEGMENT, axis=0)
    return np.asarray(hz[1:-1]), np.sqrt(power[1:-1])


def histogram(counts: npt.NDArray[np.int16]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return codes (k,) from the lowest to the highest, and the number of readings of each (Figure 15)."""
    lowest = int(counts.min())
    often = np.bincount(counts.astype(np.int64) - lowest)
    return np.arange(lowest, lowest + len(often)), often
