"""The options of a recording, and its summary: counts of what happened while the log was recorded.

`Service` notifies systemd when a recording has begun, while rows reach the disk, and when it ends. The protocol is one
datagram of `NAME=value` lines to the socket in `NOTIFY_SOCKET` (sd_notify(3)); without that variable nothing is sent.
Only stored rows feed the watchdog: a recording that runs but stores nothing is restarted.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from imuarray.acquire.sensor_health import Judge
from imuarray.clock import Clock, is_virtual
from imuarray.log.format import Event, Phase, SensorHeader
from imuarray.log.writer import Block

_SHARE = 0.5
"""Interval of notifications as a share of the watchdog's time (sd_watchdog_enabled(3) recommends to notify every half
of it).
"""
_STATUS_NS = 10_000_000_000


class Service:
    """Messages to the service manager; `environment` is that of the process, `now_ns` a clock that never steps."""

    def __init__(
        self,
        environment: Mapping[str, str] | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
        process: int | None = None,
    ) -> None:
        variables = os.environ if environment is None else environment
        self._address = _address(variables.get("NOTIFY_SOCKET", ""))
        self._watchdog_ns = _watchdog_ns(variables, os.getpid() if process is None else process)
        self._now_ns = now_ns
        self._rows = 0
        self._watchdog_sent_ns = self._status_sent_ns = -(1 << 62)
        self._ready = False

    def stored(self, rows: int) -> None:
        """Note the number of stored rows of all sensors: the first rows send READY=1, later ones WATCHDOG=1 as often as
        needed.
        """
        if self._address is None or rows <= self._rows:
            return
        now_ns, words = self._now_ns(), []
        if not self._ready:
            words.append("READY=1")
        if self._watchdog_ns is not None and now_ns - self._watchdog_sent_ns >= self._watchdog_ns * _SHARE:
            words.append("WATCHDOG=1")
        if not self._ready or now_ns - self._status_sent_ns >= _STATUS_NS:
            words.append(f"STATUS=recording, {rows} rows stored")
            self._status_sent_ns = now_ns
        self._rows, self._ready = rows, True
        if "WATCHDOG=1" in words:
            self._watchdog_sent_ns = now_ns
        self._send(words)

    def stopping(self, status: str = "finishing the log") -> None:
        """Note that the recording has ended and its log is being finished: TimeoutStopSec= counts, the watchdog no
        longer does.
        """
        self._send(["STOPPING=1", f"STATUS={' '.join(status.split())}"])

    def _send(self, words: list[str]) -> None:
        """Send one datagram; errors are ignored."""
        if self._address is None or not words:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as connection:
                connection.setblocking(False)
                connection.sendto("\n".join(words).encode(), self._address)
        except OSError:
            return


def _address(name: str) -> str | bytes | None:
    """Return the address of a socket from its path, or of an abstract one ("@..."); None for an empty address and for
    sockets that aren't local.
    """
    if name.startswith("@") and len(name) > 1:
        return b"\0" + os.fsencode(name[1:])
    return name if name.startswith("/") else None


def _watchdog_ns(environment: Mapping[str, str], process: int) -> int | None:
    """Return the time without a message after which this process is killed; None without a watchdog."""
    interval_us, owner = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", str(process))
    if not (interval_us.isascii() and interval_us.isdigit() and int(interval_us)) or owner != str(process):
        return None
    return int(interval_us) * 1000


BATCH_S = 1.0
"""Time in s between two writes: rows that are not written are lost if the machine stops."""
VIRTUAL_BATCH_S = 5.0
"""Time in s between two writes of a recording on a virtual clock, such as that of the emulated array. It is longer,
because a write takes as long for few rows as for many.
"""


@dataclass
class RecordingCounts:
    """Counts of what happened while a log was recorded."""

    frames: int = 0
    late: int = 0
    """Frames that began after their time."""
    missed: int = 0
    """Frames that were skipped because the frame before ended after their time, up to the requested end."""
    missed_by_bus: int = 0
    """Number of missed frames before which a transaction on the bus timed out."""
    uncertain: int = 0
    """Readings whose time is uncertain by a millisecond or more, because the machine was busy."""
    lost: dict[str, int] = field(default_factory=dict)
    """Readings that did not arrive, by sensor."""
    silent: list[str] = field(default_factory=list)
    """Sensors that returned no readings any more when the recording ended."""
    refused: int = 0
    """Frames of a serial link that were rejected: old, repeated, out of order or of an earlier boot."""
    seconds: float = 0.0
    """Duration in s: frames and missed frames, one period each (`imuarray.log.missed_frames`)."""
    logs: list[Path] = field(default_factory=list)
    """The files in the order of their time: one, unless the log was split into parts."""


@dataclass(frozen=True)
class RecordingOptions:
    """The options of a recording, and the callbacks that follow it."""

    rate_hz: float
    """Frames per second; a frame reads every sensor once."""
    seconds: float | None = None
    """Duration in s; None: until `stopped` returns True."""
    phase: str = ""
    """Name of the whole log ("static", "z_up", ...)."""
    up: str = ""
    """The box axis that points up in `phase` ("+Z", ...)."""
    phases: Sequence[Phase] = ()
    """Names of parts of the log, in times of the bus's clock."""
    rotate_s: float | None = None
    """Length in s of the parts into which the log is split; each part is a log (`imuarray.log.rotate`)."""
    batch_s: float | None = None
    """Time in s between two writes, on the bus's clock; None: `write_interval_s` decides."""
    wall_time: datetime | None = None
    """UTC time of the start; None: that of the transcript being replayed, else the wall clock, read once."""
    force: bool = False
    """Overwrite the log if it exists."""
    judge: Judge | None = None
    """Determines how sensors started; a sensor in a wrong state is flagged and configured again."""
    service: Service | None = None
    """The service manager to notify; None: the one that started this process, if any."""
    stopped: Callable[[], bool] = lambda: False
    """Polled between frames; True ends the recording."""
    progress: Callable[[int], None] = lambda frames: None
    """Receives the number of frames, after every write."""
    on_block: Callable[[str, Block], None] = lambda sensor, block: None
    """Receives every block of a sensor's rows as it is written."""
    on_event: Callable[[Event], None] = lambda event: None
    """Receives every event."""
    on_counts: Callable[[RecordingCounts], None] = lambda summary: None
    """Receives the summary so far, after every write."""
    on_headers: Callable[[str, Sequence[SensorHeader]], None] = lambda epoch, sensors: None
    """Receives the log's epoch and sensor headers before the log is created; an exception ends the recording."""
    on_first_frame: Callable[[int], None] = lambda time_ns: None
    """Receives the time of the first frame, if the log is split into parts."""

    def write_interval_s(self, clock: Clock) -> float:
        """Return the time in s between two writes of a recording on this clock: `batch_s`, or else a longer one on a
        virtual clock unless `on_block` follows the rows.
        """
        if self.batch_s is not None:
            return self.batch_s
        is_followed = self.on_block is not RecordingOptions.on_block
        return VIRTUAL_BATCH_S if is_virtual(clock) and not is_followed else BATCH_S
