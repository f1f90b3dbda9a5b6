"""What a change makes of a unit's statistics, on replicates made by hand and on simulated ones."""

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
from tests.gap.made_states import FITTED, drawn, standing

NAN = math.nan
LINE, OTHER = Tone(1.0, 5.0), Tone(1.0, 9.0)


def test_few_of_the_replicates_are_looked_at() -> None:
    assert len(NUMBERS) == REPLICATES
    assert 2 <= LOOKS < REPLICATES


def test_a_trial_changes_every_sensor_or_its_own() -> None:
    models = {"G1": SensorModel(FITTED, (LINE, Bias(0.5))), "G2": SensorModel(FITTED)}
    unit = standing([0.0], drawn(1), models=models)
    added = unit.changed(Hypothesis((OTHER,)))
    assert [model.added for model in added.values()] == [(LINE, Bias(0.5), OTHER), (OTHER,)]
    own = unit.changed(Hypothesis((OTHER,), sensor="G2"))
    assert [model.added for model in own.values()] == [(LINE, Bias(0.5)), (OTHER,)]
    assert all(not model.removed for model in own.values())


def test_others_get_the_opposite() -> None:
    """Two of three are exchanged."""
    models = {name: SensorModel(FITTED) for name in ("G1", "G2", "G3")}
    one, other = ChannelSwap("G3", "place"), ChannelSwap("G1", "place")
    changed = standing([0.0], drawn(1), models=models).changed(
        Hypothesis((one,), sensor="G1", others=("G3",), opposite=(other,))
    )
    assert [model.added for model in changed.values()] == [(one,), (), (other,)]


def test_what_is_removed_is_gone_from_both_places() -> None:
    """From what was added, and from what the base model draws; what takes its place comes after."""
    unit = standing([0.0], drawn(1), models={"G1": SensorModel(FITTED, (LINE, Bias(0.5)), frozenset({"scale"}))})
    (model,) = unit.changed(Hypothesis((OTHER,), removed="tone")).values()
    assert model == SensorModel(FITTED, (Bias(0.5), OTHER), frozenset({"scale", "tone"}))
    (bare,) = unit.changed(Hypothesis((), removed="tone")).values()
    assert bare == SensorModel(FITTED, (Bias(0.5),), frozenset({"scale", "tone"}))


def test_ordinary_parameters_make_up_for_what_is_missing() -> None:
    """The replicates' fits have 0.5 more of an offset than the recording's: it is taken off. Who reads another's data
    keeps his own.
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
    """Draws are the same with and without the change, so that two replicates tell it exactly."""
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
def test_a_scatter_that_is_scaled_is_told_by_many(factor: float) -> None:
    """All replicates are the same draws, so that the ratio is exact however few there are."""
    without = drawn(4, seed=2)
    likelihood, _ = update_likelihood(standing([0.0] * 4, without), factor * without)
    np.testing.assert_allclose(likelihood.scale, factor, rtol=1e-3)


def test_what_no_longer_scatters_is_where_it_is_now() -> None:
    """A change that leaves nothing of the scatter: where the replicates lay before it, by chance a third of a standard
    deviation off, says nothing of where they are after. What it leaves alone stays where it was.
    """
    without = drawn(2) + np.array([2.0, 2.0])
    after = np.column_stack([3.0 + 1e-4 * drawn(1, seed=2)[:, 0], without[:, 1]])
    likelihood, _ = update_likelihood(standing([3.0, 0.0], without), after)
    assert likelihood.location[0] == pytest.approx(3.0, abs=1e-3)
    assert likelihood.location[1] == pytest.approx(0.0, abs=1e-9)
    assert likelihood.scale[0] == pytest.approx(0.05)  # of what it was: nothing is known better than the model's form


def test_a_scatter_of_other_draws_is_believed_only_in_part() -> None:
    """Of 200 statistics drawn anew with the same scatter: the log of the ratio of two standard deviations of 16 has one
    of sqrt(2 / 30) = 0.26; shrunk by its own uncertainty it is a third of that or less in the middle.
    """
    without, anew = drawn(200, 3), drawn(200, 4)
    likelihood, _ = update_likelihood(standing([0.0] * 200, without), anew)
    assert np.median(np.abs(np.log(likelihood.scale))) < 0.26 / 3
    wider, _ = update_likelihood(standing([0.0] * 200, without), 10 * anew)
    assert np.median(wider.scale) == pytest.approx(10, rel=0.15)


def test_two_replicates_only_widen() -> None:
    """By the scatter of what the change makes: +3 and -3."""
    without = drawn(1)
    likelihood, moved = update_likelihood(standing([0.0], without), without[:2] + np.array([[3.0], [-3.0]]))
    assert moved[0] == pytest.approx(0.0, abs=1e-12)
    assert likelihood.scale[0] >= math.hypot(1, 3) * (1 - 1e-9)


def test_a_single_pair_says_nothing_of_the_scatter() -> None:
    """Of two replicates with the change one is silent: the scatter is what it was."""
    unit = standing([0.0], drawn(1))
    likelihood, moved = update_likelihood(unit, np.array([unit.values[0] + 3.0, [NAN]]))
    assert moved[0] == pytest.approx(3.0)
    assert likelihood.scale[0] == pytest.approx(1.0)


def test_an_event_makes_nothing_surer_than_its_form_is() -> None:
    """What is nearly the same in all replicates, since the event drowns the noise, is off by a twentieth of that."""
    without = drawn(2)
    likelihood, _ = update_likelihood(standing([0.0] * 2, without), 7 + 1e-3 * without)
    np.testing.assert_allclose(likelihood.location, 7.0, atol=0.01)
    np.testing.assert_allclose(likelihood.scale, 0.05, rtol=1e-6)


def test_what_speaks_only_since_the_change() -> None:
    """It is there always now, about where the replicates have it, as sure as a tenth of its size at best."""
    nothing = np.full((REPLICATES, 1), NAN)
    never = SyntheticLikelihood(np.array([NAN]), np.array([NAN]), np.array([False]), np.array([True]))
    unit = standing([20.0], nothing, never)
    likelihood, moved = update_likelihood(unit, np.array([[20.01], [19.99]]))
    assert likelihood.location[0] == pytest.approx(20.0)
    assert likelihood.scale[0] == pytest.approx(2.1)
    assert (likelihood.always[0], likelihood.never[0]) == (True, False)
    assert gains_of(unit, likelihood, moved).sum() > 10  # the recording speaks too


def test_what_the_recording_lacks_gains_nothing() -> None:
    """What is missing is no evidence: neither for a model that has it nor for one that lacks it too."""
    unit = standing([NAN], drawn(1))
    likelihood, moved = update_likelihood(unit, np.full((REPLICATES, 1), NAN))
    assert np.isnan(likelihood.location[0])
    assert not likelihood.always[0]
    assert gains_of(unit, likelihood, moved).sum() == 0.0


def test_what_hangs_together_with_nothing_else_counts_by_itself() -> None:
    """Ten that are one and the same, and one apart: of that the gain is whole."""
    unit = standing([3.0] * 11, drawn(11), independent=0.1)
    likelihood, moved = update_likelihood(unit, unit.values + 3.0)
    by_axis = gains_of(unit, likelihood, moved)
    apart = gains_of(replace(unit, separate_share=np.append(np.zeros(10), 1.0)), likelihood, moved)
    np.testing.assert_allclose(apart[:10], by_axis[:10])
    assert apart[10] == pytest.approx(10 * by_axis[10])


def test_what_is_not_simulated_says_nothing_of_a_change() -> None:
    """What a unit shares with sensors beside it is in the recording and in replicates of the whole array, not in those
    of the unit alone, with or without the change: all stays as it was.
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


def test_silence_is_no_excuse() -> None:
    """The recording says 5, the model 0: a change after which it never says anything is no better."""
    unit = standing([5.0], drawn(1))
    likelihood, moved = update_likelihood(unit, np.full((REPLICATES, 1), NAN))
    assert gains_of(unit, likelihood, moved).sum() <= 0


def test_what_a_change_makes_the_same_every_time_is_that() -> None:
    """As the difference of two sensors of which one has the other's readings: 0 in all replicates, and here, but for
    what rounding makes of it.
    """
    unit = standing([0.0], drawn(1))
    likelihood, moved = update_likelihood(unit, 1e-16 * drawn(1, seed=2))
    assert abs(likelihood.scores(unit.real)[0]) < 1
    assert gains_of(unit, likelihood, moved).sum() > -0.1


@given(st.floats(-30, 30), st.floats(-30, 30), st.floats(0.05, 1.0))
def test_a_gain_is_a_ratio_of_densities(real: float, shift: float, independent: float) -> None:
    """Of the t distribution, tempered by the share that is independent; the shift may be off by its share."""
    unit = standing([real, 0.0], drawn(2), independent=independent)
    likelihood, moved = update_likelihood(unit, unit.values + np.array([shift, 0.0]))
    width = math.hypot(1.0, FORM * shift)
    expected = stats.t.logpdf(real, FREEDOM, shift, width) - stats.t.logpdf(real, FREEDOM)
    assert gains_of(unit, likelihood, moved).sum() == pytest.approx(independent * expected, abs=1e-6)
    assert gains_of(unit, likelihood, moved)[1] == pytest.approx(0.0, abs=1e-6)


def test_no_change_gains_nothing() -> None:
    unit = standing([1.0, -3.0, NAN], drawn(3))
    likelihood, moved = update_likelihood(unit, unit.values)
    assert gains_of(unit, likelihood, moved).sum() == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(likelihood.scores(unit.real), unit.scores)


def test_noise_that_falls_otherwise_is_no_shift() -> None:
    """300 statistics of one probe drawn anew, which differ by sqrt(2 / 8) from those before, and 300 of another that
    move by 0.4: what the first seem to have moved is taken for chance, and the second keep what they moved.
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


def test_a_scatter_is_told_by_all_that_are_alike() -> None:
    """Moved by draws of ten standard deviations, of which two say next to nothing (the lower quartile of the root of
    chi-squared with one degree of freedom is 0.32): 200 that are alike say it within a third, and of others that move
    by 0.1 alike they say nothing.
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


def test_what_does_not_move_says_nothing_of_what_does() -> None:
    """Of those that are alike half are of the part that isn't simulated."""
    without = drawn(400, 3)
    walked = without[:2].copy()
    walked[:, :200] += 10 * drawn(200, 4, rows=2)
    together, _ = update_likelihood(replace(standing([0.0] * 400, without), scatter_group=np.zeros(400, int)), walked)
    assert np.median(together.scale[:200]) > 8
    np.testing.assert_allclose(together.scale[200:], 1.0)


@pytest.mark.parametrize("count", [LOOKS, REPLICATES])
def test_where_an_earlier_effect_takes_a_statistic_it_still_does(count: int) -> None:
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


def test_what_another_noise_costs() -> None:
    """By a t distribution of 5 % of the noise, axis by axis; rounding is nothing beside it."""
    unit = standing([0.0], drawn(1))
    header = SensorHeader("G1", "l3g4200d", "angular_rate", "dps", 250.0, 1e6)
    assert unit.misfit_of({"G1": header}, [{"G1": FITTED}] * 3) == pytest.approx(0.0, abs=1e-9)
    came = [{"G1": replace(FITTED, rms=(0.1, 0.1 * math.exp(factor), 0.1))} for factor in (0.2, 0.2)]
    expected = stats.t.logpdf(0, FREEDOM) - stats.t.logpdf(4.0, FREEDOM)
    assert unit.misfit_of({"G1": header}, came) == pytest.approx(expected, rel=1e-3)


def test_what_hangs_together_with_little_counts_more() -> None:
    """Ninety statistics that are one, and three of their own: a gain of these three counts as much more as they are
    more independent, one of the ninety no more, and one that is seen in nothing neither.
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
    few = replace(unit, values=values[:LOOKS])  # which tell nothing of what hangs together
    assert counts_of(few, unit.likelihood, moved) == 1.0
