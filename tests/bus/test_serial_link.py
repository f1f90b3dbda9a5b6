"""The serial link, byte by byte: layouts from its description, and frames damaged by a bad line."""

from __future__ import annotations

import struct
from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from firmware_emulator import serial_firmware as firmware
from imuarray.bus import serial_link as link
from imuarray.bus.serial_link import Deframer, Frame, LinkError, PollList, Request, frame_payload


def crc32(data: bytes) -> int:
    """Bit by bit: reflected polynomial EDB88320, all ones before and inverted after."""
    register = 0xFFFFFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (0xEDB88320 if register & 1 else 0)
    return register ^ 0xFFFFFFFF


def on_the_wire(kind: int, sequence: int, time_us: int, payload: bytes) -> bytes:
    """A frame from the table of its description."""
    body = len(payload).to_bytes(2, "little") + bytes([kind]) + sequence.to_bytes(2, "little")
    body += time_us.to_bytes(4, "little") + payload
    return b"\xa5\x5a" + body + crc32(body).to_bytes(4, "little")


def test_the_crc_gives_its_check_value() -> None:
    assert crc32(b"123456789") == 0xCBF43926


@pytest.mark.parametrize(
    ("ours", "bytes_of_the_description"),
    [
        (frame_payload(link.HELLO, 1), on_the_wire(0x01, 1, 0, b"")),
        (
            frame_payload(link.TRANSFER, 0xFFFE, link.transfer_payload(0x53, b"\x32", 6)),
            on_the_wire(0x02, 0xFFFE, 0, bytes.fromhex("53 0600 32")),
        ),
        (
            frame_payload(
                link.LIST,
                2,
                link.list_payload(3, PollList(50, 7, (Request(0x70, b"\x04", 0), Request(0x53, b"\x30", 8)))),
            ),
            on_the_wire(0x03, 2, 0, bytes.fromhex("03 3200 0700  70 01 00 04  53 01 08 30")),
        ),
        (frame_payload(link.START, 3, link.start_payload(20_000)), on_the_wire(0x04, 3, 0, bytes.fromhex("204e0000"))),
        (frame_payload(link.STOP, 4), on_the_wire(0x05, 4, 0, b"")),
        (firmware.frame(0xD0, 70_000, (1 << 32) + 5, b"\x00\x07"), on_the_wire(0xD0, 4464, 5, b"\x00\x07")),
    ],
)
def test_frames_match_the_description_byte_by_byte(ours: bytes, bytes_of_the_description: bytes) -> None:
    assert ours == bytes_of_the_description


def test_a_list_is_as_long_as_its_answer() -> None:
    asked = PollList(1, 0, (Request(0x70, b"\x04", 0), Request(0x53, b"\x30", 8), Request(0x40, b"\x02", 7)))
    assert asked.size == 1 + 2 + (2 + 8) + (2 + 7)
    assert link.request_bytes([asked, asked]) == 2 * (4 + 4 + 4)


payloads = st.binary(max_size=60) | st.just(b"\xa5\x5a" * 20) | st.binary(min_size=1000, max_size=link.MAX_PAYLOAD)
frames = st.builds(Frame, st.integers(0, 255), st.integers(0, 0xFFFF), st.integers(0, 0xFFFFFFFF), payloads)


# The bytes of a bad line: noise, syncs that begin nothing, frames cut off, lengths out of bounds. A frame whose last
# byte was lost and is that with which the next one begins is whole again; such a coincidence is left out.
syncs = st.sampled_from([b"\xa5", b"\x5a", b"\xa5\x5a", b"\xa5\x5a\xff\x03", b"\xa5\x5a\xff\xff"])
garbage = st.one_of(
    st.binary(max_size=40),
    st.lists(syncs, max_size=8).map(b"".join),
    st.builds(lambda frame, cut: wire(frame)[:-cut], frames, st.integers(1, 14)),
).filter(lambda noise: not Deframer().feed(noise + link.SYNC, final=True))


def frame_arguments(frame: Frame) -> tuple[int, int, bytes, int]:
    return frame.kind, frame.sequence, frame.payload, frame.time_us


def wire(frame: Frame) -> bytes:
    return frame_payload(*frame_arguments(frame))


def pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    at = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[start:stop] for start, stop in pairwise(at)]


@settings(deadline=None)
@given(st.binary(max_size=3000), st.lists(st.integers(0, 5000), max_size=6))
@example(b"\xa5\x5a" * 600, [3, 700])
@example(b"\xa5", [])
def test_any_bytes_in_pieces_of_any_length_are_skipped_or_are_frames(data: bytes, cuts: list[int]) -> None:
    deframer = Deframer()
    frames = [frame for piece in pieces(data, cuts) for frame in deframer.feed(piece)]
    frames += deframer.feed(b"", final=True)
    assert deframer.skipped + sum(link.OVERHEAD + len(frame.payload) for frame in frames) == len(data)
    assert all(wire(frame) in data for frame in frames)


@settings(deadline=None)
@given(st.lists(st.tuples(garbage, frames), max_size=6), garbage, st.lists(st.integers(0, 20_000), max_size=6))
def test_whole_frames_are_read_between_any_noise(sent: list[tuple[bytes, Frame]], tail: bytes, cuts: list[int]) -> None:
    data = b"".join(noise + wire(frame) for noise, frame in sent) + tail
    deframer = Deframer()
    whole_frames = [frame for piece in pieces(data, cuts) for frame in deframer.feed(piece)]
    whole_frames += deframer.feed(b"", final=True)
    assert whole_frames == [frame for _, frame in sent]


@settings(deadline=None)
@given(st.lists(frames, min_size=3, max_size=3), st.integers(0, 10**6))
def test_a_flipped_bit_costs_one_frame(sent: list[Frame], where: int) -> None:
    middle = bytearray(wire(sent[1]))
    bit = where % (8 * len(middle))
    middle[bit // 8] ^= 1 << bit % 8
    whole_frames = Deframer().feed(wire(sent[0]) + middle + wire(sent[2]), final=True)
    assert whole_frames == [sent[0], sent[2]]


@settings(deadline=None)
@given(st.lists(frames, max_size=5))
def test_a_whole_frame_is_returned_at_once(sent: list[Frame]) -> None:
    deframer = Deframer()
    for frame in sent:
        assert deframer.feed(wire(frame)) == [frame]
    assert deframer.skipped == 0


@settings(deadline=None)
@given(st.lists(st.tuples(garbage, frames), max_size=4), st.lists(st.integers(0, 20_000), max_size=4))
def test_the_firmware_receives_the_same_frames(sent: list[tuple[bytes, Frame]], cuts: list[int]) -> None:
    data = b"".join(noise + wire(frame) for noise, frame in sent) + bytes(1100)
    receiver = firmware.Receiver()
    whole_frames = [command for piece in pieces(data, cuts) for command in receiver.feed(piece)]
    assert [command.raw for command in whole_frames] == [wire(frame) for _, frame in sent]
    assert [command[:3] for command in whole_frames] == [
        (frame.kind, frame.sequence, frame.payload) for _, frame in sent
    ]


@settings(deadline=None)
@given(st.binary(max_size=20), st.integers(0, 20))
def test_answers_with_any_payload_are_decoded_or_refused(payload: bytes, count: int) -> None:
    for read in (lambda: link.outcome_of(payload, count, "x"), lambda: link.capacity_of(payload)):
        try:
            read()
        except OSError as error:
            assert error.errno in (71, 110, 121, 95)  # EPROTO, ETIMEDOUT, EREMOTEIO, EOPNOTSUPP


@pytest.mark.parametrize(
    ("payload", "number"), [(b"\x01", 121), (b"\x02", 110), (b"\x03", 95), (b"", 71), (b"\x09", 71), (b"\x00ab", 71)]
)
def test_results_are_errnos_of_linux(payload: bytes, number: int) -> None:
    with pytest.raises(OSError, match=r".") as refused:
        link.outcome_of(payload, 1, "address 0x53")
    assert refused.value.errno == number
    assert isinstance(refused.value, LinkError) == (number == 71)


def test_payloads_that_no_frame_can_carry_are_refused() -> None:
    with pytest.raises(ValueError, match="1025 bytes in a frame"):
        frame_payload(1, 0, bytes(1025))
    for address, write, read in ((0x80, b"", 0), (-1, b"", 0), (0x53, b"", -1)):
        with pytest.raises(ValueError, match="addresses of 7 bits"):
            link.transfer_payload(address, write, read)
    for write, read in ((bytes(1022), 0), (b"", 1024)):
        with pytest.raises(ValueError, match="a frame of the link holds 1024"):
            link.transfer_payload(0x53, write, read)
    with pytest.raises(ValueError, match="list 0: "):
        link.list_payload(0, PollList(1, 0, (Request(0x53, b"\x00", 200),) * 6))


def test_the_answer_to_hello_is_decoded() -> None:
    assert link.capacity_of(struct.pack("<BBH", 1, 128, 1536)) == (1, 128, 1536, 0, 0, 0)
    assert link.capacity_of(struct.pack("<BBHBBI", 1, 128, 1536, 3, 8, 65536)) == (1, 128, 1536, 3, 8, 65536)
    with pytest.raises(LinkError, match="has 3 bytes"):
        link.capacity_of(b"\x01\x02\x03")


def test_the_counts_of_the_firmware_are_decoded() -> None:
    payload = bytes.fromhex("00 01 0807060504030201 01000000 02000000 03000000 04000000 05000000 ffffffff")
    assert link.counts_of(payload) == (True, 0x0102030405060708, 1, 2, 3, 4, 5, 0xFFFFFFFF)
    with pytest.raises(LinkError, match="33 requested"):
        link.counts_of(payload[:-1])
    with pytest.raises(OSError, match="Operation not supported"):
        link.counts_of(b"\x03")
