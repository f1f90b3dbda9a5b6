"""Small logs to read and to damage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imuarray.log import Block, LogWriter, Stimulus
from imuarray.log.format import Event, Phase, SensorHeader

EPOCH = "2013-09-16T08:30:00.000000Z"

ACC = SensorHeader(
    "Acc", "bma180", "specific_force", "g", 16.0, 512.0, 2400.0, 150.0, "+Y+X-Z", (1.0, -2.0, 3.5), has_temperature=True
)
GYRO = SensorHeader("Gyro", "l3g4200d", "angular_rate", "dps", 250.0, 1 / 0.00875, 800.0, 35.0, delay_ns=1_500_000)
BARO = SensorHeader(
    "Baro",
    "bmp180",
    "pressure",
    "Pa",
    0.0,
    0.0,
    4.0,
    columns=("ut", "up"),
    compensated=("temperature", "pressure"),
    extra={"AC1": 408, "MD": 2868},
)


def write_small(path: Path) -> Path:
    """Five rows of an accelerometer, three of a gyroscope, two of a barometer; truth, phases, events."""
    ten_ms = 10_000_000
    with LogWriter(path, [ACC, GYRO, BARO], source="simulated", epoch=EPOCH, config="# toml") as log:
        time = np.arange(5) * ten_ms
        counts = np.array([[512, -256, 0], [-8192, 8191, 1], [0, 0, 0], [1, 2, 3], [4, 5, 6]], np.int16)
        status = np.array([0, 4, 1, 8, 0], np.uint16)
        log.append("Acc", Block(time, counts, status, np.array([2, -1, 0, 127, -128], np.int16)))
        gyro = np.array([[1000, 0, -1000], [32767, -32768, 0], [7, 8, 9]], np.int16)
        log.append("Gyro", Block(np.array([1, 2, 3]) * ten_ms, gyro, np.zeros(3, np.uint16)))
        baro = np.array([[27898, 190744], [27900, 190750]], np.int32)
        made = {"temperature": np.array([15.0, 15.1]), "pressure": np.array([69963.0, 69970.0])}
        log.append("Baro", Block(np.array([5, 9]) * ten_ms, baro, np.zeros(2, np.uint16), None, made))
        log.stimulus("truth", Stimulus(time, np.full((5, 3), 9.80665), np.zeros((5, 3)), np.full(5, 25.0)))
        log.phase(Phase(0, 2 * ten_ms, "z_up", "+Z"))
        log.phase(Phase(2 * ten_ms, 5 * ten_ms, "motion"))
        log.event(Event(3 * ten_ms, "Acc", "lost", "no reading: Größe µ"))
    return path


@pytest.fixture(scope="session")
def small_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_small(tmp_path_factory.mktemp("small") / "small.h5").read_bytes()


@pytest.fixture
def small(tmp_path: Path, small_bytes: bytes) -> Path:
    """A separate copy for every test: many damage it."""
    path = tmp_path / "small.h5"
    path.write_bytes(small_bytes)
    return path


@pytest.fixture
def headers() -> dict[str, SensorHeader]:
    return {header.name: header for header in (ACC, GYRO, BARO)}


@pytest.fixture
def writer(headers: dict[str, SensorHeader]) -> Callable[..., LogWriter]:
    """``writer(path, "Acc", ...)``: an open writer of these sensors."""

    def make(path: Path, *names: str, force: bool = False) -> LogWriter:
        return LogWriter(
            path, [headers[name] for name in names or ("Gyro",)], source="simulated", epoch=EPOCH, force=force
        )

    return make
