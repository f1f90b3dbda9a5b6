"""Outputs are complete or absent, and existing files are kept."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import click
import pytest

from imuarray.atomic import whole_file, write_text
from imuarray.calibrate import Calibration
from imuarray.commands.program import run
from imuarray.errors import OutputError, OutputExistsError


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that is full when written data are synchronised."""

    def fsync(fd: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", fsync)


@pytest.mark.usefixtures("full")
@pytest.mark.parametrize("before", [None, "old"])
def test_a_full_disk_keeps_the_existing_file(tmp_path: Path, before: str | None) -> None:
    path = tmp_path / "cal.toml"
    if before is not None:
        path.write_text(before)
    with pytest.raises(OutputError) as refused:
        Calibration().save(path, force=True)
    assert str(refused.value) == f"{path}: can't be written: No space left on device"
    assert refused.value.exit_code == 3
    assert [entry.read_text() for entry in tmp_path.iterdir()] == ([] if before is None else [before])


def test_any_other_error_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), whole_file(tmp_path / "a") as draft:
        draft.write_text("half")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_only_force_overwrites_and_keeps_permissions_and_links(tmp_path: Path) -> None:
    path, link = tmp_path / "a", tmp_path / "b"
    write_text(path, "one")
    path.chmod(0o600)
    link.symlink_to(path)
    with pytest.raises(OutputExistsError):
        write_text(link, "two")
    write_text(link, "two", force=True)
    assert link.is_symlink()
    assert (path.read_text(), path.stat().st_mode & 0o777) == ("two", 0o600)
    assert len(list(tmp_path.iterdir())) == 2


def test_a_device_is_written_and_not_replaced() -> None:
    write_text("/dev/null", "nothing", force=True)
    assert Path("/dev/null").is_char_device()


def test_the_message_of_hdf5_is_not_repeated() -> None:
    error = OutputError("f.h5", OSError(errno.ENOSPC, "Unable to create file (file write failed: time = Sun ...)"))
    assert str(error) == "f.h5: can't be written: No space left on device"


def test_a_missing_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No such file or directory") as refused:
        write_text(tmp_path / "none" / "a", "")
    assert refused.value.exit_code == 2


@pytest.mark.parametrize(("number", "exit_code"), [(errno.ENOSPC, 3), (errno.EDQUOT, 3), (errno.EIO, 2), (None, 2)])
def test_an_uncaught_system_error_is_one_line(
    number: int | None, exit_code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    @click.command()
    def fails() -> None:
        raise OSError(number, os.strerror(number), "there") if number else OSError("no\nnumber")

    assert run(fails, "imuarray", []) == exit_code
    err = capsys.readouterr().err
    assert err == (f"imuarray: there: {os.strerror(number)}\n" if number else "imuarray: no number\n")
