"""The faster path of each chip for its usual burst sends the same bytes as single reads."""

import math
import random

import pytest

from firmware_emulator.chip import Chip, Triple
from firmware_emulator.chips.adxl345 import Adxl345Chip
from firmware_emulator.chips.bma180 import Bma180Chip
from firmware_emulator.chips.l3g4200d import L3g4200dChip

BYTE_NS = 22_500  # nine clocks at 400 kHz


class Swinging:
    """An element whose input depends on the time alone, and exceeds the range."""

    def sample(self, at_ns: int, full_scale: float, bandwidth_hz: float) -> Triple:
        x, y, z = (1.2 * full_scale * math.sin(at_ns * 1e-9 * turn) for turn in (3.1, 5.3, 7.9))
        return x, y, z

    def temperature(self, at_ns: int) -> float:
        return 30.0 + 20.0 * math.sin(at_ns * 1e-9)

    def pressure(self, at_ns: int) -> float:
        return 101325.0


@pytest.mark.parametrize(
    ("kind", "setting", "register", "count"),
    [
        (Bma180Chip, b"", 0x02, 6),
        (Bma180Chip, b"", 0x02, 7),
        (Adxl345Chip, b"\x2d\x08", 0x30, 8),  # POWER_CTL: measure
        (Adxl345Chip, b"\x2d\x08", 0x32, 6),
        (L3g4200dChip, b"\x20\x0f", 0xA6, 8),  # CTRL_REG1: 100 Hz, all axes
        (L3g4200dChip, b"\x20\x0f", 0xA8, 6),
    ],
)
def test_a_burst_equals_single_byte_reads(kind: type[Chip], setting: bytes, register: int, count: int) -> None:
    burst_chip, byte_chip = kind(0x40, Swinging()), kind(0x40, Swinging())
    for chip in (burst_chip, byte_chip):
        chip.write(setting, 20_000_000, BYTE_NS)
        chip.stop(20_100_000)
    randomly, at_ns = random.Random(0), 20_200_000
    answers = set()
    for _ in range(600):
        at_ns += randomly.choice((150_000, 400_000, 2_000_000, 20_000_000)) + randomly.randrange(300_000)
        for chip in (burst_chip, byte_chip):
            assert chip.write(bytes((register,)), at_ns, BYTE_NS) == 1
        answer = burst_chip.read(count, at_ns + 2 * BYTE_NS, BYTE_NS)
        assert answer == Chip.read(byte_chip, count, at_ns + 2 * BYTE_NS, BYTE_NS)
        assert burst_chip.pointer == byte_chip.pointer
        for chip in (burst_chip, byte_chip):
            chip.stop(at_ns + (2 + count) * BYTE_NS)
        at_ns += (2 + count) * BYTE_NS
        answers.add(answer)
    assert len(answers) > 200
