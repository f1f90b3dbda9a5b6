"""Times, flags and words, counted by hand."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.statistics.intervals import IntervalMoments, StatusTally
from imuarray.log.format import LOST_BEFORE, SATURATED, STALE


def times(intervals_ns: list[int]) -> np.ndarray:
    return np.cumsum([1000, *intervals_ns])


@given(st.lists(st.integers(900, 1100), min_size=3, max_size=60), st.integers(1, 59))
def test_intervals_are_those_of_numpy(intervals_ns: list[int], cut: int) -> None:
    moments = IntervalMoments()
    stamps = times(intervals_ns)
    for part in (stamps[:cut], stamps[cut:]):
        if len(part):
            moments.update(part)
    found = moments.result()
    np.testing.assert_allclose(found.mean_s, np.mean(intervals_ns) * 1e-9, rtol=1e-12)
    np.testing.assert_allclose(found.std_s, np.std(intervals_ns) * 1e-9, atol=1e-14)
    assert (found.count, found.gaps) == (len(intervals_ns), 0)
    assert round(found.longest_s * 1e9) == max(intervals_ns)


def test_gaps_are_left_out_of_mean_and_spread() -> None:
    moments = IntervalMoments()
    moments.update(times([1000, 1000, 1000, 2000, 1000, 7000, 1000, 1000, 1000]))
    found = moments.result()
    assert (found.count, found.gaps) == (7, 2)
    np.testing.assert_allclose([found.mean_s, found.std_s, found.longest_s], [1e-6, 0.0, 7e-6])


def test_nothing_is_known_of_one_row() -> None:
    moments = IntervalMoments()
    moments.update(times([]))
    found = moments.result()
    assert found.count == 0
    assert np.isnan([found.mean_s, found.std_s, found.longest_s]).all()


def test_flags_and_words() -> None:
    tally = StatusTally()
    counts = np.array([[-1, -1, -1], [0, 0, 0], [5, 5, 5], [-1, -1, 0], [0, 0, 0]], np.int16)
    tally.update(np.array([STALE, STALE | SATURATED, 0, LOST_BEFORE, 0], np.uint16), counts)
    tally.update(np.zeros(5, np.uint16), counts + np.int16(3))
    assert tally.flags["stale"] == 2
    assert (tally.flags["saturated"], tally.flags["lost_before"], tally.flags["suspect"]) == (1, 1, 0)
    assert tally.words == 3
