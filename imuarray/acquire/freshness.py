"""Must a chip have had a new reading by now? Its times of reading and the slowest that its clock may be decide that.

A chip's flag says whether there is a new reading since it was last read. Two reads may follow each other closely (a
frame that began late, a burst of frames after a stall), and then an old reading is nothing wrong. It is wrong when more
time has passed since the last new reading was fetched than the chip takes for one at the slow end of its oscillator. A
chip without such a flag can't be judged so: that two of its readings are equal may be chance.
`SampleBuffer.frozen_since` looks for those.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from imuarray.acquire.adapter import SLACK_NS
from imuarray.array import SensorConfig
from imuarray.drivers.fifo_clock import TOLERANCE
from imuarray.log.format import LOST_BEFORE, RECONFIGURED, STALE, SUSPECT

_UNRELATED = LOST_BEFORE | RECONFIGURED | SUSPECT
"""Rows before which the chip may have been read without our hearing of it, or was not as configured."""


class Freshness:
    """Of one sensor, block after block."""

    def __init__(self, sensor: SensorConfig) -> None:
        self.longest_ns = round(1e9 / (sensor.chip_rate_hz * (1 - TOLERANCE))) + 2 * SLACK_NS
        self._fetched_ns: int | None = None

    def overdue(
        self, times_ns: npt.NDArray[np.int64], status: npt.NDArray[np.uint16], doubtful: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.bool_]:
        """(n,) True for rows that are stale though the chip must have had something new.

        `times_ns` (n,) are the times of the reads, `status` (n,) their flags; `doubtful` (n,) marks reads whose time is
        uncertain, or before which another read may have taken the new reading. Such a read is not judged, and the time
        since the one before it says nothing either.
        """
        unrelated = doubtful | ((status & _UNRELATED) != 0)
        stale = (status & STALE) != 0
        late = np.zeros(len(times_ns), bool)
        for row, (at_ns, is_stale, is_unrelated) in enumerate(
            zip(times_ns.tolist(), stale.tolist(), unrelated.tolist(), strict=True)
        ):
            if is_unrelated:
                self._fetched_ns = None
            elif not is_stale or self._fetched_ns is None:
                self._fetched_ns = at_ns
            else:
                late[row] = at_ns - self._fetched_ns > self.longest_ns
        return late
