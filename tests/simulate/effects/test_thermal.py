"""`thermal_bias`, `thermal_scale`, `thermal_lag`, `thermometer`: the effects of temperature, their delay, and the
thermometer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import chi2

from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.temperature import ThermalBias, ThermalLag, ThermalScale, Thermometer
from imuarray.simulate.signal import Analog
from tests.selection import some
from tests.simulate.conftest import Constant, Floats, MakePlace, times

MakeAnalog = Callable[..., Analog]
WARM = np.array([25.0, 35.0, 15.0])


def test_thermal_bias_is_a_polynomial_of_temperature(place: MakePlace, analog: MakeAnalog) -> None:
    """At the reference nothing; 10 degC above it 10 slopes and 100 quadratics, below it -10 and 100."""
    effect = ThermalBias((0.1, -0.2, 0.0), (0.01, 0.0, 0.02))
    value = effect.analog(analog(0, 3, value=5.0, temperature_degc=WARM), place()).value
    np.testing.assert_allclose(value, [[5, 5, 5], [7, 3, 7], [5, 7, 7]])


def test_thermal_scale_is_linear_in_temperature(place: MakePlace, analog: MakeAnalog) -> None:
    """1e-4 per degC (BMA-116): 1.001 and 0.999 at 10 degC above and below; the reference may be another."""
    rows = analog(0, 3, value=(1.0, -2.0, 4.0), temperature_degc=WARM)
    value = ThermalScale((1e-4, 1e-4, 0.0)).analog(rows, place()).value
    np.testing.assert_allclose(value, [[1, -2, 4], [1.001, -2.002, 4], [0.999, -1.998, 4]], rtol=1e-15)
    value = ThermalScale(0.01, 15.0).analog(rows, place()).value  # type: ignore[arg-type]
    np.testing.assert_allclose(value[:, 0], [1.1, 1.2, 1.0])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("effect", [ThermalBias(0.1, 0.1), ThermalScale(0.1)], ids=lambda effect: effect.name)  # type: ignore[arg-type]
def test_precision_is_kept(place: MakePlace, analog: MakeAnalog, effect: Effect, dtype: npt.DTypeLike) -> None:
    rows = analog(0, 3, value=1.0, dtype=dtype, temperature_degc=WARM)
    assert effect.analog(rows, place(dtype=dtype)).value.dtype == dtype


def lagged(
    time_constant_s: float, temperature: Callable[[Floats], Floats], time_ns: npt.NDArray[np.int64], place: MakePlace
) -> Floats:
    motion = Constant(temperature_degc=temperature)
    stimulus = ThermalLag(time_constant_s).stimulus(motion.stimulus(time_ns), place(motion=motion))
    return stimulus.temperature_degc


@pytest.mark.parametrize("time_constant_s", [0.3, 12.0, 40.0])
def test_a_ramp_is_followed_with_the_lag(place: MakePlace, time_constant_s: float) -> None:
    """From equilibrium at 0: T = T0 + r (t - tau (1 - exp(-t / tau))), exact where a step ends (fifty of them in a time
    constant, 10 ms at least), and off by r step^2 / (8 tau) at most.
    """
    seconds = np.arange(0.0, 200.0, 0.1)
    temperature = lagged(time_constant_s, lambda s: 20 + 0.1 * s, (seconds * 1e9).round().astype(np.int64), place)
    wanted = 20 + 0.1 * (seconds + time_constant_s * np.expm1(-seconds / time_constant_s))
    step_s = max(time_constant_s / 50, 0.01)
    np.testing.assert_allclose(temperature, wanted, rtol=0, atol=0.1 * step_s**2 / (8 * time_constant_s) + 1e-9)


def test_a_slow_wave_is_damped_and_delayed(place: MakePlace) -> None:
    """Of period 2 pi tau: by sqrt(2) and an eighth of a period; straight lines of a fiftieth cut at most
    (1 / 50)^2 / 8 off in the input and again in between.
    """
    tau = 30.0
    seconds = np.arange(2000.0, 2400.0, 0.37)
    temperature = lagged(tau, lambda s: 25 + 10 * np.sin(s / tau), (seconds * 1e9).round().astype(np.int64), place)
    np.testing.assert_allclose(temperature, 25 + 10 / np.sqrt(2) * np.sin(seconds / tau - np.pi / 4), rtol=0, atol=2e-3)


@pytest.mark.parametrize("time_constant_s", some([0.05, 5.0, 600.0], 1))
def test_any_block_alone_equals_that_of_the_whole(place: MakePlace, time_constant_s: float) -> None:
    """To the 2e-9 that remains of the difference between box and element after 20 time constants."""

    def heated(seconds: Floats) -> Floats:
        return np.where((seconds // 900) % 2, 45.0, 24.0)

    whole = lagged(time_constant_s, heated, times(0, 200_000, 10.0), place)
    for first in (1, 9001, 150_000):
        alone = lagged(time_constant_s, heated, times(first, first + 5000, 10.0), place)
        np.testing.assert_allclose(alone, whole[first : first + 5000], rtol=0, atol=1e-7)
    assert 24 <= whole.min() <= whole.max() <= 45


def test_a_lag_shorter_than_a_step_does_nothing(place: MakePlace) -> None:
    seconds = np.arange(0.0, 20.0, 0.013)
    temperature = lagged(1e-6, lambda s: 20 + np.sin(s), (seconds * 1e9).round().astype(np.int64), place)
    np.testing.assert_allclose(temperature, 20 + np.sin(seconds), rtol=0, atol=2e-5)  # (10 ms)^2 / 8 of the curvature


def test_a_part_that_warms_up_late_adds_its_own_bias(place: MakePlace, analog: MakeAnalog) -> None:
    """0.1 and -0.2 per degC of the part above 25 degC, which follows the ramp T = 25 + t as above, with 10 s; the input
    of the element is unchanged.
    """
    time_ns = times(0, 900)
    seconds, part = time_ns * 1e-9, ThermalLag(10.0, (0.1, -0.2, 0.0))
    motion = Constant(temperature_degc=lambda s: 25.0 + s)
    rows = replace(analog(0, len(time_ns), value=1.0), instant_ns=time_ns)
    value = part.analog(rows, place(motion=motion)).value
    warm = seconds - 10.0 * -np.expm1(-seconds / 10.0)
    expected = 1.0 + warm[:, None] * np.array([0.1, -0.2, 0.0])
    np.testing.assert_allclose(value, expected, atol=0.2 * 0.2**2 / 80)
    stimulus = motion.stimulus(time_ns)
    assert part.stimulus(stimulus, place(motion=motion)) is stimulus


def test_the_part_is_in_equilibrium_before_the_beginning_and_at_constant_temperature(place: MakePlace) -> None:
    temperature = lagged(10.0, lambda s: 20 + 0.1 * s, np.array([-5_000_000, -1, 0]), place)
    np.testing.assert_allclose(temperature, 20.0)
    np.testing.assert_allclose(lagged(10.0, lambda s: 0 * s + 31.5, times(0, 100), place), 31.5, rtol=1e-14)


def test_only_the_temperature_is_changed(place: MakePlace) -> None:
    stimulus = Constant().stimulus(times(0, 50))
    after = ThermalLag(3.0).stimulus(stimulus, place())
    assert after.force_box is stimulus.force_box
    assert after.time_ns is stimulus.time_ns


def test_the_thermometer_has_its_offset_and_noise(place: MakePlace, analog: MakeAnalog) -> None:
    rows = analog(0, 4000, value=1.0, thermometer_degc=np.full(4000, 30.0))
    after = Thermometer(-3.0, 0.5).analog(rows, place())
    error = after.thermometer_degc - 27.0
    # mean 0 within 5 standard errors (6e-7), variance between the quantiles at 1e-6
    assert abs(error.mean()) < 5 * 0.5 / np.sqrt(4000)
    low, high = chi2(4000).ppf([1e-6, 1 - 1e-6])
    assert low < (error**2).sum() / 0.25 < high
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 5 / np.sqrt(4000)
    assert after.value is rows.value
    assert after.temperature_degc is rows.temperature_degc
    alone = Thermometer(-3.0, 0.5).analog(analog(1000, 1100, thermometer_degc=np.full(100, 30.0)), place())
    np.testing.assert_array_equal(alone.thermometer_degc, after.thermometer_degc[1000:1100])


def test_defaults_do_nothing_and_invalid_parameters_are_refused(place: MakePlace, analog: MakeAnalog) -> None:
    rows, stimulus = analog(0, 10), Constant().stimulus(times(0, 10))
    assert ThermalBias().analog(rows, place()) is rows
    assert ThermalScale().analog(rows, place()) is rows
    assert ThermalLag().stimulus(stimulus, place()) is stimulus
    assert Thermometer().analog(rows, place()).thermometer_degc is rows.thermometer_degc
    for kind in (ThermalBias, ThermalScale):
        with pytest.raises(ValueError, match="reference_degc: -300"):
            kind(reference_degc=-300.0)
    with pytest.raises(ValueError, match=r"time_constant_s: -1(\.0)?; allowed is 0 to 1e\+06"):
        ThermalLag(-1.0)
    with pytest.raises(ValueError, match=r"rms_degc: -1(\.0)?; allowed is 0 to 1000"):
        Thermometer(0.0, -1.0)
