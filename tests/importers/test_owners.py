"""Recordings in the formats of various programs: the guessed map imports each unchanged, with the true values. The
written truth is compared in g, dps, gauss and s, independent of the spelling in the file.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from imuarray.cli import main
from imuarray.errors import SourceError
from imuarray.importers.guess import guess_map
from imuarray.importers.plausibility import report_of
from imuarray.importers.table import import_table
from imuarray.log import Log, open_log
from imuarray.log.format import LOST_BEFORE
from tests.importers.recordings import G, walk
from tests.importers.text_tables import lines, text

ROWS = 1600
WALK = walk(ROWS)
T, FORCE, RATE = WALK.time_s, WALK.force_g, WALK.rate_dps
MAGNET = np.array([0.2, 0.05, -0.43]) + np.random.default_rng(3).normal(0, 2e-3, (ROWS, 3))


def turned_over() -> np.ndarray:
    """(n, 3) g: the quiet first half, then gravity along many directions, with biases of up to 50 mg."""
    angle = np.where(T < 8, 0.0, 2 * np.pi * (T - 8) / 8)
    force = np.stack([np.sin(angle) * np.sin(3 * angle), np.sin(angle) * np.cos(3 * angle), np.cos(angle)], axis=1)
    return force + np.array([0.02, -0.03, 0.05]) + np.random.default_rng(4).normal(0, 2e-3, force.shape)


def table(header: str, form: str, *columns: Sequence[object] | np.ndarray) -> str:
    return text(header, *lines(form, *columns))


def dated(times_s: np.ndarray, begin: datetime) -> list[str]:
    return [(begin + timedelta(seconds=float(at))).isoformat(timespec="milliseconds") for at in times_s]


SI = np.hstack([FORCE * G, np.radians(RATE)])
PLAIN = "{:.3f}" + ",{:.6f}" * 6
CODES = np.rint(np.hstack([FORCE * 16384, RATE * 131])).astype(int)
WHOLE = "{}" + ",{}" * 6
US = np.rint(T * 1e6).astype(np.int64)


class Case(NamedTuple):
    """A file's text (or several files of a folder), lines that the map must have, sentences of its comments, and the
    greatest error of values (g, dps).
    """

    files: str | dict[str, str]
    map_lines: tuple[str, ...] = ()
    said: tuple[str, ...] = ()
    error: tuple[float, float] = (2e-4, 6e-3)
    force: np.ndarray = FORCE
    name: str = "data.csv"


AXES = "ax,ay,az,gx,gy,gz"
CASES: dict[str, Case] = {
    "micros() that overflows after 71.6 minutes": Case(
        table(f"us,{AXES}", WHOLE, (US + 2**32 - 8_000_000) % 2**32, CODES), ('unit = "us"', "wraps_at = 4294967296")
    ),
    "a signed counter of 32 bits that overflows": Case(
        table(f"time_us,{AXES}", WHOLE, (US + 2**31 - 8_000_000 + 2**31) % 2**32 - 2**31, CODES),
        ('unit = "us"', "wraps_at = 4294967296"),
    ),
    "the end of daylight saving time": Case(
        table(
            f"datetime,{AXES}", "{}" + ",{:.6f}" * 6, dated(T - 3600 * (T >= 10), datetime(2023, 10, 29, 2, 59, 50)), SI
        ),
        ('unit = "iso8601"', "restarts = true"),
        ("# ~ the times went back 1 time, by 3599.99 s", "# ? the times go back"),
    ),
    "a leap second": Case(
        table(
            f"datetime,{AXES}",
            "{}" + ",{:.6f}" * 6,
            [
                f"2016-12-31T23:59:{50 + at:06.3f}Z" if at < 11 else f"2017-01-01T00:00:{at - 11:06.3f}Z"
                for at in np.round(T, 3)
            ],
            SI,
        ),
        ("restarts = true",),
        ("by 0.99 s",),
    ),
    "a recorder that starts again": Case(
        table(f"ms,{AXES}", WHOLE, np.where(T < 9, 1e3 * T + 70_000, 1e3 * (T - 9)).round().astype(int), CODES),
        ("restarts = true",),
    ),
    "ms in a column that says s": Case(
        table("time (s),ax (g),ay (g),az (g),gx (dps),gy (dps),gz (dps)", PLAIN, T * 1e3, FORCE, RATE),
        ('unit = "ms"   # ?',),
        ("# ? column 'time (s)' says s, which would be 0.1 rows a second; ms is assumed",),
    ),
    "Movella DOT, whose SampleTimeFine counts us": Case(
        table(
            "PacketCounter,SampleTimeFine,FreeAcc_X,FreeAcc_Y,FreeAcc_Z,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z",
            "{},{}" + ",{:.6f}" * 9, np.arange(ROWS), (US + 2**32 - 5_000_000) % 2**32,
            0 * FORCE + 0.01, FORCE * G, RATE,
        ),
        ('unit = "us"', "wraps_at = 4294967296"),
    ),
    "Xsens MTw, whose SampleTimeFine counts 100 us": Case(
        table(
            "PacketCounter\tSampleTimeFine\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z",
            "{}\t{}" + "\t{:.6f}" * 6, np.arange(ROWS), (US // 100 + 2**32 - 5_000) % 2**32, SI,
        ),
        ("ticks = 100   # of Xsens: a clock of 10 kHz",),
    ),
    "Physics Toolbox: forces in g with decimal commas": Case(
        table(
            "time;gFx;gFy;gFz;TgF;wx;wy;wz;Bx;By;Bz", "{:.4f}" + ";{:.6f}" * 10,
            T, FORCE, np.linalg.norm(FORCE, axis=1), np.radians(RATE), MAGNET * 100,
        ).replace(".", ","),
        ('columns = ["gFx", "gFy", "gFz"]', 'unit = "rad/s"'),
    ),
    "whole numbers in mg and mdps": Case(
        table(f"t_ms,{AXES}", WHOLE, T * 1e3, np.rint(np.hstack([1e3 * turned_over(), 4e4 * RATE])).astype(int)),
        ('unit = "mg"   # ? from gravity in all directions', 'unit = "mdps"'),
        error=(6e-4, 40 * 80.0),
        force=turned_over(),
    ),
    "estimates of the gyroscope's bias beside it": Case(
        table(
            "timestamp(ms),accX,accY,accZ,gyroUncalX,gyroUncalY,gyroUncalZ,gyroBiasX,gyroBiasY,gyroBiasZ",
            "{:.1f}" + ",{:.6f}" * 9, T * 1e3, SI, 0 * FORCE + [0.0087, -0.0052, 0.0035],
        ),
        (),
        ("# ? left out: estimates of biases, according to their names: gyroBiasX",),
    ),
    "Android's numbers of sensor types": Case(
        table(
            "event.timestamp,event.sensor.type,x,y,z", "{},{}" + ",{:.6f}" * 3,
            np.repeat(US * 1000 + 987654321012345, 3) + np.tile([0, 500_000, 700_000], ROWS), np.tile([1, 4, 5], ROWS),
            np.stack([SI[:, :3], SI[:, 3:], 0 * FORCE + 88], axis=1).reshape(-1, 3),
        ),
        ('kind = "1"', 'kind = "4"'),
        ("# ? left out: rows of kind '5', whose name states no quantity",),
    ),
    "text of a board that starts, and lines with a label": Case(
        text("rst:0x1 (POWERON)", "Initializing I2C devices...", "MPU6050 connection successful",
             *lines("a/g:" + "\t{}" * 6, CODES)),
        ("columns = [1, 2, 3]", "columns = [4, 5, 6]"),
    ),
    "values with labels, for a serial plotter": Case(
        text("Adafruit MPU6050 test!", "", *lines(
            "t:{}" + "".join(f"\t{name}:{{:.5f}}" for name in AXES.split(",")), (T * 1e3).astype(int), FORCE, RATE)),
        ("labels = true", 'kind = "t,ax,ay,az,gx,gy,gz"'),
    ),
    "lines of Adafruit's example, with units": Case(
        text("MPU6050 Found!", "", *lines(
            "Acceleration X: {:.3f}, Y: {:.3f}, Z: {:.3f} m/s^2\nRotation X: {:.4f}, Y: {:.4f}, Z: {:.4f} rad/s\n"
            "Temperature: 25.30 degC\n", SI)),
        ("labels = true", 'kind = "Acceleration X,Y,Z [m/s^2]"', 'kind = "Rotation X,Y,Z [rad/s]"'),
    ),
    "stamps of the Arduino IDE, over midnight": Case(
        text(*lines("{} -> " + ",".join(["{:.5f}"] * 6),
                    [at[11:] for at in dated(T, datetime(2024, 1, 1, 23, 59, 50))], FORCE, RATE)),
        ('unit = "%H:%M:%S.%f"',),
    ),
    "VectorNav's sentences with checksums": Case(
        text("$VNRRG,01,VN-100*5C", *lines(
            "$VNYMR,+010.0,-000.1,+000.2" + ",{:+08.4f}" * 3 + ",{:+08.5f}" * 3 + ",{:+010.6f}" * 3 + "*6A",
            MAGNET, SI)),
        ('kind = "$VNYMR"', "columns = [7, 8, 9]", "columns = [10, 11, 12]"),
    ),
    "Android's events, of several lengths": Case(
        text("timestamp_ns,sensor,accuracy,v0,v1,v2,v3,v4,v5", *lines(
            "{},android.sensor.accelerometer,3,{:.6f},{:.6f},{:.6f}\n{},android.sensor.gyroscope,3,{:.6f},{:.6f},{:.6f}\n"
            "{},android.sensor.gyroscope_uncalibrated,3,{:.6f},{:.6f},{:.6f},0.01,0.02,-0.01",
            US * 1000 + 10**15, SI[:, :3], US * 1000 + 10**15 + 1000, SI[:, 3:] + 0.1,
            US * 1000 + 10**15 + 2000, SI[:, 3:])),
        ('kind = "android.sensor.accelerometer"', 'kind = "android.sensor.gyroscope_uncalibrated"'),
        ("# ? left out: android.sensor.gyroscope: the same chip's uncalibrated readings are kept",),
    ),
    "Shimmer: three rows above the values": Case(
        text('"sep=\t"', "\t".join(f"Shimmer_8A1C_{name}" for name in (
            "Timestamp_Unix", "Accel_LN_X", "Accel_LN_Y", "Accel_LN_Z", "Gyro_X", "Gyro_Y", "Gyro_Z")),
            "\t".join(["CAL"] * 7), "\t".join(["ms"] + ["m/(s^2)"] * 3 + ["deg/s"] * 3),
            *lines("{:.3f}" + "\t{:.6f}" * 6, 1.7e12 + T * 1e3, FORCE * G, RATE)),
        ("skip_rows = 1", 'unit = "m/s2"', 'unit = "dps"'),
    ),
    "Sensor Logger: a folder with copies that software computed": Case(
        {f"{name}.csv": table("time,seconds_elapsed,z,y,x", "{},{:.6f},{:.6f},{:.6f},{:.6f}",
                              US * 1000 + 17 * 10**17, T, values[:, ::-1])
         for name, values in {
             "TotalAcceleration": FORCE * G, "Gravity": FORCE * G + 0.01,
             "Accelerometer": np.random.default_rng(5).normal(0, 0.02, (ROWS, 3)), "Gyroscope": np.radians(RATE) + 0.1,
             "GyroscopeUncalibrated": np.radians(RATE)}.items()},
        ('kind = "TotalAcceleration"', 'kind = "GyroscopeUncalibrated"'),
        ("# ? left out: Gravity: computed by software", "# ? left out: Accelerometer: no gravity in it"),
        name="recording",
    ),
    "GoPro: two columns that have numbers for names": Case(
        table('cts,"Accelerometer [m/s2]",1,2,"Gyroscope [rad/s]",1_1,2_1', "{:.3f}" + ",{:.6f}" * 6, T * 1e3, SI)
        .replace("1_1,2_1", "gy,gz").replace('"Gyroscope [rad/s]"', '"gx [rad/s]"')
        .replace(",gy,gz", ",gy [rad/s],gz [rad/s]"),
        ('columns = ["Accelerometer [m/s2]", "1", "2"]',),
        ("# ? columns that are called 1 and 2 do not say which axes they hold",),
    ),
}  # fmt: skip


def imported(files: str | dict[str, str], folder: Path, name: str) -> tuple[str, Path]:
    """The guessed map, and the log that is imported with it."""
    source = folder / name
    if isinstance(files, str):
        source.write_text(files, encoding="utf-8")
    else:
        for path, content in files.items():
            (source / path).parent.mkdir(parents=True, exist_ok=True)
            (source / path).write_text(content, encoding="utf-8")
    guessed = guess_map(source)
    (folder / "map.toml").write_text(guessed, encoding="utf-8")
    import_table(source, folder / "map.toml", folder / "run.h5")
    return guessed, folder / "run.h5"


def check_truth(log: Log, force: np.ndarray, error: tuple[float, float]) -> None:
    """Check that each inertial sensor has the true values at the true times, and that there is one sensor of each
    quantity.
    """
    wanted = {"specific_force": (force, error[0]), "angular_rate": (RATE, error[1])}
    for quantity, (truth, most) in wanted.items():
        (sensor,) = log.of(quantity)  # type: ignore[arg-type]
        times_s = (np.asarray(sensor.time[:]) - int(sensor.time[0])) * 1e-9
        np.testing.assert_allclose(times_s, T, atol=2e-3)
        np.testing.assert_allclose(np.asarray(sensor.counts[:]) / sensor.sensitivity, truth, atol=most)


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=name, marks=() if not at else pytest.mark.slow if at % 2 else pytest.mark.campaign)
        for at, (name, case) in enumerate(CASES.items())
    ],
)
def test_the_guessed_map_gives_the_true_values(case: Case, tmp_path: Path) -> None:
    guessed, path = imported(case.files, tmp_path, case.name)
    for line in case.map_lines:
        assert line in guessed, guessed
    comments = " ".join(guessed.replace("\n#   ", " ").split())
    for sentence in case.said:
        assert sentence in comments, guessed
    with open_log(path) as log:
        if case.error[1] < 1:
            check_truth(log, case.force, case.error)
        else:
            np.testing.assert_allclose(log["Acc"].counts[:] / log["Acc"].sensitivity, case.force, atol=case.error[0])
        assert not [message for message in report_of(log).doubts if message.startswith("Acc")]


@pytest.mark.slow
def test_a_zip_file_of_a_phone_is_read_like_its_folder(tmp_path: Path) -> None:
    """An export of phyphox: a text for each sensor, and texts about the phone in a folder."""
    with zipfile.ZipFile(tmp_path / "phone.zip", "w") as archive:
        for name, unit, values in (("Accelerometer", "m/s^2", SI[:, :3]), ("Gyroscope", "rad/s", SI[:, 3:])):
            header = ",".join(f'"{axis} ({unit})"' for axis in "XYZ")
            archive.writestr(f"{name}.csv", table('"Time (s)",' + header, "{:.9E}" + ",{:.9E}" * 3, T, values))
        archive.writestr("meta/device.csv", '"property","value"\n"version","1.1"\n')
    guessed = guess_map(tmp_path / "phone.zip")
    (tmp_path / "map.toml").write_text(guessed, encoding="utf-8")
    summary = import_table(tmp_path / "phone.zip", tmp_path / "map.toml", tmp_path / "run.h5")
    assert summary.sensors == ("Accelerometer", "Gyroscope")
    with open_log(tmp_path / "run.h5") as log:
        check_truth(log, FORCE, (2e-4, 6e-3))


def test_a_damaged_zip_file_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "phone.zip", "w") as archive:
        archive.writestr("Accelerometer.csv", table("t,x,y,z", "{:.3f}" + ",{:.6f}" * 3, T, FORCE))
    data = bytearray((tmp_path / "phone.zip").read_bytes())
    data[100:140] = bytes(40)
    (tmp_path / "phone.zip").write_bytes(bytes(data))
    with pytest.raises(SourceError, match=r"phone\.zip: cannot be unpacked: Bad CRC-32"):
        guess_map(tmp_path / "phone.zip")


@pytest.mark.slow
def test_garbage_like_a_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    """A serial port gives random bytes while a board starts, FF FE among them."""
    (tmp_path / "data.csv").write_bytes(b"\xff\xfe\x80boot\n" + table(f"t,{AXES}", PLAIN, T, FORCE, RATE).encode())
    assert 'columns = ["ax", "ay", "az"]' in guess_map(tmp_path / "data.csv")


@pytest.mark.slow
def test_a_row_after_a_backward_clock_step_is_flagged(tmp_path: Path) -> None:
    _, path = imported(CASES["a recorder that starts again"].files, tmp_path, "data.csv")
    with open_log(path) as log:
        for sensor in log.sensors.values():
            assert np.flatnonzero(np.asarray(sensor.status[:]) & LOST_BEFORE).tolist() == [900]


@pytest.mark.parametrize(
    ("head", "packer"), [(b"\x28\xb5\x2f\xfd", "zstd"), (b"BZh91AY", "bzip2"), (b"\xfd7zXZ\0", "xz")]
)
def test_an_unsupported_compression_is_named(head: bytes, packer: str, tmp_path: Path) -> None:
    (tmp_path / "run.db3.zstd").write_bytes(head + bytes(range(256)) * 8)
    with pytest.raises(SourceError, match=rf"run\.db3\.zstd: compressed by {packer}; decompress it first"):
        guess_map(tmp_path / "run.db3.zstd")


def test_the_command_prints_the_number_of_doubts_of_a_guess(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "data.csv").write_text(table("time (s),ax (g),ay (g),az (g)", "{:.3f}" + ",{:.6f}" * 3, T * 1e3, FORCE))
    assert main(["import", str(tmp_path / "data.csv"), "--guess", "-o", str(tmp_path / "map.toml")]) == 0
    assert "map.toml, with 1 doubt at its top; read its comments" in capsys.readouterr().err
