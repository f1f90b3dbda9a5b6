"""`odr_error`: the chip runs at another data rate, or with another filter, than configured."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.converters import adxl345_bandwidth_hz, code_span
from imuarray.simulate.effect import Effect, require, scalar
from imuarray.simulate.signal import Analog, Instants, Place


@dataclass(frozen=True)
class OdrError(Effect):
    """noise rms x sqrt(real bandwidth / configured bandwidth), and new readings at the real rate only.

    `rate_hz` is the real data rate, `bandwidth_hz` the real bandwidth of the noise; nan: as configured. The bandwidth
    of an ADXL345 is half its rate (ADX-32 ... ADX-35), for its noise at least that of 100 Hz (ADX-68). At 1600 Hz and
    above its lowest bit is always 0 (ADX-47, which does not say how it rounds; the nearest even code is used here). The
    bandwidth of other chips stays as configured unless it is given. If the registers are right but the oscillator runs
    at `clock_ratio` times its rate, codes remain those of the configured rate, and so does the noise, because a filter
    that runs on the same clock averages as many readings. The paper's ADXL345s give even codes only, and more noise
    than 400 Hz explains (PAP-02). In data: repeated rows if rows come faster than the real rate, older readings, a
    different noise, missing codes.
    """

    name: ClassVar[str] = "odr_error"
    rate_hz: float = scalar(math.nan)
    bandwidth_hz: float = scalar(math.nan)
    clock_ratio: float = scalar(1.0, low=1e-3, high=10.0)

    def __post_init__(self) -> None:
        """Raise ValueError for a rate or bandwidth outside 1e-3 to 1e6 Hz."""
        super().__post_init__()
        for name, value in (("rate_hz", self.rate_hz), ("bandwidth_hz", self.bandwidth_hz)):
            if not math.isnan(value):
                require(name, value, 1e-3, 1e6)

    def lookback(self, at: Place) -> int:
        """Return the number of rows that may repeat one reading, plus one."""
        set_hz = at.sensor.rate_hz if math.isnan(self.rate_hz) and self.clock_ratio != 1.0 else self.rate_hz
        real_hz = set_hz * self.clock_ratio
        return math.ceil(at.rows_per_s / real_hz) + 1 if 0 < real_hz < at.rows_per_s else 0

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Set the rate of new readings."""
        if math.isnan(self.rate_hz) and self.clock_ratio == 1.0:
            return instants
        set_hz = instants.rate_hz if math.isnan(self.rate_hz) else self.rate_hz
        return replace(instants, rate_hz=set_hz * self.clock_ratio)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Scale the noise and set the converter. ValueError for a bandwidth if the chip has none that can be
        configured.
        """
        if math.isnan(self.rate_hz) and math.isnan(self.bandwidth_hz):
            return analog  # an oscillator's error alone is already part of the instants
        set_hz = analog.rate_hz / self.clock_ratio if math.isnan(self.rate_hz) else self.rate_hz
        span = code_span(replace(at.sensor, rate_hz=set_hz))
        factor = math.sqrt(self._bandwidth_ratio(set_hz, at))
        return replace(
            analog,
            noise=analog.noise * factor,
            lowest=span.lowest,
            highest=span.highest,
            step=span.step,
            rate_hz=set_hz * self.clock_ratio,
        )

    def _bandwidth_ratio(self, rate_hz: float, at: Place) -> float:
        """Return the ratio of the actual to the configured bandwidth of the noise."""
        sensor = at.sensor
        configured_hz, real_hz = sensor.bandwidth_hz, sensor.bandwidth_hz
        if sensor.chip == "adxl345":
            configured_hz, real_hz = map(adxl345_bandwidth_hz, (sensor.rate_hz, rate_hz))
        if math.isnan(self.bandwidth_hz):
            return real_hz / configured_hz if configured_hz else 1.0
        if not configured_hz:
            raise ValueError(f"bandwidth_hz: {self.bandwidth_hz:g}; {sensor.name} ({sensor.chip}) has none configured")
        return self.bandwidth_hz / configured_hz
