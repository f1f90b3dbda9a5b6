"""Composition of a snapshot from rows that were read: sensors in data sheet units, frames, disk space, fused output.

The fused output of the last seconds is the result that is being written beside the log, or else the average of the
rows that were read.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate import Calibration
from imuarray.calibrate.segments import degc_of, has_zero
from imuarray.characterise.spectrum import Spectrum, Welch, segment_rows
from imuarray.errors import ImuArrayError, LogError
from imuarray.fuse import FusedBlock, fuse
from imuarray.fuse.fused_file import fused_columns, rows_of
from imuarray.log import Log, SensorLog, first_at
from imuarray.log.disk_space import WATERMARK, free_bytes
from imuarray.log.format import FLAGS
from imuarray.log.health import Observations, health_of
from imuarray.log.missed_frames import (
    frame_period_ns,
    is_read_once_a_frame,
    loses_no_reading,
    missed_by_all,
    missing_rows,
)
from imuarray.monitor.log_source import LogSource
from imuarray.monitor.snapshot import INTERRUPTED, WRITTEN, Disk, FusedView, SensorView, Snapshot
from imuarray.monitor.window import Gaps, LatestRows, MemoryLog, Rows
from imuarray.units import INERTIAL

_LAST_NS = 1_000_000_000
"""Duration in ns of the last part of the log; the current reading is the mean of this part."""
_LAST_PERIODS = 2.5
"""Duration of this part in periods of a slow sensor."""
_HELD_PERIODS = 26.0
_HELD_BANDWIDTHS = 30.0
_HELD_NS = 10_500_000_000
"""Time in ns by which the newest row of a slow sensor may be older than that of the log. The logger holds readings
until it is certain that the sensor is not frozen: for 24 readings and 30 correlation times, but at most 10 s.
"""
_LEAST_ROWS = 128
"""Least number of rows for a spectrum."""
_BREAK = 3.0
"""Step in periods above which the rows after it are a separate run."""
_PRESSURE = "pressure"


def view_of(
    sensor: SensorLog, window: LatestRows, earlier: Gaps, extent: tuple[int, int], frame_period_ns: int = 0
) -> SensorView:
    """Return the view of a sensor: `sensor` has the rows of the window, `earlier` are gaps before them. `extent` are
    the times of the first and of the newest row of the log; `frame_period_ns` is the period of its frames (0: unknown).
    """
    time = window.time
    values, unit, columns = _values(sensor, window)
    silent_ns = _silence(sensor, window, extent)
    since_ns = (int(time[-1]) if len(time) else 0) - max(_LAST_NS, _LAST_PERIODS * window.usual_ns)
    last = slice(int(np.searchsorted(time, since_ns)), 0 if silent_ns else len(time))
    use, peak = _use(sensor, window)
    degc, relative = _temperature(sensor, window, last)
    rate_hz = (len(time) - 1) / ((time[-1] - time[0] + silent_ns) * 1e-9) if len(time) > 1 else 0.0
    usual_hz = 1e9 / window.usual_ns if silent_ns and window.usual_ns else rate_hz
    framed = is_read_once_a_frame(sensor.rate_hz, usual_hz, frame_period_ns)
    return SensorView(
        sensor.name, sensor.chip, sensor.quantity, unit, columns,
        rows=window.total,
        first_ns=window.first_ns,
        rate_hz=float(rate_hz),
        silent_s=silent_ns * 1e-9 if silent_ns else None,
        framed=framed,
        delayed=window.gaps.delayed + earlier.delayed,
        missed=_count_missed(window, earlier, silent_ns, frame_period_ns if framed else 0),
        flags=_flags(window),
        time=time,
        values=values,
        mean=values[last].mean(axis=0) if len(values[last]) else np.full(len(columns), np.nan),
        sd=values.std(axis=0, ddof=1) if len(time) > 1 else np.full(len(columns), np.nan),
        use=use,
        peak_use=peak,
        temperature_degc=degc,
        relative=relative,
        spectrum=_spectrum(window, values) if sensor.is_triad else None,
    )  # fmt: skip


def _silence(sensor: SensorLog, window: LatestRows, extent: tuple[int, int]) -> int:
    """Return how long a sensor has been silent, in ns up to the newest row of the log; 0 if it is not silent."""
    begins_ns, ends_ns = extent
    since_ns = ends_ns - (int(window.newest[-1]) if len(window.newest) else begins_ns)
    period_ns = window.usual_ns or (1e9 / sensor.rate_hz if sensor.rate_hz else 0.0)
    held_ns = max(_HELD_PERIODS * period_ns, _HELD_BANDWIDTHS * 1e9 / sensor.bandwidth_hz if sensor.bandwidth_hz else 0)
    return since_ns if since_ns > max(_LAST_NS, _LAST_PERIODS * period_ns, min(held_ns, _HELD_NS)) else 0


def _count_missed(window: LatestRows, earlier: Gaps, silent_ns: int, frame_period_ns: int) -> int:
    """Return the number of missing rows up to the newest row of the log; `frame_period_ns` is 0 for a sensor that is
    not read once per frame.
    """
    if frame_period_ns:
        missing = missing_rows(window.first_ns or 0, window.newest, window.total, frame_period_ns)
    else:
        missing = (window.gaps + earlier).missed
    period_ns = frame_period_ns or window.usual_ns
    return missing + (round(silent_ns / period_ns) if period_ns else 0)


def _values(sensor: SensorLog, window: LatestRows) -> tuple[Floats, str, tuple[str, ...]]:
    """Return the rows (n, k) in physical units, the unit, and the names of the columns."""
    counts = np.asarray(window.rows.get("counts", np.empty((0, 3))), float)
    if sensor.is_triad and sensor.sensitivity > 0:
        return counts / sensor.axis_sensitivity, sensor.unit, ("x", "y", "z")
    if _PRESSURE in window.rows:
        return np.asarray(window.rows[_PRESSURE], float)[:, None] / 100, "hPa", (_PRESSURE,)
    return counts, "counts", tuple(f"column {number + 1}" for number in range(counts.shape[1]))


def _use(sensor: SensorLog, window: LatestRows) -> tuple[Floats | None, Floats | None]:
    """Return the largest used share of the range in the window and in the log so far."""
    full = sensor.range * sensor.sensitivity
    if not (sensor.is_triad and full > 0 and len(window.time)) or window.peak_lsb is None:
        return None, None
    return np.abs(np.asarray(window.rows["counts"], float)).max(axis=0) / full, window.peak_lsb / full


def _temperature(sensor: SensorLog, window: LatestRows, last: slice) -> tuple[float | None, bool]:
    """Return the mean of the last rows in degC, and whether its zero is unknown; None without a thermometer."""
    if "temperature" in window.rows:
        return _finite_mean(window.rows["temperature"][last]), False
    degc = degc_of(sensor)
    if "temperature_counts" not in window.rows or degc is None:
        return None, False
    zero, step = degc
    mean = _finite_mean(window.rows["temperature_counts"][last])
    return None if mean is None else zero + step * mean, not has_zero(sensor)


def _finite_mean(rows: Any) -> float | None:
    finite = np.asarray(rows, float)[np.isfinite(rows)]
    return float(finite.mean()) if len(finite) else None


def _flags(window: LatestRows) -> dict[str, int]:
    status = np.asarray(window.rows.get("status", np.empty(0, np.uint16)))
    counts = {name: int(((status & flag) != 0).sum()) for name, flag in FLAGS.items()}
    return {name: count for name, count in counts.items() if count}


def _spectrum(window: LatestRows, values: Floats) -> Spectrum | None:
    """Return the power spectral density of the window's rows in squared units per Hz; None if there are too few."""
    if len(values) < _LEAST_ROWS or window.period_ns <= 0 or not np.isfinite(values).all():
        return None
    welch = Welch(1e9 / window.period_ns, segment_rows(len(values)), values.shape[1])
    breaks = np.flatnonzero(np.diff(window.time) > _BREAK * window.period_ns) + 1
    for part in np.split(values, breaks):
        welch.update(part)
        welch.end_run()
    spectrum = welch.result()
    return spectrum if spectrum.segments else None


TECHNIQUE = "mean"
_PATIENCE_S = (0.02, 0.05, 0.0)
"""Pause in s after each attempt to read a result that is being written."""


def fused_now(log: Log, calibration: Calibration) -> FusedView:
    """Return the average of the sensors of `log`, which has the last seconds; ImuArrayError if there is none."""
    block = FusedBlock.joined(list(fuse(log, calibration, TECHNIQUE)))
    return _view(TECHNIQUE, bool(calibration.sensors), block)


def fused_beside(path: Path, epoch: str, start_ns: int, result_path: Path | None = None) -> FusedView | None:
    """Return the rows from `start_ns` of the fused result of the log at `path`: `RUN_fused.h5`, or `result_path`
    (RESULT.h5); for a log that is split into parts, the result of the part (`RUN_001_fused.h5`, `RESULT_001.h5`) or of
    the whole. None if it does not exist, belongs to another log or ends before.
    """
    cut = re.fullmatch(r"(.+)(_\d{3,})", path.stem)
    whole, part = (cut[1], cut[2]) if cut else (path.stem, "")
    if result_path is None:
        names = [path.with_name(f"{stem}_fused{path.suffix}") for stem in (path.stem, whole)]
    else:
        names = [result_path.with_stem(result_path.stem + part), result_path]
    for candidate in dict.fromkeys(names):
        for patience_s in _PATIENCE_S if candidate.is_file() else ():
            try:
                view = _read(candidate, epoch, start_ns)
            except LogError:  # it is being written, or is not a fused result
                time.sleep(patience_s)
                continue
            if view is not None:
                return view
            break
    return None


def _read(path: Path, epoch: str, start_ns: int) -> FusedView | None:
    """Read a result as it is on the disk now, without a lock that could block its writer. LogError."""
    with fused_columns(path) as (header, columns):
        if header.get("epoch") != epoch:
            return None
        rows = rows_of(columns)  # the newest row may be incomplete
        first = first_at(columns["time"], start_ns, rows)
        at_ns = np.asarray(columns["time"][first:rows], np.int64)
        triads: dict[str, Floats] = {
            name: np.asarray(columns[name][first:rows], float) for name in INERTIAL if name in columns
        }
    if len(at_ns) < 2 or not triads:
        return None
    return _view(header.get("technique", "fused"), bool(header.get("calibration")), FusedBlock(at_ns, triads))


def _view(technique: str, calibrated: bool, block: FusedBlock) -> FusedView:
    last = block.time >= block.time[-1] - _LAST_NS
    means, noise = {}, {}
    for quantity, triad in block.triads.items():
        is_finite = np.isfinite(triad).all(axis=1)
        means[quantity] = triad[last & is_finite].mean(axis=0) if (last & is_finite).any() else np.full(3, np.nan)
        steps = np.diff(triad[is_finite], axis=0)
        noise[quantity] = np.std(steps, axis=0) / np.sqrt(2) if len(steps) > 1 else np.full(3, np.nan)
    return FusedView(technique, calibrated, block.time, block.triads, means, noise)


_ALIKE = 0.05
"""Largest relative difference between the rates of sensors that are read in the same frames."""
_COPIES = 2
"""Number of copies of each row: one in the journal, one in the HDF5 file."""


def snapshot_of(
    source: LogSource, calibration: Calibration, remark: str, quiet_s: float, result: Path | None = None
) -> Snapshot:
    """Return the snapshot of `source`, which has been quiet for `quiet_s`; `result` is the path of its fused output."""
    windows, events = source.read_rows.windows, source.read_rows.events
    begins_ns, ends_ns = _extent(windows.values())
    for window in windows.values():
        window.forget((ends_ns or 0) - source.read_rows.span_ns)
    memory_log = MemoryLog(
        source.path,
        {name: (source.attributes[name], window.rows or _no_rows(source, name)) for name, window in windows.items()},
    )
    period_ns = frame_period_ns(source.source, source.frame_rate_hz)
    extent = (begins_ns or 0, ends_ns or 0)
    views = tuple(
        view_of(memory_log[name], window, source.backlog.gaps(name), extent, period_ns)
        for name, window in windows.items()
    )
    frames = _frames(views)
    fused, not_fused = _choose_fused(source, windows, calibration, ends_ns or 0, result)
    steady = [view for view in views if view.quantity in INERTIAL and loses_no_reading(view.name, events.faults)]
    framed = [(view.first_ns, view.missed) for view in steady if view.framed and view.first_ns is not None]
    missed = missed_by_all(framed, period_ns)  # by the grid of the frames, or else by the rows that all sensors lack
    if missed is None:
        steady = [view for view in frames if loses_no_reading(view.name, events.faults)]
        missed = min((view.missed for view in steady), default=0)
    missed, disk = max(events.missed, missed), _disk(source, views)
    observations = _observations(source, views, missed, quiet_s, disk)
    return Snapshot(
        source.path,
        source.state,
        remark,
        source.source,
        source.epoch,
        events.phase if source.state == WRITTEN else "",
        begins_ns=begins_ns,
        ends_ns=ends_ns,
        quiet_s=max(0.0, quiet_s),
        rate_hz=float(np.median([view.rate_hz for view in frames])) if frames else 0.0,
        frame_rate_hz=source.frame_rate_hz,
        delayed=min((view.delayed for view in frames), default=0),
        missed=missed,
        counted=source.backlog.counted,
        events=events.kinds,
        problems=events.problems,
        recent=events.recent,
        repeated=events.repeated,
        health=None if begins_ns is None else health_of(observations),
        disk=disk,
        sensors=views,
        fused=fused,
        not_fused=not_fused,
    )


_QUIET_S = 5.0
"""Time in s without a row of any sensor after which a log that is being written counts as stopped."""


def _observations(
    source: LogSource, views: Sequence[SensorView], missed: int, quiet_s: float, disk: Disk | None
) -> Observations:
    stopped = "the logger stopped before the end" if source.state == INTERRUPTED else ""
    if source.state == WRITTEN and quiet_s >= _QUIET_S:
        stopped = f"no reading for {quiet_s:.0f} s"
    delivering = [view for view in views if view.silent_s is None]
    return Observations(
        sensors=len(views),
        frames=max((view.rows for view in views if view.framed), default=0),
        missed=missed,
        bus_failed=source.read_rows.events.bus_failed,
        silent={view.name: view.silent_s for view in views if view.silent_s is not None},
        lost={view.name: max(0, view.missed - missed) for view in delivering if view.framed},
        faults=source.read_rows.events.faults,
        stopped=stopped,
        room_s=None if disk is None else disk.left_s,
    )


def _extent(windows: Iterable[LatestRows]) -> tuple[int | None, int | None]:
    spoken = [window for window in windows if len(window.newest)]
    firsts = [window.first_ns for window in spoken if window.first_ns is not None]
    return min(firsts, default=None), max((int(window.newest[-1]) for window in spoken), default=None)


def _no_rows(source: LogSource, name: str) -> Rows:
    """Return empty columns for a sensor without rows."""
    columns = max(1, len(np.atleast_1d(source.attributes[name].get("columns", ("x", "y", "z")))))
    return {"time": np.empty(0, np.int64), "counts": np.empty((0, columns), np.int16)}


def _frames(views: Sequence[SensorView]) -> list[SensorView]:
    """Return the sensors that are read once a frame: the largest set of inertial sensors with the same rate. A missed
    frame is missing from all of them, a lost reading from one.
    """
    inertial = [view for view in views if view.quantity in INERTIAL and view.rate_hz > 0]
    sets = (
        [other for other in inertial if abs(other.rate_hz - view.rate_hz) <= _ALIKE * view.rate_hz] for view in inertial
    )
    return max(sets, key=len, default=[])


def _disk(source: LogSource, views: Sequence[SensorView]) -> Disk | None:
    """Return the free space and how long it lasts; None if it is unknown."""
    try:
        free = free_bytes(source.path)
    except OSError:
        return None
    bytes_per_s = 0.0
    if source.state == WRITTEN:
        bytes_per_s = _COPIES * sum(source.row_bytes.get(f"sensors/{view.name}", 0) * view.rate_hz for view in views)
    return Disk(free, bytes_per_s, max(0.0, (free - WATERMARK) / bytes_per_s) if bytes_per_s else None)


def _choose_fused(
    source: LogSource, windows: dict[str, LatestRows], calibration: Calibration, end_ns: int, result: Path | None
) -> tuple[FusedView | None, str]:
    """Return the fused output, or why there is none."""
    view = fused_beside(source.path, source.epoch, end_ns - source.read_rows.span_ns, result)
    if view is not None:
        return view, ""
    spoken = {name: (source.attributes[name], window.rows) for name, window in windows.items() if len(window.time)}
    if not spoken:
        return None, "no readings"
    try:
        return fused_now(MemoryLog(source.path, spoken), calibration), ""
    except ImuArrayError as error:
        return None, str(error).removeprefix(f"{source.path}: ")
