"""Writes a log as the project's file format 1 asks for it, with h5py alone."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from tests.foreign_world.chain import Signal, code_span
from tests.foreign_world.parts import Array, Sensor, stream, typical
from tests.foreign_world.world import Experiment, World, track_times

STALE, SATURATED = 1, 4
TRACK_NOISE = {"specific_force": 0.002, "angular_rate": 0.0002, "temperature": 0.02}
"""Of a reference instrument, SI and degC: an order better than the chips."""
CALIBRATION = {"AC1": 408, "AC2": -72, "AC3": -14383, "AC4": 32741, "AC5": 32757, "AC6": 23153}
CALIBRATION |= {"B1": 6190, "B2": 4, "MB": -32768, "MC": -8711, "MD": 2868}
"""BMP-20 to BMP-30."""

Whole = npt.NDArray[np.int64]


def write_log(path: Path, world: World, experiment: Experiment, signals: list[Signal]) -> None:
    """One log file; the same world gives the same data."""
    rng = stream(world.key, "file", experiment.name)
    epoch = (
        f"2024-{1 + rng.integers(12):02d}-{1 + rng.integers(28):02d}T{rng.integers(24):02d}:{rng.integers(60):02d}:00Z"
    )
    with h5py.File(path, "w") as file:
        file.attrs.update(
            format="imuarray-log",
            format_version=1,
            epoch=epoch,
            source=world.recorder.source,
            config=config_text(world),
            software="recorder 1.0",
        )
        for signal in signals:
            write_sensor(file, world, signal, epoch)
        if world.has_barometer:
            write_barometer(file, experiment, rng, epoch)
        text = h5py.string_dtype()
        for name, columns in {
            "events": ("time", "sensor", "kind", "message"),
            "phases": ("start", "end", "name", "up"),
        }.items():
            group = file.create_group(name)
            phases = experiment.stimulus.phases if name == "phases" and world.recorder.labels_phases else ()
            rows = [(round(p.start_s * 1e9), round(p.end_s * 1e9), p.name, p.up) for p in phases]
            for index, column in enumerate(columns):
                whole = column in ("time", "start", "end")
                group.create_dataset(column, data=[row[index] for row in rows], dtype="<i8" if whole else text)
        if world.recorder.track:
            write_track(file, world, experiment, rng, epoch)


def write_sensor(file: h5py.File, world: World, signal: Signal, epoch: str) -> None:
    """`/sensors/<NAME>`."""
    sensor, keep = signal.sensor, signal.keep
    group = file.create_group(f"sensors/{sensor.name}")
    facts = sensor.facts
    group.attrs.update(
        chip=sensor.chip,
        quantity=facts.quantity,
        range=float(sensor.range),
        unit=facts.unit,
        sensitivity=float(sensor.sensitivity),
        rate_hz=float(sensor.rate_hz),
        bandwidth_hz=float(sensor.bandwidth_hz),
        axes=sensor.axes,
        orientation=sensor.orientation,
        position_mm=np.array(sensor.position_mm),
    )
    codes = signal.codes[keep]
    group["time"] = np.rint(signal.stamp[keep] * 1e9).astype("<i8")
    group["time"].attrs["units"] = f"nanoseconds since {epoch}"
    group["counts"] = codes.astype("<i2")
    if len(signal.thermometer):
        group["temperature_counts"] = signal.thermometer[keep].astype("<i2")
    if world.recorder.has_status:
        low, high = code_span(sensor)
        saturated = ((codes <= low) | (codes >= high)).any(axis=1)
        group["status"] = (signal.stale[keep] * STALE + saturated * SATURATED).astype("<u2")


def write_track(file: h5py.File, world: World, experiment: Experiment, rng: np.random.Generator, epoch: str) -> None:
    """`/reference` with an instrument's own noise, or `/truth` without."""
    stimulus, times = experiment.stimulus, track_times(world, experiment.stimulus)
    group = file.create_group(world.recorder.track)
    group["time"] = np.rint(times * 1e9).astype("<i8")
    group["time"].attrs["units"] = f"nanoseconds since {epoch}"
    columns = {
        "specific_force": stimulus.force,
        "angular_rate": stimulus.rate,
        "temperature": stimulus.temperature[:, None],
    }
    for name, values in columns.items():
        at = np.stack([np.interp(times, stimulus.time_s, column) for column in values.T], axis=1)
        if world.recorder.track == "reference":
            at = at + rng.normal(0, TRACK_NOISE[name], at.shape)
        group[name] = at if name != "temperature" else at[:, 0]


def config_text(world: World) -> str:
    """The array's configuration, TOML."""
    lines = ["[array]", 'name = "array"', 'bus = "i2c:/dev/i2c-1"', 'mux = { chip = "pca9544a", address = 0x70 }']
    for sensor in world.sensors:
        lines += ["", "[[sensor]]", f'name = "{sensor.name}"', f'chip = "{sensor.chip}"', f"channel = {sensor.channel}"]
        lines += [f"address = 0x{sensor.address:02x}", f"range = {sensor.range:g}", *rate_lines(sensor)]
        x, y, z = sensor.position_mm
        lines += [f'axes = "{sensor.axes}"', f"position_mm = [{x}, {y}, {z}]"]
    if world.has_barometer:
        lines += ["", "[[sensor]]", 'name = "Baro"', 'chip = "bmp180"', "channel = 0", "address = 0x77"]
    return "\n".join(lines) + "\n"


def rate_lines(sensor: Sensor) -> list[str]:
    """Rate and bandwidth where the chip's registers can set them."""
    lines = [f"rate_hz = {sensor.rate_hz:g}"] if sensor.chip != "bma180" else []
    return lines + ([f"bandwidth_hz = {sensor.bandwidth_hz:g}"] if sensor.facts.bandwidths_hz else [])


def write_barometer(file: h5py.File, experiment: Experiment, rng: np.random.Generator, epoch: str) -> None:
    """A BMP180 that is read once a second."""
    seconds = np.arange(0.5, experiment.stimulus.duration_s)
    box = np.interp(seconds, experiment.stimulus.time_s, experiment.stimulus.temperature)
    guess = np.arange(20500, 40000)
    box = box + typical(rng, 1.0)  # BMP-74
    ut = guess[np.clip(np.searchsorted(degrees(guess), box), 0, len(guess) - 1)]
    air = rng.uniform(96000, 103000) + np.cumsum(rng.normal(0, 0.3, len(ut))) + rng.normal(0, 6, len(ut))
    ups = np.arange(20000, 60000)
    up = np.array(
        [
            ups[min(np.searchsorted(pascals(np.full(len(ups), t), ups), p), len(ups) - 1)]
            for t, p in zip(ut, air, strict=True)
        ]
    )
    group = file.create_group("sensors/Baro")
    group.attrs.update(CALIBRATION)
    group.attrs.update(chip="bmp180", quantity="pressure", range=0.0, unit="Pa", sensitivity=0.0, rate_hz=1.0)
    group.attrs.update(bandwidth_hz=0.0, axes="+X+Y+Z", orientation=np.eye(3), position_mm=np.zeros(3))
    group["time"] = np.rint(seconds * 1e9).astype("<i8")
    group["time"].attrs["units"] = f"nanoseconds since {epoch}"
    group["counts"] = np.stack([ut, up], axis=1).astype("<i4")
    group["counts"].attrs["columns"] = ["ut", "up"]
    group["temperature"] = degrees(ut).astype(float)
    group["pressure"] = pascals(ut, up).astype(float)
    group["status"] = np.zeros(len(ut), "<u2")


def b5(ut: Whole) -> Whole:
    """BMP-60."""
    c = CALIBRATION
    x1 = (ut - c["AC6"]) * c["AC5"] >> 15
    return x1 + c["MC"] * 2048 // (x1 + c["MD"])


def degrees(ut: Whole) -> Array:
    """Compensated temperature in degC."""
    return ((b5(np.asarray(ut, np.int64)) + 8) >> 4) / 10


def pascals(ut: Whole, up: Whole) -> Whole:
    """Compensated pressure in Pa, without oversampling (BMP-61 to BMP-63)."""
    c = CALIBRATION
    b6 = b5(np.asarray(ut, np.int64)) - 4000
    x3 = (c["B2"] * (b6 * b6 >> 12) >> 11) + (c["AC2"] * b6 >> 11)
    b3 = (c["AC1"] * 4 + x3 + 2) >> 2
    x3 = ((c["AC3"] * b6 >> 13) + (c["B1"] * (b6 * b6 >> 12) >> 16) + 2) >> 2
    b4 = c["AC4"] * (x3 + 32768) >> 15
    b7 = (np.asarray(up, np.int64) - b3) * 50000
    p = np.where(b7 < 0x80000000, 2 * b7 // b4, b7 // b4 * 2)
    x1 = ((p >> 8) ** 2) * 3038 >> 16
    result: Whole = p + ((x1 + (-7357 * p >> 16) + 3791) >> 4)
    return result
