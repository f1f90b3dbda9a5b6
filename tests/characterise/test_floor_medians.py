"""The medians of the noise floor against their definition for each bin."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.characterise.lines import _join_medians


@pytest.mark.parametrize(("last", "widest"), [(64, 8), (257, 16), (2048, 32)])
def test_joined_medians_equal_those_of_each_bin(last: int, widest: int) -> None:
    """A side begins three bins away, beyond the main lobe of the Hann window. It has two fifths of as many bins as
    there are below, at least 8 and at most 32 or a sixteenth of all, `widest`.
    """
    height = np.random.default_rng(last).normal(size=last + 60)
    bins = np.arange(12, last + 1)
    wanted = []
    for at in bins.tolist():
        side = sorted((8, 2 * at // 5, widest))[1]
        below, above = at - 3 - np.arange(side), at + 3 + np.arange(side)
        low, high = np.median(height[below]), np.median(height[above])
        left, right = np.log(below).mean(), np.log(above).mean()
        wanted.append(low + (high - low) * (np.log(at) - left) / (right - left))
    np.testing.assert_allclose(_join_medians(height, bins, last), wanted, rtol=1e-12, atol=1e-13)
