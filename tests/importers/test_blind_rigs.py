"""Recordings of unusual rigs: each is imported unchanged by its guessed map, with the true values."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imuarray.errors import ConfigError
from imuarray.importers.guess import guess_map
from imuarray.importers.mapping import parse_map
from imuarray.importers.table import import_table
from imuarray.log import open_log
from tests.importers.recordings import G, lines_of, walk
from tests.selection import some

ROWS = 1500
WALK = walk(ROWS)
T = WALK.time_s
SI = np.hstack([WALK.force_g * G, np.radians(WALK.rate_dps)])
CODES = np.rint(np.hstack([WALK.force_g * 4096, WALK.rate_dps * 65.5])).astype(int)
NAMES = "ax,ay,az,gx,gy,gz"


def row_counter(folder: Path) -> list[str]:
    """No time; a counter of 8 bits that wraps."""
    rows = [f"{(37 + row) % 256}," + ",".join(map(str, codes)) for row, codes in enumerate(CODES.tolist())]
    return [f"cnt,{NAMES}", *rows]


def hexadecimal(folder: Path) -> list[str]:
    """Codes as in registers."""
    rows = [
        f"{round(1000 * at)}," + ",".join(f"0x{code & 0xFFFF:04X}" for code in codes)
        for at, codes in zip(T.tolist(), CODES.tolist(), strict=True)
    ]
    return [f"t_ms,{NAMES}", *rows]


def summaries(folder: Path) -> list[str]:
    """Statistics below the readings."""
    rows = [f"{word}," + ",".join(f"{v:.4f}" for v in SI.mean(axis=0)) for word in ("Mean", "Max")]
    return [f"time_s,{NAMES}", *lines_of(T, SI, "{:.6f}"), "", *rows, f"Samples,{ROWS}"]


def serial_days(folder: Path) -> list[str]:
    """Dates as spreadsheets store them: days since the end of 1899."""
    stamps = 45356.604166666664 + T / 86400
    return [
        "Time,AccX (m/s2),AccY (m/s2),AccZ (m/s2),GyroX (rad/s),GyroY (rad/s),GyroZ (rad/s)",
        *[f"{day:.11f}," + ",".join(f"{v:.6f}" for v in row) for day, row in zip(stamps.tolist(), SI, strict=True)],
    ]


def two_columns(folder: Path) -> list[str]:
    """Whole seconds since 1970, and nanoseconds, as ROS has them."""
    rows = [
        f"{1709645400 + round(1e9 * at) // 10**9},{round(1e9 * at) % 10**9}," + ",".join(f"{v:.6f}" for v in row)
        for at, row in zip(T.tolist(), SI, strict=True)
    ]
    return [f"sec,nsec,{NAMES}", *rows]


def bars(folder: Path) -> list[str]:
    """A table with bars on both sides and a rule below its header, and times of twelve hours."""
    rows = [
        f"| 03/05/2024 02:30:{at:09.6f} PM | " + " | ".join(f"{v:.2f}" for v in row) + " |"
        for at, row in zip(T.tolist(), 1000 * np.hstack([WALK.force_g, WALK.rate_dps]), strict=True)
    ]
    head = "| Time | A.x (mg) | A.y (mg) | A.z (mg) | W.x (mdps) | W.y (mdps) | W.z (mdps) |"
    return [head, "|---|---|---|---|---|---|---|", *rows]


SAID = {
    bars: 'unit = "%m/%d/%Y %I:%M:%S.%f %p"',
    row_counter: "column 'cnt' counts the rows, from 0 again at 256 and says nothing about time: 100 rows a second",
    hexadecimal: "bits = 16",
    summaries: "3 lines that begin with a word in the place of a number left out",
    serial_days: 'unit = "d"   # ? 100 rows a second, if so',
    two_columns: 'fraction_column = "nsec"',
}


@pytest.mark.slow
@pytest.mark.parametrize("write", some(SAID, 1))
def test_the_guessed_map_gives_the_true_values(write: Callable[[Path], list[str]], tmp_path: Path) -> None:
    source, map_path = tmp_path / "rig.csv", tmp_path / "map.toml"
    source.write_text("\n".join(write(tmp_path)) + "\n")
    text = guess_map(source)
    map_path.write_text(text)
    assert SAID[write] in " ".join(line.removeprefix("#").strip() for line in text.splitlines())
    import_table(source, map_path, tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        acc, gyro = log["Acc"], log["Gyro"]
        at_s = (np.asarray(acc.time[:]) - int(acc.time[0])) * 1e-9
        assert at_s == pytest.approx(T, abs=2e-6)
        assert np.asarray(acc.counts[:]) / acc.sensitivity == pytest.approx(WALK.force_g, abs=2e-4)
        assert np.asarray(gyro.counts[:]) / gyro.sensitivity == pytest.approx(WALK.rate_dps, abs=0.01)


def test_many_rows_of_words_are_refused(tmp_path: Path) -> None:
    """A column of time with words in a tenth of the rows is refused, with the place."""
    lines = [f"t,{NAMES}", *lines_of(T, SI, "{:.6f}")]
    lines[200::10] = [f"late,{line.split(',', 1)[1]}" for line in lines[200::10]]
    (tmp_path / "rig.csv").write_text("\n".join(lines) + "\n")
    assert "'late' is not a number" in guess_map(tmp_path / "rig.csv")


def test_fractions_need_whole_seconds() -> None:
    text = """
[time]
column = 0
unit = "ms"
fraction_column = 1
[[sensor]]
name = "A"
chip = "a"
quantity = "specific_force"
columns = [2, 3, 4]
unit = "g"
"""
    with pytest.raises(ConfigError, match="fraction_column requires a column of unit 's'"):
        parse_map(text, "map.toml")
