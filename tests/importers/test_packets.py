"""Framing of MIMU4444 packets: detected between any other bytes, with any size of blocks, in bounded memory."""

from __future__ import annotations

import io
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.importers.mimu4444 import read_packets

FIRST = bytes.fromhex(
    "aa19746471"
    "08785affddf84e026affe8fffcfffd075affdafd20ffff0000ffffffcef8770240ffe2ffe8000f"
    "0783ffd5fcfb0018fffe001affcff8500293fff1fffbfffd0757ffd1fcee001d000e0001ffdaf86c024dffedffe4fff9"
    "075effcbfcd50003fff600103eae"
)
"""The first packet of the published recording exp_1, copied from a hex dump of it."""

EXTRACT = Path(__file__).parent.parent / "data" / "mimu4444" / "exp_1_extract.bin"


def packet(number: int, ticks: int = 0, value: int = 7) -> bytes:
    """A valid packet with `value` on all axes."""
    body = struct.pack(">BHBI48h", 0xAA, number % 65536, 100, ticks % 2**32, *[value] * 48)
    return body + struct.pack(">H", sum(body) % 65536)


def read(stream: bytes, block_bytes: int) -> tuple[list[int], list[int], list[int]]:
    """Numbers of all packets, bytes skipped and broken packets before each of them and after the last."""
    numbers: list[int] = []
    skipped, broken = [0], [0]
    for piece in read_packets(io.BytesIO(stream), block_bytes):
        numbers += piece.packets["number"].tolist()
        for total, part in ((skipped, piece.skipped), (broken, piece.broken)):
            total[-1] += int(part[0])
            total += part[1:].tolist()
    return numbers, skipped, broken


def test_the_first_published_packet_is_decoded() -> None:
    assert len(FIRST) == 106
    (piece, _) = read_packets(io.BytesIO(FIRST))
    (only,) = piece.packets
    assert (only["number"], only["ticks"], only["checksum"]) == (6516, 1896380506, 0x3EAE)
    assert only["axes"][0].tolist() == [-35, -1970, 618, -24, -4, -3]
    assert only["axes"][1].tolist() == [1882, -38, -736, -1, 0, -1]
    assert only["axes"][7].tolist() == [1886, -53, -811, 3, -10, 16]


@pytest.mark.parametrize("head", [bytes.fromhex("a02800c8"), b""])
def test_an_acknowledge_at_the_head_is_not_garbage(head: bytes) -> None:
    for block_bytes in (1, 3, 4, 5, 1000):
        assert read(head + packet(1) + packet(2), block_bytes) == ([1, 2], [0, 0, 0], [0, 0, 0])


def test_a_head_without_acknowledge_is_garbage() -> None:
    assert read(bytes.fromhex("a02800c9") + packet(1), 1000) == ([1], [4, 0], [0, 0])


def test_every_single_byte_error_is_detected() -> None:
    for at in range(106):
        wrong = bytearray(packet(2, 12345))
        wrong[at] ^= 0x10
        numbers, skipped, broken = read(packet(1) + bytes(wrong) + packet(3), 4096)
        assert (numbers, skipped) == ([1, 3], [0, 106, 0])
        assert broken == [0, 0 if at in (0, 3) else 1, 0]


def test_a_truncated_packet_is_garbage_and_the_next_is_read() -> None:
    assert read(packet(1) + packet(2)[:50] + packet(3), 4096) == ([1, 3], [0, 50, 0], [0, 0, 0])
    assert read(packet(1) + packet(2)[:105], 4096) == ([1], [0, 105], [0, 0])


def test_a_valid_packet_within_a_broken_packet_is_read() -> None:
    inner = packet(9)
    broken = packet(2)[:30] + inner
    assert read(packet(1) + broken, 4096)[0] == [1, 9]


def test_a_packet_within_a_valid_packet_is_part_of_its_payload() -> None:
    """A payload that is itself a complete valid packet, ten bytes later."""
    head, filler = struct.pack(">BHBI", 0xAA, 5, 100, 0), b"\x01\x01"
    inner = bytearray(packet(6))
    outer_body = head + filler + bytes(inner[:94])
    inner[94:96] = struct.pack(">H", sum(outer_body))
    inner[104:] = struct.pack(">H", sum(inner[:104]))
    stream = head + filler + bytes(inner)
    assert read(bytes(inner), 4096)[0] == [6]
    assert read(stream, 4096) == ([5], [0, 10], [0, 0])


@pytest.mark.slow
def test_a_broken_packet_at_the_edge_of_a_block_is_reported() -> None:
    """Both have the same framing: the first ends in a valid packet after 40 bytes, so it is garbage; the second is a
    broken packet.
    """
    start = bytes.fromhex("aa000064")
    stream = packet(1) + start + bytes(36) + packet(2) + start + bytes(102) + packet(3)
    for block_bytes in range(1, len(stream) + 1):
        assert read(stream, block_bytes) == ([1, 2, 3], [0, 40, 106, 0], [0, 0, 1, 0])


noise = st.one_of(
    st.binary(max_size=150),
    st.lists(st.sampled_from([0xAA, 100, 0, 1]), max_size=250).map(bytes),
    st.lists(st.just(0xAA), max_size=250).map(bytes),
)


@given(st.lists(st.tuples(noise, st.integers(0, 65535)), max_size=12), noise, st.integers(1, 700))
def test_all_packets_are_read_between_any_noise(parts: list[tuple[bytes, int]], tail: bytes, block_bytes: int) -> None:
    stream = packet(0) + b"".join(garbage + packet(number) for garbage, number in parts) + tail
    numbers, skipped, _ = read(stream, block_bytes)
    assert numbers == [0, *(number for _, number in parts)]
    assert skipped == [0, *(len(garbage) for garbage, _ in parts), len(tail)]


framed = st.binary(max_size=20).map(lambda start: (b"\xaa\x00\x00\x64" + start).ljust(106, b"\x01"))


@given(
    st.lists(st.one_of(framed, noise, st.integers(0, 65535).map(packet)), max_size=15).map(
        lambda parts: packet(0) + b"".join(parts)
    ),
    st.integers(1, 500),
)
def test_results_do_not_depend_on_blocks(stream: bytes, block_bytes: int) -> None:
    numbers, skipped, broken = read(stream, block_bytes)
    assert (numbers, skipped, broken) == read(stream, 1 << 20)
    assert sum(skipped) + 106 * len(numbers) == len(stream)
    assert all(106 * bad <= gap for bad, gap in zip(broken, skipped, strict=True))


def test_the_extract_has_only_valid_packets() -> None:
    with EXTRACT.open("rb") as file:
        pieces = list(read_packets(file))
    packets = np.concatenate([piece.packets for piece in pieces])
    assert len(packets) == 12_500
    assert sum(int(piece.skipped.sum()) for piece in pieces) == 0
    assert EXTRACT.stat().st_size == 4 + 106 * 12_500 < 1_500_000


def test_memory_does_not_grow_with_the_stream(tmp_path: Path) -> None:
    def peak(packets: int) -> int:
        path = tmp_path / "stream.bin"
        path.write_bytes(packet(1) * packets)
        tracemalloc.start()
        with path.open("rb") as file:
            assert sum(len(piece.packets) for piece in read_packets(file)) == packets
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    assert peak(120_000) < 1.1 * peak(20_000)
