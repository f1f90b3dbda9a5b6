"""HMC5883 and HMC5883L magnetometers: Honeywell Form 900405 Rev A (2010) and Rev E, register list.

Facts HMC-01, HMC-10 ... HMC-17. The two share every address and the identity bytes; gains, averaging and timing differ.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x1E,)  # fixed: HMC-01

CONFIG_A = Register(0x00, reset=0x10, reserved=0x80)
CONFIG_B = Register(0x01, reset=0x20, reserved=0x1F)
MODE = Register(
    0x02, reset=0x01, reserved=0x7C, readback_bytes=7
)  # with the data behind it: alone it locks them, HMC-34
DATA_X_MSB = Register(0x03, "r")
DATA_X_LSB = Register(0x04, "r")
DATA_Z_MSB = Register(0x05, "r")
DATA_Z_LSB = Register(0x06, "r")
DATA_Y_MSB = Register(0x07, "r")
DATA_Y_LSB = Register(0x08, "r")
STATUS = Register(0x09, "r", reserved=0xF8)
IDENTITY_A = Register(0x0A, "r", reset=0x48)
IDENTITY_B = Register(0x0B, "r", reset=0x34)
IDENTITY_C = Register(0x0C, "r", reset=0x33)

AVERAGING = CONFIG_A[6:5]
OUTPUT_RATE = CONFIG_A[4:2]
MEASUREMENT_BIAS = CONFIG_A[1:0]
GAIN = CONFIG_B[7:5]
HIGH_SPEED = MODE[7]
OPERATION = MODE[1:0]
REGULATOR = STATUS[2]
LOCK = STATUS[1]
READY = STATUS[0]
