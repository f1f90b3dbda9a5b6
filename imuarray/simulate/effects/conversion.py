"""The converter and its settings: data rate, range, steps and ends of the codes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Indices, Reals
from imuarray.chips import CHIPS
from imuarray.log.format import RECONFIGURED, SUSPECT, SensorHeader
from imuarray.simulate.converters import adxl345_bandwidth_hz, code_span
from imuarray.simulate.effect import Effect, listed, per_axis, require, scalar
from imuarray.simulate.signal import Analog, Codes, Counts, Flags, Instants, Place, Triple, per_row


@dataclass(frozen=True)
class OdrError(Effect):
    """noise rms x sqrt(real bandwidth / configured bandwidth), and new readings at the real rate only.

    `rate_hz` is the real data rate, `bandwidth_hz` the real bandwidth of the noise; nan: as configured. The bandwidth
    of an ADXL345 is half its rate (ADX-32 ... ADX-35), for its noise at least that of 100 Hz (ADX-68). At 1600 Hz and
    above its lowest bit is always 0 (ADX-47, which does not state the rounding; the nearest even code is assumed). The
    bandwidth of other chips stays as configured unless it is given. If the registers are right but the oscillator runs
    at `clock_ratio` times its rate, codes remain those of the configured rate, and so does the noise, because a filter
    that runs on the same clock averages as many readings. The paper's ADXL345s give even codes only, and more noise
    than 400 Hz explains (PAP-02). In data: repeated rows if rows come faster than the real rate, older readings, a
    different noise, missing codes.
    """

    name: ClassVar[str] = "odr_error"
    meaning: ClassVar[str] = "the chip runs at another data rate, or with another filter, than configured"
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
        """Return the largest number of rows that repeat one reading, plus one; 0 if none is repeated."""
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
        """Scale the noise and set the converter. ValueError for a bandwidth if the chip's cannot be configured."""
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

    If individual stretches are known, the range is reset in exactly these: each begins at one of `moments_s` on the
    log's clock, lasts for the time in `lengths_s`, and is in the run whose number is in `runs`. A logger that reads
    back the configuration flags the rows of the last `doubts_s` before it detects the reset as suspect, and flags the
    first row after the chip is set up again. For `blanks_s` from each moment on (0 by default) the chip has not made a
    reading yet: it delivers zeros that are not fresh; so does its thermometer.
    """

    name: ClassVar[str] = "range_reset"
    meaning: ClassVar[str] = "the chip measures in another range than configured"
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
        if not any((self.moments_s, self.lengths_s, self.doubts_s, self.blanks_s)):  # whole runs
            self.check_events("runs")
            return
        object.__setattr__(self, "blanks_s", self.blanks_s or (0.0,) * len(self.runs))
        self.check_events("runs", "moments_s", "lengths_s", "doubts_s", "blanks_s")

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the offset, scale the noise and set the converter. ValueError for a range that the chip does not have."""
        if math.isnan(self.range) or not self._is_in(at.streams.boot):
            return analog
        sensitivity = _sensitivity(at.sensor, self.range)
        first, stop = analog.first, analog.first + len(analog.instant_ns)
        # the first reading of a log may have been measured before its clock began
        onset_ns = self.onset_s * 1e9 if self.onset_s > 0 else -math.inf
        since = self._are_known(first, stop, at) if self.moments_s else analog.instant_ns >= onset_ns
        by_chance = not self.moments_s and self.probability < 1
        if not since.any() or (by_chance and at.boot_generator(self.name).random() >= self.probability):
            return analog
        span = code_span(replace(at.sensor, range=self.range, rate_hz=analog.rate_hz))
        dtype = analog.value.dtype
        return replace(
            analog,
            value=analog.value + per_row(self.offset, analog.value) * since[:, None],
            noise=analog.noise * np.where(since[:, None], np.array(self.noise_share, dtype), 1),
            sensitivity=_switch_over(since, sensitivity, analog.sensitivity, dtype),
            lowest=_switch_over(since, span.lowest, analog.lowest, dtype),
            highest=_switch_over(since, span.highest, analog.highest, dtype),
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

    def _are_known(self, first: int, stop: int, at: Place) -> Booleans:
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


def _switch_over(since: Booleans, new: Number, old: Number | Reals, dtype: npt.DTypeLike) -> Number | Reals:
    """Return `new` for rows where `since` is true and `old` for the others; one number if it is equal in all rows."""
    if since.all():
        return new
    return np.asarray(np.where(since[:, None], new, old), dtype)


Whole = npt.NDArray[np.signedinteger[Any]]


@dataclass(frozen=True)
class Quantisation(Effect):
    """Codes of each axis are rounded to multiples of `step_lsb` counts, and end at the last multiple within the code
    span. Of every `carry_lsb` codes the last `missing_lsb` never occur; the code of the carry replaces them. Bits
    that are set in the number `dead_bits` (4: bit 2) are cleared.

    Rounding to one count belongs to the converter and is always applied. Steps of two counts occur in an ADXL345 at
    1600 Hz and above (ADX-47), steps of four in a BMA180 that is read with 12 bits (BMA-61). If the converter's step is
    coarser already, codes are multiples of both. In data: codes that never occur; with noise of less than half a step,
    readings that are constant and then jump; with more noise, rounding noise of step / sqrt(12) rms. A dead bit (a line
    that is shorted to ground) removes every other stretch of 2^bit codes: readings in a removed stretch are too low by
    2^bit. Codes are missing before a carry if the converter's capacitor (or resistor) of the bit that is set by the
    carry is smaller, by more than a count, than those of all lower bits together: a differential nonlinearity of -1
    (IEEE Std 1241). An offset that the chip adds after its converter, such as a trim (BMA-46), moves carries away from
    multiples.
    """

    name: ClassVar[str] = "quantisation"
    meaning: ClassVar[str] = "codes come in steps larger than one"
    step_lsb: Triple = per_axis(1.0, low=1, high=4096)
    dead_bits: float = scalar(0.0, low=0, high=32767)
    carry_lsb: float = scalar(1.0, low=1, high=4096)
    missing_lsb: float = scalar(0.0)
    carry_at_lsb: float = scalar(0.0)

    def __post_init__(self) -> None:
        """Raise ValueError unless the parameters are whole numbers and at least one code remains before a carry."""
        super().__post_init__()
        require("missing_lsb", self.missing_lsb, 0, self.carry_lsb - 1)
        require("carry_at_lsb", self.carry_at_lsb, 0, self.carry_lsb - 1)
        numbers = [("step_lsb", step) for step in self.step_lsb]
        numbers += [(name, getattr(self, name)) for name in ("dead_bits", "carry_lsb", "missing_lsb", "carry_at_lsb")]
        for name, value in numbers:
            if value != int(value):
                raise ValueError(f"{name}: {value}; a whole number is required")

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Set the converter's step and code ends."""
        if max(self.step_lsb) == 1:
            return analog
        is_same = len(set(self.step_lsb)) == 1
        own = np.array(self.step_lsb[0] if is_same else [self.step_lsb]).astype(int)  # (1, 3) counts as columns of rows
        step = np.lcm(analog.step, own)
        step = int(step) if np.ndim(step) == 0 else step
        lowest, highest = -(-analog.lowest // step) * step, analog.highest // step * step
        return replace(analog, step=step, lowest=lowest, highest=highest)

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Replace missing codes by the carry, and clear the dead bits; negative codes are in two's complement."""
        changed = self.dead_bits or self.missing_lsb
        return replace(codes, counts=self.coded(codes.counts)) if changed else codes

    def coded(self, counts: Whole) -> Whole:
        """Return the codes that replace these."""
        if self.missing_lsb:
            carry, largest = int(self.carry_lsb), np.iinfo(counts.dtype).max
            short = carry - (counts - int(self.carry_at_lsb)) % carry
            carried = np.minimum(counts, largest - short) + short
            counts = np.where(short <= int(self.missing_lsb), carried, counts)
        return counts & ~int(self.dead_bits) if self.dead_bits else counts


@dataclass(frozen=True)
class Saturation(Effect):
    """y = x within [centre - limit, centre + limit], and the nearer end of this interval outside it; x is the signal of
    an axis including its noise.

    `limit` and `centre` of each axis in the sensor's unit. An offset that is added after the saturating element moves
    both ends. The end of the code span itself (BMA-60, ADX-46; L3G-40 to L3G-42 print spans 15 % beyond the range)
    belongs to the converter; this effect is an element or an amplifier that saturates earlier, the "clipped" signal of
    the paper's section 2.3. In data: a flat top at codes that are not the last ones, so that no flag reports it.
    """

    name: ClassVar[str] = "saturation"
    meaning: ClassVar[str] = "the signal saturates before the codes do"
    limit: Triple = per_axis(math.inf, suffix="_{u}", low=0.0)
    centre: Triple = per_axis(0.0, suffix="_{u}")

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Clip the sum of signal and noise; rows within the limit are bit by bit the same."""
        total = analog.value + analog.noise
        limit, centre = np.array(self.limit, total.dtype), np.array(self.centre, total.dtype)
        beyond = np.abs(total - centre) > limit
        if not beyond.any():
            return analog
        ends = centre + np.copysign(limit, total - centre)
        noise = np.where(beyond, analog.noise.dtype.type(0), analog.noise)
        return replace(analog, value=np.where(beyond, ends, analog.value), noise=noise)


LONGEST = 256
"""Maximum number of consecutive rows that show the same reading, however often the threshold is crossed."""

_DENSE = 1.5
"""Interval of rows, in periods of the chip's readings, below which rows show every reading."""


@dataclass(frozen=True)
class AdaptiveRange(Effect):
    """When the reading of any axis crosses `threshold` in size, all three axes repeat the previous reading for `hold_s`
    seconds, and the chip reports these readings as new.

    The gyroscope of an ICM-42688-P changes its full-scale range by itself unless bits 7:6 of INTF_CONFIG1 are 01, and
    delivers no new reading for 1 to 2 ms at each change, near 100 dps (TDK-18). In data: two or three identical triads
    at 1 kHz, then a jump to the current rate; nothing at rest. If rows are less frequent than readings, rows within the
    hold show the reading at the crossing, by linear interpolation. The temperature is not held.
    """

    name: ClassVar[str] = "adaptive_range"
    meaning: ClassVar[str] = "the reading is frozen for a moment when the rate passes a threshold"
    threshold: float = scalar(math.inf, suffix="_{u}", low=0.0)
    hold_s: float = scalar(0.0, low=0.0, high=1.0)

    def lookback(self, at: Place) -> int:
        """Return the number of rows before a stretch that can affect it: a run of held rows, the crossing before it,
        and one more row.
        """
        if not self._acts:
            return 0
        return LONGEST + math.ceil(self.hold_s * at.rows_per_s) + 2

    @property
    def _acts(self) -> bool:
        return math.isfinite(self.threshold) and self.hold_s > 0

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Replace the readings within each hold by the reading before the crossing."""
        if not self._acts or len(codes.counts) < 2:
            return codes
        inside = np.abs(codes.counts) < self.threshold * at.sensor.sensitivity
        passed = np.flatnonzero((inside[1:] != inside[:-1]).any(axis=1)) + 1
        if not len(passed):
            return codes
        period_ns = 1e9 / at.sensor.rate_hz if at.sensor.rate_hz else 0.0
        noticed_ns = self._noticed_ns(codes, passed, period_ns, at.sensor.sensitivity)
        is_held = _are_held(codes, passed, noticed_ns, self.hold_s * 1e9)
        starts = np.flatnonzero(is_held & ~np.concatenate([[False], is_held[:-1]]))
        if not len(starts):
            return codes
        shown = _held_readings(codes, starts, noticed_ns[np.searchsorted(passed, starts)] - period_ns, period_ns)
        rows = np.arange(len(is_held))
        run = np.searchsorted(starts, rows, side="right") - 1
        is_held &= rows - starts[run] < LONGEST
        return replace(codes, counts=np.where(is_held[:, None], shown[run], codes.counts))

    def _noticed_ns(self, codes: Codes, passed: Indices, period_ns: float, sensitivity: float) -> Floats:
        """Return the time at which the chip detects each crossing: its first reading after it, in a row of `passed`."""
        before, after = (np.abs(codes.counts[rows]).astype(float) for rows in (passed - 1, passed))
        limit = self.threshold * sensitivity
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where((before < limit) != (after < limit), (limit - before) / (after - before), np.inf)
        begin_ns, end_ns = (codes.instant_ns[rows].astype(float) for rows in (passed - 1, passed))
        at_ns = begin_ns + np.clip(share.min(axis=1), 0, 1) * (end_ns - begin_ns)
        return np.asarray(np.minimum(end_ns, at_ns + period_ns))


def _are_held(codes: Codes, passed: Indices, noticed_ns: Floats, hold_ns: float) -> Booleans:
    """Return (n,) whether a row falls within the hold of the latest crossing before it."""
    latest = np.searchsorted(passed, np.arange(len(codes.counts)), side="right") - 1
    since_ns = codes.instant_ns - noticed_ns[latest]
    return np.asarray((latest >= 0) & (since_ns < hold_ns))


def _held_readings(codes: Codes, starts: Indices, at_ns: Floats, period_ns: float) -> Counts:
    """Return the readings (m, 3) that are held from rows `starts` on. If every reading has a row, these are the
    previous rows; otherwise they are interpolated between the two rows at `at_ns`.
    """
    begin_ns, end_ns = (codes.instant_ns[rows].astype(float) for rows in (starts - 1, starts))
    share = np.clip((at_ns - begin_ns) / np.maximum(end_ns - begin_ns, 1), 0, 1)
    share[end_ns - begin_ns < _DENSE * period_ns] = 0
    before, after = codes.counts[starts - 1], codes.counts[starts]
    return np.asarray(np.rint(before + share[:, None] * (after - before)), codes.counts.dtype)
