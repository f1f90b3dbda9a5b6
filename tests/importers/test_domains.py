"""Recordings of other domains, from motion capture to seismology: each is imported by its guessed map with the true
values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from imuarray.importers.guess import guess_map
from imuarray.importers.table import import_table
from imuarray.log import open_log
from tests.importers.recordings import G, walk
from tests.selection import some

ROWS = 1500
WALK = walk(ROWS)
T, FORCE, RATE = WALK.time_s, WALK.force_g, WALK.rate_dps
SI = np.hstack([FORCE * G, np.radians(RATE)])


def written(path: Path, head: Sequence[str], rows: Iterable[str]) -> Path:
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
    return path


def cells(values: np.ndarray, mark: str = ",", spelt: str = "{:.6f}") -> list[str]:
    return [mark.join(spelt.format(value) for value in row) for row in values.tolist()]


def motion_capture(folder: Path) -> Path:
    """A Vicon export: the rate in a line, groups above the names, units below them, millimetres."""
    head = [
        "Devices",
        "100",
        ",,IMU1 - Acceleration,,,IMU1 - Angular velocity,,",
        "Frame,Sub Frame,ACCX,ACCY,ACCZ,GYROX,GYROY,GYROZ",
        ",,mm/s²,mm/s²,mm/s²,deg/s,deg/s,deg/s",
    ]
    rows = cells(np.hstack([FORCE * G * 1000, RATE]), spelt="{:.4f}")
    return written(folder / "vicon.csv", head, (f"{number},0,{row}" for number, row in enumerate(rows, start=1)))


def analog_of_cameras(folder: Path) -> Path:
    """A Qualisys export: a preamble of names and values, tabulators."""
    head = ["NO_OF_FRAMES\t1500", "FREQUENCY\t100", "TIME_STAMP\t2024-05-03, 14:30:00", "DATA_INCLUDED\tANALOG", ""]
    head.append("Frame\tTime\tAccX\tAccY\tAccZ\tGyrX\tGyrY\tGyrZ")
    rows = cells(np.hstack([FORCE, RATE]), "\t")
    return written(folder / "qtm.tsv", head, (f"{n + 1}\t{T[n]:.5f}\t{row}" for n, row in enumerate(rows)))


def blackbox(folder: Path) -> Path:
    """A drone's flight recorder: codes of gyroscope and accelerometer between controller terms and motors."""
    names = ["loopIteration", "time", "axisP[0]", "axisP[1]", "axisP[2]", "gyroADC[0]", "gyroADC[1]", "gyroADC[2]"]
    names += ["accSmooth[0]", "accSmooth[1]", "accSmooth[2]", "motor[0]", "motor[1]", "motor[2]", "motor[3]"]
    rng = np.random.default_rng(1)
    others, motors = rng.integers(-40, 40, (ROWS, 3)), rng.integers(300, 900, (ROWS, 4))
    codes = np.rint(np.hstack([others, RATE * 16.4, FORCE * 2048, motors])).astype(int)
    head = ['"Product","Blackbox flight data recorder"', '"acc_1G","2048"', '"looptime","312"']
    head.append(",".join(f'"{name}"' for name in names))
    rows = (f"{32 * n},{52_000_000 + round(T[n] * 1e6)},{row}" for n, row in enumerate(cells(codes, spelt="{}")))
    return written(folder / "blackbox.csv", head, rows)


def gait(folder: Path) -> Path:
    """A sensor on a horse (Xsens MT Manager): remarks, a counter that wraps, empty columns of time."""
    head = ["// Start Time: Unknown", "// Update Rate: 100.0Hz", "// Option Flags: AHS Disabled"]
    head.append("PacketCounter\tSampleTimeFine\tUTC_Nano\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z")
    rows = (f"{(65_000 + n) % 65_536:05d}\t\t\t{row}" for n, row in enumerate(cells(SI, "\t")))
    return written(folder / "withers.txt", head, rows)


def seismometer(folder: Path) -> Path:
    """K-NET's strong motion in columns, east, north and up in gal, below lines that end in numbers."""
    head = ["Origin Time       2024/01/01 16:10:00", "Station Code      ISK005", "Station Lat.      37.33"]
    head += ["Sampling Freq(Hz) 100Hz", "Duration Time(s)  15", "   EW(gal)   NS(gal)   UD(gal)"]
    return written(folder / "knet.txt", head, cells(FORCE * G * 100, "  ", "{:9.4f}"))


def wearable(folder: Path) -> Path:
    """A wristband: milliseconds since 1970, semicolons, the name of the device and the heart's rate."""
    head = ["timestamp;device_id;heart_rate;accel_x;accel_y;accel_z;gyro_x;gyro_y;gyro_z"]
    rows = enumerate(cells(SI, ";"))
    lines = (f"{1_714_746_600_000 + round(T[n] * 1000)};A1:B2:C3;{60 + n // 100};{row}" for n, row in rows)
    return written(folder / "wrist.csv", head, lines)


def autopilot(folder: Path) -> Path:
    """sensor_combined of a PX4 log (ulog2csv): elements of arrays, times of integration, states of calibration."""
    head = ["timestamp", *(f"gyro_rad[{axis}]" for axis in range(3)), "gyro_integral_dt"]
    head += ["accelerometer_timestamp_relative", *(f"accelerometer_m_s2[{axis}]" for axis in range(3))]
    head += ["accelerometer_integral_dt", "accelerometer_clipping", "accel_calibration_count"]
    pairs = zip(cells(SI[:, :3]), cells(SI[:, 3:], spelt="{:.8f}"), strict=True)
    rows = (
        f"{112_000_000 + round(T[n] * 1e6)},{rate},5000,0,{force},5000,0,3" for n, (force, rate) in enumerate(pairs)
    )
    return written(folder / "log_0_sensor_combined_0.csv", [",".join(head)], rows)


def prints(folder: Path) -> Path:
    """Output of an Arduino sketch: labels, a stamp before the first value, bars."""
    labels = ("aX", "aY", "aZ", "gX", "gY", "gZ")
    rows = (
        f"t={round(T[n] * 1000)} "
        + " | ".join(f"{name} = {value:.4f}" for name, value in zip(labels, row, strict=True))
        for n, row in enumerate(np.hstack([FORCE, RATE]).tolist())
    )
    return written(folder / "arduino.txt", ["MPU6050 test", "Calibrating... done", ""], rows)


def timetables(folder: Path) -> Path:
    """MATLAB's struct with the contents of two timetables: a barometer has another rate."""
    pressure = 101_325 + np.random.default_rng(2).normal(0, 5, (ROWS // 10, 1))
    imu = {"Time": T[:, None], "Acc": SI[:, :3], "Gyro": SI[:, 3:]}
    savemat(folder / "run.mat", {"data": {"imu": imu, "baro": {"Time": T[::10, None], "Pressure": pressure}}})
    return folder / "run.mat"


def matlab_73(folder: Path) -> Path:
    """The same recording in a file of version 7.3, with a vector for each axis."""
    with h5py.File(folder / "run.mat", "w", userblock_size=512) as file:
        file["imu/Time"] = T[None]
        for axis, name in enumerate("XYZ"):
            file[f"imu/Acc{name}"], file[f"imu/Gyro{name}"] = FORCE[None, :, axis] * G, RATE[None, :, axis]
    content = (folder / "run.mat").read_bytes()
    title = b"MATLAB 7.3 MAT-file, Platform: GLNXA64"
    (folder / "run.mat").write_bytes(title + content[len(title) :])
    return folder / "run.mat"


RIGS = [
    motion_capture, analog_of_cameras, blackbox, gait, seismometer, wearable, autopilot, prints, timetables, matlab_73,
]  # fmt: skip


@pytest.mark.parametrize("write", some(RIGS, 1))
def test_the_guessed_map_gives_the_true_values(write: Callable[[Path], Path], tmp_path: Path) -> None:
    source, map_path = write(tmp_path), tmp_path / "map.toml"
    map_path.write_text(guess_map(source))
    import_table(source, map_path, tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        triads = [sensor for sensor in log.sensors.values() if sensor.is_triad]
        assert [sensor.name for sensor in triads] == (["Acc"] if write is seismometer else ["Acc", "Gyro"])
        for sensor in triads:
            assert np.asarray(sensor.time[:] - int(sensor.time[0])) * 1e-9 == pytest.approx(T, abs=1e-6)
            truth, off = (FORCE, 3e-4) if sensor.name == "Acc" else (RATE, 0.04)
            if write is blackbox and sensor.name == "Gyro":
                assert sensor.sensitivity == pytest.approx(16.4, rel=2e-3)  # 131 / 8 fits the rotations equally well
                off += 2e-3 * float(np.abs(RATE).max())
            assert np.asarray(sensor.counts[:]) / sensor.sensitivity == pytest.approx(truth, abs=off)
        assert ("Barometer" in log.sensors) == (write is timetables)
        if write is timetables:
            assert np.asarray(log["Barometer"].time[:] - int(log["Acc"].time[0])) * 1e-9 == pytest.approx(T[::10])


@pytest.mark.slow
def test_units_of_millimetres_and_gal(tmp_path: Path) -> None:
    """1 gal is 1 cm/s2 (Galileo); both spellings of both units give the same counts."""
    counts = []
    for unit, size in (("mm/s2", 1000.0), ("mm/s^2", 1000.0), ("gal", 100.0), ("cm/s2", 100.0)):
        source = written(tmp_path / "run.csv", ["x,y,z"], cells(SI[:, :3] * size, spelt="{:.4f}"))
        text = 'time = { rate_hz = 100 }\nsensor = [{ name = "A", chip = "a", quantity = "specific_force", columns = '
        text += f'["x", "y", "z"], unit = "{unit}", values = "physical", range = 4, sensitivity = 8000.0 }}]\n'
        (tmp_path / "map.toml").write_text(
            text.replace("range = 4", f"range = {4 * G * size}").replace("8000.0", str(8000 / G / size))
        )
        import_table(source, tmp_path / "map.toml", tmp_path / "run.h5", force=True)
        with open_log(tmp_path / "run.h5") as log:
            counts.append(np.asarray(log["A"].counts[:]))
            assert log["A"].sensitivity == pytest.approx(8000)
    assert counts[0] == pytest.approx(8000 * FORCE, abs=1)
    assert all((each == counts[0]).all() for each in counts[1:2]) and np.abs(counts[2] - counts[0]).max() <= 1
