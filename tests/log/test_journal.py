"""The journal as bytes: whole blocks are read, others are not; and no field is used unchecked."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import imuarray.log.salvage as salvage
from imuarray.errors import LogError
from imuarray.log.format import Event, Phase, Preamble, SensorHeader
from imuarray.log.journal import (
    JournalLock,
    JournalReader,
    JournalWriter,
    Mark,
    Notes,
    OpenPhase,
    groups_of,
    journal_of,
    note_columns,
)
from tests.selection import examples, some

SENSORS = (
    SensorHeader("S", "l3g4200d", "angular_rate", "dps", 250.0, 114.3, has_temperature=True, delay_ns=3),
    SensorHeader(
        "P", "bmp180", "pressure", "Pa", 0, 0, columns=("ut", "up"), compensated=("pressure",), extra={"AC1": 4}
    ),
)
PREAMBLE = Preamble(SENSORS, "i2c", "2026-01-01T00:00:00Z", "# Größe", "imuarray", "abc")
GROUPS = groups_of(SENSORS)
ROW = struct.Struct("<q3hHh")  # time, counts, status, temperature of S, as imuarray.log.journal states


def written(path: Path, blocks: list[tuple[int, int, bytes]]) -> bytes:
    lock = JournalLock(path, create=True)
    journal = JournalWriter(lock.fd, PREAMBLE)
    for block in blocks:
        journal.append([block])
    journal.sync()
    lock.close()
    return journal_of(path).read_bytes()


def read(path: Path, start: Mark | None = None) -> list[tuple[int, int, bytes]]:
    with JournalReader(path) as journal:
        return [(record.group, record.rows, record.payload) for record in journal.records(start)]


BLOCKS = [(0, 1, ROW.pack(5, 1, -2, 3, 4, 5)), (5, 3, b"abc"), (0, 2, ROW.pack(6, 7, 8, 9, 1, 1) * 2), (5, 1, b"x")]


def test_the_bytes_match_the_description(tmp_path: Path) -> None:
    content = written(tmp_path / "r.h5", BLOCKS[:1])
    text = PREAMBLE.to_json().encode()
    head = b"imuarray journal 2\n" + struct.pack("<I", len(text)) + text
    first = zlib.crc32(head)
    block = struct.pack("<HHI", 0, zlib.crc32(b"abc") & 0xFFFF, 1)
    chain = zlib.crc32(block + BLOCKS[0][2], first)
    assert content == (head + struct.pack("<I", first)) * 2 + block + struct.pack("<I", chain) + BLOCKS[0][2]


def test_blocks_written_are_read_back(tmp_path: Path) -> None:
    written(tmp_path / "r.h5", BLOCKS)
    assert read(tmp_path / "r.h5") == BLOCKS
    with JournalReader(tmp_path / "r.h5") as journal:
        assert journal.preamble == PREAMBLE
        marks = [record.after for record in journal.records()]
        assert [record.payload for record in journal.records(marks[1])] == [block[2] for block in BLOCKS[2:]]
        assert list(journal.records(marks[-1])) == []
        assert list(journal.records(Mark(10**9, 0))) == []


def test_a_journal_cut_anywhere_keeps_the_blocks_before_the_cut(tmp_path: Path) -> None:
    content = written(tmp_path / "r.h5", BLOCKS)
    ends = []
    with JournalReader(tmp_path / "r.h5") as journal:
        begin = journal.start.position
        ends = [record.after.position for record in journal.records()]
    for length in [*range(0, begin, 29), *range(begin - 3, len(content))]:
        journal_of(tmp_path / "r.h5").write_bytes(content[:length])
        if length < begin // 2:  # the preamble is stored twice
            with pytest.raises(LogError):
                read(tmp_path / "r.h5")
        else:
            assert read(tmp_path / "r.h5") == BLOCKS[: sum(end <= length for end in ends)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return written(tmp_path_factory.mktemp("whole") / "r.h5", BLOCKS)


@settings(max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(where=st.integers(0, 10**6), bits=st.integers(1, 255))
def test_a_wrong_byte_never_gives_a_block_that_was_not_written(
    tmp_path: Path, whole: bytes, where: int, bits: int
) -> None:
    content = bytearray(whole)
    content[where % len(content)] ^= bits
    journal_of(tmp_path / "r.h5").write_bytes(content)
    with JournalReader(tmp_path / "r.h5") as journal:
        blocks = [(record.group, record.rows, record.payload) for record in journal.records()]
        rest = iter(BLOCKS)
        assert all(block in rest for block in blocks)
        assert blocks == BLOCKS or journal.damage


@settings(max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(where=st.integers(0, 10**6), bits=st.integers(1, 255), known=st.booleans())
def test_a_wrong_byte_in_the_preamble_loses_nothing(
    tmp_path: Path, whole: bytes, where: int, bits: int, known: bool
) -> None:
    """It is stored twice; where both copies are damaged, that of the HDF5 file replaces them."""
    size = len(b"imuarray journal 2\n") + 4 + len(PREAMBLE.to_json()) + 4
    content = bytearray(whole)
    content[where % (2 * size)] ^= bits
    if known:
        content[(where + size) % (2 * size)] ^= bits
    journal_of(tmp_path / "r.h5").write_bytes(content)
    with JournalReader(tmp_path / "r.h5", known=PREAMBLE if known else None) as journal:
        assert journal.preamble == PREAMBLE
        assert [(record.group, record.rows, record.payload) for record in journal.records()] == BLOCKS
        assert journal.damage == []


ROWS = [(0, 1, ROW.pack(number, number, -2, 3, 4, 5)) for number in range(1, 401)]
SIZE = 12 + ROW.size
"""Of one of these blocks."""


def of_version_1(tag: int) -> bytes:
    """The journal of `ROWS` as earlier versions wrote it: one copy of the preamble, and this tag."""
    text = PREAMBLE.to_json().encode()
    head = b"imuarray journal 1\n" + struct.pack("<I", len(text)) + text
    chain = zlib.crc32(head)
    content = head + struct.pack("<I", chain)
    for group, rows, payload in ROWS:
        head = struct.pack("<HHI", group, tag, rows)
        chain = zlib.crc32(head + payload, chain)
        content += head + struct.pack("<I", chain) + payload
    return content


TAG = zlib.crc32(b"abc") & 0xFFFF


@pytest.mark.parametrize("version", ["2", "1", "1, without tags"])
@pytest.mark.parametrize("byte", [0, 2, 4, 5, 8, 12, SIZE - 1])
def test_a_flipped_bit_loses_only_the_payload_that_it_hits(tmp_path: Path, byte: int, version: str) -> None:
    """Bytes 0 to 11 are the head, which can be reconstructed."""
    content = written(tmp_path / "r.h5", ROWS) if version == "2" else of_version_1(TAG if version == "1" else 0)
    spoilt, begin = bytearray(content), len(content) - len(ROWS) * SIZE
    at = next(number for number in range(100, 400) if 0 < (begin + number * SIZE) % 512 < 400)
    spoilt[begin + at * SIZE + byte] ^= 1
    journal_of(tmp_path / "r.h5").write_bytes(spoilt)
    with JournalReader(tmp_path / "r.h5") as journal:
        blocks = [(record.group, record.rows, record.payload) for record in journal.records()]
        start = begin + at * SIZE
        if byte < 12 and version != "1, without tags":
            assert (blocks, journal.damage) == (ROWS, [])
        else:
            assert [block for block in ROWS if block not in blocks] in ([ROWS[at]], [])
            lost = f"journal: bytes {start} to {start + SIZE - 1} are damaged, rows are lost"
            assert journal.damage == ([] if len(blocks) == len(ROWS) else [lost])
            assert byte < 12 or len(blocks) == len(ROWS) - 1


@pytest.mark.parametrize("byte", [0, 2, 4, 5, 12, SIZE - 1])
def test_a_flipped_bit_in_the_last_block_is_reported(tmp_path: Path, byte: int) -> None:
    content = bytearray(written(tmp_path / "r.h5", ROWS))
    content[len(content) - SIZE + byte] ^= 1
    journal_of(tmp_path / "r.h5").write_bytes(content)
    with JournalReader(tmp_path / "r.h5") as journal:
        count = len(list(journal.records()))
        start = len(content) - SIZE
        lost = f"journal: bytes {start} to {start + SIZE - 1} are damaged, rows are lost"
        assert (count, journal.damage) == ((400, []) if byte < 8 else (399, [lost]))


def test_blocks_after_a_bad_sector_are_read(tmp_path: Path) -> None:
    content = bytearray(written(tmp_path / "r.h5", ROWS))
    content[5120:5632] = b"\x55" * 512
    journal_of(tmp_path / "r.h5").write_bytes(content)
    blocks = read(tmp_path / "r.h5")
    begin = len(content) - len(ROWS) * SIZE
    assert blocks[: (5120 - begin) // SIZE] == ROWS[: (5120 - begin) // SIZE]
    assert blocks[-1] == ROWS[-1]
    assert len(ROWS) - 512 // SIZE - 3 <= len(blocks) < len(ROWS)


@pytest.mark.parametrize("length", [SIZE - 1, 12, 11, 5, 1])
@pytest.mark.parametrize("zeros", [0, 1, 5000, 100_000])
def test_an_incomplete_last_block_is_no_damage(tmp_path: Path, length: int, zeros: int) -> None:
    """A kill leaves the first bytes of a block; a power cut zeros from the end of a page on."""
    begin = len(written(tmp_path / "o.h5", []))
    content = written(tmp_path / "r.h5", ROWS)[: length - SIZE]
    if zeros:
        content = content[: len(content) // 4096 * 4096]
    journal_of(tmp_path / "r.h5").write_bytes(content + bytes(zeros))
    with JournalReader(tmp_path / "r.h5") as journal:
        assert len(list(journal.records())) == (len(content) - begin) // SIZE
        assert journal.damage == []


@pytest.mark.parametrize("head", [1, 3, 4, 5, 11, 12, 13])
def test_a_head_whose_second_page_is_zeros_is_incomplete(tmp_path: Path, head: int) -> None:
    """The first `head` bytes of a block were the last ones of a page that reached the disk. Anything after them other
    than zeros was written later, so that the rows between are lost.
    """
    first = len(written(tmp_path / "o.h5", [(5, 1, b"#")]))
    comment = b"#" * (1 + (-head - first) % 4096)
    content = written(tmp_path / "r.h5", [(5, len(comment), comment), *ROWS[:2]])
    cut = content[: len(content) - 2 * SIZE + head]
    assert len(cut) % 4096 == 0
    for tail, damaged in ((bytes(9000), False), (bytes(5000) + b"x" + bytes(4000), True)):
        journal_of(tmp_path / "r.h5").write_bytes(cut + tail)
        with JournalReader(tmp_path / "r.h5") as journal:
            assert [record.payload for record in journal.records()] == [comment]
            assert bool(journal.damage) == damaged


@pytest.mark.parametrize(
    ("place", "kept"), [(0, False), (1, True), (250, True), (500, True), (501, False), (511, False)]
)
def test_a_check_sum_is_accepted_in_the_sector_of_the_block_before(tmp_path: Path, place: int, kept: bool) -> None:
    """A bad block, head (12 bytes) and payload, of which only the check sum is right: the block after it is kept if
    that sum is in one sector (512 bytes) with the end of the block before, and so of this log.
    """
    first = len(written(tmp_path / "o.h5", [(5, 1, b"#")]))
    comment = b"#" * (1 + (place - first) % 512)
    content = bytearray(written(tmp_path / "r.h5", [(5, len(comment), comment), *ROWS[:2]]))
    bad = len(content) - 2 * SIZE
    assert bad % 512 == place
    content[bad + 4 : bad + 8] = bytes(4)
    content[bad + 20] ^= 1
    journal_of(tmp_path / "r.h5").write_bytes(content)
    with JournalReader(tmp_path / "r.h5") as journal:
        assert [record.payload for record in journal.records()] == [comment, ROWS[1][2]][: 1 + kept]


@pytest.mark.parametrize("garbage", [b"abc", b"\xff" * 5000, bytes(5000) + b"x", b"\x55" * 12])
def test_invalid_bytes_after_the_last_block_are_reported(tmp_path: Path, garbage: bytes) -> None:
    content = written(tmp_path / "r.h5", ROWS)
    journal_of(tmp_path / "r.h5").write_bytes(content + garbage)
    with JournalReader(tmp_path / "r.h5") as journal:
        assert len(list(journal.records())) == len(ROWS)
        assert bool(journal.damage) == (len(garbage) >= 12)  # fewer may be the begin of a head


def test_blocks_after_a_page_of_zeros_are_kept(tmp_path: Path) -> None:
    """A power cut may have kept that page from the disk, or a payload of zeros was hit: the rows after it are good."""
    content = bytearray(written(tmp_path / "r.h5", ROWS))
    content[4096:8192] = bytes(4096)
    journal_of(tmp_path / "r.h5").write_bytes(content)
    with JournalReader(tmp_path / "r.h5") as journal:
        blocks = [(record.group, record.rows, record.payload) for record in journal.records()]
        begin = len(content) - len(ROWS) * SIZE
        before, behind = (4096 - begin) // SIZE, -(-(8192 - begin) // SIZE)
        assert blocks[:before] == ROWS[:before]
        assert blocks[before:] in (ROWS[behind:], ROWS[behind + 1 :], ROWS[behind + 2 :])
        assert "were not on the disk at a power cut, or are damaged, rows are lost" in journal.damage[0]


def test_a_flipped_bit_in_a_payload_of_zeros_loses_no_later_rows(tmp_path: Path) -> None:
    zeros = (0, 600, b"".join(ROW.pack(0, 0, 0, 0, 0, 0) for _ in range(600)))
    times = np.arange(500, 1100, dtype="<i8").tobytes()
    zeros = (0, 600, times + zeros[2][len(times) :])
    content = bytearray(written(tmp_path / "r.h5", [*ROWS, zeros, (0, 1, ROW.pack(2000, 1, 2, 3, 4, 5))]))
    content[len(content) - SIZE - 50] ^= 8
    journal_of(tmp_path / "r.h5").write_bytes(content)
    with JournalReader(tmp_path / "r.h5") as journal:
        assert [record.rows for record in journal.records()] == [1] * 401
        assert len(journal.damage) == 1


@pytest.mark.parametrize(
    "tail",
    some(
        [
            bytes(1 << 24),
            b"\xff" * (1 << 24),
            struct.pack("<HHII", 0, TAG, 1, 5) * 1_400_000,
            TAG.to_bytes(2, "little") * (1 << 23),
        ],
        2,
    ),
)
def test_the_search_after_damage_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tail: bytes) -> None:
    """For any bytes after a journal: the number of checked blocks is limited, and no byte is searched twice."""
    checks: list[salvage.Mark] = []
    is_good = salvage.Salvage.is_good
    monkeypatch.setattr(salvage.Salvage, "is_good", lambda self, at: (checks.append(at), is_good(self, at))[1])
    content = written(tmp_path / "r.h5", ROWS)
    journal_of(tmp_path / "r.h5").write_bytes(content + b"\1" + tail)
    with JournalReader(tmp_path / "r.h5") as journal:
        assert len(list(journal.records())) == len(ROWS)
        assert bool(journal.damage) or not any(tail)
    assert len(checks) <= (1 << 26) // 4096 * 3  # a head is checked against three check sums at the most


def test_stale_sectors_of_another_log_are_rejected(tmp_path: Path) -> None:
    """Blocks of the same size at the same places, with the other log's own check sums, and times that would go on."""
    content = bytearray(written(tmp_path / "r.h5", ROWS))
    other = Preamble(SENSORS, "i2c", "2026-01-01T00:00:00Z", "# Größe", "imuarray", "abd")
    lock = JournalLock(tmp_path / "o.h5", create=True)
    journal = JournalWriter(lock.fd, other)
    journal.append([(0, 1, ROW.pack(number, -1, -2, 3, 4, 6)) for number in range(1, 401)])
    lock.close()
    stale = journal_of(tmp_path / "o.h5").read_bytes()
    begin = len(content) - len(ROWS) * SIZE
    for start in (4096, begin + 100 * SIZE, begin + 100 * SIZE + 10):
        journal_of(tmp_path / "r.h5").write_bytes(content[:start] + stale[start:])
        assert read(tmp_path / "r.h5") == ROWS[: (start - begin) // SIZE]


def test_times_that_decrease_after_damage_are_rejected(tmp_path: Path) -> None:
    content = bytearray(written(tmp_path / "r.h5", [*ROWS[:50], *ROWS[40:]]))
    begin = len(content) - 410 * SIZE
    content[begin + 49 * SIZE + 20] ^= 1
    journal_of(tmp_path / "r.h5").write_bytes(content)
    assert read(tmp_path / "r.h5") == ROWS[:49]


@settings(max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=200))
def test_any_bytes_are_refused(tmp_path: Path, content: bytes) -> None:
    journal_of(tmp_path / "r.h5").write_bytes(content)
    with pytest.raises(LogError):
        read(tmp_path / "r.h5")


def preamble(text: bytes) -> bytes:
    head = b"imuarray journal 1\n" + struct.pack("<I", len(text)) + text
    return head + struct.pack("<I", zlib.crc32(head))


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"[]",
        b"{}",
        b'{"sensors": 5}',
        b"[" * 100_000,
        PREAMBLE.to_json().replace('"i2c"', "5").encode(),
        PREAMBLE.to_json().replace('"S"', '"../S"').encode(),
        PREAMBLE.to_json().replace('"name": "S"', '"nome": "S"').encode(),
        PREAMBLE.to_json().replace('"AC1"', "AC1").encode(),
    ],
)
def test_invalid_preambles_are_refused(tmp_path: Path, text: bytes) -> None:
    journal_of(tmp_path / "r.h5").write_bytes(preamble(text))
    with pytest.raises(LogError, match="preamble can't be read"):
        read(tmp_path / "r.h5")


def test_absurd_lengths_allocate_nothing(tmp_path: Path) -> None:
    content = written(tmp_path / "r.h5", [])
    journal_of(tmp_path / "r.h5").write_bytes(content + struct.pack("<HHII", 0, 0, 2**32 - 1, 0))
    assert read(tmp_path / "r.h5") == []
    journal_of(tmp_path / "r.h5").write_bytes(b"imuarray journal 1\n" + struct.pack("<I", 2**32 - 1))
    with pytest.raises(LogError, match="beginning is damaged"):
        read(tmp_path / "r.h5")


def test_a_block_that_cannot_be_written_leaves_no_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that accepts 40 bytes and then is full."""
    lock = JournalLock(tmp_path / "r.h5", create=True)
    journal = JournalWriter(lock.fd, PREAMBLE)
    journal.append(BLOCKS[:1])
    size = journal_of(tmp_path / "r.h5").stat().st_size
    import imuarray.log.journal as module

    real, left = module.os.write, [40]

    def full(fd: int, data: bytes) -> int:
        if not left[0]:
            raise OSError(28, "No space left on device")
        written = real(fd, bytes(data)[: left[0]])
        left[0] -= written
        return written

    with monkeypatch.context() as patch:
        patch.setattr(module.os, "write", full)
        with pytest.raises(OSError, match="No space"):
            journal.append(BLOCKS[2:])
    assert journal_of(tmp_path / "r.h5").stat().st_size == size
    journal.append(BLOCKS[1:])
    lock.close()
    assert read(tmp_path / "r.h5") == BLOCKS


def test_rows_are_encoded_and_decoded() -> None:
    group = GROUPS[0]
    columns = group.decode(ROW.pack(5, 1, -2, 3, 4, 5) + ROW.pack(5, 1, -2, 3, 4, 5)[:0], 1)
    assert {name: column.tolist() for name, column in columns.items()} == {
        "time": [5],
        "counts": [[1, -2, 3]],
        "status": [4],
        "temperature_counts": [5],
    }
    assert group.encode(columns) == ROW.pack(5, 1, -2, 3, 4, 5)
    with pytest.raises(ValueError, match="rows of shape"):
        group.checked(columns | {"counts": np.ones((1, 2), np.int16)})


def test_phases_and_events_are_stored_as_lines() -> None:
    notes = [Phase(1, 2, "z_up", "+Z"), Event(-5, "Ä", "lost", 'a "b"\n')]
    columns = {"text": np.concatenate([note_columns(note)["text"] for note in notes])}
    read = Notes()
    read.add(columns)
    assert read == Notes([Phase(1, 2, "z_up", "+Z")], [Event(-5, "Ä", "lost", 'a "b"\n')])
    for text in (b"x", b"{}\n", b'{"event": [1, 2]}\n', b"\xff\n"):
        with pytest.raises(LogError, match="phases and events"):
            Notes().add({"text": np.frombuffer(text, np.uint8)})


def test_a_phase_without_an_end_lasts_until_the_last_row() -> None:
    notes = Notes(
        [Phase(0, 50, "z_up", "+Z"), Phase(0, 50, "z_up", "+Z")],
        begun=[
            OpenPhase(0, 10**9, "z_up"),
            OpenPhase(50, 10**9, "room"),
            OpenPhase(60, 70, "heat"),
            OpenPhase(200, 10**9, "cool"),
        ],
    )
    assert notes.phases_until(100) == [
        Phase(0, 50, "z_up", "+Z"),
        Phase(0, 50, "z_up", "+Z"),
        Phase(50, 100, "room"),
        Phase(60, 70, "heat"),
    ]
