"""Readings that the bus delivers instead of the latest codes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Booleans
from imuarray.simulate.converters import code_span
from imuarray.simulate.effect import Effect, choice, listed, scalar
from imuarray.simulate.signal import Codes, Counts, Place

_RARE = 1e-12


@dataclass(frozen=True)
class StaleSamples(Effect):
    """With `probability` a reading repeats the previous one: counts and temperature, not fresh.

    A row that repeats a repetition shows the last reading that was not one. Chains of repetitions are limited to a
    length that only a share of 10^-12 of them would exceed: a row beyond it keeps its own reading. In reality, a
    register that is locked while a conversion ends (L3G-50, HMC-33) or a poll that occasionally overtakes the chip
    causes this. In data: identical triads, because all three axes repeat together; the lag-1 correlation of the noise
    rises to about `probability`.

    If `rows` is above 1, repetitions occur in bursts with this mean length in rows, geometrically distributed, as from
    a bus with a temporary fault; each reading begins a burst with the probability `probability` / `rows`.
    """

    name: ClassVar[str] = "stale_samples"
    meaning: ClassVar[str] = "a reading repeats the previous one"
    probability: float = scalar(0.0, low=0.0, high=0.99)
    rows: float = scalar(1.0, low=1.0, high=1e3)

    @property
    def longest(self) -> int:
        """Return the largest number of repetitions in a row."""
        if not self.probability:
            return 0
        again = max(self.probability, 1 - 1 / self.rows)
        return math.ceil(math.log(_RARE) / math.log(again))

    def lookback(self, at: Place) -> int:
        """Return the largest number of rows that affect a stretch: the longest chain and the row before it."""
        return self.longest + 1 if self.probability else 0

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Repeat rows. A row is fresh if a fresh reading arrived since the previous row."""
        if not self.probability:
            return codes
        rows = np.arange(len(codes.counts))
        stale = self._are_stale(codes, at)
        shown_rows = np.maximum.accumulate(np.where(stale, 0, rows))
        shown_rows = np.where(rows - shown_rows > self.longest, rows, shown_rows)
        arrived = np.cumsum(codes.fresh)[shown_rows]
        fresh = np.concatenate([codes.fresh[:1], arrived[1:] > arrived[:-1]])
        temperature = None if codes.temperature_counts is None else codes.temperature_counts[shown_rows]
        return replace(codes, counts=codes.counts[shown_rows], temperature_counts=temperature, fresh=fresh)

    def _are_stale(self, codes: Codes, at: Place) -> Booleans:
        """Return the mask (n,) of the rows that repeat the one before."""
        rows = np.arange(len(codes.counts))
        if self.rows == 1:
            stream = at.streams.of_boot(at.sensor.name, self.name, width=1)  # double precision: probabilities are small
            return np.asarray(stream.uniform(codes.first, codes.first + len(rows))[:, 0] < self.probability)
        stream = at.streams.of_boot(at.sensor.name, self.name, "bursts", width=2)
        begin, length = stream.uniform(codes.first, codes.first + len(rows)).T
        lengths = np.ceil(np.log1p(-length) / math.log1p(-1 / self.rows))
        ends = np.where(begin < self.probability / self.rows, rows + np.maximum(lengths, 1.0), 0.0)
        return np.asarray(np.maximum.accumulate(ends) > rows)


GLITCH_KINDS = ("spike", "torn", "word")

_WORD = -32768, 32767
"""Lowest and highest value of two bytes, independent of the chip's range."""

_LOW_BITS = {"bma180": 6}
"""Number of bits of the code in the low byte, of chips for which it is not eight (BMA-60)."""


def high_byte(chip: str) -> int:
    """Return the number of counts of one unit of the high byte."""
    return 1 << _LOW_BITS.get(chip, 8)


@dataclass(frozen=True)
class Glitches(Effect):
    """Each reading is corrupted with `probability`, in one of three ways (`kind`).

    "spike": one axis, drawn at random, is off by plus or minus `amplitude` (in the sensor's unit, at its nominal
    sensitivity), within its codes. "torn": one axis, drawn at random, has the low byte of this reading and the high
    byte of the previous row, because the chip updated its registers between two bytes of a burst (L3G-50, ADX-49,
    BMA-101). The low byte of a BMA180 holds six bits of the code (BMA-60), that of all other chips eight. "word": all
    axes read -1, as from a bus that no chip drives, whose lines float high (UM10204, 3.1.1). In data: heavy tails; torn
    readings are off by multiples of 256 (BMA180: 64) counts, and only if neighbours differ in the high byte; for a
    gyroscope at rest, -1 is a normal small reading.

    If the corrupted readings are known, exactly these are corrupted: the reading that is due at each of `moments_s`, in
    seconds since the log's epoch, in the run whose number is in `runs`. Its error is three values of `jumps`, one for
    each axis, in the sensor's unit.
    """

    name: ClassVar[str] = "glitches"
    meaning: ClassVar[str] = "single readings are corrupted"
    probability: float = scalar(0.0, low=0.0, high=1.0)
    amplitude: float = scalar(0.0, suffix="_{u}", low=0.0, high=1e6)
    kind: str = choice("spike", GLITCH_KINDS)
    runs: tuple[float, ...] = listed()
    moments_s: tuple[float, ...] = listed()
    jumps: tuple[float, ...] = listed(suffix="_{u}")

    def __post_init__(self) -> None:
        """Raise ValueError for lists of different lengths."""
        super().__post_init__()
        if not (len(self.runs) == len(self.moments_s) == len(self.jumps) / 3):
            raise ValueError(
                f"moments_s: {len(self.moments_s)}; as many runs and three times as many jumps are required"
            )

    def active_axes(self) -> tuple[bool, ...]:
        """Return (3,) which axes have a jump of known size."""
        return tuple(any(self.jumps[axis::3]) for axis in range(3))

    def lookback(self, at: Place) -> int:
        """Return 1 if readings are torn or `moments_s` are given, because these depend on the previous row."""
        if self.moments_s:
            return 1
        return 1 if self.probability and self.kind == "torn" else 0

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Corrupt rows of counts; flags and temperature do not change."""
        if self.moments_s:
            return replace(codes, counts=self._hit(codes, at))
        if not self.probability:
            return codes
        stream = at.streams.of_boot(at.sensor.name, self.name, self.kind, width=2)  # double precision: rare events
        hit, choice = stream.uniform(codes.first, codes.first + len(codes.counts)).T
        struck = (hit < self.probability)[:, None]
        axis, upwards = np.divmod(np.floor(choice * 6).astype(np.int32), 2)
        if self.kind == "word":
            return replace(codes, counts=np.where(struck, -1, codes.counts))
        wrong = _torn(codes.counts, at) if self.kind == "torn" else self._excursion(codes.counts, upwards * 2 - 1, at)
        return replace(codes, counts=np.where(struck & (np.arange(3) == axis[:, None]), wrong, codes.counts))

    def _hit(self, codes: Codes, at: Place) -> Counts:
        of_boot = np.array(self.runs) == at.streams.boot
        due_ns = np.array(self.moments_s)[of_boot] * 1e9
        rows = np.searchsorted(codes.instant_ns, due_ns)
        in_block = (rows < len(codes.counts)) & ((rows > 0) | (codes.first == 0))  # others belong to earlier rows
        jumps = np.rint(np.array(self.jumps).reshape(-1, 3)[of_boot] * at.sensor.sensitivity).astype(codes.counts.dtype)
        counts = codes.counts.copy()
        np.add.at(counts, rows[in_block], jumps[in_block])
        return np.asarray(np.clip(counts, *_WORD))

    def _excursion(self, counts: Counts, sign: Counts, at: Place) -> Counts:
        span = code_span(at.sensor)
        jump = round(self.amplitude * at.sensor.sensitivity)
        return np.asarray(np.clip(counts + sign[:, None] * jump, span.lowest, span.highest))


def _torn(counts: Counts, at: Place) -> Counts:
    """Return readings with the low byte of their own code and the high byte of the previous one (two's complement)."""
    low = high_byte(at.sensor.chip) - 1
    previous = np.concatenate([counts[:1], counts[:-1]])
    return (previous & ~low) | (counts & low)


STUCK_KINDS = ("stale", "new")


@dataclass(frozen=True)
class Stuck(Effect):
    """A stuck sensor: from `onset_s` on, for `duration_s` seconds, every reading repeats the last one before that time,
    including the temperature, and is not fresh. If `every_s` is given this recurs: the sensor works for that time on
    average, exponentially distributed, and is then stuck again.

    Rows are counted at their nominal rate, row 0 at 0 s; with an onset of 0 the first reading stays. A chip is stuck
    when its registers are locked (L3G-51: one byte of a pair unread; HMC-33: some of six; BMA-100: only high bytes
    read), in standby (ADX-38), or when it hangs. If only its converter is stuck, the chip marks the same reading as new
    (`kind` "new" instead of "stale"). In data: long runs of identical triads.

    If individual stretches are known, the sensor is stuck in exactly these: each begins at one of `moments_s` on the
    log's clock, lasts for the time in `lengths_s`, and is in the run whose number is in `runs`. If the `readings` are
    also known (three values for each stretch, in the sensor's unit), each stretch shows its reading from its first row
    on.

    If `stuck_axes` are given (0, 1, 2), only these are stuck, as after a broken bond or when the register of one axis
    is locked: the other axes, the temperature and the chip's flags are as usual.
    """

    name: ClassVar[str] = "stuck"
    meaning: ClassVar[str] = "the counts are frozen for a while"
    onset_s: float = scalar(math.inf, low=0.0)
    duration_s: float = scalar(math.inf, low=0.0)
    every_s: float = scalar(math.inf, low=1e-3)
    kind: str = choice("stale", STUCK_KINDS)
    runs: tuple[float, ...] = listed()
    moments_s: tuple[float, ...] = listed()
    lengths_s: tuple[float, ...] = listed()
    readings: tuple[float, ...] = listed(suffix="_{u}")
    stuck_axes: tuple[float, ...] = listed()

    def __post_init__(self) -> None:
        """Raise ValueError for an unknown axis, or for lists of different lengths."""
        super().__post_init__()
        self.check_events("runs", "moments_s", "lengths_s")
        if not set(self.stuck_axes) <= {0.0, 1.0, 2.0}:
            raise ValueError(f"stuck_axes: {self.stuck_axes}; allowed are 0, 1 and 2")
        if self.readings and len(self.readings) != 3 * len(self.moments_s):
            raise ValueError(f"readings: {len(self.readings)}; none, or three for each of moments_s, are required")

    def active_axes(self) -> tuple[bool, ...]:
        """Return (3,) whether each axis is stuck, if `stuck_axes` are given."""
        return tuple(axis in self.stuck_axes for axis in range(3))

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Replace readings while the sensor is stuck by the last reading before that."""
        first, stop, moving = codes.first, codes.first + len(codes.counts), codes
        for begin, end, reading in self._known_holds(first, stop, at) if self.moments_s else self._holds(stop, at):
            if begin < stop and end > first:
                row = math.ceil(begin) if reading else max(math.ceil(begin) - 1, 0)
                last = moving.rows(row, row + 1) if row >= first else at.reaching(self.name, row)
                if reading:
                    counts = np.rint(np.array([reading]) * at.sensor.sensitivity).astype(codes.counts.dtype)
                    is_row = codes.first + np.arange(len(codes.counts)) == row
                    codes = replace(codes, counts=np.where(is_row[:, None], counts, codes.counts))
                    last = replace(last, counts=counts)
                codes = _hold(codes, last, row + 1, end, self.kind == "new")
        return codes if not self.stuck_axes else self._hold_axes(moving, codes)

    def _hold_axes(self, moving: Codes, stuck: Codes) -> Codes:
        """Return the codes `moving` with the `stuck_axes` taken from `stuck`."""
        counts = moving.counts.copy()
        places = [int(axis) for axis in self.stuck_axes]
        counts[:, places] = stuck.counts[:, places]
        return replace(moving, counts=counts)

    def _known_holds(self, first: int, stop: int, at: Place) -> Iterator[tuple[int, int, tuple[float, ...]]]:
        """Yield the rows of the known stretches that reach into first ... stop - 1, and the readings that are held."""
        for number, (run, moment_s) in enumerate(zip(self.runs, self.moments_s, strict=True)):
            if run == at.streams.boot:
                span_ns = moment_s * 1e9, (moment_s + self.lengths_s[number]) * 1e9
                for begin, end in at.rows_in(first, stop, [span_ns]):
                    yield begin, end, self.readings[3 * number : 3 * number + 3]

    def _holds(self, stop: int, at: Place) -> Iterator[tuple[float, float, tuple[float, ...]]]:
        """Yield begin and end row of each stretch with a held reading, up to row `stop`, and the reading if known."""
        free = at.boot_generator(self.name).exponential if math.isfinite(self.every_s) else lambda _: math.inf
        begin_s = self.onset_s if math.isfinite(self.onset_s) else free(self.every_s)
        while begin_s * at.rows_per_s < stop:
            end_s = begin_s + self.duration_s
            yield round(begin_s * at.rows_per_s, 6), round(end_s * at.rows_per_s, 6), ()
            begin_s = end_s + free(self.every_s)


def _hold(codes: Codes, last: Codes, begin: int, end: float, is_new: bool) -> Codes:
    """Return the codes with `last` in the rows from `begin` to before `end`."""
    rows = codes.first + np.arange(len(codes.counts))
    still = (rows >= begin) & (rows < end)
    counts = np.where(still[:, None], last.counts, codes.counts)
    temperature = codes.temperature_counts
    if temperature is not None and last.temperature_counts is not None:
        temperature = np.where(still, last.temperature_counts, temperature)
    fresh = codes.fresh | still if is_new else codes.fresh & ~still
    return replace(codes, counts=counts, temperature_counts=temperature, fresh=fresh)


SWAP_KINDS = ("data", "counts", "place")


@dataclass(frozen=True)
class ChannelSwap(Effect):
    """The readings are those of the sensor named by `sensor`; "" for the sensor itself. `kind` is the mechanism.

    "data": each row holds the data of the other sensor. Counts, temperature and freshness are those of the other chip;
    range, sensitivity and axes remain as configured. A multiplexer that switches one transaction late causes this
    (PCA-06). In data: a sensor with the bias, noise and axes of its neighbour; two sensors with the same noise.

    "place": the sensor is mounted at the position and in the orientation of the other one. Exchanged plugs or
    multiplexer channels cause this: the chip at that place is set up and read as this sensor. In data: a sensor with
    the axes and the distance from the origin of its neighbour. An exchange needs two of these effects, one for each
    sensor.
    """

    name: ClassVar[str] = "channel_swap"
    meaning: ClassVar[str] = "the sensor delivers the data of another sensor"
    sensor: str = field(default="")
    kind: str = choice("data", SWAP_KINDS)

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Return the rows of the other sensor; ValueError if there is no such sensor, naming those of the array."""
        if self.sensor in ("", at.sensor.name) or self.kind == "place":
            return codes
        try:
            neighbour = at.neighbour(self.sensor, codes.first, codes.first + len(codes.counts))
        except KeyError as error:
            raise ValueError(f"channel_swap of {at.sensor.name}: {error.args[0]}") from None
        if self.kind == "counts":
            return replace(codes, counts=neighbour.counts)
        temperature = codes.temperature_counts if neighbour.temperature_counts is None else neighbour.temperature_counts
        degrees = None if codes.temperature_counts is None else temperature
        return replace(codes, counts=neighbour.counts, temperature_counts=degrees, fresh=neighbour.fresh)
