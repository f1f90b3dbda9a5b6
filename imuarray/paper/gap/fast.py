"""What high-rate experiments, figures and appendices would show of an array (Tables 2 and 9, appendix A)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import hypot, isnan, sqrt

import numpy as np

from imuarray.paper.gap.acting import FACES_MEAN_DEGC
from imuarray.paper.gap.sensor import Array, Sensor, fast_noise
from imuarray.paper.model_units import high_rate_degc
from imuarray.paper.noise import HIGH_RATE_HZ
from imuarray.paper.replica.experiments import high_rate_s
from imuarray.paper.replica.spread import noise_residual, thermometer_residual
from imuarray.paper.replica.statistic import Statistic
from imuarray.paper.tables import number_in, table
from imuarray.paper.wander import variance_of_mean

AROUND = 1 / sqrt(3)
"""A figure that is "around" or "about" is good to a unit of its last digit either way, evenly."""
DPS_AT_250 = 0.00875
_A3_LSB = (8.0201, 9.8857, 9.3002)
"""Appendix A.3: a BMA180 at 16 g, which one isn't said."""


def expected_fast(array: Array) -> tuple[Statistic, ...]:
    """Every such statistic, the printed one beside what this array makes of it. A yes or no counts three deviations."""
    return (*_nine(array["Gyro1"]), *_figures(array["Gyro1"]), *_even(array), *_another_bma180(array))


def _nine(sensor: Sensor) -> Iterator[Statistic]:
    """Its bias at 250 dps is fitted: only the deviations tell."""
    for number in (2, 9):
        rows = [row for row in table(number) if not row["output"].endswith("t")]
        for index, row in enumerate(rows):
            name, axis = ("250dps", "2k dps")[index >= 3], index % 3
            lsb = DPS_AT_250 if name == "250dps" else sensor.lsb
            own = hypot(float(fast_noise(sensor)[axis]) * sensor.lsb / lsb, sqrt(1 / 12))
            at = (f"Table {number}", f"{row['output']} {name}")
            spread = noise_residual(row["output"]) * sqrt(2)
            deviation = Statistic(
                *at, "std_lsb", float(number_in(row, "std_lsb")), own, spread, "between experiments", "log"
            )
            yield replace(deviation, derived=number == 2)
            if name == "2k dps":
                yield replace(_mean(sensor, axis, at, float(number_in(row, "mean_lsb"))), derived=number == 2)


def _mean(sensor: Sensor, axis: int, at: tuple[str, str], value: float) -> Statistic:
    """With +X up, at the temperature that its own thermometer tells."""
    warm = high_rate_degc("2k dps") - FACES_MEAN_DEGC
    own = sensor.level[axis] + sensor.response[axis, 0] + sensor.slope[axis] * warm
    wander = sensor.in_run[axis] ** 2 * (variance_of_mean(high_rate_s("2k dps")) + variance_of_mean(5400.0))
    white = fast_noise(sensor)[axis] ** 2 / (HIGH_RATE_HZ * high_rate_s("2k dps"))
    unknown = hypot(sensor.slope_sd[axis] * warm, sensor.slope[axis] * thermometer_residual("Gyro1 t"))
    sd = sqrt(2 * sensor.turn_on[axis] ** 2 + wander + white + unknown**2)
    return Statistic(*at, "mean_lsb", value, float(own), float(sd), "chance and population")


def _figures(sensor: Sensor) -> Iterator[Statistic]:
    for i, axis in enumerate("xyz"):
        at = ("Figure 13", f"Gyro1 {axis}", "correlation of neighbours")
        yield Statistic(*at, 0.4, float(sensor.neighbours[i]), 0.1 * AROUND, "around")
        line = float(sensor.line_hz[i])
        yield _yes_or_no(("Figure 14", f"Gyro1 {axis}", "line near 50 Hz"), float(i == 1), float(not isnan(line)))
        if i == 1:
            yield _around(("Figure 14", "Gyro1 y", "line, Hz"), 50.0, line, 10 * AROUND)
            yield _around(("Figure 13", "Gyro1 y", "period, samples"), 6.0, HIGH_RATE_HZ / line, AROUND)


def _even(array: Array) -> Iterator[Statistic]:
    for name in ("ADXL1", "ADXL2"):
        even = float(array[name].step % 2 == 0)
        yield _yes_or_no(("Appendix A.2", name, "all codes even"), 1.0, even)


def _another_bma180(array: Array) -> Iterator[Statistic]:
    for i, value in enumerate(_A3_LSB):
        both = [float(array[name].rounded_noise[i]) for name in ("BMA1", "BMA2")]
        channel = f"BMA1, BMA2 {'xyz'[i]}"
        units = abs(float(np.diff(np.log(both))[0])) / sqrt(2)
        spread = hypot(units, noise_residual(f"BMA1 {'xyz'[i]}") * sqrt(2))
        yield Statistic(
            "Appendix A.3", channel, "std_lsb", value, sqrt(both[0] * both[1]), spread, "between units", "log"
        )


def _around(at: tuple[str, str, str], published: float, simulated: float, sd: float) -> Statistic:
    """Of a line; none counts three deviations."""
    if isnan(simulated):
        return Statistic(*at, published, 0.0, published / 3, "no line")
    return Statistic(*at, published, simulated, sd, "around")


def _yes_or_no(at: tuple[str, str, str], published: float, simulated: float) -> Statistic:
    return Statistic(*at, published, simulated, 1 / 3, "yes or no")
