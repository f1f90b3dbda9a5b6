"""Registers, locks, EEPROM and resets of the emulated BMA180 against its data sheet (facts BMA-.., choices DEC-..)."""

from firmware_emulator.chips.bma180 import Bma180Chip
from tests.emulator.bma180_bench import BYTE_NS, LATER, MS, Box, codes, peek, poke, unlocked


def test_the_chip_starts_measuring_at_2_g_and_150_hz():
    box = Box()
    chip = Bma180Chip(0x40, box)
    assert peek(chip, 0x00, 2) == b"\x03\x14"  # BMA-10, DEC-12
    assert codes(chip) == (0, 0, 4096)
    assert box.asked[-1][1:] == (2.0, 150.0)


def test_image_after_the_download_has_the_bytes_of_bma_58():
    image = peek(Bma180Chip(0x40, Box()), 0x20, 0x1C)
    assert image[:12] == bytes.fromhex("48041500eeeea064 00175000")
    assert image[14:27] == bytes.fromhex("81828084808080 0400b0808080")


def test_without_ee_w_an_image_write_is_acknowledged_and_ignored():
    chip = Bma180Chip(0x40, Box())
    assert poke(chip, 0x35, 0x0C) == 2
    assert peek(chip, 0x35) == b"\x04"
    poke(chip, 0x0D, 0x10, 0x35, 0x0C)
    assert peek(chip, 0x35) == b"\x0c"
    poke(chip, 0x3C, 0xAA)
    assert peek(chip, 0x3C) == b"\x00"  # BMA-48


def test_a_write_is_pairs_of_register_and_value():
    chip = unlocked()
    poke(chip, 0x21, 0x02, 0x23)  # meant as a block: the third byte is a register, BMA-05
    assert peek(chip, 0x20, 4) == bytes.fromhex("48021500")
    assert chip.read(1, LATER, BYTE_NS) == b"\xee"  # the pointer survives STOP, DEC-03
    poke(chip, 0x23, 0x11, 0x2C, 0x22)
    assert peek(chip, 0x23) + peek(chip, 0x2C) == b"\x11\x22"


def test_a_read_increments_the_register_in_seven_bits():
    chip = Bma180Chip(0x40, Box(degc=25.0))
    assert peek(chip, 0x82, 7, at=LATER) == bytes.fromhex("0100 0100 0140 02")  # BMA-03, BMA-04
    assert peek(chip, 0x7F, 2) == b"\x00\x03"
    assert peek(chip, 0x10, 0x10) == bytes(16)


def test_a_write_during_the_download_is_undone_at_its_end():
    chip = Bma180Chip(0x40, Box())
    poke(chip, 0x0D, 0x10, 0x35, 0x0C, at=5 * MS)
    assert peek(chip, 0x35, at=9 * MS) == b"\x0c"
    assert peek(chip, 0x35, at=10 * MS) == b"\x04"
    assert peek(chip, 0x0D, at=10 * MS) == b"\x10"


def test_the_download_ignores_early_writes_or_takes_no_time_by_switch():
    chip = Bma180Chip(0x40, Box(), early_writes_vanish=True)
    poke(chip, 0x0D, 0x10, 0x35, 0x0C, at=5 * MS)
    assert peek(chip, 0x35, at=6 * MS) == b"\x04"
    chip = Bma180Chip(0x40, Box(), download_ns=0)
    poke(chip, 0x0D, 0x10, 0x35, 0x0C, at=5 * MS)
    assert peek(chip, 0x35, at=11 * MS) == b"\x0c"
    poke(chip, 0x0D, 0x30, at=12 * MS)
    assert peek(chip, 0x35, at=12 * MS) + peek(chip, 0x0D, at=12 * MS) == b"\x04\x10"


def test_soft_reset_reloads_the_image_after_10_ms():
    chip = unlocked()
    poke(chip, 0x35, 0x0C)
    poke(chip, 0x10, 0xB5)
    assert peek(chip, 0x0D) == b"\x10"
    poke(chip, 0x10, 0xB6)
    assert peek(chip, 0x0D) == b"\x00"
    assert peek(chip, 0x02, 6) == bytes(6)
    assert peek(chip, 0x35, at=LATER + 9 * MS) == b"\x0c"  # the previous contents, DEC-10
    assert peek(chip, 0x35, at=LATER + 11 * MS) == b"\x04"


def test_update_image_reads_1_until_it_is_done():
    chip = unlocked()
    poke(chip, 0x35, 0x0C, 0x0D, 0x30)
    poke(chip, 0x0D, 0x10, at=LATER + MS)
    assert peek(chip, 0x0D, at=LATER + 9 * MS) == b"\x30"
    assert peek(chip, 0x0D, at=LATER + 11 * MS) + peek(chip, 0x35, at=LATER + 11 * MS) == b"\x10\x04"


def test_eeprom_and_registers_can_be_preset():
    chip = Bma180Chip(0x40, Box(), eeprom={0x35: 0x0C, 0x38: 0x71})
    assert codes(chip) == (0, 0, 512)
    chip = Bma180Chip(0x40, Box(), left_over={0x35: 0x0C, 0x0D: 0x10})
    assert peek(chip, 0x35, at=20 * MS) + peek(chip, 0x0D, at=20 * MS) == b"\x0c\x10"
    poke(chip, 0x10, 0xB6, at=20 * MS)
    assert peek(chip, 0x35, at=40 * MS) == b"\x04"


def test_any_write_to_an_even_address_of_its_window_burns_the_eeprom():
    chip = unlocked()
    poke(chip, 0x34, 0x82, 0x35, 0x0C)
    assert chip.eeprom_writes == 0
    assert peek(chip, 0x55) == b"\x0c"  # BMA-54: the window shows the image
    assert chip.eeprom_writes == 0
    poke(chip, 0x55, 0x00)
    assert chip.eeprom_writes == 1
    assert peek(chip, 0x09) == b"\x00"  # odd: ignored
    poke(chip, 0x54)
    assert chip.eeprom_writes == 2
    assert peek(chip, 0x09) == b"\x01"
    poke(chip, 0x35, 0x00, at=LATER + MS)  # ignored while ee_write, BMA-17
    assert peek(chip, 0x09, at=LATER + 10 * MS) == b"\x00"
    assert peek(chip, 0x35, at=LATER + 10 * MS) == b"\x0c"
    chip.power_on(2 * LATER)
    assert peek(chip, 0x34, 2, at=3 * LATER) == b"\x82\x0c"


def test_the_eeprom_keeps_its_size_and_neighbours():
    chip = unlocked()
    poke(chip, 0x34, 0x90, 0x35, 0x0C, 0x36, 0x11, 0x33, 0x84)
    poke(chip, 0x54)
    poke(chip, 0x10, 0xB6, at=2 * LATER)
    assert peek(chip, 0x33, 4, at=3 * LATER) == bytes.fromhex("80 90 0c 00")
    assert len(chip.eeprom) == 28


def test_operational_registers_keep_only_their_settings():
    chip = Bma180Chip(0x40, Box())
    poke(chip, 0x0D, 0x40, 0x0E, 0xE0, 0x0F, 0xF0, 0x02, 0xAA, 0x11, 0xAA)
    assert peek(chip, 0x0D, 5) == bytes.fromhex("00 00 f0 00 00")  # reset_int and the one-shots are over


def test_a_whole_byte_written_to_the_range_register_destroys_the_x_offset():
    chip = Bma180Chip(0x40, Box((0.0, 0.0, 0.0)), eeprom={0x35: 0xF4})
    assert codes(chip) == (0, 0, 0)
    poke(chip, 0x0D, 0x10, 0x35, 0x04)
    assert codes(chip, at=2 * LATER) == (-25, 0, 0)  # 15/16 of 27 codes
    poke(chip, 0x10, 0xB6, at=2 * LATER)
    assert codes(chip, at=3 * LATER) == (0, 0, 0)


def test_sleep_freezes_data_and_refuses_writes():
    box = Box()
    chip = unlocked(box)
    poke(chip, 0x0D, 0x12)
    box.value = (1.0, 1.0, 1.0)
    poke(chip, 0x35, 0x0C, at=LATER + MS)
    assert codes(chip, at=2 * LATER) == (0, 0, 4096)
    poke(chip, 0x0D, 0x10, at=2 * LATER)
    assert peek(chip, 0x35, at=2 * LATER) == b"\x04"
    assert codes(chip, at=2 * LATER + 2 * MS) == (0, 0, 4096)  # awake after 2 ms, BMA-106
    assert codes(chip, at=3 * LATER) == (4096, 4096, 4096)


def test_dis_i2c_silences_the_chip_until_the_next_power_up():
    chip = unlocked()
    assert poke(chip, 0x27, 0x65, 0x20, 0x48) == 2
    assert chip.address == -1
    assert poke(chip, 0x0D, 0x00) == 0
    assert chip.read(2, LATER, BYTE_NS) == b"\xff\xff"
    chip.power_on(LATER)
    assert chip.address == 0x40
