"""The MPU-6050's behaviour beyond its golden conversations, worked out by hand from the register map."""

from __future__ import annotations

from itertools import pairwise

import pytest

from firmware_emulator.chips.mpu6050 import Mpu6050Chip
from firmware_emulator.six_axis import ACCELEROMETER, GYROSCOPE
from tests.emulator.chip_bench import ChipBench, KnownElement

RAMP = KnownElement((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), degc=35.0)
"""Its x is the time in seconds."""


class Bench(ChipBench):
    """A chip with both elements, awake at 1 kHz with its 184 Hz filter, on a wire of its own."""

    def __init__(self) -> None:
        self.die = Mpu6050Chip(0x68, {ACCELEROMETER: RAMP}, 0)
        self.die.take_element(GYROSCOPE, RAMP)
        super().__init__(self.die)
        self.write(0x6B, 0x01, 0x1A, 0x01)


def word(data: bytes, at: int = 0) -> int:
    return int.from_bytes(data[at : at + 2], "big", signed=True)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_second_element_for_a_half_is_refused(bench: Bench) -> None:
    with pytest.raises(ValueError, match="two sensors are the gyroscope"):
        bench.die.take_element(GYROSCOPE, RAMP)


@pytest.mark.parametrize(("filter_code", "divider", "period_ms"), [(1, 9, 10.0), (0, 79, 10.0), (1, 199, 200.0)])
def test_samples_have_the_rate_of_the_divider(bench: Bench, filter_code: int, divider: int, period_ms: float) -> None:
    """8 kHz / 80 and 1 kHz / 10 are one rate (INV-11); a ramp of 16384 counts a second shows the time of a sample."""
    bench.write(0x1A, filter_code)
    bench.write(0x19, divider)
    bench.wait(1000)
    first = word(bench.read(0x3B, 14))
    bench.wait(3 * period_ms)
    assert word(bench.read(0x3B, 14)) - first == pytest.approx(3 * period_ms * 16.384, abs=1)
    assert bench.read(0x3A) == b"\x01"
    bench.wait(period_ms / 4)
    before = bench.read(0x3B, 14)
    bench.wait(0.1)
    assert bench.read(0x3B, 14) == before


def test_a_burst_is_of_one_instant(bench: Bench) -> None:
    """Fourteen bytes take 0.4 ms at 400 kHz, and a sample comes each millisecond (INV-30)."""
    for _ in range(50):
        bench.wait(0.37)
        data = bench.read(0x3B, 14)
        assert word(data, 8) == pytest.approx(word(data) * 131 / 16384, abs=1)


def test_a_new_range_applies_to_the_next_sample(bench: Bench) -> None:
    bench.wait(900)
    bench.write(0x1C, 0x18)
    bench.wait(2)
    assert word(bench.read(0x3B, 2)) == pytest.approx(2048 * bench.clock.now_ns() * 1e-9, abs=5)


def test_with_int_rd_clear_any_read_clears_the_status(bench: Bench) -> None:
    bench.wait(5)
    bench.write(0x37, 0x10)
    bench.write(0x19, 0xFF)
    bench.read(0x75)
    assert bench.read(0x3A) == b"\x00"


def test_the_queue_holds_every_sample_while_it_is_drained(bench: Bench) -> None:
    """A ramp of one count a sample shows a missing or repeated one: 1 / 131 s apart is one count of the gyroscope."""
    bench.write(0x19, 4)  # 200 Hz
    bench.write(0x23, 0x08)
    bench.write(0x6A, 0x44)
    values = []
    for _ in range(20):
        bench.wait(61)
        count = int.from_bytes(bench.read(0x72, 2), "big")
        assert count % 6 == 0
        data = bench.read(0x74, count)
        values += [word(data, at) for at in range(0, count, 6)]
    steps = {b - a for a, b in pairwise(values)}
    assert len(values) == pytest.approx(20 * 61 / 5, abs=15)
    assert steps <= {81, 82}  # 16384 counts a second, 200 samples a second: 81.92


def test_an_overflow_loses_the_oldest_samples_and_is_flagged(bench: Bench) -> None:
    bench.write(0x23, 0x08)
    bench.write(0x6A, 0x44)
    bench.read(0x3A)
    bench.wait(160)  # 960 bytes
    assert bench.read(0x3A)[0] & 0x10 == 0
    bench.wait(100)
    assert bench.read(0x3A)[0] & 0x10 == 0x10
    assert int.from_bytes(bench.read(0x72, 2), "big") == 1024
