"""A fused result as a file: its content, and no unfinished file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.errors import FusionError, LogError, OutputExistsError
from imuarray.fuse import FaultEvent, FusedBlock, read_fused, read_fused_events, write_fused
from imuarray.fuse.fused_file import LiveFused
from tests.fuse.conftest import EPOCH


def blocks(count: int = 3, rows: int = 5000) -> Iterator[FusedBlock]:
    """Row k of the whole has time 1000 k, force (k, k + 0.25, NaN) and rate (-k, 0, 0)."""
    for block in range(count):
        k = np.arange(block * rows, (block + 1) * rows, dtype=float)
        force = np.stack([k, k + 0.25, np.full(rows, np.nan)], axis=1)
        rate = np.stack([-k, 0 * k, 0 * k], axis=1)
        yield FusedBlock((1000 * k).astype(np.int64), {"specific_force": force, "angular_rate": rate})


def test_columns_and_attributes_of_a_fused_file(tmp_path: Path) -> None:
    path, reports = tmp_path / "fused.h5", []
    frames = write_fused(
        path, blocks(), epoch=EPOCH, technique="planes", log="run.h5", calibration="cal.toml", progress=reports.append
    )
    assert frames == 15000
    assert reports == [5000, 10000, 15000]
    with h5py.File(path) as file:
        head = dict(file.attrs)
        assert (head["format"], head["format_version"], head["epoch"]) == ("imuarray-fused", 1, EPOCH)
        assert (head["technique"], head["log"], head["calibration"]) == ("planes", "run.h5", "cal.toml")
        assert head["software"].startswith("imuarray ")
        fused = file["fused"]
        k = np.arange(15000)
        assert fused["time"].dtype == np.int64
        assert (fused["time"][:] == 1000 * k).all()
        assert (fused["specific_force"][:, 1] == k + 0.25).all()
        assert np.isnan(fused["specific_force"][:, 2]).all()
        assert (fused["angular_rate"][:, 0] == -k).all()
        assert fused["specific_force"].attrs["units"] == "m s-2"
        assert fused["angular_rate"].attrs["units"] == "rad s-1"
        assert fused["time"].attrs["units"] == f"nanoseconds since {EPOCH}"
    assert [entry.name for entry in tmp_path.iterdir()] == ["fused.h5"]


def test_an_existing_file_is_overwritten_only_with_force(tmp_path: Path) -> None:
    path = tmp_path / "fused.h5"
    path.write_text("mine")
    with pytest.raises(OutputExistsError, match="exists already"):
        write_fused(path, blocks(), epoch=EPOCH, technique="mean", log="run.h5")
    assert path.read_text() == "mine"
    assert write_fused(path, blocks(1), epoch=EPOCH, technique="mean", log="run.h5", force=True) == 5000
    assert h5py.is_hdf5(path)


@pytest.mark.parametrize("failure", [FusionError("no"), KeyboardInterrupt(), MemoryError()])
def test_an_exception_keeps_the_existing_file_and_no_partial_file(tmp_path: Path, failure: BaseException) -> None:
    """No half-written file remains, and an existing file is not lost."""
    path = tmp_path / "fused.h5"
    path.write_text("mine")

    def failing() -> Iterator[FusedBlock]:
        yield from blocks(1)
        raise failure

    with pytest.raises(type(failure)):
        write_fused(path, failing(), epoch=EPOCH, technique="mean", log="run.h5", force=True)
    assert [entry.name for entry in tmp_path.iterdir()] == ["fused.h5"]
    assert path.read_text() == "mine"


def test_a_file_with_an_external_link_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["fused/time"] = np.arange(3)
        file["fused/A"] = h5py.ExternalLink("/etc/passwd", "/x")
    with pytest.raises(LogError, match="fused/A: a link to another place"):
        list(read_fused(tmp_path / "f.h5"))


def test_covariances_and_sensors_in_use_are_read_back(tmp_path: Path) -> None:
    time = np.arange(4, dtype=np.int64)
    covariance = np.arange(24.0).reshape(4, 6)
    used = np.array([[7, 0], [7, 5], [0, 0], [3, 7]], np.uint8)
    block = FusedBlock(
        time, {"specific_force": np.ones((4, 3))}, {"specific_force": covariance}, {"specific_force": used}
    )
    path = tmp_path / "fused.h5"
    write_fused(path, [block], epoch=EPOCH, technique="mean", log="run.h5", sensors={"specific_force": ["A", "B"]})
    (back,) = read_fused(path)
    assert (back.covariances["specific_force"] == covariance).all()
    assert (back.used["specific_force"] == used).all()
    assert list(back.triads) == ["specific_force"]
    with h5py.File(path) as file:
        assert list(file["fused/specific_force_used"].attrs["sensors"]) == ["A", "B"]
        assert list(file["fused/specific_force_covariance"].attrs["columns"]) == ["xx", "yy", "zz", "xy", "xz", "yz"]


STUCK = FaultEvent(2_100_000_000, "specific_force", "A1", ("x", "y", "z"), "stuck", "isolated", 0.0, 10.0)
BACK = FaultEvent(5_000_000_000, "angular_rate", "Gyro é", ("x",), "bias", "readmitted", 0.1, 0.0)
TOLD = [
    (2_100_000_000, "A1", "stuck", "isolated", "2.10 s: A1 is stuck (10 sigma): excluded"),
    (5_000_000_000, "Gyro é", "bias", "readmitted", "5.00 s: Gyro é x agrees with the others again: back in use"),
]


def test_events_added_during_writing_are_stored(tmp_path: Path) -> None:
    path, events = tmp_path / "fused.h5", []

    def watched() -> Iterator[FusedBlock]:
        for block, event in zip(blocks(2), (STUCK, BACK), strict=True):
            events.append(event)
            yield block

    write_fused(path, watched(), epoch=EPOCH, technique="mean", log="run.h5", events=events)
    assert list(read_fused_events(path)) == TOLD
    with h5py.File(path) as file:
        assert file["events/time"].attrs["units"] == f"nanoseconds since {EPOCH}"
        assert file["events/message"].asstr()[1] == TOLD[1][-1]


def test_events_are_read_while_the_file_is_written(tmp_path: Path) -> None:
    path = tmp_path / "fused.h5"
    first, second = blocks(2)
    with LiveFused(path, epoch=EPOCH, technique="mean", log="run.h5") as live:
        live.append(first)
        with h5py.File(path, "r", swmr=True) as file:
            live.event(STUCK)
            column = file["events/message"]
            column.refresh()
            assert column.asstr()[:].tolist() == [TOLD[0][-1]]
        live.append(second)
        live.event(BACK)
    assert list(read_fused_events(path)) == TOLD


def test_a_very_long_name_is_cut_between_characters(tmp_path: Path) -> None:
    event = FaultEvent(0, "specific_force", "é" * 1000, ("x",), "bias", "isolated", 0.1, 9.0)
    write_fused(tmp_path / "f.h5", blocks(1), epoch=EPOCH, technique="mean", log="run.h5", events=[event])
    (stored,) = read_fused_events(tmp_path / "f.h5")
    assert stored.sensor == "é" * 128
    assert stored.message.startswith("0.00 s: éé")


def test_older_files_have_no_events_and_broken_ones_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "f.h5"
    write_fused(path, blocks(1), epoch=EPOCH, technique="mean", log="run.h5", events=[STUCK])
    with h5py.File(path, "r+") as file:
        del file["events/kind"]
    with pytest.raises(LogError, match="its events can't be read"):
        read_fused_events(path)
    with h5py.File(path, "r+") as file:
        del file["events"]
    assert read_fused_events(path) == ()


@pytest.mark.parametrize("rows", [1, 777, 4096, 16384, 40000])
def test_the_file_does_not_depend_on_blocks(tmp_path: Path, rows: int) -> None:
    """The columns of the file are the concatenated blocks, of any lengths."""
    given = list(blocks(max(2, min(50, 50000 // rows)), rows))
    write_fused(tmp_path / "f.h5", given, epoch=EPOCH, technique="mean", log="run.h5")
    result = FusedBlock.joined(list(read_fused(tmp_path / "f.h5")))
    assert (result.time == np.concatenate([block.time for block in given])).all()
    for quantity in ("specific_force", "angular_rate"):
        np.testing.assert_array_equal(result.triads[quantity], np.concatenate([b.triads[quantity] for b in given]))
