"""The uncertainty of the times of a drained queue, in the log, `info`, `characterise`, xarray and an export."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.characterise import characterise_log, render_text
from imuarray.cli import main
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import TIME_UNCERTAINTY, SensorHeader
from tests.selection import some

ROWS = 1000
STATED_S = np.where(np.arange(ROWS) < 10, 500e-6, 21e-6)
"""The first ten rows are known less well."""


@pytest.fixture
def queue(tmp_path: Path) -> Path:
    """A log of gyroscope Q, whose queue was drained, and of P, which was polled."""
    time_ns = np.arange(ROWS, dtype=np.int64) * 1_000_000
    counts = np.random.default_rng(1).normal(0, 5, (ROWS, 3)).round().astype(np.int16)
    headers = [
        SensorHeader("P", "icm42688", "angular_rate", "dps", 500.0, 65.5),
        SensorHeader("Q", "icm42688", "angular_rate", "dps", 500.0, 65.5, compensated=(TIME_UNCERTAINTY,)),
    ]
    path = tmp_path / "q.h5"
    with LogWriter(path, headers, source="emulated", epoch="2024-01-01T00:00:00Z") as log:
        status = np.zeros(ROWS, np.uint16)
        log.append("P", Block(time_ns, counts, status))
        log.append("Q", Block(time_ns, counts, status, None, {TIME_UNCERTAINTY: STATED_S}))
    return path


def test_the_uncertainty_is_a_column_in_seconds(queue: Path) -> None:
    with h5py.File(queue) as file:
        column = file["sensors/Q/time_uncertainty"]
        assert (column.dtype, column.attrs["units"]) == (np.dtype("<f4"), "s")
        assert "time_uncertainty" not in file["sensors/P"]
    with open_log(queue) as log:
        assert log["P"].time_uncertainty is None
        stated = log["Q"].time_uncertainty
        assert stated is not None
        np.testing.assert_allclose(stated[:], STATED_S, rtol=1e-6)


def test_info_reports_the_uncertainty(
    queue: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)  # lines are not broken
    assert main(["info", str(queue)]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if " rows " in line}
    assert "times known within 21 us (at worst 500 us)" in lines["Q"]
    assert "times known" not in lines["P"]
    assert main(["info", str(queue), "--json"]) == 0
    polled, drained = json.loads(capsys.readouterr().out)["sensors"]
    assert polled["time_uncertainty_s"] is None
    assert drained["time_uncertainty_s"] == pytest.approx({"median": 21e-6, "max": 500e-6}, rel=1e-6)


def test_characterise_reports_the_uncertainty(queue: Path) -> None:
    with open_log(queue) as log:
        result = characterise_log(log)
    polled, drained = result["alignment"]["sensors"]
    assert polled["time_uncertainty_s"] is None
    assert drained["time_uncertainty_s"] == pytest.approx(21e-6, rel=1e-6)
    table = [line for line in render_text(result).splitlines() if line.startswith("Q ")]
    assert any(line.split()[-2:] == ["21.0", "-"] for line in table)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", some(["npz", "csv", "parquet"], 1))
def test_an_export_keeps_the_uncertainty(suffix: str, queue: Path, tmp_path: Path) -> None:
    assert main(["export", str(queue), "-o", str(tmp_path / f"q.{suffix}")]) == 0
    assert main(["import", str(tmp_path / f"q.{suffix}"), "-o", str(tmp_path / "again.h5")]) == 0
    with open_log(tmp_path / "again.h5") as log:
        assert log["P"].time_uncertainty is None
        np.testing.assert_array_equal(log["Q"].time_uncertainty[:], STATED_S.astype(np.float32))


def test_xarray_contains_the_uncertainty(queue: Path) -> None:
    with open_log(queue) as log:
        variable = log["Q"].to_xarray()["time_uncertainty"]
    assert variable.attrs["units"] == "s"
    np.testing.assert_allclose(variable, STATED_S, rtol=1e-6)
