"""Intervals and gaps of clocks with known faults, with any block sizes."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.characterise.survey import IntervalTally, SamplingIntervals
from tests.selection import examples

MEAN_NS = 2_500_000


def tally(time_ns: np.ndarray, block: int = 10_000) -> SamplingIntervals:
    times = IntervalTally()
    for start in range(0, len(time_ns), block):
        times.update(time_ns[start : start + block])
    return times.result()


def clock(rows: int, seed: int, jitter_ns: float = 0.0, stamp_ns: float = 0.0, alternation_ns: int = 0) -> np.ndarray:
    """Times with independent jitter of the intervals, of the stamps, and alternating short and long intervals."""
    rng = np.random.default_rng(seed)
    intervals = MEAN_NS + rng.normal(0, jitter_ns, rows) + alternation_ns * (-1) ** np.arange(rows)
    return np.rint(np.cumsum(intervals) + rng.normal(0, stamp_ns, rows)).astype(np.int64)


@settings(deadline=None, max_examples=examples(30))
@given(st.lists(st.integers(1, 60_000), min_size=1, max_size=300), st.integers(1, 400))
def test_intervals_of_short_logs_are_exact(intervals: list[int], block: int) -> None:
    """Intervals up to 65,535 ns have bins of 1 ns: median, and gaps above 1.5 upper quartiles, by sorting."""
    time_ns = 10**15 + np.cumsum([0, *intervals])
    result = tally(time_ns, block)
    median = sorted(intervals)[(len(intervals) - 1) // 2]
    quartile = sorted(intervals)[-(-3 * len(intervals) // 4) - 1]
    gaps = [interval for interval in intervals if interval > 1.5 * quartile]
    usual = [interval for interval in intervals if interval not in gaps]
    assert result.rows == len(intervals) + 1
    assert result.median_s == pytest.approx(median * 1e-9)
    assert (result.gaps, result.gaps_s) == (len(gaps), pytest.approx(sum(gaps) * 1e-9))
    assert result.mean_s == pytest.approx(np.mean(usual) * 1e-9)
    assert [gap.length_s for gap in result.longest] == pytest.approx([gap * 1e-9 for gap in sorted(gaps)[:-6:-1]])
    for gap in result.longest:
        assert time_ns[gap.row - 1] == gap.after_ns
        assert time_ns[gap.row] - gap.after_ns == round(gap.length_s * 1e9)


@pytest.mark.slow
def test_results_do_not_depend_on_blocks() -> None:
    time_ns = clock(5000, 1, 20_000, 0, 100_000)
    time_ns[3000:] += 10**10
    one, other = tally(time_ns, 7), tally(time_ns, 5000)
    assert one.longest == other.longest
    assert asdict(one) | {"longest": 0} == pytest.approx(asdict(other) | {"longest": 0}, rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_jitter_of_intervals_is_estimated(seed: int) -> None:
    """20,000 ns: the standard deviation of 40,000 is known to 0.35 %, the robust to 0.8 % (five of them: 4 %)."""
    result = tally(clock(40_000, seed, 20_000))
    assert result.jitter_rms_s == pytest.approx(20e-6, rel=0.02)
    assert result.jitter_robust_s == pytest.approx(20e-6, rel=0.04)
    assert result.median_s == pytest.approx(2.5e-3, abs=5 * 1.25 * 20e-6 / 200)
    assert (result.alternation_s, result.gaps) == (0, 0)


@pytest.mark.parametrize("seed", range(5))
def test_jitter_of_stamps_is_not_an_alternation(seed: int) -> None:
    """Neighbouring intervals correlate by -1/2, of sqrt(2) times the stamps' jitter."""
    result = tally(clock(40_000, seed, 0, 20_000))
    assert result.jitter_rms_s == pytest.approx(2**0.5 * 20e-6, rel=0.03)
    assert result.alternation_s == 0


@pytest.mark.parametrize("alternation_ns", [30_000, 700_000, 2_000_000])
def test_alternating_intervals_are_detected(alternation_ns: int) -> None:
    """Intervals alternate down to 0.5 ms and 4.5 ms, with jitter, and a gap shifts the alternation."""
    early = clock(20_000, 3, 20_000, 0, alternation_ns)
    late = clock(15_001, 4, 20_000, 0, -alternation_ns) + early[-1] + 50_000_000
    result = tally(np.concatenate([early, late]))
    assert result.alternation_s == pytest.approx(alternation_ns * 1e-9, rel=0.02)
    assert result.jitter_robust_s == pytest.approx(20e-6, rel=0.05)
    assert result.jitter_rms_s < 60e-6
    assert (result.gaps, result.longest[0].row, result.longest[0].after_ns) == (1, 20_000, early[-1])


def test_outliers_and_drift_do_not_bias_the_robust_jitter() -> None:
    """One interval in a hundred 40 % late, and a clock that slows down by a tenth over the log."""
    rng = np.random.default_rng(5)
    intervals = MEAN_NS * np.linspace(1, 1.1, 40_000) + rng.normal(0, 10_000, 40_000)
    intervals[rng.random(40_000) < 0.01] *= 1.3
    result = tally(np.rint(np.cumsum(intervals)).astype(np.int64))
    assert result.jitter_robust_s == pytest.approx(10e-6, rel=0.08)
    assert result.jitter_rms_s > 70e-6
    assert result.alternation_s == 0


def test_a_regular_clock_has_no_jitter() -> None:
    result = tally(np.arange(5000) * MEAN_NS)
    assert result.median_s == pytest.approx(2.5e-3, rel=1e-5)
    assert result.mean_s == pytest.approx(2.5e-3, rel=1e-12)
    assert result.jitter_rms_s < 2.5e-3 / 2**16
    assert result.jitter_robust_s < 2.5e-3 / 2**16
    assert (result.alternation_s, result.gaps, result.longest) == (0, 0, ())


def test_few_rows_have_no_figures_and_repeated_times_are_refused() -> None:
    for rows in (0, 1):
        result = tally(np.arange(rows))
        assert (result.rows, result.gaps) == (rows, 0)
        assert np.isnan([result.median_s, result.mean_s, result.jitter_rms_s, result.jitter_robust_s]).all()
    with pytest.raises(ValueError, match="at row 5"):
        tally(np.array([0, 10, 20, 30, 40, 40, 60]), 3)
