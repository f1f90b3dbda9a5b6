"""The emulated L3G4200D against bytes and figures of its data sheet (facts L3G-.., choices DEC-..)."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_emulator.chip import Chip
from firmware_emulator.chips.l3g4200d import L3g4200dChip, path_of
from tests.emulator.chip_bench import MS, KnownElement
from tests.selection import examples

BYTE_NS = 22_500  # 9 clocks at 400 kHz
SWITCH_ON = 10 * MS
READY = SWITCH_ON + 300 * MS  # L3G-65
ODR_100, ODR_400 = 0x0F, 0x8F


class Table(KnownElement):
    """A rate table."""

    def __init__(self, dps=(100.0, -100.0, 0.0), **options):
        super().__init__(dps, **options)


def poke(chip, register, *values, at=SWITCH_ON):
    """`values` into a register and those that follow it, the last one at `at`."""
    chip.write(bytes((register | 0x80, *values)), at - len(values) * BYTE_NS, BYTE_NS)
    chip.stop(at)


def peek(chip, register, count=1, at=READY, byte_ns=BYTE_NS):
    chip.write(bytes((register | 0x80,)), at, byte_ns)
    return chip.read(count, at, byte_ns)


def codes(chip, at=READY):
    data = peek(chip, 0x28, 6, at=at)
    return tuple(int.from_bytes(data[i : i + 2], "little", signed=True) for i in (0, 2, 4))


def running(table=None, ctrl1=ODR_100, ctrl4=0x80, ctrl5=0x00, ctrl2=0x00, **switches):
    """A gyroscope set up at 0 and switched on at SWITCH_ON, whose first conversion is at READY."""
    chip = L3g4200dChip(0x69, table or Table(), **{"start_up_ns": READY - SWITCH_ON, **switches})
    poke(chip, 0x21, ctrl2, 0x00, ctrl4, ctrl5, at=0)
    poke(chip, 0x20, ctrl1, at=SWITCH_ON)
    return chip


def test_the_chip_starts_in_power_down():
    table = Table()
    chip = L3g4200dChip(0x68, table)
    assert peek(chip, 0x0F) == b"\xd3"
    assert peek(chip, 0x20, 6) == bytes.fromhex("07 00 00 00 00 00")
    assert peek(chip, 0x26, 10, at=1000 * MS) == bytes(9) + b"\x20"  # FIFO_SRC: empty, DEC-21
    assert table.asked == []


def test_vectors_of_l3g_45():
    assert peek(running(), 0x28, 6) == bytes.fromhex("a52c 5bd3 0000")
    assert peek(running(ctrl4=0xB0), 0x28, 6)[2:4] == bytes.fromhex("6bfa")
    assert peek(running(ctrl4=0xF0), 0x28, 6)[2:4] == bytes.fromhex("fa6b")  # BLE, L3G-44


@pytest.mark.parametrize(
    ("ctrl4", "range_dps", "code"),
    [(0x80, 250.0, 11429), (0x90, 500.0, 5714), (0xA0, 2000.0, 1429), (0xB0, 2000.0, 1429)],
)
def test_every_range_has_its_sensitivity(ctrl4, range_dps, code):
    table = Table()
    assert codes(running(table, ctrl4=ctrl4)) == (code, -code, 0)  # 8.75, 17.5, 70 mdps: L3G-40 ... L3G-42
    assert table.asked[-1][1] == range_dps


@pytest.mark.parametrize(("dps", "code"), [(286.8, 32767), (1e4, 32767), (-286.8, -32768), (-1e4, -32768)])
def test_both_ends_saturate_on_every_axis(dps, code):
    for axis in range(3):
        rates = [0.0, 0.0, 0.0]
        rates[axis] = dps
        assert codes(running(Table(tuple(rates))))[axis] == code  # DEC-21


def test_the_span_of_codes_is_wider_than_the_range_and_saturates():
    assert codes(running(Table((286.6, 286.8, -287.0)))) == (32754, 32767, -32768)  # +/-286.7 dps, L3G-40


def test_without_bit_7_a_burst_repeats_one_register():
    chip = running()
    chip.write(b"\x28", READY, BYTE_NS)
    assert chip.read(6, READY, BYTE_NS) == b"\xa5" * 6  # L3G-03
    chip.write(bytes((0x32, 1, 2, 3)), READY, BYTE_NS)
    assert peek(chip, 0x32, 3) == bytes((3, 0, 0))
    chip.write(bytes((0xB2, 1, 2, 3)), READY, BYTE_NS)
    assert peek(chip, 0x32, 3) == bytes((1, 2, 3))  # L3G-04


def test_reserved_registers_refuse_and_count():
    chip = running()
    poke(chip, 0x10, 0x55, at=READY)
    poke(chip, 0x00, 0x55, at=READY)
    assert chip.forbidden_writes == 2
    assert peek(chip, 0x10) == b"\x00"
    poke(chip, 0x21, 0xFF, at=READY)
    assert peek(chip, 0x21) == b"\x3f"  # L3G-07
    poke(chip, 0x0F, 0x00, at=READY)
    assert peek(chip, 0x0F) == b"\xd3"
    assert chip.forbidden_writes == 2


def test_start_up_after_power_down():
    chip = running()
    assert peek(chip, 0x27, at=READY - 10 * MS) == b"\x00"
    assert codes(chip, at=READY - 10 * MS) == (0, 0, 0)
    assert peek(chip, 0x27, at=READY) == b"\x0f"
    chip = running(start_up_ns=MS)
    assert peek(chip, 0x27, at=SWITCH_ON + MS) == b"\x0f"
    chip = L3g4200dChip(0x68, Table(), left_over={0x20: ODR_100, 0x23: 0x80})
    assert peek(chip, 0x27, at=0) == b"\x0f"  # no reset: an earlier program's settings are still there


@pytest.mark.parametrize(("out_select", "periods"), [(0x00, 1), (0x02, 6)])
def test_conversions_resume_after_sleep(out_select, periods):
    chip = running(ctrl5=out_select)
    poke(chip, 0x20, 0x08, at=READY)
    codes(chip, at=READY)
    assert peek(chip, 0x27, at=READY + 100 * MS) == b"\x00"
    poke(chip, 0x20, ODR_100, at=READY + 100 * MS)
    assert peek(chip, 0x27, at=READY + (100 + 10 * periods) * MS - 200_000) == b"\x00"
    assert peek(chip, 0x27, at=READY + (100 + 10 * periods) * MS) == b"\x0f"  # L3G-64


def test_power_down_holds_the_last_value():
    table = Table(degc=20.0)
    chip = running(table, temperature_zero=50)
    first = peek(chip, 0x26, 8)
    poke(chip, 0x20, 0x07, at=READY + MS)
    table.value, table.degc = (1.0, 2.0, 3.0), 30.0
    later = peek(chip, 0x26, 8, at=READY + 5000 * MS)
    assert (later[0], later[2:]) == (first[0], first[2:])
    assert later[1] == 0


@pytest.mark.parametrize(
    ("dr", "rate", "cutoffs", "lpf1"),  # L3G-30 ... L3G-33; L3G-38
    [
        (0, 100, (12.5, 25, 25, 25), 32),
        (1, 200, (12.5, 25, 50, 70), 54),
        (2, 400, (20, 25, 50, 110), 78),
        (3, 800, (30, 35, 50, 110), 93),
    ],
)
def test_rate_and_bandwidth(dr, rate, cutoffs, lpf1):
    for bw, cutoff in enumerate(cutoffs):
        for ctrl5, expected in ((0x00, lpf1), (0x01, lpf1), (0x02, cutoff), (0x03, cutoff)):
            table = Table()
            chip = running(table, ctrl1=dr << 6 | bw << 4 | 0x0F, ctrl5=ctrl5)
            codes(chip)
            assert table.asked[-1][2] == expected
    table = Table()
    chip = running(table, ctrl1=dr << 6 | 0x0F, ctrl4=0x00)
    for at in range(READY, READY + 100 * MS, 100_000):
        chip.load(0x28, at)
    assert len(table.asked) == rate // 10


def test_status_flags_available_and_overrun_per_axis():
    chip = running()
    assert peek(chip, 0x27) == b"\x0f"
    peek(chip, 0x28, 2)
    assert peek(chip, 0x27) == b"\x06"
    assert peek(chip, 0x27, at=READY + 10 * MS) == b"\x6f"  # y and z overwritten, x new
    assert peek(chip, 0x27, at=READY + 20 * MS) == b"\xff"
    codes(chip, at=READY + 20 * MS)
    assert peek(chip, 0x27, at=READY + 20 * MS) == b"\x00"


def test_reads_between_conversions_give_the_same_value():
    table = Table((-300.0, 0.0, 0.0), slope=(1000.0, 0.0, 0.0))
    chip = running(table)
    first = codes(chip, at=READY + MS)
    assert codes(chip, at=READY + 9 * MS) == first
    assert [at for at, _, _ in table.asked] == [READY]
    assert codes(chip, at=READY + 10 * MS)[0] - first[0] in (1142, 1143)  # 10 dps


@pytest.mark.parametrize(("ctrl4", "second"), [(0x80, 0x00), (0x00, 0x01)])
def test_block_data_update_keeps_two_bytes_together(ctrl4, second):
    table = Table((255 * 0.00875, 0.0, 0.0))
    chip = running(table, ctrl4=ctrl4)
    chip.write(b"\xa8", READY, BYTE_NS)
    assert chip.read(1, READY, BYTE_NS) == b"\xff"
    table.value = (256 * 0.00875, 0.0, 0.0)
    assert chip.read(1, READY + 10 * MS, BYTE_NS)[0] == second  # 0x00FF, or 0x01FF torn: L3G-50
    assert peek(chip, 0x28, 2, at=READY + 10 * MS) == b"\x00\x01"


def test_with_block_data_update_a_half_read_value_stays():
    table = Table((1.0, 1.0, 1.0))
    chip = running(table)
    low = peek(chip, 0x28)
    table.value = (2.0, 2.0, 2.0)
    assert peek(chip, 0x28, at=READY + 500 * MS) == low  # L3G-51
    assert peek(chip, 0x2A, at=READY + 500 * MS) == bytes((229,))  # other axes go on: 2 dps / 8.75 mdps


@pytest.mark.parametrize(("ctrl4", "code"), [(0x80, -1), (0x00, 0x00FF)])
def test_even_a_burst_is_torn_without_block_data_update(ctrl4, code):
    table = Table((-0.28, 0.0, 0.0), slope=(0.875, 0.0, 0.0))  # -1 code at READY, 0 a period later
    chip = running(table, ctrl4=ctrl4)
    chip.write(b"\xa8", READY, BYTE_NS)
    data = chip.read(6, READY, 10 * MS)
    assert int.from_bytes(data[:2], "little", signed=True) == code


def test_axes_that_are_off_keep_their_value():
    table = Table((1.0, 1.0, 1.0))
    chip = running(table)
    codes(chip)
    poke(chip, 0x20, 0x0D, at=READY)
    table.value = (2.0, 2.0, 2.0)
    assert peek(chip, 0x27, at=READY + 10 * MS) == b"\x05"
    assert codes(chip, at=READY + 10 * MS) == (229, 114, 229)


@pytest.mark.parametrize(("degc", "code"), [(20.0, 30), (25.0, 25), (35.4, 15), (-100.0, 127), (200.0, -128)])
def test_temperature_counts_decrease_with_temperature(degc, code):
    table = Table(degc=degc)
    chip = running(table, temperature_zero=50.0)
    assert int.from_bytes(peek(chip, 0x26), "big", signed=True) == code  # L3G-60


def test_thermometer_is_refreshed_once_a_second():
    table = Table(degc=20.0)
    chip = running(table, temperature_zero=50.0)
    peek(chip, 0x26)
    table.degc = 30.0
    assert peek(chip, 0x26, at=READY + 999 * MS) == bytes((30,))
    assert peek(chip, 0x26, at=READY + 1000 * MS) == bytes((20,))


@pytest.mark.parametrize(("ctrl4", "change"), [(0x82, 14857), (0x86, -14857), (0x84, 0), (0xB2, 7571), (0x96, -11429)])
def test_self_test_shifts_the_output(ctrl4, change):
    chip = running(Table((0.0, 0.0, 0.0)), ctrl4=ctrl4)
    assert codes(chip) == (change, change, change)  # 130, 530, 200 dps: L3G-62


def test_boot_clears_itself_and_changes_nothing():
    chip = running()
    poke(chip, 0x24, 0x82, at=READY)
    assert peek(chip, 0x24, at=READY + MS) == b"\x82"
    assert peek(chip, 0x24, at=READY + 10 * MS) == b"\x02"
    assert peek(chip, 0x20, at=READY + 10 * MS) == bytes((ODR_100,))


@pytest.mark.parametrize("ctrl5", [0x01, 0x11, 0x12])
def test_high_pass_removes_a_constant_rate(ctrl5):
    chip = running(ctrl2=0x03, ctrl5=ctrl5)  # 1 Hz at ODR 100, L3G-35
    assert codes(chip, at=READY)[0] < 11429 * 0.2  # 0.3 s of 1 Hz have passed
    assert abs(codes(chip, at=READY + 1000 * MS)[0]) < 11429 * 0.01


@pytest.mark.parametrize(  # L3G-35
    ("dr", "cutoffs"),
    [
        (0, (8, 4, 2, 1, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)),
        (1, (15, 8, 4, 2, 1, 0.5, 0.2, 0.1, 0.05, 0.02)),
        (2, (30, 15, 8, 4, 2, 1, 0.5, 0.2, 0.1, 0.05)),
        (3, (56, 30, 15, 8, 4, 2, 1, 0.5, 0.2, 0.1)),
    ],
)
def test_high_pass_cut_offs(dr, cutoffs):
    for hpcf, cutoff in enumerate(cutoffs):
        page = bytearray(256)
        page[0x20], page[0x21], page[0x24] = dr << 6 | 0x0F, hpcf, 0x01
        assert path_of(page).high_pass_hz == cutoff


@pytest.mark.parametrize("ctrl5", [0x00, 0x10, 0x02])
def test_high_pass_is_bypassed_by_other_output_selections(ctrl5):
    assert codes(running(ctrl2=0x03, ctrl5=ctrl5), at=READY + 1000 * MS)[0] == 11429


def test_reading_reference_zeroes_the_high_pass():
    chip = running(ctrl2=0x09, ctrl5=0x01)  # 0.01 Hz
    assert codes(chip)[0] > 11000
    assert peek(chip, 0x25) == b"\x00"
    assert codes(chip, at=READY + 20 * MS) == (0, 0, 0)


def test_reference_mode_subtracts_the_reference():
    chip = running(ctrl2=0x10, ctrl5=0x01)
    poke(chip, 0x25, 0x2C, at=READY)
    assert codes(chip, at=READY + 10 * MS)[0] == 0xA5


def test_a_burst_wraps_only_with_the_switch():
    chip = running()
    assert peek(chip, 0x2C, 5)[2:] == bytes((0x00, 0x20, 0x00))  # FIFO off: on to 0x2E, DEC-20
    assert peek(running(wrap_always=True), 0x28, 8)[6:] == bytes.fromhex("a52c")


@settings(max_examples=examples(100), deadline=None)
@given(
    st.lists(st.integers(1_000, 12 * MS), min_size=1, max_size=12),
    st.sampled_from([(0x26, 8), (0x28, 6)]),
    st.integers(1_000, 400_000),
    st.sampled_from([0x00, 0x80, 0x40, 0xC0]),
    st.booleans(),
)
def test_a_burst_equals_single_byte_reads(gaps, burst, byte_ns, ctrl4, wrap):
    register, count = burst
    quick, slow = (
        running(Table((1.0, 2.0, 3.0), slope=(30.0, -50.0, 70.0)), ODR_400, ctrl4, wrap_always=wrap) for _ in range(2)
    )
    at = READY - 5 * MS
    for gap in gaps:
        at += gap
        for chip in (quick, slow):
            chip.write(bytes((register | 0x80,)), at, byte_ns)
        assert quick.read(count, at, byte_ns) == Chip.read(slow, count, at, byte_ns)
        assert quick.read(1, at, byte_ns) == slow.read(1, at, byte_ns)  # the pointer is where it should be
        at += count * byte_ns
