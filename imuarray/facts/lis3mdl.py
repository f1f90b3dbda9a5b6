"""LIS3MDL magnetometer: STMicroelectronics data sheet DocID024204 Rev 6, register list.

Facts LIS-01 ... LIS-17. Interrupts are omitted except the low byte of their threshold, which has no effect while they
are off.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x1C, 0x1E)  # SDO/SA1 low, high: LIS-01

OFFSET_X_L = Register(0x05)
OFFSET_X_H = Register(0x06)
OFFSET_Y_L = Register(0x07)
OFFSET_Y_H = Register(0x08)
OFFSET_Z_L = Register(0x09)
OFFSET_Z_H = Register(0x0A)
WHO_AM_I = Register(0x0F, "r", reset=0x3D)
CTRL_REG1 = Register(0x20, reset=0x10)
CTRL_REG2 = Register(0x21, reserved=0x93)
CTRL_REG3 = Register(0x22, reset=0x03, reserved=0xD8)
CTRL_REG4 = Register(0x23, reserved=0xF1)
CTRL_REG5 = Register(0x24, reserved=0x3F)
STATUS_REG = Register(0x27, "r")
OUT_X_L = Register(0x28, "r")
OUT_X_H = Register(0x29, "r")
OUT_Y_L = Register(0x2A, "r")
OUT_Y_H = Register(0x2B, "r")
OUT_Z_L = Register(0x2C, "r")
OUT_Z_H = Register(0x2D, "r")
TEMP_OUT_L = Register(0x2E, "r")
TEMP_OUT_H = Register(0x2F, "r")
INT_THS_L = Register(0x32)

TEMPERATURE_ON = CTRL_REG1[7]
XY_PERFORMANCE = CTRL_REG1[6:5]
DATA_RATE = CTRL_REG1[4:2]
FAST_RATE = CTRL_REG1[1]
SELF_TEST = CTRL_REG1[0]
FULL_SCALE = CTRL_REG2[6:5]
REBOOT = CTRL_REG2[3]
SOFT_RESET = CTRL_REG2[2]
LOW_POWER = CTRL_REG3[5]
SPI_THREE_WIRE = CTRL_REG3[2]
OPERATION = CTRL_REG3[1:0]
Z_PERFORMANCE = CTRL_REG4[3:2]
BIG_ENDIAN = CTRL_REG4[1]
FAST_READ = CTRL_REG5[7]
BLOCK_UPDATE = CTRL_REG5[6]
ZYX_OVERRUN = STATUS_REG[7]
AXIS_OVERRUN = STATUS_REG[6:4]
ZYX_AVAILABLE = STATUS_REG[3]
AXIS_AVAILABLE = STATUS_REG[2:0]
