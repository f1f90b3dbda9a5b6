"""Rows that a program interpolated between readings: they are on the straight line between their neighbours, while the
readings scatter by many counts. Phones and recorders resample in this way; the noise of such rows is not that of the
sensor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imuarray.log import SensorLog

ROUNDED = 2
"""Largest second difference of three rounded values on a straight line, in counts."""

SCATTER = 6.0
"""Least second difference (median of the rows that are off the line, of the axis with the largest one) in counts: with
so much noise a twentieth of the readings is on a line by chance, on three axes at once.
"""

LEAST_SHARE = 0.3
"""Least share of rows on a line; with two rows per reading it is a half."""

FEWEST_ROWS = 200


@dataclass(frozen=True)
class Interpolation:
    """The `share` of the rows that are on the line between their neighbours, and the readings per second."""

    share: float
    rate_hz: float

    @property
    def sentence(self) -> str:
        """The interpolation as a sentence."""
        return (
            f"{100 * self.share:.0f} % of its rows are on the line between their neighbours: a program interpolated"
            f" them from about {self.rate_hz:.3g} readings per second, and their noise is not that of the sensor"
        )


def find_interpolation(sensor: SensorLog) -> Interpolation | None:
    """Return how a triad's rows were interpolated; None if they were not. Reads the rows once."""
    rows = len(sensor)
    if rows < FEWEST_ROWS or not sensor.is_triad:
        return None
    straight = compared = 0
    scatter = []
    for block in sensor.blocks():
        counts = np.asarray(sensor.counts[max(block.start - 2, 0) : block.stop])
        if len(counts) < 3:
            continue
        steps = np.diff(counts.T.astype(np.int64, order="C"))  # axis by axis, along which numpy is faster
        bends = np.abs(np.diff(steps)).max(axis=0)
        off_line = bends > ROUNDED
        held = (bends == 0) & ~steps[:, 1:].any(axis=0)
        straight += len(bends) - int(np.count_nonzero(off_line)) - int(np.count_nonzero(held))
        compared += len(bends)
        if off_line.any():
            scatter.append(float(np.median(bends[off_line])))
    if not scatter or not compared:
        return None
    share = straight / compared
    if share < LEAST_SHARE or float(np.median(scatter)) < SCATTER:
        return None
    seconds = (int(sensor.time[rows - 1]) - int(sensor.time[0])) * 1e-9
    return Interpolation(share, (1 - share) * (rows - 1) / seconds)
