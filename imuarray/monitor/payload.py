"""A snapshot as JSON: with the numbers for a program, or with the curves for the page.

`imuarray monitor --json` prints one such object per line. These keys are stable, others may be added; null: unknown or
not applicable.

================  ======================================================================================================
`log`             name of the file; for a log that is split into parts, that of the newest part
`state`           "waiting" (for the log), "being written", "finished" or "interrupted"; `remark`: further information
`source` `epoch`  of the log; `phase`: the current phase, or ""
`begins_s`        time of the first row since `epoch`; `ends_s`: of the newest row; `quiet_s`: time without new rows
`rate_hz`         current frames per second; `frame_rate_hz`: requested ones, null if the log does not state them
`missed`          frames whose time had passed before the previous frame ended, as the logger counts them
`delayed`         frames that were read more than a quarter of a period later than usual. The logger's "late" is another
                  number: all frames that began after their time
`counted`         share of the log in which `delayed` has been counted, 1 in the end
`events`          number of events by kind; `problems`: number of those that report a fault
`recent`          the last 50, the newest first: `time_s`, `sensor` ("": the array), `kind`, `message`, `trouble`
`repeated`        the last 50 that differ in more than numbers: the newest of each, with `count` and `first_s`
`health`          `level`, "green", "amber" or "red", its `reason`, and `advice`; null before the first row
`disk`            `free_bytes`; `bytes_per_s` that the log takes; `left_s` until the log ends because the disk is full
`sensors`         in the order of the log: `name`, `chip`, `quantity`, `unit`, `columns`; `rows`, `rate_hz`;
                  `silent_s`: time without readings before the newest row of the log, null if that is within a second
                  or within the time for which the logger holds the readings of a slow sensor; `delayed`; `missed`,
                  including those since it is silent; `flags` of the last 10 s, by name; in `unit` and for each column
                  `mean` of the last second (null: it is silent) and `sd` of the last 10 s; `use_percent` of the range
                  in the last 10 s and `peak_use_percent` in the log so far, or null; `temperature_degc` or null,
                  `temperature_is_relative`: only its changes are meaningful; `density_unit` of the spectra on the page.
                  The last second and the last 10 s are those of the log
`fused`           null, and `not_fused` states why; or `technique`, `calibrated` and `quantities`: "specific_force" and
                  "angular_rate", each with `unit`, `mean` of the last second and `noise` from frame to frame
`took_ms`         duration of the refresh
================  ======================================================================================================
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from imuarray.arrays import Floats, Times
from imuarray.log.format import Event
from imuarray.log.health import is_trouble
from imuarray.monitor.snapshot import FusedView, SensorView, Snapshot
from imuarray.printable import printable
from imuarray.units import READABLE, READABLE_SI

DRAWN = 160
"""Number of pieces of a curve; the smallest and the largest value of each piece are drawn."""

_DIGITS = 5
_LOWEST_BIN = 1
"""The first bin that is drawn: the bin at 0 Hz has a residue of the mean."""


def described(snapshot: Snapshot) -> dict[str, Any]:
    """Return the numbers, without curves; None where a value is unknown."""
    return {
        "log": snapshot.path.name,
        "state": snapshot.state,
        "remark": printable(snapshot.remark),
        "source": snapshot.source,
        "epoch": snapshot.epoch,
        "phase": printable(snapshot.phase),
        "begins_s": _seconds(snapshot.begins_ns),
        "ends_s": _seconds(snapshot.ends_ns),
        "quiet_s": round(snapshot.quiet_s, 1),
        "rate_hz": round(snapshot.rate_hz, 2),
        "frame_rate_hz": round(snapshot.frame_rate_hz, 4) or None,
        "delayed": snapshot.delayed,
        "missed": snapshot.missed,
        "counted": round(snapshot.counted, 3),
        "events": {printable(kind): count for kind, count in (snapshot.events or {}).items()},
        "problems": snapshot.problems,
        "recent": [_describe_event(event) for event in snapshot.recent],
        "repeated": [
            _describe_event(group.event) | {"count": group.times, "first_s": _seconds(group.first_ns)}
            for group in snapshot.repeated
        ],
        "health": None
        if snapshot.health is None
        else {
            "level": snapshot.health.level,
            "reason": snapshot.health.reason,
            "advice": snapshot.health.advice,
        },
        "disk": _describe_disk(snapshot),
        "sensors": [_describe_sensor(view) for view in snapshot.sensors],
        "fused": None if snapshot.fused is None else _describe_fused(snapshot.fused),
        "not_fused": printable(snapshot.not_fused),
        "took_ms": round(snapshot.took_s * 1e3, 1),
    }


def drawn(snapshot: Snapshot) -> dict[str, Any]:
    """Return the numbers and the curves of the last seconds: times in s before the end, spectra as amplitude spectral
    densities.
    """
    figures = described(snapshot)
    end_ns = snapshot.ends_ns or 0
    for figure, view in zip(figures["sensors"], snapshot.sensors, strict=True):
        figure["trace"] = _curves(view.time - end_ns, view.values, view.columns)
        figure["density"] = _density(view)
    if snapshot.fused is not None:
        fused = snapshot.fused
        for quantity, figure in figures["fused"]["quantities"].items():
            factor = READABLE_SI[quantity][0]
            figure["trace"] = _curves(fused.time - end_ns, factor * fused.triads[quantity], ("x", "y", "z"))
    return figures


def _describe_event(event: Event) -> dict[str, Any]:
    return {
        "time_s": _seconds(event.time_ns),
        "sensor": printable(event.sensor),
        "kind": printable(event.kind),
        "message": printable(event.message),
        "trouble": is_trouble(event),
    }


def _seconds(time_ns: int | None) -> float | None:
    return None if time_ns is None else round(time_ns * 1e-9, 3)


def _describe_disk(snapshot: Snapshot) -> dict[str, Any] | None:
    disk = snapshot.disk
    if disk is None:
        return None
    left_s = None if disk.left_s is None else round(disk.left_s)
    return {"free_bytes": disk.free_bytes, "bytes_per_s": round(disk.bytes_per_s), "left_s": left_s}


def _describe_sensor(view: SensorView) -> dict[str, Any]:
    return {
        "name": printable(view.name),
        "chip": printable(view.chip),
        "quantity": view.quantity,
        "unit": view.unit,
        "columns": list(view.columns),
        "rows": view.rows,
        "rate_hz": _number(view.rate_hz),
        "silent_s": None if view.silent_s is None else round(view.silent_s, 1),
        "delayed": view.delayed,
        "missed": view.missed,
        "flags": dict(view.flags),
        "density_unit": READABLE.get(view.unit, (1.0, view.unit))[1],
        "mean": _numbers(view.mean),
        "sd": _numbers(view.sd),
        "use_percent": None if view.use is None else _numbers(100 * view.use),
        "peak_use_percent": None if view.peak_use is None else _numbers(100 * view.peak_use),
        "temperature_degc": None if view.temperature_degc is None else _number(view.temperature_degc),
        "temperature_is_relative": view.relative,
    }


def _describe_fused(fused: FusedView) -> dict[str, Any]:
    quantities = {}
    for quantity in fused.triads:
        factor, unit = READABLE_SI[quantity]
        quantities[quantity] = {
            "unit": unit,
            "mean": _numbers(factor * fused.mean[quantity]),
            "noise": _numbers(factor * fused.noise[quantity]),
        }
    return {"technique": printable(fused.technique), "calibrated": fused.calibrated, "quantities": quantities}


def _curves(since_end_ns: Times, values: Floats, columns: tuple[str, ...]) -> dict[str, list[float | None]]:
    """Return curves with at most two points per piece: its smallest and its largest value, in order of time."""
    time_s, rows = since_end_ns * 1e-9, values
    size = -(-len(time_s) // DRAWN)
    if size > 2:
        whole = len(time_s) // size * size  # without a few of the oldest rows
        pieces = values[-whole:].reshape(-1, size, values.shape[1])
        missing = np.isnan(pieces)  # frames without a value; a piece of these is a gap in the curve
        lowest = np.where(missing, np.inf, pieces).argmin(axis=1)
        highest = np.where(missing, -np.inf, pieces).argmax(axis=1)
        ends = np.sort(np.stack([lowest, highest], axis=1), axis=1)
        rows = np.take_along_axis(pieces, ends, axis=1).reshape(-1, values.shape[1])
        time_s = np.repeat(time_s[-whole::size], 2) + np.tile([0.0, 0.5], len(pieces)) * size * np.median(
            np.diff(time_s)
        )
    curves: dict[str, list[float | None]] = {"t": [round(float(at_s), 3) for at_s in time_s]}
    return curves | {name: _numbers(column) for name, column in zip(columns, rows.T, strict=True)}


def _density(view: SensorView) -> dict[str, list[float | None]] | None:
    if view.spectrum is None:
        return None
    bins = slice(_LOWEST_BIN, None)
    density = READABLE.get(view.unit, (1.0, view.unit))[0] * np.sqrt(view.spectrum.density[bins])
    curves = {"f": _numbers(view.spectrum.frequency_hz[bins])}
    return curves | {name: _numbers(column) for name, column in zip(view.columns, density.T, strict=True)}


def _numbers(values: Floats) -> list[float | None]:
    return [_number(value) for value in values.tolist()]


def _number(value: float) -> float | None:
    """Return a number with five digits; None if it is not finite."""
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
