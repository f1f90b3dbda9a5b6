"""A real browser without a window, driven through Chrome's DevTools protocol."""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import subprocess
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

PATIENCE_S = 120
"""How long a page may take: on a busy machine a browser draws nothing for half a minute."""


class Browser:
    """One page of it."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self._number = 0
        self.said: list[str] = []
        """What the page wrote to its console, and exceptions."""

    async def call(self, method: str, **parameters: Any) -> Any:
        """A call of the protocol, answered."""
        self._number += 1
        await self._socket.write_message(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(await asyncio.wait_for(self._socket.read_message(), 120))
            self._heard(answer)
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]

    def _heard(self, answer: dict[str, Any]) -> None:
        if answer.get("method") in ("Runtime.exceptionThrown", "Log.entryAdded"):
            self.said.append(json.dumps(answer["params"]))
        if answer.get("method") == "Runtime.consoleAPICalled" and answer["params"]["type"] in ("error", "warning"):
            said = json.dumps(answer["params"]["args"])
            if "signal timed out" not in said:  # a request on a machine that is busy, which the page repeats
                self.said.append(said)

    async def value(self, expression: str) -> Any:
        """What JavaScript says."""
        answer = await self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    async def until(self, expression: str) -> Any:
        """Wait until JavaScript says something true, and what."""
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            if found := await self.value(expression):
                return found
            await asyncio.sleep(0.1)
        raise AssertionError(f"never came: {expression}; the page says {await self.value('document.body.innerText')}")

    async def screen(self, width: int, height: int, *, dark: bool = False) -> None:
        """The size and the colours that a person has."""
        await self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        await self.call("Emulation.setEmulatedMedia", features=scheme)

    async def screenshot(self) -> bytes:
        """What is to be seen, as PNG."""
        return base64.b64decode((await self.call("Page.captureScreenshot", format="png"))["data"])


@asynccontextmanager
async def browser(folder: Path, address: str) -> AsyncIterator[Browser]:
    """Chromium with `address` open, its profile in `folder`."""
    from tornado.httpclient import AsyncHTTPClient
    from tornado.websocket import websocket_connect

    assert CHROMIUM is not None
    quiet = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run")
    options = (*quiet, f"--user-data-dir={folder}", "--remote-debugging-port=0", "about:blank")
    process = subprocess.Popen([CHROMIUM, *options], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        port_file = folder / "DevToolsActivePort"
        end_s = time.monotonic() + PATIENCE_S
        while not (port_file.exists() and port_file.read_text().count("\n")):
            assert time.monotonic() < end_s, "the browser did not start"
            await asyncio.sleep(0.1)
        port = int(port_file.read_text().split()[0])
        pages = json.loads((await AsyncHTTPClient().fetch(f"http://127.0.0.1:{port}/json/list")).body)
        page = next(one for one in pages if one["type"] == "page")
        socket = await websocket_connect(page["webSocketDebuggerUrl"], max_message_size=1 << 26)
        try:
            found = Browser(socket)
            for domain in ("Page", "Runtime", "Log"):
                await found.call(f"{domain}.enable")
            await found.call("Page.navigate", url=address)
            yield found
        finally:
            socket.close()
            while await socket.read_message() is not None:
                pass
    finally:
        process.terminate()
        process.wait(60)
