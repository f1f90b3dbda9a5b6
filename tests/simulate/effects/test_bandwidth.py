"""`bandwidth`: the rms of the noise is kept, its correlation is exponential."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import integrate, signal
from scipy.linalg import toeplitz

from imuarray.log.format import STALE
from imuarray.simulate.effects.bandwidth import Bandwidth
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.signal import Analog
from imuarray.simulate.simulation import Plan, Simulation
from imuarray.simulate.timeline import PollTimes
from tests.simulate.conftest import Constant, MakePlace, furthest, header

MakeAnalog = Callable[..., Analog]


@pytest.mark.slow
def test_same_rms_and_exponential_correlation_from_the_first_row_on(place: MakePlace, analog: MakeAnalog) -> None:
    """A quarter of the rate over pi: phi = exp(-1 / 2)."""
    rng = np.random.default_rng(5)
    effect, at = Bandwidth(100 / (4 * np.pi)), place(rows_per_s=100.0)
    runs = [effect.analog(analog(0, 6, noise=rng.normal(0, 0.3, (6, 3))), at).noise.T for _ in range(3000)]
    # 27 numbers beyond 5 standard errors: 2e-5
    assert furthest(np.concatenate(runs), 0.09 * toeplitz(np.exp(-np.arange(6) / 2))) < 5


def test_noise_of_a_chip_read_repeatedly_is_correlated_by_samples(constant: type[Constant]) -> None:
    """100 samples a second, read 160 times: behind 10 Hz successive samples correlate by exp(-2 pi 10 / 100) = 0.53,
    and not by exp(-2 pi 10 / 160) = 0.68, as rows would. Standard error 0.005.
    """
    lines = PollTimes(60_000, 6_250_000)
    plan = Plan({"S1": (header("l3g4200d", rate_hz=100.0), lines)}, lines)
    block = Simulation(plan, constant(), {"S1": (WhiteNoise(0.5), Bandwidth(10.0))}).sensors["S1"].block(0, 60_000)
    is_again = (block.status & STALE) != 0
    assert np.count_nonzero(is_again) == pytest.approx(0.375 * 60_000, abs=1)
    samples = block.counts[~is_again, 0]
    assert np.corrcoef(samples[1:], samples[:-1])[0, 1] == pytest.approx(0.533, abs=0.02)


@pytest.mark.slow
def test_two_poles_are_scipys_butterworth(place: MakePlace, analog: MakeAnalog) -> None:
    """Its response to a step; and of white noise the correlation exp(-u) (cos u + sin u), u = sqrt(2) pi cutoff t, with
    standard errors of 0.005.
    """
    effect, at = Bandwidth(10.0, 1.0, 2.0), place(rows_per_s=100.0)
    rise = np.repeat((np.arange(60) > 9)[:, None], 3, axis=1).astype(float)
    result = effect.analog(analog(0, 60, value=rise), at).value[:, 0]
    times = np.linspace(0, 0.6, 60_001)
    straight = np.interp(times, np.arange(60) / 100, rise[:, 0])
    _, wanted, _ = signal.lsim(signal.butter(2, 2 * np.pi * 10.0, analog=True), straight, times)
    np.testing.assert_allclose(result, np.interp(np.arange(60) / 100, times, wanted), atol=1e-6)
    white = np.random.default_rng(6).normal(0, 0.3, (100_000, 3))
    noise = effect.analog(analog(0, 100_000, noise=white), at).noise
    assert noise.std() == pytest.approx(0.3, rel=0.01)
    for lag in (1, 2, 5):
        u = np.sqrt(2) * np.pi * 10.0 * lag / 100
        got = np.mean(noise[lag:] * noise[:-lag]) / noise.var()
        assert got == pytest.approx(np.exp(-u) * (np.cos(u) + np.sin(u)), abs=0.02)


@pytest.mark.parametrize("cutoff_hz", [1e4, 1e6])
def test_two_poles_far_above_the_row_rate_leave_noise_unchanged(
    place: MakePlace, analog: MakeAnalog, cutoff_hz: float
) -> None:
    white = np.random.default_rng(6).normal(0, 0.3, (50, 3))
    noise = Bandwidth(cutoff_hz, 1.0, 2.0).analog(analog(0, 50, noise=white), place(rows_per_s=100.0)).noise
    np.testing.assert_allclose(noise, white, rtol=1e-12)


def test_noise_of_the_papers_gyroscope_has_its_correlation(place: MakePlace, analog: MakeAnalog) -> None:
    """Correlation 0.4 between neighbours at 350 Hz (Appendix A, Figure 13) is a cutoff of 51 Hz."""
    white = np.random.default_rng(6).normal(0, 0.31, (100_000, 3))
    noise = Bandwidth(51.0).analog(analog(0, 100_000, noise=white), place(rows_per_s=350.0)).noise
    for axis in noise.T:  # five of sqrt(0.84 / 100 000) and 0.31 sqrt(1.16 / 0.84 / 200 000): 2e-6
        assert np.corrcoef(axis[:-1], axis[1:])[0, 1] == pytest.approx(0.4, abs=0.015)
        assert axis.std() == pytest.approx(0.31, abs=0.004)


def test_the_value_is_unchanged_and_no_noise_is_added(place: MakePlace, analog: MakeAnalog) -> None:
    rows = Bandwidth(5.0).analog(analog(0, 50, value=1.5), place())
    assert (rows.value == 1.5).all()
    assert (rows.noise == 0).all()


@pytest.mark.parametrize("cutoff_hz", [0.5, 5.0, 40.0])
def test_a_ramp_lags_by_the_time_constant(place: MakePlace, analog: MakeAnalog, cutoff_hz: float) -> None:
    """x(t) = t behind a filter of time constant T is t - T + T exp(-t / T), from rest at 0, for any rate of rows."""
    time_s, constant_s = np.arange(300) / 100, 1 / (2 * np.pi * cutoff_hz)
    ramp = np.repeat(time_s[:, None], 3, axis=1)
    result = Bandwidth(cutoff_hz, 1.0).analog(analog(0, 300, value=ramp), place(rows_per_s=100.0)).value
    expected = time_s - constant_s * -np.expm1(-time_s / constant_s)
    np.testing.assert_allclose(result[:, 1], expected, atol=1e-12)
    half = Bandwidth(cutoff_hz, 0.5).analog(analog(0, 300, value=ramp), place(rows_per_s=100.0)).value
    np.testing.assert_allclose(half, (ramp + result) / 2, atol=1e-12)


def test_a_constant_value_is_unchanged(place: MakePlace, analog: MakeAnalog) -> None:
    rows = Bandwidth(5.0, 1.0).analog(analog(0, 50, value=1.5), place())
    np.testing.assert_allclose(rows.value, 1.5, rtol=1e-14)


@pytest.mark.parametrize("cutoff_hz", [5.0, 25.0, 45.0])
@pytest.mark.parametrize("poles", [1.0, 2.0])
def test_the_lookback_of_a_digital_filter_is_sufficient(
    place: MakePlace, analog: MakeAnalog, cutoff_hz: float, poles: float
) -> None:
    white = np.random.default_rng(7).normal(0, 1, (3000, 3))
    effect, at = Bandwidth(cutoff_hz, poles=poles, sampled_hz=100.0), place(rows_per_s=100.0)
    back = effect.lookback(at)
    whole = effect.analog(analog(0, 3000, noise=white), at).noise
    alone = effect.analog(analog(2000 - back, 3000, noise=white[2000 - back :]), at).noise
    np.testing.assert_allclose(alone[back:], whole[2000:], rtol=0, atol=1e-10)


@pytest.mark.parametrize("cutoff_hz", [0.5, 5.0, 40.0])
def test_the_lookback_is_sufficient_and_minimal(place: MakePlace, analog: MakeAnalog, cutoff_hz: float) -> None:
    white = np.random.default_rng(7).normal(0, 1, (3000, 3))
    effect, at = Bandwidth(cutoff_hz), place(rows_per_s=100.0)
    back = effect.lookback(at)
    left = np.exp(-2 * np.pi * cutoff_hz / 100 * np.array([back, back - 1]))
    assert left[0] < 1e-12 <= left[1]  # and not a row more than it takes
    whole = effect.analog(analog(0, 3000, noise=white), at).noise
    alone = effect.analog(analog(2000 - back, 3000, noise=white[2000 - back :]), at).noise
    np.testing.assert_allclose(alone[back:], whole[2000:], rtol=0, atol=1e-11)


def test_single_precision_is_kept(place: MakePlace, analog: MakeAnalog) -> None:
    white = np.random.default_rng(8).normal(0, 1, (1000, 3))
    double = Bandwidth(1.0).analog(analog(0, 1000, noise=white), place())
    single = Bandwidth(1.0).analog(analog(0, 1000, noise=white, dtype=np.float32), place(dtype=np.float32))
    assert single.noise.dtype == np.float32
    np.testing.assert_allclose(single.noise, double.noise, atol=1e-6)


def test_defaults_do_nothing_and_invalid_parameters_are_refused(place: MakePlace, analog: MakeAnalog) -> None:
    rows = analog(0, 10)
    assert Bandwidth().analog(rows, place()) is rows
    assert Bandwidth().lookback(place()) == 0
    with pytest.raises(ValueError, match=r"cutoff_hz: 0(\.0)?; allowed is 0\.01 to inf"):
        Bandwidth(0.0)
    with pytest.raises(ValueError, match=r"share: 2(\.0)?; allowed is 0 to 1"):
        Bandwidth(5.0, 2.0)


@pytest.mark.parametrize("poles", [1.0, 2.0])
@pytest.mark.parametrize(("decay", "band"), [(0.05, 2.0), (0.7, 1.0), (3.0, 5.0), (20.0, 0.4)])
def test_the_correlation_of_a_band_is_a_cosine_transform(decay: float, poles: float, band: float) -> None:
    """Against adaptive quadrature: integral of cos(r u) / (1 + u^(2 poles)) from 0 to the band, over that for r = 0."""
    power, cosine = (
        integrate.quad(lambda u: np.cos(r * u) / (1 + u ** (2 * poles)), 0.0, band, epsabs=1e-13, limit=500)[0]  # noqa: B023
        for r in (0.0, decay * np.sqrt(poles))
    )
    assert Bandwidth(1.0, poles=poles, sampled_hz=2 * band).correlation(decay) == pytest.approx(
        cosine / power, abs=1e-8
    )


@pytest.mark.parametrize(("poles", "cutoff_hz"), [(1.0, 25.0), (2.0, 25.0), (1.0, 60.0)])
def test_noise_of_a_digital_filter_equals_that_filtered_by_fourier_transform(
    place: MakePlace, analog: MakeAnalog, poles: float, cutoff_hz: float
) -> None:
    """Against noise that is filtered by its Fourier transform: the same correlations, and the rms stays."""
    rows, generator = 1 << 17, np.random.default_rng(6)
    effect, at = Bandwidth(cutoff_hz, poles=poles, sampled_hz=100.0), place(rows_per_s=100.0)
    result = effect.analog(analog(0, rows, noise=generator.standard_normal((rows, 3))), at).noise[
        effect.lookback(at) :, 0
    ]
    over_cutoff = np.fft.rfftfreq(rows, 1 / 100.0) / cutoff_hz
    spectrum = np.fft.rfft(generator.standard_normal(rows)) / np.sqrt(1 + over_cutoff ** (2 * poles))
    expected = np.fft.irfft(spectrum)
    assert result.std() == pytest.approx(1.0, abs=0.02)
    for lag in (1, 2, 3):
        wanted = np.corrcoef(expected[lag:], expected[:-lag])[0, 1]
        assert np.corrcoef(result[lag:], result[:-lag])[0, 1] == pytest.approx(wanted, abs=0.015)


def test_a_share_of_the_noise_is_passed(place: MakePlace, analog: MakeAnalog) -> None:
    white = np.random.default_rng(6).normal(0, 0.3, (500, 3))
    rows, at = analog(0, 500, noise=white), place(rows_per_s=100.0)
    whole, half = (Bandwidth(10.0, noise_share=share).analog(rows, at).noise for share in (1.0, 0.5))
    np.testing.assert_allclose(half, whole / 2)
    with pytest.raises(ValueError, match=r"noise_share: -1(\.0)?; allowed is 0 to 10"):
        Bandwidth(10.0, noise_share=-1.0)


@pytest.mark.parametrize(("rows_per_s", "poles"), [(80.0, 2.0), (60.0, 1.0), (37.0, 2.0)])
def test_noise_of_a_chip_polled_below_its_rate_is_correlated_by_samples(
    constant: type[Constant], rows_per_s: float, poles: float
) -> None:
    """100 samples a second behind a digital filter of 12.5 Hz: rows one sample apart correlate as scipy's filtered
    noise does after one, those two apart as after two, and so on. Standard errors of 0.006 at most.
    """
    rows, period_ns = 60_000, round(1e9 / rows_per_s)
    lines = PollTimes(rows, period_ns)
    plan = Plan({"S1": (header("l3g4200d", rate_hz=100.0), lines)}, lines)
    effects = {"S1": (WhiteNoise(5.0), Bandwidth(12.5, poles=poles, sampled_hz=100.0))}
    block = Simulation(plan, constant(), effects).sensors["S1"].block(0, rows)
    level = block.counts[:, 0] - block.counts[:, 0].mean()
    samples = np.diff(np.floor(np.arange(rows) * period_ns * 1e-9 * 100 + 1e-9))
    frequency_hz = np.linspace(0, 50, 2001)
    power = 1 / (1 + (frequency_hz / 12.5) ** (2 * poles))
    assert level.std() == pytest.approx(5.0 * plan.sensors["S1"][0].sensitivity, rel=0.03)
    for apart in np.unique(samples):
        expected = (power * np.cos(2 * np.pi * frequency_hz * apart / 100)).sum() / power.sum()
        at = np.flatnonzero(samples == apart)
        assert np.mean(level[at] * level[at + 1]) / level.var() == pytest.approx(expected, abs=0.03)


def test_a_step_of_noise_on_a_chip_polled_below_its_rate_includes_unread_samples(constant: type[Constant]) -> None:
    """3 counts of noise for 250 s, and then 4 more: 5 together, also in the samples that no row reads."""
    rows = 40_000
    lines = PollTimes(rows, 12_500_000)
    sensor = header("l3g4200d", rate_hz=100.0)
    count = 1 / sensor.sensitivity
    effects = (
        WhiteNoise(3 * count),
        WhiteNoise(4 * count, spans=(0.0, 250.0, 1e9)),
        Bandwidth(12.5, poles=2.0, sampled_hz=100.0),
    )
    simulation = Simulation(Plan({"S1": (sensor, lines)}, lines), constant(), {"S1": effects})
    counts = simulation.sensors["S1"].block(0, rows).counts
    assert counts[:20_000].std() == pytest.approx(np.sqrt(9 + 1 / 12), rel=0.03)
    assert counts[20_100:].std() == pytest.approx(np.sqrt(25 + 1 / 12), rel=0.03)


@pytest.mark.parametrize("poles", [1.0, 2.0])
@pytest.mark.parametrize("sampled_hz", [100.0, np.inf])
def test_unread_samples_do_not_depend_on_the_block(constant: type[Constant], poles: float, sampled_hz: float) -> None:
    lines = PollTimes(4000, 12_500_000)
    plan = Plan({"S1": (header("l3g4200d", rate_hz=100.0), lines)}, lines)
    effects = (WhiteNoise(5.0), Bandwidth(6.0, poles=poles, sampled_hz=sampled_hz))
    whole, parts = (Simulation(plan, constant(), {"S1": effects}).sensors["S1"] for _ in range(2))
    counts = np.concatenate([parts.block(first, first + 800).counts for first in range(0, 4000, 800)])
    np.testing.assert_array_equal(counts, whole.block(0, 4000).counts)


@pytest.mark.parametrize("poles", [1, 2])
def test_a_warped_filter_equals_scipys_digital_filter(poles: int, place: MakePlace, analog: MakeAnalog) -> None:
    """Designed by the bilinear transform for 13.75 Hz at 100 samples a second, one or two for each row: correlations of
    SciPy's filter, from its impulse response; those of simulated noise have standard errors of 0.005.
    """
    impulse = signal.lfilter(*signal.butter(poles, 13.75, fs=100.0), np.eye(1, 4096)[0])
    power = impulse @ impulse
    effect = Bandwidth(13.75, poles=poles, sampled_hz=100.0, warped=1.0)
    for rows_per_s, samples in ((100.0, 1), (50.0, 2)):
        expected = [impulse[: -lag * samples] @ impulse[lag * samples :] / power for lag in (1, 2, 3, 5)]
        decay = effect.decay(rows_per_s)
        np.testing.assert_allclose([effect.correlation(decay * lag) for lag in (1, 2, 3, 5)], expected, atol=1e-4)
    white = np.random.default_rng(6).normal(0, 0.3, (100_000, 3))
    noise = effect.analog(analog(0, 100_000, noise=white), place(rows_per_s=100.0)).noise
    assert noise.std() == pytest.approx(0.3, rel=0.01)
    for lag, correlation in zip((1, 2, 3, 5), _correlations(impulse), strict=True):
        assert np.corrcoef(noise[lag:, 0], noise[:-lag, 0])[0, 1] == pytest.approx(correlation, abs=0.02)


def _correlations(impulse: np.ndarray) -> list[float]:
    return [float(impulse[:-lag] @ impulse[lag:] / (impulse @ impulse)) for lag in (1, 2, 3, 5)]


def test_measured_correlations_replace_those_of_the_filter(place: MakePlace, analog: MakeAnalog) -> None:
    """Noise correlated over three rows, as no filter of the family gives; an impossible set is refused."""
    measured = (0.5, 0.3, -0.1)
    effect = Bandwidth(20.0, correlations=measured)
    white = np.random.default_rng(6).normal(0, 0.3, (100_000, 3))
    noise = effect.analog(analog(0, 100_000, noise=white), place(rows_per_s=100.0)).noise
    assert noise.std() == pytest.approx(0.3, rel=0.01)
    for lag, correlation in enumerate(measured, start=1):
        assert np.corrcoef(noise[lag:, 1], noise[:-lag, 1])[0, 1] == pytest.approx(correlation, abs=0.02)
    with pytest.raises(ValueError, match="no noise has"):
        Bandwidth(20.0, correlations=(0.9, -0.9))
