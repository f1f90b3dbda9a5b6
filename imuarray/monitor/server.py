"""The page's server and its HTTP handlers, on Tornado: it reads the log only when a client asks, and at most once per
interval. Importing this module raises MissingExtraError without Bokeh or Tornado.

The page polls, so that no permanent connection can be lost; several pages share a snapshot. Nothing is written.

Clients on this machine, or with the token, have access. Requests that a browser sends for another page are refused.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import ipaddress
import json
import os
import secrets
import signal
import socket
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from imuarray.calibrate import Calibration
from imuarray.errors import ImuArrayError, MissingExtraError
from imuarray.monitor.log_monitor import LogMonitor, SharedSnapshots, lower_priority

try:
    from bokeh.util.paths import bokehjs_path
    from tornado.escape import url_escape
    from tornado.template import Template
    from tornado.web import Application, HTTPError, RequestHandler
except ModuleNotFoundError as error:
    raise MissingExtraError(error.name or "bokeh", "monitor") from None

HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:;"
        " connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Headers of every response. 'unsafe-inline' is allowed for styles, because Bokeh adds styles to the page."""

_OWN_SITE = frozenset({"", "none", "same-origin"})
_TOKEN_BYTES = 24


def is_own(host: str) -> bool:
    """Return whether only this machine can reach an address."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def new_token() -> str:
    """Return a new secret token that fits into a URL."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def refusal(token: str, request_token: str, host: str, headers: Mapping[str, str]) -> str | None:
    """Return why a request is refused; None if it is not. `token` is "" for a page that only this machine can reach;
    then the requested `host` must be a name of this machine, as a protection against DNS rebinding.
    """
    if headers.get("Sec-Fetch-Site", "") not in _OWN_SITE:
        return "requested by another page"
    origin = headers.get("Origin")
    if origin is not None and origin.split("://")[-1] != host:
        return "requested by another page"
    if token:
        given_right = hmac.compare_digest(request_token.encode(), token.encode())
        return None if given_right else "the token is missing or wrong: use the address that imuarray printed"
    name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
    return None if is_own(name) else "requested under another host name: use http://127.0.0.1"


_PARTS = {"page.css": "text/css; charset=utf-8", "page.js": "text/javascript; charset=utf-8"}
_BOKEH = "bokeh.min.js"


class _CheckedHandler(RequestHandler):
    """Handles GET and HEAD of permitted clients. A subclass has `get`; for HEAD, Tornado sends only its headers."""

    SUPPORTED_METHODS = ("GET", "HEAD")

    def head(self, *names: str) -> Awaitable[None] | None:
        answer: Awaitable[None] | None = self.get(*names)
        return answer

    def initialize(self, snapshots: SharedSnapshots, token: str, parts: Traversable) -> None:
        self.snapshots, self.token, self.parts = snapshots, token, parts

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)
        self.clear_header("Server")

    def prepare(self) -> None:
        request_token = self.get_query_argument("token", "") or ""
        reason = refusal(self.token, request_token, self.request.host, dict(self.request.headers.get_all()))
        if reason is not None:
            raise HTTPError(403, reason=reason)

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code} {self._reason}\n")


class _Page(_CheckedHandler):
    def get(self) -> None:
        query = f"?token={url_escape(self.token)}" if self.token else ""
        template = Template(self.parts.joinpath("page.html").read_text(encoding="utf-8"), autoescape="xhtml_escape")
        self.finish(template.generate(query=query, every_ms=round(self.snapshots.every_s * 1e3)))


class _PageFile(_CheckedHandler):
    def get(self, name: str) -> None:
        if name == _BOKEH:
            content, kind = (Path(bokehjs_path()) / "js" / _BOKEH).read_bytes(), _PARTS["page.js"]
            self.set_header("Cache-Control", "private, max-age=86400")
        else:
            content, kind = self.parts.joinpath(name).read_bytes(), _PARTS[name]
        self.set_header("Content-Type", kind)
        self.finish(content)


class _Snapshot(_CheckedHandler):
    async def get(self) -> None:
        self.set_header("Content-Type", "application/json")
        self.finish(await self.snapshots.text())


class _Figures(_CheckedHandler):
    async def get(self) -> None:
        figures = await self.snapshots.figures(self.get_query_argument("theme", "light") or "light")
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps(figures))


def application(snapshots: SharedSnapshots, token: str, parts: Traversable) -> Application:
    """Return the server's answers; every request needs `token`, if there is one. `parts` holds the page."""
    shared = {"snapshots": snapshots, "token": token, "parts": parts}
    names = "|".join((*_PARTS, _BOKEH)).replace(".", r"\.")
    return Application(
        [
            (r"/", _Page, shared),
            (rf"/({names})", _PageFile, shared),
            (r"/snapshot\.json", _Snapshot, shared),
            (r"/figures\.json", _Figures, shared),
        ],
        default_handler_class=_MissingPage,
        default_handler_args=shared,
        compress_response=True,
        log_function=lambda handler: None,
    )


class _MissingPage(_CheckedHandler):
    def prepare(self) -> None:
        super().prepare()
        raise HTTPError(404)


PORT = 8765
LINGER_S = 3.0
"""Time in s for which an open page is still served after a request to end, so that it shows how the log ended."""

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

    ImuArrayError if the address can't be served.
    """
    token = "" if is_own(options.host) else (options.token or new_token())
    listening = _socket(options.host, options.port)
    if options.parent is None:  # a parent has lowered the priority already
        lower_priority()
    asyncio.run(_serve(path, listening, token, options))


def _socket(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host.strip("[]"), port), family=family)
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno and error.errno > 0 else error.strerror
        raise ImuArrayError(
            f"{host}:{port}: can't serve the page there: {reason}; choose another --port or --host"
        ) from None
    listening.setblocking(False)
    return listening


async def _serve(path: Path, listening: socket.socket, token: str, options: PageOptions) -> None:
    from tornado.httpserver import HTTPServer

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
    """Wait for Ctrl-C, SIGTERM or the end of `parent`; after the last two, `LINGER_S` longer if a page is open."""
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
