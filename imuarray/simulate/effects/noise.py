"""Noise and lines of the signal."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Reals
from imuarray.simulate.effect import Effect, per_axis, scalar
from imuarray.simulate.signal import Analog, Place, Triple, by_axis


@dataclass(frozen=True)
class Tone(Effect):
    """y = x + amplitude sin(2 pi (frequency + drift t / 2) t + phase), t the instant at which the chip actually
    samples.

    `amplitude` in the sensor's unit, `phase_deg` at the log's epoch (nan: drawn at each boot, a different one for each
    frequency). At the log's epoch the frequency is `frequency_hz`, with a standard deviation of `frequency_spread_hz`
    between boots; from then on it drifts by `drift_hz_per_h`. The beat of two oscillators behaves like this: it starts
    at a different frequency each time and drifts as they warm up. The y axis of the paper's gyroscope has a peak near
    50 Hz (Appendix A, Figure 14); lines of MPU-9150 units drift by 10 Hz an hour (recordings of Carlsson et al., IEEE
    Sensors J. 21(6), 2021). In data: a line in the spectrum, at |frequency - k rows_per_s| if it is polled too slowly;
    a hump in the Allan deviation.
    """

    name: ClassVar[str] = "tone"
    meaning: ClassVar[str] = "a sine wave in the signal"
    amplitude: Triple = per_axis(suffix="_{u}")
    frequency_hz: float = scalar(0.0, low=0.0, high=1e6)
    phase_deg: float = scalar(math.nan)
    frequency_spread_hz: float = scalar(0.0, low=0.0, high=1e6)
    drift_hz_per_h: float = scalar(0.0, low=-1e6, high=1e6)

    def __post_init__(self) -> None:
        """Raise ValueError for an infinite phase."""
        super().__post_init__()
        if math.isinf(self.phase_deg):
            raise ValueError(f"phase_deg: {self.phase_deg}; a number is required, or nan: drawn at each boot")

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the sine wave to the value."""
        if self.amplitude == (0.0, 0.0, 0.0):
            return analog
        time_s = analog.instant_ns * 1e-9
        hertz = self._first_hz(at)  # the mean of the frequencies from the epoch to each row, if the frequency drifts
        turns = time_s * (hertz + time_s * (self.drift_hz_per_h / 7200) if self.drift_hz_per_h else hertz)
        turns += self._phase_deg(at) / 360
        wave = np.sin(2 * np.pi * (turns - np.floor(turns))).astype(analog.value.dtype)
        return replace(analog, value=analog.value + by_axis(wave, self.amplitude))

    def _phase_deg(self, at: Place) -> float:
        if not math.isnan(self.phase_deg):
            return self.phase_deg
        return at.boot_generator(self.name, f"{self.frequency_hz!r} Hz").uniform(0.0, 360.0)

    def _first_hz(self, at: Place) -> float:
        """Return the frequency at the log's epoch."""
        if self.frequency_spread_hz == 0:
            return self.frequency_hz
        draw = at.boot_generator(self.name, f"{self.frequency_hz!r} Hz, its spread").standard_normal()
        return float(self.frequency_hz + self.frequency_spread_hz * draw)


@dataclass(frozen=True)
class WhiteNoise(Effect):
    """y = x + w, w ~ N(0, rms^2), independent from row to row and axis to axis.

    `rms` in the sensor's unit: the standard deviation of single readings at rest, as data sheets (BMA-110, ADX-67,
    L3G-74, after multiplication by the root of the bandwidth) and the paper's Tables 9 and 10 give it. `bandwidth`
    shapes this noise without weakening it. In data: a flat spectrum, an Allan deviation of slope -1/2.
    """

    name: ClassVar[str] = "white_noise"
    meaning: ClassVar[str] = "every reading has an independent, normally distributed error"
    rms: Triple = per_axis(suffix="_{u}", low=0.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add white noise to the noise."""
        if self.rms == (0.0, 0.0, 0.0):
            return analog
        noise = at.stream(self.name, scale=self.rms).normal(analog.first, analog.first + len(analog.noise))
        earlier_rms = analog.white_rms
        if isinstance(earlier_rms, tuple):
            x, y, z = map(math.hypot, self.rms, earlier_rms)
            white_rms: Triple | Reals = (x, y, z)
        else:
            white_rms = np.hypot(self.rms, earlier_rms)
        return replace(analog, noise=noise if analog.is_silent else noise + analog.noise, white_rms=white_rms)
