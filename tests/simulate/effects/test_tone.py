"""`tone`: a sine at the instants at which the chip samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import kstest

from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.signal import Analog
from tests.simulate.conftest import MakePlace

MakeAnalog = Callable[..., Analog]


def test_the_sine_is_sampled_at_the_true_instants(place: MakePlace, analog: MakeAnalog) -> None:
    """A quarter of a second, a third, whole hours: sin 90, sin 120 + phase, sin phase."""
    instant_ns = np.array([250_000_000, 333_333_333, 3_600_000_000_000, 86_400_000_000_000])
    rows = Tone((1.0, 2.0, 0.0), 1.0, 30.0).analog(analog(0, 4, value=5.0, instant_ns=instant_ns), place())
    sines = np.sin(np.radians([90 + 30, 120 + 30, 30, 30]))
    np.testing.assert_allclose(rows.value, 5 + np.outer(sines, [1, 2, 0]), rtol=0, atol=1e-8)


def test_slow_rows_alias_the_tone(place: MakePlace, analog: MakeAnalog) -> None:
    """50 Hz at 40 rows a second is 10 Hz: four rows a period."""
    value = Tone(1.0, 50.0, 0.0).analog(analog(0, 400, rows_per_s=40.0), place(rows_per_s=40.0)).value
    np.testing.assert_allclose(value[:, 0], np.tile([0, 1, 0, -1], 100), atol=1e-9)


def test_the_phase_is_uniform_over_boots(place: MakePlace, analog: MakeAnalog) -> None:
    start = np.array([0, 250_000_000])

    def phase_deg(boot: int, frequency_hz: float = 1.0) -> float:
        sine, cosine = Tone(1.0, frequency_hz).analog(analog(0, 2, instant_ns=start), place(boot=boot)).value[:, 0]
        return float(np.degrees(np.arctan2(sine, cosine)) % 360)

    phases = [phase_deg(boot) for boot in range(400)]
    assert kstest(phases, "uniform", (0, 360)).pvalue > 1e-4  # as often wrong as that
    assert phases[7] == phase_deg(7)
    assert phase_deg(7, 5.0) != pytest.approx(phases[7])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_any_block_alone_equals_that_of_the_whole(
    place: MakePlace, analog: MakeAnalog, dtype: type[np.floating]
) -> None:
    effect = Tone((0.1, 0.2, 0.3), 13.0)
    whole = effect.analog(analog(0, 20_000, dtype=dtype), place(dtype=dtype)).value
    alone = effect.analog(analog(7001, 9000, dtype=dtype), place(dtype=dtype)).value
    assert alone.dtype == dtype
    np.testing.assert_allclose(alone, whole[7001:9000], rtol=0, atol=1e-15)


def test_defaults_do_nothing_and_invalid_parameters_are_refused(place: MakePlace, analog: MakeAnalog) -> None:
    rows = analog(0, 10)
    assert Tone().analog(rows, place()) is rows
    with pytest.raises(ValueError, match=r"frequency_hz: -1(\.0)?; allowed is 0 to 1e\+06"):
        Tone(1.0, -1.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="phase_deg: inf"):
        Tone(1.0, 1.0, np.inf)  # type: ignore[arg-type]


def test_a_frequency_can_drift(place: MakePlace, analog: MakeAnalog) -> None:
    """10 Hz and 360 Hz an hour more, 0.1 Hz/s: after t s 10 t + 0.05 t^2 turns; 0, 0.25 and 1000.25 of them."""
    turns = np.array([0.0, 0.25, 1000.25])
    times_s = (-10 + np.sqrt(100 + 0.2 * turns)) / 0.1
    instant_ns = np.rint(times_s * 1e9).astype(np.int64)
    effect = Tone((2.0, 0.0, 0.0), 10.0, 0.0, drift_hz_per_h=360.0)
    value = effect.analog(analog(0, 3, instant_ns=instant_ns), place()).value
    np.testing.assert_allclose(value[:, 0], [0.0, 2.0, 2.0], atol=1e-5)


def test_each_boot_begins_at_another_frequency(place: MakePlace, analog: MakeAnalog) -> None:
    """Normal about 100 Hz, by the phase that a line has gained after 1 ms; the same boot has the same."""
    instant_ns = np.array([0, 1_000_000])
    sines = [
        Tone(1.0, 100.0, 0.0, frequency_spread_hz=5.0)  # type: ignore[arg-type]
        .analog(analog(0, 2, instant_ns=instant_ns), place(boot=boot))
        .value[1, 0]
        for boot in (*range(400), 7)
    ]
    hertz = np.arcsin(sines) / (2e-3 * np.pi)
    assert hertz[-1] == hertz[7]
    assert kstest(hertz[:-1], "norm", (100.0, 5.0)).pvalue > 1e-4  # as often wrong as that


def test_invalid_drifts_are_refused() -> None:
    with pytest.raises(ValueError, match=r"frequency_spread_hz: -1(\.0)?; allowed is 0 to 1e\+06"):
        Tone(1.0, 1.0, frequency_spread_hz=-1.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"drift_hz_per_h: nan; allowed is -1e\+06 to 1e\+06"):
        Tone(1.0, 1.0, drift_hz_per_h=np.nan)  # type: ignore[arg-type]
