"""`range_reset`: the chip measures in another range than configured."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Reals
from imuarray.chips import CHIPS
from imuarray.log.format import RECONFIGURED, SUSPECT, SensorHeader
from imuarray.simulate.converters import code_span
from imuarray.simulate.effect import Effect, per_axis, scalar
from imuarray.simulate.parameters import alongside, listed
from imuarray.simulate.signal import Analog, Codes, Flags, Instants, Place, Triple, per_row

Number = TypeVar("Number", int, float)


@dataclass(frozen=True)
class RangeReset(Effect):
    """The range is reset from `onset_s` on (0: always), in a run with this probability, or only in run number `run`, or
    in the runs listed in `runs`: counts per unit are those of the other range, y = x + offset, and the noise is
    multiplied by `noise_share`.

    `range` in the sensor's unit (nan: no reset); `offset`, too, since each range has its own offset (BMA-79). A chip
    that lost its settings has another filter and another gain before its converter, so its noise in the unit differs.
    Sensitivities are those of `imuarray.chips`; the code span stays, except for the ADXL345, which clips at the range
    (ADX-46). The paper's BMA1 reads 4309 LSB for 1 g in its run 10 (Table 6): 4096 LSB/g, the chip's 2 g after a reset
    (PAP-01). In data: everything is scaled by the ratio of the sensitivities, and the noise by another ratio; if the
    onset is within the run, this starts from one row to the next.

    If individual stretches are known, exactly these are reset: from each of `moments_s`, by the log's clock, for the
    time in `lengths_s`, in the run with that number in `runs`. A logger that reads back the configuration flags the
    rows of the last `doubts_s` before the reset as suspect, and flags the first row after the chip is set up again. For
    `blanks_s` from each moment on (0 by default) the chip has not made a reading yet: it delivers zeros that are not
    fresh, also from its thermometer.
    """

    name: ClassVar[str] = "range_reset"
    range: float = scalar(math.nan, suffix="_{u}")
    offset: Triple = per_axis(suffix="_{u}")
    noise_share: Triple = per_axis(1.0, low=0.0, high=1e6)
    onset_s: float = scalar(0.0, low=-1e9, high=1e9)
    probability: float = scalar(1.0, low=0.0, high=1.0)
    run: float = scalar(math.nan)
    runs: tuple[float, ...] = listed()
    moments_s: tuple[float, ...] = listed()
    lengths_s: tuple[float, ...] = listed()
    doubts_s: tuple[float, ...] = listed()
    blanks_s: tuple[float, ...] = listed()

    def __post_init__(self) -> None:
        """Raise ValueError for lists of different lengths."""
        super().__post_init__()
        lists = {name: getattr(self, name) for name in ("runs", "moments_s", "lengths_s", "doubts_s")}
        lists["blanks_s"] = self.blanks_s or (0.0,) * len(self.runs)
        whole_runs = not any((self.moments_s, self.lengths_s, self.doubts_s, self.blanks_s))
        for name, values in alongside(**({"runs": self.runs} if whole_runs else lists)).items():
            object.__setattr__(self, name, values)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the offset, scale the noise and set the converter. ValueError for a range that the chip does not have."""
        if math.isnan(self.range) or not self._is_in(at.streams.boot):
            return analog
        sensitivity = _sensitivity(at.sensor, self.range)
        first, stop = analog.first, analog.first + len(analog.instant_ns)
        # the first reading of a log may have been measured before its clock began
        onset_ns = self.onset_s * 1e9 if self.onset_s > 0 else -math.inf
        since = self._known(first, stop, at) if self.moments_s else analog.instant_ns >= onset_ns
        by_chance = not self.moments_s and self.probability < 1
        if not since.any() or (by_chance and at.boot_generator(self.name).random() >= self.probability):
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

    def _is_in(self, run: int) -> bool:
        return (math.isnan(self.run) or self.run == run) and (not self.runs or run in self.runs)

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Set the codes to zero while there is no reading yet."""
        if math.isnan(self.range) or not any(self.blanks_s):
            return codes
        blank = np.zeros(len(codes.counts), bool)
        first, stop = codes.first, codes.first + len(blank)
        resets = zip(self.runs, self.moments_s, self.blanks_s, strict=True)
        empty_ns = ((moment * 1e9, (moment + length) * 1e9) for run, moment, length in resets if run == at.streams.boot)
        for due, end in at.rows_in(first, stop, empty_ns):
            blank[max(due - first, 0) : end - first] = True
        if not blank.any():
            return codes
        degc = codes.temperature_counts
        return replace(
            codes,
            counts=np.where(blank[:, None], 0, codes.counts),
            temperature_counts=None if degc is None else np.where(blank, 0, degc),
            fresh=codes.fresh & ~blank,
        )

    def flagged(self, status: Flags, instants: Instants, at: Place) -> Flags:
        """Flag the rows of known stretches as suspect, and mark the end of each stretch."""
        marked = status.copy() if self.moments_s else status
        for doubt_ns, _, over_ns in self._stretches(at):
            due, end = np.searchsorted(instants.stamp_ns, (doubt_ns, over_ns))
            marked[due:end] |= SUSPECT
            if end > 0 and (arrived := np.flatnonzero(instants.kept[end:])).size:
                marked[end + arrived[0]] |= RECONFIGURED
        return marked

    def _stretches(self, at: Place) -> Iterator[tuple[float, float, float]]:
        """Yield the known stretches of this run: the time from which rows are suspect, and beginning and end of the
        other range (ns).
        """
        resets = zip(self.runs if self.moments_s else (), self.moments_s, self.lengths_s, self.doubts_s, strict=True)
        for run, moment_s, length_s, doubt_s in resets:
            if run == at.streams.boot:
                yield (moment_s - doubt_s) * 1e9, moment_s * 1e9, (moment_s + length_s) * 1e9

    def _known(self, first: int, stop: int, at: Place) -> Booleans:
        """Return (stop - first,) which of these rows lie in known stretches."""
        since = np.zeros(stop - first, bool)
        for due, end in at.rows_in(first, stop, ((due_ns, over_ns) for _, due_ns, over_ns in self._stretches(at))):
            since[max(due - first, 0) : end - first] = True
        return since


def _sensitivity(sensor: SensorHeader, range_: float) -> float:
    """Return the counts per unit; ValueError for a range that this chip does not have."""
    allowed = CHIPS[sensor.chip].sensitivity
    if range_ not in allowed:
        choice = ", ".join(f"{value:g}" for value in allowed)
        raise ValueError(f"range: {range_:g}; allowed for {sensor.name} ({sensor.chip}) are {choice}")
    return allowed[range_]


def _from(since: Booleans, new: Number, old: Number | Reals, dtype: npt.DTypeLike) -> Number | Reals:
    """Return `new` for the rows where `since` is true and `old` for the others; a single number if it is the same for
    all rows.
    """
    if since.all():
        return new
    return np.asarray(np.where(since[:, None], new, old), dtype)
