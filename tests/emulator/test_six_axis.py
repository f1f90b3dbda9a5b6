"""Timing of six-axis chips, beyond their golden conversations: torn readings, grids of samples, both halves."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import pytest

from firmware_emulator.chips import DIES
from firmware_emulator.chips.icm42688 import Icm42688Chip
from firmware_emulator.chips.lsm6dso import Lsm6dsoChip
from firmware_emulator.chips.mpu6500 import Mpu6500Chip
from firmware_emulator.six_axis import ACCELEROMETER, GYROSCOPE, SampleGrid, SixAxis
from tests.emulator.chip_bench import MS, ChipBench, KnownElement


def ramp(per_second: float = 1.0) -> KnownElement:
    """An element whose input is `per_second` times the time in seconds along each axis."""
    return KnownElement((0.0, 0.0, 0.0), (per_second,) * 3)


def bench_of(chip: SixAxis, *writes: str) -> ChipBench:
    """A chip on a slow wire, after some writes."""
    bench = ChipBench(chip, 100_000)
    for text in writes:
        bench.write(*bytes.fromhex(text))
    return bench


def words(data: bytes, order: str) -> list[int]:
    return [
        int.from_bytes(data[at : at + 2], "little" if order == "<" else "big", signed=True)
        for at in range(0, len(data), 2)
    ]


def lsm6dso(control: str) -> ChipBench:
    """1666 Hz at 2 g, on a ramp of 39 counts a sample, so that a byte carries at every seventh."""
    return bench_of(Lsm6dsoChip(0x6A, {ACCELEROMETER: ramp(4.0)}), control, "1080")


@pytest.mark.parametrize(("control", "torn"), [("1204", True), ("1244", False)])
def test_without_block_update_the_bytes_of_a_number_are_of_two_samples(control: str, torn: bool) -> None:
    """LSM-13: at 100 kHz two bytes are 90 us apart, and a sample comes each 600 us. A number made of the high byte of
    one and the low byte of another is off by 256 counts.
    """
    bench, result, steps = lsm6dso(control), [], 4.0 * 1000 / 0.061 / 1666
    for _ in range(300):
        bench.wait(0.73)
        x, y, z = words(bench.read(0x28, 6), "<")
        result += [abs(y - x), abs(z - y)]
    assert (max(result) > 200) == torn
    assert torn or max(result) <= steps + 1  # a sample may still come between two axes


@pytest.mark.parametrize(
    ("bench", "register", "order", "delay_s"),
    [
        (lambda: bench_of(Icm42688Chip(0x68, {ACCELEROMETER: ramp()}), "5066", "4e0f"), 0x1F, ">", 0.0),
        (lambda: bench_of(Mpu6500Chip(0x68, {ACCELEROMETER: ramp()}), "1a01"), 0x3B, ">", 1.94e-3),
    ],
    ids=["icm42688", "mpu6500"],
)
def test_a_burst_is_of_one_instant(bench: Callable[[], ChipBench], register: int, order: str, delay_s: float) -> None:
    """TDK-12, DEC-60, INV-75: at 100 kHz six bytes take half a millisecond, and a sample comes each millisecond. It is
    the input of the chip one filter delay earlier (INV-79).
    """
    there, per_unit = bench(), 16384.0
    there.wait(100)
    for _ in range(50):
        there.wait(0.37)
        x, y, z = words(there.read(register, 6), order)
        assert x == y == z
        input_s = there.clock.now_ns() * 1e-9 - delay_s
        assert x == pytest.approx(input_s * per_unit, abs=0.0021 * per_unit)


def test_each_half_of_an_lsm6dso_has_its_own_rate() -> None:
    """LSM-11, LSM-15: the accelerometer at 104 Hz, the gyroscope at 416 Hz."""
    chip = Lsm6dsoChip(0x6A, {ACCELEROMETER: ramp()})
    chip.take_element(GYROSCOPE, ramp(20.0))
    bench = bench_of(chip, "1244", "1040", "1160")
    fresh = [0, 0]
    for _ in range(400):
        bench.wait(0.1)
        status = bench.read(0x1E, 1)[0]
        for bit, register in ((0, 0x28), (1, 0x22)):
            if status >> bit & 1:
                fresh[bit] += 1
                bench.read(register, 6)
    seconds = bench.clock.now_ns() * 1e-9
    assert fresh[0] == pytest.approx(104 * seconds, abs=2)
    assert fresh[1] == pytest.approx(416 * seconds, abs=2)


def test_the_stall_of_an_icm_42688_lasts_2_ms_and_repeats_at_each_crossing() -> None:
    """TDK-18, DEC-63: a ramp of 1000 dps a second passes 100 dps once; 1 kHz, 2000 dps."""
    for control, held in (("4d91", True), ("4d51", False)):
        bench = bench_of(Icm42688Chip(0x68, {GYROSCOPE: ramp(1000.0)}), control, "4e0c")
        readings = []
        while bench.clock.now_ns() < 130 * MS:
            bench.wait(0.5)
            readings.append(words(bench.read(0x25, 2), ">")[0])
        steps = [b - a for a, b in pairwise(readings) if a != -32768]
        assert (max(steps) > 25) == held  # 16.4 counts a sample


def test_samples_fall_on_the_grid() -> None:
    grid = SampleGrid()
    assert grid.take(10**12) is None
    assert grid.set(100, 1000)
    assert grid.take(1099) is None
    assert grid.take(1100) == 1100
    assert grid.take(2099) is None
    assert grid.take(5500) == 5100
    assert not grid.set(5600, 1000)
    assert grid.take(6100) == 6100
    assert not grid.set(6500, 2000)
    assert grid.take(8499) is None
    assert grid.take(8500) == 8500
    grid.set(9000, 0)
    assert grid.take(10**12) is None


@pytest.mark.parametrize("name", DIES)
def test_a_second_element_for_a_half_is_refused(name: str) -> None:
    chip = DIES[name].build(0x68, {ACCELEROMETER: ramp()})
    chip.take_element(GYROSCOPE, ramp())
    with pytest.raises(ValueError, match="two sensors are the gyroscope"):
        chip.take_element(GYROSCOPE, ramp())
