"""What the paper's tables would show of an array: every printed statistic of the inertial axes with its scatter.

Levels are foretold from the bias that Table 10's six faces give; a derived statistic is arithmetic on others. What the
tables print of thermometers is not compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import hypot, log, sqrt
from typing import NamedTuple

import numpy as np

from imuarray.paper.accelerometers import READINGS
from imuarray.paper.gap.acting import FACES_MEAN_DEGC
from imuarray.paper.gap.chance import (
    FACES,
    ONE_RUN,
    PARTS_OF_RUN,
    array_rate_hz,
    heated_line,
    log_deviation,
    run_temperatures,
)
from imuarray.paper.gap.sensor import CONTINUOUS, HEATING, RUNS, Array, Floats, Sensor, printed
from imuarray.paper.replica.spread import RANGE_OVER_DEVIATION, noise_residual
from imuarray.paper.replica.statistic import Statistic
from imuarray.paper.room import DEGC, FACES_DEGC
from imuarray.paper.stability import group_members
from imuarray.paper.tables import number_in, table
from imuarray.paper.wander import PARTS

FACE_VECTORS = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, -1], [0, 0, 1]], float)
"""Of the force in g along box X, Y and Z while each face of `READINGS` was up (7, 3)."""
_SIX = np.array([1 / 6] * 6 + [0.0])
_NORMAL_RANGE = 3.534
"""Of fifteen normal numbers over their deviation: `imuarray.paper.stability`."""


def expected(array: Array) -> tuple[Statistic, ...]:
    """Every statistic of Tables 3 to 8, 10 and 11, the printed one beside what this array makes of it."""
    per_sensor = (row for sensor in array.values() for row in _of_sensor(sensor))
    return (*per_sensor, *_table5(array))


def _of_sensor(sensor: Sensor) -> Iterator[Statistic]:
    for axis in range(3):
        channel = f"{sensor.name} {'xyz'[axis]}"
        yield from _faces(sensor, axis, channel)
        yield from _heating(sensor, axis, channel)
        yield from _fifteen(sensor, axis, channel)
        yield from _noise(sensor, axis, channel)


def _faces(sensor: Sensor, axis: int, channel: str) -> Iterator[Statistic]:
    """Table 10's readings, and what Tables 3 and 4 make of them."""
    mean, covariance = _face_readings(sensor, axis)
    for i, face in enumerate(READINGS):
        yield _linear(10, channel, face, printed(10, channel, face), mean[i], sqrt(covariance[i, i]))
    weights = {"drift_lsb": np.array([1.0, 0, 0, 0, 0, 0, -1.0])}
    if sensor.header.unit == "dps":
        for k in "xyz":
            weights[f"dbias_{k}_lsb"] = _difference(f"{k}_up", f"{k}_down")
    number = 4 if sensor.header.unit == "dps" else 3
    for column, weight in weights.items():
        sd = sqrt(weight @ covariance @ weight)
        values = printed(number, channel, column), float(weight @ mean)
        yield replace(_linear(number, channel, column, *values, sd), derived=True)
    if number == 3:
        yield _scale(channel, mean, covariance)


def _difference(first: str, second: str) -> Floats:
    weight = np.zeros(7)
    weight[READINGS.index(first)], weight[READINGS.index(second)] = 1.0, -1.0
    return weight


def _scale(channel: str, mean: Floats, covariance: Floats) -> Statistic:
    """The norm of the half-differences, its deviation by its gradient; without the sign that the paper gives it."""
    halves = np.array([_difference(f"{k}_up", f"{k}_down") / 2 for k in "xyz"])
    response = halves @ mean
    size = float(np.linalg.norm(response))
    gradient = response / size @ halves
    value = abs(printed(3, channel, "scale_lsb_per_g"))
    sd = hypot(sqrt(gradient @ covariance @ gradient), 0.005 / sqrt(3))
    return replace(_linear(3, channel, "scale_lsb_per_g", value, size, sd), derived=True)


def _face_readings(sensor: Sensor, axis: int) -> tuple[Floats, Floats]:
    """(7,) and (7, 7): the readings and their covariance, less the mean of six that the bias was fitted to."""
    warm = np.array(FACES_DEGC) - FACES_MEAN_DEGC
    mean = sensor.level[axis] + FACE_VECTORS @ sensor.response[axis] + sensor.slope[axis] * warm
    unit = FACE_VECTORS * sensor.response_sd[axis]
    squares = FACE_VECTORS**2 * sensor.squared_sd[axis]
    heat = np.outer(warm, warm) * sensor.slope_sd[axis] ** 2
    all_parts = unit @ unit.T + squares @ squares.T + heat + FACES.covariance(sensor, axis, array_rate_hz(10))
    away = np.eye(7) - _SIX
    return mean, np.asarray(away @ all_parts @ away.T)


def _upright(sensor: Sensor, axis: int, degc: float) -> tuple[float, float]:
    """Level and its variance with +Z up on another switch-on, without what that one adds."""
    warm = degc - FACES_MEAN_DEGC
    level = float(sensor.level[axis] + sensor.response[axis, 2] + sensor.slope[axis] * warm)
    faces = FACES.covariance(sensor, axis, array_rate_hz(10))
    # of the squared response at one face, a third is in the six faces' mean
    of_unit = sensor.response_sd[axis, 2] ** 2 + 4 / 9 * sensor.squared_sd[axis, 2] ** 2
    boot = sensor.turn_on[axis] ** 2 + float(_SIX @ faces @ _SIX)
    return level, float(of_unit + (sensor.slope_sd[axis] * warm) ** 2 + boot)


def _heating(sensor: Sensor, axis: int, channel: str) -> Iterator[Statistic]:
    """Table 8. The intercept is that of the printed slope: what it says more is the level while it was warm."""
    line = heated_line()
    of_slope, of_level = line.variances(sensor, axis)
    sd = sqrt(of_slope + sensor.slope_sd[axis] ** 2 + (0.0005 / sqrt(3)) ** 2)
    slope = printed(8, channel, "slope_lsb_per_degc")
    yield _linear(8, channel, "slope_lsb_per_degc", slope, float(sensor.slope[axis]), sd)
    level, variance = _upright(sensor, axis, line.degc)
    intercept = level + float(sensor.moved(HEATING)[axis]) - slope * line.degc
    own_boot = sensor.turn_on[axis] ** 2 + sensor.moved_sd(HEATING)[axis] ** 2 + of_level
    printed_one = printed(8, channel, "intercept_lsb")
    yield _linear(8, channel, "intercept_lsb", printed_one, intercept, sqrt(variance + own_boot))


class _Fifteen(NamedTuple):
    """Fifteen means: temperatures, what the level is moved by, covariance about that."""

    degc: Floats
    moved: Floats
    covariance: Floats


def _runs(sensor: Sensor, axis: int) -> _Fifteen:
    """Separate ones."""
    single = float(ONE_RUN.covariance(sensor, axis, array_rate_hz(11))[0, 0]) + sensor.turn_on[axis] ** 2
    spreads = sensor.moved_sd(RUNS)[..., axis] ** 2 * np.ones(PARTS)
    return _Fifteen(run_temperatures(), sensor.moved(RUNS)[..., axis] * np.ones(PARTS), np.diag(single + spreads))


def _windows(sensor: Sensor, axis: int) -> _Fifteen:
    """Those of one run, in which the temperature drifts evenly."""
    drift = np.linspace(-1, 1, PARTS)
    drift *= DEGC[11, "cont_std_of_means"] / drift.std(ddof=1)
    covariance = PARTS_OF_RUN.covariance(sensor, axis, array_rate_hz(11)) + sensor.turn_on[axis] ** 2
    return _Fifteen(DEGC[11, "cont_mean"] + drift, np.full(PARTS, float(sensor.moved(CONTINUOUS)[axis])), covariance)


def _deviation(sensor: Sensor, axis: int, fifteen: _Fifteen) -> tuple[float, float]:
    """Of the means, and the standard deviation of its logarithm."""
    wild = sensor.slope_sd[axis] ** 2 * float(fifteen.degc.var(ddof=1))
    return log_deviation(fifteen.covariance, fifteen.moved + sensor.slope[axis] * fifteen.degc, wild)


def _fifteen(sensor: Sensor, axis: int, channel: str) -> Iterator[Statistic]:
    """Table 11's means and their deviations, and Tables 6 and 7."""
    halves = {"runs": _runs(sensor, axis), "cont": _windows(sensor, axis)}
    spreads = {half: _deviation(sensor, axis, fifteen) for half, fifteen in halves.items()}
    for half, fifteen in halves.items():
        is_sum = half == "runs" and sensor.name in ("BMA1", "Gyro3")
        level, variance = _upright(sensor, axis, float(fifteen.degc.mean()))
        own = sqrt(variance + float(fifteen.covariance.sum()) / PARTS**2)
        values = printed(11, channel, f"{half}_mean"), level + float(fifteen.moved.mean())
        yield replace(_linear(11, channel, f"{half}_mean", *values, own), derived=is_sum)
        deviation, spread = spreads[half]
        yield replace(_log(11, channel, f"{half}_std_of_means", deviation, spread), derived=is_sum)
        wider = hypot(spread, RANGE_OVER_DEVIATION)
        yield replace(_log(11, channel, f"{half}_range_of_means", deviation * _NORMAL_RANGE, wider), derived=True)
    (runs, of_runs), (cont, of_cont) = spreads["runs"], spreads["cont"]
    yield replace(_log(11, channel, "ratio", runs / cont, hypot(of_runs, of_cont)), derived=True)
    if sensor.name in ("BMA1", "Gyro3"):
        yield from _single_runs(sensor, axis, channel, halves["runs"])


def _single_runs(sensor: Sensor, axis: int, channel: str, runs: _Fifteen) -> Iterator[Statistic]:
    number, column = (6 if sensor.name == "BMA1" else 7), f"{'xyz'[axis]}_lsb"
    for i, row in enumerate(table(number)):
        level, variance = _upright(sensor, axis, float(runs.degc[i]))
        sd = sqrt(variance + runs.covariance[i, i])
        yield _linear(
            number, channel, f"run {row['run']}", float(number_in(row, column)), level + float(runs.moved[i]), sd
        )


def _noise(sensor: Sensor, axis: int, channel: str) -> Iterator[Statistic]:
    """Deviations of single readings; a data sheet's typical figure is as uncertain as the three experiments differ."""
    own, spread = float(sensor.rounded_noise[axis]), noise_residual(channel)
    for number, half in ((10, ""), (11, "runs_"), (11, "cont_")):
        yield _log(number, channel, f"{half}std_lsb" if number == 10 else f"{half}std", own, spread)
        column = f"{half}sem_lsb" if number == 10 else f"{half}sem"
        readings = array_rate_hz(number) * (900 if number == 10 else 300)
        yield replace(_log(number, channel, column, own / sqrt(readings), hypot(spread, 0.01)), derived=True)


def _table5(array: Array) -> Iterator[Statistic]:
    for row in table(5):
        found = [_part_deviation(array, member["channel"]) for member in group_members(row["group"])]
        total = sum(deviation for deviation, _ in found)
        spread = sqrt(sum((deviation * part) ** 2 for deviation, part in found)) / total
        value = float(number_in(row, "std_of_5min_means_lsb"))
        one = Statistic(
            "Table 5", row["group"], "std_of_5min_means_lsb", value, total / len(found), spread, "scatter", "log"
        )
        yield replace(one, derived=True)


def _part_deviation(array: Array, channel: str) -> tuple[float, float]:
    name, letter = channel.split()
    axis = "xyz".index(letter)
    return _deviation(array[name], axis, _windows(array[name], axis))


def _linear(number: int, channel: str, column: str, value: float, own: float, sd: float) -> Statistic:
    return Statistic(f"Table {number}", channel, column, value, float(own), float(sd), "chance and population")


def _log(number: int, channel: str, column: str, own: float, sd: float) -> Statistic:
    value = printed(number, channel, column)
    return Statistic(f"Table {number}", channel, column, value, own, sd, "chance and population", "log")


def minus_twice_log_likelihood(rows: Iterator[Statistic] | tuple[Statistic, ...]) -> float:
    """Of the printed statistics, taken as independent, without the constant 2 pi."""
    return float(sum(row.z**2 + 2 * log(row.uncertainty) for row in rows))
