"""Logs that were never finished: read as they are, finished by `recover`, checked by `verify`, for any damage."""

from __future__ import annotations

import errno
import json
import os
import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import imuarray.log.interrupted as interrupted
import imuarray.log.writer as writing
from imuarray.cli import main
from imuarray.errors import DiskFullError, LogError, LogWarning
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.columns import Column
from imuarray.log.format import Event, Phase, SensorHeader
from imuarray.log.inspection import UnclosedFile, is_marked_open
from imuarray.log.journal import JournalReader, journal_of
from imuarray.log.reader import verify
from imuarray.log.writer import recover
from tests.selection import examples, some

HEADERS = (
    SensorHeader("Acc", "bma180", "specific_force", "g", 16.0, 512.0, has_temperature=True, delay_ns=7),
    SensorHeader(
        "Baro",
        "bmp180",
        "pressure",
        "Pa",
        0,
        0,
        columns=("ut", "up"),
        compensated=("temperature", "pressure"),
        extra={"AC1": 408},
    ),
)
ROWS = 230


def acc(first: int, count: int) -> Block:
    row = np.arange(first, first + count)
    counts = np.stack([row, -row, row % 7 + 1], axis=1).astype(np.int16)
    return Block(row * 1000 + 5, counts, (row % 8).astype(np.uint16), (row % 100).astype(np.int16))


def baro(row: int) -> Block:
    made = {"temperature": np.array([20.5 + row]), "pressure": np.array([99_000.0 + row])}
    return Block(
        np.array([row * 1000]), np.array([[27_898 + row, 23_843]], np.int32), np.zeros(1, np.uint16), None, made
    )


@pytest.fixture(scope="module")
def cut_short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a log after a kill: 230 rows, some commits, the last rows only in the journal."""
    folder = tmp_path_factory.mktemp("cut")
    folder_of_log = folder / "left"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writing, "CHUNK", 64)
        with LogWriter(
            folder / "run.h5", HEADERS, source="emulated", epoch="2026-01-01T00:00:00Z", config="# t"
        ) as log:
            log.keep()
            log.event(Event(3, "Acc", "lost", "no reading"))
            for first in range(0, ROWS, 10):
                log.append("Acc", acc(first, 10))
                log.append("Baro", baro(first))
                log.flush()
            log.phase(Phase(0, 10, "static", ""))
            log.flush()
            folder_of_log.mkdir()
            for path in folder.iterdir():
                if path.is_file():
                    shutil.copy(path, folder_of_log / path.name)
    return folder_of_log


@pytest.fixture
def run(cut_short: Path, tmp_path: Path) -> Path:
    for path in cut_short.iterdir():
        shutil.copy(path, tmp_path / path.name)
    return tmp_path / "run.h5"


def check(path: Path, rows: int = ROWS) -> None:
    with open_log(path) as log:
        expected = acc(0, rows)
        for name in ("time", "counts", "status", "temperature_counts"):
            np.testing.assert_array_equal(np.asarray(getattr(log["Acc"], name)), getattr(expected, name))
        frames = -(-rows // 10)
        assert log["Baro"].compensated("pressure")[:].tolist() == [99_000.0 + 10 * row for row in range(frames)]
        assert log["Baro"].attributes["AC1"] == 408
        assert log["Acc"].attributes["delay_ns"] == 7
        assert log.events[:1] == (Event(3, "Acc", "lost", "no reading"),)
        assert [event.kind for event in log.events[1:]] == (["recovered"] if log.state == "finished" else [])
        assert (log.source, log.epoch, log.config) == ("emulated", "2026-01-01T00:00:00Z", "# t")
        if rows == ROWS:
            assert log.phases == (Phase(0, 10, "static", ""),)


@pytest.mark.slow
@pytest.mark.parametrize("commits", some([1, 2, 64, 65, 66, 129], 1))
def test_a_log_being_written_is_read_from_its_file_after_any_number_of_commits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, commits: int
) -> None:
    """The table of commits gets a chunk of its own for every 64: it is after the end that the superblock states."""
    monkeypatch.setattr(writing, "CHUNK", 8)
    with LogWriter(tmp_path / "run.h5", HEADERS, source="emulated", epoch="2026-01-01T00:00:00Z") as log:
        log.keep()
        for number in range(commits):
            log.append("Acc", acc(10 * number, 10))
            log.flush()
        with open_log(tmp_path / "run.h5") as seen:
            assert (seen.is_rebuilt, len(seen["Acc"]), seen.losses) == (False, 10 * commits, ())


@pytest.mark.slow
def test_an_interrupted_log_is_read_and_not_changed(run: Path) -> None:
    before = {path: path.read_bytes() for path in run.parent.iterdir()}
    assert is_marked_open(run)
    check(run)
    with open_log(run) as log:
        assert (log.state, log.is_rebuilt) == ("interrupted", False)
    assert {path: path.read_bytes() for path in run.parent.iterdir()} == before


def test_an_interrupted_log_is_recovered(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run.parent / f".run.h5.{2**22 + 1}.part").write_bytes(b"of a process that is gone")
    (run.parent / f".run.h5.{os.getppid()}.part").write_bytes(b"of one that is not")
    assert main(["recover", str(run), "--json"]) == 0
    rows = {"Acc": ROWS, "Baro": 23}
    assert json.loads(capsys.readouterr().out) == {"log": str(run), "rows": rows, "changed": True, "kept": None}
    assert {path.name for path in run.parent.iterdir()} == {"run.h5", f".run.h5.{os.getppid()}.part"}
    check(run)
    with h5py.File(run) as file:
        assert file["sensors/Acc/counts"].compression == "gzip"
        assert file["sensors/Acc/counts"].fletcher32
        assert "commits" not in file
    assert main(["recover", str(run)]) == 0
    assert "nothing to recover" in capsys.readouterr().out


@pytest.mark.slow
def test_an_interrupted_log_is_recovered_to_another_path(run: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere.h5"
    before = run.read_bytes()
    assert main(["recover", str(run), "-o", str(elsewhere)]) == 0
    check(elsewhere)
    assert run.read_bytes() == before
    assert journal_of(run).exists()
    assert main(["recover", str(run), "-o", str(elsewhere)]) == 2


def test_without_its_journal_a_log_is_read_up_to_the_last_commit(run: Path) -> None:
    journal_of(run).unlink()
    with pytest.warns(
        LogWarning, match="its journal run.h5.journal is missing: rows since the last commit are missing"
    ):
        check(run, 210)
    recover(run, force=True)
    check_damaged(run, 210)


def check_damaged(path: Path, rows: int) -> None:
    """A recovered log that states its losses."""
    with open_log(path) as log:
        assert np.asarray(log["Acc"].counts[:]).tolist() == acc(0, rows).counts.tolist()
        assert [event.kind for event in log.events] == ["lost", "damaged", "recovered"]


@pytest.mark.slow
def test_without_its_journal_a_log_is_recovered_only_with_force(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    journal_of(run).unlink()
    before = run.read_bytes()
    missing = "its journal run.h5.journal is missing: rows since the last commit are missing"
    assert main(["verify", str(run)]) == 2
    assert missing in capsys.readouterr().err
    assert main(["info", str(run)]) == 0
    output = capsys.readouterr().out
    assert missing in output
    assert "all that was acknowledged" not in output
    assert main(["recover", str(run)]) == 2
    errors = capsys.readouterr().err
    assert "copy run.h5 and run.h5.journal together" in errors
    assert len(errors.splitlines()) == 1
    assert run.read_bytes() == before
    assert main(["recover", str(run), "--force"]) == 0
    check_damaged(run, 210)


@pytest.mark.slow
def test_rows_after_a_flipped_bit_in_the_journal_are_recovered(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = bytearray(journal_of(run).read_bytes())
    with JournalReader(run) as journal:
        blocks = [record for record in journal.records() if record.group == 0]
    content[blocks[21].after.position - 4] ^= 1  # rows 210 to 219: two blocks are in no commit
    journal_of(run).write_bytes(content)
    assert main(["verify", str(run)]) == 2
    assert "are damaged, rows are lost" in capsys.readouterr().err
    assert main(["info", str(run)]) == 0
    assert "are damaged, rows are lost" in capsys.readouterr().out
    assert main(["recover", str(run)]) == 0
    aside = run.with_name("run.h5.journal.damaged")
    assert aside.read_bytes() == content
    assert not journal_of(run).exists()
    with open_log(run) as log:
        rows = np.asarray(log["Acc"].counts[:])[:, 0].tolist()
        assert rows == [*range(210), *range(220, ROWS)]
        assert [event.kind for event in log.events] == ["lost", "damaged", "recovered"]


@pytest.mark.parametrize("command", some(["info", "verify", "recover"], 1))
def test_a_journal_alone_is_the_whole_log(run: Path, command: str) -> None:
    run.unlink()
    assert main([command, str(run)]) == 0
    check(run)


def test_an_invalid_journal_alone_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run.unlink()
    journal_of(run).write_bytes(b"no journal")
    assert main(["info", str(run)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.slow
def test_a_recovered_log_has_an_event_of_its_recovery(run: Path) -> None:
    recover(run, now=datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC))
    with open_log(run) as log:
        last_ns = int(log["Acc"].time[-1])
        text = f"the log was interrupted; its {ROWS + 23} rows were recovered 2026-01-02T03:04:05Z"
        assert log.events[-1] == Event(last_ns, "", "recovered", text)


@pytest.mark.slow
def test_recovering_a_finished_log_to_another_path_copies_it(run: Path, tmp_path: Path) -> None:
    recover(run)
    copy = tmp_path / "copy.h5"
    assert main(["recover", str(run), "-o", str(copy)]) == 0
    assert copy.read_bytes() == run.read_bytes()


def test_a_full_disk_at_recovery_is_reported_and_the_log_is_unchanged(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {path: path.read_bytes() for path in run.parent.iterdir()}

    def full(fd: int, start: int, length: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("imuarray.log.disk_space._allocate", full)
    with pytest.raises(DiskFullError, match=r"no space left on the disk; the log is unchanged$"):
        recover(run)
    assert {path: path.read_bytes() for path in run.parent.iterdir()} == before


@pytest.mark.slow
def test_the_journal_of_another_log_is_ignored(run: Path, tmp_path: Path) -> None:
    content = journal_of(run).read_bytes()
    (tmp_path / "other").mkdir()
    with LogWriter(tmp_path / "other" / "run.h5", HEADERS, source="emulated", epoch="2026-01-01T00:00:00Z") as log:
        log.keep()
        log.append("Acc", acc(5000, 300))
        log.flush()
        shutil.copy(journal_of(tmp_path / "other" / "run.h5"), journal_of(run))
    assert journal_of(run).read_bytes() != content
    with pytest.warns(LogWarning, match="its journal run.h5.journal belongs to another log"):
        check(run, 210)


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage", some(["removed data", "wrong data", "wrong table", "cut", "empty", "no superblock"], 1)
)
def test_a_log_with_a_damaged_file_is_read_from_its_journal(run: Path, damage: str) -> None:
    content = bytearray(run.read_bytes())
    with h5py.File(UnclosedFile(run), "r") as file:
        chunk = file["sensors/Acc/counts"].id.get_chunk_info(3)
        table = file["commits"].id.get_chunk_info(0)
    if damage.endswith("data"):
        zeros = bytes(100) if damage.startswith("removed") else b"\x55" * 100
        content[chunk.byte_offset : chunk.byte_offset + 100] = zeros
    elif damage == "wrong table":
        content[table.byte_offset : table.byte_offset + 8] = b"\x55" * 8
    elif damage == "cut":
        del content[len(content) // 3 :]
    elif damage == "empty":
        content.clear()
    else:
        content[:48] = bytes(48)
    run.write_bytes(content)
    check(run)
    verdict = verify(run)
    assert verdict.problems == ()
    assert recover(run).rows == {"Acc": ROWS, "Baro": 23}
    check(run)
    assert not journal_of(run).exists()


@pytest.mark.slow
def test_wrong_data_before_the_last_commit_are_read_from_the_journal(run: Path) -> None:
    content = bytearray(run.read_bytes())
    with h5py.File(UnclosedFile(run), "r") as file:
        chunk = file["sensors/Acc/counts"].id.get_chunk_info(0)
    content[chunk.byte_offset + 10] ^= 1
    run.write_bytes(content)
    check(run)
    verdict = verify(run)
    assert verdict.problems == ()
    assert verdict.remarks[1] == "1 commit of its HDF5 file damaged: those rows are read from its journal"
    recover(run)
    check(run)


def test_a_log_with_file_and_journal_damaged_is_refused(run: Path) -> None:
    run.write_bytes(run.read_bytes()[:3000])
    journal_of(run).write_bytes(b"no journal")
    with pytest.raises(LogError, match="was not finished, and is damaged; its journal is damaged"):
        open_log(run)


@pytest.mark.slow
def test_a_finished_log_on_a_read_only_disk_needs_no_recovery(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recover(run)

    def refused(path: Path, missing_ok: bool = False) -> None:
        raise OSError(errno.EROFS, "Read-only file system", str(path))

    monkeypatch.setattr(Path, "unlink", refused)
    assert not recover(run).changed


def test_a_finished_log_ignores_its_remaining_journal(run: Path) -> None:
    """The state after a kill between the last two steps of its end."""
    journal = journal_of(run).read_bytes()
    recover(run)
    journal_of(run).write_bytes(journal)
    with open_log(run) as log:
        assert log.state == "finished"
    check(run)
    assert recover(run).changed is False
    assert not journal_of(run).exists()


@pytest.mark.slow
def test_a_log_that_is_finished_while_it_is_opened_is_read(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """HDF5 fails on a draft that its writer changes; then the log replaces it, and the journal is removed."""
    finished = tmp_path / "finished.h5"
    for path, copy in ((run, finished), (journal_of(run), journal_of(finished))):
        shutil.copy(path, copy)
    recover(finished)
    run.write_bytes(run.read_bytes()[:300])
    look_for_journal = interrupted._journal

    def later(*given: Any) -> Any:
        if finished.exists():
            finished.replace(run)
            journal_of(run).unlink()
        return look_for_journal(*given)

    monkeypatch.setattr(interrupted, "_journal", later)
    with open_log(run) as log:
        assert log.state == "finished"
    check(run)


@pytest.mark.slow
def test_the_journal_of_another_log_next_to_a_finished_log_is_kept(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its rows are nowhere else; nor is a journal kept before overwritten."""
    recover(run)
    run.with_name("run.h5.journal.damaged").write_text("precious")
    (tmp_path / "other").mkdir()
    with LogWriter(tmp_path / "other" / "run.h5", HEADERS, source="emulated", epoch="2026-02-02T00:00:00Z") as log:
        log.keep()
        log.append("Acc", acc(5000, 300))
        log.flush()
        shutil.copy(journal_of(tmp_path / "other" / "run.h5"), journal_of(run))
    content = journal_of(run).read_bytes()
    assert main(["recover", str(run)]) == 0
    assert "kept as run.h5.journal.damaged.2" in capsys.readouterr().out
    assert run.with_name("run.h5.journal.damaged").read_text() == "precious"
    assert run.with_name("run.h5.journal.damaged.2").read_bytes() == content


@pytest.mark.slow
def test_a_copy_that_differs_does_not_replace_the_log(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import imuarray.log.hdf5_writer as draft

    write = draft.Draft.append

    def wrong(self: Any, number: int, columns: Any) -> None:
        write(self, number, columns | ({"counts": columns["counts"] + 1} if number == 0 else {}))

    before = {path: path.read_bytes() for path in run.parent.iterdir()}
    with monkeypatch.context() as patch:
        patch.setattr(draft.Draft, "append", wrong)
        with pytest.raises(LogError, match="its finished copy differs in /sensors/Acc; the log is unchanged"):
            recover(run)
    assert {path: path.read_bytes() for path in run.parent.iterdir()} == before
    check(run)


class TestVerify:
    @pytest.fixture
    def finished(self, run: Path) -> Path:
        recover(run)
        return run

    @pytest.mark.slow
    def test_a_good_log_is_verified(self, finished: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["verify", str(finished), "--json"]) == 0
        report = json.loads(capsys.readouterr().out)
        assert (report["log"], report["good"], report["state"]) == (str(finished), True, "finished")
        assert (report["rows"], report["problems"], report["remarks"]) == ({"Acc": ROWS, "Baro": 23}, [], [])

    def test_an_interrupted_log_is_verified(self, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["verify", str(run)]) == 0
        assert "imuarray recover" in capsys.readouterr().out
        assert main(["info", str(run)]) == 0
        assert "interrupted: all acknowledged rows are shown" in capsys.readouterr().out

    @pytest.mark.slow
    @pytest.mark.parametrize("column", some(["sensors/Acc/counts", "sensors/Acc/time", "sensors/Baro/pressure"], 1))
    def test_a_damaged_chunk_is_a_problem(
        self, finished: Path, column: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        with h5py.File(finished) as file:
            chunk = file[column].id.get_chunk_info(0)
        content = bytearray(finished.read_bytes())
        content[chunk.byte_offset + chunk.size // 2] ^= 4
        finished.write_bytes(content)
        assert main(["verify", str(finished)]) == 2
        name = column.rsplit("/", 1)[-1]
        streams = capsys.readouterr()
        assert "damaged" in streams.err
        assert len(streams.err.splitlines()) == 1
        assert name in streams.err or "damaged or malformed" in streams.err

    @pytest.mark.slow
    def test_missing_chunks_and_decreasing_times_are_problems(self, finished: Path) -> None:
        with h5py.File(finished, "r+") as file:
            group = file["sensors/Acc"]
            for name, rows, fill in (("counts", 10_000, None), ("time", 10_000, np.arange(10_000) % 5000 + 1)):
                dtype, tail = group[name].dtype, group[name].shape[1:]
                del group[name]
                group.create_dataset(name, (rows, *tail), dtype, chunks=(4096, *tail), data=fill)
            for name in ("status", "temperature_counts"):
                del group[name]
        problems = verify(finished).problems
        assert "sensor Acc: column counts: 3 of 3 chunks were never written" in problems
        assert "sensor Acc: time does not increase after row 4999" in problems


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.integers(0, 12),
    key=st.one_of(
        st.integers(-12, 11),
        st.slices(12),
        st.tuples(st.slices(12), st.integers(0, 2)),
        st.tuples(st.integers(-12, 11), st.slices(3)),
        st.just(Ellipsis),
        st.just(()),
        st.lists(st.integers(0, 11), min_size=1).map(np.array),
        st.lists(st.booleans(), min_size=12, max_size=12).map(np.array),
    ),
)
def test_a_column_of_two_parts_is_sliced_as_one(tmp_path: Path, rows: int, key: Any) -> None:
    whole = np.arange(36, dtype=np.int16).reshape(12, 3)
    with h5py.File(tmp_path / f"{os.getpid()}.h5", "w") as file:
        stored = np.concatenate([whole[:rows], np.full((5, 3), -1, np.int16)])  # more than the valid rows
        dataset = file.create_dataset("c", data=stored, maxshape=(None, 3))
        column = Column("c", whole[rows:], rows, lambda start, stop: dataset[start:stop])
        assert (column.shape, column.ndim, column.dtype, len(column), column.size) == ((12, 3), 2, whole.dtype, 12, 36)
        np.testing.assert_array_equal(column[key], whole[key])
        np.testing.assert_array_equal(np.asarray(column), whole)
        assert type(column[key]) is type(whole[key])
        with pytest.raises(IndexError):
            column[12]


def test_the_check_sum_of_an_unclosed_file_is_that_of_hdf5(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w", libver="latest") as file:
        file.attrs["x"] = 5
        file.flush()
        shutil.copy(tmp_path / "a.h5", tmp_path / "b.h5")
    assert is_marked_open(tmp_path / "b.h5")
    assert not is_marked_open(tmp_path / "a.h5")
    with pytest.raises(OSError, match="already open for write"):
        h5py.File(tmp_path / "b.h5", "r")
    with h5py.File(UnclosedFile(tmp_path / "b.h5"), "r") as file:
        assert file.attrs["x"] == 5
    closed = (tmp_path / "a.h5").read_bytes()[:48]
    assert UnclosedFile(tmp_path / "b.h5").read(12) == closed[:12]
