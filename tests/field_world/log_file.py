"""Writes a log in file format 1 with h5py."""

from __future__ import annotations

import h5py
import numpy as np

from tests.field_world.chips import QUANTITY, UNIT

PACKED = {"compression": "gzip", "compression_opts": 3, "shuffle": True}
SERIES = ("counts", "status", "temperature_counts", "temperature", "pressure")
"""Datasets of a sensor that have its time as their scale."""


def configuration(array, bus, has_multiplexer, sensors):
    """Return the configuration of an array as TOML."""
    lines = ["[array]", f'name = "{array}"', f'bus = "{bus}"']
    if has_multiplexer:
        lines.append('mux = { chip = "pca9544a", address = 0x70 }')
    for s in sensors:
        lines += ["", "[[sensor]]", f'name = "{s.name}"', f'chip = "{s.chip}"']
        lines.append(f'bus = "{s.bus}"' if s.bus else f"channel = {s.channel}")
        lines.append(f"address = 0x{s.address:02x}")
        if s.kind != "baro":
            lines.append(f"range = {s.range:g}")
            if s.chip != "bma180":
                lines.append(f"rate_hz = {s.rate_setting:g}")
            if s.chip != "adxl345" and s.kind != "mag":
                lines.append(f"bandwidth_hz = {s.bandwidth:g}")
            lines.append(f'axes = "{s.axes}"')
        lines.append("position_mm = [{}]".format(", ".join(f"{float(x):.1f}" for x in s.position_mm)))
    return "\n".join(lines) + "\n"


def write_log(path, header, sensors, rows, events, phases, clocks=None, reference=None):
    """Write a log: `header` has its attributes and what the file has; `rows` are those of each sensor by its name."""
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "imuarray-log"
        file.attrs["format_version"] = 1
        for name in ("epoch", "source", "config", "software"):
            file.attrs[name] = header[name]
        if header["frame_rate_hz"]:
            file.attrs["frame_rate_hz"] = float(header["frame_rate_hz"])
        for s in sensors:
            _write_sensor(file, s, rows[s.name], header)
        group = file.create_group("events")
        group["time"] = np.array([event[0] for event in events], np.int64)
        for i, name in enumerate(("sensor", "kind", "message"), 1):
            _write_words(group, name, [event[i] for event in events])
        group = file.create_group("phases")
        group["start"] = np.array([phase[0] for phase in phases], np.int64)
        group["end"] = np.array([phase[1] for phase in phases], np.int64)
        for i, name in ((2, "name"), (3, "up")):
            _write_words(group, name, [phase[i] for phase in phases])
        if clocks is not None:
            group = file.create_group("clocks")
            for name, values in clocks.items():
                group[name] = values.astype(np.int64)
        if reference is not None:
            group = file.create_group("reference")
            for name, values in reference.items():
                group.create_dataset(name, data=values, **PACKED)
            group["time"].attrs["units"] = f"nanoseconds since {header['epoch']}"


def _write_sensor(file, s, rows, header):
    group = file.create_group(f"sensors/{s.name}")
    group.attrs.update(
        {
            "chip": s.chip,
            "quantity": QUANTITY[s.kind],
            "range": float(s.range),
            "unit": UNIT[s.kind],
            "sensitivity": float(s.sensitivity),
            "rate_hz": float(rows.get("rate", s.rate)),
            "bandwidth_hz": float(s.bandwidth),
            "axes": s.axes,
        }
    )
    group.attrs["orientation"] = s.matrix
    group.attrs["position_mm"] = np.array(s.position_mm, float)
    if "delay_ns" in s.more:
        group.attrs["delay_ns"] = np.int64(s.more["delay_ns"])
    time = group.create_dataset("time", data=rows["time"].astype(np.int64), **PACKED)
    time.attrs["units"] = f"nanoseconds since {header['epoch']}"
    if s.kind == "baro":
        counts = group.create_dataset("counts", data=rows["counts"].astype(np.int32), **PACKED)
        counts.attrs["columns"] = np.array(["ut", "up"], dtype=object)
        for name, unit in (("temperature", "degC"), ("pressure", "Pa")):
            group.create_dataset(name, data=rows[name].astype(float), **PACKED).attrs["units"] = unit
        for name, word in rows["words"].items():
            group.attrs[name] = int(word)
    else:
        counts = group.create_dataset("counts", data=rows["counts"].astype(np.int16), **PACKED)
        if header["has_scales"]:
            counts.attrs["units"] = UNIT[s.kind]
            counts.attrs["scale_factor"] = 1.0 / s.sensitivity
            counts.attrs["add_offset"] = 0.0
            counts.attrs["long_name"] = QUANTITY[s.kind].replace("_", " ")
            counts.attrs["columns"] = np.array(["x", "y", "z"], dtype=object)
        if rows.get("temperature_counts") is not None:
            group.create_dataset("temperature_counts", data=rows["temperature_counts"].astype(np.int16), **PACKED)
    group.create_dataset("status", data=rows["status"].astype(np.uint16), **PACKED)
    if header["has_dimensions"]:
        time.make_scale("time")
        for series in (group[name] for name in SERIES if name in group):
            series.dims[0].attach_scale(time)


def _write_words(group, name, words):
    group.create_dataset(name, data=np.array(words, dtype=object), dtype=h5py.string_dtype("utf-8"))
