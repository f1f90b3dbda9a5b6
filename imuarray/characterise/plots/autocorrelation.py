"""The autocorrelation of every sensor axis: a panel per quantity; axes that are not white noise stand out in colour."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from imuarray.characterise.plots.frame import (
    FALSE_ALARM,
    AxisCurve,
    Captions,
    SensorPanel,
    Table,
    count_axes,
    floats,
    legend,
    panel_figure,
    plot,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NORMAL_95 = 1.96
"""Half-width, in standard errors, of the interval that contains 95 % of normal estimates."""

_READING = (
    "Correlation of a reading with the one so many rows later. Of white noise 1 point in 20 leaves the grey band.\nIn "
    "colour: axes whose points as a whole are not white noise (Ljung and Box, 1 % for the whole figure); the others "
    "are grey."
)


def autocorrelation_figure(result: Table) -> Figure:
    """Autocorrelations from lag 1 on, with the 95 % band of no correlation (of the sensor with the fewest rows).

    Axes whose p-value, times the number of axes, is up to 1 % are drawn in colour. MissingExtraError if there is no
    matplotlib.
    """
    level = FALSE_ALARM / count_axes(result)
    captions = Captions("Autocorrelation", _READING, "no sensor has an unbroken run long enough for an autocorrelation")
    return panel_figure(result, captions, _is_shown, partial(_draw, level=level), 3.2)


def _is_shown(axis: Table) -> bool:
    """Return whether the axis has a correlation; a constant or very short series has none."""
    return "autocorrelation" in axis and any(value is not None for value in axis["autocorrelation"]["correlation"][1:])


def _draw(panel: Axes, kind: SensorPanel, level: float) -> None:
    """Draw curves of one quantity, the grey ones below, with band and legend."""
    curves = [curve for curve in kind.curves() if _is_shown(curve.axis)]
    half = NORMAL_95 * max(curve.axis["autocorrelation"]["error"][1] for curve in curves)
    panel.axhspan(-half, half, color="0.93", zorder=0.4, linewidth=0)
    panel.axhline(0.0, color="0.6", linewidth=0.8, zorder=0.5)
    for curve in curves:
        values = floats(curve.axis["autocorrelation"]["correlation"])[1:]
        lags = np.arange(1.0, len(values) + 1)
        if stands_out(curve.axis, level):
            plot(panel, lags, values, curve, linewidth=1.2, marker="" if kind.is_crowded else "o", markersize=2.2)
        else:
            panel.plot(lags, values, color="0.7", linewidth=0.6, zorder=1.5)
    panel.set(xlabel="lag (rows)", ylabel="autocorrelation", xlim=(0, None))
    _legend(panel, kind, curves, half, level)


def _legend(panel: Axes, kind: SensorPanel, curves: list[AxisCurve], half: float, level: float) -> None:
    """Draw the legend: the sensors in colour, the grey ones as one entry, and the band."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    coloured = [curve for curve in curves if stands_out(curve.axis, level)]
    sensors = {curve.sensor["name"]: (curve.sensor, curve.colour) for curve in coloured}
    pairs = tuple(sensors.values())
    named = replace(kind, sensors=tuple(pair[0] for pair in pairs), colours=tuple(pair[1] for pair in pairs))
    more: list[Artist] = [Patch(color="0.93", label=f"±{half:.2g}: 95 % of white noise")]
    if len(coloured) < len(curves):
        more.insert(0, Line2D([], [], color="0.7", linewidth=0.8, label="like white noise"))
    legend(panel, named, more)


def stands_out(axis: Table, level: float) -> bool:
    """Return whether white noise would correlate like this with a chance of at most `level`."""
    p_value = axis["autocorrelation"]["p_value"]
    return p_value is not None and p_value <= level
