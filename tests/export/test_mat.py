"""MATLAB's version 5, as scipy reads it; its limits; and a log itself, as MATLAB's h5read would see it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from h5py import h5a, h5o, h5t
from scipy.io import loadmat, whosmat

from imuarray.errors import ExportError
from imuarray.export import export
from imuarray.export import mat_file as mat
from imuarray.log import Block, LogWriter
from tests.export.conftest import ACC, ACC_COUNTS, EPOCH, MESSAGE, MS


def test_tables_are_structs(run: Path) -> None:
    export(run, run.with_name("r.mat"))
    contents = loadmat(run.with_name("r.mat"), simplify_cells=True)
    acc = contents["Acc"]
    assert acc["counts"].tolist() == ACC_COUNTS
    assert (acc["counts"].dtype, acc["time_ns"].dtype, acc["status"].dtype) == (np.int16, np.int64, np.uint16)
    assert acc["time_s"].tolist() == [0, 0.01, 0.02, 0.03, 0.04]
    assert acc["units"] == {"counts": "counts", "status": "1", "temperature_counts": "counts"}
    assert json.loads(acc["about_json"])["axes"] == "+Y+X-Z"
    head = contents["imuarray"]
    assert (head["epoch"], head["units"]) == (EPOCH, "counts")
    assert list(head["variables"]) == ["Acc", "Baro", "Gyro", "truth", "clocks"]
    assert head["events"]["message"][0] == MESSAGE
    assert head["events"]["time_ns"].tolist() == [30 * MS, -5]
    assert head["phases"]["name"].tolist() == ["z_up", "motion"]


def test_columns_are_n_by_3_or_n_by_1(run: Path) -> None:
    """n-by-3 and n-by-1, as MATLAB would have them."""
    export(run, run.with_name("r.mat"))
    acc = loadmat(run.with_name("r.mat"))["Acc"][0, 0]
    assert (acc["counts"].shape, acc["time_ns"].shape) == ((5, 3), (5, 1))


def test_a_fused_result_is_a_struct(fused: Path) -> None:
    export(fused, fused.with_name("f.mat"))
    contents = loadmat(fused.with_name("f.mat"), simplify_cells=True)["fused"]
    np.testing.assert_array_equal(contents["specific_force"][0], [0.0, 0.5, 9.8])
    assert list(contents["cells"]["specific_force_covariance"]) == ["xx", "yy", "zz", "xy", "xz", "yz"]


def test_names_of_variables_are_valid_in_matlab(tmp_path: Path) -> None:
    names = ["IMU-1", "IMU 1", "1st", "imuarray", "µ"]
    with LogWriter(
        tmp_path / "a.h5", [replace(ACC, name=name) for name in names], source="simulated", epoch=EPOCH
    ) as log:
        log.append("1st", Block(np.arange(2), np.ones((2, 3)), np.zeros(2, np.uint16), np.zeros(2)))
    export(tmp_path / "a.h5", tmp_path / "a.mat")
    variables = [name for name, _, _ in whosmat(tmp_path / "a.mat")]
    assert len(set(variables)) == 6
    assert all(name.isidentifier() and name.isascii() and name[0].isalpha() for name in variables)
    contents = loadmat(tmp_path / "a.mat", simplify_cells=True)
    assert {json.loads(contents[name]["about_json"])["name"] for name in contents["imuarray"]["variables"]} == set(
        names
    )


def test_a_log_beyond_the_limit_of_the_format_is_refused(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert mat.MOST_BYTES == 2147483647
    monkeypatch.setattr(mat, "MOST_BYTES", 39)
    with pytest.raises(ExportError, match=r'read the log itself: h5read\("RUN.h5", "/sensors/NAME/counts"\)'):
        export(run, run.with_name("r.mat"))
    assert [path.name for path in run.parent.iterdir()] == ["run.h5"]


READABLE = (h5t.INTEGER, h5t.FLOAT, h5t.STRING)
"""Classes of types that h5read and h5readatt turn into numbers and text (MATLAB: "Export to HDF5 Files", "h5read")."""


def test_a_log_contains_only_types_that_h5read_reads(run: Path) -> None:
    """Every column and every attribute is of numbers or text, but for the references of dimension scales."""
    with h5py.File(run) as file:
        places = [file, *(file[name] for name in _names(file))]
        for place in places:
            if isinstance(place, h5py.Dataset):
                assert place.id.get_type().get_class() in READABLE, place.name
            attributes: list[bytes] = []
            h5a.iterate(h5o.open(file.id, place.name.encode()), attributes.append)
            for name in set(attributes) - {b"DIMENSION_LIST", b"REFERENCE_LIST"}:
                assert h5a.open(place.id, name).get_type().get_class() in READABLE, (place.name, name)
        assert file["sensors/Acc/counts"].shape == (5, 3)  # 3-by-5 there
        assert {file["sensors/Acc"][name].id.get_type().get_order() for name in ("time", "counts")} == {h5t.ORDER_LE}


def test_a_log_has_the_layout_of_hdf5_1_10(run: Path) -> None:
    """The layout of a column is described in version 4 of that message, which HDF5 has read since 1.10; with the format
    of HDF5 2.0 it would be version 5, which MATLAB's library does not know (HDF5 File Format Specification, IV.A.2.i).
    """
    with h5py.File(run) as file:
        places = [h5o.get_info(file[f"sensors/Acc/{name}"].id).addr for name in ("time", "counts", "status")]
    data = run.read_bytes()
    assert [_layout_version(data, place) for place in places] == [4, 4, 4]


def _layout_version(data: bytes, place: int) -> int:
    """Of the object header (version 2) at `place`: messages follow each other, each with type, size and flags."""
    assert data[place : place + 4] == b"OHDR"
    flags = data[place + 5]
    start = place + 6 + (16 if flags & 32 else 0) + (4 if flags & 16 else 0)
    width = 1 << (flags & 3)
    end = start + width + int.from_bytes(data[start : start + width], "little")
    start += width
    while start < end:
        kind, size = data[start], int.from_bytes(data[start + 1 : start + 3], "little")
        start += 4 + (2 if flags & 4 else 0)
        if kind == 8:
            return data[start]
        start += size
    raise AssertionError("no layout message")


def _names(file: h5py.File) -> list[str]:
    names: list[str] = []
    file.visit(names.append)
    return names
