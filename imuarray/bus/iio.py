"""Devices of Linux's industrial I/O subsystem (IIO): sensors that a driver of the kernel reads, through sysfs.

A device is a folder of attributes, one small text file each, and a character device with the scans of its buffer.
Kernel `Documentation/ABI/testing/sysfs-bus-iio` and `Documentation/iio/iio_devbuf.rst`; facts LNX-60 to -68.
`IioDevice` raises OSError with the errno and the file, as Linux does.

A scan, as read from /dev/iio:deviceN, is the values of all enabled channels of one instant. Its layout follows from two
attributes of each channel in sysfs: its index, which orders the channels, and its type, for example ``le:s12/16>>4``.
Each value is aligned to its own size, and the whole scan to its largest value. Kernel
`Documentation/iio/iio_devbuf.rst`, `Documentation/ABI/testing/sysfs-bus-iio` (`scan_elements`) and
`iio_compute_scan_bytes`; facts LNX-60 to -62.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn, Self

import numpy as np
import numpy.typing as npt

from imuarray.bus.linux import SpiBus
from imuarray.bus.protocol import Bus, SpiPort
from imuarray.clock import Clock, MonotonicClock
from imuarray.errors import BusUrlError, SensorError
from imuarray.printable import printable

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
        """Return the channel `name` by the texts of its index and type; ValueError states what is allowed.

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
        """The bytes in a scan, to which the value is also aligned."""
        return self.stored_bits // 8 * self.repeat

    @property
    def range_bits(self) -> int:
        """The bits of a signed number that holds every value: one more than `bits` if the type is unsigned."""
        return self.bits + (not self.is_signed)


@dataclass(frozen=True)
class ScanLayout:
    """The enabled channels in the order of their indices, and the position of each in a scan of `size` bytes."""

    elements: tuple[ScanElement, ...]
    offsets: tuple[int, ...]
    size: int

    @classmethod
    def of(cls, elements: Iterable[ScanElement]) -> ScanLayout:
        """Return the layout of scans of these channels; ValueError if there is none, or two have one index."""
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
        """Return the values of n whole scans by the name of the channel: (n,), or (n, repeat) where values are
        repeated.

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
    """Shift, mask and sign-extend (n, repeat) stored words."""
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


DEVICES = "sys/bus/iio/devices"
DEVICE = re.compile(r"iio:device[0-9]+", re.ASCII)
LONGEST_TEXT = 4096
"""Largest number of bytes of an attribute: a page of sysfs."""
MOST_ELEMENTS = 256
MOST_BYTES = 1 << 20
"""Largest number of bytes of scans that one call of `scans` reads; the next call reads the rest."""


class IioDevice:
    """The device that `wanted` names, below `root`: the label or name of its driver ("mpu6050"), its number
    ("device0"), each with ``@`` and its place ("mpu6050@1-0068") if several have the name.

    It is a `Bus` without registers: a transfer only checks whether the device exists, ENODEV if not.
    """

    def __init__(self, wanted: str, root: Path) -> None:
        self.wanted = wanted
        self._root = root
        self._folder: Path | None = None
        self._file = -1
        self._rest = b""
        self._layout: ScanLayout | None = None

    def __str__(self) -> str:
        return f"iio:{self.wanted}"

    # The device ---------------------------------------------------------------------------------------------------

    @property
    def folder(self) -> Path:
        """Its folder in sysfs; SensorError, which lists the existing devices, if none or several have the name."""
        if self._folder is None or not self._folder.is_dir():
            self._folder = self._find()
        return self._folder

    def _find(self) -> Path:
        devices = sorted(_devices(self._root), key=lambda folder: int(folder.name.removeprefix("iio:device")))
        where, _, place = self.wanted.partition("@")
        fits = [
            folder
            for folder in devices
            if where in (folder.name.removeprefix("iio:"), _text(folder / "label"), _text(folder / "name"))
            and place in ("", _place(folder))
        ]
        if len(fits) == 1:
            return fits[0]
        names = ", ".join(_name(folder) for folder in fits or devices)
        if fits:
            raise SensorError(f"{self}: {len(fits)} devices have this name; allowed are {names}")
        if not devices:
            raise SensorError(
                f"{self}: there is no device in /{DEVICES}; load the kernel module of the sensor's driver, and bind it"
            )
        raise SensorError(f"{self}: no such device; allowed are {names}")

    @property
    def name(self) -> str:
        """The name from its driver."""
        return printable(_text(self.folder / "name") or self.folder.name)

    @property
    def place(self) -> str:
        """The place of the chip on its bus in the kernel's notation: 1-0068 is address 0x68 of /dev/i2c-1."""
        return printable(_place(self.folder))

    @property
    def device_file(self) -> Path:
        """The character device of its buffer."""
        return self._root / "dev" / self.folder.name

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Check whether the device exists: OSError with ENODEV if not, with ENXIO for any register."""
        try:
            folder = self.folder
        except SensorError as error:
            raise OSError(errno.ENODEV, f"{self} was removed") from error
        if write or read:
            raise OSError(errno.ENXIO, "the kernel's driver owns the registers", str(folder))
        return b""

    # Attributes ---------------------------------------------------------------------------------------------------

    def read(self, attribute: str) -> str | None:
        """Return the text of an attribute; None if the device has none, or shares it with other devices. OSError."""
        path = self.folder / attribute
        try:
            return _read(path)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise _name_file(error, path) from error

    def write(self, attribute: str, text: str) -> None:
        """Write an attribute; OSError."""
        path = self.folder / attribute
        try:
            fd = os.open(path, os.O_WRONLY | os.O_TRUNC | os.O_CLOEXEC)
            try:
                os.write(fd, text.encode())
            finally:
                os.close(fd)
        except OSError as error:
            raise _name_file(error, path) from error

    def keep(self, attribute: str, text: str) -> None:
        """Write an attribute unless it has this value already, and read it back; SensorError if it does not keep it."""
        if self.read(attribute) == text:
            return
        self.write(attribute, text)
        kept = self.read(attribute)
        if kept != text:
            raise SensorError(f"{self}: {attribute} reads {kept!r} after {text!r} was written; the driver refuses it")

    def triggers(self) -> dict[str, Path]:
        """Return the folders of all existing triggers by name."""
        folders = sorted((self._root / DEVICES).glob("trigger[0-9]*"))
        return {name: folder for folder in folders if (name := _text(folder / "name"))}

    # The buffer ---------------------------------------------------------------------------------------------------

    def _buffer(self, attribute: str) -> str:
        """Return the path of an attribute of its first buffer (since kernel 5.11 in buffer0, LNX-64)."""
        return f"{'buffer0' if (self.folder / 'buffer0').is_dir() else 'buffer'}/{attribute}"

    def _elements_folder(self) -> str:
        return "scan_elements" if (self.folder / "scan_elements").is_dir() else "buffer0"

    def elements(self) -> dict[str, ScanElement]:
        """Return the channels that its buffer can have, by name; none without a buffer. SensorError if a type is
        invalid or if there are too many channels.
        """
        where = self._elements_folder()
        names = sorted(path.name.removesuffix("_en") for path in (self.folder / where).glob("*_en"))
        if len(names) > MOST_ELEMENTS:
            raise SensorError(f"{self}: {where} has {len(names)} channels; at most {MOST_ELEMENTS} are read")
        try:
            return {
                name: ScanElement.parse(
                    name, self.read(f"{where}/{name}_index") or "", self.read(f"{where}/{name}_type") or ""
                )
                for name in names
            }
        except ValueError as error:
            raise SensorError(f"{self}: {where}/{printable(str(error))}") from None

    def hold(self) -> None:
        """Open the buffer, which excludes other programs, and stop it; OSError with EBUSY if another program has it."""
        if self._file < 0:
            path = self.device_file
            try:
                self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            except OSError as error:
                raise _name_file(error, path) from error
        self.stop()

    def start(self, wanted: set[str], length: int, watermark: int) -> ScanLayout:
        """Enable the channels `wanted` and no others, start the capture into a buffer of `length` scans, and return
        their layout.

        It also has channels that the driver enables with them. OSError, SensorError."""
        elements, where = self.elements(), self._elements_folder()
        for name in elements:
            if name not in wanted and self.read(f"{where}/{name}_en") != "0":
                self.write(f"{where}/{name}_en", "0")
        for name in sorted(wanted):
            self.keep(f"{where}/{name}_en", "1")
        self.write(self._buffer("length"), str(length))
        with contextlib.suppress(OSError):  # read-only or missing where the driver sets it itself
            self.write(self._buffer("watermark"), str(watermark))
        self.write(self._buffer("enable"), "1")
        enabled = [element for name, element in elements.items() if self.read(f"{where}/{name}_en") == "1"]
        try:
            self._layout = ScanLayout.of(enabled)
        except ValueError as error:
            raise SensorError(f"{self}: {where}: {error}") from None
        self._rest = b""
        return self._layout

    def stop(self) -> None:
        """Stop the capture, also one of another program; OSError."""
        if self.read(self._buffer("enable")) not in ("0", None):
            self.write(self._buffer("enable"), "0")
        self._layout = None

    def scans(self) -> bytes:
        """Return the whole waiting scans, oldest first; OSError with ENODEV if the device was removed."""
        if self._layout is None or self._file < 0:
            raise OSError(errno.ENODEV, f"{self} is not set up")
        size, parts = self._layout.size, [self._rest]
        most = MOST_BYTES // size * size
        received = 0
        while received < most:
            try:
                part = os.read(self._file, most - received)
            except BlockingIOError:
                break
            except OSError as error:
                if error.errno == errno.ENODEV:
                    self._forget()
                raise OSError(error.errno, error.strerror, str(self)) from error
            if not part:
                break
            parts.append(part)
            received += len(part)
        if not received and (self._folder is None or not self._folder.is_dir()):
            self._forget()
            raise OSError(errno.ENODEV, f"{self} was removed")
        data = b"".join(parts)
        whole = len(data) // size * size
        self._rest = data[whole:]
        return data[:whole]

    def release(self) -> None:
        """Stop the capture and close the buffer."""
        if self._file >= 0:
            with contextlib.suppress(OSError, SensorError):
                self.stop()
        self._forget()

    def _forget(self) -> None:
        """Close the buffer; the device may have been removed."""
        if self._file >= 0:
            os.close(self._file)
        self._file, self._layout = -1, None


def _devices(root: Path) -> Iterator[Path]:
    with contextlib.suppress(OSError):
        for path in (root / DEVICES).iterdir():
            if DEVICE.fullmatch(path.name):
                yield path


def devices(root: Path) -> list[IioDevice]:
    """Return all devices below `root`, each by its name and place: "iio:mpu6050@1-0068"."""
    return [IioDevice(name.removeprefix("iio:"), root) for name in sorted(_name(folder) for folder in _devices(root))]


def _name(folder: Path) -> str:
    name = printable(_text(folder / "name") or folder.name.removeprefix("iio:"))
    return f"iio:{name}@{printable(_place(folder))}"


def _place(folder: Path) -> str:
    """Return the name of the parent device: the chip on its bus (LNX-63)."""
    return folder.resolve().parent.name


def _read(path: Path) -> str:
    fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        return os.read(fd, LONGEST_TEXT).decode(errors="replace").strip("\0 \t\r\n")  # some end with \n\0: LNX-68
    finally:
        os.close(fd)


def _text(path: Path) -> str:
    """Return the text of an attribute; "" if it can't be read."""
    try:
        return _read(path)
    except OSError:
        return ""


def _name_file(error: OSError, path: Path) -> OSError:
    """Return the same error with the name of its file."""
    return OSError(error.errno, error.strerror or str(error), str(path))


class IioBus:
    """The bus ``iio:`` of an array whose sensors are devices of the kernel; others name an I2C bus or a chip select.

    `root` is the folder that has `sys` and `dev`; BusUrlError if it has not.
    """

    source = "iio"

    def __init__(self, root: Path = Path("/"), *, clock: Clock | None = None) -> None:
        if not (root / "sys").is_dir():
            raise BusUrlError(f"iio:{root}: it contains no folder sys; use iio: alone for the devices of this machine")
        self.clock: Clock = MonotonicClock() if clock is None else clock
        self._root = root
        self._devices: dict[str, IioDevice] = {}
        self._wired = SpiBus(clock=self.clock)

    def iio_device(self, wanted: str) -> IioDevice:
        """Return the device that `wanted` names, made once; it need not exist yet."""
        return self._devices.setdefault(wanted, IioDevice(wanted, self._root))

    def devices(self) -> list[IioDevice]:
        """Return all devices that the kernel serves now."""
        return devices(self._root)

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Raise OSError (ENXIO): there is no I2C bus at the root."""
        _refuse()

    def spi_port(self, path: str, mode: int, clock_hz: int) -> SpiPort:
        """Return the chip select at `path`, opened once."""
        return self._wired.spi_port(path, mode, clock_hz)

    def channel_bus(self, path: str) -> Bus:
        """Return the I2C adapter at `path`, opened once."""
        return self._wired.channel_bus(path)

    def claim(self, address: int, path: str | None = None) -> None:
        """Claim an address as `LinuxBus.claim`."""
        self._wired.claim(address, path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        for device in self._devices.values():
            device.release()
        self._wired.__exit__(*error)


def _refuse() -> NoReturn:
    raise OSError(errno.ENXIO, "iio: has no I2C bus of its own")
