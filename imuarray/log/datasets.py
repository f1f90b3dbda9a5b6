"""A log as labelled arrays (xarray) and tables (pandas), in SI units with absolute times; both packages are optional.

The physical values of an accelerometer, gyroscope or magnetometer are in the box frame under the name of their
quantity, computed with the data sheet's sensitivity or a calibration; the raw counts along the sensor's own axes are
included. A column that the log lacks is missing.

`log_figure` plots every sensor over time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from imuarray.arrays import Floats, Reals, Times
from imuarray.errors import CalibrationError, MissingExtraError
from imuarray.figures import time_series_figure
from imuarray.log.format import FLAGS, SYNC_PULSE, TIME_UNCERTAINTY, TRACK_UNITS
from imuarray.units import SI_NAME, SI_PER_UNIT
from imuarray.wall_time import wall_time

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from imuarray.calibrate import Calibration
    from imuarray.log.columns import Track
    from imuarray.log.reader import Log
    from imuarray.log.sensor_log import SensorLog

AXIS, BOX_AXIS = "axis", "box_axis"
"""Dimensions of a triad: x, y, z along the sensor's own axes; X, Y, Z along those of the box."""

_LABELS = {AXIS: ("x", "y", "z"), BOX_AXIS: ("X", "Y", "Z")}

_LONG_NAME: Mapping[str, str] = MappingProxyType(
    {
        "specific_force": "specific force in the box frame",
        "angular_rate": "angular rate in the box frame",
        "magnetic_field": "magnetic flux density in the box frame",
        "pressure": "air pressure",
        "temperature": "temperature",
    }
)

_Variable = tuple[tuple[str, ...], Any, dict[str, Any]]
"""Dimensions, values and attributes, in the form that xarray accepts."""


def sensor_dataset(sensor: SensorLog, epoch: str, calibration: Calibration | None = None) -> Any:
    """Return an `xarray.Dataset` of one sensor; MissingExtraError, CalibrationError."""
    variables = _sensor_variables(sensor, calibration)
    attributes: dict[str, Any] = {
        "name": sensor.name,
        "chip": sensor.chip,
        "quantity": sensor.quantity,
        "range": sensor.range,
        "range_unit": sensor.unit,
        "sensitivity_counts_per_range_unit": sensor.sensitivity,
        "rate_hz": sensor.rate_hz,
        "bandwidth_hz": sensor.bandwidth_hz,
        "axes": sensor.axes,
        "position_mm": sensor.position_mm.tolist(),
        "calibrated": int(calibration is not None and sensor.name in calibration.sensors),
        "epoch": epoch,
    }
    return dataset(np.asarray(sensor.time[:]), epoch, variables, attributes)


def track_dataset(track: Track, epoch: str) -> Any:
    """Return an `xarray.Dataset` of `/truth` or `/reference`; MissingExtraError."""
    variables: dict[str, _Variable] = {}
    for name, column in track._asdict().items():
        if name != "time" and column is not None:
            dims = ("time", BOX_AXIS)[: len(column.shape)]
            variables[name] = dims, np.asarray(column[:]), _attributes_of(name, TRACK_UNITS[name])
    return dataset(np.asarray(track.time[:]), epoch, variables, {"epoch": epoch})


def log_tree(log: Log, calibration: Calibration | None = None) -> Any:
    """Return an `xarray.DataTree` with a node for each sensor, `truth` and `reference`; MissingExtraError."""
    xarray = optional_package("xarray")
    nodes = {name: sensor_dataset(sensor, log.epoch, calibration) for name, sensor in log.sensors.items()}
    tracks = {"truth": log.truth, "reference": log.reference}
    nodes |= {name: track_dataset(track, log.epoch) for name, track in tracks.items() if track is not None}
    attributes = {"epoch": log.epoch, "source": log.source, "software": log.software, "log": log.path.name}
    return xarray.DataTree.from_dict({"/": xarray.Dataset(attrs=attributes), **nodes})


def dataset(time: Times, epoch: str, variables: Mapping[str, _Variable], attributes: Mapping[str, Any]) -> Any:
    """Return an `xarray.Dataset` over `time` (n,) in ns since `epoch`, as dates, or as durations if the epoch is not a
    date. The axes have the coordinates x, y, z and X, Y, Z. MissingExtraError.
    """
    xarray = optional_package("xarray")
    used = {name for dims, _, _ in variables.values() for name in dims}
    coordinates: dict[str, Any] = {"time": ("time", times_of(time, epoch))}
    coordinates |= {name: (name, list(labels)) for name, labels in _LABELS.items() if name in used}
    return xarray.Dataset(dict(variables), coordinates, dict(attributes))


def table(labelled: Any) -> Any:
    """Return a `pandas.DataFrame` of a Dataset: a column for each number of a row (`angular_rate_X`, `counts_x`,
    `status`), indexed by time, with the Dataset's attributes and the units by column in `attrs`. MissingExtraError.
    """
    pandas = optional_package("pandas")
    columns: dict[str, Any] = {}
    units: dict[str, str] = {}
    for name, variable in labelled.data_vars.items():
        if variable.ndim == 1:
            parts = {str(name): variable.values}
        else:
            labels = [str(label) for label in variable.coords[variable.dims[1]].values]
            parts = {f"{name}_{label}": variable.values[:, place] for place, label in enumerate(labels)}
        columns |= parts
        units |= dict.fromkeys(parts, str(variable.attrs.get("units", "1")))
    frame = pandas.DataFrame(columns, index=pandas.Index(labelled["time"].values, name="time"))
    frame.attrs = {**labelled.attrs, "units": units}
    return frame


def times_of(time: Times, epoch: str) -> Any:
    """Convert ns since an ISO 8601 epoch into (n,) datetime64[ns], UTC; timedelta64[ns] if the epoch is no date."""
    since, zero = np.asarray(time, np.int64).astype("timedelta64[ns]"), wall_time(epoch)
    return since if zero is None else np.datetime64(zero.replace(tzinfo=None), "ns") + since


def physical_values(sensor: SensorLog, calibration: Calibration | None = None) -> Floats | None:
    """Return (n, 3) SI values in the box frame of all rows of a triad; None if the log states no sensitivity. The bias
    of a calibration is subtracted without temperature compensation. CalibrationError if the calibration does not fit
    the sensor, or is no Calibration.
    """
    if calibration is not None and not hasattr(calibration, "or_nominal"):
        kind = type(calibration).__name__
        raise CalibrationError(f"{kind} given as a calibration; allowed is a Calibration, as load_calibration returns")
    counts = np.asarray(sensor.counts[:], float)
    if calibration is not None:
        return calibration.or_nominal(sensor).stimulus_box(counts)
    if not sensor.sensitivity:
        return None
    return np.asarray(counts * (SI_PER_UNIT[sensor.unit] / np.array(sensor.axis_sensitivity)) @ sensor.orientation.T)


def _sensor_variables(sensor: SensorLog, calibration: Calibration | None) -> dict[str, _Variable]:
    variables: dict[str, _Variable] = {}
    if sensor.is_triad:
        values = physical_values(sensor, calibration)
        if values is not None:
            variables[sensor.quantity] = (
                ("time", BOX_AXIS),
                values,
                _attributes_of(sensor.quantity, SI_NAME[sensor.unit]),
            )
        counts = {"units": "count", "long_name": "raw register values along the sensor's axes"}
        variables["counts"] = ("time", AXIS), np.asarray(sensor.counts[:]), counts
    for name, unit in (("pressure", "Pa"), ("temperature", "degC")):
        if sensor.has_compensated(name):
            variables[name] = ("time",), np.asarray(sensor.compensated(name)[:]), _attributes_of(name, unit)
    degrees = sensor.temperature_counts
    if degrees is not None:
        raw = np.asarray(degrees[:])
        if (scale := sensor.thermometer) is not None:
            values = scale.zero_degc + raw / scale.lsb_per_degc
            variables["temperature"] = ("time",), values, _attributes_of("temperature", "degC")
        variables["temperature_counts"] = ("time",), raw, {"units": "count", "long_name": "the chip's own thermometer"}
    if (uncertainty := sensor.time_uncertainty) is not None:
        attributes = {"units": "s", "long_name": "largest error of time"}
        variables[TIME_UNCERTAINTY] = ("time",), np.asarray(uncertainty[:]), attributes
    if (pulse := sensor.sync_pulse) is not None:
        attributes = {"units": "s", "long_name": "time since the synchronisation pulse before the row"}
        variables[SYNC_PULSE] = ("time",), np.asarray(pulse[:]), attributes
    flags = {"units": "1", "flag_masks": list(FLAGS.values()), "flag_meanings": " ".join(FLAGS)}
    variables["status"] = ("time",), np.asarray(sensor.status[:]), flags
    return variables


def _attributes_of(quantity: str, unit: str) -> dict[str, Any]:
    return {"units": unit, "long_name": _LONG_NAME[quantity]}


def optional_package(name: str) -> Any:
    """Import xarray or pandas; MissingExtraError names the extra."""
    from importlib import import_module

    try:
        return import_module(name)
    except ImportError:
        raise MissingExtraError(name, "analysis") from None


_SI = {"specific_force": "m/s²", "angular_rate": "rad/s", "magnetic_field": "T"}


def log_figure(sensors: Sequence[SensorLog], calibration: Calibration | None = None) -> Figure:
    """Draw a panel for each sensor that has rows: physical values in the box frame, or counts; MissingExtraError."""
    panels: dict[str, tuple[Reals, Reals]] = {}
    for sensor in sensors:
        if not len(sensor):
            continue
        time_s = np.asarray(sensor.time[:]) * 1e-9
        if sensor.has_compensated("pressure"):
            panels[f"{sensor.name} (Pa)"] = time_s, np.asarray(sensor.compensated("pressure")[:])
            continue
        values = physical_values(sensor, calibration) if sensor.is_triad else None
        unit = "counts" if values is None else _SI[sensor.quantity]
        panels[f"{sensor.name} ({unit})"] = time_s, np.asarray(sensor.counts[:], float) if values is None else values
    return time_series_figure(panels)
