"""Medians of Gaussian numbers: scipy's quantiles, which the package does not use."""

from __future__ import annotations

import pytest
from scipy.stats import chi2, norm

from imuarray.robust import MEDIAN_ABSOLUTE, MEDIAN_SQUARE


def test_the_medians_are_those_of_the_distributions() -> None:
    assert pytest.approx(norm.ppf(0.75), rel=1e-14) == MEDIAN_ABSOLUTE
    assert pytest.approx(chi2.ppf(0.5, 1), rel=1e-12) == MEDIAN_SQUARE
