"""The scatter of single readings: pooled, about means of short segments, without doubtful rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.calibrate import calibrate_noise
from imuarray.errors import CalibrationError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Phase, SensorHeader
from tests.calibrate.conftest import EPOCH, Floats, accelerometer, gyroscope

STILL = Phase(0, 10**12, "static", "+Z")


def write(
    folder: Path,
    counts: Floats,
    phases: list[Phase],
    status: npt.NDArray[np.uint16] | None = None,
    header: SensorHeader | None = None,
) -> Path:
    path = folder / "run.h5"
    time = np.arange(len(counts), dtype=np.int64) * 10_000_000
    header = header or gyroscope("G")
    with LogWriter(path, [header], source="simulated", epoch=EPOCH) as writer:
        whole = np.rint(counts).astype(np.int16)
        writer.append(header.name, Block(time, whole, np.zeros(len(time), np.uint16) if status is None else status))
        for phase in phases:
            writer.phase(phase)
    return path


def noise_of(path: Path, name: str = "G") -> Floats:
    with open_log(path) as log:
        noise = calibrate_noise(log).sensors[name].noise_lsb
    assert noise is not None
    return noise


def white(rows: int, sigma: tuple[float, float, float] = (20.0, 30.0, 50.0), seed: int = 2) -> Floats:
    return np.asarray(np.random.default_rng(seed).normal(0, sigma, (rows, 3)))


def test_scatter_of_white_noise(tmp_path: Path) -> None:
    """Five standard errors of a standard deviation, sigma / sqrt(2 n)."""
    noise = noise_of(write(tmp_path, white(20000), [STILL]))
    expected = np.sqrt(np.array([20.0, 30.0, 50.0]) ** 2 + 1 / 12)
    assert (np.abs(noise - expected) < 5 * expected / np.sqrt(2 * 20000 * 255 / 256)).all()


def test_drift_is_not_noise(tmp_path: Path) -> None:
    """A ramp of 0.2 counts a row adds 0.2^2 * 256^2 / 12 to the variance within a segment, not its 4000 counts."""
    ramp = 0.2 * np.arange(20000)[:, None] - 2000
    noise = noise_of(write(tmp_path, white(20000) + ramp, [STILL]))
    expected = np.sqrt(np.array([20.0, 30.0, 50.0]) ** 2 + 0.2**2 * 256**2 / 12 + 1 / 12)
    assert (np.abs(noise - expected) < 5 * expected / np.sqrt(2 * 20000)).all()


def test_pooled_over_stretches_with_different_means(tmp_path: Path) -> None:
    """Two faces of 300 and 10 rows: squares about each one's mean, over the degrees of freedom, by hand."""
    counts = np.rint(white(310, seed=5))
    counts[300:] += 5000
    phases = [Phase(0, 3_000_000_000, "x_up", "+X"), Phase(3_000_000_000, 4_000_000_000, "x_down", "-X")]
    groups = [counts[:256], counts[256:300], counts[300:]]
    squares = sum(((group - group.mean(axis=0)) ** 2).sum(axis=0) for group in groups)
    assert noise_of(write(tmp_path, counts, phases)) == pytest.approx(np.sqrt(squares / (310 - 3)))


def test_stale_saturated_and_suspect_rows_do_not_count(tmp_path: Path) -> None:
    counts = np.rint(white(200, seed=6))
    status = np.zeros(200, np.uint16)
    for row, flag in ((10, 1), (50, 4), (90, 32)):
        status[row], counts[row] = flag, 20000
    sound = counts[status == 0]
    expected = sound.std(axis=0, ddof=1)
    assert noise_of(write(tmp_path, counts, [STILL], status)) == pytest.approx(expected)


def test_motion_outside_the_still_phases_does_not_count(tmp_path: Path) -> None:
    counts = white(4000)
    counts[2000:] *= 100
    phases = [Phase(0, 20_000_000_000, "room"), Phase(20_000_000_000, 40_000_000_000, "motion")]
    assert (noise_of(write(tmp_path, counts, phases)) < [25, 35, 55]).all()


def test_without_phases_the_accelerometers_show_where_the_box_stood_still(tmp_path: Path) -> None:
    counts = white(6000, (5.0, 5.0, 5.0)) + np.array([0, 0, 2048])
    counts[3000:3600] += np.random.default_rng(7).normal(0, 500, (600, 3))
    noise = noise_of(write(tmp_path, counts, [], header=accelerometer("A")), "A")
    assert noise == pytest.approx([5.0] * 3, rel=5 / np.sqrt(2 * 4000))


def test_a_log_that_never_stood_still_is_refused(tmp_path: Path) -> None:
    counts = white(6000, (900.0, 900.0, 900.0))
    path = write(tmp_path, counts, [], header=accelerometer("A"))
    with open_log(path) as log, pytest.raises(CalibrationError, match="no stretch in which the box stood still"):
        calibrate_noise(log)


def test_a_sensor_without_sound_readings_is_named(tmp_path: Path) -> None:
    path = write(tmp_path, white(100), [STILL], np.full(100, 32, np.uint16))
    with open_log(path) as log, pytest.raises(CalibrationError, match="sensor G: no sound readings"):
        calibrate_noise(log)
