"""Three figures of a `recompute()` result as PNG files; needs matplotlib.

Each function takes the result and the path to write. They draw on a bare `Figure`, which needs no display.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imuarray.atomic import save_figure

Result = Mapping[str, Any]

_ONE, _OTHER, _MEAN, _BAD = "#4477aa", "#66ccee", "#228833", "#cc3311"
_DPI = 130


def _save(figure: Figure, path: Path) -> None:
    save_figure(path, figure, dpi=_DPI, metadata={"Software": None})


def draw_pairs(result: Result, path: Path) -> None:
    """Temperature slopes of every pair as printed (Table 8) and of its mean as recomputed, in physical units."""
    figure = Figure(figsize=(11, 6.2), layout="constrained")
    gyros, accelerometers = figure.subplots(1, 2, width_ratios=(2, 3))
    pairs: Sequence[dict[str, Any]] = result["pairs"]
    _draw_slopes(gyros, [pair for pair in pairs if pair["unit"] == "dps"], 1000.0, "mdps per degC")
    _draw_slopes(accelerometers, [pair for pair in pairs if pair["unit"] == "mg"], 1.0, "mg per degC")
    accelerometers.set_title("accelerometers (* carried 1 g)")
    gyros.set_title("gyroscopes, 2000 dps")
    gyros.legend(loc="lower right", frameon=False)
    figure.suptitle("Temperature drift of two sensors and of their mean along the box axis")
    _save(figure, path)


def _draw_slopes(axes: Axes, pairs: Sequence[dict[str, Any]], scale: float, unit: str) -> None:
    per_count = [abs(pair["fused_slope_per_degc"] / pair["fused_slope_lsb_per_degc"]) * scale for pair in pairs]
    styles = (
        ("slope_first_lsb_per_degc", "first, printed", _ONE),
        ("slope_second_lsb_per_degc", "second, printed", _OTHER),
        ("fused_slope_lsb_per_degc", "their mean, recomputed", _MEAN),
    )
    for place, (column, label, colour) in enumerate(styles):
        sizes = [abs(pair[column]) * factor for pair, factor in zip(pairs, per_count, strict=True)]
        rows = [row + 0.27 * (place - 1) for row in range(len(pairs))]
        bars = axes.barh(rows, sizes, 0.25, color=colour, label=label)
        if place == len(styles) - 1:
            axes.bar_label(bars, [_times_less(pair) for pair in pairs], padding=3, fontsize=8)
    axes.set_yticks(range(len(pairs)), [_pair_name(pair) for pair in pairs])
    axes.invert_yaxis()
    axes.set_xlabel(f"size of the slope, {unit}")
    axes.margins(x=0.2)
    axes.spines[["top", "right"]].set_visible(False)


def _times_less(pair: dict[str, Any]) -> str:
    return f"{pair['reduction']:.3g} times less" if pair["reduction"] > 1.05 else "no less"


def _pair_name(pair: dict[str, Any]) -> str:
    star = " *" if pair["carries_1g"] else ""
    return f"{pair['first']}, {pair['second'].split()[0]}{star}\n{pair['relation']}"


def draw_blending(result: Result, path: Path) -> None:
    """Noise of every accelerometer axis (Table 10) and what weighting two ranges of BMA180 makes of it."""
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    rows = [row for row in result["table10"] if row.get("unit") == "mg"]
    out_of_plane = [row["channel"].endswith("z") for row in rows]
    left.bar(range(len(rows)), [row["noise"] for row in rows], color=[_OTHER if z else _ONE for z in out_of_plane])
    left.set_xticks(range(len(rows)), [f"{row['channel']}" for row in rows], rotation=90)
    left.bar(0, 0, color=_ONE, label="x and y, in the plane")
    left.bar(0, 0, color=_OTHER, label="z, out of the plane")
    left.legend(frameon=False)
    left.set_ylabel("standard deviation, mg")
    left.set_title("noise of each axis (BMA3, BMA4 at 1.5 g, others at 16 g)", fontsize=10)
    _draw_weights(right, result["blending"])
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    _save(figure, path)


def _draw_weights(axes: Axes, blend: dict[str, Any]) -> None:
    weights = [step / 200 for step in range(201)]
    low, high = blend["low_mg"], blend["high_mg"]
    axes.plot(weights, [((w * low) ** 2 + ((1 - w) * high) ** 2) ** 0.5 for w in weights], color=_ONE)
    points = (
        (0.0, high, f"high range alone {high:.2f}", (10, 0)),
        (0.5, blend["plain_average_mg"], f"plain average {blend['plain_average_mg']:.2f}", (8, 8)),
        (blend["weight_low"], blend["weighted_mg"], f"inverse variance {blend['weighted_mg']:.2f}", (-60, -18)),
        (1.0, low, f"low range\nalone {low:.2f}", (-40, 14)),
    )
    for weight, noise, label, offset in points:
        axes.plot(weight, noise, "o", color=_MEAN)
        axes.annotate(label, (weight, noise), xytext=offset, textcoords="offset points")
    axes.set_xlabel("weight of the 1.5 g sensor")
    axes.set_ylabel("standard deviation of the weighted mean, mg")
    axes.set_ylim(0, high * 1.1)
    axes.set_title("one BMA180 at 1.5 g with one at 16 g", fontsize=10)


def draw_runs(result: Result, path: Path) -> None:
    """BMA1's runs with the boot fault (Table 6) and Gyro3's two bias states (Table 7)."""
    figure = Figure(figsize=(11, 4.8), layout="constrained")
    grid = figure.add_gridspec(3, 2)
    fault = figure.add_subplot(grid[:, 0])
    _draw_boot_fault(fault, result)
    states = [figure.add_subplot(grid[place, 1]) for place in range(3)]
    _draw_states(states, result)
    for axes in (fault, *states):
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_xticks(range(1, len(result["table6"]) + 1, 2))
    _save(figure, path)


def _draw_boot_fault(axes: Axes, result: Result) -> None:
    faulty = {fault["run"]: fault for fault in result["boot_fault"]}
    for row in result["table6"]:
        axes.plot(row["run"], row["z_lsb"], "o", color=_BAD if row["run"] in faulty else _ONE)
    level = median(row["z_lsb"] for row in result["table6"])
    for run, fault in faulty.items():
        axes.axhline(fault["nearest_range_ratio"] * level, color=_BAD, linewidth=0.8, linestyle="--")
        note = f"run {run}: {fault['ratio']:.2f} times the median\n(dashed: {fault['nearest_range_ratio']:.0f} times)"
        axes.annotate(note, (run, fault["reading_lsb"]), xytext=(-150, -40), textcoords="offset points")
    axes.set_ylim(0, None)
    axes.set_xlabel("run")
    axes.set_ylabel("z, counts")
    axes.set_title("BMA1: a run in the wrong range", fontsize=10)


def _draw_states(panels: Sequence[Axes], result: Result) -> None:
    for state, colour, style in zip(result["bias_states"]["states"], (_ONE, _BAD), ("-", "--"), strict=True):
        rows = [row for row in result["table7"] if row["run"] in state["runs"]]
        for axes, column, centre in zip(panels, ("x_lsb", "y_lsb", "z_lsb"), state["centre_lsb"], strict=True):
            axes.plot([row["run"] for row in rows], [row[column] for row in rows], "o", color=colour)
            axes.axhline(centre, color=colour, linewidth=0.8, linestyle=style)
            axes.set_ylabel(f"{column[0]}, counts")
    panels[0].set_title("Gyro3: two states; lines are their centres", fontsize=10)
    panels[-1].set_xlabel("run")


FIGURES: dict[str, Callable[[Result, Path], None]] = {
    "pairs.png": draw_pairs,
    "blending.png": draw_blending,
    "runs.png": draw_runs,
}
"""File name to the function that draws it."""
