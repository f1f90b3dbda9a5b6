"""The boot fault of Table 6 and the two states of Table 7; the split against brute force."""

from __future__ import annotations

from decimal import Decimal
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.studies.paper.variation import (
    bias_states,
    boot_faults,
    nearest_range,
    principal_axis,
    separation,
    table6,
    table7,
    two_way_split,
)
from tests.selection import examples

SECOND_STATE = (3, 4, 5, 7, 10, 11, 13, 15)


def test_run_10_of_bma1_started_in_the_2_g_range() -> None:
    (fault,) = boot_faults()
    result = fault.as_json()
    assert (result["run"], result["column"], result["nearest_range"]) == (10, "z_lsb", "2g")
    assert result["ratio"] == pytest.approx(8.03, abs=0.005)
    assert (result["nearest_range_lsb_per_g"], result["nearest_range_ratio"]) == (4096, 8.0)
    assert [row.extra["nearest_range"] for row in table6()].count("16g") == 14


@pytest.mark.parametrize(
    ("lsb_per_g", "name"),
    [("512", "16g"), ("700", "16g"), ("750", "8g"), ("4100", "2g"), ("5000", "1.5g"), ("9999", "1g")],
)
def test_the_nearest_range_is_by_ratio(lsb_per_g: str, name: str) -> None:
    assert nearest_range(Decimal(lsb_per_g)) == name


def test_gyro3_has_the_two_states_coloured_in_the_paper() -> None:
    first, second = bias_states()
    assert second.runs == SECOND_STATE
    assert first.runs == tuple(run for run in range(1, 16) if run not in SECOND_STATE)
    np.testing.assert_allclose(first.centre, (0, 70, 2), atol=0.3)
    np.testing.assert_allclose(second.centre, (-12.6, 75, 0.7), atol=0.3)
    assert max(*first.spread, *second.spread) < 1.2
    assert separation((first, second)) > 9
    assert [row.extra["state"] for row in table7()] == [2 if run in SECOND_STATE else 1 for run in range(1, 16)]


def scatter(points: np.ndarray) -> float:
    return float(((points - points.mean(axis=0)) ** 2).sum())


@settings(max_examples=examples(30))
@given(seed=st.integers(0, 2**32 - 1), small=st.integers(2, 4), distance=st.floats(4, 40))
def test_the_split_equals_exhaustive_search(seed: int, small: int, distance: float) -> None:
    """Two clusters with eight points in all: every partition is tried."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3)
    direction *= distance / np.linalg.norm(direction)
    points = rng.uniform(-0.5, 0.5, size=(8, 3))
    points[rng.permutation(8)[:small]] += direction
    everything = set(range(8))
    best = min(
        (set(part) for size in range(2, 7) for part in combinations(range(8), size)),
        key=lambda part: scatter(points[sorted(part)]) + scatter(points[sorted(everything - part)]),
    )
    first, second = two_way_split([tuple(map(float, point)) for point in points])
    assert best in (set(first), set(second))


@settings(max_examples=examples(30))
@given(seed=st.integers(0, 2**32 - 1))
def test_principal_axis_is_the_first_eigenvector(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(12, 3)) * (8.0, 2.0, 1.0)
    values, vectors = np.linalg.eigh(np.cov(points.T))
    axis = principal_axis([tuple(map(float, point)) for point in points])
    assert abs(float(np.dot(axis, vectors[:, np.argmax(values)]))) == pytest.approx(1.0, abs=1e-6)
