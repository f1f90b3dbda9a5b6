"""Remarkable properties of a characterisation, in sentences: lines, codes, correlation, repeats, gaps, bad fits.

Everything is derived from the result of `characterise_log` alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from imuarray.characterise.repeats import STALE_SHARE

SURE = 1e-6
"""The probability below which a finding is significant, whatever the number of axes."""

_CORRELATED = 0.05
_CLIPPED_SHARE = 1e-4
_SLOW_SHARE = 0.95
_LINES = 4
_ALIASES = 3

_MAINS_HZ = (50, 60)
_MAINS_HZ_ERROR = 0.05
"""The mains frequency of large grids stays within this in normal operation (the Continental European grid: 50 mHz)."""

Axis = Mapping[str, Any]


def findings(result: Mapping[str, Any]) -> list[str]:
    """One sentence for each thing that a person should know, sensor by sensor; axes of which the same is true share
    it.
    """
    remark = result["stretch"]["remark"]
    about_box = [f"{remark}; the rows around are left out"] if remark else []
    return [*about_box, *(sentence for sensor in result["sensors"] for sentence in _of_sensor(sensor))]


def _of_sensor(sensor: Mapping[str, Any]) -> Iterator[str]:
    if sensor["timing"] is None:
        return
    name = sensor["name"]
    yield from (f"{name} {text}".replace(" : ", ": ") for text in _times(sensor["timing"], sensor["rate_hz"]))
    stalls = sensor.get("stalls")
    if stalls and stalls["adaptive_range"]:
        yield (
            f"{name} stands still at {stalls['stalled']} of {stalls['passages']} passages of 100 dps in the log: its"
            " adaptive range is on, which imuarray log switches off (bits 7:6 of register 0x4D are 01)"
        )
    axes: dict[str, list[str]] = {}
    for text, axis in (*_rails(sensor), *_of_axes(sensor)):
        axes.setdefault(text, []).append(axis)
    yield from (f"{name} {', '.join(those)}: {text}" for text, those in axes.items())


def _rails(sensor: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Describe the codes at which each axis clips anywhere in the log."""
    rails = sensor["rails"]
    if rails is None:
        return
    flagged = "" if rails["flagged"] else "; none of them is flagged as saturated: import the log again"
    for axis, low, high, readings in zip(sensor["axes"], rails["low"], rails["high"], rails["rows"], strict=True):
        ends = [f"{code:.0f}" for code in (low, high) if code is not None]
        if ends:
            yield f"clips at {' and '.join(ends)}, {readings} readings in the log{flagged}", axis["axis"]


def _of_axes(sensor: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Sentence and axis."""
    for axis in sensor["axes"]:
        texts = (*_codes(axis), *_correlation(axis), *_lines(axis, sensor), *_fit(axis))
        yield from ((text, axis["axis"]) for text in texts)


def _codes(axis: Axis) -> Iterator[str]:
    codes = axis["codes"]
    if codes is None:
        return
    if codes["step"] == 0:
        yield "always the same code"
    elif codes["usual_step"] > 1:
        every = "only even codes" if codes["usual_step"] == 2 and codes["even_share"] == 1.0 else None
        yield every or f"only every {codes['usual_step']}th code"
    missing = [gap for gap in codes["missing"] if gap["p_value"] < SURE]
    if missing:
        spans = ", ".join(_span(gap) for gap in missing[:_LINES])
        yield f"codes that never occur: {spans}"
    for end in (codes["low_end"], codes["high_end"]):
        if end["p_value"] is not None and end["p_value"] < SURE and end["share"] > _CLIPPED_SHARE:
            yield f"readings pile up at code {end['code']}: clipped"


def _span(gap: Mapping[str, Any]) -> str:
    return str(gap["first"]) if gap["first"] == gap["last"] else f"{gap['first']} to {gap['last']}"


def _correlation(axis: Axis) -> Iterator[str]:
    values, errors = axis["autocorrelation"]["correlation"], axis["autocorrelation"]["error"]
    if values[1] is None or errors[1] is None or abs(values[1]) < max(_CORRELATED, 5 * errors[1]):
        return
    if not axis["lines"]:  # a line correlates everything with everything
        yield f"neighbouring readings correlate by {values[1]:.2f}"


def _lines(axis: Axis, sensor: Mapping[str, Any]) -> Iterator[str]:
    scale = axis["unit_per_count"] or 1.0
    unit = sensor["unit"] if sensor["unit_per_count"] is not None else "counts"
    for line in axis["lines"][:_LINES]:
        amplitude, error = line["amplitude"] * scale, line["amplitude_error"] * scale
        others = [f"{hz:.4g}" for hz in line["aliases_hz"][1 : 1 + _ALIASES]]
        aliases = f", or of {', '.join(others)}, ... Hz" if others else ""
        width = f"{line['width_hz']:.2g} Hz wide " if line.get("width_hz") else ""
        base = line.get("fundamental_hz")
        order = f", harmonic {round(line['frequency_hz'] / base)} of {base:.4g} Hz" if base else ""
        place = f"{width}at {line['frequency_hz']:.4g} Hz{order}{aliases}"
        yield f"a line {place}, amplitude {amplitude:.3g} +- {error:.1g} {unit}{_mains(line)}"
    if len(axis["lines"]) > _LINES:
        yield f"weaker lines: {len(axis['lines']) - _LINES}"


def _mains(line: Mapping[str, Any]) -> str:
    """Name the mains frequency that a line is, as it is or aliased, within the errors of line and rate; "" if none."""
    if line.get("width_hz"):
        return ""
    near = 2 * line["frequency_error_hz"] + _MAINS_HZ_ERROR
    for mains_hz in _MAINS_HZ:
        if any(abs(hz - mains_hz) < near for hz in line["aliases_hz"]):
            aliased = "" if abs(line["frequency_hz"] - mains_hz) < near else "aliased "
            return f", as {aliased}{mains_hz} Hz mains would be"
    return ""


def _fit(axis: Axis) -> Iterator[str]:
    fit = axis["fit"]
    if fit is not None and fit["verdict"]:
        way = "above" if fit["worst_ratio"] > 1 else "below"
        off = abs(fit["worst_ratio"] - 1)
        tau = f"{fit['worst_tau_s']:.3g} s"
        yield f"its Allan curve is not a sum of the fitted noises: {off:.0%} {way} the fit at {tau}"


def _times(timing: Mapping[str, Any], rate_hz: float | None) -> Iterator[str]:
    pattern = timing["pattern"]["sentence"]
    if pattern:
        yield f": {pattern}"
    elif timing["gaps"]:
        places = ", ".join(f"{gap['length_s']:.3g} s after {gap['after_ns'] * 1e-9:.3f} s" for gap in _places(timing))
        yield f"has {timing['gaps']} gaps, {timing['gaps_s']:.3g} s in all: {places}"
    repeats = timing["repeats"]
    if rate_hz and repeats["new_share"] is not None and repeats["new_share"] < _SLOW_SHARE:
        yield (
            f"gives {repeats['update_rate_hz']:.4g} new readings a second, but is read {rate_hz:.4g} times; up to"
            f" {repeats['longest']} times the same"
        )
    elif repeats["new_share"] is not None and repeats["new_share"] < 1 - STALE_SHARE:
        yield f": {1 - repeats['new_share']:.1%} of its rows repeat the previous row without new readings"


def _places(timing: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    places: Sequence[Mapping[str, Any]] = timing["longest"][:3]
    return places
