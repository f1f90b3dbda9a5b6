"""AK8975 magnetometer, as it is in the MPU-9150: the register list that the Linux driver and public drivers quote.

Facts AKM-21 ... AKM-28. The I2C disable register and the factory's test registers are left out.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x0C,)  # in the MPU-9150: AKM-21

WIA = Register(0x00, "r", reset=0x48)
INFO = Register(0x01, "r")
ST1 = Register(0x02, "r", reserved=0xFE)
HXL = Register(0x03, "r")
HXH = Register(0x04, "r")
HYL = Register(0x05, "r")
HYH = Register(0x06, "r")
HZL = Register(0x07, "r")
HZH = Register(0x08, "r")
ST2 = Register(0x09, "r", reserved=0xF3)
CNTL = Register(0x0A, reserved=0xF0)
ASTC = Register(0x0C, reserved=0xBF)
ASAX = Register(0x10, "r")
ASAY = Register(0x11, "r")
ASAZ = Register(0x12, "r")

DATA_READY = ST1[0]
OVERFLOW = ST2[3]
DATA_ERROR = ST2[2]
MODE = CNTL[3:0]
SELF_TEST = ASTC[6]
