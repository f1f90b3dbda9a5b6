"""Style of the figures of the gap and validation pages: panel, colours, logarithmic axes with plain numbers, safe
names.

Black is the recording, orange the simulation before the causes were added, blue after.
"""

from __future__ import annotations

from math import log10
from typing import TYPE_CHECKING, Any

from imuarray.figures import new_figure
from imuarray.report.page import Figure as PageFigure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REAL, BEFORE, AFTER = "#1d2327", "#d55e00", "#0072b2"
"""Near black, and two colours of Okabe and Ito."""

NARROW = 5.0
"""Width in inches of a figure that shares a row of the page with another one."""


class SmallFigure(PageFigure):
    """A figure that shares a row with another one if the screen is wide enough."""

    is_small = True


def new_panel(width: float, height: float) -> tuple[Figure, Axes]:
    """Return an empty figure (inches) and its panel; MissingExtraError without matplotlib."""
    figure = new_figure(width, height)
    panel = figure.subplots()
    panel.spines[["top", "right"]].set_visible(False)
    panel.tick_params(labelsize=8.5)
    panel.set_axisbelow(True)
    return figure, panel


def plain_name(text: str, longest: int = 24) -> str:
    """Return a name that matplotlib shows literally: dollars escaped, control characters replaced, at most `longest`
    characters.
    """
    name = "".join(sign if sign.isprintable() else "?" for sign in text)
    name = name if len(name) <= longest else name[: longest - 1] + "…"
    return name.replace("$", r"\$")


def make_logarithmic(panel: Axes, which: str) -> None:
    """Make an axis ("x" or "y") logarithmic with plain numbers, at 1, 2 and 5 where it spans less than two decades.
    Call it after drawing; the axis stays linear if nothing positive is shown.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    panel.set(**{f"{which}scale": "log"})
    axis: Any = panel.xaxis if which == "x" else panel.yaxis
    low, high = sorted(panel.get_xlim() if which == "x" else panel.get_ylim())
    if low <= 0:  # nothing was drawn, or one point
        panel.set(**{f"{which}scale": "linear"})
        return
    decades = log10(high / low)
    axis.set_major_locator(LogLocator(subs=(1, 2, 5) if decades < 2 else (1, 3) if decades < 3 else (1,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def legend_above(panel: Axes) -> None:
    """Draw the legend in one row above the panel's right end."""
    panel.legend(
        loc="lower right",
        bbox_to_anchor=(1, 1),
        frameon=False,
        fontsize=8.5,
        ncols=4,
        borderaxespad=0.2,
        columnspacing=1.2,
    )
