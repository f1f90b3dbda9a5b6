"""`stuck`: the counts are frozen for a while."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, scalar
from imuarray.simulate.parameters import alongside, listed
from imuarray.simulate.signal import Codes, Counts, Place

KINDS = ("stale", "new")


@dataclass(frozen=True)
class Stuck(Effect):
    """A stuck sensor: from `onset_s` for `duration_s` seconds every reading repeats the last one before, including the
    temperature, and is not fresh. If `every_s` is given this recurs: the sensor works for that time on average,
    exponentially distributed, and is then stuck again.

    Rows are counted at their nominal rate, row 0 at 0 s; with an onset of 0 the first reading stays. A chip is stuck
    when its registers are locked (L3G-51: one byte of a pair unread; HMC-33: some of six; BMA-100: only high bytes
    read), in standby (ADX-38), or when it hangs. If only its converter is stuck, the chip marks the same reading as new
    (`kind` "new" instead of "stale"). In data: long runs of identical triads.

    If individual stretches are known, exactly these are stuck: from each of `moments_s`, by the log's clock, for the
    time in `lengths_s`, in the run with that number in `runs`. If their `readings` are known too, three values
    for each stretch in the sensor's unit, a stretch begins with the reading that is repeated.

    If `stuck_axes` are given (0, 1, 2), only these are stuck (a broken bond, a register of one axis that is locked):
    the others, the temperature and the chip's flags are as usual.
    """

    name: ClassVar[str] = "stuck"
    onset_s: float = scalar(math.inf, low=0.0)
    duration_s: float = scalar(math.inf, low=0.0)
    every_s: float = scalar(math.inf, low=1e-3)
    kind: str = field(default="stale")
    runs: tuple[float, ...] = listed()
    moments_s: tuple[float, ...] = listed()
    lengths_s: tuple[float, ...] = listed()
    readings: tuple[float, ...] = listed(suffix="_{u}")
    stuck_axes: tuple[float, ...] = listed()

    def __post_init__(self) -> None:
        """Raise ValueError for an unknown kind or axis, or for lists of different lengths."""
        super().__post_init__()
        if self.kind not in KINDS:
            raise ValueError(f"kind: {self.kind!r}; allowed are {', '.join(KINDS)}")
        for name, values in alongside(runs=self.runs, moments_s=self.moments_s, lengths_s=self.lengths_s).items():
            object.__setattr__(self, name, values)
        object.__setattr__(self, "stuck_axes", tuple(float(axis) for axis in self.stuck_axes))
        if not set(self.stuck_axes) <= {0.0, 1.0, 2.0}:
            raise ValueError(f"stuck_axes: {self.stuck_axes}; allowed are 0, 1 and 2")
        object.__setattr__(self, "readings", tuple(float(value) for value in self.readings))
        if self.readings and len(self.readings) != 3 * len(self.moments_s):
            raise ValueError(f"readings: {len(self.readings)}; none, or three for each of moments_s, are required")

    def active_axes(self) -> tuple[bool, ...]:
        """Return (3,) which axes are stuck if not all are."""
        return tuple(axis in self.stuck_axes for axis in range(3))

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Replace readings while the sensor is stuck by the last one before."""
        first, stop, moving = codes.first, codes.first + len(codes.counts), codes
        for begin, end, reading in self._known(first, stop, at) if self.moments_s else self._holds(stop, at):
            if begin < stop and end > first:
                row = math.ceil(begin) if reading else max(math.ceil(begin) - 1, 0)
                last = _row(moving, row) if row >= first else at.reaching(self.name, row)
                if reading:
                    counts = np.rint(np.array([reading]) * at.sensor.sensitivity).astype(codes.counts.dtype)
                    codes, last = _set_row(codes, row, counts), replace(last, counts=counts)
                codes = _held(codes, last, row + 1, end, self.kind == "new")
        return codes if not self.stuck_axes else self._of_axes(moving, codes)

    def _of_axes(self, moving: Codes, stuck: Codes) -> Codes:
        """Return the codes with the `stuck_axes` of the stuck ones."""
        counts = moving.counts.copy()
        places = [int(axis) for axis in self.stuck_axes]
        counts[:, places] = stuck.counts[:, places]
        return replace(moving, counts=counts)

    def _known(self, first: int, stop: int, at: Place) -> Iterator[tuple[int, int, tuple[float, ...]]]:
        """Yield the rows of the known stretches that reach into first ... stop - 1, and the readings that are held."""
        for number, (run, moment_s) in enumerate(zip(self.runs, self.moments_s, strict=True)):
            if run == at.streams.boot:
                span_ns = moment_s * 1e9, (moment_s + self.lengths_s[number]) * 1e9
                for begin, end in at.rows_in(first, stop, [span_ns]):
                    yield begin, end, self.readings[3 * number : 3 * number + 3]

    def _holds(self, stop: int, at: Place) -> Iterator[tuple[float, float, tuple[float, ...]]]:
        """Return the first and last rows of each stretch in which the last reading is held, up to row `stop`."""
        free = at.boot_generator(self.name).exponential if math.isfinite(self.every_s) else lambda _: math.inf
        begin_s = self.onset_s if math.isfinite(self.onset_s) else free(self.every_s)
        while begin_s * at.rows_per_s < stop:
            end_s = begin_s + self.duration_s
            yield round(begin_s * at.rows_per_s, 6), round(end_s * at.rows_per_s, 6), ()
            begin_s = end_s + free(self.every_s)


def _row(codes: Codes, row: int) -> Codes:
    at = slice(row - codes.first, row - codes.first + 1)
    temperature = None if codes.temperature_counts is None else codes.temperature_counts[at]
    return Codes(row, codes.instant_ns[at], codes.counts[at], temperature, codes.fresh[at])


def _set_row(codes: Codes, row: int, counts: Counts) -> Codes:
    """Return the codes with the counts (1, 3) in that row, if the row is among them."""
    rows = codes.first + np.arange(len(codes.counts))
    return replace(codes, counts=np.where((rows == row)[:, None], counts, codes.counts))


def _held(codes: Codes, last: Codes, begin: int, end: float, is_new: bool) -> Codes:
    """Return the codes with `last` in the rows from `begin` to before `end`."""
    rows = codes.first + np.arange(len(codes.counts))
    still = (rows >= begin) & (rows < end)
    counts = np.where(still[:, None], last.counts, codes.counts)
    temperature = codes.temperature_counts
    if temperature is not None and last.temperature_counts is not None:
        temperature = np.where(still, last.temperature_counts, temperature)
    fresh = codes.fresh | still if is_new else codes.fresh & ~still
    return replace(codes, counts=counts, temperature_counts=temperature, fresh=fresh)
