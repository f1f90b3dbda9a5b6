"""Figures of a validation run: false alarms, detection, confusion of effects, probabilities, closure.

Whiskers are 95 % intervals; grey bands and lines are the required limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from imuarray.figures import PALETTE
from imuarray.report.figure_style import NARROW, legend_above, make_logarithmic, new_panel, plain_name
from imuarray.validation.rates import Bin, RateEstimate, rate
from imuarray.validation.score_rows import DETECTION, FALSE_ALARMS, WITHIN, Closure, DetectionCurve, ScoreRow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from imuarray.validation.score_rows import Confusion
    from imuarray.validation.scoring import Figures

_GREY, _BLUE, _RED, *_ = PALETTE
_BAND, _INK = "#d9e0e5", "#1d2327"
_COLOURS = (_INK, *PALETTE[1:])
_MARKERS = "osD^vP"
_NOMINAL = 0.05
_SPREAD = 0.05
"""Horizontal offset between curves in natural logarithm of severity, so that their whiskers do not overlap."""
_DARK = 0.6
"""Share of a row above which the number of a cell is white."""
_LEAST_CLOSED = -0.25
"""Least share that is drawn; smaller shares, of gaps that grew, are drawn at this value."""


def plots_of(figures: Figures) -> dict[str, Figure]:
    """Draw all figures of a run, by file name."""
    alarms = [row for row in figures.rows if row.name.startswith("false alarms") and row.cases]
    filled = [item for item in figures.reliability if item.cases]
    known = [item for item in figures.closures if isfinite(item.claimed)]
    plots = {
        "false-alarms": alarms_figure(alarms) if alarms else None,
        "detection": detection_figure(figures.curves) if figures.curves else None,
        "causes": confusion_figure(figures.confusion) if figures.confusion.truths else None,
        "probabilities": reliability_figure(filled) if filled else None,
        "closure": closure_figure(known) if known else None,
    }
    return {name: plot for name, plot in plots.items() if plot is not None}


def alarms_figure(rows: Sequence[ScoreRow]) -> Figure:
    """Draw the false alarms of each plan, the allowed band, and the nominal rate."""
    figure, panel = new_panel(NARROW, 1.2 + 0.4 * len(rows))
    low, high = (100 * (end or 0.0) for end in FALSE_ALARMS)
    panel.axvspan(low, high, color=_BAND, label=f"allowed: {low:g} to {high:g} %")
    panel.axvline(100 * _NOMINAL, color=_GREY, linewidth=1, linestyle="--", label="nominal")
    for place, row in enumerate(rows):
        colour = _RED if row.passes is False else _BLUE
        _whisker(panel, RateEstimate(row.value, row.low, row.high, row.cases), place, colour)
    names = [f"{plain_name(row.name.partition('plan ')[2])} ({row.cases})" for row in rows]
    panel.set_yticks(range(len(rows)), names)
    panel.set_ylim(len(rows) - 0.5, -0.5)
    panel.set_xlim(0, None)
    panel.set_xlabel("false alarms (%)")
    legend_above(panel)
    return figure


def detection_figure(curves: Sequence[DetectionCurve]) -> Figure:
    """Draw the share of cases in which a gap is reported against severity, of all plans together and of each plan."""
    figure, panel = new_panel(NARROW, 4.0)
    for number, curve in enumerate(curves):
        shift = np.exp(_SPREAD * (number - (len(curves) - 1) / 2))
        places = np.array([limits for limits, _ in curve.points]) * shift
        shares = np.array(
            [
                (estimate.value, estimate.value - estimate.low, estimate.high - estimate.value)
                for _, estimate in curve.points
            ]
        )
        colour, marker = _COLOURS[number % len(_COLOURS)], _MARKERS[number % len(_MARKERS)]
        drawn = panel.errorbar(
            places,
            shares[:, 0],
            yerr=np.maximum(shares[:, 1:].T, 0),
            color=colour,
            marker=marker,
            markersize=4.5,
            linewidth=2.0 if number == 0 else 1.2,
            elinewidth=0.9,
            capsize=2,
        )
        drawn.set_label(plain_name(curve.plan))
    for limits, (least, _) in DETECTION.items():
        ends = np.array([limits / 1.25, limits * 1.25])
        panel.plot(ends, np.full(2, least), color="#9aa5ad", linewidth=5, zorder=0, solid_capstyle="butt")
    ticks = sorted({limits for curve in curves for limits, _ in curve.points})
    make_logarithmic(panel, "x")
    panel.set_xticks(ticks, [f"{limits:g}" for limits in ticks])
    panel.set_ylim(-0.02, 1.04)
    panel.set_xlabel("severity (detection limits)")
    panel.set_ylabel("share detected")
    panel.grid(color="0.9", linewidth=0.7)
    legend_above(panel)
    return figure


def confusion_figure(confusion: Confusion) -> Figure:
    """Draw the confusion matrix: active mechanisms in rows, first reported causes in columns. The colour is the share
    of the row, numbers are cases, frames mark correct causes.
    """
    from matplotlib.patches import Rectangle

    counts = np.array(confusion.counts, float).reshape(len(confusion.truths), len(confusion.said))
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    figure, panel = new_panel(2.6 + 0.27 * len(confusion.said), 1.8 + 0.2 * len(confusion.truths))
    panel.pcolormesh(shares, cmap="Blues", vmin=0, vmax=1, edgecolors="white", linewidth=0.6)
    for row, column in np.argwhere(counts > 0).tolist():
        colour = "white" if shares[row, column] > _DARK else _INK
        text = f"{counts[row, column]:.0f}"
        panel.text(column + 0.5, row + 0.53, text, ha="center", va="center", fontsize=6.5, color=colour)
    for row, column in np.argwhere(np.array(confusion.right, bool).reshape(counts.shape)).tolist():
        panel.add_patch(Rectangle((column, row), 1, 1, fill=False, edgecolor=_RED, linewidth=1.2))
    panel.set_ylim(len(confusion.truths), 0)
    panel.set_yticks(np.arange(len(confusion.truths)) + 0.5, [plain_name(name, 34) for name in confusion.truths])
    names = [plain_name(name).replace("_", " ") for name in confusion.said]
    panel.set_xticks(np.arange(len(names)) + 0.5, names, rotation=60, ha="left", rotation_mode="anchor")
    panel.tick_params(length=0, labeltop=True, labelbottom=False, labelsize=7.5)
    panel.spines[:].set_visible(False)
    return figure


def reliability_figure(bins: Sequence[Bin]) -> Figure:
    """Draw the share of causes that are right against the reported probability; numbers are counts of causes."""
    figure, panel = new_panel(NARROW, 4.4)
    panel.plot([0, 1], [0, 1], color=_GREY, linewidth=1, linestyle="--", label="calibrated")
    filled = [bin_ for bin_ in bins if bin_.cases]
    for bin_ in filled:
        estimate = rate(round(bin_.right * bin_.cases), bin_.cases)
        reach = np.maximum([[estimate.value - estimate.low], [estimate.high - estimate.value]], 0)
        panel.errorbar(bin_.mean, bin_.right, yerr=reach, color=_BLUE, marker="o", markersize=5, capsize=2.5)
        panel.annotate(str(bin_.cases), (bin_.mean, bin_.right), (6, 4), textcoords="offset points", fontsize=7.5)
    panel.set(xlim=(-0.02, 1.06), ylim=(-0.04, 1.06), aspect="equal")
    panel.set_xlabel("reported probability")
    panel.set_ylabel("share of causes that are right")
    legend_above(panel)
    return figure


def closure_figure(closures: Sequence[Closure]) -> Figure:
    """Draw the share of the gap that the diagnosis claims to close against the oracle's, and the tolerance band."""
    figure, panel = new_panel(NARROW, 4.4)
    ends = np.array([_LEAST_CLOSED, 1.0])
    panel.fill_between(ends, ends - WITHIN, ends + WITHIN, color=_BAND, label=f"within {WITHIN}")
    for is_right, colour, marker, label in ((False, _RED, "x", "wrong cause first"), (True, _BLUE, "o", "right")):
        own = [closure for closure in closures if closure.is_right == is_right and isfinite(closure.claimed)]
        places = np.array([(closure.oracle, closure.claimed) for closure in own]).reshape(-1, 2)
        x, y = np.maximum(places, _LEAST_CLOSED).T
        panel.scatter(x, y, s=14, color=colour, marker=marker, linewidth=0.8, alpha=0.7, label=label)
    panel.set(xlim=(_LEAST_CLOSED - 0.03, 1.05), ylim=(_LEAST_CLOSED - 0.03, 1.05), aspect="equal")
    panel.set_xlabel("share closed by the oracle")
    panel.set_ylabel("share closed according to the diagnosis")
    panel.grid(color="0.92", linewidth=0.6)
    legend_above(panel)
    return figure


def _whisker(panel: Axes, estimate: RateEstimate, place: float, colour: str) -> None:
    """Draw a rate in percent with a horizontal whisker."""
    if not estimate.cases:
        return
    reach = 100 * np.maximum([[estimate.value - estimate.low], [estimate.high - estimate.value]], 0)
    panel.errorbar(100 * estimate.value, place, xerr=reach, color=colour, marker="o", markersize=5, capsize=3)
