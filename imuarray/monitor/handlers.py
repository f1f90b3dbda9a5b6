"""The HTTP handlers of the page: the page, its parts, the log's snapshot, the figures."""

from __future__ import annotations

import json
from collections.abc import Awaitable
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from bokeh.util.paths import bokehjs_path
from tornado.escape import url_escape
from tornado.template import Template
from tornado.web import Application, HTTPError, RequestHandler

from imuarray.monitor.access import HEADERS, refusal
from imuarray.monitor.shared_snapshots import SharedSnapshots

_PARTS = {"page.css": "text/css; charset=utf-8", "page.js": "text/javascript; charset=utf-8"}
_BOKEH = "bokeh.min.js"


class _CheckedHandler(RequestHandler):
    """GET and HEAD, for whom the page is. A subclass has `get`; of its answer to HEAD, Tornado sends the headers."""

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
        given = self.get_query_argument("token", "") or ""
        why = refusal(self.token, given, self.request.host, dict(self.request.headers.get_all()))
        if why is not None:
            raise HTTPError(403, reason=why)

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code} {self._reason}\n")


class _Page(_CheckedHandler):
    def get(self) -> None:
        query = f"?token={url_escape(self.token)}" if self.token else ""
        template = Template(self.parts.joinpath("page.html").read_text(encoding="utf-8"), autoescape="xhtml_escape")
        self.finish(template.generate(query=query, every_ms=round(self.snapshots.every_s * 1e3)))


class _Part(_CheckedHandler):
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
    """The server's answers; every request needs `token`, if there is one. `parts` holds the page."""
    shared = {"snapshots": snapshots, "token": token, "parts": parts}
    names = "|".join((*_PARTS, _BOKEH)).replace(".", r"\.")
    return Application(
        [
            (r"/", _Page, shared),
            (rf"/({names})", _Part, shared),
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
