"""Gyroscopes whose rates contradict each other are named before they are averaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import imuarray as ia
from imuarray.calibrate import Calibration
from imuarray.fuse.rate_directions import rate_contradictions
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SATURATED, SensorHeader

LSB_PER_DPS = 16.0
RATE_HZ = 50.0
Rates = npt.NDArray[np.float64]


def turns_dps(peak_dps: float = 90.0, seconds: float = 60.0) -> Rates:
    """A box at rest for 20 s, which then turns to and fro about x, y and z in turn: 4 s each, at 0.25 Hz."""
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    rates = np.zeros((len(time), 3))
    for axis in range(3):
        turning = (20 + 4 * axis <= time) & (time < 24 + 4 * axis)
        rates[turning, axis] = peak_dps * np.sin(2 * np.pi * 0.25 * time[turning])
    return rates


def log_of(path: Path, rates_dps: dict[str, Rates], axes: dict[str, str] | None = None, flag: int = 0) -> Path:
    """Gyroscopes that read these rates in the box frame, with noise of 0.5 dps; `axes` are in their headers, which are
    wrong where they are given. The last gyroscope has the flag in all rows.
    """
    headers = [
        SensorHeader(
            name, "unknown", "angular_rate", "dps", 2000.0, LSB_PER_DPS, RATE_HZ, 0.0, (axes or {}).get(name, "+X+Y+Z")
        )
        for name in rates_dps
    ]
    random = np.random.default_rng(1)
    with LogWriter(path, headers, source="imported", epoch="2024-05-06T12:00:00.000000Z") as log:
        for name, rates in rates_dps.items():
            counts = np.rint((rates + random.normal(0, 0.5, rates.shape)) * LSB_PER_DPS).clip(-32768, 32767)
            status = np.full(len(counts), flag if name == list(rates_dps)[-1] else 0, np.uint16)
            time = np.arange(len(counts)) * round(1e9 / RATE_HZ)
            log.append(name, Block(time, counts.astype(np.int16), status))
    return path


def sentences(path: Path) -> list[str]:
    with open_log(path) as log:
        return list(rate_contradictions(log.of("angular_rate"), Calibration()))


@pytest.mark.parametrize("axes", ["+Y-X+Z", "-X-Y+Z", "+X-Z+Y", "+Y+Z+X", "-X+Y-Z"])
def test_one_of_three_with_wrong_axes_is_named(tmp_path: Path, axes: str) -> None:
    turns = turns_dps()
    path = log_of(tmp_path / "a.h5", {"A": turns, "B": turns, "C": turns}, {"A": axes})
    (text,) = sentences(path)
    assert text.startswith("A: its angular rates contradict those of B, C: check its `axes` and range in the config")


def test_both_of_two_are_named(tmp_path: Path) -> None:
    turns = turns_dps()
    (text,) = sentences(log_of(tmp_path / "a.h5", {"A": turns, "B": turns}, {"B": "-X-Y+Z"}))
    assert text.startswith("A, B: their angular rates contradict each other: check their `axes`")


@pytest.mark.parametrize(
    ("of_a", "of_b"),
    [(1.0, 1.0), (0.8, 1.0), (1.0, 0.8)],
)
def test_scale_errors_and_biases_are_no_contradiction(tmp_path: Path, of_a: float, of_b: float) -> None:
    turns = turns_dps()
    path = log_of(tmp_path / "a.h5", {"A": of_a * turns + 70.0, "B": of_b * turns - 40.0})
    assert sentences(path) == []


@pytest.mark.parametrize("first", ["A", "B"])
def test_a_gyroscope_that_does_not_move_contradicts_the_others(tmp_path: Path, first: str) -> None:
    """Also if it is the first one, in which rotations are searched."""
    turns = turns_dps()
    rates = {name: 0.0 * turns if name == first else turns for name in "ABC"}
    others = "B, C" if first == "A" else "A, C"
    (text,) = sentences(log_of(tmp_path / "a.h5", rates))
    assert text.startswith(f"{first}: its angular rates contradict those of {others}: ")


@pytest.mark.parametrize(("peak_dps", "count"), [(15.0, 0), (28.0, 0), (60.0, 1)])
def test_only_a_clear_rotation_is_compared(tmp_path: Path, peak_dps: float, count: int) -> None:
    turns = turns_dps(peak_dps)
    assert len(sentences(log_of(tmp_path / "a.h5", {"A": turns, "B": turns}, {"B": "-X-Y+Z"}))) == count


def test_single_glitches_are_no_rotation(tmp_path: Path) -> None:
    still = np.zeros((3000, 3))
    glitches = still.copy()
    glitches[100::200] = 1900.0
    assert sentences(log_of(tmp_path / "a.h5", {"A": glitches, "B": still})) == []


def test_saturated_rows_are_not_compared(tmp_path: Path) -> None:
    turns = turns_dps()
    assert sentences(log_of(tmp_path / "a.h5", {"A": turns, "B": -turns}, flag=SATURATED)) == []


@pytest.mark.parametrize("delay_rows", [2, 4])
def test_the_delay_of_a_filter_is_no_contradiction(tmp_path: Path, delay_rows: int) -> None:
    """80 ms at 50 Hz, in turns at 1 Hz."""
    time = np.arange(3000) / RATE_HZ
    turns = np.where(time > 20, 100 * np.sin(2 * np.pi * time), 0.0)[:, None] * [0.5, 0.6, 0.7]
    late = np.roll(turns, delay_rows, axis=0)
    assert sentences(log_of(tmp_path / "a.h5", {"A": turns, "B": late})) == []


def test_a_rotation_in_a_long_log_is_detected(tmp_path: Path) -> None:
    """Of 200,000 rows every fourth one is searched; the only turn begins after an hour."""
    turns = np.zeros((200_000, 3))
    turns[180_000:180_300] = turns_dps()[1000:1300]
    path = log_of(tmp_path / "a.h5", {"A": turns, "B": turns, "C": turns}, {"C": "-X-Y+Z"})
    (text,) = sentences(path)
    assert text.startswith("C: its angular rates contradict those of A, B: ")


def test_fuse_states_contradictions_of_gyroscopes(tmp_path: Path) -> None:
    turns = turns_dps()
    path = log_of(tmp_path / "a.h5", {"A": turns, "B": turns, "C": turns}, {"B": "-X-Y+Z"})
    (text,) = [remark for remark in ia.fuse(path).remarks if "contradict" in remark]
    assert text.startswith("B: its angular rates contradict those of A, C: ")
