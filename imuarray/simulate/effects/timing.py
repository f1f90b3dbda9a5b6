"""When rows are read and whether they arrive: errors of clocks, delays, jitter, lost rows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Booleans, Integers, Reals
from imuarray.simulate.effect import Effect, choice, listed, require, scalar
from imuarray.simulate.signal import Instants, Place
from imuarray.simulate.streams import Stream


@dataclass(frozen=True)
class ClockError(Effect):
    """instant = stamp (1 + error_ppm 1e-6), counted from the epoch: a reading stamped t was taken at that instant.

    `error_ppm` is the fractional frequency error of IEEE 1139 in millionths. It is positive for a log whose clock is
    slow: its sign is that of true minus logged time. The error of a quartz is tens of ppm, that of an RC oscillator up
    to a hundred thousand (BMA-107: 10 %). In data: everything happens faster by that ratio; lines of the spectrum are
    shifted, and the difference from a known profile of motion or temperature keeps growing.

    An oscillator that warms up from the epoch on has the additional error warm_up_ppm exp(-t / warm_up_s) at time t,
    which integrates to warm_up_ppm warm_up_s (1 - exp(-t / warm_up_s)). With warm_up_ppm = -error_ppm the clock is
    exact when cold; with 0 its rate is constant.
    """

    name: ClassVar[str] = "clock_error"
    meaning: ClassVar[str] = "the clock of the log is off by a ratio that is constant or settles"
    error_ppm: float = scalar(0.0, low=-5e5, high=5e5)
    warm_up_ppm: float = scalar(0.0, low=-5e5, high=5e5)
    warm_up_s: float = scalar(60.0, low=1e-3, high=1e9)

    def __post_init__(self) -> None:
        """Raise ValueError unless the ratio of the clocks stays between 0.5 and 1.5, also at the beginning."""
        super().__post_init__()
        require("error_ppm + warm_up_ppm", self.error_ppm + self.warm_up_ppm, -5e5, 5e5)

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Scale the times of the readings."""
        if not self.error_ppm and not self.warm_up_ppm:
            return instants
        late_ns = instants.stamp_ns * (self.error_ppm * 1e-6)
        if self.warm_up_ppm:
            warm_ns = self.warm_up_s * 1e9
            late_ns -= np.expm1(-np.maximum(instants.stamp_ns, 0) / warm_ns) * (self.warm_up_ppm * 1e-6 * warm_ns)
        return replace(instants, instant_ns=instants.instant_ns + np.rint(late_ns).astype(np.int64))


AT_ITS_RATE = 0.05
"""Relative tolerance of the row rate. Rows within it of the chip's data rate are assumed to be the chip's own readings
and not polled.
"""


@dataclass(frozen=True)
class OwnClock(Effect):
    """Reading k is taken at (k - phase_deg / 360) / (rate (1 + rate_error)), counted from the log's epoch.

    `rate_error` is relative. `phase_deg` / 360 is the part of a period that has passed at the epoch since the latest
    reading (nan: drawn at each boot). The oscillator of the BMA180 is within 10 % (BMA-107); the other data sheets
    print no tolerance. The noise does not change, because the filters run on the same clock. If the rows are the chip's
    own readings (a queue, an imported log), the effect does nothing, because their stamps are the times of the
    readings. Rows at the nominal rate of the chip are assumed to be its own readings, unless `polled` (1) states that a
    host's clock timed them. In data: no change at rest, unless the chip is polled faster than it samples; then more or
    fewer rows repeat the previous one. In motion a reading is 0 to 1 period old: a constant delay if polls and periods
    are synchronous, otherwise a jitter with a beat.
    """

    name: ClassVar[str] = "own_clock"
    meaning: ClassVar[str] = "the chip samples by its own clock and answers a poll with its latest reading"
    rate_error: float = scalar(0.0, low=-0.5, high=0.5)
    phase_deg: float = scalar(0.0)
    polled: float = choice(0.0, (0.0, 1.0))

    def __post_init__(self) -> None:
        """Raise ValueError for an infinite phase."""
        super().__post_init__()
        if math.isinf(self.phase_deg):
            raise ValueError(f"phase_deg: {self.phase_deg}; a number is required, or nan: drawn at each boot")

    def lookback(self, at: Place) -> int:
        """Return the largest number of rows that repeat one reading, plus one; 0 if none is repeated."""
        real_hz = at.sensor.rate_hz * (1 + self.rate_error)
        if not self.rate_error or not self._is_polled(at) or real_hz >= at.rows_per_s:
            return 0
        return math.ceil(at.rows_per_s / real_hz) + 1

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Set the actual rate, and the phase in periods."""
        if (self.rate_error, self.phase_deg) == (0.0, 0.0) or not self._is_polled(at):
            return instants
        rate_hz = instants.rate_hz * (1 + self.rate_error)
        return replace(instants, rate_hz=rate_hz, phase=instants.phase + self._phase(at))

    def _phase(self, at: Place) -> float:
        if not math.isnan(self.phase_deg):
            return self.phase_deg / 360
        return at.kept((self.name, "phase", at.copy), lambda: float(at.boot_generator(self.name).uniform()))

    def _is_polled(self, at: Place) -> bool:
        """Return whether the chip has a rate and is polled: its rows have another rate, or are known to be polled."""
        rate_hz = at.sensor.rate_hz
        return rate_hz > 0 and (bool(self.polled) or abs(at.rows_per_s / rate_hz - 1) > AT_ITS_RATE)


@dataclass(frozen=True)
class Skew(Effect):
    """instant = stamp - delay_s: the reading was taken `delay_s` seconds before its stamp (negative: after).

    Filters add their group delay, the axes are converted one after the other (a quarter of 417 us for each in the
    BMA180, BMA-94), and samples wait in the chip until they are read. The known part of the delay is a log's attribute
    `delay_ns`. In data: no change at rest; under motion the sensors of one array lag each other, most where the motion
    is fastest.
    """

    name: ClassVar[str] = "skew"
    meaning: ClassVar[str] = "readings are older than their time stamps"
    delay_s: float = scalar(0.0, low=-1e3, high=1e3)

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Shift the times of all readings by the same number of nanoseconds."""
        if not self.delay_s:
            return instants
        return replace(instants, instant_ns=instants.instant_ns - round(self.delay_s * 1e9))


_FREE = 0.9


@dataclass(frozen=True)
class Jitter(Effect):
    """instant = stamp + w, independent from row to row. w ~ N(0, rms_s^2) if all rows are affected. If only a `share`
    of the rows is affected, these are late: w is exponential with the root mean square `rms_s` and the mean rms_s /
    sqrt(2). It is truncated at 0.9 of the interval to the next row, because the other sensors take a tenth of that
    interval; a longer wait would also delay the stamps of the following rows.

    `rms_s` in seconds is the time that the scheduler of the logging computer inserts between a burst and the reading of
    its clock. Rows are late if another program had the processor. If the times of a log's rows show which rows these
    were (`imuarray.simulate.host_latency`), exactly these rows are late, by `wait_share` of half of each wait: 1 if all
    of it was before the transfer, -1 if it was after it. Rows that no process was ready to read are lost.

    In data: no change at rest, unless the next row repeats a late reading. Under motion, noise in proportion to the
    rate of change of the signal, rms_s sqrt(share) |dx/dt|.
    """

    name: ClassVar[str] = "jitter"
    meaning: ClassVar[str] = "time stamps of readings scatter"
    rms_s: float = scalar(0.0, low=0.0, high=1e3)
    share: float = scalar(1.0, low=0.0, high=1.0)
    wait_share: float = scalar(0.0, low=-1.0, high=1.0)

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Shift the times of all readings at random, or those of the rows whose waits are known."""
        if self.wait_share and at.waits is not None:
            halves, missed = at.waits(instants.first, instants.first + len(instants.stamp_ns))
            later = np.rint(self.wait_share * halves).astype(np.int64)
            return replace(instants, instant_ns=instants.instant_ns + later, kept=instants.kept & ~missed)
        if not self.rms_s:
            return instants
        delay = self._draw(instants.first, instants.first + len(instants.stamp_ns), at)
        return replace(instants, instant_ns=instants.instant_ns + np.rint(delay * (self.rms_s * 1e9)).astype(np.int64))

    def _draw(self, first: int, stop: int, at: Place) -> Reals:
        """Return (n,) the deviation of each row in units of `rms_s`."""
        if self.share == 1:
            return np.asarray(at.stream(self.name, width=1).normal(first, stop)[:, 0], float)
        chosen, late = at.streams.of_boot(at.sensor.name, self.name, "late", width=2).uniform(first, stop).T
        longest = _FREE / (at.rows_per_s * self.rms_s)
        within = -np.expm1(-np.sqrt(2) * longest)
        return np.where(chosen < self.share, -np.log1p(-within * late) / np.sqrt(2), 0.0)


_REACH = 64
"""Number of previous rows that are examined first; it is doubled until it suffices."""


@dataclass(frozen=True)
class DroppedSamples(Effect):
    """A two-state Markov chain from row to row: a row after a kept one is lost with probability a, a row after a lost
    one is kept with probability b.

    With b = 1 / burst_rows the lengths of bursts are geometric with the mean burst_rows. With a = b p / (1 - p) the
    long-run share of lost rows is p = `probability`; because a <= 1, p is at most burst_rows / (burst_rows + 1). This
    is the model of E. N. Gilbert (Capacity of a burst-noise channel, Bell System Technical Journal 39, 1960) in which
    every row of the bad state is lost. In data: rows are missing and the next one carries flag 8; the time between rows
    is a multiple of its usual value.

    One uniform number u determines each row: after a kept row it is lost if u < a, after a lost row if u < 1 - b. Where
    both conditions give the same result, the past is irrelevant. The state of any row is therefore computed exactly by
    going back to the last row of this kind (coupling from the past): on average 1 / (1 - |1 - a - b|) rows, whatever
    the row's number.

    If the missing rows are known, exactly these are lost: the rows that are due from each of `moments_s` on, by the
    log's clock, for the time in `lengths_s`, in the run whose number is in `runs`.
    """

    name: ClassVar[str] = "dropped_samples"
    meaning: ClassVar[str] = "readings are lost, alone or in bursts"
    probability: float = scalar(0.0)
    burst_rows: float = scalar(1.0, low=1.0, high=1e6)
    runs: tuple[float, ...] = listed()
    moments_s: tuple[float, ...] = listed()
    lengths_s: tuple[float, ...] = listed()

    def __post_init__(self) -> None:
        """Raise ValueError for a share of lost rows that such bursts cannot produce, or lists of unequal lengths."""
        super().__post_init__()
        require("probability", self.probability, 0.0, self.burst_rows / (self.burst_rows + 1))
        self.check_events("runs", "moments_s", "lengths_s")

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Mark the lost rows as not kept."""
        if self.moments_s:
            return replace(instants, kept=instants.kept & ~self._missing(instants.stamp_ns, at.streams.boot))
        if not self.probability:
            return instants
        stream = at.streams.of_boot(at.sensor.name, self.name, width=1)  # double precision: probabilities are small
        is_lost = self._are_lost(instants.first, instants.first + len(instants.kept), stream)
        return replace(instants, kept=instants.kept & ~is_lost)

    def _missing(self, stamp_ns: Integers, run: int) -> Booleans:
        """Return (n,) whether rows with these stamps are lost."""
        missing = np.zeros(len(stamp_ns), bool)
        for number, moment_s, length_s in zip(self.runs, self.moments_s, self.lengths_s, strict=True):
            if number == run:
                due, end = np.searchsorted(stamp_ns, (moment_s * 1e9, (moment_s + length_s) * 1e9))
                missing[due:end] = True
        return missing

    def _are_lost(self, first: int, stop: int, stream: Stream) -> Booleans:
        """Return (stop - first,) whether rows are lost; row 0 is lost with the long-run probability."""
        stay = 1 - 1 / self.burst_rows
        begin = self.probability / (1 - self.probability) / self.burst_rows
        reach = _REACH
        while True:
            start = max(0, first - reach)
            draws = stream.uniform(start, stop)[:, 0]
            lost, certain = draws < min(begin, stay), (draws < min(begin, stay)) | (draws >= max(begin, stay))
            if start == 0:
                lost[0], certain[0] = draws[0] < self.probability, True
            if certain[: first - start + 1].any():
                break
            reach *= 2
        rows = np.arange(len(draws))
        last = np.maximum.accumulate(np.where(certain, rows, 0))
        turned = ((rows - last) % 2 == 1) & (begin > stay)  # where the past matters, the state is kept or inverted
        return np.asarray((lost[last] ^ turned)[first - start :])
