"""Lines with few periods in the segments of the usual spectrum, such as a slow sway in a few minutes of rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from imuarray.characterise import characterise_log
from imuarray.characterise.lines import FIRST_BIN, find_bands, find_lines
from imuarray.characterise.result import SLOW_FALSE_ALARM, find_slow_lines
from imuarray.characterise.spectrum import SlowWelch, Spectrum, Welch, segment_rows, slow_welch
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SensorHeader
from tests.characterise.coloured_noise import coloured
from tests.selection import some

RATE_HZ = 333.0
ROWS = 60_000
"""180 s."""


def slow_spectrum(values: np.ndarray, rate_hz: float = RATE_HZ) -> tuple[Spectrum, float]:
    """The spectrum of low frequencies, and the frequency up to which it is used."""
    slow = slow_welch(rate_hz, len(values), values.shape[1])
    assert slow is not None
    for part in np.array_split(values, 7):
        slow.update(part)
    return slow.result(), FIRST_BIN * rate_hz / segment_rows(len(values))


def sway(over_floor: float, frequency_hz: float = 0.54) -> np.ndarray:
    """A sine that is `over_floor` times the density of white noise of unit variance in the segments of 4096 rows."""
    amplitude = np.sqrt(over_floor * 2 / RATE_HZ * 2 * 1.5 * RATE_HZ / 4096)
    return np.asarray(amplitude * np.sin(2 * np.pi * frequency_hz * np.arange(ROWS) / RATE_HZ + 1))


def test_a_sway_of_half_a_hertz_in_three_minutes_is_detected() -> None:
    """0.54 Hz is bin 6.6 of the usual spectrum, which has no floor there; 83 times the floor, and 10 times."""
    noise = np.random.default_rng(1).normal(0, 1, (ROWS, 3))
    values = noise + np.stack([sway(83), sway(10), np.zeros(ROWS)], axis=1)
    usual = Welch(RATE_HZ, segment_rows(ROWS), 3)
    usual.update(values)
    short = usual.result()
    assert not any(find_lines(short, column).lines or find_bands(short, column) for column in range(3))
    spectrum, below_hz = slow_spectrum(values)
    strong, weak, none = (find_slow_lines(spectrum, below_hz, column) for column in range(3))
    assert none == ()
    for lines, over_floor in ((strong, 83), (weak, 10)):
        (line,) = lines
        assert abs(line.frequency_hz - 0.54) < 4 * line.frequency_error_hz < 0.01
        assert line.amplitude == pytest.approx(sway(over_floor).max(), rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["white", "first order", "1/f"])
@pytest.mark.parametrize("rows", some([15_000, 60_000], 1, 0))
def test_rate_of_false_alarms(kind: str, rows: int) -> None:
    """Of 400 columns of noise, 4 or more with a line have a chance of less than 1 % at the stated level."""
    assert binom.sf(3, 400, SLOW_FALSE_ALARM) < 0.01
    rng, alarms = np.random.default_rng(31), 0
    for _ in range(100):
        spectrum, below_hz = slow_spectrum(coloured(kind, rng, (rows, 4)))
        alarms += sum(bool(find_slow_lines(spectrum, below_hz, column)) for column in range(4))
    assert alarms <= 3


def test_the_density_of_white_noise() -> None:
    """White noise of unit variance has the density 2 / rate."""
    spectrum, below_hz = slow_spectrum(np.random.default_rng(2).normal(5000, 1, (1 << 20, 4)))
    inside = (spectrum.frequency_hz > 4 * spectrum.resolution_hz) & (spectrum.frequency_hz < below_hz)
    assert float(spectrum.density[inside].mean()) == pytest.approx(2 / RATE_HZ, rel=0.02)


def test_fast_lines_do_not_alias() -> None:
    """Lines 10^5 times the noise, at frequencies that fold to 0.1 to 1.9 Hz, are attenuated to less than it."""
    folded_hz = np.linspace(0.6, 1.9, 12)
    times_s = np.arange(ROWS) / RATE_HZ
    orders = np.arange(1, 13) * RATE_HZ / 32
    lines = 1000 * np.cos(2 * np.pi * np.outer(times_s, orders - folded_hz))
    values = np.random.default_rng(3).normal(0, 1, lines.shape) + lines
    spectrum, below_hz = slow_spectrum(values)
    assert spectrum.rate_hz == RATE_HZ / 32
    assert [find_slow_lines(spectrum, below_hz, column) for column in range(12)] == [()] * 12


def test_runs_are_not_joined() -> None:
    """Two runs that are too short for a segment have no spectrum, also if together they are long enough."""
    slow = SlowWelch(100.0, 4, 64)
    for _ in range(2):
        slow.update(np.ones((200, 1)))
        slow.end_run()
    assert slow.result().segments == 0
    assert slow_welch(100.0, 2000, 1) is None


@pytest.mark.slow
def test_a_slow_line_is_in_the_characterisation(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    header = SensorHeader("Acc", "mpu6050", "specific_force", "g", 2.0, 16384.0, axes="+X+Y+Z")
    counts = np.random.default_rng(4).normal(0, 30, (ROWS, 3))
    counts[:, 1] += 30 * sway(83)
    time_ns = np.round(np.arange(ROWS) / RATE_HZ * 1e9).astype(np.int64)
    with LogWriter(path, [header], source="imported", epoch="2024-01-01T00:00:00Z") as writer:
        writer.append("Acc", Block(time_ns, np.rint(counts).astype(np.int16), np.zeros(ROWS, np.uint16)))
    with open_log(path) as log:
        axes = characterise_log(log)["sensors"][0]["axes"]
    frequencies_hz = [[round(line["frequency_hz"], 2) for line in axis["lines"]] for axis in axes]
    assert [[frequency for frequency in each if frequency < 2] for each in frequencies_hz] == [[], [0.54], []]
