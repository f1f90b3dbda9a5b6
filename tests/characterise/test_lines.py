"""Lines: rate of false alarms, errors of known lines, and frequencies of which they may be aliases."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from imuarray.characterise.lines import FIRST_BIN, aliases, find_lines, noise_floor
from imuarray.characterise.spectrum import Spectrum, Welch
from tests.characterise.coloured_noise import coloured


def spectrum(values: np.ndarray, rate_hz: float = 1.0, rows: int = 512) -> Spectrum:
    estimate = Welch(rate_hz, rows, values.shape[1])
    estimate.update(values)
    return estimate.result()


@pytest.mark.slow
@pytest.mark.parametrize("rows", [8192, 32_768])
@pytest.mark.parametrize("kind", ["white", "first order", "1/f"])
def test_rate_of_false_alarms(kind: str, rows: int) -> None:
    """The number of 240 columns of noise with a line is that of a chance of 10 %; both limits fail once in 10,000 runs.

    The lower limit is that of 5 %: bins are correlated, and a line must be narrow too.
    """
    result = spectrum(coloured(kind, np.random.default_rng(21), (rows, 240)))
    hits = sum(bool(find_lines(result, column, 0.1).lines) for column in range(240))
    assert binom.ppf(1e-4, 240, 0.05) <= hits <= binom.isf(1e-4, 240, 0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("amplitude", "at"), [(0.2, 60), (0.6, 60), (4.0, 100), (0.6, 25), (0.6, 250)])
@pytest.mark.parametrize("kind", ["white", "first order"])
def test_known_lines_are_estimated_within_their_errors(kind: str, amplitude: float, at: int) -> None:
    """160 lines at any place between two bins: errors over stated errors have a spread of 1 and a mean of 0. The spread
    of 160 normal values is known to 0.056: 0.75 to 1.25 allow four of them and 3 % for terms that the formula omits.
    The mean is known to 0.08: 0.35 is four. For a weak line the scatter of the floor contributes as much.
    """
    rng = np.random.default_rng(at)
    frequency_hz = (at + rng.uniform(-0.5, 0.5, 160)) / 512
    phase = 2 * np.pi * (frequency_hz * np.arange(16_384)[:, np.newaxis] + rng.uniform(size=160))
    local = 1.0 if kind == "white" else 1 / abs(1 - 0.9 * np.exp(-2j * np.pi * at / 512))
    noise = coloured(kind, rng, phase.shape)
    found = spectrum(noise + amplitude * local * np.cos(phase))
    searches = [find_lines(found, column) for column in range(160)]
    lines = [search.lines[0] for search in searches]
    frequency = [
        (line.frequency_hz - true) / line.frequency_error_hz for line, true in zip(lines, frequency_hz, strict=True)
    ]
    size = [(line.amplitude / (amplitude * local) - 1) * line.amplitude / line.amplitude_error for line in lines]
    for errors in (frequency, size):
        assert abs(np.mean(errors)) < 0.35
        assert 0.75 < np.std(errors) < 1.25


@pytest.mark.parametrize("rows", [1024, 4096])
@pytest.mark.parametrize(
    ("law", "tolerance"),
    [
        (lambda turn: np.ones(len(turn)), 1e-9),
        (lambda turn: 1 / np.abs(1 - 0.9 * np.exp(-1j * turn)) ** 2, 0.01),
        (lambda turn: 1 / np.sin(turn / 2), 0.005),
        (lambda turn: 1 / np.sin(turn / 2) ** 2, 0.01),
    ],
    ids=["white", "first order", "1/f", "1/f^2"],
)
def test_the_floor_of_a_smooth_spectrum_is_the_spectrum(rows: int, law: Any, tolerance: float) -> None:
    """A density without any scatter is its own floor."""
    turn = np.maximum(2 * np.pi * np.arange(rows // 2 + 1) / rows, 1e-9)
    density = law(turn)
    density[-1] /= 2
    freedom = np.full(len(turn), 1e9)
    floor = noise_floor(Spectrum(turn, density[:, np.newaxis], freedom, 1.0, rows, 1, 1, rows, 0))
    assert floor.bins.tolist() == list(range(FIRST_BIN, rows // 2 + 1))
    np.testing.assert_allclose(floor.density, density[floor.bins], rtol=tolerance)


def test_the_floor_is_the_mean_of_the_noise() -> None:
    """Not its median, which is lower by 2 / 3 / freedom: mean over 100 columns within five standard errors."""
    result = spectrum(np.random.default_rng(31).normal(size=(2048, 100)))
    means = [float(noise_floor(result, column).density[:-1].mean()) for column in range(100)]
    assert abs(np.mean(means) - 2) < 5 * np.std(means) / 10 + 0.01
    assert np.std(means) / 10 < 0.01


def test_intermittent_noise_has_fewer_degrees_of_freedom() -> None:
    """Twenty times as loud in a tenth of the time: only those segments contribute, and no line is detected."""
    values = np.random.default_rng(32).normal(size=(32_768, 40))
    values[:3277] *= 20
    result = spectrum(values)
    assert result.freedom[30] > 200
    assert max(noise_floor(result, column).spectrum_freedom[0] for column in range(40)) < 60
    assert sum(bool(find_lines(result, column, 0.1).lines) for column in range(40)) <= binom.isf(1e-4, 40, 0.1)


def test_a_strong_line_neither_hides_nor_creates_lines() -> None:
    """67 dB above the floor, a weak one 30 bins on, and the alternation +A, -A at half the rate."""
    row = np.arange(32_768)
    values = np.random.default_rng(33).normal(0, 0.01, (len(row), 20)) + 3 * np.sin(2 * np.pi * 0.1003 * row)[:, None]
    values += 0.002 * np.sin(2 * np.pi * 0.16 * row)[:, None] + 0.003 * (-1.0) ** row[:, None]
    result = spectrum(values, 100.0)
    for column in range(20):
        strong, alternation, weak = find_lines(result, column).lines
        assert strong.frequency_hz == pytest.approx(10.03, abs=5 * strong.frequency_error_hz)
        assert strong.amplitude == pytest.approx(3, rel=1e-3)
        assert alternation.frequency_hz == 50
        assert alternation.amplitude == pytest.approx(0.003, abs=5 * alternation.amplitude_error)
        assert weak.amplitude == pytest.approx(0.002, abs=5 * weak.amplitude_error)
        assert weak.false_alarm < 1e-6 < weak.over_floor


def test_constant_or_short_series_have_no_lines() -> None:
    for values in (np.full((4096, 1), 7), np.random.default_rng(1).normal(size=(100, 1))):
        search = find_lines(spectrum(values))
        assert search.lines == ()
        assert len(search.frequency_hz) == len(search.floor) == len(search.level) == 0
    short = find_lines(spectrum(np.random.default_rng(1).normal(size=(4096, 1)), rows=64))
    assert len(short.frequency_hz) == 0
    with pytest.raises(ValueError, match="a probability"):
        find_lines(spectrum(values), 0, 1.0)


def test_aliases_of_the_paper_array() -> None:
    """Mains hum of 50 Hz in a log of 28 rows a second shows at 6 Hz."""
    assert aliases(6.0, 28.0, 80.0) == (6.0, 22.0, 34.0, 50.0, 62.0, 78.0)
    assert aliases(0.0, 100.0, 300.0) == (0.0, 100.0, 200.0, 300.0)
    assert aliases(50.0, 100.0, 300.0) == (50.0, 150.0, 250.0)
    for apparent_hz, rate_hz in ((51.0, 100.0), (-1.0, 100.0), (0.0, 0.0)):
        with pytest.raises(ValueError, match="half of a positive rate"):
            aliases(apparent_hz, rate_hz, 100.0)


@given(st.integers(0, 500), st.integers(1, 1000), st.integers(0, 5000))
def test_aliases_are_the_frequencies_that_fold_to_the_line(apparent: int, rate: int, highest: int) -> None:
    """Whole frequencies: exactly those that the rate's folding maps to the apparent one."""
    apparent = min(apparent, rate // 2)
    expected = [true for true in range(highest + 1) if min(true % rate, -true % rate) == apparent]
    assert list(aliases(apparent, rate, highest)) == expected
