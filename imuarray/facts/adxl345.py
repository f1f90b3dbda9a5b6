"""ADXL345 accelerometer: Analog Devices data sheet Rev. E (2015), register map and register definitions.

Facts ADX-01, ADX-10 ... ADX-30. There is no soft reset and 0x01 ... 0x1C must not be touched.
"""

from imuarray.facts.registers import Register

ADDRESSES = (0x53, 0x1D)  # ALT ADDRESS low, high: ADX-01

DEVID = Register(0x00, "r", reset=0xE5)
THRESH_TAP = Register(0x1D)
OFSX = Register(0x1E)
OFSY = Register(0x1F)
OFSZ = Register(0x20)
DUR = Register(0x21)
LATENT = Register(0x22)
WINDOW = Register(0x23)
THRESH_ACT = Register(0x24)
THRESH_INACT = Register(0x25)
TIME_INACT = Register(0x26)
ACT_INACT_CTL = Register(0x27)
THRESH_FF = Register(0x28)
TIME_FF = Register(0x29)
TAP_AXES = Register(0x2A, reserved=0xF0)
ACT_TAP_STATUS = Register(0x2B, "r")
BW_RATE = Register(0x2C, reset=0x0A, reserved=0xE0)
POWER_CTL = Register(0x2D, reserved=0xC0)
INT_ENABLE = Register(0x2E)
INT_MAP = Register(0x2F)
INT_SOURCE = Register(0x30, "r")
DATA_FORMAT = Register(0x31, reserved=0x10)
DATAX0 = Register(0x32, "r")
DATAX1 = Register(0x33, "r")
DATAY0 = Register(0x34, "r")
DATAY1 = Register(0x35, "r")
DATAZ0 = Register(0x36, "r")
DATAZ1 = Register(0x37, "r")
FIFO_CTL = Register(0x38)
FIFO_STATUS = Register(0x39, "r", reserved=0x40)

LOW_POWER = BW_RATE[4]
RATE = BW_RATE[3:0]
LINK = POWER_CTL[5]
AUTO_SLEEP = POWER_CTL[4]
MEASURE = POWER_CTL[3]
SLEEP = POWER_CTL[2]
WAKEUP = POWER_CTL[1:0]
DATA_READY = INT_SOURCE[7]
EVENTS = INT_SOURCE[6:2]
WATERMARK = INT_SOURCE[1]
OVERRUN = INT_SOURCE[0]
SELF_TEST = DATA_FORMAT[7]
SPI = DATA_FORMAT[6]
INT_INVERT = DATA_FORMAT[5]
FULL_RES = DATA_FORMAT[3]
JUSTIFY = DATA_FORMAT[2]
RANGE = DATA_FORMAT[1:0]
FIFO_MODE = FIFO_CTL[7:6]
TRIGGER = FIFO_CTL[5]
SAMPLES = FIFO_CTL[4:0]
FIFO_TRIG = FIFO_STATUS[7]
ENTRIES = FIFO_STATUS[5:0]
