"""The longest read of each bus in one transaction, and the longest that all of them can carry.

Drivers use the latter, so that a transcript of one bus can replace another bus: reads of a chip are then split in the
same way on all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from imuarray.bus import linux, serial_link, spi

LONGEST_READS: Mapping[str, int] = MappingProxyType(
    {
        "i2c:": linux.MAX_MESSAGE,  # `i2cdev_ioctl_rdwr`; SMBus blocks of 32 bytes are not used: LNX-05
        "spi:": spi.MAX_MESSAGE - 1,  # spidev's default `bufsiz`, in which the register's address comes first
        "serial:": serial_link.MAX_PAYLOAD - 1,  # a frame of the link, in which the result comes first
    }
)
"""Bytes by bus."""
LONGEST_READ = min(LONGEST_READS.values())
