"""Layouts of public data sets and loggers: the guessed map imports each unchanged, with the true values. The recordings
are in closed form (`tests.importers.recordings`); the truth is compared in g, dps and s.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imuarray.cli import main
from imuarray.log import open_log
from tests.importers.recordings import G, walk
from tests.importers.text_tables import lines, text

ROWS = 1200
WALK = walk(ROWS)
T, FORCE, RATE = WALK.time_s, WALK.force_g, WALK.rate_dps
SI = np.hstack([FORCE * G, np.radians(RATE)])
CODES = np.rint(np.hstack([FORCE * 4096, RATE * 16.384])).astype(int)
US = np.rint(T * 1e6).astype(np.int64)
QUATERNION = np.tile([0.5, -0.5, 0.5, 0.5], (ROWS, 1)) + 1e-5 * np.arange(ROWS)[:, None] / ROWS


def kitti(folder: Path) -> Path:
    """Geiger et al. 2013: thirty values in a file for each row."""
    (folder / "oxts/data").mkdir(parents=True)
    stamps = [f"2011-09-26 13:02:{25 + at:012.9f}" for at in T]
    (folder / "oxts/timestamps.txt").write_text(text(*stamps))
    for number, row in enumerate(SI.tolist()):
        values = [49.0, 8.4, 112.0, 0.02, 0, -1.9, 3, -5, 6, 0, 0, *row[:3], *row[:3], *row[3:], *row[3:], 0.1, 0.02]
        values += [4, 8, 6, 6, 6]
        (folder / f"oxts/data/{number:010d}.txt").write_text(" ".join(map(repr, values)) + "\n")
    return folder / "oxts"


def json_lines(folder: Path) -> Path:
    """Stored MQTT messages, with a message of another kind and a line that a power cut truncated."""
    rows = [
        json.dumps({"topic": "imu/1", "ts": 1_690_000_000 + round(at, 3), "payload": {"acc": row[:3], "gyr": row[3:]}})
        for at, row in zip(T.tolist(), SI.tolist(), strict=True)
    ]
    rows.insert(600, '{"event": "battery", "volts": 3.7}')
    (folder / "log.jsonl").write_text(text(*rows) + '{"topic": "imu/1", "ts": 16900')
    return folder / "log.jsonl"


def json_lists(folder: Path) -> Path:
    """Messages with lists of readings of several sensors (Sensor Logger's push over HTTP)."""
    rows = []
    for start in range(0, ROWS, 50):
        readings = [
            {"name": name, "time": int(US[at]) * 1000 + 10**18, "values": dict(zip("xyz", SI[at, place], strict=True))}
            for at in range(start, start + 50)
            for name, place in (("accelerometer", slice(0, 3)), ("gyroscope", slice(3, 6)))
        ]
        rows.append(json.dumps({"messageId": start, "payload": readings}))
    (folder / "push.json").write_text(text(*rows))
    return folder / "push.json"


def json_document(folder: Path) -> Path:
    """A document with a list for each stream (gopro-telemetry)."""

    def stream(values: np.ndarray, units: str) -> dict[str, object]:
        samples = [{"value": row, "cts": 1e3 * at} for row, at in zip(values.tolist(), T.tolist(), strict=True)]
        return {"samples": samples, "units": units}

    streams = {"ACCL": stream(SI[:, :3], "m/s2"), "GYRO": stream(SI[:, 3:], "rad/s")}
    (folder / "GH010001.json").write_text(json.dumps({"1": {"streams": streams}, "frames/second": 29.97}))
    return folder / "GH010001.json"


def influx(folder: Path) -> Path:
    rows = lines(
        "imu,host=pi ax={:.6f},ay={:.6f},az={:.6f},gx={:.7f},gy={:.7f},gz={:.7f},n=1i {}",
        SI,
        US * 1000 + 1_690_000_000_000_000_000,
    )
    rows.insert(5, "cpu,host=pi load=0.31 1690000000050000001")
    (folder / "imu.lp").write_text(text(*rows))
    return folder / "imu.lp"


def can_frames(folder: Path) -> Path:
    """candump -L: little-endian words, a counter after them, and a frame of another device."""
    rows = []
    for at, row in zip(T.tolist(), CODES.tolist(), strict=True):
        for place, words in ((0, row[:3]), (1, row[3:])):
            data = struct.pack("<hhh", *words).hex().upper()
            rows.append(f"({1_621_592_382 + at + 1e-4 * place:.6f}) can0 {161 + place:03X}#{data}0000")
        rows.append(f"({1_621_592_382 + at + 5e-4:.6f}) can0 18FEF100#FFFF")
    (folder / "candump.log").write_text(text(*rows))
    return folder / "candump.log"


def novatel(folder: Path) -> Path:
    """RAWIMUS of a NovAtel receiver: increments, z first, y inverted."""
    accel = FORCE / 100 * G * 2**15 / 0.05
    gyro = np.radians(RATE) / 100 / (0.1 / 3600 / 256)
    shown = np.rint(np.stack([accel[:, 2], -accel[:, 1], accel[:, 0], gyro[:, 2], -gyro[:, 1], gyro[:, 0]], axis=1))
    form = "%RAWIMUSA,1105,{:.3f};1105,{:.9f},00000077" + ",{:.0f}" * 6 + "*5aa97065"
    (folder / "raw.log").write_text(text(*lines(form, 425_384 + T, 425_384 + T, shown)))
    return folder / "raw.log"


def ardupilot(folder: Path) -> Path:
    """A text log with two inertial units in one kind of rows, numbered by column I."""
    rows = ["FMT, 172, 43, IMU, QBffffff, TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"]
    form = "\n".join(f"IMU, {{}}, {number}" + ", {:.7g}" * 6 for number in (0, 1))
    other = SI + np.array([0.1, 0, 0, 0.05, 0, 0])
    rows += lines(form, US, SI[:, 3:], SI[:, :3], US, other[:, 3:], other[:, :3])
    (folder / "1.log").write_text(text(*rows))
    return folder / "1.log"


def wide(folder: Path) -> Path:
    """PAMAP2: labels, a heart rate in some rows, a temperature, two accelerometers, gyroscope, magnetometer and a
    quaternion; no names.
    """
    magnet = np.tile([20.0, 4.0, -43.0], (ROWS, 1)) + np.random.default_rng(3).normal(0, 0.2, (ROWS, 3))
    values = np.column_stack(
        [T + 8, np.where(T < 4, 0, 1), np.full(ROWS, 30.4), SI[:, :3], SI + 0.01, magnet, QUATERNION]
    )
    rows = [" ".join(f"{value:.7g}" for value in row) for row in values]
    (folder / "subject101.dat").write_text(text(*(row.replace(" ", " NaN ", 1) for row in rows)))
    return folder / "subject101.dat"


def nameless_files(folder: Path) -> Path:
    """RIDI and ADVIO: a file for each sensor without a header; the file of the pose is not a sensor."""
    (folder / "raw").mkdir()
    head = "# Created at Fri Mar 17 14:56:29 EDT 2017"
    nanos = US * 1000 + 86_000_123_456_789
    for name, values in (("acce", SI[:, :3]), ("gyro", SI[:, 3:]), ("orientation", QUATERNION)):
        form = "{}" + " {:.6f}" * values.shape[1]
        (folder / f"raw/{name}.txt").write_text(text(head, *lines(form, nanos, values)))
    return folder / "raw"


def torn_serial(folder: Path) -> Path:
    """A terminal's log in which two lines are merged."""
    rows = lines("{}" + ",{}" * 6, np.rint(T * 1e3).astype(int) + 400, CODES)
    rows[700:702] = ["7400,12" + rows[701]]
    (folder / "putty.log").write_text(text("rst:0x1 (POWERON_RESET),boot:0x13", *rows))
    return folder / "putty.log"


def kinds_behind_the_time(folder: Path) -> Path:
    """A commented header, and words that name the sensor in the second column (RealSense T265)."""
    form = "{:.3f},gyro,{:.6f},{:.6f},{:.6f}\n{:.3f},accel,{:.6f},{:.6f},{:.6f}"
    rows = lines(form, 1e12 + T * 1e3, SI[:, 3:], 1e12 + T * 1e3 + 0.4, SI[:, :3])
    (folder / "imu.csv").write_text(text("#timestamp,type,x,y,z", *rows))
    return folder / "imu.csv"


def arrays(folder: Path) -> Path:
    """APDM's Opal: a group called Calibrated, whose name does not indicate a rate."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "opal.h5", "w") as file:
        file["SI-738/Time"] = US
        file["SI-738/Calibrated/Accelerometers"], file["SI-738/Calibrated/Gyroscopes"] = SI[:, :3], SI[:, 3:]
        file["pose/tango_ori"] = QUATERNION
    return folder / "opal.h5"


def packets_of_a_phone(folder: Path) -> Path:
    """Polar's logger: the phone's date is that of a packet of 20 rows, the sensor's time that of each row."""
    packets = [f"2021-03-04T10:11:{12 + at // 0.2 * 0.2:06.3f}" for at in T]
    shown = np.rint(FORCE * 1000).astype(int)
    rows = lines("{};{};{};{};{}", packets, US * 1000 + 599_618_164_814_402_794, shown)
    (folder / "ACC.txt").write_text(text("Phone timestamp;sensor timestamp [ns];X [mg];Y [mg];Z [mg]", *rows))
    return folder / "ACC.txt"


def files_with_dots(folder: Path) -> Path:
    """MetaWear: names of files that differ after several dots."""
    (folder / "MW").mkdir()
    for name, unit, values in (("Accelerometer", "g", FORCE), ("Gyroscope", "deg/s", RATE)):
        head = f"epoc (ms),elapsed (s),x-axis ({unit}),y-axis ({unit}),z-axis ({unit})"
        rows = lines("{},{:.3f},{:.5f},{:.5f},{:.5f}", US // 1000 + 1_614_845_472_123, T, values)
        (folder / f"MW/MW_2021-03-04T10.11.12.123_{name}_100.000Hz_1.4.4.csv").write_text(text(head, *rows))
    return folder / "MW"


def angles_beside_rates(folder: Path) -> Path:
    """WitMotion: angles are not rates; German names of accelerations are recognised."""
    axes = [f"{name}{axis}({unit})" for name, unit in (("w", "\u00b0/s"), ("Angle", "\u00b0")) for axis in "xyz"]
    head = ";".join(["t_ms", "Beschl X", "Beschl Y", "Beschl Z", *axes])
    rows = lines("{:.1f}" + ";{:.5f}" * 9, T * 1e3, FORCE, RATE, RATE / 7)
    (folder / "wit.txt").write_text(text(head, *rows), encoding="utf-8")
    return folder / "wit.txt"


QUICK = (json_lines,)
SENSORS = {
    kitti: 2, json_lines: 2, json_lists: 2, json_document: 2, influx: 2, can_frames: 2, novatel: 2, ardupilot: 4,
    wide: 3, nameless_files: 2, torn_serial: 2, kinds_behind_the_time: 2, arrays: 2, packets_of_a_phone: 1,
    files_with_dots: 2, angles_beside_rates: 2,
}  # fmt: skip
"""Writers of recordings, and the number of inertial sensors in each."""


@pytest.mark.parametrize(
    "write",
    [
        pytest.param(write, marks=() if write in QUICK else pytest.mark.slow if at % 2 else pytest.mark.campaign)
        for at, write in enumerate(SENSORS)
    ],
    ids=lambda write: write.__name__,
)
def test_the_guessed_map_gives_the_true_values(
    write: Callable[[Path], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, target, log_path = write(tmp_path), tmp_path / "map.toml", tmp_path / "run.h5"
    assert main(["import", str(source), "--guess", "-o", str(target)]) == 0
    assert main(["import", str(source), "--map", str(target), "-o", str(log_path)]) == 0
    report = capsys.readouterr().out
    with open_log(log_path) as log:
        inertial = [*log.of("specific_force"), *log.of("angular_rate")]
        assert len(inertial) == SENSORS[write], target.read_text()
        for quantity, truth, most in (("specific_force", FORCE, 2e-3), ("angular_rate", RATE, 0.1)):
            if not (sensors := log.of(quantity)):  # type: ignore[arg-type]
                continue
            sensor = sensors[0]
            times_s = (np.asarray(sensor.time[:]) - int(sensor.time[0])) * 1e-9
            there = np.stack([np.interp(times_s, T, axis) for axis in truth.T], axis=1)
            values = np.asarray(sensor.counts[:]) / sensor.sensitivity
            if write is novatel:  # the scale of increments is not documented: shape and signs are compared
                values *= np.linalg.norm(there) / np.linalg.norm(values)
                most *= 10
            np.testing.assert_allclose(values, there, atol=most + 0.02 * float(np.abs(there).max()))
    assert "? Acc" not in report and "? acc" not in report, report


@pytest.mark.slow
def test_lists_of_numbers_on_each_line_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Lines as printed by MicroPython."""
    rows = [json.dumps([round(at, 3), *row]) for at, row in zip(T.tolist(), SI.tolist(), strict=True)]
    (tmp_path / "repl.txt").write_text(text(*rows))
    assert main(["import", str(tmp_path / "repl.txt"), "--guess", "-o", str(tmp_path / "map.toml")]) == 0
    words = [str(tmp_path / "repl.txt"), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]
    assert main(["import", *words]) == 0, capsys.readouterr().err
    assert "Acc: measures 0.99" in capsys.readouterr().out


@pytest.mark.parametrize(
    "content", ["{}", "[]", '{"a": [', "[1, 2", '{"a": ' * 900 + "1" + "}" * 900, '{"a": "b"}\n' * 9]
)
def test_json_without_readings_is_refused_in_one_line(
    content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.json").write_text(content)
    assert main(["import", str(tmp_path / "run.json"), "--guess"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
