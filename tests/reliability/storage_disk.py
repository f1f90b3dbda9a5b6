"""A disk made of the calls that changed it: its content after any of them, and after a power cut.

The page model is cruder than a real file system and no kinder: of a file, each 4 KiB page that changed since its last
sync is the old or the new one, at random, and its length is the old or the new one; of the folder, the first so many of
the changes since its last sync are kept. Synced data are kept.
"""

from __future__ import annotations

import random
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

PAGE = 4096
_HEAD = struct.Struct("<cQqQ")


class Call(NamedTuple):
    """One call: c create, t set length, w write, s sync, r rename, u unlink."""

    kind: str
    inode: int
    offset: int
    data: bytes


def read_calls(path: Path) -> list[Call]:
    """All recorded calls."""
    content, calls, at = path.read_bytes(), [], 0
    while at < len(content):
        kind, inode, offset, length = _HEAD.unpack_from(content, at)
        at += _HEAD.size
        calls.append(Call(kind.decode(), inode, offset, content[at : at + length]))
        at += length
    return calls


@dataclass
class File:
    """The content of a file for a process, and its synchronised content."""

    now: bytearray = field(default_factory=bytearray)
    synced: bytes = b""
    touched: set[int] = field(default_factory=set)
    """Pages that changed since the last sync."""

    def write(self, offset: int, data: bytes) -> None:
        if len(self.now) < offset + len(data):
            self.resize(offset + len(data))
        self.now[offset : offset + len(data)] = data
        self.touched.update(range(offset // PAGE, (offset + len(data) - 1) // PAGE + 1))

    def resize(self, length: int) -> None:
        if length < len(self.now):
            del self.now[length:]
        else:
            self.now.extend(bytes(length - len(self.now)))

    def sync(self) -> None:
        self.synced = bytes(self.now)
        self.touched.clear()

    def after_power_cut(self, draw: random.Random) -> bytes:
        length = draw.choice((len(self.synced), len(self.now)))
        content = bytearray(self.synced[:length])
        content.extend(bytes(length - len(content)))
        for page in sorted(self.touched):
            if draw.random() < 0.5:
                piece = self.now[page * PAGE : (page + 1) * PAGE][: max(0, length - page * PAGE)]
                content[page * PAGE : page * PAGE + len(piece)] = piece
        return bytes(content)


class Disk:
    """A folder and its files, as calls change them."""

    def __init__(self) -> None:
        self.folder: dict[str, File] = {}
        self.synced_folder: dict[str, File] = {}
        self.unsynced: list[tuple[str, File | None]] = []
        """Names given (or taken away: None) since the folder's last sync."""
        self._by_inode: dict[int, File] = {}

    def apply(self, call: Call) -> None:
        """One call more."""
        if call.kind == "c":
            name = Path(call.data.decode()).name
            if name not in self.folder:
                self._by_inode[call.inode] = File()
                self._name(name, self._by_inode[call.inode])
            elif call.offset:
                self.folder[name].resize(0)
        elif call.kind == "r":
            old, new = (Path(name).name for name in call.data.decode().split("\0"))
            self._name(new, self.folder[old])
            self._name(old, None)
        elif call.kind == "u":
            self._name(Path(call.data.decode().split("\0")[0]).name, None)
        elif call.kind == "s" and call.inode not in self._by_inode:
            self.synced_folder, self.unsynced = dict(self.folder), []
        else:
            file = self._by_inode[call.inode]
            if call.kind == "w":
                file.write(call.offset, call.data)
            elif call.kind == "t":
                file.resize(call.offset)
            else:
                file.sync()

    def _name(self, name: str, file: File | None) -> None:
        self.unsynced.append((name, file))
        if file is None:
            self.folder.pop(name, None)
        else:
            self.folder[name] = file

    def now(self) -> dict[str, bytes]:
        """The content of every file, as after a kill."""
        return {name: bytes(file.now) for name, file in self.folder.items()}

    def after_power_cut(self, draw: random.Random) -> dict[str, bytes]:
        """One possible content after a power cut."""
        folder = dict(self.synced_folder)
        for name, file in self.unsynced[: draw.randint(0, len(self.unsynced))]:
            if file is None:
                folder.pop(name, None)
            else:
                folder[name] = file
        return {name: file.after_power_cut(draw) for name, file in folder.items()}
