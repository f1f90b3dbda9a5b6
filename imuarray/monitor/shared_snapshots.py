"""Snapshots of a log for all pages that ask: taken on request, at most one per interval, and shared."""

from __future__ import annotations

import asyncio
import json
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from imuarray.monitor.figures import THEMES, FigureKind, figures
from imuarray.monitor.log_monitor import SPAN_S, LogMonitor
from imuarray.monitor.payload import drawn
from imuarray.monitor.snapshot import Snapshot
from imuarray.units import READABLE, READABLE_SI

_XYZ = ("x", "y", "z")


class SharedSnapshots:
    """Snapshots of one log, shared by all clients; taken in a thread of their own, one at a time."""

    def __init__(self, monitor: LogMonitor, every_s: float) -> None:
        self.every_s = every_s
        self._monitor = monitor
        self._thread = ThreadPoolExecutor(1, "snapshot")
        self._lock = asyncio.Lock()
        self._snapshot: Snapshot | None = None
        self._text = b"{}"
        self._is_closed = False
        self._refreshed_s = self.asked_s = float("-inf")

    async def text(self) -> bytes:
        """The last snapshot as JSON; a new one if it is older than `every_s` and this is not closed."""
        self.asked_s = time.monotonic()
        async with self._lock:
            if not self._is_closed and time.monotonic() - self._refreshed_s > 0.8 * self.every_s:
                self._refreshed_s = time.monotonic()
                await asyncio.get_running_loop().run_in_executor(self._thread, self._refresh)
        return self._text

    def _refresh(self) -> None:
        self._snapshot = self._monitor.refresh(time.monotonic())
        self._text = json.dumps(drawn(self._snapshot), allow_nan=False, separators=(",", ":")).encode()

    async def figures(self, theme: str) -> dict[str, Any]:
        """The figures that this log needs."""
        await self.text()
        views = self._snapshot.sensors if self._snapshot else ()
        shown = {(view.columns, view.unit) for view in views}
        kinds = {FigureKind("trace", columns, unit) for columns, unit in shown}
        kinds |= {
            FigureKind("density", _XYZ, READABLE.get(unit, (1.0, unit))[1])
            for columns, unit in shown
            if columns == _XYZ
        }
        kinds |= {FigureKind("trace", _XYZ, unit) for _, unit in READABLE_SI.values()}
        make = partial(figures, sorted(kinds), theme if theme in THEMES else "light", SPAN_S)
        if self._is_closed:
            return make()
        return await asyncio.get_running_loop().run_in_executor(self._thread, make)

    def close(self) -> None:
        """Take no more snapshots: further requests get the last one."""
        self._is_closed = True
        self._thread.shutdown()
        self._monitor.close()
