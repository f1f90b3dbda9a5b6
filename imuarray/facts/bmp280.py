"""BMP280 barometer: Bosch data sheet BST-BMP280-DS001 rev. 1.23, memory map.

Facts BMP-101 ... BMP-112. The calibration words are per part; each is two bytes, least significant first.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x76, 0x77)  # SDO low, high: BMP-101

CALIBRATION = Register(0x88, "r")
CALIBRATION_WORDS = ("T1", "T2", "T3", "P1", "P2", "P3", "P4", "P5", "P6", "P7", "P8", "P9")
CHIP_ID = Register(0xD0, "r", reset=0x58)
SOFT_RESET = Register(0xE0, "w")
STATUS = Register(0xF3, "r", reserved=0xF6)
CTRL_MEAS = Register(0xF4)
CONFIG = Register(0xF5, reserved=0x02)
PRESS_MSB = Register(0xF7, "r", reset=0x80)
PRESS_LSB = Register(0xF8, "r")
PRESS_XLSB = Register(0xF9, "r")
TEMP_MSB = Register(0xFA, "r", reset=0x80)
TEMP_LSB = Register(0xFB, "r")
TEMP_XLSB = Register(0xFC, "r")

MEASURING = STATUS[3]
COPYING = STATUS[0]
TEMPERATURE_OVERSAMPLING = CTRL_MEAS[7:5]
PRESSURE_OVERSAMPLING = CTRL_MEAS[4:2]
MODE = CTRL_MEAS[1:0]
STANDBY = CONFIG[7:5]
FILTER = CONFIG[4:2]
SPI_THREE_WIRE = CONFIG[0]
