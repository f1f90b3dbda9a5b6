"""Results of a survey, column by column, as plain tables: fitted noise, spectrum and its lines, correlation, codes.

Values are in counts; `unit_per_count` of the sensor turns them into its unit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from imuarray.characterise.allan_fit import NoiseFit, fit_noise
from imuarray.characterise.bands import find_bands
from imuarray.characterise.codes import Histogram, code_density
from imuarray.characterise.lines import aliases, find_lines
from imuarray.characterise.spectrum import Spectrum
from imuarray.characterise.survey import Survey
from imuarray.log import SensorLog

FILTER_TIMES = 5.0
"""A chip's low-pass filter shapes the shortest taus: noise is fitted from this many of its time constants on."""

HARMONICS = 8
"""The multiples of a line's frequency that are searched for."""

CHANCE = 0.02
"""Share of the distance of two harmonics, over their order, within which a line is taken for one."""

_LISTED_CODES = 4096
_ALIASES_TO_HZ = 500.0


def timing_of(survey: Survey, rate_hz: float) -> dict[str, Any]:
    """Intervals, their jitter and gaps; how often a reading repeats the one before, at `rate_hz` rows per second (the
    intervals do not say the rate of rows that arrive in bursts).
    """
    intervals = asdict(survey.intervals) | {"longest": [gap._asdict() for gap in survey.intervals.longest]}
    repeats = asdict(survey.repeats)
    return {**intervals, "repeats": repeats | {"update_rate_hz": survey.repeats.update_rate_hz(rate_hz)}}


def spectrum_of(survey: Survey) -> dict[str, Any]:
    """Return what the spectra of all columns have in common."""
    spectrum = survey.spectrum
    return {
        "frequency_hz": spectrum.frequency_hz,
        "freedom": spectrum.freedom[len(spectrum.freedom) // 2],
        "segment_rows": spectrum.segment_rows,
        "segments": spectrum.segments,
        "resolution_hz": spectrum.resolution_hz,
    }


def column_of(survey: Survey, column: int, sensor: SensorLog) -> dict[str, Any]:
    """One column's fit, density (squared counts per Hz), lines, autocorrelation and codes."""
    correlation = survey.correlation
    seen = survey.histograms[column]
    return {
        "fit": _fit(survey, column, sensor),
        "density": survey.spectrum.density[:, column],
        **_lines(survey.spectrum, column),
        "autocorrelation": {
            "correlation": correlation.correlation[:, column],
            "error": correlation.error[:, column],
            "p_value": correlation.p_value[column],
        },
        "codes": asdict(code_density(seen)) if seen.counts.sum() else None,
        "histogram": _histogram(seen),
    }


def _fit(survey: Survey, column: int, sensor: SensorLog) -> dict[str, Any] | None:
    """White noise, flicker and random walk of the Allan curve; None for a curve that tells nothing."""
    if survey.curve is None:
        return None
    shortest_s = FILTER_TIMES / (2 * math.pi * sensor.bandwidth_hz) if sensor.bandwidth_hz > 0 else 0.0
    fit = fit_noise(survey.curve, column, unit="counts", shortest_s=shortest_s)
    return None if fit is None else _fit_table(fit)


def _fit_table(fit: NoiseFit) -> dict[str, Any]:
    table = asdict(fit)
    terms = table["terms"] = {item.pop("term"): item for item in table.pop("coefficients")}
    for name, item in terms.items():  # coloured noise looks like flicker or random walk, and is neither
        item["doubtful"] = bool(fit.verdict) and name != "white"
    return table


def _lines(spectrum: Spectrum, column: int) -> dict[str, Any]:
    """The lines of one column, the noise floor below them, and the level that a line has to pass."""
    search = find_lines(spectrum, column)
    bands = find_bands(spectrum, column, search.lines)
    lines = [_line(asdict(line) | {"width_hz": 0.0}, spectrum.rate_hz) for line in search.lines]
    lines += [_line(asdict(band), spectrum.rate_hz) for band in bands]
    return {
        "lines": _with_harmonics(sorted(lines, key=lambda line: -line["amplitude"]), spectrum.resolution_hz),
        "line_search": {
            "first_hz": search.frequency_hz[0] if len(search.frequency_hz) else math.nan,
            "false_alarm": search.false_alarm,
            "floor": search.floor,
            "level_over_floor": float(np.median(search.level / search.floor)) if len(search.floor) else math.nan,
        },
    }


def _line(line: Mapping[str, Any], rate_hz: float) -> dict[str, Any]:
    return dict(line) | {"aliases_hz": aliases(min(line["frequency_hz"], rate_hz / 2), rate_hz, _ALIASES_TO_HZ)}


def _with_harmonics(lines: list[dict[str, Any]], resolution_hz: float) -> list[dict[str, Any]]:
    """The lines, each with the `fundamental_hz` of which it is a multiple, None of one that is of none."""
    for line in lines:
        line["fundamental_hz"] = None
        for other in sorted(lines, key=lambda line: line["frequency_hz"]):
            order = round(line["frequency_hz"] / other["frequency_hz"])
            apart = abs(line["frequency_hz"] - order * other["frequency_hz"])
            sure = 3 * (line["frequency_error_hz"] + order * other["frequency_error_hz"])
            if 2 <= order <= HARMONICS and apart < min(sure, resolution_hz) and _fits_by_reason(order, other, apart):
                line["fundamental_hz"] = other["frequency_hz"]
                break
    return lines


def _fits_by_reason(order: int, other: Mapping[str, Any], apart: float) -> bool:
    """Return whether a multiple is hardly met by chance: the distance is small against that of multiples."""
    return bool(apart < CHANCE * other["frequency_hz"] / order)


def _histogram(seen: Histogram) -> dict[str, Any] | None:
    """Codes and how often they came; None for so many that it would be no histogram of noise."""
    return asdict(seen) if len(seen.codes) <= _LISTED_CODES else None
