"""The emulated BMP180 against the worked example and vectors of its data sheet (facts BMP-..)."""

import random
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_emulator.chips.bmp180 import Bmp180Chip, Bmp180Words, b5_of, pressure_function, up_of, ut_of

MS = 1_000_000
BYTE_NS = 22_500
LATER = 100 * MS
T_COMMAND, P_COMMANDS = 0x2E, (0x34, 0x74, 0xB4, 0xF4)  # BMP-40 ... BMP-44
EXAMPLE_DEGC = 2399 / 160  # B5 of the worked example


class Weather:
    """Constant temperature and pressure."""

    def __init__(self, degc=EXAMPLE_DEGC, pascal=69964.0):
        self.degc, self.pascal = degc, pascal

    def sample(self, at_ns, full_scale, bandwidth_hz):
        raise NotImplementedError

    def temperature(self, at_ns):
        return self.degc

    def pressure(self, at_ns):
        return self.pascal


def poke(chip, register, value, at=LATER):
    assert chip.write(bytes((register, value)), at - BYTE_NS, BYTE_NS) == 2
    chip.stop(at)


def peek(chip, register, count=1, at=LATER):
    chip.write(bytes((register,)), at, BYTE_NS)
    return chip.read(count, at, BYTE_NS)


def result(chip, command, at=LATER):
    """The 24 bits of a conversion that has had 26 ms."""
    poke(chip, 0xF4, command, at)
    return int.from_bytes(peek(chip, 0xF6, 3, at + 26 * MS), "big")


def compensated(ut, up, oss):
    """degC and Pa by the formulas of BMP-60 ... BMP-63 in real numbers, nothing rounded."""
    x1 = (ut - 23153) * 32757 / 2**15
    b5 = x1 - 8711 * 2**11 / (x1 + 2868)
    b6 = b5 - 4000
    b3 = ((408 * 4 + 4 * b6 * b6 / 2**23 - 72 * b6 / 2**11) * 2**oss + 2) / 4
    b4 = 32741 * ((-14383 * b6 / 2**13 + 6190 * b6 * b6 / 2**28 + 2) / 4 + 32768) / 2**15
    p = 2 * (up - b3) * 50000 / 2**oss / b4
    return b5 / 160, p + (3038 * p * p / 2**32 - 7357 * p / 2**16 + 3791) / 16


def test_identity_calibration_and_reset_values():
    chip = Bmp180Chip(0x77, Weather())
    assert peek(chip, 0xD0) == b"\x55"
    assert peek(chip, 0xAA, 22) == bytes.fromhex("0198 ffb8 c7d1 7fe5 7ff5 5a71 182e 0004 8000 ddf9 0b34")  # BMP-20 ...
    assert peek(chip, 0xF4) + peek(chip, 0xF6, 3) == bytes.fromhex("00 80 00 00")  # BMP-13 ... BMP-16
    poke(chip, 0xAA, 0x00)
    assert peek(chip, 0xAA) == b"\x01"


def test_calibration_words_can_be_replaced():
    chip = Bmp180Chip(0x77, Weather(25.0), calibration={"AC5": 40000, "MC": -11786})
    assert peek(chip, 0xB2, 2) + peek(chip, 0xBC, 2) == bytes.fromhex("9c40 d1f6")
    assert result(chip, T_COMMAND) != result(Bmp180Chip(0x77, Weather(25.0)), T_COMMAND)


def test_the_worked_example_is_reproduced():
    chip = Bmp180Chip(0x77, Weather())
    assert result(chip, T_COMMAND) == 27898 << 8
    assert result(chip, P_COMMANDS[0], 2 * LATER) == 23843 << 8


@pytest.mark.parametrize(  # BMP-63 and BMP-65
    ("oss", "up", "pascal"),
    [(0, 23843, 69964), (1, 47686, 69962), (2, 95372, 69963), (3, 190744, 69963), (0, 46000, 136329)],
)
def test_pressure_vectors_both_ways(oss, up, pascal):
    assert pressure_function(Bmp180Words(), 2399, oss)[1](up) == pascal
    result = up_of(Bmp180Words(), 27898, oss, pascal)
    assert pressure_function(Bmp180Words(), 2399, oss)[1](result) == pascal
    assert abs(result - up) <= 1 << oss  # neighbouring words give the same pascal


@pytest.mark.parametrize(("ut", "tenths"), [(27898, 150), (30000, 313), (24000, -247)])
def test_temperature_vectors_both_ways(ut, tenths):
    assert b5_of(Bmp180Words(), ut) + 8 >> 4 == tenths
    assert abs(ut_of(Bmp180Words(), tenths / 10) - ut) <= 10  # 160 steps of B5 to a degree


@given(st.floats(-20.0, 65.0), st.floats(30_000.0, 110_000.0), st.integers(0, 3))
def test_raw_words_match_the_real_valued_formulas(degc, pascal, oss):
    ut = ut_of(Bmp180Words(), degc)
    back_degc, back_pascal = compensated(ut, up_of(Bmp180Words(), ut, oss, pascal), oss)
    assert abs(back_degc - degc) < 0.02  # a step of UT is 0.006 degC
    # A step of UP at oss 0 is 3 to 4 Pa; B4 is rounded to 1 in 33000, which costs as much again at 110 kPa.
    assert abs(back_pascal - pascal) < 8


@given(st.floats(-500.0, 500.0), st.floats(-1e6, 1e7), st.integers(0, 3))
def test_raw_words_of_impossible_weather_are_within_their_bits(degc, pascal, oss):
    ut = ut_of(Bmp180Words(), degc)
    assert 0 <= ut <= 0xFFFF
    assert 0 <= up_of(Bmp180Words(), ut, oss, pascal) < 1 << 16 + oss


@pytest.mark.parametrize(("command", "typical_ms"), [(0x2E, 3), (0x34, 3), (0x74, 5), (0xB4, 9), (0xF4, 17)])
def test_a_conversion_takes_its_typical_time(command, typical_ms):
    chip = Bmp180Chip(0x77, Weather())
    poke(chip, 0xF4, command)
    end = LATER + typical_ms * MS
    assert peek(chip, 0xF4, at=end - 1000) == bytes((command,))
    assert peek(chip, 0xF6, 2, at=end - BYTE_NS - 1000) == b"\x80\x00"  # still the reset pattern
    assert peek(chip, 0xF4, at=end) == bytes((command & ~0x20,))  # sco, BMP-46
    assert peek(chip, 0xF6, 2, at=end) != b"\x80\x00"


def test_a_read_before_the_end_gives_the_previous_result():
    chip = Bmp180Chip(0x77, Weather())
    result(chip, T_COMMAND)
    poke(chip, 0xF4, P_COMMANDS[3], at=2 * LATER)
    assert peek(chip, 0xF6, 3, at=2 * LATER + 16 * MS) == bytes.fromhex("6cfa00")  # UT 27898: BMP-48
    assert peek(chip, 0xF6, 3, at=2 * LATER + 18 * MS) != bytes.fromhex("6cfa00")


def test_pressure_words_are_left_aligned_in_24_bits():
    for oss, command in enumerate(P_COMMANDS):
        raw = result(Bmp180Chip(0x77, Weather()), command)
        assert raw % (1 << 8 - oss) == 0
        assert abs((raw >> 8 - oss) / (1 << oss) - 23843) < 1  # BMP-47


def test_results_change_only_on_command():
    weather = Weather()
    chip = Bmp180Chip(0x77, weather)
    first = result(chip, T_COMMAND)
    weather.degc = 30.0
    assert peek(chip, 0xF6, 3, at=2 * LATER) == first.to_bytes(3, "big")  # BMP-49
    assert result(chip, T_COMMAND, 3 * LATER) > first


@pytest.mark.parametrize("command", [0x0E, 0x14, 0x20, 0x3F])
def test_other_commands_start_nothing(command):
    chip = Bmp180Chip(0x77, Weather())
    assert result(chip, command) == 0x800000
    assert peek(chip, 0xF4) == bytes((command & ~0x20,))


def test_a_second_command_replaces_the_first():
    chip = Bmp180Chip(0x77, Weather())
    poke(chip, 0xF4, P_COMMANDS[3])
    poke(chip, 0xF4, T_COMMAND, at=LATER + MS)
    assert peek(chip, 0xF6, 3, at=LATER + 50 * MS) == bytes.fromhex("6cfa00")


def test_a_soft_reset_clears_the_result_and_takes_the_start_up_time():
    chip = Bmp180Chip(0x77, Weather())
    result(chip, T_COMMAND)
    poke(chip, 0xE0, 0xB5, at=2 * LATER)
    assert peek(chip, 0xF6, at=2 * LATER) == b"\x6c"
    poke(chip, 0xE0, 0xB6, at=2 * LATER)
    assert peek(chip, 0xF6, 3, at=2 * LATER) + peek(chip, 0xF4) + peek(chip, 0xE0) == bytes.fromhex("8000000000")
    poke(chip, 0xF4, T_COMMAND, at=2 * LATER + 5 * MS)  # lost: start-up takes 10 ms, BMP-50
    assert peek(chip, 0xF6, 3, at=2 * LATER + 9 * MS) == b"\x80\x00\x00"
    assert result(chip, T_COMMAND, 3 * LATER) == 27898 << 8
    chip = Bmp180Chip(0x77, Weather(), start_up_ns=0)
    assert result(chip, T_COMMAND, MS) == 27898 << 8


@pytest.mark.parametrize(("oss", "rms"), [(0, 6.0), (1, 5.0), (2, 4.0), (3, 3.0)])
def test_pressure_noise_is_that_of_the_data_sheet(oss, rms):
    chip = Bmp180Chip(0x77, Weather(pascal=100_000.0), generator=random.Random(oss))
    b5 = b5_of(Bmp180Words(), result(chip, T_COMMAND) >> 8)
    pressure = pressure_function(Bmp180Words(), b5, oss)[1]
    drawn = [pressure(result(chip, P_COMMANDS[oss], n * LATER) >> 8 - oss) for n in range(2, 402)]
    # 400 draws: 5 sigma is 18 % of the rms; quantisation at oss 0 adds 1 % to 6 Pa
    assert abs(statistics.pstdev(drawn) - rms) < 0.2 * rms
    assert abs(statistics.fmean(drawn) - 100_000) < 5 * rms / 20 + 1
