"""Hostile logs are refused, each with one line, before any column is read."""

from __future__ import annotations

import json
import os
import re
import struct
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import h5py
import pytest

from imuarray.cli import main
from imuarray.errors import LogError
from imuarray.log import LogWriter, open_log
from imuarray.log.format import Preamble, SensorHeader
from imuarray.log.journal import JournalReader, groups_of, is_running, journal_of
from tests.log.hostile_files import KINDS, damage_log
from tests.selection import some

EPOCH = "2013-09-16T08:30:00.000000Z"
GYRO = SensorHeader("Gyro", "l3g4200d", "angular_rate", "dps", 250.0, 1 / 0.00875, 800.0, 35.0, delay_ns=1_500_000)


def refusal(path: Path) -> str:
    with pytest.raises(LogError) as refused, open_log(path) as log:
        _ = log.phases, log.events
    message = str(refused.value)
    assert message.startswith(str(path))
    assert message.isprintable()
    assert len(message) < 1000
    return message


@pytest.mark.parametrize("kind", some(KINDS, 4))
def test_hostile_logs_are_refused(small: Path, kind: str) -> None:
    message = damage_log(small, kind)
    assert message in refusal(small)


def journal(path: Path, text: bytes, rest: bytes = b"", *, length: int | None = None) -> Path:
    """A journal next to a useless file, with a preamble whose check sum is right."""
    path.write_bytes(b"\x89HDF\r\n\x1a\n")
    head = b"imuarray journal 1\n" + struct.pack("<I", len(text) if length is None else length) + text
    journal_of(path).write_bytes(head + struct.pack("<I", zlib.crc32(head)) + rest)
    return path


def preamble(**changed: Any) -> bytes:
    """The preamble of a good journal, with these changes."""
    header = json.loads(Preamble((GYRO,), "i2c", EPOCH, "", "x", "id").to_json())
    header["sensors"][0] |= {name: value for name, value in changed.items() if name in header["sensors"][0]}
    return json.dumps(header | {name: value for name, value in changed.items() if name in header}).encode()


def block(text: bytes, group: int, rows: int, payload: bytes) -> bytes:
    """One block after that preamble, with its check sum."""
    head = b"imuarray journal 1\n" + struct.pack("<I", len(text)) + text
    crc = zlib.crc32(payload, zlib.crc32(struct.pack("<HHI", group, 0, rows), zlib.crc32(head)))
    return struct.pack("<HHII", group, 0, rows, crc) + payload


def test_a_journal_alone_is_read(tmp_path: Path) -> None:
    row = struct.pack("<q3hH", 5, 1, 2, 3, 0)
    path = journal(tmp_path / "r.h5", preamble(), block(preamble(), 0, 1, row))
    with open_log(path) as log:
        assert log["Gyro"].counts[:].tolist() == [[1, 2, 3]]
        assert log.is_rebuilt


@pytest.mark.parametrize(
    "text",
    [
        b"[" * 100_000,
        b'{"sensors": ' + b"[" * 50_000,
        b"{}",
        b"null",
        preamble(sensors={}),
        preamble(sensors=[5]),
        preamble(sensors=[json.loads(preamble())["sensors"][0]] * 2),
        preamble(sensors=[json.loads(preamble())["sensors"][0]] * 1000),
        preamble(name="../../etc/passwd"),
        preamble(name="a\x00b"),
        preamble(name="\x1b[2J"),
        preamble(name=""),
        preamble(name=5),
        preamble(name="x" * 70_000),
        preamble(quantity="wealth"),
        preamble(unit=None),
        preamble(axes="+X+X+X"),
        preamble(axes=["+X"]),
        preamble(range=float("nan")),
        preamble(range="wide"),
        preamble(rate_hz=10**400),
        preamble(position_mm=[1, 2]),
        preamble(position_mm=5),
        preamble(columns=["x"] * 100_000),
        preamble(columns=[]),
        preamble(columns=[["x"]]),
        preamble(compensated=["time"]),
        preamble(compensated=["a", "a"]),
        preamble(compensated=["../counts"]),
        preamble(has_temperature="yes"),
        preamble(delay_ns=1 << 80),
        preamble(extra={"chip": "x"}),
        preamble(extra={"orientation": 5}),
        preamble(extra={"a": [1] * 10}),
        preamble(extra={"a": 1 << 70}),
        preamble(extra={"a/b": 1}),
        preamble(extra=[1]),
        preamble(epoch=5),
        preamble(source="a\x00"),
    ],
    ids=lambda text: text[-60:].decode(),
)
def test_hostile_preambles_are_refused(tmp_path: Path, text: bytes) -> None:
    refusal(journal(tmp_path / "r.h5", text))


def test_a_preamble_longer_than_its_file_is_refused(tmp_path: Path) -> None:
    refusal(journal(tmp_path / "r.h5", b"{}", length=0xFFFFFFFF))


@pytest.mark.parametrize(
    "line",
    [
        b"[" * 100_000,
        b'{"phase": [1, 2, 3]}',
        b'{"phase": ["soon", 2, "x", ""]}',
        b'{"phase": [1, 1e300, "x", ""]}',
        b'{"event": [1' + b"0" * 30 + b', "a", "b", "c"]}',
        b'{"event": [true, "a", "b", "c"]}',
        b'{"event": {"time_ns": 1}}',
        b'{"event": 5}',
        b'{"event": [1, "a", "b", "c", "d", "e"]}',
        b"5",
        b"\xff",
    ],
)
def test_hostile_notes_are_refused(tmp_path: Path, line: bytes) -> None:
    notes = len(groups_of([GYRO])) - 1
    refusal(journal(tmp_path / "r.h5", preamble(), block(preamble(), notes, len(line), line)))


def test_a_block_with_an_excessive_size_allocates_no_memory(tmp_path: Path) -> None:
    path = journal(tmp_path / "r.h5", preamble(), struct.pack("<HHII", 0, 0, (1 << 28) // 16, 0) + b"x" * 100)
    tracemalloc.start()
    with open_log(path) as log:
        assert len(log["Gyro"]) == 0
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 24


def test_a_journal_that_is_a_pipe_does_not_block(small: Path) -> None:
    os.mkfifo(journal_of(small))
    with open_log(small) as log:
        assert log.state == "finished"
    with pytest.raises(LogError):
        JournalReader(small)
    assert not is_running(small)


def test_an_unfinished_hostile_log_is_refused(tmp_path: Path) -> None:
    """The table of commits is a link to another file: it is not followed."""
    path = tmp_path / "r.h5"
    with h5py.File(path, "w", libver="latest") as file:
        file.attrs["preamble"] = "{}"
        file["commits"] = h5py.ExternalLink("other.h5", "/x")
    journal_of(path).write_bytes(b"")
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["x"] = 5
    refusal(path)


def test_control_characters_are_escaped(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with h5py.File(small, "r+") as file:
        del file["events/message"]
        file["events/message"] = ["\x1b[2J gone\r\n"]
        file["sensors/Acc"].attrs["chip"] = "\x9b31mchip"
        file.attrs["software"] = "a\u202eb"
    assert main(["info", str(small)]) == 0
    output = capsys.readouterr().out
    assert r"\x1b[2J gone\r\n" in output
    assert r"\x9b31mchip" in output
    assert r"a\u202eb" in output
    assert output.replace("\n", "").isprintable()


SOURCE = Path(__file__).parents[2]
PICKLES = re.compile(
    r"\b(pickle|cPickle|dill|joblib|shelve|marshal)\b\s*(\.|import|$)|import (pickle|dill|joblib|shelve|marshal)"
    r"|allow_pickle\s*=\s*True|\b(?:np|numpy)\.load\(|read_pickle|yaml\.load|\beval\(|\bexec\(|dtype=object|h5py\.opaque"
)


@pytest.mark.slow
def test_nothing_is_unpickled() -> None:
    """Files are data: no module loads executable objects."""
    result = [
        f"{path.name}: {line.strip()}"
        for folder in ("imuarray", "firmware_emulator")
        for path in sorted((SOURCE / folder).rglob("*.py"))
        for line in path.read_text(encoding="utf-8").splitlines()
        if PICKLES.search(line)
    ]
    assert result == []


def test_a_log_of_too_many_sensors_is_not_written(tmp_path: Path) -> None:
    """A log that could not be read again is refused at once."""
    headers = [SensorHeader(f"S{number}", "x", "angular_rate", "dps", 250.0, 114.3) for number in range(513)]
    with pytest.raises(LogError, match="513 sensors; a log has at most 512"):
        LogWriter(tmp_path / "r.h5", headers, source="simulated", epoch="2026-01-01T00:00:00Z")
    assert list(tmp_path.iterdir()) == []
