"""Tables 2, 8 and 9, the figures and what the text says: statistic by statistic.

What the paper gives as "around" or "about" is taken to be good to a unit of its last digit either way, evenly: a
deviation of 1 / sqrt(3) of it. Yes and no (codes all even, a line or none) have no spread: a wrong one counts as
three uncertainties.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from math import hypot, isnan, log, sqrt
from typing import NamedTuple

import numpy as np

from imuarray.paper.model_units import unit_of
from imuarray.paper.noise import HIGH_RATE_HZ
from imuarray.paper.replica.experiments import BOOTS, Observed, array_rate_hz, high_rate_s
from imuarray.paper.replica.spread import (
    level_parts,
    noise_residual,
    own,
    printed,
    slope,
    thermometer_residual,
)
from imuarray.paper.replica.statistic import Statistic, linear, logarithmic
from imuarray.paper.replica.tabulate import Table, line_hz, neighbour_correlation, period
from imuarray.paper.startup import bias_states, boot_faults
from imuarray.paper.tables import number_in, table
from imuarray.paper.wander import PARTS, TIME_CONSTANT_S, variance_of_mean
from imuarray.simulate.motion.heating import Heating

DPS_AT_250 = 0.00875
"""One count at 250 dps (L3G-40)."""

_AROUND = 1 / sqrt(3)
_HALF_A_DIGIT = 0.5 / sqrt(3)
_FAST_NOISE = sqrt(110 / 35 * 1.4 / 0.6)
"""The mean's noise at 110 Hz over that of as many independent readings at 35 Hz: neighbours correlate by 0.4."""
_A3_STDS = {"x": 8.0201, "y": 9.8857, "z": 9.3002}
"""Appendix A.3: LSB of a BMA180 at 16 g, which one isn't said."""


class _Heated(NamedTuple):
    """The heating: mean temperature; deviation of a fitted slope from unit white noise and from a unit in-run wander,
    per degC; that of the mean from a unit wander.
    """

    degc: float
    of_noise: float
    of_wander: float
    level_of_wander: float


def eight(simulated: Table) -> Iterator[Statistic]:
    """Table 8."""
    heated = _heated()
    for row in table(8):
        for column, compare in (("slope_lsb_per_degc", _slope), ("intercept_lsb", _intercept)):
            channel, published = row["channel"], float(number_in(row, column))
            yield compare(heated, channel, published, simulated[channel][column])


def _slope(heated: _Heated, channel: str, published: float, simulated: float) -> Statistic:
    parts = _tilts(heated, channel) | {"rounding": 0.001 * _HALF_A_DIGIT}
    return replace(linear(("Table 8", channel, "slope_lsb_per_degc"), published, simulated, parts), fitted=True)


def _intercept(heated: _Heated, channel: str, published: float, simulated: float) -> Statistic:
    days, share = level_parts(channel)
    own_boot = {
        "turn-on": own(channel, lambda unit: unit.turn_on),
        "slope": heated.degc * hypot(*_tilts(heated, channel).values()),
        "in-run": own(channel, lambda unit: unit.in_run) * heated.level_of_wander,
    }
    found = linear(("Table 8", channel, "intercept_lsb"), published, simulated, days | own_boot)
    common = share * (hypot(*days.values()) / found.uncertainty) ** 2
    return replace(found, group=f"{channel}, other days", shared=common)


def _tilts(heated: _Heated, channel: str) -> dict[str, float]:
    """What the simulated slope is off by; the model has the printed one."""
    return {
        "in-run": heated.of_wander * own(channel, lambda unit: unit.in_run),
        "sem": heated.of_noise * own(channel, lambda unit: unit.noise),
    }


@cache
def _heated() -> _Heated:
    """From the temperature every half minute."""
    motion = Heating()
    seconds = np.arange(0.0, motion.seconds, 30.0)
    degc = np.asarray(motion.felt((seconds * 1e9).astype(np.int64)).temperature_degc, float)
    away = degc - degc.mean()
    weights = away / (away**2).sum()
    wander = np.exp(-np.abs(np.subtract.outer(seconds, seconds)) / TIME_CONSTANT_S)
    of_noise = 1 / sqrt(array_rate_hz(10) * motion.seconds) / float(degc.std())
    level = sqrt(variance_of_mean(motion.seconds))
    return _Heated(float(degc.mean()), of_noise, sqrt(float(weights @ wander @ weights)), level)


def nine(number: int, simulated: Table) -> Iterator[Statistic]:
    """Table 9, or Table 2, which prints the same means and deviations; the upper half is at 250 dps."""
    rows = table(number)
    for index, row in enumerate(rows):
        name = "250dps" if index < len(rows) / 2 else "2k dps"
        for column in (column for column in ("mean_lsb", "sem_lsb", "std_lsb") if column in row):
            found = simulated[f"{row['output']} {name}"][column]
            statistic = _nine(number, row["output"], name, column, float(number_in(row, column)), found)
            yield replace(statistic, derived=statistic.derived or number == 2)


def _nine(number: int, channel: str, name: str, column: str, published: float, simulated: float) -> Statistic:
    at = (f"Table {number}", f"{channel} {name}", column)
    if column != "mean_lsb":
        spread = noise_residual(channel) * sqrt(2)  # of a fourth experiment against the mean of three
        other = 0.0 if channel.endswith("t") else _between_filters()
        found = logarithmic(at, published, simulated, {"between experiments": spread, "filters": other})
        return replace(found, derived=column == "sem_lsb")
    if channel.endswith("t"):
        return replace(linear(at, published, simulated, {"day-to-day": thermometer_residual(channel)}), fitted=True)
    boot = {
        "turn-on": own(channel, lambda unit: unit.turn_on),
        "in-run": own(channel, lambda unit: unit.in_run) * sqrt(variance_of_mean(high_rate_s(name))),
        "sem": own(channel, lambda unit: unit.noise) * _FAST_NOISE / sqrt(HIGH_RATE_HZ * high_rate_s(name)),
    }
    if name == "250dps":
        coarser = unit_of("Gyro1").lsb / DPS_AT_250  # counts are that much smaller
        parts = {part: size * coarser for part, size in boot.items()}
        return replace(linear(at, published, simulated, parts), fitted=True)
    days, share = level_parts(channel)
    warmth = {"temperature": slope(channel) * thermometer_residual("Gyro1 t")}
    found = linear(at, published, simulated, boot | days | warmth)
    common = share * (hypot(*days.values()) / found.uncertainty) ** 2
    return replace(found, group=f"{channel}, other days", shared=common)


def _between_filters() -> float:
    """Standard deviation over the axes of ln(noise at 110 Hz over that in the array runs), Tables 9 (2000 dps), 10, 11.

    The model has the root of the ratio of the bandwidths for all of them.
    """
    rows = [row for row in table(9) if row["range"] == "2k dps"]
    noise = [own(row["output"], lambda unit: unit.noise) for row in rows]
    ratios = [log(float(number_in(row, "std_lsb")) / own_noise) for row, own_noise in zip(rows, noise, strict=True)]
    return float(np.std(ratios, ddof=1))


def figures(observed: Observed) -> Iterator[Statistic]:
    """Figures 13 and 14 (Gyro1 at 250 dps)."""
    counts = observed.high_rate["250dps"].counts
    neighbours = neighbour_correlation(counts)
    for i, axis in enumerate("xyz"):
        at = ("Figure 13", f"Gyro1 {axis}", "correlation of neighbours")
        yield replace(linear(at, 0.4, float(neighbours[i]), {"around": 0.1 * _AROUND}), fitted=True)
    yield linear(("Figure 13", "Gyro1 y", "period, samples"), 6.0, float(period(counts, 1)), {"around": _AROUND})
    for i, axis in enumerate("xyz"):
        hz = line_hz(counts, i)
        yield _yes_or_no(("Figure 14", f"Gyro1 {axis}", "line near 50 Hz"), float(axis == "y"), float(not isnan(hz)))
        if axis == "y":
            at = ("Figure 14", "Gyro1 y", "line, Hz")
            yield replace(linear(at, 50.0, 0.0 if isnan(hz) else hz, {"around": 10 * _AROUND}), fitted=True)


def text(observed: Observed, ten: Table, six: Table) -> Iterator[Statistic]:
    """Appendices A.2 and A.3, and sections 5.2.4's two odd sensors."""
    for name, share in observed.even.items():
        yield _yes_or_no(("Appendix A.2", name, "all codes even"), 1.0, float(share == 1.0))
    for axis, std in _A3_STDS.items():
        first, second = (ten[f"{name} {axis}"]["std_lsb"] for name in ("BMA1", "BMA2"))
        units = abs(log(printed(10, f"BMA1 {axis}", "std_lsb") / printed(10, f"BMA2 {axis}", "std_lsb"))) / sqrt(2)
        days = noise_residual(f"BMA1 {axis}") * sqrt(2)
        at = ("Appendix A.3", f"BMA1, BMA2 {axis}", "std_lsb")
        yield logarithmic(at, std, sqrt(first * second), {"between units": units, "between experiments": days})
    yield _reset(six)
    second = len(bias_states()[1].runs) / PARTS
    yield _share(("Table 7", "Gyro3", "share of runs in second state"), second, observed.second / BOOTS)
    faulty = len(boot_faults()) / PARTS
    yield _share(("Table 6", "BMA1", "share of faulty runs"), faulty, observed.faulty / BOOTS)


def _reset(six: Table) -> Statistic:
    """By how many times more the faulty run shows gravity."""
    (fault,) = boot_faults()
    others = np.mean([row["z_lsb"] for run, row in six.items() if int(run) != fault.run])
    printed_others = np.mean([float(number_in(row, "z_lsb")) for row in table(6) if int(row["run"]) != fault.run])
    scatter = sqrt(2) * own("BMA1 z", lambda unit: np.hypot(unit.turn_on, unit.in_run)) / float(printed_others) * 8
    values = float(fault.reading_lsb) / float(printed_others), six[str(fault.run)]["z_lsb"] / float(others)
    found = linear(("Table 6", "BMA1 z", f"run {fault.run} over the others"), *values, {"turn-on and in-run": scatter})
    return replace(found, derived=True, fitted=True)


def _share(at: tuple[str, str, str], published: float, simulated: float) -> Statistic:
    """The model has the printed share; the simulated one is a binomial number of `BOOTS`."""
    spread = sqrt(published * (1 - published) / BOOTS)
    return replace(linear(at, published, simulated, {"binomial": spread}), fitted=True)


def _yes_or_no(at: tuple[str, str, str], published: float, simulated: float) -> Statistic:
    return replace(linear(at, published, simulated, {"yes or no": 1 / 3}), fitted=True)
