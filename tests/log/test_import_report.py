"""The report on an import in the log: what `info`, `verify` and other programs read of it."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.cli import main
from imuarray.log import open_log
from imuarray.log.import_report import IMPORT_REPORT, ImportReport, store_import_report
from imuarray.log.reader import verify

TABLE = """
[time]
rate_hz = 100
[[sensor]]
name = "Acc"
chip = "adxl345"
quantity = "specific_force"
columns = [0, 1, 2]
unit = "g"
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """The log of an accelerometer whose columns are in m/s2, and not in g as its map states."""
    values = np.array([0.1, 0.2, 9.8]) + np.random.default_rng(1).normal(0, 0.02, (400, 3))
    (tmp_path / "a.csv").write_text("\n".join("{:.4f},{:.4f},{:.4f}".format(*row) for row in values) + "\n")
    (tmp_path / "map.toml").write_text(TABLE)
    out = tmp_path / "run.h5"
    assert main(["import", str(tmp_path / "a.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(out)]) == 0
    return out


def test_info_repeats_the_doubts_of_the_import(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["info", str(log)]) == 0
    assert "? Acc: measures 9." in " ".join(capsys.readouterr().out.split())
    assert main(["info", str(log), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)["import_report"]
    assert [text[:15] for text in report["doubts"]] == ["Acc: measures 9"]
    assert set(report) == {"facts", "remarks", "quirks", "doubts"}


def test_verify_states_the_number_of_doubts(log: Path) -> None:
    verdict = verify(log)
    assert verdict.problems == ()
    (remark,) = verdict.remarks
    assert remark.startswith("its import raised 1 doubt: ")


def test_the_attribute_is_json_that_other_programs_read(log: Path) -> None:
    with h5py.File(log) as file:
        stored = json.loads(file.attrs[IMPORT_REPORT])
    assert stored["doubts"][0].endswith("the columns may be in m/s2, not g")


@pytest.mark.slow
def test_a_long_report_keeps_its_doubts(log: Path) -> None:
    store_import_report(log, ImportReport(facts=("x" * 100,) * 2000, doubts=("the doubt",)))
    with open_log(log) as reader:
        assert reader.import_report is not None
        assert reader.import_report.doubts == ("the doubt",)
        assert 100 < len(reader.import_report.facts) < 2000


def test_a_malformed_report_is_none(log: Path) -> None:
    for value in ("", "[1]", '{"doubts": 3}', '{"doubts": [3]}', 7, "[" * 60_000 + "]"):
        with h5py.File(log, "r+") as file:
            del file.attrs[IMPORT_REPORT]
            kind = h5py.string_dtype() if isinstance(value, str) else None
            file.attrs.create(IMPORT_REPORT, value, dtype=kind)
        with open_log(log) as reader:
            assert reader.import_report is None, str(value)[:20]
