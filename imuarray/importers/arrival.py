"""Reconstruct the reading times of rows that arrived in bursts: a chip samples steadily, whatever its host does.

Rows are assumed to be read evenly between the mean arrival times of long stretches, so that the chip's oscillator may
drift against the host's clock (`imuarray.gap.recording.row_timing`). The delay of each row is kept as a column, so the
arrival times are not lost.
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
    """Replace the arrival times of a sensor's rows by their reading times and store the delays. Returns remarks as
    sentences.
    """
    timing = row_timing(log[sensor])
    if timing.rows < 3:
        return [f"{sensor}: too few rows to reconstruct reading times; arrival times are kept"]
    even = even_rows(log[sensor])
    log.revise(sensor, ARRIVAL, _EvenTimes(even).delay_s)
    log.revise(sensor, "time", _EvenTimes(even).time)
    delays = np.asarray(log[sensor].compensated(ARRIVAL))
    doubt = "" if timing.kind == "bursts" else ", although the rows do not arrive in bursts"
    return [
        f"{sensor}: reading times reconstructed at {even.rows_per_s:.5g} rows a second{doubt}; rows arrived up to"
        f" {1e3 * float(np.ptp(delays)):.3g} ms apart from them (rms {1e3 * float(delays.std()):.3g} ms), as"
        f" {ARRIVAL} says"
    ]


class _EvenTimes:
    """Reading times and delays of consecutive blocks of rows."""

    def __init__(self, even: EvenRows) -> None:
        self._even = even
        self._row = 0

    def time(self, columns: Columns) -> Times:
        """Return the reading times (n,) ns of the next rows."""
        start, self._row = self._row, self._row + len(columns["time"])
        return self._even.stamps(start, self._row)

    def delay_s(self, columns: Columns) -> npt.NDArray[np.float64]:
        """Return the delays (n,) s from reading to arrival."""
        arrived: Times = np.asarray(columns["time"], np.int64)
        return np.asarray((arrived - self.time(columns)) * 1e-9)
