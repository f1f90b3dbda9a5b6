"""The plan of what a microcontroller reads in which frame, and the conversion of its answers into rows of the
sensors.

Sensors that are read in the same frames share a list; a chip slower than the frames is read as often as it has a new
value. Every list selects its own channels, so that a lost switch command spoils one list only. Registers are read back
in turn, each twice in `SWEEP_S`, so that two wrong reads in a row are at most a second apart.

A chip that converts on demand is visited several times for one reading. Where frames are so rare that a result would be
too old by the next one, the microcontroller is given shorter periods, several to a frame (`StreamPlan.split`): the
other sensors are read in the first of them. The same is done for a queue that holds more samples than one request can
read. A reading that did not arrive has no row; the next row is flagged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.acquire.bus_segment import MuxChannel, control_byte
from imuarray.acquire.sample_buffer import SampleBuffer, SensorRoute
from imuarray.arrays import Integers
from imuarray.bus.serial_bus import Samples, SerialSpiPort
from imuarray.bus.serial_link import AGE_HELD, AGE_NOBODY, MAX_PAYLOAD, PollList, Request
from imuarray.bus.spi import SpiChip
from imuarray.drivers import OnDemandDriver
from imuarray.drivers.unattended import Visit, drain_of, least_drains_hz, unattended_queue_of, visits_of
from imuarray.facts.registers import Setting

SWEEP_S = 0.84
MAX_TURNS = 64
"""Largest number of lists of read-backs; more read-backs share lists. The firmware has space for 128 lists."""
_SLACK = 1.1
"""Factor by which a chip's own clock may be fast without a loss of readings between two visits."""
_SLACK_NS = 500_000
"""Time in ns by which two visits may be closer than a frame if a request is tried twice."""


@dataclass(frozen=True)
class VisitPlace:
    """The place of one visit in the answers of list `number`, in frames `offset`, `offset` + `every`, ...

    Positions of bytes: `ages` of the requests that must have been answered, `age` of the one that times the reading,
    and `start` to `stop`, its part of the burst (of a drain, to the end of its last answer); `busy` are bits that may
    not be set in byte `first`.
    """

    number: int
    every: int
    offset: int
    ages: tuple[int, ...]
    age: int
    first: int
    start: int
    stop: int
    busy: int = 0


@dataclass(frozen=True)
class ReadbackPlace:
    """The place at which one register of one sensor is read back."""

    route: SensorRoute
    setting: Setting
    place: VisitPlace


@dataclass(frozen=True)
class StreamPlan:
    """Lists for the microcontroller, and where their answers belong: the visits of each route, in order, and the
    registers.

    `split` periods of the microcontroller are one frame; its frame numbers count periods.
    """

    split: int
    lists: tuple[PollList, ...]
    visits: tuple[tuple[VisitPlace, ...], ...]
    watched: tuple[ReadbackPlace, ...]


_Key = tuple[int, int, int]
"""Key of a list: its `every` and `offset`, and its number among the lists with these."""
_MUX_BYTES = 2
"""Bytes in the answer for the switch to a channel before a visit."""


class _Lists:
    """Lists under construction, by (every, offset)."""

    def __init__(self) -> None:
        self._requests: dict[_Key, list[Request]] = {}
        self._numbers: dict[_Key, int] = {}
        self._sizes: dict[_Key, int] = {}
        self._selected: dict[_Key, tuple[int, int, int]] = {}
        self._newest: dict[_Key, tuple[Request, int]] = {}
        self._parts: dict[tuple[int, int], int] = {}

    def visit(self, route: SensorRoute, visit: Visit, every: int, offset: int) -> VisitPlace:
        """Add a visit at the end of its list, after a switch to its channel if another one is selected there."""
        requests = [_wire_request(route, request) for request in visit.requests]
        key = self._key_with_room(every, offset, requests)
        number = self._numbers.setdefault(key, len(self._numbers))
        ages = [self._select(key, route)] if isinstance(route.driver.registers.bus, MuxChannel) else []
        request_ages = [self._add_request(key, request) for request in requests]
        first = request_ages[0] + 2
        stop = first + visit.requests[0].read
        if any(request.rule is not None for request in visit.requests):  # a drain: all answers belong to it
            stop = request_ages[-1] + 2 + visit.requests[-1].read
        return VisitPlace(
            number,
            every,
            offset,
            (*ages, *request_ages),
            request_ages[0],
            first,
            min(first + visit.skipped, stop),
            stop,
            visit.busy,
        )

    def _key_with_room(self, every: int, offset: int, requests: Sequence[Request]) -> _Key:
        """Return the list of these frames, or a new one if a frame of the link could not carry its answer."""
        key = every, offset, self._parts.setdefault((every, offset), 0)
        size = _MUX_BYTES + sum(2 + request.read for request in requests)
        is_repeated = len(requests) == 1 and self._newest.get(key, (None, 0))[0] == requests[0]
        if 1 + self._sizes.get(key, 0) + size <= MAX_PAYLOAD or is_repeated:
            return key
        self._parts[every, offset] += 1
        return every, offset, self._parts[every, offset]

    def _select(self, key: _Key, route: SensorRoute) -> int:
        """Return the position of the age that shows whether the channel of `route` could be selected."""
        bus = route.driver.registers.bus
        if not isinstance(bus, MuxChannel):
            raise TypeError(f"{route.sensor.name} is behind no multiplexer")
        address, channel, age = self._selected.get(key, (-1, -1, -1))
        if (address, channel) != (bus.mux.address, bus.number):
            age = self._add_request(key, Request(bus.mux.address, bytes([control_byte(bus.number)]), 0))
            self._selected[key] = bus.mux.address, bus.number, age
        return age

    def _add_request(self, key: _Key, request: Request) -> int:
        """Return the position of the age of this request. The two halves of a six-axis chip, read one after the other,
        need the same bytes, which are read once.
        """
        newest, position = self._newest.get(key, (None, 0))
        if newest == request and request.read:
            return position
        position = self._sizes.get(key, 0)
        self._requests.setdefault(key, []).append(request)
        self._sizes[key] = position + 2 + request.read
        self._newest[key] = request, position
        return position

    def finished(self) -> tuple[PollList, ...]:
        """Return all lists, by number."""
        return tuple(PollList(*key[:2], tuple(self._requests[key])) for key in self._numbers)


def _wire_request(route: SensorRoute, request: Request) -> Request:
    """Return a request as the microcontroller carries it out: on SPI its address is the chip select."""
    bus = route.driver.registers.bus
    if not isinstance(bus, SpiChip) or not isinstance(bus.port, SerialSpiPort):
        return request
    return replace(request, address=bus.port.address, write=bus.message(request.write, request.read))


def plan(routes: Sequence[SensorRoute], rate_hz: float) -> StreamPlan:
    """Return the plan for reading `routes` in `rate_hz` frames a second; ValueError for a queue that only the host can
    drain.
    """
    split = _split(routes, rate_hz)
    period_rate_hz = rate_hz * split
    lists = _Lists()
    places: dict[int, tuple[VisitPlace, ...]] = {}
    segments = list(dict.fromkeys(route.segment for route in routes))
    ordered = sorted(routes, key=lambda route: segments.index(route.segment))
    drained: dict[int, tuple[VisitPlace, ...]] = {}
    for route in ordered:
        queue = unattended_queue_of(route.driver)
        if id(queue) in drained:  # the queue of the other half of the chip
            places[id(route)] = drained[id(queue)]
            continue
        if queue is None:
            visits = visits_of(route.sensor)
            offsets, every = _rhythm(route, visits, rate_hz, split)
        else:
            chip_rate_hz = route.sensor.chip_rate_hz
            every = max(1, math.floor(period_rate_hz / least_drains_hz(queue, chip_rate_hz)))
            visits = (drain_of(queue, route.driver.registers.address, chip_rate_hz, every / period_rate_hz),)
            offsets = [0]
        places[id(route)] = tuple(
            lists.visit(route, visit, every, offset) for visit, offset in zip(visits, offsets, strict=True)
        )
        if queue is not None:
            drained[id(queue)] = places[id(route)]
    registers = [(route, setting) for route in ordered for setting in route.driver.watched]
    sweep = max(1, math.floor(SWEEP_S / 2 * period_rate_hz))
    turns = min(sweep, len(registers), MAX_TURNS)
    watched = tuple(
        ReadbackPlace(
            route,
            setting,
            lists.visit(route, _read_back(route, setting), sweep, _turn(index, len(registers), turns, sweep)),
        )
        for index, (route, setting) in enumerate(registers)
    )
    return StreamPlan(split, lists.finished(), tuple(places[id(route)] for route in routes), watched)


def _turn(index: int, count: int, turns: int, sweep: int) -> int:
    """Return the frame of a sweep in which read-back `index` of `count` has its turn, one of `turns`."""
    return (index * turns // count) * sweep // turns


def _read_back(route: SensorRoute, setting: Setting) -> Visit:
    address = route.driver.registers.address
    register = setting.register
    return Visit((Request(address, bytes([register.address]), register.readback_bytes),))


def _split(routes: Sequence[SensorRoute], rate_hz: float) -> int:
    """Return the number of periods in a frame: one if no result of a conversion is too old a frame later, and no queue
    has more samples by then than a request can read.
    """
    periods = [1]
    for route in routes:
        queue = unattended_queue_of(route.driver)
        if queue is not None:
            periods.append(math.ceil(least_drains_hz(queue, route.sensor.chip_rate_hz) / rate_hz - 1e-6))
        elif isinstance(route.driver, OnDemandDriver):
            periods.append(math.ceil(1e9 / rate_hz / route.driver.lasting_ns - 1e-6))
    return max(periods)


def _rhythm(route: SensorRoute, visits: Sequence[Visit], rate_hz: float, split: int) -> tuple[list[int], int]:
    """Return the period of each visit after the first, and the number of periods after which it repeats; `split` of
    them are a frame.
    """
    period_ns = 1e9 / (rate_hz * split)
    waits = [math.ceil((visit.wait_ns + _SLACK_NS) / period_ns) if visit.wait_ns else 0 for visit in visits]
    offsets = [sum(waits[: index + 1]) for index in range(len(waits))]
    chip_rate_hz = route.sensor.chip_rate_hz
    if any(waits):
        return offsets, max(offsets[-1] + 1, math.ceil(rate_hz * split / chip_rate_hz), split)
    return offsets, split * max(1, math.floor(rate_hz / (_SLACK * chip_rate_hz)))


FAILURE_TEXTS = {
    AGE_NOBODY: "no acknowledgement (errno 121)",
    AGE_HELD: "the clock is held (errno 110)",
    0: "the conversion was not finished",
}
"""Text of an event by age, for ages that encode a failure."""
_MOST_PENDING = 1024
LINK = "lost on the link, or the microcontroller was late"


class Readings(NamedTuple):
    """Readings of one visit that arrived: numbers of the frames (n,), times (n,) in ns on the host's clock, parts of
    the burst (n, size). `failure` is the cause of the last missing one, as the text of an event.
    """

    numbers: Integers
    times_ns: Integers
    parts: npt.NDArray[np.uint8]
    failure: str


def readings_at(place: VisitPlace, samples: Samples, rate: float) -> Readings:
    """Return the readings at `place`; `rate` is that of the host's clock relative to the microcontroller's."""
    payload = samples.payload
    ages = np.stack([ages_at(payload, position) for position in place.ages], axis=1)
    worst = ages.max(axis=1)
    outcome = np.where(worst >= AGE_HELD, worst, 1)
    if place.busy:
        outcome = np.where((outcome == 1) & (payload[:, place.first] & place.busy != 0), 0, outcome)
    is_read = outcome == 1
    times_ns = samples.sent_ns - np.rint(ages_at(payload, place.age) * (1000 * rate)).astype(np.int64)
    failed = outcome[~is_read]
    failure = FAILURE_TEXTS[int(failed[-1])] if len(failed) else ""
    return Readings(samples.numbers[is_read], times_ns[is_read], payload[is_read, place.start : place.stop], failure)


def ages_at(payload: npt.NDArray[np.uint8], position: int) -> Integers:
    """Return the ages (n,) in microseconds at a position of the answers (n, size) of a list, or what failed."""
    return payload[:, position].astype(np.int64) | payload[:, position + 1].astype(np.int64) << 8


class Rows:
    """Fills the rows of one sensor, whose readings consist of the visits at `places`."""

    def __init__(self, buffer: SampleBuffer, places: tuple[VisitPlace, ...]) -> None:
        self.buffer = buffer
        self.places = places
        self._forget()

    @property
    def doubt(self) -> str:
        """Return why the last readings can't be trusted, in the words of an event; empty if they can."""
        return ""

    @property
    def idle_ns(self) -> int:
        """Return for how long a queue has been empty although it was read, if that is long enough that the chip must
        have stopped; otherwise 0.
        """
        return 0

    def begin(self) -> None:
        """Prepare for the start of the recording; OSError from the bus."""

    def resume(self) -> None:
        """Prepare for a restart of the stream; OSError from the bus."""

    def restart(self) -> None:
        """Note that frames are counted from 0 again, and that readings were lost meanwhile."""
        self.buffer.mark_lost()
        self._forget()

    def _forget(self) -> None:
        self._last = self.places[-1].offset - self.places[-1].every
        self._parts: dict[int, npt.NDArray[np.uint8]] = {}

    def missing(self, number: int) -> int:
        """Return the number of readings that were due by frame `number` and have not arrived."""
        last = self.places[-1]
        return max(0, (number - last.offset) // last.every - (self._last - last.offset) // last.every)

    def interrupted(self, number: int) -> int:
        """Return the number of readings that are lost because the stream was stopped after frame `number`."""
        return self.missing(number)

    def left_out(self, periods: int) -> int:
        """Return the number of readings that are lost when the stream stops for this many periods."""
        return periods // self.places[-1].every

    def unread(self, number: int, now_ns: int) -> int:
        """Return the number of readings that have not arrived although the recording is over, after frame `number` at
        `now_ns`.
        """
        return self.missing(number)

    def take(self, samples_by_list: Mapping[int, Samples], rate: float) -> tuple[int, str]:
        """Add the readings among the samples; return how many are missing before the last of them, and the cause of the
        last missing one.
        """
        readings = self._whole(samples_by_list, rate)
        count = len(readings.numbers)
        if count == 0:
            return 0, readings.failure
        buffer, every = self.buffer, self.places[-1].every
        gaps = np.diff(readings.numbers, prepend=self._last) // every - 1
        buffer.add_rows(readings.times_ns.tolist(), readings.parts.tobytes(), np.flatnonzero(gaps).tolist())
        self._last = int(readings.numbers[-1])
        return int(gaps.sum()), readings.failure

    def _whole(self, samples_by_list: Mapping[int, Samples], rate: float) -> Readings:
        """Return the readings all of whose visits arrived; a reading of several visits has the time of the last."""
        last = self.places[-1]
        failure = ""
        for place in self.places[:-1]:
            if place.start == place.stop or place.number not in samples_by_list:
                continue
            earlier = readings_at(place, samples_by_list[place.number], rate)
            failure = earlier.failure or failure
            shift = last.offset - place.offset
            self._parts.update(zip((earlier.numbers + shift).tolist(), earlier.parts, strict=True))
            for number in sorted(self._parts)[:-_MOST_PENDING]:  # their last visit did not arrive
                del self._parts[number]
        if last.number not in samples_by_list:
            return Readings(_EMPTY, _EMPTY, np.empty((0, 0), np.uint8), failure)
        readings = readings_at(last, samples_by_list[last.number], rate)
        failure = readings.failure or failure
        if all(place.start == place.stop for place in self.places[:-1]):
            return readings._replace(failure=failure)
        whole = np.array([number in self._parts for number in readings.numbers.tolist()], bool)
        numbers = readings.numbers[whole]
        earlier_parts = [self._parts.pop(number) for number in numbers.tolist()]
        if not len(numbers):
            return Readings(_EMPTY, _EMPTY, readings.parts[:0], failure)
        parts = np.array(earlier_parts, np.uint8)
        return Readings(
            numbers, readings.times_ns[whole], np.concatenate([parts, readings.parts[whole]], axis=1), failure
        )


_EMPTY: Integers = np.empty(0, np.int64)
