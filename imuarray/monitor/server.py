"""The page's server, on Tornado: it looks at the log only when somebody asks, and no more often than once in a while.

The page asks again and again (it needs no connection that lasts, so that there is none to lose); several pages share a
look. Nothing is written anywhere.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

from imuarray.calibrate import Calibration
from imuarray.errors import ImuArrayError, MissingExtraError
from imuarray.monitor.figures import THEMES, Kind, figures
from imuarray.monitor.guard import is_own, new_token
from imuarray.monitor.payload import drawn
from imuarray.monitor.priority import step_back
from imuarray.monitor.snapshot import Snapshot
from imuarray.monitor.watch import SPAN_S, Watch
from imuarray.units import READABLE, READABLE_SI

PORT = 8765
LINGER_S = 3.0
"""How long a page that is looked at is served on when the server is asked to end: it learns how the log ended."""

_STEP_S = 0.2
_XYZ = ("x", "y", "z")


class Looks:
    """Looks at one log, shared by all who ask; they are made in a thread of their own, one at a time."""

    def __init__(self, watch: Watch, every_s: float) -> None:
        self.every_s = every_s
        self._watch = watch
        self._thread = ThreadPoolExecutor(1, "look")
        self._lock = asyncio.Lock()
        self._snapshot: Snapshot | None = None
        self._text = b"{}"
        self._is_closed = False
        self._looked_s = self.asked_s = float("-inf")

    async def text(self) -> bytes:
        """The last look as JSON, or a new one if that is old and there are more looks."""
        self.asked_s = time.monotonic()
        async with self._lock:
            if not self._is_closed and time.monotonic() - self._looked_s > 0.8 * self.every_s:
                self._looked_s = time.monotonic()
                await asyncio.get_running_loop().run_in_executor(self._thread, self._look)
        return self._text

    def _look(self) -> None:
        self._snapshot = self._watch.refresh(time.monotonic())
        self._text = json.dumps(drawn(self._snapshot), allow_nan=False, separators=(",", ":")).encode()

    async def figures(self, theme: str) -> dict[str, Any]:
        """The figures that this log needs."""
        await self.text()
        views = self._snapshot.sensors if self._snapshot else ()
        shown = {(view.columns, view.unit) for view in views}
        kinds = {Kind("trace", *one) for one in shown}
        kinds |= {
            Kind("density", _XYZ, READABLE.get(unit, (1.0, unit))[1]) for columns, unit in shown if columns == _XYZ
        }
        kinds |= {Kind("trace", _XYZ, unit) for _, unit in READABLE_SI.values()}
        make = partial(figures, sorted(kinds), theme if theme in THEMES else "light", SPAN_S)
        if self._is_closed:
            return make()
        return await asyncio.get_running_loop().run_in_executor(self._thread, make)

    def close(self) -> None:
        """No more looks: who still asks gets the last one."""
        self._is_closed = True
        self._thread.shutdown()
        self._watch.close()


def serve(
    path: Path,
    *,
    host: str = "127.0.0.1",
    port: int = PORT,
    token: str | None = None,
    calibration: Calibration | None = None,
    result: Path | None = None,
    every_s: float = 1.0,
    announce: Callable[[str], None] = print,
    parent: int | None = None,
) -> None:
    """Serve the page of the log at `path` until SIGINT, SIGTERM or the end of the process `parent`; lowers this
    process's priority. `announce` is told the address, with a new token in it (None) unless only this machine can reach
    it. `result` as of `Watch`. MissingExtraError without Bokeh, ImuArrayError if nothing can be served there.
    """
    try:
        import bokeh  # noqa: F401  # says at once what is missing, not at the first figure
        import tornado.web  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "bokeh", "monitor") from None
    wanted = "" if is_own(host) else (token or new_token())
    listening = _socket(host, port)
    if parent is None:  # else it did that already
        step_back()
    watch = Watch(path, calibration=calibration, result=result)
    asyncio.run(_serve(listening, watch, every_s, wanted, host, announce, parent))


def _socket(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        found = socket.create_server((host.strip("[]"), port), family=family)
    except OSError as error:
        why = os.strerror(error.errno) if error.errno and error.errno > 0 else error.strerror
        raise ImuArrayError(f"{host}:{port}: can't serve there: {why}; choose another --port or --host") from None
    found.setblocking(False)
    return found


async def _serve(
    listening: socket.socket,
    watch: Watch,
    every_s: float,
    token: str,
    host: str,
    announce: Callable[[str], None],
    parent: int | None,
) -> None:
    from tornado.httpserver import HTTPServer

    from imuarray.monitor.handlers import application

    looks = Looks(watch, every_s)
    server = HTTPServer(
        application(looks, token, files("imuarray.monitor")), max_body_size=1 << 10, max_header_size=1 << 14
    )
    server.add_socket(listening)
    announce(address_of(host, listening.getsockname()[1], token))
    try:
        await _until_asked_to_end(looks, parent)
    finally:
        server.stop()
        looks.close()


def address_of(host: str, port: int, token: str) -> str:
    """What to open in a browser."""
    anywhere = host in ("0.0.0.0", "::", "")  # noqa: S104  # compared, not bound
    bare = host.strip("[]")
    name = socket.gethostname() if anywhere else (f"[{bare}]" if ":" in bare else bare)
    return f"http://{name}:{port}/" + (f"?token={token}" if token else "")


async def _until_asked_to_end(looks: Looks, parent: int | None) -> None:
    """Ctrl-C ends it at once; where a page was looking a moment ago, SIGTERM and the end of `parent` a little later."""
    at_once, soon = asyncio.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()
    with contextlib.suppress(NotImplementedError):  # Windows: Ctrl-C ends it, with KeyboardInterrupt
        loop.add_signal_handler(signal.SIGINT, at_once.set)
        loop.add_signal_handler(signal.SIGTERM, soon.set)
    while not (at_once.is_set() or soon.is_set() or (parent is not None and os.getppid() != parent)):
        await asyncio.sleep(_STEP_S)
    end_s = time.monotonic() + LINGER_S
    watched = time.monotonic() - looks.asked_s < LINGER_S
    while watched and not at_once.is_set() and time.monotonic() < end_s:
        await asyncio.sleep(_STEP_S)
