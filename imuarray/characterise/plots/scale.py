"""Draws a panel's scales with few artists.

Matplotlib creates five artists for every tick: two marks, a grid line and two labels. In figures of many panels, or
with logarithmic scales, that takes longer than drawing the curves. A `Scale` draws with one tick in place of all: all
its marks at once, all its grid lines at once, and its labels one after the other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.text import Text
from matplotlib.transforms import ScaledTranslation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.ticker import Formatter

_OFFSET_PT = 18.0
"""Distance in points of the common offset of the labels (such as 3e4) from a horizontal scale: below its labels."""

_TOLERANCE = 1e-10
"""Distance beyond an end of the scale, as a share of its length, at which a tick is still drawn; matplotlib's."""


def replace_scales(panel: Axes) -> None:
    """Let a `Scale` draw each visible axis of a panel. Call it last: positions of the axes' labels must be set."""
    for which, axis in (("x", panel.xaxis), ("y", panel.yaxis)):
        if axis.get_visible():
            panel.add_artist(Scale(panel, which))
            axis.set_visible(False)


class Scale(Artist):
    """The ticks, the grid and the label of an axis ("x" or "y") of a panel, where the axis' locators place them."""

    def __init__(self, panel: Axes, which: str) -> None:
        super().__init__()
        self._panel, self._is_horizontal = panel, which == "x"
        self._axis = panel.xaxis if self._is_horizontal else panel.yaxis
        self.set_zorder(self._axis.get_zorder())

    def draw(self, renderer: Any) -> None:
        """Draw the scale."""
        axis = self._axis
        self._draw_ticks(renderer, axis.get_majorticklocs(), axis.get_major_formatter(), axis.get_major_ticks)
        self._draw_offset(renderer, axis.get_major_formatter().get_offset())
        self._draw_ticks(renderer, axis.get_minorticklocs(), axis.get_minor_formatter(), axis.get_minor_ticks)
        axis.label.draw(renderer)

    def _draw_ticks(self, renderer: Any, places: Any, formatter: Formatter, ticks: Callable[[int], list[Any]]) -> None:
        """Draw all major or all minor ticks; `ticks` makes a list with a number of ticks of this kind."""
        labels = formatter.format_ticks(places)
        transform = self._axis.get_transform()
        low, high = np.sort(transform.transform(self._axis.get_view_interval()))
        margin = _TOLERANCE * (high - low)
        shown = [
            (float(place), label)
            for place, label, at in zip(places, labels, transform.transform(np.asarray(places, float)), strict=True)
            if low - margin <= at <= high + margin
        ]
        if not shown:
            return
        tick = ticks(1)[0]
        at = np.array([place for place, _ in shown])
        lines = np.repeat(at, 3), np.tile([0.0, 1.0, np.nan], len(at))
        marks = ((tick.tick1line, at, np.zeros(len(at))), (tick.tick2line, at, np.ones(len(at))))
        for line, along, across in ((tick.gridline, *lines), *marks):
            if line.get_visible():
                line.set_data(*((along, across) if self._is_horizontal else (across, along)))
                line.draw(renderer)
        for text in (tick.label1, tick.label2):
            for place, label in shown if text.get_visible() else ():
                if label:
                    (text.set_x if self._is_horizontal else text.set_y)(place)
                    text.set_text(label)
                    text.draw(renderer)

    def _draw_offset(self, renderer: Any, offset: str) -> None:
        """Write the number that all labels are relative to, if there is one, at the end of the scale."""
        if not offset:
            return
        figure, font = self._panel.figure, self._axis.get_offset_text().get_fontproperties()
        if self._is_horizontal:
            text = Text(1.0, 0.0, offset, ha="right", va="top", fontproperties=font)
        else:
            text = Text(0.0, 1.0, offset, ha="left", va="bottom", fontproperties=font)
        below = ScaledTranslation(0, -_OFFSET_PT / 72 if self._is_horizontal else 0, figure.dpi_scale_trans)
        text.set_figure(figure)
        text.set_transform(self._panel.transAxes + below)
        text.draw(renderer)
