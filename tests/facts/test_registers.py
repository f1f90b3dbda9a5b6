"""The arithmetic of registers, fields and settings, against bits spelled out one by one."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.facts.registers import Field, Register, Setting

REGISTER = Register(0x2D, reset=0x0A)
bytes_ = st.integers(0, 255)
bounds = st.tuples(st.integers(0, 7), st.integers(0, 7)).map(sorted)


def bits(byte: int) -> str:
    """Eight digits, most significant first."""
    return f"{byte:08b}"


@given(bounds, bytes_)
def test_a_field_reads_its_digits(bound, byte):
    low, high = bound
    assert REGISTER[high:low].of(byte) == int(bits(byte)[7 - high : 8 - low], 2)


@given(bounds, bytes_, st.data())
def test_a_setting_replaces_only_its_digits(bound, byte, data):
    low, high = bound
    width = high - low + 1
    code = data.draw(st.integers(0, 2**width - 1))
    before = bits(byte)
    after = before[: 7 - high] + f"{code:0{width}b}" + before[8 - low :]
    field = REGISTER[high:low]
    assert bits(field(code).into(byte)) == after
    assert field.of(int(after, 2)) == code
    assert bits(field.mask) == "".join("1" if low <= 7 - place <= high else "0" for place in range(8))


@given(st.integers(0, 7), bytes_)
def test_one_bit_is_a_field(bit, byte):
    assert REGISTER[bit] == REGISTER[bit:bit]
    assert REGISTER[bit].of(byte) == int(bits(byte)[7 - bit])


@given(st.integers(1, 7), bytes_, st.data())
def test_settings_of_one_register_are_written_together(cut, byte, data):
    upper, lower = REGISTER[7:cut], REGISTER[cut - 1 : 0]
    high, low = data.draw(st.integers(0, 2 ** (8 - cut) - 1)), data.draw(st.integers(0, 2**cut - 1))
    both = upper(high) | lower(low)
    assert both == lower(low) | upper(high) == Setting(REGISTER, 0xFF, high << cut | low)
    assert both.into(byte) == high << cut | low


@given(bounds, st.data())
def test_codes_that_do_not_fit_are_refused(bound, data):
    low, high = bound
    too_large = data.draw(st.integers(2 ** (high - low + 1), 1000))
    for code in (too_large, -1):
        with pytest.raises(ValueError, match=f"register 0x2d bits {high}:{low}: {code} does not fit"):
            REGISTER[high:low](code)


def test_settings_that_do_not_belong_together_are_refused():
    with pytest.raises(ValueError, match="settings of two registers, 0x2d and 0x2e"):
        REGISTER[0](1) | Register(0x2E)[1](1)
    with pytest.raises(ValueError, match="bits 0x02 set twice"):
        REGISTER[3:1](0) | REGISTER[1:0](0)


@pytest.mark.parametrize("bound", [slice(8, 0), slice(0, 1), 8, -1])
def test_bits_outside_a_byte_are_refused(bound):
    with pytest.raises(ValueError, match="register 0x2d: no bits"):
        REGISTER[bound]


def test_a_register_has_its_defaults():
    assert Register(0x10) == Register(0x10, "rw", 0x00, 0x00)
    assert Field(REGISTER, 3, 2).register.reset == 0x0A
