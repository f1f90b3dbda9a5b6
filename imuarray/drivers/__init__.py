"""One driver per chip. A new chip needs its registers in `imuarray.facts`, its entry in `imuarray.chips`, a file here
and a line below; docs/how_to/extend.md lists the other steps.
"""

from __future__ import annotations

from imuarray.array import SensorConfig
from imuarray.drivers.adxl345 import Adxl345, Adxl345Fifo
from imuarray.drivers.akm import Ak8963, Ak8975
from imuarray.drivers.barometers import Bmp180, Bmp280, Bmp388
from imuarray.drivers.bma180 import Bma180
from imuarray.drivers.driver import DecodedBursts, Driver, FifoDriver, OnDemandDriver, RemarkingDriver, SelfTest
from imuarray.drivers.hmc5883 import Hmc5883
from imuarray.drivers.icm42688 import Icm42688, Icm42688Fifo, Icm42688HighResolution
from imuarray.drivers.l3g4200d import L3g4200d, L3g4200dFifo
from imuarray.drivers.lis3mdl import Lis3mdl
from imuarray.drivers.lsm6dso import Lsm6dso, Lsm6dsoFifo
from imuarray.drivers.mmc5983 import Mmc5983
from imuarray.drivers.mpu import Mpu6050, Mpu6050Fifo, Mpu6500, Mpu6500Fifo

__all__ = [
    "DRIVERS",
    "FIFO_DRIVERS",
    "HIGH_RESOLUTION_DRIVERS",
    "DecodedBursts",
    "Driver",
    "FifoDriver",
    "OnDemandDriver",
    "RemarkingDriver",
    "SelfTest",
    "driver_of",
]


def _halves(**dies: type[Driver]) -> dict[str, type[Driver]]:
    """Return the drivers of both halves of each die, by the names that configurations use, such as mpu6050_acc."""
    return {f"{die}_{half}": driver for die, driver in dies.items() for half in ("acc", "gyro")}


DRIVERS: dict[str, type[Driver]] = {
    "adxl345": Adxl345,
    "bma180": Bma180,
    "l3g4200d": L3g4200d,
    **_halves(mpu6050=Mpu6050, mpu6500=Mpu6500, mpu9250=Mpu6500, icm42688=Icm42688, lsm6dso=Lsm6dso),
    "bmp180": Bmp180,
    "bmp280": Bmp280,
    "bmp388": Bmp388,
    "hmc5883": Hmc5883,
    "hmc5883l": Hmc5883,
    "lis3mdl": Lis3mdl,
    "mmc5983": Mmc5983,
    "ak8963": Ak8963,
    "ak8975": Ak8975,
}

FIFO_DRIVERS: dict[str, type[Driver]] = {
    "adxl345": Adxl345Fifo,
    "l3g4200d": L3g4200dFifo,
    **_halves(
        mpu6050=Mpu6050Fifo, mpu6500=Mpu6500Fifo, mpu9250=Mpu6500Fifo, icm42688=Icm42688Fifo, lsm6dso=Lsm6dsoFifo
    ),
}
"""Drivers of chips whose queue is drained (`fifo = true`)."""

HIGH_RESOLUTION_DRIVERS = _halves(icm42688=Icm42688HighResolution)
"""Drivers of chips with a queue that delivers counts of more bits (`high_resolution = true`)."""


def driver_of(sensor: SensorConfig) -> type[Driver]:
    """Return the class of the driver for a sensor as it is configured."""
    if sensor.high_resolution:
        return HIGH_RESOLUTION_DRIVERS[sensor.chip]
    return (FIFO_DRIVERS if sensor.fifo else DRIVERS)[sensor.chip]
