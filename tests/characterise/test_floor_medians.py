"""The medians of the noise floor against their definition for each bin."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.characterise.lines import _GUARD, _joined_medians, _sides


@pytest.mark.parametrize("last", [64, 257, 2048])
def test_joined_medians_equal_those_of_each_bin(last: int) -> None:
    height = np.random.default_rng(last).normal(size=last + 60)
    bins = np.arange(12, last + 1)
    wanted = []
    for at, side in zip(bins.tolist(), _sides(bins, last).tolist(), strict=True):
        below = np.arange(at - _GUARD - side, at - _GUARD)
        above = np.arange(at + _GUARD + 1, at + _GUARD + 1 + side)
        low, high = np.median(height[below]), np.median(height[above])
        left, right = np.log(below).mean(), np.log(above).mean()
        wanted.append(low + (high - low) * (np.log(at) - left) / (right - left))
    np.testing.assert_allclose(_joined_medians(height, bins, last), wanted, rtol=1e-12, atol=1e-13)
