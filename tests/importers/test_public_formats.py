"""Headers, clocks and prints of boards and data sets that are widely used: the guessed map imports each with the true
values, or states what the file does not contain. The samples are written here in these formats.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from imuarray.importers.guess import guess_map
from imuarray.importers.plausibility import report_of
from imuarray.importers.table import import_table
from imuarray.log import open_log
from tests.importers.recordings import G, walk
from tests.importers.text_tables import lines, text
from tests.selection import some

ROWS = 1600
WALK = walk(ROWS)
T, FORCE, RATE = WALK.time_s, WALK.force_g, WALK.rate_dps
MAGNET = np.array([0.2, 0.05, -0.43]) + np.random.default_rng(3).normal(0, 2e-3, (ROWS, 3))
MS = np.rint(T * 1e3).astype(int)
SIX = ",{:.6f}" * 6


def imported(folder: Path, name: str, content: str) -> tuple[str, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The guessed map on one line, and the values (n, 3) and times (n,) in s from the first row of each sensor."""
    source = folder / name
    source.write_text(content, encoding="utf-8")
    guessed = guess_map(source)
    (folder / "map.toml").write_text(guessed, encoding="utf-8")
    import_table(source, folder / "map.toml", folder / "run.h5")
    with open_log(folder / "run.h5") as log:
        values = {each.name: np.asarray(each.counts[:]) / (each.sensitivity or 1) for each in log.sensors.values()}
        times_s = {each.name: (each.time[:] - each.time[0]) * 1e-9 for each in log.sensors.values()}
    return " ".join(guessed.replace("\n#   ", " ").split()), values, times_s


@pytest.mark.slow
def test_the_names_of_the_usual_sketch_for_an_mpu6050(tmp_path: Path) -> None:
    codes = np.rint(np.hstack([FORCE * 16384, np.full((ROWS, 1), -2500), RATE * 131])).astype(int)
    head = "millis,AcX,AcY,AcZ,Tmp,GyX,GyY,GyZ"
    guessed, values, _ = imported(tmp_path, "a.csv", text(head, *lines("{}" + ",{}" * 7, MS, codes)))
    np.testing.assert_allclose(values["Acc"], FORCE, atol=1e-3)
    np.testing.assert_allclose(values["Gyro"], RATE, atol=0.01)
    assert "column 'Tmp' may be a chip's thermometer" in guessed


@pytest.mark.slow
def test_a_second_clock_of_a_table_without_names_is_no_axis(tmp_path: Path) -> None:
    codes = np.rint(np.hstack([FORCE * 16384, RATE * 131, MAGNET * 1090])).astype(int)
    content = text(*lines(" ".join(["{:6d}"] * 11), codes, MS + 2, MS + 3))
    _, values, times_s = imported(tmp_path, "a.txt", content)
    assert list(values) == ["Acc", "Gyro", "Mag"]
    np.testing.assert_allclose(values["Mag"], MAGNET, atol=1e-3)
    np.testing.assert_allclose(times_s["Gyro"], T, atol=1e-9)


PACKETS = "// Update Rate: 100.0Hz\nPacketCounter\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z\n"


@pytest.mark.slow
def test_a_counter_with_gaps_gives_the_times_at_the_stated_rate(tmp_path: Path) -> None:
    kept = np.arange(ROWS) % 50 != 7
    number = (np.arange(ROWS) + 65_000) % 65_536
    rows = lines("{}" + "\t{:.6f}" * 6, number[kept], FORCE[kept] * G, np.radians(RATE[kept]))
    guessed, _, times_s = imported(tmp_path, "a.txt", PACKETS + text(*rows))
    assert "ticks = 0.01 # stated by Update Rate: 100.0Hz" in guessed
    np.testing.assert_allclose(times_s["Acc"], T[kept], atol=1e-9)


@pytest.mark.slow
def test_a_counter_that_other_packets_share_is_no_time(tmp_path: Path) -> None:
    number = np.cumsum(np.where(np.arange(ROWS) % 2, 1, 2))
    head = "Packet number,ax (g),ay (g),az (g),gx (deg/s),gy (deg/s),gz (deg/s)"
    guessed, _, _ = imported(tmp_path, "a.csv", text(head, *lines("{}" + SIX, number, FORCE, RATE)))
    assert "column 'Packet number' numbers rows of other kinds, too, and says nothing about time" in guessed


@pytest.mark.slow
def test_a_time_that_counts_the_rows_is_doubted(tmp_path: Path) -> None:
    head = "Timestamp,ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps"
    guessed, _, _ = imported(tmp_path, "a.csv", text(head, *lines("{}" + SIX, np.arange(ROWS), FORCE, RATE)))
    assert "column 'Timestamp' rises by 1 from row to row: it may count the rows" in guessed


def test_dates_as_the_c_library_prints_them(tmp_path: Path) -> None:
    begin = datetime(2021, 12, 22, 21, 9, 46)
    dates = [(begin + timedelta(seconds=at)).strftime("%a %b %d %H:%M:%S %Y") for at in range(200)]
    head = "Time,ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps"
    _, _, times_s = imported(tmp_path, "a.csv", text(head, *lines("{}" + SIX, dates, FORCE[:200], RATE[:200])))
    np.testing.assert_allclose(times_s["Acc"], np.arange(200.0), atol=1e-9)


def test_the_exact_clock_is_preferred_to_rounded_dates(tmp_path: Path) -> None:
    stamps = T + 1.6e9
    stamps[101::100] = stamps[100::100] + 1e-4
    dates = [datetime.fromtimestamp(at).isoformat(sep=" ", timespec="milliseconds") for at in stamps]
    head = "Timestamp,TimeIntervalSince1970,ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps"
    rows = lines("{},{:.6f}" + SIX, dates, stamps, FORCE, RATE)
    guessed, _, times_s = imported(tmp_path, "a.csv", text(head, *rows))
    assert 'column = "TimeIntervalSince1970"' in guessed
    np.testing.assert_allclose(times_s["Acc"], stamps - stamps[0], atol=2e-6)


@pytest.mark.slow
def test_names_in_quotes_within_a_comment(tmp_path: Path) -> None:
    head = '# Data format: "us,RawAccelX,RawAccelY,RawAccelZ,RawGyroX,RawGyroY,RawGyroZ"'
    _, values, times_s = imported(tmp_path, "a.txt", text(head, *lines("{}" + SIX, MS * 1000, FORCE, np.radians(RATE))))
    np.testing.assert_allclose(values["Acc"], FORCE, atol=1e-3)
    np.testing.assert_allclose(values["Gyro"], RATE, atol=0.01)
    np.testing.assert_allclose(times_s["Acc"], T, atol=1e-9)


def test_sentences_of_a_razor_board(tmp_path: Path) -> None:
    codes = np.rint(np.hstack([FORCE * 256, RATE * 14.375])).astype(int)
    rows = [row for each in codes for row in ("#A-R={},{},{}".format(*each[:3]), "#G-R={},{},{}".format(*each[3:]))]
    guessed, values, _ = imported(tmp_path, "a.log", text(*rows))
    assert 'kind = "A-R"' in guessed
    np.testing.assert_allclose(values["Acc"], FORCE, atol=0.01)


@pytest.mark.slow
def test_columns_named_after_the_axis_only_take_the_quantity_of_their_file(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    folder.mkdir()
    head = "Timestamp (us),X Axis (a.u.),Y Axis (a.u.),Z Axis (a.u.)"
    form = "{}" + ",{:.6f}" * 3
    (folder / "Magnetometer.csv").write_text(text(head, *lines(form, MS * 1000, MAGNET)))
    (folder / "Accelerometer.csv").write_text(text(head.replace("a.u.", "g"), *lines(form, MS * 1000, FORCE)))
    (folder / "Temperature.csv").write_text(
        text(
            "Timestamp (us),Temperature (degC)", *lines("{},{:.1f}", np.arange(16) * 1_002_000, 25 + np.arange(16) / 8)
        )
    )
    guessed = guess_map(folder)
    assert (
        'name = "Magnetometer"\nkind = "Magnetometer"\nchip = "unknown"   # ?\nquantity = "magnetic_field"' in guessed
    )
    assert "would be 0.998 rows a second" not in guessed


@pytest.mark.slow
def test_the_step_of_a_gyroscope_at_rest_states_its_unit(tmp_path: Path) -> None:
    rest = walk(ROWS, still=True)
    codes = np.rint(rest.rate_dps * 65.6)
    head = "Time,accl0,accl1,accl2,rot0,rot1,rot2"
    rows = lines("{:.6f}" + ",{:.9g}" * 6, T, np.rint(rest.force_g * 4096) / 4096, np.radians(codes / 65.6))
    guessed, values, _ = imported(tmp_path, "a.csv", text(head, *rows))
    assert 'unit = "rad/s" # ? the step of its values is 1/65.6 dps' in guessed
    np.testing.assert_allclose(values["Gyro"], codes / 65.6, atol=1e-4)


@pytest.mark.slow
def test_a_clipped_range_of_250_dps_is_not_taken_for_500(tmp_path: Path) -> None:
    codes = np.clip(np.rint(RATE * 8 * 131), -32767, 32767)
    head = "t,Ax,Ay,Az,Gx,Gy,Gz"
    imported(tmp_path, "a.csv", text(head, *lines("{:.3f}" + ",{:.9f}" * 6, T, FORCE, codes / 131)))
    with open_log(tmp_path / "run.h5") as log:
        assert (log["Gyro"].range, log["Gyro"].sensitivity, log["Gyro"].count_bits) == (250.0, 131.0, 16)


@pytest.mark.slow
def test_steps_are_recognised_behind_three_digits(tmp_path: Path) -> None:
    rest = walk(ROWS, still=True)
    codes = np.rint(rest.rate_dps * 131)
    head = "t,ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps"
    imported(tmp_path, "a.csv", text(head, *lines("{:.2f}" + ",{:.3f}" * 6, T, rest.force_g, codes / 131)))
    with open_log(tmp_path / "run.h5") as log:
        assert log["Gyro"].sensitivity == pytest.approx(131.0, rel=1e-4)
        assert not any("codes" in sentence for sentence in report_of(log).quirks)


@pytest.mark.slow
@pytest.mark.parametrize("cell", some(["IMU initialize", "0.010.02"], 1))
def test_a_line_with_text_in_the_place_of_a_number_is_left_out(cell: str, tmp_path: Path) -> None:
    rows = lines("{:.2f}" + SIX, T, FORCE, RATE)
    rows[700] = f"7.00,0.01,{cell},0.99,1.0,2.0,3.0"
    _, values, _ = imported(tmp_path, "a.csv", text("t,ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps", *rows))
    assert (len(values["Acc"]), len(values["Gyro"])) == (ROWS - 1, ROWS)


@pytest.mark.slow
@pytest.mark.parametrize(("per_gauss", "range_"), some([(6842.0, 4.0), (1090.0, 1.3), (666.7, 48.0)], 1))
def test_the_scale_of_a_magnetometer_follows_from_the_field(per_gauss: float, range_: float, tmp_path: Path) -> None:
    codes = np.rint(np.hstack([FORCE * 16384, MAGNET * per_gauss])).astype(int)
    guessed, _, _ = imported(tmp_path, "a.csv", text("ms,ax,ay,az,mx,my,mz", *lines("{}" + ",{}" * 6, MS, codes)))
    assert f"range = {range_:g} # ? sensitivity = {per_gauss:g}" in guessed
