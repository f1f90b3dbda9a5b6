"""One sensor's last seconds, in the units of its data sheet."""

from __future__ import annotations

from typing import Any

import numpy as np

from imuarray.calibrate.segments import degc_of, has_zero
from imuarray.characterise.spectrum import Spectrum, Welch, segment_rows
from imuarray.log import SensorLog
from imuarray.log.format import FLAGS
from imuarray.log.missed_frames import is_read_once_a_frame, missing_rows
from imuarray.monitor.snapshot import Floats, SensorView
from imuarray.monitor.window import Gaps, Window

_LAST_NS = 1_000_000_000
"""Of the log, whose mean is shown as what a sensor reads now; one that gave nothing in it is silent."""
_PATIENCE = 2.5
"""Periods of a slow sensor before it is silent."""
_LEAST_ROWS = 128
"""For a spectrum."""
_BREAK = 3.0
"""Periods: behind a longer step the rows are a run of their own."""
_PRESSURE = "pressure"


def view_of(
    sensor: SensorLog, window: Window, earlier: Gaps, extent: tuple[int, int], frame_period_ns: int = 0
) -> SensorView:
    """What is to be seen of a sensor: `sensor` holds the window's rows, `earlier` are gaps before them. `extent` are
    the times of the first and of the newest row of the log. Frames lie on a grid of `frame_period_ns` (0: on none that
    is known).
    """
    time = window.time
    values, unit, columns = _values(sensor, window)
    silent_ns = _silence(window, extent)
    last = slice(int(np.searchsorted(time, extent[1] - _reach_ns(window))), 0 if silent_ns else len(time))
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
        missed=_missed(window, earlier, silent_ns, frame_period_ns if framed else 0),
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


def _reach_ns(window: Window) -> float:
    """Before the newest row of the log, in which a sensor gives one at least."""
    return max(float(_LAST_NS), _PATIENCE * window.usual_ns)


def _silence(window: Window, extent: tuple[int, int]) -> int:
    """How long a sensor gave nothing, in ns up to the newest row of the log; 0 for one that is not silent."""
    begins_ns, ends_ns = extent
    since_ns = ends_ns - (int(window.newest[-1]) if len(window.newest) else begins_ns)
    return since_ns if since_ns > _reach_ns(window) else 0


def _missed(window: Window, earlier: Gaps, silent_ns: int, frame_period_ns: int) -> int:
    """Rows that are missing up to the newest one of the log, of a sensor that is read once a frame (0: it is not)."""
    if frame_period_ns:
        missing = missing_rows(window.first_ns or 0, window.newest, window.total, frame_period_ns)
    else:
        missing = (window.gaps + earlier).missed
    period_ns = frame_period_ns or window.usual_ns
    return missing + (round(silent_ns / period_ns) if period_ns else 0)


def _values(sensor: SensorLog, window: Window) -> tuple[Floats, str, tuple[str, ...]]:
    """The rows (n, k) in physical units, the unit, what the columns are called."""
    counts = np.asarray(window.rows.get("counts", np.empty((0, 3))), float)
    if sensor.is_triad and sensor.sensitivity > 0:
        return counts / sensor.sensitivity, sensor.unit, ("x", "y", "z")
    if _PRESSURE in window.rows:
        return np.asarray(window.rows[_PRESSURE], float)[:, None] / 100, "hPa", (_PRESSURE,)
    return counts, "counts", tuple(f"column {number + 1}" for number in range(counts.shape[1]))


def _use(sensor: SensorLog, window: Window) -> tuple[Floats | None, Floats | None]:
    """The share of the range that is used, in the window and at most so far."""
    full = sensor.range * sensor.sensitivity
    if not (sensor.is_triad and full > 0 and len(window.time)) or window.peak_lsb is None:
        return None, None
    return np.abs(np.asarray(window.rows["counts"], float)).max(axis=0) / full, window.peak_lsb / full


def _temperature(sensor: SensorLog, window: Window, last: slice) -> tuple[float | None, bool]:
    """The mean of the last rows in degC, and whether its zero is unknown; None without a thermometer."""
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


def _flags(window: Window) -> dict[str, int]:
    """Rows of the window that bear a flag, by its name."""
    status = np.asarray(window.rows.get("status", np.empty(0, np.uint16)))
    counts = {name: int(((status & flag) != 0).sum()) for name, flag in FLAGS.items()}
    return {name: count for name, count in counts.items() if count}


def _spectrum(window: Window, values: Floats) -> Spectrum | None:
    """The power spectral density of the window's rows in squared units per Hz; None for too few of them."""
    if len(values) < _LEAST_ROWS or window.period_ns <= 0 or not np.isfinite(values).all():
        return None
    welch = Welch(1e9 / window.period_ns, segment_rows(len(values)), values.shape[1])
    breaks = np.flatnonzero(np.diff(window.time) > _BREAK * window.period_ns) + 1
    for part in np.split(values, breaks):
        welch.update(part)
        welch.end_run()
    spectrum = welch.result()
    return spectrum if spectrum.segments else None
