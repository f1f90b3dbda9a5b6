"""The place where decoded rows enter the log, for every bus: in the order of their times, or not at all.

Times in a log strictly increase. A row whose time says otherwise (a queue that was counted wrongly, a clock that was
fitted badly, a frame that was delivered twice) must end neither the log nor the rows around it: it is refused and
counted as a lost reading, an event tells, and the next row carries the flag "readings lost just before".
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from imuarray.acquire.fault_episode import FaultEpisodes
from imuarray.acquire.sample_buffer import SampleBuffer
from imuarray.log.format import LOST_BEFORE, OVERRUN, RECONFIGURED
from imuarray.log.rotate import Writer
from imuarray.log.writer import Block
from imuarray.printable import counted

AHEAD_NS = 1_000_000_000
"""A row that lies further ahead of the clock has an invented time; the times of a microcontroller's rows are estimated
to some milliseconds."""

_INHERITED = np.uint16(LOST_BEFORE | OVERRUN | RECONFIGURED)
"""Flags that tell of what was before a row: they pass to the row after a refused one."""


class Intake:
    """Writes blocks of rows into `log`; `observe` sees each as it was written, `faults` tell of refused rows, which
    are counted in `lost` by sensor.
    """

    def __init__(
        self,
        log: Writer,
        epoch_ns: int,
        observe: Callable[[str, Block], None],
        faults: FaultEpisodes,
        lost: dict[str, int],
    ) -> None:
        self._log, self._epoch_ns, self._observe, self._faults, self._lost = log, epoch_ns, observe, faults, lost
        self._newest_ns: dict[str, int] = {}
        self._inherited: dict[str, np.uint16] = {}

    def write(self, buffer: SampleBuffer, count: int, now_ns: int) -> Block:
        """Take the oldest `count` rows that wait, and write those that are in order; what was written, maybe no row.

        DiskFullError, LogError.
        """
        name = buffer.route.sensor.name
        block = buffer.take(count, self._epoch_ns)
        kept = in_order(block.time, self._newest_ns.get(name), now_ns - self._epoch_ns + AHEAD_NS)
        if not kept.all():
            self._refuse(name, int(np.count_nonzero(~kept)), now_ns)
            buffer.doubtful_rows = buffer.doubtful_rows[kept]
        block, self._inherited[name] = selected(block, kept, self._inherited.get(name, np.uint16(0)))
        if len(block.time):
            self._newest_ns[name] = int(block.time[-1])
            self._log.append(name, block)
            self._observe(name, block)
        return block

    def _refuse(self, name: str, count: int, now_ns: int) -> None:
        self._lost[name] += count
        text = f"{counted(count, 'reading')} refused: not later than the reading before, or ahead of the clock"
        self._faults.of(name, "refused").happened(now_ns, text, count)


def in_order(times: npt.NDArray[np.int64], newest_ns: int | None, latest_ns: int) -> npt.NDArray[np.bool_]:
    """(n,) which of the `times` (n,) can be stored behind `newest_ns` (None: nothing is stored yet): those that are at
    most `latest_ns` and later than all such before them.
    """
    possible = times <= latest_ns
    floor = np.iinfo(np.int64).min
    reached = np.maximum.accumulate(np.where(possible, times, floor))
    before = np.concatenate([[floor if newest_ns is None else newest_ns], reached[:-1]])
    return np.asarray(possible & (times > np.maximum.accumulate(before)), np.bool_)


def selected(block: Block, kept: npt.NDArray[np.bool_], inherited: np.uint16) -> tuple[Block, np.uint16]:
    """The rows of `block` that are `kept` (n,), and the flags that its next row inherits.

    The first row takes over the flags `inherited` from before the block; each row takes over those of refused rows
    right before it, and is flagged as following lost readings.
    """
    if kept.all() and not inherited:
        return block, np.uint16(0)
    status = block.status.copy()
    for row, keep in enumerate(kept.tolist()):
        if keep:
            status[row] |= inherited
            inherited = np.uint16(0)
        else:
            inherited |= (status[row] & _INHERITED) | np.uint16(LOST_BEFORE)
    temperature = None if block.temperature_counts is None else block.temperature_counts[kept]
    compensated = {name: column[kept] for name, column in block.compensated.items()}
    return Block(block.time[kept], block.counts[kept], status[kept], temperature, compensated), inherited
