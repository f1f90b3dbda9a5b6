"""Reading a calibration file: nothing of it is believed before it is checked."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from os import PathLike
from pathlib import Path

import numpy as np

from imuarray.calibrate.entries import (
    EntryPlace,
    Reader,
    covariance,
    named_tables,
    number,
    numbers,
    read_table,
    table,
    tables,
    text,
)
from imuarray.calibrate.model import FORMAT_VERSION, GROUPS, Calibration, SensorCalibration
from imuarray.calibrate.stability import (
    DRIFT,
    NOISE_LINE,
    PROVENANCE,
    THERMAL,
    TURN_ON,
    Drift,
    NoiseLine,
    Provenance,
    Thermal,
    TurnOn,
)
from imuarray.errors import CalibrationError
from imuarray.spelling import guess_file
from imuarray.toml_files import no_text
from imuarray.toml_lines import key_lines

_UNITS = {"specific_force": "g", "angular_rate": "dps", "magnetic_field": "gauss"}


def load_calibration(path: str | PathLike[str]) -> Calibration:
    """Read a calibration file; CalibrationError names the file, the line, the sensor and the key.

    >>> calibration = load_calibration("cal.toml")
    >>> calibration.sensors["Gyro1"].bias_lsb.shape
    (3,)
    """
    try:
        content = Path(path).read_text(encoding="utf-8")
        file = tomllib.loads(content)
    except (OSError, ValueError, RecursionError) as error:
        near = guess_file(path) if isinstance(error, FileNotFoundError) else ""
        other = no_text(path) if isinstance(error, UnicodeDecodeError) else f"no calibration file: {error}"
        raise CalibrationError(f"{path}: {getattr(error, 'strerror', None) or other}{near}") from None
    head = file.get("calibration")
    version = head.get("format_version") if isinstance(head, dict) else None
    if version != FORMAT_VERSION or not isinstance(head, dict):
        raise CalibrationError(f"{path}: calibration format_version is {version}; this software reads {FORMAT_VERSION}")
    sources, entries = head.get("sources", []), file.get("sensor", [])
    if not isinstance(entries, list) or not isinstance(sources, list) or not all(isinstance(s, str) for s in sources):
        raise CalibrationError(f"{path}: a list of [[sensor]] and a list of texts as calibration.sources are required")
    sensors: dict[str, SensorCalibration] = {}
    array = EntryPlace(str(path), key_lines(content), ("sensor",), "sensor")
    for index, entry in enumerate(entries, start=1):
        sensor = _from_table(entry, array.entry(index))
        if sensor.name in sensors:
            raise CalibrationError(f"{array.entry(index).key('name')}: {sensor.name!r} appears twice")
        sensors[sensor.name] = sensor
    return Calibration(sensors, tuple(sources))


def _from_table(entry: object, where: EntryPlace) -> SensorCalibration:
    sensor = read_table(entry, where, SensorCalibration, _SENSOR)
    if _UNITS.get(sensor.quantity) != sensor.unit:
        allowed = ", ".join(f"{quantity} in {unit}" for quantity, unit in _UNITS.items())
        raise CalibrationError(f"{where.key('unit')}: {sensor.quantity!r} in {sensor.unit!r}; allowed are {allowed}")
    if not np.linalg.cond(sensor.response_lsb_per_unit) < 1e3:
        raise CalibrationError(f"{where.key('response_lsb_per_unit')}: can't be inverted")
    return sensor


_SENSOR: Mapping[str, Reader] = {
    "name": text(),
    "quantity": text(),
    "unit": text(),
    "bias_lsb": numbers(3),
    "response_lsb_per_unit": numbers(3, 3),
    "bias_sem_lsb": numbers(3, lowest=0.0),
    "bias_covariance_lsb2": covariance(3),
    "response_covariance_lsb2_per_unit2": covariance(9),
    "response_sem_lsb_per_unit": numbers(3, lowest=0.0),
    "g_sensitivity_lsb_per_g": numbers(3, 3),
    "g_sensitivity_sem_lsb_per_g": numbers(3, 3, lowest=0.0),
    "noise_lsb": numbers(3, lowest=0.0),
    "noise_sem_lsb": numbers(3, lowest=0.0),
    "noise_correlation": numbers(3, lowest=-1.0, highest=1.0),
    "noise_lines": tables(NoiseLine, NOISE_LINE),
    "drift": table(Drift, DRIFT),
    "temperature_degc": number(),
    "range": number(),
    "chip": text(),
    "thermal": table(Thermal, THERMAL),
    "turn_on": table(TurnOn, TURN_ON),
    "provenance": named_tables(Provenance, PROVENANCE, tuple(GROUPS)),
}
