"""The sensors as configured: units, codes, rates, bandwidths, axes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

G0 = 9.80665
"""One g, m/s²."""
QUANTITY = {"acc": "specific_force", "gyro": "angular_rate", "mag": "magnetic_field", "baro": "pressure"}
UNIT = {"acc": "g", "gyro": "dps", "mag": "gauss", "baro": "Pa"}
BMA_SENS = {1: 8192, 1.5: 5460, 2: 4096, 3: 2730, 4: 2048, 8: 1024, 16: 512}
BMA_TOL = {1: 2, 1.5: 2, 2: 1.5, 3: 2, 4: 2, 8: 2.5, 16: 3}
HMC_SENS = {
    0.88: 1370,
    1.3: 1090,
    1.9: 820,
    2.5: 660,
    4.0: 440,
    4.7: 390,
    5.6: 330,
    8.1: 230,
    0.9: 1280,
    1.2: 1024,
    4.6: 361,
    5.5: 307,
    7.9: 219,
}  # the last five: HMC5883 without L
L3G_LPF1 = {100: 32.0, 200: 54.0, 400: 78.0, 800: 93.0}
L3G_MDPS = {250: 8.75, 500: 17.5, 2000: 70.0}
MPU_A = {2: 16384, 4: 8192, 8: 4096, 16: 2048}
MPU_G = {250: 131.0, 500: 65.5, 1000: 32.8, 2000: 16.4}


@dataclass
class Sensor:
    """A sensor as configured: chip, range, rate, bandwidth, mounting (`axes`, `position_mm`) and place on the bus."""

    name: str
    chip: str
    kind: str  # acc gyro mag baro
    range: float = 0.0
    rate_setting: float = 0.0
    bandwidth_setting: float = 0.0
    axes: str = "+X+Y+Z"
    position_mm: tuple = (0.0, 0.0, 0.0)  # from the origin of the box
    channel: int = 0
    address: int = 0
    bus: str = ""
    divisor: int = 1  # polled every div-th frame
    has_thermometer: bool = True  # the log has the thermometer's column
    low_power: bool = False  # BMA180
    second_filter: bool = False  # L3G4200D
    supply_v: float = 2.5  # ADXL345
    averaged: int = 1  # HMC5883L
    oversampling: int = 3  # BMP180
    die: str = ""  # six-axis chips: the key of the common die
    more: dict = field(default_factory=dict)

    @property
    def matrix(self):
        """The matrix that turns vectors of the sensor into those of the box."""
        turn = np.zeros((3, 3))
        for j in range(3):
            turn["XYZ".index(self.axes[2 * j + 1]), j] = 1 if self.axes[2 * j] == "+" else -1
        assert abs(np.linalg.det(turn) - 1) < 1e-9, (self.name, self.axes)
        return turn

    @property
    def sensitivity(self):
        """Codes in one unit."""
        if self.chip == "bma180":
            return float(BMA_SENS[self.range])
        if self.chip == "adxl345":
            return 256.0
        if self.chip == "l3g4200d":
            return 1000 / L3G_MDPS[self.range]
        if self.chip.startswith("mpu"):
            return float((MPU_A if self.kind == "acc" else MPU_G)[self.range])
        if self.chip.startswith("hmc"):
            return float(HMC_SENS[self.range])
        return 0.0

    @property
    def limits(self):
        """The smallest and the largest code."""
        if self.chip == "bma180":
            return -8192, 8191
        if self.chip == "adxl345":
            m = {2: 512, 4: 1024, 8: 2048, 16: 4096}[self.range]
            return -m, m - 1
        if self.chip.startswith("hmc"):
            return -2048, 2047
        return -32768, 32767

    @property
    def rate(self):
        """The rate (Hz) at which the chip updates its registers, as the log states it."""
        if self.chip == "bma180":
            return 1200.0 if self.low_power else 2400.0
        return float(self.rate_setting)

    @property
    def bandwidth(self):
        """The bandwidth (Hz) that the log states."""
        if self.kind == "baro":
            return 0.0
        if self.chip == "bma180":
            return self.bandwidth_setting / 2 if self.low_power else self.bandwidth_setting
        if self.chip == "l3g4200d":
            return self.bandwidth_setting if self.second_filter else L3G_LPF1[int(self.rate_setting)]
        if self.chip == "adxl345" or self.kind == "mag":
            return self.rate_setting / 2
        return self.bandwidth_setting
