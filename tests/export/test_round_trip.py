"""Exported and imported again: the same log, for any content."""

from __future__ import annotations

import json
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
from imuarray.importers import importer_of
from imuarray.log import Block, LogWriter, Stimulus, open_log
from imuarray.log.format import ClockRow, Event, Phase, SensorHeader
from tests.export.conftest import EPOCH, back, write_fused_run, write_run
from tests.selection import examples, some

FORMATS = ("npz", "csv", "parquet")


def everything(path: Path) -> dict[str, Any]:
    """Every column with its type, every attribute, every text of a log, by h5py alone."""
    result: dict[str, Any] = {}

    def look(name: str, item: Any) -> None:
        result[name] = {key: np.asarray(value).tolist() for key, value in item.attrs.items() if "_LIST" not in key}
        if isinstance(item, h5py.Dataset):
            data = item[()]
            result[name]["is"] = (str(data.dtype), data.tobytes() if data.dtype.kind != "O" else data.tolist())

    with h5py.File(path) as file:
        file.visititems(look)
        result["/"] = {name: np.asarray(value).tolist() for name, value in file.attrs.items()}
    return result


@pytest.mark.parametrize("suffix", some(FORMATS, 1))
def test_a_log_round_trips(run: Path, suffix: str) -> None:
    export(run, run.with_name(f"r.{suffix}"))
    assert everything(back(run.with_name(f"r.{suffix}"))) == everything(run)


def test_one_sensor_round_trips_by_its_table(run: Path) -> None:
    export(run, run.with_name("one.csv"), sensors=["Baro"])
    copy, was = everything(back(run.with_name("one.csv"))), everything(run)
    assert {name for name in copy if name.startswith("sensors/")} == {
        name for name in was if name.startswith("sensors/Baro")
    }
    assert all(copy[name] == was[name] for name in copy if name.startswith("sensors/"))


@pytest.mark.slow
def test_the_rows_of_an_interrupted_log_are_exported(tmp_path: Path) -> None:
    header = SensorHeader("S", "l3g4200d", "angular_rate", "dps", 250.0, 114.3)
    log = LogWriter(tmp_path / "a.h5", [header], source="emulated", epoch=EPOCH)
    log.keep()
    log.append("S", Block(np.arange(7), np.full((7, 3), 5), np.zeros(7, np.uint16)))
    log.flush()
    export(tmp_path / "a.h5", tmp_path / "a.npz")
    with log:
        pass
    with open_log(back(tmp_path / "a.npz")) as copy:
        assert copy["S"].counts[:].tolist() == [[5, 5, 5]] * 7


TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=8)
WORD = st.from_regex(r"[A-Za-z][\w,;\"' =+.-]{0,6}", fullmatch=True).filter(lambda word: word.isprintable())
TIMES = st.lists(st.integers(-(2**61), 2**61), max_size=5, unique=True).map(sorted)
FLOAT = st.floats(allow_nan=False) | st.just(float("nan"))
"""Of the many bit patterns that are no number, text has one."""


@st.composite
def logs(draw: Any) -> Callable[[Path], Path]:
    """One or two sensors of any kind with a few rows, and the other contents of a log."""
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


@pytest.mark.slow
@settings(max_examples=examples(10), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(write=logs())
def test_any_log_round_trips(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    run = write(tmp_path / "any.h5")
    was = everything(run)
    for suffix in FORMATS:
        export(run, tmp_path / f"any.{suffix}", force=True)
        assert everything(back(tmp_path / f"any.{suffix}")) == was


@pytest.mark.slow
def test_exports_that_are_no_logs_are_not_imported(run: Path, fused: Path) -> None:
    for suffix in FORMATS:
        export(run, run.with_name(f"si.{suffix}"), units="si")
        with pytest.raises(SourceError, match="only raw counts make a log: export with --units counts"):
            back(run.with_name(f"si.{suffix}"))
        export(fused, run.with_name(f"f.{suffix}"))
        with pytest.raises(SourceError, match="not the export of a log of format 1"):
            back(run.with_name(f"f.{suffix}"))
    assert importer_of(run) is None
    with pytest.raises(SourceError, match="no such file"):
        importer_of(run.with_name("nothing.npz"))


def test_an_import_overwrites_no_file_and_leaves_no_draft(run: Path) -> None:
    export(run, run.with_name("r.npz"))
    importer = importer_of(run.with_name("r.npz"))
    assert importer is not None
    with pytest.raises(OutputExistsError):
        importer(run.with_name("r.npz"), run)
    assert sorted(path.name for path in run.parent.iterdir()) == ["r.npz", "run.h5"]


class TestCommand:
    @pytest.mark.slow
    def test_the_commands_export_and_import_a_log(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.chdir(tmp_path)
        write_run(Path("run.h5"))
        assert main(["export", "run.h5", "-o", "r.npz", "--json"]) == 0
        report = json.loads(capsys.readouterr().out)
        assert (report["source"], report["files"], report["units"]) == ("run.h5", ["r.npz"], "counts")
        assert report["rows"]["sensors/Gyro"] == 3
        assert main(["import", "r.npz", "-o", "back.h5"]) == 0
        assert capsys.readouterr().out.startswith("back.h5: 3 sensors, 5 rows at most over 0.0 s\n")
        back = everything(Path("back.h5"))
        del back["/"]["import_report"]  # only an imported log has it
        assert back == everything(Path("run.h5"))

    @pytest.mark.parametrize(
        ("arguments", "message"),
        some(
            [
                (
                    ["run.h5", "-o", "r.xlsx"],
                    "imuarray: r.xlsx: no format has the suffix '.xlsx'; allowed are .csv, .npz",
                ),
                (["none.h5", "-o", "r.csv"], "imuarray: none.h5: no such file"),
                (["run.h5", "-o", "run.h5", "--force"], "is the input; choose another name for the output"),
                (["run.h5", "-o", "there.csv"], "there.csv: exists already"),
                (["run.h5", "-o", "r.csv", "--sensor", "X"], "no sensor 'X'; it has Acc, Baro, Gyro"),
                (["run.h5", "-o", "r.csv", "--calibration", "none.toml"], "none.toml: No such file"),
                (["there.csv", "-o", "r.csv"], "is not an HDF5 file"),
                (["run.h5", "-o", "r.yaml"], "no inertial sensor whose noise could be fitted"),
                (["fused.h5", "-o", "r.yaml"], "no inertial sensor whose noise could be fitted"),
            ],
            2,
        ),
    )
    def test_bad_input_is_one_line(
        self,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
        arguments: list[str],
        message: str,
    ) -> None:
        monkeypatch.chdir(tmp_path)
        write_run(Path("run.h5"))
        write_fused_run(Path("fused.h5"))
        Path("there.csv").write_text("mine")
        assert main(["export", *arguments]) == 2
        captured = capsys.readouterr()
        assert message in captured.err
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
