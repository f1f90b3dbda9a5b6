"""Fusing a log, or what becomes one: one specific force and one angular rate per frame, in the box frame."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from typing import TypeVar

import numpy as np

from imuarray.calibrate import Calibration
from imuarray.errors import FusionError
from imuarray.fuse.axes import axes_of
from imuarray.fuse.frames import FusedBlock
from imuarray.fuse.pipeline import EachAlone, Making, Pipeline
from imuarray.fuse.running import Warming, running_temperatures
from imuarray.fuse.stream import TIMEOUT_S, FusionStream
from imuarray.fuse.thermal import element_temperatures
from imuarray.log import Block, Log, SensorLog
from imuarray.log.format import SensorHeader
from imuarray.units import INERTIAL

BLOCK = 1 << 12
"""Rows of each sensor that are read at once; the result does not depend on it."""

_Sensor = TypeVar("_Sensor", SensorLog, SensorHeader)


def fuse(
    log: Log,
    calibration: Calibration,
    technique: str | Making,
    *,
    only: Collection[str] = (),
    causal: bool = False,
    block: int = BLOCK,
) -> Iterator[FusedBlock]:
    """Fuse the inertial sensors of `log` (`only` these, if any are named) by `technique`, a name or what makes a
    pipeline for their axes; FusionError if they can't feed it.

    Biases follow the temperature that the log tells, where the calibration says how; `causal`: as far as it was known
    when each frame was read, as `live` does.
    """
    everything = list(log.sensors.values())
    groups = _chosen(everything, only, str(log.path))
    inertial = [sensor for sensors in groups.values() for sensor in sensors]
    if causal:
        warming = running_temperatures(everything, inertial, calibration)
    else:
        warming = Warming(element_temperatures(log, inertial, calibration), {})
    stream = FusionStream(
        groups, calibration, _pipeline(groups, calibration, technique), warming, timeout_s=float("inf")
    )
    yield from _replayed([sensor for sensor in everything if sensor.name in stream.sensors], stream, block)


def live(
    sensors: Sequence[SensorHeader],
    calibration: Calibration,
    technique: str | Making,
    *,
    only: Collection[str] = (),
    timeout_s: float = TIMEOUT_S,
    tell: Callable[[str], None] = lambda text: None,
) -> FusionStream:
    """What fuses rows of `sensors` as they come, to the same as `fuse` does with `causal`. `tell` hears which sensor is
    not waited for any more after `timeout_s`, and which is back. FusionError if the sensors can't feed the technique.
    """
    sensors = sorted(sensors, key=lambda sensor: sensor.name)  # as a log has them
    groups = _chosen(sensors, only, "the array")
    inertial = [sensor for group in groups.values() for sensor in group]
    warming = running_temperatures(sensors, inertial, calibration)
    pipeline = _pipeline(groups, calibration, technique)
    return FusionStream(groups, calibration, pipeline, warming, timeout_s=timeout_s, tell=tell)


def _chosen(sensors: Sequence[_Sensor], only: Collection[str], where: str) -> dict[str, list[_Sensor]]:
    """The inertial sensors that are to be fused, by quantity; FusionError if there are none."""
    chosen: dict[str, list[_Sensor]] = {
        quantity: [s for s in sensors if s.quantity == quantity and (not only or s.name in only)]
        for quantity in INERTIAL
    }
    if not any(chosen.values()):
        raise FusionError(f"{where}: no inertial sensor {f'among {sorted(only)}' if only else 'in it'}")
    return {quantity: group for quantity, group in chosen.items() if group}


def _pipeline(groups: dict[str, list[_Sensor]], calibration: Calibration, technique: str | Making) -> Pipeline:
    """The technique, for the axes of the sensors."""
    axes = {quantity: axes_of(sensors, calibration) for quantity, sensors in groups.items()}
    return EachAlone(axes, technique) if isinstance(technique, str) else technique(axes)


def _replayed(sensors: Sequence[SensorLog], stream: FusionStream, block: int) -> Iterator[FusedBlock]:
    """The rows of all sensors in the order of their times, more or less: none is read far ahead of the others."""
    reached_ns = {sensor.name: -1 for sensor in sensors}
    row = {sensor.name: 0 for sensor in sensors}
    left = {sensor.name: sensor for sensor in sensors}
    while left:
        sensor = left[min(left, key=lambda name: reached_ns[name])]
        part = _read(sensor, slice(row[sensor.name], row[sensor.name] + block), sensor.name in stream.thermometers)
        if len(part.time):
            reached_ns[sensor.name] = int(part.time[-1])
            row[sensor.name] += len(part.time)
            yield from stream.push(sensor.name, part)
        else:
            del left[sensor.name]
            yield from stream.end(sensor.name)
    yield from stream.finish()


def _read(sensor: SensorLog, rows: slice, warm: bool) -> Block:
    """Some rows of a log; what its thermometers say only if it is wanted (`warm`)."""
    time, counts = np.asarray(sensor.time[rows]), np.asarray(sensor.counts[rows])
    status, degrees = np.asarray(sensor.status[rows]), sensor.temperature_counts
    if not warm:
        return Block(time, counts, status)
    if sensor.quantity == "pressure":
        return Block(time, counts, status, None, {"temperature": np.asarray(sensor.compensated("temperature")[rows])})
    return Block(time, counts, status, None if degrees is None else np.asarray(degrees[rows]))
