"""The curves that are drawn of differences, and their contents."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from imuarray.gap.findings.diagnosis import Overlay
from imuarray.gap.findings.overlays import Curve, bands, curves_of, drawn, overlays_of
from imuarray.gap.model.bench import Bench
from imuarray.gap.statistics.campaign import Campaign
from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.effects.temperature import ThermalBias
from tests.gap.campaign_bench import Run, benched, where
from tests.gap.small_campaign import block, gaussian, summary

TONE = Tone((0.0, 0.05, 0.0), 20.0)
COOLER = ThermalBias((0.0, 0.0, -0.02))


@pytest.fixture(scope="module")
def tone() -> tuple[Bench, Campaign]:
    return benched(["static"], {"G1": (TONE,)})


@pytest.fixture(scope="module")
def drawn_tone(tone: tuple[Bench, Campaign]) -> tuple[tuple[Overlay, ...], Run]:
    bench, campaign = tone
    before = bench.models()
    quiet = replace(before["G1"].fitted, rms=(0.05, 0.05, 0.05))  # the fit includes the line in the noise
    after = {**before, "G1": replace(before["G1"], fitted=quiet, added=(TONE,))}
    run = Run(bench)
    found = [where(), where(), where(domain="level"), where(domain="codes", axis=""), where(domain="timing")]
    return overlays_of(bench, campaign, found, (before, after), run), run


def test_a_line_is_outside_the_band_before_and_inside_after(drawn_tone: tuple[tuple[Overlay, ...], Run]) -> None:
    """0.05 dps at 20 Hz: with a Hann window the bin at the line has amplitude^2 / 3 over the distance of bins."""
    found, run = drawn_tone
    assert run.items == 4  # jobs: 8 and 4 replicates of either model
    assert [(one.kind, one.sensor, one.axis) for one in found] == [
        ("spectrum", "G1", "y"),
        ("allan", "G1", "y"),
        ("codes", "G1", "y"),
    ]
    spectrum = found[0]
    assert spectrum.phase == "static (second half)"
    assert spectrum.y_label == "amplitude density (dps/√Hz)"
    at = int(np.argmin(np.abs(spectrum.x - 20.0)))
    distance_hz = spectrum.x[1] - spectrum.x[0]
    off_hz = abs(spectrum.x[at] - 20.0) / distance_hz
    hann = math.sin(math.pi * off_hz) / (math.pi * off_hz * (1 - off_hz**2)) if off_hz else 1.0
    assert spectrum.real[at] == pytest.approx(0.05 * hann / math.sqrt(3 * distance_hz), rel=0.1)
    assert spectrum.real[at] > 3 * spectrum.before[2, at]
    assert spectrum.after[1, at] < spectrum.real[at] < spectrum.after[2, at]
    for one in found:
        assert one.before.shape == one.after.shape == (3, len(one.x))
        assert (one.before[1] <= one.before[0]).all()
        assert (one.before[0] <= one.before[2]).all()


def test_most_points_are_inside_the_band_of_the_right_model(drawn_tone: tuple[tuple[Overlay, ...], Run]) -> None:
    """With 12 replicates a point is outside with a probability of 0.2 to 0.25; never more than half of some hundred
    bins.
    """
    spectrum = drawn_tone[0][0]
    outside = (spectrum.real < spectrum.after[1]) | (spectrum.real > spectrum.after[2])
    assert outside.mean() < 0.5


def test_white_noise_decreases_with_the_root_of_time(tone: tuple[Bench, Campaign]) -> None:
    """0.05 dps at 100 rows/s on an axis without a line: 0.05 sqrt(0.01 / tau), within 3 sigma of 18 % at 1.28 s."""
    bench, campaign = tone
    (curve,) = curves_of(bench, campaign, [where(axis="x", domain="allan")], 12)
    recorded = (campaign.logs[0].phases[1].sensors["G1"],)
    how = drawn(curve, recorded)
    expected = 0.05 * np.sqrt(0.01 / how.x)
    short = how.x < 1.3
    assert short.sum() == 8
    np.testing.assert_allclose(how.values(recorded)[short], expected[short], rtol=0.5)
    np.testing.assert_allclose(how.x[0], 0.01, rtol=1e-3)


def test_each_curve_is_drawn_once_and_few_of_one_sensor(tone: tuple[Bench, Campaign]) -> None:
    bench, campaign = tone
    domains = ("spectrum", "autocorrelation", "codes", "allan", "force")
    found = [where(sensor, axis, domain) for sensor in ("G1", "A1") for axis in "xyz" for domain in domains]
    curves = curves_of(bench, campaign, found, 12)
    assert [(one.kind, one.sensor, one.axis) for one in curves] == [
        (kind, sensor, 0) for sensor in ("G1", "A1") for kind in ("spectrum", "codes", "allan")
    ]
    assert len(curves_of(bench, campaign, found, 4)) == 4
    assert overlays_of(bench, campaign, [where(domain="timing")], ({}, {}), Run(bench)) == ()


def test_equal_models_are_simulated_once(tone: tuple[Bench, Campaign]) -> None:
    bench, campaign = tone
    run = Run(bench)
    (found,) = overlays_of(bench, campaign, [where()], (bench.models(), bench.models()), run)
    assert run.items == 2  # jobs, of 8 and 4 replicates
    np.testing.assert_array_equal(found.before, found.after)


@pytest.mark.slow
def test_an_unknown_phase_selects_the_longest() -> None:
    bench, campaign = benched(["turn-on"], {})
    (named,) = curves_of(bench, campaign, [where(phase="run 4")], 12)
    assert (named.log, named.phases) == (3, (1,))  # the second halves of eight boots are held out
    (third,) = curves_of(bench, campaign, [where(phase="run 3", log="third")], 12, [*"12", "third", *"45678"])
    assert (third.log, third.phases) == (2, (1,))
    beside = where(phase="run 4", log="third")
    (paired,) = curves_of(bench, campaign, [beside], 12, [*"12", "third", *"45678"])
    assert paired.log == 3


@pytest.mark.slow
def test_thermal_curves_have_common_temperatures() -> None:
    """0.02 dps less per degC on z, over the same temperatures on x."""
    bench, campaign = benched(["heating"], {"G1": (COOLER,)})
    before = bench.models()
    cold = replace(before["G1"].fitted, slope=(0.05, 0.05, 0.05))
    wrong = {**before, "G1": replace(before["G1"], fitted=cold)}
    found = overlays_of(bench, campaign, [where(axis="z", domain="temperature")], (wrong, before), Run(bench))
    (heat,) = found
    assert heat.phase == "room, heat, cool (second halves)"
    assert (np.diff(heat.x) > 0).all()
    assert heat.x[0] > 23.5
    assert heat.x[-1] < 52.5
    slope, weak = (np.polyfit(heat.x, curve, 1)[0] for curve in (heat.real, heat.before[0]))
    assert slope == pytest.approx(0.03, abs=0.001)
    assert weak == pytest.approx(0.05, abs=0.001)
    assert np.abs(heat.real - heat.after[0]).max() < 0.05


def test_shifted_even_codes_stay_even() -> None:
    """Even codes compared with even codes of another level: both curves alternate alike."""
    curve = Curve("codes", "S", 0, 0, (0,))
    even, other = (summary(block(2 * gaussian(4.0, seed=seed) + level)) for seed, level in ((1, 0), (2, 12)))
    how = drawn(curve, (even,))
    shares = how.values((other,))
    assert shares.sum() == pytest.approx(1.0, abs=0.01)
    assert (shares[how.x % 2 == 1] == 0).all()
    assert np.abs(shares - how.values((even,))).max() < 0.02


def test_a_wide_histogram_is_coarse() -> None:
    """Spread of 2000 counts: some 15 000 between the rarest 0.1 % and half of that again, in at most 200 bins."""
    curve = Curve("codes", "S", 2, 0, (0,))
    wide = summary(block(gaussian(2000.0)))
    how = drawn(curve, (wide,))
    assert 80 < len(how.x) <= 202
    assert set(np.diff(how.x)) == {128.0}
    assert how.values((wide,)).sum() == pytest.approx(1.0, abs=0.005)


def test_bands_omit_rare_values() -> None:
    values = [np.array([float(number), math.nan if number < 7 else 1.0]) for number in range(12)]
    middle, low, high = bands(values).T[0]
    assert (middle, low, high) == (5.5, pytest.approx(0.275), pytest.approx(10.725))
    assert np.isnan(bands(values)[:, 1]).all()
