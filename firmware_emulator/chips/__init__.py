"""The chips: what reading and writing each register does, and when a conversion is finished."""

from collections.abc import Callable
from functools import partial

from firmware_emulator.chip import Chip
from firmware_emulator.chips import icm42688, lsm6dso, mpu6050, mpu6500
from firmware_emulator.chips.adxl345 import Adxl345
from firmware_emulator.chips.ak8963 import Ak8963
from firmware_emulator.chips.ak8975 import Ak8975
from firmware_emulator.chips.bma180 import Bma180
from firmware_emulator.chips.bmp180 import Bmp180
from firmware_emulator.chips.bmp280 import Bmp280
from firmware_emulator.chips.bmp388 import Bmp388
from firmware_emulator.chips.hmc5883 import Hmc5883, Hmc5883l
from firmware_emulator.chips.l3g4200d import L3g4200d
from firmware_emulator.chips.lis3mdl import Lis3mdl
from firmware_emulator.chips.mmc5983 import Mmc5983
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
"""Chips of which two sensors in one place are one die."""

CHIPS: dict[str, Callable[..., Chip]] = {
    "adxl345": Adxl345,
    "bma180": Bma180,
    "l3g4200d": L3g4200d,
    **{
        f"{name}_{suffix}": partial(die.build, half=half.name)
        for name, die in DIES.items()
        for suffix, half in die.halves.items()
    },
    "bmp180": Bmp180,
    "bmp280": Bmp280,
    "bmp388": Bmp388,
    "hmc5883": Hmc5883,
    "hmc5883l": Hmc5883l,
    "lis3mdl": Lis3mdl,
    "mmc5983": Mmc5983,
    "ak8963": Ak8963,
    "ak8975": Ak8975,
}
"""Chips by the name that configurations use; each is built as ``(address, element, powered_on_ns, **switches)``."""

ON_AUXILIARY_BUS = ("ak8963", "ak8975")
"""Chips that an MPU-9150 or MPU-9250 on the same bus hides until its bypass is open."""

BAROMETERS = ("bmp180", "bmp280", "bmp388")
"""Chips that have no axes, and draw their noise themselves, from a `generator`."""
