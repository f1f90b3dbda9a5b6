"""Emulated adapters at paths such as /dev/i2c-1, for code of this process that knows nothing of an emulator.

::

    with device_files({"/dev/i2c-1": Adapter(wire)}):
        SMBus(1).read_byte_data(0x53, 0x00)

Inside the block `os.open` leads those paths to a real, empty file that stands for the adapter, and `fcntl.ioctl` on it,
also where a module has imported it by name, is the adapter's. Closing and flock are the real ones. The read() and
write() of i2c-dev are not served.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from firmware_emulator.adapter import Adapter, OpenFile

Identity = tuple[int, int]


@contextmanager
def device_files(adapters: Mapping[str, Adapter]) -> Iterator[None]:
    """Serve `adapters` by path to everything that runs in this process inside the block."""
    real_ioctl, real_open = fcntl.ioctl, os.open

    def ioctl(fd: Any, request: int, arg: Any = 0, mutate_flag: bool = True, /) -> Any:
        file = served.file(fd if isinstance(fd, int) else fd.fileno())
        if file is None:
            return real_ioctl(fd, request, arg, mutate_flag)
        return with_address(arg, lambda argument: file.ioctl(request, argument))

    def opened(path: Any, *args: Any, **keywords: Any) -> int:
        return served.opened(real_open(served.stand_in(path), *args, **keywords))

    with tempfile.TemporaryDirectory() as folder:
        served = _DeviceFolder(adapters, Path(folder))
        replace_everywhere("ioctl", real_ioctl, ioctl)
        replace_everywhere("open", real_open, opened)
        try:
            yield
        finally:
            replace_everywhere("open", opened, real_open)
            replace_everywhere("ioctl", ioctl, real_ioctl)


def replace_everywhere(name: str, old: object, new: object) -> None:
    """Let every module that knows `old` by `name` know `new`."""
    for module in list(sys.modules.values()):
        if getattr(module, "__dict__", {}).get(name) is old:
            setattr(module, name, new)


class _DeviceFolder:
    """The adapters of one block: which file stands for which, and what has been opened."""

    def __init__(self, adapters: Mapping[str, Adapter], folder: Path) -> None:
        self._stand_ins: dict[str, Path] = {}
        self._adapters: dict[Identity, Adapter] = {}
        self._open_files: dict[int, OpenFile] = {}
        for path, adapter in adapters.items():
            stand_in = folder / path.replace("/", "_")
            stand_in.touch()
            self._stand_ins[path] = stand_in
            self._adapters[identity(stand_in.stat())] = adapter

    def stand_in(self, path: Any) -> Any:
        """The file that stands for `path`; `path` itself when it is not ours."""
        return self._stand_ins.get(os.fspath(path), path) if isinstance(path, str | os.PathLike) else path

    def opened(self, number: int) -> int:
        """A descriptor has been opened: whatever was set on the one of this number before is forgotten."""
        self._open_files.pop(number, None)
        return number

    def file(self, number: int) -> OpenFile | None:
        """The opened adapter behind a descriptor; None when another file is."""
        adapter = self._adapters.get(identity(os.fstat(number)))
        if adapter is None:
            return None
        return self._open_files.setdefault(number, adapter.open())


def identity(status: os.stat_result) -> Identity:
    """Return the identity of a file: device and inode."""
    return status.st_dev, status.st_ino


def with_address(argument: Any, call: Callable[[int], int]) -> Any:
    """`call` with a Python argument as `fcntl.ioctl` hands it on: a number as it is, a buffer by its address, of
    immutable bytes a copy, which is then the result.
    """
    if isinstance(argument, int):
        return call(argument)
    if isinstance(argument, bytes):
        copy = ctypes.create_string_buffer(argument, len(argument))
        call(ctypes.addressof(copy))
        return copy.raw
    memory = (ctypes.c_char * memoryview(argument).nbytes).from_buffer(argument)
    return call(ctypes.addressof(memory))
