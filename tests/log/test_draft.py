"""A draft of a log regularly counts the space that its compressed rows take on the disk."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.log import hdf5_writer as draft
from imuarray.log.disk_space import Allowance
from imuarray.log.format import Preamble
from imuarray.log.hdf5_writer import Draft
from tests.log.conftest import EPOCH, GYRO


def test_the_reserved_room_of_rows_is_settled_at_intervals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A row of time, three counts and flags has 8 + 6 + 2 bytes, four of them 64. Settled beyond 150 bytes: with every
    third chunk of four rows.
    """
    settled: list[Allowance] = []
    monkeypatch.setattr(draft, "_SETTLED_BYTES", 150)
    monkeypatch.setattr(Allowance, "settle", lambda room: settled.append(room))
    log = Draft(tmp_path / "r.h5", Preamble((GYRO,), "i2c", EPOCH, "", "imuarray", "abc"), chunk=4)
    counted = []
    for start in range(0, 28, 4):
        time, counts, status = np.arange(start, start + 4) * 1000, np.zeros((4, 3), np.int16), np.zeros(4, np.uint16)
        log.append(0, {"time": time, "counts": counts, "status": status})
        counted.append(len(settled))
    log.discard()
    assert counted == [0, 0, 1, 1, 1, 2, 2]


@pytest.mark.parametrize("durable", [False, True])
def test_a_closed_draft_has_the_size_of_its_content(tmp_path: Path, durable: bool) -> None:
    """Room for all texts was asked for, of a durable one allocated; the end of the file is that of its superblock, at
    byte 28 of version 3.
    """
    preamble = Preamble((GYRO,), "i2c", EPOCH, "", "imuarray", "abc")
    log = Draft(tmp_path / "r.h5", preamble, chunk=4, durable=durable)
    time, counts, status = np.arange(4) * 1000, np.zeros((4, 3), np.int16), np.zeros(4, np.uint16)
    log.append(0, {"time": time, "counts": counts, "status": status})
    log.close()
    content = log.part.read_bytes()
    assert len(content) == int.from_bytes(content[28:36], "little")


def test_unused_room_of_a_file_is_released(tmp_path: Path) -> None:
    """HDF5 itself usually cuts a file that it closes; bytes after the end in its superblock are cut in any case. A
    file without such a superblock stays as it is.
    """
    path, other = tmp_path / "a.h5", tmp_path / "b.h5"
    with h5py.File(path, "w", libver="latest") as file:
        file["x"] = np.arange(1000)
    content = path.read_bytes()
    for beyond in (0, 1, 100_000):
        path.write_bytes(content + bytes(beyond))
        room = Allowance(path, path)
        room.trim()
        room.close()
        assert path.read_bytes() == content
    other.write_bytes(b"no HDF5" * 100)
    room = Allowance(other, other)
    room.trim()
    room.close()
    assert other.stat().st_size == 700
