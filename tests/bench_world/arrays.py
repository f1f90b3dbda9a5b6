"""Sensors on a board behind a PCA9544A multiplexer: each has an address that is free on its channel, and a position."""

from __future__ import annotations

from dataclasses import replace

from tests.bench_world.chips import Sensor

ADDRESSES = {"bma180": (0x40, 0x41), "adxl345": (0x53, 0x1D), "l3g4200d": (0x68, 0x69), "mpu6050": (0x68, 0x69)}
CHANNELS = range(4)


def adxl345(name: str, range_g: int, axes: str, rate_hz: int) -> Sensor:
    """Return an ADXL345, which has neither a thermometer nor a filter to choose."""
    return Sensor(name, "adxl345", range_g, axes, rate_hz, has_thermometer=False)


def bma180(name: str, range_g: float, axes: str, bandwidth_hz: int) -> Sensor:
    """Return a BMA180."""
    return Sensor(name, "bma180", range_g, axes, None, bandwidth_hz)


def l3g4200d(name: str, range_dps: int, axes: str, rate_hz: int, bandwidth_hz: float) -> Sensor:
    """Return an L3G4200D whose second filter is in the path of the data."""
    return Sensor(name, "l3g4200d", range_dps, axes, rate_hz, bandwidth_hz)


def mpu6050(range_g: int, range_dps: int, axes: str, rate_hz: int) -> tuple[Sensor, Sensor]:
    """Return M_acc and M_gyro, the two sensors of an MPU-6050 with DLPF_CFG = 3."""
    return (
        Sensor("M_acc", "mpu6050_acc", range_g, axes, rate_hz, 44),
        Sensor("M_gyro", "mpu6050_gyro", range_dps, axes, rate_hz, 42),
    )


def place(*sensors: Sensor) -> tuple[Sensor, ...]:
    """Return the sensors in rows of three, 8 mm and 9 mm apart on the two sides of a board, with channels and
    addresses.
    """
    placed: list[Sensor] = []
    for index, sensor in enumerate(sensors):
        if sensor.chip == "mpu6050_gyro":  # in the chip before it
            half = placed[-1]
            placed.append(
                replace(sensor, position_mm=half.position_mm, channel=half.channel, address=half.address),
            )
            continue
        position = (8.0 * (index % 3) - 8, 9.0 * (index // 3) - 9, 2.0 * (index % 2))
        channel, address = _free_address(sensor, placed)
        placed.append(replace(sensor, position_mm=position, channel=channel, address=address))
    return tuple(placed)


def alone(sensor: Sensor) -> tuple[Sensor, ...]:
    """Return an array of this sensor in the middle of the box."""
    (placed,) = place(sensor)
    return (replace(placed, position_mm=(0.0, 0.0, 0.0)),)


def _free_address(sensor: Sensor, placed: list[Sensor]) -> tuple[int, int]:
    taken = {(other.channel, other.address) for other in placed}
    return next(
        (channel, address)
        for channel in CHANNELS
        for address in ADDRESSES[sensor.family]
        if (channel, address) not in taken
    )
