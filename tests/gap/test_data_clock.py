"""The rate of a chip's data clock by the polls that find no new reading."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.gap.model.base_model import _readings_a_row

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
