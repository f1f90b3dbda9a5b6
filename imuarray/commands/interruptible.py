"""Signals that end a recording cleanly."""

from __future__ import annotations

import signal
from typing import Any

_HANG_UP: int | None = getattr(signal, "SIGHUP", None)  # Windows has none


class Interruptible:
    """SIGINT, SIGTERM and SIGHUP (the terminal is gone) end a log cleanly instead of breaking it off; a SIGHUP that is
    ignored (nohup) stays so. A context manager; `asked` whether one came, `hung_up` whether it was SIGHUP.
    """

    def __init__(self) -> None:
        self.asked = self.hung_up = False
        self._before: dict[int, Any] = {}

    def _ask(self, number: int, frame: Any) -> None:
        self.asked = True
        self.hung_up |= number == _HANG_UP

    def __enter__(self) -> Interruptible:
        for number in (signal.SIGINT, signal.SIGTERM, _HANG_UP):
            if number is None or (number == _HANG_UP and signal.getsignal(number) == signal.SIG_IGN):
                continue
            self._before[number] = signal.signal(number, self._ask)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
