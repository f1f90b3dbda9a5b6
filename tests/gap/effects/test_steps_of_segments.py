"""Steps of segments and divisors of codes, compared with their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.characterise.codes import histogram
from imuarray.gap.inference.effects.codes import _divisor
from imuarray.gap.inference.effects.levels import _gains, _Series

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
