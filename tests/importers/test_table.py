"""Text tables are imported by their map; a wrong cell is named by file, line and column, and no file remains."""

from __future__ import annotations

import gzip
import tracemalloc
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.calibrate.segments import chip_thermometer, degc_of
from imuarray.cli import main
from imuarray.errors import ConfigError, ImuArrayError, OutputExistsError, SourceError
from imuarray.importers import ImportSummary
from imuarray.importers.table import import_table
from imuarray.log import open_log
from imuarray.log.format import LOST_BEFORE, SATURATED, ThermometerScale
from imuarray.simulate.motion.like import LikeLog
from tests.selection import examples, some

SENSOR = """
[[sensor]]
name = "A"
chip = "bma180"
quantity = "specific_force"
columns = ["x", "y", "z"]
range = 16
unit = "g"
sensitivity = 512
"""
NAMED = '[time]\ncolumn = "t"\nunit = "s"\n' + SENSOR
NUMBERED = NAMED.replace('"t"', "0").replace('["x", "y", "z"]', "[1, 2, 3]")
RATE = "[time]\nrate_hz = 100\n" + NUMBERED[NUMBERED.index("[[sensor]]") :].replace("[1, 2, 3]", "[0, 1, 2]")


def write(
    folder: Path, table: str | bytes, table_map: str, *, force: bool = False, block_rows: int = 4096
) -> ImportSummary:
    (folder / "map.toml").write_text(table_map, encoding="utf-8")
    (folder / "data.csv").write_bytes(table.encode() if isinstance(table, str) else table)
    out = folder / "out.h5"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("imuarray.importers.table.ROWS", block_rows)
        return import_table(folder / "data.csv", folder / "map.toml", out, force=force)


def counts_and_times(folder: Path, name: str = "A") -> tuple[list[list[int]], list[int]]:
    with open_log(folder / "out.h5") as log:
        return log[name].counts[:].tolist(), log[name].time[:].tolist()


def refused(folder: Path, table: str | bytes, table_map: str, error: type[ImuArrayError] = SourceError) -> str:
    """The error message, after a check that no new file remains."""
    with pytest.raises(error) as caught:
        write(folder, table, table_map)
    assert sorted(path.name for path in folder.iterdir()) == ["data.csv", "map.toml"]
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(f"{folder}/", "")


def test_a_table_with_a_header_is_imported(tmp_path: Path) -> None:
    summary = write(tmp_path, "t,x,y,z\n0.5,1,-2,3\n0.51,4,5,-6\n", NAMED)
    assert summary == ImportSummary(("A",), 2, None, 0.01)
    assert counts_and_times(tmp_path) == ([[1, -2, 3], [4, 5, -6]], [500_000_000, 510_000_000])
    with open_log(tmp_path / "out.h5") as log:
        sensor = log["A"]
        assert (sensor.chip, sensor.quantity, sensor.unit) == ("bma180", "specific_force", "g")
        assert (sensor.range, sensor.sensitivity, sensor.axes) == (16, 512, "+X+Y+Z")
        assert sensor.temperature_counts is None
        assert (log.source, log.epoch) == ("imported", "1970-01-01T00:00:00.000000Z")
        (event,) = log.events
        assert event.kind == "imported"
        assert "data.csv by map.toml; no wall time" in event.message
        assert not log.is_dated


def test_a_table_with_dates_is_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "t,x,y,z\n2024-05-01T10:00:00.000Z,1,-2,3\n2024-05-01T10:00:00.020Z,4,5,-6\n"
    write(tmp_path, rows, NAMED.replace('unit = "s"', 'unit = "iso8601"'))
    with open_log(tmp_path / "out.h5") as log:
        assert log.is_dated
        assert "the times are UTC" in log.events[0].message
    assert main(["info", str(tmp_path / "out.h5")]) == 0
    out = capsys.readouterr().out
    assert "rows from 2024-05-01T10:00:00.000Z to 2024-05-01T10:00:00.020Z" in out
    assert "event     0.000 s" in out and "1970" not in out


def test_the_scale_of_a_thermometer_is_imported_and_exported(tmp_path: Path) -> None:
    """The map gives it to the log, and the export returns it."""
    text = 'temperature_column = "w"\nthermometer = { zero_degc = 36.53, lsb_per_degc = 340 }\n'
    write(tmp_path, "t,x,y,z,w\n0.5,1,-2,3,-340\n0.51,4,5,-6,680\n", NAMED + text)
    assert main(["export", str(tmp_path / "out.h5"), "-o", str(tmp_path / "out.npz")]) == 0
    assert main(["import", str(tmp_path / "out.npz"), "-o", str(tmp_path / "again.h5")]) == 0
    for name in ("out.h5", "again.h5"):
        with open_log(tmp_path / name) as log:
            assert log["A"].thermometer == ThermometerScale(36.53, 340.0)
            assert degc_of(log["A"]) == (36.53, pytest.approx(1 / 340))
            warm = chip_thermometer(log, 0.005)
            assert warm is not None and warm.degc == pytest.approx([35.53, 38.53])
            assert LikeLog(log).temperature_source == "chip"


def test_a_table_compressed_by_gzip_is_imported(tmp_path: Path) -> None:
    packed = gzip.compress(b"t,x,y,z\n" + b"".join(b"%d,1,-2,3\n" % row for row in range(5000)))
    assert write(tmp_path, packed, NAMED).rows == 5000
    (tmp_path / "out.h5").unlink()
    message = refused(tmp_path, packed[:-20], NAMED)
    assert message.startswith("data.csv: after line ") and "damaged gzip data" in message


@pytest.mark.parametrize(
    ("layout", "table"),
    some(
        [
            ("", "0,1,2,3\n1,4,5,6\n"),
            ("", "0,1,2,3\r\n1,4,5,6"),
            ("", "\n# made on a Tuesday\n0, 1, 2, 3\n\n  # later\n1,4,5,6\n\n"),
            ("", "0,1.0,2.000,3e0\n+1,4,5,6\n"),
            ("", '"0","1","2","3"\n1,4,5,6\n'),
            ("", "\ufeff0,1,2,3\n1,4,5,6\n"),
            ('[file]\ndelimiter = ";"\n', "0;1;2;3\n1;4;5;6\n"),
            ('[file]\ndelimiter = "\\t"\n', "0\t1\t2\t3\n1\t4\t5\t6\n"),
            ('[file]\ndelimiter = " "\n', "  0 1   2 3 \n1 4 5 6\n"),
            ("[file]\nskip_rows = 2\n", "a,b\nc,d,e\n0,1,2,3\n1,4,5,6\n"),
            ('[file]\ncomment = "%"\n', "% x\n0,1,2,3\n%1,4,5,7\n1,4,5,6\n"),
            ("", "0,1,2,3,9\n1,4,5,6,9\n"),
        ],
        3,
    ),
)
def test_layouts_of_the_same_table_give_the_same_log(tmp_path: Path, layout: str, table: str) -> None:
    write(tmp_path, table, layout + NUMBERED)
    assert counts_and_times(tmp_path) == ([[1, 2, 3], [4, 5, 6]], [0, 1_000_000_000])


def test_a_header_in_another_alphabet_after_skipped_rows_is_read(tmp_path: Path) -> None:
    write(
        tmp_path,
        "Einheit \xb5T\n t ;x; y;z\n0;1;2;3\n".encode("latin-1"),
        '[file]\ndelimiter=";"\nskip_rows=1\n' + NAMED,
    )
    assert counts_and_times(tmp_path) == ([[1, 2, 3]], [0])


def test_a_rate_replaces_a_column_of_time(tmp_path: Path) -> None:
    assert write(tmp_path, "1,2,3\n4,5,6\n7,8,9\n", RATE).seconds == pytest.approx(0.02)
    assert counts_and_times(tmp_path)[1] == [0, 10_000_000, 20_000_000]
    with open_log(tmp_path / "out.h5") as log:
        assert log["A"].rate_hz == 100


def test_a_guessed_rate_is_reported_until_its_mark_is_removed(tmp_path: Path) -> None:
    rows = "1,2,3\n4,5,6\n7,8,9\n"
    (doubt,) = write(tmp_path, rows, RATE.replace("= 100", "= 100   # ? enter the true rate")).doubts
    assert doubt.startswith("the rate of 100 rows a second, from which all times follow, is a guess;")
    (tmp_path / "out.h5").unlink()
    assert not write(tmp_path, rows, RATE.replace("= 100", "= 100   # stated by the header")).doubts


def test_a_guessed_duration_of_a_count_is_reported_until_its_mark_is_removed(tmp_path: Path) -> None:
    rows, table_map = "t,x,y,z\n0,1,2,3\n200,4,5,6\n", NAMED.replace('unit = "s"', 'unit = "s"\nticks = 0.0001', 1)
    (doubt,) = write(tmp_path, rows, table_map.replace("0.0001", "0.0001   # ? 50 rows a second")).doubts
    assert doubt == (
        "the duration of a count of the time column, 0.0001 s, from which all times follow, is a guess; if it is true,"
        " remove the question mark at ticks in the map"
    )
    (tmp_path / "out.h5").unlink()
    assert not write(tmp_path, rows, table_map).doubts


@pytest.mark.parametrize(
    ("line", "key"),
    [
        ("sensitivity = 131   # ? not determined: turns at known times are required", "sensitivity"),
        ('unit = "dps"   # ? dps or rad/s: the import report compares rotations', "unit"),
    ],
)
def test_a_guessed_scale_of_a_gyroscope_is_reported_until_its_mark_is_removed(
    tmp_path: Path, line: str, key: str
) -> None:
    lines = {"sensitivity": "sensitivity = 131", "unit": 'unit = "dps"'} | {key: line}
    table_map = RATE.replace("specific_force", "angular_rate").replace("range = 16", "range = 250")
    table_map = table_map.replace("sensitivity = 512", lines["sensitivity"]).replace('unit = "g"', lines["unit"])
    (doubt,) = write(tmp_path, "1,2,3\n4,5,6\n", table_map).doubts
    assert doubt.startswith("A: the scale of the gyroscope is a guess, and no rotation shows it; if it is true, remove")
    assert doubt.endswith(f"at {key} in the map")
    (tmp_path / "out.h5").unlink()
    assert not write(tmp_path, "1,2,3\n4,5,6\n", table_map.replace("   # ?", "   #")).doubts


def test_a_rate_does_not_drift(tmp_path: Path) -> None:
    write(tmp_path, "1,2,3\n" * 7001, RATE.replace("100", "70"))
    assert counts_and_times(tmp_path)[1][-1] == 100 * 10**9


@pytest.mark.parametrize(("unit", "time_ns"), some([("s", 10**9), ("ms", 10**6), ("us", 10**3), ("ns", 1)], 2))
def test_units_of_time_are_converted(tmp_path: Path, unit: str, time_ns: int) -> None:
    write(tmp_path, "t,x,y,z\n-1,1,2,3\n2,1,2,3\n", NAMED.replace('"s"', f'"{unit}"'))
    assert counts_and_times(tmp_path)[1] == [-time_ns, 2 * time_ns]


def test_times_since_1970_keep_every_nanosecond(tmp_path: Path) -> None:
    write(tmp_path, "t,x,y,z\n1367400000.123456789,1,2,3\n1367400000.123456790,1,2,3\n", NAMED)
    assert counts_and_times(tmp_path)[1] == [1_367_400_000_123_456_789, 1_367_400_000_123_456_790]


def test_two_sensors_with_physical_values_and_a_thermometer(tmp_path: Path) -> None:
    gyro = """
[[sensor]]
name = "G"
chip = "l3g4200d"
quantity = "angular_rate"
columns = ["p", "q", "r"]
range = 250
unit = "dps"
sensitivity = 114.3
values = "physical"
axes = "-Y-X-Z"
position_mm = [1.0, 2.5, -3.0]
temperature_column = "T"
"""
    write(tmp_path, "t,x,y,z,p,q,r,T\n0,1,2,3,1.0,-10,0.004,-7\n1,1,2,3,0.005,250,0,8\n", NAMED + gyro)
    # 114.3; -1143; 0.4572; 0.5715; 28575
    assert counts_and_times(tmp_path, "G")[0] == [[114, -1143, 0], [1, 28575, 0]]
    assert counts_and_times(tmp_path, "A")[0] == [[1, 2, 3]] * 2
    with open_log(tmp_path / "out.h5") as log:
        thermometer = log["G"].temperature_counts
        assert thermometer is not None
        assert thermometer[:].tolist() == [-7, 8]
        assert log["G"].axes == "-Y-X-Z"
        assert log["G"].position_mm.tolist() == [1, 2.5, -3]


def test_the_ends_of_the_code_span_are_saturated(tmp_path: Path) -> None:
    write(tmp_path, "t,x,y,z\n0,1,2,3\n1,-32768,0,0\n2,0,0,32767\n", NAMED)
    with open_log(tmp_path / "out.h5") as log:
        assert log["A"].status[:].tolist() == [0, SATURATED, SATURATED]


def test_phases_include_their_first_and_last_row(tmp_path: Path) -> None:
    phases = '[[phase]]\nname = "z_up"\nrows = [0, 1]\n[[phase]]\nname = "x_down"\nrows = [2, 2]\n'
    write(tmp_path, "t,x,y,z\n" + "".join(f"{row},{row},0,0\n" for row in range(4)), NAMED + phases, block_rows=1)
    with open_log(tmp_path / "out.h5") as log:
        assert [(phase.name, phase.up) for phase in log.phases] == [("z_up", "+Z"), ("x_down", "-X")]
        inside = [log["A"].counts[log["A"].between(phase.start_ns, phase.end_ns), 0].tolist() for phase in log.phases]
    assert inside == [[0, 1], [2]]


def test_a_phase_beyond_the_table_is_refused(tmp_path: Path) -> None:
    phase = '[[phase]]\nname = "z_up"\nrows = [0, 2]\n'
    message = refused(tmp_path, "t,x,y,z\n0,1,2,3\n1,1,2,3\n", NAMED + phase, ConfigError)
    assert message == "map.toml: phase 1 'z_up': rows [0, 2], but data.csv has data rows 0 to 1"


@pytest.mark.parametrize("hole", some(["", " ", "nan", "NaN", "NA", "null", "None"], 2))
@pytest.mark.parametrize("block_rows", some([2, 1, 4096], 1))
def test_a_reading_without_an_axis_is_omitted(tmp_path: Path, hole: str, block_rows: int) -> None:
    """Two consecutive readings are one loss before the next reading; a row without any value belongs to
    another sensor.
    """
    rows = ["0,1,2,3", f"1,4,{hole},6", f"2,{hole},5,6", "3,4,5,6", "4,7,8,9", f"5,{hole},{hole},{hole}", "6,1,1,1"]
    summary = write(tmp_path, "\n".join(rows) + "\n", NUMBERED, block_rows=block_rows)
    assert counts_and_times(tmp_path) == (
        [[1, 2, 3], [4, 5, 6], [7, 8, 9], [1, 1, 1]],
        [0, 3_000_000_000, 4_000_000_000, 6_000_000_000],
    )
    with open_log(tmp_path / "out.h5") as log:
        assert log["A"].status[:].tolist() == [0, LOST_BEFORE, 0, 0]
    assert summary.remarks == (
        "A: no reading in 1 of 7 rows, whose cells are blank",
        "A: 2 rows left out in which an axis has no value; the next row is flagged (lost before)",
    )


def test_the_last_comment_is_the_header_of_a_table_without_one(tmp_path: Path) -> None:
    """The format of numpy.savetxt and of the EuRoC data sets."""
    write(tmp_path, "# recorded on a bench\n#t, x, y, z\n0.5,1,-2,3\n# a pause\n0.51,4,5,-6\n", NAMED)
    assert counts_and_times(tmp_path) == ([[1, -2, 3], [4, 5, -6]], [500_000_000, 510_000_000])


def test_a_comment_above_a_header_is_ignored(tmp_path: Path) -> None:
    write(tmp_path, "#a,b,c,d\nt,x,y,z\n0.5,1,-2,3\n0.51,4,5,-6\n", NAMED)
    assert counts_and_times(tmp_path)[0] == [[1, -2, 3], [4, 5, -6]]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("0,1,2,3\n1,4,oops,6\n", "data.csv: line 2, column 2: 'oops' is not a number"),
        ("0,1,2,3\n1,4,inf,6\n", "data.csv: line 2, column 2: 'inf' is not a number"),
        (
            "#\n0,1,2,3\n\n1,4,5.5,6\n",
            "data.csv: line 4, column 2: 5.5 is not a whole number of counts; if the column has a",
        ),
        ("0,1,2,3\n1,4,5,32768\n", "data.csv: line 2, column 3: 32768; allowed are -32768 to 32767"),
        ("0,1,2,3\n1,4,5,-1e300\n", "data.csv: line 2, column 3: -1e300; allowed are -32768 to 32767"),
        (
            "0,1,2,3\n0,4,5,6\n",
            "data.csv: line 2, column 0: 0 is not later than the row before, 0; allowed are increasing",
        ),
        ("1,1,2,3\n0.9,4,5,6\n", "data.csv: line 2, column 0: 0.9 is not later than the row before"),
        ("later,1,2,3\n", "data.csv: line 1, column 0: 'later' is not a number"),
        ("NaN,1,2,3\n", "data.csv: line 1, column 0: NaN is not a time; allowed are numbers up to 4611686018"),
        ("1e999999999,1,2,3\n", "data.csv: line 1, column 0: 1e999999999 is not a time; allowed are"),
        ("0,1,2\n1,4,5\n", "data.csv: line 1: 3 cells, so there is no column 3 (counted from 0)"),
        ("0,1,2,3\n1,4,5\n", "data.csv: line 2: 3 cells, the first row has 4"),
        ("0,1,2,3\n1,4,5,6,7\n", "data.csv: line 2: 5 cells, the first row has 4"),
        ("", "data.csv: no data rows; expected rows of numbers as map.toml describes them"),
        ("# nothing\n\n", "data.csv: no data rows"),
        ("0,1,2," + "3" * 70_000, "data.csv: line 1: longer than 65536 characters; is this a table?"),
        (
            "0;1;2;3\n",
            "data.csv: line 1: 1 cell, so there is no column 1 (counted from 0); do they have another delimiter?",
        ),
    ],
)
def test_wrong_cells_are_refused(tmp_path: Path, table: str, message: str) -> None:
    assert refused(tmp_path, table, NUMBERED).startswith(message)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("t,x,y\n0,1,2\n", "data.csv: line 1: no column 'z'; the header has t, x, y"),
        ("t,x,y,z,x\n0,1,2,3,4\n", "data.csv: line 1: several columns are called 'x'; the header has t, x, y, z, x"),
        ("", "data.csv: line 0: no column 't'; the header has "),
        ("t,x,y,z\n", "data.csv: no data rows"),
        ("t,x,y,z\n0,1,2\n", "data.csv: line 2: 3 cells, the first row has 4"),
        ("t,x,y,z\n0,1,?,3\n", "data.csv: line 2, column 'y': '?' is not a number"),
    ],
)
def test_wrong_headers_are_refused(tmp_path: Path, table: str, message: str) -> None:
    assert refused(tmp_path, table, NAMED).startswith(message)


def test_a_physical_value_beyond_the_counts_is_refused(tmp_path: Path) -> None:
    message = refused(tmp_path, "0,1,2,3\n1,4,5,100\n", NUMBERED + 'values = "physical"\n')
    wanted = "data.csv: line 2, column 3: 100 is 51200 counts; allowed are -32768 to 32767"
    assert message == wanted + "; are unit and sensitivity those of the column?"


@pytest.mark.parametrize("content", [bytes(range(256)) * 10, b"\x00" * 100, b'"' + b"1,\n" * 100_000])
def test_binary_data_is_refused(tmp_path: Path, content: bytes) -> None:
    assert refused(tmp_path, content, NUMBERED).startswith("data.csv: ")


@pytest.mark.slow
def test_a_late_error_keeps_the_old_log_and_no_partial_file(tmp_path: Path) -> None:
    rows = "".join(f"{row},1,2,3\n" for row in range(10_000))
    late = rows + "9999,1,2,3\n"
    assert refused(tmp_path, late, NUMBERED).startswith("data.csv: line 10001, column 0: 9999 is not later")
    write(tmp_path, rows, NUMBERED)
    before = (tmp_path / "out.h5").read_bytes()
    with pytest.raises(OutputExistsError):
        write(tmp_path, rows, NUMBERED)
    with pytest.raises(SourceError):
        write(tmp_path, late, NUMBERED, force=True)
    assert (tmp_path / "out.h5").read_bytes() == before


def test_time_must_increase_across_blocks(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"line 2, column 0: 0 is not later than the row before"):
        write(tmp_path, "0,1,2,3\n0,1,2,3\n", NUMBERED, block_rows=1)


def test_the_source_as_output_is_refused(tmp_path: Path) -> None:
    write(tmp_path, "0,1,2,3\n", NUMBERED)
    with pytest.raises(SourceError, match="is also the output"):
        import_table(tmp_path / "data.csv", tmp_path / "map.toml", tmp_path / "data.csv", force=True)


COUNT = st.integers(-32768, 32767)


@pytest.mark.slow
@settings(max_examples=examples(40), deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 10**12), COUNT, COUNT, COUNT), min_size=1, max_size=30),
    st.sampled_from([",", ";", "\\t", " ", "|"]),
    st.integers(1, 7),
)
def test_every_count_and_time_is_kept(rows: list[tuple[int, int, int, int]], delimiter: str, block_rows: int) -> None:
    times = np.cumsum([step for step, *_ in rows]).tolist()
    between = "\t" if delimiter == "\\t" else delimiter
    text = [f"{time // 1000}.{time % 1000:03d}" for time in times]
    table = "".join(between.join(map(str, (time, *triad))) + "\n" for time, (_, *triad) in zip(text, rows, strict=True))
    with TemporaryDirectory() as folder:
        table_map = f'[file]\ndelimiter = "{delimiter}"\n' + NUMBERED.replace('"s"', '"us"')
        summary = write(Path(folder), table, table_map, block_rows=block_rows)
        assert counts_and_times(Path(folder)) == ([list(triad) for _, *triad in rows], times)
    assert summary.rows == len(rows)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def peak(rows: int) -> int:
        table = "".join(f"{row},1,2,3\n" for row in range(rows)).encode()
        (tmp_path / "map.toml").write_text(NUMBERED)
        (tmp_path / "data.csv").write_bytes(table)
        tracemalloc.start()
        monkeypatch.setattr("imuarray.importers.table.ROWS", 500)
        import_table(tmp_path / "data.csv", tmp_path / "map.toml", tmp_path / "out.h5", force=True)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(500)
    assert peak(72_000) < 1.3 * peak(36_000)  # both are longer than the blocks of the report
