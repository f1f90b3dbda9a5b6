"""Doubts about readings that a program took apart, and about recordings that contradict each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.importers.plausibility import report_of
from imuarray.importers.table import import_table
from imuarray.log import open_log
from imuarray.log.import_report import ImportReport
from tests.importers.recordings import PER_DPS, PER_G, counts_of, walk
from tests.importers.text_tables import lines, text
from tests.selection import some

MAP = f"""
[time]
column = "t"
unit = "s"
[[sensor]]
name = "Acc"
chip = "adxl345"
quantity = "specific_force"
columns = ["ax", "ay", "az"]
range = {32768 / PER_G:g}
unit = "g"
sensitivity = {PER_G}
[[sensor]]
name = "Gyro"
chip = "l3g4200d"
quantity = "angular_rate"
columns = ["gx", "gy", "gz"]
range = {32768 / PER_DPS:.4f}
unit = "dps"
sensitivity = {PER_DPS}
"""
ROWS = 2000
T = walk(ROWS).time_s


def report(codes: np.ndarray, folder: Path) -> ImportReport:
    """The report on codes (n, 6)."""
    (folder / "map.toml").write_text(MAP)
    (folder / "a.csv").write_text(text("t,ax,ay,az,gx,gy,gz", *lines("{:.2f}" + ",{}" * 6, T, codes.astype(int))))
    import_table(folder / "a.csv", folder / "map.toml", folder / "run.h5")
    with open_log(folder / "run.h5") as log:
        return report_of(log)


def still() -> np.ndarray:
    return counts_of(walk(ROWS, still=True))


def turning() -> np.ndarray:
    return counts_of(walk(ROWS))


def test_a_recording_without_defects_has_no_doubts(tmp_path: Path) -> None:
    assert report(turning(), tmp_path).doubts == ()


def test_single_readings_that_are_off_by_256_codes(tmp_path: Path) -> None:
    codes = still()
    codes[5::100, 4] += 256
    codes[55::100, 4] -= 256
    (doubt,) = report(codes, tmp_path).doubts
    assert doubt.startswith("Gyro: ")
    assert "single readings of y jump by about 2" in doubt


def test_spikes_of_any_size_are_not_taken_for_torn_codes(tmp_path: Path) -> None:
    codes = still()
    codes[5::100, 4] += np.arange(100, 2100, 100)
    assert not any("single reading" in text for text in report(codes, tmp_path).doubts)


def test_single_readings_at_the_end_of_the_range_are_clipped(tmp_path: Path) -> None:
    codes = still()
    codes[5::100, 4] = 32_767
    assert not any("single reading" in text for text in report(codes, tmp_path).doubts)


def test_codes_that_overflow(tmp_path: Path) -> None:
    codes = still()
    shaken = slice(800, 1200)
    wide = codes[shaken, 0] + np.rint(40_000 * np.sin(0.3 * np.arange(400))).astype(int)
    codes[shaken, 0] = (wide + 32_768) % 65_536 - 32_768
    doubts = report(codes, tmp_path).doubts
    assert any("Acc: x jumps" in text and "(overflow)" in text for text in doubts)


def test_shaking_with_the_whole_range_is_no_overflow(tmp_path: Path) -> None:
    codes = still()
    codes[800:1200, 0] = np.random.default_rng(2).uniform(-32_000, 32_000, 400)
    assert not any("overflow" in text for text in report(codes, tmp_path).doubts)


def test_clipped_codes_do_not_overflow(tmp_path: Path) -> None:
    codes = still()
    codes[800:1200, 0] = np.clip(90_000 * np.sin(0.9 * np.arange(400)), -32_768, 32_767)
    assert not any("overflow" in text for text in report(codes, tmp_path).doubts)


@pytest.mark.parametrize("late", some([40, -40], 1))
def test_a_gyroscope_that_comes_late_or_early(late: int, tmp_path: Path) -> None:
    codes = turning()
    codes[:, 3:] = np.roll(codes[:, 3:], late, axis=0)
    (doubt,) = report(codes, tmp_path).doubts
    delay_s = float(doubt.partition("come ")[2].split()[0])
    assert delay_s == pytest.approx(0.4, abs=0.03)
    assert ("later" if late > 0 else "earlier") in doubt


@pytest.mark.slow
def test_an_acceleration_without_gravity_in_motion(tmp_path: Path) -> None:
    codes = turning()
    noise = np.random.default_rng(5).normal(0, 1, (ROWS + 4, 3))
    codes[:, :3] = np.rint(1.6 * PER_G * (noise[:-4] + noise[1:-3] + noise[2:-2] + noise[3:-1] + noise[4:]) / 5)
    assert any("gravity may have been removed" in text for text in report(codes, tmp_path).doubts)


def test_a_coarse_gyroscope_at_rest_has_not_stopped(tmp_path: Path) -> None:
    codes = turning()
    codes[:, 3:] = np.rint(walk(ROWS).rate_dps + np.array([0.2, 0.0, 0.2])) * PER_DPS
    result = report(codes, tmp_path)
    assert not any("did it stop" in text for text in result.doubts)
    assert not any("interpolated" in text for text in result.quirks)


@pytest.mark.slow
def test_a_slow_magnetometer_that_repeats_is_not_clipped(tmp_path: Path) -> None:
    codes = still()
    angle = np.repeat(np.arange(ROWS // 20) * 0.07, 20)
    codes[:, 0] = np.rint(9000 * np.cos(angle))
    codes[:, 1] = np.rint(9000 * np.sin(angle))
    codes[:, 2] = 500 + np.rint(20 * np.sin(5 * angle))
    import_report = report(codes, tmp_path)
    with open_log(tmp_path / "run.h5") as log:
        assert log["Acc"].flagged()["saturated"] == 0
    assert any("repeat the previous row" in text for text in import_report.quirks)
    assert not any("single axes" in text for text in import_report.quirks)
