"""A bench for one emulated BMA180: a sensing element that records requests, and reads and writes at chosen times."""

from firmware_emulator.chips.bma180 import Bma180Chip
from tests.emulator.chip_bench import MS, KnownElement

BYTE_NS = 22_500  # 9 clocks at 400 kHz
LATER = 100 * MS  # booted and settled at 150 Hz


class Box(KnownElement):
    """A box at rest, or moving by `slope` g/s."""

    def __init__(self, g=(0.0, 0.0, 1.0), **options):
        super().__init__(g, **options)


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
