"""A log in the making counts again and again what its compressed rows really took of the disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.log import draft
from imuarray.log.disk_space import Allowance
from imuarray.log.draft import Draft
from imuarray.log.preamble import Preamble
from tests.log.conftest import EPOCH, GYRO


def test_rows_are_counted_and_their_room_is_settled_now_and_then(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_a_closed_draft_takes_no_more_than_it_needs(tmp_path: Path) -> None:
    """Room for all texts was asked for; the end of the file is that of its superblock, at byte 28 of version 3."""
    log = Draft(tmp_path / "r.h5", Preamble((GYRO,), "i2c", EPOCH, "", "imuarray", "abc"), chunk=4)
    time, counts, status = np.arange(4) * 1000, np.zeros((4, 3), np.int16), np.zeros(4, np.uint16)
    log.append(0, {"time": time, "counts": counts, "status": status})
    log.close()
    content = log.part.read_bytes()
    assert len(content) == int.from_bytes(content[28:36], "little")
