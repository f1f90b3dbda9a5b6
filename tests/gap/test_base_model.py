"""The fit against the simulated effects; expected readings against laws, not against the code."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import butter, lfilter

from imuarray.gap.model.ambient_lines import AmbientLine
from imuarray.gap.model.base_model import (
    Base,
    FittedParameters,
    _Correlations,
    _filter_correlations,
    _filters,
    _form_error,
    _Reads,
    _wander,
    fit,
    replicate_seed,
    residual,
)
from imuarray.gap.model.populations import is_usual, usual_flicker
from imuarray.gap.model.rest import response_of
from imuarray.gap.recording.recordings import LogReference
from imuarray.gap.statistics.campaign import Campaign, Layout, LogSummary, PhaseSummary, summarise_log
from imuarray.gap.statistics.catalogue import Key, statistics
from imuarray.log.format import OVERRUN, STALE, Phase
from imuarray.log.writer import Block
from imuarray.simulate import parse_model
from imuarray.simulate.active_spans import acting
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bandwidth import Bandwidth
from imuarray.simulate.effects.bias import Bias, BiasInstability
from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.effects.response import Misalignment, Scale, SizeEffect
from imuarray.simulate.effects.temperature import ThermalBias, ThermalLag
from imuarray.simulate.effects.timing import OwnClock
from imuarray.simulate.motion.faces import Still
from imuarray.simulate.signal import Triple
from tests.gap.small_campaign import BASE, PLANS, OneBlock, block, campaign_of, gaussian, header, summary
from tests.selection import some


def fitted_to(kind: str, more: object = None, seed: int = 0) -> Base:
    return fit(campaign_of(kind, more, seed), PLANS[kind])  # type: ignore[arg-type]


@pytest.mark.slow
def test_noise_slopes_and_offsets_of_a_heated_array_are_fitted() -> None:
    """Noise within 5 standard errors of a median of 64 variances, slopes and offsets within 5 of a straight line."""
    rows = sum(part.sensors["A1"].rows for part in campaign_of("heating").logs[0].phases)
    base = fitted_to("heating", seed=4)
    for name, (noise, bias, thermal) in BASE.items():
        found = base.fitted[name]
        np.testing.assert_allclose(found.rms, noise.rms, rtol=5 * 1.25 / np.sqrt(2 * rows))  # type: ignore[attr-defined]
        np.testing.assert_allclose(found.slope, thermal.slope, atol=noise.rms[0] / np.sqrt(rows))  # type: ignore[attr-defined]
        np.testing.assert_allclose(found.offset, bias.offset, atol=20 * noise.rms[0] / np.sqrt(rows))  # type: ignore[attr-defined]


@pytest.mark.slow
def test_opposite_faces_cancel_a_scale_error() -> None:
    """Six faces: the mean of + and - is the bias alone; one face: 3 % of 1 g are in it."""
    more = {"A1": (Scale(0.03),)}
    assert fitted_to("tumble", more).fitted["A1"].offset == pytest.approx((0.02,) * 3, abs=5e-4)
    assert fitted_to("static", more).fitted["A1"].offset == pytest.approx((0.02, 0.02, 0.05), abs=5e-4)


def test_a_constant_temperature_gives_no_slope() -> None:
    assert {found.slope for found in fitted_to("static").fitted.values()} == {(0.0, 0.0, 0.0)}


def campaign_by_hand(counts: np.ndarray, degc: float = 25.0) -> Campaign:
    """One sensor of 2048 counts per g, flat on a table."""
    one = summary(block(counts), temperature=lambda time_ns: np.full(len(time_ns), degc))
    part = PhaseSummary(one.phase, 0, Layout({"S": one.grid}, 10**9), {"S": one}, None)
    return Campaign((LogSummary("static", (part,)),))


def test_rounding_is_subtracted_from_the_noise() -> None:
    """Noise of 0.8 counts reads as sqrt(0.64 + 1/12); 20000 rows, 5 standard errors of a median of variances."""
    counts = np.rint(np.random.default_rng(2).normal([0, 0, 2048], 0.8, (20_000, 3)))
    found = fit(campaign_by_hand(counts), [Still()]).fitted["S"]
    np.testing.assert_allclose(np.array(found.rms) * 2048, 0.8, rtol=5 * 1.25 / np.sqrt(40_000))
    np.testing.assert_allclose(found.noise(header()), np.sqrt(0.64 + 1 / 12) / 2048, rtol=0.03)


def test_a_few_outlying_segments_do_not_change_the_noise() -> None:
    counts = gaussian() + np.array([0, 0, 2048])
    quiet = fit(campaign_by_hand(counts), [Still()]).fitted["S"]
    counts[5000:5003] = 8000
    wild = fit(campaign_by_hand(counts), [Still()]).fitted["S"]
    np.testing.assert_allclose(wild.rms, quiet.rms, rtol=0.01)


def test_a_sensor_without_rest_is_fitted_as_ideal() -> None:
    campaign = campaign_by_hand(gaussian())
    (part,) = campaign.logs[0].phases
    moving = replace(part, phase=Phase(part.phase.start_ns, part.phase.end_ns, "motion", ""))
    assert fit(Campaign((LogSummary("motion", (moving,)),)), [Still()]).fitted["S"] == FittedParameters(
        *((0.0,) * 3,) * 3
    )


@pytest.mark.slow
def test_residuals_are_statistics_minus_predictions() -> None:
    """A fitted mean has a residual of 0; of a scale error of 5 % the fit takes the 2 % of the data sheet (BMA-74) and
    the 0.3 % of the uncertainty of gravity.
    """
    campaign = campaign_of("tumble", {"A1": (Scale(0.05),)})
    base = fit(campaign, PLANS["tumble"])
    left = statistics(residual(campaign, PLANS["tumble"], base))
    assert left[Key(0, "A1", "x", "", -1, "force", "force_own")] == pytest.approx(0.027, abs=1e-3)
    assert left[Key(0, "A2", "x", "", -1, "force", "force_own")] == pytest.approx(0.0, abs=1e-3)
    warm = campaign_of("heating")
    left = statistics(residual(warm, PLANS["heating"], fit(warm, PLANS["heating"])))
    slopes = [value for key, value in zip(left.keys, left.values, strict=True) if key.probe == "thermal_slope"]
    assert len(slopes) >= 12
    np.testing.assert_allclose(slopes, 0.0, atol=2e-4)


E = TypeVar("E", bound=Effect)


def effects_drawn(base: Base, name: str, kind: type[E]) -> list[E]:
    """The effects of one kind that are drawn for a sensor in the first 200 replicates."""
    return [effect for number in range(200) for effect in base.drawn(number)[name] if isinstance(effect, kind)]


def drawn(base: Base, name: str, kind: type[Scale]) -> np.ndarray:
    """(r, 3) of the first 400 replicates."""
    effects = [base.effects(replicate)[name] for replicate in range(400)]
    return np.array([effect.error for some in effects for effect in some if isinstance(effect, kind)])


@pytest.mark.slow
def test_every_replicate_draws_its_units() -> None:
    """BMA180 at 4 g: +-2 % are two sigma (BMA-74), cut there, which leaves 0.88 of sigma; gyroscopes, without a figure
    in the data sheet: 1 %, cut at three sigma, 0.99 of it. 1200 draws; 5 standard errors are 10 %.
    """
    base = fitted_to("static")
    for name, expected in (("A1", 0.0088), ("G1", 0.00987)):
        errors = drawn(base, name, Scale)
        assert errors.shape == (400, 3)
        assert errors.std() == pytest.approx(expected, rel=0.1)
    effects = base.effects(7)
    assert effects == base.effects(7) != base.effects(8)
    fitted_too = {
        "own_clock",
        "scale",
        "misalignment",
        "turn_on_bias",
        "white_noise",
        "bias",
        "thermal_bias",
        "thermal_lag",
    }
    fitted_too |= {"nonlinearity", "thermal_scale"}  # as far as stated in the data sheets (BMA-116, BMA-117)
    assert {effect.name for effect in effects["A1"]} == fitted_too | {"size_effect"}
    assert {effect.name for effect in effects["G2"]} == fitted_too | {"g_sensitivity", "bias_instability"}
    angles = [effect.angles_deg for effect in effects["G2"] if isinstance(effect, Misalignment)]
    assert 0 < np.abs(angles).max() <= 2.1


MODEL = """
[model]
name = "known"
[[design]]
chip = "bma180"
white_noise.rms_g = 1.0
bias.offset_g = 1.0
scale.error = 0.015
random_walk.density_g_per_sqrt_s = 1e-5
"""


def test_a_model_keeps_all_except_fitted_effects() -> None:
    campaign = campaign_of("static")
    base = fit(campaign, PLANS["static"], model=parse_model(MODEL))
    effects = base.effects(0)
    fitted = ["white_noise", "bias", "thermal_bias"]
    assert [effect.name for effect in effects["A1"]] == ["own_clock", "size_effect", "scale", "random_walk", *fitted]
    assert effects["A1"][4:] == fit(campaign, PLANS["static"]).effects(0)["A1"][-3:]
    assert [effect.name for effect in effects["G1"]] == ["own_clock", "bias_instability", *fitted]


@pytest.mark.parametrize(
    ("clock", "expected"),
    [
        ("", OwnClock(phase_deg=math.nan)),
        ("own_clock = {}", OwnClock()),
        ("own_clock.rate_error = 0.02", OwnClock(0.02)),
    ],
)
def test_a_clock_absent_from_the_model_has_the_nominal_rate_and_a_random_phase(clock: str, expected: OwnClock) -> None:
    base = fit(campaign_of("static"), PLANS["static"], model=parse_model(MODEL + clock))
    (found,) = (effect for effect in base.drawn(0)["A1"] if isinstance(effect, OwnClock))
    assert found == expected


@pytest.mark.slow
def test_every_other_replicate_has_clocks_at_the_configured_rate() -> None:
    """The others have clocks that are too fast by 2 % (rms), 6 % at most."""
    base = fitted_to("static")
    errors = np.array(
        [
            [effect.rate_error for effect in effects if isinstance(effect, OwnClock) and math.isnan(effect.phase_deg)]
            for number in range(200)
            for effects in base.drawn(number).values()
        ]
    ).reshape(200, -1)
    assert not errors[::2].any()
    assert np.sqrt(np.mean(errors[1::2] ** 2)) == pytest.approx(0.02, rel=0.15)
    assert errors.min() >= 0
    assert 0.03 < errors.max() <= 0.06


@pytest.mark.slow
def test_a_slope_without_a_known_temperature_is_drawn() -> None:
    """BMA180: +-0.5 mg/K are two sigma (BMA-115), of a gyroscope +-0.03 dps/degC at 250 dps (L3G-71)."""
    base, warm = fitted_to("static"), fitted_to("heating")
    assert not base.fitted["A1"].is_slope_known
    slopes = [effect.slope for effect in effects_drawn(base, "A1", ThermalBias)]
    assert np.std(slopes) == pytest.approx(2.5e-4 * 0.88, rel=0.15)
    assert np.abs(slopes).max() <= 5e-4
    assert warm.fitted["A1"].is_slope_known
    assert not any(effect.slope[0] for effect in warm.drawn(1)["A1"] if isinstance(effect, ThermalBias))


@pytest.mark.parametrize(("rows", "is_long"), some([(20_000, True), (500, False)], 1))
def test_replicates_have_the_usual_flicker_noise_in_long_phases(rows: int, *, is_long: bool) -> None:
    """White noise of 0.175 dps: the mean of 20,000 rows is known to 0.0012 dps, a sixth of the largest usual floor of
    0.008 dps, that of 500 rows to 0.008 dps. In 40 draws of three axes the floors are between 0 and that limit.
    """
    noise = np.random.default_rng(3).normal(size=(rows, 3))
    base = base_of_rows(noise, data_rate_hz=800.0, bandwidth_hz=50.0, ends_s=(rows / 200,))
    drawn_floors = [
        [rms / math.sqrt(5) for rms in effect.rms]
        for number in range(40)
        for effect in base.drawn(number)["G"]
        if isinstance(effect, BiasInstability)
    ]
    assert len(drawn_floors) == (40 if is_long else 0)  # no sensor is without flicker
    if is_long:
        assert 0 <= np.min(drawn_floors) < 0.002
        assert 0.006 < np.max(drawn_floors) <= 0.008


def test_flicker_noise_within_the_limit_is_usual() -> None:
    gyro = header("G", chip="l3g4200d")
    assert is_usual(usual_flicker((0.008, 0.001, 0.0)), gyro)
    assert not is_usual(usual_flicker((0.001, 0.01, 0.0)), gyro)
    assert not is_usual(BiasInstability((0.001,) * 3, 100.0), gyro)


@pytest.mark.slow
def test_the_curvature_of_a_bias_over_temperature_is_drawn() -> None:
    """The slope of a part changes by 0.15 % of it per degC (one sigma): 600 draws give that to 3 %."""
    warm = fitted_to("heating")
    curves = [effect.quadratic for effect in effects_drawn(warm, "G1", ThermalBias)]
    assert np.std(np.array(curves) / warm.fitted["G1"].slope) == pytest.approx(0.0015, rel=0.12)


def test_the_lag_of_an_element_that_no_heating_determines_is_drawn() -> None:
    """From 0 to 20 s, evenly: the mean of 200 draws is 10 s within three standard errors."""
    base = fitted_to("static")
    lags_s = [effect.time_constant_s for effect in effects_drawn(base, "A1", ThermalLag)]
    assert len(lags_s) == 200
    assert 0.0 <= min(lags_s) <= max(lags_s) <= 20.0
    assert np.mean(lags_s) == pytest.approx(10.0, abs=3 * 20 / math.sqrt(12 * 200))


@pytest.mark.slow
def test_the_stress_of_a_slowly_heated_board_is_drawn() -> None:
    """A part that warms up in 20 to 200 s changes the bias by 8 % of its slope (one sigma): 600 draws give that to 3 %,
    and 200 times spread evenly in their logarithm have a median within a fifth of the geometric mean, 63 s.
    """
    warm = fitted_to("heating")
    boards = effects_drawn(warm, "G1", ThermalLag)
    shares = np.array([board.slope for board in boards]) / warm.fitted["G1"].slope
    assert np.std(shares) == pytest.approx(0.08, rel=0.12)
    lags_s = [board.time_constant_s for board in boards]
    assert 20.0 <= min(lags_s) <= max(lags_s) <= 200.0
    assert np.median(lags_s) == pytest.approx(63.2, rel=0.2)


def test_the_response_is_bounded_by_the_tolerance() -> None:
    """Six faces: half of the difference of opposite faces is the response; beyond the tolerance, the bound."""
    forces = np.concatenate([np.eye(3), -np.eye(3)])
    truth = np.array([[0.01, 0.03, 0.0], [0.0, -0.05, 0.0], [-0.002, 0.0, 0.004]])
    levels = 0.1 + forces @ truth.T
    raw, bounded = response_of(levels, forces, np.full(3, 1e-4), np.full((3, 3), 0.02))
    np.testing.assert_allclose(raw, truth, atol=1e-5)
    np.testing.assert_allclose(bounded, np.clip(truth, -0.02, 0.02), atol=1e-5)
    for few in (levels[:1], np.zeros((0, 3))):
        assert not np.any(response_of(few, forces[: len(few)], np.full(3, 1e-4), np.full((3, 3), 0.02)))


def test_responses_that_no_face_determines_stay_at_the_prior() -> None:
    """Two opposite faces along z determine the response to force along z, and not to x and y."""
    forces = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    levels = np.array([[0.01, 0.0, 0.015], [-0.01, 0.0, -0.015]])
    raw, _ = response_of(levels, forces, np.full(3, 1e-4), np.full((3, 3), 0.02))
    np.testing.assert_allclose(raw[:, 2], [0.01, 0.0, 0.015], atol=1e-5)
    np.testing.assert_allclose(raw[:, :2], 0.0, atol=1e-12)


def test_seeds_of_replicates_are_unique() -> None:
    seeds = {replicate_seed(seed, number) for seed in range(20) for number in range(50)}
    assert len(seeds) == 1000
    assert 2**63 <= min(seeds) <= max(seeds) < 2**64


@pytest.mark.slow
@pytest.mark.parametrize(("lag_1", "expected"), some([(0.333, 35.0), (0.24, 45.4), (0.8, 17.5)], 1))
def test_a_configured_filter_is_fitted_where_it_is_observable(lag_1: float, expected: float) -> None:
    """35 Hz at 200 rows a second: exp(-2 pi 35 / 200) = 0.333; within half of 35 Hz."""
    low_pass = fitted_to_noise([math.sqrt(1 - lag_1**2)], [1.0, -lag_1]).low_pass
    assert low_pass is not None
    assert low_pass.cutoff_hz == pytest.approx(expected, rel=0.05)
    assert lag_1 == 0.8 or low_pass.poles == 1.0


def test_a_vibration_of_two_axes_is_no_filter() -> None:
    """A box that vibrates along two of the axes has correlated readings there; the third axis is white."""
    rng = np.random.default_rng(11)
    noise = rng.normal(size=(20_000, 3))
    noise[:, :2] += 0.3 * lfilter([1.0], [1.0, -1.9, 0.95], rng.normal(size=(20_000, 1)), axis=0)
    assert fitted_to_rows(noise, data_rate_hz=800.0, bandwidth_hz=90.0).low_pass is None


@pytest.mark.slow
def test_white_noise_gives_no_filter() -> None:
    """One of 250 recordings of 3000 rows gives a filter by chance, so that 3 of 40 do once in 1500 times."""
    each = [
        fitted_to_rows(np.random.default_rng(seed).normal(size=(3000, 3)), data_rate_hz=800.0, bandwidth_hz=50.0)
        for seed in range(40)
    ]
    assert sum(fitted.low_pass is not None for fitted in each) < 3


@pytest.mark.slow
def test_a_weak_filter_is_fitted_from_a_long_phase_among_short_ones() -> None:
    """90 Hz at 200 rows per second give a correlation of 0.06, a third of which is chance in each of 20 phases of 400
    rows, and a seventh in one of 12,000.
    """
    ends_s = [60, *range(62, 102, 2)]
    noise = lfilter([1.0], [1.0, -0.06], np.random.default_rng(5).normal(size=(20_000, 3)), axis=0)
    filtered = fitted_to_rows(noise, data_rate_hz=200.0, bandwidth_hz=70.0, ends_s=ends_s)
    assert low_pass_of(filtered).cutoff_hz == pytest.approx(90.0, rel=0.15)


def test_a_filter_of_two_poles_is_identified_by_its_second_lag() -> None:
    """Butterworth of 35 Hz, sampled 50 times as fast as the rows: after 5 ms 0.62, after 10 ms 0.19."""
    found = fitted_to_noise(*butter(2, 35.0, fs=10_000.0), every=50)
    assert low_pass_of(found).poles == 2.0
    assert low_pass_of(found).cutoff_hz == pytest.approx(35.0, rel=0.06)


def test_a_misfit_of_the_nearest_filter_widens_its_cutoff() -> None:
    """Correlations that differ from those of the filter by a twentieth of what all cutoffs of its kind change; ten
    times as much does not determine the cutoff.
    """
    kinds = (_Reads(200.0, 1.0),)
    expected = _filter_correlations(30.0, math.inf, kinds[0])[:, None]
    filters = dict(zip(_filters(30.0, math.inf), expected, strict=True))
    of_two_poles = sorted((effect for effect in filters if effect.poles == 2.0), key=lambda effect: effect.cutoff_hz)
    low, best, high = of_two_poles[0], of_two_poles[len(of_two_poles) // 2], of_two_poles[-1]
    more = 0.05 * (filters[high] - filters[low])
    measured = _Correlations(filters[best] + more, kinds, np.array([1e4]), np.array([1.0]), True)
    assert _form_error(measured, best, filters) == pytest.approx(0.05 * math.log(high.cutoff_hz / low.cutoff_hz))
    assert _form_error(measured._replace(values=filters[best]), best, filters) == 0.0
    assert _form_error(measured._replace(values=filters[best] + 10 * more), best, filters) == 0.1


@pytest.mark.parametrize("samples_a_row", some([0.5, 0.8], 1))
def test_a_filter_is_fitted_to_repeated_samples(samples_a_row: float) -> None:
    """Noise after a filter of 20 Hz, sampled at 160 or 100 Hz and read 200 times a second: its correlation is that of
    samples, exp(-2 pi 20 / 160) = 0.46 or 0.28, not that of rows (0.53).
    """
    data_rate_hz = 200 * samples_a_row
    phi = math.exp(-2 * math.pi * 20 / data_rate_hz)
    white = np.random.default_rng(8).normal(size=(20_000, 3))
    samples = lfilter([math.sqrt(1 - phi**2)], [1.0, -phi], white, axis=0)
    latest = np.floor(np.arange(20_000) * samples_a_row + 1e-9).astype(int)
    fitted = fitted_to_rows(samples[latest], data_rate_hz=data_rate_hz, bandwidth_hz=25.0)
    assert low_pass_of(fitted).poles == 1.0
    assert low_pass_of(fitted).cutoff_hz == pytest.approx(20.0, rel=0.06)


def test_a_digital_filter_is_distinguished_from_an_analogue_one() -> None:
    """Noise that a converter samples at 200 Hz, the rate of the rows, ends at 100 Hz: after one pole at 50 Hz the
    transform of 1 / (1 + f^2 / 50^2) up to there has correlations of 0.335, 0.048 and 0.019.
    """
    rows = 20_000
    shape = 1 / (1 + 1j * np.fft.rfftfreq(rows, 1 / 200) / 50)
    noise = np.fft.irfft(np.fft.rfft(np.random.default_rng(4).normal(size=(rows, 3)), axis=0) * shape[:, None], axis=0)
    assert np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1] == pytest.approx(0.335, abs=0.02)
    found = fitted_to_rows(noise, data_rate_hz=200.0, bandwidth_hz=50.0)
    assert low_pass_of(found).sampled_hz == 200.0
    assert low_pass_of(found).poles == 1.0
    assert low_pass_of(found).cutoff_hz == pytest.approx(50.0, rel=0.05)


@pytest.mark.parametrize("slow", [0.004, 0.03])
@pytest.mark.parametrize("rows_a_reading", [1, 2])
def test_a_slow_data_clock_is_estimated_from_repeated_readings(slow: float, rows_a_reading: int) -> None:
    """Of n polls at the nominal rate (or twice that), n (1 - e) (or half of that) return a new reading."""
    noise = np.random.default_rng(5).normal(size=(20_000, 3))
    latest = np.floor(np.arange(20_000) * (1 - slow) / rows_a_reading).astype(int)
    found = fitted_to_rows(noise[latest], data_rate_hz=200.0 / rows_a_reading, bandwidth_hz=50.0)
    assert found.clock_error == pytest.approx(-slow, abs=2e-4)


def test_a_slow_clock_is_estimated_from_flags_where_readings_are_often_equal() -> None:
    """Of 2000 polls 24 return no new reading: 1.2 % slow. Coarse counts are equal by chance in one of ten rows, which
    hides 24 repeats; the flags don't.
    """
    coarse = np.random.default_rng(5).normal(size=(2000, 3))
    latest = np.floor(np.arange(2000) * (1 - 0.012)).astype(int)
    is_stale = np.append(False, np.diff(latest) == 0)
    assert np.count_nonzero(is_stale) == 24
    unflagged, flagged = (
        fitted_to_rows(coarse[latest], data_rate_hz=200.0, bandwidth_hz=50.0, counts_rms=0.6, stale=stale)
        for stale in (None, is_stale)
    )
    assert math.isnan(unflagged.clock_error)
    assert flagged.clock_error == pytest.approx(-0.012, abs=1e-3)


def test_readings_that_are_equal_after_a_repeat_do_not_hide_a_slow_clock() -> None:
    """Three equal rows in a row, of which the recorder flags one: a repeat, and a reading that is equal by chance."""
    noise = np.random.default_rng(6).normal(size=(2000, 3))
    latest = np.floor(np.arange(2000) * (1 - 0.012)).astype(int)
    is_stale = np.append(False, np.diff(latest) == 0)
    after = latest[np.flatnonzero(is_stale)[:3]] + 1
    noise[after] = noise[after - 1]
    noise[[500, 900, 1200]] = noise[[499, 899, 1199]]
    result = fitted_to_rows(noise[latest], data_rate_hz=200.0, bandwidth_hz=50.0, stale=is_stale)
    assert result.clock_error == pytest.approx(-0.012, abs=1e-3)


@pytest.mark.parametrize("second", [0.048, 0.036])
def test_a_wander_needs_equal_correlations_within_chance(second: float) -> None:
    """Correlations of a heated MPU-6050 after a filter of 42 Hz, Butterworth, at 100 rows a second: 0.103 and -0.033,
    and a wander with a share of 0.035; in 24,000 rows each correlation is uncertain by 0.0065.
    """
    lags = np.array([[0.134, 0.003, 0.036, second, 0.035]])
    share = _wander(lags, np.zeros((1, 5)), np.array([4 / math.sqrt(24_000)]))
    assert share.tolist() == [[0.035 if second < 0.04 else 0.0]]


def test_a_configured_filter_is_assumed_without_evidence() -> None:
    """Butterworth of 130 Hz at 200 rows a second: -0.040 after a row, by 3000 rows uncertain by 0.018 on each axis."""
    noise = lfilter(*butter(2, 130.0, fs=10_000.0), np.random.default_rng(3).normal(size=(150_000, 3)), axis=0)[::50]
    filtered = fitted_to_rows(noise, data_rate_hz=2400.0, bandwidth_hz=130.0, ends_s=(15,))
    assert low_pass_of(filtered).cutoff_hz == pytest.approx(130.0, rel=0.01)
    assert low_pass_of(filtered).poles == 2.0


@pytest.mark.slow
def test_a_filter_at_half_the_data_rate_is_not_assumed() -> None:
    """White noise at 200 rows a second of a chip that samples at 200 Hz with a bandwidth of 100 Hz: a digital filter of
    100 Hz has a zero there, which these rows lack.
    """
    noises = np.random.default_rng(4).normal(size=(12, 3000, 3))
    fitted = [fitted_to_rows(noise, data_rate_hz=200.0, bandwidth_hz=100.0, ends_s=(15,)) for noise in noises]
    assert [parameters.low_pass for parameters in fitted] == [None] * 12


@pytest.mark.parametrize("wander_rms", [0.0, 0.4])
def test_a_short_digital_filter_has_the_measured_correlations(wander_rms: float) -> None:
    """Taps 1, 0.25 and -0.157 give (0.25 - 0.157 x 0.25) / 1.087 = 0.194 after a row, -0.144 after two and zero later,
    unlike any filter of one or two poles. A wander adds equally to all lags.
    """
    generator = np.random.default_rng(7)
    noise = lfilter([1.0, 0.25, -0.157], [1.0], generator.normal(size=(20_000, 3)), axis=0)
    wander = math.sqrt(2) * wander_rms * np.sin(2 * np.pi * (np.arange(20_000)[:, None] / 200 / 60 + [0.1, 0.4, 0.7]))
    fitted = fitted_to_rows(noise + wander, data_rate_hz=200.0, bandwidth_hz=100.0)
    assert low_pass_of(fitted).correlations[:2] == pytest.approx((0.194, -0.144), abs=0.02)
    assert np.abs(low_pass_of(fitted).correlations[2:]).max() < 0.02


def test_half_of_the_replicates_have_the_measured_correlations() -> None:
    """One pole at 35 Hz read at the data rate of 200 Hz: 0.333 after one sample and 0.111 after two. Their share among
    400 replicates is a half within three standard errors, 0.075.
    """
    phi = math.exp(-2 * math.pi * 35 / 200)
    noise = lfilter([math.sqrt(1 - phi**2)], [1.0, -phi], np.random.default_rng(7).normal(size=(20_000, 3)), axis=0)
    base = base_of_rows(noise, 200.0, 35.0)
    measured = base.fitted["G"].measured_low_pass
    assert measured is not None
    assert measured.correlations[:2] == pytest.approx((0.333, 0.111), abs=0.02)
    is_measured = [measured in base.effects(number)["G"] for number in range(400)]
    assert np.mean(is_measured) == pytest.approx(0.5, abs=0.075)
    assert is_measured == [base.filter_draw("G", number).is_measured for number in range(400)]


@pytest.mark.parametrize("wander_rms", [0.0, 0.5, 1.0])
def test_a_filter_is_fitted_in_the_presence_of_a_slow_wander(wander_rms: float) -> None:
    """One pole at 35 Hz: 0.333 at the first lag; a wander over a minute makes it 0.67 where both have the same rms."""
    generator = np.random.default_rng(7)
    phi = math.exp(-2 * math.pi * 35 / 200)
    noise = lfilter([math.sqrt(1 - phi**2)], [1.0, -phi], generator.normal(size=(20_000, 3)), axis=0)
    time_s = np.arange(20_000)[:, None] / 200
    wander = math.sqrt(2) * wander_rms * np.sin(2 * np.pi * (time_s / 60 + [0.1, 0.4, 0.7]))
    result = fitted_to_rows(noise + wander, data_rate_hz=800.0, bandwidth_hz=35.0)
    assert low_pass_of(result).cutoff_hz == pytest.approx(35.0, rel=0.1)


@pytest.mark.slow
def test_a_drift_in_short_phases_gives_no_filter() -> None:
    """White noise: 600 rows without a drift, and 12 phases of 550 rows that drift by 0.8 of its standard deviation,
    which adds 0.05 to their correlations. Fitted to all phases 9 of 20 recordings have a filter, by chance one of 250.
    """
    ends_s = np.arange(3.0, 36.1, 2.75).tolist()
    drift = np.zeros(20_000)
    drift[600:7200] = 0.8 * (np.arange(6600) % 550) / 550
    each = [
        fitted_to_rows(
            np.random.default_rng(seed).normal(size=(20_000, 3)) + drift[:, None], 800.0, 50.0, ends_s=ends_s
        )
        for seed in range(20)
    ]
    assert sum(fitted.low_pass is not None for fitted in each) <= 1


@pytest.mark.slow
@pytest.mark.parametrize(("cutoff_hz", "poles"), some([(6.0, 2), (12.0, 1), (12.0, 2), (25.0, 1)], 1))
def test_correlated_noise_is_not_underestimated(cutoff_hz: float, poles: int) -> None:
    """Segments of 312 rows: about their own mean rows after a filter of 6 Hz vary by 5 % less, and their median is
    lower.
    """
    white = np.random.default_rng(8).normal(size=(400_000, 3))
    noise = lfilter(*butter(poles, cutoff_hz, fs=4000.0), white, axis=0)[::20]
    result = fitted_to_rows(noise, data_rate_hz=800.0, bandwidth_hz=cutoff_hz)
    assert low_pass_of(result).cutoff_hz == pytest.approx(cutoff_hz, rel=0.1)
    rms = noise.std() * 20.0 / noise.std() / header("G", chip="l3g4200d", rate_hz=800.0).sensitivity
    each = noise.std(axis=0) / noise.std() * rms
    np.testing.assert_allclose(result.rms, each, rtol=0.03)


def test_alternately_early_and_late_polls_give_the_nominal_rate() -> None:
    """Polls alternately 1 ms early and late, of readings made 0.5 ms after each of the nominal moments: every other
    poll returns no new reading, and the others report a missed reading. Equal numbers of overruns and repeats mean no
    clock error.
    """
    polls = np.arange(2000) + 0.2 * (-1.0) ** np.arange(2000)
    latest = np.floor(polls - 0.1).astype(int) + 1
    fewer = np.append(1, np.diff(latest))
    assert set(fewer.tolist()[1:]) == {0, 2}
    noise = np.random.default_rng(5).normal(size=(2001, 3))
    found = fitted_to_rows(noise[latest], 200.0, 50.0, stale=fewer == 0, overrun=fewer == 2)
    assert found.clock_error == 0.0


def test_a_single_hold_does_not_change_the_clock() -> None:
    """Readings that are 1.6 % slower than the polls are repeated every 62 rows. One is held for 25 rows: the other log
    determines the clock; without it nothing does.
    """
    latest = np.floor(np.arange(20_000) * 0.984).astype(int)
    latest[15_000:15_025] = latest[15_000]
    noise = np.random.default_rng(5).normal(size=(20_000, 3))[latest]
    found = fitted_to_rows(noise, data_rate_hz=200.0, bandwidth_hz=50.0, ends_s=(50, 100))
    assert found.clock_error == pytest.approx(-0.016, abs=2e-4)
    assert math.isnan(fitted_to_rows(noise, data_rate_hz=200.0, bandwidth_hz=50.0).clock_error)


def test_random_repeats_are_not_a_slow_clock() -> None:
    """Of 20,000 rows, each of which repeats the previous row with a chance of 3 %, about 18 do so twice in a row."""
    generator = np.random.default_rng(6)
    noise, repeats = generator.normal(size=(20_000, 3)), generator.random(20_000) < 0.03
    latest = np.maximum.accumulate(np.where(repeats, 0, np.arange(20_000)))
    assert math.isnan(fitted_to_rows(noise[latest], data_rate_hz=200.0, bandwidth_hz=50.0).clock_error)


def test_a_clock_beyond_its_tolerance_is_not_fitted() -> None:
    noise = np.random.default_rng(5).normal(size=(20_000, 3))
    latest = np.floor(np.arange(20_000) * 0.85).astype(int)
    assert math.isnan(fitted_to_rows(noise[latest], data_rate_hz=200.0, bandwidth_hz=50.0).clock_error)


def low_pass_of(fitted: FittedParameters) -> Bandwidth:
    assert fitted.low_pass is not None
    return fitted.low_pass


def fitted_to_noise(over: Sequence[float], under: Sequence[float], every: int = 1) -> FittedParameters:
    """A gyroscope configured to 35 Hz with filtered noise at 200 rows per second."""
    noise = lfilter(over, under, np.random.default_rng(3).normal(size=(20_000 * every, 3)), axis=0)[::every]
    return fitted_to_rows(noise, data_rate_hz=800.0, bandwidth_hz=35.0)


def fitted_to_rows(
    noise: npt.NDArray[np.float64], data_rate_hz: float, bandwidth_hz: float, **settings: Any
) -> FittedParameters:
    """Return the parameters of `base_of_rows`."""
    return base_of_rows(noise, data_rate_hz, bandwidth_hz, **settings).fitted["G"]


def base_of_rows(
    noise: npt.NDArray[np.float64],
    data_rate_hz: float,
    bandwidth_hz: float,
    counts_rms: float = 20.0,
    stale: npt.NDArray[np.bool_] | None = None,
    overrun: npt.NDArray[np.bool_] | None = None,
    ends_s: Sequence[float] = (100,),
) -> Base:
    """A gyroscope with these settings and that noise (n, 3) of so many counts at 200 rows per second, in logs up to
    each of `ends_s`; the recorder flags the rows that are `stale` and `overrun` (n,), or none.
    """
    gyro = header("G", chip="l3g4200d", rate_hz=data_rate_hz, bandwidth_hz=bandwidth_hz)
    rows = block(np.rint(counts_rms * noise / noise.std()), 5_000_000)
    for flag, flagged in ((STALE, stale), (OVERRUN, overrun)):
        if flagged is not None:
            rows = rows._replace(status=rows.status | np.where(flagged, np.uint16(flag), np.uint16(0)))
    logs = [
        summarise_log(
            "static",
            {"G": OneBlock(gyro, Block(*(column[round(begin * 200) : round(end * 200)] for column in rows[:3])))},
            [Phase(round(begin * 1e9), round(end * 1e9), "static", "+Z")],
            LogReference(lambda time_ns: np.full(len(time_ns), 25.0)),
        )
        for begin, end in pairwise((0, *ends_s))
    ]
    return fit(Campaign(tuple(logs)), [Still()] * len(logs))


@pytest.mark.slow
def test_places_of_accelerometers_are_drawn_near_those_of_the_header() -> None:
    """Within 1.5 mm (one sigma) along each axis, independently; the place of a gyroscope has no effect. 200 draws give
    the mean to 0.11 mm and the standard deviation to 0.08 mm.
    """
    base = fitted_to("static")
    headers = {name: replace(header, position_mm=(10.0, 0.0, -5.0)) for name, header in base.headers.items()}
    places = [_places_mm(replace(base, headers=headers).drawn(replicate)) for replicate in range(200)]
    assert {name for each in places for name in each} == {"A1", "A2"}
    first, second = (np.array([each[name] for each in places]) for name in ("A1", "A2"))
    np.testing.assert_allclose(first.mean(axis=0), (10.0, 0.0, -5.0), atol=0.45)
    np.testing.assert_allclose(first.std(axis=0), 1.5, atol=0.35)
    assert np.abs(np.corrcoef(first[:, 0], second[:, 0])[0, 1]) < 0.3


def _places_mm(drawn: Mapping[str, Sequence[Effect]]) -> dict[str, Triple]:
    effects = ((name, effect) for name, several in drawn.items() for effect in several)
    return {name: effect.position_mm for name, effect in effects if isinstance(effect, SizeEffect)}


def test_rows_of_a_queue_are_new_readings_for_any_clock() -> None:
    """They are not polled, so that none is older than its stamp; rows of other sensors may be, in odd-numbered
    replicates.
    """
    base = replace(fitted_to("static"), queued=frozenset({"G1"}))
    polled = {
        name: [one.polled for one in effects if isinstance(one, OwnClock)] for name, effects in base.drawn(1).items()
    }
    assert (polled["G1"], polled["G2"]) == ([], [1.0])


@pytest.mark.slow
def test_accelerometers_of_a_replicate_have_a_common_bias() -> None:
    """The same in the box frame for any mounting of a chip; gyroscopes have none. 400 draws give the standard deviation
    to 3.5 %.
    """
    base = fitted_to("static")
    headers = {**base.headers, "A2": replace(base.headers["A2"], axes="-Y+Z-X")}
    base = replace(base, headers=headers, common_bias_g=0.05)
    drawn = []
    for number in range(400):
        biases = {
            name: [np.array(effect.offset) for effect in effects if isinstance(effect, Bias)]
            for name, effects in base.drawn(number).items()
        }
        assert biases["G1"] == biases["G2"] == []
        boxes = [np.array(headers[name].orientation) @ biases[name][0] for name in ("A1", "A2")]
        np.testing.assert_allclose(boxes[0], boxes[1], atol=1e-15)
        drawn.append(boxes[0])
    np.testing.assert_allclose(np.std(drawn, axis=0), 0.05, rtol=0.15)
    np.testing.assert_allclose(np.mean(drawn, axis=0), 0.0, atol=0.01)


@pytest.mark.slow
def test_a_machine_in_the_surroundings_runs_in_some_logs_only() -> None:
    """In half of the replicates a line acts in all logs, in the others in half of them, for both sensors alike."""
    base = fit(campaign_of("static"), PLANS["static"])
    base = replace(base, ambient_lines=(AmbientLine(17.0, (0.01, 0.0, 0.0), ("A1", "A2")),))
    tones = [
        [next(effect for effect in base.drawn(number)[name] if isinstance(effect, Tone)) for name in ("A1", "A2")]
        for number in range(40)
    ]
    assert all(first.spans == second.spans for first, second in tones)
    in_some = [[acting(first, run) is not None for run in range(40)] for first, _ in tones if first.spans]
    assert 10 <= len(in_some) <= 30
    assert 0.4 < np.mean(in_some) < 0.6
