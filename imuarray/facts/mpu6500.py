"""MPU-6500 six-axis sensor, and the MPU-9250 that holds one: InvenSense register map RM-MPU-9250A rev. 1.4 (2013).

Facts INV-70 ... INV-78, INV-96 ... INV-99. Registers of the auxiliary bus, of interrupts and of motion detection are
left out, but for the data byte of the first slave, on which nothing depends while that bus is off.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x68, 0x69)  # AD0 low, high: INV-70

SELF_TEST_X_GYRO = Register(0x00)
SELF_TEST_Y_GYRO = Register(0x01)
SELF_TEST_Z_GYRO = Register(0x02)
SELF_TEST_X_ACCEL = Register(0x0D)
SELF_TEST_Y_ACCEL = Register(0x0E)
SELF_TEST_Z_ACCEL = Register(0x0F)
SMPLRT_DIV = Register(0x19)
CONFIG = Register(0x1A, reserved=0x80)
GYRO_CONFIG = Register(0x1B, reserved=0x04)
ACCEL_CONFIG = Register(0x1C, reserved=0x07)
ACCEL_CONFIG_2 = Register(0x1D, reserved=0xF0)
FIFO_EN = Register(0x23)
INT_PIN_CFG = Register(0x37, reserved=0x01)
INT_STATUS = Register(0x3A, "r", reserved=0xA6)
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
PWR_MGMT_1 = Register(0x6B, reset=0x01)
PWR_MGMT_2 = Register(0x6C, reserved=0xC0)
FIFO_COUNT_H = Register(0x72, "r")
FIFO_COUNT_L = Register(0x73, "r")
FIFO_R_W = Register(0x74)
WHO_AM_I = Register(0x75, "r", reset=0x70)

FIFO_STOPS = CONFIG[6]
EXT_SYNC = CONFIG[5:3]
DLPF = CONFIG[2:0]
GYRO_SELF_TEST = GYRO_CONFIG[7:5]
GYRO_RANGE = GYRO_CONFIG[4:3]
GYRO_UNFILTERED = GYRO_CONFIG[1:0]
ACCEL_SELF_TEST = ACCEL_CONFIG[7:5]
ACCEL_RANGE = ACCEL_CONFIG[4:3]
ACCEL_UNFILTERED = ACCEL_CONFIG_2[3]
ACCEL_DLPF = ACCEL_CONFIG_2[2:0]
INT_ACTIVE_LOW = INT_PIN_CFG[7]
INT_OPEN = INT_PIN_CFG[6]
INT_LATCHED = INT_PIN_CFG[5]
CLEAR_BY_ANY_READ = INT_PIN_CFG[4]
FRAME_SYNC_INT = INT_PIN_CFG[3:2]
BYPASS = INT_PIN_CFG[1]
FIFO_TEMPERATURE = FIFO_EN[7]
FIFO_GYRO = FIFO_EN[6:4]
FIFO_ACCEL = FIFO_EN[3]
FIFO_SLAVES = FIFO_EN[2:0]
WAKE_ON_MOTION = INT_STATUS[6]
FIFO_OVERFLOW = INT_STATUS[4]
FRAME_SYNC = INT_STATUS[3]
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
GYRO_STANDBY = PWR_MGMT_1[4]
TEMPERATURE_OFF = PWR_MGMT_1[3]
CLOCK = PWR_MGMT_1[2:0]
ACCEL_OFF = PWR_MGMT_2[5:3]
GYRO_OFF = PWR_MGMT_2[2:0]
