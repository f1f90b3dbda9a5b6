"""The page's server, on Tornado: it reads the log only when a client asks, and at most once per interval.

The page polls (it needs no lasting connection, so that none can be lost); several pages share a snapshot. Nothing is
written.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from imuarray.calibrate import Calibration
from imuarray.errors import ImuArrayError, MissingExtraError
from imuarray.monitor.access import is_own, new_token
from imuarray.monitor.log_monitor import LogMonitor
from imuarray.monitor.shared_snapshots import SharedSnapshots

PORT = 8765
NICENESS = 10
"""Added to this process's: at equal demand the logger gets ten times as much of a processor."""
LINGER_S = 3.0
"""How long a page that is looked at is served on when the server is asked to end: it learns how the log ended."""

_STEP_S = 0.2


@dataclass(frozen=True)
class PageOptions:
    """The options of the page's server.

    `host` and `port` (0: any free one) to listen on; `token` that a request must contain (None: a new one, unless only
    this machine can reach `host`). `calibration` and `result` as of `LogMonitor`. The log is read at most once in
    `every_s`; `announce` receives the address of the page; the server ends with the process `parent`.
    """

    host: str = "127.0.0.1"
    port: int = PORT
    token: str | None = None
    calibration: Calibration | None = None
    result: Path | None = None
    every_s: float = 1.0
    announce: Callable[[str], None] = print
    parent: int | None = None


def serve(path: Path, options: PageOptions) -> None:
    """Serve the page of the log at `path` until SIGINT, SIGTERM or the end of `options.parent`, at low priority.

    MissingExtraError without Bokeh, ImuArrayError if the address can't be served.
    """
    try:
        import bokeh  # noqa: F401  # reports at once what is missing, not at the first figure
        import tornado.web  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "bokeh", "monitor") from None
    token = "" if is_own(options.host) else (options.token or new_token())
    listening = _socket(options.host, options.port)
    if options.parent is None:  # else it did that already
        step_back()
    asyncio.run(_serve(path, listening, token, options))


def step_back() -> None:
    """Lower the priority of this process: recording comes first."""
    if hasattr(os, "nice"):  # Windows has none
        with contextlib.suppress(OSError):
            os.nice(NICENESS)


def _socket(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host.strip("[]"), port), family=family)
    except OSError as error:
        why = os.strerror(error.errno) if error.errno and error.errno > 0 else error.strerror
        raise ImuArrayError(
            f"{host}:{port}: can't serve the page there: {why}; choose another --port or --host"
        ) from None
    listening.setblocking(False)
    return listening


async def _serve(path: Path, listening: socket.socket, token: str, options: PageOptions) -> None:
    from tornado.httpserver import HTTPServer

    from imuarray.monitor.handlers import application

    monitor = LogMonitor(path, calibration=options.calibration, result=options.result)
    snapshots = SharedSnapshots(monitor, options.every_s)
    server = HTTPServer(
        application(snapshots, token, files("imuarray.monitor")), max_body_size=1 << 10, max_header_size=1 << 14
    )
    server.add_socket(listening)
    options.announce(address_of(options.host, listening.getsockname()[1], token))
    try:
        await _until_asked_to_end(snapshots, options.parent)
    finally:
        server.stop()
        snapshots.close()


def address_of(host: str, port: int, token: str) -> str:
    """Return the URL of the page."""
    anywhere = host in ("0.0.0.0", "::", "")  # noqa: S104  # compared, not bound
    bare = host.strip("[]")
    name = socket.gethostname() if anywhere else (f"[{bare}]" if ":" in bare else bare)
    return f"http://{name}:{port}/" + (f"?token={token}" if token else "")


async def _until_asked_to_end(snapshots: SharedSnapshots, parent: int | None) -> None:
    """Ctrl-C ends it at once; where a page was looking a moment ago, SIGTERM and the end of `parent` a little later."""
    at_once, soon = asyncio.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()
    with contextlib.suppress(NotImplementedError):  # Windows: Ctrl-C ends it, with KeyboardInterrupt
        loop.add_signal_handler(signal.SIGINT, at_once.set)
        loop.add_signal_handler(signal.SIGTERM, soon.set)
    while not (at_once.is_set() or soon.is_set() or (parent is not None and os.getppid() != parent)):
        await asyncio.sleep(_STEP_S)
    end_s = time.monotonic() + LINGER_S
    watched = time.monotonic() - snapshots.asked_s < LINGER_S
    while watched and not at_once.is_set() and time.monotonic() < end_s:
        await asyncio.sleep(_STEP_S)
