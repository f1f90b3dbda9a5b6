"""Kalibr's imu.yaml: noise figures of each IMU, from a log at rest or from what `characterise` wrote of one (JSON).

One accelerometer, one gyroscope, or one of each, are one IMU and one file. Of more sensors there is a file for each
beside it, run_BMA1.yaml, ...: an array has no figures of its own before it is fused.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from imuarray.atomic import write_text
from imuarray.calibrate import Calibration
from imuarray.calibrate.motion import longest_rest
from imuarray.characterise import characterise_log
from imuarray.characterise.kalibr import imu_files, imu_text
from imuarray.errors import ExportError, OutputExistsError
from imuarray.export.formats import ExportRequest, ExportSummary, Progress
from imuarray.log import Log, open_log
from imuarray.spelling import guess
from imuarray.units import INERTIAL

_LARGEST = 1 << 28
"""Bytes of a characterisation; one of an array takes a hundredth."""


def write(request: ExportRequest, path: Path, force: bool, progress: Progress) -> ExportSummary:
    """Write one file or several; ExportError where there is no noise to tell."""
    if request.units not in (None, "si"):
        raise ExportError(f"{path}: Kalibr's figures are in SI")
    result = _stored(request) if request.source.suffix == ".json" else _characterised(request, progress)
    files = _files(result, request, path)
    for file in files:
        if file.exists() and not force:
            raise OutputExistsError(file)
    for file, text in files.items():
        write_text(file, text, force=force)
    progress(1.0)
    return ExportSummary(tuple(files), {sensor["name"]: int(sensor["rows"]) for sensor in result["sensors"]}, "si")


def _files(result: Mapping[str, Any], request: ExportRequest, path: Path) -> dict[Path, str]:
    """Path to text."""
    try:
        text = imu_text(result)
        several = {} if text else imu_files(result)
    except (KeyError, TypeError, AttributeError, ValueError):
        raise ExportError(f"{request.source}: no result of `imuarray characterise`") from None
    if text:
        return {path: text}
    if not several:
        raise ExportError(f"{request.source}: no inertial sensor whose noise could be fitted")
    return {path.with_name(f"{path.stem}_{name.removeprefix('imu_')}"): text for name, text in several.items()}


def _stored(request: ExportRequest) -> Mapping[str, Any]:
    """What `characterise` wrote, of the requested sensors."""
    if request.calibration is not None:
        raise ExportError(f"{request.source}: was made with its calibration; give `characterise` another")
    try:
        if request.source.stat().st_size > _LARGEST:
            raise ValueError("too long")
        result = json.loads(request.source.read_text(encoding="utf-8"))
        names = [str(sensor["name"]) for sensor in result["sensors"]]
    except OSError as error:
        raise ExportError(f"{request.source}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ExportError(f"{request.source}: no result of `imuarray characterise`") from None
    if unknown := sorted(set(request.sensors) - set(names)):
        raise ExportError(
            f"{request.source}: no sensor {unknown[0]!r}; it has {', '.join(names)}{guess(unknown[0], names)}"
        )
    chosen = [one for one in result["sensors"] if not request.sensors or one["name"] in request.sensors]
    return {**result, "sensors": chosen}


def _characterised(request: ExportRequest, progress: Progress) -> Mapping[str, Any]:
    """The noise of the inertial sensors of a log at rest."""
    with open_log(request.source) as log:
        inertial = [sensor.name for quantity in INERTIAL for sensor in log.of(quantity)]
        names = [log[name].name for name in request.sensors] or inertial
        if not names:
            raise ExportError(f"{request.source}: no accelerometer and no gyroscope in it")
        done = iter(range(1, 3 * len(names) + 1))
        return characterise_log(
            log,
            sensors=names,
            progress=lambda: progress(next(done, 0) / (3 * len(names))),
            scales=_scales(log, names, request.calibration or Calibration()),
            stretch=longest_rest(log),
        )


def _scales(log: Log, names: list[str], calibration: Calibration) -> dict[str, list[float]]:
    """Counts per unit of the sensors that a calibration knows."""
    known = [name for name in names if name in calibration.sensors]
    return {name: calibration.of(log[name]).scale_lsb_per_unit.tolist() for name in known}
