"""The sensors as they are configured: codes, rates, axes and filters.

Numbers such as BMA-70 are those of the facts of the data sheets; the figures of the MPU-6050 are those of its product
specification (revision 3.4, sections 6.1 and 6.2) and register map (revision 4.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

BMA180_CODES_PER_G = {1: 8192, 1.5: 5460, 2: 4096, 3: 2730, 4: 2048, 8: 1024, 16: 512}
"""By range in g: BMA-70 to BMA-76."""
ADXL345_CODES_PER_G = 256.0
"""At full resolution, in every range: ADX-40."""
L3G4200D_DPS_PER_CODE = {250: 0.00875, 500: 0.0175, 2000: 0.07}
"""By range in dps: L3G-40 to L3G-42."""
MPU6050_CODES_PER_G = {2: 16384, 4: 8192, 8: 4096, 16: 2048}
"""By range in g: product specification, section 6.2."""
MPU6050_CODES_PER_DPS = {250: 131.0, 500: 65.5, 1000: 32.8, 2000: 16.4}
"""By range in dps: product specification, section 6.1."""
BMA180_UPDATE_HZ = 2400.0
"""Whatever the bandwidth: BMA-93."""
DELAY_NS = {"mpu6050_acc": 4_900_000, "mpu6050_gyro": 4_800_000}
"""Delay of the filters with 44 Hz and 42 Hz: register map, DLPF_CFG = 3."""
GYROSCOPES = ("l3g4200d", "mpu6050_gyro")

_BOX_AXES = {"X": 0, "Y": 1, "Z": 2}


@dataclass(frozen=True)
class Sensor:
    """One sensor of an array. `range` in g or dps; `axes` names the direction in the box of its x, y and z; `chip` is
    "adxl345", "bma180", "l3g4200d", "mpu6050_acc" or "mpu6050_gyro".
    """

    name: str
    chip: str
    range: float
    axes: str
    rate_hz: int | None = None
    bandwidth_hz: float | None = None
    position_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    channel: int = 0
    address: int = 0
    has_thermometer: bool = True

    @property
    def family(self) -> str:
        """The name of the chip in a configuration."""
        return self.chip.split("_")[0]

    @property
    def is_gyroscope(self) -> bool:
        """Whether it measures angular rate in dps; others measure specific force in g."""
        return self.chip in GYROSCOPES

    @property
    def orientation(self) -> Array:
        """The (3, 3) matrix that turns vectors of the sensor's axes into those of the box."""
        matrix = np.zeros((3, 3))
        for axis in range(3):
            sign, letter = self.axes[2 * axis], self.axes[2 * axis + 1]
            matrix[_BOX_AXES[letter], axis] = 1 if sign == "+" else -1
        return matrix

    @property
    def sensitivity(self) -> float:
        """Codes per g or dps."""
        if self.chip == "bma180":
            return BMA180_CODES_PER_G[self.range]
        if self.chip == "adxl345":
            return ADXL345_CODES_PER_G
        if self.chip == "l3g4200d":
            return 1 / L3G4200D_DPS_PER_CODE[int(self.range)]
        table = MPU6050_CODES_PER_G if self.chip == "mpu6050_acc" else MPU6050_CODES_PER_DPS
        return table[int(self.range)]

    @property
    def update_rate_hz(self) -> float:
        """The rate at which the chip writes its registers by the data sheet."""
        return BMA180_UPDATE_HZ if self.rate_hz is None else float(self.rate_hz)

    @property
    def code_span(self) -> tuple[float, float]:
        """The lowest and the highest code."""
        if self.chip == "bma180":
            return -8192, 8191
        if self.chip == "adxl345":
            return -ADXL345_CODES_PER_G * self.range, ADXL345_CODES_PER_G * self.range - 1
        return -32768, 32767

    @property
    def toml(self) -> str:
        """Its table in a configuration."""
        lines = [
            "[[sensor]]",
            f'name = "{self.name}"',
            f'chip = "{self.family}"',
            f"channel = {self.channel}",
            f"address = {self.address:#04x}",
            f"range = {self.range}",
        ]
        if self.rate_hz is not None:
            lines.append(f"rate_hz = {self.rate_hz}")
        if self.bandwidth_hz is not None:
            lines.append(f"bandwidth_hz = {self.bandwidth_hz}")
        position = ", ".join(f"{float(place):.1f}" for place in self.position_mm)
        return "\n".join([*lines, f'axes = "{self.axes}"', f"position_mm = [{position}]", ""])
