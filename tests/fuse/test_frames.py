"""Frames that are split and joined again."""

from __future__ import annotations

import numpy as np

from imuarray.fuse import Frames, FusedBlock


def test_joined_parts_equal_the_whole() -> None:
    """Flags that some parts lack are 0 in these; flags that no part has stay None."""
    time, values = np.arange(5, dtype=np.int64), np.arange(10.0).reshape(5, 2)
    clipped = np.array([[0, 0], [0, 0], [0, 0], [1, 0], [0, -1]], np.int8)
    whole = Frames(time, values, values > 2, clipped)
    cut = [whole.part(slice(0, 3)), whole.part(slice(3, None))]
    again = Frames.joined([Frames(cut[0].time, cut[0].values, cut[0].valid), cut[1]])
    assert again.time.tolist() == time.tolist()
    assert again.values.tolist() == values.tolist()
    assert again.valid.tolist() == (values > 2).tolist()
    assert again.clipped is not None and again.clipped.tolist() == clipped.tolist()
    assert again.clipped.dtype == np.int8
    assert again.stale is None


def test_joined_blocks_keep_their_columns() -> None:
    one = FusedBlock(np.array([1]), {"angular_rate": np.ones((1, 3))}, {}, {"angular_rate": np.array([[7]], np.uint8)})
    two = FusedBlock(np.array([2]), {"angular_rate": np.zeros((1, 3))}, {}, {"angular_rate": np.array([[3]], np.uint8)})
    both = FusedBlock.joined([one, two])
    assert both.time.tolist() == [1, 2]
    assert both.triads["angular_rate"].tolist() == [[1, 1, 1], [0, 0, 0]]
    assert both.used["angular_rate"].tolist() == [[7], [3]]
    assert both.covariances == {}
