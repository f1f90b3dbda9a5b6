"""Configurations: valid files; every refusal is one line with the file, the sensor, the key and the allowed values."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.array import ArrayConfig, load_array, parse_array
from imuarray.chips import chip_of
from imuarray.errors import ConfigError

SHIPPED = Path(__file__).parents[1] / "configs" / "martin2013.toml"

GOOD = """
[array]
name = "small"
mux = { chip = "pca9544a", address = 0x70 }
[[sensor]]
name = "Acc"
chip = "bma180"
channel = 0
address = 0x40
range = 16
bandwidth_hz = 150
[[sensor]]
name = "Gyro"
chip = "l3g4200d"
channel = 1
address = 0x68
range = 2000
rate_hz = 400
bandwidth_hz = 110
axes = "+X-Y-Z"
position_mm = [1.0, -2.0, 3.5]
"""


def refusal(tmp_path: Path, text: str | bytes) -> str:
    """The one line with which a file of this content is refused; it begins with the file's name."""
    path = tmp_path / "mine.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError) as refused:
        load_array(path)
    message = str(refused.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return re.sub(re.escape(str(path)) + r"(:\d+)?: ", "", message)


def changed(before: str, after: str) -> str:
    assert before in GOOD
    return GOOD.replace(before, after, 1)


def test_a_valid_file_is_parsed() -> None:
    array = parse_array(GOOD)
    assert array.name == "small"
    assert array.bus is None
    assert array.mux is not None
    assert array.mux.address == 0x70
    acc, gyro = array.sensors
    assert (acc.name, acc.chip, acc.channel, acc.address, acc.range) == ("Acc", "bma180", 0, 0x40, 16.0)
    assert acc.sensitivity == 512  # BMA-76
    assert acc.chip_rate_hz == 2400  # BMA-93, for any configuration
    assert acc.chip_bandwidth_hz == 150
    assert gyro.sensitivity == pytest.approx(1 / 0.070)  # L3G-42: 70 mdps per digit
    assert (gyro.chip_rate_hz, gyro.chip_bandwidth_hz) == (400, 110)
    assert gyro.orientation == ((1, 0, 0), (0, -1, 0), (0, 0, -1))
    assert gyro.position_mm == [1.0, -2.0, 3.5]
    assert gyro.place == "channel 1 address 0x68"
    assert array["Gyro"] is gyro
    assert array.text == GOOD
    with pytest.raises(KeyError):
        array["Gyro2"]


def test_a_mux_at_0x70_conflicts_with_no_chip() -> None:
    text = GOOD + '[[sensor]]\nname="P"\nchip="bmp180"\nchannel=2\naddress=0x77\n'
    assert parse_array(text)["P"].sensitivity == 0.0


def test_an_array_can_be_reduced_to_some_sensors() -> None:
    array = parse_array(GOOD)
    assert [sensor.name for sensor in array.only(("Gyro",)).sensors] == ["Gyro"]
    assert array.only(("Gyro",)).text == GOOD
    with pytest.raises(ConfigError, match=r"no sensor 'Gyr'; it has Acc, Gyro"):
        array.only(("Gyr",))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        # Unknown keys, in any table, with the nearest that exists and all that exist.
        (
            changed("bandwidth_hz = 150", "bandwith_hz = 150"),
            r"sensor 1 'Acc': bandwith_hz: unknown key \(did you mean 'bandwidth_hz'\?\); allowed are",
        ),
        (
            changed('name = "small"', 'name = "small"\nmuxx = 1'),
            r"array: muxx: unknown key \(did you mean 'mux'\?\); allowed are name, bus, mux",
        ),
        (
            changed("address = 0x70", "address = 0x70, adress = 1"),
            r"array: mux: adress: unknown key \(did you mean 'address'\?\); allowed are chip, address",
        ),
        (GOOD + "[sensors]\n", r"sensors: unknown key \(did you mean 'sensor'\?\); allowed are array, sensor"),
        (changed("range = 16", "range = 16\nqqqq = 1"), r"sensor 1 'Acc': qqqq: unknown key; allowed are"),
        # Settings that a chip does not have.
        (changed("range = 16", "range = 17"), r"sensor 1 'Acc': range 17: allowed are 1, 1\.5, 2, 3, 4, 8, 16$"),
        (changed("range = 16\n", ""), r"sensor 1 'Acc': range is missing: allowed are 1, 1\.5"),
        (changed("range = 2000", "range = nan"), r"sensor 2 'Gyro': range nan: allowed are 250, 500, 2000$"),
        (changed("rate_hz = 400", "rate_hz = 1600"), r"sensor 2 'Gyro': rate_hz 1600: allowed are 100, 200, 400, 800$"),
        (changed("range = 16", "range = 16\nrate_hz = 400"), r"sensor 1 'Acc': rate_hz 400: this chip has none to set"),
        (
            changed("bandwidth_hz = 110", "bandwidth_hz = 70"),
            r"sensor 2 'Gyro': bandwidth_hz 70: allowed are 20, 25, 50, 110$",
        ),
        (
            changed("bandwidth_hz = 150", "bandwidth_hz = 0"),
            r"sensor 1 'Acc': bandwidth_hz 0: allowed are 10, 20, 40, 75, 150, 300, 600, 1200$",
        ),
        (
            changed('chip = "bma180"', 'chip = "bma280"'),
            r"sensor 1 'Acc': chip 'bma280': allowed are adxl345, bma180, l3g4200d, bmp180, .*, icm42688, lsm6dso$",
        ),
        (changed("address = 0x40", "address = 0x42"), r"sensor 1 'Acc': address 0x42: allowed are 0x40, 0x41$"),
        (changed('chip = "pca9544a"', 'chip = "pca9548"'), r"array: mux: chip: .*'pca9544a'"),
        (changed("address = 0x70", "address = 0x78"), r"array: mux: address: 0x78: allowed is 0x77 or less"),
        # Axes.
        (changed('"+X-Y-Z"', '"+X-Y+Z"'), r"sensor 2 'Gyro': axes '\+X-Y\+Z': this triad is left-handed"),
        (changed('"+X-Y-Z"', '"+X-X-Z"'), r"sensor 2 'Gyro': axes .*once"),
        (changed('"+X-Y-Z"', '"XYZ"'), r"sensor 2 'Gyro': axes 'XYZ': write the box axes"),
        # Places.
        (changed("channel = 0", "channel = 4"), r"sensor 1 'Acc': channel: .*3"),
        (changed("channel = 1", 'channel = 1\nbus = "/dev/i2c-5"'), r"sensor 2 'Gyro': channel and bus"),
        (
            changed('mux = { chip = "pca9544a", address = 0x70 }', ""),
            r"sensor 'Acc': channel 0, but \[array\] has no mux",
        ),
        (changed('name = "Gyro"', 'name = "Acc"'), r"2 sensors are called 'Acc'"),
        (
            GOOD + '[[sensor]]\nname="Two"\nchip="bma180"\nrange=2\nchannel=0\naddress=0x40\n',
            r"sensors 'Acc' and 'Two' are both at channel 0 address 0x40",
        ),
        (
            GOOD + '[[sensor]]\nname="Two"\nchip="bma180"\nrange=2\naddress=0x40\n',
            r"sensor 'Acc' on channel 0: 'Two' on the trunk answers at 0x40 too",
        ),
        # Names and numbers.
        (changed('name = "Gyro"', 'name = "../Gyro"'), r"sensor 2 '\.\./Gyro': name: "),
        (changed('name = "Gyro"', 'name = "1"'), r"sensor 2 '1': name: "),
        (changed("address = 0x40", 'address = "0x40"'), r"sensor 1 'Acc': address: .*whole number without quotes"),
        (changed("range = 16", "range = true"), r"sensor 1 'Acc': range: .*number"),
        (changed("[1.0, -2.0, 3.5]", "[1.0, -2.0]"), r"sensor 2 'Gyro': position_mm: .*3"),
        (changed('chip = "bma180"\n', ""), r"sensor 1 'Acc': chip: "),
        # Values of another type.
        (changed('chip = "bma180"', "chip = { a = 1 }"), r"sensor 1 'Acc': chip: "),
        (changed('chip = "bma180"', "chip = [[1]]"), r"sensor 1 'Acc': chip: "),
        (
            changed('chip = "bma180"\n', 'chip = "lsm6dso"\n').replace("range = 16", "range = { a = 1 }"),
            r"sensor 1 'Acc': ",
        ),
        (changed('name = "small"', r'name = "a\u0000b"'), r"name: a text without a NUL character is required"),
        ('[array]\nname = "x"\n', r"sensor: "),
        ('sensor = []\n[array]\nname = "x"\n', r"sensor: "),
        ('sensor = [3]\n[array]\nname = "x"\n', r"sensor 1: "),
        ('[array]\nname = "x"\n[sensor]\nname = "a"\n', r"sensor: .*list"),
        ("", r"array: .*sensor: "),
        ("name = ", r"not TOML: "),
        ("\n[array\n", r"not TOML: .*line 2"),
        ("\x00", r"not TOML: "),
    ],
)
def test_invalid_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    assert re.match(message, refusal(tmp_path, text)), refusal(tmp_path, text)


def test_every_kind_of_mistake_is_reported_at_once(tmp_path: Path) -> None:
    """Unknown keys, and of each sensor everything that its chip does not have."""
    text = GOOD.replace('name = "small"', 'name = "small"\ncolour = "red"')
    text = text.replace('chip = "bma180"', 'chip = "bma18"\nfoo = 1').replace("range = 2000", "range = 2001")
    message = refusal(tmp_path, text.replace('axes = "+X-Y-Z"', 'axes = "+X+Y"'))
    for mistake in ("colour: unknown key", "foo: unknown key", "chip 'bma18'", "range 2001: allowed", "axes '+X+Y'"):
        assert message.count(mistake) == 1, mistake


def test_mistakes_name_file_and_line(tmp_path: Path) -> None:
    """Line numbers counted by hand in GOOD, whose first line is empty."""
    path = tmp_path / "mine.toml"
    for text, expected in (
        (changed("range = 16", "range = 17\nqqqq = 1"), (":11: sensor 1 'Acc': qqqq", ":10: sensor 1 'Acc': range 17")),
        (changed('name = "Gyro"', 'name = "Acc"'), (":13: 2 sensors are called 'Acc'",)),
        (
            changed("address = 0x70 }", "address = 0x68 }"),
            (":4: array: mux: address: 0x68: allowed is 0x70 or more",),
        ),
        (GOOD.replace("mux = {", "# mux = {"), (":8: sensor 'Acc': channel 0,", ":15: sensor 'Gyro': channel 1,")),
        ("\n\n[array\n", (":3: not TOML: ",)),
        ('[array]\nname = "x"\n', (": sensor: is missing",)),
    ):
        path.write_text(text)
        with pytest.raises(ConfigError) as refused:
            load_array(path)
        mistakes = str(refused.value).split(f"; {path}")
        assert len(mistakes) == len(expected), mistakes
        for mistake, words in zip(mistakes, expected, strict=True):
            assert mistake.removeprefix(str(path)).startswith(words)


@pytest.mark.parametrize("channel", ["channel = 0\n", ""])
def test_a_mux_at_0x77_with_a_bmp180_is_refused(tmp_path: Path, channel: str) -> None:
    head = '[array]\nname="x"\nmux={chip="pca9544a",address=0x77}\n'
    text = f'{head}[[sensor]]\nname="P"\nchip="bmp180"\n{channel}address=0x77\n'
    assert re.match(
        r"sensor 'P': address 0x77 is the mux's own.* strap the mux to 0x70 to 0x76$", refusal(tmp_path, text)
    )


def test_every_mistake_is_reported_at_once(tmp_path: Path) -> None:
    message = refusal(tmp_path, GOOD.replace("range = 16", "range = 17").replace("range = 2000", "range = 2001"))
    assert "'Acc': range 17" in message
    assert "'Gyro': range 2001" in message


def test_a_file_other_than_utf8_is_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path, b'name = "\xff"\n') == "is not a text file"


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(ConfigError, match=re.escape(f"{path}: ")):
            load_array(path)


def test_one_address_on_two_channels_or_two_kernel_buses_is_accepted() -> None:
    sensor = '[[sensor]]\nname="{}"\nchip="bma180"\naddress=0x40\nrange=2\n{}\n'
    behind_mux = (
        '[array]\nname="x"\nmux={chip="pca9544a",address=0x70}\n'
        + sensor.format("A", "channel=0")
        + sensor.format("B", "channel=1")
    )
    kernel = '[array]\nname="x"\n' + sensor.format("A", 'bus="/dev/i2c-11"') + sensor.format("B", 'bus="/dev/i2c-12"')
    assert [len(parse_array(text).sensors) for text in (behind_mux, kernel)] == [2, 2]
    with pytest.raises(ConfigError, match="are both at /dev/i2c-11 address 0x40"):
        parse_array(kernel.replace("i2c-12", "i2c-11"))


def test_the_rates_that_a_refusal_lists_are_accepted() -> None:
    sensor = '[array]\nname="x"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=2\nrate_hz={}\n'
    with pytest.raises(ConfigError) as refused:
        parse_array(sensor.format("99.0"))
    listed = str(refused.value).partition("allowed are ")[2].split(", ")
    assert len(listed) == 16
    for rate in listed:
        parse_array(sensor.format(float(rate)))


@pytest.mark.parametrize("rate_hz", [100, 200, 400, 800])
def test_a_gyro_without_a_bandwidth_gets_an_allowed_bandwidth(rate_hz: int) -> None:
    text = f'[array]\nname="x"\n[[sensor]]\nname="G"\nchip="l3g4200d"\naddress=0x68\nrange=250\nrate_hz={rate_hz}\n'
    gyro = parse_array(text)["G"]
    assert gyro.chip_bandwidth_hz in gyro.spec.allowed_bandwidths_hz(rate_hz)


def test_positions_must_be_finite(tmp_path: Path) -> None:
    assert "position_mm" in refusal(tmp_path, changed("[1.0, -2.0, 3.5]", "[nan, inf, 0.0]"))


@given(st.text(max_size=60))
def test_the_refusal_of_any_text_is_one_line(text: str) -> None:
    try:
        parse_array(text, "f.toml")
    except ConfigError as error:
        assert "\n" not in str(error)


@given(st.text(min_size=1, max_size=10))
def test_the_refusal_of_any_key_is_one_line(key: str) -> None:
    quoted = "".join(f"\\U{ord(letter):08x}" for letter in key if not 0xD800 <= ord(letter) < 0xE000)
    try:
        parse_array(f'"{quoted}" = 1\n' + GOOD, "f.toml")
    except ConfigError as error:
        assert len(str(error).splitlines()) == 1
    else:
        pytest.fail("an unknown key was accepted")


@pytest.fixture(scope="module")
def paper() -> ArrayConfig:
    return load_array(SHIPPED)


def test_the_papers_array_names_no_bus(paper: ArrayConfig) -> None:
    assert paper.bus is None


def test_the_papers_array_has_the_chips_of_section_3(paper: ArrayConfig) -> None:
    chips = [sensor.chip for sensor in paper.sensors]
    assert {chip: chips.count(chip) for chip in chips} == {
        "adxl345": 2,
        "bma180": 4,
        "l3g4200d": 3,
        "bmp180": 1,
        "hmc5883": 2,
    }


def test_the_papers_array_has_the_ranges_of_the_paper(paper: ArrayConfig) -> None:
    ranges = {sensor.name: sensor.range for sensor in paper.sensors if sensor.chip not in ("bmp180", "hmc5883")}
    g = {"ADXL1": 16, "ADXL2": 16, "BMA1": 16, "BMA2": 16, "BMA3": 1.5, "BMA4": 1.5}
    assert ranges == {**g, "Gyro1": 2000, "Gyro2": 2000, "Gyro3": 250}


@pytest.mark.parametrize(
    "hostile",
    [f"[array]\nname = {'9' * 5000}", f"a = {'[' * 3000}{']' * 3000}", "[" + ".".join("a" * 3000) + "]\nb = 1"],
    ids=["huge number", "deep list", "deep table"],
)
def test_hostile_files_are_refused_in_one_line(tmp_path: Path, hostile: str) -> None:
    assert refusal(tmp_path, hostile)


@pytest.mark.parametrize(
    ("written", "chip"),
    [("BMA180", "bma180"), ("L3G4200D", "l3g4200d"), ("ADXL345", "adxl345"), ("HMC5883L", "hmc5883l")],
)
def test_the_name_in_a_data_sheet_is_accepted_as_a_chip(written: str, chip: str) -> None:
    assert chip_of(written) == chip


def test_a_six_axis_chip_is_accepted_by_its_part_name() -> None:
    text = """
        [array]
        name = "pair"
        [[sensor]]
        name = "IMU1_acc"
        chip = "ICM-42688-P"
        address = 0x68
        range = 4
        [[sensor]]
        name = "IMU1_gyro"
        chip = "icm42688p"
        address = 0x68
        range = 500
    """
    array = parse_array(text, "pair.toml")
    assert [sensor.chip for sensor in array.sensors] == ["icm42688_acc", "icm42688_gyro"]


def test_a_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    """Editors on Windows begin UTF-8 with it."""
    text = Path("configs/martin2013.toml").read_text(encoding="utf-8")
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert load_array(tmp_path / "a.toml").sensors == load_array("configs/martin2013.toml").sensors


def test_addresses_are_hexadecimal_in_errors() -> None:
    text = Path("configs/martin2013.toml").read_text(encoding="utf-8").replace("address = 0x70", "address = 0x41", 1)
    with pytest.raises(ConfigError, match="mux: address: 0x41: allowed is 0x70 or more"):
        parse_array(text, "a.toml")


def test_a_second_table_with_single_brackets_is_explained() -> None:
    sensor = '[sensor]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=2\n'
    with pytest.raises(ConfigError, match=r"not TOML: .*two brackets: \[\[sensor\]\]$"):
        parse_array(f'[array]\nname="a"\n{sensor}{sensor}')
