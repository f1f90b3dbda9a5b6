"""Disagreement of the paper's own tables where they state the same thing twice: the uncertainty of a comparison.

All in counts, or as natural logarithms of standard deviations. Channels are pooled in groups that ought to be alike:
one design at one range, x and y together and z apart; a design's thermometers together.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import log, sqrt

import numpy as np

from imuarray.arrays import Floats
from imuarray.studies.paper.array_model import (
    PARTS,
    REFERENCE_DEGC,
    WINDOW_S,
    Unit,
    covariance_of_means,
    gyro3_other_state_lsb,
    runs_of,
    unit_of,
    variance_of_mean,
)
from imuarray.studies.paper.systematic import READINGS
from imuarray.studies.paper.tables import DEGC, FACES_DEGC, design_of, number_in, row_of, table
from imuarray.studies.paper.variation import bias_states, boot_faults

RANGE_OVER_DEVIATION = 0.102
"""Standard deviation of ln(range / standard deviation) of 15 normal numbers."""
_CODES_PER_DEGC = {"BMA": 2.0, "Gyro": -1.0}
_STDS = ((10, "std_lsb"), (11, "runs_std"), (11, "cont_std"))


def printed(number: int, channel: str, column: str) -> float:
    """A printed number of Table 3, 4, 8, 10 or 11."""
    return float(number_in(row_of(number, channel), column))


def axis_of(channel: str) -> int:
    """0, 1, 2 for x, y, z, 3 for the thermometer."""
    return "xyzt".index(channel.split()[1])


def own(channel: str, value: Callable[[Unit], Floats]) -> float:
    """A figure of the model for this axis, in counts; 0 for a thermometer."""
    unit, axis = unit_of(channel.split()[0]), axis_of(channel)
    return 0.0 if axis == 3 else float(value(unit)[axis]) / unit.lsb


def slope(channel: str) -> float:
    """Counts per degC: Table 8, or the thermometer's own."""
    return _CODES_PER_DEGC[design_of(channel)] if channel.endswith("t") else printed(8, channel, "slope_lsb_per_degc")


@cache
def group_of(channel: str) -> tuple[str, ...]:
    """The channels of Table 10 that ought to be like this one."""
    return tuple(row["channel"] for row in table(10) if _kind(row["channel"]) == _kind(channel))


def _kind(channel: str) -> tuple[str, str, str]:
    axis = channel.split()[1]
    return design_of(channel), row_of(10, channel)["range"], "xy" if axis in "xy" else axis


def levels(channel: str) -> Floats:
    """Return the levels that a channel read with +Z up, at 25 degC, usual range and first state, on the days of Tables
    10, 11 (runs), 11 (continuous) and, but for thermometers, 8.
    """
    k = slope(channel)
    name, axis = channel.split()[0], axis_of(channel)
    other = float(gyro3_other_state_lsb()[axis]) if name == "Gyro3" and axis < 3 else 0.0
    runs = printed(11, channel, "runs_mean") - other * len(bias_states()[1].runs) / PARTS
    if name == "BMA1" and axis < 3:
        runs = float(np.delete(runs_of(name)[:, axis], [fault.run - 1 for fault in boot_faults()]).mean())
    result = [
        printed(10, channel, "z_up") - other - k * (FACES_DEGC[0] - REFERENCE_DEGC),
        runs - k * (DEGC[11, "runs_mean"] - REFERENCE_DEGC),
        printed(11, channel, "cont_mean") - k * (DEGC[11, "cont_mean"] - REFERENCE_DEGC),
    ]
    return np.array(result if axis == 3 else [*result, printed(8, channel, "intercept_lsb") + k * REFERENCE_DEGC])


@cache
def day_to_day(channel: str) -> float:
    """Standard deviation of a level from one experiment to another."""
    return sqrt(np.mean([levels(member).var(ddof=1) for member in group_of(channel)]))


@cache
def face_residual(channel: str) -> float:
    """Root mean square by which a pair of opposite faces disagrees with the mean of the three pairs.

    The model has four figures for six faces; each face is left with a third of its own variance.
    """
    squares = []
    for member in group_of(channel):
        faces = [printed(10, member, face) for face in READINGS[:6]]
        at_25 = np.array(faces) - slope(member) * (np.array(FACES_DEGC[:6]) - REFERENCE_DEGC)
        if member.endswith("t"):
            at_25 = np.repeat(at_25[[0, 2, 4]], 2)[[0, 2, 4, 1, 3, 5]]
        z_up, x_up, y_up, x_down, y_down, z_down = at_25
        pairs = np.array([x_up + x_down, y_up + y_down, z_up + z_down]) / 2
        squares.append(pairs.var())
    return sqrt(np.mean(squares))


@cache
def noise_residual(channel: str) -> float:
    """Root mean square of ln(standard deviation over its quadratic mean) in Tables 10 and 11 (three experiments)."""
    squares = []
    for member in group_of(channel):
        variances = np.array([printed(number, member, column) ** 2 for number, column in _STDS])
        squares.extend((np.log(variances / variances.mean()) / 2) ** 2)
    return sqrt(np.mean(squares))


@cache
def thermometer_residual(channel: str) -> float:
    """Root mean square by which a thermometer's mean in three experiments strays from a constant offset, codes."""
    return sqrt(np.mean([levels(member).var() for member in group_of(channel)]))


def log_deviation(windows: Floats, extra: float) -> float:
    """Standard deviation of ln s, s that of numbers with covariance `windows` (n, n) about steady differences whose
    variance is `extra`: half the relative spread of a quadratic form in normal numbers.
    """
    count = len(windows)
    middle = windows - windows.mean(axis=0)
    mean = np.trace(middle) / (count - 1)
    spread = 2 * np.trace(middle @ middle) + 4 * extra * (count - 1) * mean
    return float(np.sqrt(spread) / (count - 1) / (2 * (mean + extra)))


@cache
def run_windows(channel: str) -> Floats:
    """(15, 15) covariance of the means of separate runs that the model gives."""
    turn_on, in_run = own(channel, lambda unit: unit.turn_on), own(channel, lambda unit: unit.in_run)
    sem = printed(11, channel, "runs_sem")
    return np.asarray(np.eye(PARTS) * (turn_on**2 + in_run**2 * variance_of_mean(WINDOW_S) + sem**2))


@cache
def part_windows(channel: str) -> Floats:
    """(15, 15) covariance of the means of windows in a row that the model gives."""
    apart = np.abs(np.subtract.outer(np.arange(PARTS), np.arange(PARTS)))
    of_wander = np.array([variance_of_mean(WINDOW_S), *(covariance_of_means(k, WINDOW_S) for k in range(1, PARTS))])
    sem = printed(11, channel, "cont_sem")
    return np.asarray(own(channel, lambda unit: unit.in_run) ** 2 * of_wander[apart] + np.eye(PARTS) * sem**2)


def run_steps(channel: str) -> float:
    """Variance of the runs' means that is the same in every series: states, the faulty run, temperature."""
    name, axis = channel.split()[0], axis_of(channel)
    steady = (slope(channel) * DEGC[11, "runs_std_of_means"]) ** 2
    if axis == 3:
        return steady
    if name == "BMA1":
        runs = runs_of(name)[:, axis]
        (fault,) = boot_faults()
        return steady + float((runs[fault.run - 1] - np.delete(runs, fault.run - 1).mean()) ** 2) / PARTS
    if name == "Gyro3":
        second = len(bias_states()[1].runs)
        share = second * (PARTS - second) / (PARTS * (PARTS - 1))
        return steady + float(gyro3_other_state_lsb()[axis] ** 2) * share
    return steady


def part_steps(channel: str) -> float:
    """The same for windows in a row: temperature."""
    return (slope(channel) * DEGC[11, "cont_std_of_means"]) ** 2


@cache
def between_units(channel: str, column: str) -> float:
    """Standard deviation of the logarithms of a column of Table 11 over the units of a group."""
    return float(np.std([log(printed(11, member, column)) for member in group_of(channel)], ddof=1))


def level_parts(channel: str) -> tuple[dict[str, float], float]:
    """Return the error of a level with +Z up on another day than Table 10's: its parts, and the share of their variance
    that all such levels of the channel have in common (that day's, and the face's against the fit).
    """
    days, face = day_to_day(channel), face_residual(channel)
    parts = {"day-to-day": sqrt(2) * days, "face repeatability": face}
    return parts, (days**2 + face**2) / (2 * days**2 + face**2)
