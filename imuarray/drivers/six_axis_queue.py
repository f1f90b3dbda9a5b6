"""The one queue of a six-axis die, and its two readers, the drivers of the accelerometer and the gyroscope.

The half that is visited first drains the queue; the rows of the other half wait for its visit. A doubtful drain is
discarded as a whole: if the queue overflowed in a way that may have shifted its bytes, a transfer was aborted, or bytes
are no valid packet, the queue is emptied, and the next rows of both halves carry the flag "overrun".
"""

from __future__ import annotations

import errno
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np

from imuarray.bus import linux, serial_link, spi
from imuarray.bus.serial_link import CountRule
from imuarray.clock import Clock
from imuarray.drivers import icm42688_packets as packet_format
from imuarray.drivers.driver import Bytes, Registers
from imuarray.drivers.fifo_clock import TOLERANCE, FifoClock
from imuarray.facts import icm42688, lsm6dso
from imuarray.facts.registers import Register, Setting

LONGEST_READS: Mapping[str, int] = MappingProxyType(
    {
        "i2c:": linux.MAX_MESSAGE,  # `i2cdev_ioctl_rdwr`; SMBus blocks of 32 bytes are not used: LNX-05
        "spi:": spi.MAX_MESSAGE - 1,  # spidev's default `bufsiz`, in which the register's address comes first
        "serial:": serial_link.MAX_PAYLOAD - 1,  # a frame of the link, in which the result comes first
    }
)
"""Largest number of bytes of a read in one transaction, by bus."""
LONGEST_READ = min(LONGEST_READS.values())
"""Largest number of bytes of a read that all buses can carry. Reads of a queue are split in the same way on all of
them, so that a transcript of one bus can replace another bus.
"""


WANTED_NS = 20e3
"""Uncertainty of a sample's time in ns above which samples are counted again."""
LONGEST_WAIT_NS = 1_000_000
"""Longest wait in ns for the best time of this count; it is omitted if the wait would be longer."""
BEFORE_COUNT = 0.4
"""Share of a transaction after which a chip latches its count: three bytes of five or six on I2C, one of three or four
on SPI.
"""
_FLAGS_AND_COUNT = 3
"""Number of bytes of INT_STATUS and the count of an ICM-42688-P; FIFO_DATA is the next register (TDK-85)."""
_UNEVEN_SAMPLES, _UNEVEN_SHARE = 4, 0.02
"""Largest difference of a count from the number expected for the time since the last one: a number of samples, and a
share of the expected number for a slow chip.
"""
MOST_ROWS = 4096
"""Largest number of rows that wait for a half that is not visited; if there are more, all are dropped, and the next row
is flagged.
"""


class QueueReader:
    """One half's share of the queue of its die.

    `drained`, `uncertainties_ns` and `overrun` describe the last result of `take`: its times, their largest errors, and
    whether samples are missing before it.
    """

    def __init__(self, queue: DieQueue) -> None:
        self.drained: list[int] = []
        self.uncertainties_ns: Sequence[float] = ()
        self.overrun = False
        self._queue = queue
        self._bursts: list[bytes] = []
        self._times_ns: list[int] = []
        self._uncertainties_ns: list[float] = []
        self._gap = False
        self._has_given = False

    @property
    def gaps(self) -> Sequence[int]:
        """See `QueueTimes`."""
        return (0,) if self.overrun and self.drained else ()

    def restart(self) -> None:
        """Discard the waiting rows: the chip was set up again, or another chip was drained in its place."""
        self._queue.distrust()
        self.clear()

    def clear(self, *, gap: bool = False) -> None:
        """Discard the waiting rows; with `gap` samples that were due are missing."""
        self._bursts, self._times_ns, self._uncertainties_ns = [], [], []
        self._gap = gap and self._has_given

    @property
    def overruns(self) -> int:
        """See `DieQueue`."""
        return self._queue.overruns

    @property
    def waits(self) -> bool:
        """Return whether rows wait for this half."""
        return bool(self._times_ns)

    def put(self, bursts: bytes, clock: FifoClock, *, gap: bool) -> None:
        """Store rows at the times that `clock` returned last; with `gap` samples are missing before them."""
        if len(self._times_ns) > MOST_ROWS:
            self.clear(gap=True)
        self._gap |= gap and self._has_given
        self._bursts.append(bursts)
        self._times_ns += clock.drained
        self._uncertainties_ns += clock.uncertainties_ns

    def take(self) -> bytes:
        """Return and remove all waiting bursts."""
        self.drained, self.uncertainties_ns = self._times_ns, self._uncertainties_ns
        if not self.drained:
            self.overrun = False
            return b""
        bursts = self._bursts[0] if len(self._bursts) == 1 else b"".join(self._bursts)
        self.overrun, self._gap, self._has_given = self._gap, False, True
        self._bursts, self._times_ns, self._uncertainties_ns = [], [], []
        return bursts


class DieQueue:
    """The queue of one die at `rate_hz`; the halves that read it `join`."""

    def __init__(self, registers: Registers, clock: Clock, rate_hz: float) -> None:
        self.registers = registers
        self.clock = clock
        self.times = FifoClock(rate_hz)
        self._readers: dict[str, QueueReader] = {}
        self._trusted = self.ran_over = False
        self._drains = AcceptedDrains()
        self.overruns = 0
        """Number of drains without samples because the queue had overflowed."""
        self._shortest_ns = 1 << 62

    def join(self, half: str) -> QueueReader:
        """Return the reader of one half."""
        return self._readers.setdefault(half, QueueReader(self))

    @property
    def halves(self) -> tuple[str, ...]:
        """The halves that read the queue."""
        return tuple(self._readers)

    @property
    def is_trusted(self) -> bool:
        """False if the queue must be emptied before its samples can be used."""
        return self._trusted

    def distrust(self) -> None:
        """Empty the queue before the next drain."""
        self._trusted = False

    def empty(self, by: QueueReader | None = None) -> None:
        """Empty the queue, which restarts it: samples of the halves are missing, except for the half `by`, which
        requested it.
        """
        self._flush()
        self._trusted = True
        self._restart()
        for reader in self._readers.values():
            reader.clear(gap=reader is not by)

    def fetch(self, reader: QueueReader) -> bytes:
        """Return the rows of one half. The half that joined first drains the queue at every visit, the other one if no
        rows wait for it.
        """
        if not reader.waits or reader is next(iter(self._readers.values())):
            if not self._trusted:
                self.empty()
            else:
                self._trusted = False  # until the drain is complete
                self._trusted = self._drain()
                if self._trusted:
                    self._look_again()
        return reader.take()

    def _look_again(self) -> None:
        """Count once more, at the time at which a count gives the most information on the times of samples, if these
        are uncertain and the wait is short.
        """
        now_ns = self.clock.now_ns()
        at_ns = self.times.best_look_ns(now_ns, max(WANTED_NS, (1 - BEFORE_COUNT) * self._shortest_ns))
        if at_ns is None or at_ns - now_ns > LONGEST_WAIT_NS:
            return
        self.clock.sleep_until(at_ns)
        count, _, (from_ns, until_ns) = self._count_between()
        self.times.look(count, from_ns, until_ns)

    def _count(self) -> tuple[int, int]:
        """Return the number of samples in the chip's queue, and its flags; OSError for an impossible number."""
        raise NotImplementedError

    def _count_between(self) -> tuple[int, int, tuple[int, int]]:
        """Return the samples in the chip, flags, and the times between which the chip counted."""
        begun_ns = self.clock.now_ns()
        count, flags = self._count()
        ended_ns = self.clock.now_ns()
        self._shortest_ns = min(self._shortest_ns, ended_ns - begun_ns)
        return count, flags, (begun_ns + round(BEFORE_COUNT * self._shortest_ns), ended_ns)

    def _read(self, register: Register, count: int, size: int) -> bytes:
        """Read `count` samples of `size` bytes from the queue's register, in as many transactions as necessary."""
        most = LONGEST_READ // size
        pieces = (min(most, count - begin) for begin in range(0, count, most))
        return b"".join(self.registers.peek(register, samples * size) for samples in pieces)

    def _restart(self) -> None:
        self.times.restart()
        self._drains = AcceptedDrains()

    def _flush(self) -> None:
        raise NotImplementedError

    def _drain(self) -> bool:
        """Read the queue and `put` the rows of each reader; return False if the bytes can't be trusted."""
        raise NotImplementedError


class QueueRequest(NamedTuple):
    """One transaction of a drain: `read` bytes from `register` on, or with `rule` as many as the last answer states."""

    register: Register
    read: int
    rule: CountRule | None = None


@runtime_checkable
class UnattendedQueue(Protocol):
    """A queue that a microcontroller without drivers drains: by one transaction, whose length need not match the count,
    or by a count, the counted packets, and flags.
    """

    ran_over: bool
    """True if it had overflowed before the samples that were accepted last."""
    survives_overrun: bool
    """False if it must be emptied after an overflow: its packets may begin anywhere."""

    def most_samples(self, bytes_read: int) -> int:
        """Return how many samples of the die one request of `bytes_read` bytes can read."""

    def drain_requests(self, samples: int) -> tuple[QueueRequest, ...]:
        """Return the transactions of a drain of up to `samples` samples; the count is taken in the first of them."""

    def packet_bytes(self, answers: Sequence[bytes]) -> int:
        """Return the least number of bytes of the first transaction after its count."""

    def accept(self, answers: Sequence[bytes], counted_ns: tuple[int, int]) -> bool:
        """Store the samples of a drain for their readers; their number was counted in the given time. Return False if
        the bytes can't be trusted; then no drain is accepted until the queue was emptied. OSError for an impossible
        count.
        """


def impossible(count: int, capacity: int) -> OSError:
    """Return the error for a count that exceeds the capacity of the queue, as a dead bus may return."""
    return OSError(errno.EIO, f"its queue reports {count} and holds {capacity}")


class AcceptedDrains:
    """The last drain of a queue that a microcontroller drains. The next count shows whether a drain in between was
    carried out but did not arrive: then fewer samples wait than the chip took in that time. Time stamps do not show it
    for longer times than that in which they wrap.
    """

    def __init__(self) -> None:
        self._at_ns: int | None = None
        self._unread = 0

    def note(self, unread: int, at_ns: int) -> None:
        """Note that a drain was accepted that left `unread` packets in the queue."""
        self._at_ns, self._unread = at_ns, unread

    def since_ns(self, at_ns: int) -> int:
        """Return the time since the last accepted drain; 0 before the first."""
        return 0 if self._at_ns is None else at_ns - self._at_ns

    def is_missing(self, count: int, taken: float, slack: float = _UNEVEN_SAMPLES) -> bool:
        """Return whether the count of packets shows that a drain is missing, if the chip took about `taken` samples
        since the last one; always True before the first.
        """
        return self._at_ns is None or self._unread + taken - count > slack + _UNEVEN_SHARE * taken


class Icm42688Queue(DieQueue):
    """The queue of an ICM-42688-P: 2048 bytes in packets that begin with a header (TDK-80 ... TDK-86): 16 bytes with
    both halves and a time stamp, 8 bytes with one half. A row is a packet of 16 bytes. With `high_resolution` packets
    have 20 bytes and always both halves, and `high_resolution_rows` makes the rows.

    Flags and count are read together, then the packets. The stamps show where samples are missing, and the flag "full"
    where more are missing than the 65.536 ms of the stamps.
    """

    CAPACITY: ClassVar[int] = 2048
    survives_overrun: ClassVar[bool] = True

    def __init__(
        self,
        registers: Registers,
        clock: Clock,
        rates_hz: tuple[float, float],
        *,
        high_resolution: bool = False,
        has_pulses: bool = False,
    ) -> None:
        """`rates_hz`: the actual data rate, and the one that the registers name. The clock of the samples also counts
        the stamps: a period has the same number of their microseconds at any frequency of the clock (DEC-65). With
        `has_pulses` packets always have both halves, and stamps may count from the last synchronisation pulse (DEC-66),
        so that they do not show missing samples.
        """
        rate_hz, nominal_rate_hz = rates_hz
        super().__init__(registers, clock, rate_hz)
        self.high_resolution, self.has_pulses = high_resolution, has_pulses
        self._stamp: int | None = None
        self._full = False
        self._period_us = 1e6 / nominal_rate_hz

    @property
    def _has_stamp(self) -> bool:
        return self.size != packet_format.ONE_TRIAD and not self.has_pulses

    @property
    def size(self) -> int:
        """Return the bytes of a packet."""
        return packet_format.packet_size(self._header)

    def _flush(self) -> None:
        self.registers.poke(icm42688.SIGNAL_PATH_RESET, icm42688.FIFO_FLUSH(1).value)
        self.registers.peek(icm42688.INT_STATUS, _FLAGS_AND_COUNT)  # the first count after a flush is 0: TDK-84

    def _restart(self) -> None:
        super()._restart()
        self._stamp, self._full = None, False

    def _count(self) -> tuple[int, int]:
        return self._parse_count(self.registers.peek(icm42688.INT_STATUS, _FLAGS_AND_COUNT))

    def _parse_count(self, burst: bytes) -> tuple[int, int]:
        status, high, low = burst[:_FLAGS_AND_COUNT]
        filled = high << 8 | low
        if filled > self.CAPACITY + self.size:
            raise impossible(filled, self.CAPACITY)
        self._full |= bool(status & icm42688.FIFO_FULL.mask)
        return filled // self.size, int(self._full)

    def _drain(self) -> bool:
        count, full, counted_ns = self._count_between()
        if full and not self._has_stamp:  # missing packets would not be detected
            self.overruns += 1
            return False
        if not count:
            return True
        packets = self._read(icm42688.FIFO_DATA, count, self.size)
        kinds = {header & 0xF0 for header in set(packets[:: self.size])}
        return kinds == {self._header} and self._put(packets, 0, counted_ns, gap=bool(full))

    def most_samples(self, bytes_read: int) -> int:
        """See `UnattendedQueue`."""
        return (bytes_read - _FLAGS_AND_COUNT) // self.size

    def drain_requests(self, samples: int) -> tuple[QueueRequest, ...]:
        """Implement `UnattendedQueue`: flags, count and packets are consecutive registers, and the address does
        not increment beyond the last one, so that one transaction reads them all.
        """
        return (QueueRequest(icm42688.INT_STATUS, _FLAGS_AND_COUNT + samples * self.size),)

    def packet_bytes(self, answers: Sequence[bytes]) -> int:
        """See `UnattendedQueue`."""
        return len(answers[0]) - _FLAGS_AND_COUNT

    def accept(self, answers: Sequence[bytes], counted_ns: tuple[int, int]) -> bool:
        """Implement `UnattendedQueue`. After the packets of the queue, headers state that it is empty (TDK-81)."""
        (burst,) = answers
        count, full = self._parse_count(burst)
        headers = burst[_FLAGS_AND_COUNT :: self.size]
        present = next((index for index, header in enumerate(headers) if header & 0xF0 != self._header), len(headers))
        is_whole = present >= min(count, len(headers))
        is_trusted = self._trusted and is_whole and all(map(packet_format.is_empty, headers[present:]))
        self._trusted = False
        if is_trusted and present:
            self.ran_over = bool(full)
            gap = self.ran_over or self._drains.is_missing(
                count, self._drains.since_ns(counted_ns[0]) / self.times.period_ns
            )
            packets = burst[_FLAGS_AND_COUNT : _FLAGS_AND_COUNT + present * self.size]
            is_trusted = self._put(packets, count - present, counted_ns, gap=gap)
            self._drains.note(count - present, counted_ns[1])
        elif is_trusted:
            self.times.look(count, *counted_ns)
        self._trusted = is_trusted
        return is_trusted

    def _put(self, packets: bytes, unread: int, counted_ns: tuple[int, int], *, gap: bool) -> bool:
        """Store packets for their readers; `unread` more were counted. Return False if one is missing between them."""
        size = self.size
        count = len(packets) // size
        self._full = False
        if self._has_stamp:
            offset = packet_format.stamp_offset(size)
            first, last = (packets[at] << 8 | packets[at + 1] for at in (offset, len(packets) - size + offset))
            if self._are_missing(last - first, count - 1):
                return False
            gap |= self._stamp is not None and self._are_missing(first - self._stamp, 1)
            self._stamp = last
        self.times.times(count, counted_ns[0], gap, until_ns=counted_ns[1], unread=unread)
        for half, reader in self._readers.items():
            reader.put(self._rows(packets, half), self.times, gap=gap)
        return True

    def _rows(self, packets: bytes, half: str) -> bytes:
        if self.high_resolution:
            return packet_format.high_resolution_rows(packets, half)
        return packet_format.widened(packets, half) if self.size == packet_format.ONE_TRIAD else packets

    @property
    def _header(self) -> int:
        """Bits 7:4 of a header: not empty, accelerometer, gyroscope, 16 bits (TDK-81)."""
        if self.high_resolution:
            return packet_format.header_of(packet_format.HALVES, high_resolution=True)
        return packet_format.header_of(packet_format.HALVES if self.has_pulses else self.halves)

    def _are_missing(self, stamps: int, periods: int) -> bool:
        """Return whether a difference of time stamps, known to 16 bits, differs from `periods` periods."""
        off_us = (stamps - periods * self._period_us + 0x8000) % 0x10000 - 0x8000
        return abs(off_us) > self._period_us / 4


FIFO_ON, FIFO_RESET, OVERFLOW, EVERYTHING = 0x40, 0x04, 0x10, 0xF8
"""Bits of USER_CTRL (6 and 2), INT_STATUS (4), and FIFO_EN with thermometer, gyroscope and accelerometer, equal in the
family (INV-24, INV-27, INV-98).
"""


class MpuQueue(DieQueue):
    """A queue of bytes that loses its oldest ones when it is full (INV-27, INV-98): records of 14 bytes in the format
    of the data registers, accelerometer, thermometer, gyroscope.

    After an overflow a record may begin anywhere. The flag is therefore read after the records, so that an overflow
    during the read is also detected; the queue is then emptied. No more bytes are read than were counted, because an
    empty queue repeats its last byte.
    """

    SIZE: ClassVar[int] = 14
    survives_overrun: ClassVar[bool] = False

    # The registers and their contents: independent of one another.
    def __init__(
        self,
        registers: Registers,
        clock: Clock,
        rate_hz: float,
        capacity: int,
        control: Setting,
        table: Mapping[str, Register],
    ) -> None:
        """`control`: USER_CTRL with the queue on; `table` has FIFO_EN, FIFO_COUNT_H, FIFO_R_W, INT_STATUS."""
        super().__init__(registers, clock, rate_hz)
        self._capacity, self._control, self._table = capacity, control, table

    def _flush(self) -> None:
        """Switch the queue off, empty it, and switch it on (INV-99); reading the flags clears them."""
        enable, user = self._table["FIFO_EN"], self._control.register
        self.registers.poke(enable, 0)
        self.registers.poke(user, self._control.value & ~FIFO_ON | FIFO_RESET)
        self.registers.poke(user, self._control.value)
        self.registers.peek(self._table["INT_STATUS"])
        self.registers.poke(enable, EVERYTHING)

    def _count(self) -> tuple[int, int]:
        filled = int.from_bytes(self.registers.peek(self._table["FIFO_COUNT_H"], 2), "big")
        if filled > self._capacity:
            raise impossible(filled, self._capacity)
        return filled // self.SIZE, int(filled > self._capacity - self.SIZE)

    def _drain(self) -> bool:
        count, nearly_full, counted_ns = self._count_between()
        if not count:
            return True
        records = self._read(self._table["FIFO_R_W"], count, self.SIZE)
        flags = self.registers.peek(self._table["INT_STATUS"])[0]
        if flags & OVERFLOW or nearly_full:
            self.overruns += 1
            return False
        self._put(records, 0, counted_ns, gap=False)
        return True

    def _restart(self) -> None:
        super()._restart()
        self.ran_over = False

    def _put(self, records: bytes, unread: int, counted_ns: tuple[int, int], *, gap: bool) -> None:
        count = len(records) // self.SIZE
        self.times.times(count, counted_ns[0], gap, until_ns=counted_ns[1], unread=unread)
        for reader in self._readers.values():
            reader.put(records, self.times, gap=gap)

    def most_samples(self, bytes_read: int) -> int:
        """See `UnattendedQueue`."""
        return bytes_read // self.SIZE

    def drain_requests(self, samples: int) -> tuple[QueueRequest, ...]:
        """Implement `UnattendedQueue`: read no more than was counted, so that no record is cut; then read the flags."""
        records = QueueRequest(self._table["FIFO_R_W"], samples * self.SIZE, CountRule(self.SIZE, is_big_endian=True))
        return QueueRequest(self._table["FIFO_COUNT_H"], 2), records, QueueRequest(self._table["INT_STATUS"], 1)

    def packet_bytes(self, answers: Sequence[bytes]) -> int:
        """See `UnattendedQueue`."""
        return 0

    def accept(self, answers: Sequence[bytes], counted_ns: tuple[int, int]) -> bool:
        """Implement `UnattendedQueue`. A drain that did not arrive may have contained the flag of an overrun; no
        overrun is assumed if the queue can't have filled since the last drain.
        """
        counted, records, flags = answers
        filled = int.from_bytes(counted, "big")
        if filled > self._capacity:
            raise impossible(filled, self._capacity)
        count = filled // self.SIZE
        present = min(count, len(records) // self.SIZE)
        since_ns = self._drains.since_ns(counted_ns[0])
        gap = self._drains.is_missing(count, since_ns / self.times.period_ns)
        may_have_filled = since_ns > self._capacity / self.SIZE * self.times.nominal_ns * (1 - TOLERANCE)
        self.ran_over = bool(flags[0] & OVERFLOW) or filled > self._capacity - self.SIZE or (gap and may_have_filled)
        self._trusted &= not self.ran_over
        if self._trusted and present:
            self._put(records[: present * self.SIZE], count - present, counted_ns, gap=gap)
            self._drains.note(count - present, counted_ns[1])
        elif self._trusted and not gap:
            self.times.look(count, *counted_ns)
        return self._trusted


class Lsm6dsoQueue(DieQueue):
    """The queue of an LSM6DSO: 512 words of 7 bytes, each a tag and three numbers (LSM-40 ... LSM-45): samples of
    either half in the order in which they were taken, and at intervals a temperature. A row is a word followed by the
    last temperature.
    """

    CAPACITY: ClassVar[int] = 512
    WORD: ClassVar[int] = 7
    TAGS: ClassVar[Mapping[str, int]] = MappingProxyType({"gyro": 1, "acc": 2})
    TEMPERATURE: ClassVar[int] = 3
    TEMPERATURES_HZ: ClassVar[float] = 52.0
    survives_overrun: ClassVar[bool] = True

    def __init__(self, registers: Registers, clock: Clock, rate_hz: float, mode: Setting) -> None:
        """`mode`: FIFO_CTRL4 with the queue on, `TEMPERATURES_HZ` among its samples."""
        super().__init__(registers, clock, rate_hz)
        self._mode, self._rate_hz = mode, rate_hz
        self._clocks = {half: FifoClock(rate_hz) for half in self.TAGS}
        self._temperature = b"\x00\x00"

    def _flush(self) -> None:
        """Empty the queue through bypass (LSM-43)."""
        self.registers.poke(self._mode.register, 0)
        self.registers.poke(self._mode.register, self._mode.value)
        self.registers.peek(lsm6dso.FIFO_STATUS1, 2)
        self._temperature = self.registers.peek(lsm6dso.OUT_TEMP_L, 2)

    def _restart(self) -> None:
        super()._restart()
        for clock in self._clocks.values():
            clock.restart()
        self.ran_over = False

    def _count(self) -> tuple[int, int]:
        """Return the number of words for samples: each half and the temperature are separate words."""
        return self._parse_count(self.registers.peek(lsm6dso.FIFO_STATUS1, 2))

    def _parse_count(self, status: bytes) -> tuple[int, int]:
        low, high = status
        count = lsm6dso.FIFO_LEVEL_HIGH.of(high) << 8 | low
        if count > self.CAPACITY:
            raise impossible(count, self.CAPACITY)
        return count, high & (lsm6dso.FIFO_OVERRUN.mask | lsm6dso.FIFO_OVERRUN_LATCHED.mask)

    def _look_again(self) -> None:
        """Do nothing: a count of words does not show to which half they belong."""

    def _drain(self) -> bool:
        count, lost, counted_ns = self._count_between()
        if not count:
            return True
        data = self._read(lsm6dso.FIFO_DATA_OUT_TAG, count, self.WORD)
        return self._put(data, 0, counted_ns, gap=bool(lost))

    def _put(self, data: bytes, unread: int, counted_ns: tuple[int, int], *, gap: bool) -> bool:
        """Store words for their readers; `unread` more were counted. Return False for a word that was not requested."""
        words = np.frombuffer(data, np.uint8).reshape(-1, self.WORD)
        tags = np.asarray(words[:, 0] >> 3, np.uint8)
        if not np.isin(tags, (*self.TAGS.values(), self.TEMPERATURE)).all():
            return False
        rows = np.concatenate([words, self._temperatures(words, tags)], axis=1)
        for half, reader in self._readers.items():
            own_rows = rows[tags == self.TAGS[half]]
            clock = self._clocks[half]
            from_ns, until_ns = counted_ns
            if unread:  # the halves of these words are unknown: the count may be wrong by two samples
                from_ns -= round(2 * clock.nominal_ns)
                until_ns += round(2 * clock.nominal_ns)
            unread_samples = round(unread / self._words_per_sample)
            clock.times(len(own_rows), from_ns, gap, until_ns=until_ns, unread=unread_samples)
            reader.put(own_rows.tobytes(), clock, gap=gap)
        return True

    @property
    def _words_per_sample(self) -> float:
        return len(self._readers) + self.TEMPERATURES_HZ / self._rate_hz

    def most_samples(self, bytes_read: int) -> int:
        """See `UnattendedQueue`."""
        return int(bytes_read // self.WORD / self._words_per_sample)

    def drain_requests(self, samples: int) -> tuple[QueueRequest, ...]:
        """Implement `UnattendedQueue`: ten bits of the count, low byte first, are words."""
        rule = CountRule(self.WORD, mask=0x03FF, is_of_packets=True)
        words = math.ceil(samples * self._words_per_sample)
        return (
            QueueRequest(lsm6dso.FIFO_STATUS1, 2),
            QueueRequest(lsm6dso.FIFO_DATA_OUT_TAG, words * self.WORD, rule),
        )

    def packet_bytes(self, answers: Sequence[bytes]) -> int:
        """See `UnattendedQueue`."""
        return 0

    def accept(self, answers: Sequence[bytes], counted_ns: tuple[int, int]) -> bool:
        """See `UnattendedQueue`."""
        status, data = answers
        count, lost = self._parse_count(status)
        present = min(count, len(data) // self.WORD)
        period_ns = next(iter(self._clocks.values())).period_ns
        taken = self._drains.since_ns(counted_ns[0]) / period_ns * self._words_per_sample
        slack = _UNEVEN_SAMPLES * self._words_per_sample
        self.ran_over = bool(lost)
        gap = self.ran_over or self._drains.is_missing(count, taken, slack)
        if self._trusted and present:
            self._trusted = self._put(data[: present * self.WORD], count - present, counted_ns, gap=gap)
            self._drains.note(count - present, counted_ns[1])
        return self._trusted

    def _temperatures(self, words: Bytes, tags: Bytes) -> Bytes:
        """Return (n, 2) bytes of the last temperature before or in each word."""
        known = tags == self.TEMPERATURE
        latest = np.maximum.accumulate(np.where(known, np.arange(len(tags)), -1))
        values = np.where((latest >= 0)[:, None], words[latest, 1:3], np.frombuffer(self._temperature, np.uint8))
        self._temperature = values[-1].tobytes()
        return np.asarray(values, np.uint8)
