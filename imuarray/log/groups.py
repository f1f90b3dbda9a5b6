"""The groups of a log in HDF5, with the attributes by which xarray (engine h5netcdf) and NeXus viewers know them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import h5py
import numpy as np

from imuarray.log.format import ARRIVAL, FORMAT, FORMAT_VERSION, LONG_NAME, PLOTS, SensorHeader
from imuarray.log.layout import STIMULI, TRACK_COLUMNS, TRACK_UNITS, Group, sensor_group
from imuarray.log.preamble import Preamble
from imuarray.units import SI_NAME, SI_PER_UNIT

COMPRESSED: Mapping[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
"""How the columns of a finished log are stored: every chunk with its check sum."""

PLAIN: Mapping[str, Any] = {}
"""How the columns of a log are stored while it is written."""

LIBVER = "v110"
"""The format that a reader beside a writer needs (SWMR), and no later one: "latest" is another with every HDF5 that is
installed, and MATLAB's library, say, can't read that of HDF5 2.0.
"""

_TEXT = h5py.string_dtype("utf-8")
_PLOTTED: Mapping[str, Any] = {"NX_class": "NXdata", "axes": ["time", "."]}
"""NeXus: rows over time; what is beside each other has no axis of numbers."""


def log_attributes(preamble: Preamble) -> dict[str, Any]:
    """The attributes of the file itself."""
    attributes = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "epoch": preamble.epoch,
        "source": preamble.source,
        "config": preamble.config,
        "software": preamble.software,
        "Conventions": "CF-1.8",
        "NX_class": "NXroot",
    }
    return attributes | ({"frame_rate_hz": float(preamble.frame_rate_hz)} if preamble.frame_rate_hz else {})


def sensor_attributes(header: SensorHeader) -> dict[str, Any]:
    """The attributes of `/sensors/<NAME>`; ValueError for impossible axes."""
    attributes = {
        "chip": header.chip,
        "quantity": header.quantity,
        "range": header.range,
        "unit": header.unit,
        "sensitivity": header.sensitivity,
        "rate_hz": header.rate_hz,
        "bandwidth_hz": header.bandwidth_hz,
        "axes": header.axes,
        "orientation": np.array(header.orientation),
        "position_mm": np.array(header.position_mm),
        "columns": list(header.columns),
        "NX_class": "NXcollection",
        **header.extra,
    }
    return attributes | ({} if header.delay_ns is None else {"delay_ns": header.delay_ns})


def create_columns(file: h5py.File, group: Group, chunk: int, storage: Mapping[str, Any]) -> h5py.Group:
    """A group with its columns, empty and made to grow."""
    made = file.create_group(group.path)
    for name, kind, tail in group.columns:
        made.create_dataset(name, (0, *tail), kind, maxshape=(None, *tail), chunks=(chunk, *tail), **storage)
    return made


def create_sensor(
    file: h5py.File, header: SensorHeader, epoch: str, chunk: int, storage: Mapping[str, Any]
) -> h5py.Group:
    """Create `/sensors/<NAME>` with its attributes and empty columns; ValueError for impossible axes."""
    attributes = sensor_attributes(header)
    group = create_columns(file, sensor_group(header), chunk, storage)
    group.attrs.update(attributes)
    group.create_dataset("axis", data=list(header.columns), dtype=_TEXT)
    group["time"].attrs["units"] = f"nanoseconds since {epoch}"
    group["time"].attrs["long_name"] = "start of the burst on the wire"
    counts = group["counts"].attrs
    counts["long_name"] = LONG_NAME[header.quantity]
    if header.columns == ("x", "y", "z") and header.sensitivity:
        counts["units"] = SI_NAME[header.unit]
        counts["scale_factor"] = SI_PER_UNIT[header.unit] / header.sensitivity
        counts["add_offset"] = 0.0
    for name in header.compensated:
        group[name].attrs["units"] = {"temperature": "degC", "pressure": "Pa", ARRIVAL: "s"}.get(name, "1")
    return group


def create_track(file: h5py.File, name: str, epoch: str, chunk: int, storage: Mapping[str, Any]) -> h5py.Group:
    """Create a group of `TRACK_COLUMNS`, empty."""
    group = create_columns(file, Group(name, TRACK_COLUMNS[name]), chunk, storage)
    group["time"].attrs["units"] = f"nanoseconds since {epoch}"
    for column, _, _ in TRACK_COLUMNS[name][1:]:
        group[column].attrs["units"] = TRACK_UNITS[column]
    if name in STIMULI:
        group.attrs.update(_PLOTTED, signal="specific_force", auxiliary_signals=["angular_rate"])
        group.create_dataset("axis", data=["X", "Y", "Z"], dtype=_TEXT)
    return group


def attach_scales(group: h5py.Group) -> None:
    """Dimension scales on every column: without them xarray invents names and finds no time."""
    group["time"].make_scale("time")
    if "axis" in group:
        group["axis"].make_scale("axis")
    for name, dataset in group.items():
        if name in ("time", "axis"):
            continue
        dataset.dims[0].attach_scale(group["time"])
        if dataset.ndim == 2:
            dataset.dims[1].attach_scale(group["axis"])


def write_plots(file: h5py.File, names: Sequence[str]) -> None:
    """Write `/plots`: for each sensor its counts over time, as NeXus viewers (silx, h5web) look for them.

    A sensor's own group can't say so: there, `axes` are those of the box. The columns are soft links to those of the
    sensor, the only ones in a log; whoever reads it as a log does not follow them (`imuarray.log.inspection`).
    """
    plots = file.create_group(PLOTS)
    plots.attrs.update(NX_class="NXentry", default=min(names))
    file.attrs["default"] = PLOTS
    for name in names:
        plot = plots.create_group(name)
        plot.attrs.update(_PLOTTED, signal="counts")
        for column in ("time", "counts", "axis"):  # netCDF wants the names of both dimensions
            plot[column] = h5py.SoftLink(f"/sensors/{name}/{column}")


def write_table(
    file: h5py.File, name: str, fields: Sequence[str], rows: Sequence[Any], renamed: Mapping[str, str]
) -> None:
    """A group of equally long columns from named tuples; whole numbers are int64, the rest text."""
    group = file.create_group(name)
    for index, field in enumerate(fields):
        values = [row[index] for row in rows]
        column = renamed.get(field, field)
        if field.endswith("_ns"):
            group.create_dataset(column, data=np.array(values, np.int64))
        else:
            group.create_dataset(column, data=values, dtype=_TEXT)
