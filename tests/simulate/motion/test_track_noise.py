"""The noise of a recorded track is reduced, since it is no motion of the box."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.simulate.motion.track_noise import reduce_noise, without_track_noise

ROWS = 20_000
TIME_NS = np.arange(ROWS, dtype=np.int64) * 10_000_000
REST = (0, int(TIME_NS[4000]))


def recorded() -> tuple[np.ndarray, np.ndarray]:
    """Return (n, 6) the input of the box at 100 rows a second, and its track: at rest for 40 s, then a faint motion
    below 10 Hz along X of the power of the track's white noise (0.01); none along Y and Z.
    """
    rng = np.random.default_rng(3)
    spectrum = np.fft.rfft(rng.normal(size=ROWS - 4000))
    spectrum[np.fft.rfftfreq(ROWS - 4000, 0.01) > 10.0] = 0.0
    motion = np.fft.irfft(spectrum, ROWS - 4000)
    stimulus = np.zeros((ROWS, 6))
    stimulus[4000:, [0, 3]] = 0.01 * (motion / motion.std())[:, None]
    return stimulus, stimulus + rng.normal(0, 0.01, (ROWS, 6))


def response(stimulus: np.ndarray, track: np.ndarray) -> float:
    """Return the least-squares response of a perfect sensor to the track, along X."""
    moving = slice(4000, ROWS)
    return float(stimulus[moving, 0] @ track[moving, 0] / (track[moving, 0] @ track[moving, 0]))


def test_the_response_to_the_reduced_track_equals_that_to_the_motion() -> None:
    """A noise of the motion's power halves the response. Behind the filter it is 1: standard error 0.02 from 3200
    independent values of the motion. Where the box does not move, less than a fiftieth of the noise's power is left.
    """
    stimulus, track = recorded()
    reduced = without_track_noise(TIME_NS, track, [REST])
    assert response(stimulus, track) == pytest.approx(0.5, abs=0.03)
    assert response(stimulus, reduced) == pytest.approx(1.0, abs=0.06)
    assert reduced[4000:, [1, 2, 4, 5]].var(axis=0).max() < 0.01**2 / 50
    np.testing.assert_array_equal(reduced[:4000], track[:4000])


def test_a_track_without_rests_or_with_missing_rows_is_unchanged() -> None:
    _, track = recorded()
    np.testing.assert_array_equal(without_track_noise(TIME_NS, track, []), track)
    uneven_ns = TIME_NS + 100_000_000 * (np.arange(ROWS) > 9000)
    np.testing.assert_array_equal(without_track_noise(uneven_ns, track, [REST]), track)


def test_power_can_be_kept_instead_of_the_response() -> None:
    """The power of the motion within 5 %, where the Wiener filter keeps the share of each frequency once more."""
    stimulus, track = recorded()
    moving, variance = slice(4000, ROWS), np.full(3, 1e-4)
    kept = reduce_noise(track[moving, :3], variance, keeps_power=True)
    assert kept[:, 0].var() == pytest.approx(stimulus[moving, 0].var(), rel=0.05)
    assert reduce_noise(track[moving, :3], variance)[:, 0].var() < 0.95 * stimulus[moving, 0].var()


@pytest.mark.parametrize("hertz", [0.5, 3.0])
def test_the_noise_beside_a_single_frequency_is_reduced(hertz: float) -> None:
    """A box swings at one frequency, by up to a hundred times the noise. The mean power over 25 bins would keep the
    noise of 12 bins on either side of its line; most of it is removed.
    """
    rng = np.random.default_rng(4)
    seconds = np.arange(4000) / 100
    swing = np.zeros((4000, 3))
    swing[:, 0] = np.sin(np.pi * seconds / 40) ** 4 * np.sin(2 * np.pi * hertz * seconds)
    kept = reduce_noise(swing + rng.normal(0, 0.01, swing.shape), np.full(3, 1e-4), keeps_power=True)
    noise = np.abs(np.fft.rfft(kept[:, 0] - swing[:, 0])) ** 2 / 4000
    line = round(hertz * 40)
    beside = np.r_[line - 11 : line - 4, line + 5 : line + 12]
    assert noise[beside].mean() < 0.4 * 1e-4
