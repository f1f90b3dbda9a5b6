"""Steps of segments and divisors of codes, compared with their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.characterise.codes import histogram
from imuarray.gap.inference.effects.codes import _divisor
from imuarray.gap.inference.effects.levels import _gains, _Series, _time

SEED = 7


@pytest.mark.parametrize("ratio", [1.0, 2.0])
def test_gains_of_a_step_equal_their_definition(ratio: float) -> None:
    """n / 2 log (n var / (a var of the first a + b var of the last b)), summed over levels and logs of variances, where
    the last b are of a sensor whose readings are `ratio` times as large.
    """
    generator = np.random.default_rng(SEED)
    level, log_variance = generator.normal(300.0, 1.0, (40, 3)), generator.normal(0.0, 0.2, (40, 3))
    level[25:] += 3.0
    predicted = np.full((40, 3), 5.0)
    series = _Series(np.arange(40.0), level, predicted, np.zeros((40, 3)), np.exp(log_variance))
    rescaled = level + predicted - ratio * predicted
    expected = []
    for at in range(3, 37):
        gain = 0.0
        for axis in range(3):
            for early, late in ((level, rescaled), (log_variance, log_variance)):
                parts = at * np.var(early[:at, axis]) + (40 - at) * np.var(late[at:, axis])
                gain += 20 * np.log(40 * np.var(early[:, axis]) / parts)
        expected.append(gain)
    gains = _gains(series, ratio)
    assert np.all(gains[:3] == -np.inf)
    np.testing.assert_allclose(gains[3:], expected, rtol=1e-9)
    assert ratio > 1 or int(gains.argmax()) == 25


@pytest.mark.parametrize(
    ("onset_s", "from_s", "expected", "bounds_s"),
    [
        (10.05, 10.0, 10.05, None),  # at the first row of a segment
        (10.35, 10.0, 10.35, None),  # three rows of ten later
        (9.75, 10.0, 9.75, None),
        (15.0, 20.0, 15.0, (10.0, 20.0)),  # somewhere in a gap of ten seconds
        (12.0, 20.0, 15.0, (10.0, 20.0)),
        (20.35, 20.0, 20.35, None),  # after the gap
        (9.75, 20.0, 9.75, None),  # before it
    ],
)
def test_a_step_lies_between_rows_or_in_the_middle_of_a_gap(
    onset_s: float, from_s: float, expected: float, bounds_s: tuple[float, float] | None
) -> None:
    """Segments of ten rows, a tenth of a second apart, from 0 to 10 s and for ten seconds from `from_s` on. The scatter
    of a mean is a hundredth of the step, a tenth of a row.
    """
    generator = np.random.default_rng(SEED)
    rows_s = np.concatenate([np.arange(100), np.arange(100) + 10 * from_s])[:, None] / 10 + [[0.05]]
    rows = np.where(rows_s >= onset_s, 3.0, 0.0) + generator.normal(0.0, 0.1, (200, 3))
    level = rows.reshape(20, 10, 3).mean(axis=1)
    middle_s = rows_s.reshape(20, 10).mean(axis=1)
    series = _Series(middle_s, level, np.zeros((20, 3)), np.zeros((20, 3)), np.full((20, 3), 0.01))
    at = int((middle_s < onset_s).sum())
    moment_s, gap_s = _time(series, at, 1.0, 0.1)
    assert moment_s == pytest.approx(expected, abs=0.06)
    assert (gap_s is None) == (bounds_s is None)
    assert bounds_s is None or gap_s == pytest.approx(bounds_s)
    before = rows_s[:, 0] < moment_s
    assert np.all(rows[before] < 1.5)
    assert np.all(rows[~before] > 1.5)


@pytest.mark.parametrize(
    ("codes", "odd", "divisor"),
    [
        ((0, 12, 24, 36), 3, 12),
        ((-8, 4, 60, 64), 3, 4),
        ((0, 12, 24, 36), 9, 0),
        ((5, 10, 20), 2, 5),
        ((7, 11, 13), 0, 0),
    ],
)
def test_the_greatest_common_divisor_of_nearly_all_codes(codes: tuple[int, ...], odd: int, divisor: int) -> None:
    """Readings of 1 and 100 readings of each code: fewer than a hundredth of all change nothing."""
    values = np.concatenate([np.repeat(codes, 100), np.full(odd, 1)])
    assert _divisor(histogram(values)) == divisor
