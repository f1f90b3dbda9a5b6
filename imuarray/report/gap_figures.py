"""Drawings of how far a gap shrinks: scores, figures in units of use, and curves, before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from textwrap import fill
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from imuarray.gap.findings.text import scored
from imuarray.report.gap_sheet import AFTER, BEFORE, NARROW, REAL, legend_above, make_logarithmic, plain, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from imuarray.gap.findings.diagnosis import Gap, Overlay
from imuarray.gap.model.use import Use

Floats = npt.NDArray[np.float64]

LOGARITHMIC: Mapping[str, str] = MappingProxyType({"spectrum": "xy", "allan": "xy", "temperature": "", "codes": ""})
"""Which axes of an overlay are logarithmic, by kind."""


def shrink_figure(gap: Gap) -> Figure:
    """Bars from the floor to the score before and after, over all and by domain, on a logarithmic scale."""
    names = ["all", *(plain(name).replace("_", " ") for name in gap.domains)]
    scores = np.array([(gap.before, gap.after), *((worse, better) for worse, better, _ in gap.domains.values())])
    figure, panel = sheet(NARROW, 1.0 + 0.42 * len(names))
    places = np.arange(len(names))
    for values, colour, shift, label in zip(scores.T, (BEFORE, AFTER), (-0.19, 0.19), ("before", "after"), strict=True):
        ends = np.where(np.isfinite(values), values, gap.floor)
        panel.barh(places + shift, ends - gap.floor, 0.34, left=gap.floor, color=colour, label=label)
        for place, value, end in zip(places + shift, values, ends, strict=True):
            _write_behind(panel, scored(float(value)), max(end, gap.floor), place)
    panel.axvline(gap.floor, color=REAL, linewidth=1.3, linestyle="--", label="nothing wrong")
    _finish_rows(panel, names, "rms score (standard deviations of chance)")
    shown = np.append(scores[np.isfinite(scores)], gap.floor)
    panel.set_xlim(0.85 * shown.min(), 1.3 * shown.max())  # room for the numbers
    if shown.min() > 0:
        make_logarithmic(panel, "x")
    return figure


def can_compare(use: Use) -> bool:
    """Return true if simulated figures can stand over the recorded one."""
    every = [
        getattr(estimate, end) for estimate in (use.real, use.before, use.after) for end in ("value", "low", "high")
    ]
    return use.real.value > 0 and all(map(isfinite, every))


def use_figure(uses: Sequence[Use]) -> Figure:
    """Simulated figures over the recorded one (of each use that `can_compare`), with 95 % intervals; the recording's
    own is the band around 1.
    """
    figure, panel = sheet(NARROW, 1.0 + 0.55 * len(uses))
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
    names = [fill(plain(f"{use.sensor or 'array'}: {use.name}", 48), 24) for use in uses]
    _finish_rows(panel, names, "simulated over real (1: alike)")
    return figure


def overlay_figure(overlay: Overlay) -> Figure:
    """Return the recording's curve over both simulations' with their 95 % bands."""
    figure, panel = sheet(NARROW, 3.2)
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
    panel.set_xlabel(plain(overlay.x_label, 60), fontsize=9)
    panel.set_ylabel(plain(overlay.y_label, 60), fontsize=9)
    panel.grid(color="0.92", linewidth=0.7)
    panel.set_title(place_of(overlay), loc="left", fontsize=10, fontweight="bold")
    _key(figure, panel)
    return figure


def outside(overlay: Overlay, bands: Floats) -> float:
    """Share of the points at which the recording lies outside the 95 % band (3, n) of simulations; nan if none can be
    compared.
    """
    known = np.isfinite(overlay.real) & np.isfinite(bands).all(axis=0)
    _, low, high = bands[:, known]
    real = overlay.real[known]
    return float(np.mean((real < low) | (real > high))) if known.any() else float("nan")


def farthest(overlay: Overlay, bands: Floats) -> tuple[float, float]:
    """Return where on x the recording lies farthest outside the band (3, n), and how far, in half widths of the band
    (at least a hundredth of the curve's size); nan and 0 if nowhere.
    """
    _, low, high = bands
    width = np.maximum((high - low) / 2, 0.01 * np.nanmax(np.abs(overlay.real), initial=0.0))
    beyond = np.maximum(overlay.real - high, low - overlay.real)
    ratio = np.divide(beyond, width, out=np.zeros_like(width), where=(width > 0) & np.isfinite(beyond))
    if not len(ratio) or ratio.max() <= 0:
        return float("nan"), 0.0
    return float(overlay.x[ratio.argmax()]), float(ratio.max())


def place_of(overlay: Overlay) -> str:
    """Sensor, axis and phase, as a drawing may have them."""
    where = f"{plain(overlay.sensor)} {plain(overlay.axis)}".rstrip()
    return f"{where}, {plain(overlay.phase)}" if overlay.phase else where


def _drawable(values: Floats, logarithmic: str) -> Floats:
    """Return the values with nan for those that a logarithmic scale cannot show."""
    return np.where((values > 0) | ("y" not in logarithmic), values, np.nan)


def _write_behind(panel: Axes, text: str, end: float, place: float) -> None:
    panel.annotate(text, (end, place), xytext=(4, 0), textcoords="offset points", fontsize=8.5, va="center")


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
    """The legend below the panel, the recording first."""
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(
        [handles[-1], *handles[:-1]], [labels[-1], *labels[:-1]], loc="outside lower center", frameon=False,
        fontsize=8.5, ncols=3,
    )  # fmt: skip
