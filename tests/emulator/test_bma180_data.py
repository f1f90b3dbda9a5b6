"""Data of the emulated BMA180 against bytes and times printed in its data sheet (facts BMA-.., choices DEC-..)."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_emulator.chip import Chip
from firmware_emulator.chips.bma180 import Bma180Chip
from tests.emulator.bma180_bench import BYTE_NS, LATER, MS, Box, codes, peek, poke, unlocked
from tests.selection import examples

PERIOD_NS = 416_667  # 2400 Hz, BMA-93


def test_vectors_of_bma_65_and_saturation():
    assert peek(Bma180Chip(0x40, Box((1.0, -1.0, -1 / 4096))), 0x02, 6) == bytes.fromhex("0140 01c0 fdff")
    assert peek(Bma180Chip(0x40, Box((8191 / 4096, -2.0, 0.0))), 0x02, 6) == bytes.fromhex("fd7f 0180 0100")


@pytest.mark.parametrize(("g", "code"), [(2.0, 8191), (9.0, 8191), (-2.0, -8192), (-2.001, -8192), (-9.0, -8192)])
def test_both_ends_saturate_on_every_axis(g, code):
    assert codes(Bma180Chip(0x40, Box((g, g, g)))) == (code, code, code)  # BMA-60


@pytest.mark.parametrize(
    ("code", "range_g", "half_g"),  # 0.5 g of BMA-70 ... BMA-76
    [(0, 1.0, 4096), (1, 1.5, 2730), (2, 2.0, 2048), (3, 3.0, 1365), (4, 4.0, 1024), (5, 8.0, 512), (6, 16.0, 256)],
)
def test_every_range_has_its_sensitivity(code, range_g, half_g):
    box = Box((0.5, -0.5, 0.0))
    chip = unlocked(box)
    poke(chip, 0x35, code << 1)
    assert codes(chip, at=2 * LATER) == (half_g, -half_g, 0)
    assert box.asked[-1][1] == range_g


@pytest.mark.parametrize(
    ("register", "mid", "more", "axis"),  # upper bits of an offset, a gain, a tco: BMA-36 ... BMA-42, BMA-46
    [
        *((0x38, 0x80, 0x81, 0), (0x39, 0x80, 0x81, 1), (0x3A, 0x80, 0x81, 2)),
        *((0x32, 0x80, 0x82, 0), (0x33, 0x80, 0x82, 1), (0x34, 0x80, 0x82, 2)),
        *((0x2E, 0x81, 0x85, 0), (0x2F, 0x82, 0x86, 1), (0x30, 0x80, 0x84, 2)),
        *((0x35, 0x04, 0xF4, 0), (0x36, 0x00, 0x0F, 1), (0x36, 0x00, 0xF0, 2)),
    ],
)
def test_a_trim_affects_only_its_own_axis(register, mid, more, axis):
    chip = unlocked(Box((0.5, 0.5, 0.5), degc=45.0))
    assert peek(chip, register)[0] == mid
    poke(chip, register, more)
    moved = [code - 2048 for code in codes(chip, at=2 * LATER)]
    assert moved.pop(axis) > 8
    assert moved == [0, 0]


def test_axes_of_a_slow_oscillator_are_sampled_in_turn():
    """A hundredth of 2400 Hz: quarters of 10.4 ms (BMA-94), in which 1 g/s is 43 codes at 2 g; z is of the cycle
    before, 171 codes ago.
    """
    box = Box(slope=(1.0, 1.0, 1.0), g=(0.0, 0.0, 0.0))
    x, y, z = codes(Bma180Chip(0x40, box, rate_error=-0.99), at=1000 * MS)
    assert (y - x, z + 171 - y) == (pytest.approx(43, abs=1), pytest.approx(43, abs=1))
    sound = Bma180Chip(0x40, Box(slope=(1.0, 1.0, 1.0), g=(0.0, 0.0, 0.0)))
    assert len(set(codes(sound, at=1000 * MS))) == 1


def test_offset_trims_shift_the_output():
    chip = unlocked(Box((0.0, 0.0, 0.0)))
    poke(chip, 0x38, 0x81, 0x39, 0x7F)
    assert codes(chip, at=2 * LATER) == (27, -27, 0)  # BMA-121
    poke(chip, 0x36, 0x80)  # z<3:0> = 8: half a step of the upper bits
    assert codes(chip, at=3 * LATER)[2] in (13, 14)


def test_gain_and_temperature_trims_change_the_output():
    chip = unlocked(Box((1.0, 1.0, 1.0), degc=35.0))
    poke(chip, 0x32, 0x82)
    x, y, z = codes(chip, at=2 * LATER)
    assert x > y == z == 4096
    poke(chip, 0x32, 0x80, 0x30, 0x84)
    assert codes(chip, at=3 * LATER) == (4096, 4096, 4096 + 41)  # 10 K at 1 mg/K
    poke(chip, 0x30, 0x80, 0x20, 0x4F)
    assert codes(chip, at=4 * LATER)[0] > 4096
    poke(chip, 0x37, 0xB2)
    assert peek(chip, 0x08, at=5 * LATER) == bytes((22 + 1,))


def test_new_data_is_cleared_by_either_byte_of_the_axis():
    chip = Bma180Chip(0x40, Box())
    assert [peek(chip, 0x02)[0] & 1 for _ in range(2)] == [1, 0]
    chip.load(0x05, LATER)
    assert peek(chip, 0x04)[0] & 1 == 0
    assert peek(chip, 0x06)[0] & 1 == 1
    assert peek(chip, 0x02, at=LATER + PERIOD_NS)[0] & 1 == 1


def test_axes_are_converted_one_quarter_of_a_period_apart():
    start = 2_500_000  # BMA-106
    fresh = []
    for quarter in (1, 2, 3, 4):
        for around in (-10, 10):
            chip = Bma180Chip(0x40, Box())
            at = start + quarter * PERIOD_NS // 4 + around
            fresh.append("".join(str(chip.load(register, at) & 1) for register in (2, 4, 6)))
    assert fresh == ["000", "000", "000", "100", "100", "110", "110", "111"]  # T, x, y, z: BMA-94


@pytest.mark.parametrize(("mode", "updates", "bandwidth_hz"), [(0, 240, 150.0), (1, 240, 150.0), (3, 120, 75.0)])
def test_each_mode_has_its_update_rate(mode, updates, bandwidth_hz):
    box = Box()
    chip = unlocked(box)
    poke(chip, 0x30, 0x80 | mode)
    fresh = sum(chip.load(0x02, at) & 1 for at in range(2 * LATER, 3 * LATER, 100_000))
    assert abs(fresh - updates) <= 1
    assert box.asked[-1][2] == bandwidth_hz


@pytest.mark.parametrize(  # BMA-81 ... BMA-90
    ("code", "bandwidth_hz"),
    [(0, 10), (1, 20), (2, 40), (3, 75), (4, 150), (5, 300), (6, 600), (7, 1200), (8, 1200), (9, 300)],
)
def test_every_bandwidth_reaches_the_element(code, bandwidth_hz):
    box = Box()
    chip = unlocked(box)
    poke(chip, 0x20, code << 4 | 8)
    codes(chip, at=2 * LATER)
    assert box.asked[-1][2] == bandwidth_hz


def test_the_oscillator_may_be_ten_percent_off():
    chip = Bma180Chip(0x40, Box(), rate_error=-0.1)
    assert abs(sum(chip.load(0x02, at) & 1 for at in range(LATER, 2 * LATER, 100_000)) - 216) <= 1


def test_two_reads_within_a_period_give_one_sample():
    box = Box(slope=(1.0, 1.0, 1.0))
    chip = Bma180Chip(0x40, box)
    at = 2_500_000 + 300 * PERIOD_NS + 10
    first, asked = codes(chip, at=at), len(box.asked)
    assert codes(chip, at=at + 1000) == first
    assert len(box.asked) == asked
    assert [when for when, _, _ in box.asked] == sorted(when for when, _, _ in box.asked)


def test_a_write_that_changes_no_setting_does_not_disturb_the_converter():
    quiet, written = unlocked(), unlocked()
    for at in range(LATER, LATER + 20 * PERIOD_NS, 90_000):
        poke(written, 0x2C, 0x55, 0x35, 0x04, at=at)
        assert peek(written, 0x02, 6, at=at) == peek(quiet, 0x02, 6, at=at)


def test_the_shadow_keeps_low_and_high_byte_together():
    box = Box((63 / 4096, 0.0, 0.0))
    chip = Bma180Chip(0x40, box)
    assert chip.load(0x02, LATER) == 0xFD
    box.value = (64 / 4096, 0.0, 0.0)
    assert chip.load(0x03, LATER + PERIOD_NS) == 0x00
    assert chip.load(0x03, LATER + 9 * PERIOD_NS) == 0x00  # high bytes alone: the old shadow for ever, BMA-100
    assert chip.load(0x02, LATER + 9 * PERIOD_NS) == 0x00  # and the flag was cleared by them
    assert chip.load(0x03, LATER + 9 * PERIOD_NS) == 0x01


def test_without_shadow_a_value_is_torn():
    box = Box((63 / 4096, 0.0, 0.0))
    chip = unlocked(box)
    poke(chip, 0x33, 0x81)
    chip.write(b"\x02", 2 * LATER, BYTE_NS)
    low = chip.read(1, 2 * LATER, BYTE_NS)
    box.value = (64 / 4096, 0.0, 0.0)
    high = chip.read(1, 2 * LATER + PERIOD_NS, BYTE_NS)
    assert (low + high).hex() == "fd01"  # 127: neither 63 nor 64, BMA-101


def test_a_12_bit_read_out_keeps_the_scale():
    chip = unlocked(Box((7 / 4096, -1 / 4096, 0.5)))
    poke(chip, 0x37, 0xB1)
    assert codes(chip, at=2 * LATER) == (4, -4, 2048)  # BMA-61


@pytest.mark.parametrize(
    ("degc", "byte"), [(24.0, 0x00), (25.0, 0x02), (-30.0, 0x94), (-40.0, 0x80), (-60.0, 0x80), (150.0, 0x7F)]
)
def test_the_thermometer_has_the_codes_of_the_data_sheet(degc, byte):
    assert peek(Bma180Chip(0x40, Box(degc=degc)), 0x08)[0] == byte  # BMA-63


def test_self_test_deflects_every_axis_and_ends_by_itself():
    box = Box()
    chip = unlocked(box)
    poke(chip, 0x0D, 0x14)
    seen = [codes(chip, at=LATER + step * 200_000) for step in range(3, 40)]
    for axis, rest in enumerate((0, 0, 4096)):
        moved = [code[axis] - rest for code in seen]
        assert max(moved) > 200
        assert min(moved) < -200  # BMA-104
    assert box.asked[-1][2] == 1200.0
    assert peek(chip, 0x0D, at=LATER + 10 * MS) == b"\x10"
    assert codes(chip, at=2 * LATER) == (0, 0, 4096)


@pytest.mark.parametrize(("register", "value"), [(0x35, 0x0E), (0x20, 0xA8), (0x20, 0xF8)])
def test_unauthorised_codes_stop_the_converter(register, value):
    box = Box()
    chip = unlocked(box)
    codes(chip)
    poke(chip, register, value)
    box.value = (1.0, 1.0, 1.0)
    assert peek(chip, 0x02, 6, at=2 * LATER) == bytes.fromhex("0000 0000 0040")


@pytest.mark.parametrize(("bandwidth", "settling"), [(0, 253), (1, 127), (2, 64), (3, 35), (4, 18), (5, 9), (6, 6)])
def test_the_output_settles_after_a_change_of_range(bandwidth, settling):
    chip = unlocked()
    poke(chip, 0x20, bandwidth << 4 | 8)
    assert codes(chip, at=3 * LATER)[2] == 4096
    changed = 3 * LATER + MS
    poke(chip, 0x35, 0x0C, at=changed)
    path = [codes(chip, at=changed + n * PERIOD_NS + 1000)[2] for n in range(1, settling + 2)]
    assert path == sorted(path, reverse=True)
    assert 512 < path[0] < 4096  # neither the old nor the new value
    assert path[-1] == 512


def test_the_high_pass_removes_gravity():
    box = Box()
    chip = unlocked(box)
    poke(chip, 0x20, 0x88)
    assert codes(chip, at=LATER + MS)[2] > 4000
    assert abs(codes(chip, at=LATER + 1978 * PERIOD_NS)[2]) < 0.02 * 4096  # BMA-89
    box.value = (0.0, 0.0, 1.5)
    assert abs(codes(chip, at=LATER + 1980 * PERIOD_NS)[2] - 2048) < 0.02 * 4096


@settings(max_examples=examples(100), deadline=None)
@given(
    st.lists(st.integers(1_000, 3 * PERIOD_NS), min_size=1, max_size=12),
    st.sampled_from([6, 7]),
    st.integers(1_000, 150_000),
    st.integers(0, 3 * MS),
)
def test_a_burst_equals_single_byte_reads(gaps, count, byte_ns, first):
    quick, slow = (Bma180Chip(0x40, Box(slope=(3.0, -5.0, 7.0))) for _ in range(2))
    at = 2 * MS + first
    for gap in gaps:
        at += gap
        for chip in (quick, slow):
            chip.write(b"\x02", at, byte_ns)
        assert quick.read(count, at, byte_ns) == Chip.read(slow, count, at, byte_ns)
        at += count * byte_ns
        for register in (0x05, 0x03, 0x07):  # the shadows, too
            assert quick.load(register, at) == slow.load(register, at)
