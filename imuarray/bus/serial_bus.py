"""An array on a microcontroller, over the link of `imuarray.bus.serial_link`.

As a `Bus` it lets the microcontroller carry out one transaction after the other: drivers configure and check their
chips through it as through any other bus. `start` sends it lists to execute on its own, and `receive` returns its data
in bulk: the port is read rarely and in large pieces, and the frames of a list become the rows of a matrix.
"""

from __future__ import annotations

import errno
import os
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Integers, Times
from imuarray.bus import serial_link as link
from imuarray.bus.protocol import Bus, SpiPort
from imuarray.bus.serial_clock import ClockFit
from imuarray.bus.serial_link import Capacity, FirmwareCounts, LinkError, PollList
from imuarray.bus.serial_port import Port, UsualPort, port_of
from imuarray.bus.serial_session import PATIENCE_S, Data, Session
from imuarray.clock import Clock, MonotonicClock, sleep_for
from imuarray.errors import BusUrlError

SPI_CONTROLLER = "/dev/spidev0"
"""The name of the microcontroller's controller in a configuration, as on a computer with one controller."""
NAP_S = 0.02
"""Pause in s between two reads of a stream; the bytes that arrive during it are read at once."""
SEARCH_NS = 1_000_000_000
"""Interval in ns between two searches for a removed microcontroller while single transactions are requested."""
BUSY_BYTES = 8192
"""Number of bytes received during a pause above which the next pause is omitted: the system's buffers hold no more."""


class Samples(NamedTuple):
    """The frames of one list that arrived: numbers of the frames (n,), the times (n,) at which they were sent, in ns on
    the host's clock and in us of the microcontroller's counter, and their payload (n, size) without the list's number.
    `link_ns` is the largest error of the conversion between the two clocks.
    """

    numbers: Integers
    sent_ns: Times
    sent_us: Times
    payload: npt.NDArray[np.uint8]
    link_ns: float = 0.0


class SerialBus:
    """The microcontroller on the port that `open_port` opens; LinkError if its device does not use the link's protocol.
    `clock` is the host's.

    While lists are executed, they control the multiplexer: call `stop` before single transactions.
    """

    source = "serial"

    def __init__(
        self, open_port: Callable[[], Port], clock: Clock | None = None, *, patience_s: float = PATIENCE_S
    ) -> None:
        self.clock: Clock = MonotonicClock() if clock is None else clock
        self._session = Session(open_port, self.clock, patience_s)
        self._period_us = 0
        self._is_behind = False
        self._lost = False
        self._search_ns = 0
        self._selects: dict[int, tuple[int, int]] = {}

    @property
    def fit(self) -> ClockFit:
        """The fit of the microcontroller's clock to the host's."""
        return self._session.fit

    @property
    def capacity(self) -> Capacity:
        """The capacity of the microcontroller."""
        return self._session.capacity

    def firmware_counts(self) -> FirmwareCounts | None:
        """Return the counters of the firmware since it booted; None if it has none. OSError if it does not answer."""
        if not self.capacity.features & link.CAN_STATUS:
            return None
        return link.counts_of(self._session.ask(link.STATUS).payload)

    @property
    def skipped(self) -> int:
        """Received bytes that belonged to no frame."""
        return self._session.skipped

    @property
    def refused(self) -> Mapping[str, int]:
        """Frames with a valid checksum that were rejected, by reason: old, repeated, out of order, of another boot."""
        return self._session.refused

    @property
    def streaming(self) -> bool:
        """True between `start` and `stop`."""
        return self._period_us > 0

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Transfer as `Bus.transfer`; LinkError if the microcontroller does not answer, ValueError for a transfer that
        does not fit into a frame.

        After a LinkError it is searched for, at most every `SEARCH_NS`, and OSError has ENODEV until it has
        reappeared.
        """
        payload = link.transfer_payload(address, write, read)
        return self._transact(link.TRANSFER, payload, read, f"address {address:#04x} over the link")

    def exchange(self, select: int, write: bytes, read: int) -> bytes:
        """Carry out one transaction on a chip select of SPI: bytes out, then zeros while `read` bytes come in; errors
        as of `transfer`.
        """
        payload = link.exchange_payload(select, write, read)
        return self._transact(link.TRANSFER, payload, read, f"chip select {select} over the link")

    def _transact(self, kind: int, payload: bytes, read: int, what: str) -> bytes:
        if self._lost:
            self._find_again()
        try:
            answer = self._session.ask(kind, payload)
        except LinkError:
            self._lost, self._search_ns = True, self.clock.now_ns() + SEARCH_NS
            raise
        return link.outcome_of(answer.payload, read, what)

    def _find_again(self) -> None:
        """Open the port again; OSError with ENODEV if its device does not use the link's protocol."""
        now_ns = self.clock.now_ns()
        if now_ns < self._search_ns:
            raise OSError(errno.ENODEV, "the microcontroller was disconnected")
        try:
            self.reconnect()
        except LinkError as error:
            self._search_ns = self.clock.now_ns() + SEARCH_NS
            raise OSError(errno.ENODEV, f"the microcontroller was disconnected: {error.strerror}") from error

    def channel_bus(self, path: str) -> Bus:
        """Raise OSError, as for a missing device file."""
        raise FileNotFoundError(errno.ENOENT, "a microcontroller does not read buses of the kernel", path)

    def spi_port(self, path: str, mode: int, clock_hz: int) -> SpiPort:
        """Return the chip select N of the microcontroller, for /dev/spidev0.N; OSError if it is missing or refuses."""
        prefix, _, number = path.rpartition(".")
        if prefix != SPI_CONTROLLER or not number.isdecimal() or int(number) >= self.capacity.selects:
            raise FileNotFoundError(
                errno.ENOENT, f"this microcontroller has {self.capacity.selects} chip selects, {SPI_CONTROLLER}.N", path
            )
        self._set_select(int(number), mode, clock_hz)
        self._selects[int(number)] = mode, clock_hz
        return SerialSpiPort(self, int(number))

    def _set_select(self, select: int, mode: int, clock_hz: int) -> None:
        payload = link.select_payload(select, mode, clock_hz)
        self._transact(link.SELECT, payload, 0, f"chip select {select} in mode {mode} at {clock_hz} Hz")

    def start(self, lists: Sequence[PollList], period_us: int, prepare: Callable[[], None] | None = None) -> None:
        """Start to execute these lists, frame after frame; OSError if the microcontroller refuses or has no room.
        `prepare` is called when it has the lists, right before the first frame.
        """
        size = link.request_bytes(lists)
        if len(lists) > self.capacity.lists or size > self.capacity.request_bytes:
            raise OSError(
                errno.ENOSPC,
                f"{len(lists)} lists with {size} bytes of requests; this microcontroller has room for"
                f" {self.capacity.lists} with {self.capacity.request_bytes}",
            )
        for number, asked in enumerate(lists):
            self._do(link.LIST, link.list_payload(number, asked), f"list {number}")
        if prepare is not None:
            prepare()
        link.outcome_of(self._session.start(lists, period_us), 0, "start")
        self._period_us = period_us

    def stop(self) -> None:
        """Stop the stream; data that were sent before can still be received."""
        self._period_us = 0
        self._do(link.STOP, b"", "stop")

    def receive(self) -> Mapping[int, Samples]:
        """Return all data that arrived since the last call, by number of the list. LinkError if the port was removed.

        While streaming, wait for a pause and then until a frame has arrived or a short time has passed; do not wait if
        more data arrive than can be processed.
        """
        if self.streaming:
            if not self._is_behind:
                sleep_for(self.clock, NAP_S)
            self._is_behind = self._session.drain() > BUSY_BYTES
            until_ns = self.clock.now_ns() + round(NAP_S * 1e9)
            while not self._is_behind and self._session.read() == 0 and self.clock.now_ns() < until_ns:
                pass
        data = self._session.collect()
        return self._group_by_list(data) if data.frames else {}

    def reconnect(self, patience_s: float = PATIENCE_S) -> None:
        """Open the port again and start a new session, after it was unplugged or its microcontroller was reset: the
        chips may have lost their supply too. LinkError if no device answers.
        """
        self._period_us = 0
        self._session.reconnect(patience_s)
        self._lost = False
        for select, (mode, clock_hz) in self._selects.items():
            self._do(link.SELECT, link.select_payload(select, mode, clock_hz), f"chip select {select}")

    def _do(self, kind: int, payload: bytes, what: str) -> None:
        link.outcome_of(self._session.ask(kind, payload).payload, 0, what)

    def _group_by_list(self, data: Data) -> dict[int, Samples]:
        """Return frames as matrices, one for each list."""
        sent_ns = self.fit.host_ns(data.sent_us * 1000)
        rows: dict[int, list[int]] = defaultdict(list)
        for row, frame in enumerate(data.frames):
            rows[frame.payload[0]].append(row)
        samples = {}
        for number, where in sorted(rows.items()):
            together = b"".join([data.frames[row].payload for row in where])
            matrix = np.frombuffer(together, np.uint8).reshape(len(where), -1)
            times = sent_ns[where], data.sent_us[where]
            samples[number] = Samples(data.numbers[where], *times, matrix[:, 1:], self.fit.uncertainty_ns)
        return samples

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        with suppress(OSError):
            if self.streaming:
                self.stop()
        self._session.port.close()


class SerialSpiPort:
    """A chip select of the microcontroller, as a `SpiPort`; `address` is its address in the lists of the link."""

    def __init__(self, bus: SerialBus, select: int) -> None:
        self.address = link.FIRST_SELECT + select
        self._bus = bus
        self._select = select

    def exchange(self, sent: bytes) -> bytes:
        """Exchange bytes as `SpiPort.exchange`. The link does not carry the bytes that are received before the zeros at
        the end of `sent`, and before its second byte; they read FF, because no chip of an array sends data during the
        command.
        """
        meant = max(1, len(sent.rstrip(b"\0")))
        return b"\xff" * meant + self._bus.exchange(self._select, sent[:meant], len(sent) - meant)


def open_serial(rest: str) -> SerialBus:
    """Return the bus of the URL ``serial:`` + `rest`: ``/dev/ttyACM0``, ``/dev/ttyUSB0?baud=921600``; BusUrlError."""
    path, baud = port_of(rest)
    try:
        return SerialBus(UsualPort(path, baud), patience_s=PATIENCE_S)
    except LinkError as error:
        raise BusUrlError(f"serial:{path}: {error.strerror}; its firmware must implement the serial link") from error
    except (OSError, ValueError) as error:
        number = getattr(error, "errno", None)
        if number in (errno.EAGAIN, errno.EBUSY):
            raise BusUrlError(f"serial:{path}: another program has locked this port") from error
        if _is_no_terminal(error):
            cause: object = "is no serial port"
        else:
            cause = os.strerror(number) if number else error
        raise BusUrlError(f"serial:{path}: {cause}; ports are /dev/ttyACM* and /dev/ttyUSB* (group dialout)") from error


def _is_no_terminal(error: Exception) -> bool:
    """Return whether a port failed to open because its file has no settings of a terminal. pyserial's error has no
    errno then, but follows from a `termios.error`, whose first argument is the errno.
    """
    return error.__context__ is not None and errno.ENOTTY in error.__context__.args[:1]
