"""First-order recursions, against the loop that defines them and against SciPy's filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from imuarray import kernels
from imuarray.recursion import first_order


@pytest.mark.parametrize("remaining", [0.0, 0.3, 0.999, 1.0])
def test_every_value_is_the_drive_plus_the_remaining_share_of_the_last(remaining: float) -> None:
    drive = np.random.default_rng(1).standard_normal((257, 3))
    result = first_order(drive, remaining)
    expected, before = [], np.zeros(3)
    for row in drive:
        before = row + remaining * before
        expected.append(before)
    np.testing.assert_allclose(result, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_the_recursion_equals_scipys_filter_of_a_single_pole() -> None:
    drive = np.random.default_rng(2).standard_normal((4096, 2))
    np.testing.assert_allclose(first_order(drive, 0.98), lfilter([1.0], [1.0, -0.98], drive, axis=0), rtol=1e-12)


def test_an_empty_drive_gives_an_empty_result() -> None:
    assert first_order(np.zeros((0, 3)), 0.5).shape == (0, 3)


@pytest.mark.parametrize("compiled", [True, False])
def test_values_that_are_not_finite_affect_only_later_rows(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "COMPILED", kernels.COMPILED and compiled)
    drive = np.ones((6, 2))
    drive[3, 1] = np.nan
    result = first_order(drive, 0.5)
    assert result[:, 0].tolist() == [1.0, 1.5, 1.75, 1.875, 1.9375, 1.96875]
    assert result[:3, 1].tolist() == [1.0, 1.5, 1.75] and np.isnan(result[3:, 1]).all()
