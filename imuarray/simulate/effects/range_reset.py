"""`range_reset`: the chip measures in another range than it was set to."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from imuarray.chips import CHIPS
from imuarray.log.format import SensorHeader
from imuarray.simulate.converters import code_span
from imuarray.simulate.effect import Effect, per_axis, require, scalar
from imuarray.simulate.signal import Analog, Bools, Floats, Place, Triple, per_row

Number = TypeVar("Number", int, float)


@dataclass(frozen=True)
class RangeReset(Effect):
    """From `onset_s` on, in a run with this probability, or only in that number `run`: counts per unit of that other
    range, y = x + offset, and noise times `noise_share`.

    `range` in the sensor's unit (nan: no reset), `offset` too: each range has an offset of its own (BMA-79). A chip
    that lost its settings has another filter and another gain before its converter: its noise, in the unit, is another.
    Sensitivities are those of `imuarray.chips`; the code span stays, but for the ADXL345, which clips at the range
    (ADX-46). The paper's BMA1 reads 4309 LSB for 1 g in its run 10 (Table 6): 4096 LSB/g, the chip's 2 g after a reset
    (PAP-01). In data: everything scaled by a ratio of sensitivities, noise by another; where the onset is within the
    run, from one row to the next.
    """

    name: ClassVar[str] = "range_reset"
    range: float = scalar(math.nan, suffix="_{u}")
    offset: Triple = per_axis(suffix="_{u}")
    noise_share: Triple = per_axis(1.0)
    onset_s: float = scalar(0.0)
    probability: float = scalar(1.0)
    run: float = scalar(math.nan)

    def __post_init__(self) -> None:
        """ValueError for an infinite onset or a probability outside 0 to 1."""
        super().__post_init__()
        require("onset_s", self.onset_s, -1e9, 1e9)
        require("probability", self.probability, 0.0, 1.0)
        require("noise_share", min(self.noise_share), 0.0, 1e6)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Adds the offset, scales the noise and sets the converter. ValueError for a range that the chip hasn't."""
        if math.isnan(self.range) or (not math.isnan(self.run) and self.run != at.streams.boot):
            return analog
        sensitivity = _sensitivity(at.sensor, self.range)
        since = analog.instant_ns >= self.onset_s * 1e9
        if not since.any() or at.boot_generator(self.name).random() >= self.probability:
            return analog
        span = code_span(replace(at.sensor, range=self.range, rate_hz=analog.rate_hz))
        dtype = analog.value.dtype
        return replace(
            analog,
            value=analog.value + per_row(self.offset, analog.value) * since[:, None],
            noise=analog.noise * np.where(since[:, None], np.array(self.noise_share, dtype), 1),
            sensitivity=_from(since, sensitivity, analog.sensitivity, dtype),
            lowest=_from(since, span.lowest, analog.lowest, dtype),
            highest=_from(since, span.highest, analog.highest, dtype),
        )


def _sensitivity(sensor: SensorHeader, range_: float) -> float:
    """Counts per unit; ValueError for a range that this chip hasn't."""
    allowed = CHIPS[sensor.chip].sensitivity
    if range_ not in allowed:
        choice = ", ".join(f"{other:g}" for other in allowed)
        raise ValueError(f"range: {range_:g}; allowed for {sensor.name} ({sensor.chip}) are {choice}")
    return allowed[range_]


def _from(since: Bools, new: Number, old: Number | Floats, dtype: npt.DTypeLike) -> Number | Floats:
    """`new` in the rows where `since`, `old` before them; a number if all rows have the same."""
    if since.all():
        return new
    return np.asarray(np.where(since[:, None], new, old), dtype)
