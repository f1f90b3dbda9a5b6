"""Flags of clipped readings, which are set after the whole recording has been read."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from imuarray.characterise.codes import Rails, find_rails
from imuarray.log import LogWriter
from imuarray.log.format import SATURATED, SensorHeader
from imuarray.log.journal import Columns
from imuarray.printable import counted, listed


def flag_clipped(log: LogWriter, headers: Sequence[SensorHeader]) -> list[str]:
    """Flag the rows of triads at the end of the range. Returns sentences that state the sensors, one for all sensors
    that clip in the same way.
    """
    clipping: dict[str, list[tuple[str, int]]] = {}
    for header in headers:
        rails = find_rails(log[header.name])
        if not rails.rows.any():
            continue
        end = 1 << log[header.name].count_bits - 1  # readings at the ends of all codes are flagged already
        if ((rails.low > -end) | (rails.high < end - 1)).any():
            log.revise(header.name, "status", _flagging(rails))
        rows = log[header.name].flagged()["saturated"]
        clipping.setdefault(_where(header, rails), []).append((header.name, rows))
    return [
        f"{listed([name for name, _ in sensors])}: {where}; {_readings([rows for _, rows in sensors])} flagged as"
        " saturated"
        for where, sensors in clipping.items()
    ]


def _readings(rows: Sequence[int]) -> str:
    """Return the number of readings of each sensor at an end of the range, in words."""
    if len(rows) == 1:
        return counted(rows[0], "reading")
    span = f"{min(rows)} to {max(rows)} readings" if min(rows) < max(rows) else counted(rows[0], "reading")
    return f"{span} of each"


def _flagging(rails: Rails) -> Callable[[Columns], npt.NDArray[np.uint16]]:
    def status(columns: Columns) -> npt.NDArray[np.uint16]:
        flagged = np.where(rails.clipped(columns["counts"]), SATURATED, 0).astype(np.uint16)
        return np.asarray(columns["status"] | flagged)

    return status


def _where(header: SensorHeader, rails: Rails) -> str:
    axes: dict[str, str] = {}
    for axis, name in enumerate("xyz"):
        ends = [int(code) for code in (rails.low[axis], rails.high[axis]) if np.isfinite(code)]
        if ends:
            values = " and ".join(f"{code} ({code / header.sensitivity:.4g} {header.unit})" for code in ends)
            axes[values] = axes.get(values, "") + name
    return "; ".join(f"{names} clips at {values}" for values, names in axes.items())
