"""The arithmetic of the figures, on series with a known result."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest

from imuarray.log.writer import Block
from imuarray.studies.paper.figures import SEGMENT, correlogram, histogram, profile, rate_hz, smooth, spectrum
from imuarray.studies.paper.replica.simulation import Series, StoredSensor

RATE = 50.0


def series(counts: np.ndarray) -> Series:
    return Series((np.arange(len(counts)) * 20_000_000).astype(np.int64), counts.astype(np.int16))


def test_the_moving_average_of_a_ramp_is_the_ramp() -> None:
    rows = 20_000
    ramp = np.outer(np.arange(rows), [1.0, -0.5, 0.0])
    result = smooth(series(np.floor(ramp)), window_s=40.0, step_s=2.0)
    middle = result.seconds * RATE
    np.testing.assert_allclose(result.lsb[:, 0], middle - (rows - 1) / 2, atol=1e-6)
    np.testing.assert_allclose(result.lsb[:, 1], -(middle - (rows - 1) / 2) / 2, atol=0.5)  # halves are rounded
    assert not result.lsb[:, 2].any()
    assert result.seconds[0] == pytest.approx(19.99)  # the middle of 2000 rows
    assert np.diff(result.seconds) == pytest.approx(2.0)


def test_the_rate_of_a_series() -> None:
    assert rate_hz(series(np.zeros((11, 3)))) == pytest.approx(RATE)


def test_a_stored_sensor_returns_the_rows_read() -> None:
    class Canned:
        rows = 10

        def block(self, start: int, stop: int) -> Block:
            time = np.arange(start, stop, dtype=np.int64)
            return Block(time, np.repeat(time[:, None], 3, axis=1), np.zeros(stop - start, np.uint16))

    kept = StoredSensor(Canned())
    assert kept.block(0, 4).time.tolist() == [0, 1, 2, 3]
    kept.block(4, 10)
    assert kept.series.time_ns.tolist() == kept.series.counts[:, 2].tolist() == list(range(10))


def test_the_heating_is_that_of_the_paper() -> None:
    """24 degC for five minutes, 42 to 43 after ten, about 52 after twenty, 110 minutes in all (section 5.2.5)."""
    result = profile(60.0)
    assert result.seconds[-1] == 110 * 60
    assert result.lsb[[0, 5], 0] == pytest.approx(24)
    assert 42 <= result.lsb[10, 0] <= 43
    assert result.lsb[20, 0] == pytest.approx(52, abs=0.5) == pytest.approx(result.lsb.max(), abs=0.5)


def test_density_of_white_noise_and_of_a_line() -> None:
    """White noise of deviation s has a density of s sqrt(2 / rate); a sine of amplitude a, with a Hann window over n
    rows, a / sqrt(2) over sqrt(1.5 rate / n).

    195 segments, 1023 bins: the mean density is known to 0.03 %, the bias of its root is 1 / (8 * 195); 1 % is allowed.
    """
    random = np.random.default_rng(12)
    rows = 200_000
    counts = random.standard_normal((rows, 3)) * [200, 400, 200]
    hz_of_line = 100 * RATE / SEGMENT
    counts[:, 2] += 1000 * np.sin(2 * pi * hz_of_line / RATE * np.arange(rows))
    hz, density = spectrum(np.rint(counts).astype(np.int16), RATE)
    assert hz[0] > 0 and hz[-1] < RATE / 2
    assert density[:, :2].mean(axis=0) == pytest.approx(np.array([200, 400]) * sqrt(2 / RATE), rel=0.01)
    assert hz[density[:, 2].argmax()] == pytest.approx(hz_of_line)
    assert density[:, 2].max() == pytest.approx(1000 / sqrt(2) / sqrt(1.5 * RATE / SEGMENT), rel=0.02)


@pytest.mark.slow
def test_correlogram_of_first_order_noise() -> None:
    """0.4^lag; a lag's standard error is below 0.004, five of them are allowed."""
    random = np.random.default_rng(13)
    noise = random.standard_normal((100_000, 3)) * sqrt(1 - 0.16)
    for row in range(1, len(noise)):
        noise[row] += 0.4 * noise[row - 1]
    result = correlogram(np.rint(noise * 500).astype(np.int16))
    np.testing.assert_allclose(result, np.repeat(0.4 ** np.arange(31)[:, None], 3, axis=1), atol=0.02)


def test_histogram_counts_every_code() -> None:
    codes, often = histogram(np.array([-3, 2, 2, 0, 2, -3], np.int16))
    assert dict(zip(codes.tolist(), often.tolist(), strict=True)) == {-3: 2, -2: 0, -1: 0, 0: 1, 1: 0, 2: 3}
