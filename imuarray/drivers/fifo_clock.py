"""Estimates when the samples of a chip's queue were taken, from their numbers and the times of counting.

A chip samples by its own oscillator, some percent off (BMA-107 states 10 % for one of them), and keeps no time. But
each count of the queue says something: if it holds `level` samples at `at_ns`, the newest of them is at most one period
old. The period is estimated from all samples since the start; predictions are pulled into the window that each count
allows, so that the error of a time stays within one period for ever and no rate error adds up.
"""

from __future__ import annotations

TOLERANCE = 0.15
"""How far a chip's oscillator may be off its nominal rate."""


class FifoClock:
    """Times of consecutive samples of one chip of nominal rate `rate_hz`.

    `drained` and `overrun` tell of the last count: the times of its samples, and whether the queue had run over.
    """

    def __init__(self, rate_hz: float) -> None:
        self.nominal_ns = 1e9 / rate_hz
        self.restart()

    def restart(self) -> None:
        """Forget everything: the chip was set up again."""
        self.period_ns = self.nominal_ns
        self.drained: list[int] = []
        self.overrun = False
        self._newest_ns: float | None = None
        self._start_ns = 0.0
        self._count = 0

    def times(self, level: int, at_ns: int, overrun: bool = False) -> list[int]:
        """ns of the `level` samples that were in the queue at `at_ns`, oldest first, strictly increasing.

        After an overrun samples are missing before them, and the estimate of the period starts anew.
        """
        self.overrun = overrun
        self.drained = self._times(level, at_ns) if level else []
        return self.drained

    def _times(self, level: int, at_ns: int) -> list[int]:
        if self._newest_ns is None or self.overrun:
            return self._begin(level, at_ns)
        self._count += level
        measured_ns = (at_ns - self._start_ns) / self._count
        low, high = self.nominal_ns * (1 - TOLERANCE), self.nominal_ns * (1 + TOLERANCE)
        self.period_ns = min(max(measured_ns, low), high)
        before_ns = self._newest_ns
        predicted_ns = before_ns + level * self.period_ns
        newest_ns = min(max(predicted_ns, at_ns - self.period_ns), float(at_ns))
        # A queue that was counted late can't have newer samples than one count before: keep the order whatever happens.
        newest_ns = max(newest_ns, before_ns + level)
        self._newest_ns = newest_ns
        step_ns = (newest_ns - before_ns) / level
        return [round(before_ns + index * step_ns) for index in range(1, level + 1)]

    def _begin(self, level: int, at_ns: int) -> list[int]:
        """The first count, or the first after a gap: the newest sample is half a period old, give or take as much."""
        newest_ns = at_ns - self.period_ns / 2
        oldest_ns = newest_ns - (level - 1) * self.period_ns
        if self._newest_ns is not None and oldest_ns <= self._newest_ns:
            oldest_ns = self._newest_ns + 1
        step_ns = (newest_ns - oldest_ns) / max(level - 1, 1)
        self._newest_ns, self._start_ns, self._count = newest_ns, float(at_ns), 0
        return [round(oldest_ns + index * step_ns) for index in range(level)]
