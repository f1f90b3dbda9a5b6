"""A machine as the doctor sees it: a file tree, a user, and what only a living kernel can tell.

Everything is below a root folder, so that a machine can be made up for a test.
"""

from __future__ import annotations

import fcntl
import os
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

I2C_FUNCS = 0x0705  # LNX-03


class Check(NamedTuple):
    """What was looked at, whether it is well, what was found, and what to do if it isn't."""

    name: str
    ok: bool
    found: str
    advice: str = ""


def functionality(device: Path) -> int | None:
    """The bits with which an adapter says what it can (LNX-30); None if it can't be asked."""
    try:
        fd = os.open(device, os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        answer = fcntl.ioctl(fd, I2C_FUNCS, bytes(struct.calcsize("L")))
        return int(struct.unpack("L", answer)[0])
    except OSError:
        return None
    finally:
        os.close(fd)


def free_bytes(folder: Path) -> int:
    """Bytes that may still be written there; OSError."""
    room = os.statvfs(folder)
    return room.f_bavail * room.f_frsize


@dataclass(frozen=True)
class Machine:
    """What is asked of a machine: its file tree, who asks, and what only a living kernel can tell."""

    root: Path = Path("/")
    user: int = field(default_factory=os.getuid)
    groups: frozenset[int] = field(default_factory=lambda: frozenset((*os.getgroups(), os.getgid())))
    functionality: Callable[[Path], int | None] = functionality
    free_bytes: Callable[[Path], int] = free_bytes

    def path(self, absolute: str) -> Path:
        """Where something of this machine is."""
        return self.root / absolute.lstrip("/")

    def text(self, absolute: str) -> str:
        """The line in a file of the kernel's; "" if there is none."""
        try:
            return self.path(absolute).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return ""


def permission(machine: Machine, device: str) -> Check:
    """May this user read and write a device file that is there?"""
    try:
        about = machine.path(device).stat()
    except OSError as error:
        return Check("permission", False, f"{device}: {error.strerror}", "look at the folders above it")
    shift = 6 if about.st_uid == machine.user else 3 if about.st_gid in machine.groups else 0
    group = _group(machine, about.st_gid)
    found = f"{device}: group {group}, mode {about.st_mode & 0o777:04o}"
    if machine.user == 0 or about.st_mode >> shift & 0o6 == 0o6:
        return Check("permission", True, found)
    if about.st_mode & 0o060 == 0o060 and about.st_gid:
        return Check("permission", False, found, f"sudo adduser $USER {group}, then log in again")
    advice = 'sudo groupadd --system i2c; a udev rule: KERNEL=="i2c-[0-9]*", GROUP="i2c", MODE="0660"'
    return Check("permission", False, found, advice)


def _group(machine: Machine, number: int) -> str:
    """A group's name, by the machine's own list."""
    for line in machine.text("/etc/group").splitlines():
        name, _, rest = line.partition(":")
        if rest.split(":")[1:2] == [str(number)]:
            return name
    return str(number)
