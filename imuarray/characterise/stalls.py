"""Frozen readings where a rate passes 100 dps: an ICM-42688-P whose adaptive range is on (TDK-18).

With that range the chip gives nothing new for 1 to 2 ms at each passage, so that the row before the passage equals the
row before that in all axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imuarray.log import SensorLog

THRESHOLD_DPS = 100.0
LEAST_STALLS = 3
LEAST_SHARE = 0.5
"""The least number of passages with a stall, and their least share of all, that are reported: equal rows also occur by
chance.
"""

_BLOCK_ROWS = 4096


@dataclass(frozen=True)
class Stalls:
    """Counts of passages of an axis through 100 dps from one row to the next, and of those before which the reading
    stood still.
    """

    passages: int
    stalled: int

    @property
    def is_adaptive(self) -> bool:
        """True if that is more than chance."""
        return self.stalled >= LEAST_STALLS and self.stalled >= LEAST_SHARE * self.passages


def find_stalls(sensor: SensorLog) -> Stalls | None:
    """Look for stalls in all rows of a log; None of a chip that has none. Rows of which one is missing in between
    count as neighbours: that makes no reading stand still.
    """
    if sensor.quantity != "angular_rate" or not sensor.chip.lower().startswith("icm42688") or not sensor.sensitivity:
        return None
    threshold = THRESHOLD_DPS * sensor.sensitivity
    passages = stalled = 0
    before = np.empty((0, 3), np.int64)
    for block in sensor.blocks(_BLOCK_ROWS):
        rows = np.concatenate([before, np.asarray(sensor.counts[block], np.int64)])
        inside = np.abs(rows) < threshold
        passed = (inside[2:] != inside[1:-1]).any(axis=1)
        passages += int(np.count_nonzero(passed))
        stalled += int(np.count_nonzero(passed & (rows[1:-1] == rows[:-2]).all(axis=1)))
        before = rows[-2:]
    return Stalls(passages, stalled)
