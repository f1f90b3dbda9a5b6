"""Readings that a program processed are reported as processed, and raw readings are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import median_filter
from scipy.signal import butter, filtfilt, lfilter

from imuarray.characterise.processing import find_filters, find_processing
from imuarray.errors import LogError
from imuarray.gap.recording.recordings import recordings_of
from imuarray.importers.plausibility import report_of
from imuarray.importers.table import import_table
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import ASSUMED, DIGITS, RESOLUTION, SATURATED, SensorHeader
from tests.selection import some

ROWS, RATE_HZ, PER_G, PER_DPS = 6000, 100.0, 16384.0, 131.0
STEPS = np.array([1 / PER_G] * 3 + [1 / PER_DPS] * 3)


def readings(rows: int = ROWS) -> np.ndarray:
    """(n, 6) g and dps of a box at rest: codes of white noise of 4 mg and 0.06 dps, times their steps."""
    noise = np.random.default_rng(8).normal(0, [4e-3] * 3 + [0.06] * 3, (rows, 6))
    return np.asarray(np.rint((noise + np.array([0.02, -0.015, 1.03, 0.4, -0.8, 0.3])) / STEPS) * STEPS)


def low_passed(cutoff_hz: float) -> np.ndarray:
    return np.asarray(filtfilt(*butter(2, cutoff_hz / 50), readings(), axis=0))


def causal(cutoff_hz: float) -> np.ndarray:
    return np.asarray(lfilter(*butter(2, cutoff_hz / 50), readings(ROWS + 300), axis=0)[300:])


def averaged(count: int) -> np.ndarray:
    kernel = np.ones(count) / count
    return np.stack([np.convolve(axis, kernel, "valid") for axis in readings().T], axis=1)


def resampled(rate_hz: float) -> np.ndarray:
    """Linear interpolation at 100 Hz between readings at another rate."""
    own = readings(int(ROWS * rate_hz / RATE_HZ) + 2)
    at_s = np.arange(ROWS) / RATE_HZ
    return np.stack([np.interp(at_s, np.arange(len(own)) / rate_hz, axis) for axis in own.T], axis=1)


def without_gravity() -> np.ndarray:
    values = readings()
    values[:, :3] -= values[:, :3].mean(axis=0)
    return values


MATRIX = np.eye(6) + np.random.default_rng(3).normal(0, 4e-3, (6, 6))


def resampled_then_moved() -> np.ndarray:
    """Ten seconds at rest, coarse codes like those of a wristband, and then motion at 2 Hz."""
    values = resampled(97.3)
    values[1024:, :] += np.sin(4 * np.pi * np.arange(ROWS - 1024)[:, None] / RATE_HZ) * [0.4, 0.3, 0.2, 40, 30, 20]
    return values


PROCESSED = {
    "resampled and then moved": (resampled_then_moved(), "is resampled by a program, from about 97."),
    "low-passed to and fro": (low_passed(20), "is low-passed to about 1"),
    "low-passed": (causal(8), "is low-passed to about "),
    "a moving average": (averaged(8), "is low-passed to about "),
    "resampled": (resampled(97.3), "is resampled by a program, from about 97.3 or 102.7 readings a second"),
    "interpolated twice as fast": (resampled(50.0), "is interpolated by a program"),
    "a running median": (np.asarray(median_filter(readings(), (5, 1))), "repeats single axes"),
}
RAW = {
    "codes": readings(),
    "codes less a bias": readings() - readings().mean(axis=0),
    "calibrated": (readings() - [0.02, -0.015, 0.03, 0.4, -0.8, 0.3]) @ MATRIX,
    "rounded to two and one digits": np.column_stack([np.round(readings()[:, :3], 2), np.round(readings()[:, 3:], 1)]),
    "float32": readings().astype(np.float32).astype(float),
    "every reading twice": np.repeat(readings()[::2], 2, axis=0),
}


def imported(values: np.ndarray, folder: Path) -> Path:
    rows = (
        f"{at / RATE_HZ:.4f}," + ",".join(f"{value:.9g}" for value in row) for at, row in enumerate(values.tolist())
    )
    (folder / "data.csv").write_text("t,ax,ay,az,gx,gy,gz\n" + "\n".join(rows) + "\n")
    (folder / "map.toml").write_text(
        'time = { column = "t", unit = "s" }\n[[sensor]]\nname = "Acc"\nchip = "mpu6050"\nquantity = "specific_force"\n'
        'columns = ["ax", "ay", "az"]\nunit = "g"\n[[sensor]]\nname = "Gyro"\nchip = "mpu6050"\n'
        'quantity = "angular_rate"\ncolumns = ["gx", "gy", "gz"]\nunit = "dps"\n'
    )
    import_table(folder / "data.csv", folder / "map.toml", folder / "run.h5")
    return folder / "run.h5"


@pytest.mark.parametrize(
    "name", [name if name == "resampled" else pytest.param(name, marks=pytest.mark.slow) for name in PROCESSED]
)
def test_a_processed_recording_is_reported_as_processed(name: str, tmp_path: Path) -> None:
    """The report of the import and the diagnosis state it, and the diagnosis names no cause."""
    values, message = PROCESSED[name]
    with open_log(imported(values, tmp_path)) as log:
        for sensor in log.sensors.values():
            assert any(text.startswith(message) for text in find_processing(sensor)), find_processing(sensor)
        report = report_of(log)
        assert len([text for text in report.quirks if "program" in text]) >= 1, report.quirks
        with pytest.raises(LogError, match="every sensor was processed, so a simulated chip would differ by that: Acc"):
            recordings_of([log])


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [name if name == "codes" else pytest.param(name, marks=pytest.mark.slow) for name in RAW]
)
def test_raw_readings_are_not_reported_as_processed(name: str, tmp_path: Path) -> None:
    with open_log(imported(RAW[name], tmp_path)) as log:
        for sensor in log.sensors.values():
            assert [text for text in find_processing(sensor) if "gravity" not in text] == []


@pytest.mark.slow
@pytest.mark.parametrize(("order", "is_named"), some([(4, True), (2, False), (6, True), (3, False)], 1))
def test_a_filter_of_higher_order_than_a_chips_is_a_programs(order: int, is_named: bool, tmp_path: Path) -> None:
    """The rounded output of a Butterworth filter; chips have filters up to the third order (ICM-42688-P)."""
    smooth = lfilter(*butter(order, 0.2), readings(ROWS + 300), axis=0)[300:]
    with open_log(imported(np.rint(smooth / STEPS) * STEPS, tmp_path)) as log:
        for sensor in log.sensors.values():
            assert RESOLUTION not in sensor.attributes
            named = [text for text in find_processing(sensor) if "by a program: its spectrum falls more" in text]
            assert bool(named) == is_named


@pytest.mark.slow
def test_an_accelerometer_without_gravity_is_excluded(tmp_path: Path) -> None:
    with open_log(imported(without_gravity(), tmp_path)) as log:
        (recording,) = recordings_of([log])
        assert list(recording.experiment.plan.sensors) == ["Gyro"]
        assert "Acc: has no gravity (" in recording.notes[0]
        assert not [text for text in report_of(log).doubts if text.startswith("Gyro")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "wanted", "per_dps"),
    [
        ("codes", None, PER_DPS),
        pytest.param("codes less a bias", None, PER_DPS, marks=pytest.mark.slow),
        ("rounded to two and one digits", DIGITS, 10.0),
        pytest.param("calibrated", ASSUMED, 32767 / 125, marks=pytest.mark.slow),
    ],
)
def test_the_log_states_whether_counts_are_codes(name: str, wanted: str | None, per_dps: float, tmp_path: Path) -> None:
    with open_log(imported(RAW[name], tmp_path)) as log:
        assert log["Gyro"].attributes.get(RESOLUTION) == wanted
        assert log["Gyro"].sensitivity == pytest.approx(per_dps, rel=1e-3)


def test_readings_that_are_clipped_are_not_called_filtered(tmp_path: Path) -> None:
    """Half of the readings at rest are at the end of the range: runs of equal codes on single axes, no median."""
    noise = np.random.default_rng(4).normal(0, 20, (2000, 3))
    counts = np.minimum(np.rint(noise), 0).astype(np.int16)
    header = SensorHeader("Acc", "any", "specific_force", "g", 2.0, 1000.0)
    said = []
    for status in (0, SATURATED):
        with LogWriter(tmp_path / f"{status}.h5", [header], source="imported", epoch="2026-01-01T00:00:00Z") as log:
            flags = np.where((counts == 0).any(axis=1), status, 0).astype(np.uint16)
            log.append("Acc", Block(np.arange(2000) * 10_000_000, counts, flags))
        with open_log(tmp_path / f"{status}.h5") as log:
            said.append([text for text in find_filters(log["Acc"]) if "single axes" in text])
    assert [len(texts) for texts in said] == [1, 0]
