"""Figures of a characterisation, drawn from the result of `characterise_log` alone.

Needs matplotlib (extra "report"), imported when a figure is drawn. Bare `Figure`s with the Agg canvas: no display, no
global state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from imuarray.characterise.plots.codes import histogram_figure
from imuarray.characterise.plots.curves import allan_figure, autocorrelation_figure, spectrum_figure
from imuarray.characterise.plots.frame import COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "COLOURS",
    "FIGURES",
    "allan_figure",
    "autocorrelation_figure",
    "histogram_figure",
    "spectrum_figure",
]

FIGURES: dict[str, Callable[[Mapping[str, Any]], Figure]] = {
    "allan.png": allan_figure,
    "spectrum.png": spectrum_figure,
    "autocorrelation.png": autocorrelation_figure,
    "histogram.png": histogram_figure,
}
"""The function that draws each file; it takes a result and raises MissingExtraError without matplotlib."""
