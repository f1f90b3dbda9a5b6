"""npz as numpy alone reads it, without pickle."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from imuarray.errors import OutputError
from imuarray.export import export
from imuarray.log import Block, LogWriter
from tests.export.conftest import ACC, ACC_COUNTS, EPOCH, GYRO_COUNTS, MESSAGE, MS


def test_every_column_is_an_array(run: Path) -> None:
    export(run, run.with_name("r.npz"))
    with np.load(run.with_name("r.npz"), allow_pickle=False) as arrays:
        assert arrays["Acc_counts"].tolist() == ACC_COUNTS
        assert arrays["Gyro_counts"].tolist() == GYRO_COUNTS
        assert arrays["Gyro_time"].tolist() == [10 * MS + 1, 20 * MS + 1, 30 * MS + 1]
        kinds = {name: arrays[name].dtype.name for name in ("Acc_time", "Acc_counts", "Acc_status", "Baro_counts")}
        assert kinds == {"Acc_time": "int64", "Acc_counts": "int16", "Acc_status": "uint16", "Baro_counts": "int32"}
        assert arrays["Baro_temperature"].tolist() == [15.0, 0.1 + 0.2]
        assert arrays["truth_angular_rate"].shape == (5, 3)
        head = json.loads(arrays["header"].item())
        assert (head["epoch"], head["config"]) == (EPOCH, "[array]\nname = 'µ'\n")
        assert head["phases"] == [[0, 20 * MS, "z_up", "+Z"], [20 * MS, 50 * MS, "motion", ""]]
        assert head["events"][0] == [30 * MS, "Acc", "lost", MESSAGE]
        assert head["tables"]["sensors/Baro"]["extra"] == {"AC1": 408, "MD": 2868}
        assert set(arrays.files) == {"header", *(name for entry in head["arrays"].values() for name in entry.values())}


def test_a_fused_result_is_exported(fused: Path) -> None:
    export(fused, fused.with_name("f.npz"))
    with np.load(fused.with_name("f.npz"), allow_pickle=False) as arrays:
        assert arrays["fused_time"].tolist() == [0, 10 * MS, 20 * MS, 30 * MS]
        assert arrays["fused_specific_force"][1].tolist() == [0.1, 0.5, 9.8]
        assert np.isnan(arrays["fused_specific_force"][2]).all()
        assert arrays["fused_specific_force_covariance"][0].tolist() == [1.0, 2.0, 3.0, 0.25, 0.5, 0.75]
        assert json.loads(arrays["header"].item())["technique"] == "mean"


def test_colliding_names_are_made_distinct(tmp_path: Path) -> None:
    """Sensor A has A_temperature_counts, and so has the counts of a sensor called A_temperature."""
    from dataclasses import replace

    two = [replace(ACC, name="A"), replace(ACC, name="A_temperature")]
    with LogWriter(tmp_path / "a.h5", two, source="simulated", epoch=EPOCH) as log:
        for number, header in enumerate(two):
            rows = np.arange(2), np.full((2, 3), number), np.zeros(2, np.uint16), np.full(2, 10 + number)
            log.append(header.name, Block(*rows))
    export(tmp_path / "a.h5", tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as arrays:
        called = json.loads(arrays["header"].item())["arrays"]
        assert arrays[called["sensors/A"]["temperature_counts"]].tolist() == [10, 10]
        assert arrays[called["sensors/A_temperature"]["counts"]].tolist() == [[1, 1, 1]] * 2


@pytest.mark.slow
def test_the_size_of_blocks_does_not_change_the_arrays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    with LogWriter(tmp_path / "a.h5", [ACC], source="simulated", epoch=EPOCH) as log:
        counts = rng.integers(-(2**15), 2**15, (1000, 3))
        log.append("Acc", Block(np.arange(1000), counts, np.zeros(1000, np.uint16), np.zeros(1000)))
    for rows in (1, 7, 1 << 14):
        monkeypatch.setattr("imuarray.export.tables.ExportTable.blocks.__defaults__", (rows,))
        export(tmp_path / "a.h5", tmp_path / "a.npz", force=True)
        with np.load(tmp_path / "a.npz", allow_pickle=False) as arrays:
            assert (arrays["Acc_counts"] == counts).all()


def test_a_full_disk_leaves_no_file(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import errno

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "no room")

    monkeypatch.setattr("imuarray.export.npz_file._write_column", full)
    with pytest.raises(OutputError, match="No space left") as caught:
        export(run, run.with_name("r.npz"))
    assert caught.value.exit_code == 3
    assert [path.name for path in run.parent.iterdir()] == ["run.h5"]
