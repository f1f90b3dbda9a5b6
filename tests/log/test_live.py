"""A log while it is recorded: readable, refused to a second writer, and always in a valid state."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

import imuarray.log.journal as journal
import imuarray.log.writer as live
import imuarray.log.writer as writing
from imuarray.cli import main
from imuarray.errors import DiskFullError, LogBusyError, LogError, LogWarning, OutputExistsError
from imuarray.log import Block, Log, LogWriter, Stimulus, disk_space, open_log
from imuarray.log.format import Event, Phase
from imuarray.log.inspection import UnclosedFile, is_marked_open
from imuarray.log.journal import JournalLock, is_running, journal_of
from tests.selection import some

Writer = Callable[..., LogWriter]


def gyro(first: int, count: int) -> Block:
    row = np.arange(first, first + count)
    return Block(row * 1000 + 5, np.stack([row, -row, row % 7], axis=1).astype(np.int16), (row % 8).astype(np.uint16))


OTHER_PROGRAM = """
import sys, h5py, imuarray
with h5py.File(sys.argv[1], swmr=True) as file:
    print(len(file["sensors/Gyro/time"]), file["sensors/Gyro/time"][-1])
with imuarray.open_log(sys.argv[1]) as log:
    print(len(log["Gyro"]), log["Gyro"].time[-1])
try:
    h5py.File(sys.argv[1])
except OSError as error:
    print("h5clear" in str(error))
"""


@pytest.mark.slow
def test_another_program_reads_the_log_as_the_readme_states(
    tmp_path: Path, writer: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "CHUNK", 64)
    path = tmp_path / "run.h5"
    with writer(path) as log:
        log.keep()
        for first in range(0, 100, 10):
            log.append("Gyro", gyro(first, 10))
            log.flush()
        seen = subprocess.run([sys.executable, "-c", OTHER_PROGRAM, path], capture_output=True, text=True)
        log.append("Gyro", gyro(100, 10))
    assert seen.stderr == ""
    assert seen.stdout.splitlines() == ["70 69005", "100 99005", "True"]
    with open_log(path) as finished:
        assert len(finished["Gyro"]) == 110


def test_a_reader_sees_all_acknowledged_rows_of_a_running_log(
    tmp_path: Path, writer: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows in the HDF5 file and in the journal, events, phases, truth; and afterwards the same, finished."""
    monkeypatch.setattr(writing, "CHUNK", 64)
    path = tmp_path / "run.h5"
    with writer(path) as log:
        log.keep()
        for first in range(0, 300, 10):
            log.append("Gyro", gyro(first, 10))
            log.flush()
        with h5py.File(path, "r", swmr=True) as file:  # any HDF5 reader can read; the rest is in the journal
            assert len(file["sensors/Gyro/time"]) == 280
        with open_log(path) as seen:
            np.testing.assert_array_equal(seen["Gyro"].time[270:290], gyro(270, 20).time)
        log.event(Event(7, "Gyro", "lost", "Größe µ"))
        log.phase(Phase(np.int64(0), np.int64(9), "static", "+Z"))  # type: ignore[arg-type]
        log.stimulus("truth", Stimulus(np.arange(3), np.ones((3, 3)), np.zeros((3, 3)), np.full(3, 25.0)))
        log.flush()
        assert log.acknowledged == {"Gyro": 300}
        assert {entry.name for entry in tmp_path.iterdir()} == {"run.h5", "run.h5.journal", ".run.h5.reserve"}
        with open_log(path) as seen:
            assert seen.state == "being written"
            check(seen)
            assert isinstance(seen["Gyro"].time[0], np.int64)
    with open_log(path) as seen:
        assert seen.state == "finished"
        check(seen)
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.h5"]


def check(log: object) -> None:
    sensor = log["Gyro"]  # type: ignore[index]
    for name, expected in zip(("time", "counts", "status"), gyro(0, 300)[:3], strict=True):
        np.testing.assert_array_equal(np.asarray(getattr(sensor, name)), expected)
    assert sensor.between(50_005, 250_005) == slice(50, 250)
    assert log.events == (Event(7, "Gyro", "lost", "Größe µ"),)  # type: ignore[attr-defined]
    assert log.phases == (Phase(0, 9, "static", "+Z"),)  # type: ignore[attr-defined]
    assert log.truth.temperature[:].tolist() == [25.0] * 3  # type: ignore[attr-defined]
    assert log.reference is None  # type: ignore[attr-defined]


@pytest.mark.slow
def test_rows_and_events_before_keep_are_in_the_log(tmp_path: Path, writer: Writer) -> None:
    with writer(tmp_path / "run.h5") as log:
        log.append("Gyro", gyro(0, 10))
        log.event(Event(1, "", "note", "early"))
        log.keep()
        log.keep()
        log.append("Gyro", gyro(10, 5))
    with open_log(tmp_path / "run.h5") as log:
        np.testing.assert_array_equal(log["Gyro"].counts[:], gyro(0, 15).counts)
        assert [event.message for event in log.events] == ["early"]


@pytest.mark.slow
def test_a_finished_log_contains_every_field_of_its_headers(tmp_path: Path, writer: Writer) -> None:
    for name, kept in (("live", True), ("draft", False)):
        with writer(tmp_path / f"{name}.h5", "Acc", "Gyro", "Baro") as log:
            if kept:
                log.keep()
    with h5py.File(tmp_path / "live.h5") as first, h5py.File(tmp_path / "draft.h5") as other:
        assert set(first) == set(other) == {"sensors", "phases", "events", "plots"}
        assert set(first.attrs) == set(other.attrs)
        for name in ("Acc", "Gyro", "Baro"):
            ours, theirs = first["sensors"][name], other["sensors"][name]
            assert {key: np.asarray(value).tolist() for key, value in ours.attrs.items()} == {
                key: np.asarray(value).tolist() for key, value in theirs.attrs.items()
            }
            assert set(ours) == set(theirs)
        assert first["sensors/Baro"].attrs["AC1"] == 408
        assert first["sensors/Gyro"].attrs["delay_ns"] == 1_500_000


@pytest.mark.parametrize(("looks", "free"), [(3, True), (1000, False)])
def test_the_lock_of_a_reader_is_awaited_for_a_limited_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, looks: int, free: bool
) -> None:
    """A reader has the lock for a moment, as one of many; a process that keeps it is waited for only a limited time."""
    path = tmp_path / "run.h5"
    looker = os.open(journal_of(path), os.O_RDWR | os.O_CREAT)
    fcntl.flock(looker, fcntl.LOCK_SH)
    waited: list[float] = []

    def wait(seconds: float) -> None:
        waited.append(seconds)
        if len(waited) == looks:
            fcntl.flock(looker, fcntl.LOCK_UN)

    monkeypatch.setattr(journal.time, "sleep", wait)
    try:
        if free:
            lock = JournalLock(path, create=True)
            assert is_running(path)
            lock.close()
        else:
            with pytest.raises(LogBusyError):
                JournalLock(path, create=True)
        assert len(waited) == min(looks, 20) and sum(waited) <= 0.1 + 1e-9
        waited.clear()
        fcntl.flock(looker, fcntl.LOCK_EX)
        with pytest.raises(LogBusyError):
            JournalLock(path, create=True)
        assert waited == []  # a writer is not waited for
    finally:
        os.close(looker)


def test_a_log_starts_while_many_readers_look(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    journal_of(path).touch()
    done = threading.Event()

    def look() -> None:
        while not done.is_set():
            is_running(path)
            time.sleep(0.0005)

    lookers = [threading.Thread(target=look) for _ in range(3)]
    for looker in lookers:
        looker.start()
    try:
        for _ in range(200):
            JournalLock(path, create=True).close()
    finally:
        done.set()
        for looker in lookers:
            looker.join()


@pytest.mark.slow
def test_a_second_log_into_a_running_one_is_refused(tmp_path: Path, writer: Writer) -> None:
    path = tmp_path / "run.h5"
    early = writer(path)  # it began when there was nothing yet
    with writer(path) as log:
        log.keep()
        log.append("Gyro", gyro(0, 10))
        for force in (False, True):
            with pytest.raises(LogBusyError, match="is being written by another process"):
                writer(path, force=force)
        with pytest.raises(LogBusyError), early:
            early.keep()
        program = f"import sys; from imuarray.cli import main; sys.exit(main(['recover', {str(path)!r}]))"
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
        assert done.returncode == 2
        assert "is being written by another process" in done.stderr
        log.append("Gyro", gyro(10, 10))
    with open_log(path) as seen:
        assert len(seen["Gyro"]) == 20
    with pytest.raises(OutputExistsError):
        writer(path)


def test_a_remaining_journal_is_not_overwritten(tmp_path: Path, writer: Writer) -> None:
    journal = journal_of(tmp_path / "run.h5")
    journal.write_text("precious")
    with pytest.raises(LogError, match=r"run\.h5\.journal: belongs to another log"), writer(tmp_path / "run.h5") as log:
        log.keep()
    assert journal.read_text() == "precious"
    with writer(tmp_path / "run.h5", force=True) as log:
        log.keep()
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.h5"]


def test_an_old_log_is_replaced_when_the_new_log_is_kept(tmp_path: Path, writer: Writer) -> None:
    path = tmp_path / "run.h5"
    with writer(path) as log:
        log.append("Gyro", gyro(0, 5))
    with pytest.raises(RuntimeError, match="mine"), writer(path, force=True) as log:
        with open_log(path) as old:
            assert len(old["Gyro"]) == 5
        log.keep()
        log.append("Gyro", gyro(0, 7))
        with open_log(path) as new:
            assert new.state == "being written"
        raise RuntimeError("mine")
    with open_log(path) as new:
        assert len(new["Gyro"]) == 7


@pytest.mark.slow
def test_readers_of_a_running_log_see_no_error_and_no_wrong_row(
    tmp_path: Path, writer: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In another process, as often as it can: never an error, never a wrong row, never fewer than before."""
    monkeypatch.setattr(writing, "CHUNK", 64)
    path = tmp_path / "run.h5"
    program = f"""
import numpy as np
from imuarray.log import open_log
seen = looks = 0
while seen < 4000:
    with open_log({str(path)!r}) as log:
        rows = log["Gyro"].time[:]
        assert np.array_equal(rows, np.arange(len(rows)) * 1000 + 5), rows
        counts = log["Gyro"].counts[:]
        assert len(counts) == len(rows) >= seen
        assert np.array_equal(counts[:, 1], -np.arange(len(rows))), counts
        seen, looks = len(rows), looks + 1
print(looks)
"""
    with writer(path) as log:
        log.keep()
        pipe = subprocess.PIPE
        reader = subprocess.Popen([sys.executable, "-c", program], stdout=pipe, stderr=pipe, text=True)
        for first in range(0, 4000, 10):
            log.append("Gyro", gyro(first, 10))
            if first > 100 and reader.poll() is None:
                time.sleep(0.002)
    out, err = reader.communicate(timeout=60)
    assert (reader.returncode, err) == (0, "")
    assert int(out) >= 2


def test_a_slow_disk_makes_append_wait(tmp_path: Path, writer: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    """The queue is bounded: a limited number of blocks wait, none is lost."""
    monkeypatch.setattr(live, "QUEUE_BLOCKS", 4)
    gate = threading.Event()
    append = live.JournalWriter.append
    monkeypatch.setattr(live.JournalWriter, "append", lambda self, items: (gate.wait(), append(self, items))[1])
    done = []

    def fill() -> None:
        for number in range(40):
            log.append("Gyro", gyro(number, 1))
            done.append(number)

    with writer(tmp_path / "run.h5") as log:
        log.keep()
        thread = threading.Thread(target=fill)
        thread.start()
        thread.join(0.2)
        assert thread.is_alive()
        assert len(done) < 12
        gate.set()
        thread.join()
    with open_log(tmp_path / "run.h5") as seen:
        assert len(seen["Gyro"]) == 40


def test_an_error_of_the_writing_thread_is_raised_and_earlier_rows_are_kept(
    tmp_path: Path, writer: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.h5"

    def broken(self: live.JournalWriter, items: object) -> None:
        raise OSError(5, "Input/output error")

    with pytest.raises(LogError, match=r"run\.h5: can't be written: Input/output error"), writer(path) as log:
        log.keep()
        log.append("Gyro", gyro(0, 10))
        log.flush()
        monkeypatch.setattr(live.JournalWriter, "append", broken)
        log.append("Gyro", gyro(10, 10))
        log.flush()
    with open_log(path) as seen:
        assert seen.state == "interrupted"
        assert len(seen["Gyro"]) == 10


@pytest.mark.slow
@pytest.mark.parametrize("loss", some(["removed", "replaced"], 1))
def test_a_journal_removed_during_recording_loses_no_rows(tmp_path: Path, writer: Writer, loss: str) -> None:
    path = tmp_path / "run.h5"
    with writer(path) as log:
        log.keep()
        log.append("Gyro", gyro(0, 10))
        log.flush()
        if loss == "removed":
            journal_of(path).unlink()
        else:
            (tmp_path / "other").write_text("precious")
            (tmp_path / "other").replace(journal_of(path))
        log.append("Gyro", gyro(10, 10))
        log.flush()
        with (
            pytest.warns(LogWarning, match=r"its journal run\.h5\.journal is (missing|damaged)"),
            open_log(path) as seen,
        ):
            assert seen.state != "finished"
            assert len(seen["Gyro"]) == 20  # every sync commits now: a crash would cost a second at the most
        log.append("Gyro", gyro(20, 10))
    with open_log(path) as seen:
        assert seen.state == "finished"
        np.testing.assert_array_equal(seen["Gyro"].counts[:], gyro(0, 30).counts)
        assert [(event.kind, event.message[:23]) for event in seen.events] == [("damaged", "the journal was removed")]
    assert journal_of(path).exists() == (loss == "replaced")  # another file is kept


@pytest.mark.slow
@pytest.mark.parametrize("loss", some(["removed", "emptied", "overwritten", "finished by another process"], 1))
def test_a_file_removed_during_recording_loses_no_rows(
    tmp_path: Path, writer: Writer, monkeypatch: pytest.MonkeyPatch, loss: str
) -> None:
    monkeypatch.setattr(writing, "CHUNK", 16)
    path = tmp_path / "run.h5"
    with writer(path) as log:
        log.keep()
        for first in range(0, 100, 10):
            log.append("Gyro", gyro(first, 10))
            log.event(Event(first, "Gyro", "note", str(first)))
            log.flush()
            if first == 50 and loss == "removed":
                path.unlink()
            elif first == 50 and loss == "emptied":
                os.truncate(path, 0)
            elif first == 50 and loss == "overwritten":
                path.write_bytes(b"\x55" * path.stat().st_size)
            elif first == 50:
                (tmp_path / "finished.h5").write_bytes(finished_bytes(tmp_path / "a", writer))
                (tmp_path / "finished.h5").replace(path)
    with open_log(path) as seen:
        assert (seen.state, seen.losses) == ("finished", ())
        np.testing.assert_array_equal(seen["Gyro"].counts[:], gyro(0, 100).counts)
        assert [event.message for event in seen.events] == [str(first) for first in range(0, 100, 10)]
    assert not journal_of(path).exists()


def finished_bytes(folder: Path, writer: Writer) -> bytes:
    folder.mkdir()
    with writer(folder / "run.h5") as log:
        log.append("Gyro", gyro(0, 5))
    return (folder / "run.h5").read_bytes()


@pytest.mark.slow
def test_a_log_that_could_not_be_finished_is_reported_interrupted(
    tmp_path: Path, writer: Writer, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """HDF5 closed its file properly, and cleared its flags; the journal is lost, as by a copy without it."""
    path = tmp_path / "run.h5"

    def full(path: Path, lock: object) -> None:
        raise DiskFullError(path, "no space left on the disk")

    monkeypatch.setattr(writing, "finish", full)
    with pytest.raises(DiskFullError), writer(path) as log:
        log.keep()
        log.append("Gyro", gyro(0, 10))
        log.event(Event(7, "Gyro", "note", "early"))
        log.phase(Phase(5, 9005, "static"))
        log.flush()
    assert not is_marked_open(path)
    for has_journal in (True, False):
        if not has_journal:
            journal_of(path).unlink()
        with Log(path) as seen:
            assert seen.state == "interrupted"
            assert (len(seen["Gyro"]), len(seen.events), len(seen.phases)) == (10, 1, 1)
        capsys.readouterr()
        assert main(["verify", str(path)]) == (0 if has_journal else 2)
        assert "interrupted, 10 rows" in capsys.readouterr().out
    assert main(["recover", str(path)]) == 2
    assert "use --force to finish it without them" in capsys.readouterr().err
    assert main(["recover", str(path), "--force"]) == 0


def test_drafts_of_a_killed_process_are_removed(tmp_path: Path, writer: Writer) -> None:
    """Of this log and of others in the folder, also drafts that can't be opened or are read-only; not drafts of a
    running process, nor files that HDF5 has locked on another machine, nor files that are no logs.
    """
    gone, other = 2**22 + 1, os.getppid()
    kept = {f".run.h5.{other}.part", f".film.mp4.{gone}.part", ".run.h5.part", f".run.h5.{gone}.parts"}
    for name in (f".run.h5.{gone}.part", f".run.h5.{gone}.live.part", f".old.h5.{gone}.part", *kept):
        (tmp_path / name).write_bytes(b"")
    locked = os.open(tmp_path / f".run.h5.{gone + 1}.part", os.O_RDWR | os.O_CREAT)
    fcntl.flock(locked, fcntl.LOCK_EX)
    read = os.open(tmp_path / f".run.h5.{gone + 2}.part", os.O_RDWR | os.O_CREAT)
    fcntl.flock(read, fcntl.LOCK_SH)
    (tmp_path / f".run.h5.{gone + 3}.part").symlink_to("nowhere")
    with writer(tmp_path / "run.h5"):
        pass
    os.close(locked)
    os.close(read)
    assert {path.name for path in tmp_path.iterdir()} == {"run.h5", f".run.h5.{gone + 1}.part", *kept}


def test_a_draft_that_cannot_be_removed_does_not_prevent_a_log(
    tmp_path: Path, writer: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a folder where another user's process was killed."""
    part = tmp_path / f".run.h5.{2**22 + 1}.part"
    part.write_bytes(b"")
    unlink = Path.unlink

    def refuse(self: Path, missing_ok: bool = False) -> None:
        if self == part:
            raise PermissionError(1, "Operation not permitted")
        unlink(self, missing_ok=missing_ok)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", refuse)
        with writer(tmp_path / "run.h5") as log:
            log.append("Gyro", gyro(0, 5))
    with open_log(tmp_path / "run.h5") as seen:
        assert len(seen["Gyro"]) == 5


HDF5_TEXT = """Can't write data (file write failed: time = Mon Nov 23 12:38:50 2026
, filename = 't/.run.h5.part', file descriptor = 3, errno = {}, error message = 'x', total write size = 437)"""


@pytest.mark.parametrize(
    ("number", "kind", "message"),
    [
        (28, DiskFullError, "no space left on the disk; nothing was recorded; free space or choose another disk"),
        (27, DiskFullError, "no space left: the limit on the length of a file is reached; nothing was recorded"),
        (122, DiskFullError, "no space left: the quota of the user is used up; nothing was recorded"),
        (5, LogError, "can't be written: Input/output error"),
    ],
)
@pytest.mark.parametrize("raised", [OSError, RuntimeError])
def test_errors_of_hdf5_are_shortened_to_one_line(
    number: int, kind: type[LogError], message: str, raised: type[Exception]
) -> None:
    error = disk_space.unwritable(Path("run.h5"), raised(HDF5_TEXT.format(number)))
    assert type(error) is kind
    assert str(error).startswith(f"run.h5: {message}")
    assert len(str(error).splitlines()) == 1


@pytest.mark.parametrize(("version", "checksum"), [(3, b"\0\0\0\0"), (2, b"\0\0\0\0")])
def test_an_unknown_superblock_is_not_changed(tmp_path: Path, version: int, checksum: bytes) -> None:
    """Of another version, or with a wrong check sum: the bytes of the file are returned unchanged."""
    content = b"\x89HDF\r\n\x1a\n" + bytes([version, 8, 8, 1]) + bytes(32) + checksum + bytes(100)
    (tmp_path / "r.h5").write_bytes(content)
    with UnclosedFile(tmp_path / "r.h5", check_heaps=False) as file:
        assert file.read(len(content)) == content
