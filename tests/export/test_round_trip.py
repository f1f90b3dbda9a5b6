"""Exported and imported again: the same log, whatever is in it. And what is no export of ours is refused."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imuarray.cli import main
from imuarray.errors import OutputExistsError, SourceError
from imuarray.export import export
from imuarray.importers.exported import importer_of
from imuarray.log import Block, LogWriter, Stimulus, open_log
from imuarray.log.format import ClockRow, Event, Phase, SensorHeader
from tests.export.conftest import EPOCH, write_fused_run, write_run

FORMATS = ("npz", "csv")


def everything(path: Path) -> dict[str, Any]:
    """Every column with its type, every attribute, every text of a log, by h5py alone."""
    found: dict[str, Any] = {}

    def look(name: str, item: Any) -> None:
        found[name] = {key: np.asarray(value).tolist() for key, value in item.attrs.items() if "_LIST" not in key}
        if isinstance(item, h5py.Dataset):
            data = item[()]
            found[name]["is"] = (str(data.dtype), data.tobytes() if data.dtype.kind != "O" else data.tolist())

    with h5py.File(path) as file:
        file.visititems(look)
        found["/"] = dict(file.attrs)
    return found


def back(source: Path) -> Path:
    output = source.with_name("back.h5")
    importer = importer_of(source)
    assert importer is not None
    importer(source, output, force=True)
    return output


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_log_comes_back(run: Path, suffix: str) -> None:
    export(run, run.with_name(f"r.{suffix}"))
    assert everything(back(run.with_name(f"r.{suffix}"))) == everything(run)


def test_one_sensor_comes_back_from_its_table(run: Path) -> None:
    export(run, run.with_name("one.csv"), sensors=["Baro"])
    came, was = everything(back(run.with_name("one.csv"))), everything(run)
    assert {name for name in came if name.startswith("sensors/")} == {
        name for name in was if name.startswith("sensors/Baro")
    }
    assert all(came[name] == was[name] for name in came if name.startswith("sensors/"))


def test_an_interrupted_log_is_exported_as_far_as_it_goes(tmp_path: Path) -> None:
    header = SensorHeader("S", "l3g4200d", "angular_rate", "dps", 250.0, 114.3)
    log = LogWriter(tmp_path / "a.h5", [header], source="emulated", epoch=EPOCH)
    log.keep()
    log.append("S", Block(np.arange(7), np.full((7, 3), 5), np.zeros(7, np.uint16)))
    log.flush()
    export(tmp_path / "a.h5", tmp_path / "a.npz")
    with log:
        pass
    with open_log(back(tmp_path / "a.npz")) as came:
        assert came["S"].counts[:].tolist() == [[5, 5, 5]] * 7


TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"), max_size=8)
WORD = st.from_regex(r"[A-Za-z][\w,;\"' =+.-]{0,6}", fullmatch=True).filter(lambda word: word.isprintable())
TIMES = st.lists(st.integers(-(2**61), 2**61), max_size=5, unique=True).map(sorted)
FLOAT = st.floats(width=64)


@st.composite
def logs(draw: Any) -> Callable[[Path], Path]:
    """One or two sensors of any kind with a few rows, and whatever else a log has."""
    parts = []
    for name in draw(st.lists(WORD, min_size=1, max_size=2, unique=True)):
        baro, warm, times = draw(st.booleans()), draw(st.booleans()), draw(TIMES)
        kind = ("pressure", "Pa", ("ut", "up")) if baro else ("angular_rate", "dps", ("x", "y", "z"))
        extra = draw(st.dictionaries(st.sampled_from(["AC1", "note"]), st.integers(-99, 99) | st.floats(-1e9, 1e9)))
        header = SensorHeader(
            name, draw(TEXT), kind[0], kind[1], draw(st.floats(0, 1e6)), 114.3, axes="+Y+X-Z", columns=kind[2],
            has_temperature=warm, compensated=("temperature", "pressure") if baro else (),
            delay_ns=draw(st.none() | st.integers(-(2**40), 2**40)), extra=extra,
        )  # fmt: skip
        parts.append((header, _rows(draw, header, times)))
    phases = draw(
        st.lists(st.builds(Phase, *[st.integers(0, 2**61)] * 2, TEXT, st.sampled_from(["", "+Z"])), max_size=2)
    )
    events = draw(st.lists(st.builds(Event, st.integers(-(2**61), 2**61), TEXT, TEXT, TEXT), max_size=2))
    config, truth = draw(TEXT), draw(TIMES)

    def write(path: Path) -> Path:
        headers = [header for header, _ in parts]
        with LogWriter(path, headers, source="imported", epoch=EPOCH, config=config, force=True) as log:
            for header, block in parts:
                log.append(header.name, block)
            if truth:
                triads = np.full((len(truth), 3), 1 / 3)
                log.stimulus("truth", Stimulus(np.array(truth), triads, -triads, np.full(len(truth), np.nan)))
                log.clocks(ClockRow(truth[0], 1, 2, 3, 4))
            for phase in phases:
                log.phase(phase)
            for event in events:
                log.event(event)
        return path

    return write


def _rows(draw: Any, header: SensorHeader, times: list[int]) -> Block:
    count, width = len(times), len(header.columns)
    limit = 2**15 if width == 3 else 2**31
    cells = draw(st.lists(st.integers(-limit, limit - 1), min_size=count * width, max_size=count * width))
    made = {name: np.array(draw(st.lists(FLOAT, min_size=count, max_size=count)), float) for name in header.compensated}
    degrees = np.array(draw(st.lists(st.integers(-(2**15), 2**15 - 1), min_size=count, max_size=count)), np.int16)
    status = np.array(draw(st.lists(st.integers(0, 2**16 - 1), min_size=count, max_size=count)), np.uint16)
    counts = np.array(cells, np.int64).reshape(count, width)
    return Block(np.array(times, np.int64), counts, status, degrees if header.has_temperature else None, made)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(write=logs())
def test_any_log_comes_back(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    run = write(tmp_path / "any.h5")
    was = everything(run)
    for suffix in FORMATS:
        export(run, tmp_path / f"any.{suffix}", force=True)
        assert everything(back(tmp_path / f"any.{suffix}")) == was


def test_what_is_no_log_does_not_come_back(run: Path, fused: Path) -> None:
    for suffix in FORMATS:
        export(run, run.with_name(f"si.{suffix}"), units="si")
        with pytest.raises(SourceError, match="only raw counts make a log: export with --units counts"):
            back(run.with_name(f"si.{suffix}"))
        export(fused, run.with_name(f"f.{suffix}"))
        with pytest.raises(SourceError, match="no log of format 1"):
            back(run.with_name(f"f.{suffix}"))
    assert importer_of(run) is None
    with pytest.raises(SourceError, match="no such file"):
        importer_of(run.with_name("nothing.npz"))


def test_nothing_is_overwritten_and_nothing_left(run: Path) -> None:
    export(run, run.with_name("r.npz"))
    importer = importer_of(run.with_name("r.npz"))
    assert importer is not None
    with pytest.raises(OutputExistsError):
        importer(run.with_name("r.npz"), run)
    assert sorted(path.name for path in run.parent.iterdir()) == ["r.npz", "run.h5"]


Members = dict[str, bytes]


@pytest.fixture(scope="module")
def members(tmp_path_factory: pytest.TempPathFactory) -> Members:
    """The members of a good npz file."""
    folder = tmp_path_factory.mktemp("npz")
    export(write_run(folder / "run.h5"), folder / "run.npz")
    with zipfile.ZipFile(folder / "run.npz") as archive:
        return {one: archive.read(one) for one in archive.namelist()}


def packed(path: Path, members: Members, kind: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", kind) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def array(values: Any, **header: Any) -> bytes:
    """An array as npy, its header perhaps a lie."""
    file = io.BytesIO()
    said = {"descr": values.dtype.str, "fortran_order": False, "shape": values.shape} | header
    np.lib.format.write_array_header_1_0(file, said)
    return file.getvalue() + values.tobytes()


def head_changed(members: Members, change: Callable[[dict[str, Any]], Any]) -> bytes:
    head = json.loads(np.load(io.BytesIO(members["header.npy"])).item())
    change(head)
    return array(np.array(json.dumps(head).encode()))


COUNTS = "Acc_counts.npy"
BAD: dict[str, tuple[Callable[[Members], Members], str]] = {
    "rows without end": (
        lambda m: {COUNTS: array(np.zeros((5, 3), "<i2"), shape=(1 << 60, 3))},
        "which its bytes are not",
    ),
    "fewer rows than time": (lambda m: {COUNTS: array(np.zeros((4, 3), "<i2"))}, "arrays of different lengths"),
    "another type": (lambda m: {COUNTS: array(np.zeros((5, 3), "<f8"))}, "wanted are rows of <i2"),
    "columns first": (lambda m: {COUNTS: array(np.zeros((5, 3), "<i2"), fortran_order=True)}, "columns first"),
    "objects": (lambda m: {COUNTS: _pickled()}, "array Acc_counts"),
    "negative rows": (lambda m: {COUNTS: array(np.zeros((5, 3), "<i2"), shape=(-5, -3))}, "wanted are rows"),
    "no array at all": (lambda m: {COUNTS: b"MZ"}, "array Acc_counts"),
    "a header that is code": (lambda m: {COUNTS: _npy(b"__import__('os').abort()")}, "array Acc_counts"),
    "no header": (lambda m: {"header.npy": b""}, "array header"),
    "a header of numbers": (lambda m: {"header.npy": array(np.arange(3))}, "no header that"),
    "a header of a list": (lambda m: {"header.npy": array(np.array(b"[1]"))}, "no header that"),
    "a header of brackets": (lambda m: {"header.npy": array(np.array(b"[" * 100_000))}, "no header that"),
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
        "finer than axes can say",
    ),
}


def _npy(header: bytes) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header


def _pickled() -> bytes:
    file = io.BytesIO()
    np.save(file, np.array([{"a": 1}], object), allow_pickle=True)
    return file.getvalue()


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_npz_is_refused_and_leaves_nothing(tmp_path: Path, members: Members, kind: str) -> None:
    spoil, said = BAD[kind]
    with pytest.raises(SourceError, match=r"bad\.npz") as caught:
        back(packed(tmp_path / "bad.npz", members | spoil(members)))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["bad.npz"]


def test_a_bomb_is_refused_unopened(tmp_path: Path, members: Members, monkeypatch: pytest.MonkeyPatch) -> None:
    """A member that says it is a thousand times what its bytes can make, in the archive's list."""
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


def test_archives_that_numpy_does_not_write(tmp_path: Path, members: Members) -> None:
    with pytest.raises(SourceError, match="packed in a way that numpy does not"):
        back(packed(tmp_path / "a.npz", members, zipfile.ZIP_BZIP2))
    (tmp_path / "b.npz").write_bytes(packed(tmp_path / "a.npz", members).read_bytes()[:-100])
    with pytest.raises(SourceError, match=r"b\.npz: damaged, or no npz file"):
        back(tmp_path / "b.npz")
    data = packed(tmp_path / "a.npz", members, zipfile.ZIP_STORED).read_bytes()
    (tmp_path / "c.npz").write_bytes(data.replace(members[COUNTS][-8:], b"\1" * 8))
    with pytest.raises(SourceError, match="Bad CRC-32"):
        back(tmp_path / "c.npz")
    stored = packed(tmp_path / "a.npz", members, zipfile.ZIP_STORED)  # as numpy.savez would
    assert back(stored).is_file()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_is_told_in_a_line(tmp_path: Path, members: Members, data: st.DataObject) -> None:
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
    "a path": ("r.csv", "r_Acc.csv,", "../r_Acc.csv,", "its files are beside it"),
    "a whole path": ("r.csv", "r_Acc.csv,", "/etc/passwd,", "its files are beside it"),
    "a file that is not there": ("r.csv", "r_Acc.csv,", "r_Bcc.csv,", "no such file"),
    "another file": ("r.csv", "r_Acc.csv,", "run.h5,", "not begun as"),
    "a row less": ("r.csv", "sensors/Acc,5", "sensors/Acc,6", "5 rows, where r.csv says 6"),
    "no rows": ("r.csv", "sensors/Acc,5", "sensors/Acc,many", "its files are beside it"),
    "no such table": ("r.csv", "sensors/Acc,5", "sensors/Bcc,5", "its list and its header differ"),
    "a cell of text": ("r_Acc.csv", "8191", "lots", "line 5, column counts_y: 'lots' is no number of type int16"),
    "too large a count": ("r_Acc.csv", "8191", "81910", "line 5, column counts_y: '81910' is no number of type int16"),
    "a cell of a megabyte": ("r_Acc.csv", "8191", "8" * 1_000_000, "longer than 65536 characters"),
    "a number of many digits": ("r_Acc.csv", "8191", "8" * 9000, "is no number of type int16"),
    "a column less": ("r_Acc.csv", "counts_y", "counts", "no column 'counts_y'"),
    "a cell more": ("r_Acc.csv", "8191", "8191,0", "7 cells, the first row has 6"),
    "time that goes back": ("r_Acc.csv", "0.020000000", "0.000000001", "is not later than the row before"),
    "an event without time": ("r_events.csv", "0.030000000", "now", "'now' is no number"),
    "an open quote": ("r_events.csv", '=1+1"', "=1+1", "r_events.csv"),
}


@pytest.mark.parametrize("kind", CSV_BAD)
def test_a_bad_csv_is_refused_and_leaves_nothing(run: Path, kind: str) -> None:
    name, was, becomes, said = CSV_BAD[kind]
    files = export(run, run.with_name("r.csv")).files
    spoilt = run.with_name(name)
    text = spoilt.read_text(encoding="utf-8")
    assert was in text
    spoilt.write_text(text.replace(was, becomes), encoding="utf-8")
    with pytest.raises(SourceError) as caught:
        back(run.with_name("r.csv"))
    assert said in str(caught.value)
    assert {path.name for path in run.parent.iterdir()} == {"run.h5", *(file.name for file in files)}


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_text_is_told_in_a_line(tmp_path: Path, data: st.DataObject) -> None:
    """Some bytes of one of the files changed: SourceError, or no harm done."""
    if not (tmp_path / "r.csv").exists():
        export(write_run(tmp_path / "run.h5"), tmp_path / "r.csv")
        for file in sorted(tmp_path.glob("*.csv")):
            file.with_suffix(".good").write_bytes(file.read_bytes())
    path = data.draw(st.sampled_from(sorted(tmp_path.glob("*.csv"))))
    good = path.with_suffix(".good").read_bytes()
    spoilt = bytearray(good)
    first = len(b"# imuarray-csv 1: ")
    for _ in range(data.draw(st.integers(1, 3))):
        spoilt[data.draw(st.integers(first, len(spoilt) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(spoilt)
    try:
        back(tmp_path / "r.csv")
    except SourceError as error:
        assert "\n" not in str(error)
    finally:
        path.write_bytes(good)


def test_a_csv_header_without_end(tmp_path: Path) -> None:
    (tmp_path / "h.csv").write_bytes(b"# imuarray-csv 1: x\n# {" + b" " * (1 << 26))
    with pytest.raises(SourceError, match="a header of more than 67108864 bytes"):
        back(tmp_path / "h.csv")
    (tmp_path / "h.csv").write_bytes(b"# imuarray-csv 1: x")
    with pytest.raises(SourceError, match="two lines of comment"):
        back(tmp_path / "h.csv")


class TestCommand:
    def test_there_and_back(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.chdir(tmp_path)
        write_run(Path("run.h5"))
        assert main(["export", "run.h5", "-o", "r.npz", "--json"]) == 0
        said = json.loads(capsys.readouterr().out)
        assert (said["source"], said["files"], said["units"]) == ("run.h5", ["r.npz"], "counts")
        assert said["rows"]["sensors/Gyro"] == 3
        assert main(["import", "r.npz", "-o", "back.h5"]) == 0
        assert capsys.readouterr().out.startswith("back.h5: 3 sensors, 5 rows at most over 0.0 s\n")
        assert everything(Path("back.h5")) == everything(Path("run.h5"))

    @pytest.mark.parametrize(
        ("arguments", "said"),
        [
            (["run.h5", "-o", "r.xlsx"], "imuarray: r.xlsx: no format has the suffix '.xlsx'; allowed are .csv, .npz"),
            (["none.h5", "-o", "r.csv"], "imuarray: none.h5: no such file"),
            (["run.h5", "-o", "run.h5", "--force"], "is what the output is made from"),
            (["run.h5", "-o", "there.csv"], "there.csv: exists already"),
            (["run.h5", "-o", "r.csv", "--sensor", "X"], "no sensor 'X'; it has Acc, Baro, Gyro"),
            (["run.h5", "-o", "r.csv", "--calibration", "none.toml"], "none.toml: No such file"),
            (["there.csv", "-o", "r.csv"], "no HDF5 file"),
            (["run.h5", "-o", "r.yaml"], "no inertial sensor whose noise could be fitted"),
            (["fused.h5", "-o", "r.yaml"], "no log"),
        ],
    )
    def test_bad_input_is_one_line(
        self,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
        arguments: list[str],
        said: str,
    ) -> None:
        monkeypatch.chdir(tmp_path)
        write_run(Path("run.h5"))
        write_fused_run(Path("fused.h5"))
        Path("there.csv").write_text("mine")
        assert main(["export", *arguments]) == 2
        captured = capsys.readouterr()
        assert said in captured.err
        assert captured.err.count("\n") == 1
        assert sorted(path.name for path in tmp_path.iterdir()) == ["fused.h5", "run.h5", "there.csv"]

    def test_help_loads_nothing_heavy(self) -> None:
        import subprocess
        import sys

        code = (
            "import sys; from imuarray.cli import main; main(['export', '--help']);"
            "sys.exit(any(name in sys.modules for name in ('numpy', 'h5py', 'scipy', 'mcap')))"
        )
        assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0
