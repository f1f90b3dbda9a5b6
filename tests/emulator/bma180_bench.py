"""A bench for one emulated BMA180: a sensing element that records requests, and reads and writes at chosen times."""

from firmware_emulator.chips.bma180 import Bma180Chip

MS = 1_000_000
BYTE_NS = 22_500  # 9 clocks at 400 kHz
LATER = 100 * MS  # booted and settled at 150 Hz


class Box:
    """A sensing element at rest, or moving by `slope` g/s; records each request."""

    def __init__(self, g=(0.0, 0.0, 1.0), degc=25.0, slope=(0.0, 0.0, 0.0)):
        self.g, self.degc, self.slope = g, degc, slope
        self.asked = []

    def sample(self, at_ns, full_scale, bandwidth_hz):
        self.asked.append((at_ns, full_scale, bandwidth_hz))
        x, y, z = (g + slope * at_ns * 1e-9 for g, slope in zip(self.g, self.slope, strict=True))
        return x, y, z

    def temperature(self, at_ns):
        return self.degc

    def pressure(self, at_ns):
        return 101325.0


def poke(chip, *pairs, at=LATER):
    """Register and value, one after the other, in one transaction; how many bytes were acknowledged."""
    acknowledged = chip.write(bytes(pairs), at, BYTE_NS)
    chip.stop(at)
    return acknowledged


def peek(chip, register, count=1, at=LATER, byte_ns=BYTE_NS):
    chip.write(bytes((register,)), at, byte_ns)
    data = chip.read(count, at, byte_ns)
    chip.stop(at)
    return data


def codes(chip, at=LATER):
    data = peek(chip, 0x02, 6, at=at)
    return tuple(int.from_bytes(data[i : i + 2], "little", signed=True) >> 2 for i in (0, 2, 4))


def unlocked(box=None, **switches):
    chip = Bma180Chip(0x40, box or Box(), **switches)
    poke(chip, 0x0D, 0x10, at=20 * MS)
    return chip
