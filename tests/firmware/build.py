"""The host build of the firmware, compiled for the tests; its core as the tests call it."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from ctypes import POINTER, Structure, c_bool, c_char, c_size_t, c_uint8, c_uint16, c_uint32, c_uint64, c_void_p
from functools import cache
from pathlib import Path
from typing import Any

from firmware_emulator.clock import WireClock
from firmware_emulator.microcontroller_bus import result_of

SOURCES = Path(__file__).parents[2] / "firmware"
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wshadow", "-Wconversion")
COMPILER = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
NO_COMPILER = "no C compiler (Debian's packages gcc and libc6-dev)"
MAX_FRAME = 1039


def compiled(folder: Path, name: str, sources: tuple[Path, ...], *flags: str) -> Path:
    """Compile `sources` strictly; RuntimeError with the compiler's message."""
    words = [str(COMPILER), *STRICT, "-O1", "-g", *flags, "-o", str(folder / name), *map(str, sources)]
    ran = subprocess.run(words, capture_output=True, text=True)
    if ran.returncode:
        raise RuntimeError(f"{' '.join(words)}\n{ran.stderr}")
    return folder / name


CORE = (SOURCES / "core/link.c", SOURCES / "core/firmware.c")
PROBE = """
#include "{header}"
size_t probe_size(void);
bool probe_due(const firmware *self, uint64_t *due_us);
void probe_number(firmware *self, uint64_t number);
size_t probe_size(void) {{ return sizeof(firmware); }}
bool probe_due(const firmware *self, uint64_t *due_us) {{
    *due_us = self->begun_us + self->number * self->period_us;
    return self->period_us != 0;
}}
void probe_number(firmware *self, uint64_t number) {{
    self->begun_us -= (number - self->number) * self->period_us;
    self->number = number;
}}
"""


@cache
def sanitizers(folder: Path) -> tuple[str, ...]:
    """Return the flags for the sanitizers that this compiler has."""
    (folder / "empty.c").write_text("int main(void) { return 0; }\n")
    for flags in (("-fsanitize=address,undefined", "-fno-sanitize-recover=all"), ()):
        try:
            program = compiled(folder, "empty", (folder / "empty.c",), *flags)
        except RuntimeError:
            continue
        if subprocess.run([program], capture_output=True).returncode == 0:
            return flags
    raise RuntimeError("a program of no lines does not run")


@cache
def library(folder: Path) -> Core:
    """The core as a shared library."""
    probe = folder / "probe.c"
    probe.write_text(PROBE.format(header=SOURCES / "core/firmware.h"))
    return Core(compiled(folder, "core.so", (*CORE, probe), "-fPIC", "-shared"))


@cache
def program(folder: Path) -> Path:
    """The host build, with sanitizers."""
    return compiled(folder, "imuarray-firmware", (*CORE, SOURCES / "host/main.c"), *sanitizers(folder))


class LinkFrame(Structure):
    """``link_frame``."""

    _fields_ = (
        ("kind", c_uint8),
        ("sequence", c_uint16),
        ("payload", POINTER(c_char)),
        ("size", c_size_t),
        ("raw", POINTER(c_char)),
        ("raw_size", c_size_t),
    )


NOW = ctypes.CFUNCTYPE(c_uint64, c_void_p)
TRANSACTION = ctypes.CFUNCTYPE(ctypes.c_int, c_void_p, c_uint8, POINTER(c_char), c_size_t, POINTER(c_uint8), c_size_t)
SET = ctypes.CFUNCTYPE(ctypes.c_int, c_void_p, c_uint8, c_uint8, c_uint32)
SEND = ctypes.CFUNCTYPE(c_size_t, c_void_p, POINTER(c_char), c_size_t)
FEED = ctypes.CFUNCTYPE(None, c_void_p)


class Platform(Structure):
    """``firmware_platform``."""

    _fields_ = (
        ("context", c_void_p),
        ("now_us", NOW),
        ("i2c", TRANSACTION),
        ("spi", TRANSACTION),
        ("spi_set", SET),
        ("send", SEND),
        ("feed_watchdog", FEED),
        ("selects", c_uint8),
        ("watchdog_reset", c_bool),
    )


class Core:
    """The functions of the core."""

    def __init__(self, path: Path) -> None:
        functions: Any = ctypes.CDLL(str(path))
        self.functions = functions
        functions.link_crc32.restype = c_uint32
        functions.link_crc32.argtypes = (ctypes.c_char_p, c_size_t)
        functions.link_complete.restype = c_size_t
        functions.link_complete.argtypes = (c_void_p, c_uint8, c_uint16, c_uint32, c_size_t)
        functions.link_receiver_init.argtypes = (c_void_p,)
        functions.link_receive.restype = c_size_t
        functions.link_receive.argtypes = (c_void_p, c_void_p, c_size_t, POINTER(LinkFrame), POINTER(c_bool))
        functions.link_receive_pause.restype = c_bool
        functions.link_receive_pause.argtypes = (c_void_p, POINTER(LinkFrame))
        functions.firmware_init.argtypes = (c_void_p, POINTER(Platform))
        functions.firmware_take.argtypes = (c_void_p, c_void_p, c_size_t)
        functions.firmware_step.restype = c_uint32
        functions.firmware_step.argtypes = (c_void_p,)
        functions.firmware_waiting.restype = c_bool
        functions.firmware_waiting.argtypes = (c_void_p,)
        functions.probe_size.restype = c_size_t
        functions.probe_due.restype = c_bool
        functions.probe_due.argtypes = (c_void_p, POINTER(c_uint64))
        functions.probe_number.argtypes = (c_void_p, c_uint64)

    def frame(self, kind: int, sequence: int, time_us: int, payload: bytes) -> bytes:
        """The result of ``link_complete`` for a payload; empty if it refuses."""
        buffer = ctypes.create_string_buffer(15 + len(payload))
        ctypes.memmove(ctypes.addressof(buffer) + 11, payload, len(payload))
        size: int = self.functions.link_complete(buffer, kind, sequence, time_us, len(payload))
        return buffer.raw[:size]


class CoreReceiver:
    """``link_receiver``: bytes in, whole frames out."""

    def __init__(self, core: Core) -> None:
        self._functions = core.functions
        self._receiver = ctypes.create_string_buffer(MAX_FRAME + 64)
        self._functions.link_receiver_init(self._receiver)

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that `data` completes, all of each."""
        frames, frame, result, start = [], LinkFrame(), c_bool(True), 0
        buffer = ctypes.create_string_buffer(data, max(len(data), 1))
        while result or start < len(data):
            at = ctypes.addressof(buffer) + start
            start += self._functions.link_receive(self._receiver, at, len(data) - start, frame, result)
            if result:
                frames.append(frame.raw[: frame.raw_size])
        return frames

    def pause(self) -> list[bytes]:
        """The frames after a damaged one."""
        frames, frame = [], LinkFrame()
        while self._functions.link_receive_pause(self._receiver, frame):
            frames.append(frame.raw[: frame.raw_size])
        return frames


class CoreFirmware:
    """The core in the place of `firmware_emulator.serial_firmware.Firmware`: the same arguments, methods and clock.

    An error of another kind that the bus raises is raised by the call that led to it.
    """

    core: Core

    def __init__(
        self, bus: Any, clock: WireClock, *, counter_us: int = 0, drift: float = 0.0, selects: int = 0
    ) -> None:
        self.clock, self.bus, self.rate = clock, bus, 1 + drift
        self._counter_us, self._started_ns = counter_us, clock.now_ns()
        self._functions = self.core.functions
        self.room = 1 << 30
        self._sent = bytearray()
        self._error: BaseException | None = None
        # ctypes keeps none of these functions alive.
        self._platform = Platform(
            None,
            NOW(lambda context: self.time_us()),
            TRANSACTION(self._i2c),
            TRANSACTION(self._spi),
            SET(self._set),
            SEND(self._send),
            FEED(lambda context: None),
            selects,
            False,
        )
        self._self = ctypes.create_string_buffer(self._functions.probe_size())
        self._functions.firmware_init(self._self, self._platform)

    def time_us(self) -> int:
        """The counter."""
        return self._counter_us + int((self.clock.now_ns() - self._started_ns) * self.rate) // 1000

    @property
    def due_ns(self) -> int | None:
        """Return when the next frame begins, on the true clock; None while none is required."""
        due_us = c_uint64()
        if not self._functions.probe_due(self._self, due_us):
            return None
        at_ns = self._started_ns + int((due_us.value - self._counter_us) * 1000 / self.rate)
        while self._counter_us + int((at_ns - self._started_ns) * self.rate) // 1000 < due_us.value:
            at_ns += 1
        return at_ns

    def feed(self, data: bytes) -> bytes:
        """Bytes from the host; the bytes to send."""
        self._functions.firmware_take(self._self, data, len(data))
        return b"".join(self._pieces())

    def tick(self) -> list[bytes]:
        """Begin the next frame if it is time to: the frames that it sends."""
        self._functions.firmware_step(self._self)
        return self._pieces()

    def skip_to(self, number: int) -> None:
        """Let the next frame be this one, and due when the next one was."""
        self._functions.probe_number(self._self, number)

    def _pieces(self) -> list[bytes]:
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        pieces = []
        while len(self._sent) >= 4 and len(self._sent) >= (size := 15 + int.from_bytes(self._sent[2:4], "little")):
            pieces.append(bytes(self._sent[:size]))
            del self._sent[:size]
        return pieces

    def _transact(self, address: int, write: Any, write_size: int, read: Any, read_size: int) -> int:
        try:
            answer = self.bus.transfer(address, write[:write_size], read_size)
            ctypes.memmove(read, answer, read_size)
        except (OSError, ValueError) as error:
            return result_of(error)
        except BaseException as error:
            self._error = error
            return 1
        return 0

    def _i2c(self, context: Any, address: int, write: Any, write_size: int, read: Any, read_size: int) -> int:
        return self._transact(address, write, write_size, read, read_size)

    def _spi(self, context: Any, select: int, write: Any, write_size: int, read: Any, read_size: int) -> int:
        return self._transact(0x80 + select, write, write_size, read, read_size)

    def _set(self, context: Any, select: int, mode: int, clock_hz: int) -> int:
        try:
            self.bus.set_select(select, mode, clock_hz)
        except (OSError, ValueError) as error:
            return result_of(error)
        return 0

    def _send(self, context: Any, data: Any, size: int) -> int:
        count = min(size, self.room)
        self.room -= count
        self._sent += data[:count]
        return count
