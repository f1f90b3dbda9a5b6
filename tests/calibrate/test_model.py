"""The calibration file: round trip, refusals, and what an update keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from imuarray.calibrate import Calibration, SensorCalibration, load_calibration
from imuarray.calibrate.model import (
    GROUPS,
    THERMOMETERS,
    BiasState,
    Drift,
    NoiseLine,
    Provenance,
    Thermal,
    TurnOn,
)
from imuarray.errors import CalibrationError, FusionError, ImuArrayError, OutputExistsError
from imuarray.fuse import fuse
from imuarray.log import open_log
from tests.calibrate.conftest import Part, WriteLog, accelerometer, gyroscope, ideal
from tests.selection import examples

HEAD = "[calibration]\nformat_version = 1\n"
SENSOR = (
    '[[sensor]]\nname = "A"\nquantity = "specific_force"\nunit = "g"\n'
    "bias_lsb = [1, 2, 3]\nresponse_lsb_per_unit = [[9, 0, 0], [0, 9, 0], [0, 0, 9]]\n"
)

HEATED = """[sensor.thermal]
slope_lsb_per_degc = [0.1, 0.2, 0.3]
slope_sem_lsb_per_degc = [0.01, 0.01, 0.01]
reference_degc = 30.0
meaning = ["bias", "bias", "bias or scale"]
thermometer = "barometer"
"""
TURNED_ON = """[sensor.turn_on]
rms_lsb = [1, 1, 1]
rms_sem_lsb = [1, 1, 1]
spread_lsb = [1, 1, 1]
p_value = [0, 0, 0]
runs = 7
[[sensor.turn_on.states]]
bias_lsb = [1, 2, 3]
share = 0.5
"""

numbers = st.floats(-1e6, 1e6, allow_nan=False).filter(lambda x: x == 0 or abs(x) > 1e-6)
positive = st.floats(1e-3, 1e6)


def triples(of: st.SearchStrategy[float]) -> st.SearchStrategy[np.ndarray]:
    return st.lists(of, min_size=3, max_size=3).map(np.array)


matrices = st.lists(st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3), min_size=3, max_size=3)

texts = st.text(st.characters(codec="utf-8"), max_size=12)
counts = st.integers(0, 999)
unknown_or_positive = st.lists(positive | st.just(float("nan")), min_size=3, max_size=3).map(np.array)

thermals = st.builds(
    Thermal,
    slope_lsb_per_degc=triples(numbers),
    slope_sem_lsb_per_degc=triples(positive),
    reference_degc=st.floats(-40, 85),
    meaning=st.tuples(*[st.sampled_from(["bias", "bias or scale"])] * 3),
    thermometer=st.sampled_from(THERMOMETERS),
    lag_s=st.floats(0, 1e4),
    lag_interval_s=st.none() | st.lists(positive, min_size=2, max_size=2).map(np.array),
    quadratic_lsb_per_degc2=st.none() | triples(numbers),
    scale_slope_per_degc=st.none() | unknown_or_positive,
    scale_slope_sem_per_degc=st.none() | unknown_or_positive,
    quadratic_sem_lsb_per_degc2=st.none() | triples(positive),
)
states = st.builds(
    BiasState, bias_lsb=triples(numbers), share=st.floats(0, 1), runs=st.lists(counts, max_size=4).map(tuple)
)
turn_ons = st.builds(
    TurnOn,
    rms_lsb=triples(positive),
    rms_sem_lsb=triples(positive),
    spread_lsb=triples(positive),
    p_value=st.lists(st.floats(0, 1) | st.just(float("nan")), min_size=3, max_size=3).map(np.array),
    runs=counts,
    states=st.lists(states, max_size=2).map(tuple),
    apart=st.lists(counts, max_size=3).map(tuple),
    gravity_lsb=st.none() | triples(numbers),
)
drifts = st.builds(
    Drift,
    rms_lsb=triples(positive),
    rms_sem_lsb=triples(positive),
    time_constant_s=st.floats(1e-3, 1e6),
    rms_upper_lsb=st.none() | triples(positive),
    time_constant_interval_s=st.none()
    | st.lists(positive | st.just(float("nan")), min_size=2, max_size=2).map(np.array),
    span_s=st.none() | st.floats(0, 1e6),
)
noise_lines = st.builds(
    NoiseLine,
    axis=st.sampled_from("xyz"),
    frequency_hz=st.floats(0, 1e3),
    amplitude_lsb=st.floats(0, 1e3),
    share=st.floats(0, 1),
    frequency_sem_hz=st.none() | st.floats(0, 1),
    amplitude_sem_lsb=st.none() | st.floats(0, 1),
    range_hz=st.none() | st.lists(positive, min_size=2, max_size=2).map(np.array),
)
origins = st.builds(
    Provenance,
    logs=st.lists(texts, max_size=2).map(tuple),
    software=texts,
    epoch=texts,
    temperature_degc=st.none() | st.floats(-40, 85),
)

sensors = st.builds(
    SensorCalibration,
    name=st.text(st.characters(codec="utf-8"), min_size=1, max_size=12),
    quantity=st.just("specific_force"),
    unit=st.just("g"),
    bias_lsb=triples(numbers),
    response_lsb_per_unit=st.builds(lambda m, s: s * (np.eye(3) + np.array(m)), matrices, positive),
    bias_sem_lsb=st.none() | triples(positive),
    response_sem_lsb_per_unit=st.none() | triples(positive),
    g_sensitivity_lsb_per_g=st.none() | st.lists(triples(numbers), min_size=3, max_size=3).map(np.array),
    noise_lsb=st.none() | triples(positive),
    noise_sem_lsb=st.none() | triples(positive),
    noise_correlation=st.none() | triples(st.floats(-1, 1)),
    noise_lines=st.lists(noise_lines, max_size=2).map(tuple),
    drift=st.none() | drifts,
    temperature_degc=st.none() | st.floats(-40, 85),
    bias_covariance_lsb2=st.none() | matrices.map(lambda m: np.array(m) @ np.array(m).T + np.eye(3)),
    g_sensitivity_sem_lsb_per_g=st.none() | st.lists(triples(positive), min_size=3, max_size=3).map(np.array),
    chip=st.none() | st.just("bma180"),
    response_covariance_lsb2_per_unit2=st.none() | st.just(np.diag(np.arange(1.0, 10.0))),
    thermal=st.none() | thermals,
    turn_on=st.none() | turn_ons,
    provenance=st.dictionaries(st.sampled_from(sorted(GROUPS)), origins, max_size=3),
)


def assert_alike(before: object, after: object) -> None:
    """Arrays to nine digits (nan equals nan; a tiny value is 0), everything else exactly."""
    if is_dataclass(before):
        assert type(before) is type(after)
        for item in fields(before):
            assert_alike(getattr(before, item.name), getattr(after, item.name))
    elif isinstance(before, np.ndarray):
        assert isinstance(after, np.ndarray)
        assert after == pytest.approx(before, rel=1e-8, abs=1e-60, nan_ok=True)
    elif isinstance(before, Mapping):
        assert isinstance(after, Mapping) and before.keys() == after.keys()
        for key, value in before.items():
            assert_alike(value, after[key])
    elif isinstance(before, tuple):
        assert isinstance(after, tuple) and len(before) == len(after)
        for one, other in zip(before, after, strict=True):
            assert_alike(one, other)
    else:
        assert before == after


@settings(max_examples=examples(60), deadline=None)
@given(st.lists(sensors, max_size=3, unique_by=lambda sensor: sensor.name), st.lists(st.text(max_size=9), max_size=2))
def test_a_calibration_survives_a_round_trip(written: list[SensorCalibration], sources: list[str]) -> None:
    """Nine digits survive, names and sources exactly; figures that were not measured stay unknown."""
    sources = [source.encode("utf-8", "ignore").decode() for source in sources]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "cal.toml"
        Calibration({sensor.name: sensor for sensor in written}, tuple(sources)).save(path)
        read = load_calibration(path)
    assert list(read.sensors) == [sensor.name for sensor in written]
    assert list(read.sources) == sources
    for sensor in written:
        assert_alike(sensor, read.sensors[sensor.name])


WANDERED = """
[sensor.drift]
rms_lsb = [1, 2, 3]
rms_sem_lsb = [1, 1, 1]
time_constant_s = 40
time_constant_interval_s = [20, nan]

[[sensor.noise_lines]]
axis = "x"
frequency_hz = 9
amplitude_lsb = 2
share = 0.5
"""

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
    "a square beyond any float": HEAD + SENSOR.replace("[1, 2, 3]", "[1e299, 2, 3]"),
    "drift beyond any float": HEAD + SENSOR + WANDERED.replace("rms_lsb = [1", "rms_lsb = [1e200"),
    "huge whole number": HEAD + SENSOR.replace("[1, 2, 3]", f"[1{'0' * 400}, 2, 3]"),
    "5000 digits": HEAD + f"x = {'9' * 5000}\n",
    "deep nesting": "x = " + "[" * 5000,
    "number in quotes": HEAD + SENSOR.replace("[1, 2, 3]", '["1", "2", "3"]'),
    "true for a number": HEAD + SENSOR.replace("[1, 2, 3]", "[true, 2, 3]"),
    "asymmetric covariance": HEAD + SENSOR + "bias_covariance_lsb2 = [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]\n",
    "negative variance": HEAD + SENSOR + "bias_covariance_lsb2 = [[1, 2, 0], [2, 1, 0], [0, 0, 1]]\n",
    "thermal a number": HEAD + SENSOR + "thermal = 5\n",
    "thermal half said": HEAD + SENSOR + "[sensor.thermal]\nreference_degc = 25\n",
    "unknown meaning": HEAD + SENSOR + HEATED.replace('["bias", ', '["colour", '),
    "two meanings": HEAD + SENSOR + HEATED.replace('["bias", ', "["),
    "unknown thermometer": HEAD + SENSOR + HEATED.replace("barometer", "thumb"),
    "negative lag": HEAD + SENSOR + HEATED + "lag_s = -1\n",
    "NaN slope": HEAD + SENSOR + HEATED.replace("[0.1, ", "[nan, "),
    "share above one": HEAD + SENSOR + TURNED_ON.replace("share = 0.5", "share = 1.5"),
    "runs half a run": HEAD + SENSOR + TURNED_ON.replace("runs = 7", "runs = 7.5"),
    "negative spread": HEAD + SENSOR + TURNED_ON.replace("spread_lsb = [1", "spread_lsb = [-1"),
    "probability of two": HEAD + SENSOR + TURNED_ON.replace("p_value = [0", "p_value = [2"),
    "states a table": HEAD + SENSOR + TURNED_ON.replace("[[sensor.turn_on.states]]", "[sensor.turn_on.states]"),
    "unknown group": HEAD + SENSOR + "[sensor.provenance.weather]\n",
    "provenance a text": HEAD + SENSOR + 'provenance = "mine"\n',
    "negative error of noise": HEAD + SENSOR + "noise_sem_lsb = [-1, 1, 1]\n",
    "correlation beyond one": HEAD + SENSOR + "noise_correlation = [0, 0, -1.5]\n",
    "lines a table": HEAD + SENSOR + WANDERED.replace("[[sensor.noise_lines]]", "[sensor.noise_lines]"),
    "line of a fourth axis": HEAD + SENSOR + WANDERED.replace('"x"', '"w"'),
    "line below zero": HEAD + SENSOR + WANDERED.replace("_hz = 9", "_hz = -9"),
    "line without a share": HEAD + SENSOR + WANDERED.replace("share = 0.5\n", ""),
    "line of more than all": HEAD + SENSOR + WANDERED.replace("share = 0.5", "share = 1.5"),
    "no time constant": HEAD + SENSOR + WANDERED.replace("time_constant_s = 40\n", ""),
    "time constant of zero": HEAD + SENSOR + WANDERED.replace("_s = 40", "_s = 0"),
    "NaN drift": HEAD + SENSOR + WANDERED.replace("rms_lsb = [1", "rms_lsb = [nan"),
    "drift a list": HEAD + SENSOR + "drift = [1, 2, 3]\n",
    "logs a text": HEAD + SENSOR + '[sensor.provenance.bias]\nlogs = "one"\n',
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


WHOLE = HEAD + SENSOR + HEATED + TURNED_ON + WANDERED


def test_the_valid_tables_of_the_malformed_cases_are_read(tmp_path: Path) -> None:
    path = tmp_path / "cal.toml"
    path.write_text(WHOLE, encoding="utf-8")
    sensor = load_calibration(path).sensors["A"]
    assert sensor.thermal is not None and sensor.turn_on is not None and sensor.drift is not None
    assert (sensor.drift.time_constant_s, sensor.drift.rms_lsb.tolist()) == (40, [1, 2, 3])
    assert sensor.noise_lines == (NoiseLine("x", 9.0, 2.0, 0.5),)
    assert sensor.thermal.meaning == ("bias", "bias", "bias or scale")
    assert (sensor.turn_on.runs, sensor.turn_on.states[0].share) == (7, 0.5)
    assert sensor.turn_on.states[0].bias_lsb.tolist() == [1, 2, 3]


@settings(max_examples=examples(150), deadline=None)
@given(st.integers(0, len(WHOLE) - 1), st.binary(max_size=6), st.integers(0, 20))
@example(0, b"\xff\xfe", 0)
def test_a_damaged_file_is_read_or_raises_a_calibration_error(place: int, inserted: bytes, removed: int) -> None:
    """Bytes overwritten at a random place: no other exception than CalibrationError."""
    good = WHOLE.encode()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "cal.toml"
        path.write_bytes(good[:place] + inserted + good[place + removed :])
        try:
            load_calibration(path)
        except ImuArrayError as error:
            assert str(error).startswith(str(path))


def test_a_noise_whose_square_underflows_is_zero(tmp_path: Path) -> None:
    """The square of such a noise is zero, and a division by it fails."""
    path = tmp_path / "cal.toml"
    path.write_text(HEAD + SENSOR + "noise_lsb = [1e-300, 1e-9, 2]\n")
    noise = load_calibration(path).sensors["A"].noise_lsb
    assert noise is not None and noise.tolist() == [0.0, 1e-9, 2.0]


@pytest.mark.parametrize("name", ["missing.toml", "."])
def test_a_missing_file_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(CalibrationError, match=r"No such file|Is a directory"):
        load_calibration(tmp_path / name)


def test_saving_overwrites_only_with_force(tmp_path: Path) -> None:
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
def test_tumble_and_noise_merge_in_either_order(older: SensorCalibration, newer: SensorCalibration) -> None:
    merged = Calibration({"A": older}, ("one",)).merged(Calibration({"A": newer}, ("two",)))
    both = merged.sensors["A"]
    assert both.bias_lsb.tolist() == [1, 2, 3]
    assert both.bias_sem_lsb is not None and both.noise_lsb is not None
    assert both.response_lsb_per_unit[0, 0] == 2000
    assert both.noise_lsb.tolist() == [7, 8, 9]
    assert both.temperature_degc == 25.0
    assert merged.sources == ("one", "two")


def test_a_new_measurement_replaces_the_older_figure() -> None:
    newer = known(bias_lsb=np.array([4.0, 5, 6]), bias_sem_lsb=np.ones(3), noise_lsb=np.ones(3))
    both = Calibration({"A": TUMBLED}).merged(Calibration({"A": newer})).sensors["A"]
    assert both.bias_lsb.tolist() == [4, 5, 6]
    assert both.response_lsb_per_unit[0, 0] == 2000


HEATED_SENSOR = known(
    thermal=Thermal(
        slope_lsb_per_degc=np.array([0.5, -2.0, 4.0]),
        slope_sem_lsb_per_degc=np.ones(3),
        reference_degc=30.0,
        meaning=("bias", "bias", "bias or scale"),
        thermometer="barometer",
        quadratic_lsb_per_degc2=np.array([0.0, 0.1, 0.0]),
    )
)
STARTED = known(turn_on=TurnOn(np.ones(3), np.ones(3), np.ones(3), np.zeros(3), 7))
FORCED = known(g_sensitivity_lsb_per_g=np.eye(3), g_sensitivity_sem_lsb_per_g=np.ones((3, 3)))


@settings(max_examples=examples(30), deadline=None)
@given(st.permutations([TUMBLED, NOISY, HEATED_SENSOR, STARTED, FORCED]))
def test_results_of_all_commands_merge_in_any_order(order: list[SensorCalibration]) -> None:
    merged = Calibration()
    for sensor in order:
        group = sensor.measured()[0]
        stamped = known(**{**vars(sensor), "provenance": {group: Provenance((f"{group}.h5",))}})
        merged = merged.merged(Calibration({"A": stamped}))
    both = merged.sensors["A"]
    assert both.measured() == ("bias", "response", "g_sensitivity", "noise", "thermal", "turn_on")
    assert both.bias_lsb.tolist() == [1, 2, 3]
    assert both.temperature_degc == 25.0
    assert both.thermal is HEATED_SENSOR.thermal and both.turn_on is STARTED.turn_on
    assert {group: origin.logs for group, origin in both.provenance.items()} == {
        group: (f"{group}.h5",) for group in ("bias", "g_sensitivity", "noise", "thermal", "turn_on")
    }


def test_a_new_bias_drops_covariance_and_provenance_of_the_older() -> None:
    older = known(
        **{**vars(TUMBLED), "bias_covariance_lsb2": np.eye(3), "provenance": {"bias": Provenance(("old.h5",))}}
    )
    newer = known(bias_lsb=np.array([4.0, 5, 6]), bias_sem_lsb=np.ones(3))
    both = Calibration({"A": older}).merged(Calibration({"A": newer})).sensors["A"]
    assert both.bias_covariance_lsb2 is None and both.temperature_degc is None
    assert both.provenance == {}


def test_merging_figures_of_two_ranges_is_refused() -> None:
    with pytest.raises(CalibrationError, match="sensor A: calibrated at a range of 2 g before, at 16 now"):
        Calibration({"A": known(range=2.0)}).merged(Calibration({"A": known(range=16.0)}))


def test_thermal_slopes_shift_the_bias_from_its_temperature() -> None:
    """From 25 to 40 degC about 30: slopes by 15, squares 100 - 25; the axis that may be one of scale stays."""
    moved = known(bias_lsb=np.array([1.0, 2.0, 3.0]), temperature_degc=25.0, thermal=HEATED_SENSOR.thermal)
    expected = [1 + 0.5 * 15, 2 - 2 * 15 + 0.1 * 75, 3]
    assert moved.bias_at(40.0) == pytest.approx(expected)
    assert moved.bias_at([25.0, 40.0]) == pytest.approx(np.array([[1, 2, 3], expected]))


def test_a_bias_of_unknown_temperature_holds_at_the_reference() -> None:
    moved = known(bias_lsb=np.array([1.0, 2.0, 3.0]), thermal=HEATED_SENSOR.thermal)
    assert moved.bias_at(32.0) == pytest.approx([1 + 1, 2 - 4 + 0.4, 3])
    assert known(bias_lsb=np.array([1.0, 2.0, 3.0])).bias_at([10.0, 20.0]).tolist() == [[1, 2, 3], [1, 2, 3]]


def test_provenance_is_added_to_figures_without_it(write_log: WriteLog) -> None:
    part = Part(accelerometer("A"), ideal("+X+Y+Z", 2048), np.zeros(3))
    done = known(**{**vars(TUMBLED), "noise_lsb": np.ones(3), "provenance": {"noise": Provenance(("before.h5",))}})
    with open_log(write_log([part], np.eye(3), name="one.h5")) as log:
        stamped = Calibration({"A": done}).stamped([log]).sensors["A"].provenance
    assert sorted(stamped) == ["bias", "noise", "response"]
    assert stamped["noise"].logs == ("before.h5",)
    assert [Path(path).name for path in stamped["bias"].logs] == ["one.h5"]
    assert (stamped["bias"].epoch, stamped["bias"].temperature_degc) == ("2024-01-01T00:00:00Z", 25.0)
    assert stamped["response"].software.startswith("imuarray ")


def test_lists_are_written_on_one_line() -> None:
    sensor = known(noise_lsb=np.array([7.0, 8.25, 1e-7]), thermal=HEATED_SENSOR.thermal)
    lines = Calibration({"A": sensor}, ("a, b.h5",)).to_toml().splitlines()
    assert "noise_lsb = [7.0, 8.25, 1e-07]" in lines
    assert 'meaning = ["bias", "bias", "bias or scale"]' in lines
    assert 'sources = ["a, b.h5"]' in lines
    assert "  [0.0, 2048.0, 0.0]," in lines


def test_a_merge_keeps_other_sensors() -> None:
    merged = Calibration({"A": TUMBLED}).merged(Calibration({"B": known(name="B")}))
    assert sorted(merged.sensors) == ["A", "B"]


def test_merging_different_sensors_of_one_name_is_refused() -> None:
    gyro = known(quantity="angular_rate", unit="dps", noise_lsb=np.ones(3))
    with pytest.raises(CalibrationError):
        Calibration({"A": TUMBLED}).merged(Calibration({"A": gyro}))


def test_an_uncalibrated_sensor_uses_the_data_sheet(write_log: WriteLog) -> None:
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


def test_a_calibration_of_another_array_is_refused(write_log: WriteLog) -> None:
    """It has other sensors, or one of the same name with another chip."""
    part = Part(accelerometer("BMA1", "+X+Y+Z"), ideal("+X+Y+Z", 2048), np.zeros(3))
    with open_log(write_log([part], np.eye(3))) as log:
        with pytest.raises(
            CalibrationError, match="sensor BMA1: not calibrated; the calibration contains BMA2; did you mean"
        ):
            Calibration({"BMA2": known(name="BMA2")}).of(log["BMA1"])
        with pytest.raises(CalibrationError, match="sensor BMA1: calibrated as chip mpu6050, logged as bma180"):
            Calibration({"BMA1": known(name="BMA1", chip="mpu6050")}).of(log["BMA1"])
        own = Calibration({"BMA1": known(name="BMA1", chip=log["BMA1"].chip, bias_lsb=np.ones(3))})
        assert own.of(log["BMA1"]).bias_lsb.tolist() == [1, 1, 1]
        assert Calibration({"BMA2": known(name="BMA2")}).or_nominal(log["BMA1"]).bias_lsb.tolist() == [0, 0, 0]
        with pytest.raises(
            FusionError, match="the calibration contains BMA2, but none of the sensors to be fused: BMA1"
        ):
            next(fuse(log, Calibration({"BMA2": known(name="BMA2")}), "mean"))


def test_counts_are_converted_to_a_triad_in_the_box_frame() -> None:
    """Misaligned axes of different scale: the counts of a known stimulus are converted back to it, in SI."""
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
def test_azimuth_and_elevation_in_all_quadrants(
    direction: tuple[float, float, float], azimuth: float, elevation: float
) -> None:
    rows = np.array([direction, direction, direction], float) * 512
    result = known(response_lsb_per_unit=rows).azimuth_elevation_deg()
    assert result[0] == pytest.approx((azimuth, elevation))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("bias_lsb = [1, 2]", ":8: sensor 1: bias_lsb must have 3 finite numbers"),
        ("bias_lsb = [1, 2, 3]\nbais_lsb = [1, 2, 3]", ":9: sensor 1: bais_lsb: unknown key; allowed are "),
        (
            'bias_lsb = [1, 2, 3]\n\n[[sensor.noise_lines]]\naxis = "w"',
            ":10: sensor 1: noise_lines 1: a table is required",
        ),
    ],
)
def test_an_error_names_the_line_of_the_file(wrong: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "cal.toml"
    path.write_text(
        '[calibration]\nformat_version = 1\n[[sensor]]\nname = "A"\nquantity = "specific_force"\nunit = "g"\n'
        "response_lsb_per_unit = [[9, 0, 0], [0, 9, 0], [0, 0, 9]]\n" + wrong + "\n",
        encoding="utf-8",
    )
    with pytest.raises(CalibrationError) as refused:
        load_calibration(path)
    assert f"{path}{message}" in str(refused.value)
