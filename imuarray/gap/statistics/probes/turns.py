"""Probe of a gyroscope's response to the turns between two rests, from the direction of gravity before and after.

It needs neither another gyroscope nor an instrument. It is coarse: rates are means over parts of the turn, and
attitudes are known to one or two degrees.
"""

from __future__ import annotations

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.recording.phases import Up
from imuarray.gap.recording.turns import Turn, factors_of
from imuarray.gap.statistics.campaign import LogSummary
from imuarray.gap.statistics.margins import response
from imuarray.gap.statistics.probes.probe import Probes, TurnProbe, once
from imuarray.gap.statistics.summary import Summary
from imuarray.units import SI_PER_UNIT

_BY_ATTITUDES = 0.1
"""Error of a factor that attitude errors of some degrees cause in a turn about several axes."""


def factor(log: LogSummary, sensor: str) -> Floats:
    """Return, for each axis, the factor (3,) of its readings with which the turns lead from each attitude to the next,
    with the readings of the other axes unchanged; nan where the box hardly turns about an axis, and for sensors other
    than gyroscopes.
    """
    return factors_of(turns_of(log).get(sensor, []))


@once
def turns_of(log: LogSummary) -> dict[str, list[Turn]]:
    """Return, for each gyroscope, the turns between known attitudes, from its readings without bias, along its own
    axes.
    """
    turns: dict[str, list[Turn]] = {}
    for part in log.phases:
        for name, summary in part.sensors.items():
            if part.ups_box is not None and (turn := turn_of(summary, part.ups_box)) is not None:
                turns.setdefault(name, []).append(turn)
    return turns


def turn_of(summary: Summary, ups_box: tuple[Up, Up]) -> Turn | None:
    """Return a gyroscope's turn between two directions up in the box's frame, from readings without bias, along its own
    axes; None for other sensors.
    """
    header = summary.header
    if header.quantity != "angular_rate":
        return None
    rate = summary.segments.mean / header.sensitivity * SI_PER_UNIT[header.unit]
    before, after = np.array(ups_box) @ header.orientation
    return Turn.of(before, after, rate, summary.segments.width_s * len(rate))


PROBES: Probes = {
    "turn_factor": TurnProbe(
        "motion",
        "factor on the readings with which turns lead from one attitude to the next",
        ("axis_error", "channel_swap", "range_reset", "scale"),
        response,
        factor,
        resolution=_BY_ATTITUDES,
    )
}
