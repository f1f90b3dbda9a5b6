"""The rate of a chip's data clock by the polls that find no new reading."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.gap.model.data_clock import _readings_a_row, _readings_between_polls
from imuarray.gap.statistics.intervals import IntervalMoments, Intervals

POLLS = 400_000


def share_of_repeats(error: float, jitter: float) -> float:
    """Share of polls, at a mean interval of 1 with independent jitter of each poll, that find no new reading of a clock
    that is faster by `error`.
    """
    rng = np.random.default_rng(3)
    times = np.arange(POLLS) + rng.normal(0, jitter / np.sqrt(2), POLLS)  # the interval scatters by `jitter`
    newest = np.floor(np.maximum.accumulate(times) * (1 + error) + 0.3)
    return float((np.diff(newest) == 0).mean())


@pytest.mark.parametrize("error", [-0.02, -0.001, 0.0, 0.001, 0.003])
def test_a_clock_near_the_polls_rate(error: float) -> None:
    """A slow clock repeats as many readings as it lacks; a fast one repeats some too, as polls jitter. The share of
    repeats is known to a few percent, which is a tenth of the jitter at most.
    """
    jitter = 0.003
    assert _readings_a_row(share_of_repeats(error, jitter), jitter) - 1 == pytest.approx(error, abs=0.1 * jitter)


def test_even_polls_lack_what_they_repeat() -> None:
    assert _readings_a_row(0.01, 0.0) == pytest.approx(0.99)
    assert _readings_a_row(0.0, 0.003) == 1.0


@pytest.mark.parametrize("error", [-0.03, 0.0, 0.025])
def test_a_clock_that_is_polled_more_often_than_it_measures(error: float) -> None:
    """Polls of a 200 Hz clock come 2.7 and 5.3 ms apart, in pairs or not: how many readings were missed in the longer
    intervals is not asked. The share of repeats of 400,000 polls is known to a thousandth.
    """
    rng = np.random.default_rng(5)
    intervals_s = np.where(rng.random(POLLS) < 0.6, 2.7e-3, 5.3e-3) + rng.normal(0, 5e-5, POLLS)
    newest = np.floor(np.cumsum(intervals_s) * 200 * (1 + error))
    repeated = float((np.diff(newest) == 0).mean())
    moments = IntervalMoments(period_s=1 / 200)
    moments.update(np.rint(np.cumsum(intervals_s) * 1e9).astype(np.int64))
    assert _readings_between_polls(moments.result(), repeated) / 200 - 1 == pytest.approx(error, abs=3e-3)


def test_more_repeats_than_short_intervals_are_no_clock() -> None:
    intervals = Intervals(100, 5e-3, 0.0, 0, 5e-3, shorter=50, shorter_s=4e-3)
    assert np.isnan(_readings_between_polls(intervals, 0.6))
