"""The layout of scans: types and indices are parsed, and bytes unpacked as the kernel's documentation lays them out."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.bus.iio import ScanElement, ScanLayout
from tests.bus.iio_machine import scan


def element(name: str, index: int, kind: str) -> ScanElement:
    return ScanElement.parse(name, str(index), kind)


def test_the_layout_matches_the_example_of_the_documentation() -> None:
    """iio_devbuf.rst: u16, u32, u32, u64, big-endian, at bytes 0, 4, 8, 16; the first and the last alone at 0 and 8."""
    kinds = ("be:u16/16>>0", "be:u32/32>>0", "be:u32/32>>0", "be:u64/64>>0")
    channels = [element(f"channel{number}", number, kind) for number, kind in enumerate(kinds)]
    whole = ScanLayout.of(channels)
    assert (whole.offsets, whole.size) == ((0, 4, 8, 16), 24)
    two = ScanLayout.of([channels[3], channels[0]])
    assert (two.offsets, two.size) == ((0, 8), 16)
    scans = struct.pack(">H6xQ", 0xFFFF, 2**64 - 1)
    values = two.unpack(scans)
    assert (values["channel0"].tolist(), values["channel3"].tolist()) == ([65535], [2**64 - 1])


def test_twelve_bits_in_the_upper_part_of_sixteen_are_unpacked() -> None:
    """iio_devbuf.rst: le:s12/16>>4; bits below are no part of the value."""
    layout = ScanLayout.of([element("in_accel_y", 0, "le:s12/16>>4")])
    assert layout.unpack(bytes.fromhex("0f80 f07f 1f00"))["in_accel_y"].tolist() == [-2048, 2047, 1]


@pytest.mark.parametrize(("order", "sign"), [("<", "le"), (">", "be")])
def test_the_layout_matches_the_alignment_of_a_c_structure(order: str, sign: str) -> None:
    """Three axes of 16 bits, a temperature and a time: `struct` with native alignment puts the time at byte 8."""
    channels = [element(f"in_accel_{axis}", number, f"{sign}:s16/16>>0") for number, axis in enumerate("xyz")]
    layout = ScanLayout.of([*channels, element("in_timestamp", 9, f"{sign}:s64/64>>0")])
    assert layout.size == struct.calcsize("@hhhq")
    scans = b"".join(struct.pack(f"{order}hhh2xq", row, -row, 1000 + row, 10**18 + row) for row in range(5))
    values = layout.unpack(scans)
    assert values["in_accel_y"].tolist() == [0, -1, -2, -3, -4]
    assert values["in_accel_z"].tolist() == [1000, 1001, 1002, 1003, 1004]
    assert values["in_timestamp"].tolist() == [10**18 + row for row in range(5)]


@st.composite
def channels(draw: Any) -> tuple[str, list[int], tuple[int, int, str]]:
    """A type, the values of one scan, and the stored words: value with other bits around it, size, order."""
    stored = draw(st.sampled_from((8, 16, 32, 64)))
    bits = draw(st.integers(1, stored))
    shift = draw(st.integers(0, stored - bits))
    repeat = draw(st.sampled_from((1, 1, 1, 2, 4)))
    order, sign = draw(st.sampled_from(("le", "be"))), draw(st.sampled_from("su"))
    low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if sign == "s" else (0, 2**bits - 1)
    values = draw(st.lists(st.integers(low, high), min_size=repeat, max_size=repeat))
    noise = draw(st.integers(0, 2**stored - 1))
    mask = (2**bits - 1) << shift
    words = [(noise & ~mask) | ((value % 2**bits) << shift) for value in values]
    kind = f"{order}:{sign}{bits}/{stored}"
    kind += f"X{repeat}" if repeat > 1 else draw(st.sampled_from(("", "X1", "X0")))
    kind += f">>{shift}" if shift or draw(st.booleans()) else ""
    way = "little" if order == "le" else "big"
    block = b"".join(word.to_bytes(stored // 8, way) for word in words)  # type: ignore[arg-type]
    return kind, values, (int.from_bytes(block, "big"), len(block), "big")


@given(st.lists(channels(), min_size=1, max_size=6), st.randoms(use_true_random=False))
def test_any_channels_are_unpacked(made: list[Any], random: Any) -> None:
    """Against words made with `int.to_bytes` and aligned one by one: byte order, bits, shift, sign, repetitions, gaps
    in the indices, and any order of the channels.
    """
    indices = sorted(random.sample(range(100), len(made)))
    listed = [
        element(f"c{row}", index, kind) for row, (index, (kind, _, _)) in enumerate(zip(indices, made, strict=True))
    ]
    random.shuffle(listed)
    single = scan([word for _, _, word in made])
    layout = ScanLayout.of(listed)
    assert layout.size == len(single)
    values = layout.unpack(single * 3)
    for row, (_, expected, _) in enumerate(made):
        got = values[f"c{row}"]
        assert got.tolist() == ([expected] * 3 if len(expected) > 1 else expected * 3)
        assert got.dtype in (np.int64, np.uint64)


@pytest.mark.parametrize(
    "kind",
    ["", "le", "le:s16", "LE:s16/16", "le:x16/16", "le:s16/24", "le:s17/16", "le:s0/16", "le:s12/16>>5", "le:s16/16X3",
     "le:s16/16X64", "le:s16/16>>-1", "le:s16/16>>0 ", "le:s१६/16", "ne:s16/16", "le:s16/9999", "le:s16/16>>0\nx"],
)  # fmt: skip
def test_invalid_types_are_refused(kind: str) -> None:
    with pytest.raises(ValueError, match=r"in_accel_x_type is .*: allowed is"):
        element("in_accel_x", 0, kind)


@pytest.mark.parametrize("index", ["", "-1", "x", "1.0", "99999999", "²"])
def test_invalid_indices_are_refused(index: str) -> None:
    with pytest.raises(ValueError, match=r"in_accel_x_index is .*: a whole number"):
        ScanElement.parse("in_accel_x", index, "le:s16/16")


def test_two_channels_at_one_index_and_none_at_all_are_refused() -> None:
    with pytest.raises(ValueError, match="a_index and b_index are both 1"):
        ScanLayout.of([element("a", 1, "le:s16/16"), element("b", 1, "le:s16/16")])
    with pytest.raises(ValueError, match="no channel is enabled"):
        ScanLayout.of([])


@given(st.text(max_size=30))
def test_any_text_is_a_type_or_refused(text: str) -> None:
    try:
        parsed = element("c", 0, text)
    except ValueError:
        return
    assert parsed.bits + parsed.shift <= parsed.stored_bits
