"""Nuisance quantities are fitted: the lag of an element, a line of the surroundings, the delay of a filter, and one
attitude in several phases of a log; expected values are those of the simulation.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
import pytest

from imuarray.arrays import Integers
from imuarray.characterise.spectrum import Welch
from imuarray.gap.model.ambient_lines import MOST_G, _picked_up, _Spectrum, fit_ambient_lines
from imuarray.gap.model.base_model import fit
from imuarray.gap.model.element_temperature import LONGEST_DIE_LAG_S
from imuarray.gap.model.nuisance import nuisance_estimates
from imuarray.gap.model.populations import LONGEST_LAG_S, response_tolerance
from imuarray.gap.model.signal_delay import (
    NO_DELAY,
    SignalDelay,
    _odd_units,
    _Problem,
    _slopes,
    _step,
    fit_signal_delays,
    stated_delay,
)
from imuarray.gap.recording.attitude import attitude_numbers, shared_readings
from imuarray.gap.recording.recordings import CHIP_LEAD_S, reference_of
from imuarray.gap.recording.source import simulated_sources
from imuarray.gap.statistics.campaign import Campaign, summarise_log
from imuarray.gap.statistics.lines import highest_lines
from imuarray.log.format import Phase, SensorHeader
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bandwidth import Bandwidth
from imuarray.simulate.effects.bias import CommonMode
from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.effects.temperature import ThermalBias, ThermalLag
from imuarray.simulate.motion.faces import Still
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.stimulus import BoxStimulus
from tests.gap.small_campaign import PLANS, SECOND, campaign_of, phases_of, simulation
from tests.selection import some


@pytest.mark.slow
@pytest.mark.parametrize("lag_s", some([4.0, 12.0], 1))
def test_the_lag_of_one_chip_is_fitted_and_its_slope_with_it(lag_s: float) -> None:
    base = fit(campaign_of("heating", {"G1": (ThermalLag(lag_s),)}, seed=3), PLANS["heating"])
    assert base.fitted["G1"].lag_s == pytest.approx(lag_s, rel=0.1)
    assert base.fitted["G1"].slope == pytest.approx((0.05,) * 3, rel=0.01)
    assert base.fitted["G2"].lag_s == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize(("slope", "expected_s"), some([(0.0, LONGEST_DIE_LAG_S), (-0.05, LONGEST_LAG_S)], 1))
def test_a_lag_beyond_the_usual_is_left_to_the_effect(slope: float, expected_s: float) -> None:
    """A die whose thermometer has the same lag, and elements whose thermometer follows the box without lag: with the
    slope of the array, +0.05 dps/degC, no element follows without lag.
    """
    at_once = (ThermalBias((slope,) * 3),) if slope else ()
    lag = ThermalLag(100.0, (-slope,) * 3) if slope else ThermalLag(100.0)
    base = fit(campaign_of("heating", {"G1": (*at_once, lag)}, seed=3), PLANS["heating"])
    assert base.fitted["G1"].lag_s == expected_s


@pytest.mark.slow
def test_an_element_may_have_the_lag_of_the_dies_on_the_board() -> None:
    """One die lags by 30 s by its thermometer, an accelerometer by 35 s; without the first, this lag is unusual."""
    late = {"A1": (ThermalLag(35.0),), "G1": (ThermalLag(30.0),)}
    for effects, expected_s in ((late, 35.0), ({"A1": late["A1"]}, LONGEST_LAG_S)):
        campaign = without_thermometer(campaign_of("heating", effects, seed=3), "A1")
        assert fit(campaign, PLANS["heating"]).fitted["A1"].lag_s == pytest.approx(expected_s, rel=0.05)


def without_thermometer(campaign: Campaign, name: str) -> Campaign:
    logs = []
    for log in campaign.logs:
        parts = []
        for part in log.phases:
            segments = part.sensors[name].segments
            segments = replace(segments, thermometer=np.full(len(segments.rows), np.nan))
            parts.append(replace(part, sensors={**part.sensors, name: replace(part.sensors[name], segments=segments)}))
        logs.append(replace(log, phases=tuple(parts)))
    return Campaign(tuple(logs))


class Leading(Heating):
    """A heating whose temperature is measured by a thermometer with a lag of 5 s, which is corrected."""

    lead_s = 5.0


@pytest.mark.slow
def test_elements_have_the_usual_lag_of_the_thermometer_or_a_fitted_one() -> None:
    """Fitted from readings that follow the temperature without lag; without a slope it is not observable, and the lag
    is the usual one.
    """
    leading = [Leading(scale=0.02)]
    assert fit(campaign_of("heating", {}, seed=3), leading).fitted["G1"].lag_s == pytest.approx(0.0, abs=0.2)
    level = {"G1": (ThermalBias((-0.05,) * 3),)}
    assert fit(campaign_of("heating", level, seed=3), leading).fitted["G1"].lag_s == CHIP_LEAD_S


class Warming(Still):
    """A box at rest that is warmed from 24 to 52 degC, with a time constant of a minute."""

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        return replace(super().stimulus(time_ns), temperature_degc=24 + 28 * (1 - np.exp(-time_ns / 60e9)))


@pytest.mark.parametrize("lag_s", [0.0, 8.0])
def test_a_curved_bias_in_a_monotonic_heating_gives_the_lag_of_its_element(lag_s: float) -> None:
    """Such a curve is a straight line in an earlier temperature rather than in the present one."""
    motion = Warming(seconds=300.0)
    effects = (ThermalBias(quadratic=(0.002, -0.002, 0.001)), *((ThermalLag(lag_s),) if lag_s else ()))
    sources = simulated_sources(simulation(motion, {"G1": effects}, seed=3))
    campaign = Campaign((summarise_log("heating", sources, phases_of(motion), reference_of(motion)),))
    assert fit(campaign, [motion]).fitted["G1"].lag_s == pytest.approx(lag_s, abs=0.5)


def test_without_heating_no_lag_is_fitted() -> None:
    assert {parameters.lag_s for parameters in fit(campaign_of("static"), PLANS["static"]).fitted.values()} == {0.0}


def vibrating(
    amplitude_g: float, *names: str, array: Collection[str] = ("A1", "A2", "G1", "G2"), seconds: float = 600
) -> tuple[float, ...]:
    """Amplitudes along X of the ambient lines at 17 Hz fitted to a time at rest in which these sensors of an array,
    which are along X, have a line of this amplitude there.
    """
    tone, motion = Tone((amplitude_g, 0.0, 0.0), 17.0, phase_deg=30.0), Still(seconds=seconds)
    sources = simulated_sources(simulation(motion, dict.fromkeys(names, (tone,)), seed=5))
    campaign = Campaign((summarise_log("static", sources, phases_of(motion), reference_of(motion)),))
    headers = {name: part.header for name, part in campaign.logs[0].phases[0].sensors.items() if name in array}
    fitted = fit_ambient_lines(campaign, headers)
    return tuple(item.amplitude_box[0] / 9.80665 for item in fitted if abs(item.frequency_hz - 17.0) < 0.2)


@pytest.mark.slow
def test_a_weak_line_of_all_accelerometers_is_of_the_room() -> None:
    (amplitude_g,) = vibrating(4e-4, "A1", "A2")
    assert amplitude_g == pytest.approx(4e-4, rel=0.15)


@pytest.mark.slow
def test_a_line_of_one_accelerometer_is_not_of_the_room() -> None:
    assert vibrating(4e-4, "A1") == ()


def test_a_line_that_only_just_shows_in_one_accelerometer_would_show_in_an_equal_one() -> None:
    """20 s with 4 mg of noise: by the bins of the peak, each accelerometer shows 1.3 mg with four standard deviations.
    A line that one of them lacks is of the sensor; that of a single accelerometer may be of the room.
    """
    assert vibrating(1.3e-3, "A1", array=("A1", "A2"), seconds=20) == ()
    assert vibrating(1.3e-3, "A1", array=("A1",), seconds=20) == pytest.approx((1.3e-3,), rel=0.25)


@pytest.mark.parametrize(("amplitude_g", "is_of_room"), some([(2e-3, True), (5e-3, False)], 1))
def test_a_line_of_a_single_accelerometer_may_be_of_the_room(amplitude_g: float, *, is_of_room: bool) -> None:
    """Without another accelerometer in the array it cannot be told, up to an amplitude of some milli-g."""
    lines = vibrating(amplitude_g, "A1", array=("A1",))
    assert lines == pytest.approx((amplitude_g,) * is_of_room, rel=0.15)


@pytest.mark.slow
def test_a_strong_line_of_several_sensors_is_of_the_surroundings() -> None:
    (amplitude_g,) = vibrating(10 * MOST_G, "A1", "A2")
    assert amplitude_g == pytest.approx(10 * MOST_G, rel=0.15)
    assert vibrating(3 * MOST_G, "A1") == ()
    rate = 0.2  # dps, which the function converts to g
    (amplitude,) = vibrating(rate, "G1", "G2")
    assert amplitude * 9.80665 == pytest.approx(np.radians(rate), rel=0.15)
    assert vibrating(rate, "G1") == ()


@pytest.mark.parametrize(("share", "hertz", "count"), [(0.13, 60.0, 2), (0.13, 57.0, 0), (0.25, 60.0, 0)])
def test_a_faint_line_of_the_mains_is_picked_up(share: float, hertz: float, count: int) -> None:
    """An eighth of the noise of a gyroscope, and less of another one, along other axes, in rows of 100 Hz; no other
    frequency, and not a quarter of the noise.
    """
    motion, noise_dps = Still(seconds=600), 0.05
    tone = Tone((0.0, share * noise_dps, 0.0), hertz)
    weaker = Tone((0.9 * share * noise_dps, 0.0, 0.0), hertz)
    sources = simulated_sources(simulation(motion, {"G1": (tone,), "G2": (weaker,)}, seed=5))
    campaign = Campaign((summarise_log("static", sources, phases_of(motion), reference_of(motion)),))
    headers = {name: part.header for name, part in campaign.logs[0].phases[0].sensors.items() if name in ("G1", "G2")}
    lines = fit_ambient_lines(campaign, headers)
    assert [name for line in lines for name in line.sensors] == ["G1", "G2"][:count]


@pytest.mark.parametrize(
    ("quantity", "unit", "share", "is_picked_up"),
    [
        ("magnetic_field", "gauss", 0.1, True),
        ("magnetic_field", "gauss", 0.3, False),
        ("angular_rate", "dps", 0.1, False),
    ],
)
def test_a_magnetometer_measures_currents_of_any_frequency(
    quantity: str, unit: str, share: float, *, is_picked_up: bool
) -> None:
    """A line at 17 Hz in 200,000 rows at 80 Hz, with an amplitude that is a `share` of the noise."""
    header = SensorHeader("S", "unheard_of", quantity, unit, 8.0, 1000.0)
    counts = np.random.default_rng(2).normal(0, 5, (200_000, 3))
    counts[:, 1] += share * 5 * np.sin(2 * np.pi * 17 * np.arange(200_000) / 80)
    welch = Welch(80.0, 1024, 3)
    welch.update(counts)
    member = _Spectrum(header, welch.result(), 80.0)
    (line,) = highest_lines(member.spectrum, 1)
    hertz = line.bin * 80.0 / 1024
    assert hertz == pytest.approx(17.0, abs=0.05)
    assert (_picked_up(member, line, hertz) is not None) == is_picked_up


@pytest.mark.parametrize(
    ("effect", "count"), [(CommonMode((1.0, 1.0, 1.0), 1.0), 0), (Tone((0.06, 0.06, 0.0), 0.3, phase_deg=30.0), 1)]
)
def test_a_common_wander_of_gyroscopes_is_no_line(effect: Effect, count: int) -> None:
    """A wander with a corner at 0.16 Hz is highest in the lowest bins, as a line at 0.3 Hz is, but broad."""
    motion = Still(seconds=100)
    sources = simulated_sources(simulation(motion, dict.fromkeys(("G1", "G2"), (effect,)), seed=5))
    campaign = Campaign((summarise_log("static", sources, phases_of(motion), reference_of(motion)),))
    headers = {name: part.header for name, part in campaign.logs[0].phases[0].sensors.items()}
    lines = [line for line in fit_ambient_lines(campaign, headers) if {"G1", "G2"} & set(line.sensors)]
    assert len(lines) == count


@pytest.mark.slow
def test_the_delay_of_filters_is_fitted_in_motion() -> None:
    """Both gyroscopes have the same configuration; with 12.5 Hz instead of 35 one of them has an additional delay of
    11.6 ms.
    """
    campaign = campaign_of("motion", {"G1": (Bandwidth(12.5, share=1.0, poles=2.0, signal_only=1.0),)}, seed=2)
    headers = {name: part.header for name, part in campaign.logs[0].phases[0].sensors.items()}
    headers["G1"] = replace(headers["G1"], bandwidth_hz=12.5)
    simulated = [campaign_of("motion", seed=seed) for seed in (11, 12, 13)]
    delays = fit_signal_delays(campaign, headers, (), [(dict.fromkeys(headers, NO_DELAY), simulated)])
    difference_s = delays["G1"].filter_s - delays["G2"].filter_s
    own_s = 1 / (math.sqrt(2) * math.pi * 12.5)  # G2 has no filter here
    assert difference_s == pytest.approx(own_s, rel=0.25)


def test_a_filter_without_a_delay_is_not_fitted() -> None:
    """Synchronous sensors of one cutoff: a delay of a picosecond would give a cutoff that no effect accepts."""
    campaign = campaign_of("motion", seed=2)
    headers = {name: part.header for name, part in campaign.logs[0].phases[0].sensors.items()}
    headers["G1"] = replace(headers["G1"], bandwidth_hz=1e4)
    delays = fit_signal_delays(campaign, headers, (), [(dict.fromkeys(headers, NO_DELAY), [campaign])])
    assert {delays[name].filter_s for name in ("G1", "G2")} == {0.0}


def test_a_delay_stated_in_the_log_is_simulated_unchanged() -> None:
    """It is not a parameter of the fit, which then gives no other delay in a motion that both gyroscopes follow
    synchronously.
    """
    campaign = campaign_of("motion", seed=2)
    headers = {name: part.header for name, part in campaign.logs[0].phases[0].sensors.items()}
    headers["G1"] = replace(headers["G1"], bandwidth_hz=41.0, delay_ns=5_900_000)
    simulated = {name: stated_delay(header) for name, header in headers.items()}
    delays = fit_signal_delays(campaign, headers, (), [(simulated, [campaign])])
    assert delays["G1"] == pytest.approx((0.0, 0.0059))
    assert delays["G2"].stamp_s == 0.0


def phases(*ends_s: tuple[float, float, str]) -> list[Phase]:
    return [Phase(round(start * SECOND), round(stop * SECOND), "static", up) for start, stop, up in ends_s]


def test_steps_of_a_heating_share_an_attitude() -> None:
    """Also their first or second halves alone; a box that was turned in between has another attitude."""
    whole = phases((0, 20, "+Z"), (20, 60, "+Z"), (60, 100, "+Z"), (104, 120, "-X"), (120, 130, "+Z"))
    assert attitude_numbers(whole) == [0, 0, 0, 1, 2]
    halves = phases((0, 10, "+Z"), (20, 40, "+Z"), (60, 80, "+Z"), (104, 112, "-X"))
    assert attitude_numbers(halves) == [0, 0, 0, 1]
    others = phases((10, 20, "+Z"), (40, 60, "+Z"), (80, 100, "+Z"), (112, 120, "-X"))
    assert attitude_numbers(others) == [0, 0, 0, 1]
    assert attitude_numbers(phases((0, 10, "+Z"), (13, 20, "+Z"))) == [0, 1]  # put down again
    assert attitude_numbers(phases((0, 10, ""), (10, 20, ""))) == [0, 1]  # without a note


def test_readings_in_one_attitude_are_averaged() -> None:
    readings = np.array([[[1.0, 0, 0]], [[3.0, 0, np.nan]], [[7.0, 0, 0]]])
    shared = shared_readings([0, 0, 1], readings)
    np.testing.assert_array_equal(shared[:, 0], [[2, 0, 0], [2, 0, 0], [7, 0, 0]])


def test_the_apparent_delay_of_a_fast_motion_is_corrected() -> None:
    """Twice as much in the first row, as much as expected in the second; in the last nothing was changed."""
    design = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    before = np.array([0.0, 0.001]), np.array([0.001, 0.002, 0.003])
    after = np.array([0.002, 0.002]), np.array([0.005, 0.003, 0.004])
    np.testing.assert_allclose(_slopes(design, before, after), [2.0, 1.0, 1.0])


def test_the_noise_is_compared_with_the_data_sheet() -> None:
    """150 ug/sqrt(Hz) (BMA-110) at 600 Hz are 3.67 mg; four times as much is 12.04 dB, the same within its rounding."""
    campaign = campaign_of("static")
    base = fit(campaign, [Still(seconds=60.0)], seed=0)
    name = next(name for name, header in base.headers.items() if header.chip == "bma180")
    header = replace(base.headers[name], bandwidth_hz=600.0)
    printed = 150e-6 * math.sqrt(600.0)
    fitted = replace(base.fitted[name], rms=(printed, 4 * printed, printed / 4))
    estimates = nuisance_estimates(
        campaign, replace(base, headers={name: header}, fitted={name: fitted}), has_reference=False
    )
    x, y, z = (estimate for estimate in estimates if estimate.quantity == "noise")
    assert (x.axis, x.unit) == ("x", "dB")
    assert (x.value, y.value, z.value) == pytest.approx((0.0, 12.04, -12.04), abs=0.1)
    assert math.isnan(y.pull)  # a typical figure has no tolerance


def test_a_noise_without_a_data_sheet_figure_is_not_compared() -> None:
    campaign = campaign_of("static")
    base = fit(campaign, [Still(seconds=60.0)], seed=0)
    unknown = {name: replace(header, bandwidth_hz=0.0, rate_hz=0.0) for name, header in base.headers.items()}
    estimates = nuisance_estimates(campaign, replace(base, headers=unknown), has_reference=False)
    assert "noise" not in {estimate.quantity for estimate in estimates}


@pytest.mark.parametrize(("accelerometers", "widening"), [(1, 1.0), (2, 1.0), (3, 1.234), (9, 1.0838)])
def test_a_misalignment_is_relative_to_the_median_of_the_accelerometers(accelerometers: int, widening: float) -> None:
    """The root of 1 + pi / 6 for three of them. A scale error does not depend on the attitude."""
    sensors = campaign_of("static").logs[0].phases[0].sensors.values()
    part = next(sensor.header for sensor in sensors if sensor.header.quantity == "specific_force")
    alone, among = response_tolerance(part), response_tolerance(part, accelerometers)
    assert np.arcsin(among[0, 1]) == pytest.approx(widening * np.arcsin(alone[0, 1]), rel=1e-3)
    assert among[0, 0] == alone[0, 0]


_CUTOFFS_HZ = {"A": 50.0, "B": 20.0, "C": 70.0, "D": 25.0}
"""Cutoffs of gyroscopes that follow one motion."""


def delays_of_units(extra_s: Mapping[str, float], ratio: float, count: int) -> Mapping[str, SignalDelay]:
    """Delays fitted to the first `count` gyroscopes, whose filters delay by `ratio` times the delay of two poles at
    the cutoff, 1 / (sqrt(2) pi f), and by `extra_s`. Each is compared with the mean of the others, known to 0.1 ms.
    """
    headers = {
        name: SensorHeader(name, "l3g4200d", "angular_rate", "dps", 8.75e-3, 250.0, rate_hz=400.0, bandwidth_hz=hertz)
        for name, hertz in list(_CUTOFFS_HZ.items())[:count]
    }
    two_poles_s = {name: 1 / (math.sqrt(2) * math.pi * _CUTOFFS_HZ[name]) for name in headers}
    late_s = np.array([ratio * two_poles_s[name] + extra_s.get(name, 0.0) for name in headers])
    odd = _odd_units(headers, ())
    parameters = np.array([[two_poles_s[name], *(name in unit.sensors for unit in odd)] for name in headers])
    relative = np.eye(count) - (1 - np.eye(count)) / (count - 1)
    most = np.array([1.5, *(math.inf for _ in odd)])
    problem = _Problem(relative @ late_s, np.full(count, 1e8), relative @ parameters, np.zeros(len(most)), most)
    return _step(problem, headers, (), odd)


@pytest.mark.parametrize("ratio", [0.0, 1.0])
def test_a_late_gyroscope_does_not_change_the_delays_of_filters(ratio: float) -> None:
    """It has the longest nominal delay, and thus the largest influence on the common ratio."""
    delays = delays_of_units({"B": 0.008}, ratio, count=4)
    for name, hertz in _CUTOFFS_HZ.items():
        assert delays[name].filter_s == pytest.approx(ratio / (math.sqrt(2) * math.pi * hertz), abs=1e-4)


def test_three_gyroscopes_do_not_show_which_is_late() -> None:
    """Nominal delays d of 4.50, 11.25 and 3.22 ms: the ratio by least squares, the covariance of d with the delays of
    0, 8 and 0 ms over the variance of d, is 39.4 / 37.3.
    """
    delays = delays_of_units({"B": 0.008}, 0.0, count=3)
    assert delays["B"].filter_s == pytest.approx(39.4 / 37.3 * 11.25e-3, rel=0.01)
