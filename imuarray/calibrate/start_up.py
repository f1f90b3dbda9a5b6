"""How a sensor came up this time: in which of its stored states, or wrong, so that it should be started again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from imuarray.calibrate.model import Calibration, SensorCalibration
from imuarray.calibrate.stability import TurnOn
from imuarray.calibrate.states import Ranges, explained_range

Floats = npt.NDArray[np.float64]

_NO_RANGES: Ranges = MappingProxyType({})


@dataclass(frozen=True)
class StartUp:
    """How a sensor came up: the place of its state in the calibration's list, how many spreads its reading is from that
    (root mean square over the axes), and whether it should be started again, and why.
    """

    state: int
    distance: float
    fault: bool
    explanation: str = ""


def state_of(
    means: Mapping[str, npt.ArrayLike],
    calibration: Calibration,
    *,
    ranges: Ranges = _NO_RANGES,
    limit: float = 8.0,
    pose_g: float = 0.02,
) -> dict[str, StartUp]:
    """How each sensor that has a `turn_on` came up, by its mean counts (3,) over some seconds at rest.

    Accelerometers are read in the pose of the calibrating runs, to `pose_g`. A run more than `limit` spreads from every
    state, or in another range, is a fault; `ranges` are the sensitivities of each sensor's chip, by sensor.
    """
    known = {name: sensor for name, sensor in calibration.sensors.items() if name in means}
    return {
        name: _start_up(np.asarray(means[name], float), sensor, sensor.turn_on, ranges.get(name, {}), limit, pose_g)
        for name, sensor in known.items()
        if sensor.turn_on is not None and sensor.turn_on.states
    }


def _start_up(
    mean: Floats, sensor: SensorCalibration, known: TurnOn, ranges: Mapping[float, float], limit: float, pose_g: float
) -> StartUp:
    gravity = np.zeros(3) if known.gravity_lsb is None else known.gravity_lsb
    tilt = pose_g * sensor.scale_lsb_per_unit if known.gravity_lsb is not None else 0.0
    spread = np.maximum(np.hypot(known.spread_lsb, tilt), 1e-9)
    usual = np.array([state.bias_lsb for state in known.states]) + gravity
    distances = np.sqrt(np.mean(((mean - usual) / spread) ** 2, axis=1))
    state = int(distances.argmin())
    sensitivity = ranges.get(np.nan if sensor.range is None else sensor.range, np.nan)
    feels = sensor.quantity == "specific_force"
    ratio, found = explained_range(mean, usual[state], sensitivity, ranges) if feels else (np.nan, None)
    distance = float(distances[state])
    if found is not None:
        return StartUp(
            state, distance, True, f"{ratio:.2f} times the usual reading: came up at {found:g} {sensor.unit}"
        )
    far = not distance <= limit
    return StartUp(state, distance, far, f"{distance:.1f} spreads from every state" if far else "")
