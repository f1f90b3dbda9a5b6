"""Common parts of the figures: sensors grouped by quantity, their colours and dashes, titles, scales, legends."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray import figures
from imuarray.arrays import Floats
from imuarray.printable import encodable

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Table = Mapping[str, Any]

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's palette (Color Universal Design, 2008) without its yellow, which is hardly visible on white paper."""

FALSE_ALARM = 0.01
"""Approximate probability that a figure of white Gaussian noise marks any axis; divided among the axes."""

_DASHES = ((), (5, 1.5), (1.2, 1.2), (5, 1.2, 1.2, 1.2))
_TITLES = {
    "specific_force": "Accelerometers",
    "angular_rate": "Gyroscopes",
    "magnetic_field": "Magnetometers",
    "pressure": "Barometers",
    "temperature": "Thermometers",
}
_LEGEND_ROWS = 22


class AxisCurve(NamedTuple):
    """One axis of one sensor, its scale in `SensorPanel.unit` per count, and its colour and dashes."""

    sensor: Table
    axis: Table
    scale: float
    colour: Any
    dashes: tuple[float, ...]


@dataclass(frozen=True)
class SensorPanel:
    """The `sensors` that share a panel, with their `colours`: those of one quantity in one unit."""

    quantity: str
    unit: str
    sensors: tuple[Table, ...]
    colours: tuple[Any, ...]

    @property
    def is_crowded(self) -> bool:
        """Return whether there are more sensors than colours in the palette; they are then thin lines without bands."""
        return len(self.sensors) > len(COLOURS)

    @property
    def title(self) -> str:
        """Return the heading of the panel."""
        return _TITLES.get(self.quantity, self.quantity)

    def curves(self) -> Iterator[AxisCurve]:
        """Yield every axis: colour is the sensor, dashes are the axis."""
        for sensor, colour in zip(self.sensors, self.colours, strict=True):
            for axis, dashes in zip(sensor["axes"], cycle(_DASHES), strict=False):
                yield AxisCurve(sensor, axis, scale_of(axis, self.unit), colour, dashes)


def kinds(result: Table, is_shown: Callable[[Table], bool]) -> list[SensorPanel]:
    """Return panels for sensors with an axis that `is_shown` accepts; a sensor has one colour in all figures."""
    groups: dict[tuple[str, str], list[Table]] = {}
    for sensor in result["sensors"]:
        groups.setdefault((sensor["quantity"], unit_of(sensor)), []).append(sensor)
    listed = []
    for (quantity, unit), sensors in groups.items():
        colours = zip(sensors, _colours(len(sensors)), strict=True)
        pairs = [pair for pair in colours if any(map(is_shown, pair[0]["axes"]))]
        if pairs:
            listed.append(SensorPanel(quantity, unit, *map(tuple, zip(*pairs, strict=True))))
    return listed


def unit_of(sensor: Table) -> str:
    """Return the unit that the sensor's counts are drawn in: g, dps, gauss; counts if the log has no sensitivity."""
    return str(sensor["unit"]) if sensor["unit_per_count"] is not None else "counts"


def scale_of(axis: Table, unit: str) -> float:
    """Return the size of a count of this axis in `unit`, without its sign."""
    return 1.0 if unit == "counts" else abs(float(axis["unit_per_count"]))


@dataclass(frozen=True)
class Captions:
    """The texts of a figure: its title, how to read the panels, and what is missing if there are none."""

    title: str
    reading: str
    otherwise: str


def panel_figure(
    result: Table,
    captions: Captions,
    is_shown: Callable[[Table], bool],
    draw: Callable[[Axes, SensorPanel], None],
    height: float,
) -> Figure:
    """Draw a panel of `height` inches for every kind of sensor with an axis that `is_shown` accepts."""
    figure = new_figure(result, captions.title)
    panel_kinds = kinds(result, is_shown)
    set_height(figure, height, len(panel_kinds))
    if not panel_kinds:
        figure.text(0.5, 0.4, captions.otherwise, ha="center")
        return figure
    panels = figure.subplots(len(panel_kinds), 1, squeeze=False)
    for panel, kind in zip(panels[:, 0], panel_kinds, strict=True):
        draw(panel, kind)
        panel.set_title(plain(kind.title), loc="left", y=1.0, fontsize=10, fontweight="bold")
        panel.grid(which="major", color="0.88", linewidth=0.8)
        panel.grid(which="minor", color="0.95", linewidth=0.5)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
    how_to_read(figure, captions.reading)
    arrange(figure, panels, _CURVES)
    replace_all_scales(panels)
    return figure


def new_figure(result: Table, title: str) -> Figure:
    """Return an empty figure with a title; MissingExtraError without matplotlib."""
    figure = figures.new_figure(10.0, 4.0)
    figure.set_dpi(120)
    figure.set_layout_engine("none")  # `arrange` is faster
    stretch = result["stretch"]
    emulated = " (emulated, no hardware)" if result["source"] == "emulated" else ""
    part = "the whole log" if stretch["phase"] is None else f"phase {stretch['phase']}"
    name = str(result["log"]).replace("\\", "/").rsplit("/", 1)[-1]
    length_s = stretch["end_s"] - stretch["start_s"]
    figure.suptitle(plain(f"{title} of {name}{emulated}: {part}, {length_s:.4g} s"), fontsize=11)
    return figure


class Margins(NamedTuple):
    """Space around each panel for its labels in inches: on the left and the right, above and below."""

    left: float
    right: float
    above: float
    below: float


_CURVES = Margins(0.95, 0.12, 0.26, 0.52)
_TITLE_IN = 0.4
_FOOT_LINE_IN = 0.15
_EDGE_IN = 0.12
_LABEL_IN = (0.72, 0.36)
"""Distances in inches from a panel to the names of its vertical and horizontal axes, beyond the longest tick labels."""


def arrange(figure: Figure, panels: npt.NDArray[np.object_], margins: Margins) -> None:
    """Place a grid of panels and their labels by the `margins`, all panels of one size, legends on the right.

    Matplotlib's layouts measure every text of every panel several times, which takes as long as drawing them.
    """
    width, height = figure.get_size_inches()
    rows, columns = panels.shape
    legends = [panel.get_legend() for panel in panels[:, -1]]
    texts = [legend.get_window_extent().width / figure.dpi for legend in legends if legend is not None]
    legend_width = max(texts, default=0.0) + (0.1 if texts else 0.0)
    figure.suptitle(figure.get_suptitle(), y=1 - _EDGE_IN / height, fontsize=11)
    foot = _EDGE_IN + _FOOT_LINE_IN * len(figure.get_supxlabel().splitlines())
    each_width = (width - legend_width) / columns - margins.left - margins.right
    each_height = (height - _TITLE_IN - foot) / rows - margins.above - margins.below
    for (row, column), panel in np.ndenumerate(panels):
        start = margins.left + column * (margins.left + each_width + margins.right)
        top = _TITLE_IN + margins.above + row * (margins.above + each_height + margins.below)
        panel.set_position((start / width, 1 - (top + each_height) / height, each_width / width, each_height / height))
        panel.yaxis.set_label_coords(-_LABEL_IN[0] / each_width, 0.5)
        panel.xaxis.set_label_coords(0.5, -_LABEL_IN[1] / each_height)


def replace_all_scales(panels: npt.NDArray[np.object_]) -> None:
    """Let the scales of arranged panels be drawn with few artists."""
    from imuarray.characterise.plots.scale import replace_scales

    for panel in panels.ravel():
        replace_scales(panel)


def set_height(figure: Figure, height: float, rows: int) -> None:
    """Set the size: 10 inches wide, and `height` inches for each row of panels."""
    figure.set_size_inches(10.0, 1.2 + height * max(1, rows))


def how_to_read(figure: Figure, reading: str) -> None:
    """Write one or two lines of explanation at the foot of a figure."""
    figure.supxlabel(reading, fontsize=8.5, color="0.3")


def plain(text: str) -> str:
    """Return text that matplotlib does not interpret as mathematics, without characters that it cannot draw."""
    return encodable(text).replace("$", r"\$")


def floats(values: Sequence[float | None]) -> Floats:
    """Return the numbers of a result; nan for None."""
    return np.array(values, np.float64)


def plot(panel: Axes, x: Floats, y: Floats, curve: AxisCurve, **style: Any) -> None:
    """Plot the line of one axis in its colour and dashes."""
    line = panel.plot(x, y, color=curve.colour, **style)[0]
    if curve.dashes:
        line.set_dashes(curve.dashes)


def logarithmic(panel: Axes, lowest: float, highest: float, top: float = 1.6) -> None:
    """Make both scales logarithmic with plain numbers; upwards from below `lowest` to `top` times `highest`."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    panel.set(xscale="log", yscale="log", ylim=(lowest / 1.6, highest * top))
    numbers = FuncFormatter(lambda value, _: f"{value:g}")
    low, high = panel.get_xlim()
    for scale, ratio in ((panel.xaxis, high / low), (panel.yaxis, highest / lowest)):
        scale.set_major_formatter(numbers)
        scale.set_minor_formatter(numbers if ratio < 100 else NullFormatter())
        if ratio < 100 or scale is panel.yaxis:
            scale.set_minor_locator(LogLocator(subs=(2, 5)))
    panel.tick_params(which="minor", labelsize=8, labelcolor="0.35")


def legend(panel: Axes, kind: SensorPanel, more: Sequence[Artist], notes: Mapping[str, str] | None = None) -> None:
    """Draw a legend next to the panel: sensors by colour, each with a note, axes by dashes, and the artists `more`."""
    from matplotlib.lines import Line2D

    handles: list[Artist] = []
    for sensor, colour in zip(kind.sensors, kind.colours, strict=True):
        note = (notes or {}).get(sensor["name"], "")
        handles.append(Line2D([], [], color=colour, linewidth=3, label=plain(label(sensor) + note)))
    names = dict.fromkeys(axis["axis"] for sensor in kind.sensors for axis in sensor["axes"])
    for name, dashes in zip(names, cycle(_DASHES), strict=False):
        handle = Line2D([], [], color="0.25", linewidth=1.4, label=f"axis {plain(name)}")
        if dashes:
            handle.set_dashes(dashes)
        handles.append(handle)
    handles += more
    panel.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        frameon=False,
        fontsize=8,
        ncols=1 + (len(handles) - 1) // _LEGEND_ROWS,
        handlelength=2.4,
    )


def label(sensor: Table) -> str:
    """Return a sensor's name and range."""
    return f"{sensor['name']} ±{sensor['range']:g} {sensor['unit']}" if sensor["range"] else str(sensor["name"])


def count_axes(result: Table) -> int:
    """Return the number of axes among which a figure's probability of a false alarm is divided; at least 1."""
    return max(1, sum(len(sensor["axes"]) for sensor in result["sensors"]))


def _colours(count: int) -> list[Any]:
    """Return `count` distinguishable colours; beyond the palette, an even walk through cividis."""
    if count <= len(COLOURS):
        return list(COLOURS[:count])
    from matplotlib import colormaps

    return list(colormaps["cividis"](np.linspace(0, 0.95, count)))
