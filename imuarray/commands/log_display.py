"""Display of a running recording: events and progress on the terminal, and a live page.

A separate process of low priority serves the page and ends with this one. Its modules are not imported here, because
that would delay the start of the recording.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imuarray.commands.options import terminal_columns
from imuarray.errors import MissingExtraError
from imuarray.printable import printable

if TYPE_CHECKING:
    from imuarray.acquire import RecordingCounts
    from imuarray.log.format import Event

_PAUSE_S = 0.5
"""Time between two updates of the progress line."""
_CLEAR = "\r\x1b[K"


class LogScreen:
    """Events and progress on standard error. A terminal that is closed does not disturb the recording."""

    def __init__(
        self, label: str, rate_hz: float, seconds: float | None, status: Callable[[], str] = lambda: ""
    ) -> None:
        """Begin; `status` returns a text to append to the progress line."""
        self._status = status
        self._label, self._rate_hz, self._seconds = label, rate_hz, seconds
        self._terminal = sys.stderr.isatty()
        self._counted_s = -_PAUSE_S
        self._line = ""

    def event(self, event: Event) -> None:
        """Print an event: seconds of the log, sensor, kind, message."""
        text = " ".join(word for word in (event.sensor, f"{event.kind}:", event.message) if word)
        self._write(f"{self._clear()}{event.time_ns * 1e-9:9.1f} s  {printable(text)}\n{self._line}")

    def remark(self, text: str) -> None:
        """Print a remark of the program."""
        self._write(f"{self._clear()}imuarray: {printable(text)}\n{self._line}")

    def counted(self, summary: RecordingCounts) -> None:
        """Update the progress line, at most twice a second and only on a terminal."""
        now_s = time.monotonic()
        if not self._terminal or now_s - self._counted_s < _PAUSE_S:
            return
        self._counted_s = now_s
        whole = "" if self._seconds is None else f" of {self._seconds:g}"
        lasted_s = (summary.frames + summary.missed) / self._rate_hz
        lost_readings = sum(summary.lost.values())
        self._line = (
            f"{printable(self._label)}: {summary.frames} frames, {lasted_s:.0f}{whole} s, {lost_readings} readings lost"
        )
        if status := self._status():
            self._line += f"; {printable(status)}"
        self._line = self._line[: terminal_columns()]
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


_PATIENCE_S = 8.0
"""Longest time to wait for the page's process, which serves an open page for three seconds after the end."""
_NICENESS = 10


def _print(text: str) -> None:
    with suppress(OSError, ValueError):
        print(f"imuarray: {text}", file=sys.stderr, flush=True)


@contextmanager
def serve_page(run: Path, arguments: Mapping[str, object], report: Callable[[str], None] = _print) -> Iterator[None]:
    """Serve the page of the log at `run`, which need not exist yet, in a separate process.

    `arguments` are options of `imuarray monitor` by name; None values are omitted. `report` receives the address of the
    page, or why there is none, from another thread. An open page is served for a moment after the end, so that it shows
    how the log ended. A failure of the page does not affect the recording. MissingExtraError without Bokeh.
    """
    if find_spec("bokeh") is None:
        raise MissingExtraError("bokeh", "monitor")
    program = [sys.executable, "-m", "imuarray", "monitor", str(run), "--parent", str(os.getpid())]
    for option, value in arguments.items():
        program += [option, str(value)] if value is not None else []
    process = subprocess.Popen(
        program,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,  # so that Ctrl-C reaches only the logger
    )
    _lower_priority(process.pid)
    reporting = threading.Thread(target=_report_lines, args=(process.stdout, report), name="page", daemon=True)
    reporting.start()
    try:
        yield
    finally:
        _end(process)
        reporting.join(1.0)
        if process.stdout is not None and not reporting.is_alive():
            process.stdout.close()


def _lower_priority(process: int) -> None:
    if hasattr(os, "setpriority"):  # Windows has none
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, process, os.getpriority(os.PRIO_PROCESS, 0) + _NICENESS)


def _report_lines(lines: Iterable[str] | None, report: Callable[[str], None]) -> None:
    """Report the output of the page's process: the address of the page, or why there is none."""
    for line in lines or ():
        text = line.strip()
        report(f"watch it at {text}" if text.startswith("http://") else f"no page: {text.removeprefix('imuarray: ')}")


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        with suppress(subprocess.TimeoutExpired):
            process.wait(1.0)
