"""Scales of the chips' own thermometers, by the name of the chip (for a six-axis chip: of the die)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class ChipThermometer(NamedTuple):
    """counts = (temperature - `zero_degc`) * `lsb_per_degc`, in this number of `bits`."""

    zero_degc: float
    lsb_per_degc: float
    bits: int = 8


THERMOMETERS: Mapping[str, ChipThermometer] = MappingProxyType(
    {
        "bma180": ChipThermometer(24.0, 2.0),  # BMA-63
        "l3g4200d": ChipThermometer(0.0, -1.0),  # one count less per degree, and no known zero: L3G-60
        "mpu6050": ChipThermometer(35.0 + 521 / 340, 340.0, 16),  # INV-42
        "mpu6500": ChipThermometer(21.0, 333.87, 16),  # INV-76
        "mpu9250": ChipThermometer(21.0, 333.87, 16),
        "icm42688": ChipThermometer(25.0, 132.48, 16),  # TDK-32
        "lis3mdl": ChipThermometer(25.0, 8.0, 16),  # LIS-20
        "lsm6dso": ChipThermometer(25.0, 256.0, 16),  # LSM-32
    }
)


def thermometer_scale(chip: str) -> ChipThermometer | None:
    """Return the data sheet's scale of a chip's thermometer; None if it has none, or if the chip is unknown."""
    return THERMOMETERS.get(chip.removesuffix("_acc").removesuffix("_gyro"))
