"""The Allan deviation of every sensor axis: a panel per quantity, log-log, with confidence bands and fitted noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imuarray.characterise.plots.frame import (
    AxisCurve,
    Captions,
    SensorPanel,
    Table,
    floats,
    legend,
    logarithmic,
    panel_figure,
    plot,
    scale_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_READING = (
    "Falls like the grey line: white noise, averaging helps. Flat: flicker noise, averaging longer does not help. "
    "Rises: drift.\n"
    "N is the white noise and K the random walk of the axes whose curve a sum of noises fits (thin curves)."
)


def allan_figure(result: Table) -> Figure:
    """Allan deviations in the sensors' units (g, dps, gauss; counts if there is none), and the curves of good fits.

    Colour is the sensor, dashes are the axis, the light band is the 95 % interval; more sensors than the palette has
    colours get thin lines without bands. MissingExtraError if there is no matplotlib.
    """
    captions = Captions("Allan deviation", _READING, "no sensor has an unbroken run long enough for an Allan deviation")
    return panel_figure(result, captions, _is_shown, _draw, 4.2)


def _is_shown(axis: Table) -> bool:
    """Return whether the axis has a curve; a constant series can't be drawn on a logarithmic scale."""
    return bool(axis["allan"]) and any(value > 0 for value in axis["allan"]["deviation"])


def _draw(panel: Axes, kind: SensorPanel) -> None:
    """Draw curves, bands, fits, guide and legend of one quantity."""
    from matplotlib.lines import Line2D

    for curve in kind.curves():
        if _is_shown(curve.axis):
            _draw_axis(panel, curve, kind.is_crowded)
    _scale(panel)
    panel.set(xlabel="averaging time τ (s)", ylabel=f"Allan deviation ({kind.unit})")
    more = [Line2D([], [], color="0.6", linewidth=1.0, label="slope −1/2: white noise")]
    if not kind.is_crowded:
        more.append(Line2D([], [], color="0.88", linewidth=6.0, label="bands: 95 %"))
    notes = {} if kind.is_crowded else {sensor["name"]: _note(sensor, kind.unit) for sensor in kind.sensors}
    legend(panel, kind, more, notes)


def _draw_axis(panel: Axes, curve: AxisCurve, is_crowded: bool) -> None:
    """Draw one curve, and its band and its fit if there is room."""
    allan = curve.axis["allan"]
    tau_s, deviation, low, high = (floats(allan[name]) for name in ("tau_s", "deviation", "low", "high"))
    is_positive = deviation > 0
    tau_s, deviation, low, high = (
        tau_s[is_positive],
        deviation[is_positive] * curve.scale,
        low[is_positive],
        high[is_positive],
    )
    style = {"linewidth": 0.6} if is_crowded else {"linewidth": 1.4, "marker": "o", "markersize": 2.2}
    plot(panel, tau_s, deviation, curve, **style)
    if not is_crowded:
        panel.fill_between(tau_s, low * curve.scale, high * curve.scale, color=curve.colour, alpha=0.06, linewidth=0)
    fit = curve.axis.get("fit")
    if fit and not fit["verdict"] and not is_crowded:
        fitted = floats(fit["deviation"]) * curve.scale
        panel.plot(floats(fit["tau_s"]), fitted, color=curve.colour, linewidth=0.5, alpha=0.8, gid="fit")


def _scale(panel: Axes) -> None:
    """Set the limits by the curves alone (bands may extend beyond them), and draw the guide.

    The guide is a grey line of slope -1/2 below the curves: parts of a curve with this slope are white noise.
    """
    points = [np.asarray(line.get_xydata()).T for line in panel.get_lines()]
    lowest, highest = (float(f([f(deviation) for _, deviation in points])) for f in (np.min, np.max))
    lowest_white = min(float(np.min(deviation * np.sqrt(tau_s))) for tau_s, deviation in points)
    logarithmic(panel, lowest, highest)
    ends_s = np.array(panel.get_xlim())
    panel.plot(ends_s, 0.7 * lowest_white / np.sqrt(ends_s), color="0.6", linewidth=1.0, zorder=0.5, gid="guide")
    panel.set(xlim=tuple(ends_s), ylim=(lowest / 1.6, highest * 1.6))


def _note(sensor: Table, unit: str) -> str:
    """White noise and random walk of a sensor's well fitted axes, from the least to the greatest, and the others."""
    fitted = [axis for axis in sensor["axes"] if axis.get("fit") and not axis["fit"]["verdict"]]
    unfit = [axis["axis"] for axis in sensor["axes"] if axis.get("fit") and axis["fit"]["verdict"]]
    lines = []
    for name, symbol, per in (("white", "N", "√Hz"), ("random walk", "K", "√s")):
        terms = [(axis["fit"]["terms"].get(name), scale_of(axis, unit)) for axis in fitted]
        significant = [(term, scale) for term, scale in terms if term and term["significant"] and term["low"] > 0]
        values = sorted(term["value"] * scale for term, scale in significant)
        if values:
            ends = dict.fromkeys(f"{value:.2g}" for value in (values[0], values[-1]))
            lines.append(f"\n{symbol} {' to '.join(ends)} {unit}/{per}")
    return "".join(lines) + (f"\nnot fitted: {', '.join(unfit)}" if unfit else "")
