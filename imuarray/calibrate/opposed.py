"""Cancellation of biases and temperature drift by anti-parallel axes of one design (the paper's section 2.1).

An error that all units of a design have in common remains in the mean of parallel axes and cancels between opposite
ones. It is evaluated in the calibrated biases, rotated into the box frame (`cancellation`), and in the slopes with
temperature (`opposed_slopes`).

In the box frame the axes of a pair have opposite signs, so the mean of the pair drifts with half the difference of the
two slopes: 0.002 LSB/degC for the y axes of the paper's Gyro1 and Gyro2; with parallel axes it would be 0.263. Opposed
axes drift less than parallel ones exactly if the two slopes have the same sign. The test for equal signs uses the
larger of two one-sided p-values (Berger, Technometrics 24, 1982, p. 295).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from imuarray.calibrate.model import BIAS, Calibration, SensorCalibration
from imuarray.log import SensorLog


@dataclass(frozen=True)
class Cancellation:
    """One design along one box axis: the mean bias in the box frame, in the sensor's unit, of the axes `along` the box
    axis, of those `against` it, and of both halves averaged (`opposed`); None if no axis points in that direction.
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
    """Evaluate the cancellation for every design (chip) and box axis of the inertial `sensors`."""
    biases: dict[tuple[str, str, str, int], dict[int, list[float]]] = {}
    for sensor in sensors:
        calibration_of = calibration.or_nominal(sensor)
        for direction, bias in zip(calibration_of.directions_box, calibration_of.bias_in_units(), strict=True):
            axis = int(np.abs(direction).argmax())
            sign = 1 if direction[axis] > 0 else -1
            ways = biases.setdefault((sensor.chip, sensor.quantity, sensor.unit, axis), {})
            ways.setdefault(sign, []).append(sign * float(bias))
    return [_row(*key, ways) for key, ways in sorted(biases.items())]


def _row(chip: str, quantity: str, unit: str, axis: int, ways: Mapping[int, list[float]]) -> Cancellation:
    along, against = (float(np.mean(ways[sign])) if sign in ways else None for sign in (1, -1))
    biases = [bias for way in ways.values() for bias in way]
    return Cancellation(
        chip,
        quantity,
        unit,
        "XYZ"[axis],
        along,
        against,
        (along + against) / 2 if along is not None and against is not None else None,
        float(np.sqrt(np.mean(np.square(biases)))),
    )


OPPOSED = -0.95
"""Cosine of the angle between two axes that point in opposite directions."""


@dataclass(frozen=True)
class OpposedSlopes:
    """Slopes with temperature of two axes ("Gyro1 y") of one design and range that oppose each other along a box axis,
    in counts/degC along their own axes.

    `half_difference` is the slope of their mean in the box frame and `sem` its standard error; `reduction` is the mean
    magnitude of the single slopes over it. `p_cancels` is the p-value of these slopes under the hypothesis that they do
    not have the same sign, `p_nothing_left` that of the half difference under the hypothesis that they cancel
    completely. `is_bias` is False if a slope may be one of scale.
    """

    first: str
    second: str
    chip: str
    box_axis: str
    slope_first: float
    slope_second: float
    half_difference: float
    sem: float
    reduction: float
    p_cancels: float
    p_nothing_left: float
    is_bias: bool


def opposed_slopes(
    sensors: Sequence[SensorLog], calibrations: Mapping[str, SensorCalibration]
) -> Iterator[OpposedSlopes]:
    """Yield every pair of axes with opposite nominal directions of two `sensors` of one chip and range."""
    for first, second in combinations(sensors, 2):
        if (first.chip, first.quantity, first.range) != (second.chip, second.quantity, second.range):
            continue
        cosines = first.orientation.T @ second.orientation
        for i, j in product(range(3), range(3)):
            if cosines[i, j] < OPPOSED:
                yield _pair(first, i, calibrations[first.name], second, j, calibrations[second.name])


def _pair(
    first: SensorLog, i: int, known: SensorCalibration, second: SensorLog, j: int, other: SensorCalibration
) -> OpposedSlopes:
    if known.thermal is None or other.thermal is None:
        raise ValueError("both sensors need slopes")
    slopes = np.array([known.thermal.slope_lsb_per_degc[i], other.thermal.slope_lsb_per_degc[j]])
    sems = np.array([known.thermal.slope_sem_lsb_per_degc[i], other.thermal.slope_sem_lsb_per_degc[j]])
    half, sem, reduction, cancels, nothing_left = compare_opposed(slopes[0], slopes[1], sems[0], sems[1])
    return OpposedSlopes(
        f"{first.name} {'xyz'[i]}",
        f"{second.name} {'xyz'[j]}",
        first.chip,
        "XYZ"[int(np.abs(first.orientation[:, i]).argmax())],
        float(slopes[0]),
        float(slopes[1]),
        half,
        sem,
        reduction,
        cancels,
        nothing_left,
        known.thermal.meaning[i] == BIAS and other.thermal.meaning[j] == BIAS,
    )


def compare_opposed(
    first: float, second: float, sem_first: float, sem_second: float
) -> tuple[float, float, float, float, float]:
    """Return the half difference of two slopes, its standard error, the reduction, `p_cancels` and `p_nothing_left`
    (see `OpposedSlopes`).
    """
    from scipy.special import ndtr  # slow to import, and every logger imports this package

    half, sem = (first - second) / 2, float(np.hypot(sem_first, sem_second)) / 2
    reduction = (abs(first) + abs(second)) / 2 / abs(half) if half else np.inf
    one_sided = [max(ndtr(-sign * first / sem_first), ndtr(-sign * second / sem_second)) for sign in (1, -1)]
    return half, sem, float(reduction), float(min(one_sided)), float(2 * ndtr(-abs(half) / sem))
