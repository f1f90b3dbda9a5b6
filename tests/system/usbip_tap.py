"""An emulated array that is served over USB/IP by this process, which notes every byte that its chips give."""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from firmware_emulator.serve import UsbipServer

Rows = list[list[int]]


class WireTap:
    """A wire that records each transfer: address, register, bytes that were read."""

    def __init__(self, wire: Any) -> None:
        self.wire = wire
        self.reads: list[tuple[int, int, bytes]] = []
        self._register = -1

    def send(self, address: int, data: bytes) -> None:
        self._register = data[0] if data else -1
        self.wire.send(address, data)

    def receive(self, address: int, count: int) -> bytes:
        answer: bytes = self.wire.receive(address, count)
        self.reads.append((address, self._register, answer))
        return answer

    def given(self, address: int, register: int) -> list[bytes]:
        """The bytes that were read from one register on, a piece a transaction."""
        return [data for at, where, data in self.reads if (at, where) == (address, register)]

    def __getattr__(self, name: str) -> Any:
        return getattr(self.wire, name)


@contextmanager
def serve_array(wires: Mapping[str, WireTap], name: str) -> Iterator[int]:
    """Serve the wires, each as a separate adapter; the port."""
    with UsbipServer(wires, name, port=0) as server:  # type: ignore[arg-type]
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server.address[1]
        finally:
            server.shutdown()
            thread.join()


def words(data: bytes, order: str) -> list[int]:
    """Signed numbers of 16 bits; `order` is ">" or "<"."""
    return [value for (value,) in struct.iter_unpack(f"{order}h", data)]


def mpu_rows(wire: WireTap, address: int) -> Rows:
    """Records of an MPU's queue with acceleration, temperature and rate: the six of the triads (INV-27)."""
    records = [words(part, ">") for part in wire.given(address, 0x74)]
    return [record[:3] + record[4:] for record in records if len(record) == 7]


def lsm6dso_rows(wire: WireTap, address: int, tag: int) -> Rows:
    """Triads of one tag in the bytes of an LSM6DSO's queue: 1 is the rate, 2 the acceleration (LSM-50)."""
    queue = b"".join(wire.given(address, 0x78))
    pieces = [queue[at : at + 7] for at in range(0, len(queue) - 6, 7)]
    return [words(piece[1:], "<") for piece in pieces if piece[0] >> 3 == tag]


def icm_rows(wire: WireTap, address: int, half: int) -> Rows:
    """Valid triads of one half in the bytes of an ICM-426xx's queue: 0 acceleration, 1 rate. A header states which
    are present; a packet of both has 16 bytes, of one 8 (TDK-81, TDK-82); -32768 is no reading (TDK-13). What a read
    left of a packet is in the next (TDK-86).
    """
    rows, queue, at = [], b"".join(wire.given(address, 0x30)), 0
    while at < len(queue):
        has = [bool(queue[at] & 0x40), bool(queue[at] & 0x20)]
        assert any(has), queue[at : at + 16].hex()
        size = 16 if all(has) else 8
        begin = at + 1 + (6 if half == 1 and has[0] else 0)
        row = words(queue[begin : begin + 6], ">") if at + size <= len(queue) else []
        if has[half] and row and row != [-32768] * 3:
            rows.append(row)
        at += size
    return rows
