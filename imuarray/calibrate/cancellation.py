"""What pairing anti-parallel axes of one design would cancel of their biases (the paper's section 2.1).

An error that all units of a design share adds up among axes that point the same way and cancels between opposite
ones. Here it is looked at where it shows first: in the calibrated biases, turned into the box frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.calibrate.model import Calibration
from imuarray.log import SensorLog


@dataclass(frozen=True)
class Cancellation:
    """One design along one box axis: mean bias, box frame and the sensor's unit, of the axes along it, of those
    against it, and of both halves averaged; None where no axis points that way.
    """

    chip: str
    quantity: str
    unit: str
    box_axis: str
    along: float | None
    against: float | None
    opposed: float | None
    single_rms: float


def cancellation(sensors: Sequence[SensorLog], calibration: Calibration) -> list[Cancellation]:
    """A row for every design (chip) and box axis of the inertial `sensors`."""
    biases: dict[tuple[str, str, str, int], dict[int, list[float]]] = {}
    for sensor in sensors:
        known = calibration.or_nominal(sensor)
        for direction, bias in zip(known.directions_box, known.bias_in_units(), strict=True):
            axis = int(np.abs(direction).argmax())
            sign = 1 if direction[axis] > 0 else -1
            ways = biases.setdefault((sensor.chip, sensor.quantity, sensor.unit, axis), {})
            ways.setdefault(sign, []).append(sign * float(bias))
    return [_row(*key, ways) for key, ways in sorted(biases.items())]


def _row(chip: str, quantity: str, unit: str, axis: int, ways: Mapping[int, list[float]]) -> Cancellation:
    along, against = (float(np.mean(ways[sign])) if sign in ways else None for sign in (1, -1))
    everything = [bias for way in ways.values() for bias in way]
    return Cancellation(
        chip,
        quantity,
        unit,
        "XYZ"[axis],
        along,
        against,
        (along + against) / 2 if along is not None and against is not None else None,
        float(np.sqrt(np.mean(np.square(everything)))),
    )
