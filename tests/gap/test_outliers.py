"""Single outlying readings: spikes are detected, steps and slopes are not."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.gap.recording.outliers import MOST, Outliers, OutlierTally
from tests.selection import examples

ROWS = 200


def lone(apart: np.ndarray, cuts: tuple[int, ...] = ()) -> Outliers:
    """Outliers of rows (n, 3), row n at n ns, in pieces."""
    tally, time_ns = OutlierTally(), np.arange(len(apart))
    for time, part in zip(np.split(time_ns, cuts), np.split(apart.astype(float), cuts), strict=True):
        tally.update(time, part.T)
    return tally.result()


@given(st.integers(2, ROWS - 3), st.integers(0, 2), st.integers(1, 1000), st.sampled_from([-1, 1]))
def test_a_spike_has_its_time_and_height(row: int, axis: int, height: int, sign: int) -> None:
    """Also on a slope: the expected value is the mean of its neighbours."""
    apart = np.outer(np.arange(ROWS), (0, 1, -3))
    apart[row, axis] += sign * height
    found = lone(apart)
    assert found.axis.tolist() == [axis]
    assert found.time_ns.tolist() == [row]
    np.testing.assert_allclose(found.deviation, [sign * height])


@given(st.integers(2, ROWS - 3), st.integers(2, 10))
def test_steps_and_pulses_are_not_outliers(row: int, length: int) -> None:
    step, pulse = np.zeros((2, ROWS, 3))
    step[row:] = 100
    pulse[row : row + length] = 100
    assert len(lone(step).deviation) == len(lone(pulse).deviation) == 0


@settings(max_examples=examples(20), deadline=None)
@given(st.lists(st.integers(1, ROWS - 1), max_size=6, unique=True), st.integers(0, 9))
def test_outliers_do_not_depend_on_blocks(cuts: list[int], seed: int) -> None:
    apart = np.random.default_rng(seed).integers(-9, 9, (ROWS, 3))
    whole, parts = lone(apart), lone(apart, tuple(sorted(cuts)))
    np.testing.assert_array_equal(whole.time_ns, parts.time_ns)
    np.testing.assert_array_equal(whole.deviation, parts.deviation)
    assert np.bincount(whole.axis, minlength=3).max() <= MOST
