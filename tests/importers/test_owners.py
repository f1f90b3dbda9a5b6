"""Recordings as programs of their owners write them: the guessed map imports each at once, with the true values.

What is compared is the truth that was written, in g, dps, gauss and s, however the file spells it.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from imuarray.importers.guess import guess_map
from imuarray.importers.plausibility import report_of
from imuarray.importers.table import import_table
from imuarray.log import Log, open_log
from imuarray.log.format import LOST_BEFORE
from tests.importers.recordings import G, walk

ROWS = 1600
WALK = walk(ROWS)
T, FORCE, RATE = WALK.time_s, WALK.force_g, WALK.rate_dps
MAGNET = np.array([0.2, 0.05, -0.43]) + np.random.default_rng(3).normal(0, 2e-3, (ROWS, 3))


def turned_over() -> np.ndarray:
    """(n, 3) g: the quiet first half, then gravity along many directions, seen with biases of up to 50 mg."""
    angle = np.where(T < 8, 0.0, 2 * np.pi * (T - 8) / 8)
    force = np.stack([np.sin(angle) * np.sin(3 * angle), np.sin(angle) * np.cos(3 * angle), np.cos(angle)], axis=1)
    return force + np.array([0.02, -0.03, 0.05]) + np.random.default_rng(4).normal(0, 2e-3, force.shape)


def lines(form: str, *columns: Sequence[object] | np.ndarray) -> list[str]:
    """One line for each row, by a format of `str.format`; columns of numbers (n,) or (n, k)."""
    flat: list[Sequence[object]] = []
    for column in columns:
        values = np.asarray(column)
        flat += [values] if values.ndim == 1 else list(values.T)
    return [form.format(*row) for row in zip(*flat, strict=True)]


def text(*rows: str) -> str:
    return "\n".join(rows) + "\n"


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
        ("# ~ the times fell 1 time, by 3599.99 s", "# ? the times fall"),
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
    """Each inertial sensor has the true values at the true times, and there is one of each quantity."""
    wanted = {"specific_force": (force, error[0]), "angular_rate": (RATE, error[1])}
    for quantity, (truth, most) in wanted.items():
        (sensor,) = log.of(quantity)  # type: ignore[arg-type]
        times_s = (np.asarray(sensor.time[:]) - int(sensor.time[0])) * 1e-9
        np.testing.assert_allclose(times_s, T, atol=2e-3)
        np.testing.assert_allclose(np.asarray(sensor.counts[:]) / sensor.sensitivity, truth, atol=most)


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=name, marks=pytest.mark.slow if at else ())
        for at, (name, case) in enumerate(CASES.items())
    ],
)
def test_the_owner_gets_the_true_values_at_once(case: Case, tmp_path: Path) -> None:
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
        assert not [text for text in report_of(log).doubts if text.startswith("Acc")]


def test_a_row_after_a_clock_was_set_back_is_flagged(tmp_path: Path) -> None:
    _, path = imported(CASES["a recorder that starts again"].files, tmp_path, "data.csv")
    with open_log(path) as log:
        for sensor in log.sensors.values():
            assert np.flatnonzero(np.asarray(sensor.status[:]) & LOST_BEFORE).tolist() == [900]
