"""Answers and frames that only the firmware's core has; the others are tests of both (`tests.firmware.kinds`)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_emulator.clock import VirtualClock
from firmware_emulator.serial_firmware import Firmware
from tests.emulator import firmware_bench
from tests.emulator.firmware_bench import MS, NOBODY, ONE, Board, ask, bench, frame_fields, framed, run, started
from tests.firmware.build import CoreFirmware
from tests.selection import examples

LISTS, REQUEST_BYTES, LINE_BYTES, KEPT_BYTES = 128, 4096, 8192, 32768
RESEND, STATUS, SELECT = 6, 7, 8


@pytest.fixture(autouse=True)
def _the_core(core_firmware: type[CoreFirmware], monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The bench has the core."""
    monkeypatch.setattr(firmware_bench, "Firmware", core_firmware)
    yield


def counts(firmware: Any, sequence: int = 500) -> dict[str, int]:
    names = ("result", "watchdog", "now_us", "sent", "late", "dropped", "overwritten", "failures", "skipped")
    answer = ask(firmware, STATUS, sequence=sequence)
    return dict(zip(names, struct.unpack("<BBQ6I", answer), strict=True))


def test_hello_reports_version_capacity_and_features() -> None:
    assert ask(bench()[0], 1) == struct.pack("<BBHBBI", 1, LISTS, REQUEST_BYTES, 7, 0, KEPT_BYTES)


def test_lists_beyond_the_memory_are_refused() -> None:
    firmware, _, _ = bench()
    body = ONE * 250  # 1000 bytes, of which 4 lists have room; every answer has 1 + 1000 bytes
    results = [ask(firmware, 3, bytes([number, 1, 0, 0, 0]) + body, number) for number in range(5)]
    assert results == [b"\x00"] * 4 + [b"\x03"]
    assert ask(firmware, 3, bytes([1, 1, 0, 0, 0]) + ONE, 9) == b"\x00"  # in place of list 1
    assert ask(firmware, 3, bytes([4, 1, 0, 0, 0]) + body, 10) == b"\x00"


def test_replacing_a_list_does_not_change_the_others() -> None:
    firmware, _, clock = started(5000, "00 0100 0000 53010130", "01 0100 0000 53010231", "02 0100 0000 53010332")
    assert ask(firmware, 3, bytes.fromhex("00 0100 0000 53010430"), 20) == b"\x00"
    sizes = [len(frame[3]) for frame in run(firmware, clock, 1)]
    assert sizes == [1 + 2 + 4, 1 + 2 + 2, 1 + 2 + 3]


def test_counters_wrap() -> None:
    firmware, _, clock = started(1000, "00 0100 0000" + ONE.hex(), counter_us=(1 << 32) - 3000)
    assert [frame[2] for frame in run(firmware, clock, 5)] == [2**32 - 2900, 2**32 - 1900, 2**32 - 900, 100, 1100]
    firmware.skip_to(65_535)  # type: ignore[attr-defined]
    assert [frame[1] for frame in run(firmware, clock, 3)] == [65_535, 0, 1]
    assert counts(firmware)["now_us"] > 1 << 32


def test_echoed_answers_are_not_executed() -> None:
    firmware, _, _ = bench()
    answer = firmware.feed(framed(1, 1))
    assert firmware.feed(answer) == b""
    assert firmware.feed(framed(0x50, 1)) == b""  # its answer would look like DATA
    assert firmware.feed(framed(0xD0, 1)) == b""


def test_a_command_after_a_damaged_length_is_executed_after_a_pause() -> None:
    firmware, _, clock = bench()
    assert firmware.feed(b"\xa5\x5a\xff\x03" + framed(1, 1)) == b""  # 1023 bytes are announced
    clock.advance(99 * MS)
    assert firmware.tick() == []
    clock.advance(MS)
    (answer,) = firmware.tick()
    assert frame_fields(answer)[:2] == (0x81, 1)
    firmware.feed(b"\xa5\x5a\xff\x03")
    clock.advance(250 * MS)  # the host asks again
    assert frame_fields(firmware.feed(framed(1, 2)))[:2] == (0x81, 2)
    assert counts(firmware)["skipped"] == 8


class TestKeptData:
    """DATA is kept until it is acknowledged, and sent again when it is asked for."""

    def the(self, frames: int, size: int = 8) -> tuple[Any, VirtualClock, list[bytes]]:
        firmware, _, clock = started(5000, f"00 0100 0000 5301{size:02x}30")
        sent = []
        for _ in range(frames):
            assert firmware.due_ns is not None
            clock.sleep_until(firmware.due_ns)
            sent += firmware.tick()
        return firmware, clock, sent

    def again(self, firmware: Any, first: int, count: int, sequence: int = 300) -> tuple[list[bytes], tuple[int, ...]]:
        """The frames that are sent again, and the answer: result, number of frames, number to go on with."""
        data = firmware.feed(framed(RESEND, sequence, struct.pack("<HH", first, count)))
        pieces = []
        while data:
            size = 15 + int.from_bytes(data[2:4], "little")
            pieces.append(data[:size])
            data = data[size:]
        return pieces[:-1], struct.unpack("<BHH", frame_fields(pieces[-1])[3])

    def test_frames_are_sent_again_unchanged(self) -> None:
        firmware, _, sent = self.the(20)
        assert self.again(firmware, 5, 3) == (sent[5:8], (0, 3, 8))

    def test_acknowledged_frames_are_discarded(self) -> None:
        firmware, _, sent = self.the(20)
        assert self.again(firmware, 12, 0) == ([], (0, 0, 12))
        assert self.again(firmware, 0, 20, 301)[0] == sent[12:]

    def test_frames_are_sent_again_across_the_wrap_of_numbers(self) -> None:
        firmware, clock, _ = self.the(1)
        firmware.skip_to(65_530)
        sent = []
        for _ in range(12):
            clock.sleep_until(firmware.due_ns)
            sent += firmware.tick()
        assert self.again(firmware, 65_534, 5) == (sent[4:9], (0, 5, 3))

    def test_the_oldest_frame_is_overwritten_and_counted(self) -> None:
        frames, record = 200, 4 + 15 + 1 + 2 + 200
        firmware, _, sent = self.the(frames, 200)
        room = KEPT_BYTES // record
        assert counts(firmware)["overwritten"] == frames - room
        # The line holds fewer at once; `next` is the number to continue with.
        received: list[bytes] = []
        first = 0
        for sequence in range(300, 340):
            pieces, (_, count, following) = self.again(firmware, first, frames - first, sequence)
            assert count == len(pieces)
            received += pieces
            first = following
            if first == frames:
                break
        assert received == sent[frames - room :]

    def test_frames_without_room_on_the_line_can_be_requested_later(self) -> None:
        firmware, clock, _ = self.the(1, 200)
        firmware.room = 0
        for _ in range(60):
            clock.sleep_until(firmware.due_ns)
            assert firmware.tick() == []
        firmware.room = 1 << 30
        on_the_line = firmware.tick()
        dropped = counts(firmware)["dropped"]
        assert len(on_the_line) + dropped == 60
        assert dropped > 20
        assert (len(on_the_line) + 1) * 218 <= LINE_BYTES - 1039 + 218
        pieces, _ = self.again(firmware, 1, 60)
        later, _ = self.again(firmware, 1 + len(pieces), 60, 302)
        later_still, _ = self.again(firmware, 1 + len(pieces) + len(later), 60, 303)
        numbers = [frame_fields(piece)[1] for piece in pieces + later + later_still]
        assert numbers == list(range(1, 61))
        assert (pieces + later)[: len(on_the_line)] == on_the_line

    def test_a_new_stream_has_no_frames_of_the_old_one(self) -> None:
        firmware, _, _ = self.the(20)
        ask(firmware, 4, struct.pack("<I", 1000), 400)
        assert self.again(firmware, 0, 20)[0] == []

    @settings(max_examples=examples(40), deadline=None)
    @given(frames=st.integers(1, 400), size=st.integers(0, 255), data=st.data())
    def test_only_frames_sent_before_are_sent_again(self, frames: int, size: int, data: st.DataObject) -> None:
        firmware, _, sent = self.the(frames, size)
        acknowledged = 0
        for sequence in range(300, 303):
            first, count = data.draw(st.integers(0, frames)), data.draw(st.integers(0, 500))
            pieces, (_, number, following) = self.again(firmware, first, count, sequence)
            assert number == len(pieces)
            numbers = [frame_fields(piece)[1] for piece in pieces]
            assert pieces == [sent[place] for place in numbers]
            begins = max(first, acknowledged, counts(firmware)["overwritten"])
            assert numbers == list(range(begins, begins + len(numbers)))
            assert following == first + count or following == begins + len(numbers)
            acknowledged = max(first, acknowledged)


def test_status_counts_skipped_late_and_failed_requests() -> None:
    firmware, board, clock = started(1000, "00 0100 0000" + ONE.hex() + NOBODY.hex(), counter_us=7)
    run(firmware, clock, 3)  # of 0.3 ms, until 2.3 ms
    clock.advance(3 * MS + MS // 2)  # frames 3 and 4 should have begun and ended
    run(firmware, clock, 2)
    firmware.feed(b"noise")
    counters = counts(firmware)
    assert {name: counters[name] for name in ("result", "watchdog", "dropped", "overwritten", "skipped")} == {
        "result": 0,
        "watchdog": 0,
        "dropped": 0,
        "overwritten": 0,
        "skipped": 5,
    }
    assert (counters["sent"], counters["late"], counters["failures"]) == (5, 2, 5)
    assert counters["now_us"] == firmware.time_us()
    assert len(board.asked) == 5 * 3


class Selects:
    """Chip selects that echo what is sent, inverted."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.asked: list[tuple[int, bytes, int]] = []
        self.settings: list[tuple[int, int, int]] = []

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        self.asked.append((address, write, read))
        return bytes(~value & 0xFF for value in (write + bytes(read))[-read:]) if read else b""

    def set_select(self, select: int, mode: int, clock_hz: int) -> None:
        if clock_hz > 24_000_000:
            raise ValueError(clock_hz)
        self.settings.append((select, mode, clock_hz))


def test_chip_selects_are_read_and_listed(core_firmware: type[CoreFirmware]) -> None:
    clock = VirtualClock(0)
    selects = Selects(clock)
    firmware: Any = core_firmware(selects, clock, selects=8)
    assert ask(firmware, 1)[5] == 8
    assert ask(firmware, SELECT, struct.pack("<BBI", 3, 3, 10_000_000), 2) == b"\x00"
    assert ask(firmware, SELECT, struct.pack("<BBI", 3, 0, 25_000_000), 3) == b"\x03"
    assert ask(firmware, SELECT, struct.pack("<BBI", 8, 0, 1_000_000), 4) == b"\x03"
    assert ask(firmware, SELECT, struct.pack("<BBI", 3, 4, 1_000_000), 5) == b"\x03"
    assert selects.settings == [(3, 3, 10_000_000)]
    assert ask(firmware, 2, bytes.fromhex("83 0200 f5"), 6) == bytes.fromhex("00 ff ff")
    assert selects.asked == [(0x83, b"\xf5", 2)]
    assert ask(firmware, 2, bytes.fromhex("88 0200 f5"), 7) == b"\x03"  # chip select 8 of 8
    assert ask(firmware, 3, bytes.fromhex("00 0100 0000 83 01 04 f5  53 01 01 00"), 8) == b"\x00"
    assert ask(firmware, 3, bytes.fromhex("01 0100 0000 88 01 04 f5"), 9) == b"\x03"
    ask(firmware, 4, struct.pack("<I", 1000), 10)
    (frame,) = run(firmware, clock, 1)
    assert frame[3].hex(" ") == "00 00 00 ff ff ff ff 00 00 ff"


class Queue:
    """A queue of numbered bytes behind register 10, whose count, high byte first, is in 1 and 2 of a read from 0."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.count = 0
        self.asked: list[tuple[bytes, int]] = []
        self.errno = 0

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        self.asked.append((write, read))
        self.clock.advance(100_000)
        if self.errno:
            raise OSError(self.errno, "fails")
        if write == b"\x00":
            return bytes([0xEE, *(self.count | 0x8000).to_bytes(2, "big")])[:read]
        return bytes(range(1, read + 1))

    def set_select(self, select: int, mode: int, clock_hz: int) -> None:
        """None is used."""


COUNT = bytes.fromhex("53 01 03 00")
DATA_7 = bytes.fromhex("53 81 0f  01 03 ff7f 07  10")  # at most 15 bytes; packets of 7, counted, high byte first


@pytest.mark.parametrize("kind", ["core", "emulated"])
@pytest.mark.parametrize(
    ("rule", "count", "read"),
    [
        (DATA_7, 0, 0),
        (DATA_7, 1, 7),
        (DATA_7, 2, 14),
        (DATA_7, 500, 14),  # at most the room in the list
        (bytes.fromhex("53 81 0f  01 01 ff7f 07  10"), 13, 7),  # bytes are counted: one whole packet
        (bytes.fromhex("53 81 0f  01 01 0800 07  10"), 0x7FF7, 0),  # the mask leaves nothing
        (bytes.fromhex("53 81 05  01 03 ff7f 07  10"), 3, 0),  # no packet fits
    ],
)
def test_a_queue_is_read_by_its_count(
    kind: str, rule: bytes, count: int, read: int, core_firmware: type[CoreFirmware]
) -> None:
    clock = VirtualClock(0)
    queue = Queue(clock)
    queue.count = count
    firmware: Any = (core_firmware if kind == "core" else Firmware)(queue, clock, selects=8)
    assert ask(firmware, 3, bytes(1) + bytes.fromhex("0100 0000") + COUNT + rule, 2) == b"\x00"
    ask(firmware, 4, struct.pack("<I", 1000), 3)
    (frame,) = run(firmware, clock, 1)
    room = rule[2]
    assert queue.asked == [(b"\x00", 3), *([(b"\x10", read)] if read else [])]
    counted = bytes([0xEE, *(count | 0x8000).to_bytes(2, "big")])
    ages = (200, 100) if read else (100, 0)
    data = bytes(range(1, read + 1)) + bytes(room - read)
    assert frame[3] == b"\0" + struct.pack("<H", ages[0]) + counted + struct.pack("<H", ages[1]) + data
    queue.errno = 110
    (frame,) = run(firmware, clock, 1)  # the count fails, and so does the counted read
    assert frame[3] == b"\0" + b"\xfe\xff" + bytes(3) + b"\xfe\xff" + bytes(room)


@pytest.mark.parametrize("kind", ["core", "emulated"])
@pytest.mark.parametrize(
    "requests",
    [
        DATA_7,  # nothing before it counts
        bytes.fromhex("53 01 02 00") + DATA_7,  # two bytes at 1 are not in two
        COUNT + bytes.fromhex("53 81 0f  01 03 ff7f 00  10"),  # packets of nothing
        COUNT + DATA_7[:-1],
        COUNT + DATA_7[:5],
    ],
)
def test_a_count_outside_its_read_is_refused(kind: str, requests: bytes, core_firmware: type[CoreFirmware]) -> None:
    clock = VirtualClock(0)
    firmware: Any = (core_firmware if kind == "core" else Firmware)(Queue(clock), clock, selects=8)
    assert ask(firmware, 3, bytes(1) + bytes.fromhex("0100 0000") + requests, 2) == b"\x03"


def test_the_core_and_the_emulated_firmware_send_the_same_bytes(core_firmware: type[CoreFirmware]) -> None:
    """The same commands at the same times: the same bytes on the line, HELLO's room aside."""
    both = [kind(Board(clock := VirtualClock(5 * MS)), clock) for kind in (core_firmware, Firmware)]
    commands = [
        framed(3, 1, bytes.fromhex("00 0100 0000") + ONE * 3 + NOBODY),
        framed(3, 2, bytes.fromhex("05 0300 0100") + ONE),
        framed(9, 3),
        framed(4, 4, struct.pack("<I", 2500)),
    ]
    answers = [[firmware.feed(command) for command in commands] for firmware in both]
    assert answers[0] == answers[1]
    for _ in range(50):
        sent = []
        for firmware in both:
            assert firmware.due_ns is not None
            firmware.clock.sleep_until(firmware.due_ns)
            sent.append(firmware.tick())
        assert sent[0] == sent[1]
        assert sent[0]


@settings(max_examples=examples(60), deadline=None)
@given(
    data=st.lists(
        st.one_of(
            st.binary(max_size=50),
            st.builds(framed, st.integers(0, 9), st.integers(0, 3), st.binary(max_size=20)),
            st.builds(framed, st.sampled_from([2, 3, 6, 8]), st.integers(0, 3), st.binary(max_size=1024)),
        ),
        max_size=12,
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
    clock.advance(100 * MS)
    firmware.tick()
    ask(firmware, 1, sequence=77)
