"""A disk that fills up: the log ends with its own error and exit code, everything acknowledged is in it."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from imuarray.cli import main
from imuarray.errors import DiskFullError
from imuarray.log import LogWriter, RotatingWriter, disk_space, open_log
from imuarray.log.journal import journal_of
from tests.reliability import storage_rows as rows
from tests.selection import some

ROOT = Path(__file__).parents[2]
MIB = 1 << 20
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
"""Under a limit on the length of files, Python would store truncated bytecode, which all later imports refuse."""


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 8 MiB in memory; only root can have one."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", place], capture_output=True, check=False
    )
    if mounted.returncode != 0:
        pytest.skip("a small disk can't be mounted here: needs root")
    yield place
    subprocess.run(["umount", "-l", place], check=True)


def logged(folder: Path, setup: str = "", **options: int) -> subprocess.CompletedProcess[str]:
    """Log until the disk is full, in a separate process that ends as the command line does."""
    program = f"""
import sys, click
from pathlib import Path
from imuarray.errors import ImuArrayError
from tests.reliability import storage_rows as rows
{setup}
try:
    told = rows.counter({str(folder.parent / "acknowledged")!r})
    rows.record(Path({str(folder / "run.h5")!r}), 1_000_000, 500, 1024, told, **{options!r})
except ImuArrayError as error:
    print(error, file=sys.stderr)
    sys.exit(error.exit_code)
"""
    return subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def check(done: subprocess.CompletedProcess[str], folder: Path) -> int:
    """Exit code 3, no signal, one line; frames that the log holds, all that were acknowledged."""
    assert done.returncode == DiskFullError.exit_code == 3
    assert len(done.stderr.splitlines()) == 1
    assert "the log was ended" in done.stderr or "no space left" in done.stderr
    acknowledged = rows.counted(folder.parent / "acknowledged")
    frames, problems = rows.wrong(folder / "run.h5")
    assert problems == []
    assert frames >= acknowledged > 1000
    return frames


def test_a_log_ends_at_the_watermark_and_is_finished(small_disk: Path) -> None:
    frames = check(logged(small_disk, watermark=4 * MIB), small_disk)
    assert [path.name for path in small_disk.iterdir()] == ["run.h5"]
    with open_log(small_disk / "run.h5") as log:
        assert log.state == "finished"
    print(f"ended at the watermark with {frames} frames, finished")


@pytest.mark.slow
def test_a_log_ends_on_a_full_disk_without_a_watermark(small_disk: Path, tmp_path: Path) -> None:
    """Without a watermark: the journal, or the space reserved for HDF5, reaches the end of the disk."""
    frames = check(logged(small_disk, watermark=0), small_disk)
    with open_log(small_disk / "run.h5") as log:
        assert log.state == "interrupted"
    assert main(["verify", str(small_disk / "run.h5")]) == 0
    assert main(["recover", str(small_disk / "run.h5"), "-o", str(tmp_path / "elsewhere.h5")]) == 0
    assert rows.wrong(tmp_path / "elsewhere.h5") == (frames, [])
    print(f"ended on a full disk with {frames} frames")


@pytest.mark.slow
def test_a_log_ends_when_another_process_fills_the_disk(small_disk: Path) -> None:
    filler = f"""
import threading, time
def fill():
    time.sleep(0.15)
    with open({str(small_disk / "filler")!r}, "wb", buffering=0) as file:
        while True:
            try:
                file.write(bytes(4096))
            except OSError:
                time.sleep(0.001)
threading.Thread(target=fill, daemon=True).start()
"""
    check(logged(small_disk, filler, watermark=0), small_disk)


@pytest.mark.slow
def test_a_log_ends_at_a_limit_of_the_file_size(tmp_path: Path) -> None:
    """A limit that the disk's free space does not show, as a quota is."""
    folder = tmp_path / "disk"
    folder.mkdir()
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({2 * MIB}, {2 * MIB}))"
    check(logged(folder, limit, watermark=0), folder)


@pytest.mark.slow
@pytest.mark.parametrize("limit", some([0, 3000, 30_000, 300_000, 1_100_000], 1))
def test_a_low_limit_of_the_file_size_is_an_error_of_one_line(tmp_path: Path, limit: int) -> None:
    """In the draft, the reserve, the journal or the file."""
    folder = tmp_path / "disk"
    folder.mkdir()
    program = f"import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))\n"
    program += "from imuarray.cli import main; sys.exit(main(sys.argv[1:]))"
    words = ["log", "martin2013", "--bus", "emulated:", "--seconds", "30", "-o", str(folder / "run.h5")]
    done = subprocess.run(
        [sys.executable, "-c", program, *words],
        cwd=ROOT,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 3
    assert len([line for line in done.stderr.splitlines() if "no hardware" not in line]) == 1
    assert "no space left: the limit on the length of a file is reached" in done.stderr
    if "nothing was recorded" in done.stderr:
        assert list(folder.iterdir()) == []
    else:
        assert main(["verify", str(folder / "run.h5")]) == 0


@pytest.fixture
def few_files(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """A disk in memory with a limited number of files and folders, its root included."""
    place = tmp_path / "disk"
    place.mkdir()

    def mount(inodes: int) -> Path:
        options = f"size=200m,nr_inodes={inodes}"
        mounted = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", options, "tmpfs", place], capture_output=True, check=False
        )
        if mounted.returncode != 0:
            pytest.skip("a small disk can't be mounted here: needs root")
        return place

    yield mount
    subprocess.run(["umount", "-l", place], check=False)


@pytest.mark.slow
@pytest.mark.parametrize("inodes", some([2, 3, 4], 1))
def test_a_disk_without_free_inodes_leaves_no_file(few_files: Callable[[int], Path], inodes: int) -> None:
    folder = few_files(inodes)
    done = logged(folder, watermark=0)
    assert done.returncode == 3
    assert "nothing was recorded" in done.stderr
    assert list(folder.iterdir()) == []


@pytest.mark.slow
def test_a_rotated_log_on_a_full_disk_names_unfinished_parts(
    small_disk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every part can be read and recovered; no reserve remains. Another process takes all free space."""
    full = threading.Event()
    ended = threading.Event()

    def fill() -> None:
        with (small_disk / "filler").open("wb", buffering=0) as file:
            while not ended.is_set():
                try:
                    file.write(bytes(4096))
                except OSError:
                    full.set()
                    ended.wait(0.0005)

    filler = threading.Thread(target=fill)
    try:
        with (
            pytest.raises(DiskFullError) as failed,
            RotatingWriter(
                small_disk / "run.h5", rows.SENSORS, every_s=300.0, source="simulated", epoch=rows.EPOCH, watermark=0
            ) as log,
        ):
            log.keep()
            for first in range(0, 1_000_000, 1000):
                log.append("Acc", rows.block(0, first, 1000))
                log.append("Gyro", rows.block(1, first, 1000))
                if first == 29_000:  # the last rows of the first part
                    log.flush()
                    filler.start()
                    full.wait()
    finally:
        ended.set()
    filler.join()
    unfinished = [path for path in log.paths if journal_of(path).exists()]
    assert unfinished
    assert all(path.name in str(failed.value) for path in unfinished)
    assert "free space, then run `imuarray recover" in str(failed.value)
    assert [path.name for path in small_disk.iterdir() if path.name.startswith(".")] == []
    total = 0
    for path in log.paths:
        assert main(["verify", str(path)]) == 0
        assert main(["recover", str(path), "-o", str(tmp_path / path.name)]) == 0
        with open_log(tmp_path / path.name) as part:
            total += len(part["Acc"])
    assert total >= log.acknowledged["Acc"] >= 29_000
    capsys.readouterr()


def test_a_log_does_not_begin_below_the_watermark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imuarray.log.writer.free_bytes", lambda path: 10 * MIB)
    with (
        pytest.raises(
            DiskFullError, match=r"less than 64 MiB are free; nothing was recorded; free space or choose another disk$"
        ),
        LogWriter(tmp_path / "run.h5", rows.SENSORS, source="simulated", epoch=rows.EPOCH) as log,
    ):
        log.keep()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_disk_that_accepts_a_name_but_no_byte_leaves_no_file(tmp_path: Path) -> None:
    folder = tmp_path / "disk"
    folder.mkdir()
    no_byte = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))"
    done = logged(folder, no_byte, watermark=0)
    assert "nothing was recorded" in done.stderr
    assert done.returncode == DiskFullError.exit_code
    assert list(folder.iterdir()) == []


def test_a_draft_on_a_full_disk_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        pytest.raises(DiskFullError, match="no space left on the disk"),
        LogWriter(tmp_path / "run.h5", rows.SENSORS, source="simulated", epoch=rows.EPOCH) as log,
    ):
        monkeypatch.setattr(disk_space, "free_bytes", lambda path: 2 * MIB)
        for first in range(0, 100_000, 1000):
            log.append("Acc", rows.block(0, first, 1000))
    assert list(tmp_path.iterdir()) == []
