"""Defective recordings of other programs, with the report of each: a table."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from imuarray.cli import main
from imuarray.importers.cells import CellColumn
from imuarray.importers.table import _is_copy
from tests.importers.recordings import PER_DPS, PER_G, ROWS, G, counts_of, joined, lines_of, several_tables, walk
from tests.selection import some

HEAD = "t,ax,ay,az,gx,gy,gz"
ACC = """
[[sensor]]
name = "Acc"
chip = "any"
quantity = "specific_force"
columns = ["ax", "ay", "az"]
unit = "g"
range = 8
sensitivity = 4096
"""
GYRO = """
[[sensor]]
name = "Gyro"
chip = "any"
quantity = "angular_rate"
columns = ["gx", "gy", "gz"]
unit = "dps"
range = 250
sensitivity = 131
"""
SECONDS = '[time]\ncolumn = "t"\nunit = "s"\n'
MAP = SECONDS + ACC + GYRO
INDEXED = MAP.replace('"t"', "0").replace('["ax", "ay", "az"]', "[1, 2, 3]").replace('["gx", "gy", "gz"]', "[4, 5, 6]")


ROWS_OF_COUNTS = tuple(lines_of(walk().time_s, counts_of(walk()), "{:d}"))


def plain(header: str = HEAD) -> list[str]:
    return [header, *ROWS_OF_COUNTS]


LINEAR_G = np.random.default_rng(6).normal(1e-3, 5e-3, (ROWS, 3))


def stopped(end: int = ROWS) -> bytes:
    """From row 1500 to `end` the program repeats the last reading of the gyroscope."""
    counts = counts_of(walk())
    counts[1500:end, 3:] = counts[1500, 3:]
    return joined([HEAD, *lines_of(walk().time_s, counts, "{:d}")])


def stuck_axis() -> bytes:
    """From row 1500 on, the accelerometer's y stays at one reading."""
    counts = counts_of(walk())
    counts[1500:, 1] = 1234
    return joined([HEAD, *lines_of(walk().time_s, counts, "{:d}")])


@cache
def units_taken_for_others() -> bytes:
    recording = walk()
    counts = counts_of(recording)
    values = np.hstack([counts[:, :3] / PER_G * G, np.radians(counts[:, 3:] / PER_DPS)])
    return joined([HEAD, *lines_of(recording.time_s, values, "{:.7f}")])


def si_units() -> str:
    return MAP.replace('"g"\nrange = 8\nsensitivity = 4096', '"m/s2"').replace(
        '"dps"\nrange = 250\nsensitivity = 131', '"rad/s"'
    )


def clipped(at_g: float, rms_g: float = 3.0) -> bytes:
    """Shaken, cut off at a range, as counts."""
    recording = walk()
    shaken = np.random.default_rng(7).normal(0, rms_g, (ROWS, 3)).clip(-at_g, at_g)
    values = counts_of(recording._replace(force_g=shaken)).clip(-32768, 32767)
    return joined([HEAD, *lines_of(recording.time_s, values, "{:d}")])


def in_units(still: bool) -> np.ndarray:
    """g and dps."""
    return np.asarray(counts_of(walk(still=still)) / np.array([PER_G] * 3 + [PER_DPS] * 3))


def turned_throughout() -> bytes:
    """Turned about an axis that is not along gravity, at a rate that oscillates between 30 and 90 dps."""
    time_s = np.arange(ROWS) * 0.01
    rate = np.radians(60 + 30 * np.sin(2 * np.pi * 0.1 * time_s))
    angle = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * 0.01)])
    noise = np.random.default_rng(4).normal(0, [5.0] * 3 + [10.0] * 3, (ROWS, 6))
    force = np.stack([np.zeros(ROWS), np.sin(angle), np.cos(angle)], axis=1) * PER_G
    turned = np.stack([np.degrees(rate) * PER_DPS, np.zeros(ROWS), np.zeros(ROWS)], axis=1)
    counts = np.rint(np.hstack([force, turned]) + noise).astype(int)
    return joined([HEAD, *lines_of(time_s, counts, "{:d}")])


@cache
def bursts() -> bytes:
    """A busy host stamps the rows that a driver has buffered, eight rows in two milliseconds, then none
    for some time.
    """
    recording = walk(4000)
    rng = np.random.default_rng(3)
    sizes = rng.integers(2, 14, 700)
    ends = np.cumsum(sizes)
    ends = ends[ends <= 4000]
    stamps = np.concatenate(
        [
            recording.time_s[end - 1] + 1e-3 + np.arange(size) * 2e-4
            for end, size in zip(ends.tolist(), sizes.tolist(), strict=False)
        ]
    )
    rows = len(stamps)
    return joined([HEAD, *lines_of(stamps, counts_of(recording)[:rows], "{:d}")])


def stalls() -> bytes:
    recording = walk(still=True)
    stamps = recording.time_s + 2.5 * (np.arange(ROWS) // 50)
    return joined([HEAD, *lines_of(stamps, counts_of(recording), "{:d}")])


def changing_rate(later_s: float, row: int) -> bytes:
    """100 rows per second until `row`, then a row every `later_s`."""
    times_s = np.cumsum(np.where(np.arange(ROWS) <= row, 0.01, later_s)) - 0.01
    return joined([HEAD, *lines_of(times_s, counts_of(walk(still=True)), "{:d}")])


@cache
def with_counter(span: int) -> bytes:
    recording = walk()
    ticks = (np.rint(recording.time_s * 1e6).astype(np.int64) + span - 5_000_000) % span
    rows = counts_of(recording)
    return joined(
        [
            HEAD,
            *(f"{tick}," + ",".join(map(str, row)) for tick, row in zip(ticks.tolist(), rows.tolist(), strict=True)),
        ]
    )


def wide_with_blanks() -> bytes:
    recording, rows = walk(), counts_of(walk()).astype(object)
    rows[np.arange(ROWS) % 4 != 0, :3] = ""
    return joined([HEAD, *lines_of(recording.time_s, rows, "{}")])


KINDS = "[file]\nkind_column = 0\n" + MAP.replace('"t"', "1").replace(
    '["ax", "ay", "az"]', '[2, 3, 4]\nkind = "ACC"'
).replace('["gx", "gy", "gz"]', '[2, 3, 4]\nkind = "GYR"')


def edited(change: Callable[[list[str]], list[str]]) -> bytes:
    return joined(change(plain()))


def insert(at: int, *lines: str) -> Callable[[list[str]], list[str]]:
    return lambda all_: [*all_[:at], *lines, *all_[at:]]


CASES: dict[str, tuple[bytes, str, int, list[str]]] = {
    "sound": (joined(plain()), MAP, 0, ["~ Acc: measures 0.9998 g at rest", "~ Gyro: reads 0.5"]),
    "m/s2 and rad/s as g and dps": (
        units_taken_for_others(),
        MAP.replace("4096", "2048")
        .replace("range = 8", "range = 16")
        .replace("range = ", 'values = "physical"\nrange = '),
        0,
        [
            "? Acc: measures 9.8",
            "the columns may be in m/s2, not g",
            "? Gyro: measures 0.0175 times the rotation of gravity in the accelerometers: the columns may be in rad/s",
        ],
    ),
    "rad/s as dps, of a coarse gyroscope": (
        units_taken_for_others(),
        si_units().replace('"rad/s"', '"dps"\nrange = 2000\nsensitivity = 16.4\nvalues = "physical"'),
        0,
        ["Gyro xyz: its values change by", "are rounded away: 16.4 counts per dps are too few, or the unit is wrong"],
    ),
    "m/s2 and rad/s, said so": (
        units_taken_for_others(),
        si_units(),
        0,
        [
            "~ Acc: measures 0.9998 g at rest",
            "Acc: 4096 counts per g, range 2 g, as the grid of its values says",
            "Gyro: 131 counts per dps",
        ],
    ),
    "mg as g": (
        joined([HEAD, *lines_of(walk().time_s, counts_of(walk()) / [4.096, 4.096, 4.096, 1, 1, 1])]),
        MAP.replace('unit = "g"\nrange = 8\nsensitivity = 4096', 'unit = "g"'),
        0,
        ["g at rest instead of 1 g: the columns may be in mg, not g"],
    ),
    "another range's sensitivity": (
        joined(plain()),
        MAP.replace("4096", "16384").replace("range = 8", "range = 2"),
        0,
        ["? Acc: measures 0.25 g at rest instead of 1 g", "the counts per g 4 times too large"],
    ),
    "milliseconds as seconds": (
        joined([HEAD, *lines_of(walk().time_s * 1000, counts_of(walk()), "{:d}")]),
        MAP,
        0,
        ["0.1 rows a second: the unit of time may be a thousand times smaller"],
    ),
    "an axis that is not connected": (
        edited(lambda lines: [lines[0], *(re.sub(r"^(.*?,.*?),.*?,", r"\1,0,", line) for line in lines[1:])]),
        MAP,
        0,
        ["? Acc: y is always 0"],
    ),
    "a column named twice": (
        joined(plain()),
        MAP + GYRO.replace("Gyro", "Gyro2"),
        0,
        ["? Gyro2: has the same readings as Gyro: are its columns named twice?"],
    ),
    "clipping at the range": (
        clipped(8.0),
        MAP,
        0,
        ["Acc: xyz clips at -32768 (-8 g) and 32767 (8 g); 35 readings flagged as saturated"],
    ),
    "clipping at half the range, in codes of 17 bits": (
        clipped(8.0, 6.0),
        MAP.replace("range = 8", "range = 16"),
        0,
        ["Acc: xyz clips at -32768 (-8 g) and 32767 (8 g); 917 readings flagged as saturated"],
    ),
    "clipping below the range": (
        clipped(4.0),
        MAP,
        0,
        ["xyz clips at -16384 (-4 g) and 16384 (4 g); 917 readings flagged as saturated"],
    ),
    "bursts": (bursts(), MAP, 0, ["rows arrive in bursts", "The true rate is 1", "stamps = 'arrival'"]),
    "bursts, counted out": (
        bursts(),
        MAP.replace('unit = "s"', 'unit = "s"\nstamps = "arrival"', 1),
        0,
        ["Acc: reading times reconstructed at 10", "rows arrived up to"],
    ),
    "stalls": (stalls(), MAP, 0, ["rows stall for 2.51 s after every 50 rows"]),
    "unsigned codes": (
        joined([HEAD, *lines_of(walk().time_s, counts_of(walk()) + 32768, "{:d}")]),
        MAP,
        2,
        ["allowed are -32768 to 32767; for unsigned codes, set offset or bits in the map"],
    ),
    "unsigned codes with their offset": (
        joined([HEAD, *lines_of(walk().time_s, counts_of(walk()) + 32768, "{:d}")]),
        MAP.replace("range", "offset = 32768\nrange"),
        0,
        ["~ Acc: measures 0.9998 g at rest"],
    ),
    "two's complement read as unsigned": (
        joined([HEAD, *lines_of(walk().time_s, counts_of(walk()) % 65536, "{:d}")]),
        MAP.replace("range", "bits = 16\nrange"),
        0,
        ["~ Acc: measures 0.9998 g at rest"],
    ),
    "12 bits with an offset that nobody says": (
        joined([HEAD, *lines_of(walk().time_s, counts_of(walk()) // 16 + 2048, "{:d}")]),
        MAP.replace("4096", "256").replace("131", "8.1875"),
        0,
        ["all codes are positive on every axis: are they unsigned, with an offset?"],
    ),
    "separators at the ends of lines": (
        edited(lambda lines: [lines[0], *(line + "," for line in lines[1:])]),
        MAP,
        0,
        ["2000 rows each"],
    ),
    "a header that comes again": (
        edited(lambda lines: insert(1200, HEAD)(insert(700, HEAD)(lines))),
        MAP,
        0,
        ["2000 rows each", "2 lines that repeat the header left out"],
    ),
    "NUL bytes of a power cut": (
        edited(insert(900, "\0" * 512 + "9.01,1,2")),
        MAP,
        0,
        ["2000 rows each", "1 line with NUL bytes left out"],
    ),
    "a last line that is cut off": (
        joined(plain())[:-12],
        MAP,
        0,
        ["1999 rows each", "1 line at the end of the file left out"],
    ),
    "a last table of zeros": (
        edited(lambda lines: [*lines, *["0,0,0,0,0,0,0"] * 300]),
        MAP,
        0,
        ["2000 rows each", "300 rows of zeros only, time included, left out as padding"],
    ),
    "decimal commas": (
        joined(plain()).replace(b",", b";").replace(b".", b","),
        '[file]\ndelimiter = ";"\n' + MAP,
        2,
        ["; for decimal commas, set decimal = ',' in the map"],
    ),
    "decimal commas, said so": (
        joined(plain()).replace(b",", b";").replace(b".", b","),
        '[file]\ndelimiter = ";"\ndecimal = ","\n' + MAP,
        0,
        ["2000 rows each"],
    ),
    "a header that no column is named by": (
        joined(plain()),
        INDEXED,
        2,
        ["'t' is not a number; for a header, name the columns in the map, or set skip_rows = 1"],
    ),
    "another delimiter": (joined(plain()).replace(b",", b"\t"), INDEXED, 2, ["; do they have another delimiter?"]),
    "UTF-16 of a Windows shell": ("\n".join(plain()).encode("utf-16"), MAP, 0, ["2000 rows each"]),
    "a clock of milliseconds": (
        joined([HEAD, *lines_of(np.floor(walk().time_s * 50) / 50, counts_of(walk()), "{:d}")]),
        MAP,
        2,
        ["0.000000 is not later than the row before", "; for a coarse clock, set ties = true in the map"],
    ),
    "a clock of milliseconds, said so": (
        joined([HEAD, *lines_of(np.floor(walk().time_s * 50) / 50, counts_of(walk()), "{:d}")]),
        MAP.replace('unit = "s"', 'unit = "s"\nties = true', 1),
        0,
        ["1000 rows with the time of the row before put 1 ns later ~"],
    ),
    "a counter that begins anew": (
        with_counter(1 << 32),
        MAP.replace('unit = "s"', 'unit = "us"\nwraps_at = 4294967296', 1),
        0,
        ["2000 rows each over 20.0 s", "the time column wrapped 1 time"],
    ),
    "a counter that begins anew, and nobody says it": (
        with_counter(1 << 32),
        MAP.replace('unit = "s"', 'unit = "us"', 1),
        2,
        ["for a counter that wraps, set wraps_at in the map"],
    ),
    "several tables of different rates": (several_tables(), KINDS, 0, ["2000 rows at most over 20.0 s"]),
    "blank cells of a slower sensor": (wide_with_blanks(), MAP, 0, ["Acc: no reading in 1500 of 2000 rows"]),
    "rows that are missing": (
        edited(lambda rows: [row for at, row in enumerate(rows) if at not in (500, 501, 502, 1200, 1201)]),
        MAP,
        0,
        ["~ Acc, Gyro: 2 gaps between rows, 35 ms in the median: 5 rows may be missing"],
    ),
    "single rows that are missing": (
        edited(lambda rows: [row for at, row in enumerate(rows) if at not in (300, 700, 1200)]),
        MAP,
        0,
        ["~ Acc, Gyro: 3 gaps between rows, 20 ms in the median: 3 rows may be missing"],
    ),
    "a rate that changes half way": (
        changing_rate(0.02, 1200),
        MAP,
        0,
        ["~ Acc, Gyro: the rate changes: 100 rows per second at first, 50 from 12 s on"],
    ),
    "a rate that changes early": (
        changing_rate(0.03, 300),
        MAP,
        0,
        ["~ Acc, Gyro: the rate changes: 100 rows per second at first, 33.33 from 3 s on"],
    ),
    "a rate that rises": (
        changing_rate(0.004, 1500),
        MAP,
        0,
        ["~ Acc, Gyro: the rate changes: 100 rows per second at first, 250 from 15"],
    ),
    "every other row is missing for some time": (
        edited(lambda rows: [row for at, row in enumerate(rows) if at < 400 or at > 1600 or at % 4]),
        MAP,
        0,
        ["20 ms in 18 % of the intervals: rows are missing regularly"],
    ),
    "values that never change": (
        joined([HEAD, *lines_of(walk().time_s, np.tile([0.0, 0.0, 1.0, 0.3, 0.3, 0.3], (ROWS, 1)))]),
        MAP.replace("range", 'values = "physical"\nrange'),
        0,
        ["? Acc: xyz is always 0, 0, 4096 ? Gyro: xyz is always 39, 39, 39"],
    ),
    "gravity taken out": (
        joined([HEAD, *lines_of(walk().time_s, counts_of(walk()._replace(force_g=walk().force_g * 0.05)), "{:d}")]),
        MAP,
        0,
        ["? Acc: measures 0.0", "gravity may have been removed (linear acceleration), or the unit may be wrong"],
    ),
    "linear acceleration of a phone, which rests": (
        joined([HEAD, *lines_of(walk().time_s, counts_of(walk()._replace(force_g=LINEAR_G)), "{:d}")]),
        MAP,
        0,
        ["g instead of 1 g: gravity may have been removed (linear acceleration), or"],
    ),
    "a gyroscope that stops": (
        stopped(),
        MAP,
        0,
        [
            "~ Gyro: reads 0.5",
            "? Gyro: repeats one reading from 15 s after the beginning to the end (500 of 2000 rows): did it stop?",
        ],
    ),
    "an axis that sticks": (
        stuck_axis(),
        MAP,
        0,
        [
            "? Acc: y stays at 1234 (0.3013 g) from 15 s after the beginning to the end (500 of 2000 rows), while the"
            " other axes change: did it stop?"
        ],
    ),
    "a gyroscope that stops for three seconds": (
        stopped(1800),
        MAP,
        0,
        ["? Gyro: repeats one reading for 2.99 s, from 15 s after the beginning (300 rows): did it stop?"],
    ),
    "columns of a gyroscope in another order": (
        joined([HEAD, *lines_of(walk().time_s, counts_of(walk())[:, [0, 1, 2, 5, 3, 4]], "{:d}")]),
        MAP,
        0,
        ["? Gyro: its rotations do not fit those of the accelerometers: it is mounted in another direction"],
    ),
    "exchanged signs": (
        joined([HEAD, *lines_of(walk().time_s, counts_of(walk()) * [1, 1, 1, -1, -1, -1], "{:d}")]),
        MAP,
        0,
        ["? Gyro: rotates opposite to the accelerometers: axes of one of them are mirrored or exchanged"],
    ),
    "units in other spellings": (
        units_taken_for_others(),
        si_units().replace('"m/s2"', '"m/s^2"').replace('"rad/s"', '"rad/sec"').replace('"s"', '"sec"', 1),
        0,
        ["~ Acc: measures 0.9998 g at rest", "~ Gyro: reads 0.5"],
    ),
    "dps as rad/s, at rest": (
        joined([HEAD, *lines_of(walk().time_s, in_units(still=True))]),
        si_units().replace('"m/s2"', '"g"'),
        0,
        ["? Gyro: reads 2", "more than gyroscopes do: the columns may be in dps, not rad/s"],
    ),
    "rad/s as dps, at rest": (
        joined([HEAD, *lines_of(walk().time_s, in_units(still=True) * [1, 1, 1, *[np.pi / 180] * 3], "{:.9f}")]),
        si_units()
        .replace('"m/s2"', '"g"')
        .replace('"rad/s"', '"dps"\nrange = 2\nsensitivity = 16000\nvalues = "physical"'),
        0,
        ["less than MEMS gyroscopes have: the columns may be in rad/s, not dps"],
    ),
    "shaken throughout": (clipped(8.0), MAP, 0, ["Acc: xyz clips", "2000 rows each"]),
    "turned throughout": (turned_throughout(), MAP, 0, ["~ Gyro: turns at ", "dps at its quietest"]),
    "a line that NUL bytes end": (
        edited(insert(900, "9.01,1,2" + "\0" * 40)),
        MAP,
        0,
        ["2000 rows each", "1 line with NUL bytes left out"],
    ),
    "a line of NUL bytes alone": (
        edited(insert(900, "\0" * 40)),
        MAP,
        0,
        ["2000 rows each", "1 line with NUL bytes left out"],
    ),
    "messages between the rows": (
        edited(lambda lines: [*insert(900, "I2C timeout, retrying")(lines), "Total: 2000 rows"]),
        MAP,
        0,
        ["2000 rows each", "2 lines of text without a number left out"],
    ),
    "dates that are called seconds": (
        edited(lambda lines: [lines[0], *("2024-03-01 12:00:0" + line for line in lines[1:900])]),
        MAP,
        2,
        ["is not a number; for dates, set unit = 'iso8601'"],
    ),
    "lines above the header": (
        edited(lambda lines: ["Logger 3", "firmware 1.2", *lines]),
        MAP,
        2,
        ["no column 't'; the header has Logger 3; line 3 has it", "skip_rows = 2"],
    ),
    "another delimiter, of a header": (
        joined(plain()).replace(b",", b"\t"),
        MAP,
        2,
        ["if the delimiter is '\\t', set it in [file] of the map"],
    ),
    "no text": (bytes([*b"\x7fELF", *range(1, 200)]) * 40, MAP, 2, ["is not text; allowed are tables of text"]),
    "runs one after the other": (
        edited(lambda lines: [*lines, *lines[1:900]]),
        MAP,
        2,
        ["is not later than the row before", "import several recordings one by one"],
    ),
    "only even codes": (
        joined([HEAD, *lines_of(walk().time_s, counts_of(walk()) // 2 * 2, "{:d}")]),
        MAP,
        0,
        ["~ Acc, Gyro: only even codes"],
    ),
    "rows that were written twice, said so": (
        joined([HEAD, *(line for row in plain()[1:] for line in (row, row))]),
        MAP.replace('unit = "s"', 'unit = "s"\nties = true', 1),
        0,
        [
            "2000 rows with the time of the row before put 1 ns later, all with equal cells: the file may hold rows"
            " twice"
        ],
    ),
}


QUICK = (
    "sound",
    "m/s2 and rad/s as g and dps",
    "an axis that is not connected",
    "clipping at the range",
    "decimal commas",
    "several tables of different rates",
    "rows that are missing",
    "a gyroscope that stops",
    "exchanged signs",
    "rows that were written twice, said so",
)
"""Cases of the quick half."""


@pytest.mark.parametrize(("last", "is_copy"), [(["7", "8.5"], True), (["7", "8.4"], False), (["6", "8.5"], False)])
def test_a_copy_has_all_cells_of_the_row_before(last: list[str], is_copy: bool) -> None:
    """A column of whole numbers, and one of texts."""
    numbers = CellColumn("a.npy", "count", [1, 2, 3], [], np.array([1, 7, int(last[0])]))
    texts = CellColumn("a.csv", "ax", [1, 2, 3], ["2", "8.5", last[1]])
    assert _is_copy([numbers, texts], 2) == is_copy


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK else pytest.mark.slow if at % 2 else pytest.mark.campaign)
        for at, name in enumerate(CASES)
    ],
)
def test_the_report_names_the_defect(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, table_map, code, message = CASES[name]
    (tmp_path / "data.csv").write_bytes(data)
    (tmp_path / "map.toml").write_text(table_map, encoding="utf-8")
    arguments = [str(tmp_path / "data.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]
    assert main(["import", *arguments]) == code
    captured = capsys.readouterr()
    text = " ".join((captured.out + captured.err).split())
    for sentence in message:
        assert sentence in text, text
    if name in ("sound", "shaken throughout", "turned throughout"):
        assert "?" not in text
    assert (tmp_path / "run.h5").exists() == (code == 0)


def late(delays_s: np.ndarray) -> bytes:
    return joined([HEAD, *lines_of(walk().time_s + delays_s, counts_of(walk()), "{:d}")])


LATE = np.where(np.isin(np.arange(ROWS), (200, 600, 1500)), 8e-3, 0.0)
"""Three rows are 8 ms late, and the next ones on time."""

SLEEPS = np.cumsum(np.random.default_rng(8).uniform(0, 16e-3, ROWS))
"""A program that sleeps for a period after each reading: intervals scatter, and no clock is behind them."""


@pytest.mark.parametrize("delays_s", some([LATE, SLEEPS], 1), ids=["late", "sleeps"])
def test_late_rows_are_not_reported_as_missing(
    delays_s: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "data.csv").write_bytes(late(delays_s))
    (tmp_path / "map.toml").write_text(MAP, encoding="utf-8")
    arguments = [str(tmp_path / "data.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]
    assert main(["import", *arguments]) == 0
    assert "missing" not in capsys.readouterr().out


@pytest.mark.parametrize(("rows", "mark"), some([(3, "~"), (6, "?")], 1))
def test_times_that_many_rows_share_are_doubted(
    rows: int, mark: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """So many rows have the same time, and those of the next one are 20 ms later."""
    counts = np.rint(np.random.default_rng(4).normal([0, 0, 4096], 9, (600, 3))).astype(int)
    (tmp_path / "data.csv").write_bytes(
        joined(["t,ax,ay,az", *lines_of(np.arange(600) // rows * 0.02, counts, "{:d}")])
    )
    (tmp_path / "map.toml").write_text(SECONDS.replace('"s"', '"s"\nties = true') + ACC, encoding="utf-8")
    arguments = [str(tmp_path / "data.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]
    assert main(["import", *arguments]) == 0
    assert f"  {mark} Acc: several rows have the same time, and the next time is 0.02 s" in capsys.readouterr().out


@pytest.mark.parametrize(("axes", "doubted"), some([("+X+Y+Z", True), ("+X-Y-Z", False)], 1))
def test_an_accelerometer_mounted_upside_down_is_reported(
    axes: str, doubted: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two accelerometers, the second turned by 180 degrees about X, where both read 100 counts: 177 degrees, which is
    180 - 2 atan(100 / 4096), are between their directions of gravity, unless the map states the mounting.
    """
    noise = np.rint(np.random.default_rng(5).normal(0, 8, (2000, 6))).astype(int)
    codes = noise + np.array([100, 50, 4096, 100, -50, -4096])
    (tmp_path / "data.csv").write_bytes(
        joined(["t,ax,ay,az,bx,by,bz", *lines_of(np.arange(2000) * 0.01, codes, "{:d}")])
    )
    second = ACC.replace('"Acc"', '"Up"').replace('["ax", "ay", "az"]', '["bx", "by", "bz"]') + f'axes = "{axes}"\n'
    (tmp_path / "map.toml").write_text(SECONDS + ACC + second)
    files = ["--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]
    assert main(["import", str(tmp_path / "data.csv"), *files]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert ("? Up: its gravity is 177 degrees from that of Acc" in text) == doubted
