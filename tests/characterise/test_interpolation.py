"""Rows that were interpolated between readings, and rows that only look so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.characterise.processing import find_interpolation
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SensorHeader
from tests.selection import some

ROWS = 4000
NOISE = np.random.default_rng(1).normal(0, 30, (ROWS, 3))
MOTION = 4096 * np.stack([np.sin(np.arange(ROWS) * step) for step in (0.01, 0.013, 0.017)], axis=1)


def found(path: Path, counts: np.ndarray) -> tuple[float, float] | None:
    with LogWriter(
        path,
        [SensorHeader("A", "any", "specific_force", "g", 8.0, 4096.0)],
        source="imported",
        epoch="2026-01-01T00:00:00Z",
    ) as log:
        times = np.arange(ROWS) * 10_000_000
        log.append("A", Block(times, np.rint(counts).astype(np.int16), np.zeros(ROWS, np.uint16)))
    with open_log(path) as log:
        result = find_interpolation(log["A"])
    return None if result is None else (result.share, result.rate_hz)


@pytest.mark.parametrize("factor", [2, 4, 10])
def test_the_rate_of_interpolated_readings_is_estimated(factor: int, tmp_path: Path) -> None:
    at = np.arange(ROWS)
    rows = np.stack([np.interp(at, at[::factor], column[::factor]) for column in (MOTION + NOISE).T], axis=1)
    result = found(tmp_path / "a.h5", rows)
    assert result is not None
    assert result == pytest.approx((1 - 1 / factor, 100 / factor), rel=0.03)


OTHERS = {
    "readings": MOTION + NOISE,
    "each reading twice": np.repeat((MOTION + NOISE)[::2], 2, axis=0),
    "each reading eight times": np.repeat((MOTION + NOISE)[::8], 8, axis=0),
    "at rest, noise below a count": 0.3 * NOISE / 30 + 100,
    "a smooth motion without noise": MOTION / 8,
    "filtered noise": np.cumsum(NOISE / 30, axis=0),
}


@pytest.mark.parametrize("name", some(OTHERS, 2))
def test_other_rows_are_not_reported_as_interpolated(name: str, tmp_path: Path) -> None:
    assert found(tmp_path / "a.h5", OTHERS[name]) is None
