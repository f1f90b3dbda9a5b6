"""MMC5983MA magnetometer: MEMSIC data sheet Rev A (2019), register list.

Facts MMC-01 ... MMC-17. The control registers can only be written.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x30,)  # fixed: MMC-01

X_OUT_0 = Register(0x00, "r")
X_OUT_1 = Register(0x01, "r")
Y_OUT_0 = Register(0x02, "r")
Y_OUT_1 = Register(0x03, "r")
Z_OUT_0 = Register(0x04, "r")
Z_OUT_1 = Register(0x05, "r")
XYZ_OUT_2 = Register(0x06, "r", reserved=0x03)
T_OUT = Register(0x07, "r")
STATUS = Register(0x08, reserved=0xEC)
CONTROL_0 = Register(0x09, "w", reserved=0x80)
CONTROL_1 = Register(0x0A, "w", reserved=0x60)
CONTROL_2 = Register(0x0B, "w")
CONTROL_3 = Register(0x0C, "w", reserved=0xB9)
PRODUCT_ID = Register(0x2F, "r", reset=0x30)

X_LOW = XYZ_OUT_2[7:6]
Y_LOW = XYZ_OUT_2[5:4]
Z_LOW = XYZ_OUT_2[3:2]
OTP_READ_DONE = STATUS[4]
TEMPERATURE_DONE = STATUS[1]
FIELD_DONE = STATUS[0]
OTP_READ = CONTROL_0[6]
AUTO_SET_RESET = CONTROL_0[5]
RESET_COIL = CONTROL_0[4]
SET_COIL = CONTROL_0[3]
INTERRUPT_ON = CONTROL_0[2]
TAKE_TEMPERATURE = CONTROL_0[1]
TAKE_FIELD = CONTROL_0[0]
SOFT_RESET = CONTROL_1[7]
YZ_OFF = CONTROL_1[4:3]
X_OFF = CONTROL_1[2]
BANDWIDTH = CONTROL_1[1:0]
PERIODIC_SET_ON = CONTROL_2[7]
PERIODIC_SET = CONTROL_2[6:4]
CONTINUOUS = CONTROL_2[3]
FREQUENCY = CONTROL_2[2:0]
SPI_THREE_WIRE = CONTROL_3[6]
CURRENT_MINUS = CONTROL_3[2]
CURRENT_PLUS = CONTROL_3[1]
