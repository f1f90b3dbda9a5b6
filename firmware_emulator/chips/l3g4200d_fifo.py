"""The L3G4200D's FIFO of 32 sets (facts L3G-53 ... L3G-58, DEC-23).

The two modes that wait for an interrupt stay what they are before it, for the interrupt is not modelled:
stream-to-FIFO streams, bypass-to-stream bypasses. A set is taken out when its first byte is read and stays on the
output registers until its last one, OUT_Z_H, is; with the FIFO empty the registers keep the last set read. These
are choices, not facts.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

Codes = tuple[int, int, int]

DEPTH = 32
FIFO, STREAM, STREAM_TO_FIFO = 0b001, 0b010, 0b011
LAST_BYTE = 5  # OUT_Z_H, counted from OUT_X_L


class Fifo:
    """Sets in the order of their conversion."""

    def __init__(self) -> None:
        self.mode = 0
        self._sets: deque[Codes] = deque()
        self._shown: Codes = (0, 0, 0)
        self._open = False
        self._upto = -1
        self._stopped = False  # full once, in FIFO mode

    @property
    def active(self) -> bool:
        """True if sets are stored at all."""
        return self.mode in (FIFO, STREAM, STREAM_TO_FIFO)

    @property
    def level(self) -> int:
        """Sets stored, 0 ... 32."""
        return len(self._sets)

    @property
    def waiting(self) -> bool:
        """True if there is a set that has not been read to its end."""
        return self._open or bool(self._sets)

    def switch(self, mode: int, latest: int, shown: Codes) -> None:
        """Another mode from conversion `latest` on; going through bypass empties (L3G-54)."""
        was_active = self.active
        self.mode = mode
        if not self.active:
            self._sets.clear()
            self._stopped = False
        if not was_active:
            self._open, self._shown, self._upto = False, shown, latest

    def fill(self, latest: int, convert: Callable[[int], Codes]) -> None:
        """Take in the conversions up to `latest`, as far as the mode keeps them."""
        begin, end = self._upto + 1, latest + 1
        if self.mode == FIFO:
            end = begin if self._stopped else min(end, begin + DEPTH - len(self._sets))
        else:
            begin = max(begin, end - DEPTH)  # older ones would be discarded anyway
        for index in range(begin, end):
            if len(self._sets) == DEPTH:
                self._sets.popleft()
            self._sets.append(convert(index))
        self._upto = latest
        self._stopped = self.mode == FIFO and (self._stopped or len(self._sets) == DEPTH)

    def shown(self, byte: int) -> Codes:
        """The set to which byte 0 ... 5 of the output registers belongs when it is read now (L3G-56)."""
        if not self._open and self._sets:
            self._open, self._shown = True, self._sets.popleft()
        if byte == LAST_BYTE:
            self._open = False
        return self._shown

    def source(self, watermark: int) -> int:
        """FIFO_SRC_REG: watermark reached, full, empty, level up to 31 (L3G-55, L3G-58)."""
        level = len(self._sets)
        full = level == DEPTH
        return (level >= watermark) << 7 | full << 6 | (not level) << 5 | level - full
