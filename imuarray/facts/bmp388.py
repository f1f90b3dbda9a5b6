"""BMP388 barometer: Bosch data sheet BST-BMP388-DS001 rev. 1.0, memory map.

Facts BMP-201 ... BMP-212. A BMP390 has the same registers and another identity. The calibration words are per part, one
or two bytes each, least significant first. The queue, interrupts and the sensor's clock are left out.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x76, 0x77)  # SDO low, high: BMP-201

CHIP_ID = Register(0x00, "r", reset=0x50)
ERR_REG = Register(0x02, "r", reserved=0xF8)
STATUS = Register(0x03, "r", reserved=0x8F)
DATA_0 = Register(0x04, "r")
DATA_1 = Register(0x05, "r")
DATA_2 = Register(0x06, "r", reset=0x80)
DATA_3 = Register(0x07, "r")
DATA_4 = Register(0x08, "r")
DATA_5 = Register(0x09, "r", reset=0x80)
PWR_CTRL = Register(0x1B, reserved=0xCC)
OSR = Register(0x1C, reset=0x02, reserved=0xC0)
ODR = Register(0x1D, reserved=0xE0)
CONFIG = Register(0x1F, reserved=0xF1)
CALIBRATION = Register(0x31, "r")
CALIBRATION_WORDS = ("T1", "T2", "T3", "P1", "P2", "P3", "P4", "P5", "P6", "P7", "P8", "P9", "P10", "P11")
CMD = Register(0x7E, "w")

CONFIGURATION_ERROR = ERR_REG[2]
COMMAND_ERROR = ERR_REG[1]
FATAL_ERROR = ERR_REG[0]
TEMPERATURE_READY = STATUS[6]
PRESSURE_READY = STATUS[5]
COMMAND_READY = STATUS[4]
MODE = PWR_CTRL[5:4]
TEMPERATURE_ON = PWR_CTRL[1]
PRESSURE_ON = PWR_CTRL[0]
TEMPERATURE_OVERSAMPLING = OSR[5:3]
PRESSURE_OVERSAMPLING = OSR[2:0]
PERIOD = ODR[4:0]
FILTER = CONFIG[3:1]
