"""Recordings of apps for phones: linear accelerations and attitudes are named, and are not measurements."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imuarray.errors import ConfigError
from imuarray.importers.guess import guess_map
from imuarray.importers.mapping import parse_map
from imuarray.importers.table import import_table
from imuarray.log import Log, open_log
from tests.importers.recordings import G
from tests.selection import some

ROWS, RATE_HZ = 1200, 100.0
T = np.arange(ROWS) / RATE_HZ
RNG = np.random.default_rng(7)
MOVING = (T > 4) & (T < 10)
RATE = np.where(MOVING[:, None], np.radians([60.0, 40.0, 30.0]) * np.sin(np.outer(T - 4, [1.1, 0.7, 0.9])), 0.0)
"""rad/s"""


def attitudes() -> Rotation:
    """From the phone to a level frame with z up."""
    made = [Rotation.identity()]
    for step in RATE[:-1] / RATE_HZ:
        made.append(made[-1] * Rotation.from_rotvec(step))
    return Rotation.concatenate(made)


ATTITUDE = attitudes()
QUATERNION = ATTITUDE.as_quat()[:, [3, 0, 1, 2]]
UP = ATTITUDE.inv().apply([0.0, 0.0, 1.0])
PUSHED = MOVING[:, None] * 1.5 * np.sin(np.outer(T, [9.0, 7.0, 11.0]))
LINEAR = PUSHED + RNG.normal(0, 0.02, (ROWS, 3))
"""m/s2"""
GYRO = RATE + RNG.normal(0, 2e-3, (ROWS, 3))
UNIX_NS = [1_700_000_000_000_000_000 + round(at * 1e9) for at in T]


def table(path: Path, head: str, *columns: object) -> Path:
    path.parent.mkdir(exist_ok=True)
    cells = [np.atleast_2d(np.asarray(column, object).T).T for column in columns]
    rows = [[f"{cell:.6f}" if isinstance(cell, float) else str(cell) for cell in row] for row in np.hstack(cells)]
    path.write_text("\n".join([head, *map(",".join, rows)]) + "\n")
    return path


def phyphox(folder: Path) -> Path:
    """A folder of texts with names and units."""
    for name, unit, values in (("Linear Acceleration", "m/s^2", LINEAR), ("Gyroscope", "rad/s", GYRO)):
        head = ",".join(f'"{name} {axis} ({unit})"' for axis in "xyz")
        table(folder / "phyphox" / f"{name}.csv", f'"Time (s)",{head}', T, values)
    return table(folder / "phyphox" / "Attitude.csv", '"Time (s)","w","x","y","z"', T, QUATERNION).parent


def sensor_logger(folder: Path) -> Path:
    """A folder whose accelerometer has no gravity, with the axes in the order z, y, x."""
    for name, values in (("Accelerometer", LINEAR), ("Gravity", G * UP), ("Gyroscope", GYRO)):
        table(folder / "logger" / f"{name}.csv", "time,seconds_elapsed,z,y,x", UNIX_NS, T, values[:, ::-1])
    head = "time,seconds_elapsed,qz,qy,qx,qw"
    return table(folder / "logger" / "Orientation.csv", head, UNIX_NS, T, QUATERNION[:, ::-1]).parent


def android_table(folder: Path) -> Path:
    head = "timestamp_ns,lin_acc_x,lin_acc_y,lin_acc_z,gyro_x,gyro_y,gyro_z,rot_vec_w,rot_vec_x,rot_vec_y,rot_vec_z"
    return table(folder / "android.csv", head, UNIX_NS, LINEAR, GYRO, QUATERNION)


def toolbox(folder: Path) -> Path:
    return table(folder / "toolbox.csv", "time,ax,ay,az,wx,wy,wz", T, LINEAR, GYRO)


def android_events(folder: Path) -> Path:
    """A row for each event, with its type and up to four values."""
    lines = ["timestamp,type,v0,v1,v2,v3"]
    for stamp, force, rate, turned in zip(UNIX_NS, LINEAR, GYRO, QUATERNION[:, [1, 2, 3, 0]], strict=True):
        for late, kind, values in ((0, "LINEAR_ACCELERATION", force), (9, "GYROSCOPE", rate)):
            lines.append(f"{stamp + late},TYPE_{kind}," + ",".join(f"{value:.6f}" for value in values) + ",")
        lines.append(f"{stamp + 99},TYPE_ROTATION_VECTOR," + ",".join(f"{value:.6f}" for value in turned))
    path = folder / "events.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def plain(text: str) -> str:
    return " ".join(line.lstrip("#? ") for line in text.splitlines())


def imported(folder: Path, source: Path, text: str) -> Log:
    (folder / "map.toml").write_text(text)
    import_table(source, folder / "map.toml", folder / "run.h5")
    return open_log(folder / "run.h5")


@pytest.mark.parametrize(
    ("write", "attitude"),
    some(
        [
            (phyphox, "left out: Attitude.csv: an attitude"),
            (sensor_logger, "left out: Orientation.csv: an attitude"),
            (android_table, 'left out: "rot_vec_w", "rot_vec_x", "rot_vec_y", "rot_vec_z": an attitude'),
            (toolbox, ""),
            (android_events, "left out: rows of kind 'TYPE_ROTATION_VECTOR': an attitude"),
        ],
        1,
    ),
)
def test_only_measurements_are_proposed(write: Callable[[Path], Path], attitude: str, tmp_path: Path) -> None:
    """The gyroscope alone; linear acceleration and attitude are named in one line each, the former as a comment."""
    source = write(tmp_path)
    text = guess_map(source)
    assert attitude in plain(text)
    assert "a linear acceleration: a program subtracted gravity, so it is not a measurement" in plain(text)
    assert '# quantity = "specific_force"' in text
    with imported(tmp_path, source, text) as log:
        (gyro,) = log.sensors.values()
        assert gyro.quantity == "angular_rate"
        rates = np.asarray(gyro.counts[:]) / gyro.sensitivity
        assert rates == pytest.approx(np.degrees(GYRO), abs=0.01)


@pytest.mark.slow
def test_the_attitude_restores_gravity_on_request(tmp_path: Path) -> None:
    """With the comment of the proposal as part of the map: the force in closed form, and rotations that agree."""
    source = android_table(tmp_path)
    text = guess_map(source)
    head, aside = text.split("# [[sensor]]")
    asked = head + "\n".join(line.removeprefix("# ") for line in f"# [[sensor]]{aside}".splitlines())
    (tmp_path / "map.toml").write_text(asked)
    summary = import_table(source, tmp_path / "map.toml", tmp_path / "run.h5")
    assert any("1 g is added along up in the attitude of rot_vec_w" in text for text in summary.remarks)
    with open_log(tmp_path / "run.h5") as log:
        force = np.asarray(log["Acc"].counts[:]) / log["Acc"].sensitivity
    assert force == pytest.approx(LINEAR / G + UP, abs=1e-3)


@pytest.mark.slow
def test_rows_without_an_attitude_are_omitted(tmp_path: Path) -> None:
    """Zeros, which an app writes until its attitude is known."""
    turned = QUATERNION.copy()
    turned[:50] = 0.0
    source = table(tmp_path / "phone.csv", "t,ax,ay,az,qw,qx,qy,qz", T, LINEAR, turned)
    text = guess_map(source).replace("# attitude_columns", "attitude_columns")
    with imported(tmp_path, source, text) as log:
        assert len(log["Acc"]) == ROWS - 50


@pytest.mark.parametrize(
    ("quantity", "unit", "more", "message"),
    [
        ("angular_rate", "dps", "", "attitude_columns apply to specific_force, but the quantity is angular_rate"),
        ("specific_force", "g", "gravity_columns = [8, 9, 10]", "would add gravity twice"),
        ("specific_force", "g", "range = 2\nsensitivity = 16384", "attitude_columns applies to columns in a unit"),
    ],
)
def test_contradictory_maps_are_refused(quantity: str, unit: str, more: str, message: str) -> None:
    text = f"""
[time]
rate_hz = 100
[[sensor]]
name = "A"
chip = "phone"
quantity = "{quantity}"
columns = [0, 1, 2]
unit = "{unit}"
attitude_columns = [3, 4, 5, 6]
{more}
"""
    with pytest.raises(ConfigError, match=message):
        parse_map(text, "map.toml")
