"""Scans of Linux's industrial I/O subsystem: what the bytes of /dev/iio:deviceN mean.

A scan is the values of all enabled channels of one instant. Its layout follows from two attributes of each channel in
sysfs: its index, which orders the channels, and its type, for example ``le:s12/16>>4``. Each value is aligned to its
own size, and the whole scan to its largest value. Kernel `Documentation/iio/iio_devbuf.rst`,
`Documentation/ABI/testing/sysfs-bus-iio` (`scan_elements`) and `iio_compute_scan_bytes`; facts LNX-60 to -62.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

TYPE = re.compile(r"(be|le):([su])([0-9]{1,3})/([0-9]{1,3})(?:X([0-9]{1,3}))?(?:>>([0-9]{1,3}))?", re.ASCII)
"""The type of a channel: byte order, sign, valid bits, stored bits, repetitions, shift (LNX-60)."""
STORED_BITS = (8, 16, 32, 64)
MOST_REPETITIONS = 16
ALLOWED_TYPE = "[be|le]:[s|u]bits/stored bits (8, 16, 32, 64)[Xrepeat (1, 2, 4, 8, 16)][>>shift]"


@dataclass(frozen=True)
class ScanElement:
    """One channel of a scan: its `name` in sysfs ("in_accel_x"), its `index`, and the type of its values."""

    name: str
    index: int
    is_big_endian: bool
    is_signed: bool
    bits: int
    stored_bits: int
    repeat: int = 1
    shift: int = 0

    @classmethod
    def parse(cls, name: str, index: str, kind: str) -> ScanElement:
        """The channel `name` by the texts of its index and type; ValueError says what is allowed.

        >>> ScanElement.parse("in_accel_y", "1", "le:s12/16>>4").shift
        4
        """
        if not (index.isascii() and index.isdigit() and len(index) < 7):
            raise ValueError(f"{name}_index is {index[:40]!r}: a whole number from 0 on is required")
        match = TYPE.fullmatch(kind)
        if match is None:
            raise ValueError(f"{name}_type is {kind[:40]!r}: allowed is {ALLOWED_TYPE}")
        bits, stored, repeat, shift = (int(number or 0) for number in match.group(3, 4, 5, 6))
        repeat = max(repeat, 1)
        fits = stored in STORED_BITS and bits > 0 and bits + shift <= stored
        if not fits or repeat > MOST_REPETITIONS or repeat & (repeat - 1):
            raise ValueError(
                f"{name}_type is {kind!r}: allowed is {ALLOWED_TYPE}, bits and shift within the stored bits"
            )
        return cls(name, int(index), match[1] == "be", match[2] == "s", bits, stored, repeat, shift)

    @property
    def size(self) -> int:
        """Bytes in a scan, to which the value is aligned as well."""
        return self.stored_bits // 8 * self.repeat

    @property
    def range_bits(self) -> int:
        """Bits of a signed number that holds every value: one more than `bits` where the type is unsigned."""
        return self.bits + (not self.is_signed)


@dataclass(frozen=True)
class ScanLayout:
    """The enabled channels in the order of their indices, and where in a scan of `size` bytes each begins."""

    elements: tuple[ScanElement, ...]
    offsets: tuple[int, ...]
    size: int

    @classmethod
    def of(cls, elements: Iterable[ScanElement]) -> ScanLayout:
        """The layout of scans of these channels; ValueError if there is none, or two have one index."""
        ordered = sorted(elements, key=lambda element: element.index)
        if not ordered:
            raise ValueError("no channel is enabled: a scan needs at least one")
        for first, second in pairwise(ordered):
            if first.index == second.index:
                raise ValueError(f"{first.name}_index and {second.name}_index are both {first.index}")
        offsets, end = [], 0
        for element in ordered:
            start = -(-end // element.size) * element.size
            offsets.append(start)
            end = start + element.size
        largest = max(element.size for element in ordered)
        return cls(tuple(ordered), tuple(offsets), -(-end // largest) * largest)

    def unpack(self, scans: bytes) -> Mapping[str, npt.NDArray[Any]]:
        """The values of n whole scans by the name of the channel: (n,), or (n, repeat) where values are repeated.

        int64, or uint64 for unsigned values of 64 bits. Bits above the valid ones are ignored, as they are undefined.
        """
        order = {True: ">", False: "<"}
        kind = np.dtype(
            {
                "names": [element.name for element in self.elements],
                "formats": [
                    (f"{order[element.is_big_endian]}u{element.stored_bits // 8}", (element.repeat,))
                    for element in self.elements
                ],
                "offsets": list(self.offsets),
                "itemsize": self.size,
            }
        )
        rows = np.frombuffer(scans, kind)
        return {element.name: _values(rows[element.name], element) for element in self.elements}


def _values(stored: npt.NDArray[Any], element: ScanElement) -> npt.NDArray[Any]:
    """Shift, mask and sign (n, repeat) stored words."""
    unused = np.uint64(64 - element.bits)
    words = (stored.astype(np.uint64) >> np.uint64(element.shift)) << unused
    values: npt.NDArray[Any]
    if element.is_signed:
        values = words.view(np.int64) >> np.int64(64 - element.bits)
    else:
        values = words >> unused
        if element.bits < 64:
            values = values.astype(np.int64)
    return values[:, 0] if element.repeat == 1 else values
