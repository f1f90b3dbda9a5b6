"""A bus of Linux: /dev/i2c-N through I2C_RDWR, by smbus2.

One call is one transaction with one STOP at its end (LNX-06). Only one read message per call, and last: i2c-bcm2835,
the Raspberry Pi's adapter, refuses anything else (LNX-10). I2C_RDWR does not ask whether a kernel driver owns an
address (LNX-12)."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from smbus2 import SMBus, i2c_msg

from imuarray.bus.protocol import Bus
from imuarray.clock import Clock, MonotonicClock
from imuarray.errors import BusUrlError

MAX_MESSAGE = 8192
"""Bytes that one message may carry (LNX-05)."""


class LinuxBus:
    """An I2C adapter of this machine."""

    source = "i2c"

    def __init__(self, path: str) -> None:
        self.path = path
        self.clock: Clock = MonotonicClock()
        self._others: dict[str, LinuxBus] = {}
        try:
            self._adapter = SMBus(path)
        except OSError as error:
            raise BusUrlError(
                f"i2c:{path}: {error.strerror or error}; buses are /dev/i2c-*, open to group i2c"
            ) from error

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """See `Bus.transfer`; ValueError for more than a message can carry (the kernel's field is 16 bits wide:
        LNX-33).
        """
        if len(write) > MAX_MESSAGE or read > MAX_MESSAGE:
            raise ValueError(
                f"address {address:#04x}: {max(len(write), read)} bytes, a message carries at most {MAX_MESSAGE}"
            )
        answer = i2c_msg.read(address, read)
        messages = [i2c_msg.write(address, write)] if write or not read else []
        self._adapter.i2c_rdwr(*messages, *([answer] if read else []))
        return bytes(answer) if read else b""

    def channel_bus(self, path: str) -> Bus:
        """The adapter at `path`, opened once."""
        if path not in self._others:
            self._others[path] = LinuxBus(path)
        return self._others[path]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for bus in self._others.values():
            bus._adapter.close()
        self._adapter.close()
