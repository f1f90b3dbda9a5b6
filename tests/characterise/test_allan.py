"""The overlapping Allan deviation against other implementations, exact arithmetic and closed forms."""

from __future__ import annotations

import tracemalloc
import warnings
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.stats import binom

from imuarray.characterise import allan_deviation
from imuarray.characterise.allan import allan_deviation_of_runs
from imuarray.characterise.allan_curve import octaves
from imuarray.characterise.allan_fit import fit_noise
from tests.selection import some

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # allantools warns of its own dependencies when it is imported
    import allantools


def oadev(values: np.ndarray, rate: float, taus: np.ndarray) -> Any:
    return allantools.oadev(values, rate=rate, data_type="freq", taus=taus)


def test_riley_1000_point_suite() -> None:
    """The 1000-point suite of NIST SP 1065 ("Test suites"): a Lehmer generator, overlapping deviations as printed."""
    state = [1234567890]
    for _ in range(999):
        state.append(16807 * state[-1] % 2147483647)
    curve = allan_deviation(np.array(state) / 2147483647, 1.0, [1, 10, 100])
    assert [f"{value:.6e}" for value in curve.deviation] == ["2.922319e-01", "9.159953e-02", "3.241343e-02"]


def test_nbs_nine_point_suite() -> None:
    """The nine values of NBS Monograph 140, annex 8.E, as SP 1065 prints their overlapping deviations."""
    curve = allan_deviation([892, 809, 823, 798, 671, 644, 883, 903, 677], 1.0, [1, 2])
    assert [f"{value:.5f}" for value in curve.deviation] == ["91.22945", "85.95287"]
    assert curve.terms.tolist() == [8, 6]


@pytest.mark.parametrize(
    ("rows", "kind"),
    [(60, "float"), (8191, "counts"), (8193, "float"), (32_769, "float"), (100_003, "counts"), (1_000_000, "float")],
)
def test_equals_allantools(rows: int, kind: str) -> None:
    values = 1000 + 30 * np.random.default_rng(rows).normal(size=rows)
    values = values if kind == "float" else np.rint(values).astype(np.int16)
    curve = allan_deviation(values, 0.02)
    taus, expected, _, terms = oadev(values.astype(float), 50.0, curve.tau_s)
    np.testing.assert_allclose(curve.tau_s[: len(taus)], taus, rtol=1e-12)
    np.testing.assert_allclose(curve.deviation[: len(taus)], expected, rtol=1e-12)
    np.testing.assert_array_equal(curve.terms[: len(taus)], terms)
    assert len(taus) >= len(octaves(rows)) - 1


@settings(deadline=None)
@given(
    hnp.arrays(np.int16, st.integers(2, 40), elements=st.integers(-(2**15), 2**15 - 1)),
    st.data(),
)
def test_deviation_of_counts_equals_rational_arithmetic(values: np.ndarray, data: st.DataObject) -> None:
    """Compared with the definition as a difference of neighbouring averages, in rational numbers."""
    m = data.draw(st.integers(1, len(values) // 2))
    whole = [int(value) for value in values]
    means = [Fraction(sum(whole[start : start + m]), m) for start in range(len(whole) - m + 1)]
    apart = [(late - early) ** 2 for early, late in zip(means, means[m:], strict=False)]
    variance = sum(apart, Fraction(0)) / (2 * len(apart))
    curve = allan_deviation(values, 1.0, [m])
    assert curve.deviation[0] == pytest.approx(float(variance) ** 0.5, rel=4e-16)
    assert curve.terms[0] == len(apart)


def test_deviation_of_counts_on_a_large_mean_is_exact() -> None:
    """Sums beyond 2^53, where float64 would lose counts, and sums that wrap round int64 don't change the result."""
    noise = np.random.default_rng(1).integers(-3, 4, 5000)
    expected = allan_deviation(noise, 1.0).deviation
    for offset in (2**50, 2**61):
        np.testing.assert_array_equal(allan_deviation(noise + offset, 1.0).deviation, expected)


def test_wide_integers_are_computed_in_floating_point() -> None:
    values = np.array([0, 2**62, 0, 2**62, 0, 2**62], np.uint64)
    assert allan_deviation(values, 1.0, [1]).deviation[0] == pytest.approx(2**62 / 2**0.5, rel=1e-12)
    assert allan_deviation(values, 1.0, [2]).deviation[0] == 0


@settings(deadline=None)
@given(
    hnp.arrays(
        np.float64, hnp.array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=30), elements=st.floats(-1e3, 1e3)
    ),
    st.floats(1e-3, 1e3),
)
def test_columns_are_independent(values: np.ndarray, interval_s: float) -> None:
    curve = allan_deviation(values, interval_s)
    shape = (len(octaves(len(values))), values.shape[1])
    for part in (curve.deviation, curve.low, curve.high, curve.freedom, curve.noise):
        assert part.shape == shape
    assert curve.tau_s.shape == curve.terms.shape == shape[:1]
    for column in range(values.shape[1]):
        alone = allan_deviation(values[:, column].copy(), interval_s)
        np.testing.assert_array_equal(alone.deviation, curve.deviation[:, column])
        np.testing.assert_array_equal(alone.noise, curve.noise[:, column])
    assert (curve.low <= curve.deviation).all() and (curve.deviation <= curve.high).all()
    assert (curve.freedom >= 1 - 1e-9).all()


@settings(deadline=None)
@given(hnp.arrays(np.int32, st.integers(2, 60), elements=st.integers(-1000, 1000)), st.integers(-(10**6), 10**6))
def test_an_offset_changes_nothing_and_the_deviation_scales(values: np.ndarray, offset: int) -> None:
    deviation = allan_deviation(values, 1.0).deviation
    np.testing.assert_array_equal(allan_deviation(values + offset, 1.0).deviation, deviation)
    np.testing.assert_array_equal(allan_deviation(values * -4, 1.0).deviation, 4 * deviation)


def test_deviation_of_a_ramp_and_an_alternation() -> None:
    """A drift of 1 per row gives m / sqrt(2); an alternation by 2 gives sqrt(2) at m = 1 and 0 at even m."""
    ramp = allan_deviation(np.arange(1000), 1.0, [1, 7, 100])
    np.testing.assert_allclose(ramp.deviation, np.array([1, 7, 100]) / 2**0.5, rtol=1e-14)
    alternating = allan_deviation(np.tile([0, 2], 50), 1.0, [1, 2, 4])
    np.testing.assert_allclose(alternating.deviation, [2**0.5, 0, 0], rtol=1e-14)
    assert alternating.low[1] == alternating.high[1] == 0


def test_deviation_of_a_million_counts_is_exact() -> None:
    """Compared with integer sums, to the last digits; a running sum of rounded readings has an error of 1e-12."""
    values = np.rint(np.random.default_rng(5).normal(0, 20, 1_000_000)).astype(np.int16) + np.int16(5460)
    curve = allan_deviation(values, 1.0)
    phase = np.concatenate([[0], np.cumsum(values.astype(np.int64))])
    for m, deviation in zip(octaves(len(values)), curve.deviation, strict=True):
        second = phase[2 * m :] - 2 * phase[m:-m] + phase[: -2 * m]
        exact = Fraction(int((second**2).sum()), 2 * len(second) * m * m)
        assert abs(Fraction(deviation) ** 2 / exact - 1) < Fraction(1, 10**15)


@pytest.mark.parametrize("step", [1, 40, 65_535])
@pytest.mark.parametrize("kind", [np.int16, np.int32, np.uint8])
def test_deviation_from_blocks_of_counts_equals_the_definition(step: int, kind: type[np.integer]) -> None:
    """Compared with integer sums; columns alternate, then rise by `step`. The largest step makes a running sum that
    exceeds 32 bits.
    """
    limits = np.iinfo(kind)
    rows = 70_001  # beyond two blocks
    risen = np.where(np.arange(rows) < 101, np.arange(rows) % 3, min(step, limits.max - limits.min)) + limits.min
    columns = [risen.astype(kind), risen[::-1].astype(kind)]
    curve = allan_deviation_of_runs(columns, 0.5, [len(columns[0])])
    for column, deviations in zip(columns, curve.deviation.T, strict=True):
        phase = np.concatenate([[0], np.cumsum(column.astype(np.int64))])
        for m, deviation in zip(octaves(rows), deviations, strict=True):
            second = phase[2 * m :] - 2 * phase[m:-m] + phase[: -2 * m]
            exact = Fraction(sum(int(value) ** 2 for value in second[second != 0]), 2 * len(second) * m * m)
            assert abs(Fraction(deviation) ** 2 / exact - 1) < Fraction(1, 10**13)
    assert curve.tau_s.tolist() == [0.5 * m for m in octaves(rows)]


def test_blocks_of_counts_need_four_bytes_per_reading() -> None:
    values = np.random.default_rng(7).integers(-40, 40, 500_000).astype(np.int16)
    tracemalloc.start()
    allan_deviation_of_runs([values], 1.0, [len(values)])
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 4 * len(values) + 2_500_000, "the running sum, and blocks"


REPEATS, ROWS, FACTORS = 2000, 1024, (1, 4, 32, 128)


def averaged(density: np.ndarray, frequency: np.ndarray) -> list[float]:
    """Allan variances of readings of a spectral density: through the transfer function of the second differences."""
    gains = [2 * np.sin(np.pi * frequency * m) ** 4 / (m * np.sin(np.pi * frequency)) ** 2 for m in FACTORS]
    return [float((density * gain).mean()) for gain in gains]


def flicker_noise(rng: np.random.Generator) -> np.ndarray:
    """Readings (n, r) of spectrum 1 / (2 sin(pi f)) except for their start: the sum of their differences. These are
    stationary, of spectrum 2 sin(pi f) and therefore of autocovariance 4 / (pi (1 - 4 k^2)); drawn by circulant
    embedding (Davies and Harte, Biometrika 74, 1987).
    """
    covariance = 4 / (np.pi * (1 - 4 * np.arange(ROWS + 1.0) ** 2))
    power = np.fft.rfft(np.concatenate([covariance, covariance[-2:0:-1]])).real
    drawn = np.fft.rfft(rng.normal(size=(REPEATS, 2 * ROWS))) * np.sqrt(power)
    return np.cumsum(np.fft.irfft(drawn)[:, :ROWS], axis=1).T


FREQUENCY = (np.arange(1 << 15) + 0.5) / (1 << 16)
TRUTHS = {
    "white": [1 / m for m in FACTORS],
    "flicker": averaged(1 / (2 * np.sin(np.pi * FREQUENCY)), FREQUENCY),
    "random walk": [(2 * m * m + 1) / (6 * m) for m in FACTORS],
}
"""Allan variances of unit white noise, of the flicker noise above, and of the running sum of unit white noise."""


@pytest.mark.slow
@pytest.mark.parametrize("estimator", some(["overlapping", "decimated"], 1, 0))
@pytest.mark.parametrize("noise", TRUTHS)
def test_means_equal_closed_forms_and_intervals_cover(noise: str, estimator: Any) -> None:
    """2000 replicates: mean within 5 standard errors; 95 % intervals cover as often as a binomial of 0.95 allows.

    Each of the 24 counts leaves its limits with a chance of 1e-4 if the coverage is 95 %. (It is only near 95 %: noise
    types are estimated from the data, and the distribution is not quite chi-squared.)
    """
    rng = np.random.default_rng(11)
    series = flicker_noise(rng) if noise == "flicker" else rng.normal(size=(ROWS, REPEATS))
    series = np.cumsum(series, axis=0) if noise == "random walk" else series
    curve = allan_deviation(series, 1.0, FACTORS, estimator=estimator)
    for row, variance in enumerate(TRUTHS[noise]):
        squares = curve.deviation[row] ** 2
        assert abs(squares.mean() - variance) < 5 * squares.std() / REPEATS**0.5
        covered = int(((curve.low[row] ** 2 <= variance) & (variance <= curve.high[row] ** 2)).sum())
        assert binom.ppf(5e-5, REPEATS, 0.95) <= covered <= binom.isf(5e-5, REPEATS, 0.95)


@pytest.mark.parametrize(
    ("values", "interval_s", "factors", "message"),
    [
        ([1.0], 1.0, None, "at least 2"),
        (np.zeros((5, 2, 2)), 1.0, None, r"\(5, 2, 2\)"),
        (np.zeros((5, 0)), 1.0, None, r"\(5, 0\)"),
        (np.zeros(5, complex), 1.0, None, "complex128"),
        ([1.0, np.nan, 2.0], 1.0, None, "not finite"),
        ([1.0, np.inf, 2.0], 1.0, None, "not finite"),
        ([1.0, 2.0], 0.0, None, "interval_s is 0.0"),
        ([1.0, 2.0], float("nan"), None, "interval_s is nan"),
        (np.zeros(10), 1.0, [0], "from 1 to 5"),
        (np.zeros(10), 1.0, [6], "from 1 to 5"),
        (np.zeros(10), 1.0, [1.5], "whole numbers"),
        (np.zeros(10), 1.0, [], "whole numbers"),
    ],
)
def test_invalid_arguments_are_refused(values: Any, interval_s: float, factors: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        allan_deviation(values, interval_s, factors)


def test_octaves_end_at_a_third_of_the_rows() -> None:
    assert octaves(2) == octaves(3) == (1,)
    assert octaves(47) == (1, 2, 4, 8)
    assert octaves(48) == (1, 2, 4, 8, 16)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    lengths=st.lists(st.integers(9, 40), min_size=2, max_size=6),
    seed=st.integers(0, 1000),
)
def test_runs_are_pooled_by_their_squared_differences(lengths: list[int], seed: int) -> None:
    """The mean over the squared second differences of all runs, summed term by term; none spans a gap."""
    rng = np.random.default_rng(seed)
    runs = [rng.integers(-500, 500, (length, 2)) + 300 * number for number, length in enumerate(lengths)]
    counts = np.concatenate(runs).astype(np.int16)
    curve = allan_deviation_of_runs([counts[:, 0], counts[:, 1]], 0.01, lengths)
    assert curve.rows == sum(lengths)
    for point, m in enumerate(octaves(max(lengths))):
        for column in range(2):
            squares = [
                (run[at + m : at + 2 * m, column].mean() - run[at : at + m, column].mean()) ** 2 / 2
                for run in runs
                for at in range(len(run) + 1 - 2 * m)
            ]
            assert curve.terms[point] == len(squares)
            assert curve.deviation[point, column] == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-9)


def test_a_single_run_equals_the_deviation_of_counts() -> None:
    counts = np.random.default_rng(3).integers(-99, 99, 500).astype(np.int16)
    pooled, alone = allan_deviation_of_runs([counts], 0.1, [500]), allan_deviation(counts[:, None], 0.1)
    np.testing.assert_array_equal(pooled.deviation, alone.deviation)
    np.testing.assert_array_equal(pooled.freedom, alone.freedom)


def test_degrees_of_freedom_of_equal_runs_add_up() -> None:
    """Twenty independent runs have twenty times the degrees of freedom of one run."""
    counts = np.random.default_rng(4).integers(-99, 99, 20 * 60).astype(np.int16)
    pooled = allan_deviation_of_runs([counts], 0.1, [60] * 20)
    alone = allan_deviation_of_runs([counts[:60]], 0.1, [60])
    assert pooled.freedom[:, 0] == pytest.approx(20 * alone.freedom[:, 0], rel=1e-9)


@pytest.mark.slow
def test_intervals_of_white_noise_with_stalls_cover() -> None:
    """150 recordings of 60 runs of 51 rows and a longer one: the 95 % interval of N covers the truth in 135 ... 149."""
    rng = np.random.default_rng(6)
    lengths = [51] * 30 + [400] + [51] * 30
    held, width = 0, []
    for _ in range(150):
        counts = np.rint(rng.normal(0, 100, sum(lengths))).astype(np.int16)
        fit = fit_noise(allan_deviation_of_runs([counts], 0.01, lengths))
        assert fit is not None
        white = fit["white"]
        held += white.low <= 100 * 0.01**0.5 <= white.high
        width.append((white.high - white.low) / white.value)
    assert binom.ppf(0.005, 150, 0.95) <= held <= 149
    assert np.median(width) < 2.2 * 1.96 / np.sqrt(sum(lengths))  # 1 / sqrt(2 n) is the least error of a deviation
