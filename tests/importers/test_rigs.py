"""Recordings of many kinds of rigs: the guessed map imports each unchanged, with the true values.

The recordings are in closed form (`tests.importers.recordings`).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imuarray.importers.guess import guess_map
from imuarray.importers.table import import_table
from imuarray.log import Log, open_log
from tests.importers.recordings import G, lines_of, walk
from tests.selection import some

ROWS = 1500
WALK = walk(ROWS)
T, FORCE, RATE = WALK.time_s, WALK.force_g, WALK.rate_dps
SI = np.hstack([FORCE * G, np.radians(RATE)])
BOOT_ROW = 900


def rebooted_ms() -> list[int]:
    """Milliseconds since the start of the board, which restarted before row 900, 350 ms earlier."""
    since = np.rint(T * 1000).astype(int) + 512
    since[BOOT_ROW:] += 350 - since[BOOT_ROW]
    return [int(each) for each in since]


def serial_text(row: Callable[[int, list[float]], str], boot: list[str]) -> list[str]:
    lines = [row(ms, values) for ms, values in zip(rebooted_ms(), SI.tolist(), strict=True)]
    return [*boot, *lines[:BOOT_ROW], *boot, *lines[BOOT_ROW:]]


def arduino(folder: Path) -> Path:
    """Labels and units of two sensors with a bar between them, a stamp in brackets, and boots in the middle."""

    def row(ms: int, values: list[float]) -> str:
        parts = [f"{axis}: {value:.3f}" for axis, value in zip("XYZXYZ", values, strict=True)]
        return f"[{ms}] Acceleration {', '.join(parts[:3])} m/s^2 | Rotation {', '.join(parts[3:])} rad/s"

    boot = ["ets Jul 29 2019 12:21:46", "", "rst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)", "MPU6050 found!"]
    return written(folder / "arduino.txt", serial_text(row, boot))


def prefixed(folder: Path) -> Path:
    """A word before every row of numbers, and no names."""
    return written(
        folder / "serial.txt",
        serial_text(lambda ms, values: f"IMU: {ms}\t" + "\t".join(f"{value:.3f}" for value in values), ["Booting..."]),
    )


def gopro(folder: Path) -> Path:
    """Packets have one date, and rows their own time (gopro-telemetry)."""

    def stream(place: slice) -> dict[str, object]:
        date = "2023-05-01T10:00:00.000Z"
        rows = zip(T.tolist(), SI[:, place].tolist(), strict=True)
        return {"samples": [{"value": row, "cts": round(1000 * at, 3), "date": date} for at, row in rows]}

    streams = {"ACCL": stream(slice(0, 3)), "GYRO": stream(slice(3, 6))}
    path = folder / "gopro.json"
    path.write_text(json.dumps({"1": {"streams": streams, "device name": "HERO8 Black"}}))
    return path


NAMES = "ax (m/s^2),ay (m/s^2),az (m/s^2),gx (rad/s),gy (rad/s),gz (rad/s)"


def stamped(name: str, stamp: Callable[[float], str]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        rows = [f"{stamp(at)}," + ",".join(f"{v:.6f}" for v in row) for at, row in zip(T.tolist(), SI, strict=True)]
        return written(folder / "data.csv", [f"{name},{NAMES}", *rows])

    return write


def of_receiver(at: float) -> str:
    """hhmmss.sss, from 23:59:50 on."""
    second = (86390 + round(at, 3)) % 86400
    return f"{int(second // 3600):02d}{int(second % 3600 // 60):02d}{second % 60:06.3f}"


def of_stopwatch(at: float) -> str:
    second = 3595 + at
    return f"{int(second // 60) % 60}:{second % 60:06.3f}"


def joined_parts(folder: Path) -> Path:
    """Two consecutive files that overlap by 200 rows."""
    rows = lines_of(T, SI, "{:.6f}")
    return written(folder / "joined.csv", [f"t,{NAMES}", *rows[:800], *rows[600:]])


def written(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def imported(folder: Path, source: Path) -> Log:
    (folder / "map.toml").write_text(guess_map(source))
    import_table(source, folder / "map.toml", folder / "run.h5")
    return open_log(folder / "run.h5")


RIGS: dict[str, Callable[[Path], Path]] = {
    "labels and boots": arduino,
    "a word before numbers": prefixed,
    "dates of packets": gopro,
    "hhmmss": stamped("utc", of_receiver),
    "minutes": stamped("Time", of_stopwatch),
    "overlapping parts": joined_parts,
}


@pytest.mark.slow
@pytest.mark.parametrize("rig", some(RIGS, 1))
def test_a_guessed_map_gives_the_true_values(rig: str, tmp_path: Path) -> None:
    with imported(tmp_path, RIGS[rig](tmp_path)) as log:
        acc, gyro = log["Acc"], log["Gyro"]
        assert len(acc) == len(gyro) == ROWS
        force_g = np.asarray(acc.counts[:]) / acc.sensitivity
        rate_dps = np.asarray(gyro.counts[:]) / gyro.sensitivity
        assert float(np.abs(force_g - FORCE).max()) < 2e-3 / 9.8 + 5e-4
        assert float(np.abs(rate_dps - RATE).max()) < np.degrees(6e-4)
        at_s = (np.asarray(acc.time[:]) - int(acc.time[0])) * 1e-9
        assert float(np.abs(at_s - T).max()) < 0.02


LINES, HEAD = lines_of(T, SI, "{:.6f}"), f"t,{NAMES}"
CHANGED = LINES[650].replace(",", ",1", 1)


def folder_of(folder: Path, *files: list[str]) -> Path:
    """A folder with one text of a recorder for each list of rows."""
    folder.mkdir()
    for number, rows in enumerate(files):
        written(folder / f"imu{number}.csv", [HEAD, *rows])
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("files", "message"),
    [
        ((LINES[:800], LINES[600:]), "imu1: its first 200 rows are in the file before it, too: kept once"),
        ((LINES[:800], LINES[800:]), "imu0, imu1 joined in this order"),
        ((LINES[:500], LINES[450:1000], LINES[900:]), "imu2: its first 100 rows are in the file before it"),
        ((LINES, LINES[600:800]), "imu1: its first 200 rows are in the file before it, too: kept once"),
    ],
    ids=["overlap", "follow", "three", "inside"],
)
def test_parts_in_a_folder_are_joined(files: tuple[list[str], ...], message: str, tmp_path: Path) -> None:
    """Files that begin one after the other and agree where they overlap are one recording, with each row once."""
    source = folder_of(tmp_path / "parts", *files)
    assert message in " ".join(line.lstrip("# ~") for line in guess_map(source).splitlines())
    with imported(tmp_path, source) as log:
        assert set(log.sensors) == {"Acc", "Gyro"}
        assert np.asarray(log["Acc"].time[:]) * 1e-9 == pytest.approx(T, abs=1e-6)
        assert np.asarray(log["Gyro"].counts[:]) / log["Gyro"].sensitivity == pytest.approx(RATE, abs=0.04)


APART: dict[str, tuple[list[str], str]] = {
    "a row differs": (
        [*LINES[600:650], CHANGED, *LINES[651:]],
        "imu1.csv: line 52: imu1 overlaps the file before it, but this row",
    ),
    "no row is the same": ([CHANGED, *LINES[651:]], "imu1.csv: line 2"),
    "a gap": (LINES[900:], "they would have a gap of 7 % of their time"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", some(APART, 1))
def test_files_that_do_not_follow_each_other_are_doubted(case: str, tmp_path: Path) -> None:
    second, message = APART[case]
    source = folder_of(tmp_path / "parts", LINES[:800], second)
    text = " ".join(line.removeprefix("#").strip() for line in guess_map(source).splitlines())
    assert "imu0.csv, imu1.csv have the same columns and begin one after the other" in text
    assert message in text
    with imported(tmp_path, source) as log:
        assert set(log.sensors) == {"Acc", "Gyro", "Acc2", "Gyro2"}


@pytest.mark.slow
def test_files_of_simultaneous_sensors_are_not_parts(tmp_path: Path) -> None:
    assert "parts" not in guess_map(folder_of(tmp_path / "sensors", LINES, LINES))


def test_readings_in_seconds_are_not_times_of_day(tmp_path: Path) -> None:
    """Six digits before the point, and no step at the end of a minute."""
    source = stamped("t", lambda at: f"{120000 + at:.2f}")(tmp_path)
    assert 'unit = "s"' in guess_map(source)


@pytest.mark.slow
@pytest.mark.parametrize("name", some(["Zimmer [°C]", "room_degC", "T1 (K)"], 1))
def test_a_unit_of_temperature_indicates_a_thermometer(name: str, tmp_path: Path) -> None:
    rows = [f"{line},23.45" if "K" not in name else f"{line},296.6" for line in lines_of(T, SI, "{:.6f}")]
    with imported(tmp_path, written(tmp_path / "warm.csv", [f"t,{NAMES},{name}", *rows])) as log:
        degrees = np.asarray(log["Thermometer"].compensated("temperature"))
    assert float(np.abs(degrees - 23.45).max()) < 0.011
