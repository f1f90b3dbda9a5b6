"""Intervals of equal rows, against a plain loop over them."""

from __future__ import annotations

from itertools import groupby

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.recording.events import MOST_STRETCHES, repeated_rows_in
from tests.gap.small_campaign import block


def held(counts: list[int], cuts: tuple[int, ...] = ()) -> list[tuple[int, int, int]]:
    """Rows, first and last time of the intervals in counts (all axes alike), row n at n ns, in pieces."""
    pieces = np.split(np.arange(len(counts)), cuts)
    found = repeated_rows_in(block(np.array(counts)[rows], 1, int(rows[0])) for rows in pieces if len(rows))
    return list(zip(found.rows.tolist(), found.begin_ns.tolist(), found.end_ns.tolist(), strict=True))


@given(st.lists(st.integers(0, 1), min_size=1, max_size=60), st.lists(st.integers(1, 59), max_size=5, unique=True))
def test_repeated_rows_equal_those_of_a_loop_for_any_blocks(counts: list[int], cuts: list[int]) -> None:
    """Of k equal rows k - 1 repeat the previous row."""
    expected, row = [], 0
    for _, equal in groupby(counts):
        count = len(list(equal))
        if count >= 3:
            expected.append((count - 1, row + 1, row + count - 1))
        row += count
    assert held(counts, tuple(sorted(cuts))) == expected


def test_a_repeated_row_needs_all_axes_equal() -> None:
    rows = np.zeros((9, 3))
    rows[:, 1] = [0, 1, 2, 3, 3, 3, 3, 4, 5]
    found = repeated_rows_in([block(rows, 1)])
    assert (found.rows.tolist(), found.begin_ns.tolist(), found.end_ns.tolist()) == ([3], [4], [6])
    assert found.counts.tolist() == [[0, 3, 0]]


def test_the_longest_intervals_are_kept() -> None:
    """More intervals of three rows than are kept, one of four and one of six."""
    many = [value for pair in range(MOST_STRETCHES) for value in (2 * pair,) * 3 + (2 * pair + 1,)]
    found = held([*many, -1, -1, -1, -1, -1, -1, *many])
    assert len(found) == MOST_STRETCHES
    assert found[-1] == (5, len(many) + 1, len(many) + 5)
    assert held([]) == []
