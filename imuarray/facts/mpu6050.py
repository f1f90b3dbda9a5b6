"""MPU-6050 six-axis sensor: InvenSense register map RM-MPU-6000A rev. 4.2 (19 Aug 2013).

Facts INV-01, INV-10 ... INV-29. Registers of the auxiliary bus and of motion detection are omitted, except the data
byte of the first slave on that bus, which has no effect while the bus is off.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x68, 0x69)  # AD0 low, high: INV-01

XG_OFFS_TC = Register(0x00, reset=0x01)  # not in the register map: INV-29
SELF_TEST_X = Register(0x0D)
SELF_TEST_Y = Register(0x0E)
SELF_TEST_Z = Register(0x0F)
SELF_TEST_A = Register(0x10, reserved=0xC0)
SMPLRT_DIV = Register(0x19)
CONFIG = Register(0x1A, reserved=0xC0)
GYRO_CONFIG = Register(0x1B, reserved=0x07)
ACCEL_CONFIG = Register(0x1C, reserved=0x07)
FIFO_EN = Register(0x23)
INT_PIN_CFG = Register(0x37, reserved=0x01)
INT_ENABLE = Register(0x38, reserved=0xE6)
INT_STATUS = Register(0x3A, "r", reserved=0xE6)
ACCEL_XOUT_H = Register(0x3B, "r")
ACCEL_XOUT_L = Register(0x3C, "r")
ACCEL_YOUT_H = Register(0x3D, "r")
ACCEL_YOUT_L = Register(0x3E, "r")
ACCEL_ZOUT_H = Register(0x3F, "r")
ACCEL_ZOUT_L = Register(0x40, "r")
TEMP_OUT_H = Register(0x41, "r")
TEMP_OUT_L = Register(0x42, "r")
GYRO_XOUT_H = Register(0x43, "r")
GYRO_XOUT_L = Register(0x44, "r")
GYRO_YOUT_H = Register(0x45, "r")
GYRO_YOUT_L = Register(0x46, "r")
GYRO_ZOUT_H = Register(0x47, "r")
GYRO_ZOUT_L = Register(0x48, "r")
I2C_SLV0_DO = Register(0x63)
USER_CTRL = Register(0x6A, reserved=0x88)
PWR_MGMT_1 = Register(0x6B, reset=0x40, reserved=0x10)
PWR_MGMT_2 = Register(0x6C)
FIFO_COUNT_H = Register(0x72, "r")
FIFO_COUNT_L = Register(0x73, "r")
FIFO_R_W = Register(0x74)
WHO_AM_I = Register(0x75, "r", reset=0x68)

POWER_MODE = XG_OFFS_TC[7]
GYRO_X_DRIFT_TRIM = XG_OFFS_TC[6:1]
OTP_VALID = XG_OFFS_TC[0]
TRIM_ACCEL_X_HIGH = SELF_TEST_X[7:5]
TRIM_GYRO_X = SELF_TEST_X[4:0]
TRIM_ACCEL_Y_HIGH = SELF_TEST_Y[7:5]
TRIM_GYRO_Y = SELF_TEST_Y[4:0]
TRIM_ACCEL_Z_HIGH = SELF_TEST_Z[7:5]
TRIM_GYRO_Z = SELF_TEST_Z[4:0]
TRIM_ACCEL_X_LOW = SELF_TEST_A[5:4]
TRIM_ACCEL_Y_LOW = SELF_TEST_A[3:2]
TRIM_ACCEL_Z_LOW = SELF_TEST_A[1:0]
EXT_SYNC = CONFIG[5:3]
DLPF = CONFIG[2:0]
GYRO_SELF_TEST = GYRO_CONFIG[7:5]
GYRO_RANGE = GYRO_CONFIG[4:3]
ACCEL_SELF_TEST = ACCEL_CONFIG[7:5]
ACCEL_RANGE = ACCEL_CONFIG[4:3]
FIFO_TEMPERATURE = FIFO_EN[7]
FIFO_GYRO = FIFO_EN[6:4]
FIFO_ACCEL = FIFO_EN[3]
FIFO_SLAVES = FIFO_EN[2:0]
INT_LEVEL = INT_PIN_CFG[7]
INT_OPEN = INT_PIN_CFG[6]
LATCH_INT = INT_PIN_CFG[5]
INT_READ_CLEAR = INT_PIN_CFG[4]
FSYNC_LEVEL = INT_PIN_CFG[3]
FSYNC_INT_EN = INT_PIN_CFG[2]
BYPASS_EN = INT_PIN_CFG[1]
FIFO_OVERFLOW_EN = INT_ENABLE[4]
MASTER_INT_EN = INT_ENABLE[3]
DATA_READY_EN = INT_ENABLE[0]
FIFO_OVERFLOW = INT_STATUS[4]
MASTER_INT = INT_STATUS[3]
DATA_READY = INT_STATUS[0]
FIFO_ON = USER_CTRL[6]
MASTER_ON = USER_CTRL[5]
I2C_OFF = USER_CTRL[4]
FIFO_RESET = USER_CTRL[2]
MASTER_RESET = USER_CTRL[1]
SIGNAL_RESET = USER_CTRL[0]
DEVICE_RESET = PWR_MGMT_1[7]
SLEEP = PWR_MGMT_1[6]
CYCLE = PWR_MGMT_1[5]
TEMPERATURE_OFF = PWR_MGMT_1[3]
CLOCK = PWR_MGMT_1[2:0]
WAKE_RATE = PWR_MGMT_2[7:6]
ACCEL_STANDBY = PWR_MGMT_2[5:3]
GYRO_STANDBY = PWR_MGMT_2[2:0]
