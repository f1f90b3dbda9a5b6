"""Damaged, truncated or malicious fused files: one line that names the place, or the valid part."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from imuarray.errors import LogError
from imuarray.export import export
from imuarray.fuse import FaultEvent, FusedBlock, read_fused, read_fused_events, read_fused_head, write_fused
from imuarray.fuse.fused_file import LiveFused
from imuarray.log import open_log
from imuarray.report.files import file_kind
from imuarray.report.fused_page import fused_sections
from imuarray.report.page import Table
from tests.fuse.conftest import EPOCH
from tests.selection import some

FRAMES = 50


def block(frames: int = FRAMES) -> FusedBlock:
    """Frames of a force and of the sensors in use."""
    time = np.arange(frames, dtype=np.int64) * 10_000_000
    triad, covariance = np.tile([0.0, 0.0, 9.8], (frames, 1)), np.ones((frames, 6))
    used = np.full((frames, 2), 7, np.uint8)
    return FusedBlock(time, {"specific_force": triad}, {"specific_force": covariance}, {"specific_force": used})


def written(path: Path) -> Path:
    sensors = {"specific_force": ["A", "B"]}
    write_fused(path, [block()], epoch=EPOCH, technique="mean", log="run.h5", sensors=sensors)
    return path


def other(name: str, values: Any) -> Callable[[h5py.File], None]:
    """A column with other values."""

    def change(file: h5py.File) -> None:
        del file["fused"][name]
        file["fused"][name] = values

    return change


def group_at(name: str) -> Callable[[h5py.File], None]:
    """A group in place of a column."""

    def change(file: h5py.File) -> None:
        del file["fused"][name]
        file["fused"].create_group(name)

    return change


def with_attributes(**attributes: Any) -> Callable[[h5py.File], None]:
    return lambda file: file.attrs.update(attributes)


FORCE, COVARIANCE, USED = "specific_force", "specific_force_covariance", "specific_force_used"
BAD: dict[str, tuple[Callable[[h5py.File], Any], str]] = {
    "no time": (lambda file: file["fused"].pop("time"), "not a fused result"),
    "a group as time": (group_at("time"), "fused/time: not a column of numbers"),
    "one time": (other("time", 5), r"fused/time: its shape is \(\)"),
    "no times at all": (other("time", h5py.Empty("i8")), r"fused/time: its shape is \(\)"),
    "times of two columns": (other("time", np.zeros((FRAMES, 2), np.int64)), r"required is \(n,\)"),
    "times that are none": (other("time", np.full(FRAMES, np.nan)), "type int64"),
    "times in words": (other("time", np.array([b"x"] * FRAMES)), "type int64"),
    "a force of one axis": (other(FORCE, np.zeros(FRAMES)), r"required is \(n, 3\)"),
    "a force of four axes": (other(FORCE, np.zeros((FRAMES, 4))), r"required is \(n, 3\)"),
    "matrices for a force": (other(FORCE, np.zeros((FRAMES, 3, 3))), r"required is \(n, 3\)"),
    "a force in words": (other(FORCE, np.full((FRAMES, 3), b"x")), "type float"),
    "a force without end": (other(FORCE, np.full((FRAMES, 3), np.inf)), "infinite values"),
    "a group as force": (group_at(FORCE), "fused/specific_force: not a column"),
    "covariances of two entries": (other(COVARIANCE, np.zeros((FRAMES, 2))), r"required is \(n, 6\)"),
    "covariances of one": (other(COVARIANCE, np.zeros(FRAMES)), r"required is \(n, 6\)"),
    "fractions of an axis": (other(USED, np.zeros((FRAMES, 2))), "type uint8"),
    "use of nobody": (other(USED, np.zeros(FRAMES, np.uint8)), "at most 1024"),
    "use of a crowd": (other(USED, np.zeros((FRAMES, 3000), np.uint8)), "at most 1024"),
    "a later format": (with_attributes(format_version=2), "format_version is 2; this software reads 1"),
    "no version": (lambda file: file.attrs.pop("format_version"), "format_version is None"),
    "several versions": (with_attributes(format_version=[1, 1]), "damaged or malformed"),
}


@pytest.mark.parametrize("kind", some(BAD, 4))
def test_invalid_columns_are_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    change, words = BAD[kind]
    path = written(tmp_path / "bad.h5")
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(LogError, match=words) as caught:
        read_fused_head(path)
        list(read_fused(path))
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_triads_are_not_compressed_but_checked(tmp_path: Path) -> None:
    with h5py.File(written(tmp_path / "fused.h5")) as file:
        columns = {name: file["fused"][name] for name in ("time", "specific_force", "specific_force_covariance")}
        assert {name: column.compression for name, column in columns.items()} == {
            "time": "gzip",
            "specific_force": None,
            "specific_force_covariance": "gzip",
        }
        assert all(column.fletcher32 for column in columns.values())


@pytest.mark.parametrize("value", [5, [5, 6], "AB", np.zeros((2, 2)), h5py.Empty("S3")], ids=str)
def test_invalid_sensor_names_are_ignored(tmp_path: Path, value: Any) -> None:
    path = written(tmp_path / "f.h5")
    assert read_fused_head(path).sensors == {"specific_force": ("A", "B")}
    with h5py.File(path, "a") as file:
        file["fused"][USED].attrs["sensors"] = value
    assert read_fused_head(path).sensors == {"specific_force": ()}


def test_unknown_columns_are_ignored(tmp_path: Path) -> None:
    path = written(tmp_path / "f.h5")
    with h5py.File(path, "a") as file:
        file["fused"]["x_used"] = np.zeros((3, 1 << 10))
        file["fused"]["y_covariance"] = b"?"
    (back,) = read_fused(path)
    assert list(back.used) == list(back.covariances) == ["specific_force"]


def test_damaged_rows_are_named(tmp_path: Path) -> None:
    path = written(tmp_path / "f.h5")
    with h5py.File(path) as file:
        at = file["fused"][FORCE].id.get_chunk_info(0).byte_offset
    data = bytearray(path.read_bytes())
    data[at + 2 : at + 40] = b"\xff" * 38
    path.write_bytes(data)
    with pytest.raises(LogError, match="fused/specific_force: rows 0 to 49 are damaged"):
        list(read_fused(path))


def test_a_negative_variance_is_printed_as_a_dash(tmp_path: Path) -> None:
    path = written(tmp_path / "f.h5")
    with h5py.File(path, "a") as file:
        other(COVARIANCE, np.full((FRAMES, 6), -1.0))(file)
    _, section = fused_sections(path, read_fused_head(path), with_figures=False)
    assert isinstance(section.parts[0], Table)
    assert [row[-1] for row in section.parts[0].rows] == ["–"] * 3


@pytest.mark.slow
def test_the_page_lists_the_use_of_sensors_only_if_it_varies(tmp_path: Path) -> None:
    path = written(tmp_path / "f.h5")
    texts = []
    for used in (7, 5):
        with h5py.File(path, "a") as file:
            flags = file["fused"]["specific_force_used"]
            flags[:1] = used
            flags[1:] = 7
        _, section = fused_sections(path, read_fused_head(path), with_figures=False)
        texts.append((section.text, [part.heading for part in section.parts if isinstance(part, Table)]))
    (whole, tables), (part, more) = texts
    assert "was used in every frame." in whole and len(tables) == 1
    assert "every frame" not in part and more[1] == ["sensor", "x", "y", "z"]


def test_an_unfinished_result_can_be_read(tmp_path: Path) -> None:
    """HDF5 refuses a file that is marked as open for writing; one column is longer, since it is written first."""
    live = LiveFused(tmp_path / "live.h5", epoch=EPOCH, technique="mean", log="run.h5")
    live.append(block())
    path, cut_file = tmp_path / "live.h5", tmp_path / "cut.h5"
    with live:
        (back,) = read_fused(path)
        assert (back.time == block().time).all()
        assert (back.triads[FORCE] == block().triads[FORCE]).all()
        live._fused._group["time"].resize(FRAMES + 10, axis=0)
        live._fused._group["time"].flush()
        cut_file.write_bytes(path.read_bytes())
    assert read_fused_head(cut_file).frames == FRAMES
    assert [len(part.time) for part in read_fused(cut_file, block=30)] == [30, 20]
    assert sum(export(cut_file, tmp_path / "f.csv").rows.values()) == FRAMES
    assert file_kind(cut_file) == "fused result"
    with pytest.raises(LogError, match=r"cut\.h5: is a fused result, not a log$"):
        open_log(cut_file)


def test_a_result_whose_writer_was_killed_before_its_first_frame_is_no_log(tmp_path: Path) -> None:
    path = tmp_path / "killed.h5"
    with LiveFused(tmp_path / "live.h5", epoch=EPOCH, technique="mean", log="run.h5"):
        path.write_bytes((tmp_path / "live.h5").read_bytes())
    with pytest.raises(LogError, match=r"killed\.h5: is a fused result, not a log$"):
        open_log(path)


EVENT = FaultEvent(1, "specific_force", "A", ("x",), "stuck", "isolated", 0.0, 9.0)


def test_unfinished_events_are_ignored(tmp_path: Path) -> None:
    path = tmp_path / "f.h5"
    write_fused(path, [block()], epoch=EPOCH, technique="mean", log="run.h5", events=[EVENT])
    (event,) = read_fused_events(path)
    with h5py.File(path, "a") as file:
        file["events/time"].resize(2, axis=0)
        file["events/sensor"].resize(2, axis=0)
    assert read_fused_events(path) == (event,)


@pytest.mark.parametrize(
    "change",
    [
        lambda events: events.pop("kind"),
        lambda events: (events.pop("kind"), events.create_group("kind")),
        lambda events: (events.pop("time"), events.create_dataset("time", data=np.zeros((1, 2)))),
        lambda events: (events.pop("time"), events.create_dataset("time", data=[np.nan])),
        lambda events: (
            events.pop("message"),
            events.create_dataset("message", (1 << 17,), "S1024", chunks=(64,), compression="gzip"),
        ),
    ],
    ids=["none", "a group", "two times each", "no time", "a flood of words"],
)
def test_invalid_events_are_refused(tmp_path: Path, change: Callable[[h5py.Group], Any]) -> None:
    path = tmp_path / "f.h5"
    write_fused(path, [block()], epoch=EPOCH, technique="mean", log="run.h5", events=[EVENT])
    with h5py.File(path, "a") as file:
        change(file["events"])
        # so that the file is large enough for the declared data in compressed form
        file["ballast"] = np.ones(1 << 18, np.uint8)
    with pytest.raises(LogError, match="its events can't be read"):
        read_fused_events(path)
