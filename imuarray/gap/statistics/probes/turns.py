"""Probe of a gyroscope's response to the turns from one rest to the next, by the direction of gravity at both ends.

It needs neither another gyroscope nor an instrument, and is coarse: a rate is the mean of a part of the turn, and an
attitude is known to a degree or two.
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
"""Change of a factor that attitudes make which are wrong by some degrees, where a turn goes about several axes."""


def factor(log: LogSummary, sensor: str) -> Floats:
    """Return the factor (3,) of each axis's readings by which the turns lead from each attitude to the next, the other
    axes as they are; nan where the box hardly turns about an axis, and of other sensors than gyroscopes.
    """
    return factors_of(turns_of(log).get(sensor, []))


@once
def turns_of(log: LogSummary) -> dict[str, list[Turn]]:
    """Return the turns between attitudes that are known, as each gyroscope without its bias shows them, in its own
    axes.
    """
    turns: dict[str, list[Turn]] = {}
    for part in log.phases:
        for name, summary in part.sensors.items():
            if part.ups_box is not None and (turn := turn_of(summary, part.ups_box)) is not None:
                turns.setdefault(name, []).append(turn)
    return turns


def turn_of(summary: Summary, ups_box: tuple[Up, Up]) -> Turn | None:
    """Return a gyroscope's turn between two directions up in the box's frame, by readings without bias, in its own
    axes; None of other sensors.
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
        "factor of the readings by which turns lead from one attitude to the next",
        ("axis_error", "channel_swap", "range_reset", "scale"),
        response,
        factor,
        resolution=_BY_ATTITUDES,
    )
}
