"""Tables 5, 6, 7 and 11: runs and windows of five minutes, statistic by statistic.

A level on another day than Table 10's is off by what days differ by, twice: that day and this. A deviation of fifteen
means scatters by itself; where the model was fitted to the printed one that counts on the simulated side only, where
nothing of it was left to fit (the model has 0) on both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import hypot, sqrt

from imuarray.paper.replica.spread import (
    RANGE_OVER_DEVIATION,
    axis_of,
    between_units,
    level_parts,
    log_deviation,
    noise_residual,
    own,
    part_steps,
    part_windows,
    printed,
    run_steps,
    run_windows,
    thermometer_residual,
)
from imuarray.paper.replica.statistic import Statistic, linear, logarithmic
from imuarray.paper.replica.tabulate import Table
from imuarray.paper.stability import group_members
from imuarray.paper.startup import boot_faults
from imuarray.paper.tables import number_in, table
from imuarray.paper.wander import PARTS, WINDOW_S, variance_of_mean

_RESET_RATIO = 8.0
"""Counts per g at 2 g over those at 16 g."""


def eleven(simulated: Table) -> Iterator[Statistic]:
    """Table 11."""
    for row in table(11):
        channel, found = row["channel"], simulated[row["channel"]]
        spreads = {half: deviation_spread(channel, half) for half in ("runs", "cont")}
        for half, spread in spreads.items():
            yield _mean(channel, half, found[f"{half}_mean"])
            for column in (f"{half}_sem", f"{half}_std"):
                values = printed(11, channel, column), found[column]
                noise = logarithmic(
                    ("Table 11", channel, column), *values, {"between experiments": noise_residual(channel)}
                )
                yield replace(noise, derived=column.endswith("sem"), fitted=True)
            yield _deviation(channel, half, found[f"{half}_std_of_means"], spread)
            yield _range(channel, half, found[f"{half}_range_of_means"], spread)
        both = {"runs": spreads["runs"], "windows": spreads["cont"]}
        ratio = logarithmic(("Table 11", channel, "ratio"), printed(11, channel, "ratio"), found["ratio"], both)
        yield replace(ratio, derived=True, fitted=True)


def five(simulated: Table) -> Iterator[Statistic]:
    """Table 5."""
    for row in table(5):
        members = [member["channel"] for member in group_members(row["group"])]
        sizes = [printed(11, member, "cont_std_of_means") for member in members]
        errors = [size * deviation_spread(member, "cont") for member, size in zip(members, sizes, strict=True)]
        spread = sqrt(sum(error**2 for error in errors)) / sum(sizes)
        column = "std_of_5min_means_lsb"
        at = ("Table 5", row["group"], column)
        found = logarithmic(
            at, float(number_in(row, column)), simulated[row["group"]][column], {"scatter of fifteen": spread}
        )
        yield replace(found, derived=True, fitted=True)


def by_run(number: int, name: str, simulated: Table) -> Iterator[Statistic]:
    """Tables 6 (BMA1) and 7 (Gyro3): every run's means."""
    faulty = {fault.run for fault in boot_faults()} if name == "BMA1" else set()
    for row in table(number):
        run = int(row["run"])
        for axis, column in zip("xyzt", ("x_lsb", "y_lsb", "z_lsb", "temp_int"), strict=True):
            at = (f"Table {number}", f"{name} {axis}", f"run {run}")
            values = float(number_in(row, column)), simulated[row["run"]][column]
            yield _one_run(at, *values, _RESET_RATIO if run in faulty and axis != "t" else 1.0)


def deviation_spread(channel: str, half: str) -> float:
    """Standard deviation of ln(simulated / published) for a deviation of fifteen means of Table 11."""
    if axis_of(channel) == 3:  # chips follow the room each in its way
        return between_units(channel, f"{half}_std_of_means")
    if half == "cont":
        spread = log_deviation(part_windows(channel), part_steps(channel))
    else:
        spread = hypot(log_deviation(run_windows(channel), run_steps(channel)), _step_of_fault(channel))
    return spread * (1.0 if _is_fitted(channel, half) else sqrt(2))


def _step_of_fault(channel: str) -> float:
    """How uncertain the faulty run's distance from the others is, as a share of it; 0 where there is none.

    Seven times what a day moves them by, eight times what a run does.
    """
    if not channel.startswith("BMA1"):
        return 0.0
    parts, _ = level_parts(channel)
    days = (_RESET_RATIO - 1) * hypot(*parts.values())
    run = _RESET_RATIO * sqrt(float(run_windows(channel)[0, 0]))
    return hypot(days, run) / sqrt(run_steps(channel) * PARTS)


def _is_fitted(channel: str, half: str) -> bool:
    """Whether the model has something of its own for this deviation."""
    return axis_of(channel) < 3 and own(channel, lambda unit: unit.turn_on if half == "runs" else unit.in_run) > 0


def _is_derived(channel: str, half: str) -> bool:
    """Whether Table 6 or 7 prints the runs one by one."""
    return half == "runs" and channel.split()[0] in ("BMA1", "Gyro3")


def _mean(channel: str, half: str, simulated: float) -> Statistic:
    column = f"{half}_mean"
    at, published = ("Table 11", channel, column), printed(11, channel, column)
    if axis_of(channel) == 3:
        found = linear(at, published, simulated, {"day-to-day": thermometer_residual(channel)})
        return replace(found, fitted=True, derived=_is_derived(channel, half))
    windows = run_windows(channel) if half == "runs" else part_windows(channel)
    own_boot = 0.0 if half == "runs" else own(channel, lambda unit: unit.turn_on)
    factor = (PARTS - 1 + _RESET_RATIO) / PARTS if channel.startswith("BMA1") and half == "runs" else 1.0
    parts, share = level_parts(channel)
    days = {name: part * factor for name, part in parts.items()}
    wander = {"in-run and sem": float(sqrt(windows.sum())) / PARTS, "turn-on": own_boot}
    found = linear(at, published, simulated, days | wander)
    common = share * (hypot(*days.values()) / found.uncertainty) ** 2
    return replace(found, group=f"{channel}, other days", shared=common, derived=_is_derived(channel, half))


def _deviation(channel: str, half: str, simulated: float, spread: float) -> Statistic:
    column = f"{half}_std_of_means"
    values = printed(11, channel, column), simulated
    found = logarithmic(("Table 11", channel, column), *values, _scatter(channel, spread))
    return replace(found, fitted=_is_fitted(channel, half), derived=_is_derived(channel, half))


def _scatter(channel: str, spread: float) -> dict[str, float]:
    return {"between units" if axis_of(channel) == 3 else "scatter of fifteen": spread}


def _range(channel: str, half: str, simulated: float, spread: float) -> Statistic:
    column = f"{half}_range_of_means"
    values = printed(11, channel, column), simulated
    shape = sqrt(2) * RANGE_OVER_DEVIATION
    found = logarithmic(
        ("Table 11", channel, column), *values, _scatter(channel, spread) | {"range over deviation": shape}
    )
    return replace(found, derived=True)


def _one_run(at: tuple[str, str, str], published: float, simulated: float, ratio: float) -> Statistic:
    channel = at[1]
    if axis_of(channel) == 3:
        offset = thermometer_residual(channel)
        parts = {"day-to-day": offset, "in-run": printed(11, channel, "cont_std_of_means")}
        found = linear(at, published, simulated, parts)
        return replace(found, group=f"{channel}, {at[0]}", shared=(offset / found.uncertainty) ** 2, fitted=True)
    days = {name: part * ratio for name, part in level_parts(channel)[0].items()}
    twice = sqrt(2) * ratio
    parts = {
        "turn-on": twice * own(channel, lambda unit: unit.turn_on),
        "in-run": twice * own(channel, lambda unit: unit.in_run) * sqrt(variance_of_mean(WINDOW_S)),
        "sem": twice * printed(11, channel, "runs_sem"),
    }
    found = linear(at, published, simulated, days | parts)
    return replace(found, group=f"{channel}, other days", shared=(hypot(*days.values()) / found.uncertainty) ** 2)
