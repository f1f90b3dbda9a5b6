"""CPU time of a transaction on the Linux path, against smbus2's own way with fresh messages.

Both sides read the six data bytes of an ADXL345 through an opened device, in the same run; the ioctl itself is replaced
by a function that does nothing, so that only what Python does around it is compared.
"""

from __future__ import annotations

import fcntl
import time
from collections.abc import Callable
from typing import Any

import smbus2.smbus2
from smbus2 import SMBus, i2c_msg

from firmware_emulator.clock import VirtualClock
from firmware_emulator.device_file import Adapter, device_files
from firmware_emulator.wire import Wire
from imuarray.bus.linux import LinuxBus

PATH, ADDRESS, REGISTER, COUNT = "/dev/i2c-1", 0x53, b"\x32", 6
CALLS, REPEATS = 20_000, 7


def rows() -> list[dict[str, Any]]:
    """One row: `ours` and `peer` in microseconds a transaction, the least of several turns taken alternately."""
    ours_us, peer_us = measured()
    return [
        {
            "name": "Linux path, CPU a transaction, ioctl left out: LinuxBus.transfer against smbus2 i2c_rdwr",
            "ours": ours_us,
            "peer": peer_us,
            "unit": "us",
            "ratio": ours_us / peer_us,
            "target": 1 / 3,
            "better": "lower",
        }
    ]


def measured() -> tuple[float, float]:
    """Microseconds a transaction, ours and smbus2's."""
    adapter = Adapter(Wire(VirtualClock()))
    with device_files({PATH: adapter}), LinuxBus(PATH) as ours, SMBus(PATH) as peer:
        return without_ioctl(lambda: ours.transfer(ADDRESS, REGISTER, COUNT), lambda: fresh_messages(peer))


def fresh_messages(bus: SMBus) -> bytes:
    """A transaction as smbus2's documentation shows it."""
    read = i2c_msg.read(ADDRESS, COUNT)
    bus.i2c_rdwr(i2c_msg.write(ADDRESS, REGISTER), read)
    return bytes(read)


def without_ioctl(ours: Callable[[], bytes], peer: Callable[[], bytes]) -> tuple[float, float]:
    """Both timed with an ioctl that does nothing."""
    kept = fcntl.ioctl, smbus2.smbus2.ioctl
    fcntl.ioctl = smbus2.smbus2.ioctl = nothing  # type: ignore[assignment]  # that is the purpose
    try:
        turns = [(microseconds(ours), microseconds(peer)) for _ in range(REPEATS)]
    finally:
        fcntl.ioctl, smbus2.smbus2.ioctl = kept
    return min(turn[0] for turn in turns), min(turn[1] for turn in turns)


def nothing(*_: Any) -> int:
    """An ioctl that costs next to nothing."""
    return 0


def microseconds(call: Callable[[], bytes]) -> float:
    """CPU time of one call."""
    begun_ns = time.process_time_ns()
    for _ in range(CALLS):
        call()
    return (time.process_time_ns() - begun_ns) / CALLS / 1000


if __name__ == "__main__":
    for row in rows():
        print(row)
