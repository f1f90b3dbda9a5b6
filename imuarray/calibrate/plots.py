"""Tables and figures of a calibration in mg and dps, every estimate with its standard error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from imuarray.arrays import Floats, Reals
from imuarray.errors import CalibrationError
from imuarray.figures import PALETTE, estimates_figure, new_figure
from imuarray.html_table import number
from imuarray.units import READABLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from imuarray.calibrate.model import Calibration, SensorCalibration


_LABELS: Mapping[str, str] = MappingProxyType(
    {
        "bias": "bias",
        "noise": "noise of single readings, rms",
        "thermal": "slope of the bias per degree Celsius",
        "turn_on": "change of the bias from run to run, rms",
    }
)
"""Title of each group, in the order in which the default is chosen."""


def calibration_figure(calibration: Calibration, group: str | None = None) -> Figure:
    """Plot one group of figures of all sensors, one panel per unit (mg or dps); CalibrationError for a group that does
    not exist or was not measured, MissingExtraError without matplotlib.
    """
    if group is not None and group not in _LABELS:
        raise CalibrationError(f"group {group!r}: allowed are {', '.join(_LABELS)}")
    groups = [name for name in _LABELS if any(_estimates(s, name) is not None for s in calibration.sensors.values())]
    if not groups or (group is not None and group not in groups):
        raise CalibrationError(
            f"{group or 'bias'} was not measured; the calibration contains {', '.join(groups) or 'nothing'}"
        )
    shown_group = group or groups[0]
    axes = [
        (name, unit, per_count * float(value[axis]), np.nan if sem is None else per_count * float(sem[axis]))
        for sensor, axis, name, unit, per_count in readable_axes(calibration)
        for value, sem in filter(None, [_estimates(sensor, shown_group)])
    ]
    labels, units, values, errors = map(list, zip(*axes, strict=True))
    return estimates_figure(labels, values, errors, units, _LABELS[shown_group])


def readable_axes(calibration: Calibration) -> Iterator[tuple[SensorCalibration, int, str, str, float]]:
    """Yield every axis: its sensor, number and name, its unit (mg or dps), and that unit per count."""
    for sensor in calibration.sensors.values():
        factor, unit = READABLE[sensor.unit]
        for axis, letter in enumerate("xyz"):
            yield sensor, axis, f"{sensor.name} {letter}", unit, float(factor / sensor.scale_lsb_per_unit[axis])


def bias_rows(calibration: Calibration) -> Iterator[tuple[str, ...]]:
    """Yield axis, unit, bias, its standard error, counts per unit and noise; "–" if not known."""
    for sensor, axis, name, unit, per_count in readable_axes(calibration):
        figures = (sensor.bias_lsb, sensor.bias_sem_lsb, sensor.noise_lsb)
        bias, sem, noise = (number(np.nan if lsb is None else float(lsb[axis]) * per_count) for lsb in figures)
        yield name, unit, bias, sem, number(float(sensor.scale_lsb_per_unit[axis]), 5), noise


def slope_rows(calibration: Calibration) -> Iterator[tuple[str, ...]]:
    """Yield axis, unit, slope, its standard error, lag, and the meaning of the slope."""
    for sensor, axis, name, unit, per_count in readable_axes(calibration):
        if (thermal := sensor.thermal) is not None:
            figures = (thermal.slope_lsb_per_degc, thermal.slope_sem_lsb_per_degc)
            slope, sem = (number(float(lsb[axis]) * per_count) for lsb in figures)
            yield name, unit, slope, sem, number(thermal.significant_lag_s, 3), thermal.meaning[axis]


def turn_on_rows(calibration: Calibration) -> Iterator[tuple[str, ...]]:
    """Yield axis, unit, rms from run to run, its standard error, runs, states and the p-value of no change."""
    for sensor, axis, name, unit, per_count in readable_axes(calibration):
        if (turn_on := sensor.turn_on) is not None:
            rms, sem = (number(float(lsb[axis]) * per_count) for lsb in (turn_on.rms_lsb, turn_on.rms_sem_lsb))
            counted = str(turn_on.runs), str(max(1, len(turn_on.states))), number(float(turn_on.p_value[axis]), 2)
            yield name, unit, rms, sem, *counted


def _estimates(sensor: SensorCalibration, group: str) -> tuple[Floats, Floats | None] | None:
    """Return a group's figure and its standard error, in counts; None if it was not measured."""
    if group == "bias" and sensor.bias_sem_lsb is not None:
        return sensor.bias_lsb, sensor.bias_sem_lsb
    if group == "noise" and sensor.noise_lsb is not None:
        return sensor.noise_lsb, sensor.noise_sem_lsb
    if group == "thermal" and sensor.thermal is not None:
        return sensor.thermal.slope_lsb_per_degc, sensor.thermal.slope_sem_lsb_per_degc
    if group == "turn_on" and sensor.turn_on is not None:
        return sensor.turn_on.rms_lsb, sensor.turn_on.rms_sem_lsb
    return None


def residual_figure(sensors: Sequence[str], poses: Sequence[str], residual_mg: Reals) -> Figure:
    """Plot residuals (sensors, poses) in mg: one row per sensor, one dot per pose."""
    figure = new_figure(8.0, 1.6 + 0.35 * len(sensors))
    axes = figure.subplots()
    span = max(float(np.nanmax(np.abs(residual_mg), initial=0.0)), 0.1)
    for row, values in enumerate(residual_mg):
        axes.axhline(row, color=PALETTE[0], linewidth=0.5)
        axes.scatter(values, np.full(len(values), row), s=26, alpha=0.75, color=PALETTE[1], zorder=3)
    axes.axvline(0, color="black", linewidth=0.8)
    axes.set_xlim(-1.15 * span, 1.15 * span)
    axes.set_ylim(len(sensors) - 0.4, -0.6)
    axes.set_yticks(range(len(sensors)), sensors)
    axes.set_xlabel(f"length of the specific force less 1 g (mg), a dot for each of {len(poses)} poses")
    axes.grid(axis="x", linewidth=0.4, alpha=0.6)
    return figure
