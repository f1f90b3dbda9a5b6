"""Scales drawn with few artists look like those that matplotlib draws."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from imuarray.characterise.plots.scale import replace_scales
from tests.selection import some


def _linear(panel: Any) -> None:
    panel.plot([-3.0, 5.0], [0.2, 0.4])
    panel.grid(which="major")
    panel.set_axisbelow(True)


def _logarithmic(panel: Any) -> None:
    panel.loglog([0.01, 300.0], [2e-5, 0.3])
    panel.grid(which="major")
    panel.grid(which="minor", linewidth=0.5)
    panel.tick_params(which="minor", labelsize=6)


def _bare(panel: Any) -> None:
    panel.plot([1000.0, 1020.0], [0.0, 1.0])
    panel.set_yticks([])
    panel.locator_params(axis="x", nbins=7, integer=True)


def _drawn(draw: Callable[[Any], None], change: Callable[[Any], None]) -> np.ndarray:
    """The picture (height, width, 4) of a panel after `change`."""
    figure = Figure(figsize=(4.0, 3.0), dpi=120)
    canvas = FigureCanvasAgg(figure)
    panel = figure.subplots()
    figure.subplots_adjust(bottom=0.25)
    draw(panel)
    panel.set(xlabel="time (s)", ylabel="rate")
    panel.xaxis.set_label_coords(0.5, -0.12)
    panel.yaxis.set_label_coords(-0.1, 0.5)
    change(panel)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba()).copy()


@pytest.mark.parametrize("draw", some([_linear, _logarithmic, _bare], 1))
def test_the_picture_is_that_of_matplotlib(draw: Callable[[Any], None]) -> None:
    theirs = _drawn(draw, lambda panel: None)
    assert (theirs < 128).any()
    assert np.array_equal(_drawn(draw, replace_scales), theirs)


def test_a_number_that_labels_are_relative_to_is_written_below_the_right_end() -> None:
    def far(panel: Any) -> None:
        panel.plot([1e9, 1e9 + 1], [0.0, 1.0])

    corner = np.s_[300:320, 360:]
    assert (_drawn(far, lambda panel: None)[corner] < 128).any()
    assert (_drawn(far, replace_scales)[corner] < 128).any()
    assert not (_drawn(_linear, replace_scales)[corner] < 128).any()
