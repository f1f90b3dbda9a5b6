"""LSM6DSO six-axis sensor: STMicroelectronics DS12140 Rev 2.

Facts LSM-01 ... LSM-33. Registers of the queue, of interrupts and of the embedded functions are left out, but for the
low byte of the queue's watermark, on which nothing depends while the queue is off.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x6A, 0x6B)  # SA0 low, high: LSM-01

FUNC_CFG_ACCESS = Register(0x01, reserved=0x3F)
FIFO_CTRL1 = Register(0x07)
WHO_AM_I = Register(0x0F, "r", reset=0x6C)
CTRL1_XL = Register(0x10, reserved=0x01)
CTRL2_G = Register(0x11, reserved=0x01)
CTRL3_C = Register(0x12, reset=0x04, reserved=0x02)
CTRL4_C = Register(0x13, reserved=0x91)
CTRL5_C = Register(0x14, reserved=0x10)
CTRL6_C = Register(0x15)
CTRL7_G = Register(0x16, reserved=0x08)
CTRL8_XL = Register(0x17)
STATUS_REG = Register(0x1E, "r", reserved=0xF8)
OUT_TEMP_L = Register(0x20, "r")
OUT_TEMP_H = Register(0x21, "r")
OUTX_L_G = Register(0x22, "r")
OUTX_H_G = Register(0x23, "r")
OUTY_L_G = Register(0x24, "r")
OUTY_H_G = Register(0x25, "r")
OUTZ_L_G = Register(0x26, "r")
OUTZ_H_G = Register(0x27, "r")
OUTX_L_A = Register(0x28, "r")
OUTX_H_A = Register(0x29, "r")
OUTY_L_A = Register(0x2A, "r")
OUTY_H_A = Register(0x2B, "r")
OUTZ_L_A = Register(0x2C, "r")
OUTZ_H_A = Register(0x2D, "r")

EMBEDDED_PAGE = FUNC_CFG_ACCESS[7]
SENSOR_HUB_PAGE = FUNC_CFG_ACCESS[6]
ACCEL_RATE = CTRL1_XL[7:4]
ACCEL_RANGE = CTRL1_XL[3:2]
ACCEL_LPF2_ON = CTRL1_XL[1]
GYRO_RATE = CTRL2_G[7:4]
GYRO_RANGE = CTRL2_G[3:1]
BOOT = CTRL3_C[7]
BLOCK_UPDATE = CTRL3_C[6]
INT_ACTIVE_LOW = CTRL3_C[5]
INT_OPEN = CTRL3_C[4]
SPI_THREE_WIRE = CTRL3_C[3]
AUTO_INCREMENT = CTRL3_C[2]
SW_RESET = CTRL3_C[0]
GYRO_SLEEP = CTRL4_C[6]
INT2_ON_INT1 = CTRL4_C[5]
DATA_READY_MASK = CTRL4_C[3]
I2C_OFF = CTRL4_C[2]
GYRO_LPF1_ON = CTRL4_C[1]
ULTRA_LOW_POWER = CTRL5_C[7]
ROUNDING = CTRL5_C[6:5]
GYRO_SELF_TEST = CTRL5_C[3:2]
ACCEL_SELF_TEST = CTRL5_C[1:0]
EDGE_MODE = CTRL6_C[7:5]
ACCEL_LOW_POWER = CTRL6_C[4]
OFFSET_WEIGHT = CTRL6_C[3]
GYRO_LPF1 = CTRL6_C[2:0]
GYRO_LOW_POWER = CTRL7_G[7]
GYRO_HIGH_PASS_ON = CTRL7_G[6]
GYRO_HIGH_PASS = CTRL7_G[5:4]
OIS_ENABLE = CTRL7_G[2]
OFFSET_ON = CTRL7_G[1]
OIS_ON = CTRL7_G[0]
ACCEL_FILTER = CTRL8_XL[7:5]
ACCEL_REFERENCE = CTRL8_XL[4]
ACCEL_FAST_SETTLING = CTRL8_XL[3]
ACCEL_HIGH_PASS_ON = CTRL8_XL[2]
ACCEL_RANGE_MODE = CTRL8_XL[1]
LOW_PASS_ON_6D = CTRL8_XL[0]
TEMPERATURE_READY = STATUS_REG[2]
GYRO_READY = STATUS_REG[1]
ACCEL_READY = STATUS_REG[0]
