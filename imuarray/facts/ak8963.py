"""AK8963 magnetometer, as it is in the MPU-9250: AKM data sheet MS1356-E-02 (2013), register list.

Facts AKM-01 ... AKM-16. The I2C disable register and the factory's test registers are left out.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x0C,)  # in the MPU-9250: AKM-01

WIA = Register(0x00, "r", reset=0x48)
INFO = Register(0x01, "r")
ST1 = Register(0x02, "r", reserved=0xFC)
HXL = Register(0x03, "r")
HXH = Register(0x04, "r")
HYL = Register(0x05, "r")
HYH = Register(0x06, "r")
HZL = Register(0x07, "r")
HZH = Register(0x08, "r")
ST2 = Register(0x09, "r", reserved=0xE7)
CNTL1 = Register(0x0A, reserved=0xE0)
CNTL2 = Register(0x0B, reserved=0xFE)
ASTC = Register(0x0C, reserved=0xBF)
ASAX = Register(0x10, "r")
ASAY = Register(0x11, "r")
ASAZ = Register(0x12, "r")

DATA_OVERRUN = ST1[1]
DATA_READY = ST1[0]
SIXTEEN_BITS_SHOWN = ST2[4]
OVERFLOW = ST2[3]
SIXTEEN_BITS = CNTL1[4]
MODE = CNTL1[3:0]
SOFT_RESET = CNTL2[0]
SELF_TEST = ASTC[6]
