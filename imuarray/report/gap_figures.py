"""Figures of a gap diagnosis before and after the causes were added: the map of scores, bars of scores by domain,
figures in units of use, and curves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite, isnan, log
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.findings.text import number, scored
from imuarray.gap.model.use import Use
from imuarray.report.figure_style import (
    AFTER,
    BEFORE,
    NARROW,
    REAL,
    legend_above,
    make_logarithmic,
    new_panel,
    plain_name,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import FuncNorm
    from matplotlib.figure import Figure

    from imuarray.gap.findings.diagnosis import Gap, Map, Overlay

LOGARITHMIC: Mapping[str, str] = {"spectrum": "xy", "allan": "xy", "temperature": "", "codes": ""}
"""Logarithmic axes of an overlay, by kind."""


def shrink_figure(gap: Gap) -> Figure:
    """Draw the score before and after, of all statistics and by domain, as bars that begin at the floor."""
    names = ["all", *(plain_name(name).replace("_", " ") for name in gap.domains)]
    scores = np.array([(gap.before, gap.after), *((worse, better) for worse, better, _ in gap.domains.values())])
    figure, panel = new_panel(NARROW, 1.0 + 0.42 * len(names))
    places = np.arange(len(names))
    for values, colour, shift, label in zip(scores.T, (BEFORE, AFTER), (-0.19, 0.19), ("before", "after"), strict=True):
        ends = np.where(np.isfinite(values), values, gap.floor)
        panel.barh(places + shift, ends - gap.floor, 0.34, left=gap.floor, color=colour, label=label)
        for place, value, end in zip(places + shift, values, ends, strict=True):
            at = max(end, gap.floor), place
            panel.annotate(scored(float(value)), at, (4, 0), textcoords="offset points", fontsize=8.5, va="center")
    panel.axvline(gap.floor, color=REAL, linewidth=1.3, linestyle="--", label="no gap")
    _finish_rows(panel, names, "rms score (standard deviations of chance)")
    shown = np.append(scores[np.isfinite(scores)], gap.floor)
    panel.set_xlim(0.85 * shown.min(), 1.3 * shown.max())  # room for the numbers
    if shown.min() > 0:
        make_logarithmic(panel, "x")
    return figure


def can_compare(use: Use) -> bool:
    """Return whether all figures are finite and the recorded one is positive, so that ratios to it exist."""
    every = [
        getattr(estimate, end) for estimate in (use.real, use.before, use.after) for end in ("value", "low", "high")
    ]
    return use.real.value > 0 and all(map(isfinite, every))


def use_figure(uses: Sequence[Use]) -> Figure:
    """Draw the simulated figures of each use, divided by the recorded one, with 95 % intervals; the interval of the
    recording is the band around 1. `can_compare` is true of each use.
    """
    figure, panel = new_panel(NARROW, 1.0 + 0.55 * len(uses))
    for place, use in enumerate(uses):
        scale = use.real.value
        low, wide = use.real.low / scale, (use.real.high - use.real.low) / scale
        panel.barh(place, wide, 0.72, left=low, color="#ccd4da", label=None if place else "real")
        for estimate, colour, shift, label in (
            (use.before, BEFORE, -0.16, "before"),
            (use.after, AFTER, 0.16, "after"),
        ):
            reach = np.abs([[estimate.value - estimate.low], [estimate.high - estimate.value]]) / scale
            bar = panel.errorbar(estimate.value / scale, place + shift, xerr=reach, fmt="o", color=colour, capsize=3)
            bar.set_label("_" if place else label)
    panel.axvline(1, color=REAL, linewidth=1.2)
    names = [fill(plain_name(f"{use.sensor or 'array'}: {use.name}", 48), 24) for use in uses]
    _finish_rows(panel, names, "simulated over real (1: alike)")
    return figure


def overlay_figure(overlay: Overlay) -> Figure:
    """Draw the curve of the recording over those of the simulations before and after, with their 95 % bands."""
    figure, panel = new_panel(NARROW, 3.2)
    logarithmic = LOGARITHMIC[overlay.kind]
    known = np.isfinite(overlay.x) & ((overlay.x > 0) | ("x" not in logarithmic))
    x = overlay.x[known]
    steps: dict[str, Any] = {"drawstyle": "steps-mid"} if overlay.kind == "codes" else {}
    for order, (bands, colour, label) in enumerate(
        ((overlay.before, BEFORE, "before"), (overlay.after, AFTER, "after"))
    ):
        middle, low, high = _drawable(bands[:, known], logarithmic)
        panel.fill_between(
            x, low, high, color=colour, alpha=0.25, linewidth=0, zorder=1 + order, step="mid" if steps else None
        )
        panel.plot(x, middle, color=colour, linewidth=1.6, zorder=3 + order, label=label, **steps)
    real = _drawable(overlay.real[known], logarithmic)
    panel.plot(x, real, color=REAL, linewidth=1.0, zorder=5, label="real", **steps)
    for which in logarithmic:
        make_logarithmic(panel, which)
    panel.set_xlabel(plain_name(overlay.x_label, 60), fontsize=9)
    panel.set_ylabel(plain_name(overlay.y_label, 60), fontsize=9)
    panel.grid(color="0.92", linewidth=0.7)
    panel.set_title(place_of(overlay), loc="left", fontsize=10, fontweight="bold")
    _key(figure, panel)
    return figure


def outside(overlay: Overlay, bands: Floats) -> float:
    """Return the share of points at which the recording lies outside the 95 % band (3, n) of simulations; nan if no
    point can be compared.
    """
    known = np.isfinite(overlay.real) & np.isfinite(bands).all(axis=0)
    _, low, high = bands[:, known]
    real = overlay.real[known]
    return float(np.mean((real < low) | (real > high))) if known.any() else float("nan")


def farthest(overlay: Overlay, bands: Floats) -> tuple[float, float]:
    """Return the x at which the recording lies farthest outside the band (3, n), and how far, in half widths of the
    band (but at least 1 % of the curve's largest value); nan and 0 if it lies nowhere outside.
    """
    _, low, high = bands
    width = np.maximum((high - low) / 2, 0.01 * np.nanmax(np.abs(overlay.real), initial=0.0))
    beyond = np.maximum(overlay.real - high, low - overlay.real)
    ratio = np.divide(beyond, width, out=np.zeros_like(width), where=(width > 0) & np.isfinite(beyond))
    if not len(ratio) or ratio.max() <= 0:
        return float("nan"), 0.0
    return float(overlay.x[ratio.argmax()]), float(ratio.max())


def place_of(overlay: Overlay) -> str:
    """Return the title of a curve: its sensor, axis and phase."""
    where = f"{plain_name(overlay.sensor)} {plain_name(overlay.axis)}".rstrip()
    return f"{where}, {plain_name(overlay.phase)}" if overlay.phase else where


def _drawable(values: Floats, logarithmic: str) -> Floats:
    """Replace values that a logarithmic scale cannot show by nan."""
    return np.where((values > 0) | ("y" not in logarithmic), values, np.nan)


def _finish_rows(panel: Axes, names: Sequence[str], label: str) -> None:
    panel.set_yticks(range(len(names)), names, fontsize=9)
    panel.set_ylim(len(names) - 0.5, -0.5)
    panel.tick_params(axis="y", length=0)
    panel.spines["left"].set_visible(False)
    panel.grid(axis="x", color="0.9", linewidth=0.8)
    panel.margins(x=0.1)
    panel.set_xlabel(label, fontsize=9)
    legend_above(panel)


def _key(figure: Any, panel: Axes) -> None:
    """Draw the legend below the panel, the recording first."""
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(
        [handles[-1], *handles[:-1]], [labels[-1], *labels[:-1]], loc="outside lower center", frameon=False,
        fontsize=8.5, ncols=3,
    )  # fmt: skip


# The map -------------------------------------------------------------------------------------------------------------

_STOPS = ((0.0, "#f4f7f9"), (0.5, "#c3d3df"), (0.5, "#ffe2a8"), (0.72, "#ee9a2e"), (1.0, "#9c3200"))
"""Colour scale: pale blue below the limit, amber to dark brown above it."""
_DARK = 0.82
"""Position on the colour scale above which numbers are white."""


def top_of(shown: Map) -> float:
    """Return the end of the colour scale of both maps: the largest finite score, at least ten times the limit."""
    both = np.concatenate([shown.before.ravel(), shown.after.ravel(), [10 * shown.limit]])
    return float(both[np.isfinite(both)].max())


def map_figure(scores: Floats, shown: Map, title: str) -> Figure:
    """Draw `scores` (sensors, domains) as coloured cells with their numbers; the colours change abruptly at the limit.
    Cells without a statistic are hatched. MissingExtraError without matplotlib.
    """
    rows, columns = scores.shape
    top = top_of(shown)
    figure, panel = new_panel(NARROW, 1.9 + 0.27 * rows)
    norm = _scale(shown.limit, top)
    image = panel.pcolormesh(
        np.ma.masked_invalid(np.minimum(scores, top)), norm=norm, cmap=_colours(), edgecolors="white", linewidth=1.5
    )
    for (row, column), score in np.ndenumerate(scores):
        _write(panel, row, column, float(score), shown.limit, norm)
    panel.set_ylim(rows, 0)
    panel.set_yticks(np.arange(rows) + 0.5, [plain_name(name, 16) for name in shown.sensors])
    names = [plain_name(name).replace("_", " ") for name in shown.domains]
    panel.set_xticks(np.arange(columns) + 0.5, names, rotation=45, ha="left", rotation_mode="anchor")
    panel.tick_params(length=0, labeltop=True, labelbottom=False)
    panel.spines[:].set_visible(False)
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, fontweight="bold")
    _draw_scale(figure, panel, image, shown.limit, top)
    return figure


def _write(panel: Axes, row: int, column: int, score: float, limit: float, norm: FuncNorm) -> None:
    """Write the number of a cell, bold above the limit, or hatch the cell."""
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
    """Return a colour scale that is linear up to the limit, in its middle, and logarithmic from there to `top`."""
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
    """Draw the colour scale below the map, with a mark at the limit."""
    bar = figure.colorbar(image, ax=panel, orientation="horizontal", aspect=40, pad=0.03, shrink=0.92)
    steps = [step for power in range(7) for step in (10.0**power, 3 * 10.0**power) if 1.6 * limit < step < top / 2]
    ticks = [0.0, limit, *steps, top]
    bar.set_ticks(ticks, labels=["0", f"limit {number(limit, 2)}", *map(scored, steps), scored(top)])
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=8, length=3)
    bar.ax.axvline(limit, color="#1d2327", linewidth=1.6)
    bar.outline.set_visible(False)
