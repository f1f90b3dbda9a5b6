"""One call for each step: the same results as the commands, with uncertainties, drawings and tables."""

from __future__ import annotations

import inspect
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

import imuarray as ia
from imuarray.calibrate import Calibration, SensorCalibration, calibrate_noise, calibrate_tumble, calibrate_turn_on
from imuarray.cli import program
from imuarray.errors import CalibrationError, ConfigError, FusionError, LogError, MissingExtraError
from imuarray.fuse import read_fused_head
from imuarray.fuse.fused_file import FusedEvent
from imuarray.log import Log
from imuarray.simulate import EFFECTS
from tests.log.conftest import write_small
from tests.selection import some


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tumble, a log at rest and a calibration."""
    here = tmp_path_factory.mktemp("analysis")
    ia.simulate("martin2013", here / "tumble.h5", experiment="tumble", seconds=60.0, model="martin2013").close()
    ia.simulate("martin2013", here / "rest.h5", seconds=40.0, model="martin2013").close()
    ia.calibrate_tumble(here / "tumble.h5").calibration.save(here / "cal.toml")
    return here


@pytest.fixture(scope="module")
def rest(folder: Path) -> Iterator[Log]:
    """The log at rest, open."""
    with ia.open_log(folder / "rest.h5") as log:
        yield log


def run(*words: str | Path) -> None:
    done = CliRunner().invoke(program, [str(word) for word in words])
    assert done.exit_code == 0, done.output


def columns(path: Path) -> dict[str, Any]:
    """Every dataset of numbers of a file."""
    result: dict[str, Any] = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, item: (
                result.update({name: item[...]})
                if isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf"
                else None
            )
        )
    return result


def equal(first: dict[str, Any], second: dict[str, Any]) -> bool:
    return first.keys() == second.keys() and all(
        np.array_equal(first[name], second[name], equal_nan=first[name].dtype.kind == "f") for name in first
    )


def test_a_fused_file_is_read_again(folder: Path, tmp_path: Path) -> None:
    """Frames, sensors and events; saving a result that was read gives the same file."""
    fused = ia.fuse(folder / "rest.h5", folder / "cal.toml", "mean")
    event = FusedEvent(2_000_000_000, "Gyro1", "stuck", "isolated", "Gyro1 is stuck: excluded")
    replace(fused, events=(event,)).save(tmp_path / "first.h5")
    again = ia.load_fused(tmp_path / "first.h5")
    assert (again.technique, again.epoch, again.log) == ("mean", fused.epoch, str(folder / "rest.h5"))
    assert {quantity: list(names) for quantity, names in again.sensors.items()} == {
        quantity: list(names) for quantity, names in fused.sensors.items()
    }
    assert again.events == (event,)
    np.testing.assert_array_equal(again.specific_force, fused.specific_force)
    np.testing.assert_array_equal(again.standard_error("angular_rate"), fused.standard_error("angular_rate"))
    again.save(tmp_path / "second.h5")
    assert equal(columns(tmp_path / "first.h5"), columns(tmp_path / "second.h5"))
    with pytest.raises(LogError, match=r"rest\.h5: "):
        ia.load_fused(folder / "rest.h5")


def test_an_array_of_the_package_is_loaded_by_its_name() -> None:
    assert ia.load_array("martin2013").name == "martin2013"
    with pytest.raises(ConfigError, match="martin2014: no such file, and no array of that name comes with the package"):
        ia.load_array("martin2014")


@pytest.mark.slow
def test_a_simulation_equals_that_of_the_command(tmp_path: Path) -> None:
    run("simulate", "martin2013", "-o", tmp_path / "a.h5", "--seconds", "5", "--seed", "3", "--without", "tone")
    with ia.simulate("martin2013", tmp_path / "b.h5", seconds=5.0, seed=3, without=["tone"]) as log:
        assert log.source == "simulated"
    assert equal(columns(tmp_path / "a.h5"), columns(tmp_path / "b.h5"))
    run("simulate", "--like", tmp_path / "a.h5", "-o", tmp_path / "c.h5", "--seed", "4", "--model", "martin2013")
    ia.simulate(tmp_path / "a.h5", tmp_path / "d.h5", seed=4, model="martin2013").close()
    assert equal(columns(tmp_path / "c.h5"), columns(tmp_path / "d.h5"))


@pytest.mark.slow
def test_an_effect_is_added_to_one_sensor_only(tmp_path: Path) -> None:
    """A sine of amplitude a has an rms of a / sqrt(2)."""
    tone = EFFECTS["tone"](amplitude=5.0, frequency_hz=7.0)  # type: ignore[call-arg]
    with (
        ia.simulate("martin2013", tmp_path / "a.h5", seconds=20.0) as plain,
        ia.simulate("martin2013", tmp_path / "b.h5", seconds=20.0, effects={"Gyro1": [tone]}) as hum,
    ):
        added_dps = (hum["Gyro1"].counts[:].astype(float) - plain["Gyro1"].counts[:]) / plain["Gyro1"].sensitivity
        np.testing.assert_allclose(added_dps.std(axis=0), 5.0 / np.sqrt(2), rtol=0.02)
        np.testing.assert_array_equal(hum["Gyro2"].counts[:], plain["Gyro2"].counts[:])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"experiment": "heat"}, "allowed are static, tumble, heating"),
        ({"effects": {"Gyro9": []}}, "effects of 'Gyro9': the array has"),
        ({"effects": {"Gyro1": ["tone"]}}, r"effects of Gyro1: 'tone' is no effect; give EFFECTS\[\"tone\"\]"),
        ({"effects": {"Gyro1": EFFECTS["tone"](amplitude=1.0)}}, r"effects of Gyro1: Tone\(.*: a list of effects is"),
        ({"model": "datashet"}, "no model of that name"),
    ],
)
def test_an_invalid_option_is_refused_with_the_allowed_values(
    tmp_path: Path, options: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        ia.simulate("martin2013", tmp_path / "a.h5", seconds=1.0, **options)
    assert not (tmp_path / "a.h5").exists()


def test_seconds_must_be_a_number(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="seconds '20s': allowed is a number of seconds"):
        ia.simulate("martin2013", tmp_path / "a.h5", seconds="20s")  # type: ignore[arg-type]


def test_a_calibration_is_indexed_and_becomes_a_table() -> None:
    known = SensorCalibration(
        "A1", "specific_force", "g", np.array([1.0, 2.0, -3.0]), np.eye(3) * 1000.0, bias_sem_lsb=np.full(3, 0.5)
    )
    calibration = Calibration({"A1": known})
    assert calibration["A1"] is known
    with pytest.raises(CalibrationError, match=r"no calibration of 'a1'; there is A1; did you mean A1\?"):
        calibration["a1"]
    table = calibration.to_pandas()
    assert table.index.names == ["sensor", "axis"]
    assert table.loc[("A1", "z"), "bias"] == pytest.approx(-0.003)
    assert table["bias_sem"].tolist() == pytest.approx([0.0005] * 3)
    assert table["scale_lsb_per_unit"].tolist() == [1000.0] * 3
    assert table["noise"].isna().all()


@pytest.mark.slow
def test_simulating_a_recorded_log_refuses_other_conditions(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="seconds: with a recorded log these come from the log"):
        ia.simulate(folder / "rest.h5", tmp_path / "a.h5", seconds=1.0)


@pytest.mark.parametrize("technique", some(["mean", "optimal"], 1))
def test_a_fusion_equals_that_of_the_command(folder: Path, tmp_path: Path, technique: str) -> None:
    command, own = tmp_path / "command.h5", tmp_path / "own.h5"
    run("fuse", folder / "rest.h5", "--calibration", folder / "cal.toml", "--technique", technique, "-o", command)
    fused = ia.fuse(folder / "rest.h5", folder / "cal.toml", technique)
    assert fused.save(own) == len(fused.time) > 1000
    assert equal(columns(command), columns(own))
    assert read_fused_head(own) == read_fused_head(command)
    # against the truth by hand: the box is at rest, Z up. (All frames, not only those within the truth's times.)
    still = np.array([0.0, 0.0, 9.80665])
    by_hand = np.sqrt(np.nanmean((fused.specific_force - still) ** 2, axis=0))
    np.testing.assert_allclose(fused.errors["specific_force"].rms, by_hand, rtol=1e-2)


@pytest.mark.slow
def test_a_fusion_remarks_on_missing_calibration(folder: Path) -> None:
    fused = ia.fuse(folder / "rest.h5", technique="planes", only=["BMA1", "BMA2", "Gyro1"])
    assert fused.sensors == {"specific_force": ["BMA1", "BMA2"], "angular_rate": ["Gyro1"]}
    assert any(remark.startswith("no noise in the calibration") for remark in fused.remarks)
    other = Calibration({"Other": ia.calibrate_noise(folder / "rest.h5").sensors["Gyro1"]})
    with pytest.raises(FusionError, match="the calibration: contains Other, but none of"):
        ia.fuse(folder / "rest.h5", other)


@pytest.mark.slow
def test_a_characterisation_equals_that_of_the_command(folder: Path, tmp_path: Path) -> None:
    run("characterise", folder / "rest.h5", "-o", tmp_path / "noise", "--sensor", "Gyro1,BMA1")
    characterisation = ia.characterise(folder / "rest.h5", sensors=["Gyro1", "BMA1"])
    assert characterisation.result == json.loads((tmp_path / "noise" / "characterise.json").read_text())
    white = characterisation.coefficient("Gyro1", "x")
    assert white is not None
    assert white.low < white.value < white.high
    assert white.unit == "dps/sqrt(Hz)"
    assert repr(white).startswith(f"Coefficient(value={white.value:.4g}, low={white.low:.4g}")
    # counts that are white with a scatter of s at r rows a second have N = s / sqrt(r)
    entry = characterisation.axis("Gyro1", "x")
    assert white.value == pytest.approx(entry["unit"]["std"] / np.sqrt(50.0), rel=0.1)
    table = characterisation.to_pandas()
    assert table.loc[("Gyro1", "x"), "N"] == white.value
    for sensor, axis, term, words in (
        ("Gyro7", "x", "white", "no sensor 'Gyro7'"),
        ("Gyro1", "q", "white", "no axis 'q'"),
        ("Gyro1", "x", "pink", "allowed are white"),
    ):
        with pytest.raises(LogError, match=words):
            characterisation.coefficient(sensor, axis, term)


@pytest.mark.slow
def test_every_result_has_a_figure_and_a_table(folder: Path, tmp_path: Path) -> None:
    with ia.open_log(folder / "rest.h5") as log:
        tumble = ia.calibrate_tumble(folder / "tumble.h5")
        results = [log, tumble, tumble.calibration, ia.calibrate_noise(log), ia.fuse(log, technique="mean")]
        results.append(ia.characterise(log, sensors=["Gyro1"]))
        for number, result in enumerate(results):
            result.plot().savefig(tmp_path / f"{number}.svg")
            assert (tmp_path / f"{number}.svg").stat().st_size > 10_000
            html = result._repr_html_()
            assert html.count("<tr>") == html.count("</tr>") > 1
            assert len(repr(result)) < 2000
        assert "Gyro1" in log.plot(["Gyro1"]).axes[0].get_ylabel()
    assert repr(log).endswith("closed>")


def test_a_figure_of_an_unmeasured_group_is_refused(folder: Path) -> None:
    known = ia.load_calibration(folder / "cal.toml")
    panels = [axes.get_xlabel() for axes in known.plot("bias").axes]
    assert panels == ["bias, mg; bars: two standard errors", "bias, dps; bars: two standard errors"]
    with pytest.raises(CalibrationError, match="thermal was not measured; the calibration contains bias"):
        known.plot("thermal")
    with pytest.raises(CalibrationError, match="allowed are bias, noise, thermal, turn_on"):
        known.plot("therml")


def test_a_diagnosis_with_too_few_replicates_is_refused() -> None:
    """With b replicates p is at least 1 / (1 + b), and a gap needs 1 / 20."""
    with pytest.raises(ConfigError, match="replicates: 18 given; at least 19 are needed"):
        ia.diagnose("rest.h5", replicates=18)


@pytest.mark.slow
def test_one_log_is_diagnosed_without_a_list(folder: Path, tmp_path: Path) -> None:
    diagnosis = ia.diagnose(folder / "rest.h5", model="martin2013", only=["Gyro1"], replicates=40)
    assert [recording.name for recording in diagnosis.recorded] == ["rest.h5"]
    diagnosis.plot().savefig(tmp_path / "found.svg")
    assert diagnosis.verdict in repr(diagnosis)
    verdict = f"Verdict {diagnosis.verdict}: {diagnosis.reason}"
    assert " ".join(str(diagnosis).split()).startswith(f"{verdict} Limits only what could be compared agrees; ")
    assert diagnosis.sentence in diagnosis._repr_html_()
    assert "<table>" in diagnosis._repr_html_()


@pytest.mark.parametrize("name", ["fuse", "simulate", "characterise"])
def test_a_package_can_be_called_as_the_function_of_its_name(name: str) -> None:
    import imuarray.analysis

    package = getattr(ia, name)
    assert package is sys.modules[f"imuarray.{name}"]
    assert inspect.signature(package) == inspect.signature(getattr(imuarray.analysis, name))


class TestLabelled:
    """Against the literals of `write_small`: 512 counts are one g (range 16), axes +Y+X-Z."""

    def test_sensors_have_units_and_times(self, tmp_path: Path) -> None:
        with ia.open_log(write_small(tmp_path / "small.h5")) as log:
            tree = log.to_xarray()
        force = tree["Acc"]["specific_force"]
        # counts 512, -256, 0: one g along the sensor's x, which is the box's Y; minus half a g along its y, the box's X
        np.testing.assert_allclose(force[0], [-4.903325, 9.80665, 0.0])
        assert (force.dims, force.attrs["units"]) == (("time", "box_axis"), "m s-2")
        assert list(force.box_axis.values) == ["X", "Y", "Z"]
        assert force.time.values[1] == np.datetime64("2013-09-16T08:30:00.010000000")
        np.testing.assert_array_equal(tree["Acc"]["counts"][0], [512, -256, 0])
        assert tree["Acc"]["counts"].attrs["units"] == "count"
        assert tree["Gyro"]["angular_rate"].attrs["units"] == "rad s-1"
        np.testing.assert_array_equal(tree["Baro"]["pressure"], [69963.0, 69970.0])
        assert tree["Baro"]["pressure"].attrs["units"] == "Pa"
        assert tree["truth"]["specific_force"].attrs["units"] == "m s-2"
        assert tree["Gyro"].attrs["range_unit"] == "dps"
        assert tree["Acc"]["status"].attrs["flag_meanings"].split()[:3] == ["stale", "overrun", "saturated"]

    def test_tables_have_a_column_for_each_number(self, tmp_path: Path) -> None:
        with ia.open_log(write_small(tmp_path / "small.h5")) as log:
            table = log["Gyro"].to_pandas()
        assert list(table.columns) == [
            *(f"angular_rate_{axis}" for axis in "XYZ"),
            *(f"counts_{axis}" for axis in "xyz"),
            "status",
        ]
        assert table.attrs["units"]["angular_rate_X"] == "rad s-1"
        assert table["counts_x"].tolist() == [1000, 32767, 7]
        assert str(table.index[0]) == "2013-09-16 08:30:00.010000"

    @pytest.mark.slow
    def test_a_calibration_removes_the_bias(self, folder: Path) -> None:
        known = ia.load_calibration(folder / "cal.toml")
        with ia.open_log(folder / "rest.h5") as log:
            gyro = log["Gyro1"]
            raw, calibrated = (gyro.to_xarray(each)["angular_rate"].mean("time").values for each in (None, known))
            assert np.linalg.norm(calibrated) < 0.2 * np.linalg.norm(raw)

    def test_a_log_without_a_date_has_durations(self) -> None:
        from imuarray.log.datasets import times_of

        assert times_of(np.array([5]), "")[0] == np.timedelta64(5, "ns")
        assert times_of(np.array([0]), "2024-01-01T01:00:00+01:00")[0] == np.datetime64("2024-01-01T00:00:00")

    @pytest.mark.slow
    def test_a_fused_result_has_named_dimensions(self, folder: Path, tmp_path: Path) -> None:
        import xarray

        fused = ia.fuse(folder / "rest.h5", folder / "cal.toml")
        fused.save(tmp_path / "fused.h5")
        with xarray.open_dataset(tmp_path / "fused.h5", engine="h5netcdf", group="fused") as stored:
            assert stored.specific_force.dims == ("time", "axis")
            assert list(stored.axis.values) == ["X", "Y", "Z"]
            assert list(stored.entry.values) == ["xx", "yy", "zz", "xy", "xz", "yz"]
            assert list(stored.angular_rate_sensor.values) == ["Gyro1", "Gyro2", "Gyro3"]
            assert stored.specific_force.attrs["units"] == "m s-2"
            assert stored.time.dtype == np.dtype("datetime64[ns]")
            labelled = fused.to_xarray()
            np.testing.assert_array_equal(labelled.specific_force, stored.specific_force)
            np.testing.assert_array_equal(labelled.time, stored.time)
        variance = fused.to_pandas()["specific_force_covariance_xx"]
        np.testing.assert_array_equal(variance, fused.frames.covariances["specific_force"][:, 0])

    def test_a_missing_package_is_named(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "xarray", None)
        with (
            ia.open_log(write_small(tmp_path / "small.h5")) as log,
            pytest.raises(MissingExtraError, match=r"xarray.*imuarray\[analysis\]"),
        ):
            log.to_pandas()


def test_a_table_contains_the_rows_of_a_phase(folder: Path) -> None:
    pytest.importorskip("xarray")
    with ia.open_log(folder / "tumble.h5") as log:
        sensor, phase = log["BMA1"], log.phases[1]
        time = np.asarray(sensor.time[:])
        rows = (phase.start_ns <= time) & (time < phase.end_ns)
        table = sensor.to_pandas(phase=phase.name)
        np.testing.assert_array_equal(table[["counts_x", "counts_y", "counts_z"]], sensor.counts[:][rows])
        assert len(log.to_pandas(phase=phase.name)["BMA1"]) == rows.sum() > 0
        mean = sensor.to_xarray(phase=phase.name)["specific_force"].mean("time").sel(box_axis=phase.up[1])
        assert float(mean) * {"+": 1, "-": -1}[phase.up[0]] > 5  # not calibrated
        with pytest.raises(LogError, match=r"tumble\.h5: no phase 'zup'; it has z_up, .*did you mean z_up"):
            sensor.to_pandas(phase="zup")


def test_representations_are_one_line(folder: Path) -> None:
    with ia.open_log(folder / "rest.h5") as log:
        counts = log["Gyro1"].counts
        place = f"{folder / 'rest.h5'}, sensor Gyro1: counts"
        assert repr(counts) == f"<column {place}, {len(counts)} x 3 int16>"
    known = SensorCalibration("A", "specific_force", "g", np.array([256.0, 0.0, -51.2]), 512 * np.eye(3))
    assert repr(known) == "<SensorCalibration A: nothing; bias 0.5, 0, -0.1 g>"
    assert repr(ia.load_array("martin2013")).startswith("<ArrayConfig martin2013: ADXL1, ")


@pytest.mark.slow
def test_a_log_given_twice_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same poses twice would count as twice as many, and standard errors would be 0.71 of their true size."""
    monkeypatch.chdir(folder)
    with pytest.raises(LogError, match=r"tumble.h5: is given more than once; each log is allowed once$"):
        ia.calibrate_tumble("./tumble.h5", folder / "tumble.h5")
    done = CliRunner().invoke(program, ["calibrate", "tumble", "tumble.h5", "./tumble.h5", "-o", "twice.toml"])
    assert "is given more than once" in str(done.exception)


@pytest.mark.parametrize(
    "analysis",
    [ia.calibrate_tumble, ia.calibrate_noise, ia.calibrate_thermal, ia.calibrate_turn_on, lambda: ia.diagnose([])],
)
def test_a_call_without_a_log_is_an_error_of_one_line(analysis: Any) -> None:
    with pytest.raises(LogError, match=r"^no log is given; at least one is required$"):
        analysis()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda log: ia.calibrate_tumble([log]),
            r"calibrate_tumble\(\*logs\): list given as a log; allowed is a path or ",
        ),
        (lambda log: ia.calibrate_noise([log]), r"calibrate_noise\(\*logs\): list given as a log"),
        (lambda log: ia.calibrate_thermal([log]), r"calibrate_thermal\(\*logs\): list given as a log"),
        (lambda log: ia.calibrate_turn_on([log]), r"calibrate_turn_on\(\*logs\): list given as a log"),
        (lambda log: ia.characterise([log]), r"characterise\(log\): list given as a log"),
        (lambda log: ia.fuse(3), r"fuse\(log\): int given as a log"),
        (lambda log: calibrate_turn_on(log), r"calibrate_turn_on\(logs\): Log given; allowed is a list of logs$"),
        (
            lambda log: calibrate_turn_on(["run.h5"]),
            r"calibrate_turn_on\(logs\): str given as a log; allowed is an open log$",
        ),
        (
            lambda log: calibrate_tumble([log]),
            r"calibrate_tumble\(\*logs\): list given as a log; allowed is an open log$",
        ),
        (lambda log: calibrate_noise(), "no log is given; at least one is required$"),
    ],
)
def test_a_list_is_not_accepted_as_a_log_nor_a_log_as_a_list(
    rest: Log, call: Callable[[Any], Any], message: str
) -> None:
    with pytest.raises(LogError, match=f"^{message}"):
        call(rest)


def test_a_list_is_not_accepted_as_a_calibration(folder: Path) -> None:
    with pytest.raises(CalibrationError, match=r"^list given as a calibration; allowed is a path or a Calibration$"):
        ia.fuse(folder / "rest.h5", [folder / "cal.toml"])  # type: ignore[arg-type]


def test_a_single_name_is_not_split_into_letters(folder: Path, tmp_path: Path) -> None:
    noise = ia.characterise(folder / "rest.h5", sensors="Gyro1")
    assert {row["sensor"] for row in noise.to_pandas().reset_index().to_dict("records")} == {"Gyro1"}
    with ia.simulate("martin2013", tmp_path / "one.h5", seconds=1, only="Gyro1", without="tone") as log:
        assert list(log.sensors) == ["Gyro1"]
    with pytest.raises(ConfigError, match="effect 'tne': allowed are"):
        ia.diagnose(folder / "rest.h5", without="tne")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seconds": -1}, "seconds: -1; allowed is anything above 0$"),
        ({"seconds": 1e30}, r"allowed is anything above 0 and below 4.6e\+09 s"),
        ({"up": "Z"}, r"up 'Z': allowed are \+X"),
        ({"seed": -1}, "seed -1"),
        ({"rate_hz": 0}, "0 frames per second: allowed is anything above 0"),
    ],
)
def test_invalid_conditions_are_refused(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ia.simulate("martin2013", tmp_path / "s.h5", **{"seconds": 1, **options})
    assert not list(tmp_path.iterdir())


def test_an_unknown_estimator_is_refused(folder: Path) -> None:
    with pytest.raises(ConfigError, match="estimator 'modified': allowed are overlapping, decimated"):
        ia.characterise(folder / "rest.h5", sensors=["Gyro1"], estimator="modified")  # type: ignore[arg-type]


def test_reading_a_closed_log_is_not_reported_as_damage(folder: Path) -> None:
    with ia.open_log(folder / "rest.h5") as log:
        gyro = log["Gyro1"]
    with pytest.raises(LogError, match=r"sensor Gyro1: counts: the log is closed; read its rows while it is open"):
        gyro.counts[:3]
