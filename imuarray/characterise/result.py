"""The result of a characterisation: all estimates for a log's sensors at rest, as one object for JSON.

Values are in counts; `unit_per_count` converts them to the sensor's unit and `si_per_count` to SI, by a calibration or
by the data sheet's typical sensitivity (null if the log has none). Statistics and coefficients are given in all three.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from types import MappingProxyType
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from imuarray.characterise.alignment import find_alignment
from imuarray.characterise.allan import Estimator
from imuarray.characterise.allan_curve import CONFIDENCE, AllanCurve, floor, white_noise
from imuarray.characterise.allan_fit import fit_noise
from imuarray.characterise.codes import code_density, find_rails
from imuarray.characterise.lines import FIRST_BIN, SpectralLine, aliases, find_bands, find_lines
from imuarray.characterise.noise import LEFT_OUT, NoiseStatistics, noise_statistics
from imuarray.characterise.processing import find_filters, find_interpolation, find_missing_gravity
from imuarray.characterise.repeats import find_stalls
from imuarray.characterise.spectrum import Spectrum
from imuarray.characterise.stretch import (
    Stretch,
    Timing,
    choose_stretch,
    find_rate_changes,
    find_timing,
    rate_change_sentence,
)
from imuarray.characterise.survey import Survey, runs_of_curve, survey
from imuarray.errors import ConfigError, LogError
from imuarray.json_values import json_value
from imuarray.log import Log, SensorLog
from imuarray.log.format import FLAGS
from imuarray.log.row_timing import row_timing
from imuarray.units import SI_NAME, SI_PER_UNIT

FILTER_TIMES = 5.0
"""Shortest tau of the fit in time constants of the chip's low-pass filter, which affects shorter ones."""

HARMONICS = 8
"""Highest multiple of a line's frequency that is reported as a harmonic."""

CHANCE = 0.02
"""Largest distance of a line from a harmonic, as a share of the distance of two harmonics over their order."""

_LISTED_CODES = 4096
_ALIASES_TO_HZ = 500.0


def timing_of(survey: Survey, rate_hz: float) -> dict[str, Any]:
    """Return the intervals, their jitter and gaps; and how often a reading repeats the one before, at `rate_hz` rows
    per second (the rate of rows that arrive in bursts can't be computed from the intervals).
    """
    intervals = asdict(survey.intervals) | {"longest": [gap._asdict() for gap in survey.intervals.longest]}
    repeats = asdict(survey.repeats)
    return {**intervals, "repeats": repeats | {"update_rate_hz": survey.repeats.update_rate_hz(rate_hz)}}


def spectrum_of(survey: Survey) -> dict[str, Any]:
    """Return the common properties of the spectra of all columns."""
    spectrum = survey.spectrum
    return {
        "frequency_hz": spectrum.frequency_hz,
        "freedom": spectrum.freedom[len(spectrum.freedom) // 2],
        "segment_rows": spectrum.segment_rows,
        "segments": spectrum.segments,
        "resolution_hz": spectrum.resolution_hz,
    }


def column_of(survey: Survey, column: int, sensor: SensorLog) -> dict[str, Any]:
    """Return one column's fit, density (squared counts per Hz), lines, autocorrelation and codes."""
    correlation = survey.correlation
    histogram = survey.histograms[column]
    return {
        "fit": _fit(survey, column, sensor),
        "density": survey.spectrum.density[:, column],
        **_lines(survey.spectrum, survey.slow_spectrum, column),
        "autocorrelation": {
            "correlation": correlation.correlation[:, column],
            "error": correlation.error[:, column],
            "p_value": correlation.p_value[column],
        },
        "codes": asdict(code_density(histogram)) if histogram.counts.sum() else None,
        "histogram": (asdict(histogram) if len(histogram.codes) <= _LISTED_CODES else None),
    }


def _fit(survey: Survey, column: int, sensor: SensorLog) -> dict[str, Any] | None:
    """Return white noise, flicker and random walk of the Allan curve; None if none can be determined."""
    if survey.curve is None:
        return None
    shortest_s = FILTER_TIMES / (2 * math.pi * sensor.bandwidth_hz) if sensor.bandwidth_hz > 0 else 0.0
    fit = fit_noise(survey.curve, column, unit="counts", shortest_s=shortest_s)
    if fit is None:
        return None
    table = asdict(fit)
    terms = table["terms"] = {item.pop("term"): item for item in table.pop("coefficients")}
    for name, item in terms.items():  # coloured noise may be mistaken for flicker noise or a random walk
        item["doubtful"] = bool(fit.verdict) and name != "white"
    return table


SLOW_FALSE_ALARM = 1e-3
"""Chance that the spectrum of low frequencies of noise alone shows a line: a tenth of that of the other spectrum."""


def find_slow_lines(spectrum: Spectrum, below_hz: float, column: int = 0) -> tuple[SpectralLine, ...]:
    """Return the narrow lines in one column of a spectrum with long segments, below the frequency at which the search
    in shorter ones begins.
    """
    lines = find_lines(spectrum, column, SLOW_FALSE_ALARM).lines
    return tuple(line for line in lines if line.frequency_hz < below_hz)


def _lines(spectrum: Spectrum, slow_spectrum: Spectrum | None, column: int) -> dict[str, Any]:
    """Return the lines of one column, the noise floor, and the level that a line must exceed."""
    search = find_lines(spectrum, column)
    narrow = search.lines
    if slow_spectrum is not None:
        narrow += find_slow_lines(slow_spectrum, FIRST_BIN * spectrum.resolution_hz, column)
    bands = find_bands(spectrum, column, narrow)
    lines = [_line(asdict(line) | {"width_hz": 0.0}, spectrum.rate_hz) for line in narrow]
    lines += [_line(asdict(band), spectrum.rate_hz) for band in bands]
    return {
        "lines": _add_fundamentals(sorted(lines, key=lambda line: -line["amplitude"]), spectrum.resolution_hz),
        "line_search": {
            "first_hz": search.frequency_hz[0] if len(search.frequency_hz) else math.nan,
            "false_alarm": search.false_alarm,
            "floor": search.floor,
            "level_over_floor": float(np.median(search.level / search.floor)) if len(search.floor) else math.nan,
        },
    }


def _line(line: Mapping[str, Any], rate_hz: float) -> dict[str, Any]:
    return dict(line) | {"aliases_hz": aliases(min(line["frequency_hz"], rate_hz / 2), rate_hz, _ALIASES_TO_HZ)}


def _add_fundamentals(lines: list[dict[str, Any]], resolution_hz: float) -> list[dict[str, Any]]:
    """Return the lines, each with the `fundamental_hz` that it is a multiple of, None if it is not a harmonic."""
    for line in lines:
        line["fundamental_hz"] = None
        for other in sorted(lines, key=lambda line: line["frequency_hz"]):
            order = round(line["frequency_hz"] / other["frequency_hz"])
            distance = abs(line["frequency_hz"] - order * other["frequency_hz"])
            sure = 3 * (line["frequency_error_hz"] + order * other["frequency_error_hz"])
            if (
                2 <= order <= HARMONICS
                and distance < min(sure, resolution_hz)
                and bool(distance < CHANCE * other["frequency_hz"] / order)
            ):
                line["fundamental_hz"] = other["frequency_hz"]
                break
    return lines


Progress = Callable[[], None]


def characterise_log(
    log: Log,
    phase: str | Stretch | None = None,
    sensors: Sequence[str] | None = None,
    progress: Progress | None = None,
    estimator: Estimator | None = None,
    scales: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> dict[str, Any]:
    """Characterise the noise of the triads of `log` (or of the named `sensors`, of any kind) in one stretch at rest.

    `phase` is the name of the stretch; None: the longest phase at rest. Without a phase at rest, a `Stretch` given as
    `phase` is used, or the whole log; the result states which. `scales`: calibrated counts per unit of a sensor's axes
    (3,), by sensor; the others are the data sheet's. `estimator` of the Allan deviation; None: overlapping, or for long
    runs decimated (`survey.EXACT_ROWS`). `progress` is called after every column. LogError for an unknown phase or
    sensor, or a log without triads, ConfigError for an unknown estimator.
    """
    chosen_sensors = (
        [log[name] for name in sensors] if sensors else [item for item in log.sensors.values() if item.is_triad]
    )
    if estimator not in (None, *get_args(Estimator)):
        raise ConfigError(f"estimator {estimator!r}: allowed are {', '.join(get_args(Estimator))}")
    if not chosen_sensors:
        raise LogError(f"{log.path}: it has no accelerometer, gyroscope or magnetometer")
    log.keep_rows()
    chosen_stretch = choose_stretch(log, None if isinstance(phase, Stretch) else phase)
    if isinstance(phase, Stretch) and chosen_stretch.phase is None:
        chosen_stretch = phase
    result = {
        "log": str(log.path),
        "source": log.source,
        "software": log.software,
        "stretch": _stretch(chosen_stretch),
        "confidence": CONFIDENCE,
        "left_out_of_statistics": [name for name, flag in FLAGS.items() if flag & LEFT_OUT],
        "sensors": [
            _sensor(sensor, chosen_stretch, estimator, scales.get(sensor.name), progress or (lambda: None))
            for sensor in chosen_sensors
        ],
        "alignment": _alignment(log),
    }
    return {name: json_value(value) for name, value in result.items()}


def _alignment(log: Log) -> dict[str, Any] | None:
    """Return the alignment of the inertial sensors in time over the whole log; None if all rows have the same times."""
    alignment = find_alignment(log)
    return None if alignment is None or alignment.is_simultaneous else asdict(alignment)


def _stretch(stretch: Stretch) -> dict[str, Any]:
    return {
        "phase": stretch.phase,
        "up": stretch.up,
        "start_s": stretch.start_ns * 1e-9,
        "end_s": stretch.end_ns * 1e-9,
        "chosen_by": stretch.chosen_by,
        "left_out_s": [[start_ns * 1e-9, end_ns * 1e-9] for start_ns, end_ns in stretch.left_out],
        "remark": stretch.remark,
    }


def _sensor(
    sensor: SensorLog,
    stretch: Stretch,
    estimator: Estimator | None,
    scale: Sequence[float] | None,
    progress: Progress,
) -> dict[str, Any]:
    """Return the result of one sensor: its description, times and flags, and its axes."""
    rows = sensor.between(stretch.start_ns, stretch.end_ns)
    pattern = row_timing(sensor)
    rate_runs = find_rate_changes(sensor) if pattern.kind == "steady" else ()
    timing = find_timing(sensor, rows, counted=pattern.kind == "bursts", left_out=stretch.left_out)
    statistics = noise_statistics(sensor, rows, stretch.left_out)
    run = _run(sensor, timing)
    if pattern.kind == "bursts" and pattern.rate_hz:  # the times of both ends are wrong by up to a burst
        run["interval_s"] = 1 / pattern.rate_hz
    surveyed = survey(sensor, rows, timing, run["interval_s"], estimator, stretch.left_out)
    count = statistics.rows or math.nan
    runs = runs_of_curve(timing, surveyed.estimator) if surveyed else (timing.run,)
    pooled = sum(rows.stop - rows.start for rows in runs)
    per_count = _per_count(sensor, scale)
    rails = find_rails(sensor) if sensor.is_triad else None
    stalls = find_stalls(sensor)
    interpolation = find_interpolation(sensor)
    processing = [find_missing_gravity(sensor), *find_filters(sensor)]
    return {
        **_identity(sensor, per_count),
        "rows": statistics.rows,
        "rows_used": statistics.used,
        "flags": dict(statistics.flags),
        "stale_share": statistics.flags["stale"] / count,
        "rate_hz": 1 / run["interval_s"],
        "median_interval_s": timing.interval_s,
        "gaps": timing.gaps,
        "largest_gap_s": timing.largest_gap_s,
        "allan_run": run
        | {"rows": pooled, "runs": len(runs), "longest_run_rows": run["rows"], "left_out_share": 1 - pooled / count},
        "allan_estimator": surveyed and surveyed.estimator,
        "timing": surveyed
        and timing_of(surveyed, 1 / run["interval_s"])
        | {
            "pattern": asdict(pattern) | {"sentence": pattern.sentence or rate_change_sentence(rate_runs)},
            "rates": [asdict(run) for run in rate_runs],
        },
        "spectrum": surveyed and spectrum_of(surveyed),
        "rails": rails and asdict(rails) | {"flagged": sensor.flagged()["saturated"]},
        "processing": [text for text in processing if text],
        "interpolation": interpolation and asdict(interpolation) | {"sentence": interpolation.sentence},
        "stalls": stalls and asdict(stalls) | {"adaptive_range": stalls.is_adaptive},
        "axes": _axes(sensor, per_count, surveyed, statistics, progress),
    }


def _identity(sensor: SensorLog, per_axis: npt.NDArray[np.float64]) -> dict[str, Any]:
    """Return a sensor's header from the log, and its mean scale over the axes."""
    per_count = float(per_axis.mean())
    return {
        "name": sensor.name,
        "chip": sensor.chip,
        "quantity": sensor.quantity,
        "range": sensor.range,
        "unit": sensor.unit,
        "si_unit": SI_NAME[sensor.unit],
        "unit_per_count": per_count,
        "si_per_count": per_count * SI_PER_UNIT[sensor.unit],
    }


def _per_count(sensor: SensorLog, scale: Sequence[float] | None) -> npt.NDArray[np.float64]:
    """Return units per count (k,): as calibrated, or those of the data sheet; nan if not known."""
    columns = int(sensor.counts.shape[1])
    nominal = sensor.axis_sensitivity if sensor.is_triad else (sensor.sensitivity,) * columns
    return np.asarray(1 / np.array([value or np.nan for value in (nominal if scale is None else scale)]))


def _axes(
    sensor: SensorLog,
    per_count: npt.NDArray[np.float64],
    surveyed: Survey | None,
    statistics: NoiseStatistics,
    progress: Progress,
) -> list[dict[str, Any]]:
    """Return the results of every column: its statistics and those of the survey."""
    axes = []
    for column, name in enumerate(sensor.count_columns):
        unit = float(per_count[column])
        scales = {"counts": 1.0, "unit": unit, "si": unit * SI_PER_UNIT[sensor.unit]}
        curve = surveyed.curve.column(column) if surveyed and surveyed.curve else None
        axis = _axis(name, column, statistics, curve, scales)
        axes.append(axis | (column_of(surveyed, column, sensor) if surveyed else {}))
        progress()
    return axes


def _run(sensor: SensorLog, timing: Timing) -> dict[str, Any]:
    """Return the rows of the Allan deviation; `interval_s` is their mean interval, the unit of tau.

    It is the mean and not the median, because an array that is polled in alternating order has alternating intervals.
    """
    first, last = timing.run.start, timing.run.stop - 1
    if last <= first:
        return {"start_s": math.nan, "end_s": math.nan, "rows": last + 1 - first, "interval_s": math.nan}
    start, end = int(sensor.time[first]), int(sensor.time[last])
    interval_s = (end - start) * 1e-9 / (last - first)
    return {"start_s": start * 1e-9, "end_s": end * 1e-9, "rows": last + 1 - first, "interval_s": interval_s}


def _axis(
    name: str, column: int, statistics: NoiseStatistics, curve: AllanCurve | None, scales: dict[str, float]
) -> dict[str, Any]:
    """Return one axis: statistics and coefficients in counts, the sensor's unit and SI, and the curve in counts."""
    white = curve and white_noise(curve.tau_s, curve.deviation, curve.freedom)
    lowest = curve and floor(curve.tau_s, curve.deviation, curve.low, curve.high, curve.freedom)
    values = {
        "mean": float(statistics.mean[column]),
        "std": float(statistics.std[column]),
        "sem": float(statistics.sem[column]),
        "noise_density": white.density if white else math.nan,
        "noise_density_one_sided": white.density * math.sqrt(2) if white else math.nan,
        "bias_instability": lowest.instability if lowest else math.nan,
        "bias_instability_low": lowest.low if lowest else math.nan,
        "bias_instability_high": lowest.high if lowest else math.nan,
    }
    return {
        "axis": name,
        "unit_per_count": scales["unit"],
        **{unit: {key: value * scale for key, value in values.items()} for unit, scale in scales.items()},
        "lag1": float(statistics.lag1[column]),
        "even_share": float(statistics.even_share[column]),
        "noise_density_tau_s": [white.shortest_s, white.longest_s] if white else None,
        "bias_instability_tau_s": lowest.tau_s if lowest else None,
        "bias_instability_is_bound": lowest.is_bound if lowest else None,
        "allan": asdict(curve) if curve else None,
    }
