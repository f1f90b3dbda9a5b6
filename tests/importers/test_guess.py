"""`imuarray import DATA --guess`: a map that imports unchanged, with its doubtful entries marked."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from imuarray.cli import main
from imuarray.importers.column_meaning import _tell_apart
from imuarray.importers.guess import guess_map
from imuarray.importers.mapping import parse_map
from imuarray.importers.proposal import _power_of_two_wrap
from imuarray.importers.text_layout import TextLayout, note_days
from imuarray.log import open_log
from tests.importers.recordings import G, counts_of, lines_of, several_tables, walk
from tests.selection import some

COUNTS = counts_of(walk())
SI = np.hstack([COUNTS[:, :3] / 4096 * G, np.radians(COUNTS[:, 3:] / 131)])


def text_of(header: str | None, values: np.ndarray, time_s: np.ndarray | None = None, form: str = "{:.9g}") -> str:
    lines = lines_of(walk().time_s if time_s is None else time_s, values, form)
    return "\n".join([*([header] if header else []), *lines]) + "\n"


CASES: dict[str, tuple[str, list[str]]] = {
    "short names": (
        text_of("t,ax,ay,az,gx,gy,gz", COUNTS, form="{:d}"),
        ['unit = "s"', "sensitivity = 4096   # ? from gravity", "sensitivity = 131"],
    ),
    "long names with units": (
        text_of(
            "Time [s],Accel_X [m/s^2],Accel_Y [m/s^2],Accel_Z [m/s^2],Gyro_X [rad/s],Gyro_Y [rad/s],Gyro_Z [rad/s]", SI
        ),
        ['unit = "m/s2"', 'unit = "rad/s"', 'columns = ["Accel_X [m/s^2]", "Accel_Y [m/s^2]", "Accel_Z [m/s^2]"]'],
    ),
    "signed whole numbers of mg and mdps, units behind underscores": (
        text_of(
            "t_s,ax_mg,ay_mg,az_mg,gx_mdps,gy_mdps,gz_mdps",
            np.rint(COUNTS * np.array([1000 / 4096] * 3 + [1000 / 131] * 3)),
            form="{:+.0f}",
        ),
        ['unit = "mg"\n', 'unit = "mdps"\n'],
    ),
    "whole numbers of mg without a unit, and of mdps": (
        text_of(
            "t,ax,ay,az,gx,gy,gz", np.rint(COUNTS * np.array([1000 / 4096] * 3 + [1000 / 131] * 3)), form="{:+.0f}"
        ),
        ['unit = "mg"   # ? from gravity', 'unit = "mdps"   # ? from the size'],
    ),
    "degrees an hour and feet": (
        text_of(
            "t [s],ax [ft/s^2],ay [ft/s^2],az [ft/s^2],wx [deg/h],wy [deg/h],wz [deg/h]",
            np.hstack([SI[:, :3] / 0.3048, np.degrees(SI[:, 3:]) * 3600]),
        ),
        ['unit = "ft/s2"\n', 'unit = "deg/h"\n'],
    ),
    "revolutions a minute": (
        text_of(
            "t [s],ax [g],ay [g],az [g],wx [rpm],wy [rpm],wz [rpm]",
            np.hstack([SI[:, :3] / G, np.degrees(SI[:, 3:]) / 6]),
        ),
        ['unit = "rpm"\n'],
    ),
    "SI units behind underscores": (
        text_of("t_s,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2,gyr_x_rad_s,gyr_y_rad_s,gyr_z_rad_s", SI),
        ['unit = "m/s2"\n', 'unit = "rad/s"\n'],
    ),
    "no header": (
        text_of(None, SI),
        ["column = 0", "columns = [1, 2, 3]", 'unit = "m/s2"   # ? from the size of the values', "rad/s"],
    ),
    "no header, the rate before the force": (
        text_of(None, np.hstack([SI[:, 3:], SI[:, :3]])),
        ['columns = [4, 5, 6]\nunit = "m/s2"', 'columns = [1, 2, 3]\nunit = "rad/s"'],
    ),
    "a header that is a comment, units in powers": (
        text_of(
            "#timestamp [s],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],"
            "a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]",
            np.hstack([SI[:, 3:], SI[:, :3]]),
        ),
        ['quantity = "angular_rate"\ncolumns = ["w_RS_S_x [rad s^-1]"', 'unit = "rad/s"\n', 'unit = "m/s2"\n'],
    ),
    "decimal commas behind two lines of text": (
        "Logger 3\nmade today\n" + text_of("t,ax,ay,az,wx,wy,wz", SI).replace(",", ";").replace(".", ","),
        ['delimiter = ";"', 'decimal = ","', "skip_rows = 2", 'unit = "m/s2"'],
    ),
    "a preamble of another width, and triads of other things (flight controllers)": (
        '"Product","Flight recorder"\n"acc_1G","4096"\n"looptime","125"\n'
        + text_of(
            "time (us),axisP[0],axisP[1],axisP[2],accSmooth[0],accSmooth[1],accSmooth[2],gyroADC[0] (deg/s),"
            "gyroADC[1] (deg/s),gyroADC[2] (deg/s)",
            np.hstack([COUNTS[:, 3:], COUNTS[:, :3], np.degrees(SI[:, 3:])]),
            walk().time_s * 1e6,
        ),
        [
            "skip_rows = 3",
            'unit = "us"',
            'columns = ["accSmooth[0]"',
            "sensitivity = 4096   # ? from gravity",
            'unit = "dps"\n',
            "no quantity: axisP[0]",
        ],
    ),
    "milliseconds, tabs": (
        text_of("millis,acc.x,acc.y,acc.z,rot.x,rot.y,rot.z", SI, walk().time_s * 1000).replace(",", "\t"),
        ['delimiter = "\\t"', 'column = "millis"', 'unit = "ms"'],
    ),
    "ties": (text_of("t,ax,ay,az,gx,gy,gz", SI, np.floor(walk().time_s * 50) / 50), ["ties = true"]),
    "a counter of microseconds": (
        text_of(
            "micros,ax,ay,az,gx,gy,gz",
            COUNTS,
            (np.rint(walk().time_s * 1e6) + 2**32 - 5_000_000) % 2**32,
            "{:d}",
        ),
        ['unit = "us"', "wraps_at = 4294967296"],
    ),
    "another range of the gyroscope": (
        text_of("t,ax,ay,az,gx,gy,gz", COUNTS // np.array([1, 1, 1, 8, 8, 8]), form="{:d}"),
        ["sensitivity = 16.375   # ? from the rotation of gravity in the accelerometer", "range = 2000"],
    ),
    "unsigned codes with an offset": (
        text_of("t,ax,ay,az,gx,gy,gz", COUNTS + 32768, form="{:d}"),
        ["offset = 32768   # ? none is negative", "sensitivity = 4096", "sensitivity = 131"],
    ),
    "two's complement read as unsigned": (
        text_of("t,ax,ay,az,gx,gy,gz", COUNTS % 65536, form="{:d}"),
        ["bits = 16   # ? none is negative", "sensitivity = 4096", "sensitivity = 131"],
    ),
    "mg and thousandths of dps": (
        text_of("t,ax,ay,az,gx,gy,gz", COUNTS / [4.096, 4.096, 4.096, 0.131, 0.131, 0.131]),
        ['unit = "mg"', 'unit = "mdps"   # ? from the size of the values'],
    ),
    "a temperature in kelvins": (
        text_of("t,ax,ay,az,gx,gy,gz,Temp", np.hstack([COUNTS, 293 + np.arange(2000)[:, None] / 997])),
        ["[[thermometer]]", 'unit = "K"'],
    ),
    "a temperature in degrees": (
        text_of("t,ax,ay,az,gx,gy,gz,Temp", np.hstack([COUNTS, 20 + np.arange(2000)[:, None] / 997])),
        ["[[thermometer]]", 'unit = "degC"   # ? from the size of the values'],
    ),
}


QUICK = ("long names with units",)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK else pytest.mark.slow if at % 2 else pytest.mark.campaign)
        for at, name in enumerate(CASES)
    ],
)
def test_a_guessed_map_imports_unchanged(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, expected = CASES[name]
    (tmp_path / "data.csv").write_text(text)
    guessed = guess_map(tmp_path / "data.csv")
    for line in expected:
        assert line in guessed, guessed
    assert "its columns state the unit" not in " ".join(guessed.replace("#", " ").split())  # maps have all of them
    (tmp_path / "map.toml").write_text(guessed)
    arguments = [str(tmp_path / "data.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]
    assert main(["import", *arguments]) == 0
    report = capsys.readouterr().out
    assert "2000 rows" in report and "?" not in report
    with open_log(tmp_path / "run.h5") as log:
        assert {sensor.quantity for sensor in log.sensors.values()} >= {"specific_force", "angular_rate"}
        assert np.linalg.norm(np.mean(log["Acc"].counts[:900], axis=0)) / log["Acc"].sensitivity == pytest.approx(
            1, rel=0.01
        )


@pytest.mark.slow
def test_a_matrix_with_time_and_padding_is_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A matrix of a MATLAB script: a row for each reading, time first, and unused rows of zeros."""
    from scipy.io import savemat

    matrix = np.vstack([np.column_stack([walk().time_s + 1, SI]), np.zeros((300, 7))])
    savemat(tmp_path / "data.mat", {"measured": matrix})
    (tmp_path / "map.toml").write_text(guess_map(tmp_path / "data.mat"))
    guessed = (tmp_path / "map.toml").read_text()
    assert 'columns = ["measured[4]", "measured[5]", "measured[6]"]' in guessed
    assert "wraps_at" not in guessed
    arguments = [str(tmp_path / "data.mat"), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]
    assert main(["import", *arguments]) == 0
    report = " ".join(capsys.readouterr().out.split())
    assert "2000 rows each over 20.0 s" in report and "300 rows of zeros only" in report


@pytest.mark.slow
@pytest.mark.parametrize("encoding", some(["cp1252", "utf-8", "utf-8-sig", "utf-16"], 1))
def test_units_of_a_spreadsheet_in_any_encoding_are_read(encoding: str, tmp_path: Path) -> None:
    """Names in German, units with ° and ², decimal commas."""
    names = [*(f"Beschl. {axis} [m/s²]" for axis in "XYZ"), *(f"Drehrate {axis} [°/s]" for axis in "XYZ")]
    values = np.hstack([SI[:, :3], np.degrees(SI[:, 3:])])
    text = text_of(",".join(["Zeit [s]", *names]), values, form="{:.5f}").replace(",", ";").replace(".", ",")
    path = tmp_path / "run.csv"
    path.write_bytes(text.replace("Beschl,", "Beschl.").encode(encoding))
    target = tmp_path / "map.toml"
    assert main(["import", str(path), "--guess", "-o", str(target)]) == 0
    assert 'columns = ["Beschl. X [m/s²]", "Beschl. Y [m/s²]", "Beschl. Z [m/s²]"]' in target.read_text("utf-8")
    assert main(["import", str(path), "--map", str(target), "-o", str(tmp_path / "run.h5")]) == 0
    with open_log(tmp_path / "run.h5") as log:
        assert [sensor.unit for sensor in log.sensors.values()] == ["g", "dps"]


@pytest.mark.slow
def test_the_file_name_gives_the_sensor(tmp_path: Path) -> None:
    """Phones write a file for each sensor, with columns x, y, z."""
    values = SI[:, 5:2:-1]
    (tmp_path / "Gyroscope.csv").write_text(text_of("seconds_elapsed,z,y,x", values))
    guessed = guess_map(tmp_path / "Gyroscope.csv")
    assert 'quantity = "angular_rate"' in guessed and 'columns = ["x", "y", "z"]' in guessed


@pytest.mark.slow
def test_consecutive_recordings_in_a_file_are_imported(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_text(text_of("t,ax,ay,az,gx,gy,gz", COUNTS, walk().time_s % 7, "{:d}"))
    text = " ".join(guess_map(tmp_path / "data.csv").replace("\n#  ", "").split())
    assert "# ~ the times went back 2 times, by 6.99 s, 6.99 s; the rows after that continue at the usual" in text
    assert "# ? the times go back:" in text and "If the file holds several recordings, import them one by one" in text
    assert "restarts = true # ?" in text and "sort = true #" not in text


@pytest.mark.slow
def test_rows_of_several_kinds_are_distinguished(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_bytes(several_tables())
    guessed = guess_map(tmp_path / "data.csv")
    result = parse_map(guessed, "guess")
    assert result.file.kind_column == 0
    assert {(sensor.kind, sensor.quantity) for sensor in result.sensor} == {
        ("ACC", "specific_force"),
        ("GYR", "angular_rate"),
    }
    assert "rows of several kinds: ACC, GYR" in guessed


@pytest.mark.slow
def test_kinds_of_equal_width_are_distinguished(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = [
        f"{kind},{stamp:.6f}," + ",".join(map(str, row[at : at + 3]))
        for stamp, row in zip(walk().time_s.tolist(), COUNTS.tolist(), strict=True)
        for kind, at in (("ACC", 0), ("GYR", 3))
    ]
    (tmp_path / "data.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "map.toml").write_text(guess_map(tmp_path / "data.csv"))
    arguments = [str(tmp_path / "data.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]
    assert main(["import", *arguments]) == 0
    report = capsys.readouterr().out
    assert "2000 rows each over 20.0 s" in report and "Acc: measures 0.9998 g at rest" in report


@pytest.mark.slow
def test_an_array_in_a_separate_file_is_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "data.npy", np.column_stack([walk().time_s, COUNTS]))
    (tmp_path / "map.toml").write_text(guess_map(tmp_path / "data.npy"))
    arguments = [str(tmp_path / "data.npy"), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]
    assert main(["import", *arguments]) == 0
    with open_log(tmp_path / "run.h5") as log:
        assert np.array_equal(log["Acc"].counts[:], COUNTS[:, :3])
        assert np.array_equal(log["Gyro"].counts[:], COUNTS[:, 3:])


@pytest.mark.parametrize("data", [b"", b"\0" * 100, b"nothing but\nwords in it\n", bytes(range(256)) * 40])
def test_data_that_no_map_can_describe_is_refused(
    data: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "data.csv").write_bytes(data)
    assert main(["import", str(tmp_path / "data.csv"), "--guess"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_guess_does_not_overwrite_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "data.csv").write_text(CASES["short names"][0])
    (tmp_path / "map.toml").write_text("mine")
    assert main(["import", str(tmp_path / "data.csv"), "--guess", "-o", str(tmp_path / "map.toml")]) == 2
    assert (tmp_path / "map.toml").read_text() == "mine"
    assert main(["import", str(tmp_path / "data.csv"), "--guess", "-o", str(tmp_path / "data.csv"), "--force"]) == 2
    assert main(["import", str(tmp_path / "data.csv"), "--guess", "--up", "+Z"]) == 2


@pytest.mark.slow
def test_units_are_distinguished_by_the_last_part_of_a_name(tmp_path: Path) -> None:
    """Counts of two units, gyroscopes with a bias: gravity is not searched for in them."""
    columns = [f"imu{unit}_{letter}{axis}" for unit in (0, 1) for letter in "agm" for axis in "xyz"]
    rows = "".join(f"{number},0,1,4096,33,65,98,200,10,300,3,2,4095,30,60,90,210,20,290\n" for number in range(300))
    (tmp_path / "data.csv").write_text(",".join(["t_ms", *columns]) + "\n" + rows)
    quantities = re.findall(r'^quantity = "(\w+)"', guess_map(tmp_path / "data.csv"), re.MULTILINE)
    assert sorted(quantities) == sorted(["specific_force", "angular_rate", "magnetic_field"] * 2)


def test_a_second_unnamed_accelerometer_is_recognised(tmp_path: Path) -> None:
    """Both triads turn through the faces and keep their lengths, 256 and 1024 counts."""
    faces = [(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0, -1), (0, -1, 0), (-1, 0, 0)]
    rows = "".join(
        " ".join(map(str, [10_000 * number, *(256 * a for a in face), *(1024 * a for a in face)])) + "\n"
        for number in range(600)
        for face in [faces[number // 100]]
    )
    (tmp_path / "data.txt").write_text(rows)
    text = guess_map(tmp_path / "data.txt")
    assert re.findall(r'^quantity = "(\w+)"', text, re.MULTILINE) == ["specific_force"] * 2
    assert "sensitivity = 1024" in text


def test_a_single_row_raises_no_warning(tmp_path: Path) -> None:
    """One row has no step of time; warnings are errors here."""
    (tmp_path / "one.csv").write_text(text_of("t,ax,ay,az,gx,gy,gz", COUNTS[:1], walk().time_s[:1], form="{:d}"))
    assert 'column = "t"' in guess_map(tmp_path / "one.csv")


@pytest.mark.parametrize(
    ("day", "unit", "first"),
    [
        ("06.05.2024", "%d.%m.%Y", "2024-05-06"),
        ("2024/05/06", "%Y/%m/%d", "2024-05-06"),
        ("2024-05-06", "%Y-%m-%d", "2024-05-06"),
        ("26/05/2024", "%d/%m/%Y", "2024-05-26"),
        ("05/06/2024", "%m/%d/%Y", "2024-05-06"),
    ],
)
def test_a_date_in_a_column_of_its_own_dates_the_times_of_day(tmp_path: Path, day: str, unit: str, first: str) -> None:
    rows = [
        f"{day};12:00:{second:02.0f},{part:03d};0.01;-0.02;{1.0 + 1e-3 * (part % 7):.3f}"
        for second in range(60)
        for part in range(0, 1000, 50)
    ]
    source = tmp_path / "day.csv"
    source.write_text("\n".join(["Datum;Uhrzeit;ax [g];ay [g];az [g]", *rows]) + "\n")
    table_map = guess_map(source)
    assert f'date_column = "Datum"\nunit = "{unit} %H:%M:%S.%f"' in table_map
    is_ambiguous = day.startswith("05/")
    assert ("the month may come after the day" in table_map) == is_ambiguous
    (tmp_path / "map.toml").write_text(table_map)
    run = tmp_path / "day.h5"
    assert main(["import", str(source), "--map", str(tmp_path / "map.toml"), "-o", str(run)]) == 0
    with open_log(run) as log:
        assert np.datetime64(int(log["Acc"].time[0]), "ns") == np.datetime64(f"{first}T12:00:00", "ns")
        assert int(log["Acc"].time[-1]) - int(log["Acc"].time[0]) == 59_950_000_000


def test_a_force_in_gal_may_be_taken_for_mg_and_the_map_says_so(tmp_path: Path) -> None:
    source = tmp_path / "gal.csv"
    source.write_text(text_of("t,ax,ay,az", SI[:, :3] * 100))
    assert 'unit = "mg"   # ? from the size of the values: 98' in guess_map(source)
    assert "1 g in gal (cm/s2) would be 980.7" in guess_map(source)
    source.write_text(text_of("t,ax,ay,az", COUNTS[:, :3] / 4096 * 1000, form="{:.2f}"))
    assert "in gal (cm/s2)" not in guess_map(source)


@pytest.mark.slow
def test_sensors_whose_columns_have_the_same_names_are_all_imported(tmp_path: Path) -> None:
    """The second board is mounted upside down, so that the signs show which columns were taken."""
    both = np.hstack([SI, -SI])
    (tmp_path / "data.csv").write_text(text_of("t,ax,ay,az,gx,gy,gz,ax,ay,az,gx,gy,gz", both))
    (tmp_path / "map.toml").write_text(guess_map(tmp_path / "data.csv"))
    assert (
        main(
            ["import", str(tmp_path / "data.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]
        )
        == 0
    )
    with open_log(tmp_path / "run.h5") as log:
        assert list(log.sensors) == ["Acc", "Acc2", "Gyro", "Gyro2"]
        for name, first in (("Acc", 0), ("Acc2", 6)):
            value = log[name].counts[:] / log[name].sensitivity * G
            np.testing.assert_allclose(value, both[:, first : first + 3], atol=2e-3)


@pytest.mark.parametrize(
    ("days", "day_format"),
    [
        (["12/05/2024", "1/11/2024"], "%m/%d/%Y"),
        (["12/05/2024", "13/05/2024"], "%d/%m/%Y"),
        (["5.12.2024"], "%d.%m.%Y"),
        (["2024-12-05"], "%Y-%m-%d"),
        (["2024/12/5"], "%Y/%m/%d"),
        (["12/05/24"], ""),
    ],
)
def test_a_first_number_beyond_twelve_is_a_day(days: list[str], day_format: str) -> None:
    layout = TextLayout()
    note_days(layout, [["0.5", f" {day}"] for day in days])
    assert (layout.day_column, layout.day_format) == ((1, day_format) if day_format else (None, ""))


def test_the_second_column_of_a_name_has_its_unit_and_numbers_are_no_names() -> None:
    apart, units = _tell_apart(["t", "ax", "ay", "ax", "1", "1", "", ""], {"ax": "m/s2", "1": "V"})
    assert apart == ["t", "ax", "ay", "2.ax", "1", "1", "", ""]
    assert units == {"ax": "m/s2", "2.ax": "m/s2", "1": "V"}


@pytest.mark.parametrize(
    ("counts", "line"),
    [
        (np.arange(1000) % 256, ["wraps_at = 256"]),
        (np.arange(100) % 16, ["wraps_at = 16"]),
        (np.arange(100) % 8, []),
        (np.arange(1000) % 200, []),
        (1 + np.arange(1000) % 255, []),
        (np.arange(256), []),
        (np.append(np.arange(1000) % 256, 130), []),
    ],
    ids=["8 bits", "4 bits", "too few bits", "no power of two", "begins at 1", "no fall", "falls by less than half"],
)
def test_only_a_fall_from_the_largest_number_of_some_bits_is_a_wrap(counts: np.ndarray, line: list[str]) -> None:
    assert _power_of_two_wrap(counts.astype(float)) == line


@pytest.mark.slow
def test_a_counter_of_eight_bits_wraps(tmp_path: Path) -> None:
    """Rows 700 and 701 are missing; the rest is at 100 Hz, as assumed."""
    rows = np.delete(np.arange(2000), [700, 701])
    lines = (f"{row % 256}," + ",".join(map(str, COUNTS[row].tolist())) for row in rows.tolist())
    (tmp_path / "data.csv").write_text("seq,ax,ay,az,gx,gy,gz\n" + "\n".join(lines) + "\n")
    text = guess_map(tmp_path / "data.csv")
    assert "ticks = 0.01   # ? 100 rows a second\nwraps_at = 256\n" in text
    assert "restarts" not in text
    (tmp_path / "map.toml").write_text(text)
    assert (
        main(
            ["import", str(tmp_path / "data.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]
        )
        == 0
    )
    with open_log(tmp_path / "run.h5") as log:
        np.testing.assert_array_equal(log["Acc"].time[:], rows * 10_000_000)


@pytest.mark.slow
@pytest.mark.parametrize(("gravity", "is_doubted"), [(1000, True), (1024, False)])
def test_whole_numbers_that_may_be_in_mg_are_doubted(tmp_path: Path, gravity: int, is_doubted: bool) -> None:
    """Gravity is 1000 in one direction: mg, or 1024 counts per g of a part that is 2 % off. 1024 is the latter."""
    (tmp_path / "data.csv").write_text(
        text_of("t,ax,ay,az,gx,gy,gz", np.rint(COUNTS * np.array([gravity / 4096] * 3 + [1.0] * 3)), form="{:.0f}")
    )
    text = " ".join(guess_map(tmp_path / "data.csv").replace("\n#  ", "").split())
    assert f"sensitivity = 1024 # ? from gravity: {gravity} counts" in text
    doubt = f"# ? Acc: gravity is {gravity}: 1024 counts per g are assumed; if the columns are in mg, replace"
    assert (doubt in text) == is_doubted


@pytest.mark.slow
def test_a_stated_unit_that_maps_do_not_have_is_doubted(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_text(
        text_of("t [s],ax [yd/s^2],ay [yd/s^2],az [yd/s^2],wx (raw),wy (raw),wz (raw)", SI / 0.9144)
    )
    text = " ".join(guess_map(tmp_path / "data.csv").replace("\n#  ", "").split())
    assert "Acc: its columns state the unit 'yd/s^2', which maps do not have: m/s2 is assumed; enter one" in text
    assert "Gyro: its columns state" not in text
