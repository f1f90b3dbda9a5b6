"""The page's figures, drawn by Bokeh in the browser: axes and colours are defined here, the data are in the snapshots.

The page labels the curves next to the numbers above, in the same colours.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from imuarray.errors import MissingExtraError

COLOURS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"light": ("#0072B2", "#B94E00", "#007F5C"), "dark": ("#56B4E9", "#F0A03C", "#2BD1A0")}
)
"""Colours of x, y and z by theme, after Okabe and Ito's palette for all kinds of colour vision."""

_HEIGHT, _RIGHT = 150, 12
"""Height of a figure and its right margin, in pixels."""


class Theme(NamedTuple):
    """Colours of the figure around the curves."""

    text: str
    grid: str


THEMES: Mapping[str, Theme] = MappingProxyType(
    {"light": Theme("#3d4653", "#dfe3e8"), "dark": Theme("#b9c2cf", "#333c48")}
)


class FigureKind(NamedTuple):
    """Figures that differ by their data alone: "trace" over time or "density" over frequency, what the columns are
    called, the unit.
    """

    plot: str
    columns: tuple[str, ...]
    unit: str

    @property
    def key(self) -> str:
        """The key by which the page requests it."""
        return "|".join((self.plot, ",".join(self.columns), self.unit))


def figures(kinds: Iterable[FigureKind], theme: str, span_s: float) -> dict[str, Any]:
    """Every kind as a JSON object for BokehJS's `embed_item`, by its key; MissingExtraError without Bokeh."""
    try:
        from bokeh.embed import json_item
    except ModuleNotFoundError:
        raise MissingExtraError("bokeh", "monitor") from None
    return {kind.key: json_item(_figure(kind, theme, span_s)) for kind in kinds}


def _figure(kind: FigureKind, theme: str, span_s: float) -> Any:
    """An empty figure; its data source is called "source"."""
    from bokeh.models import BasicTickFormatter, ColumnDataSource, FixedTicker, Range1d
    from bokeh.plotting import figure

    over_time = kind.plot == "trace"
    over = "t" if over_time else "f"
    axes: dict[str, Any] = {"x_range": Range1d(start=-span_s, end=0)}
    if not over_time:  # the page sets them to whole decades
        axes = {name: Range1d(start=0.1, end=10, name=name[0]) for name in ("x_range", "y_range")}
        axes |= {"x_axis_type": "log", "y_axis_type": "log"}
    plot = figure(height=_HEIGHT, sizing_mode="stretch_width", tools="", toolbar_location=None, **axes)
    plot.min_border_right = _RIGHT
    if not over_time:
        plot.xaxis.ticker = plot.xgrid.ticker = FixedTicker(ticks=_ticks((1, 2, 5)))
        plot.axis.formatter = BasicTickFormatter(use_scientific=False)
        plot.yaxis.ticker = plot.ygrid.ticker = FixedTicker(ticks=_ticks((1, 3)))
    source = ColumnDataSource({name: [] for name in (over, *kind.columns)}, name="source")
    for name, colour in zip(kind.columns, COLOURS[theme], strict=False):
        plot.line(over, name, source=source, color=colour, line_width=1.4)
    plot.xaxis.axis_label = "s before the newest row" if over_time else "Hz"
    plot.yaxis.axis_label = kind.unit if over_time else f"{kind.unit}/√Hz"
    _dress(plot, THEMES[theme])
    return plot


def _ticks(steps: tuple[int, ...]) -> list[float]:
    """The ticks of a logarithmic axis."""
    return [step * 10.0**decade for decade in range(-6, 7) for step in steps]


def _dress(plot: Any, theme: Theme) -> None:
    """Quiet surroundings in the colours of the page."""
    plot.background_fill_alpha = plot.border_fill_alpha = 0.0
    plot.outline_line_color = None
    plot.grid.grid_line_color = theme.grid
    for axis in (*plot.xaxis, *plot.yaxis):
        axis.axis_label_text_color = axis.major_label_text_color = theme.text
        axis.axis_line_color = axis.major_tick_line_color = theme.grid
        axis.minor_tick_line_color = None
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_font_size = axis.major_label_text_font_size = "11px"
