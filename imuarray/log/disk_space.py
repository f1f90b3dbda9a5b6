"""Disk space, allocated before it is needed because HDF5 does not survive a write that fails.

A write to a full disk leaves HDF5 with a file that it can't close, and ends the process in a segmentation fault. The
space for what HDF5 will write is therefore allocated first (`Allowance`), a log ends while some space remains
(`WATERMARK`), and a reserve file is released for the last steps if the disk becomes full nevertheless.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from imuarray.errors import NO_ROOM, DiskFullError, LogError, errno_of, reason_of

if sys.platform != "win32":
    import resource

_NO_SPACE: Mapping[int, str] = {
    errno.EDQUOT: "no space left: the quota of the user is used up",
    errno.EFBIG: "no space left: the limit on the length of a file is reached",
}

WATERMARK = 64 << 20
"""Free bytes below which a log that is being recorded ends."""

RESERVE = 1 << 20
"""Bytes of the reserve file."""

_STEP = 1 << 16
_LOOK_STEP = 1 << 20
_NOT_SUPPORTED = frozenset({errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS, errno.ENODEV})


def free_bytes(path: Path) -> int:
    """Return the number of bytes that can still be written in the folder of `path`."""
    room = os.statvfs(path.parent)
    return room.f_bavail * room.f_frsize


def unwritable(path: Path, error: Exception, *kept: str) -> LogError:
    """Return the error for `path` that fits an error of the system or of HDF5: DiskFullError if there is no space
    (`kept` says what remains), else LogError.
    """
    number = errno_of(error)
    if number in NO_ROOM:
        return DiskFullError(path, _NO_SPACE.get(number, "no space left on the disk"), *kept)
    return LogError(f"{path}: can't be written: {reason_of(error)}")


@contextlib.contextmanager
def write_errors(path: Path, *kept: str) -> Iterator[None]:
    """Convert errors of a write inside the context into the error of `path` (`unwritable`)."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # HDF5 uses both
        raise unwritable(path, error, *kept) from None


def longest_file() -> int | None:
    """Return the limit on the length of a file that this process may write, in bytes (RLIMIT_FSIZE), or None."""
    if sys.platform == "win32":
        return None
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    return None if limit == resource.RLIM_INFINITY else limit


def _allocate(fd: int, start: int, length: int) -> None:
    """Allocate disk space for a stretch of a file; OSError."""
    if not hasattr(os, "posix_fallocate"):  # macOS
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    os.posix_fallocate(fd, start, length)


class Allowance:
    """The disk space for one HDF5 file, allocated beyond its end; call `reserve` before every write."""

    def __init__(self, path: Path, name: Path, *, allocate: bool = True) -> None:
        """Open the file at `path`, called `name` in errors; without `allocate`, free space is only checked."""
        self._path, self._name = path, name
        self._step = _STEP if allocate else _LOOK_STEP
        self._allocates = allocate
        self.fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        self._used = self._allocated = os.fstat(self.fd).st_size

    def reserve(self, size: int) -> None:
        """Reserve space for `size` more bytes of data and what HDF5 adds; DiskFullError if there is none."""
        self._used += size + size // 64
        if self._used <= self._allocated:
            return
        required = self._used + self._step
        if self._allocates:
            try:
                _allocate(self.fd, self._allocated, required - self._allocated)
            except OSError as error:
                if error.errno not in _NOT_SUPPORTED:
                    raise unwritable(self._name, error) from None
                self._allocates = False
        limit = longest_file()
        if limit is not None and self._used > limit:
            raise unwritable(self._name, OSError(errno.EFBIG, ""))
        if not self._allocates and free_bytes(self._path) < required - self._allocated + RESERVE:
            raise unwritable(self._name, OSError(errno.ENOSPC, ""))
        self._allocated = required

    def sync(self) -> None:
        """Wait until everything written is on the disk; LogError."""
        try:
            os.fsync(self.fd)
        except OSError as error:
            raise unwritable(self._name, error) from None

    def settle(self) -> None:
        """Replace the requested size by the size that the written data really took: compressed data take less."""
        self._used = min(self._used, self._end() or self._used)

    def trim(self) -> None:
        """Release the space that a closed file does not use."""
        end = self._end()
        if end is not None and end < os.fstat(self.fd).st_size:
            os.ftruncate(self.fd, end)

    def _end(self) -> int | None:
        """Return the end of the file as its superblock states it (HDF5 file format, version 3: 64 bits at byte
        28).
        """
        head = os.pread(self.fd, 36, 0)
        return int.from_bytes(head[28:36], "little") if len(head) == 36 and head[8] == 3 and head[9] == 8 else None

    def close(self) -> None:
        """Close the file."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


class Reserve:
    """A file that only occupies space, which is released when it is needed."""

    def __init__(self, path: Path) -> None:
        self.path = reserve_of(path)
        fd = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            _allocate(fd, 0, RESERVE)
        except OSError as error:
            if error.errno not in _NOT_SUPPORTED:
                self.release()
                raise unwritable(path, error) from None
        finally:
            os.close(fd)

    def release(self) -> None:
        """Free the reserved space."""
        self.path.unlink(missing_ok=True)


def reserve_of(path: Path) -> Path:
    """Return the path of the reserve file of the log at `path`."""
    return path.with_name(f".{path.name}.reserve")


def sync_folder(path: Path) -> None:
    """Wait until the names in the folder of `path` are on the disk."""
    with contextlib.suppress(OSError):  # some file systems cannot sync a folder
        fd = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)
