"""A summary in pieces equals the summary of the whole, and its parts equal those by NumPy and SciPy."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from imuarray.gap.statistics.probes import PROBES, PhaseProbe
from imuarray.gap.statistics.summary import Grid, Summary, Tally, side_by_side
from imuarray.log.format import Phase
from imuarray.log.writer import Block
from tests.gap.small_campaign import block, header, summary
from tests.selection import examples


def noise(rows: int = 3000, seed: int = 1) -> np.ndarray:
    return np.rint(np.random.default_rng(seed).normal((30, 0, -700), (3, 8, 20), (rows, 3))).astype(np.int16)


def same(one: Any, other: Any) -> None:
    """Equal to rounding, field by field."""
    if dataclasses.is_dataclass(one):
        for item in dataclasses.fields(one):
            same(getattr(one, item.name), getattr(other, item.name))
    elif isinstance(one, tuple):
        for mine, yours in zip(one, other, strict=True):
            same(mine, yours)
    elif isinstance(one, np.ndarray | float):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)  # spectra are in single precision
    else:
        assert one == other


@settings(max_examples=examples(15), deadline=None)
@given(st.lists(st.integers(1, 2999), max_size=5, unique=True))
def test_a_streamed_summary_equals_that_of_the_whole(cuts: list[int]) -> None:
    rows = block(noise(), temperature_counts=(np.arange(3000) % 7).astype(np.int16))
    same(summary(rows, cuts=sorted(cuts)), summary(rows))


@pytest.mark.parametrize("longer", [1, 4])
def test_summaries_of_several_replicates_equal_single_ones(longer: int) -> None:
    """Two replicates in two blocks each, and every probe that is defined per column; also for a phase much longer than
    its rows, with none in its second half. The readings of the first replicate are in pairs.
    """
    warm = (np.arange(3000) % 7).astype(np.int16)
    counts = [np.repeat(noise(1500), 2, axis=0), noise(seed=2)]
    rows = [block(own, temperature_counts=warm + seed) for seed, own in enumerate(counts, start=1)]
    phase = Phase(0, longer * (int(rows[0].time[-1]) + 10_000_000), "static", "+Z")
    tally = Tally(header(), phase, Grid.of(3000), 2)
    for part in (slice(1000), slice(1000, 3000)):
        tally.update(
            *(
                Block(one.time[part], one.counts[part], one.status[part], warm[part] + seed)
                for seed, one in enumerate(rows, start=1)
            )
        )
    both = tally.results(lambda time_ns: np.full(len(time_ns), 25.0))
    together = side_by_side(both)
    for at, (found, own) in enumerate(zip(both, rows, strict=True)):
        alone = summary(own, phase)
        same(found, alone)
        for name, probe in PROBES.items():
            if isinstance(probe, PhaseProbe) and probe.by_column:
                told = np.broadcast_to(probe.statistic(together).reshape(-1, 3), (2, 3))[at]
                np.testing.assert_allclose(told, probe.statistic(alone), rtol=1e-4, atol=1e-6, err_msg=name)


def test_parts_of_a_summary_equal_numpy_and_scipy() -> None:
    counts = noise()
    found = summary(block(counts))
    assert found.rows == 3000
    for axis in range(3):
        column = counts[:, axis].astype(float)
        values, times = np.unique(column, return_counts=True)
        np.testing.assert_array_equal(found.codes[axis].codes, values)
        np.testing.assert_array_equal(found.codes[axis].counts, times)
        steps, times = np.unique(np.abs(np.diff(column)), return_counts=True)
        np.testing.assert_array_equal(found.steps[axis].codes, steps)
        np.testing.assert_array_equal(found.steps[axis].counts, times)
        _, density = signal.welch(column, 1.0, nperseg=found.grid.spectrum_rows)
        np.testing.assert_allclose(found.spectrum.density[2:, axis], density[2:], rtol=1e-4)
        squares = np.diff(column) ** 2
        for values, ours in ((column, found.correlation), (squares, found.arch)):
            for lag in (1, 2, 3):
                expected = np.corrcoef(values[:-lag], values[lag:])[0, 1]
                np.testing.assert_allclose(ours[lag, axis], expected, atol=2e-3)  # means of whole and part differ


def test_memory_does_not_grow() -> None:
    """The size of a tally of a phase after ten times as many rows: the same to 10 %."""
    import pickle

    def size(rows: int) -> int:
        tally = Tally(header(), Phase(0, 10**12, "static", "+Z"), Grid(256, 64))
        counts = np.random.default_rng(1).integers(-50, 50, (rows, 3)).astype(np.int16)
        for start in range(0, rows, 2000):
            tally.update(block(counts[start : start + 2000], start_ns=start * 10_000_000))
        return len(pickle.dumps(tally))

    assert size(80_000) < 1.1 * size(8_000)


def test_a_phase_without_rows_has_no_values() -> None:
    found: Summary = Tally(header(), Phase(0, 10**9, "static", "+Z"), Grid.of(0)).result(lambda time_ns: 0.0 * time_ns)
    assert found.rows == 0
    assert np.isnan(found.segments.mean).all()
    assert np.isnan(found.correlation[1]).all()


def test_grids_of_parts_and_spectra() -> None:
    """Parts of at least 16 rows; spectra of at least 16 segments, 64 to 4096 rows."""
    assert Grid.of(100) == Grid(64, 6)
    assert Grid.of(90_000) == Grid(4096, 64)
    assert Grid.of(0) == Grid(64, 2)
