"""CSV as other programs read it: names and numbers, and a JSON file with everything else."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.errors import CalibrationError, ExportError, LogError, OutputExistsError
from imuarray.export import export
from imuarray.importers import importer_of
from imuarray.log import open_log
from tests.export.conftest import ACC_COUNTS, EPOCH, MESSAGE, back


def read(path: Path) -> tuple[list[str], list[list[str]]]:
    """Names and rows, by the standard library."""
    with path.open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    return names, rows


def test_each_table_has_a_file_and_a_list_names_them(run: Path) -> None:
    written = export(run, run.with_name("r.csv"))
    names = [file.name for file in written.files]
    tables = ["r_Acc.csv", "r_Baro.csv", "r_Gyro.csv", "r_truth.csv", "r_clocks.csv", "r_phases.csv", "r_events.csv"]
    assert names == [*tables, "r.json", "r.csv"]
    assert written.rows == {"sensors/Acc": 5, "sensors/Baro": 2, "sensors/Gyro": 3, "truth": 5, "clocks": 1}
    assert written.units == "counts"
    rows = [["r_Acc.csv", "sensors/Acc", "5"], ["r_Baro.csv", "sensors/Baro", "2"], ["r_Gyro.csv", "sensors/Gyro", "3"]]
    rows += [["r_truth.csv", "truth", "5"], ["r_clocks.csv", "clocks", "1"]]
    rows += [["r_phases.csv", "phases", "2"], ["r_events.csv", "events", "2"]]
    assert read(run.with_name("r.csv")) == (["file", "table", "rows"], rows)


def test_counts_and_times_are_exact(run: Path) -> None:
    export(run, run.with_name("r.csv"))
    names, rows = read(run.with_name("r_Acc.csv"))
    assert names == ["time_s", "counts_x", "counts_y", "counts_z", "status", "temperature_counts"]
    assert rows[1] == ["0.010000000", "-8192", "8191", "1", "4", "-1"]
    assert read(run.with_name("r_Baro.csv")) == (
        ["time_s", "counts_ut", "counts_up", "status", "temperature_degc", "pressure_pa"],
        [
            ["0.005000000", "27898", "190744", "0", "15.0", "69963.0"],
            ["0.009000000", "27900", "190750", "0", "0.30000000000000004", "nan"],
        ],
    )
    names, rows = read(run.with_name("r_events.csv"))
    assert rows == [["0.030000000", "Acc", "lost", MESSAGE], ["-0.000000005", "", "simulated", ""]]


def test_numpy_reads_a_table(run: Path) -> None:
    export(run, run.with_name("one.csv"), sensors=["Acc"])
    table = np.genfromtxt(run.with_name("one.csv"), delimiter=",", names=True)
    assert table["counts_y"].tolist() == [row[1] for row in ACC_COUNTS]
    assert table["time_s"].tolist() == [0, 0.01, 0.02, 0.03, 0.04]
    assert sorted(path.name for path in run.parent.iterdir()) == ["one.csv", "one.json", "run.h5"]


def test_pandas_reads_every_table_without_arguments(run: Path, fused: Path) -> None:
    pandas = pytest.importorskip("pandas")
    files = export(run, run.with_name("r.csv")).files
    tables = {file.stem: pandas.read_csv(file) for file in files if file.suffix == ".csv"}
    assert list(tables["r_Acc"].columns) == [
        "time_s", "counts_x", "counts_y", "counts_z", "status", "temperature_counts",
    ]  # fmt: skip
    assert tables["r_Acc"][["counts_x", "counts_y", "counts_z"]].to_numpy().tolist() == ACC_COUNTS
    assert tables["r_Acc"].dtypes.astype(str).tolist() == ["float64", *["int64"] * 5]
    assert tables["r_truth"]["angular_rate_y_radps"].tolist() == [1 / 3] * 5
    assert tables["r_events"]["message"].tolist()[0] == MESSAGE
    assert tables["r_phases"]["name"].tolist() == ["z_up", "motion"]
    assert tables["r"]["file"].tolist() == [file.name for file in files if file.suffix == ".csv"][:-1]
    export(fused, fused.with_name("f.csv"))
    table = pandas.read_csv(fused.with_name("f.csv"))
    assert table["specific_force_z_mps2"].isna().tolist() == [False, False, True, False]


def test_the_json_file_states_the_unit_of_every_column(run: Path) -> None:
    export(run, run.with_name("r.csv"), units="si")
    head = json.loads(run.with_name("r.json").read_text())
    assert head["imuarray_csv"] == 2
    assert head["files"]["r_Acc.csv"] == "sensors/Acc"
    names, _ = read(run.with_name("r_Acc.csv"))
    assert head["column_units"]["sensors/Acc"] == dict(zip(names, ["s", *["m s-2"] * 3, "1", "degC"], strict=True))


@pytest.mark.slow
def test_a_file_of_an_earlier_version_is_imported(run: Path) -> None:
    """Version 1 had two lines of comment, of which the second held the header; the list's was that of the log."""
    export(run, run.with_name("r.csv"))
    head = json.loads(run.with_name("r.json").read_text())
    for name, table in [*head["files"].items(), ("r.csv", "")]:
        path = run.with_name(name)
        about = {"table": table} if table else head
        path.write_text(f"# imuarray-csv 1: {table} of run.h5\n# {json.dumps(about)}\n{path.read_text()}")
    run.with_name("r.json").unlink()
    with open_log(back(run.with_name("r.csv"))) as log:
        assert log["Acc"].counts[:].tolist() == ACC_COUNTS
        assert [event.message for event in log.events] == [MESSAGE, ""]


def test_a_table_with_a_json_file_of_another_program_is_not_imported(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_text("t,x,y,z\n0,1,2,3\n")
    (tmp_path / "data.json").write_text('{"rate": 100}')
    assert importer_of(tmp_path / "data.csv") is None


def test_the_header_has_the_conversion_to_si(run: Path) -> None:
    export(run, run.with_name("one.csv"), sensors=["Acc"])
    head = json.loads(run.with_name("one.json").read_text())
    assert (head["epoch"], head["source"], head["units"]) == (EPOCH, "simulated", "counts")
    about = head["tables"]["sensors/Acc"]
    force = np.array(about["orientation"]) @ [0, 0, 512] * about["si_per_count"]
    np.testing.assert_allclose(force, [0, 0, -9.80665])  # one g along the chip's z, which points down


def test_values_can_be_in_units_of_the_data_sheet(run: Path) -> None:
    export(run, run.with_name("u.csv"), units="sensor")
    names, rows = read(run.with_name("u_Gyro.csv"))
    assert names == [
        "time_s", "angular_rate_x_dps", "angular_rate_y_dps", "angular_rate_z_dps", "status", "temperature_counts",
    ]  # fmt: skip
    np.testing.assert_allclose(np.array(rows[0][1:4], float), [8.75, 0, -8.75])  # 8.75 mdps a count: L3G-40
    names, rows = read(run.with_name("u_Acc.csv"))
    assert names[1:] == [
        "specific_force_x_g", "specific_force_y_g", "specific_force_z_g", "status", "temperature_degc",
    ]  # fmt: skip
    assert [float(cell) for cell in rows[0][1:]] == [-0.5, 1.0, 0.0, 0, 25.0]  # 24 degC at 0, half a degree a count


def test_a_calibration_is_applied(run: Path) -> None:
    """Bias (10, 20, 30), axes x and y exchanged and 500 counts per g: by hand."""
    response = np.array([[0.0, 500.0, 0.0], [500.0, 0.0, 0.0], [0.0, 0.0, -500.0]])
    known = SensorCalibration("Acc", "specific_force", "g", np.array([10.0, 20.0, 30.0]), response)
    both = export(run, run.with_name("both.csv"), calibration=Calibration({"Acc": known}))
    assert (both.units, both.uncalibrated) == ("si", ("Gyro",))
    export(run, run.with_name("c.csv"), calibration=Calibration({"Acc": known}), sensors=["Acc"])
    names, rows = read(run.with_name("c.csv"))
    assert names[1:4] == ["specific_force_x_mps2", "specific_force_y_mps2", "specific_force_z_mps2"]
    expected = np.array([-276 / 500, 502 / 500, 30 / 500]) * 9.80665
    np.testing.assert_allclose(np.array(rows[0][1:4], float), expected, rtol=1e-12)


def test_a_fused_result_is_one_table(fused: Path) -> None:
    assert export(fused, fused.with_name("f.csv")).files == (fused.with_name("f.csv"), fused.with_name("f.json"))
    names, rows = read(fused.with_name("f.csv"))
    row = dict(zip(names, rows[1], strict=True))
    assert row["time_s"] == "0.010000000"
    assert (row["specific_force_x_mps2"], row["angular_rate_z_radps"]) == ("0.1", repr(3 / 7))
    assert (row["specific_force_covariance_yz_m2ps4"], row["specific_force_used_Acc2"]) == ("0.75", "0")
    assert rows[2][names.index("specific_force_y_mps2")] == "nan"


def test_unsupported_options_are_refused(run: Path, fused: Path) -> None:
    to = run.with_name("x.csv")
    known = Calibration()
    with pytest.raises(ExportError, match=r"'.xlsx'; allowed are .csv, .npz, .parquet, .mcap, .mat, .yaml, .sdf"):
        export(run, run.with_name("x.xlsx"))
    with pytest.raises(ExportError, match="units 'feet': allowed are counts, si, sensor"):
        export(run, to, units="feet")
    with pytest.raises(ExportError, match="raw counts need no calibration"):
        export(run, to, units="counts", calibration=known)
    with pytest.raises(ExportError, match="a fused result"):
        export(fused, to, sensors=["Acc"])
    with pytest.raises(LogError, match="no sensor 'Nobody'; it has Acc, Baro, Gyro"):
        export(run, to, sensors=["Nobody"])
    with pytest.raises(ExportError, match="has Acc, Gyro; the calibration contains no sensor"):
        export(run, to, calibration=known)
    misfit = SensorCalibration("Acc", "specific_force", "g", np.zeros(3), np.eye(3) * 4096.0)
    with pytest.raises(CalibrationError, match="another range"):
        export(run, to, calibration=Calibration({"Acc": misfit}))
    assert sorted(path.name for path in run.parent.iterdir()) == ["fused.h5", "run.h5"]


def test_files_are_overwritten_only_with_force(run: Path) -> None:
    mine = run.with_name("r_Gyro.csv")
    mine.write_text("mine")
    with pytest.raises(OutputExistsError, match=r"r_Gyro\.csv: exists already"):
        export(run, run.with_name("r.csv"))
    assert sorted(path.name for path in run.parent.iterdir()) == ["r_Gyro.csv", "run.h5"]
    export(run, run.with_name("r.csv"), force=True)
    assert mine.read_text().startswith("time_s,counts_x,")


@pytest.mark.parametrize("failure", [KeyboardInterrupt(), LogError("damaged")])
def test_a_failure_writes_no_file(run: Path, monkeypatch: pytest.MonkeyPatch, failure: BaseException) -> None:
    """All tables are written when it fails; existing files are kept."""
    run.with_name("r_Acc.csv").write_text("mine")

    def breaks(*_: object) -> str:
        raise failure

    monkeypatch.setattr("imuarray.export.csv_files._write_texts", breaks)
    with pytest.raises(type(failure)):
        export(run, run.with_name("r.csv"), force=True)
    assert sorted(path.name for path in run.parent.iterdir()) == ["r_Acc.csv", "run.h5"]
    assert run.with_name("r_Acc.csv").read_text() == "mine"


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda file: file.__setitem__("fused/out", h5py.ExternalLink("/etc/passwd", "/x")), "a link to another"),
        (lambda file: file.__delitem__("fused/time"), "not a fused result"),
        (lambda file: file["fused"].create_dataset("big", (1 << 40,), "i2", chunks=(4,)), "more than this file"),
    ],
)
def test_a_hostile_fused_file_is_refused(fused: Path, spoil: Callable[[h5py.File], object], message: str) -> None:
    with h5py.File(fused, "r+") as file:
        spoil(file)
    with pytest.raises(LogError, match=message):
        export(fused, fused.with_name("f.csv"))
    assert [path.name for path in fused.parent.iterdir()] == ["fused.h5"]


@pytest.mark.slow
def test_progress_ends_at_one(run: Path) -> None:
    for suffix in ("csv", "npz", "parquet", "mat", "mcap"):
        shares: list[float] = []
        export(run, run.with_name(f"p.{suffix}"), progress=shares.append, force=True)
        assert shares == sorted(shares)
        assert shares[-1] == pytest.approx(1.0) or suffix == "mcap"
