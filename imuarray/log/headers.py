"""What a log says of a sensor that is set as an array's configuration says."""

from __future__ import annotations

from collections.abc import Mapping

from imuarray.array import SensorConfig
from imuarray.log.format import SensorHeader


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
