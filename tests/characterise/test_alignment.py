"""Alignment in time of synthetic sensors with known clocks, delays and gains."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.characterise import characterise_log, render_text
from imuarray.characterise.alignment import Alignment, SensorAlignment, find_alignment
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SATURATED, TIME_UNCERTAINTY, Phase, SensorHeader
from tests.selection import some

SECONDS = 40.0
COUNTS_PER_DPS = 100.0
FREQUENCIES_HZ = np.array([1.3, 2.1, 3.4])


def rates_dps(at_s: np.ndarray) -> np.ndarray:
    """Rotation of the box (n, 3): at rest for ten seconds, then a sine along each axis."""
    moves = at_s[:, None] > 10.0
    return np.asarray(np.where(moves, 80.0 * np.sin(2 * np.pi * FREQUENCIES_HZ * (at_s[:, None] - 10.0)), 0.0))


def rows(
    seed: int, rate_hz: float, first_s: float, delay_s: float, gain: float = 1.0, noise: float = 5.0
) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) in ns, and counts (n, 3) of the rotation `delay_s` earlier."""
    at_s = first_s + np.arange(int(SECONDS * rate_hz)) / rate_hz
    skewed = rates_dps(at_s - delay_s) @ np.array([[1.0, 0.02, 0.0], [-0.02, 1.0, 0.01], [0.0, 0.0, 1.0]])
    counts = gain * COUNTS_PER_DPS * skewed + np.random.default_rng(seed).normal(0.0, noise, (len(at_s), 3))
    return np.rint(at_s * 1e9).astype(np.int64), np.rint(counts).astype(np.int32)


def aligned(path: Path, others: dict[str, tuple[np.ndarray, np.ndarray]], delay_ns: int = 0, clipped: int = 0) -> Path:
    """Write a log of gyroscope A at 200 Hz from 0 on, and of `others`; `clipped` limits B's counts, with flags."""
    sensors = {"A": rows(1, 200.0, 0.0, 0.0), **others}
    headers = [
        SensorHeader(name, "l3g4200d", "angular_rate", "dps", 500.0, COUNTS_PER_DPS, extra={"delay_ns": delay_ns})
        if name == "B"
        else SensorHeader(name, "l3g4200d", "angular_rate", "dps", 500.0, COUNTS_PER_DPS)
        for name in sensors
    ]
    with LogWriter(path, headers, source="simulated", epoch="2024-01-01T00:00:00Z") as writer:
        for name, (time_ns, counts) in sensors.items():
            status = np.zeros(len(time_ns), np.uint16)
            if clipped and name == "B":
                status[(np.abs(counts) > clipped).any(axis=1)] = SATURATED
                counts = np.clip(counts, -clipped, clipped)
            writer.append(name, Block(time_ns, counts, status))
        writer.phase(Phase(0, 10_000_000_000, "static"))
    return path


def of(path: Path) -> tuple[Alignment, dict[str, SensorAlignment]]:
    with open_log(path) as log:
        result = find_alignment(log)
    assert result is not None
    return result, {sensor.name: sensor for sensor in result.sensors}


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", some([0.0, 2.7e-3, -4e-4, 1.5e-2], 2))
def test_a_delay_is_estimated_within_its_error(tmp_path: Path, delay_s: float) -> None:
    """A gain error of -3 % and an axis that is misaligned by a degree do not bias the delay."""
    result, sensors = of(aligned(tmp_path / "r.h5", {"B": rows(2, 200.0, 0.0, delay_s, gain=0.97)}))
    assert (result.delays_from, sensors["A"].delay_s) == ("A", 0.0)
    estimate, error = sensors["B"].delay_s, sensors["B"].delay_error_s
    assert estimate is not None
    assert error is not None
    assert 1e-7 < error < 2e-5
    assert estimate == pytest.approx(delay_s, abs=4 * error + 2e-3 * abs(delay_s))
    assert result.motion_from_s is not None
    assert result.motion_from_s <= 10.0


def test_a_filter_delay_in_the_header_is_subtracted(tmp_path: Path) -> None:
    _, sensors = of(aligned(tmp_path / "r.h5", {"B": rows(2, 200.0, 0.0, 5e-3)}, delay_ns=5_000_000))
    assert sensors["B"].delay_s == pytest.approx(0.0, abs=2e-5)


def test_clipped_rows_do_not_bias_the_delay(tmp_path: Path) -> None:
    _, sensors = of(aligned(tmp_path / "r.h5", {"B": rows(2, 200.0, 0.0, 1e-3)}, clipped=4000))
    assert sensors["B"].delay_s == pytest.approx(1e-3, abs=5e-5)


def test_rate_and_delay_of_a_sensor_with_its_own_clock(tmp_path: Path) -> None:
    """1 % fast: it gains a row in half a second, and the nearest row is uniform within half a period."""
    _, sensors = of(aligned(tmp_path / "r.h5", {"B": rows(2, 202.0, 0.0012, 6e-4)}))
    fast = sensors["B"]
    assert fast.rate_hz == pytest.approx(202.0, rel=1e-6)
    assert fast.rate_ppm == pytest.approx(10_000.0, abs=1.0)
    assert fast.row_apart_s == pytest.approx(0.5, rel=1e-3)
    assert fast.spread_s == pytest.approx(1 / 202 / np.sqrt(12), rel=0.05)
    assert fast.delay_s == pytest.approx(6e-4, abs=5e-5)


def test_the_offset_of_a_sensor_read_later_in_each_frame(tmp_path: Path) -> None:
    _, sensors = of(aligned(tmp_path / "r.h5", {"B": rows(2, 200.0, 0.0007, 0.0)}))
    assert sensors["B"].offset_s == pytest.approx(0.0007, abs=1e-9)
    assert (sensors["B"].spread_s, sensors["B"].row_apart_s) == (pytest.approx(0.0, abs=1e-9), None)
    assert sensors["B"].delay_s == pytest.approx(0.0, abs=2e-5)


@pytest.mark.slow
def test_a_log_at_rest_gives_no_delay(tmp_path: Path) -> None:
    time_ns, counts = rows(1, 200.0, 0.0, 0.0)
    quiet = np.random.default_rng(3).normal(0.0, 5.0, counts.shape).round().astype(np.int32)
    path = tmp_path / "r.h5"
    headers = [SensorHeader(name, "l3g4200d", "angular_rate", "dps", 500.0, COUNTS_PER_DPS) for name in "AB"]
    with LogWriter(path, headers, source="simulated", epoch="2024-01-01T00:00:00Z") as writer:
        for name in "AB":
            writer.append(name, Block(time_ns, np.roll(quiet, ord(name), axis=0), np.zeros(len(quiet), np.uint16)))
    outcome, sensors = of(path)
    assert outcome.is_simultaneous
    assert sensors["B"].delay_s is None
    with open_log(path) as log:
        result = characterise_log(log)
    assert result["alignment"] is None
    assert "alignment in time" not in render_text(result)


def test_characterise_reports_the_alignment_of_sensors(tmp_path: Path) -> None:
    path = aligned(tmp_path / "r.h5", {"B": rows(2, 202.0, 0.0, 2.7e-3)})
    with open_log(path) as log:
        text = render_text(characterise_log(log))
    head, _, _, first, second = text[text.index("alignment in time") :].splitlines()[:5]
    assert head == "alignment in time, relative to A; delays relative to A, by the rotation from 0 s on"
    assert first.split() == ["A", "200.000", "0", "0.0", "0.0", "-", "-", "0.0"]
    name, rate, ppm, *_ = second.split()
    assert (name, rate, ppm) == ("B", "202.000", "10000")
    assert float(second.split()[-2]) == pytest.approx(2700, abs=20)


@pytest.mark.parametrize(("uncertainty_s", "is_equal"), some([(17e-6, True), (None, False), (2e-6, False)], 1))
def test_rates_that_differ_within_their_uncertainty_are_equal(
    uncertainty_s: float | None, is_equal: bool, tmp_path: Path
) -> None:
    """2 ppm in 40 s: times with an error of 17 us over an eighth of that give 3.4 ppm."""
    compensated = () if uncertainty_s is None else (TIME_UNCERTAINTY,)
    headers = [
        SensorHeader(
            name, "icm42688_gyro", "angular_rate", "dps", 500.0, COUNTS_PER_DPS, compensated=compensated * (name == "B")
        )
        for name in "AB"
    ]
    path = tmp_path / "r.h5"
    with LogWriter(path, headers, source="simulated", epoch="2024-01-01T00:00:00Z") as writer:
        for name, rate_hz in (("A", 200.0), ("B", 200.0004)):
            time_ns, counts = rows(1, rate_hz, 0.0, 0.0)
            stated = np.full(len(time_ns), uncertainty_s or 0.0)
            further = {TIME_UNCERTAINTY: stated} if name == "B" and compensated else {}
            writer.append(name, Block(time_ns, counts, np.zeros(len(counts), np.uint16), None, further))
    _, sensors = of(path)
    assert (sensors["B"].row_apart_s is None) == is_equal
    if not is_equal:
        assert sensors["B"].row_apart_s == pytest.approx(2500, rel=0.1)
