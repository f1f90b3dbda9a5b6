"""A bus of Linux: /dev/i2c-N through I2C_RDWR. Facts LNX-*.

One call is one transaction with one STOP at its end (LNX-06), with at most one read message, as the last: i2c-bcm2835,
the Raspberry Pi's adapter, refuses other transactions (LNX-10). The poll loop repeats the same few transactions, so
their C structures are kept: a transaction is one ioctl on a prepared block. smbus2 opens the device and defines the
structures.

I2C_RDWR checks neither whether a kernel driver owns an address (LNX-12) nor whether another program uses the bus:
`claim` checks the former, a lock on the device excludes the latter. A bus belongs to one thread.

The removal of an open adapter is detected by its missing entry in sysfs, after a failed transaction. The descriptor is
closed, because the kernel could not finish the removal otherwise. From then on every transaction ends with ENODEV, and
the adapter is searched for at intervals by its identity (`imuarray.bus.identity`). When it has reappeared the bus works
as before.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Self

from smbus2 import I2cFunc, SMBus, i2c_msg
from smbus2.smbus2 import I2C_RDWR, I2C_SLAVE, i2c_rdwr_ioctl_data

from imuarray.bus.identity import DEVICE_FILES, I2C_DEVICES, Entry, adapter_entry, adapters, is_alone, mark_of, search
from imuarray.bus.protocol import Bus, SpiPort
from imuarray.bus.spi import SpiPorts
from imuarray.clock import Clock, MonotonicClock
from imuarray.errors import BusUrlError, SensorError

MAX_MESSAGE = 8192
"""Largest number of bytes of one message (LNX-05)."""
KEPT = 256
"""Number of transactions whose structures are kept; an array of a dozen chips uses about a dozen for each."""
TIMEOUT_S = 0.03
"""Time-out of a transfer in s. With the kernel's default, 1 s, a hung bus would stop the log for 1 s per sensor."""
I2C_TIMEOUT = 0x0702  # in units of 10 ms (LNX-03); smbus2 does not name it
SEARCH_NS = 200_000_000
"""Interval in ns between two searches for a removed adapter; a search lists all adapters of the machine."""


class LinuxBus:
    """An I2C adapter of this machine, locked for this object; BusUrlError if it can't be opened.

    `timeout_s` is set on the adapter itself and persists (LNX-03). `devices` is the kernel's list of I2C devices in
    sysfs, `device_files` the folder in which an unplugged adapter reappears. `where` is the present device file; None
    while the adapter is removed.
    """

    source = "i2c"

    def __init__(
        self,
        path: str,
        *,
        timeout_s: float = TIMEOUT_S,
        devices: Path | None = None,
        device_files: Path | None = None,
        clock: Clock | None = None,
    ) -> None:
        self.path = path
        self.where: str | None = path
        self.clock: Clock = MonotonicClock() if clock is None else clock
        self._timeout_s = timeout_s
        self._devices = I2C_DEVICES if devices is None else devices
        self._device_files = DEVICE_FILES if device_files is None else device_files
        self._others: dict[str, LinuxBus] = {}
        self._spi = SpiPorts()
        self._together = [self]  # with its channels: the kernel waits until they are closed too
        self._entry: Entry | None = None
        self._alone = True
        self._known: dict[str, int] = {}
        self._search_ns = 0
        self._prepared = lru_cache(KEPT)(_Ioctl.of)
        self._adapter: Any = SMBus()
        self._file = -1
        try:
            self._open(path)
        except OSError as error:
            raise BusUrlError(
                f"i2c:{path}: {error.strerror or error}; buses are /dev/i2c-* (enable I2C, join group i2c)"
            ) from error

    def _open(self, path: str) -> None:
        """Open and lock `path`, and note its identity; a failure leaves nothing open."""
        try:
            self._adapter.open(path)
            self._set_up()
        except BaseException:
            self._adapter.close()
            raise
        self.where, self._file = path, self._adapter.fd
        name = Path(os.path.realpath(path)).name
        entry = adapter_entry(self._devices, name)
        if entry is not None:  # otherwise there is no sysfs
            self._entry = entry
            self._alone = is_alone(entry.identity, adapters(self._devices))

    def _set_up(self) -> None:
        if not self._adapter.funcs & I2cFunc.I2C:
            raise BusUrlError(f"i2c:{self.path}: this adapter speaks SMBus only, plain I2C messages are needed")
        try:
            fcntl.flock(self._adapter.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BusUrlError(
                f"i2c:{self.path}: another program has locked this bus; two on one bus would mix their transactions"
            ) from None
        fcntl.ioctl(self._adapter.fd, I2C_TIMEOUT, max(1, round(self._timeout_s * 100)))

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Transfer as `Bus.transfer`; ValueError for more than a message can carry (the kernel's field is 16 bits wide:
        LNX-33). OSError with ENODEV while the adapter is removed.
        """
        block = self._prepared(address, write, read)
        if self._file < 0:
            self._find_again()
        try:
            fcntl.ioctl(self._file, I2C_RDWR, block.structure)
        except OSError:
            self._notice_removal()
            raise
        return block.answer.raw

    def _notice_removal(self) -> None:
        """Close every adapter of this bus that the kernel has removed; OSError with ENODEV if this one is removed.

        All of them are closed, because the kernel removes a root adapter only after its channels are closed.
        """
        for bus in self._together:
            bus._close_if_removed()
        if self._file < 0:
            raise self._removal_error()

    def _close_if_removed(self) -> None:
        entry = self._entry
        if self._file < 0 or entry is None or mark_of(self._devices, entry.name) == entry.mark:
            return
        self._adapter.close()
        self._file, self.where = -1, None
        listed = adapters(self._devices)
        self._known = {other.name: other.mark for other in listed.values()}
        self._alone = self._alone and is_alone(entry.identity, listed)

    def _removal_error(self) -> OSError:
        what = f" ({self._entry.identity.text})" if self._entry else ""
        return OSError(errno.ENODEV, f"the adapter {self.path}{what} was removed")

    def _find_again(self) -> None:
        """Open the adapter if it has reappeared, at most every `SEARCH_NS`; OSError with ENODEV otherwise."""
        now_ns = self.clock.now_ns()
        if self._entry is None or now_ns < self._search_ns:
            raise self._removal_error()
        self._search_ns = now_ns + SEARCH_NS
        for bus in self._together:
            bus._close_if_removed()
        name = search(self._entry.identity, adapters(self._devices), self._known, alone=self._alone)
        if name is None:
            raise self._removal_error()
        try:
            self._open(str(self._device_files / name))
        except (OSError, BusUrlError) as error:  # udev has not set its permissions yet, or another program was faster
            raise self._removal_error() from error

    def claim(self, address: int, path: str | None = None) -> None:
        """Raise SensorError if a driver of the kernel owns `address` of this bus (of the channel bus at `path`). Two
        drivers of one chip overwrite each other's settings, and two drivers of a multiplexer redirect each other's
        transactions (LNX-24).
        """
        bus = self if path is None else self._other(path)
        if bus._file < 0:
            bus._find_again()
        try:
            fcntl.ioctl(bus._file, I2C_SLAVE, address)
        except OSError as error:
            if error.errno != errno.EBUSY:
                bus._notice_removal()
                raise
            raise SensorError(
                f"{bus.path}: address {address:#04x} belongs to {bus._owner(address)}; unbind that driver, or, if it"
                ' drives the multiplexer, leave out mux and give each sensor bus = "/dev/i2c-N" of its channel'
            ) from error

    def _owner(self, address: int) -> str:
        number = os.path.realpath(self.where or self.path).rpartition("-")[2]
        link = self._devices / f"{number}-{address:04x}" / "driver"
        return f"the kernel's driver {link.readlink().name!r}" if link.is_symlink() else "a driver of the kernel"

    def channel_bus(self, path: str) -> Bus:
        """Return the adapter at `path`, opened once."""
        return self._other(path)

    def spi_port(self, path: str, mode: int, clock_hz: int) -> SpiPort:
        """Return the chip select at `path`, opened once; for sensors on SPI in addition to those on this bus."""
        return self._spi.port(path, mode, clock_hz)

    def _other(self, path: str) -> LinuxBus:
        if os.path.realpath(path) == os.path.realpath(self.path):
            return self
        if path not in self._others:
            other = LinuxBus(
                path,
                timeout_s=self._timeout_s,
                devices=self._devices,
                device_files=self._device_files,
                clock=self.clock,
            )
            self._others[path] = other
            self._together.append(other)
            other._together = self._together
        return self._others[path]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        for bus in self._others.values():
            bus._adapter.close()
        self._adapter.close()
        self._spi.close()


class SpiBus:
    """The bus ``spi:`` of an array whose sensors name their chip selects; other sensors may name an I2C bus."""

    source = "spi"

    def __init__(self, *, clock: Clock | None = None) -> None:
        self.clock: Clock = MonotonicClock() if clock is None else clock
        self._ports = SpiPorts()
        self._others: dict[str, LinuxBus] = {}

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Raise OSError (ENXIO): there is no I2C bus at the root."""
        raise OSError(errno.ENXIO, "spi: has no I2C bus of its own")

    def spi_port(self, path: str, mode: int, clock_hz: int) -> SpiPort:
        """Return the chip select at `path`, opened once."""
        return self._ports.port(path, mode, clock_hz)

    def channel_bus(self, path: str) -> Bus:
        """Return the I2C adapter at `path`, opened once."""
        if path not in self._others:
            self._others[path] = LinuxBus(path, clock=self.clock)
        return self._others[path]

    def claim(self, address: int, path: str | None = None) -> None:
        """Claim an address as `LinuxBus.claim`."""
        if path is None:
            return
        self.channel_bus(path)
        self._others[path].claim(address)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        for bus in self._others.values():
            bus.__exit__(*error)
        self._ports.close()


class _Ioctl(NamedTuple):
    """The structures of one I2C_RDWR; the kernel stores the bytes that were read in `answer`."""

    structure: Any
    answer: ctypes.Array[ctypes.c_char]
    messages: list[Any]
    """The memory to which the structure points."""

    @classmethod
    def of(cls, address: int, write: bytes, read: int) -> _Ioctl:
        """Raise ValueError for a message that is too long or an address of more than seven bits."""
        if not 0 <= address <= 0x7F:
            raise ValueError(f"address {address:#x}: addresses have seven bits")
        if len(write) > MAX_MESSAGE or read > MAX_MESSAGE:
            raise ValueError(
                f"address {address:#04x}: {max(len(write), read)} bytes, a message carries at most {MAX_MESSAGE}"
            )
        messages: list[Any] = [i2c_msg.write(address, write)] if write or not read else []
        answer = (ctypes.c_char * read)()
        if read:
            messages.append(i2c_msg(addr=address, flags=1, len=read, buf=answer))
        return cls(i2c_rdwr_ioctl_data.create(*messages), answer, messages)
