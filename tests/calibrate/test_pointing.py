"""Orientation of sensors from poses by hand: a box turned in an unrecorded way, sensors mounted at random."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imuarray.calibrate.pointing import TURNS, Pointing, find_pointing, upright_poses, with_axes
from imuarray.commands.calibrate import _axes_report, _print_axes
from imuarray.errors import CalibrationError, ConfigError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Phase, SensorHeader
from tests.calibrate.conftest import EPOCH, Floats, ideal
from tests.selection import some

RATE_HZ, REST_S, TURN_S = 50.0, 4.0, 1.5
FIELD_WORLD = np.array([0.2, 0.05, -0.45])
"""Gauss, in a frame whose z points up."""

UP = {"+X": (1, 0, 0), "-X": (-1, 0, 0), "+Y": (0, 1, 0), "-Y": (0, -1, 0), "+Z": (0, 0, 1), "-Z": (0, 0, -1)}


def attitude(up: str, heading_rad: float) -> Rotation:
    """Box to world: the given box axis up, with any heading."""
    axis = (1, 0, 0) if up[1] == "Z" else np.cross(UP[up], (0, 0, 1))
    level = Rotation.from_rotvec(np.arccos(UP[up][2]) * np.asarray(axis, float))
    return Rotation.from_rotvec([0, 0, heading_rad]) * level


def held(ups: Sequence[str], seed: int = 5) -> tuple[Floats, Rotation, Floats]:
    """Seconds (n,), attitudes box to world and rates (n, 3) in rad/s in the box frame of a box held and turned."""
    rng = np.random.default_rng(seed)
    ends = [attitude(up, rng.uniform(0, 6)) for up in ups]
    rest, turn = round(REST_S * RATE_HZ), round(TURN_S * RATE_HZ)
    parts, rates = [], []
    for place, first in enumerate(ends):
        parts += [first] * rest
        rates += [np.zeros(3)] * rest
        if place + 1 < len(ends):
            way = (first.inv() * ends[place + 1]).as_rotvec()
            share = (np.arange(turn) + 0.5) / turn
            parts += [first * Rotation.from_rotvec(way * part) for part in share]
            rates += [way / TURN_S] * turn
    return np.arange(len(parts)) / RATE_HZ, Rotation.concatenate(parts), np.array(rates)


Written = Callable[..., Path]


@pytest.fixture
def written(tmp_path: Path) -> Written:
    """A log of sensors that point along `axes`, while the log states +X+Y+Z; phases only where named."""

    def write(axes: dict[str, str], ups: Sequence[str], *, named: bool = False, bias: float = 0.1) -> Path:
        rng = np.random.default_rng(3)
        seconds, attitudes, rates = held(ups)
        time = np.round(seconds * 1e9).astype(np.int64)
        box = {
            "a": attitudes.inv().apply([0.0, 0.0, 1.0]),
            "g": np.degrees(rates),
            "m": attitudes.inv().apply(FIELD_WORLD),
        }
        kinds = {
            "a": ("bma180", "specific_force", "g", 4.0, 2048.0, 0.02),
            "g": ("l3g4200d", "angular_rate", "dps", 500.0, 1 / 0.0175, 0.2),
            "m": ("hmc5883l", "magnetic_field", "gauss", 1.3, 1090.0, 0.002),
        }
        headers = [SensorHeader(name, *kinds[name[0]][:5]) for name in axes]
        path = tmp_path / "poses.h5"
        with LogWriter(path, headers, source="simulated", epoch=EPOCH) as writer:
            for name, text in axes.items():
                sensitivity, sigma = kinds[name[0]][4:]
                exact = box[name[0]] @ ideal(text, sensitivity).T
                exact += sensitivity * (bias * rng.uniform(-1, 1, 3) + rng.normal(0, sigma, exact.shape))
                writer.append(name, Block(time, np.rint(exact).astype(np.int16), np.zeros(len(time), np.uint16)))
            for place, up in enumerate(ups if named else ()):
                start = round(place * (REST_S + TURN_S) * 1e9)
                face = f"{up[1].lower()}_{'up' if up[0] == '+' else 'down'}"
                writer.phase(Phase(start, start + round(REST_S * 1e9), face, up))
        return path

    return write


AXES = {"a1": "-Y+X+Z", "a2": "+Y+X-Z", "a3": "+Z+X+Y", "g1": "+X-Y-Z", "g2": "-Z-X+Y", "m1": "-X-Y+Z"}


@pytest.mark.parametrize("named", some([True, False], 1))
def test_three_poses_determine_every_axis(written: Written, named: bool) -> None:
    with open_log(written(AXES, ("+Z", "+X", "+Y"), named=named)) as log:
        result = find_pointing(log, upright_poses(log))
    assert {each.sensor: each.axes for each in result} == AXES


@pytest.mark.slow
def test_every_mounting_orientation_is_determined(written: Written) -> None:
    signs = [
        "".join("+-"[int(row[np.abs(row).argmax()] < 0)] + "XYZ"[np.abs(row).argmax()] for row in t) for t in TURNS
    ]
    axes = {f"{kind}{index}": text for kind in "agm" for index, text in enumerate(signs)}
    assert len(set(signs)) == 24
    ups = ("-Z", "+Y", "-X", "+X")
    with open_log(written(axes, ups, bias=0.2)) as log:
        result = find_pointing(log, upright_poses(log, ups))
    assert {each.sensor: each.axes for each in result} == axes


def test_poses_in_another_order_are_refused(written: Written) -> None:
    with (
        open_log(written(AXES, ("+Z", "+X", "+Y"))) as log,
        pytest.raises(CalibrationError, match=r"not \+X, \+Z, \+Y up"),
    ):
        find_pointing(log, upright_poses(log, ("+X", "+Z", "+Y")))


def test_a_mirrored_accelerometer_is_not_determined(written: Written) -> None:
    """A mirrored triad fits no rotation; one of two accelerometers does not contradict the poses."""
    with open_log(written({"a1": "-Y+X+Z", "a2": "-X+Y+Z"}, ("+Z", "+X", "+Y"))) as log:
        pointings = {each.sensor: each for each in find_pointing(log, upright_poses(log))}
    assert pointings["a1"].axes == "-Y+X+Z"
    assert pointings["a2"].axes == "" and "no orientation explains" in pointings["a2"].reason


def test_a_wrong_number_of_poses_is_refused_with_their_times(written: Written) -> None:
    with (
        open_log(written(AXES, ("+Z", "+X"))) as log,
        pytest.raises(CalibrationError, match=r"2 poses detected \(.* s\)"),
    ):
        upright_poses(log)


def test_poses_about_a_single_vertical_axis_are_refused(written: Written) -> None:
    alike = pytest.raises(CalibrationError, match="one box axis up")
    with open_log(written(AXES, ("+Z", "+Z", "-Z"), named=True)) as log, alike:
        find_pointing(log, upright_poses(log))


def test_a_magnetometer_without_a_gyroscope_is_not_determined(written: Written) -> None:
    axes = {name: text for name, text in AXES.items() if name[0] != "g"}
    with open_log(written(axes, ("+Z", "+X", "+Y"))) as log:
        result = {each.sensor: each for each in find_pointing(log, upright_poses(log))}
    assert result["m1"].axes == "" and "gyroscope" in result["m1"].reason
    assert result["a3"].axes == AXES["a3"]


def test_two_poses_do_not_determine_a_gyroscope(written: Written) -> None:
    """One turn: every rotation about its axis gives the same readings."""
    ups = ("+Z", "+X")
    with open_log(written(AXES, ups)) as log:
        result = {each.sensor: each for each in find_pointing(log, upright_poses(log, ups))}
    assert result["a1"].axes == AXES["a1"]
    assert result["g1"].axes == "" and "as good as" in result["g1"].reason


@pytest.mark.slow
def test_an_unknown_pose_is_refused(written: Written) -> None:
    with open_log(written(AXES, ("+Z", "+X", "+Y"))) as log, pytest.raises(CalibrationError, match="allowed are"):
        upright_poses(log, ("+Z", "X", "+Y"))


FOUND = [Pointing("A", "bma180", "+Y+X-Z", 0.01, 1.0)]


def test_axes_are_written_into_an_otherwise_unchanged_configuration() -> None:
    text = '# mine\r\n[[sensor]]\nname = "A" # low\n\n[[sensor]]\nname = "B"\n'
    assert with_axes(text, FOUND, "run.h5") == text.replace("low\n", 'low\naxes = "+Y+X-Z"\n')


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no toml [", "not TOML: Invalid key"),
        ("\0\x1b[31m", "not TOML"),
        ("a = " + "[" * 100_000, "not TOML"),
        ("a = 1\na = 2", "not TOML"),
        ('[[sensor]]\nname = "A"\naxes = "x"\n[sensor.axes]', "not TOML"),
        ("sensor = 5", r"no list of \[\[sensor\]\] tables"),
        ('sensor = "A"', r"no list of"),
        ('[sensor]\nname = "A"', r"no list of"),
        ('sensor = ["A"]', r"no list of"),
        ("#" * (1 << 21), "has 2097152 characters"),
    ],
    ids=range(10),
)
def test_an_invalid_configuration_is_refused_in_one_line(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=rf"^run\.h5: its configuration .*{message}") as caught:
        with_axes(text, FOUND, "run.h5")
    assert str(caught.value).isprintable()


def test_sensors_with_an_invalid_name_stay_unchanged() -> None:
    text = '[[sensor]]\nname = ["A"]\n[[sensor]]\nname = {A = 1}\n[[sensor]]\n'
    assert with_axes(text, FOUND, "run.h5") == text


def test_the_report_names_the_residual_of_each_sensor(capsys: pytest.CaptureFixture[str]) -> None:
    """The former key `left` is kept for programs that read it."""
    pointings = [Pointing("A1", "bma180", "+Y-X+Z", 0.02, 1.41), Pointing("G1", "l3g4200d", "", 0.6, 0.7, "no turn")]
    report = _axes_report(pointings, {"A1": "+X+Y+Z", "G1": "+X+Y+Z"})
    assert report["sensors"][0]["residual"] == report["sensors"][0]["left"] == 0.02
    _print_axes(report)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines[:2]] == [
        ["sensor", "axes", "residual", "next", "best"],
        ["A1", "+Y-X+Z", "0.02", "1.41"],
    ]
    assert lines[2].split(maxsplit=2) == ["G1", "?", "not determined: no turn; +X+Y+Z kept"]
