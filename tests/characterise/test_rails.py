"""Detection of clipping by the range and by a pile at the last code; and readings that only look clipped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.characterise import characterise_log
from imuarray.characterise.codes import find_rails
from imuarray.characterise.findings import findings
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SensorHeader
from tests.selection import some

EPOCH = "2013-09-16T08:30:00Z"


def logged(folder: Path, counts: np.ndarray, range_g: float = 8.0, sensitivity: float = 1024.0) -> Path:
    header = SensorHeader("S", "any", "specific_force", "g", range_g, sensitivity)
    with LogWriter(folder / "run.h5", [header], source="imported", epoch=EPOCH, force=True) as log:
        time = np.arange(len(counts)) * 10_000_000
        log.append("S", Block(time, counts.astype(np.int16), np.zeros(len(counts), np.uint16)))
    return folder / "run.h5"


def shaken(at: float, rows: int = 4000, low: float | None = None) -> np.ndarray:
    return np.rint(np.random.default_rng(1).normal(0, at / 2, (rows, 3))).clip(-at if low is None else low, at)


@pytest.mark.parametrize(
    ("counts", "high", "low"),
    some(
        [
            (shaken(8192), 8192, -8192),  # range times sensitivity
            (shaken(8191, low=-8192), 8191, -8192),  # two's complement of 14 bits
            (shaken(8400), 8400, -8400),  # a little beyond the range, which chips reach
            (shaken(5000), 5000, -5000),  # another range than that of the log
            (shaken(5000, low=-40_000), 5000, -np.inf),  # one end only
            (shaken(8192, rows=40) // 3, np.inf, -np.inf),
            (np.rint(np.random.default_rng(2).normal(0, 300, (4000, 3))), np.inf, -np.inf),
            (np.rint(np.random.default_rng(2).normal(0, 0.4, (4000, 3))), np.inf, -np.inf),  # hardly any codes
            (np.zeros((400, 3)), np.inf, -np.inf),
        ],
        3,
    ),
)
def test_rails_of_clipped_and_unclipped_readings(counts: np.ndarray, high: float, low: float, tmp_path: Path) -> None:
    with open_log(logged(tmp_path, counts)) as log:
        rails = find_rails(log["S"])
    np.testing.assert_array_equal(rails.high, [high] * 3)
    np.testing.assert_array_equal(rails.low, [low] * 3)
    expected = ((counts >= high) | (counts <= low)).sum(axis=0)
    np.testing.assert_array_equal(rails.rows, expected)
    np.testing.assert_array_equal(rails.clipped(counts), ((counts >= high) | (counts <= low)).any(axis=1))


def test_clipped_readings_without_flags_are_reported(tmp_path: Path) -> None:
    with open_log(logged(tmp_path, shaken(8192))) as log:
        sentences = [text for text in findings(characterise_log(log)) if "clips at -8192 and 8192" in text]
    assert sentences and all("none of them is flagged as saturated: import the log again" in text for text in sentences)


@pytest.mark.slow
def test_uniform_noise_is_not_clipping(tmp_path: Path) -> None:
    """Its density is constant and ends abruptly."""
    counts = np.random.default_rng(3).integers(-3000, 3001, (20_000, 3))
    with open_log(logged(tmp_path, counts)) as log:
        assert not find_rails(log["S"]).rows.any()


@pytest.mark.slow
def test_gaussian_noise_is_not_reported_as_clipped(tmp_path: Path) -> None:
    """40 recordings of six ends each, at a level of one in a million."""
    rng = np.random.default_rng(4)
    for spread in rng.uniform(1, 2000, 40):
        counts = np.rint(rng.normal(0, spread, (2000, 3))).clip(-8000, 8000)
        with open_log(logged(tmp_path, counts)) as log:
            assert not find_rails(log["S"]).rows.any()


def test_a_smooth_peak_of_the_rate_is_not_clipping(tmp_path: Path) -> None:
    """A swing of 45 dps in whole dps: the time at its largest code follows a square root, and is not a pile."""
    at = np.arange(4000) * 0.01
    swing = np.stack([60 * np.sin(2 * at), 45 * np.sin(1.5 * at), 30 * np.sin(at)], axis=1)
    with open_log(logged(tmp_path, np.rint(swing), 250.0, 1.0)) as log:
        assert not find_rails(log["S"]).rows.any()
    with open_log(logged(tmp_path, np.rint(swing.clip(-40, 40)), 250.0, 1.0)) as log:
        rails = find_rails(log["S"])
        assert rails.high.tolist()[:2] == [40, 40] and rails.low.tolist()[:2] == [-40, -40]
