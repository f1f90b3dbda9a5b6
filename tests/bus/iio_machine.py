"""A machine whose kernel serves sensors: a tree like sysfs, and FIFOs for the character devices of their buffers.

Attributes are plain files; the reaction of the kernel to a write is left to the tests. Scans are laid out by
hand, byte by byte, from the description in the kernel's documentation.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

ACCEL = {  # of an accelerometer that captures by itself, its buffer as it was until kernel 5.10
    "in_accel_scale": "0.000598205",
    "in_accel_scale_available": "0.000598205 0.001196410 0.002392821 0.004785642",
    "in_accel_x_raw": "1",
    "in_accel_y_raw": "-2",
    "in_accel_z_raw": "16384",
    "sampling_frequency": "50",
    "sampling_frequency_available": "10 50 100 200",
    "current_timestamp_clock": "realtime",
    "buffer/enable": "0",
    "buffer/length": "2",
    "buffer/watermark": "1",
    "scan_elements/in_accel_x_en": "0",
    "scan_elements/in_accel_x_index": "0",
    "scan_elements/in_accel_x_type": "le:s16/16>>0",
    "scan_elements/in_accel_y_en": "0",
    "scan_elements/in_accel_y_index": "1",
    "scan_elements/in_accel_y_type": "le:s16/16>>0",
    "scan_elements/in_accel_z_en": "0",
    "scan_elements/in_accel_z_index": "2",
    "scan_elements/in_accel_z_type": "le:s16/16>>0",
    "scan_elements/in_timestamp_en": "0",
    "scan_elements/in_timestamp_index": "3",
    "scan_elements/in_timestamp_type": "le:s64/64>>0",
}


class KernelDevice:
    """One device: its `folder` in sysfs, and the FIFO in the place of its character device."""

    def __init__(self, root: Path, number: int, place: str, attributes: Mapping[str, str]) -> None:
        self.folder = root / f"sys/devices/{place}/iio:device{number}"
        self.file = root / f"dev/iio:device{number}"
        self.folder.mkdir(parents=True)
        for name, text in attributes.items():
            self.write(name, text)
        listed = root / "sys/bus/iio/devices"
        listed.mkdir(parents=True, exist_ok=True)
        self.link = listed / self.folder.name
        self.link.symlink_to(self.folder)
        self.file.parent.mkdir(exist_ok=True)
        os.mkfifo(self.file)

    def write(self, name: str, text: str) -> None:
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text + "\n")

    def read(self, name: str) -> str:
        return (self.folder / name).read_text().strip()

    def feed(self, scans: bytes) -> None:
        """Let scans wait in the buffer; somebody must have it open."""
        fd = os.open(self.file, os.O_WRONLY | os.O_NONBLOCK)
        assert os.write(fd, scans) == len(scans)
        os.close(fd)


class KernelMachine:
    """`root` has the folders sys and dev."""

    def __init__(self, root: Path) -> None:
        self.root = root
        (root / "sys").mkdir()
        self._count = 0

    def add(self, name: str, place: str, attributes: Mapping[str, str]) -> KernelDevice:
        device = KernelDevice(self.root, self._count, place, {"name": name, **attributes})
        self._count += 1
        return device


def scan(words: Sequence[tuple[int, int, str]]) -> bytes:
    """One scan of words (stored value, bytes, "little" or "big"), each aligned to its size, all to the largest."""
    out = bytearray()
    for value, size, order in words:
        while len(out) % size:
            out.append(0xA5)
        out += value.to_bytes(size, order, signed=value < 0)  # type: ignore[arg-type]
    while len(out) % max(size for _, size, _ in words):
        out.append(0xA5)
    return bytes(out)
