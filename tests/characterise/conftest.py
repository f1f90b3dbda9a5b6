"""A small log at rest with usual defects: a gap, stale rows, a suspect reading, even codes, motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.log import Block, LogWriter
from imuarray.log.format import LOST_BEFORE, SATURATED, STALE, SUSPECT, Phase, SensorHeader

RATE_HZ = 100.0
ROWS = 6000
SIGMA = 20.0
INTERVAL_NS = 10_000_000

SENSORS = (
    SensorHeader("A", "bma180", "specific_force", "g", 1.5, 5460.0),
    SensorHeader("E", "adxl345", "specific_force", "g", 16.0, 256.0),
    SensorHeader("G", "l3g4200d", "angular_rate", "dps", 250.0, 1 / 0.00875),
    SensorHeader("P", "bmp180", "pressure", "Pa", 0.0, 0.0, columns=("ut", "up")),
)


def _white(rng: np.random.Generator, columns: int) -> np.ndarray:
    return np.rint(rng.normal(0.0, SIGMA, (ROWS, columns))).astype(np.int32)


@pytest.fixture(scope="session")
def log_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """60 s at 100 Hz: phase "static" is [5 s, 55 s), "motion" the rest.

    A: white, sigma 20, mean (0, 0, 5460), a gap of 20 rows after 20 s. E: even codes, row 2900 suspect, 10 saturated.
    G: white, every second row stale. P: two columns without a scale.
    """
    path = tmp_path_factory.mktemp("log") / "run.h5"
    rng = np.random.default_rng(20130916)
    time = np.arange(ROWS, dtype=np.int64) * INTERVAL_NS
    with LogWriter(path, SENSORS, source="simulated", epoch="2024-01-01T00:00:00Z") as writer:
        status = np.zeros(ROWS, np.uint16)
        status[2020] = LOST_BEFORE
        kept = np.r_[0:2000, 2020:ROWS]
        counts = _white(rng, 3) + np.array([0, 0, 5460])
        counts[5500:] += 9000
        writer.append("A", Block(time[kept], counts[kept], status[kept]))
        status = np.zeros(ROWS, np.uint16)
        counts = _white(rng, 3) & ~1
        status[2900], counts[2900] = SUSPECT, 30000
        status[3100:3110], counts[3100:3110] = SATURATED, 4095
        writer.append("E", Block(time, counts, status))
        status = np.zeros(ROWS, np.uint16)
        status[1::2] = STALE
        writer.append("G", Block(time, np.repeat(_white(rng, 3)[::2], 2, axis=0), status))
        writer.append("P", Block(time[::10], _white(rng, 2)[::10], np.zeros(ROWS // 10, np.uint16)))
        writer.phase(Phase(0, 5_000_000_000, "static"))
        writer.phase(Phase(5_000_000_000, 55_000_000_000, "static", "+Z"))
        writer.phase(Phase(0, 60_000_000_000, "motion"))
    return path
