"""Packets of a MIMU4444 board in a byte stream, found and validated block by block between other bytes.

A packet is 106 bytes, big endian: 0xAA, packet number (16 bits), payload length (100), time stamp (32 bits), eight
times ax ay az gx gy gz (16 bits, signed), and the sum of the first 104 bytes (16 bits). Sources: the recordings that
were published with H. Carlsson, I. Skog, J. Jalden, Self-Calibration of Inertial Sensor Arrays, IEEE Sensors Journal
21(6), 2021 (github.com/hcarlsso/Self-Calibration-Inertial-Sensor-Arrays-BCD.jl, MIT).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Integers

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
    """Packets (n,) in stream order. `skipped` (n + 1,): bytes before each packet, and after the last, that belong to no
    valid packet. `broken` (n + 1,): packets of wrong checksum among them.
    """

    packets: npt.NDArray[Any]
    skipped: Integers
    broken: Integers


def read_packets(file: BinaryIO, block_bytes: int = BLOCK_BYTES) -> Iterator[Piece]:
    """Yield the packets of `file` in pieces of about `block_bytes`, without a command's acknowledge at the
    beginning.
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
    """The state between two blocks: undecided bytes, bytes skipped since the last packet, and how many of the rest
    belong to a packet that is already counted as broken.
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
        done = int(good[-1]) + SIZE if len(good) else 0
        # A broken packet is one only if no sound packet begins within it, which the next block may yet show.
        undecided = max(done, len(data) if last else len(data) - 2 * SIZE + 1)
        bad = _apart(_clear_of(good, bad[(bad < undecided) & (bad >= self.counted)]))
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
    return _apart(framed[sound]), framed[~sound]


def _apart(starts: Integers) -> Integers:
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
    after = np.searchsorted(good, bad)
    before = good[np.maximum(after - 1, 0)]
    next_one = good[np.minimum(after, len(good) - 1)]
    clear: npt.NDArray[np.bool_] = (np.abs(bad - before) >= SIZE) & (np.abs(next_one - bad) >= SIZE)
    return bad[clear]


def _packets_at(data: npt.NDArray[np.uint8], starts: Integers) -> npt.NDArray[Any]:
    """Return the packets (n,) that begin at `starts`."""
    if len(starts) == 0:
        return np.empty(0, PACKET)
    if len(starts) == 1 or (np.diff(starts) == SIZE).all():
        return data[starts[0] : starts[-1] + SIZE].view(PACKET)
    return np.ascontiguousarray(data[starts[:, None] + np.arange(SIZE)]).view(PACKET)[:, 0]
