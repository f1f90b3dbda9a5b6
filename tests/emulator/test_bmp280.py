"""The emulated BMP280: noise, filter and the rhythm of normal mode, which no golden conversation can show."""

from __future__ import annotations

import random
import statistics

import pytest

from firmware_emulator.chips.bmp280 import Bmp280Chip, Bmp280Words, fine_of, pascal_of, up_of, ut_of

MS = 1_000_000


class Weather:
    """Constant temperature, pressure by time."""

    def __init__(self, *steps: tuple[int, float]) -> None:
        self.steps = steps or ((0, 100_000.0),)

    def sample(self, at_ns: int, full_scale: float, bandwidth_hz: float) -> tuple[float, float, float]:
        raise NotImplementedError

    def temperature(self, at_ns: int) -> float:
        return 25.0

    def pressure(self, at_ns: int) -> float:
        return next(pascal for begin_ns, pascal in reversed(self.steps) if at_ns >= begin_ns)


def poke(chip: Bmp280Chip, register: int, value: int, at_ns: int) -> None:
    chip.write(bytes((register, value)), at_ns, 0)


def shown(chip: Bmp280Chip, at_ns: int) -> tuple[float, float]:
    """degC and Pa in the data registers."""
    chip.write(b"\xf7", at_ns, 0)
    data = chip.read(6, at_ns, 22_500)
    up, ut = int.from_bytes(data[:3], "big") >> 4, int.from_bytes(data[3:], "big") >> 4
    fine = fine_of(chip.words, ut)
    return fine / 5120, pascal_of(chip.words, fine, up)


@pytest.mark.parametrize(("code", "rms"), [(1, 3.3), (2, 2.6), (3, 2.1), (4, 1.6), (5, 1.3)])
def test_pressure_noise_is_that_of_the_data_sheet(code: int, rms: float) -> None:
    """BMP-125. 400 draws: 5 sigma is 18 % of the rms; steps at x1 are 2.6 Pa, which adds 3 % to 3.3 Pa."""
    chip = Bmp280Chip(0x76, Weather(), generator=random.Random(code))
    drawn = []
    for number in range(1, 401):
        poke(chip, 0xF4, 0b001_000_01 | code << 2, number * 100 * MS)
        drawn.append(shown(chip, number * 100 * MS + 50 * MS)[1])
    assert statistics.pstdev(drawn) == pytest.approx(rms, rel=0.21)
    assert statistics.fmean(drawn) == pytest.approx(100_000, abs=5 * rms / 20 + 0.2)


def test_results_change_only_on_command() -> None:
    chip = Bmp280Chip(0x76, Weather((0, 100_000.0), (500 * MS, 90_000.0)))
    poke(chip, 0xF4, 0x55, 100 * MS)
    assert shown(chip, 200 * MS)[1] == pytest.approx(100_000, abs=0.5)
    assert shown(chip, 900 * MS)[1] == pytest.approx(100_000, abs=0.5)
    poke(chip, 0xF4, 0x55, 900 * MS)
    assert shown(chip, 1000 * MS)[1] == pytest.approx(90_000, abs=0.5)


def test_normal_mode_measures_after_each_pause() -> None:
    """BMP-107 to -109: x1 and x1 take 5.5 ms, the pause of code 1 is 62.5 ms: a result every 68 ms."""
    steps = [(number * MS, 90_000.0 + 10 * number) for number in range(300)]
    chip = Bmp280Chip(0x76, Weather(*steps))
    poke(chip, 0xF5, 0b001_000_00, 10 * MS)
    poke(chip, 0xF4, 0b001_001_11, 10 * MS)
    seen = [round((shown(chip, at * MS)[1] - 90_000) / 10) for at in range(16, 300)]
    assert sorted(set(seen)) == pytest.approx([15, 83, 151, 219, 287], abs=1)


def test_the_filter_settles_in_the_samples_of_the_data_sheet() -> None:
    """BMP-110: 75 % of a step after 2, 5, 11 and 22 samples with coefficients 2, 4, 8 and 16."""
    needed = []
    for code in (1, 2, 3, 4):
        chip = Bmp280Chip(0x76, Weather((0, 100_000.0), (1050 * MS, 99_000.0)))
        poke(chip, 0xF5, code << 2, 10 * MS)
        for number in range(1, 11):
            poke(chip, 0xF4, 0x25, number * 100 * MS)
        shown(chip, 1040 * MS)
        count, pascal = 0, 100_000.0
        while pascal > 99_250.0:
            count += 1
            poke(chip, 0xF4, 0x25, (1000 + count * 100) * MS)
            pascal = shown(chip, (1000 + count * 100 + 50) * MS)[1]
        needed.append(count)
    assert needed == [2, 5, 11, 22]


def test_raw_words_of_impossible_weather_are_within_their_bits() -> None:
    for degc in (-500.0, 0.0, 500.0):
        ut = ut_of(Bmp280Words(), degc)
        assert 0 <= ut < 1 << 20
        for pascal in (-1e6, 0.0, 1e7):
            assert 0 <= up_of(Bmp280Words(), ut, pascal) < 1 << 20
