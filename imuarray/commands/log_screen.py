"""The screen of a running recording: every event, and on a terminal the progress."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from imuarray.printable import printable

if TYPE_CHECKING:
    from imuarray.acquire import Summary
    from imuarray.log.format import Event

_PAUSE_S = 0.5
"""Between two counter lines."""
_CLEAR = "\r\x1b[K"


class LogScreen:
    """Standard error. A terminal that goes away (ssh drops) does not disturb the recording."""

    def __init__(self, label: str, rate_hz: float, seconds: float | None, more: Callable[[], str] = lambda: "") -> None:
        """`more` returns a text to append to the progress line."""
        self._more = more
        self._label, self._rate_hz, self._seconds = label, rate_hz, seconds
        self._terminal = sys.stderr.isatty()
        self._counted_s = -_PAUSE_S
        self._line = ""

    def event(self, event: Event) -> None:
        """One line: seconds of the log, sensor, kind, message."""
        about = " ".join(word for word in (event.sensor, f"{event.kind}:", event.message) if word)
        self._write(f"{self._clear()}{event.time_ns * 1e-9:9.1f} s  {printable(about)}\n{self._line}")

    def remark(self, text: str) -> None:
        """A line about something else than the log."""
        self._write(f"{self._clear()}imuarray: {printable(text)}\n{self._line}")

    def counted(self, summary: Summary) -> None:
        """Show the progress now and then in a line that is written over; only on a terminal."""
        now_s = time.monotonic()
        if not self._terminal or now_s - self._counted_s < _PAUSE_S:
            return
        self._counted_s = now_s
        whole = "" if self._seconds is None else f" of {self._seconds:g}"
        lasted_s = (summary.frames + summary.missed) / self._rate_hz
        lost = sum(summary.lost.values())
        self._line = f"{printable(self._label)}: {summary.frames} frames, {lasted_s:.0f}{whole} s, {lost} readings lost"
        if more := self._more():
            self._line += f"; {printable(more)}"
        self._write(_CLEAR + self._line)

    def close(self) -> None:
        """Remove the progress line."""
        if self._line:
            self._write(_CLEAR)
        self._line = ""

    def _clear(self) -> str:
        return _CLEAR if self._line else ""

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            click.echo(text, err=True, nl=False, color=self._terminal or None)
