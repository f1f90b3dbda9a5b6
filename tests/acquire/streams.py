"""Streams of an emulated microcontroller, and the logs that are made of them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from imuarray.acquire import connect
from imuarray.acquire.recording import RecordingCounts, RecordingOptions
from imuarray.acquire.stream import Streaming, streams
from imuarray.array import ArrayConfig
from imuarray.log import open_log
from imuarray.log.writer import LogWriter
from tests.bus.serial_bench import Bench

MS, S = 1_000_000, 1_000_000_000
STALE, OVERRUN, LOST, RECONFIGURED, SUSPECT = 1, 2, 8, 16, 32
DATA = 0xD0


def stream(
    bench: Bench,
    array: ArrayConfig,
    path: Path,
    *,
    rate_hz: float = 100.0,
    seconds: float | None = 3.0,
    at: Mapping[float, Callable[[], Any]] | None = None,
    **further: Any,
) -> tuple[RecordingCounts, int]:
    """Record, doing things at times (s of the recording) on the way; the summary, and when it started."""
    todo = sorted((at or {}).items())
    with bench.bus() as bus:
        routes = connect(array, bus)
        assert streams(bus, routes)
        bench.taps.clear()
        start_ns = bench.now_ns()

        def stopped() -> bool:
            while todo and bench.now_ns() - start_ns >= todo[0][0] * S:
                if todo.pop(0)[1]() is StopIteration:
                    return True
            return False

        headers = [route.header for route in routes]
        with LogWriter(path, headers, source=bus.source, epoch="1970-01-01T00:00:00Z") as log:
            recording = Streaming(routes, bus, log, RecordingOptions(rate_hz, **further), start_ns)
            recording.run(seconds, stopped)
    return recording.summary, start_ns


def words(code: str, data: bytes) -> tuple[int, ...]:
    return struct.unpack(code, data)


DECODED: dict[str, tuple[int, int, Callable[[bytes], tuple[int, ...]]]] = {
    # first register of the burst, bytes, and their meaning
    "adxl345": (0x30, 8, lambda data: words("<3h", data[2:])),
    "bma180": (0x02, 7, lambda data: tuple(word >> 2 for word in words("<3h", data[:6]))),
    "l3g4200d": (0xA6, 8, lambda data: words("<3h", data[2:])),
    "hmc5883": (0x03, 6, lambda data: tuple(words(">3h", data)[index] for index in (0, 2, 1))),
}


def on_the_wire(bench: Bench, array: ArrayConfig, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Times (ns) and counts of every reading of one sensor that its chip gave."""
    sensor = array[name]
    register, size, decoded = DECODED[sensor.chip]
    times, counts, channel = [], [], None
    for tap in bench.taps:
        if array.mux and tap.address == array.mux.address and tap.answer is not None:
            channel = tap.write[0] & 3 if tap.write[0] & 4 else None
        ours = sensor.channel is None or sensor.channel == channel
        if ours and (tap.address, tap.write) == (sensor.address, bytes([register])) and len(tap.answer or b"") == size:
            times.append(tap.at_ns)
            counts.append(decoded(tap.answer or b""))
    return np.array(times), np.array(counts)


def logged(path: Path, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    with open_log(path) as log:
        sensor = log[name]
        return sensor.time[:], sensor.counts[:], np.asarray(sensor.status[:])


def events(path: Path) -> list[tuple[str, str, str]]:
    with open_log(path) as log:
        return [(event.sensor, event.kind, event.message) for event in log.events]


class BadLine:
    """A line that damages a `share` of the frames of data: nothing arrives, a part, noise, a wrong bit, or, if it
    `repeats`, the frame twice. `damaged` counts them.
    """

    def __init__(self, seed: int, share: float, *, repeats: bool = False) -> None:
        self.damaged = 0
        self._draw, self._share, self._repeats = np.random.default_rng(seed), share, repeats

    def __call__(self, piece: bytes) -> bytes:
        draw = self._draw
        if not piece or piece[4] != DATA or draw.random() > self._share:
            return piece
        self.damaged += 1
        at = int(draw.integers(len(piece)))
        kinds = [
            b"",
            piece[:at],
            bytes(draw.bytes(30)) + piece[5:],
            piece[:at] + bytes([piece[at] ^ 1 << int(draw.integers(8))]) + piece[at + 1 :],
            *([piece + piece] if self._repeats else []),
        ]
        return kinds[int(draw.integers(len(kinds)))]
