"""The average and the paper's three techniques: their common contract."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.errors import FusionError
from imuarray.fuse import NEEDS_NOISE, TECHNIQUES, Axis, fuse
from imuarray.log import open_log
from tests.fuse.arrays import at_once, low_and_high, triad, weights
from tests.fuse.conftest import Floats, G, Motion, Part, WriteRun, calibration, joined
from tests.selection import some

AXES = ("+X+Y+Z", "-Y-X-Z", "+Y+X-Z", "+Y-X+Z", "+Y+Z+X", "-X-Y+Z")


def mixed(sigma: float) -> list[Part]:
    """Three designs, two of them with two ranges, in six orientations."""
    kinds = (("bma180", 16.0, 2048.0), ("bma180", 2.0, 16384.0), ("adxl345", 16.0, 2048.0))
    return [Part(f"A{i}", axes, "specific_force", *kinds[i % 3], sigma=sigma * (1 + i)) for i, axes in enumerate(AXES)]


@pytest.mark.parametrize("technique", some(TECHNIQUES, 2))
def test_noiseless_sensors_give_the_truth(write_run: WriteRun, technique: str) -> None:
    """Shaken beyond the low range of 2 g: clipping must have no effect. Half a count of 1/2048 g is rounding, and the
    effect of rounding on the estimates of `ranges` is less than a tenth.
    """

    def motion(seconds: Floats) -> Floats:
        return np.asarray(3 * np.sin(2 * np.pi * np.outer(seconds, [0.5, 0.3, 0.2])) + np.array([0, 0, 1]))

    silent = [part._replace(sigma=0.0) for part in mixed(0.01)]
    with open_log(write_run(silent, force=motion)) as log:
        time, fused = joined(list(fuse(log, calibration(mixed(0.01)), technique)))
    assert np.abs(fused / G - motion(time * 1e-9)).max() < (0.55 if technique == "ranges" else 0.5001) / 2048


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_equal_parallel_sensors_give_their_mean(technique: str) -> None:
    values = np.random.default_rng(3).normal(0, 1, (200, 12))
    axes = [axis for name in "ABCD" for axis in triad(name, "+X+Y+Z", (1.0, 1.0, 1.0))]
    fused = TECHNIQUES[technique](axes)(at_once(values)).triad_box
    assert fused == pytest.approx(values.reshape(200, 4, 3).mean(axis=1))


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_weights_sum_to_the_identity(technique: str) -> None:
    """Unbiased: the weights of every technique in the box frame sum to the identity."""
    axes = [
        axis
        for index, way in enumerate(AXES)
        for axis in triad(f"S{index}", way, (1.0, 2.0, 4.0), "ab"[index % 2], (1e3, 2e3)[index // 3])
    ]
    rows = np.array([axis.direction_box for axis in axes])
    truth = np.array([0.3, -0.7, 1.1])
    fused = TECHNIQUES[technique](axes)(at_once(np.tile(rows @ truth, (3, 1)))).triad_box
    assert fused == pytest.approx(np.tile(truth, (3, 1)))


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_axes_in_one_plane_are_refused(technique: str) -> None:
    axes = triad("A", "+X+Y+Z", (1.0, 1.0, 1.0))
    flat = [axes[0], axes[1], Axis("A", "c", 2, (0.6, 0.8, 0.0), 1e3, 1.0)]
    assert np.isnan(TECHNIQUES[technique](flat)(at_once(np.ones((5, 3)))).triad_box).all()


@pytest.mark.parametrize("technique", sorted(NEEDS_NOISE & set(TECHNIQUES)))
def test_a_technique_that_weighs_by_noise_names_a_sensor_without_noise(technique: str) -> None:
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 1.0)), *triad("B", "+X+Y+Z", None)]
    with pytest.raises(FusionError, match="sensor B: its noise is not known"):
        TECHNIQUES[technique](axes)


@pytest.mark.parametrize("technique", sorted(NEEDS_NOISE & set(TECHNIQUES)))
def test_a_noise_of_zero_is_refused(technique: str) -> None:
    axes = [*triad("A", "+X+Y+Z", (0.0, 0.0, 0.0)), *triad("B", "+X+Y+Z", (1.0, 1.0, 1.0), span=2e3)]
    with pytest.raises(FusionError):
        TECHNIQUES[technique](axes)


def test_mean_weighs_every_axis_alike() -> None:
    axes = [*triad("A", "+X+Y+Z", None), *triad("B", "-Y-X-Z", None)]
    # B's x points along -Y, its y along -X.
    expected = [[0.5, 0, 0, 0, -0.5, 0], [0, 0.5, 0, -0.5, 0, 0], [0, 0, 0.5, 0, 0, -0.5]]
    assert weights(TECHNIQUES["mean"](axes), 6) == pytest.approx(np.array(expected), abs=1e-12)


@pytest.mark.parametrize("technique", sorted(NEEDS_NOISE & set(TECHNIQUES)))
def test_nearly_equal_noise_gives_the_weights_of_the_average(technique: str) -> None:
    """Variances 1 : 1.21; inverse-variance weights would gain 4 * 1.21 / 2.21^2 - 1 = -0.9 % of the variance."""
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 1.1)), *triad("B", "+Y+Z+X", (1.0, 1.0, 1.1), span=2e3)]
    assert weights(TECHNIQUES[technique](axes), 6)[0, [0, 5]] == pytest.approx([0.5, 0.5])


@pytest.mark.parametrize("technique", some(TECHNIQUES, 2))
def test_no_clipped_reading_is_used(write_run: WriteRun, technique: str) -> None:
    """At 3 g the low range is at its end: a single use of it would give an error of 0.7 g."""
    motion: Motion = lambda seconds: np.tile([3.0, 0.0, 0.0], (len(seconds), 1))  # noqa: E731
    with open_log(write_run(low_and_high(sigma=False), force=motion)) as log:
        _, fused = joined(list(fuse(log, calibration(low_and_high()), technique)))
    assert np.abs(fused / G - [3, 0, 0]).max() < 0.51 / 2048


def test_the_covariance_is_the_noise_through_the_weights() -> None:
    """Two axes of noise 1 and 2 along X: (1 + 4) / 4 with equal weights, 1 / (1 + 1/4) by inverse variance."""
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 2.0)), *triad("B", "+Z+Y+X", (1.0, 1.0, 2.0))]
    frames = at_once(np.zeros((2, 6)))
    assert TECHNIQUES["mean"](axes)(frames).covariance_box[1] == pytest.approx([1.25, 0.5, 1.25, 0, 0, 0])
    assert TECHNIQUES["planes"](axes)(frames).covariance_box[1] == pytest.approx([0.8, 0.5, 0.8, 0, 0, 0])


def test_an_unknown_noise_in_use_gives_an_unknown_covariance() -> None:
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 1.0)), *triad("B", "+X+Y+Z", None)]
    frames = at_once(np.zeros((2, 6)))
    frames.valid[1, 3:] = False
    estimate = TECHNIQUES["mean"](axes)(frames)
    assert np.isnan(estimate.covariance_box[0, :3]).all()
    assert estimate.covariance_box[1] == pytest.approx([1, 1, 1, 0, 0, 0])
    assert estimate.used.tolist() == [[True] * 6, [True] * 3 + [False] * 3]
