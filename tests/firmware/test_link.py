"""The codec of the firmware: frames of the link's description, the same frames as Python's codec, and any bytes."""

from __future__ import annotations

import zlib
from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from imuarray.bus.serial_link import MAX_PAYLOAD, Deframer, Frame, frame_payload
from tests.firmware.build import Core, CoreReceiver
from tests.selection import examples

# Bytes as they are on the wire, by the table of the description. The checksums are those that gzip writes behind the
# same bytes (`xxd -r -p | gzip | tail -c 8 | head -c 4`).
GOLDEN = {
    "HELLO": ((0x01, 1, 0, ""), "a55a 0000 01 0100 00000000  bfcc228b"),
    "TRANSFER": ((0x02, 0xFFFE, 0, "53060032"), "a55a 0400 02 feff 00000000 53060032 caa889c5"),
    "START": ((0x04, 3, 0, "204e0000"), "a55a 0400 04 0300 00000000 204e0000 61eb154e"),
    "DATA": ((0xD0, 4464, 0x01020304, "0007"), "a55a 0200 d0 7011 04030201 0007 27408ba3"),
}


payloads = st.binary(max_size=60) | st.just(b"\xa5\x5a" * 20) | st.binary(min_size=1000, max_size=MAX_PAYLOAD)
frames = st.builds(Frame, st.integers(0, 255), st.integers(0, 0xFFFF), st.integers(0, 0xFFFFFFFF), payloads)
syncs = st.sampled_from([b"\xa5", b"\x5a", b"\xa5\x5a", b"\xa5\x5a\xff\x03", b"\xa5\x5a\xff\xff", b"\xa5\x5a\x00\x04"])


def wire(frame: Frame) -> bytes:
    return frame_payload(frame.kind, frame.sequence, frame.payload, frame.time_us)


damage = st.one_of(
    st.binary(max_size=40),
    st.lists(syncs, max_size=8).map(b"".join),
    st.builds(lambda frame, cut: wire(frame)[:-cut], frames, st.integers(1, 14)),
)


def pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    places = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[start:stop] for start, stop in pairwise(places)]


def test_the_crc_gives_its_check_value(core: Core) -> None:
    assert core.functions.link_crc32(b"123456789", 9) == 0xCBF43926


@settings(deadline=None)
@given(data=st.binary(max_size=300))
def test_the_crc_is_zlibs(core: Core, data: bytes) -> None:
    assert core.functions.link_crc32(data, len(data)) == zlib.crc32(data)


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_frames_are_written_and_read(core: Core, name: str) -> None:
    (kind, sequence, time_us, payload), text = GOLDEN[name]
    golden = bytes.fromhex(text)
    assert core.frame(kind, sequence, time_us, bytes.fromhex(payload)) == golden
    assert CoreReceiver(core).feed(golden) == [golden]


@settings(deadline=None)
@given(frame=frames)
def test_the_core_and_python_read_each_others_frames(core: Core, frame: Frame) -> None:
    sent = core.frame(frame.kind, frame.sequence, frame.time_us, frame.payload)
    assert Deframer().feed(sent) == [frame]
    assert CoreReceiver(core).feed(wire(frame)) == [sent]


@settings(max_examples=examples(60), deadline=None)
@given(sent=st.lists(st.tuples(damage, frames), max_size=5), cuts=st.lists(st.integers(0, 20_000), max_size=6))
@example(sent=[(b"\xa5\x5a\x00\x04" * 300, Frame(1, 1, 0, b""))], cuts=[3, 700])
def test_the_core_and_python_read_the_same_frames_on_a_bad_line(
    core: Core, sent: list[tuple[bytes, Frame]], cuts: list[int]
) -> None:
    data = b"".join(noise + wire(frame) for noise, frame in sent)
    receiver, deframer = CoreReceiver(core), Deframer()
    whole_frames = [raw for piece in pieces(data, cuts) for raw in receiver.feed(piece)] + receiver.pause()
    assert whole_frames == [wire(frame) for frame in deframer.feed(data, final=True)]


@settings(deadline=None)
@given(data=st.binary(max_size=3000), cuts=st.lists(st.integers(0, 5000), max_size=6))
@example(data=b"\xa5\x5a" * 600, cuts=[3, 700])
@example(data=b"\xa5\x5a\xff\xff" * 300, cuts=[1])
def test_any_bytes_in_pieces_of_any_length_are_skipped_or_are_frames(core: Core, data: bytes, cuts: list[int]) -> None:
    receiver = CoreReceiver(core)
    frames = [raw for piece in pieces(data, cuts) for raw in receiver.feed(piece)] + receiver.pause()
    assert all(raw in data and Deframer().feed(raw) for raw in frames)
    receiver = CoreReceiver(core)
    assert receiver.feed(data) + receiver.pause() == frames


def test_a_payload_that_is_too_long_is_no_frame(core: Core) -> None:
    assert core.frame(0xD0, 0, 0, bytes(1024))[:4] == bytes.fromhex("a55a0004")
    assert core.frame(0xD0, 0, 0, bytes(1025)) == b""
