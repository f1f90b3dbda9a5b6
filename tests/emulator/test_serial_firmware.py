"""The emulated microcontroller: its answers, its frames and their times; bytes from the description of the link."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_emulator.serial_firmware import LISTS, REQUEST_BYTES
from tests.emulator.firmware_bench import (
    MS,
    NOBODY,
    ONE,
    TRANSACTION_NS,
    ask,
    bench,
    frame_fields,
    framed,
    run,
    started,
)
from tests.firmware.kinds import both_kinds


def test_hello_reports_version_and_capacity() -> None:
    assert ask(bench()[0], 1) == struct.pack("<BBH", 1, LISTS, REQUEST_BYTES)


@both_kinds()
def test_a_transaction_is_executed_and_answered() -> None:
    firmware, board, _ = bench()
    assert ask(firmware, 2, bytes.fromhex("53 0600 32")) == b"\x00" + bytes(range(6))
    assert board.asked == [(0x53, b"\x32", 6)]
    assert ask(firmware, 2, bytes.fromhex("53 0000 2d08"), 2) == b"\x00"
    assert ask(firmware, 2, bytes.fromhex("1d 0100 00"), 3) == b"\x01"
    board.failures = [110]
    assert ask(firmware, 2, bytes.fromhex("53 0100 00"), 4) == b"\x02"


@both_kinds()
def test_a_repeated_command_is_answered_again_and_executed_once() -> None:
    firmware, board, _ = bench()
    command = framed(2, 7, bytes.fromhex("53 0100 00"))
    first = firmware.feed(command)
    assert firmware.feed(command + command) == first * 2
    assert len(board.asked) == 1
    ask(firmware, 2, bytes.fromhex("53 0100 00"), 8)
    assert len(board.asked) == 2


@both_kinds()
@pytest.mark.parametrize(
    ("kind", "payload"),
    [
        (2, "53 01"),
        (2, "53 ffff 00"),
        (2, "ff 0100 00"),
        (3, "00 0100"),
        (3, "00 0000 0000 53010230"),  # every 0
        (3, "00 0200 0200 53010230"),  # a remainder that does not exist
        (3, "80 0100 0000 53010230"),  # list 128
        (3, "00 0100 0000 530102"),  # cut off
        (3, "00 0100 0000 53010230 ff"),
        (3, "00 0100 0000 80010230"),  # eight bits of address
        (3, "00 0100 0000" + "5301ff30" * 4),  # more than a frame holds
        (4, "00000000"),
        (4, "0010"),
        (9, ""),
    ],
)
def test_invalid_commands_are_refused(kind: int, payload: str) -> None:
    firmware, _, _ = bench()
    assert ask(firmware, kind, bytes.fromhex(payload)) == b"\x03"
    assert firmware.due_ns is None


def test_lists_beyond_the_memory_are_refused() -> None:
    firmware, _, _ = bench()
    body = ONE * 100  # 400 bytes
    results = [ask(firmware, 3, bytes([number, 1, 0, 0, 0]) + body, number) for number in range(5)]
    assert results == [b"\x00"] * 3 + [b"\x03"] * 2
    assert ask(firmware, 3, bytes([0, 1, 0, 0, 0]) + ONE, 9) == b"\x00"  # in place of list 0
    assert ask(firmware, 3, bytes([4, 1, 0, 0, 0]) + body, 10) == b"\x00"


@both_kinds()
def test_lists_run_in_their_frames() -> None:
    firmware, _, clock = started(5000, "00 0100 0000" + ONE.hex(), "01 0300 0200" + NOBODY.hex())
    sent = run(firmware, clock, 7)
    assert [(frame[1], frame[3][0]) for frame in sent] == [
        (0, 0),
        (1, 0),
        (2, 0),
        (2, 1),
        (3, 0),
        (4, 0),
        (5, 0),
        (5, 1),
        (6, 0),
    ]


@both_kinds()
def test_frames_have_times_and_ages() -> None:
    firmware, _, clock = started(5000, "00 0100 0000" + (ONE * 3).hex(), counter_us=1000)
    sent = run(firmware, clock, 3)
    assert [frame[2] for frame in sent] == [1300, 6300, 11300]  # 300 us after each beginning
    assert sent[0][3].hex(" ") == "00 2c 01 00 01 c8 00 00 01 64 00 00 01"  # ages 300, 200, 100


@both_kinds()
def test_drift_applies_to_the_counter_and_the_period() -> None:
    firmware, _, clock = started(5000, "00 0100 0000" + ONE.hex(), drift=0.01)
    begun_ns = clock.now_ns()
    sent = run(firmware, clock, 102)
    assert sent[-1][2] - sent[0][2] == pytest.approx(101 * 5000, abs=1)
    assert clock.now_ns() - begun_ns == pytest.approx(101 * 5 * MS / 1.01 + TRANSACTION_NS, abs=2)


def test_counters_wrap() -> None:
    firmware, _, clock = started(1000, "00 0100 0000" + ONE.hex(), counter_us=(1 << 32) - 3000)
    assert [frame[2] for frame in run(firmware, clock, 5)] == [2**32 - 2900, 2**32 - 1900, 2**32 - 900, 100, 1100]
    firmware._number = 65_535
    firmware._begun_ns = clock.now_ns() - 65_535 * MS
    assert [frame[1] for frame in run(firmware, clock, 3)] == [65_535, 0, 1]


@both_kinds()
def test_a_request_without_acknowledgement_is_tried_twice() -> None:
    firmware, board, clock = started(5000, "00 0100 0000" + ONE.hex())
    board.failures = [121, 0, 121, 121, 110]
    first, second, third = run(firmware, clock, 3)
    assert first[3].hex(" ") == "00 64 00 00 01"  # the age of the second try
    assert second[3].hex(" ") == "00 ff ff 00 00"
    assert third[3].hex(" ") == "00 fe ff 00 00"
    assert len(board.asked) == 5


@both_kinds()
def test_frames_without_time_are_skipped() -> None:
    firmware, _, clock = started(1000, "00 0100 0000" + ONE.hex())
    run(firmware, clock, 2)
    clock.advance(3 * MS + MS // 2)
    assert [frame[1] for frame in run(firmware, clock, 2)] == [4, 5]  # the one that should run by now is begun late


@both_kinds()
@pytest.mark.parametrize("kind", [1, 5])
def test_hello_and_stop_end_the_stream(kind: int) -> None:
    firmware, _, clock = started(1000, "00 0100 0000" + ONE.hex())
    run(firmware, clock, 2)
    ask(firmware, kind)
    assert firmware.due_ns is None
    assert firmware.tick() == []
    ask(firmware, 4, struct.pack("<I", 1000), 98)
    assert run(firmware, clock, 3) == []  # the lists are forgotten


@settings(deadline=None)
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=50),
            st.builds(framed, st.integers(0, 6), st.integers(0, 3), st.binary(max_size=20)),
        ),
        max_size=10,
    )
)
def test_any_bytes_leave_the_firmware_responsive(data: list[bytes]) -> None:
    firmware, _, clock = bench()
    for piece in data:
        firmware.feed(piece)
        if firmware.due_ns is not None:
            clock.sleep_until(firmware.due_ns)
            for frame in firmware.tick():
                frame_fields(frame)
    firmware.feed(bytes(1100))
    ask(firmware, 1, sequence=77)
