"""The recording on a page: the envelope of every sensor over time, with marks where it is clipped, missing or silent.

An envelope is the least and the greatest value of each stretch of rows, so that a spike of one reading is visible
however long the log is. The page contains it twice: as SVG, which needs no script and can be printed, and for BokehJS,
which can zoom (`recording.js`).
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from math import ceil, floor, log10
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Times
from imuarray.calibrate import Calibration
from imuarray.log import Log, SensorLog
from imuarray.log.format import LOST_BEFORE, SATURATED
from imuarray.log.row_timing import row_timing
from imuarray.printable import counted
from imuarray.series import true_runs
from imuarray.units import SI_PER_UNIT

SILENT_S = 1.0
"""Least time in s by which the readings of a silent sensor begin after those of the others, or end before them."""
PERIODS = 2.5
"""Length of a pause, in periods of the sensor, above which readings are missing. If the array is polled in alternating
order, readings are up to two periods apart.
"""

_MOST_STRETCHES = 64_000
"""Largest number of stretches of all sensors together: 28 bytes each, a third more as text, so that the page is below
5 MB.
"""
_MOST_OF_ONE = 4000
"""Largest number of stretches of a sensor."""
_STATIC = 500
"""Largest number of stretches of a sensor in the SVG, about one for each pixel of its width."""
_BLOCK = 1 << 16
_SEPARATE = 400
"""Ratio of the duration of the recording to the distance of two marks, above which the marks are joined."""

Kind = Literal["clipped", "missing", "silent"]
KINDS: tuple[Kind, ...] = ("clipped", "missing", "silent")


class SignalSpan(NamedTuple):
    """A span of time, in s since the epoch of the log, in which a sensor is clipped, missing or silent."""

    kind: Kind
    start_s: float
    end_s: float


class TimeUnit(NamedTuple):
    """The unit in which the time axis is readable."""

    name: str
    seconds: float


@dataclass(frozen=True)
class Trace:
    """One sensor over time: `time_s` (n,), and the least and greatest values `low` and `high` (n, k) of n stretches for
    the k `columns`; nan where readings are missing for longer than a stretch. `note` states what the `spans` mark.
    """

    name: str
    about: str
    unit: str
    columns: tuple[str, ...]
    time_s: Floats
    low: Floats
    high: Floats
    spans: tuple[SignalSpan, ...]
    note: str


@dataclass(frozen=True)
class RecordingFigure:
    """Every sensor of a log over the same time, from `start_s` to `end_s`."""

    traces: Sequence[Trace]
    start_s: float
    end_s: float

    @property
    def time_unit(self) -> TimeUnit:
        """Return seconds, minutes or hours, by the duration."""
        duration_s = self.end_s - self.start_s
        return (
            TimeUnit("s", 1.0)
            if duration_s < 600
            else TimeUnit("min", 60.0)
            if duration_s < 7200
            else TimeUnit("h", 3600.0)
        )

    @property
    def data(self) -> dict[str, Any]:
        """Return the data of `recording.js` for JSON; numbers are the base64 text of little-endian float32."""
        unit = self.time_unit
        return {
            "start": self.start_s / unit.seconds,
            "end": self.end_s / unit.seconds,
            "time_unit": unit.name,
            "traces": [
                {
                    "unit": trace.unit,
                    "columns": trace.columns,
                    "time": _encode(trace.time_s / unit.seconds),
                    "low": [_encode(column) for column in trace.low.T],
                    "high": [_encode(column) for column in trace.high.T],
                    "spans": [(kind, start / unit.seconds, end / unit.seconds) for kind, start, end in trace.spans],
                }
                for trace in self.traces
            ],
        }

    @property
    def drawings(self) -> list[Drawing]:
        """Return the traces as paths of an SVG whose view box is 1000 wide and 100 high."""
        return [_drawing(trace, self) for trace in self.traces]


class Drawing(NamedTuple):
    """A trace as SVG: a closed path for each column, rectangles (kind, left, width), the height of the zero line (None:
    not in view), and the labels of the ends of both axes.
    """

    trace: Trace
    paths: Sequence[str]
    rectangles: Sequence[tuple[Kind, float, float]]
    zero: float | None
    bottom: str
    top: str
    start: str
    end: str


def recording_of(log: Log, calibration: Calibration) -> RecordingFigure | None:
    """Return the envelopes of all sensors of a log, in the box frame and in the sensors' units, by `calibration` or
    else by the data sheets' sensitivity; counts where neither is known. None if the log holds no reading.
    """
    with_rows = [sensor for sensor in log.sensors.values() if len(sensor)]
    if not with_rows:
        return None
    ends_ns = (min(int(sensor.time[0]) for sensor in with_rows), max(int(sensor.time[-1]) for sensor in with_rows))
    most = max(50, min(_MOST_OF_ONE, _MOST_STRETCHES // len(log.sensors)))
    traces = [_trace(sensor, calibration, ends_ns, most) for sensor in log.sensors.values()]
    return RecordingFigure(traces, ends_ns[0] * 1e-9, ends_ns[1] * 1e-9)


def silent_s(sensor: SensorLog, ends_ns: tuple[int, int]) -> tuple[float, float]:
    """Return for how many seconds a sensor is silent at the beginning and at the end of a log that lasts from the first
    to the second of `ends_ns`; 0 for less than `SILENT_S` or `PERIODS` of its periods.
    """
    if not len(sensor):
        return 0.0, max((ends_ns[1] - ends_ns[0]) * 1e-9, 1e-9)
    first_ns, last_ns = int(sensor.time[0]), int(sensor.time[-1])
    period_s = (last_ns - first_ns) * 1e-9 / max(len(sensor) - 1, 1)
    limit_s = max(SILENT_S, PERIODS * period_s)
    before_s, after_s = (first_ns - ends_ns[0]) * 1e-9, (ends_ns[1] - last_ns) * 1e-9
    return before_s if before_s > limit_s else 0.0, after_s if after_s > limit_s else 0.0


def _trace(sensor: SensorLog, calibration: Calibration, ends_ns: tuple[int, int], most: int) -> Trace:
    columns, unit = _columns(sensor)
    before_s, after_s = silent_s(sensor, ends_ns)
    start_s, end_s = ends_ns[0] * 1e-9, ends_ns[1] * 1e-9
    spans = [SignalSpan("silent", start_s, start_s + before_s)] if before_s else []
    spans += [SignalSpan("silent", end_s - after_s, end_s)] if after_s else []
    width = -(-len(sensor) // most) if len(sensor) > most else 1
    period_ns = _period_ns(sensor)
    in_bursts = row_timing(sensor).kind == "bursts"
    longest_ns = np.inf if in_bursts else PERIODS * period_ns  # between bursts there are pauses without a loss
    parts: list[tuple[Floats, Floats, Floats]] = []
    clipped = missing = 0
    missing_s, last_ns = 0.0, None
    for rows in sensor.blocks(width * max(1, _BLOCK // width)):
        time, status = np.asarray(sensor.time[rows], np.int64), np.asarray(sensor.status[rows])
        steps = np.diff(time, prepend=time[0] if last_ns is None else last_ns)
        last_ns = int(time[-1])
        at_end = (status & SATURATED) != 0
        pauses = np.flatnonzero((steps > longest_ns) | (((status & LOST_BEFORE) != 0) & (steps > 0)))
        clipped, missing = clipped + int(at_end.sum()), missing + len(pauses)
        missing_s += float(steps[pauses].sum()) * 1e-9
        spans += [SignalSpan("missing", (time[row] - steps[row]) * 1e-9, time[row] * 1e-9) for row in pauses]
        spans += [
            SignalSpan("clipped", time[first] * 1e-9, (time[end - 1] + period_ns) * 1e-9)
            for first, end in zip(*true_runs(at_end), strict=True)
        ]
        breaks = np.flatnonzero(steps > max(longest_ns, width * period_ns))
        parts.append(_envelope(time, _values(sensor, rows, calibration), np.arange(0, len(time), width), breaks))
    time_s, low, high = (
        (np.concatenate([part[number] for part in parts]) for number in range(3))
        if parts
        else (np.zeros(0), np.zeros((0, len(columns))), np.zeros((0, len(columns))))
    )
    notes = [_note(clipped, missing, missing_s, before_s, after_s), "rows arrived in bursts" if in_bursts else ""]
    note = "; ".join(filter(None, notes))
    subtitle = f"{sensor.chip}, {sensor.quantity.replace('_', ' ')}"
    merged = tuple(_merge(spans, (end_s - start_s) / _SEPARATE))
    return Trace(sensor.name, subtitle, unit, columns, time_s, low, high, merged, note)


def _columns(sensor: SensorLog) -> tuple[tuple[str, ...], str]:
    """Return the names of the columns that are drawn, and their unit."""
    for name, unit in (("pressure", "Pa"), ("temperature", "°C")):
        if sensor.quantity == name and sensor.has_compensated(name):
            return (name,), unit
    if sensor.is_triad:
        return ("X", "Y", "Z"), sensor.unit if sensor.sensitivity else "counts"
    return tuple(f"counts {number + 1}" for number in range(sensor.counts.shape[1])), "counts"


def _values(sensor: SensorLog, rows: slice, calibration: Calibration) -> Floats:
    """Return the values (n, k) of some rows."""
    columns, unit = _columns(sensor)
    if columns[0] in ("pressure", "temperature"):
        return np.asarray(sensor.compensated(columns[0])[rows], float)[:, None]
    counts = np.asarray(sensor.counts[rows], float)
    if unit == "counts":
        return counts
    if sensor.name in calibration.sensors:
        return np.asarray(calibration.of(sensor).stimulus_box(counts) / SI_PER_UNIT[sensor.unit])
    return np.asarray(counts / sensor.axis_sensitivity @ sensor.orientation.T)


def _period_ns(sensor: SensorLog) -> float:
    """Return the usual time between two readings in ns: half the median duration of two consecutive steps, which is
    constant even if sensors are polled in alternating order.
    """
    time = np.asarray(sensor.time[: 4 * 4096], np.int64)
    return float(np.median(time[2:] - time[:-2])) / 2 if len(time) > 2 else float("inf")


def _envelope(
    time: Times, values: Floats, first: npt.NDArray[np.intp], breaks: npt.NDArray[np.intp]
) -> tuple[Floats, Floats, Floats]:
    """Return times in s and the least and greatest values of the stretches that begin at the rows `first` and `breaks`,
    with a row of nan before each of `breaks`.
    """
    first = np.union1d(first, breaks)
    last = np.append(first[1:], len(time)) - 1
    centre_s = (time[first] + time[last]) * 0.5e-9
    low, high = np.fmin.reduceat(values, first, axis=0), np.fmax.reduceat(values, first, axis=0)
    places = np.searchsorted(first, breaks)
    blank_s = (time[breaks] + time[np.maximum(breaks - 1, 0)]) * 0.5e-9
    return (
        np.insert(centre_s, places, blank_s),
        np.insert(low, places, np.nan, axis=0),
        np.insert(high, places, np.nan, axis=0),
    )


def _merge(spans: Sequence[SignalSpan], separate_s: float) -> Iterator[SignalSpan]:
    """Yield the spans by kind and in order; spans of one kind that are closer than `separate_s` are joined."""
    for kind in KINDS:
        last: SignalSpan | None = None
        for span in sorted(span for span in spans if span.kind == kind):
            if last is not None and span.start_s - last.end_s < separate_s:
                last = last._replace(end_s=max(last.end_s, span.end_s))
                continue
            if last is not None:
                yield last
            last = span
        if last is not None:
            yield last


def _note(clipped: int, missing: int, missing_s: float, before_s: float, after_s: float) -> str:
    parts = [f"{counted(clipped, 'reading')} clipped"] if clipped else []
    length = f"{missing_s:.2g}" if missing_s < 100 else f"{missing_s:.0f}"
    parts += [f"readings missing in {counted(missing, 'pause')}, {length} s in all"] if missing else []
    parts += [f"silent for {before_s:.0f} s at the beginning"] if before_s else []
    parts += [f"silent for {after_s:.0f} s at the end"] if after_s else []
    return "; ".join(parts)


# Drawings ------------------------------------------------------------------------------------------------------------


def _drawing(trace: Trace, recording: RecordingFigure) -> Drawing:
    low, high = _limits(trace)
    duration_s = max(recording.end_s - recording.start_s, 1e-9)
    time_s, lowest, greatest = _coarser(trace)
    across = 1000 * (time_s - recording.start_s) / duration_s
    down = [100 * (high - edge) / (high - low) for edge in (greatest, lowest)]
    paths = ["".join(_outline(across, down[0][:, k], down[1][:, k])) for k in range(len(trace.columns))]
    rectangles = [
        (span.kind, round(1000 * (span.start_s - recording.start_s) / duration_s, 1),
         round(max(2.0, 1000 * (span.end_s - span.start_s) / duration_s), 1))
        for span in trace.spans
    ]  # fmt: skip
    unit = recording.time_unit
    start, end = (f"{round(at_s / unit.seconds, 2):g} {unit.name}" for at_s in (recording.start_s, recording.end_s))
    zero = 100 * high / (high - low) if low < 0 < high else None
    return Drawing(trace, paths, rectangles, zero, f"{low:.6g}", f"{high:.6g}", start, end)


def _limits(trace: Trace) -> tuple[float, float]:
    """Return round numbers below and above all values."""
    if not np.isfinite(trace.low).any():
        return 0.0, 1.0
    low, high = float(np.nanmin(trace.low)), float(np.nanmax(trace.high))
    span = (high - low) or abs(high) or 1.0
    step = 10.0 ** floor(log10(span / 10))
    step *= next(factor for factor in (1, 2, 5, 10) if span / (factor * step) <= 10)
    bottom, top = floor(low / step) * step, ceil(high / step) * step
    return (bottom, top) if top > bottom else (bottom - step, top + step)


def _coarser(trace: Trace) -> tuple[Floats, Floats, Floats]:
    """Return the envelope in at most about `_STATIC` stretches; rows of nan remain."""
    width = -(-len(trace.time_s) // _STATIC)
    if width <= 1:
        return trace.time_s, trace.low, trace.high
    blank = np.flatnonzero(np.isnan(trace.low).all(axis=1))
    first = np.unique(np.concatenate([np.arange(0, len(trace.time_s), width), blank, blank + 1]))
    first = first[first < len(trace.time_s)]
    last = np.append(first[1:], len(trace.time_s)) - 1
    centre_s = (trace.time_s[first] + trace.time_s[last]) / 2
    return centre_s, np.fmin.reduceat(trace.low, first, axis=0), np.fmax.reduceat(trace.high, first, axis=0)


def _outline(across: Floats, top: Floats, bottom: Floats) -> Iterator[str]:
    """Yield a closed path around each run of finite values."""
    for first, end in zip(*true_runs(np.isfinite(top)), strict=True):
        upper = [f"{x:.1f},{y:.1f}" for x, y in zip(across[first:end], top[first:end], strict=True)]
        lower = [f"{x:.1f},{y:.1f}" for x, y in zip(across[first:end], bottom[first:end], strict=True)]
        yield f"M{' '.join([*upper, *reversed(lower)])}Z"


def _encode(values: Floats) -> str:
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")


# Scripts -------------------------------------------------------------------------------------------------------------


@cache
def scripts() -> tuple[str, ...]:
    """Return the scripts to zoom a recording: BokehJS from the installed package, and `recording.js`; none without
    Bokeh.
    """
    package = find_spec("bokeh")
    if package is None or package.origin is None:
        return ()
    folder = Path(package.origin).parent / "server" / "static" / "js"  # importing bokeh would take half a second
    try:
        parts = [(folder / name).read_text(encoding="utf-8") for name in ("bokeh.min.js", "bokeh-api.min.js")]
    except OSError:
        return ()
    return (*parts, files("imuarray.report").joinpath("recording.js").read_text(encoding="utf-8"))
