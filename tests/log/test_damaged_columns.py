"""The error of a damaged column names sensor and rows, in any read; other columns behave as their datasets."""

from __future__ import annotations

import threading
from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.cli import main
from imuarray.errors import LogError
from imuarray.log import open_log
from imuarray.log.columns import clocks_of
from imuarray.log.format import CLOCKS
from tests.selection import some


def flip_a_bit(path: Path, column: str) -> Path:
    """In the middle of the first chunk of a column, without an update of the check sum."""
    with h5py.File(path, "r") as file:
        chunk = file[column].id.get_chunk_info(0)
    at = chunk.byte_offset + chunk.size // 2
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)
    return path


def test_a_column_behaves_as_its_dataset(small: Path) -> None:
    with open_log(small) as log, h5py.File(small) as file:
        ours, theirs = log["Acc"].counts, file["sensors/Acc/counts"]
        assert (ours.shape, ours.dtype, ours.ndim, len(ours)) == (theirs.shape, theirs.dtype, theirs.ndim, len(theirs))
        assert ours.chunks == theirs.chunks
        np.testing.assert_array_equal(np.asarray(ours), theirs[:])
        np.testing.assert_array_equal(np.asarray(ours, float), theirs[:].astype(float))
        np.testing.assert_array_equal(list(ours), list(theirs))
        for key in (0, -1, slice(1, 3), slice(None, None, 2), (slice(None), 1), np.array([0, 2]), ...):
            np.testing.assert_array_equal(ours[key], theirs[key])
        with pytest.raises(ValueError, match=r"[Ss]tep"):
            ours[::-1]
        with pytest.raises(IndexError):
            ours[99]


@pytest.mark.parametrize(
    ("key", "rows"),
    some([(slice(1, 4), "rows 1 to 3 are"), (2, "row 2 is"), (-1, "row 4 is"), (..., "rows 0 to 4 are")], 3),
)
def test_damaged_rows_are_named(small: Path, key: object, rows: str) -> None:
    with open_log(flip_a_bit(small, "sensors/Acc/counts")) as log, pytest.raises(LogError) as refused:
        log["Acc"].counts[key]
    assert str(refused.value) == f"{small}, sensor Acc: counts: {rows} damaged (imuarray verify lists all)"


def test_damaged_rows_of_the_truth_are_named(small: Path) -> None:
    with open_log(flip_a_bit(small, "truth/specific_force")) as log, pytest.raises(LogError) as refused:
        assert log.truth is not None
        np.asarray(log.truth.specific_force)
    assert f"{small}: group truth: specific_force: rows 0 to 4 are damaged" in str(refused.value)


@pytest.mark.parametrize(
    "command", some(["fuse", "characterise", "calibrate noise", "calibrate tumble", "gap diagnose"], 2)
)
def test_commands_report_damaged_rows_in_one_line(
    small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    flip_a_bit(small, "sensors/Acc/counts")
    output = [] if command == "characterise" else ["-o", str(tmp_path / "output")]
    assert main([*command.split(), str(small), *output]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len([line for line in lines if line.startswith("imuarray: ")]) == 1
    assert "Traceback" not in "".join(lines)
    assert not (tmp_path / "output").is_file()


def test_verify_names_damaged_rows(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["verify", str(flip_a_bit(small, "sensors/Acc/counts"))])
    out, err = capsys.readouterr()
    assert "sensor Acc: column counts: rows 0 to 4 are damaged" in out + err


def test_a_refused_log_does_not_keep_others_from_reading(small: Path) -> None:
    with h5py.File(small, "r+") as file:
        file["sensors/Acc/time"][:] = 0
    with pytest.raises(LogError) as refused:  # kept, with its frames
        open_log(small)
    read: list[int] = []
    other = threading.Thread(target=lambda: read.append(len(h5py.File(small)["sensors"])), daemon=True)
    other.start()
    other.join(20)
    assert read == [3], refused


def test_clocks_must_be_integers_of_one_length() -> None:
    names = [name for name, _, _ in CLOCKS]
    with h5py.File("clocks", "w", driver="core", backing_store=False) as file:
        for number, name in enumerate(names):
            file[name] = np.array([number, number + 10], np.int64)
        assert [column[:].tolist() for column in clocks_of(file, "here")] == [[n, n + 10] for n in range(5)]
        for wrong in (np.zeros(2), np.zeros(3, np.int64)):
            del file[names[-1]]
            file[names[-1]] = wrong
            with pytest.raises(LogError, match="here is missing a column"):
                clocks_of(file, "here")
