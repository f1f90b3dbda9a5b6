"""Changes of the rate of rows, and rows without such a change."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.characterise.stretch import find_rate_changes, rate_change_sentence
from imuarray.log import open_log
from imuarray.log.format import SensorHeader
from imuarray.log.writer import Block, LogWriter
from tests.selection import some

ROWS = 6000
HEADER = SensorHeader("A", "any", "specific_force", "g", 8.0, 4096.0)


def runs_of(path: Path, intervals_s: np.ndarray) -> tuple[tuple[int, float], ...]:
    times_ns = np.rint(np.cumsum(np.append(0.0, intervals_s)) * 1e9).astype(np.int64)
    with LogWriter(path, [HEADER], source="imported", epoch="2026-01-01T00:00:00Z") as log:
        log.append("A", Block(times_ns, np.zeros((len(times_ns), 3), np.int16), np.zeros(len(times_ns), np.uint16)))
    with open_log(path) as log:
        return tuple((run.start, run.rate_hz) for run in find_rate_changes(log["A"]))


@pytest.mark.parametrize("after", [700, 3000, 5500])
@pytest.mark.parametrize("later_s", [0.004, 0.02])
def test_a_change_has_its_row_and_both_rates(after: int, later_s: float, tmp_path: Path) -> None:
    intervals = np.where(np.arange(ROWS) < after, 0.01, later_s)
    (first, rate_hz), (row, later_hz) = runs_of(tmp_path / "a.h5", intervals)
    assert (first, row) == (0, after)
    assert (rate_hz, later_hz) == pytest.approx((100, 1 / later_s))


STEADY = {
    "a millisecond's clock at 400 Hz": np.diff(np.floor(np.arange(ROWS + 1) * 2.5)) * 1e-3,
    "a program that sleeps": np.random.default_rng(1).uniform(0.001, 0.019, ROWS),
    "a tenth of the rows is lost": np.diff(
        np.flatnonzero(np.random.default_rng(2).random(ROWS + 700) > 0.1)[: ROWS + 1] * 0.01
    ),
    "stalls": np.where(np.arange(ROWS) % 97 == 0, 2.0, 0.01),
    "bursts": np.where(np.arange(ROWS) % 8 == 0, 0.073, 0.001),
    "an oscillator that drifts by 5 %": 0.01 * np.linspace(1, 1.05, ROWS),
    "a single slow piece": np.where(np.abs(np.arange(ROWS) - 2000) < 30, 0.02, 0.01),
}


@pytest.mark.parametrize("name", some(STEADY, 2))
def test_steady_rates_have_no_change(name: str, tmp_path: Path) -> None:
    assert runs_of(tmp_path / "a.h5", STEADY[name]) == ()


def test_many_changes_are_counted(tmp_path: Path) -> None:
    """A phone that saves power while its screen is dark: 1000 rows at 100 Hz, 1000 rows at 20 Hz, and so on."""
    intervals = np.where(np.arange(ROWS) // 1000 % 2 == 0, 0.01, 0.05)
    assert [row for row, _ in runs_of(tmp_path / "a.h5", intervals)] == [0, 1000, 2000, 3000, 4000, 5000]
    with open_log(tmp_path / "a.h5") as log:
        sentence = rate_change_sentence(find_rate_changes(log["A"]))
    assert sentence == "the rate changes 5 times, between 20 and 100 rows per second"


def test_a_short_log_has_no_change(tmp_path: Path) -> None:
    assert runs_of(tmp_path / "a.h5", np.where(np.arange(200) < 100, 0.01, 0.02)) == ()
