"""The effect of a change on a unit's statistics, on replicates made by hand and on simulated ones."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.inference.unit_state import LOOKS, NUMBERS, REPLICATES, counts_of, gains_of, update_likelihood
from imuarray.gap.model.replication import SensorModel
from imuarray.gap.statistics.synthetic_likelihood import FORM, FREEDOM, SyntheticLikelihood
from imuarray.log.format import SensorHeader
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.effects.readings import ChannelSwap
from imuarray.simulate.effects.response import Scale
from tests.gap.unit_states import FITTED, drawn, standing

NAN = math.nan
LINE, OTHER = Tone(1.0, 5.0), Tone(1.0, 9.0)


def test_first_evaluations_use_a_part_of_the_replicates() -> None:
    assert len(NUMBERS) == REPLICATES
    assert 2 <= LOOKS < REPLICATES


def test_a_trial_changes_every_sensor_or_the_named_one() -> None:
    models = {"G1": SensorModel(FITTED, (LINE, Bias(0.5))), "G2": SensorModel(FITTED)}
    unit = standing([0.0], drawn(1), models=models)
    added = unit.changed(Hypothesis((OTHER,)))
    assert [model.added for model in added.values()] == [(LINE, Bias(0.5), OTHER), (OTHER,)]
    own = unit.changed(Hypothesis((OTHER,), sensor="G2"))
    assert [model.added for model in own.values()] == [(LINE, Bias(0.5)), (OTHER,)]
    assert all(not model.removed for model in own.values())


def test_the_other_sensor_has_the_opposite_exchange() -> None:
    """Two of three are exchanged."""
    models = {name: SensorModel(FITTED) for name in ("G1", "G2", "G3")}
    one, other = ChannelSwap("G3", "place"), ChannelSwap("G1", "place")
    changed = standing([0.0], drawn(1), models=models).changed(
        Hypothesis((one,), sensor="G1", others=("G3",), opposite=(other,))
    )
    assert [model.added for model in changed.values()] == [(one,), (), (other,)]


def test_a_removed_effect_is_removed_from_added_and_base_effects() -> None:
    """From the added effects and from those of the base model; a replacement is appended."""
    unit = standing([0.0], drawn(1), models={"G1": SensorModel(FITTED, (LINE, Bias(0.5)), frozenset({"scale"}))})
    (model,) = unit.changed(Hypothesis((OTHER,), removed="tone")).values()
    assert model == SensorModel(FITTED, (Bias(0.5), OTHER), frozenset({"scale", "tone"}))
    (bare,) = unit.changed(Hypothesis((), removed="tone")).values()
    assert bare == SensorModel(FITTED, (Bias(0.5),), frozenset({"scale", "tone"}))


def test_ordinary_parameters_are_adapted_to_the_recording() -> None:
    """The fits of replicates have an offset 0.5 larger than that of the recording: it is subtracted. A sensor with the
    data of another keeps its own.
    """
    models = {"G1": SensorModel(FITTED), "G2": SensorModel(FITTED, (ChannelSwap("G1"),))}
    unit = standing([0.0], drawn(1), models=models)
    came = [dict.fromkeys(models, replace(FITTED, offset=(1.5 + bias, 2.0, 3.0))) for bias in (-0.1, 0.1)]
    found = unit.settled({"G1": replace(models["G1"], added=(Scale(0.1),)), "G2": models["G2"]}, came)
    np.testing.assert_allclose(found["G1"].fitted.offset, [0.5, 2.0, 3.0])
    np.testing.assert_allclose(found["G1"].fitted.rms, FITTED.rms)
    assert found["G1"].added == (Scale(0.1),)
    assert found["G2"] == models["G2"]


@given(st.integers(2, REPLICATES), st.floats(-50, 50))
def test_a_shift_moves_the_middle_and_not_the_scatter(count: int, shift: float) -> None:
    """Draws are the same with and without the change, so that two replicates determine it exactly."""
    without = drawn(3)
    likelihood, moved = update_likelihood(
        standing([0.0] * 3, without), without[:count] + np.array([shift, 0.0, -shift])
    )
    np.testing.assert_allclose(moved, [shift, 0.0, -shift], atol=1e-9)
    np.testing.assert_allclose(likelihood.location, moved, atol=1e-9)
    np.testing.assert_allclose(likelihood.scale, 1.0, rtol=1e-6)
    assert likelihood.always.all()
    assert not likelihood.never.any()


@given(st.floats(0.05, 20))
def test_a_scaled_scatter_is_estimated(factor: float) -> None:
    """All replicates are the same draws, so that the ratio is exact for any number."""
    without = drawn(4, seed=2)
    likelihood, _ = update_likelihood(standing([0.0] * 4, without), factor * without)
    np.testing.assert_allclose(likelihood.scale, factor, rtol=1e-3)


def test_a_statistic_without_scatter_has_its_new_location() -> None:
    """A change that removes the scatter: the previous location of the replicates, by chance a third of a standard
    deviation away, does not determine the new one. Unchanged statistics keep their location.
    """
    without = drawn(2) + np.array([2.0, 2.0])
    after = np.column_stack([3.0 + 1e-4 * drawn(1, seed=2)[:, 0], without[:, 1]])
    likelihood, _ = update_likelihood(standing([3.0, 0.0], without), after)
    assert likelihood.location[0] == pytest.approx(3.0, abs=1e-3)
    assert likelihood.location[1] == pytest.approx(0.0, abs=1e-9)
    # of the previous scatter: the form of the model limits the precision
    assert likelihood.scale[0] == pytest.approx(0.05)


def test_a_scatter_of_different_draws_is_shrunk() -> None:
    """200 statistics of new draws with the same scatter: the log of the ratio of two standard deviations of 16 has one
    of sqrt(2 / 30) = 0.26; shrunk by its own uncertainty it is a third of that or less in the middle.
    """
    without, anew = drawn(200, 3), drawn(200, 4)
    likelihood, _ = update_likelihood(standing([0.0] * 200, without), anew)
    assert np.median(np.abs(np.log(likelihood.scale))) < 0.26 / 3
    wider, _ = update_likelihood(standing([0.0] * 200, without), 10 * anew)
    assert np.median(wider.scale) == pytest.approx(10, rel=0.15)


def test_two_replicates_only_widen_the_scatter() -> None:
    """By the scatter of the changes: +3 and -3."""
    without = drawn(1)
    likelihood, moved = update_likelihood(standing([0.0], without), without[:2] + np.array([[3.0], [-3.0]]))
    assert moved[0] == pytest.approx(0.0, abs=1e-12)
    assert likelihood.scale[0] >= math.hypot(1, 3) * (1 - 1e-9)


def test_a_single_pair_does_not_change_the_scatter() -> None:
    """One of two replicates with the change has no value: the scatter is unchanged."""
    unit = standing([0.0], drawn(1))
    likelihood, moved = update_likelihood(unit, np.array([unit.values[0] + 3.0, [NAN]]))
    assert moved[0] == pytest.approx(3.0)
    assert likelihood.scale[0] == pytest.approx(1.0)


def test_the_form_of_an_event_limits_the_precision() -> None:
    """A statistic that is nearly the same in all replicates, since the event exceeds the noise, has an error of a
    twentieth.
    """
    without = drawn(2)
    likelihood, _ = update_likelihood(standing([0.0] * 2, without), 7 + 1e-3 * without)
    np.testing.assert_allclose(likelihood.location, 7.0, atol=0.01)
    np.testing.assert_allclose(likelihood.scale, 0.05, rtol=1e-6)


def test_a_statistic_that_exists_only_after_the_change() -> None:
    """It exists in all replicates now, near their values, with an error of at least a tenth of its size."""
    nothing = np.full((REPLICATES, 1), NAN)
    never = SyntheticLikelihood(np.array([NAN]), np.array([NAN]), np.array([False]), np.array([True]))
    unit = standing([20.0], nothing, never)
    likelihood, moved = update_likelihood(unit, np.array([[20.01], [19.99]]))
    assert likelihood.location[0] == pytest.approx(20.0)
    assert likelihood.scale[0] == pytest.approx(2.1)
    assert (likelihood.always[0], likelihood.never[0]) == (True, False)
    assert gains_of(unit, likelihood, moved).sum() > 10  # the recording has a value too


def test_a_statistic_missing_in_the_recording_gains_nothing() -> None:
    """A missing value is no evidence: neither for a model that has it nor for one that lacks it."""
    unit = standing([NAN], drawn(1))
    likelihood, moved = update_likelihood(unit, np.full((REPLICATES, 1), NAN))
    assert np.isnan(likelihood.location[0])
    assert not likelihood.always[0]
    assert gains_of(unit, likelihood, moved).sum() == 0.0


def test_an_uncorrelated_statistic_has_its_full_gain() -> None:
    """Ten identical statistics and an independent one: the gain of the latter is complete."""
    unit = standing([3.0] * 11, drawn(11), independent=0.1)
    likelihood, moved = update_likelihood(unit, unit.values + 3.0)
    by_axis = gains_of(unit, likelihood, moved)
    apart = gains_of(replace(unit, separate_share=np.append(np.zeros(10), 1.0)), likelihood, moved)
    np.testing.assert_allclose(apart[:10], by_axis[:10])
    assert apart[10] == pytest.approx(10 * by_axis[10])


def test_statistics_that_are_not_simulated_are_unchanged() -> None:
    """Statistics relative to other sensors are in the recording and in replicates of the whole array, not in those of
    the unit alone, with or without the change: they stay the same.
    """
    unit = standing([1.0, 1.0], drawn(2))
    unit.values[:, 1] = NAN
    after = unit.values + np.array([1.0, 0.0])
    likelihood, moved = update_likelihood(unit, after)
    assert (likelihood.location[1], likelihood.scale[1], moved[1]) == (0.0, 1.0, 0.0)
    assert (bool(likelihood.always[1]), bool(likelihood.never[1])) == (True, False)
    gains = gains_of(unit, likelihood, moved)
    assert gains[0] > 0
    assert gains[1] == pytest.approx(0.0, abs=1e-9)


def test_a_missing_value_of_a_model_is_not_better() -> None:
    """The recording has 5, the model 0: a change after which there is no value is not better."""
    unit = standing([5.0], drawn(1))
    likelihood, moved = update_likelihood(unit, np.full((REPLICATES, 1), NAN))
    assert gains_of(unit, likelihood, moved).sum() <= 0


def test_a_statistic_that_a_change_makes_constant() -> None:
    """Like the difference of two sensors, one of which has the other's readings: 0 in all replicates and in the
    recording, except for rounding.
    """
    unit = standing([0.0], drawn(1))
    likelihood, moved = update_likelihood(unit, 1e-16 * drawn(1, seed=2))
    assert abs(likelihood.scores(unit.real)[0]) < 1
    assert gains_of(unit, likelihood, moved).sum() > -0.1


@given(st.floats(-30, 30), st.floats(-30, 30), st.floats(0.05, 1.0))
def test_a_gain_is_a_ratio_of_densities(real: float, shift: float, independent: float) -> None:
    """Densities of the t distribution, tempered by the independent share; the shift has a proportional error."""
    unit = standing([real, 0.0], drawn(2), independent=independent)
    likelihood, moved = update_likelihood(unit, unit.values + np.array([shift, 0.0]))
    width = math.hypot(1.0, FORM * shift)
    expected = stats.t.logpdf(real, FREEDOM, shift, width) - stats.t.logpdf(real, FREEDOM)
    assert gains_of(unit, likelihood, moved).sum() == pytest.approx(independent * expected, abs=1e-6)
    assert gains_of(unit, likelihood, moved)[1] == pytest.approx(0.0, abs=1e-6)


def test_no_change_has_no_gain() -> None:
    unit = standing([1.0, -3.0, NAN], drawn(3))
    likelihood, moved = update_likelihood(unit, unit.values)
    assert gains_of(unit, likelihood, moved).sum() == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(likelihood.scores(unit.real), unit.scores)


def test_different_draws_are_not_a_shift() -> None:
    """300 statistics of one probe with new draws, which differ by sqrt(2 / 8) from the previous ones, and 300 of
    another probe that move by 0.4: the apparent shift of the first is treated as chance, and the second keep their
    shift.
    """
    without, anew = drawn(600, 3), drawn(600, 4)
    anew[:, 300:] = without[:, 300:] + 0.4
    unit = standing([0.0] * 600, without)
    _, all_moved = update_likelihood(unit, anew)
    assert all_moved[:300].std() == pytest.approx(0.5, rel=0.15)
    likelihood, moved = update_likelihood(replace(unit, probes=np.repeat([0, 1], 300)), anew)
    assert moved[:300].std() < 0.15
    np.testing.assert_allclose(moved[300:], 0.4, rtol=1e-9)
    assert likelihood.branches is not None
    np.testing.assert_allclose(likelihood.branches[0, 300:], 0.4, rtol=1e-9)


def test_a_scatter_is_estimated_from_all_similar_statistics() -> None:
    """Moved by draws of ten standard deviations, which two draws determine poorly (the lower quartile of the root of
    chi-squared with one degree of freedom is 0.32): 200 similar statistics determine it within a third, without an
    effect on others that all move by 0.1.
    """
    without = drawn(400, 3)
    walked = without[:2] + drawn(400, 4, rows=2) * np.repeat([10.0, 0.1], 200)
    unit = standing([0.0] * 400, without)
    alone, _ = update_likelihood(unit, walked)
    assert np.quantile(alone.scale[:200], 0.25) == pytest.approx(3.2, abs=1.0)
    together, _ = update_likelihood(replace(unit, scatter_group=np.repeat([0, 1], 200)), walked)
    assert np.quantile(together.scale[:200], 0.25) > 8
    assert np.quantile(together.scale[:200], 0.75) < 13
    np.testing.assert_allclose(together.scale[200:], 1.0, rtol=1e-6)


def test_constant_statistics_do_not_affect_moving_ones() -> None:
    """Half of the similar statistics are of the part that is not simulated."""
    without = drawn(400, 3)
    walked = without[:2].copy()
    walked[:, :200] += 10 * drawn(200, 4, rows=2)
    together, _ = update_likelihood(replace(standing([0.0] * 400, without), scatter_group=np.zeros(400, int)), walked)
    assert np.median(together.scale[:200]) > 8
    np.testing.assert_allclose(together.scale[200:], 1.0)


@pytest.mark.parametrize("count", [LOOKS, REPLICATES])
def test_the_shift_by_an_earlier_effect_is_kept(count: int) -> None:
    """To 0 or to 10, by the boot; a later change that does nothing to it makes no reading likelier or less likely."""
    without = drawn(1, 5)
    states = without + np.array([0.0, 10.0] * (REPLICATES // 2))[:, None]
    unit = standing([10.0], without)
    first, _ = update_likelihood(unit, states)
    after = replace(unit, likelihood=first, values=states)
    likelihood, moved = update_likelihood(after, states[:count].copy())
    np.testing.assert_allclose(gains_of(after, likelihood, moved), 0.0, atol=1e-6)
    later, moved = update_likelihood(after, states[:count] + 1.0)
    assert gains_of(replace(after, real=np.array([11.0])), later, moved) > 0.1


def test_the_cost_of_a_change_of_noise() -> None:
    """By a t distribution of 5 % of the noise, for each axis; rounding is negligible."""
    unit = standing([0.0], drawn(1))
    header = SensorHeader("G1", "l3g4200d", "angular_rate", "dps", 250.0, 1e6)
    assert unit.misfit_of({"G1": header}, [{"G1": FITTED}] * 3) == pytest.approx(0.0, abs=1e-9)
    came = [{"G1": replace(FITTED, rms=(0.1, 0.1 * math.exp(factor), 0.1))} for factor in (0.2, 0.2)]
    expected = stats.t.logpdf(0, FREEDOM) - stats.t.logpdf(4.0, FREEDOM)
    assert unit.misfit_of({"G1": header}, came) == pytest.approx(expected, rel=1e-3)


def test_gains_of_less_correlated_statistics_have_more_weight() -> None:
    """Ninety identical statistics and three independent ones: a gain of these three is weighted by their independence,
    a gain of the ninety is not, and neither is a gain without statistics.
    """
    alone = drawn(3, 2, rows=4) @ np.ones((3, 1))
    own = np.concatenate([np.eye(3), -np.eye(3), np.zeros((REPLICATES - 6, 3))])  # without any correlation
    values = np.concatenate([np.repeat(np.resize(alone, (REPLICATES, 1)), 90, axis=1), own], axis=1)
    unit = standing([0.0] * 93, values, independent=0.25)
    moved = np.zeros(93)
    assert counts_of(unit, unit.likelihood, moved) == 1.0
    moved[90:] = 9.0
    assert counts_of(unit, unit.likelihood, moved) == pytest.approx(4.0)
    assert counts_of(unit, unit.likelihood, 9.0 - moved) == 1.0
    few = replace(unit, values=values[:LOOKS])  # which do not determine the correlation
    assert counts_of(few, unit.likelihood, moved) == 1.0
