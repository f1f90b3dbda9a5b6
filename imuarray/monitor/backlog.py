"""Delayed and missed rows from before a monitor looked, counted a piece at a time: a long log makes no look longer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from imuarray.errors import LogError
from imuarray.log.untrusted_input import DAMAGE
from imuarray.monitor.window import STRIDE, Gaps, gaps_of

AT_ONCE = 1 << 19
"""Rows that are read at one look."""


class Backlog:
    """The first rows of time columns by sensor: (column, rows). `close` is called once all of them are counted."""

    def __init__(self, columns: Mapping[str, tuple[Any, int]], close: Callable[[], None] = lambda: None) -> None:
        self._columns = dict(columns)
        self._total = sum(rows for _, rows in columns.values())
        self._done = dict.fromkeys(columns, 0)
        self._gaps = dict.fromkeys(columns, Gaps())
        self._close: Callable[[], None] | None = close

    @property
    def counted(self) -> float:
        """The share of its rows that were counted."""
        return sum(self._done.values()) / self._total if self._total else 1.0

    def gaps(self, name: str) -> Gaps:
        """Of a sensor, as far as they were counted."""
        return self._gaps.get(name, Gaps())

    def step(self, periods_ns: Mapping[str, float]) -> None:
        """Count some more rows; what can't be read is passed over, and a sensor of which no period is known."""
        left = AT_ONCE
        for name, (column, rows) in self._columns.items():
            start = self._done[name]
            stop = min(rows, start + left)
            if stop > start:
                self._gaps[name] += _counted(column, start, stop, periods_ns.get(name, 0.0))
                self._done[name] = stop
                left -= stop - start
        if self.counted == 1.0:
            self.close()

    def close(self) -> None:
        """Let go of the columns."""
        if self._close is not None:
            self._close()
        self._columns, self._close = {}, None


def _counted(column: Any, start: int, stop: int, period_ns: float) -> Gaps:
    """Gaps that begin in rows `start` to `stop`."""
    try:
        return gaps_of(np.asarray(column[start : min(stop + STRIDE, len(column))]), period_ns)
    except (LogError, *DAMAGE):
        return Gaps()
