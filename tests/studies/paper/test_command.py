"""`imuarray paper`: the object, the page, the files, and refusals."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from decimal import Decimal, localcontext
from pathlib import Path

import pytest

from imuarray import figures
from imuarray.cli import main
from imuarray.studies.paper import SOURCE, recompute, render_text

TEXTS = {"paper.json", "pairs.csv", *(f"table{number}.csv" for number in range(1, 12))}
PICTURES = {"pairs.png", "blending.png", "runs.png"}
PNG = b"\x89PNG\r\n\x1a\n"


def test_the_object_is_plain_and_complete_json() -> None:
    result = recompute()
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    assert {f"table{number}" for number in range(1, 12)} < set(result)
    assert "ION GNSS+ 2013" in result["source"] == SOURCE
    assert all(set(item) == {"claim", "evidence", "holds"} for item in result["slips"] + result["conclusions"])
    assert result["matches"]["table3"]["bias_lsb"] == [18, 18]
    assert result["matches"]["table3"]["scale_lsb_per_g"] == [17, 18]
    assert result["within_input_rounding"]["table3"]["scale_lsb_per_g"] == [18, 18]


def test_matches_are_the_numbers_of_equal_rows() -> None:
    result = recompute()
    for name, columns in result["matches"].items():
        for column, (equal, total) in columns.items():
            rows = [row for row in result[name] if f"printed_{column}" in row]
            assert (sum(row[column] == row[f"printed_{column}"] for row in rows), len(rows)) == (equal, total)


def test_results_do_not_depend_on_the_decimal_context() -> None:
    expected = recompute()
    with localcontext() as context:
        context.prec = 4
        assert recompute() == expected
        assert Decimal(1) / 3 == Decimal("0.3333")


def test_the_text_fits_100_columns_and_has_the_main_results() -> None:
    text = render_text(json.loads(json.dumps(recompute())))
    assert max(len(line) for line in text.splitlines()) <= 100
    assert len(text.splitlines()) < 90
    for words in (
        "86 of  90 equal",
        "8.32",
        "47.9 Hz",
        "run 10: 8.03 times",
        "Slips of the paper: 10",
        "15 of 18 hold",
    ):
        assert words in text
    assert "\N{NO-BREAK SPACE}" not in text


def test_the_command_prints_text_or_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper"]) == 0
    assert capsys.readouterr().out == render_text(recompute())
    assert main(["paper", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == recompute()


@pytest.mark.slow
def test_the_command_writes_its_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "new" / "place"
    assert main(["paper", "-o", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == TEXTS | PICTURES
    assert json.loads((out / "paper.json").read_text()) == recompute()
    assert all((out / name).read_bytes().startswith(PNG) for name in PICTURES)
    assert "16 files written" in capsys.readouterr().err
    with (out / "table3.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["printed_bias_lsb"] == rows[0]["bias_lsb"] == "7.734"
    assert [float(part) for part in rows[0]["response_lsb_per_g"].split()] == [-261.286, -5.3281, 4.7167]


@pytest.mark.slow
def test_an_existing_file_is_overwritten_only_with_force(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    taken = tmp_path / "table7.csv"
    taken.write_text("mine")
    assert main(["paper", "-o", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert str(taken) in error
    assert len(error.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["table7.csv"]
    assert taken.read_text() == "mine"
    assert main(["paper", "-o", str(tmp_path), "--force"]) == 0
    assert taken.read_text().startswith("run,x_lsb")


@pytest.mark.slow
def test_an_unwritable_folder_gives_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["paper", "-o", str(tmp_path / "file" / "below")]) == 2
    (tmp_path / "paper.json").mkdir()
    assert main(["paper", "-o", str(tmp_path), "--force"]) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert str(tmp_path / "file") in first
    assert str(tmp_path / "paper.json") in second


def test_without_matplotlib_tables_and_a_hint_are_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "find_spec", lambda name: None)
    assert main(["paper", "-o", str(tmp_path)]) == 0
    assert {path.name for path in tmp_path.iterdir()} == TEXTS
    assert "imuarray[report]" in capsys.readouterr().err


@pytest.mark.slow
def test_no_heavy_package_is_imported() -> None:
    imports = "import sys, imuarray.commands.paper; from imuarray.studies.paper import recompute"
    code = f"{imports}; recompute(); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {"numpy", "scipy", "h5py", "matplotlib"}.isdisjoint(done.stdout.split())
