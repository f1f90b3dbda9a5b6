"""Files that are no logs, damaged logs and hostile logs: each a `LogError` of one line."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from h5py._hl.base import phil

from imuarray.errors import CalibrationError, LogError
from imuarray.log import Log, open_log
from imuarray.log.inspection import HeapCheckedFile
from imuarray.log.reader import verify
from tests.selection import some

Spoil = Callable[[h5py.File], None]


def refusal(path: Path) -> str:
    """The one line with which a file is refused, when it is opened or when its contents are read."""
    with pytest.raises(LogError) as refused, open_log(path) as log:
        _ = log.phases, log.events, log.truth, log.reference, log.epoch
    message = str(refused.value)
    assert message.startswith(str(path))
    assert len(message.splitlines()) == 1
    return message.removeprefix(str(path)).lstrip(":, ")


def spoilt(path: Path, spoil: Spoil) -> Path:
    with h5py.File(path, "r+") as file:
        spoil(file)
    return path


def test_a_good_log_is_not_refused(small: Path) -> None:
    with open_log(small) as log:
        assert list(log.sensors) == ["Acc", "Baro", "Gyro"]
        assert [sensor.name for sensor in log.of("angular_rate")] == ["Gyro"]
        assert log["Acc"].counts[1:3].tolist() == [[-8192, 8191, 1], [0, 0, 0]]
        assert log["Acc"].between(10_000_000, 30_000_000) == slice(1, 3)
        assert [(part.start, part.stop) for part in log["Acc"].blocks(2)] == [(0, 2), (2, 4), (4, 5)]
        with pytest.raises(LogError, match="no sensor 'acc'; it has Acc, Baro, Gyro"):
            log["acc"]
        with pytest.raises(LogError, match="column pressure is missing"):
            log["Acc"].compensated("pressure")
        assert log["Baro"].compensated("pressure")[0] == 69963.0


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none.h5") == "no such file"
    assert refusal(tmp_path) == "is a folder"


@pytest.mark.parametrize("content", [b"", b"time,x,y,z\n0,1,2,3\n", b"\x89HDF\r\n\x1a\n", b"PK\x03\x04", bytes(4096)])
def test_files_other_than_hdf5_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.h5").write_bytes(content)
    assert "a log is an HDF5 file of format 'imuarray-log'" in refusal(tmp_path / "x.h5")


def test_a_log_truncated_anywhere_is_refused(tmp_path: Path, small_bytes: bytes) -> None:
    path = tmp_path / "cut.h5"
    for kept in [*range(0, 100, 7), *np.linspace(100, len(small_bytes) - 1, 60).astype(int)]:
        path.write_bytes(small_bytes[:kept])
        refusal(path)


@pytest.mark.slow
def test_damaged_metadata_are_refused_or_omitted(tmp_path: Path, small_bytes: bytes) -> None:
    """One wrong byte in each object header and heap; always the same, since some damage makes HDF5 itself fail."""
    path = tmp_path / "damaged.h5"
    places = [match.start() for match in re.finditer(rb"OHDR|OCHK|FRHP|FHDB|BTHD|BTLF|GCOL", small_bytes)]
    assert len(places) > 20
    refused = partial = 0
    for place in places:
        spoilt_bytes = bytearray(small_bytes)
        spoilt_bytes[place + 6] ^= 0x21
        path.write_bytes(spoilt_bytes)
        try:
            with Log(path) as log:
                partial += bool(log.losses)
                _ = log.phases, log.events, log.truth, log.epoch
        except LogError as error:
            refused += 1
            assert len(str(error).splitlines()) == 1
    assert refused > 5  # its root, or an object that is read here
    assert partial > 10  # a sensor is left out, the others can be read


def test_other_hdf5_files_are_refused(tmp_path: Path) -> None:
    for attribute in (None, "netcdf", b"imuarray", 5, [1, 2], ["a", "b"], h5py.Empty("f")):
        with h5py.File(tmp_path / "x.h5", "w") as file:
            if attribute is not None:
                file.attrs["format"] = attribute
        assert refusal(tmp_path / "x.h5").startswith("an HDF5 file, but not a log")


@pytest.mark.parametrize("version", some([0, 2, "1.0", -1, None, [1, 1]], 3))
def test_other_versions_are_refused(small: Path, version: Any) -> None:
    def spoil(file: h5py.File) -> None:
        del file.attrs["format_version"]
        if version is not None:
            file.attrs["format_version"] = version

    assert "reads format 1" in refusal(spoilt(small, spoil))


def delete(name: str) -> Spoil:
    return lambda file: file.__delitem__(name)


def replace(name: str, data: Any) -> Spoil:
    def spoil(file: h5py.File) -> None:
        del file[name]
        file[name] = data

    return spoil


def attribute(name: str, key: str, value: Any) -> Spoil:
    def spoil(file: h5py.File) -> None:
        if value is None:
            del file[name].attrs[key]
        else:
            file[name].attrs[key] = value

    return spoil


@pytest.mark.filterwarnings("ignore::imuarray.errors.LogWarning")  # the texts are not those that were written
@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (delete("sensors"), "group sensors is missing or empty"),
        (replace("sensors", 5), "group sensors is missing or empty"),
        (attribute("/", "source", "dream"), "attribute source is 'dream'; allowed are i2c"),
        (attribute("/", "source", None), "attribute source is None"),
        (delete("sensors/Acc/time"), "sensor Acc: column time is missing"),
        (delete("sensors/Acc/counts"), "sensor Acc: column counts is missing"),
        (
            replace("sensors/Acc/counts", np.zeros((4, 3), np.int16)),
            r"sensor Acc: column counts has another length than time: its shape is \(4, 3\), that of time \(5,\)",
        ),
        (
            replace("sensors/Acc/status", np.zeros(6, np.uint16)),
            "sensor Acc: column status has another length than time",
        ),
        (
            replace("sensors/Acc/temperature_counts", np.zeros(4, np.int16)),
            "sensor Acc: column temperature_counts has another length",
        ),
        (
            replace("sensors/Acc/counts", np.zeros((5, 2), np.int16)),
            r"sensor Acc: column counts is not an \(n, 3\) table",
        ),
        (replace("sensors/Acc/counts", np.zeros(5, np.int16)), r"sensor Acc: column counts is not an \(n, 3\) table"),
        (replace("sensors/Acc/counts", np.zeros((5, 3))), "sensor Acc: column counts is not a column of whole numbers"),
        (replace("sensors/Acc/time", np.arange(5.0)), "sensor Acc: column time is not a column of whole numbers"),
        (
            replace("sensors/Acc/status", np.full(5, -1)),
            "Acc: column status is not a column of unsigned .* but of int64",
        ),
        (
            replace("sensors/Acc/status", np.zeros((5, 1), "u2")),
            r"Acc: column status has shape \(5, 1\), one number in",
        ),
        (replace("sensors/Acc/time", np.array([0, 1, 3, 3, 4])), "Acc: column time does not increase after row 2$"),
        (
            replace("sensors/Acc/time", np.arange(5) + 2**62),
            r"sensor Acc: column time reaches 4.612e\+09 s; allowed are 4.612e\+09 s \(146 years\) before and after",
        ),
        (replace("sensors/Acc/time", np.arange(5) - 2**62), "sensor Acc: column time reaches -4.612e"),
        (attribute("sensors/Acc", "sensitivity", -512.0), "Acc: attribute sensitivity is -512, 0 or more is required"),
        (attribute("sensors/Gyro", "rate_hz", -1), "Gyro: attribute rate_hz is -1, 0 or more is required$"),
        (attribute("sensors/Acc", "chip", None), "sensor Acc: attribute chip is missing"),
        (attribute("sensors/Acc", "quantity", "speed"), "sensor Acc: attribute quantity is 'speed'; allowed are "),
        (
            attribute("sensors/Acc", "unit", "dps"),
            "sensor Acc: attribute unit is 'dps'; allowed for specific_force is g",
        ),
        (attribute("sensors/Acc", "unit", "m"), "sensor Acc: attribute unit is 'm'; allowed are g, dps"),
        (attribute("sensors/Acc", "range", "wide"), "sensor Acc: attribute range is 'wide', a number is required"),
        (attribute("sensors/Acc", "sensitivity", np.nan), "sensor Acc: attribute sensitivity is nan, a finite number"),
        (
            attribute("sensors/Acc", "sensitivity", None),
            "sensor Acc: attribute sensitivity is missing, a number is required",
        ),
        (attribute("sensors/Acc", "rate_hz", [1.0, 2.0]), "sensor Acc: attribute rate_hz is .* a number is required"),
        (attribute("sensors/Acc", "axes", "+X+Y-Z"), r"sensor Acc: axes '\+X\+Y-Z': this triad is left-handed"),
        (attribute("sensors/Acc", "axes", 5), "sensor Acc: attribute axes is"),
        (attribute("sensors/Acc", "axes", "Q" * 60_000), f"sensor Acc: axes '{'Q' * 40}\\.\\.\\.': write the box axes"),
        (
            attribute("sensors/Acc", "orientation", np.diag([1.0, 1.0, -1.0])),
            "sensor Acc: attribute orientation is not a 3x3 rotation",
        ),
        (
            attribute("sensors/Acc", "orientation", 2 * np.eye(3)),
            "sensor Acc: attribute orientation is not a 3x3 rotation",
        ),
        (
            attribute("sensors/Acc", "orientation", np.full((3, 3), np.nan)),
            "sensor Acc: attribute orientation is not a 3x3 rotation",
        ),
        (attribute("sensors/Acc", "orientation", np.eye(2)), "sensor Acc: attribute orientation is not a 3x3 rotation"),
        pytest.param(
            attribute("sensors/Acc", "orientation", "upright"),
            "sensor Acc: attribute orientation",
        ),
        pytest.param(
            attribute("sensors/Acc", "position_mm", "left"),
            "sensor Acc: attribute position_mm",
        ),
        (replace("sensors/Acc", np.arange(3)), "sensor Acc: is not a group; a sensor is a group of columns"),
        (delete("phases/name"), "group phases is missing one of the columns start, end, name, up"),
        (replace("events/time", [1, 2]), "group events has columns of different lengths"),
        (replace("phases", 5), "group phases"),
        (replace("phases/start", 5), "group phases"),
        pytest.param(
            replace("phases/start", np.array([b"soon", b"now"])),
            "group phases",
        ),
        (delete("truth/time"), "group truth has no time"),
        (replace("truth", 5), "group truth"),
        pytest.param(
            replace("truth/specific_force", np.zeros((4, 3))),
            "group truth",
        ),
        pytest.param(
            replace("sensors/Acc/time", np.array([4, 3, 2, 1, 0])),
            "sensor Acc: ",
        ),
    ],
)
def test_malformed_logs_are_refused(small: Path, spoil: Spoil, text: str) -> None:
    message = refusal(spoilt(small, spoil))
    assert re.search(text, message), message


def test_a_kept_refusal_does_not_block_other_threads(small: Path) -> None:
    """The traceback keeps the frames of the read, and with them h5py's lock if that was taken."""

    def is_free() -> bool:
        free: bool = phil.acquire(blocking=False)
        if free:
            phil.release()
        return free

    with pytest.raises(LogError) as refused:
        open_log(spoilt(small, delete("sensors/Acc/time")))
    with ThreadPoolExecutor(1) as other:
        assert other.submit(is_free).result()
    assert refused.tb is not None


def test_a_sensor_that_is_a_dataset_is_refused(small: Path) -> None:
    def spoil(file: h5py.File) -> None:
        attributes = dict(file["sensors/Acc"].attrs)
        del file["sensors/Acc"]
        file["sensors/Acc"] = np.arange(3)
        file["sensors/Acc"].attrs.update(attributes)

    refusal(spoilt(small, spoil))


def nested(file: h5py.File) -> None:
    file.create_group("/".join(["a"] * 40))


def circular(file: h5py.File) -> None:
    file["sensors/Acc/again"] = file["sensors"]


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((5, 3), "i2")
    layout[:] = h5py.VirtualSource("/etc/passwd", "x", (5, 3))
    del file["sensors/Acc/counts"]
    file["sensors/Acc"].create_virtual_dataset("counts", layout)


def outside(file: h5py.File) -> None:
    del file["sensors/Acc/counts"]
    file["sensors/Acc"].create_dataset("counts", (5, 3), "i2", external=[("/etc/passwd", 0, 30)])


def unknown_filter(file: h5py.File) -> None:
    del file["sensors/Acc/counts"]
    creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    creation.set_chunk((5, 3))
    creation.set_filter(32100, h5py.h5z.FLAG_OPTIONAL, ())
    h5py.h5d.create(file["sensors/Acc"].id, b"counts", h5py.h5t.STD_I16LE, h5py.h5s.create_simple((5, 3)), creation)


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (
            replace("sensors/Acc/counts", h5py.ExternalLink("/etc/passwd", "/x")),
            "sensors/Acc/counts: a link to another place",
        ),
        (replace("sensors/Acc", h5py.ExternalLink("other.h5", "/x")), "sensors/Acc: a link to another place"),
        (
            replace("sensors/Acc/counts", h5py.SoftLink("/sensors/Gyro/counts")),
            "sensors/Acc/counts: a link to another place",
        ),
        (replace("sensors/Acc/counts", h5py.SoftLink("/nowhere")), "sensors/Acc/counts: a link to another place"),
        (lambda file: file.__setitem__("type", np.dtype("f8")), "type: neither group nor dataset"),
        (virtual, "sensors/Acc/counts: data stored outside"),
        (outside, "sensors/Acc/counts: data stored outside"),
        (unknown_filter, "sensors/Acc/counts: .*unknown filter"),
        (nested, "nested deeper than"),
        (circular, "sensors/Acc/again: reached twice"),
    ],
)
def test_hostile_logs_are_refused(small: Path, spoil: Spoil, text: str) -> None:
    message = refusal(spoilt(small, spoil))
    assert re.search(text, message), message


@pytest.mark.filterwarnings("ignore::imuarray.errors.LogWarning")  # the tables are not those that were written
def test_additional_and_missing_optional_entries_are_accepted(small: Path) -> None:
    def spoil(file: h5py.File) -> None:
        file["sensors/Acc"].attrs["colour"] = "red"
        file["sensors/Acc/more"] = np.arange(7)
        file.create_group("notes")["a"] = "text"
        del file["sensors/Acc/status"], file["events"], file["truth"]
        del (
            file["sensors/Acc"].attrs["orientation"],
            file["sensors/Acc"].attrs["position_mm"],
            file["sensors/Acc"].attrs["rate_hz"],
        )
        file["sensors/Acc"].attrs["chip"] = np.bytes_("bma180")

    with open_log(spoilt(small, spoil)) as log:
        acc = log["Acc"]
        assert acc.chip == "bma180"
        assert np.asarray(acc.status).tolist() == [0] * 5
        np.testing.assert_array_equal(acc.orientation, [[0, 1, 0], [1, 0, 0], [0, 0, -1]])
        assert (acc.rate_hz, acc.position_mm.tolist()) == (0.0, [0.0, 0.0, 0.0])
        assert log.events == ()
        assert log.truth is None


def test_an_orientation_between_the_axes_is_read(small: Path) -> None:
    angle = np.radians(1.5)
    turned = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    with open_log(spoilt(small, attribute("sensors/Gyro", "orientation", turned))) as log:
        np.testing.assert_array_equal(log["Gyro"].orientation, turned)


def test_a_malformed_truth_is_a_problem_of_verify(small: Path) -> None:
    """The log opens: only reading the truth is refused."""
    spoilt(small, replace("truth/specific_force", np.zeros((4, 3))))
    (problem,) = verify(small).problems
    assert "group truth" in problem


@pytest.mark.parametrize(
    ("offset", "whence", "place"), [(7, os.SEEK_SET, 7), (7, os.SEEK_CUR, 12), (-7, os.SEEK_END, -7)]
)
def test_a_heap_checked_file_is_positioned_as_any_file(small: Path, offset: int, whence: int, place: int) -> None:
    """After five bytes were read."""
    content = small.read_bytes()
    expected = place % len(content)
    with HeapCheckedFile(small) as file:
        assert file.read(5) == content[:5]
        assert file.seek(offset, whence) == file.tell() == expected
        assert file.read(3) == content[expected : expected + 3]


READERS: dict[str, Callable[[Log], object]] = {
    "epoch": lambda log: log.epoch,
    "state": lambda log: log.state,
    "phases": lambda log: log.phases,
    "events": lambda log: log.events,
    "truth": lambda log: log.truth,
    "a column that was not read before": lambda log: log["Acc"].counts[:2],
    "a compensated column": lambda log: log["Baro"].compensated("pressure"),
    "names of columns": lambda log: log["Baro"].count_columns,
}


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_a_closed_log_is_not_read(small: Path, read: Callable[[Log], object]) -> None:
    with open_log(small) as log:
        pass
    with pytest.raises(LogError, match=r"small\.h5.*: the log is closed"):
        read(log)


def test_a_sensor_is_selected_by_its_name_not_by_a_number(small: Path) -> None:
    with open_log(small) as log, pytest.raises(LogError, match="no sensor 0; it has Acc, Baro, Gyro"):
        log[0]  # type: ignore[index]


def test_a_single_name_is_one_sensor_to_plot(small: Path) -> None:
    pytest.importorskip("matplotlib")
    with open_log(small) as log:
        assert len(log.plot("Acc").axes) == len(log.plot(["Acc"]).axes) == 1


def test_the_path_of_a_calibration_is_no_calibration(small: Path) -> None:
    pytest.importorskip("matplotlib")
    with (
        open_log(small) as log,
        pytest.raises(
            CalibrationError, match="str given as a calibration; allowed is a Calibration, as load_calibration"
        ),
    ):
        log.plot("Acc", "cal.toml")  # type: ignore[arg-type]
