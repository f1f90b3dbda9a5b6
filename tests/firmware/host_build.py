"""The firmware's host build as a process, on the emulated array, behind lines that fail."""

from __future__ import annotations

import socket
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from firmware_emulator.microcontroller_bus import MicrocontrollerBus, serve_bus
from imuarray.bus.serial_port import usual_port

ADXL345 = 0x53
BURST = b"\x30"
"""Where the logger's bursts of an ADXL345 begin: INT_SOURCE, and the readings two bytes later."""
KEY = np.array([1, 7919, -12553])


def reading(number: int) -> np.ndarray:
    """The counts of one burst; no two of 2^16 are the same, and no mixture of two is a third."""
    return ((number * KEY + 2**15) % 2**16 - 2**15).astype("<i2")


class NumberedBus:
    """The microcontroller's bus, whose bursts of ADXL345 are numbered: burst n reads `reading(n)`.

    `bursts` are the times (ns) at which they began, `written` everything that was written, in order.
    """

    def __init__(self, array: Any) -> None:
        self._bus = MicrocontrollerBus(array)
        self.bursts: list[int] = []
        self.written: list[tuple[int, bytes]] = []
        self.set_select = self._bus.set_select

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        begun_ns = time.monotonic_ns()
        answer = self._bus.transfer(address, write, read)
        if not read:
            self.written.append((address, write))
        if (address, write, read) == (ADXL345, BURST, 8):
            self.bursts.append(begun_ns)
            return answer[:2] + reading(len(self.bursts) - 1).tobytes()
        return answer


class HostBuild:
    """The process; `path` leads to its pseudo-terminal, and after `restart` to the next one's."""

    def __init__(self, program: Path, bus: Any, path: Path, *options: str) -> None:
        self._program, self._bus, self.path, self._options = program, bus, path, options
        self.process: subprocess.Popen[bytes] | None = None
        self.complaints = b""
        self.start()

    def start(self) -> None:
        """A new boot of the microcontroller."""
        ours, theirs = socket.socketpair()
        words = [str(self._program), "--bus", str(theirs.fileno()), *self._options]
        self.process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, pass_fds=[theirs.fileno()]
        )
        theirs.close()
        self._thread = threading.Thread(target=serve_bus, args=(self._bus, ours))
        self._thread.start()
        assert self.process.stdout is not None
        line = self.process.stdout.readline().decode().strip()
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(line)

    def kill(self) -> None:
        """Pull the plug: its terminal disappears."""
        assert self.process is not None
        self.process.kill()
        self._close()
        self.path.unlink()

    def _close(self) -> int:
        assert self.process is not None
        _, self.complaints = self.process.communicate()
        self._thread.join()
        return self.process.returncode

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self.process is not None
        if self.process.poll() is None:
            self.process.terminate()
            code = self._close()
            assert code == -15, self.complaints.decode()
        elif self.process.returncode != -9:
            self._close()
            raise AssertionError(f"the firmware ended: {self.complaints.decode()}")


class BadLine:
    """A port whose bytes are handed to `spoil_read` and `spoil_write` on their way; they may sleep."""

    def __init__(
        self,
        path: Path,
        spoil_read: Callable[[bytes], bytes] = bytes,
        spoil_write: Callable[[bytes], bytes] = bytes,
    ) -> None:
        self._path, self._spoil_read, self._spoil_write = path, spoil_read, spoil_write

    def __call__(self) -> Self:
        self._port = usual_port(str(self._path), 115_200)
        return self

    @property
    def in_waiting(self) -> int:
        return self._port.in_waiting

    def read(self, size: int = 1, /) -> bytes:
        data = self._port.read(size)
        return self._spoil_read(data) if data else data

    def write(self, data: bytes, /) -> int | None:
        return self._port.write(self._spoil_write(data))

    def close(self) -> None:
        self._port.close()


def damage(seed: int, chance: float) -> Callable[[bytes], bytes]:
    """Return the effect of a bad line on pieces: of some it loses bytes, flips a bit, adds noise, or loses all."""
    draw = np.random.default_rng(seed)

    def spoiled(piece: bytes) -> bytes:
        if draw.random() > chance:
            return piece
        at, until = sorted(draw.integers(0, len(piece) + 1, 2).tolist())
        bit = int(draw.integers(8 * len(piece)))
        flipped = piece[: bit // 8] + bytes([piece[bit // 8] ^ 1 << bit % 8]) + piece[bit // 8 + 1 :]
        noise = piece[:at] + draw.bytes(20) + piece[at:]
        return [b"", piece[:at] + piece[until:], flipped, noise][int(draw.integers(4))]

    return spoiled
