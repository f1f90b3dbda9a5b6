"""Damaged or hostile exports: refused in one line, with no file written."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imuarray.errors import SourceError
from imuarray.export import export
from tests.export.conftest import back, write_run
from tests.selection import examples, some

Members = dict[str, bytes]


@pytest.fixture(scope="module")
def members(tmp_path_factory: pytest.TempPathFactory) -> Members:
    """The members of a good npz file."""
    folder = tmp_path_factory.mktemp("npz")
    export(write_run(folder / "run.h5"), folder / "run.npz")
    with zipfile.ZipFile(folder / "run.npz") as archive:
        return {entry: archive.read(entry) for entry in archive.namelist()}


def packed(path: Path, members: Members, kind: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", kind) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def array(values: Any, **header: Any) -> bytes:
    """An array as npy, whose header may be false."""
    file = io.BytesIO()
    fields = {"descr": values.dtype.str, "fortran_order": False, "shape": values.shape} | header
    np.lib.format.write_array_header_1_0(file, fields)
    return file.getvalue() + values.tobytes()


def head_changed(members: Members, change: Callable[[dict[str, Any]], Any]) -> bytes:
    head = json.loads(np.load(io.BytesIO(members["header.npy"])).item())
    change(head)
    return array(np.array(json.dumps(head).encode()))


COUNTS = "Acc_counts.npy"
BAD: dict[str, tuple[Callable[[Members], Members], str]] = {
    "rows without end": (
        lambda m: {COUNTS: array(np.zeros((5, 3), "<i2"), shape=(1 << 60, 3))},
        "which differs from its size",
    ),
    "fewer rows than time": (lambda m: {COUNTS: array(np.zeros((4, 3), "<i2"))}, "arrays of different lengths"),
    "another type": (lambda m: {COUNTS: array(np.zeros((5, 3), "<f8"))}, "required are rows of <i2"),
    "columns first": (lambda m: {COUNTS: array(np.zeros((5, 3), "<i2"), fortran_order=True)}, "column-major order"),
    "objects": (lambda m: {COUNTS: _pickled()}, "array Acc_counts"),
    "negative rows": (lambda m: {COUNTS: array(np.zeros((5, 3), "<i2"), shape=(-5, -3))}, "required are rows"),
    "no array at all": (lambda m: {COUNTS: b"MZ"}, "array Acc_counts"),
    "a header that is code": (lambda m: {COUNTS: _npy(b"__import__('os').abort()")}, "array Acc_counts"),
    "no header": (lambda m: {"header.npy": b""}, "array header"),
    "a header of numbers": (lambda m: {"header.npy": array(np.arange(3))}, "not a header written by"),
    "a header of a list": (lambda m: {"header.npy": array(np.array(b"[1]"))}, "no header written by"),
    "a header of brackets": (lambda m: {"header.npy": array(np.array(b"[" * 100_000))}, "no header written by"),
    "times that go back": (
        lambda m: {"Acc_time.npy": array(np.array([5, 4, 3, 2, 1]))},
        "Acc: time is not strictly increasing",
    ),
    "an array of another place": (
        lambda m: {"header.npy": head_changed(m, lambda h: h["arrays"]["sensors/Acc"].update(counts="../../x"))},
        "no array '../../x'",
    ),
    "a sensor of another place": (
        lambda m: {"header.npy": head_changed(m, lambda h: h["tables"]["sensors/Acc"].update(name="../Acc"))},
        "names of sensors and columns are words",
    ),
    "a source that there is not": (
        lambda m: {"header.npy": head_changed(m, lambda h: h.update(source="somewhere"))},
        "allowed are i2c",
    ),
    "an event without its text": (
        lambda m: {"header.npy": head_changed(m, lambda h: h.update(events=[[1, "", ""]]))},
        "phases or events",
    ),
    "a text with a NUL": (
        lambda m: {"header.npy": head_changed(m, lambda h: h.update(events=[[1, "", "", "\0"]]))},
        "phases or events",
    ),
    "an orientation that axes can't say": (
        lambda m: {
            "header.npy": head_changed(
                m, lambda h: h["tables"]["sensors/Gyro"].update(orientation=[[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]])
            )
        },
        "not a multiple of quarter turns",
    ),
}


def _npy(header: bytes) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header


def _pickled() -> bytes:
    file = io.BytesIO()
    np.save(file, np.array([{"a": 1}], object), allow_pickle=True)
    return file.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("kind", some(BAD, 6))
def test_a_bad_npz_is_refused_and_leaves_no_file(tmp_path: Path, members: Members, kind: str) -> None:
    spoil, message = BAD[kind]
    with pytest.raises(SourceError, match=r"bad\.npz") as caught:
        back(packed(tmp_path / "bad.npz", members | spoil(members)))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["bad.npz"]


@pytest.mark.slow
def test_a_bomb_is_refused_unopened(tmp_path: Path, members: Members, monkeypatch: pytest.MonkeyPatch) -> None:
    """A member whose entry in the archive's list states a thousand times the size that its bytes can give."""
    path = packed(tmp_path / "bomb.npz", members)
    data = bytearray(path.read_bytes())
    entry = data.rindex(COUNTS.encode()) - 46  # its entry in the list: sizes at 20 and 24
    struct.pack_into("<L", data, entry + 24, 0xFFFF_FFF0)
    path.write_bytes(data)
    with pytest.raises(SourceError, match=r"Acc_counts\.npy: declares 4294967280 bytes, more than"):
        back(path)
    path = packed(tmp_path / "bomb.npz", members | {"header.npy": array(np.array(b"{" + b" " * 70_000_000 + b"}"))})
    with pytest.raises(SourceError, match=r"a header of 7\d+ bytes; at most 67108864"):
        back(path)


def test_archives_that_numpy_does_not_write_are_refused(tmp_path: Path, members: Members) -> None:
    with pytest.raises(SourceError, match="compressed by a method that NumPy does not use"):
        back(packed(tmp_path / "a.npz", members, zipfile.ZIP_BZIP2))
    (tmp_path / "b.npz").write_bytes(packed(tmp_path / "a.npz", members).read_bytes()[:-100])
    with pytest.raises(SourceError, match=r"b\.npz: damaged, or not an npz file"):
        back(tmp_path / "b.npz")
    data = packed(tmp_path / "a.npz", members, zipfile.ZIP_STORED).read_bytes()
    (tmp_path / "c.npz").write_bytes(data.replace(members[COUNTS][-8:], b"\1" * 8))
    with pytest.raises(SourceError, match="Bad CRC-32"):
        back(tmp_path / "c.npz")
    stored = packed(tmp_path / "a.npz", members, zipfile.ZIP_STORED)  # as numpy.savez would
    assert back(stored).is_file()


@settings(max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_archive_is_an_error_of_one_line(tmp_path: Path, members: Members, data: st.DataObject) -> None:
    """Some bytes of an archive changed: SourceError, or no harm done."""
    path = packed(tmp_path / "d.npz", members)
    spoilt = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        spoilt[data.draw(st.integers(4, len(spoilt) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(spoilt)
    try:
        back(path)
    except SourceError as error:
        assert "\n" not in str(error)


CSV_BAD = {
    "a path": ("r.csv", "r_Acc.csv,", "../r_Acc.csv,", "its files must be in the same folder"),
    "a whole path": ("r.csv", "r_Acc.csv,", "/etc/passwd,", "its files must be in the same folder"),
    "a file that is not there": ("r.csv", "r_Acc.csv,", "r_Bcc.csv,", "no such file"),
    "another file": ("r.csv", "r_Acc.csv,", "run.h5,", "line 1 is not text"),
    "a row less": ("r.csv", "sensors/Acc,5", "sensors/Acc,6", "5 rows, r.csv states 6"),
    "no rows": ("r.csv", "sensors/Acc,5", "sensors/Acc,many", "its files must be in the same folder"),
    "no such table": ("r.csv", "sensors/Acc,5", "sensors/Bcc,5", "its list and its header differ"),
    "a cell of text": ("r_Acc.csv", "8191", "lots", "line 3, column counts_y: 'lots' is not a number of type int16"),
    "too large a count": (
        "r_Acc.csv",
        "8191",
        "81910",
        "line 3, column counts_y: '81910' is not a number of type int16",
    ),
    "a cell of a megabyte": ("r_Acc.csv", "8191", "8" * 1_000_000, "longer than 65536 characters"),
    "a number of many digits": ("r_Acc.csv", "8191", "8" * 9000, "is not a number of type int16"),
    "a column less": ("r_Acc.csv", "counts_y", "counts", "no column 'counts_y'"),
    "a cell more": ("r_Acc.csv", "8191", "8191,0", "7 cells, the first row has 6"),
    "time that goes back": ("r_Acc.csv", "0.020000000", "0.000000001", "is not later than the row before"),
    "an event without time": ("r_events.csv", "0.030000000", "now", "'now' is not a number"),
    "an open quote": ("r_events.csv", '=1+1"', "=1+1", "r_events.csv"),
}


@pytest.mark.parametrize("kind", some(CSV_BAD, 2))
def test_a_bad_csv_is_refused_and_leaves_no_file(run: Path, kind: str) -> None:
    name, was, becomes, message = CSV_BAD[kind]
    files = export(run, run.with_name("r.csv")).files
    spoilt = run.with_name(name)
    text = spoilt.read_text(encoding="utf-8")
    assert was in text
    spoilt.write_text(text.replace(was, becomes), encoding="utf-8")
    with pytest.raises(SourceError) as caught:
        back(run.with_name("r.csv"))
    assert message in str(caught.value)
    assert {path.name for path in run.parent.iterdir()} == {"run.h5", *(file.name for file in files)}


@settings(max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_text_is_an_error_of_one_line(tmp_path: Path, data: st.DataObject) -> None:
    """Some bytes of one of the files changed: SourceError, or no harm done."""
    if not (tmp_path / "r.csv").exists():
        export(write_run(tmp_path / "run.h5"), tmp_path / "r.csv")
        for file in [*tmp_path.glob("*.csv"), tmp_path / "r.json"]:
            file.with_name(f"{file.name}.good").write_bytes(file.read_bytes())
    path = data.draw(st.sampled_from(sorted([*tmp_path.glob("*.csv"), tmp_path / "r.json"])))
    good = path.with_name(f"{path.name}.good").read_bytes()
    spoilt = bytearray(good)
    first = len(b'{"imuarray_csv": ') if path.suffix == ".json" else 0
    for _ in range(data.draw(st.integers(1, 3))):
        spoilt[data.draw(st.integers(first, len(spoilt) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(spoilt)
    try:
        back(tmp_path / "r.csv")
    except SourceError as error:
        assert "\n" not in str(error)
    finally:
        path.write_bytes(good)


@pytest.mark.slow
def test_a_csv_header_without_end_is_refused(tmp_path: Path) -> None:
    (tmp_path / "h.csv").write_bytes(b"# imuarray-csv 1: x\n# {" + b" " * (1 << 26))
    with pytest.raises(SourceError, match="a header of more than 67108864 bytes"):
        back(tmp_path / "h.csv")
    (tmp_path / "j.csv").write_bytes(b"file,table,rows\n")
    (tmp_path / "j.json").write_bytes(b'{"imuarray_csv": 2' + b" " * (1 << 26))
    with pytest.raises(SourceError, match=r"j\.json: a header of more than 67108864 bytes"):
        back(tmp_path / "j.csv")
    (tmp_path / "h.csv").write_bytes(b"# imuarray-csv 1: x")
    with pytest.raises(SourceError, match="two comment lines"):
        back(tmp_path / "h.csv")
