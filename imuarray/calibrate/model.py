"""What is known of each sensor, and the file that keeps it.

Measurement model of a triad, counts of one reading::

    counts = response @ stimulus_box + bias + noise           accelerometer, gyroscope
    counts = ... + g_sensitivity @ (specific force in g)      gyroscope only

`stimulus_box` is the specific force in g or the angular rate in dps in the box frame; row k of `response` (counts per
unit) is what the sensor's axis k answers to each box axis, so that scale factor, misalignment and orientation are all
in it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
import tomli_w

from imuarray import __version__
from imuarray.errors import CalibrationError, OutputExistsError
from imuarray.log import SensorLog
from imuarray.units import SI_PER_UNIT

Floats = npt.NDArray[np.float64]

FORMAT_VERSION = 1

_UNITS = {"specific_force": "g", "angular_rate": "dps", "magnetic_field": "gauss"}
_HUGE = 1e6

_SHAPES = {
    "bias_lsb": (3,),
    "bias_sem_lsb": (3,),
    "response_lsb_per_unit": (3, 3),
    "response_sem_lsb_per_unit": (3,),
    "g_sensitivity_lsb_per_g": (3, 3),
    "noise_lsb": (3,),
}


@dataclass(frozen=True)
class SensorCalibration:
    """One sensor's parameters; what was not measured is None (or, for `response`, the data sheet's).

    Shapes: `bias_lsb`, `bias_sem_lsb`, `response_sem_lsb_per_unit` (one figure per sensor axis) and `noise_lsb`
    (standard deviation of single readings) (3,); `response_lsb_per_unit` and `g_sensitivity_lsb_per_g` (3, 3), rows
    sensor axes, columns box axes.
    """

    name: str
    quantity: str
    unit: str
    bias_lsb: Floats
    response_lsb_per_unit: Floats
    bias_sem_lsb: Floats | None = None
    response_sem_lsb_per_unit: Floats | None = None
    g_sensitivity_lsb_per_g: Floats | None = None
    noise_lsb: Floats | None = None
    temperature_degc: float | None = None
    range: float | None = None
    """The measuring range, in `unit`, at which this holds."""

    @property
    def scale_lsb_per_unit(self) -> Floats:
        """(3,) length of each row of the response: counts per unit along the axis that the sensor axis really has."""
        return np.asarray(np.linalg.norm(self.response_lsb_per_unit, axis=1), float)

    @property
    def directions_box(self) -> Floats:
        """(3, 3) unit vectors, one row per sensor axis: where it points in the box frame."""
        return np.asarray(self.response_lsb_per_unit / self.scale_lsb_per_unit[:, None])

    @property
    def lsb_per_si(self) -> Floats:
        """(3,) counts per m/s2 or rad/s along each sensor axis."""
        return np.asarray(self.scale_lsb_per_unit / SI_PER_UNIT[self.unit])

    def stimulus_box(self, counts: npt.ArrayLike) -> Floats:
        """Specific force (m/s2) or angular rate (rad/s) in the box frame (n, 3) from counts (n, 3)."""
        inverse = np.linalg.inv(self.response_lsb_per_unit) * SI_PER_UNIT[self.unit]
        return np.asarray((np.asarray(counts, float) - self.bias_lsb) @ inverse.T)

    def bias_in_units(self) -> Floats:
        """(3,) bias in the sensor's unit (g or dps), along its own axes."""
        return np.asarray(self.bias_lsb / self.scale_lsb_per_unit)

    def azimuth_elevation_deg(self) -> Floats:
        """(3, 2) azimuth (0 along box X, 90 along box Y) and elevation above the XY plane of each sensor axis, degrees.

        The angles of the paper's Appendix B, by atan2: its printed quotient is upside down and loses the quadrant.
        """
        x, y, z = self.directions_box.T
        return np.asarray(np.degrees(np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))], axis=1)))


@dataclass(frozen=True)
class Calibration:
    """The parameters of many sensors and where they came from."""

    sensors: Mapping[str, SensorCalibration] = field(default_factory=lambda: MappingProxyType({}))
    sources: tuple[str, ...] = ()

    def merged(self, other: Calibration) -> Calibration:
        """This calibration with everything that `other` measured in its place."""
        sensors = dict(self.sensors)
        for name, newer in other.sensors.items():
            older = sensors.get(name)
            sensors[name] = newer if older is None else _merge(older, newer)
        return Calibration(sensors, (*self.sources, *other.sources))

    def of(self, sensor: SensorLog) -> SensorCalibration:
        """What is known of `sensor`: the calibration if there is one, else the data sheet. CalibrationError if it
        does not fit.
        """
        known = self.sensors.get(sensor.name)
        if known is None:
            return nominal(sensor)
        if (known.quantity, known.unit) != (sensor.quantity, sensor.unit):
            raise CalibrationError(
                f"{sensor.where}: calibrated as {known.quantity} in {known.unit}, logged as {sensor.quantity}"
            )
        if known.range not in (None, sensor.range):
            raise CalibrationError(
                f"{sensor.where}: calibrated at a range of {known.range:g} {known.unit}, logged at {sensor.range:g}"
            )
        ratio = known.scale_lsb_per_unit / (sensor.sensitivity or np.nan)
        if (np.abs(np.log2(ratio)) > 1).any():  # no chip is off by a factor of two; another range is
            raise CalibrationError(
                f"{sensor.where}: calibrated at {known.scale_lsb_per_unit[0]:.4g} counts per {known.unit}, logged at"
                f" {sensor.sensitivity:.4g}: another range"
            )
        return known

    def to_toml(self) -> str:
        """The file's text."""
        return tomli_w.dumps(
            {
                "calibration": {
                    "format_version": FORMAT_VERSION,
                    "software": f"imuarray {__version__}",
                    "sources": list(self.sources),
                },
                "sensor": [_to_table(sensor) for sensor in self.sensors.values()],
            }
        )

    def save(self, path: str | PathLike[str], *, force: bool = False) -> None:
        """Write the file; OutputExistsError if it is there."""
        try:
            with Path(path).open("w" if force else "x", encoding="utf-8") as file:
                file.write(self.to_toml())
        except FileExistsError:
            raise OutputExistsError(path) from None


def nominal(sensor: SensorLog) -> SensorCalibration:
    """What the data sheet and the configured axes say of a triad; CalibrationError for a sensor without a
    sensitivity.
    """
    if not sensor.is_triad or sensor.sensitivity <= 0:
        raise CalibrationError(f"{sensor.where}: no triad with a sensitivity, nothing to calibrate")
    return SensorCalibration(
        name=sensor.name,
        quantity=sensor.quantity,
        unit=sensor.unit,
        bias_lsb=np.zeros(3),
        response_lsb_per_unit=sensor.sensitivity * sensor.orientation.T,
        range=sensor.range,
    )


def load_calibration(path: str | PathLike[str]) -> Calibration:
    """Read a calibration file; CalibrationError names the file, the sensor and the key."""
    try:
        table = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise CalibrationError(
            f"{path}: {getattr(error, 'strerror', None) or f'no calibration file: {error}'}"
        ) from None
    head = table.get("calibration")
    version = head.get("format_version") if isinstance(head, dict) else None
    if version != FORMAT_VERSION or not isinstance(head, dict):
        raise CalibrationError(f"{path}: calibration format_version is {version}; this software reads {FORMAT_VERSION}")
    sources, entries = head.get("sources", []), table.get("sensor", [])
    if not isinstance(entries, list) or not isinstance(sources, list) or not all(isinstance(s, str) for s in sources):
        raise CalibrationError(f"{path}: a list of [[sensor]] and a list of texts as calibration.sources are wanted")
    sensors: dict[str, SensorCalibration] = {}
    for index, entry in enumerate(entries, start=1):
        sensor = _from_table(entry, f"{path}, sensor {index}")
        if sensor.name in sensors:
            raise CalibrationError(f"{path}, sensor {index}: {sensor.name!r} stands in it twice")
        sensors[sensor.name] = sensor
    return Calibration(sensors, tuple(sources))


def _merge(older: SensorCalibration, newer: SensorCalibration) -> SensorCalibration:
    """`newer` where it measured something, else `older`. A bias without an uncertainty was not measured."""
    if (older.quantity, older.unit) != (newer.quantity, newer.unit):
        raise CalibrationError(
            f"sensor {newer.name}: calibrated as {older.quantity} before, as {newer.quantity} now: two of one name"
        )
    kept = {item.name: getattr(older, item.name) for item in fields(newer) if getattr(newer, item.name) is None}
    if newer.bias_sem_lsb is None:
        kept["bias_lsb"] = older.bias_lsb
    if newer.response_sem_lsb_per_unit is None:
        kept["response_lsb_per_unit"] = older.response_lsb_per_unit
    return replace(newer, **kept)


def _to_table(sensor: SensorCalibration) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for item in fields(sensor):
        value = getattr(sensor, item.name)
        if isinstance(value, np.ndarray):
            table[item.name] = np.vectorize(lambda number: float(f"{number:.9g}"))(value).tolist()
        elif value is not None:
            table[item.name] = value
    return table


def _from_table(entry: Any, where: str) -> SensorCalibration:
    known = {item.name for item in fields(SensorCalibration)}
    if not isinstance(entry, dict) or not {"name", "quantity", "unit", "bias_lsb", "response_lsb_per_unit"} <= set(
        entry
    ):
        raise CalibrationError(f"{where}: name, quantity, unit, bias_lsb and response_lsb_per_unit are wanted")
    if unknown := set(entry) - known:
        raise CalibrationError(f"{where}: unknown key {sorted(unknown)[0]!r}; allowed are {', '.join(sorted(known))}")
    if not isinstance(entry["name"], str) or not entry["name"]:
        raise CalibrationError(f"{where}: name {entry['name']!r}; a text is wanted")
    if (entry["quantity"], entry["unit"]) not in list(_UNITS.items()):
        allowed = ", ".join(f"{quantity} in {unit}" for quantity, unit in _UNITS.items())
        raise CalibrationError(f"{where}: {entry['quantity']!r} in {entry['unit']!r}; allowed are {allowed}")
    values: dict[str, Any] = {
        key: _array(value, key, where) if key in _SHAPES else value for key, value in entry.items()
    }
    for key in ("temperature_degc", "range"):
        number = values.get(key)
        if number is not None and not (isinstance(number, int | float) and abs(number) < _HUGE):
            raise CalibrationError(f"{where}: {key} is no number that a sensor could have")
    for key in ("noise_lsb", "bias_sem_lsb", "response_sem_lsb_per_unit"):
        if key in values and (values[key] < 0).any():
            raise CalibrationError(f"{where}: {key} is negative")
    sensor = SensorCalibration(**values)
    if not np.linalg.cond(sensor.response_lsb_per_unit) < 1e3:
        raise CalibrationError(f"{where}: response_lsb_per_unit can't be inverted")
    return sensor


def _array(value: Any, key: str, where: str) -> Floats:
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError, OverflowError):
        array = np.array([np.nan])
    if array.shape != _SHAPES[key] or not np.isfinite(array).all():
        raise CalibrationError(f"{where}: {key} wants {' x '.join(map(str, _SHAPES[key]))} finite numbers")
    return array
