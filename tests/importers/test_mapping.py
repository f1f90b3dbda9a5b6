"""Invalid maps are refused in one line that names file, place, and allowed values."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from imuarray.errors import ConfigError
from imuarray.importers.mapping import load_map, parse_map

TIME = '[time]\ncolumn = "t"\nunit = "s"\n'
SENSOR = """[[sensor]]
name = "A"
chip = "bma180"
quantity = "specific_force"
columns = ["x", "y", "z"]
range = 16
unit = "g"
sensitivity = 512
"""


def complaint(tmp_path: Path, text: str) -> str:
    path = tmp_path / "map.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_map(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return re.sub(re.escape(str(path)) + r"(:\d+)?: ", "", message)


def test_the_shortest_map_is_read(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text(TIME + SENSOR)
    table_map = load_map(path)
    (sensor,) = table_map.sensor
    assert (sensor.is_physical, sensor.axes, sensor.temperature_column) == (False, "+X+Y+Z", None)
    assert (table_map.file.delimiter, table_map.file.skip_rows, table_map.file.comment) == (",", 0, "#")
    assert list(table_map.columns()) == ["t", "x", "y", "z"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "range = 16",
            "rnage = 16",
            "sensor 1 'A': rnage: unknown key (did you mean 'range'?); allowed are ",
        ),
        (
            "[time]",
            "[tmie]\n[time]",
            "tmie: unknown key (did you mean 'time'?); allowed are file, time, sensor, thermometer,",
        ),
        ('unit = "s"', 'unit = "s"\nzone = 1', "time: zone: unknown key; allowed are column, unit, rate_hz, ticks,"),
        ("range = 16", "", "sensor 1 'A': range: is missing"),
        (
            "range = 16",
            "range = 16\nthermometer = { zero_degc = 1.0, lsb_per_degc = 2.0 }",
            "sensor 1 'A': thermometer requires temperature_column",
        ),
        (
            "range = 16",
            'range = 16\ntemperature_column = "w"\nthermometer = { zero_degc = 1.0, lsb_per_degc = 0.0 }',
            "sensor 1 'A': thermometer: lsb_per_degc 0",
        ),
        ("range = 16", "range = -16", "sensor 1 'A': range: -16: allowed is anything above 0"),
        ("range = 16", "range = inf", "sensor 1 'A': range: inf: a finite number is required"),
        (
            "sensitivity = 512",
            'sensitivity = "512"',
            "sensor 1 'A': sensitivity: '512': a number without quotes is required",
        ),
        ('unit = "g"', 'unit = "dps"', "sensor 1 'A': unit 'dps': allowed for specific_force are g, mg, m/s2"),
        ('unit = "g"', 'unit = "m"', "sensor 1 'A': unit 'm': allowed for specific_force are g, mg, m/s2"),
        (
            'unit = "g"',
            'unit = "g"\nscale = 0.002',
            "sensor 1 'A': sensitivity (counts per unit) and scale (units per count) are redundant",
        ),
        (
            "sensitivity = 512",
            'values = "counts"',
            "sensor 1 'A': sensitivity: is missing, or scale; columns of counts",
        ),
        (
            "sensitivity = 512",
            "offset = 7",
            "sensor 1 'A': offset and bits apply to counts, but these columns have a unit",
        ),
        ('"specific_force"', '"pressure"', "quantity: 'pressure': allowed are 'specific_force', 'angular_rate' or"),
        ('["x", "y", "z"]', '["x", "y"]', "sensor 1 'A': columns: 2 entries: 3 or more are required"),
        (
            '["x", "y", "z"]',
            '["x", "y", "y"]',
            "sensor 1 'A': columns ['x', 'y', 'y']: each column may appear only once",
        ),
        ('["x", "y", "z"]', "[1, 2, -3]", "columns 3: -3: allowed are a column's name or its index, counted from 0"),
        ('["x", "y", "z"]', "[1, 2, 1.5]", "columns 3: 1.5: allowed are a column's name or its index"),
        ('["x", "y", "z"]', "[1, 2, true]", "columns 3: True: allowed are a column's name or its index"),
        ('name = "A"', 'name = "A/B"', "sensor 1 'A/B': name: 'A/B': allowed are a letter, then letters, digits and _"),
        ("range = 16", 'range = 16\naxes = "+X+Y-Z"', "sensor 1 'A': axes '+X+Y-Z': this triad is left-handed"),
        ("range = 16", 'range = 16\nvalues = "si"', "sensor 1 'A': values: 'si': allowed are 'counts' or 'physical'"),
        ('unit = "s"\n', "", "time: unit requires column; allowed are s, ms, us, ns, d, iso8601"),
        ('unit = "s"', 'unit = "s"\nrate_hz = 100', "time: needs either column and unit, or rate_hz"),
        ('column = "t"\nunit = "s"', "", "time: needs either column and unit, or rate_hz"),
        ('column = "t"\nunit = "s"', "rate_hz = 0", "time: rate_hz: 0: allowed is 0.001 or more"),
        (
            "[time]",
            '[file]\ndelimiter = "tab"\n[time]',
            "file: delimiter: 'tab': allowed are ',', ';', '\\t', ' ' or '|'",
        ),
        ("[time]", "[file]\nskip_rows = -1\n[time]", "file: skip_rows: -1: allowed is 0 or more"),
        ("[time]", '[[phase]]\nname = "p"\nrows = [5, 4]\n[time]', "phase 1 'p': rows [5, 4]: [first, last], last not"),
        ("[time]", '[[phase]]\nname = "p"\n[time]', "phase 1 'p': needs either rows or seconds: [first, last]"),
        (
            "[time]",
            '[[phase]]\nname = "p"\nseconds = [2, 1]\n[time]',
            "phase 1 'p': seconds [2.0, 1.0]: [begin, end], end",
        ),
        (
            "[time]",
            '[[phase]]\nname = "z_up"\nup = "+X"\nrows = [1, 1]\n[time]',
            "up '+X', but the name 'z_up' says +Z",
        ),
        (
            "[time]",
            '[file]\ndecimal = ","\n[time]',
            "file: decimal and delimiter are both ','; a table with decimal commas",
        ),
        (
            "[time]",
            '[file]\nformat = "mimu4444"\n[time]',
            "file: the format defines time and sensors: leave them out",
        ),
        ('unit = "s"\n', 'unit = "iso8601"\nwraps_at = 4.0\n', "time: ticks and wraps_at require a column of numbers"),
        ("[time]", "[reference]\n[time]", "reference: names no column; specific_force, angular_rate and temperature"),
        (
            "[time]",
            '[reference]\nangular_rate = { columns = [1, 2, 3], unit = "g" }\n[time]',
            "'g': allowed for angular_rate",
        ),
        ("[time]", '[[thermometer]]\nname = "T"\ncolumn = "w"\n[time]', "thermometer 1 'T': counts need zero_degc and"),
        ("[time]", '[[phase]]\nname = "p"\nrows = [-5, 4]\n[time]', "phase 1 'p': rows 1: -5: allowed is 0 or more"),
        ("[time]", "[time", "not TOML: "),
    ],
)
def test_an_invalid_map_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = TIME + SENSOR
    assert text.count(old) == 1 or old == 'unit = "s"\n'
    assert message in complaint(tmp_path, text.replace(old, new, 1))


def test_all_errors_are_named(tmp_path: Path) -> None:
    message = complaint(tmp_path, (TIME + SENSOR).replace("range = 16", "range = 0").replace('"t"', '""'))
    assert "time: column: '': allowed are" in message
    assert "; sensor 1 'A': range: " in message


def test_every_error_names_its_line(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text('time = { column = "t", unit = "s" }\n[[sensor]]\n' + SENSOR_KEYS)
    with pytest.raises(ConfigError) as caught:
        load_map(path)
    assert [line.partition("; ")[0] for line in str(caught.value).split(f"{path}:")[1:]] == [
        "6: sensor 1 'A': columns: 2 entries: 3 or more are required",
        "4: sensor 1 'A': rnage: unknown key (did you mean 'range'?)",
    ]


SENSOR_KEYS = """name = "A"
rnage = 16
quantity = "specific_force"
columns = [
    "x", "y",
]
unit = "g"
chip = "bma180"
"""


def test_names_must_be_unique_and_a_sensor_is_required(tmp_path: Path) -> None:
    assert complaint(tmp_path, TIME + SENSOR * 2) == "2 sensors are called 'A'; names are unique"
    assert complaint(tmp_path, TIME) == "sensor: is missing"


def test_values_in_place_of_tables_are_refused(tmp_path: Path) -> None:
    assert complaint(tmp_path, TIME + "sensor = 3").startswith("time: sensor: unknown key")
    assert complaint(tmp_path, "sensor = [3]\n" + TIME).startswith("sensor 1: 3: a table is required")


def test_a_missing_or_binary_map_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: No such file"):
        load_map(tmp_path / "none.toml")
    path = tmp_path / "map.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"map\.toml: is not a text file"):
        load_map(path)


@pytest.mark.parametrize(
    ("name", "up"),
    [("z_up", "+Z"), ("x_down", "-X"), ("y_up_check", "+Y"), ("static", ""), ("w_up", ""), ("z", ""), ("run 3", "")],
)
def test_the_name_of_a_face_gives_the_up_axis(tmp_path: Path, name: str, up: str) -> None:
    path = tmp_path / "map.toml"
    path.write_text(TIME + SENSOR + f'[[phase]]\nname = "{name}"\nrows = [0, 0]\n')
    assert load_map(path).phase[0].box_up == up


@pytest.mark.parametrize(
    ("quantity", "spelt", "size"),
    [
        ("specific_force", "m/s^2", 1 / 9.80665),
        ("specific_force", "m/s\u00b2", 1 / 9.80665),
        ("specific_force", "G", 1.0),
        ("specific_force", "mG", 1e-3),
        ("angular_rate", "\u00b0/s", 1.0),
        ("angular_rate", "deg/sec", 1.0),
        ("angular_rate", "rad/sec", 57.29577951308232),
        ("magnetic_field", "G", 1.0),
        ("magnetic_field", "mG", 1e-3),
        ("magnetic_field", "\u00b5T", 1e-2),
        ("magnetic_field", "\u03bcT", 1e-2),
    ],
)
def test_usual_spellings_of_units_are_accepted(quantity: str, spelt: str, size: float) -> None:
    """The size in g, dps and gauss. A G is a unit of acceleration or of a field, by the quantity."""
    sensor = f'name = "A", chip = "any", quantity = "{quantity}", columns = [0, 1, 2], unit = "{spelt}"'
    result = parse_map(f"time = {{ rate_hz = 1 }}\nsensor = [{{ {sensor} }}]\n", "map.toml")
    assert result.sensor[0].log_units == pytest.approx(size, rel=1e-12)


def test_usual_spellings_of_time_and_temperature_are_accepted() -> None:
    sensor = 'name = "A", chip = "any", quantity = "angular_rate", columns = [1, 2, 3], unit = "deg/s"'
    text = f"""
time = {{ column = 0, unit = "usec" }}
sensor = [{{ {sensor} }}]
thermometer = [{{ name = "T", column = 4, unit = "\u00b0C" }}]
[reference]
temperature = {{ column = 5, unit = "kelvin" }}
angular_rate = {{ columns = [6, 7, 8], unit = "\u00b0/s" }}
"""
    result = parse_map(text, "map.toml")
    assert result.time is not None and result.time.unit == "us"
    assert result.thermometer[0].unit == "degC"
    assert result.reference is not None and result.reference.temperature is not None
    assert result.reference.temperature.unit == "K"
    assert result.reference.angular_rate is not None and result.reference.angular_rate.unit == "dps"
