"""What anti-parallel axes of one design can cancel of their errors, pair by pair, as a calibration tells it.

The mean of a pair, one axis counted with the other's sign, keeps half the difference of the two errors (paper, section
2.1): of the slopes with temperature, and of the biases.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.opposed import cancelled
from imuarray.calibrate.stability import BIAS
from imuarray.fuse.axes import Axis, axes_of
from imuarray.log import SensorLog

_OPPOSED = -0.95
"""Cosine of the angle between two axes that point in opposite directions."""

_WITHIN = 1.96
"""Standard errors to either side of a 95 % interval."""


@dataclass(frozen=True)
class Reduction:
    """An error of a pair: of one axis (`single`, mean of the two magnitudes) and what their mean in the box frame
    keeps of it (`left`, standard error `left_sem`), in SI, slopes per degC.

    `reduction` is how many times less that is, from `least` to `most` with 95 % (inf where nothing left is possible);
    `p_value`: probability of such errors if opposing the axes gained nothing.
    """

    single: float
    left: float
    left_sem: float
    reduction: float
    least: float
    most: float
    p_value: float


@dataclass(frozen=True)
class Pair:
    """Two axes ("Gyro1 y") of one `chip`, opposite along `box_axis`, and what they cancel of their drift with
    temperature and of their bias; None where the calibration doesn't know that of both.

    `is_bias` is False where a slope may be one of scale, which opposing doesn't cancel.
    """

    first: str
    second: str
    chip: str
    box_axis: str
    drift: Reduction | None
    bias: Reduction | None
    is_bias: bool = True


def capabilities(sensors: Sequence[SensorLog], calibration: Calibration) -> list[Pair]:
    """Every pair of opposing axes of two of `sensors` (of one quantity) of one design, by their calibrated directions;
    measuring ranges may differ.
    """
    known = {sensor.name: calibration.or_nominal(sensor) for sensor in sensors}
    return [
        Pair(
            first.label,
            second.label,
            first.chip,
            "XYZ"[int(np.abs(first.direction_box).argmax())],
            _drift(known[first.sensor], first.index, known[second.sensor], second.index),
            _bias(known[first.sensor], first.index, known[second.sensor], second.index),
            all(_is_bias(known[axis.sensor], axis.index) for axis in (first, second)),
        )
        for first, second in _opposing(axes_of(sensors, calibration))
    ]


def _opposing(axes: Sequence[Axis]) -> Iterator[tuple[Axis, Axis]]:
    for first, second in combinations(axes, 2):
        alike = first.chip == second.chip and first.sensor != second.sensor
        if alike and np.dot(first.direction_box, second.direction_box) < _OPPOSED:
            yield first, second


def _is_bias(known: SensorCalibration, index: int) -> bool:
    return known.thermal is None or known.thermal.meaning[index] == BIAS


def _drift(first: SensorCalibration, i: int, second: SensorCalibration, j: int) -> Reduction | None:
    if first.thermal is None or second.thermal is None:
        return None
    return _reduction(
        first.thermal.slope_lsb_per_degc[i] / first.lsb_per_si[i],
        second.thermal.slope_lsb_per_degc[j] / second.lsb_per_si[j],
        first.thermal.slope_sem_lsb_per_degc[i] / first.lsb_per_si[i],
        second.thermal.slope_sem_lsb_per_degc[j] / second.lsb_per_si[j],
    )


def _bias(first: SensorCalibration, i: int, second: SensorCalibration, j: int) -> Reduction | None:
    if first.bias_sem_lsb is None or second.bias_sem_lsb is None:
        return None
    return _reduction(
        first.bias_lsb[i] / first.lsb_per_si[i],
        second.bias_lsb[j] / second.lsb_per_si[j],
        first.bias_sem_lsb[i] / first.lsb_per_si[i],
        second.bias_sem_lsb[j] / second.lsb_per_si[j],
    )


def _reduction(first: float, second: float, sem_first: float, sem_second: float) -> Reduction:
    """By standard errors of zero the interval is the figure itself."""
    tiny = np.finfo(float).tiny
    left, sem, reduction, p_value, _ = cancelled(first, second, max(sem_first, tiny), max(sem_second, tiny))
    single = (abs(first) + abs(second)) / 2
    low, high = abs(left) - _WITHIN * sem, abs(left) + _WITHIN * sem
    return Reduction(
        float(single),
        float(left),
        float(sem),
        float(reduction),
        float(single / high) if high > 0 else np.inf,
        float(single / low) if low > 0 else np.inf,
        float(p_value),
    )
