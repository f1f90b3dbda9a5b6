"""The amplitude spectral density of every sensor axis: a panel per quantity, log-log, with the lines marked.

Towards high frequencies the bins of a sixth of an octave are averaged, without those of lines, so that many curves in
one panel remain legible. Each line is drawn from the curve up to its peak.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.characterise.plots.frame import (
    AxisCurve,
    Captions,
    SensorPanel,
    Table,
    floats,
    legend,
    logarithmic,
    panel_figure,
    plain,
    plot,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BANDS_PER_OCTAVE = 6

MAINS_HZ = (50.0, 60.0, 100.0, 120.0)
"""Frequencies of the mains and the harmonics of rectifiers and transformers."""

_MAINS_WITHIN_HZ = 0.1
_BINS = slice(2, -1)
"""Bins that are drawn: bin 0 is the mean, bin 1 is attenuated by the removal of each segment's mean, and the last bin
has half the density.
"""

_LINE_BINS = 3
"""The number of bins that a line covers on either side."""

_LABELS_APART = 1.1
"""Ratio of frequencies below which lines share a label, that of the highest peak."""

_MOST_LABELS = 12
_HEADROOM = 0.65
"""Space for the labels above, as a share of the height of all curves and peaks."""

_READING = (
    "Flat: white noise. Rising to the left: drift and flicker noise. Falling to the right: a filter. A marked peak, "
    "with its axes and frequency: a line,\nof vibration or mains. Sampling folds lines beyond half the rate down; if a "
    "mains frequency would come out there, it is named."
)


def spectrum_figure(result: Table) -> Figure:
    """Amplitude spectral densities, one-sided, in the sensors' units per root hertz, and the lines found in them.

    Colour is the sensor, dashes are the axis, the light band is the 95 % interval; more sensors than the palette has
    colours get thin lines without bands. MissingExtraError if there is no matplotlib.
    """
    captions = Captions(
        "Amplitude spectral density", _READING, "no sensor has an unbroken run long enough for a spectrum"
    )
    return panel_figure(result, captions, _is_shown, _draw, 4.2)


class Bands(NamedTuple):
    """Mean frequency and density (b,) of bands with this number of `bins` (b,) each."""

    frequency_hz: Floats
    density: Floats
    bins: Floats


def bands(frequency_hz: Floats, density: Floats, in_band: npt.NDArray[np.bool_]) -> Bands:
    """Means over a sixth of an octave of the bins (m,) that `in_band` (m,) marks; a band may be a single bin.

    `frequency_hz` is that of bin 0, 1, 2 ... of a spectrum; bands are the same for all spectra of one resolution.
    """
    bin_ = np.flatnonzero(in_band)
    band = np.floor(BANDS_PER_OCTAVE * np.log2(bin_)).astype(int)
    _, member, bins = np.unique(band, return_inverse=True, return_counts=True)
    mean_hz, mean = (np.bincount(member, values[bin_]) / bins for values in (frequency_hz, density))
    return Bands(mean_hz, mean, bins.astype(float))


def interval(averaged: Bands, freedom: float) -> tuple[Floats, Floats]:
    """Ends (b,) of the 95 % interval of the band's density, of bins with `freedom` degrees of freedom each.

    Powers of neighbouring bins correlate by 4/9 and of the next by 1/36: those of a Hann window's transform squared.
    """
    from scipy.special import chdtri

    n = averaged.bins
    shared = 1 + 2 * (np.maximum(n - 1, 0) * 4 / 9 + np.maximum(n - 2, 0) / 36) / n
    total = freedom * n / shared
    return averaged.density * total / chdtri(total, 0.025), averaged.density * total / chdtri(total, 0.975)


def _is_shown(axis: Table) -> bool:
    """Return whether the axis has a density; a constant series can't be drawn on a logarithmic scale."""
    return any(value for value in axis.get("density", ())[_BINS])


def _draw(panel: Axes, kind: SensorPanel) -> None:
    """Draw curves, bands, lines and legend of one quantity."""
    from matplotlib.lines import Line2D

    curves = [curve for curve in kind.curves() if _is_shown(curve.axis)]
    for curve in curves:
        _draw_axis(panel, curve, kind.is_crowded)
    has_lines = any(curve.axis["lines"] for curve in curves)
    heights = np.concatenate([np.asarray(line.get_xydata())[:, 1] for line in panel.get_lines()])
    lowest, highest = float(heights.min()), float(heights.max())
    logarithmic(panel, lowest, highest, 1.6 * (highest / lowest) ** (_HEADROOM if has_lines else 0))
    _label_lines(panel, curves)
    panel.set(xlabel="frequency (Hz)", ylabel=f"density ({kind.unit}/√Hz)")
    more = [Line2D([], [], color="0.88", linewidth=6.0, label="bands: 95 %")] if not kind.is_crowded else []
    if has_lines:
        more.append(Line2D([], [], color="0.25", linewidth=0.8, marker="D", markersize=4, label="a line"))
    legend(panel, kind, more)


def _draw_axis(panel: Axes, curve: AxisCurve, is_crowded: bool) -> None:
    """Draw one curve, its band if there is room, and its lines, each from the curve up to its peak."""
    common = curve.sensor["spectrum"]
    frequency_hz, density = floats(common["frequency_hz"]), floats(curve.axis["density"])
    peaks = [_bin(line, common) for line in curve.axis["lines"]]
    in_band = np.zeros(len(density), bool)
    in_band[_BINS] = density[_BINS] > 0
    for peak in peaks:
        in_band[max(0, peak - _LINE_BINS) : peak + _LINE_BINS + 1] = False
    averaged = bands(frequency_hz, density, in_band)
    height = np.sqrt(averaged.density) * curve.scale
    plot(panel, averaged.frequency_hz, height, curve, linewidth=0.6 if is_crowded else 1.2)
    if not is_crowded:
        low, high = (np.sqrt(end) * curve.scale for end in interval(averaged, common["freedom"]))
        panel.fill_between(averaged.frequency_hz, low, high, color=curve.colour, alpha=0.06, linewidth=0)
    top = [_height(line, curve) for line in curve.axis["lines"]]
    foot = np.interp(frequency_hz[peaks], averaged.frequency_hz, height)
    if peaks:
        panel.vlines(frequency_hz[peaks], foot, top, color=curve.colour, linewidth=0.8)
        panel.plot(frequency_hz[peaks], top, "D", color=curve.colour, markersize=4, gid="lines")


def _bin(line: Table, common: Table) -> int:
    """Return the bin of a line's peak, inside the spectrum."""
    nearest: int = round(line["frequency_hz"] / common["resolution_hz"])
    return min(nearest, len(common["frequency_hz"]) - 1)


def _height(line: Table, curve: AxisCurve) -> float:
    """Return the height of a line's peak in the panel."""
    return float(np.sqrt(curve.axis["density"][_bin(line, curve.sensor["spectrum"])])) * curve.scale


def _label_lines(panel: Axes, curves: list[AxisCurve]) -> None:
    """Frequencies above the peaks and the axes that have them, the highest first, none over another."""
    peaks = [(_height(line, curve), line, curve) for curve in curves for line in curve.axis["lines"]]
    labelled: list[float] = []
    for height, line, curve in sorted(peaks, key=lambda peak: -peak[0]):
        at_hz, apart_hz = line["frequency_hz"], 2 * curve.sensor["spectrum"]["resolution_hz"]
        if len(labelled) < _MOST_LABELS and all(
            max(at_hz / other, other / at_hz) > _LABELS_APART for other in labelled
        ):
            labelled.append(at_hz)
            same = {curve.axis["axis"] for _, other, curve in peaks if abs(other["frequency_hz"] - at_hz) <= apart_hz}
            text = f"{', '.join(sorted(same))}: {line_label(line)}"
            style: dict[str, Any] = {"rotation": 90, "ha": "center", "va": "bottom", "fontsize": 7.5, "color": "0.2"}
            panel.annotate(plain(text), (at_hz, height), (0, 5), textcoords="offset points", **style)


def line_label(line: Table) -> str:
    """Return a line's frequency, and the mains frequency that it is an alias of, unless it is a mains frequency
    itself.
    """
    for mains_hz in MAINS_HZ:
        if any(abs(alias_hz - mains_hz) <= _MAINS_WITHIN_HZ for alias_hz in line["aliases_hz"]):
            really = "" if abs(line["frequency_hz"] - mains_hz) <= _MAINS_WITHIN_HZ else f"{mains_hz:g} Hz "
            return f"{line['frequency_hz']:.4g} Hz ({really}mains?)"
    return f"{line['frequency_hz']:.4g} Hz"
