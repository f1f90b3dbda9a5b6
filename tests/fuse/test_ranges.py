"""`ranges`: the gain of Table 10 at rest, and no step at the end of the low range in motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from imuarray.calibrate import Calibration
from imuarray.cli import main
from imuarray.fuse import TECHNIQUES, Axis, Estimate, Frames, fuse
from imuarray.fuse.techniques import changes
from imuarray.fuse.techniques.ranges import SETTLED, Blends, Fading, RangeBlend, settling_s
from imuarray.log import open_log
from tests.fuse.arrays import HIGH_MG, LOW_MG, at_once, low_and_high, triad, weights
from tests.fuse.conftest import Floats, G, Motion, Part, WriteRun, calibration, joined, nothing

LOW_G, HIGH_G = LOW_MG / 1e3, HIGH_MG / 1e3
SHARE = LOW_G**-2 / (LOW_G**-2 + HIGH_G**-2)
"""Of the low range in the blend: 0.76."""
BLEND_G = (LOW_G**-2 + HIGH_G**-2) ** -0.5
RATE_HZ = 100.0
BIAS_G, SCALE, DELAY_S = 0.05, 0.02, 1e-3
"""What the low range reads otherwise than the high one."""


def test_noise_of_ranges_is_that_predicted_by_table_10(write_run: WriteRun) -> None:
    """8.32 mg, against 9.77 mg of the average and 9.53 mg of the low range alone; error rate 6e-5."""
    assert pytest.approx(0.762, abs=5e-4) == SHARE
    assert pytest.approx(8.32e-3, abs=5e-6) == BLEND_G
    parts = low_and_high()
    with open_log(write_run(parts, force=nothing, frames=20000)) as log:
        result = {name: joined(list(fuse(log, calibration(parts), name)))[1] / G * 1e3 for name in ("ranges", "mean")}
    for name, expected in (("ranges", 8.32), ("mean", 9.77)):
        assert result[name].std() == pytest.approx(expected, rel=4 / np.sqrt(2 * 60000))


def test_ranges_weigh_by_inverse_variance_within_a_design() -> None:
    axes = [
        *triad("LOW", "+X+Y+Z", (1.0, 1.0, 1.0), span=10.0),
        *triad("HIGH", "+X+Y+Z", (3.0, 3.0, 3.0), span=100.0),
        *triad("OTHER", "+X+Y+Z", (50.0, 50.0, 50.0), chip="d", span=100.0),
    ]
    # 1 : 1/9 within the design, which has the weight of two of three sensors, as in the average.
    expected = np.array([0.9 * 2 / 3, 0.1 * 2 / 3, 1 / 3])
    assert weights(TECHNIQUES["ranges"](axes), 9)[1, [1, 4, 7]] == pytest.approx(expected)


def test_ranges_of_different_chips_are_blended() -> None:
    """Designs with one range each: 1 : 1/9 by inverse variance, for two units of the high range 1/18 each; chips with
    the same range have equal weights, and full scales of 2000 and 2048 are one range.
    """
    axes = [
        *triad("LOW", "+X+Y+Z", (1.0, 1.0, 1.0), chip="c", span=10.0),
        *triad("HIGH", "+X+Y+Z", (3.0, 3.0, 3.0), chip="d", span=100.0),
        *triad("TOO", "+X+Y+Z", (3.0, 3.0, 3.0), chip="e", span=100.0),
    ]
    result = weights(TECHNIQUES["ranges"](axes), 9)[1, [1, 4, 7]]
    assert result == pytest.approx(np.array([9, 1, 1]) / 11)
    assert changes("ranges", axes) == ["LOW"]
    one = [
        *triad("A", "+X+Y+Z", (1.0,) * 3, chip="c", span=2000.0),
        *triad("B", "+X+Y+Z", (1.0,) * 3, chip="d", span=2048.0),
    ]
    assert changes("ranges", one) == []


def test_a_low_range_of_another_chip_fades_out_without_a_step(write_run: WriteRun) -> None:
    """From 0 to 3 g with a chip of 1.5 g and another of 16 g that differ by 50 mg: no step at the hand-over; by the
    noise of the calibration, in a log without rest.
    """
    low, high = low_and_high(sigma=False)
    low = low._replace(chip="mpu9150", error=lambda seconds: np.full((len(seconds), 3), 0.05))
    motion: Motion = lambda seconds: np.outer(seconds, [0.3, 0.0, 0.0])  # noqa: E731
    known = calibration([part._replace(chip=one.chip) for part, one in zip(low_and_high(), (low, high), strict=True)])
    with open_log(write_run([low, high], force=motion)) as log:
        time, fused = joined(list(fuse(log, known, "ranges")))
    error = fused[:, 0] / G - 0.3 * time * 1e-9
    assert np.abs(error - SHARE * 0.05).max() < 1.5 / 2048


@pytest.mark.slow
def test_the_noise_of_the_calibration_needs_no_rest(
    write_run: WriteRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A log without rest, of two chips with known noise and a third of unknown noise that is not fused."""
    low, high = low_and_high()
    parts = [low._replace(chip="mpu9150"), high, Part("THIRD", sigma=0.02)]
    known = calibration(parts)
    known = Calibration({**known.sensors, "THIRD": replace(known.sensors["THIRD"], noise_lsb=None)})
    known.save(tmp_path / "cal.toml")
    motion: Motion = lambda seconds: np.sin(np.outer(seconds, [9.0, 7.0, 8.0]))  # noqa: E731
    run = str(write_run(parts, force=motion))
    fused = ["fuse", run, "--calibration", str(tmp_path / "cal.toml"), "-o", str(tmp_path / "f.h5"), "--technique"]
    assert main([*fused, "ranges", "--only", "LOW,HIGH"]) == 0
    text = capsys.readouterr()
    assert "no noise" not in text.err and "ranges relies on wider ranges near the end of the range of LOW\n" in text.out
    assert main([*fused, "opposed", "--only", "LOW,HIGH", "--force"]) == 0
    assert "opposed changes nothing on this array: the axes of a design that point both ways" in capsys.readouterr().out
    assert main([*fused, "ranges", "--only", "HIGH", "--force"]) == 0
    assert "all its sensors of a quantity have one measuring range" in capsys.readouterr().out


def low_share(level: float, axis: int = 0) -> float:
    """Weight of a low-range sensor's y if axis `axis` reads that share of its range."""
    technique = TECHNIQUES["ranges"](
        [*triad("LOW", "+X+Y+Z", (1.0, 1.0, 1.0), span=10.0), *triad("HIGH", "+X+Y+Z", (2.0, 2.0, 2.0), span=100.0)]
    )
    values = np.zeros((1, 6))
    values[0, axis] = 10.0 * level
    before = technique(at_once(values)).triad_box[0, 1]
    values[0, 1] += 1e-6
    return float((technique(at_once(values)).triad_box[0, 1] - before) / 1e-6)


def test_the_low_range_has_full_weight_until_three_quarters_of_it() -> None:
    for level in (0.0, 0.5, -0.7, 0.75):
        assert low_share(level) == pytest.approx(0.8, abs=1e-6)


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_low_range_has_no_weight_near_its_end(axis: int, sign: int) -> None:
    """By the largest axis of the triad: exactly zero from 95 % on."""
    for level in (0.95, 0.97, 1.0, 1.2):
        assert low_share(sign * level, axis) == 0.0


@pytest.mark.slow
def test_the_low_range_fades_without_a_step() -> None:
    levels = np.linspace(0.7, 1.0, 151)
    share = np.array([low_share(level) for level in levels])
    assert (np.diff(share) <= 1e-9).all()
    # A smooth cubic over 100 of the 150 steps is nowhere steeper than 1.5 times the average.
    assert np.abs(np.diff(share)).max() < 1.6 * 0.8 / 100 * 2


@pytest.mark.slow
@pytest.mark.parametrize("bias_g", [0.0, 0.05])
def test_no_step_where_the_high_range_takes_over(write_run: WriteRun, bias_g: float) -> None:
    """Equal bias, no noise, from 0 to 3 g: the error stays the bias, within half a count of the coarser sensor."""
    motion: Motion = lambda seconds: np.outer(seconds, [0.3, 0.0, 0.0])  # noqa: E731
    with open_log(write_run(low_and_high(bias_g, sigma=False), force=motion)) as log:
        time, fused = joined(list(fuse(log, calibration(low_and_high()), "ranges")))
    error = fused[:, 0] / G - 0.3 * time * 1e-9 - bias_g
    assert np.abs(error).max() < 0.6 / 2048


def test_the_high_range_is_used_up_to_its_end() -> None:
    """There is no higher range: at 99 % of 16 g it is used alone."""
    axes = [*triad("LOW", "+X+Y+Z", (1.0, 1.0, 1.0), span=1.5), *triad("HIGH", "+X+Y+Z", (2.0, 2.0, 2.0), span=16.0)]
    values = np.tile([1.5, 0.0, 0.0, 15.84, 0.0, 0.0], (2, 1))
    assert TECHNIQUES["ranges"](axes)(at_once(values)).triad_box[0] == pytest.approx([15.84, 0.0, 0.0])


def test_sensors_of_a_single_range_are_not_faded() -> None:
    """A design with one range has no other range for a hand-over."""
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 1.0), span=10.0), *triad("B", "+X+Y+Z", (1.0, 1.0, 1.0), span=10.0)]
    fused = TECHNIQUES["ranges"](axes)(at_once(np.full((1, 6), 9.9))).triad_box
    assert fused == pytest.approx(np.full((1, 3), 9.9))


def pair(bandwidth_hz: float | None = 150.0) -> list[Axis]:
    """A sensor of 1.5 and one of 16, in g, with the noise of Table 10."""
    return [
        Axis(name, "bma180", index, tuple(row), span, noise, bandwidth_hz=bandwidth_hz)
        for name, span, noise in (("LOW", 1.5, LOW_G), ("HIGH", 16.0, HIGH_G))
        for index, row in enumerate(np.eye(3).tolist())
    ]


class Case(NamedTuple):
    """A motion of the box in g, with the frames of `pair` and the level of their blend (n, 3): the weighted mean of the
    readings of both ranges without noise, clipping or limits.
    """

    seconds: Floats
    frames: Frames
    level: Floats


def sensed(
    motion: Motion,
    seconds: float,
    seed: int,
    *,
    bias_g: float | Floats = BIAS_G,
    scale: float = SCALE,
    delay_s: float = DELAY_S,
) -> Case:
    """The readings of both ranges of a motion."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    truth, late = motion(time), (1 + scale) * motion(time - delay_s) + bias_g
    low = late + rng.normal(0, LOW_G, truth.shape)
    values = np.concatenate([np.clip(low, -1.5, 1.5), truth + rng.normal(0, HIGH_G, truth.shape)], axis=1)
    clipped = np.zeros(values.shape, np.int8)
    clipped[:, :3] = np.sign(low) * (np.abs(low) >= 1.5)
    valid = np.ones(values.shape, bool)
    valid[:, :3] = ~clipped.any(axis=1)[:, None]
    frames = Frames(np.round(time * 1e9).astype(np.int64), values, valid, clipped)
    return Case(time, frames, SHARE * late + (1 - SHARE) * truth)


def manoeuvre(seconds: Floats) -> Floats:
    """A sway by 0.5 g along X and Y for ten seconds, then 5 g along X and back within four seconds, then rest."""
    swaying, pull = seconds < 10, np.clip((seconds - 10) / 4, 0, 1)
    x = np.where(swaying, 0.5 * np.sin(2 * np.pi * seconds), 5 * np.sin(np.pi * pull) ** 2)
    y = np.where(swaying, 0.5 * np.sin(1.4 * np.pi * seconds), 0.0)
    return np.stack([x, y, np.ones_like(x)], axis=1)


def still_until_10(seconds: Floats) -> Floats:
    """The same without the swaying."""
    return np.where((seconds < 10)[:, None], [0.0, 0.0, 1.0], manoeuvre(seconds))


def error_g(case: Case, technique: Callable[[Frames], Estimate] | None = None) -> tuple[Floats, Estimate]:
    """Result minus the blend's level along X, and the result."""
    estimate = (technique or RangeBlend(pair()))(case.frames)
    return estimate.triad_box[:, 0] - case.level[:, 0], estimate


SEEDS = range(24)


@pytest.mark.slow
def test_no_step_across_a_manoeuvre_of_5_g() -> None:
    """The mean error before, at the top and after; and on either side of both hand-overs, where noise of half a second
    is 17.05 / sqrt 50 = 2.4 mg: not one of them shows a step as large as the noise of one reading, and 24 runs
    together less than a fifth of it. Untracked, the step would be 0.76 (50 mg + 2 % of 5 g), and is.
    """
    steps, tops = [], []
    for seed in SEEDS:
        case = sensed(manoeuvre, 18, seed)
        error, estimate = error_g(case)
        out = np.flatnonzero(~estimate.used[:, 0])
        begin, end = out[0], out[-1] + 1
        assert not (estimate.used & ~case.frames.valid).any()
        assert 300 > end - begin > 200
        means = [error[part].mean() for part in (slice(begin - 80, begin - 30), slice(begin, begin + 50))]
        means += [error[part].mean() for part in (slice(end - 50, end), slice(end + 30, end + 80))]
        steps.append([means[1] - means[0], means[2] - means[3]])
        tops.append(error[(case.seconds > 11.5) & (case.seconds < 12.5)].mean())
        assert abs(error[500:900].mean()) < 4 * BLEND_G / np.sqrt(400)
        assert abs(error[1500:].mean()) < 4 * BLEND_G / np.sqrt(300)
    assert np.abs(steps).max() < HIGH_G
    assert np.abs(np.mean(steps, axis=0)).max() < HIGH_G / 5
    assert np.abs(tops).max() < HIGH_G
    assert abs(np.mean(tops)) < HIGH_G / 5


def test_the_same_manoeuvre_without_tracking_has_a_step() -> None:
    """The test above can fail: 38 mg of bias at least, where nothing was learned (the manoeuvre is at the start)."""
    case = sensed(lambda seconds: manoeuvre(seconds + 10.5), 4, 1)
    error, estimate = error_g(case)
    assert error[(~estimate.used[:, 0]) & (case.seconds < 0.6)].mean() < -0.038


@pytest.mark.slow
def test_learning_at_rest_does_not_increase_errors_of_a_manoeuvre() -> None:
    """Rest determines the bias, not the scale: rms at 4 to 5 g compared with that of the uncorrected high range. For
    differences as large as the prior (1.5 g / 20, 1 %, 1.5 ms) much better, and equal without differences.
    """
    rng = np.random.default_rng(5)
    drawn = rng.normal(0, 1, (12, 3)) * [0.075, 0.01, 1.5e-3]
    for differences, allowed in ((drawn, 0.6), (np.zeros((6, 3)), 1.03)):
        squares = []
        for seed, (bias_g, scale, delay_s) in enumerate(differences):
            case = sensed(still_until_10, 15, seed, bias_g=bias_g, scale=scale, delay_s=delay_s)
            top = (case.seconds > 11.4) & (case.seconds < 12.6)
            plain = case.frames.values[top, 3] - case.level[top, 0]
            squares.append([np.mean(error_g(case)[0][top] ** 2), np.mean(plain**2)])
        tracked, plain_rms = np.sqrt(np.mean(squares, axis=0))
        assert tracked < allowed * plain_rms


def test_the_covariance_includes_the_uncertainty_of_the_corrections() -> None:
    """Before: 8.32 mg. Without the low range: its square is 17.05^2 and the uncertainty of the differences; the squared
    error over it is 1 in the mean of differences as large as the prior (12 of them: 0.4 to 2).
    """
    rng = np.random.default_rng(6)
    result = []
    for seed, (bias_g, scale, delay_s) in enumerate(rng.normal(0, 1, (12, 3)) * [0.075, 0.01, 1.5e-3]):
        case = sensed(still_until_10, 13, seed, bias_g=bias_g, scale=scale, delay_s=delay_s)
        error, estimate = error_g(case)
        assert estimate.covariance_box[500, 0] == pytest.approx(BLEND_G**2)
        out = ~estimate.used[:, 0]
        assert (estimate.covariance_box[out, 0] > HIGH_G**2).all()
        result.append(np.mean(error[out] ** 2 / estimate.covariance_box[out, 0]))
    assert 0.4 < np.mean(result) < 2


def test_uncertainty_grows_while_the_low_range_is_unused() -> None:
    """5 g for a minute and a half: the correction stays, its uncertainty grows."""
    case = sensed(lambda seconds: manoeuvre(np.minimum(seconds, 12)), 102, 11)
    error, estimate = error_g(case)
    begin, end = slice(1200, 2200), slice(9200, 10200)
    grown = estimate.covariance_box[end, 0].mean() - estimate.covariance_box[begin, 0].mean()
    assert 1e-6 < grown < 3 * HIGH_G**2
    assert error[end].mean() == pytest.approx(error[begin].mean(), abs=5 * HIGH_G / np.sqrt(500))


def test_the_bias_absorbs_a_scale_that_is_not_estimated() -> None:
    """Along Z, 1 g and a sway of 50 mg, which hardly determine a scale of 1 %: the reading at 1 g is still known within
    1.5 mg rms of 12 runs (the means of 200 readings scatter by 1.2 mg).
    """
    means = []
    for seed in range(12):

        def swaying(seconds: Floats) -> Floats:
            return manoeuvre(seconds) + np.outer(0.05 * np.sin(2 * np.pi * seconds) * (seconds < 10), [0, 0, 1])

        case = sensed(swaying, 14, seed, bias_g=0.0, scale=0.01, delay_s=0.0)
        estimate = RangeBlend(pair())(case.frames)
        means.append((estimate.triad_box[:, 2] - case.level[:, 2])[~estimate.used[:, 0]].mean())
    assert np.sqrt(np.mean(np.square(means))) < 1.5 * HIGH_G / np.sqrt(200)


def test_tracked_differences_equal_the_simulated_ones() -> None:
    """Low minus high along X within four standard errors, which are as small as twenty seconds of sway allow."""
    technique = RangeBlend(pair())
    technique(sensed(lambda seconds: manoeuvre(seconds % 10), 20, 2).frames)
    low, high = technique.tracker.relative()[0], technique.tracker.relative()[3]
    assert (low.label, high.label) == ("LOW x", "HIGH x")
    assert low.bias_si - high.bias_si == pytest.approx(BIAS_G, abs=4 * (low.bias_sem_si + high.bias_sem_si))
    assert low.scale - high.scale == pytest.approx(SCALE, abs=4 * (low.scale_sem + high.scale_sem))
    # The noise of the slope reduces a delay by up to a tenth.
    assert low.delay_s - high.delay_s == pytest.approx(DELAY_S, abs=1e-4 + 4 * (low.delay_sem_s + high.delay_sem_s))
    assert low.bias_sem_si + high.bias_sem_si < 1e-3
    assert low.scale_sem + high.scale_sem < 3e-3
    assert low.delay_sem_s + high.delay_sem_s < 6e-4


def test_rest_determines_the_bias_alone() -> None:
    technique = RangeBlend(pair())
    technique(sensed(nothing, 20, 3).frames)
    low, high = technique.tracker.relative()[0], technique.tracker.relative()[3]
    assert low.bias_si - high.bias_si == pytest.approx(BIAS_G, abs=4 * (low.bias_sem_si + high.bias_sem_si))
    assert (low.delay_s, high.delay_s) == (0.0, 0.0)
    assert (low.scale, high.scale) == (0.0, 0.0)


def test_a_slow_turn_determines_the_scale_and_no_delay() -> None:
    """0.28 g/s at most: the slope is below its noise, 0.6 g/s."""
    technique = RangeBlend(pair())
    technique(sensed(lambda seconds: np.outer(0.9 * np.sin(0.1 * np.pi * seconds), [1, 0, 0]), 40, 9).frames)
    low, high = technique.tracker.relative()[0], technique.tracker.relative()[3]
    assert (low.delay_s, high.delay_s) == (0.0, 0.0)
    assert low.scale - high.scale == pytest.approx(SCALE, abs=4 * (low.scale_sem + high.scale_sem))


@pytest.mark.slow
def test_a_delay_is_corrected_where_the_high_range_is_alone() -> None:
    """A low range 4 ms late: during the rise to 5 g, at 3 g/s, the blend is late by 0.76 of that, and the high range
    has the same delay. Without the correction: 9 mg.
    """
    result = []
    for seed in SEEDS:
        case = sensed(manoeuvre, 12, seed, bias_g=0.0, scale=0.0, delay_s=4e-3)
        error, _ = error_g(case, RangeBlend(pair(40.0)))
        result.append(error[1080:1160].mean())
    assert abs(np.mean(result)) < 3e-3


def test_a_drifting_difference_is_followed() -> None:
    """0.1 mg/s for 300 s: the estimate lags by the memory of 20 s, within its noise; no scale is estimated."""
    drift = 1e-4 * np.arange(30000)[:, None] / RATE_HZ
    technique = RangeBlend(pair())
    technique(sensed(nothing, 300, 4, bias_g=drift, scale=0.0, delay_s=0.0).frames)
    low, high = technique.tracker.relative()[0], technique.tracker.relative()[3]
    assert low.bias_si - high.bias_si == pytest.approx(0.03 - 1e-4 * 20, abs=2e-3)
    assert low.scale == high.scale == 0.0


def test_the_blend_of_all_ranges_is_not_changed_by_tracking() -> None:
    """Corrections cancel in the weighted mean: differences below a fiftieth of the noise."""
    case = sensed(lambda seconds: 0.2 * manoeuvre(seconds), 9, 5)
    values = case.frames.values
    plain = SHARE * values[:, :3] + (1 - SHARE) * values[:, 3:]
    estimate = RangeBlend(pair())(case.frames)
    assert estimate.used.all()
    assert np.abs(estimate.triad_box - plain).max() < BLEND_G / 50 * 4
    assert np.abs((estimate.triad_box - plain).mean(axis=0)).max() < BLEND_G / 1000


@pytest.mark.slow
def test_results_do_not_depend_on_blocks() -> None:
    """Any block limits: in the middle of segments, of the hand-over, of settling."""
    case = sensed(manoeuvre, 16, 6)
    whole = RangeBlend(pair(20.0))(case.frames)
    pieces, technique = [], RangeBlend(pair(20.0))
    cuts = [0, 1, 2, 63, 64, 65, 500, 1046, 1047, 1051, 1350, 1354, 1600]
    for first, last in pairwise(cuts):
        part = slice(first, last)
        time, values, valid = case.frames.time[part], case.frames.values[part], case.frames.valid[part]
        assert case.frames.clipped is not None
        pieces.append(technique(Frames(time, values, valid, case.frames.clipped[part])))
    for name in ("triad_box", "covariance_box", "used"):
        joined_up = np.concatenate([getattr(piece, name) for piece in pieces])
        assert joined_up == pytest.approx(getattr(whole, name), rel=1e-9, abs=1e-12)


def test_a_lost_reading_or_sensor_causes_no_step() -> None:
    """The low sensor has no reading in every tenth frame, and none from second 12 on: the high range
    keeps the level.
    """
    case = sensed(lambda seconds: manoeuvre(np.minimum(seconds, 9.75)), 20, 7)
    valid = case.frames.valid.copy()
    valid[::10, :3] = False
    valid[1200:, :3] = False
    error, estimate = error_g(case._replace(frames=Frames(case.frames.time, case.frames.values, valid)))
    assert (estimate.used == valid).all()
    assert abs(error[300:1200:10].mean()) < 5 * HIGH_G / np.sqrt(90)
    assert abs(error[1200:].mean()) < 5 * HIGH_G / np.sqrt(800)


def test_a_dead_high_sensor_does_not_stop_the_tracking() -> None:
    """Two high sensors, one of them without readings: the other is still compared with the low range."""
    third = [Axis("DEAD", "bma180", axis.index, axis.direction_box, 16.0, HIGH_G) for axis in pair()[3:]]
    technique = RangeBlend([*pair(), *third])
    case = sensed(lambda seconds: manoeuvre(seconds % 10), 20, 8)
    values = np.concatenate([case.frames.values, np.zeros((2000, 3))], axis=1)
    valid = np.concatenate([case.frames.valid, np.zeros((2000, 3), bool)], axis=1)
    technique(Frames(case.frames.time, values, valid))
    result = technique.tracker.relative()
    assert result[0].bias_si - result[3].bias_si == pytest.approx(BIAS_G, abs=4e-3)
    assert result[0].scale - result[3].scale == pytest.approx(SCALE, abs=4e-3)
    assert (result[6].bias_si, result[6].scale) == (0.0, 0.0)


def test_a_sensor_that_fails_keeps_its_share_of_the_level() -> None:
    """A second high sensor with an error of 60 mg has 0.19 of the level; after its loss the others stay at the level,
    and do not return by 11.5 mg within the memory of the tracker.
    """
    third = [Axis("DIES", "bma180", axis.index, axis.direction_box, 16.0, HIGH_G) for axis in pair()[3:]]
    case = sensed(nothing, 80, 10, bias_g=0.0)
    off = np.random.default_rng(3).normal(0.06, HIGH_G, (8000, 3))
    valid = np.ones((8000, 9), bool)
    valid[2000:, 6:] = False
    values = np.concatenate([case.frames.values, off], axis=1)
    fused = RangeBlend([*pair(), *third])(Frames(case.frames.time, values, valid)).triad_box
    level_g = 0.06 * HIGH_G**-2 / (LOW_G**-2 + 2 * HIGH_G**-2)
    assert fused[1000:2000].mean() == pytest.approx(level_g, abs=5e-4)
    assert fused[7000:].mean() == pytest.approx(level_g, abs=1.2e-3)


def filtered(signal: Floats, bandwidth_hz: float, rate_hz: float) -> Floats:
    """A second-order low-pass of a chip."""
    return np.asarray(sosfilt(butter(2, bandwidth_hz, fs=rate_hz, output="sos"), signal))


def back_from_5_g(bandwidth_hz: float, inside: int = 20) -> tuple[Floats, Frames]:
    """Along X: the force after the chips' low-pass, and frames of 400 Hz of both ranges without noise: 5 g that end
    within 2 ms. The low range clips before its low-pass, whose output is inside the range long before it is right.
    """
    rate_hz = 400.0 * inside
    seconds = np.arange(round(2 * rate_hz)) / rate_hz
    felt = 5 * np.clip((1.0 - seconds) / 2e-3, 0, 1) * np.clip(seconds / 0.4, 0, 1)
    low, high = (filtered(np.clip(felt, -end, end), bandwidth_hz, rate_hz)[::inside] for end in (1.5, 16.0))
    values = np.zeros((len(low), 6))
    values[:, 0], values[:, 3] = np.minimum(low, 1.5), high
    valid = np.ones(values.shape, bool)
    valid[:, :3] = (low < 1.4999)[:, None]
    clipped = np.zeros(values.shape, np.int8)
    clipped[:, 0] = low >= 1.4999
    return high, Frames((np.arange(len(low)) * 2_500_000).astype(np.int64), values, valid, clipped)


@pytest.mark.parametrize("bandwidth_hz", [10.0, 20.0, 40.0])
def test_a_low_range_stays_out_until_its_filter_has_settled(bandwidth_hz: float) -> None:
    """The transient of the low-pass after the clipped 3.5 g stays below a tenth of the noise of a reading."""
    high, frames = back_from_5_g(bandwidth_hz)
    estimate = RangeBlend(pair(bandwidth_hz))(frames)
    after = np.flatnonzero(frames.time > 1_000_000_000)
    wrong = np.abs(frames.values[after, 0] - high[after])
    assert wrong[frames.valid[after, 0]].max() > 0.3  # inside its range again and far from right
    assert np.abs(estimate.triad_box[after, 0] - high[after]).max() < SETTLED * LOW_G
    back = after[np.argmax(estimate.used[after, 0])]
    assert 1.0 < frames.time[back] * 1e-9 < 1.0 + 2.5 / bandwidth_hz + 0.02


def test_the_low_range_returns_smoothly() -> None:
    """The weight of the low range rises from nothing, to the whole within the settling time, without a step."""
    _, frames = back_from_5_g(20.0)
    share = Fading(pair(20.0))(frames, np.full((len(frames.time), 6), np.nan))
    assert (share[:, 3:] == 1).all()
    after = share[frames.time > 1_000_000_000, 0]
    begin, end = np.argmax(after > 0), np.argmax(after == 1)
    settling = settling_s(20.0, 14.5, LOW_G)
    assert (end - begin) / 400 == pytest.approx(settling, abs=0.005)
    assert 1 + settling < frames.time[len(share) - len(after) + begin] * 1e-9 < 1 + settling + 0.025
    # A smooth cubic is nowhere steeper than 1.5 times the average.
    assert np.diff(after).max() < 1.6 / (end - begin)
    assert (np.diff(after) >= 0).all()


def test_the_settling_time_is_that_of_a_second_order_low_pass() -> None:
    """``14.5 g exp(-sqrt(2) pi 150 Hz t) = 0.953 mg``: t = 14.4 ms. A bandwidth that isn't known is a slow one."""
    assert settling_s(150.0, 14.5, LOW_G) == pytest.approx(14.45e-3, abs=5e-5)
    assert settling_s(None, 14.5, LOW_G) == pytest.approx(15 * settling_s(150.0, 14.5, LOW_G))


def test_a_spike_beyond_the_low_range_excludes_it() -> None:
    """A spike of 3 g that the slower low sensor reads as 0.5 g: the high sensor detects it. The next frame is 5 ms
    after the middle between the two, the following 15 ms, when the settling time of 14.4 ms has passed.
    """
    values = np.zeros((40, 6))
    values[10, [0, 3]] = 0.5, 3.0
    estimate = RangeBlend(pair())(at_once(values))
    assert estimate.triad_box[10, 0] == pytest.approx(3.0)
    assert np.flatnonzero(~estimate.used[:, 0]).tolist() == [10, 11]


def test_axes_that_do_not_span_space_have_no_blend() -> None:
    """Two triads: any six, five, ... axes have a blend if X, Y and Z are among them; two of them, or none, do not."""
    blends = Blends(np.concatenate([np.eye(3)] * 2), np.ones(6), np.ones(6))
    for present, spans in (("111111", True), ("110001", True), ("110110", False), ("000001", False), ("000000", False)):
        blend = blends.of(np.array([sign == "1" for sign in present]))
        assert (blend is not None) == spans
