"""Packets in the queue of an ICM-42688-P: bytes to bytes, without a chip.

A packet begins with a header that determines its contents and length (TDK-81): 8 bytes with one triad, 16 with both and
a time stamp, 20 with both in 20 bits. In packets of 20 bytes the four lowest bits of each axis are at the end, those of
the accelerometer above those of the gyroscope (TDK-88). The accelerometer leaves two of its 20 bits at 0, the gyroscope
one (TDK-89), so that counts in a row have 18 and 19 bits.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from imuarray.drivers.driver import Bytes

ONE_TRIAD, BOTH_TRIADS, HIGH_RESOLUTION = 8, 16, 20
"""Sizes of packets in bytes."""
ROW_BYTES = 14
"""Size of a row of one half from packets of high resolution: x, y, z of 32 bits, temperature of 16, high byte first."""
HALVES: Mapping[str, int] = MappingProxyType({"acc": 0x40, "gyro": 0x20})
"""Bit of the header that is set if the triad of this half is in the packet."""
_EMPTY, _MORE_BITS, _PULSE = 0x80, 0x10, 0x0C
_FIRST: Mapping[str, int] = MappingProxyType({"acc": 1, "gyro": 7})
_EXTENSION = slice(17, 20)
_ZERO_BITS: Mapping[str, int] = MappingProxyType({"acc": 2, "gyro": 1})


def header_of(halves: Collection[str], *, high_resolution: bool = False) -> int:
    """Return bits 7:4 of the header of packets with these halves."""
    return sum(HALVES[half] for half in halves) | (_MORE_BITS if high_resolution else 0)


def is_empty(header: int) -> bool:
    """Return whether a header means that the queue is empty."""
    return bool(header & _EMPTY)


def are_after_pulse(headers: Bytes) -> npt.NDArray[np.bool_]:
    """Return (n,) which packets with these headers (n,) are the first after a synchronisation pulse (TDK-90)."""
    return np.asarray((headers & _PULSE) == _PULSE, np.bool_)


def packet_size(header: int) -> int:
    """Return the length of a packet with this header; 0 if the queue is empty, or if no packet has it."""
    triads = header & (HALVES["acc"] | HALVES["gyro"])
    if is_empty(header) or not triads:
        return 0
    both = triads == HALVES["acc"] | HALVES["gyro"]
    if header & _MORE_BITS:
        return HIGH_RESOLUTION if both else 0
    return BOTH_TRIADS if both else ONE_TRIAD


def stamp_offset(size: int) -> int:
    """Return the position of the 16-bit time stamp in a packet of this size, high byte first."""
    return 15 if size == HIGH_RESOLUTION else 14


def widened(packets: bytes, half: str) -> bytes:
    """Return packets of one half as packets of both halves, without readings of the other half."""
    table = np.frombuffer(packets, np.uint8).reshape(-1, ONE_TRIAD)
    wide = np.zeros((len(table), BOTH_TRIADS), np.uint8)
    first = _FIRST[half]
    wide[:, first : first + 6], wide[:, 13] = table[:, 1:7], table[:, 7]
    return wide.tobytes()


def high_resolution_rows(packets: bytes, half: str) -> bytes:
    """Return rows of one half (`ROW_BYTES` each) from packets of 20 bytes; the lowest code stands for no reading."""
    table = np.frombuffer(packets, np.uint8).reshape(-1, HIGH_RESOLUTION)
    first = _FIRST[half]
    upper = np.ascontiguousarray(table[:, first : first + 6]).view(">i2").astype(np.int32)
    nibbles: Bytes = table[:, _EXTENSION]
    lower = nibbles >> 4 if half == "acc" else nibbles & 0x0F
    rows = np.empty((len(table), ROW_BYTES), np.uint8)
    codes = (upper << 4 | lower) >> _ZERO_BITS[half]
    rows[:, :12] = codes.astype(">i4").view(np.uint8)
    rows[:, 12:] = table[:, 13:15]
    return rows.tobytes()
