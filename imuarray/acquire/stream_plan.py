"""What a microcontroller is told to do in which frame, and where in its answers each sensor's bytes are.

Sensors that are read in the same frames share a list; a chip slower than the frames is read as often as it has
something new. Every list selects the channels that it needs by itself: a lost switch spoils one list. Registers
are read back in turn, each twice in `SWEEP_S`, so that two wrong reads in a row are no more than a second apart.

A chip that converts when it is asked to is visited several times for one reading. Where frames are so seldom that a
result would be old by the next one, the microcontroller is given shorter periods, several to a frame (`Plan.split`):
the other sensors are read in the first of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from imuarray.acquire.sensor_routes import SensorRoute
from imuarray.bus.mux import MuxChannel
from imuarray.bus.serial_link import PollList, Request
from imuarray.drivers import OnDemandDriver
from imuarray.drivers.unattended import Visit, visits_of
from imuarray.facts import pca9544a
from imuarray.facts.registers import Setting

SWEEP_S = 0.84
_SLACK = 1.1
"""By how much a chip's own clock may be fast without its readings getting lost between ours."""
_SLACK_NS = 500_000
"""How much closer than a frame two visits may come when a request is tried twice."""


@dataclass(frozen=True)
class Place:
    """One visit in the answers of list `number`: there in frames `offset`, `offset` + `every`, ...

    Positions of bytes: `ages` of the requests that must have been answered, `age` of the one that times the reading,
    and `start` to `stop`, its part of the burst; `busy` are bits that may not be set in byte `first`.
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
    """Where one register of one route is read back."""

    route: SensorRoute
    setting: Setting
    place: Place


@dataclass(frozen=True)
class Plan:
    """Lists for the microcontroller, and where to look: the visits of each route, in order, and the registers.

    `split` periods of the microcontroller are one frame; its frame numbers count periods.
    """

    split: int
    lists: tuple[PollList, ...]
    visits: tuple[tuple[Place, ...], ...]
    watched: tuple[ReadbackPlace, ...]


class _Lists:
    """Lists that grow, by (every, offset)."""

    def __init__(self) -> None:
        self._asked: dict[tuple[int, int], list[Request]] = {}
        self._numbers: dict[tuple[int, int], int] = {}
        self._sizes: dict[tuple[int, int], int] = {}
        self._selected: dict[tuple[int, int], tuple[int, int, int]] = {}

    def visit(self, route: SensorRoute, visit: Visit, every: int, offset: int) -> Place:
        """Put a visit at the end of its list, behind a switch to its channel if another is selected there."""
        key = every, offset
        number = self._numbers.setdefault(key, len(self._numbers))
        ages = [self._select(key, route)] if isinstance(route.driver.registers.bus, MuxChannel) else []
        own = [self._ask(key, request) for request in visit.requests]
        first = own[0] + 2
        stop = first + visit.requests[0].read
        return Place(
            number, every, offset, (*ages, *own), own[0], first, min(first + visit.skipped, stop), stop, visit.busy
        )

    def _select(self, key: tuple[int, int], route: SensorRoute) -> int:
        """Where it is told whether the channel of `route` could be selected."""
        bus = route.driver.registers.bus
        if not isinstance(bus, MuxChannel):
            raise TypeError(f"{route.sensor.name} is behind no multiplexer")
        address, channel, age = self._selected.get(key, (-1, -1, -1))
        if (address, channel) != (bus.mux.address, bus.number):
            setting = pca9544a.ENABLE(1) | pca9544a.CHANNEL(bus.number)
            age = self._ask(key, Request(bus.mux.address, bytes([setting.value]), 0))
            self._selected[key] = bus.mux.address, bus.number, age
        return age

    def _ask(self, key: tuple[int, int], request: Request) -> int:
        """Position of the age of this request."""
        position = self._sizes.get(key, 0)
        self._asked.setdefault(key, []).append(request)
        self._sizes[key] = position + 2 + request.read
        return position

    def finished(self) -> tuple[PollList, ...]:
        """All of them, by number."""
        return tuple(PollList(*key, tuple(self._asked[key])) for key in self._numbers)


def plan(routes: Sequence[SensorRoute], rate_hz: float) -> Plan:
    """The plan for reading `routes` in `rate_hz` frames a second; ValueError for one whose queue is drained."""
    split = _split(routes, rate_hz)
    period_rate_hz = rate_hz * split
    lists = _Lists()
    places: dict[int, tuple[Place, ...]] = {}
    segments = list(dict.fromkeys(route.segment for route in routes))
    ordered = sorted(routes, key=lambda route: segments.index(route.segment))
    for route in ordered:
        visits = visits_of(route.sensor)
        offsets, every = _rhythm(route, visits, rate_hz, split)
        places[id(route)] = tuple(
            lists.visit(route, visit, every, offset) for visit, offset in zip(visits, offsets, strict=True)
        )
    wanted = [(route, setting) for route in ordered for setting in route.driver.watched]
    sweep = max(1, math.floor(SWEEP_S / 2 * period_rate_hz))
    watched = tuple(
        ReadbackPlace(
            route, setting, lists.visit(route, _read_back(route, setting), sweep, index * sweep // len(wanted))
        )
        for index, (route, setting) in enumerate(wanted)
    )
    return Plan(split, lists.finished(), tuple(places[id(route)] for route in routes), watched)


def _read_back(route: SensorRoute, setting: Setting) -> Visit:
    address = route.driver.registers.address
    register = setting.register
    return Visit((Request(address, bytes([register.address]), register.readback_bytes),))


def _split(routes: Sequence[SensorRoute], rate_hz: float) -> int:
    """Into how many periods a frame is split: one if no result of a conversion is too old a frame later."""
    drivers = [route.driver for route in routes if isinstance(route.driver, OnDemandDriver)]
    return max((math.ceil(1e9 / rate_hz / driver.lasting_ns - 1e-6) for driver in drivers), default=1)


def _rhythm(route: SensorRoute, visits: Sequence[Visit], rate_hz: float, split: int) -> tuple[list[int], int]:
    """In which period after the first each visit is, and after how many periods it all begins anew; `split` of them
    are a frame.
    """
    period_ns = 1e9 / (rate_hz * split)
    waits = [math.ceil((visit.wait_ns + _SLACK_NS) / period_ns) if visit.wait_ns else 0 for visit in visits]
    offsets = [sum(waits[: index + 1]) for index in range(len(waits))]
    chip_rate_hz = route.sensor.chip_rate_hz
    if len(visits) > 1:
        return offsets, max(offsets[-1] + 1, math.ceil(rate_hz * split / chip_rate_hz), split)
    return offsets, split * max(1, math.floor(rate_hz / (_SLACK * chip_rate_hz)))
