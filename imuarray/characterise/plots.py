"""The Allan deviation of every sensor axis as one figure: a panel per quantity, log-log, with confidence bands.

Needs matplotlib (extra "report"), imported when a figure is drawn. A bare `Figure` with the Agg canvas: no display, no
global state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from imuarray.errors import MissingExtraError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's palette (Color Universal Design, 2008) without its yellow, which white paper swallows."""

_DASHES = ((), (5, 1.5), (1.2, 1.2), (5, 1.2, 1.2, 1.2))
_TITLES = {
    "specific_force": "Accelerometers",
    "angular_rate": "Gyroscopes",
    "magnetic_field": "Magnetometers",
    "pressure": "Barometers",
    "temperature": "Thermometers",
}
_LEGEND_ROWS = 22


def allan_figure(result: Mapping[str, Any]) -> Figure:
    """Allan deviations of a `characterise_log` result in the sensors' units (g, dps, gauss; counts if there is none).

    Colour is the sensor, dashes are the axis, the light band is the 95 % interval; more sensors than the palette has
    colours get thin lines without bands. MissingExtraError if there is no matplotlib.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError("matplotlib", "report") from None
    drawn = [sensor for sensor in result["sensors"] if any(axis["allan"] for axis in sensor["axes"])]
    kinds = list(dict.fromkeys((sensor["quantity"], _unit(sensor)) for sensor in drawn))
    figure = Figure(figsize=(10.0, 1.0 + 4.2 * max(1, len(kinds))), layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    figure.suptitle(_title(result), fontsize=11)
    if not kinds:
        figure.text(0.5, 0.4, "no sensor has an unbroken run long enough for an Allan deviation", ha="center")
        return figure
    panels = figure.subplots(len(kinds), 1, squeeze=False)[:, 0]
    for panel, kind in zip(panels, kinds, strict=True):
        _draw(panel, kind, [sensor for sensor in drawn if (sensor["quantity"], _unit(sensor)) == kind])
    figure.align_ylabels(panels)
    panels[-1].set_xlabel("averaging time τ (s)")
    return figure


def _unit(sensor: Mapping[str, Any]) -> str:
    return str(sensor["unit"]) if sensor["unit_per_count"] is not None else "counts"


def _title(result: Mapping[str, Any]) -> str:
    stretch = result["stretch"]
    emulated = " (emulated, no hardware)" if result["source"] == "emulated" else ""
    which = "the whole log" if stretch["phase"] is None else f"phase {stretch['phase']}"
    length_s = stretch["end_s"] - stretch["start_s"]
    name = str(result["log"]).replace("\\", "/").rsplit("/", 1)[-1]
    return _plain(f"Overlapping Allan deviation of {name}{emulated}: {which}, {length_s:.4g} s")


def _plain(text: str) -> str:
    """Text in which matplotlib sees no mathematics."""
    return text.replace("$", r"\$")


def _draw(panel: Axes, kind: tuple[str, str], sensors: Sequence[Mapping[str, Any]]) -> None:
    """One quantity's curves, bands, guide and legends."""
    quantity, unit = kind
    colours = _colours(len(sensors))
    crowded = len(sensors) > len(COLOURS)
    for sensor, colour in zip(sensors, colours, strict=True):
        scale = sensor["unit_per_count"] if unit != "counts" else 1.0
        for axis, dashes in zip(sensor["axes"], cycle(_DASHES), strict=False):
            if axis["allan"]:
                _draw_axis(panel, axis["allan"], scale, colour, dashes, crowded)
    panel.set(xscale="log", yscale="log")
    panel.set_ylabel(f"Allan deviation ({unit})")
    panel.set_title(_TITLES.get(quantity, quantity), loc="left", fontsize=10, fontweight="bold")
    panel.grid(which="major", color="0.88", linewidth=0.8)
    panel.grid(which="minor", color="0.95", linewidth=0.5)
    panel.set_axisbelow(True)
    panel.spines[["top", "right"]].set_visible(False)
    _frame(panel)
    _legends(panel, sensors, colours)


def _draw_axis(
    panel: Axes, allan: Mapping[str, Any], scale: float, colour: Any, dashes: tuple[float, ...], crowded: bool
) -> None:
    """One curve, with its band if there is room; a constant series can't stand on a logarithmic scale."""
    tau_s, deviation, low, high = (np.array(allan[name], float) for name in ("tau_s", "deviation", "low", "high"))
    shown = deviation > 0
    if not shown.any():
        return
    tau_s, deviation, low, high = tau_s[shown], deviation[shown] * scale, low[shown] * scale, high[shown] * scale
    line = panel.plot(tau_s, deviation, color=colour, linewidth=0.6 if crowded else 1.4)[0]
    if not crowded:
        line.set(marker="o", markersize=2.2)
        panel.fill_between(tau_s, low, high, color=colour, alpha=0.06, linewidth=0)
    if dashes:
        line.set_dashes(dashes)


def _frame(panel: Axes) -> None:
    """Limits by the curves alone (bands may leave them), plain numbers at the ticks, and the guide.

    The guide is a grey line of slope -1/2 below the curves: what falls like it is white noise.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    points = [(np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)) for line in panel.get_lines()]
    if not points:
        return
    left, right = panel.get_xlim()
    lowest, highest = (float(f([f(deviation) for _, deviation in points])) for f in (np.min, np.max))
    lowest_white = min(float(np.min(deviation * np.sqrt(tau_s))) for tau_s, deviation in points)
    ends_s = np.array([left, right])
    panel.plot(ends_s, 0.7 * lowest_white / np.sqrt(ends_s), color="0.6", linewidth=1.0, zorder=0.5)
    panel.set(xlim=(left, right), ylim=(lowest / 1.6, highest * 1.6))
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    panel.xaxis.set_major_formatter(plain)
    panel.yaxis.set_major_formatter(plain)
    panel.yaxis.set_minor_locator(LogLocator(subs=(2, 5)))
    panel.yaxis.set_minor_formatter(plain if highest / lowest < 100 else NullFormatter())
    panel.tick_params(axis="y", which="minor", labelsize=8, labelcolor="0.35")


def _colours(count: int) -> list[Any]:
    """So many colours that can be told apart; beyond the palette, an even walk through cividis."""
    if count <= len(COLOURS):
        return list(COLOURS[:count])
    from matplotlib import colormaps

    return list(colormaps["cividis"](np.linspace(0, 0.95, count)))


def _legends(panel: Axes, sensors: Sequence[Mapping[str, Any]], colours: Sequence[Any]) -> None:
    """Beside the panel: sensors by colour, axes by dashes."""
    from matplotlib.lines import Line2D

    names = list(dict.fromkeys(axis["axis"] for sensor in sensors for axis in sensor["axes"]))
    handles = [
        Line2D([], [], color=colour, linewidth=3, label=_plain(_label(sensor)))
        for sensor, colour in zip(sensors, colours, strict=True)
    ]
    for name, dashes in zip(names, cycle(_DASHES), strict=False):
        handle = Line2D([], [], color="0.25", linewidth=1.4, label=f"axis {_plain(name)}")
        if dashes:
            handle.set_dashes(dashes)
        handles.append(handle)
    handles.append(Line2D([], [], color="0.6", linewidth=1.0, label="slope −1/2"))
    if len(sensors) <= len(COLOURS):
        handles.append(Line2D([], [], color="0.88", linewidth=6.0, label="bands: 95 %"))
    panel.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        frameon=False,
        fontsize=8,
        ncols=1 + (len(handles) - 1) // _LEGEND_ROWS,
        handlelength=2.4,
    )


def _label(sensor: Mapping[str, Any]) -> str:
    scale = f" ±{sensor['range']:g} {sensor['unit']}" if sensor["range"] else ""
    return f"{sensor['name']}{scale}"
