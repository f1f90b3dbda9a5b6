"""Writes a log in file format 1 with h5py."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from tests.bench_world.chips import DELAY_NS, Sensor
from tests.bench_world.motion import GRID_HZ, Motion
from tests.bench_world.samples import Rows

REFERENCE_HZ = 100
REFERENCE_FORCE_NOISE, REFERENCE_RATE_NOISE = 0.003, 2e-4
"""Of the track of a rate table, m/s² and rad/s."""
MISSED = "frames missed: the computer was busy"


@dataclass(frozen=True)
class Recording:
    """What a log holds: its `epoch` (ISO 8601), configuration, frame rate, rows by sensor, motion, and the times in ns
    at which the recorder noticed that it had missed frames.
    """

    epoch: str
    config: str
    rate_hz: float
    rows: Mapping[Sensor, Rows]
    motion: Motion
    misses_ns: tuple[int, ...]


def write_log(path: Path, recording: Recording, stream: np.random.Generator) -> None:
    """Write a log; `stream` gives the noise of the reference."""
    with h5py.File(path, "w") as file:
        file.attrs.update(
            {
                "format": "imuarray-log",
                "format_version": 1,
                "epoch": recording.epoch,
                "source": "i2c",
                "config": recording.config,
                "software": "fieldlogger 2.3",
                "frame_rate_hz": recording.rate_hz,
            }
        )
        for sensor, rows in recording.rows.items():
            _write_sensor(file, sensor, rows, recording.epoch)
        _write_events(file, recording.misses_ns)
        _write_phases(file, recording.motion)
        if recording.motion.has_reference:
            _write_reference(file, recording.motion, stream)


def _write_sensor(file: h5py.File, sensor: Sensor, rows: Rows, epoch: str) -> None:
    group = file.create_group(f"sensors/{sensor.name}")
    group.attrs.update(
        {
            "chip": sensor.chip,
            "quantity": "angular_rate" if sensor.is_gyroscope else "specific_force",
            "range": float(sensor.range),
            "unit": "dps" if sensor.is_gyroscope else "g",
            "sensitivity": float(sensor.sensitivity),
            "rate_hz": sensor.update_rate_hz,
            "bandwidth_hz": float(sensor.bandwidth_hz or 0),
            "axes": sensor.axes,
            "orientation": sensor.orientation,
            "position_mm": np.array(sensor.position_mm, float),
        }
    )
    if sensor.chip in DELAY_NS:
        group.attrs["delay_ns"] = np.int64(DELAY_NS[sensor.chip])
    group["time"] = rows.time_ns
    group["time"].attrs["units"] = f"nanoseconds since {epoch}"
    group["counts"] = rows.counts
    group["status"] = rows.status
    if rows.temperature_counts is not None:
        group["temperature_counts"] = rows.temperature_counts


def _write_events(file: h5py.File, misses_ns: tuple[int, ...]) -> None:
    group = file.create_group("events")
    group["time"] = np.array(misses_ns, np.int64)
    for name, word in {"sensor": "", "kind": "missed", "message": MISSED}.items():
        _write_words(group, name, [word] * len(misses_ns))


def _write_phases(file: h5py.File, motion: Motion) -> None:
    group = file.create_group("phases")
    group["start"] = np.array([int(phase.start_s * 1e9) for phase in motion.phases], np.int64)
    group["end"] = np.array([int(phase.end_s * 1e9) for phase in motion.phases], np.int64)
    _write_words(group, "name", [phase.name for phase in motion.phases])
    _write_words(group, "up", [phase.up for phase in motion.phases])


def _write_reference(file: h5py.File, motion: Motion, stream: np.random.Generator) -> None:
    group = file.create_group("reference")
    rows = slice(None, None, round(GRID_HZ / REFERENCE_HZ))
    force, rate = motion.force_box[rows], motion.rate_box[rows]
    group["time"] = np.rint(motion.time_s[rows] * 1e9).astype(np.int64)
    group["specific_force"] = force + stream.normal(0, REFERENCE_FORCE_NOISE, force.shape)
    group["angular_rate"] = rate + stream.normal(0, REFERENCE_RATE_NOISE, rate.shape)
    group["temperature"] = motion.temperature_c[rows]


def _write_words(group: h5py.Group, name: str, words: list[str]) -> None:
    group.create_dataset(name, data=np.array(words, object), dtype=h5py.string_dtype(), shape=(len(words),))
