"""Errors that `imuarray` raises on purpose, in one tree.

::

    ImuArrayError                 a message of one line; the exit code of the command line is 2
    +-- ConfigError               an invalid TOML file: states the file, the key and the allowed values
    +-- BusUrlError               a URL of an unknown bus, or a bus that can't be opened here
    +-- SensorError               a chip that is missing, wrong, or does not keep what was written to it
    +-- LogError                  a log that is missing, foreign, truncated, malicious or malformed
    |   +-- LogBusyError          a log that another process is writing
    |   +-- DiskFullError         no space left: the log was ended and contains all acknowledged rows; exit code 3
    +-- SourceError               a foreign recording that `import` can't read: states the file and the row
    +-- CalibrationError          data that do not determine the parameters, or an invalid calibration file
    +-- FusionError               a technique that has too few sensors or data in this log
    +-- ExportError               an unknown format or unit of an export: states the known ones
    +-- OutputExistsError         a file that would be overwritten (`--force` allows it)
    +-- OutputError               a file that can't be written; exit code 3 if the disk is full
    +-- MissingExtraError         an optional package that a command needs is not installed

A log that is read although a part of it is damaged or lost gives a `LogWarning`. A bus raises `OSError` with the errno
of Linux: 6 (ENXIO) or 121 (EREMOTEIO) for an address that no chip acknowledges, 110 (ETIMEDOUT) for a clock that is
held low too long (LNX-40 ... LNX-49).
"""

from __future__ import annotations

import errno
import os
import re
from os import PathLike

NOT_ACKNOWLEDGED = frozenset({errno.ENXIO, errno.EREMOTEIO})
"""The two errnos of Linux adapters for a missing acknowledge (LNX-40, LNX-41)."""

NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""The errors of a write when space is exhausted: the disk, the user's quota, the file size limit."""


_HDF5_ERRNO = re.compile(r"errno = (\d+)")


def errno_of(error: Exception) -> int:
    """Return the errno of a system error, 0 if none is known; HDF5 states it within a longer message."""
    if isinstance(error, OSError) and error.errno:
        return error.errno
    match = _HDF5_ERRNO.search(str(error))
    return int(match[1]) if match else 0


def reason_of(error: Exception) -> str:
    """Return the system's error message in one line."""
    number = errno_of(error)
    return os.strerror(number) if number else " ".join(str(error).split())


class ImuArrayError(Exception):
    """Root of the tree; its text is one line that states the place, the invalid value and the allowed values."""

    exit_code = 2
    """Exit code of the command line."""


class ConfigError(ImuArrayError):
    """An invalid configuration: unknown key, impossible range, two sensors in one place, mirrored axes."""


class BusUrlError(ImuArrayError):
    """A bus URL that names no known bus, or a bus that can't be opened on this machine."""


class SensorError(ImuArrayError):
    """A chip that does not answer, has another identity, or does not keep its configuration."""


class LogError(ImuArrayError):
    """A log file that is missing, not a log, truncated, malformed, or malicious."""


class LogBusyError(LogError):
    """A log that another process is writing or recovering."""

    def __init__(self, path: str | PathLike[str]) -> None:
        super().__init__(f"{path}: is being written by another process; wait until it ends, or choose another name")


NOTHING_RECORDED = "nothing was recorded; free space or choose another disk"
"""The usual end of a DiskFullError."""


class DiskFullError(LogError):
    """The disk is full, or nearly full, and nothing more can be written; a log that was begun keeps its acknowledged
    rows.
    """

    exit_code = 3

    def __init__(
        self,
        path: str | PathLike[str],
        why: str,
        kept: str = NOTHING_RECORDED,
    ) -> None:
        """`kept` states what was saved before the error."""
        self.path, self.why, self.kept = path, why, kept
        super().__init__(f"{path}: {why}; {kept}")


class LogWarning(UserWarning):
    """A log was opened that is incomplete: rows are lost, or texts have changed. The message states which."""


class SourceError(ImuArrayError):
    """A foreign recording that can't be imported; names the file and the row or byte."""


class CalibrationError(ImuArrayError):
    """A log that is not suitable for a calibration, or a calibration file that does not fit."""


class FusionError(ImuArrayError):
    """A fusion technique that this array or this log has too few sensors or data for."""


class ExportError(ImuArrayError):
    """An export that is not possible: an unknown suffix, or units that the file can't be converted to."""


class OutputExistsError(ImuArrayError):
    """An output that already exists; nothing is overwritten without `--force`."""

    def __init__(self, path: str | PathLike[str]) -> None:
        super().__init__(f"{path}: exists already; choose another name or use --force")


class OutputError(ImuArrayError):
    """An output that can't be written, with the reason from the system; no partial file is left. A `remark` states
    which other files are missing.
    """

    def __init__(self, path: str | PathLike[str], error: Exception, remark: str = "") -> None:
        super().__init__(f"{path}: can't be written: {reason_of(error)}{f'; {remark}' if remark else ''}")
        self.path, self.error = path, error
        self.exit_code = 3 if errno_of(error) in NO_ROOM else 2


class MissingExtraError(ImuArrayError):
    """An optional package is not installed; the message names the extra that installs it."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"this needs {package}, which is not installed: pip install 'imuarray[{extra}]'")
