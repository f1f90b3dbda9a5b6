"""`bandwidth`: each reading depends on the previous ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, NamedTuple

import numpy as np

from imuarray.arrays import Integers, Reals
from imuarray.simulate.effect import Effect, choice, listed, scalar
from imuarray.simulate.effects.timing import AT_ITS_RATE
from imuarray.simulate.signal import Analog, Place

_FINE = 1e-3  # time constants per row, below which correlations of rows are too similar to be distinguished
_FORGOTTEN = 12 * math.log(10.0)  # time constants after which a share of 1e-12 of the past remains
_MEMORY = 8  # number of rows from which noise after a digital filter is predicted
_IMPULSE = 4096  # rows of a filter's impulse response
_STEPS = 8  # steps of the quadrature for each cutoff and each radian


SEVERAL_SAMPLES = 4
"""Readings of the chip per row above which one reading more or less changes the time between rows only slightly."""


@dataclass(frozen=True)
class Bandwidth(Effect):
    """White noise w becomes n[k] = phi n[k-1] + sqrt(1 - phi^2) w[k], phi = exp(-2 pi cutoff / rows_per_s).

    This is first-order low-pass noise of the same rms; `cutoff_hz` is its -3 dB frequency if that is well below the
    rate of the rows. The paper's gyroscope (Appendix A, Figure 13: correlation 0.4 between consecutive rows at 350 Hz)
    has 51 Hz instead of the 110 Hz that was configured. `share` of the signal, assumed to be linear between rows,
    passes the same filter and is delayed by 1 / (2 pi cutoff). With a share of 1 the chip filters everything; with 0
    the motion is not filtered, as if only the noise itself were correlated. In data: correlation phi^k at lag k, an
    Allan deviation that flattens at the shortest times; under motion, a sensor that lags the others.

    With 2 `poles` it is a Butterworth filter, which resembles the output stage of a chip more closely: a = sqrt(2) pi
    cutoff, correlation exp(-a t) (cos a t + sin a t) after a time t, delay 1 / a.

    A digital filter behind a converter that samples at `sampled_hz` passes white noise only up to half that rate
    (infinite: no limit). The correlations follow from that part of the filter's response; each row is predicted from
    the 8 rows before it so that they are reproduced (Yule and Walker). A `warped` filter (1) is designed by the
    bilinear transform, as most are: its response falls to zero at half the rate.

    If a chip is polled faster than it samples, the noise depends on the previous sample, not on the previous row: rows
    that repeat a sample repeat its noise. If it is polled more slowly, consecutive rows are one or two samples apart
    (or up to four); the filter also processes the samples that no row reads.

    `noise_share` of the noise's rms passes the filter. If a filter is always present, the noise is measured behind it,
    so the share is 1. A filter that starts at some instant reduces the noise. `signal_only` (1) leaves the noise white;
    it is meant for rows that are so slow, compared with the filter, that only its delay is visible.

    No data sheet prints the response of a chip's filter. `correlations` of the noise at lags of 1, 2, ... samples, as
    measured, replace those of the filter; each later sample is predicted from the same number of earlier ones.
    """

    name: ClassVar[str] = "bandwidth"
    meaning: ClassVar[str] = "each reading depends on the previous ones"
    cutoff_hz: float = scalar(math.inf, low=1e-2)
    share: float = scalar(0.0, low=0.0, high=1.0)
    poles: float = choice(1.0, (1.0, 2.0))
    sampled_hz: float = scalar(math.inf, low=1e-2)
    noise_share: float = scalar(1.0, low=0.0, high=10.0)
    signal_only: float = choice(0.0, (0.0, 1.0))
    warped: float = choice(0.0, (0.0, 1.0))
    correlations: tuple[float, ...] = listed()

    def __post_init__(self) -> None:
        """Raise ValueError unless a noise can have the `correlations`."""
        super().__post_init__()
        if self.correlations and not has_correlations(self.correlations):
            raise ValueError(f"correlations: no noise has {self.correlations}")

    def lookback(self, at: Place) -> int:
        """Return the number of rows after which the influence of earlier rows has decayed to 1e-12."""
        rows = math.ceil(_FORGOTTEN / self.decay(at.rows_per_s))
        if self.correlations:
            return max(rows, _rows_remembered(_prediction_filter(self.correlations)[1]))
        if math.isinf(self.sampled_hz):
            return rows
        samples_a_row = at.sensor.rate_hz / at.rows_per_s
        decay = self.decay(at.rows_per_s) / (samples_a_row if 1 < samples_a_row < SEVERAL_SAMPLES else 1)
        return max(rows, _rows_remembered(_noise_filter(decay, self._response)[1]))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Filter the noise, which is stationary from the first row on, and the signal, which is assumed to be constant
        before the first row.
        """
        if math.isinf(self.cutoff_hz):
            return analog
        decay = self.decay(at.rows_per_s)
        value = self._filter_signal(analog.value, decay)
        if self.signal_only:
            return replace(analog, value=value)
        if not 0 < analog.rate_hz < SEVERAL_SAMPLES * at.rows_per_s:
            return replace(analog, value=value, noise=self._filter_noise(analog.noise, decay))
        steps_ns = np.diff(analog.instant_ns)
        samples = np.where(steps_ns > 0, np.maximum(np.rint(steps_ns * 1e-9 * analog.rate_hz), 1), 0).astype(int)
        if (samples == 1).all():
            return replace(analog, value=value, noise=self._filter_noise(analog.noise, decay))
        return replace(analog, value=value, noise=self._filter_samples(analog, samples, at))

    def _filter_samples(self, analog: Analog, samples: Integers, at: Place) -> Reals:
        """Return the noise (n, 3) of rows whose intervals are `samples` (n - 1,) of the chip: 0 repeats the previous
        sample; with 2 or more, no row reads the samples in between.
        """
        most = math.ceil(analog.rate_hz / at.rows_per_s)
        steps = np.append(0, np.minimum(samples, most + 1))
        places = np.cumsum(steps)  # indices of the rows among all samples
        is_first = np.append(True, steps[1:] > 0)
        is_read = np.zeros(places[-1] + 1, bool)
        is_read[places] = True
        white = np.empty((len(is_read), 3), analog.noise.dtype)
        white[is_read] = analog.noise[is_first]
        if not is_read.all():
            stop = analog.first + len(analog.noise)
            unread = at.stream(self.name, "unread", width=3 * most).normal(analog.first, stop).reshape(-1, most, 3)
            unread = unread * np.broadcast_to(np.asarray(analog.white_rms, unread.dtype), analog.noise.shape)[:, None]
            white[~is_read] = unread[np.arange(most) < (steps - 1)[:, None]]
        decay = self.decay(at.rows_per_s) * at.rows_per_s / analog.rate_hz
        return np.ascontiguousarray(self._filter_noise(white, decay)[places])

    def _filter_noise(self, white: Reals, decay: float) -> Reals:
        """Return the noise (n, 3) after the filter; consecutive samples are `decay` time constants apart."""
        from scipy.signal import lfilter  # imported late because SciPy takes long to load

        numerator, denominator = (
            _prediction_filter(self.correlations) if self.correlations else _noise_filter(decay, self._response)
        )
        first = np.zeros((len(denominator) - 1, white.shape[1]))
        first[0] = (1 - numerator[0]) * white[0]
        noise, _ = lfilter(numerator, denominator, white.astype(float), axis=0, zi=first)
        return np.asarray(self.noise_share * noise, white.dtype)

    def _filter_signal(self, value: Reals, decay: float) -> Reals:
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

    def correlation(self, decay: float) -> float:
        """Return the correlation of the noise behind the filter at a lag of `decay` time constants."""
        return _correlation(decay, self._response)

    @property
    def _response(self) -> _Response:
        band = self.sampled_hz / 2 / self.cutoff_hz
        return _Response(self.poles, band, bool(self.warped) and band > 1)

    def decay(self, readings_per_s: float) -> float:
        """Return the number of time constants between consecutive readings."""
        return 2 * math.pi * self.cutoff_hz / readings_per_s / math.sqrt(self.poles)


def two_pole_cutoff_hz(delay_s: float) -> float:
    """Return the cutoff in Hz of a two-pole Butterworth filter with a delay of `delay_s`, or the delay for a cutoff."""
    return 1 / (math.sqrt(2) * math.pi * delay_s)


class _Response(NamedTuple):
    """The squared response of a filter with this number of `poles` to noise up to `band` cutoffs (infinite: to all
    noise); `band` is half the rate of the samples. If `is_warped`, the response falls to zero there (bilinear
    transform).
    """

    poles: float
    band: float
    is_warped: bool

    def power(self, over_cutoff: Reals) -> Reals:
        """Return the squared response at these frequencies, which are divided by the cutoff and below `band`."""
        if self.is_warped:
            over_cutoff = np.tan(math.pi / 2 * over_cutoff / self.band) / math.tan(math.pi / 2 / self.band)
        return np.asarray(1 / (1 + over_cutoff ** (2 * self.poles)))


@lru_cache(maxsize=4096)
def _correlation(decay: float, response: _Response) -> float:
    """Return the correlation of the filtered noise at a lag of `decay` time constants. For band-limited noise it is the
    cosine transform of the squared response.
    """
    if math.isinf(response.band):
        fade = math.exp(-decay)
        return fade if response.poles == 1 else fade * (math.cos(decay) + math.sin(decay))
    radians = decay * math.sqrt(response.poles)  # at the cutoff
    steps = 2 * math.ceil(_STEPS * (1 + response.band * (1 + radians)))
    over_cutoff = np.linspace(0.0, response.band, steps + 1)
    weighted = _simpson_weights(steps) * response.power(over_cutoff)
    return float(weighted @ np.cos(radians * over_cutoff) / weighted.sum())


@lru_cache(maxsize=256)
def _simpson_weights(steps: int) -> Reals:
    """Return the weights (steps + 1,) of Simpson's rule, 1 4 2 4 ... 2 4 1, for an even number of steps; read-only."""
    weights = np.tile([2.0, 4.0], steps // 2 + 1)[: steps + 1]
    weights[[0, -1]] = 1.0
    weights.flags.writeable = False
    return weights


def _rows_remembered(denominator: Reals) -> int:
    """Return the number of rows after which a filter with this denominator has forgotten the past."""
    return math.ceil(_FORGOTTEN / -math.log(np.abs(np.roots(denominator)).max()))


def has_correlations(correlations: Sequence[float]) -> bool:
    """Return whether noise with these correlations at lags 1, 2, ... can exist."""
    from scipy.linalg import toeplitz  # imported late because SciPy takes long to load

    return bool(np.linalg.eigvalsh(toeplitz([1.0, *correlations]))[0] > _FINE)


@lru_cache(maxsize=256)
def _prediction_filter(correlations: tuple[float, ...]) -> tuple[Reals, Reals]:
    """Return (numerator, denominator) of the filter that turns white noise into noise of the same rms with these
    correlations at lags 1 ... n, by prediction from the n rows before (Yule and Walker).
    """
    from scipy.linalg import solve_toeplitz  # imported late because SciPy takes long to load

    rows = np.array([1.0, *correlations])
    coefficients = solve_toeplitz(rows[:-1], rows[1:])
    return np.array([math.sqrt(max(1 - coefficients @ rows[1:], _FINE))]), np.append(1.0, -coefficients)


@lru_cache(maxsize=256)
def _noise_filter(decay: float, response: _Response) -> tuple[Reals, Reals]:
    """Return (numerator, denominator) of a filter that turns white noise into noise after the chip's filter, of the
    same rms, row by row. Its poles are those of the chip's filter; with two poles there is also a zero, which follows
    from the first three correlations. If the filter is warped and its samples are the rows, it is returned itself; for
    any other digital filter, the noise is predicted from the previous rows.
    """
    if response.is_warped and abs(decay * math.sqrt(response.poles) * response.band / math.pi - 1) < AT_ITS_RATE:
        return _bilinear_filter(response)
    if math.isfinite(response.band):
        return _prediction_filter(tuple(_correlation(decay * lag, response) for lag in range(1, _MEMORY + 1)))
    if response.poles == 1:
        phi = math.exp(-decay)
        return np.array([math.sqrt(-math.expm1(-2 * decay))]), np.array([1.0, -phi])
    decayed = math.exp(-decay)
    denominator = np.array([1.0, -2 * decayed * math.cos(decay), decayed * decayed])
    fine = max(decay, _FINE)
    if fine > decay:
        numerator, _ = _noise_filter(fine, response)
        return numerator * (decay / fine) ** 1.5, denominator
    rows = np.array([_correlation(decay * lag, response) for lag in range(4)])
    lags = np.subtract.outer(np.arange(3), np.arange(3))
    same, neighbour = (float(denominator @ rows[np.abs(lags + lag)] @ denominator) for lag in (0, 1))
    share = 2 * neighbour / same
    zero = share / (1 + math.sqrt(max(1 - share * share, 0.0)))  # the zero within the unit circle
    return math.sqrt(same / (1 + zero * zero)) * np.array([1.0, zero]), denominator


def _bilinear_filter(response: _Response) -> tuple[Reals, Reals]:
    """Return (numerator, denominator) of a warped filter at the rate of its samples, for noise of the same rms."""
    from scipy.signal import butter, lfilter  # imported late because SciPy takes long to load

    numerator, denominator = butter(int(response.poles), 1 / response.band)
    impulse = lfilter(numerator, denominator, np.eye(1, _IMPULSE)[0])
    return np.asarray(numerator / np.sqrt(np.square(impulse).sum())), np.asarray(denominator)


@lru_cache(maxsize=256)
def _signal_filter(decay: float, poles: float) -> tuple[Reals, Reals]:
    """Return (numerator, denominator) of the filter itself, for a signal that is linear between rows."""
    from scipy.signal import cont2discrete  # imported late because SciPy takes long to load

    numerator, denominator = ([decay], [1.0, decay]) if poles == 1 else ([2 * decay**2], [1.0, 2 * decay, 2 * decay**2])
    discrete, denominator, _ = cont2discrete((numerator, denominator), 1.0, method="foh")
    return np.asarray(discrete).ravel(), np.asarray(denominator)
