"""Parquet as pandas and pyarrow read it, and damaged files of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imuarray.errors import MissingExtraError, SourceError
from imuarray.export import export
from imuarray.importers import importer_of
from imuarray.importers.guess import guess_map
from imuarray.log import Block, LogWriter, open_log
from tests.export.conftest import ACC, ACC_COUNTS, EPOCH, MESSAGE, back, write_run
from tests.selection import examples

parquet = pytest.importorskip("pyarrow.parquet")


@pytest.mark.slow
def test_pandas_reads_types_dates_and_values(run: Path, fused: Path) -> None:
    pandas = pytest.importorskip("pandas")
    files = export(run, run.with_name("r.parquet")).files
    assert files[-1] == run.with_name("r.parquet")
    tables = {file.stem: pandas.read_parquet(file) for file in files}
    acc = tables["r_Acc"]
    assert acc.dtypes.astype(str).to_dict() == {
        "time": "datetime64[ns, UTC]", "counts_x": "int16", "counts_y": "int16", "counts_z": "int16",
        "status": "uint16", "temperature_counts": "int16",
    }  # fmt: skip
    assert acc["time"][1] == pandas.Timestamp("2013-09-16T08:30:00.260Z")
    assert acc[["counts_x", "counts_y", "counts_z"]].to_numpy().tolist() == ACC_COUNTS
    assert tables["r_Gyro"]["time"][0].nanosecond == 1
    assert tables["r_events"]["message"].tolist() == [MESSAGE, ""]
    assert tables["r"][["table", "rows"]].to_numpy().tolist()[:2] == [["sensors/Acc", 5], ["sensors/Baro", 2]]
    export(fused, fused.with_name("f.parquet"))
    fused_table = pandas.read_parquet(fused.with_name("f.parquet"))
    assert fused_table["angular_rate_y_radps"].tolist() == [2 / 7] * 4
    assert fused_table["specific_force_covariance_yz_m2ps4"][0] == 0.75


def test_units_and_the_header_are_in_the_metadata(run: Path) -> None:
    export(run, run.with_name("one.parquet"), sensors=["Gyro"], units="si")
    schema = parquet.read_schema(run.with_name("one.parquet"))
    assert schema.field("angular_rate_x_radps").metadata[b"unit"] == b"rad s-1"
    head = json.loads(schema.metadata[b"imuarray"])
    assert (head["epoch"], head["units"], head["table"]) == (EPOCH, "si", "sensors/Gyro")


def test_without_a_date_as_epoch_times_are_nanoseconds(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.h5", [ACC], source="imported", epoch="yesterday") as log:
        log.append("Acc", Block(np.array([-7]), np.ones((1, 3)), np.zeros(1, np.uint16), np.zeros(1)))
    export(tmp_path / "a.h5", tmp_path / "a.parquet", sensors=["Acc"])
    assert parquet.read_table(tmp_path / "a.parquet")["time_ns"].to_pylist() == [-7]
    with open_log(back(tmp_path / "a.parquet")) as log:
        assert log["Acc"].time[:].tolist() == [-7]


def test_a_file_of_another_program_is_imported_by_its_map(run: Path, tmp_path: Path) -> None:
    import pyarrow

    columns = {"t": np.arange(20.0), **{f"acc_{axis}": np.linspace(0, 1, 20) for axis in "xyz"}}
    parquet.write_table(pyarrow.table(columns), tmp_path / "other.parquet")
    assert importer_of(tmp_path / "other.parquet") is None
    assert "acc_x" in guess_map(tmp_path / "other.parquet")


def test_a_missing_package_is_named(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.delitem(sys.modules, "imuarray.export.parquet_files", raising=False)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(MissingExtraError, match=r"imuarray\[parquet\]"):
        export(run, run.with_name("r.parquet"))


@pytest.mark.slow
@settings(max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_file_is_an_error_of_one_line(tmp_path: Path, data: st.DataObject) -> None:
    """Some bytes of one of the files changed: SourceError, or no harm done."""
    if not (tmp_path / "r.parquet").exists():
        export(write_run(tmp_path / "run.h5"), tmp_path / "r.parquet")
        for file in [*tmp_path.glob("*.parquet")]:
            file.with_suffix(".good").write_bytes(file.read_bytes())
    path = data.draw(st.sampled_from(sorted(tmp_path.glob("*.parquet"))))
    good = path.with_suffix(".good").read_bytes()
    spoilt = bytearray(good)
    for _ in range(data.draw(st.integers(1, 3))):
        spoilt[data.draw(st.integers(4, len(spoilt) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(spoilt)
    try:
        if importer_of(tmp_path / "r.parquet") is not None:
            back(tmp_path / "r.parquet")
    except SourceError as error:
        assert "\n" not in str(error)
    finally:
        path.write_bytes(good)
