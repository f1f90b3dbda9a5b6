"""A recording as a service: notifies systemd when it has begun, while rows reach the disk, and when it ends.

The protocol is one datagram of `NAME=value` lines to the socket in `NOTIFY_SOCKET` (sd_notify(3)); without that
variable nothing is sent. Only stored rows feed the watchdog: a recording that runs but stores nothing is restarted.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Mapping

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
        given = os.environ if environment is None else environment
        self._address = _address(given.get("NOTIFY_SOCKET", ""))
        self._watchdog_ns = _watchdog_ns(given, os.getpid() if process is None else process)
        self._now_ns = now_ns
        self._rows = 0
        self._fed_ns = self._told_ns = -(1 << 62)
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
        if self._watchdog_ns is not None and now_ns - self._fed_ns >= self._watchdog_ns * _SHARE:
            words.append("WATCHDOG=1")
        if not self._ready or now_ns - self._told_ns >= _STATUS_NS:
            words.append(f"STATUS=recording, {rows} rows stored")
            self._told_ns = now_ns
        self._rows, self._ready = rows, True
        if "WATCHDOG=1" in words:
            self._fed_ns = now_ns
        self._send(words)

    def stopping(self, status: str = "finishing the log") -> None:
        """Note that the recording has ended and its log is being finished: TimeoutStopSec= counts from now on, and the
        watchdog no longer applies.
        """
        self._send(["STOPPING=1", f"STATUS={' '.join(status.split())}"])

    def _send(self, words: list[str]) -> None:
        """Send one datagram; whether it is received does not matter here."""
        if self._address is None or not words:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
                out.setblocking(False)
                out.sendto("\n".join(words).encode(), self._address)
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
    allowed, whose = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", str(process))
    if not (allowed.isascii() and allowed.isdigit() and int(allowed)) or whose != str(process):
        return None
    return int(allowed) * 1000
