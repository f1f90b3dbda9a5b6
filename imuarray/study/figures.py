"""Drawings of the study: ratios with intervals, and the errors of a heated box over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from imuarray.fuse import technique_names
from imuarray.report.figures import PALETTE, new_figure
from imuarray.study.runs import CAUSAL, OPTIMAL_CAUSAL, SMOOTHED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from imuarray.fuse import Ratio
    from imuarray.study.study import Row

Floats = npt.NDArray[np.floating[Any]]

_MARKERS = "osD^vPX*"


def ratios_figure(panels: Mapping[str, Sequence[Row]], of: str) -> Figure:
    """A panel for each heading, a row an experiment, a mark a technique: its `over_mean` or `over_bound` (`of`) with
    its interval.
    """
    figure = new_figure(9.0, 1.6 + 0.62 * max(len({row.experiment for row in rows}) for rows in panels.values()))
    drawn = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    techniques = list(dict.fromkeys((*technique_names(), OPTIMAL_CAUSAL, CAUSAL, SMOOTHED)))
    for axes, (heading, rows) in zip(drawn, panels.items(), strict=True):
        _panel(axes, heading, rows, techniques, of)
    drawn[0].invert_yaxis()
    shown = [marks for axes in drawn for marks in zip(*axes.get_legend_handles_labels(), strict=True)]
    found = {label: handle for handle, label in shown}
    named = {technique: found[technique] for technique in techniques if technique in found}
    figure.legend(named.values(), named, loc="outside upper center", ncols=7, frameon=False, fontsize=9)
    words = {"over_mean": "error over that of the simple average", "over_bound": "error over the causal bound"}
    figure.supxlabel(words[of], fontsize=10)
    return figure


def _panel(axes: Axes, heading: str, rows: Sequence[Row], techniques: Sequence[str], of: str) -> None:
    experiments = list(dict.fromkeys(row.experiment for row in rows))
    for number, technique in enumerate(techniques):
        mine = [row for row in rows if row.technique == technique]
        if not mine:
            continue
        places = [experiments.index(row.experiment) + 0.7 * ((number + 0.5) / len(techniques) - 0.5) for row in mine]
        ratios = [ratio for row in mine if (ratio := getattr(row, of)) is not None]
        colour = PALETTE[number % len(PALETTE)]
        axes.errorbar(
            [ratio.ratio for ratio in ratios], places, xerr=_reach(ratios), fmt=_MARKERS[number % len(_MARKERS)],
            color=colour, markersize=5, elinewidth=1.2, capsize=2, label=technique,
        )  # fmt: skip
    axes.axvline(1, color="black", linewidth=0.8)
    axes.set_yticks(range(len(experiments)), experiments)
    axes.set_title(heading, fontsize=10)
    axes.grid(axis="x", linewidth=0.4, alpha=0.6)


def _reach(ratios: Sequence[Ratio]) -> Floats:
    """(2, n) how far intervals reach to both sides; nowhere where there is none."""
    low = [ratio.ratio - ratio.low for ratio in ratios]
    high = [ratio.high - ratio.ratio for ratio in ratios]
    return np.asarray(np.maximum(np.nan_to_num(np.array([low, high])), 0.0))


def heating_figure(
    time_s: Floats, curves: Mapping[str, Sequence[Floats]], temperature: tuple[Floats, Floats], unit: str
) -> Figure:
    """Ten-second means of the errors along box X, Y and Z of some techniques (three (n,) each), and the temperature."""
    figure = new_figure(9.0, 7.0)
    drawn = figure.subplots(4, 1, sharex=True, height_ratios=(3, 3, 3, 2))
    for axis, axes in enumerate(drawn[:3]):
        for number, (technique, values) in enumerate(curves.items()):
            colour = PALETTE[number % len(PALETTE)]
            axes.plot(time_s, values[axis], color=colour, linewidth=1.6, label=technique)
        axes.axhline(0, color="black", linewidth=0.6)
        axes.set_ylabel(f"box {'XYZ'[axis]} ({unit})")
    drawn[0].legend(frameon=False, fontsize=9, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    drawn[3].plot(*temperature, color=PALETTE[2], linewidth=1.2)
    drawn[3].set_ylabel("°C")
    drawn[3].set_xlabel("time (s)")
    return figure
