"""Frames that are written to the disk and read back."""

from __future__ import annotations

from contextlib import closing

import numpy as np

from imuarray.fuse.frames import Frames
from imuarray.fuse.spools import FrameSpool


def block(rng: np.random.Generator, first: int, frames: int, flags: bool) -> dict[str, Frames]:
    time = np.arange(first, first + frames, dtype=np.int64) * 10_000_000
    return {
        quantity: Frames(
            time,
            rng.normal(size=(frames, axes)),
            rng.random((frames, axes)) > 0.1,
            rng.integers(-1, 2, (frames, axes)).astype(np.int8) if flags else None,
            rng.random((frames, axes)) > 0.5 if flags else None,
            np.where(rng.random((frames, axes)) > 0.5, np.nan, 1.0) if flags else None,
        )
        for quantity, axes in (("angular_rate", 3), ("specific_force", 6))
    }


def test_blocks_are_read_back_in_order_repeatedly() -> None:
    rng = np.random.default_rng(11)
    written = [
        (block(rng, 10 * number, 10 - number, number != 1), {"A": rng.normal(size=10 - number)}) for number in range(3)
    ]
    written.append((block(rng, 40, 0, True), {}))
    with closing(FrameSpool()) as spool:
        for frames, degc in written:
            spool.add(frames, degc)
        assert spool.frames == 10 + 9 + 8
        for _ in range(2):
            read = list(spool.blocks())
            assert len(read) == len(written)
            for (frames, degc), (of_disk, degc_of_disk) in zip(written, read, strict=True):
                assert degc.keys() == degc_of_disk.keys() and frames.keys() == of_disk.keys()
                for sensor, column in degc.items():
                    np.testing.assert_array_equal(degc_of_disk[sensor], column)
                for quantity, part in frames.items():
                    for name in ("time", "values", "valid", "clipped", "stale", "offsets"):
                        column, other = getattr(part, name), getattr(of_disk[quantity], name)
                        assert (column is None) == (other is None)
                        if column is not None:
                            assert other.dtype == column.dtype
                            np.testing.assert_array_equal(other, column)


def test_columns_may_be_contiguous_in_memory() -> None:
    values = np.asfortranarray(np.random.default_rng(12).normal(size=(5, 3)))
    frames = {"angular_rate": Frames(np.arange(5), values, np.ones((5, 3), bool))}
    with closing(FrameSpool()) as spool:
        spool.add(frames, {})
        ((read, _),) = spool.blocks()
    np.testing.assert_array_equal(read["angular_rate"].values, values)
