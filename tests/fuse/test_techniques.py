"""The average and the paper's three techniques: contract, weights, and what each is not allowed to do."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.errors import FusionError
from imuarray.fuse import NEEDS_NOISE, TECHNIQUES, Axis, Frames, fuse
from imuarray.fuse.techniques import Technique
from imuarray.log import open_log
from tests.fuse.conftest import Floats, G, Motion, Part, WriteRun, calibration, joined, nothing, pointing

AXES = ("+X+Y+Z", "-Y-X-Z", "+Y+X-Z", "+Y-X+Z", "+Y+Z+X", "-X-Y+Z")


def triad(
    sensor: str, axes: str, noise: tuple[float, float, float] | None, chip: str = "c", span: float = 1e3
) -> list[Axis]:
    """The three axes of a sensor; noise and range in whatever unit."""
    return [
        Axis(sensor, chip, index, tuple(row), span, None if noise is None else noise[index])
        for index, row in enumerate(pointing(axes).tolist())
    ]


def at_once(values: Floats) -> Frames:
    """Frames (n, m) a hundredth of a second apart, all valid."""
    return Frames(np.arange(len(values), dtype=np.int64) * 10_000_000, values, np.ones(values.shape, bool))


def weights(technique: Technique, count: int) -> Floats:
    """(3, m) what each axis adds to each box axis: the answers to a small unit reading of every axis in turn."""
    small = 1e-3
    return np.asarray(technique(at_once(small * np.eye(count))).triad_box.T / small)


def mixed(sigma: float) -> list[Part]:
    """Three designs, two of them with two ranges, pointing six ways."""
    kinds = (("bma180", 16.0, 2048.0), ("bma180", 2.0, 16384.0), ("adxl345", 16.0, 2048.0))
    return [Part(f"A{i}", axes, "specific_force", *kinds[i % 3], sigma=sigma * (1 + i)) for i, axes in enumerate(AXES)]


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_noiseless_sensors_give_the_truth(write_run: WriteRun, technique: str) -> None:
    """Shaken beyond the low range of 2 g: what clips must not show. Half a count of 1/2048 g is rounding."""

    def motion(seconds: Floats) -> Floats:
        return np.asarray(3 * np.sin(2 * np.pi * np.outer(seconds, [0.5, 0.3, 0.2])) + np.array([0, 0, 1]))

    silent = [part._replace(sigma=0.0) for part in mixed(0.01)]
    with open_log(write_run(silent, force=motion)) as log:
        time, fused = joined(list(fuse(log, calibration(mixed(0.01)), technique)))
    assert np.abs(fused / G - motion(time * 1e-9)).max() < 0.5001 / 2048


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_sensors_of_one_kind_that_point_alike_give_their_mean(technique: str) -> None:
    values = np.random.default_rng(3).normal(0, 1, (200, 12))
    axes = [axis for name in "ABCD" for axis in triad(name, "+X+Y+Z", (1.0, 1.0, 1.0))]
    fused = TECHNIQUES[technique](axes)(at_once(values)).triad_box
    assert fused == pytest.approx(values.reshape(200, 4, 3).mean(axis=1))


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_weights_leave_a_constant_alone(technique: str) -> None:
    """Unbiased: every technique's weights, turned into the box frame, add up to the identity."""
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
def test_axes_in_one_plane_do_not_make_a_triad(technique: str) -> None:
    axes = triad("A", "+X+Y+Z", (1.0, 1.0, 1.0))
    flat = [axes[0], axes[1], Axis("A", "c", 2, (0.6, 0.8, 0.0), 1e3, 1.0)]
    assert np.isnan(TECHNIQUES[technique](flat)(at_once(np.ones((5, 3)))).triad_box).all()


@pytest.mark.parametrize("technique", sorted(NEEDS_NOISE))
def test_a_technique_that_weighs_by_noise_names_the_sensor_without(technique: str) -> None:
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 1.0)), *triad("B", "+X+Y+Z", None)]
    with pytest.raises(FusionError, match="sensor B: its noise is not known"):
        TECHNIQUES[technique](axes)


@pytest.mark.parametrize("technique", sorted(NEEDS_NOISE))
def test_a_noise_of_zero_is_refused(technique: str) -> None:
    axes = [*triad("A", "+X+Y+Z", (0.0, 0.0, 0.0)), *triad("B", "+X+Y+Z", (1.0, 1.0, 1.0), span=2e3)]
    with pytest.raises(FusionError):
        TECHNIQUES[technique](axes)


def test_mean_weighs_every_axis_alike() -> None:
    axes = [*triad("A", "+X+Y+Z", None), *triad("B", "-Y-X-Z", None)]
    # B's x points along -Y, its y along -X.
    expected = [[0.5, 0, 0, 0, -0.5, 0], [0, 0.5, 0, -0.5, 0, 0], [0, 0, 0.5, 0, 0, -0.5]]
    assert weights(TECHNIQUES["mean"](axes), 6) == pytest.approx(np.array(expected), abs=1e-12)


def test_planes_weigh_by_inverse_variance() -> None:
    """z scatters twice as much as x and y: 4 to 1 where they meet along one box axis."""
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 2.0)), *triad("B", "+Y+Z+X", (1.0, 1.0, 2.0))]
    # B: x along Y, y along Z, z along X.
    expected = [[0.8, 0, 0, 0, 0, 0.2], [0, 0.5, 0, 0.5, 0, 0], [0, 0, 0.2, 0, 0.8, 0]]
    assert weights(TECHNIQUES["planes"](axes), 6) == pytest.approx(np.array(expected), abs=1e-12)


def test_planes_can_be_better_out_of_plane() -> None:
    axes = [*triad("A", "+X+Y+Z", (3.0, 3.0, 1.0)), *triad("B", "+Y+Z+X", (3.0, 3.0, 1.0))]
    found = weights(TECHNIQUES["planes"](axes), 6)
    assert found[0, [0, 5]] == pytest.approx([0.1, 0.9])


def test_planes_look_at_the_plane_and_not_at_the_sensor() -> None:
    """B is ten times noisier on every axis, C of another design: weights differ by plane alone, within a design."""
    axes = [
        *triad("A", "+X+Y+Z", (1.0, 1.0, 2.0)),
        *triad("B", "+X+Y+Z", (10.0, 10.0, 20.0)),
        *triad("C", "+X+Y+Z", (5.0, 5.0, 5.0), chip="d"),
    ]
    found = weights(TECHNIQUES["planes"](axes), 9)
    assert found[0, [0, 3, 6]] == pytest.approx([1 / 3, 1 / 3, 1 / 3])
    assert found[2, [2, 5, 8]] == pytest.approx([1 / 6, 1 / 6, 4 / 6])


@pytest.mark.parametrize("technique", sorted(NEEDS_NOISE))
def test_hardly_different_noise_weighs_as_in_the_average(technique: str) -> None:
    """Variances 1 : 1.21; inverse-variance weights would gain 4 * 1.21 / 2.21^2 - 1 = -0.9 % of the variance."""
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 1.1)), *triad("B", "+Y+Z+X", (1.0, 1.0, 1.1), span=2e3)]
    assert weights(TECHNIQUES[technique](axes), 6)[0, [0, 5]] == pytest.approx([0.5, 0.5])


# The paper's Table 10, mean of six channels at typical sensitivity: BMA180 at +-1.5 g and at +-16 g, mg.
LOW_MG, HIGH_MG = 9.53, 17.05


def low_and_high(bias_g: float = 0.0, sigma: bool = True) -> list[Part]:
    def error(seconds: Floats) -> Floats:
        return np.full((len(seconds), 3), bias_g)

    low = Part("LOW", range=1.5, sensitivity=5460.0, sigma=LOW_MG / 1e3 if sigma else 0.0, error=error)
    return [low, Part("HIGH", range=16.0, sensitivity=2048.0, sigma=HIGH_MG / 1e3 if sigma else 0.0, error=error)]


def test_ranges_gain_what_table_10_promises(write_run: WriteRun) -> None:
    """8.32 mg, against 9.77 mg of the average and 9.53 mg of the low range alone; error rate 6e-5."""
    parts = low_and_high()
    with open_log(write_run(parts, force=nothing, frames=20000)) as log:
        found = {name: joined(list(fuse(log, calibration(parts), name)))[1] / G * 1e3 for name in ("ranges", "mean")}
    for name, expected in (("ranges", 8.32), ("mean", 9.77)):
        assert found[name].std() == pytest.approx(expected, rel=4 / np.sqrt(2 * 60000))


def test_ranges_weigh_by_inverse_variance_and_leave_other_designs_alone() -> None:
    axes = [
        *triad("LOW", "+X+Y+Z", (1.0, 1.0, 1.0), span=10.0),
        *triad("HIGH", "+X+Y+Z", (3.0, 3.0, 3.0), span=100.0),
        *triad("OTHER", "+X+Y+Z", (50.0, 50.0, 50.0), chip="d", span=100.0),
    ]
    # 1 : 1/9 within the design, which counts for two of three sensors as in the average.
    expected = np.array([0.9 * 2 / 3, 0.1 * 2 / 3, 1 / 3])
    assert weights(TECHNIQUES["ranges"](axes), 9)[1, [1, 4, 7]] == pytest.approx(expected)


def low_share(level: float, axis: int = 0) -> float:
    """Weight of a low-range sensor's y, whose axis `axis` stands at that share of its range."""
    technique = TECHNIQUES["ranges"](
        [*triad("LOW", "+X+Y+Z", (1.0, 1.0, 1.0), span=10.0), *triad("HIGH", "+X+Y+Z", (2.0, 2.0, 2.0), span=100.0)]
    )
    values = np.zeros((1, 6))
    values[0, axis] = 10.0 * level
    before = technique(at_once(values)).triad_box[0, 1]
    values[0, 1] += 1e-6
    return float((technique(at_once(values)).triad_box[0, 1] - before) / 1e-6)


def test_the_low_range_is_trusted_in_full_until_three_quarters_of_it() -> None:
    for level in (0.0, 0.5, -0.7, 0.75):
        assert low_share(level) == pytest.approx(0.8, abs=1e-6)


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_low_range_is_not_used_at_all_before_its_end(axis: int, sign: int) -> None:
    """By the largest axis of the triad: exactly zero from 95 % on."""
    for level in (0.95, 0.97, 1.0, 1.2):
        assert low_share(sign * level, axis) == 0.0


def test_the_low_range_fades_without_a_step() -> None:
    levels = np.linspace(0.7, 1.0, 601)
    share = np.array([low_share(level) for level in levels])
    assert (np.diff(share) <= 1e-9).all()
    # A smooth cubic over 400 of the 600 steps is nowhere steeper than 1.5 times the average.
    assert np.abs(np.diff(share)).max() < 1.6 * 0.8 / 400 * 2


@pytest.mark.parametrize("bias_g", [0.0, 0.05])
def test_no_step_where_the_high_range_takes_over(write_run: WriteRun, bias_g: float) -> None:
    """Equal bias, no noise, from 0 to 3 g: the error stays the bias, within half a count of the coarser sensor."""
    motion: Motion = lambda seconds: np.outer(seconds, [0.3, 0.0, 0.0])  # noqa: E731
    with open_log(write_run(low_and_high(bias_g, sigma=False), force=motion)) as log:
        time, fused = joined(list(fuse(log, calibration(low_and_high()), "ranges")))
    error = fused[:, 0] / G - 0.3 * time * 1e-9 - bias_g
    assert np.abs(error).max() < 0.6 / 2048


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_no_clipped_reading_is_used(write_run: WriteRun, technique: str) -> None:
    """At 3 g the low range stands at its end: one use of it would show 0.7 g."""
    motion: Motion = lambda seconds: np.tile([3.0, 0.0, 0.0], (len(seconds), 1))  # noqa: E731
    with open_log(write_run(low_and_high(sigma=False), force=motion)) as log:
        _, fused = joined(list(fuse(log, calibration(low_and_high()), technique)))
    assert np.abs(fused / G - [3, 0, 0]).max() < 0.51 / 2048


def test_the_high_range_is_used_to_its_end() -> None:
    """Nothing comes after it: at 99 % of 16 g it carries on alone."""
    axes = [*triad("LOW", "+X+Y+Z", (1.0, 1.0, 1.0), span=1.5), *triad("HIGH", "+X+Y+Z", (2.0, 2.0, 2.0), span=16.0)]
    values = np.tile([1.5, 0.0, 0.0, 15.84, 0.0, 0.0], (2, 1))
    assert TECHNIQUES["ranges"](axes)(at_once(values)).triad_box[0] == pytest.approx([15.84, 0.0, 0.0])


def test_two_low_sensors_and_no_high_one_are_not_faded() -> None:
    """A design with one range has nothing to hand over to."""
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 1.0), span=10.0), *triad("B", "+X+Y+Z", (1.0, 1.0, 1.0), span=10.0)]
    fused = TECHNIQUES["ranges"](axes)(at_once(np.full((1, 6), 9.9))).triad_box
    assert fused == pytest.approx(np.full((1, 3), 9.9))


def test_the_covariance_is_what_the_noise_makes_of_the_weights() -> None:
    """Two axes of noise 1 and 2 along X: weighing alike (1 + 4) / 4, by inverse variance 1 / (1 + 1/4)."""
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 2.0)), *triad("B", "+Z+Y+X", (1.0, 1.0, 2.0))]
    frames = at_once(np.zeros((2, 6)))
    assert TECHNIQUES["mean"](axes)(frames).covariance_box[1] == pytest.approx([1.25, 0.5, 1.25, 0, 0, 0])
    assert TECHNIQUES["planes"](axes)(frames).covariance_box[1] == pytest.approx([0.8, 0.5, 0.8, 0, 0, 0])


def test_a_covariance_is_unknown_where_a_noise_in_use_is() -> None:
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 1.0)), *triad("B", "+X+Y+Z", None)]
    frames = at_once(np.zeros((2, 6)))
    frames.valid[1, 3:] = False
    estimate = TECHNIQUES["mean"](axes)(frames)
    assert np.isnan(estimate.covariance_box[0, :3]).all()
    assert estimate.covariance_box[1] == pytest.approx([1, 1, 1, 0, 0, 0])
    assert estimate.used.tolist() == [[True] * 6, [True] * 3 + [False] * 3]
