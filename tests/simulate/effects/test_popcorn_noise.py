"""`popcorn_noise`: two levels, Poisson switching, independence of blocks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import poisson

from imuarray.simulate.effects.bias import PopcornNoise
from imuarray.simulate.signal import Analog
from tests.simulate.conftest import MakePlace

MakeAnalog = Callable[..., Analog]


def test_noise_has_two_levels(place: MakePlace, analog: MakeAnalog) -> None:
    value = PopcornNoise((0.2, 0.4, 1.0), 1.0).analog(analog(0, 5000, value=7.0), place()).value
    for axis, half in enumerate((0.1, 0.2, 0.5)):
        np.testing.assert_allclose(np.unique(value[:, axis]), [7 - half, 7 + half])


@pytest.mark.slow
def test_the_autocovariance_is_that_of_a_random_telegraph(place: MakePlace, analog: MakeAnalog) -> None:
    """(amplitude / 2)^2 exp(-2 switches_per_s |t|), mean 0, wherever: at the start, across the ends of chunks."""
    rows = np.array([0, 5, 30, 16_383, 16_384, 16_400])
    effect = PopcornNoise(2.0, 0.1)
    signs = np.concatenate(
        [effect.analog(analog(0, 16_401), place(rows_per_s=10.0, seed=seed)).value[rows].T for seed in range(300)]
    )
    wanted = np.exp(-2 * 0.1 * np.abs(np.subtract.outer(rows, rows)) / 10)
    result = signs.T @ signs / len(signs)
    # The mean of 900 products of two signs, each correlated by c: standard error sqrt((1 - c^2) / 900).
    # 15 pairs and 6 means beyond 5 of them: 1e-5.
    assert (np.abs(result - wanted) <= 5 * np.sqrt((1 - wanted**2) / 900) + 1e-12).all()
    assert np.abs(signs.mean(axis=0)).max() < 5 / 30


@pytest.mark.slow
def test_a_rare_level_has_its_share_and_durations(place: MakePlace, analog: MakeAnalog) -> None:
    """A fifth of the time at the upper level: mean 0, variance 4 x 0.2 x 0.8 = 0.64, exp(-0.4 t / 0.32) from one
    reading to another, wherever; times at a level of 2 x 0.2 / 0.4 = 1 s and 4 s.
    """
    effect = PopcornNoise(2.0, 0.4, 0.2)
    rows = np.array([0, 5, 16_383, 16_384, 16_390])
    values = [effect.analog(analog(0, 16_391), place(rows_per_s=10.0, seed=seed)).value for seed in range(300)]
    np.testing.assert_allclose(np.unique(values[0]), [-0.4, 1.6])
    result = np.concatenate([entry[rows].T for entry in values])
    wanted = 0.64 * np.exp(-0.4 / 0.32 * np.abs(np.subtract.outer(rows, rows)) / 10)
    # The squared product of two readings has a mean of at most their fourth moment, 1.6^4 x 0.2 + 0.4^4 x 0.8 = 1.33:
    # 15 products and 5 means of 900, beyond 5 standard errors: 1e-5.
    assert np.abs(result.T @ result / 900 - wanted).max() < 5 * np.sqrt(1.33 / 900)
    assert np.abs(result.mean(axis=0)).max() < 5 * np.sqrt(0.64 / 900)
    high = values[0][:, 0] > 0
    edges = np.flatnonzero(np.diff(high.astype(int)))
    lengths, upper = np.diff(edges) / 10, high[edges[:-1] + 1]
    # Some 650 stretches, half of them at each level; rows hide a twentieth of those at the upper one.
    assert lengths[upper].mean() == pytest.approx(1.0, rel=0.25)
    assert lengths[~upper].mean() == pytest.approx(4.0, rel=0.25)


def test_numbers_of_switches_are_poisson(place: MakePlace, analog: MakeAnalog) -> None:
    """In 200 stretches of 300 rows across several chunks; rows are so close that no two switches share one."""
    value = PopcornNoise(2.0, 1.0).analog(analog(0, 60_000), place(rows_per_s=100.0)).value
    switches = (np.diff(value, axis=0, prepend=value[:1]) != 0).reshape(200, 300, 3).sum(axis=1).ravel()
    # 600 numbers of mean 3 (less 1 % of pairs that share a row) and variance 3: five standard errors each, 1e-6.
    assert switches.mean() == pytest.approx(3, abs=5 * np.sqrt(3 / 600) + 0.03)
    variance_error = np.sqrt((poisson(3).stats("k") + 2) * 9 / 600)
    assert switches.var() == pytest.approx(3, abs=5 * variance_error + 0.03)


def test_chunks_switch_at_different_rows(place: MakePlace, analog: MakeAnalog) -> None:
    """80 places of 16 384 and 80 others: 0.4 in common on average, 8 or more with probability 1e-8."""
    value = PopcornNoise(2.0, 0.5).analog(analog(0, 32_768), place(rows_per_s=100.0)).value[:, 0]
    first, second = (set(np.flatnonzero(np.diff(part)).tolist()) for part in np.split(value, 2))
    assert 40 < len(first) < 130
    assert len(first & second) < 8


def test_axes_switch_independently(place: MakePlace, analog: MakeAnalog) -> None:
    value = PopcornNoise(2.0, 0.5).analog(analog(0, 100_000), place(rows_per_s=1.0)).value
    # exp(-2 x 0.5) = 0.37 from row to row: 100 000 rows are as good as 100 000 (1 - 0.37^2) / (1 + 0.37^2) = 76 000
    # independent products; three pairs beyond 5 standard errors: 2e-6.
    for first, other in ((0, 1), (0, 2), (1, 2)):
        assert abs((value[:, first] * value[:, other]).mean()) < 5 / np.sqrt(76_000)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("first", "stop"), [(0, 1), (100, 200), (16_383, 16_385), (16_384, 32_768), (20_000, 40_000)])
def test_any_block_alone_equals_that_of_the_whole(
    place: MakePlace, analog: MakeAnalog, dtype: type[np.floating], first: int, stop: int
) -> None:
    effect = PopcornNoise((0.1, 0.2, 0.3), 0.5)
    whole = effect.analog(analog(0, 40_000, dtype=dtype), place(dtype=dtype)).value
    alone = effect.analog(analog(first, stop, dtype=dtype), place(dtype=dtype)).value
    assert alone.dtype == dtype
    np.testing.assert_array_equal(alone, whole[first:stop])


def test_boots_begin_and_switch_independently(place: MakePlace, analog: MakeAnalog) -> None:
    runs = [PopcornNoise(2.0, 0.1).analog(analog(0, 5000), place(boot=boot)).value for boot in range(40)]
    begins = np.array([run[0] for run in runs])
    assert (np.ptp(begins, axis=0) == 2).all()  # 40 equal coins on one of three axes: 5e-12
    assert len({run.tobytes() for run in runs}) == 40


def test_defaults_do_nothing_and_invalid_parameters_are_refused(place: MakePlace, analog: MakeAnalog) -> None:
    rows = analog(0, 10)
    assert PopcornNoise().analog(rows, place()) is rows
    with pytest.raises(ValueError, match=r"switches_per_s: -1(\.0)?; allowed is 0 to 1e\+06"):
        PopcornNoise(1.0, -1.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"high_share: 1(\.0)?; allowed is 0\.01 to 0\.99"):
        PopcornNoise(1.0, 1.0, 1.0)  # type: ignore[arg-type]
