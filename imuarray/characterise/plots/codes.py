"""Histogram of codes of every sensor axis: a small panel each, with the Gaussian of same mean and spread."""

from __future__ import annotations

from math import erfc, pi, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from imuarray.arrays import Floats
from imuarray.characterise.plots.frame import (
    COLOURS,
    FALSE_ALARM,
    Margins,
    Table,
    arrange,
    count_axes,
    floats,
    how_to_read,
    label,
    new_figure,
    plain,
    replace_all_scales,
    set_height,
)
from imuarray.printable import percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_SENSORS = 12
"""Largest number of rows of panels; sensors with marks are preferred."""

MOST_BARS = 120
"""Largest number of bars; wider histograms have bars of several codes."""

_TESTS = 3
"""Number of tests that share the significance level: the share of even codes and an outlier at either end. The other
marks hardly occur by chance. For white noise of 0.2 to 50 counts rms and 10 to 30 000 readings, `marks` reports a fault
with up to 3 times the probability of its level.
"""

_READING = (
    "Bars: share of the readings per code (counts); black: the Gaussian of the same mean and standard deviation.\n"
    "Orange: what Gaussian noise, rounded, gives in at most 1 % of such figures: even codes only, missing ones, "
    "clipping at an end, outliers."
)


_BARS = Margins(0.16, 0.16, 0.22, 0.24)


def histogram_figure(result: Table) -> Figure:
    """Draw bars of codes, one row of panels per sensor and one column per axis, with faults in orange.

    MissingExtraError if there is no matplotlib.
    """
    level = FALSE_ALARM / count_axes(result) / _TESTS
    measured = [sensor for sensor in result["sensors"] if any(map(_is_shown, sensor["axes"]))]
    sensors = choose_sensors(measured, level)
    selection = f", {len(sensors)} of {len(measured)} sensors" if len(sensors) < len(measured) else ""
    figure = new_figure(result, f"Codes{selection}")
    set_height(figure, 1.25, len(sensors))
    if not sensors:
        figure.text(0.5, 0.4, "no sensor has readings of at most 4096 different codes", ha="center")
        return figure
    columns = max(len(sensor["axes"]) for sensor in sensors)
    grid = figure.subplots(len(sensors), columns, squeeze=False)
    for sensor, panels in zip(sensors, grid, strict=True):
        for panel in panels[len(sensor["axes"]) :]:
            panel.set_axis_off()
        for axis, panel in zip(sensor["axes"], panels, strict=False):
            _draw(panel, axis, level)
            panel.set_title(plain(f"{label(sensor)}, {axis['axis']}"), loc="left", y=1.0, fontsize=8)
    how_to_read(figure, _READING)
    arrange(figure, grid, _BARS)
    replace_all_scales(grid)
    return figure


def _is_shown(axis: Table) -> bool:
    return bool(axis.get("histogram")) and bool(axis["histogram"]["codes"])


def choose_sensors(sensors: list[Table], level: float) -> list[Table]:
    """Return at most `MOST_SENSORS`, in their order; those with the most marked axes if there are more."""
    marked = [sum(bool(marks(axis, level)) for axis in sensor["axes"]) for sensor in sensors]
    first = sorted(range(len(sensors)), key=lambda at: -marked[at])[:MOST_SENSORS]
    return [sensors[at] for at in sorted(first)]


def marks(axis: Table, level: float) -> list[str]:
    """Describe the faults of a converter that a histogram shows; `level` is the significance level."""
    codes = axis.get("codes")
    if not codes or not codes["std"]:
        return ["one code only"] if codes and codes["readings"] > 1 else []
    remarks = _steps(codes, step_of(axis, level))
    missing = sum((gap["last"] - gap["first"]) // codes["usual_step"] + 1 for gap in _missing(codes, level))
    if missing:
        remarks.append(f"{missing} code{'s' if missing > 1 else ''} missing")
    for name in ("low", "high"):
        end = codes[f"{name}_end"]
        if _is_piled(end, level):
            remarks.append(f"{100 * end['share']:.2g} % at the {name} end")
        elif _is_far(end, codes, level):
            remarks.append(f"outlier at {end['code']}")
    is_uneven = codes["even_p"] is not None and codes["even_p"] <= level
    return remarks or ([f"{percent(codes['even_share'], 1)} even codes"] if is_uneven else [])


def step_of(axis: Table, level: float) -> int:
    """Return the usual step of the codes; 1 if it may be due to chance: step^(1 - n) for n different codes."""
    step: int = axis["codes"]["usual_step"]
    different = len(axis["histogram"]["codes"]) if axis["histogram"] else np.inf
    return step if step > 1 and float(step) ** (1 - different) <= level else 1


def _steps(codes: Table, step: int) -> list[str]:
    """Describe the step between codes; empty for 1."""
    if step == 2 and codes["even_share"] in (0, 1):
        return ["even codes only" if codes["even_share"] else "odd codes only"]
    return [f"codes in steps of {step}"] if step > 1 else []


def _missing(codes: Table, level: float) -> list[Table]:
    """Return the gaps that are significant."""
    return [gap for gap in codes["missing"] if gap["p_value"] <= level]


def _is_piled(end: Table, level: float) -> bool:
    return end["p_value"] is not None and end["p_value"] <= level


def _is_far(end: Table, codes: Table, level: float) -> bool:
    """Return whether Gaussian readings are unlikely to reach an end. The distance is reduced by a step, because the
    measured spread of noise below a step is unreliable.
    """
    distance = float(abs(end["code"] - codes["mean"]) - codes["step"]) / codes["std"]
    return bool(codes["readings"] * erfc(distance / sqrt(2)) / 2 <= level)


def bars(histogram: Table, step: int) -> tuple[Floats, Floats]:
    """Return the heights (b,) and edges (b + 1,), in codes, of bars side by side for codes that come in steps of
    `step`.

    A height is the share of the readings per possible code, 0 between codes. A bar is 1 wide, or several steps so that
    there are at most `MOST_BARS`.
    """
    codes, counts = floats(histogram["codes"]), floats(histogram["counts"])
    together = max(1, int(np.ceil((codes[-1] - codes[0] + 1) / step / MOST_BARS)))
    edges_low, width = codes - 0.5, 1
    if together > 1:
        width = together * step
        member = ((codes - codes[0]) // width).astype(int)
        edges_low, counts = (
            edges_low[0] + width * np.arange(member[-1] + 1),
            np.asarray(np.bincount(member, counts), np.float64),
        )
    edges = np.union1d(edges_low, edges_low + width)
    heights = np.zeros(len(edges) - 1)
    heights[np.searchsorted(edges, edges_low)] = counts / counts.sum() / together
    return heights, edges


def _draw(panel: Axes, axis: Table, level: float) -> None:
    """Draw bars, Gaussian and marks of one axis."""
    panel.set_yticks([])
    panel.spines[["top", "right", "left"]].set_visible(False)
    panel.tick_params(labelsize=7)
    if not _is_shown(axis):
        panel.set_xticks([])
        reason = "over 4096 different codes" if axis.get("codes") else "no readings"
        panel.text(0.5, 0.5, reason, transform=panel.transAxes, ha="center", va="center", fontsize=8, color="0.4")
    else:
        panel.locator_params(axis="x", nbins=7, integer=True)
        codes, step = axis["codes"], step_of(axis, level)
        heights, edges = bars(axis["histogram"], step)
        panel.stairs(heights, edges, fill=True, color=COLOURS[5], linewidth=0)
        if codes["std"]:
            x = np.linspace(edges[0], edges[-1], 200)
            share = np.exp(-0.5 * ((x - codes["mean"]) / codes["std"]) ** 2) / (codes["std"] * sqrt(2 * pi))
            panel.plot(x, share * step, color="black", linewidth=0.8)
        else:
            panel.set_xlim(edges[0] - 4, edges[1] + 4)  # space, so that a single code is drawn as a narrow bar
        _draw_marks(panel, codes, level)
        _write_marks(panel, codes["mean"], marks(axis, level))


def _write_marks(panel: Axes, mean: float, texts: list[str]) -> None:
    """Write the marks into the right corner, or the left one if most readings are right of the middle."""
    low, high = panel.get_xlim()
    is_left = mean > low + 0.6 * (high - low)
    style: dict[str, Any] = {"fontsize": 7.5, "color": COLOURS[1], "va": "top", "ha": "left" if is_left else "right"}
    panel.text(0.0 if is_left else 1.0, 1.0, "\n".join(texts), transform=panel.transAxes, **style)


def _draw_marks(panel: Axes, codes: Table, level: float) -> None:
    """Draw triangles below the axis at missing codes and at ends where readings accumulate."""
    at = [(gap["first"] + gap["last"]) / 2 for gap in _missing(codes, level)]
    at += [codes[end]["code"] for end in ("low_end", "high_end") if _is_piled(codes[end], level)]
    if at:
        style: dict[str, Any] = {"color": COLOURS[1], "markersize": 5, "clip_on": False, "gid": "marks"}
        panel.plot(at, np.zeros(len(at)), "^", transform=panel.get_xaxis_transform(), **style)
