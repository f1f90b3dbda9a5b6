"""Noise figures for Kalibr, OpenVINS, VINS-Fusion (.yaml), Gazebo and PX4 (.sdf): `imuarray.characterise.imu_noise`.

Figures come from a log at rest, from a fused result at rest, or from the JSON file that `characterise` wrote. One
accelerometer, one gyroscope, one of each, or a fused result are one IMU and one file. For more sensors there is a file
for each, run_BMA1.yaml, ..., because an array has no noise figures of the whole before it is fused.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from imuarray.arrays import Booleans, Floats, Times
from imuarray.atomic import write_text
from imuarray.calibrate import Calibration
from imuarray.calibrate.motion import STILL, longest_rest
from imuarray.characterise import allan_deviation, characterise_log, fit_noise
from imuarray.characterise.imu_noise import TEXTS, ImuNoise, TriadNoise, imus_of, triad_noise
from imuarray.characterise.survey import EXACT_ROWS
from imuarray.errors import ExportError, OutputExistsError
from imuarray.export.formats import TOOLS, ExportRequest, ExportSummary, Progress
from imuarray.fuse.fused_file import fused_columns, is_fused
from imuarray.log import open_log
from imuarray.printable import percent
from imuarray.series import true_runs
from imuarray.spelling import guess
from imuarray.units import INERTIAL, SI_PER_UNIT, UNITS_OF, Quantity

_LARGEST = 1 << 28
"""Largest size of a characterisation's file in bytes; that of an array has a hundredth of this."""

_FUSED_TOPIC = "/fused"
_REGULAR = 0.5
"""Largest difference of an interval within a run from the usual interval, as a share of it."""


def write(request: ExportRequest, path: Path, force: bool, progress: Progress) -> ExportSummary:
    """Write one file or several; ExportError if no noise could be determined."""
    tool = request.tool or TOOLS[path.suffix.lower()][0]
    if request.units not in (None, "si"):
        raise ExportError(f"{path}: noise figures are in SI; leave units out")
    imus, rows = _imus(request, progress)
    if not imus:
        raise ExportError(f"{request.source}: no inertial sensor whose noise could be fitted")
    files = {path: imus[0]} if len(imus) == 1 else {path.with_stem(f"{path.stem}_{imu.name}"): imu for imu in imus}
    for file in files:
        if file.exists() and not force:
            raise OutputExistsError(file)
    for file, imu in files.items():
        write_text(file, TEXTS[tool](imu), force=force)
    progress(1.0)
    notes = tuple(f"{file}: without {', '.join(imu.lacks())}" for file, imu in files.items() if imu.lacks())
    return ExportSummary(tuple(files), rows, "si", notes=notes)


def _imus(request: ExportRequest, progress: Progress) -> tuple[list[ImuNoise], dict[str, int]]:
    """Return the IMUs of a source, and the number of rows of each sensor."""
    if request.source.is_file() and is_fused(request.source):
        return _read_fused(request, progress)
    result = _read_result(request) if request.source.suffix == ".json" else _characterise(request, progress)
    try:
        return imus_of(result), {sensor["name"]: int(sensor["rows"]) for sensor in result["sensors"]}
    except (KeyError, TypeError, AttributeError, ValueError):
        raise ExportError(f"{request.source}: not a result of `imuarray characterise`") from None


def _read_result(request: ExportRequest) -> Mapping[str, Any]:
    """Return the result that `characterise` wrote, reduced to the requested sensors."""
    if request.calibration is not None:
        raise ExportError(
            f"{request.source}: was made with its own calibration; give --calibration to `characterise` instead"
        )
    try:
        if request.source.stat().st_size > _LARGEST:
            raise ValueError("too long")
        result = json.loads(request.source.read_text(encoding="utf-8"))
        names = [str(sensor["name"]) for sensor in result["sensors"]]
    except OSError as error:
        raise ExportError(f"{request.source}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ExportError(f"{request.source}: not a result of `imuarray characterise`") from None
    if unknown := sorted(set(request.sensors) - set(names)):
        raise ExportError(
            f"{request.source}: no sensor {unknown[0]!r}; it has {', '.join(names)}{guess(unknown[0], names)}"
        )
    sensors = [sensor for sensor in result["sensors"] if not request.sensors or sensor["name"] in request.sensors]
    return {**result, "sensors": sensors}


def _characterise(request: ExportRequest, progress: Progress) -> Mapping[str, Any]:
    with open_log(request.source) as log:
        inertial = [sensor.name for quantity in INERTIAL for sensor in log.of(quantity)]
        names = [log[name].name for name in request.sensors] or inertial
        if not names:
            raise ExportError(f"{request.source}: it has no accelerometer and no gyroscope")
        steps = iter(range(1, 3 * len(names) + 1))
        return characterise_log(
            log,
            longest_rest(log),
            names,
            progress=lambda: progress(next(steps, 0) / (3 * len(names))),
            scales=(request.calibration or Calibration()).scales(log[name] for name in names),
        )


def _read_fused(request: ExportRequest, progress: Progress) -> tuple[list[ImuNoise], dict[str, int]]:
    """Return the noise of a fused result at rest as one IMU; ExportError if it moves or is too short."""
    path = request.source
    if request.sensors or request.calibration is not None:
        raise ExportError(f"{path}: a fused result; it has no sensors to choose or convert")
    triads: dict[str, TriadNoise] = {}
    with fused_columns(path) as (attributes, columns):
        time = np.asarray(columns["time"][:], np.int64)
        values = {quantity: np.asarray(columns[quantity][:], float) for quantity in INERTIAL if quantity in columns}
    moving = _is_moving(time, values)
    rates, seconds, rows = [0.0], 0.0, 0
    for number, (quantity, triad) in enumerate(values.items(), start=1):
        run = _longest_run(time, np.isfinite(triad).all(axis=1) & ~moving)
        interval_s = _interval_s(time[run])
        if (noise := _fit(triad[run], interval_s)) is not None:
            triads[quantity] = noise
            count = run.stop - run.start
            rates.append(1 / interval_s)
            seconds, rows = max(seconds, count * interval_s), max(rows, count)
        progress(number / 3)
    if not triads and moving.any():
        raise ExportError(f"{path}: moves in {percent(float(moving.mean()))} of its frames; noise is measured at rest")
    if not triads:
        return [], {}
    imu = ImuNoise("fused", _FUSED_TOPIC, max(rates), seconds, attributes.get("software", "imuarray"), triads)
    return [imu], {"fused": rows}


def _is_moving(time: Times, values: Mapping[Quantity, Floats]) -> Booleans:
    """Return which frames (n,) are in a second of motion: the readings scatter more than those of a box at rest, or
    their mean differs from that of the second before or after.
    """
    second = (time - time[:1]) // 1_000_000_000
    moving = np.zeros(int(second[-1]) + 1 if len(second) else 0, bool)
    for quantity, triad in values.items():
        is_finite = np.isfinite(triad).all(axis=1)
        count = np.maximum(np.bincount(second[is_finite], minlength=len(moving)), 1)
        limit = STILL[quantity] * SI_PER_UNIT[next(iter(UNITS_OF[quantity]))]
        for axis in triad[is_finite].T:
            mean = np.bincount(second[is_finite], axis, len(moving)) / count
            deviation = np.sqrt(
                np.bincount(second[is_finite], (axis - mean[second[is_finite]]) ** 2, len(moving)) / count
            )
            steps = np.abs(np.diff(mean)) > limit
            moving |= deviation > limit
            moving[1:] |= steps
            moving[:-1] |= steps
    return np.asarray(moving[second], bool)


def _longest_run(time: Times, is_finite: Booleans) -> slice:
    """Return the longest stretch of frames at regular intervals without missing values."""
    steps = np.diff(time)
    usual = float(np.median(steps)) if len(steps) else 0.0
    is_joined = is_finite[1:] & is_finite[:-1] & (np.abs(steps - usual) <= _REGULAR * usual)
    starts, ends = true_runs(is_joined)
    if not len(starts):
        return slice(0, 0)
    longest = int(np.argmax(ends - starts))
    return slice(int(starts[longest]), int(ends[longest]) + 1)


def _interval_s(time: Times) -> float:
    return (int(time[-1]) - int(time[0])) * 1e-9 / (len(time) - 1) if len(time) > 1 else float("nan")


def _fit(values: Floats, interval_s: float) -> TriadNoise | None:
    """Return the noise of (n, 3) values in SI; None for fewer than 9 rows."""
    if len(values) < 9:
        return None
    curve = allan_deviation(values, interval_s, estimator="overlapping" if len(values) <= EXACT_ROWS else "decimated")
    fits = [fit for column in range(3) if (fit := fit_noise(curve, column)) is not None]
    axes = [{"terms": {item.term: asdict(item) for item in fit.coefficients}, "verdict": fit.verdict} for fit in fits]
    return triad_noise(axes, 1.0)
