"""`monitor --text` on a terminal: what was there is written over, in one piece, so that nothing flickers."""

from __future__ import annotations

import shutil
import signal
import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

import click

_HOME, _REST_OF_LINE, _REST_OF_SCREEN = "\x1b[H", "\x1b[K", "\x1b[J"
_NAP_S = 0.1


class MonitorScreen:
    """Standard output; a context manager, which notices when the terminal changes its size."""

    def __init__(self) -> None:
        self.is_terminal = sys.stdout.isatty()
        self.resized = False
        self._before: Any = None

    @property
    def columns(self) -> int:
        """The columns of a line: the last one stays free, as some terminals wrap otherwise."""
        return shutil.get_terminal_size().columns - 1 if self.is_terminal else 80

    def show(self, lines: Sequence[str]) -> None:
        """Print over the previous output of a terminal, as many lines as fit."""
        if not self.is_terminal:
            click.echo("\n".join(lines))
            return
        room = shutil.get_terminal_size()
        shown = [line[: room.columns - 1] + _REST_OF_LINE + "\n" for line in lines[: room.lines - 1]]
        click.echo(_HOME + "".join(shown) + _REST_OF_SCREEN, nl=False, color=True)

    def rest(self, seconds: float) -> None:
        """Wait; no longer than until the size changes."""
        end_s = time.monotonic() + seconds
        while not self.resized and (left_s := end_s - time.monotonic()) > 0:
            time.sleep(min(_NAP_S, left_s))
        self.resized = False

    def __enter__(self) -> Self:
        if self.is_terminal and hasattr(signal, "SIGWINCH"):
            self._before = signal.signal(signal.SIGWINCH, self._resize)
        return self

    def _resize(self, number: int, frame: Any) -> None:
        self.resized = True

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._before is not None:
            signal.signal(signal.SIGWINCH, self._before)
