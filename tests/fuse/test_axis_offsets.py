"""Frames that lack a reading: the mean of an array whose sensors have different biases keeps its level."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from imuarray.fuse import Frames, fuse
from imuarray.fuse.least_squares import FixedWeights
from imuarray.fuse.stream import RECENT, AxisOffsets
from imuarray.fuse.techniques import TECHNIQUES
from imuarray.log import open_log
from tests.fuse.arrays import triad
from tests.fuse.conftest import DPS, Floats, Part, WriteRun, calibration, joined, nothing
from tests.selection import some

BIASES = np.random.default_rng(8).normal(0.0, 0.2, (8, 3))
ROWS = np.tile(np.eye(3), (8, 1))
WEIGHTS = np.repeat([1.0, 2.0, 3.0, 4.0, 1.0, 2.0, 3.0, 4.0], 3)


def frames(count: int = 200, seed: int = 1) -> Frames:
    """A changing rate, and eight triads along the box with one bias each."""
    truth = np.random.default_rng(seed).normal(0.0, 1.0, (count, 1, 3))
    values = (truth + BIASES).reshape(count, 24)
    return Frames(np.arange(count, dtype=np.int64) * 10_000_000, values, np.ones(values.shape, bool))


def lacking(whole: Frames, sensor: int, rows: slice) -> Frames:
    """The frames, some of them without the readings of a sensor; the values in their place must have no effect."""
    whole.valid[rows, 3 * sensor : 3 * sensor + 3] = False
    whole.values[rows, 3 * sensor : 3 * sensor + 3] = 1e3
    return whole


def fused(technique: FixedWeights, *blocks: Frames) -> Floats:
    offsets = AxisOffsets(ROWS)
    return np.concatenate([technique(offsets(block)).triad_box for block in blocks])


@pytest.mark.parametrize("weights", [np.ones(24), WEIGHTS])
def test_a_frame_without_a_sensor_keeps_the_weighted_mean_of_all_biases(weights: Floats) -> None:
    technique = FixedWeights(ROWS, weights, np.ones(24))
    part = lacking(lacking(frames(), 2, slice(100, 101)), 7, slice(150, 150 + RECENT))
    truth = np.random.default_rng(1).normal(0.0, 1.0, (200, 3))
    mean_bias = weights[::3] @ BIASES / weights[::3].sum()
    assert fused(technique, part) == pytest.approx(truth + mean_bias, abs=1e-12)


def test_a_lost_sensor_changes_the_mean_by_its_share() -> None:
    """From frame `RECENT` after its loss on: bias minus mean, over the seven remaining sensors."""
    step = fused(FixedWeights(ROWS, np.ones(24), np.ones(24)), lacking(frames(), 2, slice(100, 200)))
    truth = np.random.default_rng(1).normal(0.0, 1.0, (200, 3))
    level = np.where(np.arange(200)[:, None] < 100 + RECENT, 0.0, (BIASES.mean(axis=0) - BIASES[2]) / 7)
    assert step == pytest.approx(truth + BIASES.mean(axis=0) + level, abs=1e-12)


def test_an_excluded_sensor_removes_its_bias_from_the_mean() -> None:
    """A fault monitor after the alignment excludes sensor 5; then a frame without sensor 2 has the mean of seven."""
    part = AxisOffsets(ROWS)(lacking(frames(), 2, slice(100, 101)))
    excluded = np.zeros(part.valid.shape, bool)
    excluded[:, 15:18] = True
    result = FixedWeights(ROWS, np.ones(24), np.ones(24))(part.without(excluded)).triad_box
    truth = np.random.default_rng(1).normal(0.0, 1.0, (200, 3))
    assert result == pytest.approx(truth + np.delete(BIASES, 5, axis=0).mean(axis=0), abs=1e-12)


def test_blocks_do_not_change_offsets_and_unknown_offsets_are_ignored() -> None:
    technique = FixedWeights(ROWS, np.ones(24), np.ones(24))
    part = lacking(frames(), 2, slice(100, 110))
    cuts = [0, 1, 90, 105, 108, 200]
    pieces = [part.part(slice(*pair)) for pair in itertools.pairwise(cuts)]
    assert fused(technique, *pieces) == pytest.approx(fused(technique, part), abs=1e-12)
    assert AxisOffsets(ROWS)(lacking(frames(), 2, slice(0, 200))).offsets is None
    clipped = lacking(frames(), 2, slice(100, 101))
    ends = np.zeros(clipped.valid.shape, np.int8)
    ends[100, 6] = 1
    assert AxisOffsets(ROWS)(Frames(clipped.time, clipped.values, clipped.valid, ends)).offsets is None


@pytest.mark.slow
@pytest.mark.parametrize("technique", some([name for name in TECHNIQUES if name != "opposed"], 1))
def test_a_slow_oscillator_causes_no_steps_in_the_fused_log(write_run: WriteRun, technique: str) -> None:
    """Eight gyroscopes at rest with one bias each, in whole counts; each of them misses one frame of fifty. Every fused
    frame is the mean of the biases, whether it was combined directly or not.
    """
    counts = np.arange(-4.0, 4.0) * 37
    parts = [
        Part(
            f"G{i}",
            "+X+Y+Z",
            "angular_rate",
            "l3g4200d",
            250.0,
            100.0,
            sigma=0.0,
            error=lambda seconds, bias=bias: np.full((len(seconds), 3), bias / 100.0),
            lost=lambda seconds, i=i: np.round(seconds * 100 + 3 * i) % 50 == 49,
        )
        for i, bias in enumerate(counts)
    ]
    known = calibration([part._replace(sigma=0.1) for part in parts])
    with open_log(write_run(parts, rate=nothing, frames=600)) as log:
        time, result = joined(list(fuse(log, known, technique, block=97)), "angular_rate")
    assert len(time) == 600
    late = np.flatnonzero(time > 20 * 10_000_000)  # a first frame that lacks a reading has no earlier frame
    assert result[late] / DPS == pytest.approx(np.full((len(late), 3), counts.mean() / 100.0), abs=1e-9)


def test_axes_of_six_directions_keep_the_level() -> None:
    """Least squares of triads in six orientations: the level of all is kept."""
    axes = ("+X+Y+Z", "-Y-X-Z", "+Y+X-Z", "+Y-X+Z", "+Y+Z+X", "-X-Y+Z")
    rows = np.array([axis.direction_box for i, way in enumerate(axes) for axis in triad(f"A{i}", way, None)])
    bias = np.random.default_rng(4).normal(0.0, 0.1, 18)
    truth = np.random.default_rng(5).normal(0.0, 1.0, (100, 3))
    values = truth @ rows.T + bias
    valid = np.ones(values.shape, bool)
    valid[60:63, 3:6] = valid[62:66, 9:12] = False
    part = AxisOffsets(rows)(Frames(np.arange(100, dtype=np.int64) * 10_000_000, values, valid))
    result = FixedWeights(rows, np.ones(18), np.ones(18))(part).triad_box
    assert result == pytest.approx(truth + bias @ rows / 6, abs=1e-12)
