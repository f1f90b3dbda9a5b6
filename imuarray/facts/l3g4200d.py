"""L3G4200D gyroscope: ST data sheet Doc ID 17116 Rev 3 (Dec 2010), register mapping.

Facts L3G-01, L3G-10 ... L3G-25. Reserved registers (0x00 ... 0x0E, 0x10 ... 0x1F) must not be written.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x68, 0x69)  # SDO low, high: L3G-01

WHO_AM_I = Register(0x0F, "r", reset=0xD3)
CTRL_REG1 = Register(0x20, reset=0x07)
CTRL_REG2 = Register(0x21, reserved=0xC0)
CTRL_REG3 = Register(0x22)
CTRL_REG4 = Register(0x23, reserved=0x08)
CTRL_REG5 = Register(0x24, reserved=0x20)
REFERENCE = Register(0x25)
OUT_TEMP = Register(0x26, "r")
STATUS_REG = Register(0x27, "r")
OUT_X_L = Register(0x28, "r")
OUT_X_H = Register(0x29, "r")
OUT_Y_L = Register(0x2A, "r")
OUT_Y_H = Register(0x2B, "r")
OUT_Z_L = Register(0x2C, "r")
OUT_Z_H = Register(0x2D, "r")
FIFO_CTRL_REG = Register(0x2E)
FIFO_SRC_REG = Register(0x2F, "r")
INT1_CFG = Register(0x30)
INT1_SRC = Register(0x31, "r")
INT1_THS_XH = Register(0x32, reserved=0x80)
INT1_THS_XL = Register(0x33)
INT1_THS_YH = Register(0x34, reserved=0x80)
INT1_THS_YL = Register(0x35)
INT1_THS_ZH = Register(0x36, reserved=0x80)
INT1_THS_ZL = Register(0x37)
INT1_DURATION = Register(0x38)

DATA_RATE = CTRL_REG1[7:6]
BANDWIDTH = CTRL_REG1[5:4]
POWER_ON = CTRL_REG1[3]
AXES_ON = CTRL_REG1[2:0]
HIGH_PASS_MODE = CTRL_REG2[5:4]
HIGH_PASS_CUTOFF = CTRL_REG2[3:0]
BLOCK_DATA_UPDATE = CTRL_REG4[7]
BIG_ENDIAN = CTRL_REG4[6]
FULL_SCALE = CTRL_REG4[5:4]
SELF_TEST = CTRL_REG4[2:1]
SPI_3WIRE = CTRL_REG4[0]
BOOT = CTRL_REG5[7]
FIFO_EN = CTRL_REG5[6]
HIGH_PASS_EN = CTRL_REG5[4]
INT1_SELECT = CTRL_REG5[3:2]
OUT_SELECT = CTRL_REG5[1:0]
ZYX_OVERRUN = STATUS_REG[7]
AXIS_OVERRUN = STATUS_REG[6:4]
ZYX_AVAILABLE = STATUS_REG[3]
AXIS_AVAILABLE = STATUS_REG[2:0]
FIFO_MODE = FIFO_CTRL_REG[7:5]
FIFO_WATERMARK = FIFO_CTRL_REG[4:0]
FIFO_AT_WATERMARK = FIFO_SRC_REG[7]
FIFO_OVERRUN = FIFO_SRC_REG[6]
FIFO_EMPTY = FIFO_SRC_REG[5]
FIFO_LEVEL = FIFO_SRC_REG[4:0]
