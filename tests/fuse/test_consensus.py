"""The consensus of an array: the mean, with a bounded influence of each sensor."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.fuse import aligned
from imuarray.fuse.least_squares import TOLERATED_SI, consensus
from imuarray.log import open_log
from tests.fuse.conftest import Floats, G, Part, WriteRun, calibration, pointing
from tests.selection import examples

AXES = ("+X+Y+Z", "-Y-X-Z", "+Y+X-Z", "+Y-X+Z", "+X-Y-Z")
ROWS = np.concatenate([pointing(axes) for axes in AXES])
FORCE = "specific_force"
LIMIT = TOLERATED_SI[FORCE]


def agreed(values: Floats) -> Floats:
    return consensus(values, np.ones(values.shape, bool), ROWS, FORCE)


@given(seed=st.integers(0, 1 << 32))
@settings(max_examples=examples(20), deadline=None)
def test_sensors_that_agree_are_averaged(seed: int) -> None:
    """For triads along the axes of the box, in any orientation, it is the mean of their vectors."""
    rng = np.random.default_rng(seed)
    vectors = rng.normal(0, 5, (4, 1, 3)) + rng.uniform(-LIMIT / 5, LIMIT / 5, (4, len(AXES), 3))
    values = np.einsum("sij,nsj->nsi", ROWS.reshape(-1, 3, 3), vectors).reshape(4, -1)
    np.testing.assert_allclose(agreed(values), vectors.mean(axis=1), atol=1e-12)


@pytest.mark.parametrize("off", [1.0, 10.0, 1e4])
def test_the_influence_of_an_outlier_is_limited(off: float) -> None:
    """One of five sensors has an error of `off` limits along box X: it shifts the consensus by a fifth of the limit."""
    truth = np.array([[1.0, -2.0, G]])
    values = truth @ ROWS.T
    values[:, :3] += off * LIMIT * ROWS[:3, 0]
    np.testing.assert_allclose(agreed(values) - truth, [[min(off, 1.0) * LIMIT / 5, 0, 0]], atol=1e-12)


def test_the_consensus_is_continuous_at_the_limit() -> None:
    """No step of the result is larger than the step of that one reading; all the others differ a little."""
    rng = np.random.default_rng(5)
    off = np.linspace(0, 5 * LIMIT, 4001)
    values = np.tile(rng.normal(0, LIMIT / 10, len(ROWS)), (len(off), 1))
    values[:, 0] += off
    assert np.abs(np.diff(agreed(values), axis=0)).max() <= off[1] * (1 + 1e-9)


def test_frames_without_enough_axes_are_nan() -> None:
    valid = np.ones((2, len(ROWS)), bool)
    valid[1, 2:] = False
    result = consensus(np.full(valid.shape, 100.0), valid, ROWS, FORCE)
    assert np.isfinite(result[0]).all()
    assert np.isnan(result[1]).all()


def test_a_sensor_in_another_range_does_not_move_the_others_in_time(write_run: WriteRun) -> None:
    """Sensors are read up to 4 ms after each other while the force oscillates; one reads eight times as much. The slope
    of the mean would be 2.4 times too steep, and give the others an error of up to 1.4 x 4 ms of motion.
    """

    def swinging(seconds: Floats) -> Floats:
        swing = np.array([0.3, 0.2, 0.4]) * np.sin(2 * np.pi * np.outer(seconds, [0.5, 0.4, 0.3]))
        return np.asarray(swing + np.array([0.0, 0.0, 1.0]))

    parts = [Part(f"A{i}", axes, late_s=0.001 * i, sensitivity=8000.0, range=4.0) for i, axes in enumerate(AXES)]
    wrong = parts[3]._replace(error=lambda seconds: 7 * swinging(seconds) @ pointing(AXES[3]).T, range=30.0)
    wrong = wrong._replace(sensitivity=1000.0)
    parts[3] = wrong
    with open_log(write_run(parts, force=swinging)) as log:
        blocks = [frames[FORCE] for frames, _ in aligned(log, calibration(parts))]
    time = np.concatenate([block.time for block in blocks])
    values = np.concatenate([block.values for block in blocks]) / G
    truth = swinging(time * 1e-9) @ ROWS.T
    sound = [index for index in range(len(ROWS)) if index // 3 != 3]
    fastest = 2 * np.pi * 0.5 * 0.3  # g/s: 0.94, of which 1.4 x 4 ms are 5 mg
    error = np.abs(values - truth)[5:-5, sound].max()
    assert error < 0.1 * 1.4 * 0.004 * fastest


@pytest.mark.parametrize("sensors", [3, 4, 6, 8, 9, 12])
@pytest.mark.parametrize("complete", [True, False])
def test_the_consensus_equals_its_definition(sensors: int, complete: bool) -> None:
    """Few sensors or many, in blocks with every reading or with a missing reading."""
    rng = np.random.default_rng(sensors)
    rows = np.concatenate([pointing(AXES[number % len(AXES)]) for number in range(sensors)])
    values = rng.normal(0, 3 * LIMIT, (50, 3 * sensors))
    valid = np.ones(values.shape, bool)
    valid[-1, 0] = complete
    wanted = []
    for frame in values[:-1]:
        vectors = np.einsum("sij,si->sj", rows.reshape(-1, 3, 3), frame.reshape(-1, 3))  # rows are orthonormal
        middle = np.median(vectors, axis=0)
        apart = (frame - rows @ middle).reshape(-1, 3)
        limit = LIMIT + 4 * np.median(np.abs(apart))
        drawn_in = apart * np.minimum(1, limit / np.abs(apart).max(axis=1).clip(1e-300))[:, None]
        wanted.append(middle + np.linalg.lstsq(rows, drawn_in.reshape(-1), rcond=None)[0])
    np.testing.assert_allclose(consensus(values, valid, rows, FORCE)[:-1], wanted, rtol=1e-12, atol=1e-12)


def test_a_missing_reading_has_no_weight() -> None:
    """The other four are averaged, for each missing sensor, in a block with a complete frame."""
    rng = np.random.default_rng(7)
    vectors = np.array([1.0, -2.0, G]) + rng.uniform(-LIMIT / 5, LIMIT / 5, (2, len(AXES), 3))
    values = np.einsum("sij,nsj->nsi", ROWS.reshape(-1, 3, 3), vectors).reshape(2, -1)
    for missing in range(len(AXES)):
        valid = np.ones(values.shape, bool)
        valid[1, 3 * missing : 3 * missing + 3] = False
        known = np.arange(len(AXES)) != missing
        expected = [vectors[0].mean(axis=0), vectors[1, known].mean(axis=0)]
        np.testing.assert_allclose(consensus(values, valid, ROWS, FORCE), expected, atol=1e-12)


def test_the_median_is_that_of_the_available_readings() -> None:
    """The median of four readings 0, 0, 3, 3 limits is 1.5; each has an influence up to one limit from
    it: 1.5 again.
    """
    vectors = np.array([1.0, -2.0, G]) * np.ones((2, len(AXES), 1))
    vectors[:, 2:4, 0] += 3 * LIMIT
    values = np.einsum("sij,nsj->nsi", ROWS.reshape(-1, 3, 3), vectors).reshape(2, -1)
    valid = np.ones(values.shape, bool)
    valid[1, -3:] = False
    np.testing.assert_allclose(consensus(values, valid, ROWS, FORCE)[1], [1 + 1.5 * LIMIT, -2.0, G], atol=1e-12)
