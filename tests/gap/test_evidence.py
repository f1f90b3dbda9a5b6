"""Evidence of a sensor from scores made by hand, and from a recording."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imuarray.gap.inference.evidence import PhaseEvidence, ScoredStatistics, evidence_of
from imuarray.gap.model.rest import FittedParameters
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.motion.faces import turn_on_run
from tests.gap.search_inputs import evidence
from tests.gap.small_bench import LINE, prepared, static
from tests.gap.small_campaign import block, gaussian, summary

NAN = math.nan


def test_the_score_farthest_from_zero_is_returned() -> None:
    """By axis, over rows and probes; that of a whole sensor is used for each axis."""
    made = evidence({"line": [[1.0, -4.0, NAN], [2.0, 3.0, NAN]], "repeats": [[-2.5]], "silent": [[NAN] * 3]})
    np.testing.assert_array_equal(made.score("line"), [2.0, -4.0, 0.0])
    np.testing.assert_array_equal(made.score("line", "repeats"), [-2.5, -4.0, -2.5])
    np.testing.assert_array_equal(made.score("repeats", "no such probe"), [-2.5] * 3)
    np.testing.assert_array_equal(made.score("silent"), 0.0)
    np.testing.assert_array_equal(made.score("no such probe"), 0.0)


def test_a_deviation_on_any_axis_is_odd() -> None:
    made = evidence({"line": [[1.0, -4.0, NAN]], "repeats": [[3.0]]})
    assert made.is_odd("line")
    assert not made.is_odd("line", beyond=4.0)
    assert not made.is_odd("repeats")
    assert not made.is_odd("no such probe")


def test_shifts_of_the_worst_and_of_the_typical_row() -> None:
    """Scores times their scale; a row without an axis is not a typical row."""
    made = evidence({"mean": [[1.0, -4.0, NAN], [2.0, 3.0, 1.0], [4.0, 9.0, 3.0]], "repeats": [[2.0], [NAN], [-6.0]]})
    np.testing.assert_allclose(made.shift("mean"), [2.0, 4.5, 1.5])
    np.testing.assert_allclose(made.typical("mean"), [1.5, 3.0, 1.0])
    np.testing.assert_allclose(made.shift("repeats"), -3.0)
    np.testing.assert_allclose(made.typical("repeats"), -1.0)
    for nothing in (made.shift("no such probe"), made.typical("no such probe")):
        np.testing.assert_array_equal(nothing, 0.0)


def test_the_rate_is_the_median_over_phases() -> None:
    """Phases of 100, 100 and 20 rows/s; without a phase the rate of the sensor."""
    rows = [summary(block(gaussian(rows=100), interval_ns)) for interval_ns in (10**7, 10**7, 5 * 10**7)]
    seen = [PhaseEvidence(0, "static", True, one, one, None) for one in rows]
    assert evidence({}, seen=seen).rows_per_s == pytest.approx(100.0)
    assert evidence({}).rows_per_s == 1.0


def test_noise_includes_rounding() -> None:
    """2048 counts/g: a step's variance is 1 / (12 x 2048^2)."""
    np.testing.assert_allclose(evidence({}).noise, np.sqrt(np.array([1e-4, 1e-4, 4e-4]) + 1 / (12 * 2048**2)))


def test_evidence_of_a_recording_is_of_the_training_half() -> None:
    """The training half alone: as many rows of each probe as it has phases; residuals have no level."""
    bench, campaign = static(LINE)
    train = bench.split.train(campaign)
    number = np.arange(bench.of_train, dtype=float)
    keys, parts = bench.keys[: bench.of_train], [False] * bench.of_train
    scored = ScoredStatistics(keys, parts, number, number - 1, number * 2)
    found = evidence_of(bench, train, "G1", scored, bench.models()["G1"], (LINE,))
    assert (found.header.name, found.effects, found.runs, found.others) == ("G1", (LINE,), None, ())
    (seen,) = found.phases
    assert seen.is_still
    assert found.still == found.phases
    assert seen.raw.rows == pytest.approx(1000, abs=2)
    assert np.average(seen.residual.segments.mean, axis=0) == pytest.approx([0.0] * 3, abs=0.05)
    assert found.rows_per_s == pytest.approx(100.0, rel=1e-3)
    for at, key in enumerate(keys):
        place = max("xyz".find(key.axis), 0)
        assert found.values[key.probe][0, place] == at
        assert found.expected[key.probe][0, place] == at - 1
        assert found.scores[key.probe][0, place] == 2 * at
        assert found.values[key.probe].shape == (1, 3 if key.axis else 1)


def test_levels_are_relative_to_the_present_model() -> None:
    """A model with 0.1 dps more on x gives residuals 0.1 dps lower; sensors of the same quantity are named, runs
    counted.
    """
    motions = [turn_on_run(run, 4.0) for run in range(1, 13)]
    bench, campaign = prepared([("turn-on", motion) for motion in motions], ["G1", "G2", "A1"])
    train = bench.split.train(campaign)
    model = bench.models()["G1"]
    x, y, z = model.fitted.offset
    shifted = type(model)(FittedParameters(model.fitted.rms, (x + 0.1, y, z), model.fitted.slope), (Bias(),))
    nothing = ScoredStatistics((), (), np.zeros(0), np.zeros(0), np.zeros(0))
    one, other = (evidence_of(bench, train, "G1", nothing, each, ()) for each in (model, shifted))
    assert [item.name for item in one.others] == ["G2"]
    assert [seen.log for seen in one.phases] == [0, 2, 4, 6, 8, 10]  # boots of the campaign
    assert one.runs is not None
    assert one.runs.means.shape == (6, 3)
    for before, after in zip(one.phases, other.phases, strict=True):
        apart = (after.residual.segments.mean - before.residual.segments.mean) / one.header.sensitivity
        np.testing.assert_allclose(np.average(apart, axis=0), [-0.1, 0.0, 0.0], atol=1e-9)
        np.testing.assert_array_equal(after.raw.segments.mean, before.raw.segments.mean)
