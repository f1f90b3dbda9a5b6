"""What a log says of a sensor: of one that is set as an array's configuration says, and of one that was recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

from imuarray.log.format import SensorHeader
from imuarray.log.sensor_log import SensorLog
from imuarray.units import Quantity

if TYPE_CHECKING:
    from imuarray.array import SensorConfig


def header_of(sensor: SensorConfig, extra: Mapping[str, int | float | str]) -> SensorHeader:
    """The header of a configured sensor; `extra` holds what only its chip knows (a barometer's calibration words)."""
    spec = sensor.spec
    barometer = spec.quantity == "pressure"
    x, y, z = sensor.position_mm
    return SensorHeader(
        name=sensor.name,
        chip=sensor.chip,
        quantity=spec.quantity,
        unit=spec.unit,
        range=sensor.range or 0.0,
        sensitivity=sensor.sensitivity,
        rate_hz=sensor.chip_rate_hz,
        bandwidth_hz=sensor.chip_bandwidth_hz,
        axes=sensor.axes,
        position_mm=(x, y, z),
        columns=("ut", "up") if barometer else ("x", "y", "z"),
        has_temperature=spec.has_thermometer and not sensor.fifo,
        compensated=("temperature", "pressure") if barometer else (),
        extra=extra,
    )


def recorded_header(sensor: SensorLog) -> SensorHeader:
    """The header with which a log like the one that `sensor` is from would be written."""
    x, y, z = sensor.position_mm.tolist()
    columns = {"pressure": ("ut", "up"), "temperature": ("t",)}.get(sensor.quantity, ("x", "y", "z"))
    compensated = {"pressure": ("temperature", "pressure"), "temperature": ("temperature",)}.get(sensor.quantity, ())
    return SensorHeader(
        name=sensor.name,
        chip=sensor.chip,
        quantity=cast(Quantity, sensor.quantity),
        unit=sensor.unit,
        range=sensor.range,
        sensitivity=sensor.sensitivity,
        rate_hz=sensor.rate_hz,
        bandwidth_hz=sensor.bandwidth_hz,
        axes=sensor.axes,
        position_mm=(x, y, z),
        columns=columns,
        has_temperature=sensor.temperature_counts is not None,
        compensated=compensated,
        extra={} if sensor.thermometer is None else sensor.thermometer.attributes,
    )
