"""Frames per second through the serial link, against pyserial's `read_until` in a loop.

Both sides read the same stream from a pseudo-terminal that another process fills as fast as it is emptied: the list of
the paper's nine inertial sensors as its microcontroller sends it (106 bytes with two switches), CRC checked. Ours goes
as far as `SerialBus.receive`: widened counters, times on the host's clock, a matrix of bytes for all frames of a list.

Seconds are those of the reading process on its processor, system calls included: what else the machine does, and how
fast the other process writes, is left out on both sides.
"""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from firmware_emulator.array import open_array
from firmware_emulator.serial_firmware import Firmware
from firmware_emulator.serial_port import SerialPort
from imuarray.acquire.bus_segment import connect
from imuarray.acquire.stream_plan import plan
from imuarray.array import load_array
from imuarray.bus.serial_bus import SerialBus, open_serial
from imuarray.bus.serial_link import DATA, STOP, SYNC, TIMES_US, PollList, frame_payload
from imuarray.bus.serial_port import usual_port

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"
OURS_S, PEER_S = 2.0, 2.0
FRAMES = 1 << 16
PERIOD_US = 1 << 16
"""Times and numbers of the frames begin anew together, so that the stream can be sent again and again."""
FLOOD = "import os, sys\nwith open(sys.argv[2], 'rb') as file:\n    data = file.read()\nfd = int(sys.argv[1])\n"
FLOOD += (
    "os.set_blocking(fd, True)\nat = 0\nwhile True:\n    at = (at + os.write(fd, data[at : at + 65536])) % len(data)\n"
)


def rows() -> list[dict[str, Any]]:
    """One row: frames per second of either side."""
    ours, peer = measured()
    return [
        {
            "name": "serial link, frames a second of CPU from the port: bulk against read_until",
            "ours": ours,
            "peer": peer,
            "unit": "frames/s",
            "ratio": ours / peer,
            "target": 100.0,
            "better": "higher",
        }
    ]


def measured() -> tuple[float, float]:
    """Frames a second, ours and pyserial's."""
    import tempfile

    array = load_array(CONFIG)
    array = array.only(tuple(sensor.name for sensor in array.sensors if sensor.chip[:3] not in ("bmp", "hmc")))
    emulated = open_array(array, clock="real")
    with SerialPort(Firmware(emulated, emulated.clock)) as port, tempfile.TemporaryDirectory() as folder:
        with answered(port), open_serial(port.path) as bus:
            asked = plan(connect(array, bus), 200.0).lists[:1]
        size = asked[0].size
        asked = (PollList(1, 0, asked[0].requests),)
        with answered(port):
            bus = open_serial(port.path)
            bus.start(asked, PERIOD_US)
            started_us = bus._session._admission._newest_us  # type: ignore[union-attr]
            bus._session.ask(STOP)  # the emulated one is silent from now on
        stream = Path(folder) / "stream.bin"
        stream.write_bytes(b"".join(frame_of(number, size, started_us) for number in range(FRAMES)))
        begin(bus, len(frame_of(0, size)))
        with flooded(port, stream):
            ours = bulk(bus)
            bus._session.port.close()
            peer = read_until(port.path, len(frame_of(0, asked[0].size)))
    return ours, peer


class Paced:
    """The port, and a clock that goes on as its bytes are read: as if each frame had come when it was sent."""

    def __init__(self, port: Any, frame_bytes: int, begun_ns: int) -> None:
        self.port, self.frame_bytes, self.begun_ns, self.count = port, frame_bytes, begun_ns, 0

    def now_ns(self) -> int:
        return self.begun_ns + self.count * PERIOD_US * 1000 // self.frame_bytes

    def sleep_until(self, at_ns: int) -> None:
        """Bytes alone make time pass."""

    @property
    def in_waiting(self) -> int:
        return int(self.port.in_waiting)

    def read(self, size: int = 1, /) -> bytes:
        data: bytes = self.port.read(size)
        self.count += len(data)
        return data

    def close(self) -> None:
        self.port.close()


def begin(bus: SerialBus, frame_bytes: int) -> None:
    """From now on time passes with what is read."""
    paced: Any = Paced(bus._session.port, frame_bytes, bus.clock.now_ns())
    bus._session.port = bus._session.clock = bus.clock = paced


def frame_of(number: int, size: int, started_us: int = 0) -> bytes:
    """What the microcontroller sends in this frame; readings are noise without a sync in it."""
    draw = zlib.crc32(number.to_bytes(4, "little")).to_bytes(4, "little") * size
    payload = b"\0" + draw[: size - 1].replace(SYNC[:1], b"\0")
    return frame_payload(DATA, number, payload, (started_us + number * PERIOD_US) % TIMES_US)


def bulk(bus: SerialBus) -> float:
    """Frames a second by `SerialBus.receive`."""
    bus.receive()
    frames, until_s, begun_s = 0, time.monotonic() + OURS_S, time.process_time()
    while time.monotonic() < until_s:
        frames += sum(len(samples.numbers) for samples in bus.receive().values())
    return frames / (time.process_time() - begun_s)


def read_until(path: str, size: int) -> float:
    """Frames a second by `read_until` of the next sync."""
    port: Any = usual_port(path, 115_200)
    port.read_until(SYNC)
    frames, until_s, begun_s = 0, time.monotonic() + PEER_S, time.process_time()
    while time.monotonic() < until_s:
        data = port.read_until(SYNC)
        if len(data) != size:  # a sync by chance, in a time or a checksum
            continue
        length, _, _, _ = struct.unpack_from("<HBHI", data)
        (checksum,) = struct.unpack_from("<I", data, 9 + length)
        frames += zlib.crc32(data[: 9 + length]) == checksum
    spent_s = time.process_time() - begun_s
    port.close()
    return frames / spent_s


@contextmanager
def answered(port: SerialPort) -> Iterator[None]:
    """The microcontroller takes commands."""
    thread = threading.Thread(target=port.serve_forever)
    thread.start()
    try:
        yield
    finally:
        port.shutdown()
        thread.join()
        os.read(port._woken, 1)


@contextmanager
def flooded(port: SerialPort, stream: Path) -> Iterator[None]:
    """Another process sends `stream` again and again."""
    words = [sys.executable, "-c", FLOOD, str(port._host), str(stream)]
    with subprocess.Popen(words, pass_fds=[port._host]) as process:
        try:
            yield
        finally:
            process.kill()


if __name__ == "__main__":
    for row in rows():
        print(row)
