"""The identity of a device in sysfs, independent of the number that the kernel gives it.

/dev/i2c-3 and /dev/ttyACM0 are numbers in the order of appearance (LNX-02): an adapter that was unplugged and plugged
in again may have another one, and another adapter may have the old one. What does not change is the USB device (vendor,
product, serial number), the port that it is plugged into and its interface; of a built-in adapter the place of its
parent device; of a channel that the kernel drives the multiplexer's address, the channel and the adapter in front of
it (LNX-21).

While a descriptor of an I2C adapter is open the kernel can't finish its removal (`i2c_del_adapter` waits for the last
reference), and the USB port stays blocked. The adapter's entry in sysfs is removed before that wait, so the removal is
detected there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

I2C_DEVICES = Path("/sys/bus/i2c/devices")
"""Folder in which the kernel lists I2C adapters and their devices (LNX-21)."""
TTY_DEVICES = Path("/sys/class/tty")
"""Folder in which the kernel lists serial ports."""
DEVICE_FILES = Path("/dev")
_ADAPTER = re.compile(r"i2c-(\d+)")
_NUMBER = re.compile(r"\b\d+\b")


@dataclass(frozen=True)
class BusIdentity:
    """`device` is the description of the device itself, `part` its adapter or port, `place` the port into which it is
    plugged ("" for a built-in device).
    """

    device: str
    part: str
    place: str = ""

    @property
    def text(self) -> str:
        """The text for messages: "USB 0403:c631 serial A1 at port 1-1.2, interface 1.0"."""
        return f"{self.device}{f' at port {self.place}' if self.place else ''}{f', {self.part}' if self.part else ''}"

    def elsewhere(self, other: BusIdentity) -> bool:
        """Return whether the other could be this device, plugged into another port."""
        return (self.device, self.part) == (other.device, other.part)


@dataclass(frozen=True)
class Entry:
    """The entry of one device file in sysfs: its name, its `mark` (inode), which no later entry of that name has, and
    its identity.
    """

    name: str
    mark: int
    identity: BusIdentity


def adapters(devices: Path = I2C_DEVICES) -> dict[str, Entry]:
    """Return every I2C adapter of this machine by the name of its device file ("i2c-1"); empty without sysfs."""
    names = sorted((path.name for path in _list_folder(devices) if _ADAPTER.fullmatch(path.name)), key=_number)
    entries = {}
    for name in names:
        entry = adapter_entry(devices, name)
        if entry is not None:
            entries[name] = entry
    return entries


def adapter_entry(devices: Path, name: str) -> Entry | None:
    """Return the entry of one adapter; None if the kernel has none of that name."""
    mark = mark_of(devices, name)
    identity = _adapter_identity(devices, name)
    return None if mark is None or identity is None else Entry(name, mark, identity)


def ports(devices: Path = TTY_DEVICES) -> dict[str, Entry]:
    """Return every serial port with a device, by the name of its device file ("ttyACM0")."""
    entries = {}
    for path in sorted(_list_folder(devices)):
        mark = mark_of(devices, path.name)
        try:
            real = (path / "device").resolve(strict=True)
        except (OSError, RuntimeError):
            continue
        usb = _usb_device(real)
        if mark is not None and usb is not None:
            entries[path.name] = Entry(path.name, mark, _usb_identity(usb, real, ""))
    return entries


def mark_of(devices: Path, name: str) -> int | None:
    """Return the inode of an entry; None if the device was removed. OSError for any other failure, which does not mean
    a removal.
    """
    try:
        return (devices / name).stat().st_ino
    except (FileNotFoundError, NotADirectoryError):
        return None


def search(wanted: BusIdentity, listed: Mapping[str, Entry], known: Mapping[str, int], *, alone: bool) -> str | None:
    """Return the name under which a removed device has reappeared; None if it has not.

    `known` are names and marks of the entries that existed without it. A device at another port is accepted only if no
    other device of its kind was present (`alone`), and if exactly one has appeared: two can't be distinguished.
    """
    new = [entry for entry in listed.values() if known.get(entry.name) != entry.mark]
    for entry in new:
        if entry.identity == wanted:
            return entry.name
    moved = [entry.name for entry in new if entry.identity.elsewhere(wanted)]
    return moved[0] if alone and len(moved) == 1 else None


def is_alone(wanted: BusIdentity, listed: Mapping[str, Entry]) -> bool:
    """Return whether no other device among those listed has the same description."""
    return not any(entry.identity != wanted and entry.identity.elsewhere(wanted) for entry in listed.values())


def _list_folder(devices: Path) -> list[Path]:
    try:
        return list(devices.iterdir())
    except OSError:
        return []


def _number(name: str) -> int:
    return int(name.rpartition("-")[2])


def _adapter_identity(devices: Path, name: str) -> BusIdentity | None:
    try:
        real = (devices / name).resolve(strict=True)
    except (OSError, RuntimeError):
        return None
    title = _text(real / "name")
    mux = real / "mux_device"
    if mux.is_symlink():
        return _channel_identity(devices, real, mux)
    usb = _usb_device(real)
    if usb is not None:
        return _usb_identity(usb, real, _NUMBER.sub("#", title))  # names contain the USB device's number
    return BusIdentity(f"{title or 'adapter'} of {real.parent.name}", str(real.parent))


def _channel_identity(devices: Path, real: Path, mux: Path) -> BusIdentity | None:
    """Return the identity of a channel of a kernel-driven multiplexer: `mux` leads to a device such as 1-0070."""
    try:
        device = mux.resolve(strict=True)
    except (OSError, RuntimeError):
        return None
    number, _, address = device.name.partition("-")
    before = _adapter_identity(devices, f"i2c-{number}")
    if before is None:
        return None
    channels = [
        link.name for link in _list_folder(device) if link.name.startswith("channel-") and link.resolve() == real
    ]
    part = f"multiplexer {address} {channels[0] if channels else real.name}"
    return replace(before, part=f"{before.part}, {part}" if before.part else part)


def _usb_device(real: Path) -> Path | None:
    """Return the folder of the USB device that `real` belongs to."""
    return next((folder for folder in real.parents if (folder / "idVendor").is_file()), None)


def _usb_identity(usb: Path, real: Path, title: str) -> BusIdentity:
    """Return the identity of `real`, the folder of an adapter or port, or of its device, below the USB device's.

    Interfaces are named PORT:CONFIGURATION.INTERFACE (the kernel's USB documentation, sysfs); several adapters of one
    interface are distinguished by their order.
    """
    serial = _text(usb / "serial")
    device = f"USB {_text(usb / 'idVendor')}:{_text(usb / 'idProduct')}" + (f" serial {serial}" if serial else "")
    below = real.relative_to(usb).parts
    interface = below[0].partition(":")[2] if below else ""
    parts = [f"interface {interface}"] if interface else []
    if title:
        parts.insert(0, title)
        siblings = [path.name for path in _list_folder(real.parent) if _ADAPTER.fullmatch(path.name)]
        order = sorted(siblings, key=_number).index(real.name) if real.name in siblings else 0
        parts += [f"adapter {order}"] if order else []
    return BusIdentity(device, ", ".join(parts), usb.name)


def _text(path: Path) -> str:
    """Return the line of a file; empty if there is none."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
