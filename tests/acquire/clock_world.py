"""A world that is a clock: the specific force along x is the share of the present second that has passed.

Arrays of six-axis chips with queues, whose rows show when they were taken.
"""

from __future__ import annotations

from firmware_emulator.chip import Triple

SPAN_G = 32.0
ADDRESSES = {"icm42688": 0x68, "lsm6dso": 0x6A, "mpu6050": 0x68, "mpu6500": 0x68}


class ClockElement:
    """Feels the share of the second that has passed."""

    def sample(self, at_ns: int, full_scale: float, bandwidth_hz: float) -> Triple:
        share = at_ns % 1_000_000_000 * 1e-9
        return (share - 0.5) * SPAN_G * 0.999, 0.0, 0.0

    def temperature(self, at_ns: int) -> float:
        return 25.0

    def pressure(self, at_ns: int) -> float:
        return 101325.0


def array_text(die: str, rate_hz: int, *, on_spi: bool) -> str:
    place = 'bus = "/dev/spidev0.0"' if on_spi else f"address = {ADDRESSES[die]:#x}"
    text = '[array]\nname = "a"\n'
    for half, full_scale in (("acc", 16), ("gyro", 500)):
        text += f'[[sensor]]\nname = "{half}"\nchip = "{die}"\n{place}\nrange = {full_scale}\nrate_hz = {rate_hz}\n'
        text += "fifo = true\n"
    return text
