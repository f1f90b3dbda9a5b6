"""The journal as bytes: what is whole is read, what is not is not; and nothing in it is believed for being there."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imuarray.errors import LogError
from imuarray.log.format import Event, Phase, SensorHeader
from imuarray.log.journal import JournalLock, JournalReader, JournalWriter, Mark, journal_of
from imuarray.log.layout import Begun, Notes, groups_of, note_columns
from imuarray.log.preamble import Preamble

SENSORS = (
    SensorHeader("S", "l3g4200d", "angular_rate", "dps", 250.0, 114.3, has_temperature=True, delay_ns=3),
    SensorHeader(
        "P", "bmp180", "pressure", "Pa", 0, 0, columns=("ut", "up"), compensated=("pressure",), extra={"AC1": 4}
    ),
)
PREAMBLE = Preamble(SENSORS, "i2c", "2026-01-01T00:00:00Z", "# Größe", "imuarray", "abc")
GROUPS = groups_of(SENSORS)
ROW = struct.Struct("<q3hHh")  # time, counts, status, temperature of S, as imuarray.log.layout says


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


def test_the_bytes_are_as_described(tmp_path: Path) -> None:
    content = written(tmp_path / "r.h5", BLOCKS[:1])
    text = PREAMBLE.to_json().encode()
    head = b"imuarray journal 1\n" + struct.pack("<I", len(text)) + text
    first = zlib.crc32(head)
    block = struct.pack("<HHI", 0, zlib.crc32(b"abc") & 0xFFFF, 1)
    chain = zlib.crc32(block + BLOCKS[0][2], first)
    assert content == head + struct.pack("<I", first) + block + struct.pack("<I", chain) + BLOCKS[0][2]


def test_what_is_written_is_read(tmp_path: Path) -> None:
    written(tmp_path / "r.h5", BLOCKS)
    assert read(tmp_path / "r.h5") == BLOCKS
    with JournalReader(tmp_path / "r.h5") as journal:
        assert journal.preamble == PREAMBLE
        marks = [record.after for record in journal.records()]
        assert [record.payload for record in journal.records(marks[1])] == [block[2] for block in BLOCKS[2:]]
        assert list(journal.records(marks[-1])) == []
        assert list(journal.records(Mark(10**9, 0))) == []


def test_cut_anywhere_it_holds_the_blocks_before(tmp_path: Path) -> None:
    content = written(tmp_path / "r.h5", BLOCKS)
    ends = []
    with JournalReader(tmp_path / "r.h5") as journal:
        begin = journal.start.position
        ends = [record.after.position for record in journal.records()]
    for length in [*range(0, begin, 29), *range(begin - 3, len(content))]:
        journal_of(tmp_path / "r.h5").write_bytes(content[:length])
        if length < begin:
            with pytest.raises(LogError):
                read(tmp_path / "r.h5")
        else:
            assert read(tmp_path / "r.h5") == BLOCKS[: sum(end <= length for end in ends)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return written(tmp_path_factory.mktemp("whole") / "r.h5", BLOCKS)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(where=st.integers(0, 10**6), bits=st.integers(1, 255))
def test_with_a_wrong_byte_it_holds_blocks_that_were_written(
    tmp_path: Path, whole: bytes, where: int, bits: int
) -> None:
    content = bytearray(whole)
    content[where % len(content)] ^= bits
    journal_of(tmp_path / "r.h5").write_bytes(content)
    try:
        found = read(tmp_path / "r.h5")
    except LogError:
        return
    rest = iter(BLOCKS)
    assert all(block in rest for block in found)
    assert len(found) < len(BLOCKS)


ROWS = [(0, 1, ROW.pack(number, number, -2, 3, 4, 5)) for number in range(1, 401)]
SIZE = 12 + ROW.size
"""Of one of these blocks."""


def untagged(content: bytes, begin: int) -> bytes:
    """The journal of `ROWS` as an earlier version wrote it."""
    (chain,), made = struct.unpack_from("<I", content, begin - 4), content[:begin]
    for group, rows, payload in ROWS:
        head = struct.pack("<HHI", group, 0, rows)
        chain = zlib.crc32(head + payload, chain)
        made += head + struct.pack("<I", chain) + payload
    return made


@pytest.mark.parametrize("tagged", [True, False])
@pytest.mark.parametrize("byte", [0, 2, 4, 5, 8, 12, SIZE - 1])
def test_behind_a_flipped_bit_blocks_are_good_again(tmp_path: Path, byte: int, tagged: bool) -> None:
    content = bytearray(written(tmp_path / "r.h5", ROWS))
    begin = len(content) - len(ROWS) * SIZE
    content = content if tagged else bytearray(untagged(bytes(content), begin))
    at = next(number for number in range(100, 400) if 0 < (begin + number * SIZE) % 512 < 400)
    content[begin + at * SIZE + byte] ^= 1
    journal_of(tmp_path / "r.h5").write_bytes(content)
    with JournalReader(tmp_path / "r.h5") as journal:
        found = [(record.group, record.rows, record.payload) for record in journal.records()]
        assert found == ROWS[:at] + ROWS[at + 1 :]
        start = begin + at * SIZE
        assert journal.damage == [f"journal: bytes {start} to {start + SIZE - 1} are damaged, rows are lost"]


def test_behind_a_bad_sector_blocks_are_good_again(tmp_path: Path) -> None:
    content = bytearray(written(tmp_path / "r.h5", ROWS))
    content[5120:5632] = b"\x55" * 512
    journal_of(tmp_path / "r.h5").write_bytes(content)
    found = read(tmp_path / "r.h5")
    begin = len(content) - len(ROWS) * SIZE
    assert found[: (5120 - begin) // SIZE] == ROWS[: (5120 - begin) // SIZE]
    assert found[-1] == ROWS[-1]
    assert len(ROWS) - 512 // SIZE - 3 <= len(found) < len(ROWS)


@pytest.mark.parametrize("left", [SIZE - 1, SIZE, 5])
def test_a_torn_end_is_no_damage(tmp_path: Path, left: int) -> None:
    content = bytearray(written(tmp_path / "r.h5", ROWS))
    journal_of(tmp_path / "r.h5").write_bytes(content[: -SIZE + left - 3] + b"abc")
    with JournalReader(tmp_path / "r.h5") as journal:
        assert len(list(journal.records())) == len(ROWS) - 1
        assert journal.damage == []


def test_a_page_that_a_power_cut_kept_from_the_disk_is_the_end(tmp_path: Path) -> None:
    content = bytearray(written(tmp_path / "r.h5", ROWS))
    content[4096:8192] = bytes(4096)
    journal_of(tmp_path / "r.h5").write_bytes(content)
    with JournalReader(tmp_path / "r.h5") as journal:
        assert len(list(journal.records())) == (4096 - journal.start.position) // SIZE
        assert journal.damage == []


def test_stale_sectors_of_another_log_are_not_believed(tmp_path: Path) -> None:
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


def test_times_that_go_back_behind_damage_are_not_believed(tmp_path: Path) -> None:
    content = bytearray(written(tmp_path / "r.h5", [*ROWS[:50], *ROWS[40:]]))
    begin = len(content) - 410 * SIZE
    content[begin + 49 * SIZE + 20] ^= 1
    journal_of(tmp_path / "r.h5").write_bytes(content)
    assert read(tmp_path / "r.h5") == ROWS[:49]


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=200))
def test_any_bytes(tmp_path: Path, content: bytes) -> None:
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
def test_preambles_that_mean_nothing(tmp_path: Path, text: bytes) -> None:
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


def test_a_block_that_can_not_be_written_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that takes 40 bytes and then says that it is full."""
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


def test_rows_as_bytes_and_back() -> None:
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


def test_phases_and_events_are_lines() -> None:
    notes = [Phase(1, 2, "z_up", "+Z"), Event(-5, "Ä", "lost", 'a "b"\n')]
    columns = {"text": np.concatenate([note_columns(note)["text"] for note in notes])}
    read = Notes()
    read.add(columns)
    assert read == Notes([Phase(1, 2, "z_up", "+Z")], [Event(-5, "Ä", "lost", 'a "b"\n')])
    for text in (b"x", b"{}\n", b'{"event": [1, 2]}\n', b"\xff\n"):
        with pytest.raises(LogError, match="phases and events"):
            Notes().add({"text": np.frombuffer(text, np.uint8)})


def test_a_phase_that_was_never_ended_goes_on_to_the_end() -> None:
    notes = Notes(
        [Phase(0, 50, "z_up", "+Z"), Phase(0, 50, "z_up", "+Z")],
        begun=[Begun(0, 10**9, "z_up"), Begun(50, 10**9, "room"), Begun(60, 70, "heat"), Begun(200, 10**9, "cool")],
    )
    assert notes.phases_until(100) == [
        Phase(0, 50, "z_up", "+Z"),
        Phase(0, 50, "z_up", "+Z"),
        Phase(50, 100, "room"),
        Phase(60, 70, "heat"),
    ]
