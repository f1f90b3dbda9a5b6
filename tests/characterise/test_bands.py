"""Wide lines: their frequency and amplitude, and no detection in noise of any colour."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from imuarray.characterise.lines import FALSE_ALARM, find_bands, find_lines
from imuarray.characterise.result import _add_fundamentals
from imuarray.characterise.spectrum import Spectrum, Welch, segment_rows

RATE_HZ = 100.0
ROWS = 60_000


def spectrum_of(values: np.ndarray, rate_hz: float = RATE_HZ) -> Spectrum:
    welch = Welch(rate_hz, segment_rows(len(values)), 1)
    welch.update(values)
    return welch.result()


def wander(frequency_hz: float, wide_hz: float, amplitude: float, seed: int) -> np.ndarray:
    """A sine whose frequency walks about its mean by `wide_hz` (standard deviation), within seconds."""
    rng = np.random.default_rng(seed)
    slow = lfilter([1], [1, -0.999], rng.normal(0, 1, ROWS))
    offset_hz = wide_hz * slow / slow.std()
    return np.asarray(amplitude * np.sin(2 * np.pi * np.cumsum(frequency_hz + offset_hz) / RATE_HZ))


@pytest.mark.parametrize(("frequency_hz", "wide_hz"), [(10.4, 0.5), (31.4, 0.3), (20.0, 1.5), (47.0, 0.2)])
def test_a_line_of_varying_frequency_is_detected(frequency_hz: float, wide_hz: float) -> None:
    """Amplitude 1 in noise of standard deviation 1; there is no narrow line."""
    values = wander(frequency_hz, wide_hz, 1.0, 1) + np.random.default_rng(2).normal(0, 1, ROWS)
    spectrum = spectrum_of(values)
    (band,) = find_bands(spectrum, 0, find_lines(spectrum).lines)
    assert band.frequency_hz == pytest.approx(frequency_hz, abs=0.5 * wide_hz)
    assert band.amplitude == pytest.approx(1.0, rel=0.1)
    assert wide_hz < band.width_hz < 4 * wide_hz
    assert band.over_floor > 5


def test_a_slow_line_at_the_first_bins_is_detected() -> None:
    """0.54 Hz: nearer to 0 than the 24 bins that a floor needs; 83 times the floor."""
    time_s = np.arange(ROWS) / RATE_HZ
    values = 0.12 * np.sin(2 * np.pi * 0.54 * time_s) + np.random.default_rng(3).normal(0, 1, ROWS)
    spectrum = spectrum_of(values)
    bands = find_bands(spectrum, 0, find_lines(spectrum).lines)
    assert any(band.frequency_hz == pytest.approx(0.54, abs=0.03) for band in bands)


def colours(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    white = rng.normal(0, 1, ROWS // 4)
    first, second = butter(1, 0.3), butter(2, 0.5)
    return {
        "white": white,
        "random walk": white + np.cumsum(rng.normal(0, 0.02, len(white))),
        "flicker": white + lfilter([1], [1, -0.99], rng.normal(0, 0.1, len(white))),
        "a filter of first order": lfilter(*first, white),
        "a filter of second order": lfilter(*second, white),
    }


@pytest.mark.slow
def test_noise_of_any_colour_shows_no_band() -> None:
    """At most the stated share of false alarms (1 %), of 150 each: 5 or more have a chance of 2 %."""
    alarms: dict[str, int] = {}
    for seed in range(150):
        for colour, values in colours(seed).items():
            alarms[colour] = alarms.get(colour, 0) + bool(find_bands(spectrum_of(values)))
    assert FALSE_ALARM == 0.01
    assert max(alarms.values()) < 5, alarms


def test_a_narrow_line_is_not_a_band() -> None:
    time_s = np.arange(ROWS) / RATE_HZ
    values = 0.5 * np.sin(2 * np.pi * 23.456 * time_s) + np.random.default_rng(4).normal(0, 1, ROWS)
    spectrum = spectrum_of(values)
    narrow = find_lines(spectrum).lines
    assert len(narrow) == 1
    assert find_bands(spectrum, 0, narrow) == ()


def test_harmonics_name_their_fundamental() -> None:
    def line(frequency_hz: float) -> dict[str, float | None]:
        return {"frequency_hz": frequency_hz, "frequency_error_hz": 0.005}

    result = _add_fundamentals([line(15.7), line(31.41), line(40.0), line(47.09)], 0.024)
    assert [one["fundamental_hz"] for one in result] == [None, 15.7, None, 15.7]
