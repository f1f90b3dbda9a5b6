"""Figures that need no display: matplotlib's own `Figure`, without its global state, in colours that colour-blind
readers can distinguish. A notebook shows the returned figures; `figure.savefig("name.svg")` writes one to a file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from imuarray.arrays import Reals
from imuarray.errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PALETTE = ("#7f7f7f", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00")
"""Grey for single sensors, then Okabe and Ito's colours."""

_MOST_POINTS = 4000
"""Largest number of points of a curve over time. Longer curves are drawn by the smallest and the largest value of each
stretch of rows.
"""


def can_draw() -> bool:
    """Return whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure (inches) that needs no display; MissingExtraError without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError("matplotlib", "report") from None
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def time_series_figure(panels: Mapping[str, tuple[Reals, Reals]], title: str = "", height: float = 1.7) -> Figure:
    """Plot curves over time, one panel for each label: times (n,) in s and values (n,), or (n, 3) along X, Y and Z.

    With more than 4000 rows, each stretch is drawn by its smallest and largest value, so that a single spike is
    visible.
    """
    figure = new_figure(8.0, 0.8 + height * max(1, len(panels)))
    axes = figure.subplots(max(1, len(panels)), 1, sharex=True, squeeze=False)[:, 0]
    for panel, (label, (time_s, values)) in zip(axes, panels.items(), strict=False):
        columns = np.asarray(values, float).reshape(len(time_s), -1)
        for number, column in enumerate(columns.T):
            curve_s, curve = envelope(np.asarray(time_s, float), column)
            colour, name = PALETTE[1 + number % (len(PALETTE) - 1)], "XYZ"[number] if columns.shape[1] > 1 else None
            panel.plot(curve_s, curve, color=colour, linewidth=0.8, label=name)
        panel.set_ylabel(label, fontsize=9)
        panel.grid(linewidth=0.4, alpha=0.6)
        if columns.shape[1] > 1:  # above the panel, where it covers no curve
            place = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.98), "borderaxespad": 0.0}
            panel.legend(frameon=False, fontsize=8, ncols=columns.shape[1], **place)
    axes[-1].set_xlabel("time (s)")
    if title:
        figure.suptitle(title.replace("$", r"\$"), fontsize=10.5, x=0.02, ha="left")
    return figure


def envelope(time_s: Reals, values: Reals, most: int = _MOST_POINTS) -> tuple[Reals, Reals]:
    """Return the curve (n,), or with more than `most` rows the smallest and the largest value of each stretch."""
    width = -(-2 * len(values) // most)
    if width <= 2:
        return time_s, values
    first = np.arange(0, len(values), width)
    low, high = np.fmin.reduceat(values, first), np.fmax.reduceat(values, first)
    return np.repeat(time_s[first], 2), np.stack([low, high], axis=1).ravel()


def estimates_figure(
    labels: Sequence[str], values: Sequence[float], errors: Sequence[float], units: Sequence[str], quantity: str
) -> Figure:
    """Plot estimates, one dot per line with two standard errors on either side, in one panel for each unit. nan is not
    known and has no dot, or no bar.
    """
    figure = new_figure(8.0, 1.1 + 0.24 * max(3, len(labels)))
    groups = list(dict.fromkeys(units)) or [""]
    places = {unit: [row for row, unit_of_row in enumerate(units) if unit_of_row == unit] for unit in groups}
    heights = [max(3, len(rows)) for rows in places.values()]
    panels = figure.subplots(len(groups), 1, squeeze=False, height_ratios=heights)[:, 0]
    for panel, (unit, rows) in zip(panels, places.items(), strict=True):
        lines = np.arange(len(rows))
        bars = 2 * np.nan_to_num(np.asarray([errors[row] for row in rows], float))
        dots = [values[row] for row in rows]
        panel.axvline(0, color=PALETTE[0], linewidth=0.8)
        panel.errorbar(dots, lines, xerr=bars, fmt="o", color=PALETTE[1], ecolor=PALETTE[0], markersize=4, elinewidth=1)
        panel.set_yticks(lines, [labels[row] for row in rows], fontsize=8)
        panel.set_ylim(len(rows) - 0.4, -0.6)
        panel.set_xlabel(f"{quantity}, {unit}; bars: two standard errors")
        panel.grid(axis="x", linewidth=0.4, alpha=0.6)
    return figure
