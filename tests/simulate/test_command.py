"""`imuarray simulate` on the command line."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from imuarray.cli import main
from imuarray.commands.simulate import EXPERIMENTS as TYPED
from imuarray.log import open_log
from imuarray.simulate import load_model
from imuarray.simulate.experiments import EXPERIMENTS
from tests.selection import some

CONFIGS = Path(__file__).parents[2] / "configs"


def simulate(*arguments: object) -> int:
    return main(["simulate", *map(str, arguments)])


def counts(path: Path, name: str = "BMA1") -> Any:
    with open_log(path) as log:
        return np.asarray(log[name].counts)


def test_the_command_has_every_experiment() -> None:
    assert tuple(EXPERIMENTS) == TYPED


@pytest.mark.slow
@pytest.mark.parametrize("experiment", some(["static", "tumble", "heating", "motion"], 1))
def test_every_experiment_has_the_requested_length(tmp_path: Path, experiment: str) -> None:
    run = tmp_path / "run.h5"
    assert simulate("martin2013", "--experiment", experiment, "--seconds", 30, "-o", run) == 0
    with open_log(run) as log:
        assert log.source == "simulated"
        assert len(log["Gyro1"]) == 1500
        assert log.phases[-1].end_ns == pytest.approx(30e9, rel=0.05)
        assert log.truth is not None


@pytest.mark.slow
def test_a_turn_on_series_is_one_file_per_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["martin2013", "--model", "martin2013", "--experiment", "turn-on", "--runs", 3, "--seconds", 20]
    assert simulate(*arguments, "--only", "Gyro3,BMA1", "-o", tmp_path / "run.h5", "--json") == 0
    report = json.loads(capsys.readouterr().out)
    paths = [Path(log["log"]) for log in report["logs"]]
    assert [path.name for path in paths] == ["run_01.h5", "run_02.h5", "run_03.h5"]
    names = []
    for path in paths:
        with open_log(path) as log:
            names += [phase.name for phase in log.phases]
    assert names == ["run 1", "run 2", "run 3"]
    assert not np.array_equal(counts(paths[0]), counts(paths[1]))
    bistable = [effect for effect in report["effects"]["Gyro3"] if effect["effect"] == "bistable_bias"]
    assert bistable[0]["offset_dps"][0] == pytest.approx(-12.6 * 0.00875, abs=0.3 * 0.00875)  # Table 7


@pytest.mark.slow
def test_equal_seeds_give_equal_logs_and_other_seeds_other_logs(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.h5" for name in "abcd"]
    for path, more in zip(paths, [(), ("--workers", 2), ("--seed", 1), ("--boot", 1)], strict=True):
        assert simulate("martin2013", "--seconds", 2, *more, "-o", path) == 0
    same, threads, seed, boot = (counts(path) for path in paths)
    assert np.array_equal(same, threads)
    assert not np.array_equal(same, seed)
    assert not np.array_equal(same, boot)


@pytest.mark.slow
def test_leaving_out_an_effect_changes_no_other_draw(tmp_path: Path) -> None:
    for name, more in (("all", ""), ("less", "bias"), ("silent", "white_noise,bias_instability")):
        arguments = ["martin2013", "--model", "martin2013", "--seconds", 20, "--without", more]
        assert simulate(*arguments, "-o", tmp_path / f"{name}.h5") == 0
    everything, unbiased, silent = (counts(tmp_path / f"{name}.h5").astype(float) for name in ("all", "less", "silent"))
    apart = everything - unbiased
    # the removed part is a constant, up to the rounding of both
    assert (np.ptp(apart, axis=0) <= 1).all()
    assert np.abs(apart.mean(axis=0)).min() > 5
    assert silent.std(axis=0).max() < 1 < everything.std(axis=0).min()


@pytest.mark.slow
def test_units_drawn_anew_differ_from_the_papers(tmp_path: Path) -> None:
    for name, more in (("known", ()), ("drawn", ("--population",))):
        arguments = ["martin2013", "--model", "martin2013", "--seconds", 5, *more]
        assert simulate(*arguments, "-o", tmp_path / f"{name}.h5") == 0
    known, drawn = (counts(tmp_path / f"{name}.h5", "BMA3").mean(axis=0) for name in ("known", "drawn"))
    assert np.abs(known - drawn).max() > 20


@pytest.mark.slow
def test_a_calibration_becomes_units(tmp_path: Path) -> None:
    run, calibration, again = tmp_path / "run.h5", tmp_path / "cal.toml", tmp_path / "again.h5"
    common = ("martin2013", "--experiment", "tumble", "--seconds", 210, "--only", "BMA1,BMA2,ADXL1")
    assert simulate(*common, "--model", "martin2013", "-o", run) == 0
    assert main(["calibrate", "tumble", str(run), "-o", str(calibration)]) == 0
    assert simulate(*common, "--calibration", calibration, "--seed", 7, "-o", again) == 0
    with open_log(run) as first, open_log(again) as second:
        for phase in first.phases:
            rows = first["BMA1"].between(phase.start_ns, phase.end_ns)
            ours, theirs = (np.asarray(log["BMA1"].counts[rows], float).mean(axis=0) for log in (first, second))
            # 1450 readings of 8 to 9 counts: 0.3 for the difference of two means; the datasheet model adds its own
            # nonlinearity (a few counts at 1 g at most) and in-run effects
            assert np.abs(ours - theirs).max() < 4


@pytest.mark.slow
def test_a_log_is_simulated_like_a_recorded_log(tmp_path: Path) -> None:
    first, again = tmp_path / "first.h5", tmp_path / "again.h5"
    assert (
        main(["log", "martin2013", "--bus", "emulated:?world=tumble&face_s=3", "--seconds", "12", "-o", str(first)])
        == 0
    )
    assert simulate("--like", first, "--model", "martin2013", "-o", again) == 0
    with open_log(first) as log, open_log(again) as copy:
        assert copy.phases == log.phases
        assert copy.epoch == log.epoch
        for name, sensor in log.sensors.items():
            np.testing.assert_array_equal(np.asarray(copy[name].time), np.asarray(sensor.time))
        ours, theirs = (np.asarray(source["BMA1"].counts[:100], float).mean(axis=0) for source in (copy, log))
    assert np.abs(ours - theirs).max() < 20  # the same unit, in the same pose


@pytest.mark.slow
def test_another_experiment_is_simulated_for_the_array_of_a_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its sensors and its frame rate; the length, the face and the motion are those of the experiment."""
    run, other = tmp_path / "run.h5", tmp_path / "other.h5"
    assert simulate("martin2013", "--only", "Gyro1,BMA2", "--rate-hz", 20, "--seconds", 2, "-o", run) == 0
    assert simulate("--like", run, "--experiment", "static", "--up=-X", "--seconds", 5, "-o", other) == 0
    with open_log(other) as log:
        assert set(log.sensors) == {"Gyro1", "BMA2"}
        assert len(log["Gyro1"]) == 100
        assert log.frame_rate_hz == 20
        assert [phase.up for phase in log.phases] == ["-X"]
    assert simulate("--like", run, "--experiment", "static", "--only", "Gyro2", "-o", tmp_path / "no.h5") == 2
    assert "no sensor 'Gyro2'" in capsys.readouterr().err
    with h5py.File(run, "r+") as file:
        file.attrs["config"] = ""
    assert simulate("--like", run, "--experiment", "static", "-o", tmp_path / "no.h5") == 2
    assert "it has no configuration, which another experiment needs; omit --experiment" in capsys.readouterr().err


@pytest.mark.slow
def test_a_trajectory_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "lift.csv"
    rows = [f"{t / 10},0,0,{0.5 * (t / 10) ** 2},0,0,0" for t in range(101)]  # 1 m/s2 upwards
    path.write_text("time_s,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg\n" + "\n".join(rows) + "\n", encoding="utf-8")
    run = tmp_path / "run.h5"
    assert simulate("martin2013", "--experiment", "motion", "--motion", path, "--seconds", 10, "-o", run) == 0
    with open_log(run) as log:
        assert log.truth is not None
        np.testing.assert_allclose(np.asarray(log.truth.specific_force)[100:400], [[0, 0, 10.80665]] * 300, atol=1e-6)
    assert (
        simulate("martin2013", "--experiment", "motion", "--motion", path, "--seconds", 20, "-o", run, "--force") == 2
    )


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((), "give either a CONFIG or --like"),
        (("martin2013", "--like", "x.h5"), "give either a CONFIG or --like"),
        (("nosuch",), "no array of that name"),
        (("martin2013", "--model", "nosuch"), "datasheet, martin2013"),
        (("martin2013", "--without", "gremlins"), "'gremlins'"),
        (("martin2013", "--only", "Gyro9"), "Gyro9"),
        (("martin2013", "--experiment", "motion", "--motion", "nosuch.csv"), "nosuch.csv"),
        (("martin2013", "--experiment", "motion", "--motion", "vehikel"), "hand, vehicle and a trajectory file"),
        (("martin2013", "--calibration", "nosuch.toml"), "nosuch.toml"),
        (("martin2013", "--motion", "vehicle"), "--motion is for --experiment motion"),
        (("martin2013", "--runs", "4"), "--runs is for --experiment turn-on"),
        (("martin2013", "--experiment", "heating", "--temperature", "10"), "--temperature is for"),
        (("--like", "x.h5", "--seconds", "9"), "--seconds: with --like it comes from the log, unless an --experiment"),
        (("--like", "x.h5", "--experiment", "tumble", "--runs", "4"), "--runs is for --experiment turn-on, not tumble"),
    ],
)
def test_bad_input_is_reported_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], complaint: str
) -> None:
    assert simulate(*arguments, "-o", tmp_path / "run.h5") == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert complaint in lines[0]
    assert not list(tmp_path.glob("*.h5"))


@pytest.mark.slow
def test_an_existing_log_is_overwritten_only_with_force(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run.h5"
    assert simulate("martin2013", "--seconds", 2, "-o", run) == 0
    before = run.read_bytes()
    assert simulate("martin2013", "--seconds", 2, "-o", run) == 2
    assert "--force" in capsys.readouterr().err
    assert run.read_bytes() == before
    assert simulate("martin2013", "--seconds", 2, "--seed", 1, "-o", run, "--force") == 0
    assert run.read_bytes() != before


@pytest.mark.parametrize("path", sorted((CONFIGS / "models").glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_model_loads_by_its_name(path: Path) -> None:
    assert load_model(path).name == path.stem


@pytest.mark.slow
def test_a_heated_box_can_be_upside_down(tmp_path: Path) -> None:
    run = tmp_path / "run.h5"
    assert simulate("martin2013", "--experiment", "heating", "--up=-Z", "--seconds", 20, "-o", run) == 0
    with open_log(run) as log:
        assert {phase.up for phase in log.phases} == {"-Z"}
        assert log.truth is not None
        np.testing.assert_allclose(np.asarray(log.truth.specific_force)[:5], [[0, 0, -9.80665]] * 5, atol=1e-12)


def test_sensors_missing_in_the_model_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "small.toml"
    text = '[model]\nname = "small"\n[[sensor]]\nname = "Gyro7"\nchip = "l3g4200d"\n[sensor.bias]\noffset_dps = 1.0\n'
    model.write_text(text, encoding="utf-8")
    assert (
        simulate("martin2013", "--model", model, "--only", "Gyro1,BMA1", "--seconds", 2, "-o", tmp_path / "r.h5") == 0
    )
    errors = capsys.readouterr().err
    assert "model small has no parameters for BMA1, Gyro1: simulated as ideal" in errors
    assert "its sensors Gyro7 are not in this array" in errors


@pytest.fixture
def as_in_a_terminal() -> Iterator[None]:
    """Ctrl-C as in an interactive program, also where a shell has started the tests in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("as_in_a_terminal")
def test_an_interrupt_lost_by_python_acts_at_the_next_step() -> None:
    """An exception raised in a callback of the garbage collector is printed and forgotten: the next step ends it."""
    from imuarray.commands.options import progress

    with pytest.raises(KeyboardInterrupt), progress(10, "work") as done:
        with suppress(KeyboardInterrupt):  # lost
            signal.raise_signal(signal.SIGINT)
        done(1)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("as_in_a_terminal")
def test_other_terminating_signals_act_as_an_interrupt() -> None:
    from imuarray.commands.options import ended_by_signals, progress

    before = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)]
    with pytest.raises(KeyboardInterrupt), ended_by_signals(), progress(10, "work") as done:
        with suppress(KeyboardInterrupt):  # lost
            signal.raise_signal(signal.SIGTERM)
        done(1)
    assert [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)] == before


@pytest.mark.parametrize(
    ("state", "line"),
    [
        ((0, 0, 7.2), "step: 7 s"),
        ((0, 40, 3.0), "step: 0 of 40 in 3 s"),
        ((10, 40, 30.0), "step: 10 of 40 in 30 s, 90 s left"),
        ((1, 21, 60.0), "step: 1 of 21 in 60 s, 20 min left"),
    ],
)
def test_a_line_shows_the_progress_of_a_step(state: tuple[int, int, float], line: str) -> None:
    from imuarray.commands.options import progress_line

    assert progress_line("step", *state) == line


def test_progress_lines_are_printed_without_a_terminal_also_during_a_long_step(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from imuarray.commands import options

    monkeypatch.setattr(options, "_EVERY_S", 0.01)
    output = ""
    with options.Steps() as steps:
        steps.begin("reading")
        while "reading: 0 s\n" not in output:
            output += capsys.readouterr().err
        with steps.bar(4) as tell:
            tell(2)
            while "reading: 2 of 4 in 0 s, 0 s left\n" not in output:
                output += capsys.readouterr().err
    assert not steps._thread.is_alive()


def test_effects_are_listed_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--effects", "--json"]) == 0
    effects = json.loads(capsys.readouterr().out)["effects"]
    assert effects["popcorn_noise"]["meaning"]
    assert effects["tone"]["parameters"][:3] == ["amplitude_UNIT", "frequency_hz", "phase_deg"]
    assert main(["simulate", "martin2013"]) == 2
    assert capsys.readouterr().err == "imuarray: Missing option '-o' / '--output'.\n"
