"""BMA180 accelerometer: Bosch data sheet v2.5 (7 Dec 2010), memory map.

Facts BMA-01, BMA-10 ... BMA-58. Reset values are those of the image after the EEPROM download with mid codes in the
trim fields (BMA-58). The image 0x20 ... 0x3B is written only while EE_W is 1; 0x40 ... 0x5B must never be written.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x40, 0x41)  # SDO low, high: BMA-01

CHIP_ID = Register(0x00, "r", reset=0x03)
VERSION = Register(0x01, "r")
ACC_X_LSB = Register(0x02, "r", reserved=0x02)
ACC_X_MSB = Register(0x03, "r")
ACC_Y_LSB = Register(0x04, "r", reserved=0x02)
ACC_Y_MSB = Register(0x05, "r")
ACC_Z_LSB = Register(0x06, "r", reserved=0x02)
ACC_Z_MSB = Register(0x07, "r")
TEMP = Register(0x08, "r")
STATUS_REG1 = Register(0x09, "r", reserved=0x40)
STATUS_REG2 = Register(0x0A, "r")
STATUS_REG3 = Register(0x0B, "r")
STATUS_REG4 = Register(0x0C, "r")
CTRL_REG0 = Register(0x0D, reserved=0x80)
CTRL_REG1 = Register(0x0E)
CTRL_REG2 = Register(0x0F, reserved=0x0F)
RESET = Register(0x10, "w")
BW_TCS = Register(0x20, reset=0x48)
CTRL_REG3 = Register(0x21, reset=0x04)
CTRL_REG4 = Register(0x22, reset=0x15)
HY = Register(0x23)
SLOPE_TAPSENS_INFO = Register(0x24, reset=0xEE)
HIGH_LOW_INFO = Register(0x25, reset=0xEE)
LOW_DUR = Register(0x26, reset=0xA0)
HIGH_DUR = Register(0x27, reset=0x64)
TAPSENS_TH = Register(0x28)
LOW_TH = Register(0x29, reset=0x17)
HIGH_TH = Register(0x2A, reset=0x50)
SLOPE_TH = Register(0x2B)
CD1 = Register(0x2C)
CD2 = Register(0x2D)
TCO_X = Register(0x2E, reset=0x81)
TCO_Y = Register(0x2F, reset=0x82)
TCO_Z = Register(0x30, reset=0x80)
GAIN_T = Register(0x31, reset=0x84)
GAIN_X = Register(0x32, reset=0x80)
GAIN_Y = Register(0x33, reset=0x80)
GAIN_Z = Register(0x34, reset=0x80)
OFFSET_LSB1 = Register(0x35, reset=0x04)
OFFSET_LSB2 = Register(0x36)
OFFSET_T = Register(0x37, reset=0xB0)
OFFSET_X = Register(0x38, reset=0x80)
OFFSET_Y = Register(0x39, reset=0x80)
OFFSET_Z = Register(0x3A, reset=0x80)
CRC = Register(0x3B)

X_LOW = ACC_X_LSB[7:2]
NEW_DATA_X = ACC_X_LSB[0]
Y_LOW = ACC_Y_LSB[7:2]
NEW_DATA_Y = ACC_Y_LSB[0]
Z_LOW = ACC_Z_LSB[7:2]
NEW_DATA_Z = ACC_Z_LSB[0]
FIRST_TAP = STATUS_REG1[7]
EVENTS = STATUS_REG1[5:1]
EE_WRITE = STATUS_REG1[0]
RESET_INT = CTRL_REG0[6]
UPDATE_IMAGE = CTRL_REG0[5]
EE_W = CTRL_REG0[4]
SELF_TEST_1 = CTRL_REG0[3]
SELF_TEST_0 = CTRL_REG0[2]
SLEEP = CTRL_REG0[1]
DIS_WAKE_UP = CTRL_REG0[0]
UNLOCK_EE = CTRL_REG2[7:4]
BANDWIDTH = BW_TCS[7:4]
TCS = BW_TCS[3:0]
HIGH_DURATION = HIGH_DUR[7:1]
DIS_I2C = HIGH_DUR[0]
MODE_CONFIG = TCO_Z[1:0]
TCO_Z_TRIM = TCO_Z[7:2]
SHADOW_DIS = GAIN_Y[0]
GAIN_Y_TRIM = GAIN_Y[7:1]
OFFSET_X_LOW = OFFSET_LSB1[7:4]
RANGE = OFFSET_LSB1[3:1]
SMP_SKIP = OFFSET_LSB1[0]
OFFSET_T_TRIM = OFFSET_T[7:1]
READOUT_12BIT = OFFSET_T[0]
