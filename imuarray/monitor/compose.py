"""A snapshot from what was read: sensors in their units, frames, room on the disk, the fused output."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from imuarray.calibrate import Calibration
from imuarray.errors import ImuArrayError
from imuarray.log.disk_space import WATERMARK, free_bytes
from imuarray.log.missed_frames import frame_period_ns, missed_by_all
from imuarray.monitor.fused import fused_beside, fused_now
from imuarray.monitor.held import HeldLog
from imuarray.monitor.snapshot import WRITTEN, Disk, FusedView, SensorView, Snapshot
from imuarray.monitor.source import Source
from imuarray.monitor.views import view_of
from imuarray.monitor.window import Rows, Window
from imuarray.units import INERTIAL

_ALIKE = 0.05
"""Sensors are read in the same frames if their rates differ by no more than this share."""
_COPIES = 2
"""A row stands in the journal and in the HDF5 file."""


def snapshot_of(
    source: Source, calibration: Calibration, remark: str, quiet_s: float, result: Path | None = None
) -> Snapshot:
    """What is to be seen of `source` now; nothing came for `quiet_s`. `result`: where its fused output is written."""
    windows, told = source.seen.windows, source.seen.told
    begins_ns, ends_ns = _extent(windows.values())
    for window in windows.values():
        window.forget((ends_ns or 0) - source.seen.span_ns)
    held = HeldLog(
        source.path,
        {name: (source.attributes[name], window.rows or _no_rows(source, name)) for name, window in windows.items()},
    )
    period_ns = frame_period_ns(source.source, source.frame_rate_hz)
    extent = (begins_ns or 0, ends_ns or 0)
    views = tuple(
        view_of(held[name], window, source.backlog.gaps(name), extent, period_ns) for name, window in windows.items()
    )
    frames = _frames(views)
    fused, not_fused = _fused(source, windows, calibration, ends_ns or 0, result)
    return Snapshot(
        source.path,
        source.state,
        remark,
        source.source,
        source.epoch,
        told.phase if source.state == WRITTEN else "",
        begins_ns=begins_ns,
        ends_ns=ends_ns,
        quiet_s=max(0.0, quiet_s),
        rate_hz=float(np.median([view.rate_hz for view in frames])) if frames else 0.0,
        frame_rate_hz=source.frame_rate_hz,
        delayed=min((view.delayed for view in frames), default=0),
        missed=max(told.missed, _missed(frames, period_ns)),
        counted=source.backlog.counted,
        events=told.kinds,
        problems=told.problems,
        recent=told.recent,
        disk=_disk(source, views),
        sensors=views,
        fused=fused,
        not_fused=not_fused,
    )


def _extent(windows: Iterable[Window]) -> tuple[int | None, int | None]:
    """The times of the first and of the newest row of the log."""
    spoken = [window for window in windows if len(window.newest)]
    firsts = [window.first_ns for window in spoken if window.first_ns is not None]
    return min(firsts, default=None), max((int(window.newest[-1]) for window in spoken), default=None)


def _no_rows(source: Source, name: str) -> Rows:
    """The columns of a sensor from which nothing came."""
    columns = max(1, len(np.atleast_1d(source.attributes[name].get("columns", ("x", "y", "z")))))
    return {"time": np.empty(0, np.int64), "counts": np.empty((0, columns), np.int16)}


def _frames(views: Sequence[SensorView]) -> list[SensorView]:
    """The sensors that are read once a frame: of the inertial ones, the most that have one rate. A frame that was
    missed is missing from all of them, a reading that was lost from one.
    """
    inertial = [view for view in views if view.quantity in INERTIAL and view.rate_hz > 0]

    def alike(view: SensorView) -> list[SensorView]:
        return [other for other in inertial if abs(other.rate_hz - view.rate_hz) <= _ALIKE * view.rate_hz]

    return max((alike(view) for view in inertial), key=len, default=[])


def _missed(frames: Sequence[SensorView], period_ns: int) -> int:
    """Of all frames, by the grid that they lie on, else by what is missing from every sensor."""
    framed = [(view.first_ns, view.missed) for view in frames if view.framed and view.first_ns is not None]
    known = missed_by_all(framed, period_ns)
    return min((view.missed for view in frames), default=0) if known is None else known


def _disk(source: Source, views: Sequence[SensorView]) -> Disk | None:
    """Room, and how long it lasts; None where the disk does not say."""
    try:
        free = free_bytes(source.path)
    except OSError:
        return None
    rates = {f"sensors/{view.name}": view.rate_hz for view in views}
    written = source.state == WRITTEN
    taken = _COPIES * sum(source.row_bytes.get(path, 0) * rate for path, rate in rates.items()) if written else 0.0
    return Disk(free, taken, max(0.0, (free - WATERMARK) / taken) if taken else None)


def _fused(
    source: Source, windows: dict[str, Window], calibration: Calibration, end_ns: int, result: Path | None
) -> tuple[FusedView | None, str]:
    """The fused output, or why there is none."""
    beside = fused_beside(source.path, source.epoch, end_ns - source.seen.span_ns, result)
    if beside is not None:
        return beside, ""
    spoken = {name: (source.attributes[name], window.rows) for name, window in windows.items() if len(window.time)}
    if not spoken:
        return None, "no readings"
    try:
        return fused_now(HeldLog(source.path, spoken), calibration), ""
    except ImuArrayError as error:
        return None, str(error).removeprefix(f"{source.path}: ")
