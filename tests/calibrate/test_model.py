"""The calibration file: round trip, what is refused, what an update keeps."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from imuarray.calibrate import Calibration, SensorCalibration, load_calibration
from imuarray.errors import CalibrationError, ImuArrayError, OutputExistsError
from imuarray.log import open_log
from tests.calibrate.conftest import Part, WriteLog, accelerometer, gyroscope, ideal

HEAD = "[calibration]\nformat_version = 1\n"
SENSOR = (
    '[[sensor]]\nname = "A"\nquantity = "specific_force"\nunit = "g"\n'
    "bias_lsb = [1, 2, 3]\nresponse_lsb_per_unit = [[9, 0, 0], [0, 9, 0], [0, 0, 9]]\n"
)

numbers = st.floats(-1e6, 1e6, allow_nan=False).filter(lambda x: x == 0 or abs(x) > 1e-6)
positive = st.floats(1e-3, 1e6)


def triples(of: st.SearchStrategy[float]) -> st.SearchStrategy[np.ndarray]:
    return st.lists(of, min_size=3, max_size=3).map(np.array)


matrices = st.lists(st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3), min_size=3, max_size=3)

sensors = st.builds(
    SensorCalibration,
    name=st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12),
    quantity=st.just("specific_force"),
    unit=st.just("g"),
    bias_lsb=triples(numbers),
    response_lsb_per_unit=st.builds(lambda m, s: s * (np.eye(3) + np.array(m)), matrices, positive),
    bias_sem_lsb=st.none() | triples(positive),
    response_sem_lsb_per_unit=st.none() | triples(positive),
    g_sensitivity_lsb_per_g=st.none() | st.lists(triples(numbers), min_size=3, max_size=3).map(np.array),
    noise_lsb=st.none() | triples(positive),
    temperature_degc=st.none() | st.floats(-40, 85),
)

ARRAYS = (
    "bias_lsb",
    "response_lsb_per_unit",
    "bias_sem_lsb",
    "response_sem_lsb_per_unit",
    "g_sensitivity_lsb_per_g",
    "noise_lsb",
)


@settings(max_examples=60, deadline=None)
@given(st.lists(sensors, max_size=3, unique_by=lambda sensor: sensor.name), st.lists(st.text(max_size=9), max_size=2))
def test_round_trip(written: list[SensorCalibration], sources: list[str]) -> None:
    """Nine digits survive, names and sources exactly; what was not measured stays unknown."""
    sources = [source.encode("utf-8", "ignore").decode() for source in sources]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "cal.toml"
        Calibration({sensor.name: sensor for sensor in written}, tuple(sources)).save(path)
        read = load_calibration(path)
    assert list(read.sensors) == [sensor.name for sensor in written]
    assert list(read.sources) == sources
    for sensor in written:
        back = read.sensors[sensor.name]
        assert (back.quantity, back.unit) == (sensor.quantity, sensor.unit)
        assert back.temperature_degc == sensor.temperature_degc
        for key in ARRAYS:
            before, after = getattr(sensor, key), getattr(back, key)
            assert (before is None) == (after is None)
            if before is not None:
                assert after == pytest.approx(before, rel=1e-8, abs=0)


REFUSED = {
    "empty file": "",
    "no TOML": "{",
    "other version": "[calibration]\nformat_version = 2\n",
    "head no table": "calibration = 1\n",
    "NaN": HEAD + SENSOR.replace("[1, 2, 3]", "[nan, 2, 3]"),
    "infinite": HEAD + SENSOR.replace("[1, 2, 3]", "[1, inf, 3]"),
    "two numbers": HEAD + SENSOR.replace("[1, 2, 3]", "[1, 2]"),
    "ragged": HEAD + SENSOR.replace("[1, 2, 3]", "[[1], [1, 2], 3]"),
    "dates": HEAD + SENSOR.replace("[1, 2, 3]", "[1979-05-27, 1979-05-27, 1979-05-27]"),
    "table for a number": HEAD + SENSOR.replace("[1, 2, 3]", "{ x = 1 }"),
    "singular": HEAD + SENSOR.replace("[0, 0, 9]", "[0, 9, 0]"),
    "all zero": HEAD + SENSOR.replace("9", "0"),
    "unknown key": HEAD + SENSOR + "bais_lsb = [0, 0, 0]\n",
    "no name": HEAD + SENSOR.replace('name = "A"\n', ""),
    "unknown unit": HEAD + SENSOR.replace('"g"', '"furlong"'),
    "temperature text": HEAD + SENSOR + 'temperature_degc = "warm"\n',
    "temperature NaN": HEAD + SENSOR + "temperature_degc = nan\n",
    "sensor no table": HEAD.replace("[cal", "sensor = ['A']\n[cal"),
    "one sensor table": HEAD + SENSOR.replace("[[sensor]]", "[sensor]"),
    "huge whole number": HEAD + SENSOR.replace("[1, 2, 3]", f"[1{'0' * 400}, 2, 3]"),
    "5000 digits": HEAD + f"x = {'9' * 5000}\n",
    "deep nesting": "x = " + "[" * 5000,
}
"""What a file says, and CalibrationError is the answer."""

NOT_YET = {
    "sensor a number": "sensor = 5\n" + HEAD,
    "sources a number": HEAD + "sources = 5\n",
    "unit a list": HEAD + SENSOR.replace('"g"', "[1]"),
    "name a list": HEAD + SENSOR.replace('"A"', "[1]"),
    "name a number": HEAD + SENSOR.replace('"A"', "5"),
    "unknown quantity": HEAD + SENSOR.replace("specific_force", "colour"),
    "unit of another quantity": HEAD + SENSOR.replace('"g"', '"dps"'),
    "twice the same sensor": HEAD + SENSOR + SENSOR,
    "negative noise": HEAD + SENSOR + "noise_lsb = [-1, 1, 1]\n",
    "huge temperature": HEAD + SENSOR + f"temperature_degc = 1{'0' * 400}\n",
}
"""What is believed, or ends in a traceback, so far."""


@pytest.mark.parametrize(
    "text",
    [
        *(pytest.param(text, id=name) for name, text in REFUSED.items()),
        *(
            pytest.param(
                text,
                id=name,
            )
            for name, text in NOT_YET.items()
        ),
    ],
)
def test_malformed_files_are_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "cal.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CalibrationError) as caught:
        load_calibration(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, len(HEAD + SENSOR) - 1), st.binary(max_size=6), st.integers(0, 20))
@example(0, b"\xff\xfe", 0)
def test_a_damaged_file_is_read_or_refused(place: int, inserted: bytes, removed: int) -> None:
    """Bytes overwritten at a random place: never another exception than ours."""
    good = (HEAD + SENSOR).encode()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "cal.toml"
        path.write_bytes(good[:place] + inserted + good[place + removed :])
        try:
            load_calibration(path)
        except ImuArrayError as error:
            assert str(error).startswith(str(path))


@pytest.mark.parametrize("name", ["missing.toml", "."])
def test_a_file_that_is_not_there(tmp_path: Path, name: str) -> None:
    with pytest.raises(CalibrationError, match=r"No such file|Is a directory"):
        load_calibration(tmp_path / name)


def test_saving_never_overwrites_unless_told(tmp_path: Path) -> None:
    path = tmp_path / "cal.toml"
    path.write_text("mine")
    with pytest.raises(OutputExistsError, match="exists already"):
        Calibration().save(path)
    assert path.read_text() == "mine"
    Calibration().save(path, force=True)
    assert load_calibration(path).sensors == {}


def known(**values: object) -> SensorCalibration:
    plain = {"name": "A", "quantity": "specific_force", "unit": "g", "bias_lsb": np.zeros(3)}
    return SensorCalibration(**{**plain, "response_lsb_per_unit": 2048 * np.eye(3), **values})  # type: ignore[arg-type]


TUMBLED = known(
    bias_lsb=np.array([1.0, 2, 3]),
    bias_sem_lsb=np.ones(3),
    response_lsb_per_unit=2000 * np.eye(3),
    response_sem_lsb_per_unit=np.ones(3),
    temperature_degc=25.0,
)
NOISY = known(noise_lsb=np.array([7.0, 8, 9]))


@pytest.mark.parametrize(("older", "newer"), [(TUMBLED, NOISY), (NOISY, TUMBLED)])
def test_tumble_and_noise_add_up_in_either_order(older: SensorCalibration, newer: SensorCalibration) -> None:
    merged = Calibration({"A": older}, ("one",)).merged(Calibration({"A": newer}, ("two",)))
    both = merged.sensors["A"]
    assert both.bias_lsb.tolist() == [1, 2, 3]
    assert both.bias_sem_lsb is not None and both.noise_lsb is not None
    assert both.response_lsb_per_unit[0, 0] == 2000
    assert both.noise_lsb.tolist() == [7, 8, 9]
    assert both.temperature_degc == 25.0
    assert merged.sources == ("one", "two")


def test_what_was_measured_again_replaces_what_was_known() -> None:
    newer = known(bias_lsb=np.array([4.0, 5, 6]), bias_sem_lsb=np.ones(3), noise_lsb=np.ones(3))
    both = Calibration({"A": TUMBLED}).merged(Calibration({"A": newer})).sensors["A"]
    assert both.bias_lsb.tolist() == [4, 5, 6]
    assert both.response_lsb_per_unit[0, 0] == 2000


def test_other_sensors_are_kept() -> None:
    merged = Calibration({"A": TUMBLED}).merged(Calibration({"B": known(name="B")}))
    assert sorted(merged.sensors) == ["A", "B"]


def test_two_different_sensors_of_one_name_are_not_mixed() -> None:
    gyro = known(quantity="angular_rate", unit="dps", noise_lsb=np.ones(3))
    with pytest.raises(CalibrationError):
        Calibration({"A": TUMBLED}).merged(Calibration({"A": gyro}))


def test_a_sensor_that_is_not_calibrated_is_taken_from_the_data_sheet(write_log: WriteLog) -> None:
    part = Part(accelerometer("A", "-Y-X-Z"), ideal("-Y-X-Z", 2048), np.zeros(3))
    with open_log(write_log([part], np.eye(3))) as log:
        plain = Calibration().of(log["A"])
    assert plain.response_lsb_per_unit.tolist() == ideal("-Y-X-Z", 2048).tolist()
    assert plain.bias_lsb.tolist() == [0, 0, 0]
    assert plain.bias_sem_lsb is None and plain.noise_lsb is None


def test_a_calibration_of_another_quantity_is_refused(write_log: WriteLog) -> None:
    part = Part(gyroscope("A"), ideal("+X+Y+Z", 100), np.zeros(3))
    with (
        open_log(write_log([part], np.eye(3))) as log,
        pytest.raises(CalibrationError, match="sensor A: calibrated as specific_force in g, logged as angular_rate"),
    ):
        Calibration({"A": TUMBLED}).of(log["A"])


def test_a_calibration_at_another_range_is_refused(write_log: WriteLog) -> None:
    part = Part(accelerometer("A", sensitivity=256.0), ideal("+X+Y+Z", 256), np.zeros(3))
    with open_log(write_log([part], np.eye(3))) as log, pytest.raises(CalibrationError):
        Calibration({"A": TUMBLED}).of(log["A"])


def test_counts_become_a_triad_in_the_box_frame() -> None:
    """Axes askew and of different scale: the counts of a known stimulus give it back, in SI."""
    response = np.array([[100.0, 20.0, -5.0], [3.0, -250.0, 0.0], [10.0, 0.0, 60.0]])
    bias = np.array([5.0, -7.0, 11.0])
    sensor = known(response_lsb_per_unit=response, bias_lsb=bias)
    stimulus_g = np.array([[0.3, -1.2, 0.9], [0.0, 0.0, 0.0]])
    counts = stimulus_g @ response.T + bias
    assert sensor.stimulus_box(counts) == pytest.approx(9.80665 * stimulus_g)
    lengths = [np.sqrt(100**2 + 20**2 + 5**2), np.sqrt(3**2 + 250**2), np.sqrt(10**2 + 60**2)]
    assert sensor.scale_lsb_per_unit == pytest.approx(lengths)
    assert sensor.bias_in_units() == pytest.approx(bias / lengths)


@pytest.mark.parametrize(
    ("direction", "azimuth", "elevation"),
    [
        ((1, 0, 0), 0, 0),
        ((0, 1, 0), 90, 0),
        ((-1, 0, 0), 180, 0),
        ((0, -1, 0), -90, 0),
        ((1, 1, 0), 45, 0),
        ((0, 0, 1), 0, 90),
        ((0, 0, -1), 0, -90),
        ((-1, -1, np.sqrt(2)), -135, 45),
    ],
)
def test_angles_are_zero_along_x_ninety_along_y_and_know_their_quadrant(
    direction: tuple[float, float, float], azimuth: float, elevation: float
) -> None:
    rows = np.array([direction, direction, direction], float) * 512
    found = known(response_lsb_per_unit=rows).azimuth_elevation_deg()
    assert found[0] == pytest.approx((azimuth, elevation))
