"""Signals that pass through the effects: instants, the stimulus of the box at these, the sensing element's signal,
counts.

Each stage is a frozen dataclass of equally long arrays for consecutive rows of one sensor; `first` is the number of the
first row. An effect returns a new one and does not modify its argument. The suffix of a vector is its frame: `_box` is
the box, `_sensor` (or no suffix) the sensor's own axes. The sensor's unit is its data sheet's: g, dps or gauss.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Integers, Reals
from imuarray.log.format import SensorHeader
from imuarray.simulate.motion.stimulus import BoxStimulus, Motion
from imuarray.simulate.streams import CHUNK, Stream, Streams

Counts = npt.NDArray[np.int32]
Flags = npt.NDArray[np.uint16]
Triple = tuple[float, float, float]
Kept = TypeVar("Kept")

__all__ = ["Analog", "BoxStimulus", "Codes", "Instants", "Motion", "Place", "Triple", "by_axis", "per_row"]


@dataclass(frozen=True)
class Instants:
    """The instants at which rows are read: `stamp_ns` (n,) is the stamp in the log, `instant_ns` (n,) the actual time
    of the reading; rows that are not `kept` (n,) do not arrive. The chip delivers the latest of `rate_hz` readings a
    second; one of them was made `phase` periods before the log's epoch.
    """

    first: int
    stamp_ns: Integers
    instant_ns: Integers
    kept: Booleans
    rate_hz: float
    phase: float = 0.0


@dataclass(frozen=True)
class Analog:
    """The signal between the sensing element and the converter, in the sensor's unit and along its own axes.

    `value` (n, 3) without noise and `noise` (n, 3) are kept apart until they are converted; `force_g` (n, 3) is the
    true specific force in g along the sensor's axes, `temperature_degc` (n,) the element's, `thermometer_degc` (n,) the
    one that the chip's own thermometer measures. `sensitivity` (counts per unit, a number or (n, 1)), `lowest` and
    `highest` code and `step` between codes belong to the converter; `rate_hz` is its rate of new codes. `white_rms`,
    (3,) or (n, 3), is the standard deviation along each axis of the part of the noise that is independent from one
    reading to the next.
    """

    first: int
    instant_ns: Integers
    value: Reals
    noise: Reals
    force_g: Reals
    temperature_degc: Reals
    sensitivity: float | Reals
    lowest: int | Reals
    highest: int | Reals
    step: int | Integers
    thermometer_degc: Reals
    rate_hz: float
    white_rms: Triple | Reals = (0.0, 0.0, 0.0)

    @property
    def is_silent(self) -> bool:
        """Return whether there is no noise yet: `noise` is a single zero, broadcast to (n, 3)."""
        return self.noise.strides == (0, 0)


@dataclass(frozen=True)
class Codes:
    """The codes that the bus delivers: `counts` (n, 3) integers, `temperature_counts` (n,) or None, `fresh` (n,): False
    if the chip had no newer reading than in the previous row.
    """

    first: int
    instant_ns: Integers
    counts: Counts
    temperature_counts: Counts | None
    fresh: Booleans

    def rows(self, first: int, stop: int) -> Codes:
        """Return those of the rows first ... stop - 1 that are here."""
        begin = max(first, self.first)
        at = slice(begin - self.first, stop - self.first)
        degrees = None if self.temperature_counts is None else self.temperature_counts[at]
        return Codes(begin, self.instant_ns[at], self.counts[at], degrees, self.fresh[at])


@dataclass(frozen=True)
class Place:
    """The place where an effect acts: the sensor, the motion, the random streams.

    `rows_per_s` is the nominal rate of the rows. `neighbour(name, first, stop)` returns the codes of another sensor of
    the array (KeyError if there is none), `reaching(effect, row)` the codes of one row at the input of that effect of
    this sensor, and `stamps(first, stop)` the stamps of rows in ns. `dtype` is that of the analog arrays. `waits(first,
    stop)` returns half of the host's wait before each row in ns, and whether the host missed a reading there, if rows
    are read at the times of a log that shows this; otherwise None.
    """

    sensor: SensorHeader
    rows_per_s: float
    motion: Motion
    streams: Streams
    neighbour: Callable[[str, int, int], Codes]
    reaching: Callable[[str, int], Codes]
    stamps: Callable[[int, int], Integers]
    dtype: npt.DTypeLike = np.float64
    waits: Callable[[int, int], tuple[Integers, Booleans]] | None = None
    copy: int = 1
    """The index among several effects of one kind, each of which has its own random streams."""
    _kept: dict[Hashable, Any] = field(default_factory=dict, repr=False, compare=False)

    def kept(self, key: Hashable, make: Callable[[], Kept]) -> Kept:
        """Return the result of `make`, which is evaluated once; `key` holds all it depends on besides this place."""
        kept: Kept = self._kept[key] if key in self._kept else self._kept.setdefault(key, make())
        return kept

    def row_at(self, at_ns: float, stop: int) -> int:
        """Return the first row before `stop` whose stamp is not earlier than this time; `stop` if there is none."""
        return bisect_left(range(stop), at_ns, key=lambda row: int(self.stamps(row, row + 1)[0]))

    def rows_in(self, first: int, stop: int, stretches_ns: Iterable[tuple[float, float]]) -> Iterator[tuple[int, int]]:
        """Yield, for each stretch (from, until) that overlaps rows first ... stop - 1, its first row and the row after
        its last one, at most `stop`.
        """
        first_ns, last_ns = (int(self.stamps(row, row + 1)[0]) for row in (first, stop - 1))
        for due_ns, over_ns in stretches_ns:
            if due_ns <= last_ns and over_ns > first_ns:
                yield self.row_at(due_ns, stop), self.row_at(over_ns, stop)

    def stream(
        self,
        effect: str,
        purpose: str = "",
        *,
        width: int = 3,
        shared_by: str = "",
        chunk_rows: int = CHUNK,
        scale: Triple | None = None,
    ) -> Stream:
        """Return the effect's stream for this sensor in this run, or one stream for all sensors that name the same
        `shared_by`.

        `chunk_rows` are drawn at a time, fewer if few are required; `scale` are the standard deviations.
        """
        name = (f"all {shared_by}" if shared_by else self.sensor.name, self._stream_name(effect), purpose)
        return self.kept(
            (name, scale),
            lambda: self.streams.of_boot(*name, width=width, dtype=self.dtype, chunk_rows=chunk_rows, scale=scale),
        )

    def boot_generator(self, effect: str, purpose: str = "") -> np.random.Generator:
        """Return a generator for the effect's draws at power-on of this sensor."""
        return self.streams.of_boot(self.sensor.name, self._stream_name(effect), f"boot {purpose}").generator()

    def _stream_name(self, effect: str) -> str:
        return effect if self.copy == 1 else f"{effect} {self.copy}"


@lru_cache(maxsize=64)
def _tile(values: Triple, count: int, dtype: str) -> Reals:
    tiled: Reals = np.empty((count, len(values)), dtype)
    for axis, value in enumerate(values):
        tiled[:, axis] = value
    tiled.flags.writeable = False
    return tiled


def per_row(values: Triple, like: Reals) -> Reals:
    """Return `values` repeated in every row of an array with the shape and type of `like` (n, 3); read-only.

    Multiplying and adding it is ten times faster than a broadcast over an inner axis of three.
    """
    return _tile(values, len(like), like.dtype.str)


def by_axis(column: Reals, values: Triple) -> Reals:
    """Return the products (n, 3) of a column (n,) with the value of each axis, in the type of the column.

    An outer product takes ten times as long.
    """
    products = np.empty((len(column), len(values)), column.dtype)
    for axis, value in enumerate(values):
        np.multiply(column, value, out=products[:, axis])
    return products
