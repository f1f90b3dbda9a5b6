"""Accelerometers of one box whose specific forces point in contradictory directions: their axes are wrong in the
configuration, or a sensor is faulty. Their mean is then a wrong force, down to 0 g for two in opposite directions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate import Calibration
from imuarray.log import SensorLog
from imuarray.log.format import SATURATED, SUSPECT
from imuarray.printable import listed
from imuarray.units import STANDARD_GRAVITY

_COMPARED_NS = 10_000_000_000
"""Duration of the stretch at the beginning of a log whose mean forces are compared."""

_CONTRADICTION_DEG = 45.0
"""Least angle between two mean forces that is reported. Wrong axes turn a triad by at least 90 degrees; uncalibrated
biases of 0.25 g, as those of a BMA180 at 16 g, turn two of them apart by up to 28 degrees.
"""

_LEAST_FORCE = 0.5 * STANDARD_GRAVITY
"""Smallest mean force in m/s2 whose direction is compared."""


def contradictions(sensors: Sequence[SensorLog], calibration: Calibration) -> Iterator[str]:
    """Yield a sentence if mean forces at the beginning of the log point in directions that differ by more than biases
    explain. The reference is the sensor with which most others agree, the first one in a tie.
    """
    accelerometers = [sensor for sensor in sensors if sensor.quantity == "specific_force" and len(sensor)]
    start_ns = max((int(sensor.time[0]) for sensor in accelerometers), default=0)
    mean_forces = {sensor.name: _mean_force(sensor, calibration, start_ns) for sensor in accelerometers}
    directions = {
        name: force / size for name, force in mean_forces.items() if (size := np.linalg.norm(force)) > _LEAST_FORCE
    }
    if len(directions) < 2:
        return
    triads = np.stack(list(directions.values()))
    angles_deg = np.degrees(np.arccos(np.clip(triads @ triads.T, -1.0, 1.0)))
    reference = int(np.argmax((angles_deg <= _CONTRADICTION_DEG).sum(axis=1)))
    angle_of = dict(zip(directions, angles_deg[reference], strict=True))
    majority = [name for name, angle_deg in angle_of.items() if angle_deg <= _CONTRADICTION_DEG]
    for name, angle_deg in angle_of.items():
        if angle_deg > _CONTRADICTION_DEG:
            yield (
                f"{name}: its specific force points {angle_deg:.0f} degrees from that of {listed(majority)}: axes are"
                " wrong in the configuration or map, or a sensor is faulty"
            )


def _mean_force(sensor: SensorLog, calibration: Calibration, start_ns: int) -> Floats:
    """Return the mean force (3,) in m/s2 in the box frame of the valid rows of the stretch; zeros without any."""
    rows = sensor.between(start_ns, start_ns + _COMPARED_NS)
    valid = (np.asarray(sensor.status[rows]) & (SATURATED | SUSPECT)) == 0
    if not valid.any():
        return np.zeros(3)
    counts = np.asarray(sensor.counts[rows], np.float64)[valid].mean(axis=0)
    return calibration.or_nominal(sensor).stimulus_box(counts)
