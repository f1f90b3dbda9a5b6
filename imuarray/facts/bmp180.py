"""BMP180 barometer: Bosch data sheet v2.8 (2015), memory map.

Facts BMP-01, BMP-10 ... BMP-30. The calibration words are per part; each is two bytes, most significant first.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x77,)  # fixed: BMP-01

CALIBRATION = Register(0xAA, "r")
CALIBRATION_WORDS = ("AC1", "AC2", "AC3", "AC4", "AC5", "AC6", "B1", "B2", "MB", "MC", "MD")
CHIP_ID = Register(0xD0, "r", reset=0x55)
SOFT_RESET = Register(0xE0, "w")
CTRL_MEAS = Register(0xF4)
OUT_MSB = Register(0xF6, "r", reset=0x80)
OUT_LSB = Register(0xF7, "r")
OUT_XLSB = Register(0xF8, "r")

OVERSAMPLING = CTRL_MEAS[7:6]
CONVERTING = CTRL_MEAS[5]
MEASUREMENT = CTRL_MEAS[4:0]
