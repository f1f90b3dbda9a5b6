"""Logs that are being written, step by step by the test."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from imuarray.log import Block, LogWriter
from imuarray.log.format import SensorHeader

RATE_HZ = 100
PERIOD_NS = 10_000_000
EPOCH = "2026-01-01T00:00:00.000000Z"

ACC = SensorHeader("Acc", "bma180", "specific_force", "g", 4.0, 2048.0, 2400.0, axes="+X+Y+Z", has_temperature=True)
TURNED = SensorHeader("Turned", "adxl345", "specific_force", "g", 16.0, 256.0, 800.0, axes="+Y-X+Z")
GYRO = SensorHeader("Gyro", "l3g4200d", "angular_rate", "dps", 250.0, 100.0, 800.0, axes="+X+Y+Z", has_temperature=True)
BARO = SensorHeader(
    "Baro", "bmp180", "pressure", "Pa", 0.0, 0.0, 4.0, columns=("ut", "up"), compensated=("temperature", "pressure")
)
HEADERS = (ACC, TURNED, GYRO, BARO)

ACC_LSB, TURNED_LSB, GYRO_LSB = (512, -1024, 2048), (-128, -64, 256), (1000, -500, 250)
"""What they read: (0.25, -0.5, 1) g in the box frame, told by both accelerometers, and (10, -5, 2.5) dps."""


def rows(name: str, start_s: float, seconds: float, period_ns: int = PERIOD_NS) -> Block:
    """Rows of a constant sensor whose counts alternate by one count."""
    count = round(seconds * 1e9 / period_ns)
    time = np.int64(round(start_s * 1e9)) + np.arange(count, dtype=np.int64) * period_ns
    status = np.zeros(count, np.uint16)
    if name == "Baro":
        made = {"temperature": np.full(count, 21.5), "pressure": np.full(count, 100_250.0)}
        return Block(time, np.full((count, 2), 20_000, np.int32), status, None, made)
    level = {"Acc": ACC_LSB, "Turned": TURNED_LSB, "Gyro": GYRO_LSB}[name]
    counts = (np.array(level) + np.where(np.arange(count) % 2, 1, -1)[:, None]).astype(np.int16)
    warm = {"Acc": 8, "Gyro": 20}.get(name)
    return Block(time, counts, status, None if warm is None else np.full(count, warm, np.int16))


class Logger:
    """Writes all sensors, in steps of some seconds; sensors can be left out."""

    def __init__(self, writer: LogWriter) -> None:
        self.writer = writer
        self.now_s = 0.0

    def go_on(self, seconds: float, without: tuple[str, ...] = ()) -> None:
        for header in HEADERS:
            if header.name not in without:
                period_ns = 250_000_000 if header.name == "Baro" else PERIOD_NS
                self.writer.append(header.name, rows(header.name, self.now_s, seconds, period_ns))
        self.now_s += seconds
        self.writer.flush()


@pytest.fixture
def log_path(tmp_path: Path) -> Path:
    return tmp_path / "run.h5"


@pytest.fixture
def logger(log_path: Path) -> Iterator[Logger]:
    """A log that is being written, without rows so far."""
    with LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH) as writer:
        writer.keep()
        yield Logger(writer)
