"""`bandwidth`: each reading depends on the previous ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

import numpy as np

from imuarray.arrays import Reals
from imuarray.simulate.effect import Effect, scalar
from imuarray.simulate.effects.own_clock import AT_ITS_RATE
from imuarray.simulate.signal import Analog, Place

_FINE = 1e-3  # time constants per row, below which correlations of rows are too similar to be distinguished
_FORGOTTEN = 12 * math.log(10.0)  # time constants after which a share of 1e-12 of the past remains
_MEMORY = 8  # number of rows from which noise after a digital filter is predicted
_STEPS = 8  # steps of the quadrature for each cutoff and each radian


SEVERAL_SAMPLES = 4
"""Readings of the chip per row above which one reading more or less changes the time between rows only slightly."""


@dataclass(frozen=True)
class Bandwidth(Effect):
    """White noise w becomes n[k] = phi n[k-1] + sqrt(1 - phi^2) w[k], phi = exp(-2 pi cutoff / rows_per_s).

    This is first-order low-pass noise of the same rms; `cutoff_hz` is its -3 dB frequency if that is well below the
    rate of the rows. The paper's gyroscope (Appendix A, Figure 13: correlation 0.4 between consecutive rows at 350 Hz)
    has 51 Hz instead of the 110 Hz that was configured. `share` of the signal, taken as straight between rows, passes
    the same filter and is delayed by 1 / (2 pi cutoff). With a share of 1 the chip filters everything; with 0 the
    motion is not filtered, as if only the noise itself were correlated. In data: correlation phi^k at lag k, an Allan
    deviation that flattens at the shortest times; under motion, a sensor that lags the others.

    With 2 `poles` it is a Butterworth filter, which resembles the output stage of a chip more closely: a = sqrt(2) pi
    cutoff, correlation exp(-a t) (cos a t + sin a t) after a time t, delay 1 / a.

    A digital filter behind a converter that samples at `sampled_hz` passes white noise up to half that rate only
    (infinite: no limit). The correlations are those of that part of the filter's response; the 8 rows before each
    row reproduce them (Yule and Walker).

    If a chip is polled faster than it samples, the noise depends on the previous sample, not on the previous row: rows
    that repeat a sample repeat its noise. If it is polled more slowly, consecutive rows are one or two samples apart
    (or up to four); the filter also processes the samples that no row reads.

    `noise_share` of the noise's rms passes the filter. For a filter that is always present the noise is measured behind
    it, so the share is 1; a filter that starts at some moment reduces the noise. `signal_only` (1) leaves the noise
    white, for rows so much slower than the filter that only its delay is visible.
    """

    name: ClassVar[str] = "bandwidth"
    cutoff_hz: float = scalar(math.inf, low=1e-2)
    share: float = scalar(0.0, low=0.0, high=1.0)
    poles: float = scalar(1.0)
    sampled_hz: float = scalar(math.inf, low=1e-2)
    noise_share: float = scalar(1.0, low=0.0, high=10.0)
    signal_only: float = scalar(0.0)

    def __post_init__(self) -> None:
        """Raise ValueError unless `poles` is 1 or 2 and `signal_only` is 0 or 1."""
        super().__post_init__()
        if self.poles not in (1.0, 2.0):
            raise ValueError(f"poles: {self.poles:g}; allowed are 1 and 2")
        if self.signal_only not in (0.0, 1.0):
            raise ValueError(f"signal_only: {self.signal_only:g}; allowed are 0 and 1")

    def lookback(self, at: Place) -> int:
        """Return the number of rows after which the influence of earlier rows has decayed to 1e-12."""
        rows = math.ceil(_FORGOTTEN / self.decay(at.rows_per_s))
        if math.isinf(self.sampled_hz):
            return rows
        samples_a_row = at.sensor.rate_hz / at.rows_per_s
        decay = self.decay(at.rows_per_s) / (samples_a_row if 1 < samples_a_row < SEVERAL_SAMPLES else 1)
        return max(rows, _memory(decay, self.poles, self.band))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Filter the noise, which is stationary from the first row on, and the signal, which is taken as constant
        before it.
        """
        if math.isinf(self.cutoff_hz):
            return analog
        decay = self.decay(at.rows_per_s)
        value = self._passed(analog.value, decay)
        if self.signal_only:
            return replace(analog, value=value)
        samples_a_row = analog.rate_hz / at.rows_per_s
        if 1 + AT_ITS_RATE < samples_a_row < SEVERAL_SAMPLES and np.any(analog.white_rms):
            return replace(analog, value=value, noise=self._of_every_sample(analog, at))
        if not 0 < (1 + AT_ITS_RATE) * samples_a_row < 1:
            return replace(analog, value=value, noise=self._coloured(analog.noise, decay))
        is_new = np.concatenate([[True], np.diff(analog.instant_ns) > 0])
        samples = self._coloured(analog.noise[is_new], decay / samples_a_row)
        return replace(analog, value=value, noise=samples[np.cumsum(is_new) - 1])

    def _of_every_sample(self, analog: Analog, at: Place) -> Reals:
        """Return the noise (n, 3) of rows between which the chip makes further readings."""
        most = math.ceil(analog.rate_hz / at.rows_per_s)
        samples = np.rint(np.diff(analog.instant_ns) * 1e-9 * analog.rate_hz).astype(int)
        skipped = np.concatenate([[0], np.clip(samples - 1, 0, most)])
        places = np.cumsum(skipped + 1) - 1  # indices of the rows among all samples
        is_read = np.zeros(places[-1] + 1, bool)
        is_read[places] = True
        stop = analog.first + len(analog.noise)
        unread = at.stream(self.name, "unread", width=3 * most).normal(analog.first, stop).reshape(-1, most, 3)
        unread = unread * np.broadcast_to(np.asarray(analog.white_rms, unread.dtype), analog.noise.shape)[:, None]
        white = np.empty((len(is_read), 3), analog.noise.dtype)
        white[is_read] = analog.noise
        white[~is_read] = unread[np.arange(most) < skipped[:, None]]
        decay = self.decay(at.rows_per_s) * at.rows_per_s / analog.rate_hz
        return np.ascontiguousarray(self._coloured(white, decay)[places])

    def _coloured(self, white: Reals, decay: float) -> Reals:
        """Return the noise (n, 3) after the filter; consecutive rows are `decay` time constants apart."""
        from scipy.signal import lfilter  # imported late because SciPy takes long to load

        numerator, denominator = _noise_filter(decay, self.poles, self.band)
        first = np.zeros((len(denominator) - 1, white.shape[1]))
        first[0] = (1 - numerator[0]) * white[0]
        noise, _ = lfilter(numerator, denominator, white.astype(float), axis=0, zi=first)
        return np.asarray(self.noise_share * noise, white.dtype)

    def _passed(self, value: Reals, decay: float) -> Reals:
        """Return the signal (n, 3) after the filter, exactly for a signal that is linear between rows."""
        if not self.share:
            return value
        from scipy.signal import lfilter, lfilter_zi  # imported late because SciPy takes long to load

        signal = value.astype(float)
        numerator, denominator = _signal_filter(decay, self.poles)
        late, _ = lfilter(
            numerator, denominator, signal, axis=0, zi=lfilter_zi(numerator, denominator)[:, None] * signal[:1]
        )
        return np.asarray(value + self.share * (late - signal), value.dtype)

    @property
    def band(self) -> float:
        """Return the highest frequency of the noise that is filtered, divided by the cutoff."""
        return self.sampled_hz / 2 / self.cutoff_hz

    def decay(self, readings_per_s: float) -> float:
        """Return the number of time constants between consecutive readings."""
        return 2 * math.pi * self.cutoff_hz / readings_per_s / math.sqrt(self.poles)


def two_pole_cutoff_hz(delay_s: float) -> float:
    """Return the cutoff in Hz of a two-pole Butterworth filter with a delay of `delay_s`; or the delay in s for a
    cutoff in Hz.
    """
    return 1 / (math.sqrt(2) * math.pi * delay_s)


def correlation(decay: float, poles: float, band: float = math.inf) -> float:
    """Return the correlation of the filtered noise at a lag of `decay` time constants, for noise that is band-limited
    at `band` times the cutoff.
    """
    if math.isfinite(band):
        return _band_limited(decay, poles, band)
    fade = math.exp(-decay)
    return fade if poles == 1 else fade * (math.cos(decay) + math.sin(decay))


@lru_cache(maxsize=4096)
def _band_limited(decay: float, poles: float, band: float) -> float:
    """Return the cosine transform of the filter's squared response 1 / (1 + u^(2 poles)), u = 0 to `band` cutoffs."""
    radians = decay * math.sqrt(poles)  # at the cutoff
    steps = 2 * math.ceil(_STEPS * (1 + band * (1 + radians)))
    over_cutoff = np.linspace(0.0, band, steps + 1)
    power = 1 / (1 + over_cutoff ** (2 * poles))
    weighted = _simpson_weights(steps) * power
    return float(weighted @ np.cos(radians * over_cutoff) / weighted.sum())


@lru_cache(maxsize=256)
def _simpson_weights(steps: int) -> Reals:
    """Return the weights (steps + 1,) of Simpson's rule, 1 4 2 4 ... 2 4 1, for an even number of steps; read-only."""
    weights = np.tile([2.0, 4.0], steps // 2 + 1)[: steps + 1]
    weights[[0, -1]] = 1.0
    weights.flags.writeable = False
    return weights


@lru_cache(maxsize=256)
def _memory(decay: float, poles: float, band: float) -> int:
    """Return the number of rows that the noise of a digital filter depends on."""
    _, under = _noise_filter(decay, poles, band)
    return math.ceil(_FORGOTTEN / -math.log(np.abs(np.roots(under)).max()))


@lru_cache(maxsize=256)
def _noise_filter(decay: float, poles: float, band: float = math.inf) -> tuple[Reals, Reals]:
    """Return (numerator, denominator) of a filter that turns white noise into noise after the chip's filter, of the
    same rms, row by row. Its poles are those of the chip's filter; with two poles there is also a zero, which follows
    from the first three correlations. For a digital filter the noise is predicted from the previous rows.
    """
    if math.isfinite(band):
        rows = np.array([correlation(decay * lag, poles, band) for lag in range(_MEMORY + 1)])
        from scipy.linalg import solve_toeplitz  # imported late because SciPy takes long to load

        coefficients = solve_toeplitz(rows[:-1], rows[1:])
        return np.array([math.sqrt(max(1 - coefficients @ rows[1:], _FINE))]), np.append(1.0, -coefficients)
    if poles == 1:
        phi = math.exp(-decay)
        return np.array([math.sqrt(-math.expm1(-2 * decay))]), np.array([1.0, -phi])
    decayed = math.exp(-decay)
    denominator = np.array([1.0, -2 * decayed * math.cos(decay), decayed * decayed])
    fine = max(decay, _FINE)
    if fine > decay:
        numerator, _ = _noise_filter(fine, poles)
        return numerator * (decay / fine) ** 1.5, denominator
    rows = np.array([correlation(decay * lag, poles) for lag in range(4)])
    lags = np.subtract.outer(np.arange(3), np.arange(3))
    same, neighbour = (float(denominator @ rows[np.abs(lags + lag)] @ denominator) for lag in (0, 1))
    share = 2 * neighbour / same
    zero = share / (1 + math.sqrt(max(1 - share * share, 0.0)))  # the zero within the unit circle
    return math.sqrt(same / (1 + zero * zero)) * np.array([1.0, zero]), denominator


@lru_cache(maxsize=256)
def _signal_filter(decay: float, poles: float) -> tuple[Reals, Reals]:
    """Return (numerator, denominator) of the filter itself, for a signal that is linear between rows."""
    from scipy.signal import cont2discrete  # imported late because SciPy takes long to load

    numerator, denominator = ([decay], [1.0, decay]) if poles == 1 else ([2 * decay**2], [1.0, 2 * decay, 2 * decay**2])
    discrete, denominator, _ = cont2discrete((numerator, denominator), 1.0, method="foh")
    return np.asarray(discrete).ravel(), np.asarray(denominator)
