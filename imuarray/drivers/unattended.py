"""The transactions of one reading, for a microcontroller that has no drivers.

Most readings are one transaction, those of an LIS3MDL are two in one frame; the driver fetches once from a bus that
records the transactions. A barometer needs two or three, with waits in between. The answers are joined to the burst
that the driver's `decode` reads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from imuarray.array import SensorConfig
from imuarray.bus.serial_link import MAX_LIST_READ, Request
from imuarray.drivers import DRIVERS, Driver
from imuarray.drivers.akm import Ak8975
from imuarray.drivers.barometers import ForcedBarometer
from imuarray.drivers.fifo_clock import TOLERANCE
from imuarray.drivers.six_axis import QueuedHalf
from imuarray.drivers.six_axis_queue import UnattendedQueue
from imuarray.facts import bmp180


@dataclass(frozen=True)
class Visit:
    """The requests to one chip in one frame. The answer to the first request, from byte `skipped` on, is a part of the
    burst. If one of the bits `busy` is set in the first byte of this answer, the conversion was not finished, and there
    is no reading.
    """

    requests: tuple[Request, ...]
    skipped: int = 0
    busy: int = 0
    wait_ns: int = 0
    """Least time since the previous visit, in ns."""


class _NotingBus:
    """A bus that records the requests and answers with zeros."""

    def __init__(self) -> None:
        self.asked: list[Request] = []

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        self.asked.append(Request(address, write, read))
        return bytes(read)


class _NoClock:
    """A clock that does not advance."""

    def now_ns(self) -> int:
        return 0

    def sleep_until(self, at_ns: int) -> None:
        pass


def unattended_queue_of(driver: Driver) -> UnattendedQueue | None:
    """Return the queue of a driver, if a microcontroller can drain it."""
    queue = driver.die_queue if isinstance(driver, QueuedHalf) else None
    return queue if isinstance(queue, UnattendedQueue) else None


def needs_counting(queue: UnattendedQueue) -> bool:
    """Return whether the microcontroller must read the number of samples that it counted; older firmware can't."""
    return any(request.rule is not None for request in queue.drain_requests(1))


def least_drains_hz(queue: UnattendedQueue, rate_hz: float) -> float:
    """Return the least rate at which the queue of a chip that takes `rate_hz` samples a second must be drained."""
    return rate_hz * (1 + TOLERANCE) / (queue.most_samples(MAX_LIST_READ) - 1)


def drain_of(queue: UnattendedQueue, address: int, rate_hz: float, pause_s: float) -> Visit:
    """Return the visit that drains the queue of the chip at `address`, `pause_s` after the previous visit."""
    requests = queue.drain_requests(math.ceil(rate_hz * (1 + TOLERANCE) * pause_s) + 1)
    return Visit(
        tuple(
            Request(address, bytes([request.register.address]), min(request.read, MAX_LIST_READ), request.rule)
            for request in requests
        )
    )


def visits_of(sensor: SensorConfig) -> tuple[Visit, ...]:
    """Return the visits of one reading, in order; ValueError for a sensor with `fifo`, which returns any number of
    readings per visit.
    """
    if sensor.fifo:
        raise ValueError(f"sensor {sensor.name}: a queue is drained by its driver")
    if sensor.chip == "bmp180":
        return _bmp180(sensor.address)
    bus = _NotingBus()
    driver = DRIVERS[sensor.chip](bus, sensor, _NoClock())
    if isinstance(driver, ForcedBarometer):
        return _forced_barometer(sensor.address, driver)
    driver.fetch()
    if isinstance(driver, Ak8975):  # a visit reads, and starts another measurement at once
        return (Visit(tuple(bus.asked)),)
    return tuple(Visit((request,)) for request in bus.asked)


def _forced_barometer(address: int, driver: ForcedBarometer) -> tuple[Visit, ...]:
    """Return the visits of one measurement: one starts it, one reads it after its longest duration."""
    start = Request(address, bytes([driver.force.register.address, driver.force.value]), 0)
    look = Request(address, bytes([driver.first.address]), driver.head + driver.burst)
    (longest_ns,) = driver.conversions_ns
    return Visit((start,)), Visit((look,), skipped=driver.head, busy=driver.busy, wait_ns=longest_ns)


def _bmp180(address: int) -> tuple[Visit, ...]:
    """Return the visits of temperature, then pressure: each is started, and read after its longest duration (BMP-40,
    BMP-44, BMP-46).
    """
    register = bytes([bmp180.CTRL_MEAS.address])
    start_temperature = Request(address, register + b"\x2e", 0)
    start_pressure = Request(address, register + b"\xf4", 0)
    busy = bmp180.CONVERTING.mask
    return (
        Visit((start_temperature,)),
        Visit((Request(address, register, 4), start_pressure), skipped=2, busy=busy, wait_ns=4_500_000),
        Visit((Request(address, register, 5),), skipped=2, busy=busy, wait_ns=25_500_000),
    )
