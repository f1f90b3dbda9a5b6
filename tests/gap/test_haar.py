"""Allan variances of the tally against second differences by definition, and white noise."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray import series
from imuarray.gap.statistics.haar import FINEST, HaarTally

OCTAVES = 7


def spelled_out(values: np.ndarray, factor: int) -> list[float]:
    """Half the mean square of the difference of neighbouring means over `factor` rows, at every quarter of it."""
    stride = max(1, factor // 4)
    starts = range(0, len(values) - 2 * factor + 1, stride)
    pairs = [(values[at : at + factor].mean(), values[at + factor : at + 2 * factor].mean()) for at in starts]
    return [(second - first) ** 2 / 2 for first, second in pairs]


@given(st.lists(st.integers(-3000, 3000), min_size=1, max_size=400), st.lists(st.integers(0, 400), max_size=4))
def test_variances_of_any_series_in_any_pieces_equal_the_definition(numbers: list[int], cuts: list[int]) -> None:
    values = np.array(numbers, float)
    tally = HaarTally(OCTAVES, columns=2)
    edges = sorted({0, len(values), *(cut for cut in cuts if cut < len(values))})
    for first, stop in pairwise(edges):
        tally.update(np.stack([values[first:stop], -2 * values[first:stop]]))
    found = tally.result()
    for octave in range(OCTAVES):
        squares = spelled_out(values, 1 << octave)
        assert found.terms[octave] == len(squares)
        expected = np.mean(squares) if squares else np.nan
        np.testing.assert_allclose(found.variance[octave], [expected, 4 * expected], rtol=1e-9, atol=1e-9)
        shown = octave >= FINEST and expected > 0
        kurtosis = np.mean(np.square(squares)) / expected**2 if shown else np.nan
        np.testing.assert_allclose(found.kurtosis[octave], [kurtosis, kurtosis], rtol=1e-9)


def test_the_variance_of_white_noise_decreases_with_the_averaging_time() -> None:
    """sigma^2 / m; a fixed seed, 5 standard errors of the least sure octave (about 3 % of 2^17 / 64 / 2 terms)."""
    values = np.random.default_rng(1).normal(size=(3, 1 << 17)) * 4.0
    tally = HaarTally(OCTAVES)
    tally.update(values)
    np.testing.assert_allclose(tally.result().variance * 2.0 ** np.arange(OCTAVES)[:, None], 16.0, rtol=0.15)


def test_variances_without_compiled_code_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    results = []
    for is_compiled in (series.COMPILED, False):
        monkeypatch.setattr(series, "COMPILED", is_compiled)
        tally = HaarTally(OCTAVES)
        for block in np.split(np.random.default_rng(2).normal(size=(3, 3000)), 3, axis=1):
            tally.update(block)
        results.append(tally.result())
    for compiled, plain in zip(*results, strict=True):
        np.testing.assert_allclose(compiled, plain, rtol=1e-12)
