"""Slow processes: the exact distribution at their knots, straight lines between, independence of blocks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.simulate.processes import SlowProcess, gauss_markov, random_walk
from imuarray.simulate.signal import Place
from tests.selection import examples, some
from tests.simulate.conftest import Floats, MakePlace, furthest, header

SEEDS = 300


def drawn(process_of_seed: list[SlowProcess], rows: list[int]) -> Floats:
    """(3 seeds, rows): the axes are independent, so each is a sample."""
    values = [np.stack([process.rows(row, row + 1)[0] for row in rows], axis=1) for process in process_of_seed]
    return np.concatenate(values)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rows_per_s", "time_constant_s", "rows"),
    some(
        [
            (10.0, 90.0, [0, 1, 2800, 4095, 4096, 4102, 8192, 2500]),  # every row a knot; chunks of 4096 knots meet
            (10.0, 90.0, [101_000, 102_399, 102_400, 102_401, 104_000]),  # long after any influence of the beginning
            (1.0, 0.5, [0, 1, 2, 3, 8191, 8192]),  # shorter than a row
            (100.0, 100.0, [0, 16, 32, 65_520, 65_536, 16_384, 131_072]),  # every sixteenth row a knot
            # knots no farther apart than 256 rows
            (100.0, 1e6, [0, 256 * 4095, 256 * 4096, 256 * 2000, 256 * 200_000]),
        ],
        2,
        0,
    ),
)
def test_gauss_markov_is_normal_stationary_and_exponentially_correlated(
    place: MakePlace, rows_per_s: float, time_constant_s: float, rows: list[int]
) -> None:
    processes = [gauss_markov(time_constant_s, place(rows_per_s=rows_per_s, seed=seed), "b") for seed in range(SEEDS)]
    lag_s = np.abs(np.subtract.outer(rows, rows)) / rows_per_s
    # At most 44 numbers, each beyond 5 standard errors with probability 6e-7: 3e-5.
    assert furthest(drawn(processes, rows), np.exp(-lag_s / time_constant_s)) < 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rows_per_s", "rows"),
    some(
        [
            (10.0, [1, 2, 2800, 4095, 4096, 4102, 8192, 50_000]),  # every row a knot
            (100.0, [10, 20, 40_950, 40_960, 40_970, 81_920]),  # every tenth
            (50_000.0, [256, 512, 256 * 4095, 256 * 4096]),
        ],
        1,
        0,
    ),
)
def test_random_walk_grows_by_one_a_second(place: MakePlace, rows_per_s: float, rows: list[int]) -> None:
    processes = [random_walk(place(rows_per_s=rows_per_s, seed=seed), "w") for seed in range(SEEDS)]
    # 44 numbers as above: 3e-5.
    assert furthest(drawn(processes, rows), np.minimum.outer(rows, rows) / rows_per_s) < 5
    assert (drawn(processes[:5], [0]) == 0).all()


@pytest.mark.slow
def test_axes_are_independent(place: MakePlace) -> None:
    ends = np.stack([gauss_markov(100.0, place(seed=seed), "b").rows(5000, 5001)[0] for seed in range(800)])
    assert furthest(ends, np.eye(3)) < 5  # 9 numbers: 5e-6


def gauss(at: Place) -> SlowProcess:
    return gauss_markov(100.0, at, "b")


def walk(at: Place) -> SlowProcess:
    return random_walk(at, "w")


def part_of_flicker(at: Place) -> SlowProcess:
    return gauss_markov(11.0, at, "b", number=1)


@pytest.mark.parametrize(("kind", "spacing"), [(gauss, 16), (walk, 10), (part_of_flicker, 64)])
def test_a_process_is_linear_between_knots(
    place: MakePlace, kind: Callable[[Place], SlowProcess], spacing: int
) -> None:
    rows = kind(place(rows_per_s=100.0)).rows(0, 19_201)
    at = np.arange(19_201)
    for axis in rows.T:
        np.testing.assert_allclose(axis, np.interp(at, at[::spacing], axis[::spacing]), rtol=0, atol=1e-12)
    assert np.abs(np.diff(rows[::spacing], n=2, axis=0)).min() > 0  # every knot is a corner


@pytest.mark.parametrize("kind", [gauss, walk, part_of_flicker])
@pytest.mark.parametrize("rows_per_s", [4.0, 100.0])  # every row a knot; knots farther apart
def test_a_block_alone_equals_that_in_sequence(
    place: MakePlace, kind: Callable[[Place], SlowProcess], rows_per_s: float
) -> None:
    process, again = (kind(place(rows_per_s=rows_per_s)) for _ in range(2))
    whole = np.concatenate([process.rows(first, first + 5000) for first in range(0, 50_000, 5000)])

    @settings(max_examples=examples(25), deadline=None)
    @given(st.integers(0, 49_999), st.integers(0, 30_000))
    def same(first: int, length: int) -> None:
        stop = min(first + length, 50_000)
        np.testing.assert_array_equal(again.rows(first, stop), whole[first:stop])

    same()


def test_the_distribution_is_the_same_months_later(place: MakePlace) -> None:
    at = place()
    far = np.concatenate([gauss_markov(100.0, at, "b").rows(10**9 + k, 10**9 + k + 1) for k in range(0, 10**7, 10**5)])
    # 300 independent standard normal numbers: mean square 1 +- 5 sqrt(2 / 300); chance 6e-7
    assert abs((far**2).mean() - 1) < 5 * np.sqrt(2 / 300)


def test_processes_of_different_names_differ(place: MakePlace) -> None:
    def path(at: Place, effect: str = "b", number: int = 1, shared_by: str = "") -> Floats:
        return gauss_markov(100.0, at, effect, shared_by, number=number).rows(0, 5000)

    other = place(header(name="S2"))
    paths = [
        path(place()),
        path(other),
        path(place(seed=2)),
        path(place(boot=1)),
        path(place(), "c"),
        path(place(), number=2),
        path(place(), shared_by="bma180"),
    ]
    firsts = np.array([rows[0] for rows in paths])
    assert len(np.unique(firsts)) == firsts.size
    np.testing.assert_array_equal(path(place()), paths[0])
    np.testing.assert_array_equal(path(other, shared_by="bma180"), paths[-1])


@pytest.mark.parametrize("rows_per_s", [4.0, 100.0])
def test_another_time_constant_changes_the_process_little(place: MakePlace, rows_per_s: float) -> None:
    first, other = (
        gauss_markov(time_s, place(rows_per_s=rows_per_s), "b").rows(0, 50_000) for time_s in (100.0, 101.0)
    )
    # The draws are the same. The response to a draw is exp(-s / T), so that two time constants that differ by 1 %
    # have a correlation of 2 sqrt(T U) / (T + U), 1 - 1.2e-5; the mean square of their difference is 2.5e-5.
    assert 1e-6 < ((other - first) ** 2).mean() < 1e-4


@pytest.mark.parametrize("rows_per_s", [4.0, 100.0])
def test_single_precision_is_kept(place: MakePlace, rows_per_s: float) -> None:
    rows = gauss_markov(100.0, place(rows_per_s=rows_per_s, dtype=np.float32), "b").rows(0, 3000, np.float32)
    assert rows.dtype == np.float32
    assert rows.shape == (3000, 3)
    assert np.isfinite(rows).all()
