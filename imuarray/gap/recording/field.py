"""The magnetic field around a resting box, estimated from the log's own magnetometers.

A log does not record the field, which differs from room to room. The mean reading of the magnetometers in each phase at
rest is therefore assumed to be the field and is no evidence of their errors. Their differences, and their changes
within a phase, are evidence.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.recording.phases import is_at_rest
from imuarray.gap.recording.source import RecordedSource
from imuarray.log import SensorLog
from imuarray.log.format import Phase
from imuarray.simulate.motion.faces import PhaseField


def fields_of(sensors: Sequence[SensorLog], phases: Sequence[Phase]) -> tuple[PhaseField, ...]:
    """Return the mean field of the magnetometers among `sensors` in each phase at rest, in the order of time; empty
    without a magnetometer.
    """
    magnetometers = [sensor for sensor in sensors if sensor.quantity == "magnetic_field" and sensor.sensitivity]
    fields: list[PhaseField] = []
    last_end_ns = 0
    for phase in filter(is_at_rest, sorted(phases)):
        means = [mean for sensor in magnetometers if (mean := _mean_box(sensor, phase)) is not None]
        if means:
            x, y, z = np.mean(means, axis=0).tolist()
            # half-way between two phases: the first readings of a phase may have been measured before it begins
            turn_ns = (last_end_ns + phase.start_ns) // 2 if fields else phase.start_ns
            fields.append(PhaseField(turn_ns, (x, y, z)))
            last_end_ns = phase.end_ns
    return tuple(fields)


def _mean_box(sensor: SensorLog, phase: Phase) -> Floats | None:
    """Return the mean field (3,) in gauss in the box frame; None without readings."""
    rows, sums = 0, np.zeros(3)
    for block in RecordedSource(sensor).blocks(phase.start_ns, phase.end_ns):
        rows += len(block.time)
        sums += block.counts.sum(axis=0, dtype=float)
    return np.asarray(sensor.orientation @ (sums / sensor.axis_sensitivity) / rows) if rows else None
