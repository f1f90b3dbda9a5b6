"""Logs that other programs write: forms that the format allows and our own writer does not use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from imuarray.calibrate.model import nominal
from imuarray.characterise.processing import find_missing_gravity
from imuarray.cli import main
from imuarray.errors import CalibrationError
from imuarray.log import open_log
from imuarray.log.reader import verify

ATTRIBUTES: dict[str, Any] = {
    "chip": "adxl345", "quantity": "specific_force", "range": 16.0, "unit": "g", "sensitivity": 256.0, "rate_hz": 100.0,
    "bandwidth_hz": 50.0, "axes": "+X+Y+Z",
}  # fmt: skip


def write(path: Path, columns: dict[str, Any], **others: Any) -> Path:
    """Write a log of an accelerometer `A` by h5py alone; `others` replace its attributes."""
    with h5py.File(path, "w") as file:
        file.attrs.update(format="imuarray-log", format_version=1, epoch="2026-01-02T03:04:05Z", source="i2c")
        file.create_group("sensors/A").attrs.update(ATTRIBUTES | others)
        for name, column in columns.items():
            file[f"sensors/A/{name}"] = column
    return path


@pytest.mark.parametrize(
    ("stored", "read"),
    [("u1", "i2"), ("<u2", "i4"), (">u2", "i4"), (">i2", "i2"), ("u4", "i8"), ("u8", "i8"), ("i8", "i8")],
)
def test_counts_are_read_as_signed_integers(tmp_path: Path, stored: str, read: str) -> None:
    """The difference of 3 and 200 is -197; in one byte without a sign it is 59."""
    path = write(tmp_path / "a.h5", {"time": np.arange(2), "counts": np.array([[200, 1, 0], [3, 0, 1]], stored)})
    with open_log(path) as log:
        for _ in range(2):
            counts = log["A"].counts
            assert counts.dtype == np.dtype(read) and counts[:].dtype == np.dtype(read) and counts[0, 0] == 200
            assert np.diff(counts[:], axis=0).tolist() == [[-197, -1, 1]]
            log.keep_rows()


@pytest.mark.parametrize("axes", [{"axes": ""}, {}])
def test_a_barometer_needs_no_axes(tmp_path: Path, axes: dict[str, str]) -> None:
    path = write(tmp_path / "a.h5", {"time": np.arange(2), "counts": np.zeros((2, 3), np.int16)})
    with h5py.File(path, "r+") as file:
        file.create_group("sensors/B").attrs.update({"chip": "bmp180", "quantity": "pressure", "unit": "Pa"} | axes)
        file["sensors/B/time"] = np.arange(2)
        file["sensors/B/counts"] = np.zeros((2, 2), np.int32)
    with open_log(path) as log:
        assert (len(log["B"]), log["B"].axes) == (2, "+X+Y+Z")


@pytest.mark.parametrize("stored", ["u8", ">u8", ">i8", "i8"])
def test_times_beyond_53_bits_keep_their_last_nanosecond(tmp_path: Path, stored: str) -> None:
    """2**60 + 1 ns is no float; a sum of uint64 and int64 is one."""
    path = write(
        tmp_path / "a.h5", {"time": np.array([2**60, 2**60 + 1], stored), "counts": np.zeros((2, 3), np.int16)}
    )
    with open_log(path) as log:
        time = log["A"].time
        assert time.dtype == np.int64
        assert (time[:] + np.int64(1)).tolist() == [2**60 + 1, 2**60 + 2]


def test_numbers_as_written_by_matlab_are_read(tmp_path: Path) -> None:
    """An attribute is an array with one element, and every number a float."""
    columns = {"time": np.arange(2), "counts": np.zeros((2, 3), np.int16)}
    path = write(
        tmp_path / "a.h5", columns, sensitivity=np.array([256.0]), range=np.array([[16.0]]), chip=np.array([b"x"])
    )
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = np.array([1.0])
        file.attrs["frame_rate_hz"] = np.array([50.0])
    with open_log(path) as log:
        assert (log["A"].sensitivity, log["A"].range, log["A"].chip, log.frame_rate_hz) == (256.0, 16.0, "x", 50.0)


def test_verify_names_an_epoch_without_a_date_and_phases_without_time(tmp_path: Path) -> None:
    path = write(tmp_path / "a.h5", {"time": np.arange(2), "counts": np.zeros((2, 3), np.int16)})
    with h5py.File(path, "r+") as file:
        file.attrs["epoch"] = "yesterday"
        text = h5py.string_dtype()
        phases = {
            "start": [9, 0],
            "end": [9, 5],
            "name": np.array(["static", "z_up"], text),
            "up": np.array(["", "up"], text),
        }
        for name, column in phases.items():
            file[f"phases/{name}"] = column
        file["reference/angular_rate"] = np.zeros((2, 3))
    assert verify(path).problems == (
        "group reference has no time",
        "attribute epoch is 'yesterday'; a date in ISO 8601 is required, such as 2026-01-31T12:00:00Z",
        "phase 'static': its end, 9 ns, is not after its start, 9 ns",
        "phase 'z_up': up is 'up'; allowed are +X, -X, +Y, -Y, +Z, -Z and an empty text",
    )


def test_an_accelerometer_of_unknown_sensitivity_is_characterised_but_not_fused(tmp_path: Path) -> None:
    columns = {"time": np.arange(3000) * 10_000_000, "counts": np.full((3000, 3), 100, np.int16)}
    with open_log(write(tmp_path / "a.h5", columns, sensitivity=0.0)) as log:
        assert find_missing_gravity(log["A"]) == ""
        with pytest.raises(CalibrationError, match=r"sensor A: its sensitivity \(counts per g\) is not known"):
            nominal(log["A"])


def test_fuse_names_a_quantity_without_a_reading(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The accelerometer began an hour after the gyroscope ended."""
    time, counts = np.arange(100) * 10_000_000, np.zeros((100, 3), np.int16)
    path = write(tmp_path / "a.h5", {"time": time + 3600 * 10**9, "counts": counts})
    gyro = ATTRIBUTES | {"chip": "l3g4200d", "quantity": "angular_rate", "unit": "dps"}
    with h5py.File(path, "r+") as file:
        file.create_group("sensors/G").attrs.update(gyro)
        file["sensors/G/time"], file["sensors/G/counts"] = time, counts
        del file["sensors/A/time"], file["sensors/A/counts"]
        file["sensors/A/time"], file["sensors/A/counts"] = time[:0], counts[:0]
    assert main(["fuse", str(path), "-o", str(tmp_path / "f.h5")]) == 0
    output = capsys.readouterr().out
    assert "specific_force: no frame has a value, because A had no valid reading near the time of a frame" in output
    assert "angular_rate: no frame" not in output
