"""The spool: last in, first out, with a file beyond its limit of memory."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.fuse.optimal import filter as spooled
from imuarray.fuse.optimal.filter import Spool


@pytest.mark.parametrize("held_bytes", [0, 100, 1 << 20])
def test_the_spool_returns_the_last_group_first(held_bytes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """For groups in the file one by one, several together, or all in memory."""
    monkeypatch.setattr(spooled, "_HELD_BYTES", held_bytes)
    rng = np.random.default_rng(105)
    groups = [[rng.normal(size=(index, 3)), rng.normal(size=index), np.zeros((0, 2))] for index in range(5)]
    spool = Spool()
    assert not spool
    for group in groups[:3]:
        spool.push(group)
    taken = [spool.pop()]
    for group in groups[3:]:
        spool.push(group)
    taken += [spool.pop() for _ in range(4)]
    assert not spool
    for got, put in zip(taken, [groups[2], groups[4], groups[3], groups[1], groups[0]], strict=True):
        assert [array.shape for array in got] == [array.shape for array in put]
        assert all((a == b).all() for a, b in zip(got, put, strict=True))
    with pytest.raises(IndexError, match="the spool is empty"):
        spool.pop()
    spool.close()
