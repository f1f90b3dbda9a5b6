"""Readings of one sensor on their way from the bus to the log: kept raw, decoded many at a time, written once trusted.

A row is written only when the chip's configuration has been seen to be right *after* it was read: a chip that fell back
to its defaults is noticed later than it happened, and what it said in between must not stand in the log as good.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.acquire.stations import Station
from imuarray.drivers import FifoDriver
from imuarray.log.format import LOST_BEFORE, OVERRUN, STALE, SUSPECT
from imuarray.log.writer import Block

_NEXT_FRAME = 1.1e9
"""A frame later, in ns at 1 Hz, with a margin for the way there and back."""


@dataclass
class Pending:
    """Bursts of one station that wait to be written; row numbers count from the oldest one that waits."""

    station: Station
    times_ns: list[int] = field(default_factory=list)
    bursts: bytearray = field(default_factory=bytearray)
    lost_before: list[int] = field(default_factory=list)
    overrun: list[int] = field(default_factory=list)
    suspect: list[tuple[int, int | None]] = field(default_factory=list)
    """Stretches of rows [first, last) in which the configuration was wrong; last None: still is."""
    missing: bool = False
    _last: npt.NDArray[Any] | None = None

    def __post_init__(self) -> None:
        self.driver = self.station.driver
        self._visited_ns = -(1 << 62)
        self.queue = self.driver.queue if isinstance(self.driver, FifoDriver) else None

    def due(self, now_ns: int, rate_hz: float) -> bool:
        """False for a chip so slow that the next frame is soon enough for its next sample; none is missed for it."""
        sensor = self.station.sensor
        if self.queue is not None or sensor.spec.on_demand or sensor.chip_rate_hz >= rate_hz:
            return True
        if now_ns + _NEXT_FRAME / rate_hz <= self._visited_ns + 1e9 / sensor.chip_rate_hz:
            return False
        self._visited_ns = now_ns
        return True

    def add(self, burst: bytes, at_ns: int) -> None:
        """One fetch: a reading taken at `at_ns`, or as many as a queue held."""
        if not burst:
            return
        if self.missing:
            self.lost_before.append(len(self.times_ns))
            self.missing = False
        if self.queue is None:
            self.times_ns.append(at_ns)
        else:
            if self.queue.overrun:
                self.overrun.append(len(self.times_ns))
            self.times_ns += self.queue.drained
        self.bursts += burst

    def distrust(self, row: int) -> None:
        """Rows from `row` on are suspect, until `trust`."""
        self.suspect.append((max(row, 0), None))

    def trust(self) -> None:
        """Rows from now on are good again."""
        self.suspect = [(first, len(self.times_ns) if last is None else last) for first, last in self.suspect]

    def take(self, count: int, epoch_ns: int, rate_hz: float) -> Block:
        """Decode the oldest `count` rows, and forget them.

        A chip that is polled more slowly than it measures overruns by design; only where every sample was meant to be
        read, at `rate_hz` frames a second or by its queue, is that worth a flag.
        """
        size = count * self.driver.burst
        decoded = self.driver.decode(np.frombuffer(self.bursts[:size], np.uint8).reshape(count, self.driver.burst))
        status = decoded.status.copy()
        if self.station.sensor.chip_rate_hz > rate_hz:
            status &= ~np.uint16(OVERRUN)
        status[[row for row in self.lost_before if row < count]] |= LOST_BEFORE
        status[[row for row in self.overrun if row < count]] |= OVERRUN
        for first, last in self.suspect:
            status[first:last] |= SUSPECT
        if not self.driver.tells_fresh:
            status |= self._repeated(decoded.counts)
        times = np.array(self.times_ns[:count], np.int64) - epoch_ns
        del self.times_ns[:count], self.bursts[:size]
        self.lost_before = _later(self.lost_before, count)
        self.overrun = _later(self.overrun, count)
        self.suspect = [
            (max(first - count, 0), None if last is None else last - count)
            for first, last in self.suspect
            if last is None or last > count
        ]
        return Block(times, decoded.counts, status, decoded.temperature_counts, decoded.compensated)

    def _repeated(self, counts: npt.NDArray[Any]) -> npt.NDArray[np.uint16]:
        """STALE where a triad equals the one before it; all that a chip without a ready bit lets us know."""
        before = np.concatenate([counts[:1] - 1 if self._last is None else self._last, counts[:-1]])
        self._last = counts[-1:]
        return np.where((counts == before).all(axis=1), STALE, 0).astype(np.uint16)


def _later(rows: Sequence[int], count: int) -> list[int]:
    """Row numbers after the oldest `count` rows are gone."""
    return [row - count for row in rows if row >= count]
