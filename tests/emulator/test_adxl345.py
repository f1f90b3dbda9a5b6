"""The emulated ADXL345 against bytes and times of its data sheet."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from firmware_emulator.chip import Triple
from firmware_emulator.chips.adxl345 import Adxl345Chip
from tests.emulator.chip_bench import MS, ChipBench, KnownElement


class Board(ChipBench):
    """One chip at 0x53 on a separate wire."""

    def __init__(self, force_g: Callable[[int], Triple] | Triple = (1.0, -1.0, 0.0)) -> None:
        self.element = KnownElement(force_g)
        super().__init__(Adxl345Chip(0x53, self.element))


def ticks(at_ns: int) -> Triple:
    """A force in full-resolution codes that counts milliseconds: x is the number of the conversion."""
    return round(at_ns / MS) / 256, 0.0, 0.0


def x_of(data: bytes) -> int:
    return int.from_bytes(data[:2], "little", signed=True)


def test_registers_have_their_reset_values_after_power_on() -> None:
    board = Board()
    board.wait(1000)
    expected = {0x00: 0xE5, 0x2C: 0x0A, 0x30: 0x02}  # ADX-30
    for register in [0x00, *range(0x1D, 0x3A)]:
        assert board.read(register) == bytes([expected.get(register, 0)]), hex(register)
    assert not board.element.asked  # standby


def test_reserved_and_read_only_registers_ignore_writes() -> None:
    board = Board()
    board.write(0x00, 0x12, 0x10, 0x34, 0x39, 0x56, 0x31, 0xFF)
    assert board.read(0x00) == b"\xe5"
    assert board.read(0x10) == b"\x00"
    assert board.read(0x39) == b"\x00"
    assert board.read(0x31) == b"\xef"  # bit 4 is always 0


def test_a_multi_byte_write_increments_the_register() -> None:
    board = Board()
    board.wire.transfer(0x53, b"\x1e\x01\x02\x03")
    assert board.read(0x1E, 3) == b"\x01\x02\x03"


@pytest.mark.parametrize(
    ("data_format", "force_g", "expected"),
    [
        (0x0B, 1.0, "0001"),  # ADX-48: full resolution
        (0x0B, -1.0, "00ff"),
        (0x0B, -17.0, "00f0"),
        (0x0B, 17.0, "ff0f"),
        (0x0F, 1.0, "0008"),  # left-justified
        (0x04, 1.0, "0040"),  # 2 g, ten bits, left-justified
        (0x00, 1.0, "0001"),
        (0x00, 3.0, "ff01"),  # 511
        (0x01, 1.0, "8000"),  # 4 g, ten bits: 128
        (0x02, 1.0, "4000"),
        (0x03, 1.0, "2000"),
        (0x03, -20.0, "00fe"),  # -512
        (0x08, 3.0, "ff01"),
        (0x09, 5.0, "ff03"),
        (0x0A, 9.0, "ff07"),
    ],
)
def test_formats_match_the_data_sheet(data_format: int, force_g: float, expected: str) -> None:
    board = Board((force_g, 0.0, 0.0))
    board.write(0x31, data_format, 0x2D, 0x08)
    board.wait(20)
    assert board.read(0x32, 6).hex() == expected + "00000000"


@pytest.mark.parametrize("rate", range(16))
def test_rate_and_turn_on_time(rate: int) -> None:
    board = Board(ticks)
    board.write(0x2C, rate, 0x31, 0x0B)
    board.write(0x2D, 0x08)
    # The write ended at byte 3 of the message: 2.5 us per clock, STOP and bus free time after it.
    written_ns = board.wire.clock.now_ns() - 1900
    period_ns = round(1e9 / (3200 / 2 ** (15 - rate)))
    board.wait((3 * period_ns + 1.1 * MS) / MS)
    board.read(0x32, 6)
    assert board.element.asked[-1][0] == written_ns + 3 * period_ns + 1_100_000
    assert board.element.asked[-1][2] == max(0.5e9 / period_ns, 50.0)
    board.wait(period_ns / MS)
    board.read(0x32, 6)
    assert board.element.asked[-1][0] == written_ns + 4 * period_ns + 1_100_000


def test_not_ready_before_the_turn_on_time_is_over() -> None:
    board = Board()
    board.write(0x2D, 0x08)
    board.wait(11.0 - 0.1)
    assert board.read(0x30) == b"\x02"
    assert board.read(0x32, 6) == bytes(6)
    board.wait(0.2)
    assert board.read(0x30) == b"\x82"


def test_one_conversion_is_sampled_once() -> None:
    board = Board()
    board.write(0x2D, 0x08)
    board.wait(15)
    assert board.read(0x32, 6) == board.read(0x32, 6)
    assert len(board.element.asked) == 1


def test_codes_are_even_at_1600_and_3200_hz() -> None:
    codes = {
        (rate, data_format): {code_at(step, rate, data_format) % 2 for step in range(40)}
        for rate in (0x0D, 0x0E, 0x0F)
        for data_format in (0x0B, 0x00, 0x03)
    }
    even, live = {0}, {0, 1}
    assert codes == {
        (0x0D, 0x0B): live,
        (0x0D, 0x00): live,
        (0x0D, 0x03): live,
        (0x0E, 0x0B): even,
        (0x0E, 0x00): even,
        (0x0E, 0x03): live,
        (0x0F, 0x0B): even,
        (0x0F, 0x00): even,
        (0x0F, 0x03): live,
    }


def code_at(step: int, rate: int, data_format: int) -> int:
    board = Board((step / 64, 0.0, 0.0) if data_format == 0x03 else (step / 256, 0.0, 0.0))
    board.write(0x31, data_format, 0x2C, rate, 0x2D, 0x08)
    board.wait(5)
    return x_of(board.read(0x32, 6))


def test_offset_registers_are_added_in_every_range() -> None:
    for data_format, expected in ((0x0B, 127 * 4), (0x00, 127 * 4), (0x03, 64)):  # 1.984 g = 63.5 codes of 1/32 g
        board = Board((0.0, 0.0, 0.0))
        board.write(0x1E, 0x7F, 0x1F, 0x80, 0x31, data_format, 0x2D, 0x08)
        board.wait(20)
        data = board.read(0x32, 6)
        assert x_of(data) == expected
        assert x_of(data[2:]) == -expected - (4 if expected > 64 else 0)


def test_data_ready_and_overrun_in_bypass() -> None:
    board = Board(ticks)
    board.write(0x31, 0x0B, 0x2D, 0x08)
    board.wait(12)
    assert board.read(0x30) == b"\x82"
    assert board.read(0x30) == b"\x82"  # reading INT_SOURCE clears nothing (ADX-50)
    board.read(0x32, 6)
    assert board.read(0x30) == b"\x02"
    board.wait(10)
    assert board.read(0x30) == b"\x82"
    board.wait(10)
    assert board.read(0x30) == b"\x83"
    board.read(0x32, 6)
    assert board.read(0x30) == b"\x02"
    board.wait(25)  # two conversions at once
    assert board.read(0x30) == b"\x83"


def test_standby_keeps_registers_and_data() -> None:
    board = Board()
    board.write(0x31, 0x0B, 0x2D, 0x08)
    board.wait(12)
    board.write(0x2D, 0x00)
    board.wait(100)
    assert board.read(0x32, 6).hex() == "000100ff0000"
    assert board.read(0x31) == b"\x0b"
    assert len(board.element.asked) == 1


def fifo_board(control: int) -> Board:
    """Conversions at 12.1, 22.1, ... ms or so: x of the nth is about 11 + 10 (n - 1)."""
    board = Board(ticks)
    board.write(0x31, 0x0B, 0x38, control, 0x2D, 0x08)
    return board


def drained(board: Board, count: int) -> list[int]:
    return [(x_of(board.read(0x32, 6)) - 1) // 10 for _ in range(count)]


def test_fifo_mode_keeps_the_first_33_sets() -> None:
    board = fifo_board(0x40 | 16)
    board.wait(145)
    assert board.read(0x39) == b"\x0e"
    assert board.read(0x30) == b"\x80"
    board.wait(20)
    assert board.read(0x30) == b"\x82"
    board.wait(1000)
    assert board.read(0x39) == b"\x20"  # DEC-24
    assert board.read(0x30) == b"\x83"
    board.write(0x2D, 0x00)  # standby keeps what the FIFO holds (ADX-38)
    assert drained(board, 33) == list(range(1, 34))
    assert board.read(0x30) == b"\x00"
    assert drained(board, 1) == [33]  # stale


def test_stream_mode_keeps_the_newest_33_sets() -> None:
    board = fifo_board(0x80)
    board.wait(11 + 10 * 99 + 1)
    assert board.read(0x39) == b"\x20"
    assert drained(board, 33) == list(range(68, 101))
    assert len(board.element.asked) == 33


def test_trigger_mode_keeps_samples_from_before_the_event() -> None:
    board = fifo_board(0xC0 | 5)
    board.wait(11 + 10 * 49 + 1)
    board.chip.event(1, board.wire.clock.now_ns())  # the other pin
    assert board.read(0x39) == b"\x20"
    board.chip.event(0, board.wire.clock.now_ns())
    assert board.read(0x39) == b"\x85"
    board.wait(1000)
    assert board.read(0x39) == b"\xa0"
    assert drained(board, 33) == list(range(46, 79))
    board.write(0x38, 0x00)
    assert board.read(0x39) == b"\x00"


def test_bypass_empties_the_fifo() -> None:
    board = fifo_board(0x40)
    board.wait(200)
    board.write(0x38, 0x00)
    board.write(0x38, 0x40)
    assert board.read(0x39) == b"\x00"
    assert board.read(0x30) == b"\x02"


def test_reading_a_single_byte_discards_a_set_and_a_long_burst_reads_one_set() -> None:
    board = fifo_board(0x40)
    board.wait(300)
    first = board.read(0x32)[0]
    second = board.read(0x32)[0]
    assert (first, second) == (11, 21)
    burst = board.read(0x32, 8)  # ADX-05: runs on to FIFO_CTL and FIFO_STATUS
    assert x_of(burst) == 31
    assert burst[6] == 0x40
    before = burst[7]
    assert board.read(0x39)[0] == before


def test_within_a_transaction_a_set_ends_only_with_its_last_byte() -> None:
    def twice(first_count: int) -> tuple[int, int]:
        board = fifo_board(0x40)
        board.wait(300)
        board.wire.send(0x53, b"\x32")
        first = board.wire.receive(0x53, first_count)
        board.wire.send(0x53, b"\x32")
        second = board.wire.receive(0x53, 6)
        board.wire.stop()
        return x_of(first), x_of(second)

    assert twice(5) == (11, 11)
    assert twice(6) == twice(7) == (11, 21)  # ADX-55


def test_a_burst_reads_one_conversion() -> None:
    board = Board(lambda at_ns: (math.floor(at_ns / MS) / 256,) * 3)
    board.write(0x31, 0x0B, 0x2C, 0x0F, 0x2D, 0x08)
    for _ in range(50):
        board.wait(0.37)
        data = board.read(0x32, 6)
        assert data[0:2] == data[2:4] == data[4:6]  # the burst takes 206 us, a conversion 312.5 us


def test_low_power_and_range_reach_the_element() -> None:
    board = Board()
    board.write(0x31, 0x09, 0x2C, 0x1A, 0x2D, 0x08)
    board.wait(12)
    board.read(0x32, 6)
    assert board.element.asked[-1][1:] == (4.0, 288.0)


def test_self_test_moves_every_axis_within_the_limits() -> None:
    board = Board((0.0, 0.0, 0.0))
    board.write(0x31, 0x8B, 0x2D, 0x08)
    board.wait(12)
    data = board.read(0x32, 6)
    x, y, z = (x_of(data[i:]) / 256 for i in (0, 2, 4))
    assert 0.20 < x < 2.10  # ADX-58
    assert -2.10 < y < -0.20
    assert 0.30 < z < 3.40


def test_only_a_power_cycle_resets_the_chip() -> None:
    board = Board()
    board.write(0x1E, 0x11, 0x31, 0x0B, 0x2D, 0x08)
    board.wait(50)
    board.chip.power_on(board.wire.clock.now_ns())
    assert board.read(0x1E) == b"\x00"
    assert board.read(0x30) == b"\x02"
    board.wait(50)
    assert board.read(0x32, 6) == bytes(6)
