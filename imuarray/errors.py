"""Errors that `imuarray` raises on purpose, in one tree.

::

    ImuArrayError                 one line for a person; the command line turns it into its exit code (2)
    +-- ConfigError               a TOML file says something impossible: names the file, the key, what is allowed
    +-- BusUrlError               a bus URL that names no bus, or one that can't be opened here
    +-- SensorError               a chip that is missing, wrong, or does not keep what was written to it
    +-- LogError                  a log that is missing, foreign, truncated, hostile or malformed
    |   +-- LogBusyError          a log that is being written by somebody else
    |   +-- DiskFullError         no space left: the log was ended and contains all acknowledged rows; exit code 3
    +-- SourceError               a foreign recording that `import` can't read: names the file and the row
    +-- CalibrationError          data from which the wanted parameters can't be had, or a bad calibration file
    +-- FusionError               a technique that this array or this log can't feed
    +-- ExportError               an export into a format or in units that there are none of: names those that there are
    +-- OutputExistsError         a file that would be overwritten (`--force` allows it)
    +-- OutputError               a file that can't be written; exit code 3 if the disk is full
    +-- MissingExtraError         an optional package that a command needs is not installed

A log that is read although something in it is damaged or lost gives a `LogWarning`.

A bus itself speaks `OSError` with the errno that Linux would give: 6 (ENXIO) or 121 (EREMOTEIO) for an address that
nobody acknowledges, 110 (ETIMEDOUT) for a clock held too long (LNX-40 ... LNX-49).
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
    """Return the errno of what the system said, 0 if none is known; HDF5 tells it in the middle of a paragraph."""
    if isinstance(error, OSError) and error.errno:
        return error.errno
    match = _HDF5_ERRNO.search(str(error))
    return int(match[1]) if match else 0


def reason_of(error: Exception) -> str:
    """Return the system's error message in one line."""
    number = errno_of(error)
    return os.strerror(number) if number else " ".join(str(error).split())


class ImuArrayError(Exception):
    """Root of the tree; its text is one line that names the place, what came and what is allowed."""

    exit_code = 2
    """Exit code of the command line."""


class ConfigError(ImuArrayError):
    """A configuration that can't be meant: unknown key, impossible range, two sensors in one place, mirrored axes."""


class BusUrlError(ImuArrayError):
    """A bus URL that names no known bus, or a bus that can't be opened on this machine."""


class SensorError(ImuArrayError):
    """A chip that does not answer, has another identity, or does not keep its configuration."""


class LogError(ImuArrayError):
    """A log file that is missing, not a log, truncated, malformed, or built to do harm."""


class LogBusyError(LogError):
    """A log that another process is writing or recovering."""

    def __init__(self, path: str | PathLike[str]) -> None:
        super().__init__(f"{path}: is being written by another process; wait until it ends, or choose another name")


class DiskFullError(LogError):
    """The disk is full, or nearly so: nothing more can be written; of a log that was begun, what was acknowledged is
    kept.
    """

    exit_code = 3

    def __init__(
        self,
        path: str | PathLike[str],
        why: str,
        kept: str = "nothing was recorded; free space or choose another disk",
    ) -> None:
        """`kept` says what there is all the same."""
        self.path, self.why, self.kept = path, why, kept
        super().__init__(f"{path}: {why}; {kept}")


class LogWarning(UserWarning):
    """A log was opened that is incomplete: rows are lost, or texts have changed. The message says which."""


class SourceError(ImuArrayError):
    """A foreign recording that can't be imported; names the file and the row or byte."""


class CalibrationError(ImuArrayError):
    """A log that can't be calibrated from, or a calibration file that does not fit."""


class FusionError(ImuArrayError):
    """A technique that this array or this log can't feed."""


class ExportError(ImuArrayError):
    """An export that can't be: a suffix that no format has, units that a file can't be given in."""


class OutputExistsError(ImuArrayError):
    """An output that exists already; nothing is overwritten unless `--force` says so."""

    def __init__(self, path: str | PathLike[str]) -> None:
        super().__init__(f"{path}: exists already; choose another name or use --force")


class OutputError(ImuArrayError):
    """An output that can't be written, for what the system said; nothing is left of it."""

    def __init__(self, path: str | PathLike[str], error: Exception) -> None:
        super().__init__(f"{path}: can't be written: {reason_of(error)}")
        self.exit_code = 3 if errno_of(error) in NO_ROOM else 2


class MissingExtraError(ImuArrayError):
    """An optional package is not installed; names the extra that brings it."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"this needs {package}, which is not installed: pip install 'imuarray[{extra}]'")
