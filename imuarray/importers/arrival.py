"""Times of rows that arrived in bursts, counted out: a chip samples steadily, whatever its host is busy with.

Rows are taken to have been read evenly between mean arrival times of long stretches, so that the chip's oscillator
may drift against the host's clock (`imuarray.gap.recording.row_timing`). The raw times are kept: each row's delay
stands beside its time.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Times
from imuarray.gap.recording.row_timing import EvenRows, even_rows, row_timing
from imuarray.log import LogWriter
from imuarray.log.format import ARRIVAL
from imuarray.log.layout import Columns


def count_out(log: LogWriter, sensor: str) -> list[str]:
    """Put the times at which a sensor's rows were read in the place of those at which they arrived, and by how much
    they arrived later beside them; what is to be said of it, in sentences.
    """
    timing = row_timing(log[sensor])
    if timing.rows < 3:
        return [f"{sensor}: too few rows to count their times out; they are those of arrival"]
    even = even_rows(log[sensor])
    log.revise(sensor, ARRIVAL, _Counted(even).delay_s)
    log.revise(sensor, "time", _Counted(even).time)
    delays = np.asarray(log[sensor].compensated(ARRIVAL))
    doubt = "" if timing.kind == "bursts" else ", though they don't arrive in bursts"
    return [
        f"{sensor}: times counted out at {even.rows_per_s:.5g} rows a second{doubt}; rows arrived up to"
        f" {1e3 * float(np.ptp(delays)):.3g} ms apart from them (rms {1e3 * float(delays.std()):.3g} ms), as"
        f" {ARRIVAL} says"
    ]


class _Counted:
    """The rows that a revision has seen."""

    def __init__(self, even: EvenRows) -> None:
        self._even = even
        self._row = 0

    def time(self, columns: Columns) -> Times:
        """(n,) ns at which the next rows were read."""
        start, self._row = self._row, self._row + len(columns["time"])
        return self._even.stamps(start, self._row)

    def delay_s(self, columns: Columns) -> npt.NDArray[np.float64]:
        """(n,) s by which they arrived later."""
        arrived: Times = np.asarray(columns["time"], np.int64)
        return np.asarray((arrived - self.time(columns)) * 1e-9)
