"""Fusing a log: one specific force and one angular rate per frame, in the box frame, block by block."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from imuarray.calibrate import Calibration
from imuarray.errors import FusionError
from imuarray.fuse.axes import axes_of
from imuarray.fuse.frames import FusedBlock
from imuarray.fuse.pipeline import EachAlone, Making
from imuarray.fuse.stream import FusionStream
from imuarray.fuse.thermal import element_temperatures
from imuarray.log import Block, Log, SensorLog
from imuarray.units import INERTIAL

BLOCK = 1 << 12
"""Rows of each sensor that are read at once; the result does not depend on it."""


def fuse(
    log: Log,
    calibration: Calibration,
    technique: str | Making,
    *,
    only: Collection[str] = (),
    block: int = BLOCK,
) -> Iterator[FusedBlock]:
    """Fuse the inertial sensors of `log` (`only` these, if any are named) by `technique`, a name or what makes a
    pipeline for their axes; FusionError if they can't feed it. Biases follow the temperature that the log tells, where
    the calibration says how.
    """
    chosen: dict[str, list[SensorLog]] = {
        quantity: [s for s in log.of(quantity) if not only or s.name in only] for quantity in INERTIAL
    }
    groups: dict[str, list[SensorLog]] = {quantity: sensors for quantity, sensors in chosen.items() if sensors}
    if not groups:
        raise FusionError(f"{log.path}: no inertial sensor {f'among {sorted(only)}' if only else 'in it'}")
    axes = {quantity: axes_of(sensors, calibration) for quantity, sensors in groups.items()}
    pipeline = EachAlone(axes, technique) if isinstance(technique, str) else technique(axes)
    inertial = [sensor for sensors in groups.values() for sensor in sensors]
    warmth = element_temperatures(log, inertial, calibration)
    stream = FusionStream(groups, calibration, pipeline, warmth=warmth, timeout_s=float("inf"))
    yield from _replayed(inertial, stream, block)


def _replayed(sensors: Sequence[SensorLog], stream: FusionStream, block: int) -> Iterator[FusedBlock]:
    """The rows of all sensors in the order of their times, more or less: none is read far ahead of the others."""
    reached_ns = {sensor.name: -1 for sensor in sensors}
    row = {sensor.name: 0 for sensor in sensors}
    left = {sensor.name: sensor for sensor in sensors}
    while left:
        sensor = left[min(left, key=lambda name: reached_ns[name])]
        start = row[sensor.name]
        rows = slice(start, start + block)
        part = Block(np.asarray(sensor.time[rows]), np.asarray(sensor.counts[rows]), np.asarray(sensor.status[rows]))
        if len(part.time):
            reached_ns[sensor.name] = int(part.time[-1])
            row[sensor.name] += len(part.time)
            yield from stream.push(sensor.name, part)
        else:
            del left[sensor.name]
            yield from stream.end(sensor.name) if left else stream.finish()
