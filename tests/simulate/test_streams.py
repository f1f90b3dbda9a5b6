"""Named streams: independence of blocks, and of other names, runs, units."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from imuarray.simulate.streams import CHUNK, DrawMemory, Stream, Streams
from tests.selection import examples


@settings(max_examples=examples(40), deadline=None)
@given(st.integers(0, 3 * CHUNK), st.integers(1, CHUNK), st.sampled_from(["float32", "float64"]))
def test_any_block_alone_equals_that_of_the_whole(start: int, length: int, dtype: str) -> None:
    whole = Streams(7).of_boot("S1", "white_noise", dtype=dtype).normal(0, 4 * CHUNK)
    alone = Streams(7).of_boot("S1", "white_noise", dtype=dtype).normal(start, start + length)
    assert alone.dtype == dtype
    np.testing.assert_array_equal(alone, whole[start : start + length])


def test_another_name_seed_or_boot_is_another_stream() -> None:
    draws = [
        Streams(seed, boot).of_boot(*name).normal(0, 1000)[:, 0]
        for seed, boot, name in [
            (1, 0, ("S1", "white_noise")),
            (2, 0, ("S1", "white_noise")),
            (1, 1, ("S1", "white_noise")),
            (1, 0, ("S2", "white_noise")),
            (1, 0, ("S1", "tone")),
            (1, 0, ("S1white_noise", "")),
        ]
    ]
    correlation = np.corrcoef(draws) - np.eye(len(draws))
    # 15 pairs of 1000 rows: |r| > 0.13 has probability 4e-5 each
    assert np.abs(correlation).max() < 0.13


def test_draws_of_a_unit_are_the_same_in_every_boot() -> None:
    assert Streams(3, 0).of_unit("S1", "bias").normal() == Streams(3, 9).of_unit("S1", "bias").normal()
    assert Streams(3).of_unit("S1", "bias").normal() != Streams(4).of_unit("S1", "bias").normal()


@pytest.mark.parametrize("entropy", [(0,), (1 << 32, 5), (0x8123456789ABCDEF, 1, 0, 3), ((1 << 64) - 1, 1 << 31)])
@pytest.mark.parametrize("chunk", [0, 7, 1 << 40])
def test_the_seed_of_a_chunk_is_that_of_its_numbers(entropy: tuple[int, ...], chunk: int) -> None:
    """NumPy's own seed of the numbers, as its documentation describes it: words of 32 bits, the lowest first."""
    seed = np.random.SeedSequence((*entropy, chunk))
    drawn = Stream(entropy, 1, np.float64).generator(chunk).random(4)
    np.testing.assert_array_equal(drawn, np.random.Generator(np.random.SFC64(seed)).random(4))


def test_rows_are_standard_normal_across_chunk_edges() -> None:
    rows = Streams(11).of_boot("S1", "noise", width=1).normal(CHUNK - 5000, CHUNK + 5000)[:, 0]
    assert stats.kstest(rows, "norm").pvalue > 1e-3  # error rate 1e-3
    uniform = Streams(11).of_boot("S1", "places", width=1).uniform(CHUNK - 5000, CHUNK + 5000)[:, 0]
    assert stats.kstest(uniform, "uniform").pvalue > 1e-3


def test_rows_are_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Streams(1).of_boot("S1", "noise").normal(0, 3)[0, 0] = 1.0


def test_negative_seeds_are_refused() -> None:
    with pytest.raises(ValueError, match="seed -1"):
        Streams(-1)


def test_cached_draws_are_the_same_numbers() -> None:
    """Of a whole chunk, of a part of one, scaled and not; also the second time, and compared with a plain stream."""
    memory = DrawMemory(1 << 22)
    for _ in range(2):
        for scale in (None, (1.0, 2.0, 0.5)):
            for rows in ((0, 100), (CHUNK - 5, CHUNK + 5)):
                plain = Streams(7).of_boot("S1", "white_noise", scale=scale).normal(*rows)
                remembered = Streams(7, memory=memory).of_boot("S1", "white_noise", scale=scale).normal(*rows)
                np.testing.assert_array_equal(remembered, plain)


def test_a_cache_discards_the_least_recent_results() -> None:
    """Of results of 400 bytes each 1000 bytes hold two; a result that is larger than the memory is made each time."""
    memory, made = DrawMemory(1000), list[str]()

    def recalled(key: str, values: int = 50) -> int:
        def make() -> np.ndarray:
            made.append(key)
            return np.zeros(values)

        return len(memory.recall(key, make, lambda array: array.nbytes))

    for key in ("a", "b", "a", "c", "a", "b", "c"):
        assert recalled(key) == 50
    assert made == ["a", "b", "c", "b", "c"]
    assert [recalled("large", 200) for _ in range(2)] == [200, 200]
    assert made[-2:] == ["large", "large"]
