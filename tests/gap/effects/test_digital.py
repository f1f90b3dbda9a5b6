"""Effects of converters and of the bus: suggested from codes, repeats and tails."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.evidence import Evidence, Repetition, Span
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.conversion import AdaptiveRange, OdrError, Quantisation, Saturation
from imuarray.simulate.effects.readings import Glitches, StaleSamples, Stuck
from tests.gap.effects.evidence_of import evidence_of
from tests.selection import some

ALL = ("quantisation", "saturation", "stale_samples", "glitches", "stuck", "odr_error")


def shown(kind: str, sensor: str, *effects: Effect) -> Evidence:
    return evidence_of(kind, sensor, {sensor: effects})


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["static", "tumble", "motion"])
@pytest.mark.parametrize("sensor", ["A1", "G1"])
def test_nothing_is_suggested_without_evidence(kind: str, sensor: str) -> None:
    assert not [trial for name in ALL for trial in CANDIDATES[name].guesses(evidence_of(kind, sensor))]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "sensor", "step"), some([("static", "A1", 2.0), ("static", "A1", 4.0), ("tumble", "G1", 16.0)], 1)
)
def test_a_coarser_step_is_suggested(kind: str, sensor: str, step: float) -> None:
    (trial,) = CANDIDATES["quantisation"].guesses(shown(kind, sensor, Quantisation(step)))
    assert trial == Hypothesis((Quantisation(step),))


@pytest.mark.parametrize("steps", [(1.0, 1.0, 4.0), (2.0, 1.0, 2.0), (2.0, 8.0, 1.0)])
def test_a_coarser_step_of_some_axes_is_suggested(steps: tuple[float, float, float]) -> None:
    """Codes of all axes together have no common step; codes of each axis have."""
    (trial,) = CANDIDATES["quantisation"].guesses(shown("static", "A1", Quantisation(steps)))
    assert trial == Hypothesis((Quantisation(steps),))


def test_a_step_that_is_not_a_power_of_two_is_suggested_first() -> None:
    first, second = CANDIDATES["quantisation"].guesses(shown("static", "A1", Quantisation(6.0)))
    assert first == Hypothesis((Quantisation(6.0),))
    assert second == Hypothesis((Quantisation(2.0),))


def test_glitches_do_not_hide_a_step() -> None:
    """A bus that sometimes floats gives -1, which is not a multiple of 4."""
    (trial,) = CANDIDATES["quantisation"].guesses(
        shown("static", "A1", Quantisation(4.0), Glitches(0.0005, kind="word"))
    )
    assert trial == Hypothesis((Quantisation(4.0),))


def test_a_step_of_the_model_alone_is_removed() -> None:
    evidence = evidence_of("static", "A1", modelled=(Quantisation(4.0),))
    assert list(CANDIDATES["quantisation"].guesses(evidence)) == [Hypothesis((), removed="quantisation")]


@pytest.mark.parametrize(
    ("kind", "sensor", "limit"), some([("static", "A1", 1.02), ("motion", "A1", 1.2), ("motion", "G1", 30.0)], 1)
)
def test_saturation_is_suggested_at_its_limit(kind: str, sensor: str, limit: float) -> None:
    """To a count, the rounding of the limit."""
    evidence = shown(kind, sensor, Saturation(limit))
    trial = next(iter(CANDIDATES["saturation"].guesses(evidence)))
    (found,) = trial.effects
    assert isinstance(found, Saturation)
    assert found.limit == pytest.approx((limit,) * 3, abs=1 / evidence.header.sensitivity)
    assert trial.free == ("limit",)


@pytest.mark.slow
def test_saturation_of_a_single_axis_is_suggested() -> None:
    """Readings of the others exceed its limit."""
    evidence = shown("motion", "A1", Saturation((math.inf, math.inf, 1.1)))
    (found,) = list(CANDIDATES["saturation"].guesses(evidence))[-1].effects
    assert isinstance(found, Saturation)
    assert found.limit == pytest.approx((math.inf, math.inf, 1.1), abs=1 / evidence.header.sensitivity)


@pytest.mark.slow
def test_saturation_at_one_end_is_suggested() -> None:
    """A gyroscope that saturates at +30 dps and turns faster in the other sense, up to the limit of the converter."""
    evidence = shown("motion", "G1", Saturation(300.0, -270.0))
    (found,) = list(CANDIDATES["saturation"].guesses(evidence))[-1].effects
    assert isinstance(found, Saturation)
    upper = np.add(found.centre, found.limit)
    np.testing.assert_allclose(upper, 30.0, atol=1 / evidence.header.sensitivity)
    lowest = np.subtract(found.centre, found.limit)
    np.testing.assert_allclose(lowest, -32768 / evidence.header.sensitivity)


@pytest.mark.slow
def test_saturation_before_an_added_offset_is_suggested() -> None:
    """A gyroscope that saturates at +37.5 and -22.5 dps on every axis."""
    evidence = shown("motion", "G1", Saturation(30.0, 7.5))
    (saturated,) = list(CANDIDATES["saturation"].guesses(evidence))[-1].effects
    assert isinstance(saturated, Saturation)
    assert saturated.limit == pytest.approx((30.0,) * 3, abs=1 / evidence.header.sensitivity)
    assert saturated.centre == pytest.approx((7.5,) * 3, abs=1 / evidence.header.sensitivity)


@pytest.mark.parametrize("probability", [0.02, 0.05, 0.3])
def test_stale_samples_are_suggested(probability: float) -> None:
    """6000 rows: 120 repetitions scatter by a tenth."""
    (trial,) = CANDIDATES["stale_samples"].guesses(shown("static", "A1", StaleSamples(probability)))
    (found,) = trial.effects
    assert isinstance(found, StaleSamples)
    assert found.probability == pytest.approx(probability, rel=0.35)


@pytest.mark.slow
def test_rare_stale_samples_are_suggested() -> None:
    """About a dozen repetitions in a tumble: the median over its phases is zero, their share of all rows is not."""
    evidence = shown("tumble", "A1", StaleSamples(0.002))
    repeated = [phase.raw.repeats for phase in evidence.phases]
    assert max(repeats.longest for repeats in repeated) == 2
    assert np.median([repeats.repeat_share for repeats in repeated]) < 0.003
    (trial,) = CANDIDATES["stale_samples"].guesses(evidence)
    (effect,) = trial.effects
    assert isinstance(effect, StaleSamples)
    assert effect.probability == pytest.approx(0.002, rel=0.8)


def test_stale_samples_in_bursts_are_suggested() -> None:
    """Thirty bursts of three repetitions in 6000 rows of the recording; a reading is stale at 0.015. As many in the
    held-out part of the log are ignored.
    """
    evidence = shown("static", "A1", StaleSamples(0.015, rows=3.0))
    repeated = tuple(Repetition(Span(0, 2.0 * number + 0.5, 0.03), 3, (0, 0, 0)) for number in range(60))
    trials = list(CANDIDATES["stale_samples"].guesses(replace(evidence, repeated=repeated)))
    (effect,) = trials[-1].effects
    assert isinstance(effect, StaleSamples)
    assert trials[-1].free == ("probability", "rows")
    assert effect.probability == pytest.approx(0.015, rel=0.35)
    assert effect.rows == pytest.approx(3.0, rel=0.25)


@pytest.mark.parametrize(("probability", "amplitude"), [(0.002, 0.05), (0.01, 0.1), (0.01, 0.5)])
def test_spikes_are_suggested(probability: float, amplitude: float) -> None:
    trial = next(iter(CANDIDATES["glitches"].guesses(shown("static", "A1", Glitches(probability, amplitude)))))
    (found,) = trial.effects
    assert isinstance(found, Glitches)
    assert found.kind == "spike"
    assert found.probability == pytest.approx(probability, rel=0.5)
    assert found.amplitude == pytest.approx(amplitude, rel=0.1)


def test_few_spikes_are_listed_individually() -> None:
    """A row and a half of its 1/100 s before and after; the noise of the reading and of half of each neighbour's."""
    hit = Glitches(runs=(0.0, 0.0), moments_s=(12.3, 40.0), jumps=(0.0, 0.5, 0.0, -2.0, 0.0, 0.0))
    *_, trial = CANDIDATES["glitches"].guesses(shown("static", "A1", hit))
    (found,) = trial.effects
    assert isinstance(found, Glitches)
    assert trial.needs_both
    assert found.runs == (0.0, 0.0)
    np.testing.assert_allclose(sorted(found.moments_s), hit.moments_s, atol=0.015)
    np.testing.assert_allclose(sorted(found.jumps), sorted(hit.jumps), atol=0.02)


def test_torn_words_are_suggested() -> None:
    """z rests at 2112.5 counts, in the middle between two codes of 33 times 64: half of its neighbours differ in the
    high byte (six bits of a BMA180 travel in the low one, BMA-60). The other axes are unchanged.
    """
    trials = CANDIDATES["glitches"].guesses(
        shown("static", "A1", Bias((0.0, 0.0, 0.01152)), Glitches(0.05, kind="torn"))
    )
    (torn,) = [trial for trial in trials if isinstance(trial.effects[0], Glitches) and trial.effects[0].kind == "torn"]
    assert torn.free == ("probability",)
    assert torn.effects[0].probability == pytest.approx(0.05, rel=0.5)


def test_words_of_a_floating_bus_are_suggested() -> None:
    trial = next(iter(CANDIDATES["glitches"].guesses(shown("static", "G1", Glitches(0.005, kind="word")))))
    (found,) = trial.effects
    assert isinstance(found, Glitches)
    assert found.kind == "word"
    assert found.probability == pytest.approx(0.005, rel=0.5)


def test_a_stuck_second_is_suggested() -> None:
    """To the precision of a row."""
    (trial,) = CANDIDATES["stuck"].guesses(shown("static", "A1", Stuck(30.0, 1.0)))
    (found,) = trial.effects
    assert isinstance(found, Stuck)
    assert (found.onset_s, found.duration_s) == pytest.approx((30.0, 1.0), abs=0.02)
    assert trial.free == ()  # factors of an onset would be seconds


@pytest.mark.slow
def test_a_stuck_interval_over_a_turn_is_one_suggestion() -> None:
    """Faces last from 11 to 21 s and from 22 to 32 s: one interval, though no phase covers the turn."""
    (trial,) = CANDIDATES["stuck"].guesses(shown("tumble", "G1", Stuck(15.0, 10.0)))
    (found,) = trial.effects
    assert isinstance(found, Stuck)
    assert (found.onset_s, found.duration_s) == pytest.approx((15.0, 10.0), abs=0.05)


def test_a_permanently_stuck_sensor_is_suggested() -> None:
    (trial,) = CANDIDATES["stuck"].guesses(shown("static", "A1", Stuck(40.0)))
    (found,) = trial.effects
    assert isinstance(found, Stuck)
    assert found.onset_s == pytest.approx(40.0, abs=0.02)
    assert found.duration_s == math.inf
    assert trial.free == ()


@pytest.mark.parametrize("rate_hz", [50.0, 90.0])
def test_a_data_rate_below_the_poll_rate_is_suggested(rate_hz: float) -> None:
    *_, trial = CANDIDATES["odr_error"].guesses(shown("static", "G1", OdrError(rate_hz)))
    (found,) = trial.effects
    assert isinstance(found, OdrError)
    assert found.rate_hz == pytest.approx(rate_hz, rel=0.01)
    assert trial.free == ("rate_hz",)


@pytest.mark.slow
def test_a_data_rate_between_poll_and_configured_rate_is_suggested() -> None:
    """130 Hz polled at 100 Hz: half a period is 3.8 ms, that of the set 800 Hz 0.6 ms."""
    evidence = evidence_of(("static", "motion"), "G1", {"G1": (OdrError(130.0),)})
    (trial,) = CANDIDATES["odr_error"].guesses(evidence)
    (found,) = trial.effects
    assert isinstance(found, OdrError)
    assert found.clock_ratio * 800.0 == pytest.approx(130.0, rel=0.1)
    assert trial.free == ("clock_ratio",)
    only = evidence_of(("static", "motion"), "A1", {"A1": (OdrError(130.0),)})
    (other,) = CANDIDATES["odr_error"].guesses(only)  # a BMA180, which has one rate (BMA-93)
    assert trial.rarity > other.rarity > 0


def test_even_codes_of_an_adxl345_suggest_its_fast_rate() -> None:
    """Its lowest bit is always 0 from 1600 Hz on (ADX-47); at 100 Hz it is not."""
    evidence = shown("static", "A1", Quantisation(2.0))
    slow = replace(evidence, header=replace(evidence.header, chip="adxl345", rate_hz=400.0))
    assert [trial.effects[0] for trial in CANDIDATES["odr_error"].guesses(slow)] == [OdrError(1600.0), OdrError(3200.0)]


def test_odd_codes_of_an_adxl345_suggest_a_slower_rate() -> None:
    evidence = evidence_of("static", "A1")
    header = replace(evidence.header, chip="adxl345", rate_hz=3200.0)
    fast = replace(evidence, header=header, scores={**evidence.scores, "odd_codes": np.full((1, 3), 50.0)})
    assert [trial.effects[0] for trial in CANDIDATES["odr_error"].guesses(fast)] == [OdrError(800.0), OdrError(400.0)]


def test_twice_the_noise_suggests_four_times_the_bandwidth() -> None:
    """Bandwidths 10, 20, 40, 75, 150, 300, 600, 1200 Hz (BMA-81 ... BMA-88), 150 configured."""
    evidence = evidence_of("static", "A1")
    apart = {**evidence.values, "noise": evidence.expected["noise"] + math.log(2.0)}
    loud = replace(evidence, values=apart, scores={**evidence.scores, "noise": np.full((1, 3), 20.0)})
    assert [trial.effects[0] for trial in CANDIDATES["odr_error"].guesses(loud)] == [OdrError(bandwidth_hz=600.0)]


@pytest.mark.parametrize(
    ("name", "effect"),
    some(
        [
            ("stale_samples", StaleSamples(0.1)),
            ("stuck", Stuck(30.0, 1.0)),
            ("glitches", Glitches(0.01, 0.1)),
            ("saturation", Saturation(1.0)),
            ("odr_error", OdrError(50.0)),
        ],
        2,
    ),
)
def test_an_effect_of_the_model_alone_is_removed(name: str, effect: Effect) -> None:
    evidence = evidence_of("static", "A1", modelled=(effect,))
    assert list(CANDIDATES[name].guesses(evidence)) == [Hypothesis((), removed=effect.name)]


@pytest.mark.parametrize("bit", some([2, 3], 1))
def test_a_dead_bit_is_suggested(bit: int) -> None:
    """An accelerometer's noise of some counts jumps over the codes with that bit; the readings are half of that span
    too low on average, by which the fitted bias is wrong.
    """
    evidence = shown("static", "A1", Quantisation(dead_bits=float(1 << bit)))
    as_fitted, behind = CANDIDATES["quantisation"].guesses(evidence)
    assert as_fitted == Hypothesis((Quantisation(dead_bits=float(1 << bit)),))
    assert behind.effects == as_fitted.effects
    assert behind.fitted is not None
    half = (1 << bit) / 2 / evidence.header.sensitivity
    assert np.median(np.subtract(behind.fitted.offset, evidence.fitted.offset)) == pytest.approx(half, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(("carry", "missing"), some([(16, 7), (16, 4), (8, 3), (32, 10)], 2))
def test_codes_missing_before_every_carry_are_suggested(carry: int, missing: int) -> None:
    trials = list(CANDIDATES["quantisation"].guesses(shown("static", "A1", _missing(carry, missing))))
    assert [trial.effects for trial in trials] == [(_missing(carry, missing),)] * 2


@pytest.mark.parametrize(("carry", "missing", "at"), [(8, 1, 3), (16, 4, 7)])
def test_an_offset_shifts_the_carries(carry: int, missing: int, at: int) -> None:
    effect = replace(_missing(carry, missing), carry_at_lsb=float(at))
    first = next(iter(CANDIDATES["quantisation"].guesses(shown("static", "A1", effect))))
    assert first.effects == (effect,)


@pytest.mark.slow
def test_mostly_missing_codes_are_suggested() -> None:
    """Two of 16 occur, which is similar to two of four, or of eight, and to dead bits."""
    trials = list(CANDIDATES["quantisation"].guesses(shown("static", "A1", _missing(16, 14))))
    assert [trial.effects for trial in trials][-2:] == [(_missing(16, 14),)] * 2


def _missing(carry: int, missing: int) -> Quantisation:
    return Quantisation(carry_lsb=float(carry), missing_lsb=float(missing))


@pytest.mark.slow
def test_a_dead_bit_in_motion_is_suggested() -> None:
    """At rest no axis is near it."""
    assert not list(CANDIDATES["quantisation"].guesses(shown("static", "G1", Quantisation(dead_bits=128.0))))
    first = next(iter(CANDIDATES["quantisation"].guesses(shown("motion", "G1", Quantisation(dead_bits=128.0)))))
    assert first == Hypothesis((Quantisation(dead_bits=128.0),))


@pytest.mark.parametrize(
    ("chip", "kind", "is_guessed"),
    some([("icm42688_gyro", "motion", True), ("icm42688_gyro", "static", False), ("l3g4200d", "motion", False)], 1),
)
def test_readings_that_stall_at_a_range_change_are_suggested(chip: str, kind: str, is_guessed: bool) -> None:
    """The erratum of one chip (TDK-18): 1 to 2 ms near 100 dps. Other chips and rest have other causes."""
    evidence = shown(kind, "G1", AdaptiveRange(40.0, 0.05) if kind == "motion" else Stuck(30.0, 1.0))
    assert evidence.is_odd("repeats", "longest_repeat")
    trials = list(CANDIDATES["adaptive_range"].guesses(replace(evidence, header=replace(evidence.header, chip=chip))))
    assert trials == ([Hypothesis((AdaptiveRange(100.0, 0.0015),), ("hold_s",))] if is_guessed else [])


@pytest.mark.slow
def test_repeated_holds_are_suggested() -> None:
    """Half a second in about five: 10 holds, within 3, in the one or two minutes of the recording."""
    found = [
        effect
        for trial in CANDIDATES["stuck"].guesses(shown("tumble", "G1", Stuck(duration_s=0.5, every_s=4.0)))
        for effect in trial.effects
    ]
    again = [effect for effect in found if isinstance(effect, Stuck) and math.isfinite(effect.every_s)]
    assert again[0].duration_s == pytest.approx(0.5, rel=0.2)
    assert 1.5 < again[0].every_s < 10


@pytest.mark.slow
@pytest.mark.parametrize(("end_s", "length_s"), [(40.0, 20.0), (1e9, 1e9)])
def test_an_axis_stuck_at_one_code_is_suggested(end_s: float, length_s: float) -> None:
    """From 20 s on, to a segment of a second; the other axes have noise, so that no reading repeats the
    previous one.
    """
    put_in = Stuck(kind="new", runs=(0,), moments_s=(20.0,), lengths_s=(end_s - 20.0,), stuck_axes=(1,))
    effects = [
        effect for trial in CANDIDATES["stuck"].guesses(shown("static", "A1", put_in)) for effect in trial.effects
    ]
    (effect,) = [effect for effect in effects if isinstance(effect, Stuck) and effect.stuck_axes]
    assert effect.stuck_axes == (1.0,)
    assert effect.moments_s == pytest.approx((20.0,), abs=1.5)
    assert effect.lengths_s == pytest.approx((length_s,), abs=2.5)
    assert effect.active_axes() == (False, True, False)
