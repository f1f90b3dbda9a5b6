"""MIMU4444 boards: eight MPU-9150, four on each side, so that every axis of a chip on one side opposes an axis of a
chip on the other.

Scales: 2048 counts per g (+-16 g), 16.4 counts per degree/s (+-2000 degrees/s). The box frame is the board's, that of
the odd units; the even ones, on the other side, have x along -Y, y along -X, z along -Z. Time is the board's 64 MHz
counter of 32 bits, which wraps every 67 s; the packet numbers of 16 bits determine the number of wraps in a gap.

The packets are searched for and validated in a byte stream, block by block; other bytes may be between them. A packet
is 106 bytes, big endian: 0xAA, packet number (16 bits), payload length (100), time stamp (32 bits), eight times ax ay
az gx gy gz (16 bits, signed), and the sum of the first 104 bytes (16 bits). Sources: the recordings that were published
with H. Carlsson, I. Skog, J. Jalden, Self-Calibration of Inertial Sensor Arrays, IEEE Sensors Journal 21(6), 2021
(github.com/hcarlsso/Self-Calibration-Inertial-Sensor-Arrays-BCD.jl, MIT).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Integers
from imuarray.errors import SourceError
from imuarray.importers import NO_WALL_TIME, ImportSummary, open_source, unreadable
from imuarray.importers.clipped import flag_clipped
from imuarray.log import Block, LogWriter
from imuarray.log.format import LOST_BEFORE, SATURATED, Event, SensorHeader

HEAD = 0xAA
PAYLOAD = 100
"""Bytes between the length and the checksum: time stamp and eight sensors."""

PACKET = np.dtype(
    [
        ("head", "u1"),
        ("number", ">u2"),
        ("length", "u1"),
        ("ticks", ">u4"),
        ("axes", ">i2", (8, 6)),
        ("checksum", ">u2"),
    ]
)
SIZE = PACKET.itemsize
SUMMED = SIZE - 2

BLOCK_BYTES = 1 << 18

_ACKNOWLEDGE = 0xA0


class Piece(NamedTuple):
    """Packets (n,) in stream order. `skipped` (n + 1,) is the number of bytes before each packet, and after the last,
    that are not part of a valid packet. `broken` (n + 1,) is the number of packets with a wrong checksum in them.
    """

    packets: npt.NDArray[Any]
    skipped: Integers
    broken: Integers


def read_packets(file: BinaryIO, block_bytes: int = BLOCK_BYTES) -> Iterator[Piece]:
    """Yield the packets of `file` in pieces of about `block_bytes`, without the board's acknowledgement of a command at
    the beginning.
    """
    cutter = _Cutter()
    head = file.read(4)
    block = (b"" if _is_acknowledge(head) else head) + file.read(block_bytes)
    while block:
        yield cutter.cut(block)
        block = file.read(block_bytes)
    yield cutter.cut(b"", last=True)


def _is_acknowledge(head: bytes) -> bool:
    """Return whether these bytes are the board's answer to the start command: 0xA0, the command, and their sum."""
    return len(head) == 4 and head[0] == _ACKNOWLEDGE and int.from_bytes(head[2:], "big") == head[0] + head[1]


class _Cutter:
    """The state between two blocks: undecided bytes (`rest`), bytes `skipped` and packets `broken` since the last
    packet, and the number of undecided bytes in a packet that is already `counted` as broken.
    """

    def __init__(self) -> None:
        self.rest = b""
        self.skipped = 0
        self.broken = 0
        self.counted = 0

    def cut(self, block: bytes, last: bool = False) -> Piece:
        """Return the packets of the rest and `block`. Bytes that may begin a packet are kept, unless `last`."""
        data = np.frombuffer(self.rest + block, np.uint8)
        good, bad = _find(data)
        end = int(good[-1]) + SIZE if len(good) else 0
        # A packet counts as broken only if no valid packet begins within it, which may depend on the next block.
        undecided = max(end, len(data) if last else len(data) - 2 * SIZE + 1)
        bad = _drop_overlaps(_clear_of(good, bad[(bad < undecided) & (bad >= self.counted)]))
        starts = np.append(good, undecided)
        skipped = np.diff(starts, prepend=0) - np.append(0, np.full(len(good), SIZE))
        broken = np.diff(np.searchsorted(bad, starts), prepend=0)
        skipped[0] += self.skipped
        broken[0] += self.broken
        self.rest = data[undecided:].tobytes()
        self.counted = max(0, int(bad[-1]) + SIZE - undecided) if len(bad) else max(0, self.counted - undecided)
        self.skipped, self.broken = int(skipped[-1]), int(broken[-1])
        if not last:
            skipped[-1] = broken[-1] = 0
        return Piece(_packets_at(data, good), skipped, broken)


def _find(data: npt.NDArray[np.uint8]) -> tuple[Integers, Integers]:
    """Return where valid packets begin in `data`, and where framed packets with a wrong checksum begin."""
    count = max(0, len(data) - SIZE + 1)
    framed = np.flatnonzero((data[:count] == HEAD) & (data[3 : 3 + count] == PAYLOAD))
    total = np.concatenate([[0], np.cumsum(data, dtype=np.int64)])
    sums = (total[framed + SUMMED] - total[framed]) & 0xFFFF
    stated = data[framed + SUMMED].astype(np.int64) << 8 | data[framed + SUMMED + 1]
    sound = sums == stated
    return _drop_overlaps(framed[sound]), framed[~sound]


def _drop_overlaps(starts: Integers) -> Integers:
    """Return `starts` without those within the packet of an earlier one."""
    if (np.diff(starts) >= SIZE).all():
        return starts
    kept: list[int] = []
    for start in starts.tolist():
        if not kept or start >= kept[-1] + SIZE:
            kept.append(start)
    return np.array(kept, np.int64)


def _clear_of(good: Integers, bad: Integers) -> Integers:
    """Return `bad` without those that overlap a packet of `good`."""
    if len(good) == 0:
        return bad
    following = np.searchsorted(good, bad)
    preceding = good[np.maximum(following - 1, 0)]
    next_start = good[np.minimum(following, len(good) - 1)]
    clear: npt.NDArray[np.bool_] = (np.abs(bad - preceding) >= SIZE) & (np.abs(next_start - bad) >= SIZE)
    return bad[clear]


def _packets_at(data: npt.NDArray[np.uint8], starts: Integers) -> npt.NDArray[Any]:
    """Return the packets (n,) that begin at `starts`."""
    if len(starts) == 0:
        return np.empty(0, PACKET)
    if len(starts) == 1 or (np.diff(starts) == SIZE).all():
        return data[starts[0] : starts[-1] + SIZE].view(PACKET)
    return np.ascontiguousarray(data[starts[:, None] + np.arange(SIZE)]).view(PACKET)[:, 0]


RATE_HZ = 62.5
COUNTER_HZ = 64_000_000
TICKS_PER_PACKET = round(COUNTER_HZ / RATE_HZ)

JUMP_S = 0.5
"""Allowed difference in s between the counter and the packet numbers, plus 1 % of a gap; a larger one is an event."""

EVENTS_PER_KIND = 100
"""Maximum number of events of one kind; the rest is one event with their number."""

_POSITIONS_MM = tuple((x, y, z) for x in (-9.45, 9.45) for y in (9.45, -9.45) for z in (1.0, -1.0))
_AXES = ("+X+Y+Z", "-Y-X-Z")


def sensors() -> list[SensorHeader]:
    """Return the sixteen sensors of a board: `IMU1_acc`, `IMU1_gyro`, ..., `IMU8_gyro`."""
    return [header for unit in range(len(_POSITIONS_MM)) for header in (_header(unit, "acc"), _header(unit, "gyro"))]


def _header(unit: int, part: str) -> SensorHeader:
    """Return the header of the accelerometer ("acc") or gyroscope ("gyro") of one unit, counted from 0."""
    gyro = part == "gyro"
    return SensorHeader(
        name=f"IMU{unit + 1}_{part}",
        chip="mpu9150",
        quantity="angular_rate" if gyro else "specific_force",
        unit="dps" if gyro else "g",
        range=2000.0 if gyro else 16.0,
        sensitivity=16.4 if gyro else 2048.0,
        rate_hz=RATE_HZ,
        axes=_AXES[unit % 2],
        position_mm=_POSITIONS_MM[unit],
    )


def import_file(
    source: str | PathLike[str],
    output: str | PathLike[str],
    *,
    force: bool = False,
    progress: Callable[[int], None] = lambda done: None,
    block_bytes: int = BLOCK_BYTES,
) -> ImportSummary:
    """Write the recording `source` to the log `output`; SourceError if it contains no valid packet."""
    headers = sensors()
    with (
        open_source(source, output) as file,
        LogWriter(output, headers, source="imported", epoch=NO_WALL_TIME, force=force) as log,
    ):
        recording = _Recording(log, [header.name for header in headers], str(source))
        for piece in read_packets(file, block_bytes):
            recording.add(piece)
            progress(file.tell())
        summary = recording.finish()
        return replace(summary, remarks=tuple(flag_clipped(log, headers)))


def is_recording(source: str | PathLike[str]) -> bool:
    """Return whether a file begins with packets of a board; SourceError if it is unreadable."""
    try:
        with Path(source).open("rb") as file:
            return any(len(piece.packets) > 1 for piece in islice(read_packets(file), 1))
    except OSError as error:
        raise unreadable(Path(source), error) from None


class _Recording:
    """The state of one import: the last packet's number and counter, the elapsed time, events."""

    def __init__(self, log: LogWriter, names: list[str], source: str) -> None:
        self.log = log
        self.names = names
        self.source = source
        self.rows = self.lost = 0
        self.number = self.ticks = self.elapsed = 0
        self.happened: Counter[str] = Counter()
        note = f"from {Path(source).name}, MIMU4444; without wall-clock time: the epoch is that of its first packet"
        log.event(Event(0, "", "imported", note))

    def add(self, piece: Piece) -> None:
        number = piece.packets["number"].astype(np.int64)
        ticks = piece.packets["ticks"].astype(np.int64)
        if len(number) and not self.rows:
            self.number, self.ticks, self.elapsed = (
                int(number[0]) - 1,
                int(ticks[0]) - TICKS_PER_PACKET,
                -TICKS_PER_PACKET,
            )
        steps, passed = _advance(np.append(self.number, number), np.append(self.ticks, ticks))
        elapsed = self.elapsed + np.cumsum(passed)
        time = (elapsed * 125 + 4) // 8  # 15.625 ns a tick
        fresh = passed > 0
        if (~fresh & (steps > 0)).any():
            stuck = number[np.argmax(~fresh & (steps > 0))]
            raise SourceError(f"{self.source}: packet {stuck}: it has the time stamp of the packet before it")
        self._write(piece, time, steps, fresh)
        self._note(piece, number, time, steps, passed)
        if len(number):
            self.number, self.ticks, self.elapsed = int(number[-1]), int(ticks[-1]), int(elapsed[-1])

    def _write(self, piece: Piece, time: Integers, steps: Integers, fresh: npt.NDArray[np.bool_]) -> None:
        gap = np.where(steps > 1, LOST_BEFORE, 0)[fresh]
        axes = piece.packets["axes"].astype(np.int16)[fresh].reshape(-1, len(self.names), 3)
        for index, name in enumerate(self.names):
            counts = np.ascontiguousarray(axes[:, index])
            full = ((counts == -32768) | (counts == 32767)).any(axis=1)
            self.log.append(name, Block(time[fresh], counts, (gap | np.where(full, SATURATED, 0)).astype(np.uint16)))
        self.rows += len(axes)
        self.lost += int(np.maximum(steps - 1, 0).sum())

    def _note(self, piece: Piece, number: Integers, time: Integers, steps: Integers, passed: Integers) -> None:
        time_of_row = np.append(time, (self.elapsed * 125 + 4) // 8 if len(time) == 0 else time[-1])
        odd = piece.skipped - SIZE * piece.broken
        excess = np.abs(passed - steps * TICKS_PER_PACKET)
        jumps = np.flatnonzero(excess > JUMP_S * COUNTER_HZ + 0.01 * steps * TICKS_PER_PACKET)
        end = len(number)
        errors: dict[str, tuple[Integers, Callable[[int], str]]] = {
            "checksum": (
                np.flatnonzero(piece.broken),
                lambda i: f"{piece.broken[i]} packets with a wrong checksum left out",
            ),
            "garbage": (np.flatnonzero(odd[:end]), lambda i: f"{odd[i]} bytes that belong to no packet left out"),
            "lost": (np.flatnonzero(steps > 1), lambda i: f"{steps[i] - 1} packets missing before packet {number[i]}"),
            "repeated": (
                np.flatnonzero(steps == 0),
                lambda i: f"packet {number[i]} was received twice; one is left out",
            ),
            "clock": (jumps, lambda i: _jump(passed[i], steps[i]) + f" before packet {number[i]}"),
            "cut_off": (
                end + np.flatnonzero(odd[end:]),
                lambda i: f"{odd[i]} bytes at the end are not a whole packet",
            ),
        }
        for kind, (rows, message) in errors.items():
            for index in rows:
                self.happened[kind] += 1
                if self.happened[kind] <= EVENTS_PER_KIND:
                    self.log.event(Event(max(0, int(time_of_row[index])), "", kind, message(index)))

    def finish(self) -> ImportSummary:
        """Write the last events and return the summary; SourceError if there was no packet."""
        if self.rows == 0:
            raise SourceError(
                f"{self.source}: no MIMU4444 packet in it; expected packets of {SIZE} bytes: 0xaa, number, "
                f"length {PAYLOAD}, payload, sum of the first {SIZE - 2} bytes"
            )
        end_ns = (self.elapsed * 125 + 4) // 8
        for kind, count in self.happened.items():
            if count > EVENTS_PER_KIND:
                self.log.event(Event(end_ns, "", kind, f"{count - EVENTS_PER_KIND} more events of this kind"))
        return ImportSummary(tuple(self.names), self.rows, self.lost, end_ns * 1e-9, dict(self.happened))


def _jump(passed: int, steps: int) -> str:
    """Describe the difference between the counter and the packet numbers."""
    return f"{passed / COUNTER_HZ:.3f} s by the counter, {steps / RATE_HZ:.3f} s by the packet numbers,"


def _advance(number: Integers, ticks: Integers) -> tuple[Integers, Integers]:
    """Return, from raw numbers and counters (n + 1,), the number of packets and of ticks (n,) from each packet to the
    next.

    Both wrap: the number after 65536 packets, the counter after 2**32 ticks; in a gap the packet number determines how
    often the counter wrapped. A repeated packet is a step of 0 packets and 0 ticks; no other step is 0.
    """
    steps = (np.diff(number) - 1) % 65536 + 1
    passed = np.diff(ticks) % 2**32
    same = (steps == 65536) & (passed == 0)
    wraps = np.rint((steps * TICKS_PER_PACKET - passed) / 2**32).astype(np.int64)
    passed += np.maximum(wraps, 0) * 2**32
    return np.where(same, 0, steps), np.where(same, 0, passed)
