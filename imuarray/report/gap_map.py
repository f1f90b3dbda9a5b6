"""The map of a gap: sensors by domains, one colour scale for before and after, every number written."""

from __future__ import annotations

from math import isnan, log
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from imuarray.gap.findings.text import number, scored
from imuarray.report.gap_sheet import NARROW, plain, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import FuncNorm
    from matplotlib.figure import Figure

    from imuarray.gap.findings.diagnosis import Map

Floats = npt.NDArray[np.float64]

_STOPS = ((0.0, "#f4f7f9"), (0.5, "#c3d3df"), (0.5, "#ffe2a8"), (0.72, "#ee9a2e"), (1.0, "#9c3200"))
"""Below the limit pale blue, beyond it from amber to a brown that is dark enough for white numbers."""
_DARK = 0.82
"""Place on the colour scale from which numbers are white."""


def top_of(shown: Map) -> float:
    """Return the end of the colour scale of both maps: the largest finite score, at least ten times the limit."""
    both = np.concatenate([shown.before.ravel(), shown.after.ravel(), [10 * shown.limit]])
    return float(both[np.isfinite(both)].max())


def map_figure(scores: Floats, shown: Map, title: str) -> Figure:
    """`scores` (sensors, domains) as colours that break at the limit, every number written; hatched where nothing is
    said. MissingExtraError without matplotlib.
    """
    rows, columns = scores.shape
    top = top_of(shown)
    figure, panel = sheet(NARROW, 1.9 + 0.27 * rows)
    norm = _scale(shown.limit, top)
    image = panel.pcolormesh(
        np.ma.masked_invalid(np.minimum(scores, top)), norm=norm, cmap=_colours(), edgecolors="white", linewidth=1.5
    )
    for (row, column), score in np.ndenumerate(scores):
        _write(panel, row, column, float(score), shown.limit, norm)
    panel.set_ylim(rows, 0)
    panel.set_yticks(np.arange(rows) + 0.5, [plain(name, 16) for name in shown.sensors])
    names = [plain(name).replace("_", " ") for name in shown.domains]
    panel.set_xticks(np.arange(columns) + 0.5, names, rotation=45, ha="left", rotation_mode="anchor")
    panel.tick_params(length=0, labeltop=True, labelbottom=False)
    panel.spines[:].set_visible(False)
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, fontweight="bold")
    _draw_scale(figure, panel, image, shown.limit, top)
    return figure


def _write(panel: Axes, row: int, column: int, score: float, limit: float, norm: FuncNorm) -> None:
    """The number of one cell, bold beyond the limit, or a hatched cell."""
    from matplotlib.patches import Rectangle

    if isnan(score):
        panel.add_patch(Rectangle((column, row), 1, 1, facecolor="#eceff1", edgecolor="#b4bec5", hatch="////", lw=0))
        return
    panel.text(
        column + 0.5,
        row + 0.53,
        scored(score),
        ha="center",
        va="center",
        fontsize=8,
        color="white" if norm(score) > _DARK else "#1d2327",
        fontweight="bold" if score > limit else "normal",
    )


def _scale(limit: float, top: float) -> FuncNorm:
    """Even up to the limit, which is in the middle, and logarithmic from there to `top`."""
    from matplotlib.colors import FuncNorm

    span = log(top / limit)

    def place(score: Any) -> Any:
        beyond = 0.5 + 0.5 * np.log(np.maximum(score, limit) / limit) / span
        return np.where(np.asarray(score) <= limit, 0.5 * np.asarray(score) / limit, beyond)

    def score(place: Any) -> Any:
        beyond = limit * np.exp(span * (np.maximum(place, 0.5) - 0.5) / 0.5)
        return np.where(np.asarray(place) <= 0.5, 2 * limit * np.asarray(place), beyond)

    return FuncNorm((place, score), vmin=0.0, vmax=top, clip=True)


def _colours() -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("gap", _STOPS, N=512)


def _draw_scale(figure: Figure, panel: Axes, image: Any, limit: float, top: float) -> None:
    """The colour scale below the map, the limit marked."""
    bar = figure.colorbar(image, ax=panel, orientation="horizontal", aspect=40, pad=0.03, shrink=0.92)
    steps = [step for power in range(7) for step in (10.0**power, 3 * 10.0**power) if 1.6 * limit < step < top / 2]
    ticks = [0.0, limit, *steps, top]
    bar.set_ticks(ticks, labels=["0", f"limit {number(limit, 2)}", *map(scored, steps), scored(top)])
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=8, length=3)
    bar.ax.axvline(limit, color="#1d2327", linewidth=1.6)
    bar.outline.set_visible(False)
