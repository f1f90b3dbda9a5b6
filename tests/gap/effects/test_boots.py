"""Differences from boot to boot, and a range other than the configured one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.inference.evidence import Span
from imuarray.gap.recording.resets import Reset
from imuarray.simulate.effects.bias import Bias, BistableBias, TurnOnBias
from imuarray.simulate.effects.conversion import RangeReset
from imuarray.simulate.effects.timing import DroppedSamples
from tests.gap.effects.evidence_of import evidence_of
from tests.selection import some


def resets(kind: str, sensor: str, put_in: RangeReset, seed: int = 7) -> list[RangeReset]:
    trials = CANDIDATES["range_reset"].guesses(evidence_of(kind, sensor, {sensor: (put_in,)}, seed=seed))
    return [effect for trial in trials for effect in trial.effects if isinstance(effect, RangeReset)]


@pytest.mark.slow
def test_levels_that_scatter_suggest_a_turn_on_bias() -> None:
    """Eight boots: a standard deviation of seven degrees of freedom is within a factor of 2 in 99 of 100 cases. On all
    axes it is above that of usual parts, 0.15 dps.
    """
    evidence = evidence_of("turn-on", "G1", {"G1": (TurnOnBias((1.0, 0.6, 0.8)),)}, seed=7)
    (trial,) = CANDIDATES["turn_on_bias"].guesses(evidence)
    (effect,) = trial.effects
    assert isinstance(effect, TurnOnBias)
    assert np.all(np.abs(np.log(np.array(effect.rms) / (1.0, 0.6, 0.8))) < np.log(2.0))


@pytest.mark.slow
def test_two_groups_of_levels_suggest_two_states() -> None:
    """The two states as simulated, whichever is the rarer."""
    put_in = np.array([0.9, 0.4, -0.2])
    evidence = evidence_of("turn-on", "G1", {"G1": (BistableBias((0.9, 0.4, -0.2), 0.4),)}, seed=7)
    (trial,) = CANDIDATES["bistable_bias"].guesses(evidence)
    (effect,) = trial.effects
    assert isinstance(effect, BistableBias)
    sign = np.sign(effect.offset[0])
    np.testing.assert_allclose(sign * np.array(effect.offset), put_in, atol=0.02)
    assert 0.1 < effect.probability <= 0.5


@pytest.mark.slow
def test_another_range_in_some_boots_is_suggested() -> None:
    found = resets("turn-on", "A1", RangeReset(2.0, (0.02,) * 3, (1.5,) * 3, probability=0.4))
    of_two_g, just_in = [one for one in found if one.range == 2.0]
    assert just_in == replace(of_two_g, probability=1.0, runs=just_in.runs)
    assert len(just_in.runs) == round(8 * of_two_g.probability)
    assert of_two_g.offset == pytest.approx((0.02,) * 3, abs=0.002)
    assert of_two_g.noise_share == pytest.approx((1.5,) * 3, rel=0.1)
    assert 0.1 < of_two_g.probability <= 0.5
    assert of_two_g.onset_s == 0.0


@pytest.mark.slow
def test_another_range_is_suggested_for_its_boots_only() -> None:
    """Boots 2 and 6, both of one part; another bias in these, without another noise, is not another range."""
    put_in = RangeReset(2.0, (0.02,) * 3, runs=(2.0, 6.0))
    trials = CANDIDATES["range_reset"].guesses(evidence_of("turn-on", "A1", {"A1": (put_in,)}, seed=7))
    told = [trial for trial in trials if trial.effects[0].runs]  # type: ignore[attr-defined]
    assert all(trial.whole and trial.rarity >= 2 for trial in told)
    first, *_ = [one for trial in told for one in trial.effects if isinstance(one, RangeReset)]
    assert (first.range, first.runs, first.probability) == (2.0, (2.0, 6.0), 1.0)
    assert first.noise_share == pytest.approx((1.0,) * 3, rel=0.1)
    states = evidence_of("turn-on", "A1", {"A1": (BistableBias((0.5, 0.3, 0.2), 0.4),)}, seed=7)
    others = [
        one
        for trial in CANDIDATES["range_reset"].guesses(states)
        for one in trial.effects
        if isinstance(one, RangeReset)
    ]
    assert not [one for one in others if one.runs]


@pytest.mark.slow
def test_another_range_is_suggested_though_levels_scatter() -> None:
    """The bias of each boot hides which of them have the range of 2000 dps; their noise in counts does not."""
    runs = (1.0, 2.0, 4.0, 5.0, 7.0)
    put_in = (TurnOnBias((1.0, 1.0, 1.0)), RangeReset(2000.0, runs=runs))
    trials = CANDIDATES["range_reset"].guesses(evidence_of("turn-on", "G1", {"G1": put_in}, seed=7))
    ranges = [effect for trial in trials for effect in trial.effects if isinstance(effect, RangeReset)]
    assert (2000.0, runs) in [(effect.range, effect.runs) for effect in ranges]


@pytest.mark.parametrize(("sensor", "range_", "offset"), some([("A1", 2.0, 0.02), ("G1", 2000.0, 0.2)], 1))
def test_another_range_from_a_row_on_is_suggested(sensor: str, range_: float, offset: float) -> None:
    first, *_ = resets("static", sensor, RangeReset(range_, (offset,) * 3, (0.8,) * 3, 33.3))
    assert first.range == range_
    assert first.onset_s == pytest.approx(33.3, abs=0.1)
    assert first.offset == pytest.approx((offset,) * 3, rel=0.1)
    assert first.noise_share == pytest.approx((0.8,) * 3, rel=0.3)
    assert first.probability == 1.0
    assert first.run == 0.0


def test_a_step_of_the_bias_is_no_other_range() -> None:
    """An offset and a share of the noise would compensate the ratio of any range; the noise of the readings stays."""
    evidence = evidence_of("static", "A1", {"A1": (Bias((0.3, 0.1, 0.2), spans=(0.0, 33.3, 1e9)),)}, seed=7)
    trials = CANDIDATES["range_reset"].guesses(evidence)
    assert not [effect for trial in trials for effect in trial.effects if isinstance(effect, RangeReset)]


@pytest.mark.slow
def test_another_range_from_a_row_of_a_tumble_on_is_suggested() -> None:
    """The faces determine the ratio, 4 / 3, whichever face follows the step, and the next log has that range too."""
    put_in = (RangeReset(3.0, onset_s=70.0, run=0.0), RangeReset(3.0, runs=(1.0,)))
    evidence = evidence_of(("tumble", "static"), "A1", {"A1": put_in}, seed=7)
    lasting, *_ = [
        trial for trial in CANDIDATES["range_reset"].guesses(evidence) if len(trial.effects) == 2 and trial.is_brief
    ]
    first, then = lasting.effects
    assert isinstance(first, RangeReset)
    assert isinstance(then, RangeReset)
    assert (first.range, first.run, then.range, then.runs) == (3.0, 0.0, 3.0, (1.0,))
    assert first.onset_s == pytest.approx(70.0, abs=1.0)


@pytest.mark.campaign
def test_another_range_with_an_onset_in_each_log_is_suggested() -> None:
    """A supply with occasional dips: the second log has its own onset and the same range."""
    dips = [RangeReset(2.0, onset_s=onset_s, run=run) for onset_s, run in ((33.3, 0.0), (20.0, 1.0))]
    evidence = evidence_of(("static", "heating"), "A1", {"A1": tuple(dips)}, seed=7)
    trial = next(trial for trial in CANDIDATES["range_reset"].guesses(evidence) if trial.is_brief)
    found = {effect.run: effect for effect in trial.effects if isinstance(effect, RangeReset)}
    assert {run: one.range for run, one in found.items()} == {0.0: 2.0, 1.0: 2.0}
    assert found[0.0].onset_s == pytest.approx(33.3, abs=0.1)
    assert found[1.0].onset_s == pytest.approx(20.0, abs=0.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "sensor", "range_"), some([("tumble", "A1", 2.0), ("tumble", "A1", 8.0), ("motion", "G1", 500.0)], 1, 1)
)
def test_another_range_in_all_logs_is_suggested(kind: str, sensor: str, range_: float) -> None:
    assert range_ in {one.range for one in resets(kind, sensor, RangeReset(range_))}


@pytest.mark.slow
def test_equal_boots_suggest_nothing() -> None:
    """They scatter less than those of usual parts."""
    evidence = evidence_of("turn-on", "A1", seed=5)
    for candidate in (
        CANDIDATES["turn_on_bias"],
        CANDIDATES["bistable_bias"],
        CANDIDATES["range_reset"],
        CANDIDATES["bias"],
    ):
        assert list(candidate.guesses(evidence)) == []


@pytest.mark.slow
def test_a_permanent_step_between_boots_suggests_a_bias() -> None:
    """From the fifth of eight boots on; the scatter of single boots is less than a hundredth of it."""
    evidence = evidence_of("turn-on", "A1", {"A1": (Bias((0.05, 0.0, -0.02), 4),)}, seed=7)
    (trial,) = CANDIDATES["bias"].guesses(evidence)
    (effect,) = trial.effects
    assert isinstance(effect, Bias)
    assert effect.from_boot == 4
    assert effect.offset == pytest.approx((0.05, 0.0, -0.02), abs=0.002)


def test_faces_determine_the_range() -> None:
    """z up and z down at 4 g, then at 1 g (four times the counts) with an offset of 0.3 g; any other range would need a
    different offset on each face.
    """
    noise = np.full(3, 3.0)
    up, down = (np.array([0.0, 0.0, 2048.0 * z]) for z in (0.7, -1.3))
    told = [
        Reset(at, at, at + 0.1, before, 4 * (before + 0.3 * 2048.0 * np.array([0.0, 0.0, 1.0])), noise, noise)
        for at, before in ((5.0, up), (8.0, down))
    ]
    evidence = replace(
        evidence_of("static", "A1"), resets=((0, told[0]), (1, told[1])), scores={"doubt": np.full((1, 1), 50.0)}
    )
    first, *_ = CANDIDATES["range_reset"].guesses(evidence)
    (effect,) = first.effects
    assert isinstance(effect, RangeReset)
    assert effect.range == 1.0
    assert effect.offset == pytest.approx((0.0, 0.0, 0.3))


def test_a_temporary_range_reset_is_suggested() -> None:
    """2 g instead of 4 g in two logs, detected by the recorder: twice the counts, and 20 mg more; after the second,
    rows are lost while the chip is configured again, and other rows independently.
    """
    before, noise = np.array([100.0, -200.0, 2000.0]), np.full(3, 3.0)
    within, spread = 2 * (before + 0.02 * 2048), 4 * noise  # twice the doubled value
    told = (
        Reset(4.9, 5.0, 5.1, before, within, noise, spread),
        Reset(7.8, 8.0, 8.2, before, within, noise, spread),
    )
    evidence = replace(
        evidence_of("static", "A1"),
        resets=((0, told[0]), (3, told[1])),
        holes=(Span(3, 8.2, 0.3), Span(0, 30.0, 0.1)),
        scores={"doubt": np.full((1, 1), 50.0)},
    )
    first, second = CANDIDATES["range_reset"].guesses(evidence)
    reset, lost = first.effects
    assert isinstance(reset, RangeReset)
    assert isinstance(lost, DroppedSamples)
    assert (reset.range, reset.runs, reset.moments_s) == (2.0, (0.0, 3.0), (5.0, 8.0))
    assert reset.lengths_s == pytest.approx((0.1, 0.2))
    assert reset.doubts_s == pytest.approx((0.1, 0.2))
    assert reset.offset == pytest.approx((0.02,) * 3)
    assert reset.noise_share == pytest.approx((2.0,) * 3)
    assert (lost.runs, lost.moments_s, lost.lengths_s) == ((3.0,), (8.2,), (0.3,))
    assert reset.blanks_s == (0.0, 0.0)
    assert first.whole
    assert first.name == "range_reset"
    assert second.rarity > first.rarity > 0
    assert not list(CANDIDATES["range_reset"].guesses(replace(evidence, scores={})))
    brief = told[0]._replace(noise_within=np.full(3, np.nan), blank_s=0.01)
    found = next(iter(CANDIDATES["range_reset"].guesses(replace(evidence, resets=((0, brief),))))).effects[0]
    assert isinstance(found, RangeReset)
    assert (found.blanks_s, found.noise_share) == ((0.01,), (1.0, 1.0, 1.0))


@pytest.mark.slow
def test_the_offset_of_a_range_does_not_depend_on_the_zero_of_a_thermometer() -> None:
    """2000 dps in the place of 250 in one of three logs, with no offset. A slope over a temperature far from the
    reference is not an offset, since all logs are equally warm; neither is a phase in which the sensor was not read.
    """
    other = RangeReset(2000.0, runs=(1.0,))
    evidence = evidence_of("turn-on", "G1", {"G1": (Bias((5.0, -4.0, 3.0)), other)}, seed=7)
    seen = tuple(
        replace(
            part, raw=replace(part.raw, segments=replace(segments, temperature_degc=segments.temperature_degc - 49))
        )
        for part in evidence.phases
        for segments in (part.raw.segments,)
    )
    cold = replace(evidence, phases=seen, fitted=replace(evidence.fitted, slope=(0.5, -0.5, 0.5)))
    first = evidence.still[0]
    nothing = replace(first.residual.segments, mean=np.full_like(first.raw.segments.mean, np.nan))
    residual = replace(first.residual, segments=nothing)
    unread = replace(first, log=2, raw=replace(first.raw, rows=0), residual=residual)
    for item in (evidence, cold, replace(evidence, phases=(*evidence.phases, unread))):
        (reset,) = (
            effect
            for trial in CANDIDATES["range_reset"].guesses(item)
            for effect in trial.effects
            if isinstance(effect, RangeReset) and effect.range == 2000.0 and effect.runs
        )
        assert reset.runs == (1.0,)
        assert reset.offset == pytest.approx((0.0,) * 3, abs=0.5)
