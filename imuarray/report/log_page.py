"""Report of a log: what was recorded, gaps and flags, the noise of each sensor at rest, and what is unusual."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import timedelta
from typing import Any

import numpy as np

from imuarray.calibrate import Calibration
from imuarray.calibrate.motion import longest_rest
from imuarray.characterise import characterise_log
from imuarray.characterise.findings import findings
from imuarray.characterise.plots import allan_figure, spectrum_figure
from imuarray.errors import ImuArrayError
from imuarray.log import Log, SensorLog
from imuarray.log.format import FLAGS
from imuarray.printable import counted, duration, listed
from imuarray.report.page import Figure, Section, Table
from imuarray.report.recording import PERIODS, RecordingFigure, recording_of, scripts
from imuarray.units import READABLE
from imuarray.wall_time import wall_time

_EVENTS = 500
"""Largest number of different events that are listed."""

_ALLAN_S = 30.0
"""Least time at rest in s for which an Allan deviation is drawn, up to averaging times of several seconds."""

_TERMS = ("white", "flicker", "random walk")
"""Terms of the Allan fit: N, B and K of IEEE Std 952."""


def log_summary(log: Log) -> Iterator[str]:
    """Yield a line on the length, sensors and source of a log, and one on its state if it is not finished."""
    rows = sum(len(sensor) for sensor in log.sensors.values())
    source = "the emulated array, no hardware" if log.source == "emulated" else log.source
    yield f"{log.path.name}: {_duration(log)} of {counted(len(log.sensors), 'sensor')}, {rows} readings ({source})."
    if log.state != "finished":
        yield f"{log.path.name} is {log.state}: the page shows the acknowledged rows."


def log_sections(
    log: Log,
    scales: Mapping[str, Any],
    *,
    with_figures: bool,
    progress: Callable[[float], None] = lambda share: None,
    calibration: Calibration | None = None,
) -> Iterator[Section]:
    """Yield the sections on what was recorded, on every sensor over time by `calibration` (None: by the data sheets),
    and on the noise at rest. `scales`: calibrated counts per unit by sensor, for the noise.
    """
    yield _recording_section(log)
    if recording := recording_of(log, calibration or Calibration()):
        yield _figure_section(log, recording)
    columns = itertools.count(1)
    total = 3 * sum(sensor.is_triad for sensor in log.sensors.values())
    try:
        result = characterise_log(
            log, longest_rest(log), progress=lambda: progress(next(columns) / total), scales=scales
        )
    except ImuArrayError as error:
        yield Section(f"{log.path.name}: noise", f"The noise could not be determined: {error}.")
        return
    yield _noise(log, result, with_figures=with_figures)


def doubt_sections(log: Log, doubts: Sequence[str]) -> Iterator[Section]:
    """Yield the section of `doubts` (`imuarray.importers.plausibility`) about an imported log, if there are any."""
    if not doubts:
        return
    words = (
        "The readings contradict the map of the import, or what the sensors can do. Correct the map, or explain each"
        " line, before you use the figures below."
    )
    rows = [[where, what] for where, _, what in (text.partition(": ") for text in doubts)]
    parts = [Table(["where", "what is doubtful"], rows, "The doubts that the import of this log printed.", (1,))]
    yield Section(f"{log.path.name}: what is doubtful", words, parts)


def _recording_section(log: Log) -> Section:
    rows, flagged = [], dict.fromkeys(FLAGS, 0)
    for sensor in log.sensors.values():
        flags = sensor.flagged()
        for name, count in flags.items():
            flagged[name] += count
        listed = ", ".join(f"{count} {name}" for name, count in flags.items() if count)
        span = f"±{sensor.range:g} {sensor.unit}" if sensor.range else "–"
        seconds = float(sensor.time[-1] - sensor.time[0]) * 1e-9 if len(sensor) > 1 else 0.0
        rate = f"{(len(sensor) - 1) / seconds:.2f}" if seconds else "–"
        longest = f"{1e3 * _longest_s(sensor):.1f}"
        rows.append([sensor.name, sensor.chip, span, sensor.axes, str(len(sensor)), rate, longest, listed or "none"])
    lost_before = flagged.get("lost_before", 0)
    start = f"Epoch {log.epoch}" if log.is_dated else "Recorded at an unknown date"
    words = f"{start}, written by {log.software}. "
    words += (
        "No readings were lost. " if not lost_before else f"Readings are missing before {lost_before} of the readings. "
    )
    words += (
        "The flags come from the log: stale means that the chip had no new reading, saturated that an axis was at the"
        " limit of its range."
    )
    heading = ["sensor", "chip", "range", "axes", "readings", "Hz", "longest pause ms", "flags"]
    parts = [
        Table(heading, rows, "All sensors. Look for a rate that differs from the others, and for flags.", (1, 3, 7))
    ]
    if log.phases:
        stretches = [[p.name, p.up or "–", f"{p.start_ns * 1e-9:.1f}", f"{p.end_ns * 1e-9:.1f}"] for p in log.phases]
        parts.append(Table(["phase", "up", "from s", "to s"], stretches, "The phases of the log.", (1,)))
    if log.events:
        parts.append(_events(log))
    return Section(f"{log.path.name}: what was recorded", words, parts)


def _events(log: Log) -> Table:
    """Return the table of events; events that repeat share a row, with their number and the time of the last one."""
    repeats: dict[tuple[str, str, str], list[float]] = {}
    for event in sorted(log.events):
        repeats.setdefault((event.sensor, event.kind, event.message), []).append(event.time_ns * 1e-9)
    rows = [
        [f"{times[0]:.3f}", f"{times[-1]:.3f}" if len(times) > 1 else "–", str(len(times)), sensor or "array", *words]
        for (sensor, *words), times in list(repeats.items())[:_EVENTS]
    ]
    hidden = len(repeats) - len(rows)
    more = f" {hidden} more are in the log; `imuarray info` prints them." if hidden else ""
    caption = f"The events of the log; repeated events share a row.{more}"
    return Table(["at s", "last at s", "times", "sensor", "kind", "what"], rows, caption, (3, 4, 5))


def _figure_section(log: Log, recording: RecordingFigure) -> Section:
    marked = [trace.name for trace in recording.traces if trace.spans]
    words = (
        f"Sensors with clipped, missing or silent stretches: {listed(marked)}. "
        if marked
        else "No sensor has clipped, missing or silent stretches. "
    )
    words += (
        "Each band spans the smallest to the largest value of a stretch of readings, so that even a single spike is"
        " visible. Clipped readings are at the end of the range. Readings are missing in a pause of more than"
        f" {PERIODS:g} periods, or where the log flags a loss. A sensor is silent after its last reading."
    )
    words += "" if scripts() else " The figures can be zoomed once Bokeh is installed: pip install 'imuarray[monitor]'."
    return Section(f"{log.path.name}: the recording", words, [recording])


def _longest_s(sensor: SensorLog) -> float:
    """Return the longest time between two consecutive readings."""
    longest, last = 0, None
    for block in sensor.blocks():
        time = np.asarray(sensor.time[block])
        steps = np.diff(time, prepend=time[:1] if last is None else last)
        longest, last = max(longest, int(steps.max(initial=0))), time[-1:]
    return longest * 1e-9


def _duration(log: Log) -> str:
    """Return the text of the length of a log and of the time at which it begins."""
    rows = [sensor for sensor in log.sensors.values() if len(sensor)]
    if not rows:
        return "nothing"
    first, last = min(int(s.time[0]) for s in rows), max(int(s.time[-1]) for s in rows)
    seconds = (last - first) * 1e-9
    length = duration(seconds, 1)
    epoch = wall_time(log.epoch) if log.is_dated else None
    try:
        start = None if epoch is None else epoch + timedelta(microseconds=first // 1000)
    except OverflowError:
        start = None
    return length if start is None else f"{length} from {start:%Y-%m-%d %H:%M:%S} UTC"


def _noise(log: Log, result: Mapping[str, Any], *, with_figures: bool) -> Section:
    stretch = result["stretch"]
    where = (
        f"phase {stretch['phase']}: {stretch['chosen_by']}"
        if stretch["phase"]
        else "the whole log; motion, if there is any, counts as noise"
    )
    words = f"Over {stretch['start_s']:.1f} s to {stretch['end_s']:.1f} s ({where})."
    sentences = findings(result)
    words += "" if sentences else " Nothing unusual: no spectral line, no clipping, no missing codes."
    seconds = stretch["end_s"] - stretch["start_s"]
    parts: list[Table | Figure] = []
    if sentences:
        rows = [text.split(": ", 1) if ": " in text else ["box", text] for text in sentences]
        parts.append(Table(["where", "what"], rows, "What is unusual, the most important first.", (1,)))
    parts.append(_noise_table(result))
    if seconds < _ALLAN_S:
        words += (
            f" The Allan deviation is not drawn: {seconds:.0f} s are too short, at least {_ALLAN_S:.0f} s are needed."
            " One minute at rest shows white noise, hours show drift."
        )
    elif with_figures:
        caption = (
            "Straight lines of slope -1/2 are white noise. Where a curve is flat or rises, the bias wanders, and"
            " averaging longer gains nothing."
        )
        parts.append(Figure(allan_figure(result), caption, "Allan deviation of every axis against averaging time"))
    if with_figures and (drawing := spectrum_figure(result)).axes:  # no axes if there are too few rows
        caption = "A flat spectrum is white noise, a fall at high frequency is a filter, a peak is a vibration or hum."
        parts.append(Figure(drawing, caption, "Spectral density of every axis against frequency"))
    return Section(f"{log.path.name}: noise", words, parts)


def _noise_table(result: Mapping[str, Any]) -> Table:
    rows = []
    for sensor in result["sensors"]:
        factor, unit = READABLE.get(sensor["unit"], (1.0, sensor["unit"]))
        for axis in sensor["axes"]:
            own, fit = axis["unit"], axis.get("fit")
            scatter = f"{factor * own['std']:.4g}" if own["std"] is not None else "–"
            cells = [_format_coefficient(fit, name, factor * abs(axis["unit_per_count"] or 1.0)) for name in _TERMS]
            rows.append([f"{sensor['name']} {axis['axis']}", unit, scatter, *cells])
    heading = ["axis", "unit", "scatter", "N, unit/√Hz", "B, unit", "K, unit/√s"]
    caption = (
        "Scatter of single readings; white noise N, bias instability B and rate random walk K fitted to the Allan"
        " deviation (IEEE Std 952), with 95 % intervals. “<”: not detected, the figure is an upper limit. A figure in"
        " brackets has another cause: a spectral line, a drift or coloured noise."
    )
    return Table(heading, rows, caption, (1,))


def _format_coefficient(fit: Mapping[str, Any] | None, name: str, factor: float) -> str:
    """Return the text of a coefficient with its interval, or its upper limit."""
    term = None if fit is None else fit["terms"].get(name)
    if term is None:
        return "–"
    low, high = (factor * bound for bound in (term["low"], term["high"]))
    if term["doubtful"] and term["significant"] and low > 0:
        return f"({factor * term['value']:.3g})"
    if low <= 0:
        return f"< {high:.2g}"
    return f"< {high:.2g}" if not term["significant"] else f"{factor * term['value']:.3g} ({low:.3g} to {high:.3g})"
