"""Layouts of other recordings: several clocks, files and instances, dates in other formats, unsigned codes."""

from __future__ import annotations

import io
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from imuarray.cli import main
from imuarray.errors import SourceError
from imuarray.importers.cells import CellColumn, TextTable, TimeColumn
from imuarray.importers.column_meaning import propose_columns
from imuarray.importers.column_names import unit_in
from imuarray.importers.guess import guess_map
from imuarray.importers.mapping import FileTable
from imuarray.importers.plausibility import report_of, turns_of
from imuarray.importers.table import import_table
from imuarray.importers.text_layout import TextLayout, read_text
from imuarray.log import open_log
from tests.importers.recordings import PER_DPS, PER_G, ROWS, G, counts_of, joined, lines_of, walk
from tests.selection import some

HEADER = "t,ax,ay,az,gx,gy,gz"
WALK = walk()
BOTH = np.hstack([WALK.force_g, WALK.rate_dps])


def imported(source: Path, tmp_path: Path) -> tuple[str, Path]:
    """The proposed map of a recording, and the imported log."""
    text = guess_map(source)
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    import_table(source, tmp_path / "map.toml", tmp_path / "run.h5")
    return text, tmp_path / "run.h5"


def written(tmp_path: Path, data: bytes, name: str = "data.csv") -> Path:
    (tmp_path / name).write_bytes(data)
    return tmp_path / name


@pytest.mark.slow
def test_each_sensor_of_a_wide_table_has_its_own_clock(tmp_path: Path) -> None:
    half = ROWS // 2
    lines = ["ACC_Time,ACC_X_g,ACC_Y_g,ACC_Z_g,GYR_Time,GYR_X_dps,GYR_Y_dps,GYR_Z_dps"]
    for row in range(ROWS):
        force = ",".join(f"{value:.5f}" for value in WALK.force_g[row])
        rate = ",".join(f"{value:.4f}" for value in WALK.rate_dps[2 * row]) if row < half else ",,"
        stamp = f"{WALK.time_s[2 * row] + 0.004:.3f}" if row < half else ""
        lines.append(f"{WALK.time_s[row]:.3f},{force},{stamp},{rate}")
    text, path = imported(written(tmp_path, joined(lines)), tmp_path)
    assert 'time_column = "GYR_Time"' in text
    with open_log(path) as log:
        assert np.asarray(log["Gyro"].time[:3]).tolist() == [4_000_000, 24_000_000, 44_000_000]
        assert np.asarray(log["Acc"].time[:3]).tolist() == [0, 10_000_000, 20_000_000]
        assert (len(log["Gyro"]), len(log["Acc"])) == (half, ROWS)


@pytest.mark.slow
def test_a_folder_of_one_file_a_sensor_is_one_recording(tmp_path: Path) -> None:
    """An export of a phone: columns z, y, x, epochs in ns, SI units that no header states."""
    phone = tmp_path / "phone"
    phone.mkdir()
    for name, values, late_ns in (
        ("TotalAcceleration", WALK.force_g * G, 0),
        ("Gyroscope", np.radians(WALK.rate_dps), 2_500_000),
    ):
        rows = [
            f"{1_726_480_000_000_000_000 + late_ns + row * 10_000_000},{row * 0.01:.3f},"
            + ",".join(f"{value:.7f}" for value in values[row, ::-1])
            for row in range(ROWS)
        ]
        (phone / f"{name}.csv").write_bytes(joined(["time,seconds_elapsed,z,y,x", *rows]))
    (phone / "Metadata.csv").write_text("device,platform\nPhone,android\n", encoding="utf-8")
    text, path = imported(phone, tmp_path)
    assert 'kind = "Gyroscope"' in text
    assert "left out: " in text and "Metadata.csv" in text
    with open_log(path) as log:
        assert list(log.sensors) == ["Gyroscope", "TotalAcceleration"]
        first = {name: int(log[name].time[0]) for name in log.sensors}
        assert first["Gyroscope"] - first["TotalAcceleration"] == 2_500_000
        still = np.asarray(log["TotalAcceleration"].counts[: ROWS // 2]) / log["TotalAcceleration"].sensitivity
        assert still.mean(axis=0) == pytest.approx([0, 0, 1], abs=2e-3)
        assert report_of(log).doubts == ()


def test_a_folder_without_the_file_lists_its_files(tmp_path: Path) -> None:
    (tmp_path / "phone").mkdir()
    with pytest.raises(SourceError, match=r"no ROS 2 bag, and has no \.csv"):
        guess_map(tmp_path / "phone")
    (tmp_path / "phone" / "Gyro.csv").write_bytes(joined([HEADER, *lines_of(WALK.time_s, BOTH)]))
    (tmp_path / "map.toml").write_text(
        'time = { column = "t", unit = "s" }\n[[sensor]]\nname = "Gyro"\nchip = "any"\nquantity = "angular_rate"\n'
        'columns = ["gx", "gy", "gz"]\nunit = "dps"\nkind = "Gyroscope"\n',
        encoding="utf-8",
    )
    with pytest.raises(SourceError, match=r"no file 'Gyroscope'; the kind .* is the name of its file: Gyro$"):
        import_table(tmp_path / "phone", tmp_path / "map.toml", tmp_path / "run.h5")


@pytest.mark.slow
def test_alternate_rows_of_two_instances_become_two_sensors(tmp_path: Path) -> None:
    lines = ["timestamp,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"]
    for row in range(ROWS):
        for instance in (0, 1):
            rate = ",".join(f"{value:.6f}" for value in np.radians(WALK.rate_dps[row] + instance))
            force = ",".join(f"{value:.5f}" for value in WALK.force_g[row] * G)
            lines.append(f"{WALK.time_s[row]:.3f},{instance},{rate},{force}")
    text, path = imported(written(tmp_path, joined(lines)), tmp_path)
    assert "kind_column = 1" in text
    with open_log(path) as log:
        assert sorted(log.sensors) == ["Acc", "Acc2", "Gyro", "Gyro2"]
        means = [np.asarray(log[name].counts[:]).mean(axis=0) / log[name].sensitivity for name in ("Gyro", "Gyro2")]
        assert means[1] - means[0] == pytest.approx([1, 1, 1], abs=0.01)
        assert len(log["Gyro2"]) == ROWS


@pytest.mark.slow
def test_the_format_rows_of_a_log_name_the_columns_of_each_kind(tmp_path: Path) -> None:
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 140, 49, IMU, QBffffff, TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
        "FMT, 141, 30, MAG, QBhhh, TimeUS,I,MagX,MagY,MagZ",
    ]
    for row in range(ROWS):
        us = 5_000_000 + row * 10_000
        rate = ", ".join(f"{value:.6f}" for value in np.radians(WALK.rate_dps[row]))
        force = ", ".join(f"{value:.5f}" for value in WALK.force_g[row] * G)
        lines.append(f"IMU, {us}, 0, {rate}, {force}")
        if row % 10 == 0:
            lines.append(f"MAG, {us}, 0, {200 + row % 7}, {row // 10 % 5}, {row % 3 - 420}")
    text, path = imported(written(tmp_path, joined(lines), "flight.log"), tmp_path)
    assert 'kind = "IMU"' in text
    assert "columns = [6, 7, 8]" in text
    assert "columns = [3, 4, 5]" in text
    with open_log(path) as log:
        assert (len(log["Acc"]), len(log["Mag"])) == (ROWS, ROWS // 10)
        assert report_of(log).doubts == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("written_as", "unit"),
    [
        ("%d.%m.%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f"),
        pytest.param("%Y/%m/%d %H:%M:%S.%f", "%Y/%m/%d %H:%M:%S.%f", marks=pytest.mark.slow),
        pytest.param("%m/%d/%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S.%f", marks=pytest.mark.slow),
        pytest.param("%H:%M:%S.%f", "%H:%M:%S.%f", marks=pytest.mark.slow),
        pytest.param("%Y%m%dT%H%M%S.%f", "%Y%m%dT%H%M%S.%f", marks=pytest.mark.slow),
    ],
)
def test_dates_of_other_formats_are_proposed_and_read_over_midnight(written_as: str, unit: str, tmp_path: Path) -> None:
    begin = datetime(2024, 9, 9, 23, 59, 50)
    stamps = [(begin + timedelta(milliseconds=10 * row)).strftime(written_as) for row in range(ROWS)]
    rows = [f"{stamp};" + ";".join(f"{v:.5f}" for v in row) for stamp, row in zip(stamps, BOTH.tolist(), strict=True)]
    text, path = imported(
        written(tmp_path, joined([HEADER.replace("t", "when", 1).replace(",", ";"), *rows])), tmp_path
    )
    assert f'unit = "{unit}"' in text
    with open_log(path) as log:
        time = np.asarray(log["Acc"].time[:], np.int64)
        assert np.unique(np.diff(time)).tolist() == [10_000_000]
        since_midnight = 86_390 * 10**9
        # 2024-09-09 is the 19 975th day after 1970-01-01 (54 years, of which 14 leap, and 252 days).
        days = 0 if unit == "%H:%M:%S.%f" else 54 * 365 + 13 + 252
        assert int(time[0]) == days * 86_400 * 10**9 + since_midnight


def test_a_fraction_of_a_formatted_date_has_up_to_nine_digits() -> None:
    texts = ["16.09.2024 00:00:00", "16.09.2024 00:00:00,000000001", "16.09.2024 00:00:01.5"]
    column = CellColumn("data.csv", "'t'", [2, 3, 4], texts)
    times = TimeColumn("%d.%m.%Y %H:%M:%S.%f").nanoseconds(column)
    assert (times - times[0]).tolist() == [0, 1, 1_500_000_000]
    with pytest.raises(SourceError, match="line 2, column 't': '16/09/2024' is not a date and time in the format"):
        TimeColumn("%d.%m.%Y %H:%M:%S.%f").nanoseconds(column._replace(texts=["16/09/2024", *texts[1:]]))


@pytest.mark.parametrize("unit", some(["%d.%m.%Y", "%H:%M:%Q", "fortnight"], 1))
def test_an_unknown_unit_of_time_is_refused_with_the_allowed_ones(
    unit: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = written(tmp_path, joined([HEADER, *lines_of(WALK.time_s[:20], BOTH[:20])]))
    text = guess_map(source).replace('unit = "s"', f'unit = "{unit}"', 1)
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    assert main(["import", str(source), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]) == 2
    message = capsys.readouterr().err
    assert "map.toml" in message
    assert "%H" in message


@pytest.mark.slow
def test_rows_out_of_order_keep_their_time_column_and_are_sorted(tmp_path: Path) -> None:
    order = np.arange(ROWS)
    order[10::50], order[12::50] = order[12::50].copy(), order[10::50].copy()
    source = written(tmp_path, joined([HEADER, *lines_of(WALK.time_s[order], BOTH[order])]))
    text = guess_map(source)
    assert 'column = "t"' in text
    assert "sort = true   # rows are out of order" in text
    (tmp_path / "map.toml").write_text(text.replace("sort = true", ""), encoding="utf-8")
    with pytest.raises(SourceError, match=r"line 13, .* for rows out of order, sort = true"):
        import_table(source, tmp_path / "map.toml", tmp_path / "run.h5")


@pytest.mark.slow
@pytest.mark.parametrize(("middle", "per_g"), [(512, 100), (2048, 400), (128, 30)])
def test_the_middle_of_an_unsigned_converter_is_proposed_as_offset(middle: int, per_g: int, tmp_path: Path) -> None:
    codes = np.rint(middle + WALK.force_g * per_g).astype(int)
    source = written(tmp_path, joined(["t,ax,ay,az", *lines_of(WALK.time_s, codes, "{:d}")]))
    text, path = imported(source, tmp_path)
    assert f"offset = {middle} " in text
    with open_log(path) as log:
        assert log["Acc"].sensitivity == pytest.approx(per_g, rel=0.12)
        assert log["Acc"].range * log["Acc"].sensitivity == middle
        assert report_of(log).doubts == ()


@pytest.mark.slow
def test_codes_with_an_undeclared_offset_are_doubted(tmp_path: Path) -> None:
    codes = np.rint(512 + WALK.force_g * 100).astype(int)
    source = written(tmp_path, joined(["t,ax,ay,az", *lines_of(WALK.time_s, codes, "{:d}")]))
    lines = [line for line in guess_map(source).splitlines() if not line.startswith("offset")]
    (tmp_path / "map.toml").write_text("\n".join(lines), encoding="utf-8")
    import_table(source, tmp_path / "map.toml", tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        assert any("are they unsigned, with an offset?" in text for text in report_of(log).doubts)


@pytest.mark.slow
def test_linear_acceleration_is_omitted_if_the_full_one_exists(tmp_path: Path) -> None:
    linear = np.hstack([np.ones((ROWS, 1)), np.zeros((ROWS, 3)), BOTH, WALK.force_g - [0, 0, 1]])
    header = "t,qw,qx,qy,qz,ax,ay,az,gx,gy,gz,lin_acc_x,lin_acc_y,lin_acc_z"
    text, path = imported(written(tmp_path, joined([header, *lines_of(WALK.time_s, linear)])), tmp_path)
    assert "left out: computed by software, according to their names" in text
    with open_log(path) as log:
        assert list(log.sensors) == ["Acc", "Gyro"]


@pytest.mark.slow
@pytest.mark.parametrize("true_scale", [1.0, 0.5, 131 / 57.142857])
def test_the_scale_of_a_gyroscope_is_estimated_from_quick_turns(true_scale: float, tmp_path: Path) -> None:
    """Turns of up to 2.2 rad/s: each step is turned exactly, by Rodrigues' formula."""
    time_s = np.arange(4000) * 0.01
    rate = np.stack([1.5 * np.sin(1.9 * time_s), 1.2 * np.sin(2.3 * time_s + 1), np.sin(1.4 * time_s)], axis=1)
    force = np.empty((4000, 3))
    force[0] = [0, 0, 1]
    for row in range(3999):
        turn = (rate[row] + rate[row + 1]) / 2 * 0.01
        angle = np.linalg.norm(turn)
        axis, f = -turn / max(angle, 1e-12), force[row]
        force[row + 1] = f * np.cos(angle) + np.cross(axis, f) * np.sin(angle) + axis * (axis @ f) * (1 - np.cos(angle))
    noise = np.random.default_rng(8).normal(0, [4e-3] * 3 + [0.1] * 3, (4000, 6))
    values = np.hstack([force, np.degrees(rate) / true_scale]) + noise
    counts = np.rint(values * np.array([PER_G] * 3 + [PER_DPS / 4] * 3)).astype(int)
    source = written(tmp_path, joined([HEADER, *lines_of(time_s, counts, "{:d}")]))
    (tmp_path / "map.toml").write_text(
        'time = { column = "t", unit = "s" }\n[[sensor]]\nname = "Acc"\nchip = "any"\nquantity = "specific_force"\n'
        'columns = ["ax", "ay", "az"]\nunit = "g"\nrange = 8\nsensitivity = 4096\n[[sensor]]\nname = "Gyro"\n'
        'chip = "any"\nquantity = "angular_rate"\ncolumns = ["gx", "gy", "gz"]\nunit = "dps"\nrange = 1000\n'
        "sensitivity = 32.75\n",
        encoding="utf-8",
    )
    import_table(source, tmp_path / "map.toml", tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        assert turns_of(log) == pytest.approx(true_scale, rel=0.02)


@pytest.mark.slow
def test_rows_with_equal_times_are_reported(tmp_path: Path) -> None:
    stamps = np.floor(WALK.time_s * 5) / 5
    source = written(tmp_path, joined([HEADER, *lines_of(stamps, counts_of(WALK), "{:d}")]))
    text, path = imported(source, tmp_path)
    assert "ties = true" in text
    with open_log(path) as log:
        report = report_of(log)
    assert "several rows have the same time, and the next time is 0.2 s later" in " ".join(report.doubts)
    assert "in bursts" not in " ".join([*report.doubts, *report.quirks])


def quantities(path: Path) -> dict[str, tuple[str, int, np.ndarray]]:
    """Quantity, number of rows and mean in g or dps of each triad."""
    with open_log(path) as log:
        return {
            name: (sensor.quantity, len(sensor), np.asarray(sensor.counts[:]).mean(axis=0) / sensor.sensitivity)
            for name, sensor in log.sensors.items()
            if sensor.is_triad
        }


@pytest.mark.slow
def test_rows_with_the_sensor_named_in_a_column_are_separated(tmp_path: Path) -> None:
    """One row for each reading, where the app of a phone writes all sensors into one file; the columns are z, y, x."""
    lines = ["time,seconds_elapsed,sensor,z,y,x"]
    for row in range(0, ROWS, 2):
        stamp = 1_730_000_000_000_000_000 + row * 10_000_000
        for late_ns, name, values in (
            (0, "Accelerometer", WALK.force_g[row] * G),
            (1_200_000, "Gyroscope", np.radians(WALK.rate_dps[row])),
        ):
            cells = ",".join(f"{value:.6f}" for value in values[::-1])
            lines.append(f"{stamp + late_ns},{row * 0.01:.3f},{name},{cells}")
    text, path = imported(written(tmp_path, joined(lines)), tmp_path)
    assert "kind_column = 2" in text and 'kind = "Gyroscope"' in text
    triads = quantities(path)
    assert {name: triad[:2] for name, triad in triads.items()} == {
        "Acc": ("specific_force", ROWS // 2),
        "Gyro": ("angular_rate", ROWS // 2),
    }
    assert triads["Acc"][2] == pytest.approx(WALK.force_g[::2].mean(axis=0), abs=1e-3)
    assert triads["Gyro"][2] == pytest.approx(WALK.rate_dps[::2].mean(axis=0), abs=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("brackets", ["[]", "()", ""])
def test_a_row_of_units_identifies_names_in_another_language(brackets: str, tmp_path: Path) -> None:
    """A data logger of a laboratory: a preamble, names, units below them, decimal commas."""
    opening, closing = (brackets[:1], brackets[1:])
    units = [f"{opening}{unit}{closing}" for unit in ("s", "m/s²", "m/s²", "m/s²", "°/s", "°/s", "°/s", "°C")]
    lines = ["Messprotokoll", "Start:;28.11.2026 14:03:12", "Abtastrate:;100;Hz"]
    lines += ["Zeit;Besch_X;Besch_Y;Besch_Z;Drehr_X;Drehr_Y;Drehr_Z;Temperatur", ";".join(units)]
    for stamp, row in zip(WALK.time_s, BOTH * [G, G, G, 1, 1, 1], strict=True):
        cells = [f"{stamp:.3f}", *(f"{value:.4f}" for value in row), "23.40"]
        lines.append(";".join(cells).replace(".", ","))
    text, path = imported(written(tmp_path, ("\r\n".join(lines) + "\r\n").encode("cp1252")), tmp_path)
    assert '"degC"' in text
    triads = quantities(path)
    assert triads["Acc"][2] == pytest.approx(WALK.force_g.mean(axis=0), abs=1e-3)
    assert triads["Gyro"][:2] == ("angular_rate", ROWS)
    assert triads["Gyro"][2] == pytest.approx(WALK.rate_dps.mean(axis=0), abs=1e-2)


@pytest.mark.slow
def test_a_column_of_comments_without_cells_is_accepted(tmp_path: Path) -> None:
    """A measurement file of LabVIEW: two heads, tabs, and a name "Comment" without a cell in any row; a header that is
    longer than the rows for another reason is refused.
    """
    head = [
        "LabVIEW Measurement\t",
        "Separator\tTab",
        "***End_of_Header***\t",
        "Channels\t6\t",
        "***End_of_Header***\t",
    ]
    names = ["X_Value", "Acc X", "Acc Y", "Acc Z", "Gyro X", "Gyro Y", "Gyro Z", "Comment"]
    rows = [
        "\t".join([f"{stamp:.6f}", *(f"{value:.6f}" for value in row)])
        for stamp, row in zip(WALK.time_s, BOTH, strict=True)
    ]
    _, path = imported(written(tmp_path, joined([*head, "\t".join(names), *rows]), "run.lvm"), tmp_path)
    assert quantities(path)["Gyro"][2] == pytest.approx(WALK.rate_dps.mean(axis=0), abs=1e-2)
    odd = joined([*head, "\t".join([*names[:-1], "Force"]), *rows])
    assert "7 cells, the first row has 8" in guess_map(written(tmp_path, odd, "odd.lvm"))


@pytest.mark.slow
def test_a_unit_of_time_with_a_factor_is_read(tmp_path: Path) -> None:
    """The counter of a Bosch chip: ticks of 39.0625 us, 24 bits; without the factor the rate would be 3.9 kHz."""
    ticks = (np.rint(WALK.time_s / 39.0625e-6).astype(int) + (1 << 24) - 200_000) % (1 << 24)
    counts = counts_of(WALK)
    head = "Acc-X[LSB], Acc-Y[LSB], Acc-Z[LSB], Gyr-X[LSB], Gyr-Y[LSB], Gyr-Z[LSB], Sensor Time[39.0625us]"
    lines = [", ".join(map(str, [*row, tick])) for row, tick in zip(counts.tolist(), ticks.tolist(), strict=True)]
    text, path = imported(written(tmp_path, joined(["Board: APP3.1", head, *lines])), tmp_path)
    assert "ticks = 39.0625" in text and "wraps_at = 16777216" in text
    with open_log(path) as log:
        seconds = (int(log["Acc"].time[-1]) - int(log["Acc"].time[0])) * 1e-9
    assert seconds == pytest.approx((ROWS - 1) / 100, abs=1e-4)


def test_a_header_in_a_comment_above_rows_that_hold_a_word() -> None:
    """`rostopic echo -p` writes "%time,..." above rows with the frame_id of each message."""
    text = b"%time,field.header.frame_id,x,y\n1,imu,2,3\n2,imu,4,5\n"
    table = TextTable(io.BytesIO(text), "echo.csv", FileTable(comment="%"), named=True)
    assert table.names == ["time", "field.header.frame_id", "x", "y"]
    assert [row for block in table.blocks() for row in zip(*block.columns, strict=True)] == [
        ("1", "imu", "2", "3"),
        ("2", "imu", "4", "5"),
    ]


@pytest.mark.parametrize(
    ("name", "unit"),
    [("ax_m/s^2", "m/s2"), ("ax_m/s2", "m/s2"), ("gx_rad/s", "rad/s"), ("gx_deg/s", "dps"), ("gx_°/s", "dps")],
)
def test_units_after_an_underscore_are_read(name: str, unit: str) -> None:
    assert unit_in(name) == unit


def test_a_sensor_with_a_column_of_two_axes_only_is_named() -> None:
    names = ["t", "AccX", "AccY", "AccZ", "gx_dps", "gz_dps", "max_x"]
    columns = [np.arange(40.0) * 10, *np.tile([0.01, 0.02, 1.0, 3.0, 4.0, 5.0], (40, 1)).T]
    doubts = propose_columns(TextLayout(), names, columns, {}).doubts
    assert doubts == ['left out: "gx_dps", "gz_dps": no column of axis y; a sensor needs three axes']


def test_lines_that_end_with_a_carriage_return_alone(tmp_path: Path) -> None:
    path = written(tmp_path, b"t,ax,ay,az\r0,0,0,1\r1,0,0,1\r")
    _, names, rows = read_text(path)
    assert names == ["t", "ax", "ay", "az"]
    assert rows == [["0", "0", "0", "1"], ["1", "0", "0", "1"]]


def test_a_time_that_a_spreadsheet_rounded_is_named() -> None:
    names = ["timestamp", "ax_g", "ay_g", "az_g"]
    columns = [np.full(40, 1.7e12), *np.tile([0.01, 0.02, 1.0], (40, 1)).T]
    (doubt,) = propose_columns(TextLayout(), names, columns, {}).doubts
    assert doubt.startswith("column 'timestamp' has 1 value in 40 rows, the first 1.7e+12, and no row has a time")
    assert doubt.endswith("100 rows a second are assumed")


def test_a_scale_that_a_recording_at_rest_does_not_show_is_doubted(tmp_path: Path) -> None:
    counts = counts_of(walk(rows=200, still=True))
    text = guess_map(written(tmp_path, joined([HEADER, *lines_of(WALK.time_s[:200], counts, "{:d}")])))
    assert "# ? Gyro: 131 counts per dps are assumed, as no rotation shows the scale" in text
