"""The paper's Figures 6 to 19 from the simulated experiments, in its axes and units. Colour is the sensor or the range,
dashes are the axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from imuarray.characterise import allan_deviation
from imuarray.errors import MissingExtraError
from imuarray.report.figures import PALETTE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from imuarray.paper.replica import Curves
    from imuarray.paper.replica.curves import Noise

_GREY, _BLUE, _RED, _GREEN, _PINK, _ORANGE = PALETTE
_SENSOR_COLOURS = (_BLUE, _RED, _GREEN)
_AXIS_DASHES: Mapping[str, tuple[float, ...]] = {"x": (), "y": (5, 1.5), "z": (1.2, 1.2)}
_GROUPS = (
    ("ADXL345, ±16 g", ("ADXL1", "ADXL2")),
    ("BMA180, ±1.5 g", ("BMA3", "BMA4")),
    ("L3G4200D", ("Gyro1", "Gyro2", "Gyro3")),
)
_RANGES = {"250dps": ("±250 dps", 0.00875, _BLUE), "2k dps": ("±2000 dps", 0.07, _RED)}
"""By Table 9's name: the name here, dps per count (L3G-40, L3G-42), colour."""
_OF_AXES = {"x": _BLUE, "y": _RED, "z": _GREEN}
_MILLI_G = {"ADXL1": 1000 / 256, "BMA2": 1000 / 512}
"""mg per count (ADX-40, BMA-76)."""


def in_run_figure(curves: Curves) -> Figure:
    """Like Figure 6: a continuous run, averaged over five minutes, less its mean."""
    figure, panels = _sheet(7.5, 8.0, 3)
    for panel, (title, names) in zip(panels, _GROUPS, strict=True):
        for name, colour in zip(names, _SENSOR_COLOURS, strict=False):
            curve = curves.in_run[name]
            for axis, values in zip("xyz", curve.lsb.T, strict=True):
                panel.plot(curve.seconds / 60, values, color=colour, dashes=_AXIS_DASHES[axis], linewidth=1.3)
        panel.axhline(0, color="black", linewidth=0.6)
        panel.set_ylabel("output − mean (LSB)")
        _title(panel, title)
        _legend(panel, dict(zip(names, _SENSOR_COLOURS, strict=False)))
    panels[-1].set_xlabel("time (min)")
    return figure


def profile_figure(curves: Curves) -> Figure:
    """Like Figure 7: the temperature while the box is heated twice."""
    figure, (panel,) = _sheet(7.5, 3.0, 1)
    _draw_profile(panel, curves)
    panel.set_xlabel("time (min)")
    return figure


def temperature_figure(curves: Curves, channel: str, slope: float, intercept: float) -> Figure:
    """Like Figures 8 and 9: readings against temperature, the line through them, and the printed one."""
    figure, (panel,) = _sheet(7.5, 4.2, 1)
    found = curves.against_temperature[channel]
    points = panel.plot(found.degc, found.lsb, color=_GREY, linestyle="none", marker=".", markersize=3, alpha=0.35)
    points[0].set_label("readings, one in four seconds")
    ends = np.array([found.degc.min(), found.degc.max()])
    ours = f"simulated: {found.slope:+.3f} LSB/°C, {found.intercept:.2f} LSB at 0 °C"
    panel.plot(ends, found.slope * ends + found.intercept, color=_RED, linewidth=2.2, label=ours)
    theirs = f"Table 8: {slope:+.3f} LSB/°C, {intercept:.2f} LSB at 0 °C"
    panel.plot(ends, slope * ends + intercept, color="black", linewidth=1.4, linestyle="--", label=theirs)
    panel.set_xlabel("temperature (°C)")
    panel.set_ylabel(f"{channel} (LSB)")
    panel.legend(frameon=False, fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=1)
    return figure


def opposed_figure(curves: Curves) -> Figure:
    """Like Figure 10: two gyroscopes that point in opposite directions and half of their difference."""
    figure, (panel, below) = _sheet(7.5, 5.6, 2, (5, 2))
    curve = curves.opposed
    styles = (("Gyro1 y", _BLUE), ("Gyro2 y", _RED), ("half of the difference", _GREEN))
    for (label, colour), values in zip(styles, curve.lsb.T, strict=True):
        panel.plot(curve.seconds / 60, values, color=colour, linewidth=1.5, label=label)
    panel.set_ylabel("output (LSB)")
    panel.legend(frameon=False, fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    _draw_profile(below, curves)
    below.set_xlabel("time (min)")
    return figure


def gyro_allan_figure(curves: Curves) -> Figure:
    """Like Figure 11: Allan deviation of Gyro1 alone at both ranges."""
    figure, (panel,) = _sheet(7.5, 4.8, 1)
    for name, (_, dps, colour) in _RANGES.items():
        _draw_allan(panel, curves.noise[name], dps, dict.fromkeys("xyz", colour))
    _finish_allan(panel, "Allan deviation (dps)")
    _legend(panel, {label: colour for label, _, colour in _RANGES.values()})
    return figure


def gyro_memory_figure(curves: Curves) -> Figure:
    """Like Figures 13 and 14: autocorrelation and spectrum of Gyro1 at 250 dps."""
    figure, (upper, lower) = _sheet(7.5, 6.4, 2, shared=False)
    noise = curves.noise["250dps"]
    for axis, values in zip("xyz", noise.correlogram.T, strict=True):
        upper.plot(values, color=_OF_AXES[axis], dashes=_AXIS_DASHES[axis], marker="o", markersize=3, linewidth=1.2)
    upper.axhline(0.4, color="black", linewidth=0.8, linestyle=":")
    upper.annotate("0.4", (30, 0.4), xytext=(0, 3), textcoords="offset points", ha="right", fontsize=9)
    upper.set(xlabel="lag (samples)", ylabel="autocorrelation")
    _axes_legend(upper)
    _draw_spectrum(lower, noise, _RANGES["250dps"][1])
    lower.set_ylabel("density (dps/√Hz)")
    return figure


def histogram_figure(curves: Curves) -> Figure:
    """Like Figure 15: how often Gyro1 x read each code, at both ranges, and the normal curve of that deviation."""
    figure, panels = _sheet(7.5, 5.0, 2, shared=False)
    for panel, (name, (label, _, colour)) in zip(panels, _RANGES.items(), strict=True):
        counts, codes, often = curves.noise[name].counts[:, 0], curves.noise[name].codes, curves.noise[name].often
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


def accelerometer_figure(curves: Curves, name: str) -> Figure:
    """Like Figures 16 to 19: Allan deviation and spectrum of an accelerometer, from the continuous run."""
    figure, (upper, lower) = _sheet(7.5, 6.8, 2, shared=False)
    _draw_allan(upper, curves.noise[name], _MILLI_G[name], _OF_AXES)
    _finish_allan(upper, "Allan deviation (mg)")
    _axes_legend(upper)
    _draw_spectrum(lower, curves.noise[name], _MILLI_G[name])
    lower.set_ylabel("density (mg/√Hz)")
    return figure


def _draw_profile(panel: Axes, curves: Curves) -> None:
    warmth = curves.profile
    panel.plot(warmth.seconds / 60, warmth.lsb, color=_ORANGE, linewidth=1.8)
    panel.set_ylabel("temperature (°C)")


def _draw_allan(panel: Axes, noise: Noise, scale: float, colours: Mapping[str, str]) -> None:
    curve = allan_deviation(noise.counts, 1 / noise.rate_hz, estimator="decimated")
    for axis, deviation in zip("xyz", curve.deviation.T, strict=True):
        panel.plot(
            curve.tau_s, scale * deviation, color=colours[axis], dashes=_AXIS_DASHES[axis], marker="o", markersize=2.5
        )


def _finish_allan(panel: Axes, label: str) -> None:
    """Logarithmic scales, plain numbers, and below the curves a grey line of slope -1/2: white noise falls so."""
    from matplotlib.ticker import FuncFormatter

    points = [np.asarray(line.get_xydata(), float) for line in panel.get_lines()]
    ends = np.array([min(p[0, 0] for p in points), max(p[-1, 0] for p in points)])
    lowest = min(float((p[:, 1] * np.sqrt(p[:, 0])).min()) for p in points)
    panel.plot(ends, 0.7 * lowest / np.sqrt(ends), color=_GREY, linewidth=1.0)
    panel.set(xscale="log", yscale="log", xlabel="averaging time τ (s)", ylabel=label)
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.grid(which="major", color="0.88", linewidth=0.8)


def _draw_spectrum(panel: Axes, noise: Noise, scale: float) -> None:
    for axis in "yxz":  # the y axis may have a line that the others would hide behind
        panel.plot(noise.hz, scale * noise.density[:, "xyz".index(axis)], color=_OF_AXES[axis], linewidth=0.8)
    panel.set_ylim(0, None)
    panel.set_xlabel("frequency (Hz)")
    _axes_legend(panel, dashed=False)


def _sheet(
    width: float, height: float, rows: int, ratios: Sequence[float] | None = None, *, shared: bool = True
) -> tuple[Figure, list[Any]]:
    """An empty figure (inches) that needs no display, and its panels; MissingExtraError without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError("matplotlib", "report") from None
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
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
    """Above the panel, at its right: names by colour, axes by dashes."""
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
