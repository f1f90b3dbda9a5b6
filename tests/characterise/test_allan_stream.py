"""The decimated estimator and the stream against their definition, with any block sizes, and in bounded memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from imuarray.characterise.allan import AllanStream, allan_deviation
from imuarray.characterise.allan_curve import stride_of
from tests.selection import examples


def by_definition(values: Sequence[int], m: int, stride: int) -> float:
    """Root of half the mean square of differences of neighbouring averages over m, every `stride` rows."""
    sums = [sum(values[at : at + m]) for at in range(len(values) - m + 1)]
    squares = [Fraction(sums[at + m] - sums[at], m) ** 2 for at in range(0, len(values) - 2 * m + 1, stride)]
    return float(sum(squares, Fraction(0)) / (2 * len(squares))) ** 0.5


def fed(values: np.ndarray, cuts: Sequence[int], stream: AllanStream) -> AllanStream:
    for part in np.split(values, sorted(cuts)):
        stream.feed(part)
    return stream


@pytest.mark.parametrize(
    ("factor", "stride"), [(1, 1), (7, 1), (8, 1), (15, 1), (16, 2), (20, 2), (40, 5), (44, 4), (97, 1), (1000, 125)]
)
def test_largest_divisor_up_to_an_eighth(factor: int, stride: int) -> None:
    assert stride_of(factor) == stride


@pytest.mark.parametrize("m", [1, 5, 16, 40, 64, 97, 300])
def test_the_decimated_estimator_equals_its_definition(m: int) -> None:
    values = np.random.default_rng(m).integers(-50, 50, 1000)
    curve = allan_deviation(values, 1.0, [m], estimator="decimated")
    assert curve.deviation[0] == pytest.approx(by_definition(values.tolist(), m, stride_of(m)), rel=1e-15)
    assert curve.stride[0] == stride_of(m)
    assert curve.terms[0] == len(range(0, 1000 - 2 * m + 1, stride_of(m)))


@settings(deadline=None, max_examples=examples(50))
@given(
    hnp.arrays(np.int16, st.integers(2, 300), elements=st.integers(-1000, 1000)),
    st.lists(st.integers(0, 300), max_size=6),
    st.sampled_from(["decimated", "overlapping"]),
)
def test_results_do_not_depend_on_blocks(values: np.ndarray, cuts: list[int], estimator: Any) -> None:
    """Integers are summed exactly, so that the results are the same to the last bit."""
    factors = [m for m in (1, 2, 3, 16, 40, 64) if m <= len(values) // 2]
    stream = fed(values, cuts, AllanStream(0.5, factors, estimator))
    at_once = allan_deviation(values, 0.5, factors, estimator=estimator)
    curve = stream.curve()
    np.testing.assert_array_equal(curve.deviation, at_once.deviation)
    np.testing.assert_array_equal(curve.terms, at_once.terms)
    np.testing.assert_array_equal(stream.curve().deviation, curve.deviation)


@pytest.mark.parametrize("estimator", ["decimated", "overlapping"])
def test_rows_beyond_the_buffers_are_exact(estimator: Any) -> None:
    """100,003 rows in three columns fill every level's buffer; results do not depend on columns and blocks."""
    values = np.random.default_rng(2).integers(-30, 30, (100_003, 3))
    factors = [1, 4, 16, 1000, 4096, 30_000]
    stream = fed(values, [1, 2, 32_767, 32_769, 90_000], AllanStream(1.0, factors, estimator))
    curve = stream.curve()
    for column in range(3):
        series = values[:, column].copy()
        phase = np.concatenate([[0], np.cumsum(series)])
        for row, m in enumerate(factors):
            second = (phase[2 * m :] - 2 * phase[m:-m] + phase[: -2 * m])[:: curve.stride[row]]
            expected = (int((second**2).sum()) / (2 * len(second))) ** 0.5 / m
            assert curve.deviation[row, column] == pytest.approx(expected, rel=1e-14)
            assert curve.terms[row] == len(second)


def test_feeding_continues_after_a_curve() -> None:
    values = np.random.default_rng(4).normal(size=50_000)
    stream = AllanStream(1.0)
    stream.feed(values[:20_000])
    np.testing.assert_allclose(
        stream.curve().deviation, allan_deviation(values[:20_000], 1.0, estimator="decimated").deviation, rtol=1e-12
    )
    stream.feed(values[20_000:])
    np.testing.assert_allclose(
        stream.curve().deviation, allan_deviation(values, 1.0, estimator="decimated").deviation, rtol=1e-12
    )


def peak_of(rows: int) -> int:
    block = np.random.default_rng(0).integers(-9, 9, 10_000).astype(np.int16)
    tracemalloc.start()
    stream = AllanStream(1 / 400)
    for _ in range(rows // len(block)):
        stream.feed(block)
    stream.curve()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


@pytest.mark.slow
def test_memory_does_not_grow() -> None:
    """Sixteen times the rows need only the memory of the deeper levels' first values (64 KiB each); below 10 MB."""
    peak_of(10_000)  # modules that are imported on first use
    short, long = peak_of(500_000), peak_of(8_000_000)
    assert long < short + 5 * 2 * 8193 * 8
    assert long < 10_000_000


def test_wide_integers_do_not_wrap_round() -> None:
    """Exact on a large mean; beyond what float64 counts exactly, rounded, but not wrapped round."""
    noise = np.random.default_rng(1).integers(-3, 4, 5000)
    expected = allan_deviation(noise, 1.0, estimator="decimated").deviation
    large = allan_deviation(noise + 2**61, 1.0, estimator="decimated").deviation
    np.testing.assert_array_equal(large, expected)
    apart = np.array([-(2**63), 2**63 - 1] * 4)
    assert allan_deviation(apart, 1.0, [1], estimator="decimated").deviation[0] == pytest.approx(2**63.5, rel=1e-12)


def test_the_decimated_estimator_keeps_the_degrees_of_freedom() -> None:
    """An eighth of the terms has at least 97 % of the degrees of freedom."""
    values = np.random.default_rng(3).normal(size=10_000)
    full, few = (allan_deviation(values, 1.0, estimator=way) for way in ("overlapping", "decimated"))
    np.testing.assert_array_less(0.97 * full.freedom, few.freedom)
    assert few.terms[-3] < full.terms[-3] / 50


def test_invalid_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="interval_s is 0"):
        AllanStream(0)
    with pytest.raises(ValueError, match="needs its averaging factors"):
        AllanStream(1.0, estimator="overlapping")
    with pytest.raises(ValueError, match="whole numbers from 1"):
        AllanStream(1.0, [0])
    with pytest.raises(ValueError, match="one of overlapping, decimated"):
        allan_deviation([1.0, 2.0], 1.0, estimator="half")  # type: ignore[arg-type]
    stream = AllanStream(1.0)
    with pytest.raises(ValueError, match="0 rows"):
        stream.curve()
    with pytest.raises(ValueError, match="complex128"):
        stream.feed(np.zeros(3, complex))
    stream.feed(np.zeros((3, 2)))
    with pytest.raises(ValueError, match=r"\(2,\) are required"):
        stream.feed(np.zeros(3))
    with pytest.raises(ValueError, match="not finite"):
        stream.feed(np.full((1, 2), np.nan))
    long = AllanStream(1.0, [100])
    long.feed(np.zeros(10))
    with pytest.raises(ValueError, match="too few"):
        long.curve()
