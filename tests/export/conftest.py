"""A small log of three sensors with everything that a log can have, and a fused file, whose values are known here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.fuse import FusedBlock, write_fused
from imuarray.importers import importer_of
from imuarray.log import Block, LogWriter, Stimulus
from imuarray.log.format import ClockRow, Event, Phase, SensorHeader

EPOCH = "2013-09-16T08:30:00.250000Z"
EPOCH_NS = 1_379_320_200_250_000_000
"""The same since 1970: `date -d 2013-09-16T08:30:00Z +%s` says 1379320200."""

MS = 1_000_000
ACC = SensorHeader(
    "Acc", "bma180", "specific_force", "g", 16.0, 512.0, 2400.0, 150.0, "+Y+X-Z", (1.0, -2.0, 3.5), has_temperature=True
)
GYRO = SensorHeader(
    "Gyro", "l3g4200d", "angular_rate", "dps", 250.0, 1 / 0.00875, 800.0, 35.0, has_temperature=True, delay_ns=1_500_000
)
BARO = SensorHeader(
    "Baro", "bmp180", "pressure", "Pa", 0.0, 0.0, 4.0,
    columns=("ut", "up"), compensated=("temperature", "pressure"), extra={"AC1": 408, "MD": 2868},
)  # fmt: skip
ACC_COUNTS = [[512, -256, 0], [-8192, 8191, 1], [0, 0, 512], [1, 2, 3], [4, 5, 6]]
GYRO_COUNTS = [[1000, 0, -1000], [32767, -32768, 0], [7, 8, 9]]
MESSAGE = 'no reading: "Größe", µ\nand a second line, =1+1'


def write_run(path: Path) -> Path:
    """Five rows of an accelerometer, three of a gyroscope, two of a barometer; truth, clocks, phases, events."""
    with LogWriter(path, [ACC, GYRO, BARO], source="simulated", epoch=EPOCH, config="[array]\nname = 'µ'\n") as log:
        time, status = np.arange(5) * 10 * MS, np.array([0, 4, 1, 8, 0], np.uint16)
        log.append("Acc", Block(time, np.array(ACC_COUNTS), status, np.array([2, -1, 0, 127, -128])))
        gyro = np.array([1, 2, 3]) * 10 * MS + 1
        log.append("Gyro", Block(gyro, np.array(GYRO_COUNTS), np.zeros(3, np.uint16), np.array([20, 21, 22])))
        made = {"temperature": np.array([15.0, 0.1 + 0.2]), "pressure": np.array([69963.0, np.nan])}
        baro = np.array([[27898, 190744], [27900, 190750]])
        log.append("Baro", Block(np.array([5, 9]) * MS, baro, np.zeros(2, np.uint16), None, made))
        rates = np.full((5, 3), 1 / 3)
        log.stimulus("truth", Stimulus(time, np.full((5, 3), 9.80665), rates, np.full(5, 25.0)))
        log.clocks(ClockRow(0, 5, 6, 7, EPOCH_NS))
        log.phase(Phase(0, 20 * MS, "z_up", "+Z"))
        log.phase(Phase(20 * MS, 50 * MS, "motion"))
        log.event(Event(30 * MS, "Acc", "lost", MESSAGE))
        log.event(Event(-5, "", "simulated", ""))
    return path


@pytest.fixture(scope="session")
def run_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_run(tmp_path_factory.mktemp("run") / "run.h5").read_bytes()


@pytest.fixture
def run(tmp_path: Path, run_bytes: bytes) -> Path:
    path = tmp_path / "run.h5"
    path.write_bytes(run_bytes)
    return path


def write_fused_run(path: Path) -> Path:
    """Four frames; the third has no force, covariances of the rate are not known."""
    force = np.array([[0.0, 0.5, 9.8], [0.1, 0.5, 9.8], [np.nan] * 3, [0.3, 0.5, 9.8]])
    rate = np.array([[1.0, 2.0, 3.0]] * 4) / 7
    covariances = {"specific_force": np.tile([1.0, 2.0, 3.0, 0.25, 0.5, 0.75], (4, 1))}
    covariances["angular_rate"] = np.full((4, 6), np.nan)
    used = {"specific_force": np.array([[7, 0]] * 4, np.uint8), "angular_rate": np.array([[7]] * 4, np.uint8)}
    block = FusedBlock(np.arange(4) * 10 * MS, {"specific_force": force, "angular_rate": rate}, covariances, used)
    sensors = {"specific_force": ["Acc", "Acc2"], "angular_rate": ["Gyro"]}
    write_fused(path, [block], epoch=EPOCH, technique="mean", log="run.h5", sensors=sensors)
    return path


@pytest.fixture(scope="session")
def fused_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_fused_run(tmp_path_factory.mktemp("fused") / "fused.h5").read_bytes()


@pytest.fixture
def fused(tmp_path: Path, fused_bytes: bytes) -> Path:
    path = tmp_path / "fused.h5"
    path.write_bytes(fused_bytes)
    return path


def back(source: Path) -> Path:
    """The export `source`, imported again."""
    output = source.with_name("back.h5")
    importer = importer_of(source)
    assert importer is not None
    importer(source, output, force=True)
    return output
