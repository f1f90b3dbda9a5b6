"""PCA9544A multiplexer: NXP data sheet Rev 5 (2014), control register.

Facts PCA-01 ... PCA-05. There is one register and no register address: the control byte follows the address byte.
"""

from imuarray.facts.registers import Register

ADDRESSES = tuple(range(0x70, 0x78))  # pins A2 A1 A0: PCA-01
CHANNELS = (0, 1, 2, 3)

CONTROL = Register(0x00, reserved=0x08)

INTERRUPTS = CONTROL[7:4]
ENABLE = CONTROL[2]
CHANNEL = CONTROL[1:0]
