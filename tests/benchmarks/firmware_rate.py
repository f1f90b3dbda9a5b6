"""The firmware in C beside the emulated one in Python, on the list of eight six-axis chips, 14 bytes of each: frames a
second of processor, with chips that answer at once; and what its host build puts on a pseudo-terminal at 1 kHz.

On paper a frame of the link has 144 bytes: 15 of the link, the number of the list, and of each chip an age and 14
bytes. The queues of eight ICM-42688-P at 1 kHz are read 100 times a second in two frames of the link, of each chip an
age, 3 bytes and 13 packets of 16 (tests/acquire/test_stream_queue.py). The host build's bytes are counted with the
read-backs of registers in between, and its processor time with the questions on the socket of its bus; where machine or
bus are busy, it leaves frames out.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory
from typing import Any

from compare import Row, row

from firmware_emulator.clock import VirtualClock
from firmware_emulator.serial_firmware import Firmware
from imuarray.bus.serial_bus import SerialBus
from imuarray.bus.serial_link import (
    LIST,
    OVERHEAD,
    START,
    PollList,
    Request,
    frame_payload,
    list_payload,
    start_payload,
)
from imuarray.bus.serial_port import usual_port

sys.path.insert(0, str(Path(__file__).parents[2]))  # the tests' own host build

from tests.firmware.build import CORE, SOURCES, compiled
from tests.firmware.host_build import HostBuild

CHIPS, BURST, RATE_HZ = 8, 14, 1000
FRAME_BYTES = OVERHEAD + 1 + CHIPS * (2 + BURST)
PYTHON_FRAMES = 5000
READ_BACKS = 16
SECONDS = 3.0
ASKED = PollList(1, 0, tuple(Request(0x80 + chip, b"\x9d", BURST) for chip in range(CHIPS)))
DRAINS_HZ, DRAINED = 100, 3 + 13 * 16
DRAINS = [
    PollList(1, 0, tuple(Request(0x80 + chip, b"\xad", DRAINED) for chip in range(first, first + 4)))
    for first in (0, 4)
]
DRAIN_BYTES = 2 * (OVERHEAD + 1 + 4 * (2 + DRAINED))


class CannedBus:
    """Chip selects that answer at once."""

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """As many bytes as were asked for."""
        return b"\x07" * read

    def set_select(self, select: int, mode: int, clock_hz: int) -> None:
        """Any mode and clock."""


class CountingPort:
    """The port, and how many bytes came through it."""

    def __init__(self, path: Path) -> None:
        self._port: Any = usual_port(str(path), 115_200)
        self.count = 0

    @property
    def in_waiting(self) -> int:
        return int(self._port.in_waiting)

    def read(self, size: int = 1, /) -> bytes:
        data: bytes = self._port.read(size)
        self.count += len(data)
        return data

    def write(self, data: bytes, /) -> int | None:
        written: int | None = self._port.write(data)
        return written

    def close(self) -> None:
        self._port.close()


def rows() -> list[Row]:
    """Frames a second of processor, bytes of a frame, share of a processor; nothing without a C compiler."""
    try:
        with TemporaryDirectory() as folder:
            return _rows(Path(folder))
    except (OSError, RuntimeError) as error:
        print(f"firmware_rate: {error}", file=sys.stderr)
        return []


def _rows(folder: Path) -> list[Row]:
    harness = Path(__file__).parent / "firmware_core.c"
    core = compiled(folder, "firmware_core", (*CORE, harness), "-O2", f"-I{SOURCES / 'core'}")
    printed = subprocess.run([core], capture_output=True, text=True, check=True).stdout.split()
    if float(printed[1]) != FRAME_BYTES:
        raise RuntimeError(f"the core sends {printed[1]} bytes for a frame of {FRAME_BYTES}")
    busy_s, size = hosted(folder, [ASKED], RATE_HZ)
    drain_s, drain_size = hosted(folder, DRAINS, DRAINS_HZ)
    return [
        row(
            "firmware, frames a second of CPU: C core, emulated firmware",
            float(printed[0]),
            python(),
            "/s",
            10,
            "higher",
        ),
        row(
            "firmware's host build, bytes for a frame of 8 six-axis chips: on paper",
            size,
            FRAME_BYTES,
            "B",
            1.1,
            "lower",
        ),
        row(
            "firmware's host build, processor at 1 kHz: share of one processor", busy_s * RATE_HZ, 1.0, "", 0.5, "lower"
        ),
        row(
            "firmware's host build, bytes a second of the queues of 8 chips at 1 kHz: on paper",
            drain_size * DRAINS_HZ,
            DRAIN_BYTES * DRAINS_HZ,
            "B/s",
            1.1,
            "lower",
        ),
        row(
            "firmware's host build, processor for these queues: share of one processor",
            drain_s * DRAINS_HZ,
            1.0,
            "",
            0.5,
            "lower",
        ),
    ]


def python() -> float:
    """Frames a second of processor of the emulated firmware."""
    clock = VirtualClock()
    firmware = Firmware(CannedBus(), clock, selects=CHIPS)
    firmware.feed(frame_payload(LIST, 1, list_payload(0, ASKED)))
    firmware.feed(frame_payload(START, 2, start_payload(1_000_000 // RATE_HZ)))
    begun_s = time.process_time()
    for _ in range(PYTHON_FRAMES):
        clock.sleep_until(firmware.due_ns or 0)
        if [len(frame) for frame in firmware.tick()] != [FRAME_BYTES]:
            raise RuntimeError("a frame of another length")
    return PYTHON_FRAMES / (time.process_time() - begun_s)


def hosted(folder: Path, asked: list[PollList], rate_hz: int) -> tuple[float, float]:
    """Seconds of processor that the host build needs for a frame of these lists at `rate_hz`, and bytes of a frame with
    the read-backs of eight chips.
    """
    program = compiled(folder, "imuarray-firmware", (*CORE, SOURCES / "host/main.c"), "-O2")
    sweep = rate_hz * 2 // 5
    lists = asked + [
        PollList(sweep, turn * sweep // READ_BACKS, (Request(0x80 + turn % CHIPS, b"\xce", 1),))
        for turn in range(READ_BACKS)
    ]
    before = getrusage(RUSAGE_CHILDREN)
    with HostBuild(program, CannedBus(), folder / "ttyACM0") as host:
        port = CountingPort(host.path)
        with SerialBus(lambda: port) as bus:
            bus.start(lists, 1_000_000 // rate_hz)
            port.count = frames = 0
            until_s = time.monotonic() + SECONDS
            while time.monotonic() < until_s:
                received = bus.receive()
                frames += len(received[0].numbers) if 0 in received else 0
    after = getrusage(RUSAGE_CHILDREN)
    busy_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return busy_s / frames, port.count / frames


if __name__ == "__main__":
    os.chdir(Path(__file__).parent)
    for found in rows():
        print(found)
