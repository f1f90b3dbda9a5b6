"""Figures of curves, with a panel for each quantity: the Allan deviation of every sensor axis with confidence bands and
fitted noise, log-log; its amplitude spectral density, log-log, with the lines marked; and its autocorrelation, in which
axes that are not white noise stand out in colour.

Towards high frequencies the bins of a sixth of an octave are averaged, without those of lines, so that many curves in
one panel remain legible. Each line is drawn from the curve up to its peak.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.characterise.plots.frame import (
    FALSE_ALARM,
    AxisCurve,
    Captions,
    SensorPanel,
    Table,
    count_axes,
    floats,
    legend,
    logarithmic,
    panel_figure,
    plain,
    plot,
    scale_of,
)
from imuarray.units import MAINS_HZ

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ALLAN_READING = (
    "Falls like the grey line: white noise, averaging helps. Flat: flicker noise, averaging longer does not help. "
    "Rises: drift.\n"
    "N is the white noise and K the random walk of the axes whose curve a sum of noises fits (thin curves)."
)


def allan_figure(result: Table) -> Figure:
    """Draw the Allan deviations in the sensors' units (g, dps, gauss; counts if there is none), and the curves of
    good fits.

    Colour is the sensor, dashes are the axis, the light band is the 95 % interval; more sensors than the palette has
    colours get thin lines without bands. MissingExtraError if there is no matplotlib.
    """
    captions = Captions(
        "Allan deviation", _ALLAN_READING, "no sensor has an unbroken run long enough for an Allan deviation"
    )
    return panel_figure(result, captions, _has_curve, _draw_allan, 4.2)


def _has_curve(axis: Table) -> bool:
    """Return whether the axis has a curve; a constant series can't be drawn on a logarithmic scale."""
    return bool(axis["allan"]) and any(value > 0 for value in axis["allan"]["deviation"])


def _draw_allan(panel: Axes, kind: SensorPanel) -> None:
    """Draw curves, bands, fits, guide and legend of one quantity."""
    from matplotlib.lines import Line2D

    for curve in kind.curves():
        if _has_curve(curve.axis):
            _draw_allan_axis(panel, curve, kind.is_crowded)
    _scale(panel)
    panel.set(xlabel="averaging time τ (s)", ylabel=f"Allan deviation ({kind.unit})")
    more = [Line2D([], [], color="0.6", linewidth=1.0, label="slope −1/2: white noise")]
    if not kind.is_crowded:
        more.append(Line2D([], [], color="0.88", linewidth=6.0, label="bands: 95 %"))
    notes = {} if kind.is_crowded else {sensor["name"]: _note(sensor, kind.unit) for sensor in kind.sensors}
    legend(panel, kind, more, notes)


def _draw_allan_axis(panel: Axes, curve: AxisCurve, is_crowded: bool) -> None:
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
    """Return white noise and random walk of a sensor's well fitted axes, least to greatest, and the other axes."""
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


BANDS_PER_OCTAVE = 6

_NAMED_HZ = (*MAINS_HZ, *(2 * hz for hz in MAINS_HZ))
"""Frequencies of the mains and their second harmonics, those of rectifiers and transformers."""

_MAINS_WITHIN_HZ = 0.1
_BINS = slice(2, -1)
"""Bins that are drawn. Excluded are bin 0, which is the mean, bin 1, which is attenuated by the removal of each
segment's mean, and the last bin, which has half the density.
"""

_LINE_BINS = 3
"""The number of bins that a line covers on either side."""

_LABELS_APART = 1.1
"""Ratio of frequencies below which lines share a label, that of the highest peak."""

_MOST_LABELS = 12
_HEADROOM = 0.65
"""Space for the labels above, as a share of the height of all curves and peaks."""

_SPECTRUM_READING = (
    "Flat: white noise. Rising to the left: drift and flicker noise. Falling to the right: a filter. A marked peak, "
    "with its axes and frequency: a line,\nof vibration or mains. Sampling folds lines beyond half the rate down; if a "
    "mains frequency would come out there, it is named."
)


def spectrum_figure(result: Table) -> Figure:
    """Draw the amplitude spectral densities, one-sided, in the sensors' units per root hertz, and the lines found in
    them.

    Colour is the sensor, dashes are the axis, the light band is the 95 % interval; more sensors than the palette has
    colours get thin lines without bands. MissingExtraError if there is no matplotlib.
    """
    captions = Captions(
        "Amplitude spectral density", _SPECTRUM_READING, "no sensor has an unbroken run long enough for a spectrum"
    )
    return panel_figure(result, captions, _has_density, _draw_spectrum, 4.2)


class Bands(NamedTuple):
    """Mean frequency and density (b,) of bands with this number of `bins` (b,) each."""

    frequency_hz: Floats
    density: Floats
    bins: Floats


def bands(frequency_hz: Floats, density: Floats, in_band: npt.NDArray[np.bool_]) -> Bands:
    """Return the means over a sixth of an octave of the bins (m,) that `in_band` (m,) marks; a band may be a single
    bin.

    `frequency_hz` is that of bin 0, 1, 2 ... of a spectrum; bands are the same for all spectra of one resolution.
    """
    bin_ = np.flatnonzero(in_band)
    band = np.floor(BANDS_PER_OCTAVE * np.log2(bin_)).astype(int)
    _, member, bins = np.unique(band, return_inverse=True, return_counts=True)
    mean_hz, mean = (np.bincount(member, values[bin_]) / bins for values in (frequency_hz, density))
    return Bands(mean_hz, mean, bins.astype(float))


def interval(averaged: Bands, freedom: float) -> tuple[Floats, Floats]:
    """Return the ends (b,) of the 95 % interval of the band's density, of bins with `freedom` degrees of freedom each.

    Powers of neighbouring bins correlate by 4/9 and of the next by 1/36: those of a Hann window's transform squared.
    """
    from scipy.special import chdtri

    n = averaged.bins
    shared = 1 + 2 * (np.maximum(n - 1, 0) * 4 / 9 + np.maximum(n - 2, 0) / 36) / n
    total = freedom * n / shared
    return averaged.density * total / chdtri(total, 0.025), averaged.density * total / chdtri(total, 0.975)


def _has_density(axis: Table) -> bool:
    """Return whether the axis has a density; a constant series can't be drawn on a logarithmic scale."""
    return any(value for value in axis.get("density", ())[_BINS])


def _draw_spectrum(panel: Axes, kind: SensorPanel) -> None:
    """Draw curves, bands, lines and legend of one quantity."""
    from matplotlib.lines import Line2D

    curves = [curve for curve in kind.curves() if _has_density(curve.axis)]
    for curve in curves:
        _draw_spectrum_axis(panel, curve, kind.is_crowded)
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


def _draw_spectrum_axis(panel: Axes, curve: AxisCurve, is_crowded: bool) -> None:
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
    """Write above the peaks their frequencies and the axes that have them, the highest first, none over another."""
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
    """Return a line's frequency, and the mains frequency that it is an alias of, unless it is a mains frequency."""
    for mains_hz in _NAMED_HZ:
        if any(abs(alias_hz - mains_hz) <= _MAINS_WITHIN_HZ for alias_hz in line["aliases_hz"]):
            really = "" if abs(line["frequency_hz"] - mains_hz) <= _MAINS_WITHIN_HZ else f"{mains_hz:g} Hz "
            return f"{line['frequency_hz']:.4g} Hz ({really}mains?)"
    return f"{line['frequency_hz']:.4g} Hz"


NORMAL_95 = 1.96
"""Half-width, in standard errors, of the interval that contains 95 % of normal estimates."""

_CORRELATION_READING = (
    "Correlation of a reading with the one so many rows later. Of white noise 1 point in 20 leaves the grey band.\nIn "
    "colour: axes whose points as a whole are not white noise (Ljung and Box, 1 % for the whole figure); the others "
    "are grey."
)


def autocorrelation_figure(result: Table) -> Figure:
    """Draw autocorrelations from lag 1 on, with the 95 % band of no correlation (of the sensor with the fewest rows).

    Axes whose p-value, times the number of axes, is up to 1 % are in colour. MissingExtraError without matplotlib.
    """
    level = FALSE_ALARM / count_axes(result)
    captions = Captions(
        "Autocorrelation", _CORRELATION_READING, "no sensor has an unbroken run long enough for an autocorrelation"
    )
    return panel_figure(result, captions, _has_correlation, partial(_draw_correlation, level=level), 3.2)


def _has_correlation(axis: Table) -> bool:
    """Return whether the axis has a correlation; a constant or very short series has none."""
    return "autocorrelation" in axis and any(value is not None for value in axis["autocorrelation"]["correlation"][1:])


def _draw_correlation(panel: Axes, kind: SensorPanel, level: float) -> None:
    """Draw curves of one quantity, the grey ones below, with band and legend."""
    curves = [curve for curve in kind.curves() if _has_correlation(curve.axis)]
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
    _correlation_legend(panel, kind, curves, half, level)


def _correlation_legend(panel: Axes, kind: SensorPanel, curves: list[AxisCurve], half: float, level: float) -> None:
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
