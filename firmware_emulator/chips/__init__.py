"""The chips: the effects of reading and writing each register, and the times of conversions."""

from collections.abc import Callable
from typing import Any

from firmware_emulator.chip import Chip, Element
from firmware_emulator.chips import icm42688, lsm6dso, mpu6050, mpu6500
from firmware_emulator.chips.adxl345 import Adxl345Chip
from firmware_emulator.chips.akm import Ak8963Chip, Ak8975Chip
from firmware_emulator.chips.bma180 import Bma180Chip
from firmware_emulator.chips.bmp180 import Bmp180Chip
from firmware_emulator.chips.bmp280 import Bmp280Chip
from firmware_emulator.chips.bmp388 import Bmp388Chip
from firmware_emulator.chips.hmc5883 import Hmc5883Chip, Hmc5883lChip
from firmware_emulator.chips.l3g4200d import L3g4200dChip
from firmware_emulator.chips.lis3mdl import Lis3mdlChip
from firmware_emulator.chips.mmc5983 import Mmc5983Chip
from firmware_emulator.six_axis import Die, Half

DIES: dict[str, Die] = {
    "mpu6050": mpu6050.DIE,
    "mpu6500": mpu6500.DIE,
    "mpu9250": mpu6500.DIE_9250,
    "icm42688": icm42688.DIE,
    "lsm6dso": lsm6dso.DIE,
}
"""Six-axis chips by name; each is two entries of `CHIPS`, as in ``mpu6050_acc``."""

HALVES: dict[str, Half] = {
    f"{name}_{suffix}": half for name, die in DIES.items() for suffix, half in die.halves.items()
}
"""Chips of which two sensors at one place are the two halves of one die."""


def _chip_of(die: Die, half: Half) -> Callable[..., Chip]:

    def build(address: int, element: Element, powered_on_ns: int = 0, **switches: Any) -> Chip:
        return die.build(address, {half.name: element}, powered_on_ns, **switches)

    return build


CHIPS: dict[str, Callable[..., Chip]] = {
    "adxl345": Adxl345Chip,
    "bma180": Bma180Chip,
    "l3g4200d": L3g4200dChip,
    **{f"{name}_{suffix}": _chip_of(die, half) for name, die in DIES.items() for suffix, half in die.halves.items()},
    "bmp180": Bmp180Chip,
    "bmp280": Bmp280Chip,
    "bmp388": Bmp388Chip,
    "hmc5883": Hmc5883Chip,
    "hmc5883l": Hmc5883lChip,
    "lis3mdl": Lis3mdlChip,
    "mmc5983": Mmc5983Chip,
    "ak8963": Ak8963Chip,
    "ak8975": Ak8975Chip,
}
"""Chips by the name that configurations use; each is built as ``(address, element, powered_on_ns, **switches)``."""

ON_AUXILIARY_BUS = ("ak8963", "ak8975")
"""Chips that can't be reached until the bypass of an MPU-9150 or MPU-9250 on the same bus is open."""

BAROMETERS = ("bmp180", "bmp280", "bmp388")
"""Chips that have no axes and draw their own noise from a `generator`."""
