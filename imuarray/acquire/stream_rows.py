"""From what a microcontroller sent of one sensor to rows that wait for the log, many at a time.

A reading that did not arrive has no row; the next one says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.acquire.sample_buffer import SampleBuffer
from imuarray.acquire.stream_plan import Place
from imuarray.bus.serial_bus import Samples
from imuarray.bus.serial_link import AGE_HELD, AGE_NOBODY

Numbers = npt.NDArray[np.int64]

_WHY = {
    AGE_NOBODY: "nobody acknowledges (errno 121)",
    AGE_HELD: "the clock is held (errno 110)",
    0: "the conversion was not finished",
}
_KEPT = 1024
LINK = "lost on the link, or the microcontroller came late"


class Readings(NamedTuple):
    """Readings of one visit that arrived: numbers of the frames (n,), times (n,) in ns on the host's clock, parts of
    the burst (n, size). `failure` says why the last one that is missing is missing, in the words of an event.
    """

    numbers: Numbers
    times_ns: Numbers
    parts: npt.NDArray[np.uint8]
    failure: str


def readings_at(place: Place, samples: Samples, rate: float) -> Readings:
    """What is at `place`; `rate` is that of the host's clock over the microcontroller's."""
    payload = samples.payload
    ages = np.stack([_ages(payload, position) for position in place.ages], axis=1)
    worst = ages.max(axis=1)
    why = np.where(worst >= AGE_HELD, worst, 1)
    if place.busy:
        why = np.where((why == 1) & (payload[:, place.first] & place.busy != 0), 0, why)
    good = why == 1
    times_ns = samples.sent_ns - np.rint(_ages(payload, place.age) * (1000 * rate)).astype(np.int64)
    failed = why[~good]
    failure = _WHY[int(failed[-1])] if len(failed) else ""
    return Readings(samples.numbers[good], times_ns[good], payload[good, place.start : place.stop], failure)


def _ages(payload: npt.NDArray[np.uint8], position: int) -> npt.NDArray[np.int64]:
    """(n,) ages at this position."""
    return payload[:, position].astype(np.int64) | payload[:, position + 1].astype(np.int64) << 8


class Rows:
    """Fills the rows of one sensor, whose readings consist of the visits at `places`."""

    def __init__(self, buffer: SampleBuffer, places: tuple[Place, ...]) -> None:
        self.buffer = buffer
        self.places = places
        self.restart()

    def restart(self) -> None:
        """Frames are counted from 0 again."""
        self._last = self.places[-1].offset - self.places[-1].every
        self._parts: dict[int, npt.NDArray[np.uint8]] = {}

    def missing(self, number: int) -> int:
        """Readings that should have come by frame `number` and have not."""
        last = self.places[-1]
        return max(0, (number - last.offset) // last.every - (self._last - last.offset) // last.every)

    def take(self, came: Mapping[int, Samples], rate: float) -> tuple[int, str]:
        """Add the readings among what came; how many are missing before the last of them, and why the last of those."""
        readings = self._whole(came, rate)
        count = len(readings.numbers)
        if count == 0:
            return 0, readings.failure
        buffer, every = self.buffer, self.places[-1].every
        gaps = np.diff(readings.numbers, prepend=self._last) // every - 1
        rows = len(buffer.times_ns)
        if buffer.set_up_again:
            buffer.reconfigured.append(rows)
            buffer.set_up_again = False
        buffer.lost_before += [rows + int(row) for row in np.flatnonzero(gaps)]
        if buffer.missing and not gaps[0]:
            buffer.lost_before.insert(len(buffer.lost_before) - np.count_nonzero(gaps), rows)
        buffer.missing = False
        buffer.times_ns += readings.times_ns.tolist()
        buffer.bursts += readings.parts.tobytes()
        self._last = int(readings.numbers[-1])
        return int(gaps.sum()), readings.failure

    def _whole(self, came: Mapping[int, Samples], rate: float) -> Readings:
        """Readings all of whose visits arrived; one that takes several is timed by its last."""
        last = self.places[-1]
        failure = ""
        for place in self.places[:-1]:
            if place.start == place.stop or place.number not in came:
                continue
            earlier = readings_at(place, came[place.number], rate)
            failure = earlier.failure or failure
            shift = last.offset - place.offset
            self._parts.update(zip((earlier.numbers + shift).tolist(), earlier.parts, strict=True))
            for number in sorted(self._parts)[:-_KEPT]:  # whose last visit never came
                del self._parts[number]
        if last.number not in came:
            return Readings(_NONE, _NONE, np.empty((0, 0), np.uint8), failure)
        readings = readings_at(last, came[last.number], rate)
        failure = readings.failure or failure
        if all(place.start == place.stop for place in self.places[:-1]):
            return readings._replace(failure=failure)
        whole = np.array([number in self._parts for number in readings.numbers.tolist()], bool)
        numbers = readings.numbers[whole]
        earlier_parts = [self._parts.pop(number) for number in numbers.tolist()]
        if not len(numbers):
            return Readings(_NONE, _NONE, readings.parts[:0], failure)
        parts = np.array(earlier_parts, np.uint8)
        return Readings(
            numbers, readings.times_ns[whole], np.concatenate([parts, readings.parts[whole]], axis=1), failure
        )


_NONE: Numbers = np.empty(0, np.int64)
