"""An I2C adapter as the poll loop sees it: does it hang, is it there, and how long does a clock of it take.

A hung bus (somebody holds a wire low) costs a time-out a transaction. Two in a row, with nothing heard in between, are
the bus and not a sensor; it is then asked ever less often until something answers. An adapter that was unplugged ends
every transaction with ENODEV; it is looked for at a steady pace.
"""

from __future__ import annotations

import errno

HUNG = frozenset({errno.ETIMEDOUT, errno.EAGAIN, errno.EBUSY})
"""What Linux adapters say when the bus does not come free (LNX-43, LNX-44, LNX-47)."""
REMOVED = frozenset({errno.ENODEV})
"""What a bus says whose adapter was unplugged (`imuarray.bus.linux`)."""
SEARCH_NS = 250_000_000
"""Between two looks for an adapter that was removed."""
FIRST_PAUSE_NS = 50_000_000
LONGEST_PAUSE_NS = 400_000_000
SLACK_NS = 1_000_000
"""A reading that took so much longer than its bits need was interrupted: its time is not known better than that."""


class Adapter:
    """One adapter. `silent_until_ns`: nothing is sent before; `hangs` and `removed` while it is so."""

    def __init__(self) -> None:
        self.hangs = False
        self.removed = False
        self.silent_until_ns = -(1 << 62)
        self.time_outs = 0
        self.clock_ns = 1e9
        self._pause_ns = FIRST_PAUSE_NS

    @property
    def down(self) -> bool:
        """Whether nothing that is behind it can be asked."""
        return self.hangs or self.removed

    def was_removed(self, now_ns: int) -> bool:
        """A transaction ended with one of `REMOVED`; whether that is when the adapter went."""
        began = not self.removed
        self.removed = True
        self.silent_until_ns = now_ns + SEARCH_NS
        return began

    def returned(self) -> None:
        """It is there again."""
        self.removed = False
        self.silent_until_ns = -(1 << 62)

    def timed_out(self, now_ns: int) -> bool:
        """A transaction ended with one of `HUNG`; whether that is when the bus began to hang."""
        self.time_outs += 1
        if self.time_outs < 2:
            return False
        began = not self.hangs
        self.hangs = True
        self.silent_until_ns = now_ns + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, LONGEST_PAUSE_NS)
        return began

    def answered(self) -> bool:
        """Something was heard; whether that ended a hang."""
        ended = self.hangs
        self.hangs = False
        self.time_outs = 0
        self._pause_ns = FIRST_PAUSE_NS
        return ended

    def start_of(self, begun_ns: int, ended_ns: int, clocks: int) -> tuple[int, bool]:
        """When a burst of so many clocks that was asked for and given between these times was on the wire, and whether
        that is certain.

        A clock takes what it took in the quickest burst so far. The rest of the time is the machine's: if that is more
        than `SLACK_NS` the middle of what is possible is wrong by half of it at most.
        """
        took_ns = ended_ns - begun_ns
        if took_ns < clocks * self.clock_ns:
            self.clock_ns = took_ns / clocks
        slack_ns = took_ns - clocks * self.clock_ns
        if slack_ns <= SLACK_NS:
            return begun_ns, True
        return begun_ns + round(slack_ns / 2), False
