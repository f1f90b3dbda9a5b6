"""Drawings for the report: fused against single sensors. Drawn without a display; colours that the colour-blind can
tell apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from imuarray.arrays import Reals
from imuarray.figures import PALETTE, new_figure
from imuarray.printable import listed

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def drift_figure(
    time_s: Reals,
    single: Mapping[str, Reals],
    fused: Mapping[str, Reals],
    unit: str,
    temperature: tuple[Reals, Reals] | None,
) -> Figure:
    """Slow errors (n,) of single sensors and of fused results over time, with the temperature (time, degC) below
    them.
    """
    figure = new_figure(8.0, 5.2)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    for number, values in enumerate(single.values()):
        upper.plot(
            time_s,
            values,
            color=PALETTE[0],
            linewidth=1.0,
            label=None if number else f"each alone: {listed(list(single))}",
        )
    for colour, (name, values) in zip(PALETTE[1:], fused.items(), strict=False):
        upper.plot(time_s, values, color=colour, linewidth=1.8, label=name)
    upper.axhline(0, color="black", linewidth=0.6)
    upper.set_ylabel(f"error ({unit})")
    upper.legend(frameon=False, fontsize=9, loc="best")
    if temperature is not None:
        lower.plot(*temperature, color=PALETTE[2], linewidth=1.2)
    lower.set_ylabel("temperature (°C)")
    lower.set_xlabel("time (s)")
    return figure


def motion_figure(
    felt: tuple[Reals, Reals], times_s: Mapping[str, Reals], errors_mg: Mapping[str, Reals], end_of_range_g: float
) -> Figure:
    """Return a motion (time, g) that leaves the low range, and below it the errors (n,) of several results at
    their times.
    """
    figure = new_figure(8.0, 5.6)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
    upper.plot(*felt, color="black", linewidth=1.0)
    for limit in (-end_of_range_g, end_of_range_g):
        upper.axhline(limit, color=PALETTE[2], linewidth=0.9, linestyle="--")
    upper.set_ylabel("truth (g)")
    for colour, (name, values) in zip((PALETTE[0], PALETTE[2], PALETTE[1]), errors_mg.items(), strict=False):
        lower.plot(times_s[name], values, color=colour, linestyle="none", marker=".", markersize=4, label=name)
    lower.set_ylabel("error (mg)")
    lower.set_xlabel("time (s)")
    lower.legend(frameon=False, fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return figure


def ratio_figure(labels: Sequence[str], ratios: Sequence[float], errors: Sequence[float]) -> Figure:
    """Error over that of the average, a dot a line, with two standard errors; left of 1 is better."""
    figure = new_figure(8.0, 0.8 + 0.24 * len(labels))
    axes = figure.subplots()
    rows = np.arange(len(labels))[::-1]
    better = [ratio < 1 - 2 * error for ratio, error in zip(ratios, errors, strict=True)]
    colours = [PALETTE[1] if flag else PALETTE[0] for flag in better]
    axes.errorbar(ratios, rows, xerr=2 * np.asarray(errors), fmt="none", ecolor=PALETTE[0], elinewidth=1)
    axes.scatter(ratios, rows, color=colours, zorder=3, s=22)
    axes.axvline(1, color="black", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_xticks([0.1, 0.2, 0.5, 1.0, 1.2], ["0.1", "0.2", "0.5", "1", "1.2"])
    axes.minorticks_off()
    axes.set_ylim(-0.7, len(labels) - 0.3)
    axes.set_yticks(rows, labels, fontsize=8)
    axes.set_xlabel("error over that of the simple average of the same sensors")
    axes.grid(axis="x", linewidth=0.4, alpha=0.6)
    return figure


def course_figure(time_s: Reals, triad: Reals, label: str) -> Figure:
    """Return a triad (n, 3) over time, a panel for each box axis."""
    figure = new_figure(8.0, 4.6)
    panels = figure.subplots(3, 1, sharex=True)
    for axis, panel in enumerate(panels):
        panel.plot(time_s, triad[:, axis], color=PALETTE[1 + axis], linewidth=0.9)
        panel.set_ylabel("XYZ"[axis], rotation=0, labelpad=12)
        panel.grid(linewidth=0.4, alpha=0.6)
    panels[-1].set_xlabel("time (s)")
    figure.suptitle(label, fontsize=10.5, x=0.02, ha="left")
    return figure
