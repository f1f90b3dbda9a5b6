"""Frames with errors on the disk: results share their columns of frames as long as the frames are the same."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.fuse.evaluation import ErrorFrames, ErrorFrameSpool


def frames(first: int, count: int, sd: float) -> ErrorFrames:
    """Frames of independent errors of one size, with increasing times and truth."""
    number = np.arange(first, first + count)
    truth = np.stack([number, number + 0.25, number + 0.5], axis=1).astype(float)
    covariances = np.tile([sd**2, sd**2, sd**2, 0.0, 0.0, 0.0], (count, 1))
    return ErrorFrames(number * 1_000, 2 * truth, truth, covariances)


def test_results_with_the_same_frames_share_them_until_they_differ() -> None:
    blocks = [frames(0, 5, 0.5), frames(5, 4, 0.5), frames(9, 3, 0.5)]
    kept = [0, 2, 3]  # of the second block
    with ErrorFrameSpool() as first, ErrorFrameSpool(motion=first.motion) as second:
        for number, block in enumerate(blocks):
            first.add(block)
            second.add(block[np.array(kept)] if number == 1 else block, first, block)
            assert (second.motion is first.motion) == (number == 0)
        for spool, numbers in ((first, range(12)), (second, [*range(5), 5, 7, 8, *range(9, 12)])):
            result, times = spool[:], np.array(numbers) * 1_000
            assert len(spool) == len(times)
            np.testing.assert_array_equal(spool.times(slice(None)), times)
            np.testing.assert_array_equal(result.time, times)
            np.testing.assert_array_equal(result.truth[:, 1], np.array(numbers) + 0.25)
            np.testing.assert_array_equal(result.errors[:, 2], 2 * (np.array(numbers) + 0.5))
            np.testing.assert_allclose(spool.white[:][:, 0], 4 * np.array(numbers), rtol=1e-14)


def test_a_spool_that_shares_reads_its_own_frames_only() -> None:
    block = frames(0, 6, 1.0)
    with ErrorFrameSpool() as first, ErrorFrameSpool(motion=first.motion) as second:
        first.add(block)
        assert len(second) == 0 and len(second[:]) == 0
        second.add(block, first, block)
        np.testing.assert_array_equal(second.times(slice(4, 9)), [4_000, 5_000])


def test_files_without_names_are_not_completed() -> None:
    with ErrorFrameSpool() as spool, pytest.raises(ValueError, match="no names"):
        spool.complete()
