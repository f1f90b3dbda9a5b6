"""The bypass of an MPU-9150 or MPU-9250: while it is open, the magnetometer on its own bus answers on the array's
(INV-97).
"""

from __future__ import annotations

from firmware_emulator.chip import Target
from firmware_emulator.chips.mpu_queue import MpuFamily

NOWHERE = -1


class BehindBypass:
    """A device that has its address while the bypass of `host` is open; always, while it has no host."""

    def __init__(self, device: Target) -> None:
        self.device = device
        self.host: MpuFamily | None = None

    @property
    def address(self) -> int:
        """The device's address; an unused one while the bypass is open."""
        return self.device.address if self.host is None or self.host.bypass_open else NOWHERE

    @address.setter
    def address(self, value: int) -> None:
        self.device.address = value

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """See `Target`."""
        return self.device.write(data, at_ns, byte_ns)

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """See `Target`."""
        return self.device.read(count, at_ns, byte_ns)

    def stop(self, at_ns: int) -> None:
        """See `Target`."""
        self.device.stop(at_ns)
