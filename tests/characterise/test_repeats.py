"""Repeated readings: chips that are slower than their poll, equal readings by chance, and any block sizes."""

from __future__ import annotations

from itertools import groupby

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.characterise.repeats import APART, Repeats, RepeatTally, RunTally


def tally(counts: np.ndarray, block: int = 10_000) -> Repeats:
    rows = RepeatTally()
    for start in range(0, len(counts), block):
        rows.update(counts[start : start + block])
    return rows.result()


@settings(deadline=None)
@given(st.lists(st.lists(st.integers(0, 2), max_size=150), max_size=4), st.integers(1, 160), st.integers(1, 2))
def test_repeats_equal_those_counted_by_groupby(runs: list[list[int]], block: int, columns: int) -> None:
    """Compared with Python's groupby, for separate runs of the log; the second column is constant."""
    outcome = RepeatTally()
    for run in runs:
        counts = np.column_stack([run, np.full(len(run), 7)])[:, :columns].astype(np.int16)
        for start in range(0, len(run), block):
            outcome.update(counts[start : start + block])
        outcome.end_run()
    result = outcome.result()
    lengths = [len(list(group)) for run in runs for _, group in groupby(run)]
    pairs = sum(max(0, len(run) - 1) for run in runs)
    far = [run[at] == run[at - APART] for run in runs for at in range(APART, len(run))]
    assert (result.rows, result.longest) == (sum(map(len, runs)), max(lengths, default=0))
    if lengths:
        assert result.longest_row == sum(lengths[: lengths.index(max(lengths))])
    if pairs:
        assert result.repeat_share == pytest.approx((sum(lengths) - len(lengths)) / pairs)
    else:
        assert np.isnan([result.repeat_share, result.new_share]).all()
    np.testing.assert_allclose(result.chance_share, np.mean(far) if far else np.nan)


@pytest.mark.parametrize("spread", [0.4, 50.0])
@pytest.mark.parametrize("rate_hz", [100.0, 270.0, 800.0])
def test_the_update_rate_is_estimated(rate_hz: float, spread: float) -> None:
    """A chip of 100, 270 and 800 Hz polled at 400 Hz, also where a third of new readings are equal by chance.

    40,000 rows: the shares are known to 0.0025, the rate to 2 Hz where a third is equal by chance; 10 Hz are five.
    """
    fresh = np.rint(np.random.default_rng(1).normal(0, spread, (100_000, 3))).astype(np.int16)
    result = tally(fresh[(np.arange(40_000) * rate_hz / 400).astype(int)])
    assert result.update_rate_hz(400.0) == pytest.approx(min(rate_hz, 400.0), abs=10)
    if spread < 1:
        assert 0.2 < result.chance_share < 0.6
    else:
        assert result.chance_share < 1e-3


def test_a_repeat_needs_all_columns_equal() -> None:
    counts = np.array([[1, 2, 3], [1, 2, 4], [1, 2, 4], [1, 2, 4], [0, 2, 4]], np.int16)
    result = tally(counts)
    assert (result.repeat_share, result.longest, result.longest_row) == (0.5, 3, 1)


def test_a_stuck_chip_has_no_update_rate() -> None:
    result = tally(np.full((500, 3), 9))
    assert (result.repeat_share, result.longest) == (1, 500)
    assert np.isnan(result.new_share)


@pytest.mark.parametrize("at", [0, 1, 4, 9])
def test_the_longest_runs_of_an_axis_do_not_depend_on_blocks(at: int) -> None:
    codes = np.array([7, 7, 3, 5, 5, 5, 5, 2, 2, 2])
    runs = RunTally()
    for part in (codes[:at], codes[at:]):
        runs.update(part)
    runs.finish()
    assert (runs.rows, runs.first_row, runs.longest, runs.next_longest) == (10, 3, 4, 3)
