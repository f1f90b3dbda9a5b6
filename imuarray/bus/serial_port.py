"""The serial port of a microcontroller, opened by pyserial and read in large pieces only.

`read_until` and `readline` of pyserial fetch one byte a system call; a read of all waiting bytes is several hundred
times faster.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol
from urllib.parse import parse_qsl

from imuarray.bus.identity import DEVICE_FILES, TTY_DEVICES, Entry, is_alone, ports, search
from imuarray.bus.serial_link import LinkError
from imuarray.errors import BusUrlError

BAUD = 115_200
"""The baud rate of Arduino's examples; a native USB port ignores it."""
READ_S = 0.02
"""Longest wait for one byte, in s."""
WRITE_S = 0.25


class Port(Protocol):
    """The part of pyserial's `Serial` that is used; a read that times out returns the bytes that have arrived."""

    @property
    def in_waiting(self) -> int:
        """The bytes that can be read at once."""

    def read(self, size: int = 1, /) -> bytes:
        """Read up to `size` bytes."""

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""

    def close(self) -> None:
        """Close the port."""


def usual_port(path: str, baud: int) -> Port:
    """Open the port at `path` exclusively; pyserial's SerialException, an OSError, or ValueError."""
    from serial import Serial

    port: Port = Serial(path, baud, timeout=READ_S, write_timeout=WRITE_S, exclusive=True)
    return port


class UsualPort:
    """A function that opens the port at `path`, and later the same device after it has reappeared
    (`imuarray.bus.identity`), possibly with another number. `devices` is the kernel's list of serial ports, `where` the
    one that was opened last.
    """

    def __init__(
        self,
        path: str,
        baud: int,
        *,
        devices: Path | None = None,
        device_files: Path | None = None,
        open_port: Callable[[str, int], Port] = usual_port,
    ) -> None:
        self.where = path
        self._baud = baud
        self._devices = TTY_DEVICES if devices is None else devices
        self._device_files = DEVICE_FILES if device_files is None else device_files
        self._open_port = open_port
        self._entry: Entry | None = None
        self._alone = True
        self._known: dict[str, int] = {}

    def __call__(self) -> Port:
        """Return the open port; errors of `usual_port`, FileNotFoundError while the device is removed."""
        listed = ports(self._devices)
        if self._entry is not None and listed.get(self._entry.name) != self._entry:
            name = search(self._entry.identity, listed, self._known, alone=self._alone)
            if name is None:
                raise FileNotFoundError(errno.ENOENT, f"{self._entry.identity.text} was removed", self.where)
            self.where = str(self._device_files / name)
        port = self._open_port(self.where, self._baud)
        self._entry = listed.get(Path(os.path.realpath(self.where)).name)
        if self._entry is not None:
            self._known = {other.name: other.mark for other in listed.values() if other != self._entry}
            self._alone = is_alone(self._entry.identity, listed)
        return port


def port_of(rest: str) -> tuple[str, int]:
    """Return path and speed from a URL without its ``serial:``; BusUrlError."""
    path, _, query = rest.partition("?")
    asked = dict(parse_qsl(query, keep_blank_values=True))
    baud = asked.pop("baud", str(BAUD))
    if not path:
        raise BusUrlError("bus 'serial:': name the port, as in serial:/dev/ttyACM0")
    if asked or not (baud.isascii() and baud.isdigit() and int(baud)):
        raise BusUrlError(f"bus 'serial:{rest}': after the port only ?baud= and a whole number are allowed")
    return path, int(baud)


@contextmanager
def port_errors() -> Iterator[None]:
    """Convert errors of a removed port to LinkError; pyserial's errors have no errno of their own."""
    try:
        yield
    except LinkError:
        raise
    except OSError as error:
        raise LinkError(f"the port fails: {error}") from error
