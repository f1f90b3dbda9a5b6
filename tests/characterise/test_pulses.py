"""Alignment by synchronisation pulses, on rows whose times have a known error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.characterise import characterise_log, render_text
from imuarray.characterise.alignment import SensorAlignment, find_alignment
from imuarray.log import open_log
from imuarray.log.format import SYNC_PULSE, SYNC_PULSE_ERROR, SensorHeader
from imuarray.log.writer import Block, LogWriter

SECONDS, PULSE_S = 60.0, 0.37


def written(path: Path, sensors: dict[str, tuple[float, float, bool]]) -> dict[str, SensorAlignment]:
    """Alignment of sensors of a nominal 500 Hz by name, each with its actual rate, the lateness of its times (s), and
    whether it measures the time since a pulse by its own oscillator.
    """
    headers = [
        SensorHeader(
            name,
            "mpu6050_gyro",
            "angular_rate",
            "dps",
            500.0,
            65.5,
            rate_hz=500.0,
            compensated=(SYNC_PULSE,),
            extra={SYNC_PULSE_ERROR: 20.5e-6 if is_measured else 1.01e-3},
        )
        for name, (_, _, is_measured) in sensors.items()
    ]
    with LogWriter(path, headers, source="simulated", epoch="2024-01-01T00:00:00Z") as writer:
        for number, (name, (rate_hz, late_s, is_measured)) in enumerate(sensors.items()):
            times_s = (np.arange(round(SECONDS * rate_hz)) + 0.31 * number) / rate_hz
            pulses_s = np.arange(PULSE_S, times_s[-1], PULSE_S) + 0.5e-3
            following = np.searchsorted(times_s, pulses_s)
            ages_s = np.full(len(times_s), np.nan)
            ages_s[following] = (times_s[following] - pulses_s) * rate_hz / 500 if is_measured else 1e-3
            counts = np.random.default_rng(number).integers(-50, 50, (len(times_s), 3)).astype(np.int16)
            time_ns = np.rint((times_s + late_s + 1) * 1e9).astype(np.int64)
            writer.append(name, Block(time_ns, counts, np.zeros(len(counts), np.uint16), None, {SYNC_PULSE: ages_s}))
    with open_log(path) as log:
        alignment = find_alignment(log)
    assert alignment is not None
    assert alignment.pulses_from == next(iter(sensors))
    return {sensor.name: sensor for sensor in alignment.sensors}


def test_measured_pulses_determine_late_times_to_a_microsecond(tmp_path: Path) -> None:
    late = {"A": 0.0, "B": 150e-6, "C": -2e-3}
    rates = {"A": 503.1, "B": 498.7, "C": 500.2}
    sensors = written(tmp_path / "r.h5", {name: (rates[name], late[name], True) for name in late})
    for name, late_s in late.items():
        assert sensors[name].pulses == 162  # 0.3705 s, 0.7405 s ... 59.9405 s
        assert sensors[name].pulse_offset_s == pytest.approx(late_s, abs=1e-6)
    assert sensors["B"].pulse_error_s is not None
    assert sensors["B"].pulse_error_s <= 41e-6


def test_marks_alone_determine_late_times_to_part_of_a_period(tmp_path: Path) -> None:
    """A pulse at any phase of two periods of 2 ms: 0.82 ms of one difference, 0.126 ms of 162 (95 %)."""
    sensors = written(tmp_path / "r.h5", {"A": (503.1, 0.0, False), "B": (498.7, 700e-6, False)})
    late, error = sensors["B"].pulse_offset_s, sensors["B"].pulse_error_s
    assert late is not None
    assert error is not None
    assert late == pytest.approx(700e-6, abs=error)
    assert 60e-6 < error < 200e-6


def test_pulses_at_one_phase_do_not_average_down(tmp_path: Path) -> None:
    """Periods of exactly 2 ms, pulses a quarter of a period after a sample: the mean of many is no better."""
    sensors = written(tmp_path / "r.h5", {"A": (500.0, 0.0, False), "B": (500.0, 0.0, False)})
    assert sensors["B"].pulse_error_s == pytest.approx(2.02e-3)


@pytest.mark.slow
def test_characterise_prints_the_alignment_by_pulses(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    written(path, {"A": (503.1, 0.0, False), "B": (498.7, 700e-6, False)})
    with open_log(path) as log:
        text = render_text(characterise_log(log))
    lines = text[text.index("synchronisation pulses, relative to A") :].splitlines()
    assert lines[1].split() == ["sensor", "pulses", "later", "by", "us"]
    assert lines[2].split() == ["A", "162", "0.0"]
    name, count, _, error = lines[3].split()
    assert (name, count) == ("B", "162")
    assert error.startswith("+-")
