"""The emulated microcontroller at a pseudo-terminal, which other programs open like /dev/ttyACM0."""

from __future__ import annotations

import os
import select
import tty
from typing import Self

from firmware_emulator.serial_firmware import Firmware

ROOM = 4096
"""Maximum number of bytes that wait while the terminal is not read, in addition to the terminal's own buffer; a list
that does not fit is dropped.
"""
CHUNK = 65536
IDLE_S = 1.0


class SerialPort:
    """Serves `firmware` at `path`, in real time. `dropped` counts the lists that were not read in time."""

    def __init__(self, firmware: Firmware) -> None:
        self.firmware = firmware
        self.dropped = 0
        self._host, self._kept = (
            os.openpty()
        )  # the other end stays open, so that a host that disconnects causes no error here
        tty.setraw(self._kept)
        os.set_blocking(self._host, False)
        self.path = os.ttyname(self._kept)
        self._out = bytearray()
        self._woken, self._waker = os.pipe()

    def serve_forever(self) -> None:
        """Serve until `shutdown`, which another thread may call."""
        while not self._step():
            pass

    def shutdown(self) -> None:
        """End `serve_forever`."""
        os.write(self._waker, b"\0")

    def _step(self) -> bool:
        """Wait for bytes, or for the next frame to begin; return True after `shutdown`."""
        due_ns = self.firmware.due_ns
        wait_s = IDLE_S if due_ns is None else (due_ns - self.firmware.clock.now_ns()) * 1e-9
        writing = [self._host] if self._out else []
        readable, _, _ = select.select([self._host, self._woken], writing, [], min(max(wait_s, 0.0), IDLE_S))
        if self._host in readable:
            self._out += self.firmware.feed(os.read(self._host, CHUNK))
            self._send()
        for frame in self.firmware.tick():
            if len(self._out) + len(frame) > ROOM:
                self.dropped += 1
            else:
                self._out += frame
                self._send()
        self._send()
        return self._woken in readable

    def _send(self) -> None:
        try:
            del self._out[: os.write(self._host, self._out)]
        except BlockingIOError:
            return

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        for end in (self._host, self._kept, self._woken, self._waker):
            os.close(end)
