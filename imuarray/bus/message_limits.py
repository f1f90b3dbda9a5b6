"""The longest read that each bus carries in one transaction, and the longest that all of them carry.

Drivers keep to the latter, so that a transcript of one bus can be replayed in the place of another: the same chip is
then asked in the same pieces everywhere.
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
