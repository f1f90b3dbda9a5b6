"""The paper's figures: three of the recomputation as PNG files, its Figures 6 to 19 from the simulated experiments.

The latter have the paper's axes and units; colour is the sensor or the range, dashes are the axis. All need matplotlib
(MissingExtraError) and no display. The curves in them are plain arrays, computed here from the experiments.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import signal

from imuarray.arrays import Floats
from imuarray.atomic import save_figure
from imuarray.characterise import allan_deviation
from imuarray.figures import PALETTE, new_figure
from imuarray.simulate.motion.heating import Heating
from imuarray.studies.paper.array_model import WINDOW_S
from imuarray.studies.paper.replica.comparison import autocorrelation
from imuarray.studies.paper.variation import HIGH_RATE_HZ

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from imuarray.studies.paper.replica.simulation import ExperimentData, Series

Result = Mapping[str, Any]
Counts = npt.NDArray[np.int16]

_ONE, _OTHER, _MEAN, _BAD = "#4477aa", "#66ccee", "#228833", "#cc3311"
_DPI = 130


def _save(figure: Figure, path: Path) -> None:
    save_figure(path, figure, dpi=_DPI, metadata={"Software": None})


def draw_pairs(result: Result, path: Path) -> None:
    """Draw temperature slopes of every pair as printed (Table 8) and of its mean as recomputed, in physical units."""
    figure = new_figure(11, 6.2)
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
            axes.bar_label(
                bars,
                [(f"{pair['reduction']:.3g} times less" if pair["reduction"] > 1.05 else "no less") for pair in pairs],
                padding=3,
                fontsize=8,
            )
    names = [
        f"{pair['first']}, {pair['second'].split()[0]}{' *' if pair['carries_1g'] else ''}\n{pair['relation']}"
        for pair in pairs
    ]
    axes.set_yticks(range(len(pairs)), names)
    axes.invert_yaxis()
    axes.set_xlabel(f"size of the slope, {unit}")
    axes.margins(x=0.2)
    axes.spines[["top", "right"]].set_visible(False)


def draw_blending(result: Result, path: Path) -> None:
    """Draw the noise of every accelerometer axis (Table 10) and the result of weighting two ranges of BMA180."""
    figure = new_figure(11, 4.6)
    remaining, right = figure.subplots(1, 2)
    rows = [row for row in result["table10"] if row.get("unit") == "mg"]
    out_of_plane = [row["channel"].endswith("z") for row in rows]
    remaining.bar(range(len(rows)), [row["noise"] for row in rows], color=[_OTHER if z else _ONE for z in out_of_plane])
    remaining.set_xticks(range(len(rows)), [f"{row['channel']}" for row in rows], rotation=90)
    remaining.bar(0, 0, color=_ONE, label="x and y, in the plane")
    remaining.bar(0, 0, color=_OTHER, label="z, out of the plane")
    remaining.legend(frameon=False)
    remaining.set_ylabel("standard deviation, mg")
    remaining.set_title("noise of each axis (BMA3, BMA4 at 1.5 g, others at 16 g)", fontsize=10)
    _draw_weights(right, result["blending"])
    for axes in (remaining, right):
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
    """Draw BMA1's runs with the boot fault (Table 6) and Gyro3's two bias states (Table 7)."""
    figure = new_figure(11, 4.8)
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


SEGMENT = 2048
"""Rows of a segment of a spectrum, which is averaged over all segments."""
LAGS = 31
_STEP_S = 10.0


class TimeCurve(NamedTuple):
    """A curve over time: seconds (n,), LSB (n, k)."""

    seconds: Floats
    lsb: Floats


class Scatter(NamedTuple):
    """An axis against temperature: degC (n,), LSB (n,) of some of the readings, and the line through all of them."""

    degc: Floats
    lsb: Floats
    slope: float
    intercept: float


def rate_hz(series: Series) -> float:
    """Return the readings per second."""
    return float((len(series.time_ns) - 1) / (series.time_ns[-1] - series.time_ns[0]) * 1e9)


def smooth(series: Series, window_s: float = WINDOW_S, step_s: float = _STEP_S) -> TimeCurve:
    """Return the moving average minus the total mean, every `step_s`, at the middle of the window (Figure 6)."""
    rows, step = (max(1, round(seconds * rate_hz(series))) for seconds in (window_s, step_s))
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(series.counts, axis=0, dtype=float)])
    starts = np.arange(0, len(sums) - rows, step)
    means = (sums[starts + rows] - sums[starts]) / rows
    middle = (series.time_ns[starts] + series.time_ns[starts + rows - 1]) / 2e9
    return TimeCurve(middle, means - series.counts.mean(axis=0))


def profile(step_s: float = _STEP_S) -> TimeCurve:
    """Return the temperature (degC, in place of LSB) of the box while it is heated (Figure 7)."""
    motion = Heating()
    seconds = np.arange(0.0, motion.seconds + step_s / 2, step_s)
    degc = np.asarray(motion.stimulus((seconds * 1e9).astype(np.int64)).temperature_degc, float)
    return TimeCurve(seconds, degc[:, None])


_SCATTER_S = 4.0
"""Time in s between the readings of Figures 8 and 9."""
_HALF_MINUTE_S = 30.0


def against_temperature(observed: ExperimentData, channel: str) -> Scatter:
    """Return a channel such as "Gyro2 x" of a sensor of `WARMED` against temperature (Figures 8 and 9)."""
    name, letter = channel.split()
    axis, series, line = "xyz".index(letter), observed.warm[name], observed.heated[name]
    sampled = slice(None, None, max(1, round(_SCATTER_S * rate_hz(series))))
    degc = np.asarray(Heating().stimulus(series.time_ns[sampled]).temperature_degc, float)
    lsb = series.counts[sampled, axis].astype(float)
    return Scatter(degc, lsb, float(line.slope[axis]), float(line.intercept[axis]))


def opposed(observed: ExperimentData) -> TimeCurve:
    """Return Gyro1 y, Gyro2 y and half of their difference while heated, averaged over half a minute (Figure 10)."""
    means = []
    for name in ("Gyro1", "Gyro2"):
        series = observed.warm[name]
        rows = round(_HALF_MINUTE_S * rate_hz(series))
        whole = len(series.counts) // rows * rows
        means.append(series.counts[:whole, 1].reshape(-1, rows).mean(axis=1))
    first, second = means
    seconds = np.asarray((np.arange(len(first)) + 0.5) * _HALF_MINUTE_S, float)
    return TimeCurve(seconds, np.column_stack([first, second, (first - second) / 2]))


def correlogram(counts: Counts) -> Floats:
    """Return (31, 3) autocorrelation at lags 0 to 30 (Figure 13)."""
    return np.array([autocorrelation(counts, lag) if lag else np.ones(3) for lag in range(LAGS)])


def spectrum(counts: Counts, rate: float) -> tuple[Floats, Floats]:
    """Return Hz (k,) and amplitude density (k, 3) in LSB/sqrt(Hz) by Welch (Figures 14, 17 and 19), without 0 Hz and
    the Nyquist frequency, which are half a bin wide.
    """
    hz, power = signal.welch(counts.astype(float), rate, nperseg=SEGMENT, axis=0)
    return np.asarray(hz[1:-1]), np.sqrt(power[1:-1])


def histogram(counts: Counts) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return codes (k,) from the lowest to the highest, and the number of readings of each (Figure 15)."""
    lowest = int(counts.min())
    often = np.bincount(counts.astype(np.int64) - lowest)
    return np.arange(lowest, lowest + len(often)), often


_GREY, _BLUE, _RED, _GREEN, _PINK, _ORANGE = PALETTE
_SENSOR_COLOURS = (_BLUE, _RED, _GREEN)
_AXIS_DASHES: Mapping[str, tuple[float, ...]] = {"x": (), "y": (5, 1.5), "z": (1.2, 1.2)}
_GROUPS = (
    ("ADXL345, ±16 g", ("ADXL1", "ADXL2")),
    ("BMA180, ±1.5 g", ("BMA3", "BMA4")),
    ("L3G4200D", ("Gyro1", "Gyro2", "Gyro3")),
)
_RANGES = {"250dps": ("±250 dps", 0.00875, _BLUE), "2k dps": ("±2000 dps", 0.07, _RED)}
"""Keyed by Table 9's name: the name here, dps per count (L3G-40, L3G-42), colour."""
_OF_AXES = {"x": _BLUE, "y": _RED, "z": _GREEN}
_MILLI_G = {"ADXL1": 1000 / 256, "BMA2": 1000 / 512}
"""mg per count (ADX-40, BMA-76)."""


def in_run_figure(observed: ExperimentData) -> Figure:
    """Draw a figure like Figure 6: a continuous run, averaged over five minutes, minus its mean."""
    figure, panels = _sheet(7.5, 8.0, 3)
    for panel, (title, names) in zip(panels, _GROUPS, strict=True):
        for name, colour in zip(names, _SENSOR_COLOURS, strict=False):
            curve = smooth(observed.still[name])
            for axis, values in zip("xyz", curve.lsb.T, strict=True):
                panel.plot(curve.seconds / 60, values, color=colour, dashes=_AXIS_DASHES[axis], linewidth=1.3)
        panel.axhline(0, color="black", linewidth=0.6)
        panel.set_ylabel("output − mean (LSB)")
        _title(panel, title)
        _legend(panel, dict(zip(names, _SENSOR_COLOURS, strict=False)))
    panels[-1].set_xlabel("time (min)")
    return figure


def profile_figure() -> Figure:
    """Draw a figure like Figure 7: the temperature while the box is heated twice."""
    figure, (panel,) = _sheet(7.5, 3.0, 1)
    _draw_profile(panel)
    panel.set_xlabel("time (min)")
    return figure


def temperature_figure(observed: ExperimentData, channel: str, slope: float, intercept: float) -> Figure:
    """Draw figures like Figures 8 and 9: readings against temperature, the line through them, and the printed one."""
    figure, (panel,) = _sheet(7.5, 4.2, 1)
    result = against_temperature(observed, channel)
    points = panel.plot(result.degc, result.lsb, color=_GREY, linestyle="none", marker=".", markersize=3, alpha=0.35)
    points[0].set_label("readings, one in four seconds")
    ends = np.array([result.degc.min(), result.degc.max()])
    simulated = f"simulated: {result.slope:+.3f} LSB/°C, {result.intercept:.2f} LSB at 0 °C"
    panel.plot(ends, result.slope * ends + result.intercept, color=_RED, linewidth=2.2, label=simulated)
    published = f"Table 8: {slope:+.3f} LSB/°C, {intercept:.2f} LSB at 0 °C"
    panel.plot(ends, slope * ends + intercept, color="black", linewidth=1.4, linestyle="--", label=published)
    panel.set_xlabel("temperature (°C)")
    panel.set_ylabel(f"{channel} (LSB)")
    panel.legend(frameon=False, fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=1)
    return figure


def opposed_figure(observed: ExperimentData) -> Figure:
    """Draw a figure like Figure 10: two gyroscopes that point in opposite directions and half of their difference."""
    figure, (panel, lower_panel) = _sheet(7.5, 5.6, 2, (5, 2))
    curve = opposed(observed)
    styles = (("Gyro1 y", _BLUE), ("Gyro2 y", _RED), ("half of the difference", _GREEN))
    for (label, colour), values in zip(styles, curve.lsb.T, strict=True):
        panel.plot(curve.seconds / 60, values, color=colour, linewidth=1.5, label=label)
    panel.set_ylabel("output (LSB)")
    panel.legend(frameon=False, fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    _draw_profile(lower_panel)
    lower_panel.set_xlabel("time (min)")
    return figure


def gyro_allan_figure(observed: ExperimentData) -> Figure:
    """Draw a figure like Figure 11: Allan deviation of Gyro1 alone at both ranges."""
    figure, (panel,) = _sheet(7.5, 4.8, 1)
    for name, (_, dps, colour) in _RANGES.items():
        counts = observed.high_rate[name].counts
        _draw_allan(panel, counts, HIGH_RATE_HZ, dps, dict.fromkeys("xyz", colour))
    _finish_allan(panel, "Allan deviation (dps)")
    _legend(panel, {label: colour for label, _, colour in _RANGES.values()})
    return figure


def gyro_memory_figure(observed: ExperimentData) -> Figure:
    """Draw figures like Figures 13 and 14: autocorrelation and spectrum of Gyro1 at 250 dps."""
    figure, (upper, lower) = _sheet(7.5, 6.4, 2, shared=False)
    counts = observed.high_rate["250dps"].counts
    for axis, values in zip("xyz", correlogram(counts).T, strict=True):
        upper.plot(values, color=_OF_AXES[axis], dashes=_AXIS_DASHES[axis], marker="o", markersize=3, linewidth=1.2)
    upper.axhline(0.4, color="black", linewidth=0.8, linestyle=":")
    upper.annotate("0.4", (30, 0.4), xytext=(0, 3), textcoords="offset points", ha="right", fontsize=9)
    upper.set(xlabel="lag (samples)", ylabel="autocorrelation")
    _axes_legend(upper)
    _draw_spectrum(lower, counts, HIGH_RATE_HZ, _RANGES["250dps"][1])
    lower.set_ylabel("density (dps/√Hz)")
    return figure


def histogram_figure(observed: ExperimentData) -> Figure:
    """Draw a figure like Figure 15: the number of readings of each code of Gyro1 x, at both ranges, and the normal
    curve with their mean and standard deviation.
    """
    figure, panels = _sheet(7.5, 5.0, 2, shared=False)
    for panel, (name, (label, _, colour)) in zip(panels, _RANGES.items(), strict=True):
        counts = observed.high_rate[name].counts[:, 0]
        codes, often = histogram(counts)
        panel.stairs(often / 1000, np.append(codes, codes[-1] + 1) - 0.5, color=colour, fill=True, alpha=0.45)
        mean, std = float(counts.mean()), float(counts.std())
        fine = np.linspace(codes[0], codes[-1], 300)
        normal = len(counts) * np.exp(-(((fine - mean) / std) ** 2) / 2) / (std * np.sqrt(2 * np.pi))
        panel.plot(fine, normal / 1000, color="black", linewidth=1.0, label=f"normal, {std:.2f} LSB")
        _title(panel, label)
        panel.set_ylabel("readings (thousands)")
        panel.legend(frameon=False, fontsize=9, loc="upper right")
    panels[-1].set_xlabel("Gyro1 x (LSB; bins of 1 LSB)")
    return figure


def accelerometer_figure(observed: ExperimentData, name: str) -> Figure:
    """Draw figures like Figures 16 to 19: Allan deviation and spectrum of an accelerometer, from the continuous run."""
    figure, (upper, lower) = _sheet(7.5, 6.8, 2, shared=False)
    series, scale = observed.still[name], _MILLI_G[name]
    _draw_allan(upper, series.counts, rate_hz(series), scale, _OF_AXES)
    _finish_allan(upper, "Allan deviation (mg)")
    _axes_legend(upper)
    _draw_spectrum(lower, series.counts, rate_hz(series), scale)
    lower.set_ylabel("density (mg/√Hz)")
    return figure


def _draw_profile(panel: Axes) -> None:
    warmth = profile()
    panel.plot(warmth.seconds / 60, warmth.lsb, color=_ORANGE, linewidth=1.8)
    panel.set_ylabel("temperature (°C)")


def _draw_allan(panel: Axes, counts: Counts, rate: float, scale: float, colours: Mapping[str, str]) -> None:
    curve = allan_deviation(counts, 1 / rate, estimator="decimated")
    for axis, deviation in zip("xyz", curve.deviation.T, strict=True):
        panel.plot(
            curve.tau_s, scale * deviation, color=colours[axis], dashes=_AXIS_DASHES[axis], marker="o", markersize=2.5
        )


def _finish_allan(panel: Axes, label: str) -> None:
    """Set logarithmic scales and plain numbers, and draw a grey line of slope -1/2 below the curves: the slope of white
    noise.
    """
    from matplotlib.ticker import FuncFormatter

    points = [np.asarray(line.get_xydata(), float) for line in panel.get_lines()]
    ends = np.array([min(p[0, 0] for p in points), max(p[-1, 0] for p in points)])
    lowest = min(float((p[:, 1] * np.sqrt(p[:, 0])).min()) for p in points)
    panel.plot(ends, 0.7 * lowest / np.sqrt(ends), color=_GREY, linewidth=1.0)
    panel.set(xscale="log", yscale="log", xlabel="averaging time τ (s)", ylabel=label)
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.grid(which="major", color="0.88", linewidth=0.8)


def _draw_spectrum(panel: Axes, counts: Counts, rate: float, scale: float) -> None:
    hz, density = spectrum(counts, rate)
    for axis in "yxz":  # the y axis may have a line that would hide the others
        panel.plot(hz, scale * density[:, "xyz".index(axis)], color=_OF_AXES[axis], linewidth=0.8)
    panel.set_ylim(0, None)
    panel.set_xlabel("frequency (Hz)")
    _axes_legend(panel, dashed=False)


def _sheet(
    width: float, height: float, rows: int, ratios: Sequence[float] | None = None, *, shared: bool = True
) -> tuple[Figure, list[Any]]:
    """Return an empty figure (inches) that needs no display, and its panels; MissingExtraError without matplotlib."""
    figure = new_figure(width, height)
    grid = figure.subplots(rows, 1, sharex=shared, squeeze=False, height_ratios=ratios)
    figure.suptitle("simulated", x=0.995, ha="right", fontsize=8, color="0.4")
    panels = list(grid[:, 0])
    for panel in panels:
        panel.spines[["top", "right"]].set_visible(False)
    figure.align_ylabels(panels)
    return figure, panels


def _title(panel: Axes, text: str) -> None:
    panel.set_title(text, loc="left", fontsize=10)


def _legend(panel: Axes, colours: Mapping[str, str]) -> None:
    """Place a legend above the panel, at its right: names by colour, axes by dashes."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colour, linewidth=3, label=name) for name, colour in colours.items()]
    for axis, dashes in _AXIS_DASHES.items():
        handles.append(Line2D([], [], color="0.25", linewidth=1.3, dashes=dashes, label=axis))
    panel.legend(handles=handles, loc="lower right", bbox_to_anchor=(1, 1), frameon=False, fontsize=8, ncols=6)


def _axes_legend(panel: Axes, *, dashed: bool = True) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=colour, linewidth=2, dashes=_AXIS_DASHES[axis] if dashed else (), label=axis)
        for axis, colour in _OF_AXES.items()
    ]
    panel.legend(handles=handles, loc="lower right", bbox_to_anchor=(1, 1), frameon=False, fontsize=9, ncols=3)
