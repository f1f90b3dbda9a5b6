"""The emulated HMC5883 and HMC5883L against bytes and times of their data sheets."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from firmware_emulator.chip import Triple
from firmware_emulator.chips.hmc5883 import Hmc5883Chip, Hmc5883lChip
from tests.emulator.chip_bench import MS, ChipBench, KnownElement


class Board(ChipBench):
    """One chip at 0x1E on a separate wire."""

    def __init__(
        self, field: Callable[[int], Triple] | Triple = (0.5, 0.25, -0.25), variant: str = "hmc5883l", wrap: int = 8
    ) -> None:
        self.element = KnownElement(field)
        super().__init__(Hmc5883Chip(0x1E, self.element, variant=variant, wrap=wrap))

    def single(self) -> bytes:
        self.write(0x02, 0x01)
        self.wait(10)
        return self.read(0x03, 6)


def test_registers_have_their_reset_values_after_power_on() -> None:
    board = Board()
    assert board.read(0x00, 3) == b"\x10\x20\x01"  # HMC-10 ... HMC-12
    board.read(0x03, 6)
    assert board.read(0x09, 4) == b"\x00H43"
    assert not board.element.asked


@pytest.mark.parametrize(("variant", "first_ms"), [("hmc5883l", 56.0), ("hmc5883", 16.6)])
def test_the_reset_mode_measures_once_when_ready(variant: str, first_ms: float) -> None:
    board = Board(variant=variant)
    board.wait(first_ms - 0.2)
    assert board.read(0x09)[0] & 1 == 0
    board.wait(0.2)
    assert board.read(0x09)[0] & 1 == 1
    assert board.read(0x02) == b"\x03"  # HMC-38, DEC-31
    assert [asked[0] for asked in board.element.asked] == [round(first_ms * MS)]


def test_data_have_their_order_sign_and_byte_order() -> None:
    board = Board((0.5, 0.25, -0.25))
    board.wait(60)
    # 545 (HMC-40), then Z = -272.5 and Y = 272.5, rounded to even
    assert board.read(0x03, 6).hex() == "0221" + "fef0" + "0110"


GAINS = {
    "hmc5883l": (1370, 1090, 820, 660, 440, 390, 330, 230),
    "hmc5883": (1280, 1024, 768, 614, 415, 361, 307, 219),
}


@pytest.mark.parametrize("variant", GAINS)
@pytest.mark.parametrize("code", range(8))
def test_each_gain_has_its_sensitivity(variant: str, code: int) -> None:
    board = Board((1.0, -1.0, 0.0), variant)
    board.wait(60)
    board.write(0x01, code << 5)
    board.single()
    data = board.single()
    words = [int.from_bytes(data[i : i + 2], "big", signed=True) for i in (0, 2, 4)]
    gain = GAINS[variant][code]
    assert words == [gain, 0, -gain]


def test_the_first_measurement_after_a_gain_change_has_the_old_gain() -> None:
    board = Board((1.0, 0.0, 0.0))
    board.wait(60)
    assert board.single()[:2] == (1090).to_bytes(2, "big")
    board.write(0x01, 0xE0)
    assert board.single()[:2] == (1090).to_bytes(2, "big")  # HMC-36
    assert board.single()[:2] == (230).to_bytes(2, "big")


def test_a_new_gain_applies_also_when_the_first_measurement_is_not_read() -> None:
    board = Board((1.0, 0.0, 0.0))
    board.wait(60)
    board.write(0x00, 0x18)
    board.write(0x02, 0x00)
    board.write(0x01, 0xE0)
    board.wait(1000)
    assert board.read(0x03, 6)[:2] == (230).to_bytes(2, "big")


def test_overflow_marks_only_its_axis() -> None:
    board = Board((2047.4 / 1090, -2048.4 / 1090, 2048.0 / 1090))
    board.wait(60)
    assert board.read(0x03, 6).hex() == "07ff" + "f000" + "f800"  # HMC-31, HMC-32


def counting(at_ns: int) -> Triple:
    return (at_ns // MS) / 1090, 0.0, 0.0


def continuous(rate: int = 6) -> Board:
    board = Board(counting)
    board.wait(60)
    board.write(0x00, rate << 2)
    board.read(0x03, 6)
    board.write(0x02, 0x00)
    return board


@pytest.mark.parametrize(("rate", "hertz"), list(enumerate((0.75, 1.5, 3.0, 7.5, 15.0, 30.0, 75.0))))
def test_each_continuous_rate_has_its_period(rate: int, hertz: float) -> None:
    board = continuous(rate)
    written_ns = board.wire.clock.now_ns() - 1900
    board.wait(2e3 / hertz - 0.6)
    assert board.read(0x09) == b"\x00"
    board.wait(0.6)
    assert board.read(0x09) == b"\x01"
    board.wait(1e3 / hertz)
    board.read(0x03, 6)
    times = [asked[0] - written_ns for asked in board.element.asked[1:]]
    assert times == pytest.approx([2e9 / hertz, 3e9 / hertz], abs=2.0)


def test_one_conversion_is_sampled_once() -> None:
    board = continuous()
    board.wait(30)
    before = len(board.element.asked)
    assert board.read(0x03, 6) == board.read(0x03, 6)
    assert len(board.element.asked) == before + 1


def test_ready_is_low_while_the_registers_are_written() -> None:
    board = continuous()
    due_ns = board.wire.clock.now_ns() - 1900 + round(3e9 / 75)
    status_ns = 600 + 45_000 + 1200 + 22_500  # from START to the moment the status byte is fetched
    board.wire.clock.sleep_until(due_ns - status_ns - 251_000)
    assert board.read(0x09) == b"\x01"
    board.wire.clock.sleep_until(due_ns - status_ns - 100_000)
    assert board.read(0x09) == b"\x00"
    board.wire.clock.sleep_until(due_ns - status_ns)
    assert board.read(0x09) == b"\x01"


def test_reading_two_bytes_locks_all_six() -> None:
    board = continuous()
    board.wait(30)
    first = board.read(0x03, 2)
    assert board.read(0x09) == b"\x03"
    board.wait(200)
    assert board.read(0x03, 2) == first
    board.read(0x05, 4)
    assert board.read(0x09)[0] & 2 == 0
    board.wait(20)
    assert board.read(0x03, 6)[:2] != first


@pytest.mark.parametrize(("variant", "locked"), [("hmc5883l", 2), ("hmc5883", 0)])
def test_reading_the_mode_locks_only_the_hmc5883l(variant: str, locked: int) -> None:
    board = Board(variant=variant)
    board.wait(60)
    board.read(0x02)
    assert board.read(0x09)[0] & 2 == locked
    board.write(0x00, 0x10)
    assert board.read(0x09)[0] & 2 == 0


def test_single_mode_is_ready_until_read() -> None:
    board = Board()
    board.wait(60)
    assert board.read(0x09) == b"\x01"
    board.wait(500)
    assert board.read(0x09) == b"\x01"
    board.read(0x03, 6)
    assert board.read(0x09) == b"\x00"
    board.write(0x02, 0x01)
    board.wait(5.8)
    assert board.read(0x09) == b"\x00"
    board.wait(0.2)
    assert board.read(0x09) == b"\x01"


def test_idle_measures_nothing() -> None:
    board = Board()
    board.wait(60)
    board.write(0x02, 0x02)
    before = len(board.element.asked)
    board.wait(1000)
    board.read(0x03, 6)
    assert len(board.element.asked) == before
    assert board.read(0x02) == b"\x02"


def test_the_pointer_wraps() -> None:
    board = Board()
    board.wait(60)
    six = board.read(0x03, 6)
    assert board.read(0x03, 8) == six + six[:2]  # DEC-30
    assert board.read(0x0A, 5) == b"H43\x10\x20"
    assert board.read(0x40, 2) == b"\x00\x10"  # HMC-03; from anywhere beyond 0x0C on to 0
    other = Board(wrap=9)
    other.wait(60)
    assert other.read(0x03, 8) == six + b"\x00" + six[:1]  # byte 7 is the status: read, so not ready


def test_a_write_does_not_increment_the_pointer_and_drops_reserved_bits() -> None:
    board = Board()
    board.wire.transfer(0x1E, b"\x00\xf0\x9c")
    assert board.read(0x00, 2) == b"\x1c\x20"
    board.write(0x0A, 0x00)
    assert board.read(0x0A) == b"H"


@pytest.mark.parametrize(
    ("variant", "gain", "bias", "expected"),
    [
        ("hmc5883l", 5, 1, (452, 452, 421)),  # HMC-41, order X Y Z
        ("hmc5883l", 5, 2, (-452, -452, -421)),
        ("hmc5883", 1, 1, (655, 655, -604)),  # HMC-42
    ],
)
def test_the_self_test_adds_its_field(variant: str, gain: int, bias: int, expected: tuple[int, ...]) -> None:
    board = Board((0.3, -0.2, 0.4), variant)
    board.wait(60)
    board.write(0x00, 0x10 | bias)
    board.write(0x01, gain << 5)
    board.single()
    data = board.single()
    x, z, y = (int.from_bytes(data[i : i + 2], "big", signed=True) for i in (0, 2, 4))
    assert (x, y, z) == pytest.approx(expected, abs=1)


def test_averaging_on_the_hmc5883l_quarters_the_bandwidth_at_eight() -> None:
    bandwidths = {}
    for variant in GAINS:
        for code in (0, 3):
            board = Board(variant=variant)
            board.wait(60)
            board.write(0x00, code << 5 | 0x10)
            board.single()
            bandwidths[variant, code] = board.element.asked[-1][2]
    assert bandwidths["hmc5883l", 3] == pytest.approx(bandwidths["hmc5883l", 0] / 4)
    assert bandwidths["hmc5883", 3] == bandwidths["hmc5883", 0]


def test_variants_have_their_regulator_bit_and_gains() -> None:
    assert Board(variant="hmc5883").read(0x09) == b"\x04"
    assert Hmc5883lChip(0x1E, KnownElement(counting)).variant.gains[0] == 1370
    with pytest.raises(ValueError, match="hmc5883l"):
        Hmc5883Chip(0x1E, KnownElement(counting), variant="hmc5843")
