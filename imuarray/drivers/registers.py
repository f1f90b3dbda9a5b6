"""A chip's registers as a driver uses them: read, write, read-modify-write, and nothing believed that was not read
back.
"""

from __future__ import annotations

from imuarray.bus.protocol import Bus
from imuarray.errors import NOT_ACKNOWLEDGED, SensorError
from imuarray.facts.registers import Register, Setting


class Registers:
    """The registers of one chip at `address` of `bus`; `label` names it in messages ("BMA2 (bma180) at channel 0
    ...").
    """

    def __init__(self, bus: Bus, address: int, label: str) -> None:
        self.bus = bus
        self.address = address
        self.label = label

    def peek(self, register: Register, count: int = 1) -> bytes:
        """`count` bytes from `register` on, in one transaction."""
        return self.bus.transfer(self.address, bytes([register.address]), count)

    def read_back(self, register: Register) -> int:
        """What the register holds, of a chip that goes on measuring."""
        return self.peek(register, register.readback_bytes)[0]

    def poke(self, register: Register, value: int) -> None:
        """Write a whole register."""
        self.bus.transfer(self.address, bytes([register.address, value]))

    def change(self, setting: Setting) -> None:
        """Read-modify-write: bits beside the setting (a factory trim, say) keep their value."""
        self.poke(setting.register, setting.into(self.peek(setting.register)[0]))

    def set(self, *settings: Setting) -> None:
        """Write each setting as a whole register and read it back, one after the other; SensorError as `verify`."""
        for setting in settings:
            self.poke(setting.register, setting.value)
            self.verify(setting)

    def verify(self, setting: Setting) -> None:
        """SensorError if the chip did not keep `setting`."""
        kept = self.peek(setting.register)[0]
        if kept & setting.mask != setting.value:
            raise SensorError(
                f"{self.label}: register {setting.register.address:#04x} reads {kept:#04x} after"
                f" {setting.into(kept):#04x} was written; the chip refuses its configuration"
            )

    def expect(self, *registers: Register) -> None:
        """SensorError unless somebody answers and the identity registers hold what the data sheet says."""
        try:
            found = b"".join(self.peek(register) for register in registers)
        except OSError as error:
            if error.errno not in NOT_ACKNOWLEDGED:
                raise SensorError(f"{self.label}: the bus fails: {error.strerror or error}") from error
            raise SensorError(f"{self.label}: nobody acknowledges this address") from error
        expected = bytes(register.reset for register in registers)
        if found != expected:
            raise SensorError(f"{self.label}: identity {found.hex(' ')}, expected {expected.hex(' ')}")
