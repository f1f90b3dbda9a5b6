"""`imuarray import`: its arguments, printed output and refusals."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from imuarray.cli import main
from imuarray.errors import DiskFullError
from imuarray.importers.mapping import load_map
from imuarray.log import open_log

ROOT = Path(__file__).parent.parent.parent
EXTRACT = ROOT / "tests" / "data" / "mimu4444" / "exp_1_extract.bin"
EXAMPLE = ROOT / "configs" / "import_example.toml"


@pytest.mark.slow
def test_the_report_of_a_format_is_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.h5"
    assert main(["import", str(EXTRACT), "--format", "mimu4444", "-o", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["log"] == str(out)
    assert len(result["sensors"]) == 16
    assert (result["rows"], result["lost"], result["events"]) == (12_500, 21_495, {"lost": 20})
    assert result["seconds"] == pytest.approx(543.904, abs=0.001)
    assert main(["info", str(out)]) == 0


def test_the_example_map_reads_the_table_in_its_comments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    comment = [line.removeprefix("#     ") for line in EXAMPLE.read_text().splitlines() if line.startswith("#     ")]
    data, out = tmp_path / "data.csv", tmp_path / "out.h5"
    data.write_text("\n".join(comment))
    assert main(["import", str(data), "--map", str(EXAMPLE), "--output", str(out)]) == 0
    captured = capsys.readouterr()
    assert captured.out == f"{out}: 2 sensors, 2 rows each over 0.0 s\n"
    assert captured.err == ""
    with open_log(out) as log:
        assert log["BMA1"].counts[:].tolist() == [[12, -31, 508], [14, -30, 511]]
        assert log["Gyro1"].counts[:].tolist() == [[3, -8, 1], [2, -9, 0]]
        assert log["BMA1"].time[:].tolist() == [0, 10_000_000]
        assert [(phase.name, phase.up) for phase in log.phases] == [("z_up", "+Z")]
    assert main(["info", str(out)]) == 0
    assert "doubts" not in capsys.readouterr().out
    assert load_map(EXAMPLE).file == load_map(EXAMPLE).file.__class__()


@pytest.mark.parametrize(
    ("kept", "remark"),
    [
        ((), "nothing was imported; free space or choose another disk"),
        (("all acknowledged rows are in the log",), "all acknowledged rows are in the log"),
    ],
)
def test_a_full_disk_is_an_error_of_the_import(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, kept: tuple[str, ...], remark: str
) -> None:
    def import_file(source: Path, output: Path, **_: object) -> None:
        raise DiskFullError(output, "no space left on the disk", *kept)

    monkeypatch.setattr("imuarray.importers.mimu4444.import_file", import_file)
    assert main(["import", str(EXTRACT), "--format", "mimu4444", "-o", "none.h5"]) == 3
    assert capsys.readouterr().err == f"imuarray: none.h5: no space left on the disk; {remark}\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give either --map MAP.toml or --format mimu4444"),
        (["--format", "mimu4444", "--map", str(EXAMPLE)], "give either --map MAP.toml or --format mimu4444"),
        (["--format", "mimu"], "'mimu' is not 'mimu4444'"),
        (["--map", str(EXAMPLE)], "is not text; allowed are tables of text"),
    ],
)
def test_invalid_input_gives_one_line_and_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert main(["import", str(EXTRACT), *arguments, "-o", str(tmp_path / "out.h5")]) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.startswith("imuarray: ")
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    assert list(tmp_path.iterdir()) == []


def test_an_output_is_required(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", str(EXTRACT), "--format", "mimu4444"]) == 2
    assert "Missing option '-o' / '--output'" in capsys.readouterr().err


@pytest.mark.slow
def test_an_existing_file_is_overwritten_only_with_force(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.h5"
    out.write_text("dear data")
    arguments = ["import", str(EXTRACT), "--format", "mimu4444", "-o", str(out)]
    assert main(arguments) == 2
    assert "exists already" in capsys.readouterr().err
    assert out.read_text() == "dear data"
    assert main([*arguments, "--force"]) == 0
    assert capsys.readouterr().out.startswith(f"{out}: 16 sensors, 12500 rows each over 543.9 s, 21495 lost\n")


@pytest.mark.slow
def test_progress_is_shown_on_a_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    assert main(["import", str(EXTRACT), "--format", "mimu4444", "-o", str(tmp_path / "out.h5"), "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["rows"] == 12_500
    assert EXTRACT.name in captured.err


def test_help_imports_no_heavy_package() -> None:
    code = (
        "import sys; from imuarray.cli import main; main(['import', '--help']);"
        "sys.exit(any(name in sys.modules for name in ('numpy', 'h5py', 'pydantic')))"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=False).returncode == 0
