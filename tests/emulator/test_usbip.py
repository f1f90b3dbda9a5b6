"""USB/IP frames against the layouts of the kernel's documentation (usbip_protocol); the parser on invalid frames."""

from __future__ import annotations

import struct
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_emulator.usbip import Conversation, Export, ProtocolError, Setup, UsbIdentity

LIST_DEVICES = bytes.fromhex("0111 8005 00000000")
IMPORT_1_2 = bytes.fromhex("0111 8003 00000000") + b"1-2".ljust(32, b"\0")
# GET_DESCRIPTOR of the device, as Linux sends it: seqnum 7, devid 00010002, in, endpoint 0, flags 200, 64 bytes.
SUBMIT_IN = bytes.fromhex(
    "00000001 00000007 00010002 00000001 00000000  00000200 00000040 00000000 00000000 00000000  8006000100004000"
)
SUBMIT_OUT = bytes.fromhex(
    "00000001 00000008 00010002 00000000 00000000  00000000 00000002 00000000 ffffffff 00000000  4107000053000200 2d08"
)
UNLINK = bytes.fromhex("00000002 00000009 00010002 00000000 00000000  00000007") + bytes(24)


class Device:
    """Answers every inward request with a made-up descriptor; stalls request 99."""

    identity = UsbIdentity(0x1234, 0x5678, 0x0201, (0xFF, 0xEE, 0xDD), (0xCC, 0xBB, 0xAA))

    def __init__(self) -> None:
        self.seen: list[tuple[Setup, bytes]] = []
        self.resets = 0

    def control(self, setup: Setup, data: bytes) -> bytes | None:
        self.seen.append((setup, data))
        return None if setup.request == 99 else bytes(range(18))

    def reset(self) -> None:
        self.resets += 1


def conversation(port: int = 2) -> tuple[Conversation, Device]:
    device = Device()
    return Conversation([Export(port, device)]), device


def answers(talk: Conversation, data: bytes) -> bytes:
    return b"".join(talk.feed(data))


def test_a_device_is_listed() -> None:
    talk, _ = conversation()
    answer = answers(talk, LIST_DEVICES)
    assert answer[:12] == bytes.fromhex("0111 0005 00000000 00000001")
    assert answer[0x0C:0x10C].rstrip(b"\0").startswith(b"/sys/")
    assert answer[0x10C:0x12C] == b"1-2".ljust(32, b"\0")
    assert answer[0x12C:0x138] == bytes.fromhex("00000001 00000002 00000002")  # bus 1, device 2, full speed
    assert answer[0x138:0x144] == bytes.fromhex("1234 5678 0201 ffeedd 01 01 01")
    assert answer[0x144:] == bytes.fromhex("ccbbaa 00")
    assert talk.over


def test_several_devices_and_none_are_listed() -> None:
    talk = Conversation([Export(1, Device()), Export(2, Device())])
    answer = answers(talk, LIST_DEVICES)
    assert len(answer) == 0x0C + 2 * (0x138 + 4)
    assert answer[0x10C:0x10F] == b"1-1"
    assert answer[0x13C + 0x10C : 0x13C + 0x10F] == b"1-2"
    assert answers(Conversation([]), LIST_DEVICES) == bytes.fromhex("0111 0005 00000000 00000000")


def test_a_device_is_imported() -> None:
    talk, _ = conversation()
    answer = answers(talk, IMPORT_1_2)
    assert answer[:8] == bytes.fromhex("0111 0003 00000000")
    assert answer[0x108:0x128] == b"1-2".ljust(32, b"\0")
    assert answer[0x128:] == bytes.fromhex("00000001 00000002 00000002 1234 5678 0201 ffeedd 01 01 01")
    assert len(answer) == 0x140
    assert not talk.over


@pytest.mark.parametrize("busid", [b"1-1", b"", b"\xff" * 32, b"1-2" * 10 + b"11"])
def test_import_of_an_unknown_device_is_refused(busid: bytes) -> None:
    talk, _ = conversation()
    assert answers(talk, IMPORT_1_2[:8] + busid.ljust(32, b"\0")) == bytes.fromhex("0111 0003 00000001")
    assert talk.over


def test_only_one_client_at_a_time_has_the_device() -> None:
    export = Export(2, device := Device())
    first, second, third = (Conversation([export]) for _ in range(3))
    assert answers(first, IMPORT_1_2)[7] == 0
    assert answers(second, IMPORT_1_2)[7] == 1
    second.close()
    assert device.resets == 0
    first.close()
    assert device.resets == 1
    assert answers(third, IMPORT_1_2)[7] == 0


def test_submit_inwards_returns_the_data() -> None:
    talk, device = conversation()
    answer = answers(talk, IMPORT_1_2 + SUBMIT_IN)[0x140:]
    assert answer[:0x30] == bytes.fromhex(
        "00000003 00000007 00000000 00000000 00000000  00000000 00000012 00000000 00000000 00000000 0000000000000000"
    )
    assert answer[0x30:] == bytes(range(18))
    assert device.seen == [(Setup(0x80, 6, 0x0100, 0, 64), b"")]


def test_submit_outwards_returns_the_length_and_no_data() -> None:
    talk, device = conversation()
    answer = answers(talk, IMPORT_1_2 + SUBMIT_OUT)[0x140:]
    assert answer == bytes.fromhex(
        "00000003 00000008 00000000 00000000 00000000  00000000 00000002 00000000 ffffffff 00000000 0000000000000000"
    )
    assert device.seen == [(Setup(0x41, 7, 0, 0x53, 2), b"\x2d\x08")]


def test_a_longer_answer_is_cut_to_the_requested_length() -> None:
    talk, _ = conversation()
    frame = SUBMIT_IN[:0x18] + struct.pack(">I", 8) + SUBMIT_IN[0x1C:0x2E] + struct.pack("<H", 8)
    answer = answers(talk, IMPORT_1_2 + frame)[0x140:]
    assert answer[0x18:0x1C] == b"\0\0\0\x08"
    assert answer[0x30:] == bytes(range(8))


def test_a_stall_is_reported_as_broken_pipe() -> None:
    talk, _ = conversation()
    answer = answers(talk, IMPORT_1_2 + SUBMIT_IN[:0x29] + bytes([99]) + SUBMIT_IN[0x2A:])[0x140:]
    assert struct.unpack_from(">iI", answer, 0x14) == (-32, 0)
    assert len(answer) == 0x30


def test_the_example_of_the_document_addresses_a_missing_endpoint() -> None:
    """Frames captured by the kernel's documentation: device 15, endpoint 1, which a device like ours doesn't have."""
    talk, device = conversation(port=15)
    command_in = bytes.fromhex(
        "00000001 00000d05 0001000f 00000001 00000001 00000200 00000040 ffffffff 00000000 00000004 00000000 00000000"
    )
    command_out = bytes.fromhex(
        "00000001 00000d06 0001000f 00000000 00000001 00000000 00000040 ffffffff 00000000 00000004 00000000 00000000"
        "ffffffff860008a784ce5ae212376300000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000"
    )
    answers(talk, IMPORT_1_2[:8] + b"1-15".ljust(32, b"\0"))
    got = answers(talk, command_in + command_out)
    # As captured, but for status -EPIPE and no data.
    assert got == bytes.fromhex(
        "00000003 00000d05 00000000 00000000 00000000 ffffffe0 00000000 ffffffff 00000000 00000000 00000000 00000000"
        "00000003 00000d06 00000000 00000000 00000000 ffffffe0 00000000 ffffffff 00000000 00000000 00000000 00000000"
    )
    assert device.seen == []


def test_unlink_after_completion_is_answered_with_zero() -> None:
    talk, _ = conversation()
    answers(talk, IMPORT_1_2 + SUBMIT_IN)
    assert answers(talk, UNLINK) == bytes.fromhex("00000004 00000009") + bytes(0x28)


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (bytes.fromhex("0106 8005 00000000"), "version 0x0106"),
        (bytes.fromhex("0111 8002 00000000"), "operation 0x8002"),
        (bytes.fromhex("0111 0005 00000000"), "operation 0x0005"),
        (b"GET / HTTP/1.1\r\n\r\n", "version 0x4745"),
        (IMPORT_1_2 + b"\0\0\0\x05" + SUBMIT_IN[4:], "command 0x5"),
        (IMPORT_1_2 + SUBMIT_IN[:8] + b"\0\x01\0\x03" + SUBMIT_IN[12:], "device 0x10003"),
        (IMPORT_1_2 + SUBMIT_IN[:12] + b"\0\0\0\x02" + SUBMIT_IN[16:], "direction 2"),
        (IMPORT_1_2 + SUBMIT_OUT[:0x18] + b"\x7f\xff\xff\xff" + SUBMIT_OUT[0x1C:], "2147483647 bytes"),
        (IMPORT_1_2 + SUBMIT_OUT[:0x18] + b"\0\x01\0\0" + SUBMIT_OUT[0x1C:], "65536 bytes"),
        (IMPORT_1_2 + SUBMIT_OUT[:0x18] + b"\0\0\0\x03" + SUBMIT_OUT[0x1C:], "a buffer of 3 bytes"),
        (IMPORT_1_2 + SUBMIT_OUT[:12] + b"\0\0\0\x01" + SUBMIT_OUT[16:], "direction 1, does not fit"),
    ],
)
def test_invalid_frames_are_refused(frame: bytes, message: str) -> None:
    talk, device = conversation()
    with pytest.raises(ProtocolError, match=message):
        answers(talk, frame)
    assert device.seen == []


def fed(talk: Conversation, chunks: list[bytes]) -> tuple[bytes, int]:
    """The answers until the conversation was over or broken, and the largest number of bytes kept."""
    got, kept = bytearray(), 0
    try:
        for chunk in chunks:
            for answer in talk.feed(chunk):
                got += answer
            kept = max(kept, len(talk._pending))
    except ProtocolError as error:
        assert "\n" not in str(error)
    return bytes(got), kept


@given(st.lists(st.binary(max_size=200), max_size=20), st.sampled_from([b"", IMPORT_1_2]))
def test_memory_is_bounded_for_random_bytes(chunks: list[bytes], before: bytes) -> None:
    talk, _ = conversation()
    _, kept = fed(talk, [before, *chunks])
    assert kept < 48 + 65535


words = st.sampled_from([0, 1, 2, 3, 0x40, 0xFFFF, 0x10000, 0x10002, 0x7FFFFFFF, 0xFFFFFFFF])


@given(st.lists(st.tuples(st.lists(words, min_size=10, max_size=10), st.binary(min_size=8, max_size=8)), max_size=8))
def test_memory_is_bounded_for_frames_of_plausible_numbers(frames: list[tuple[list[int], bytes]]) -> None:
    talk, device = conversation()
    stream = [struct.pack(">10I", *numbers) + setup for numbers, setup in frames]
    _, kept = fed(talk, [IMPORT_1_2, *stream])
    assert kept < 48 + 65535
    assert all(setup.length == len(data) or setup.request_type >> 7 for setup, data in device.seen)


@given(st.lists(st.integers(0, 40 + 2 * 48 + 50), max_size=10))
def test_answers_do_not_depend_on_the_cuts_of_the_stream(cuts: list[int]) -> None:
    stream = IMPORT_1_2 + SUBMIT_OUT + SUBMIT_IN + UNLINK
    edges = [0, *sorted(cuts), len(stream)]
    chunks = [stream[begin:end] for begin, end in pairwise(edges)]
    whole, cut = conversation()[0], conversation()[0]
    assert fed(cut, chunks)[0] == answers(whole, stream)
