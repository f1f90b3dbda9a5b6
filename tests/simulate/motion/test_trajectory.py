"""Motions from files: paths through rows, recorded force and rate, and refusals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imuarray.errors import SourceError
from imuarray.simulate.motion.trajectory import StimulusRows, Trajectory, load_trajectory

G = 9.80665
S = 10**9
FIELD = np.array([0.2, 0.0, -0.43])
GRAVITY = np.array([0.0, 0.0, G])
PLACE = "x_m,y_m,z_m"
ANGLES = "roll_deg,pitch_deg,yaw_deg"
FELT = "force_x_mps2,force_y_mps2,force_z_mps2"
DPS = "rate_x_dps,rate_y_dps,rate_z_dps"

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """``write(header, rows)``: a file of these rows."""

    def make(header: str, rows: npt.ArrayLike) -> Path:
        path = tmp_path / "path.csv"
        lines = [",".join(f"{value:.17g}" for value in row) for row in np.asarray(rows, float)]
        path.write_text("\n".join([header, *lines]) + "\n")
        return path

    return make


def table(*columns: npt.ArrayLike) -> npt.NDArray[np.float64]:
    return np.concatenate([np.reshape(column, (len(np.asarray(column)), -1)) for column in columns], axis=1)


T = np.linspace(0, 4, 401)


def test_a_circle_at_constant_speed_has_centripetal_force_and_rate(write: Write) -> None:
    """Nose along the path, a turn in 4 s on a radius of 2 m: centripetal force to the left, a steady rate about z."""
    pace, radius = np.pi / 2, 2.0
    place = radius * np.stack([np.sin(pace * T), 1 - np.cos(pace * T), 0 * T], axis=1)
    angles = np.stack([0 * T, 0 * T, np.degrees(pace * T)], axis=1)
    motion = load_trajectory(write(f"time_s,{PLACE},{ANGLES}", table(T, place, angles)))
    times = np.arange(S // 2, 3 * S, 12_345_678)  # away from the ends, where a spline is less accurate
    stimulus = motion.stimulus(times)
    assert stimulus.force_box == pytest.approx(np.tile([0, radius * pace**2, G], (len(times), 1)), abs=1e-3)
    assert stimulus.rate_box == pytest.approx(np.tile([0, 0, pace], (len(times), 1)), abs=1e-9)
    assert stimulus.angular_acceleration_box == pytest.approx(0, abs=1e-7)
    heading = pace * times * 1e-9
    expected = np.stack([0.2 * np.cos(heading), -0.2 * np.sin(heading), 0 * heading - 0.43], axis=1)
    assert stimulus.field_box == pytest.approx(expected, abs=1e-9)
    assert stimulus.temperature_degc.tolist() == [25.0] * len(times)
    assert motion.seconds == 4.0
    assert [tuple(phase) for phase in motion.phases] == [(0, 4 * S, "motion", "")]


def test_a_lift_has_its_force_and_pressure(write: Write) -> None:
    """Height t^2 / 2: 1 m/s2 more, and 12 Pa less per metre. Times count from the first row; temperature is linear."""
    rows = table(T + 100, 0 * T, 0 * T, T**2 / 2, 0 * T, 0 * T, 0 * T, 20 + T)
    motion = load_trajectory(write(f"time_s,{PLACE},{ANGLES},temperature_degc", rows))
    stimulus = motion.stimulus(np.array([0, S, 4 * S]))
    assert stimulus.force_box == pytest.approx(np.tile([0, 0, G + 1], (3, 1)), abs=1e-8)
    assert stimulus.pressure_pa == pytest.approx([101325, 101325 - 0.5 * 1.225 * G, 101325 - 8 * 1.225 * G], abs=1e-6)
    assert stimulus.temperature_degc == pytest.approx([20, 21, 24])


def test_angles_turn_about_z_then_y_then_x(write: Write) -> None:
    """Roll 90: y up. Pitch 90: nose (x) down. Yaw alone leaves gravity."""
    force = {(90, 0, 0): (0, G, 0), (0, 90, 0): (-G, 0, 0), (0, 0, 90): (0, 0, G), (90, 0, 90): (0, G, 0)}
    for angles, expected in force.items():
        motion = load_trajectory(write(f"time_s,{PLACE},{ANGLES}", [[t, 0, 0, 0, *angles] for t in range(4)]))
        assert motion.stimulus(np.array([S])).force_box[0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("count", [2, 3, 5, 40])
def test_a_path_matches_numerical_derivatives(count: int, write: Write, rates: Callable[..., Any]) -> None:
    """Whichever splines run between rows, rate and force are derivatives of the attitude and position they give."""
    random = np.random.default_rng(4)
    attitudes = Rotation.from_rotvec(np.cumsum(0.3 * random.standard_normal((count, 3)), axis=0))
    place = np.cumsum(0.1 * random.standard_normal((count, 3)), axis=0)
    quaternions = np.roll(attitudes.as_quat(), 1, axis=1) * 1.004  # nearly of unit length will do
    header = f"time_s,{PLACE},qw,qx,qy,qz"
    motion = load_trajectory(write(header, table(0.25 * np.arange(count), place, quaternions)))
    assert isinstance(motion, Trajectory)
    knots = np.arange(count) * S // 4
    assert (attitudes.inv() * motion.attitude(knots)).magnitude() == pytest.approx(0, abs=1e-12)
    assert motion.position(knots) == pytest.approx(place, abs=1e-12)
    step_ns = 100_000
    times = np.arange(10_000_000, round(motion.seconds * S) - step_ns, 31_111_111)
    times = times[np.abs((times + S // 8) % (S // 4) - S // 8) > step_ns]  # third derivatives jump at rows
    stimulus, numeric = motion.stimulus(times), rates(motion.attitude, times)
    assert stimulus.rate_box == pytest.approx(numeric.rate_box, abs=1e-4)
    assert stimulus.angular_acceleration_box == pytest.approx(numeric.angular_acceleration_box, abs=1e-2)
    before, now, after = (motion.position(times + shift) for shift in (-step_ns, 0, step_ns))
    acceleration = (before - 2 * now + after) / (step_ns * 1e-9) ** 2
    to_box = motion.attitude(times).inv()
    assert stimulus.force_box == pytest.approx(to_box.apply(acceleration + GRAVITY), abs=1e-4)
    assert stimulus.field_box == pytest.approx(to_box.apply(FIELD), abs=1e-12)


@pytest.mark.parametrize(("unit", "factor"), [("dps", np.pi / 180), ("radps", 1.0)])
def test_recorded_force_and_rate_are_interpolated(unit: str, factor: float, write: Write) -> None:
    """Cubics pass through cubic splines unchanged."""
    force = np.stack([T**3, 1 - T**2, 9 + T], axis=1)
    rate = np.stack([T**2, T**3 - T, -T], axis=1)
    names = ",".join(f"rate_{axis}_{unit}" for axis in "xyz")
    motion = load_trajectory(write(f"time_s,{FELT},{names}", table(T, force, rate)))
    assert isinstance(motion, StimulusRows)
    at = np.array([0.123, 1.777, 3.999])
    stimulus = motion.stimulus((at * S).astype(np.int64))
    assert stimulus.force_box == pytest.approx(np.stack([at**3, 1 - at**2, 9 + at], axis=1), abs=1e-7)
    assert stimulus.rate_box == pytest.approx(factor * np.stack([at**2, at**3 - at, -at], axis=1), abs=1e-7)
    slope = factor * np.stack([2 * at, 3 * at**2 - 1, -1 + 0 * at], axis=1)
    assert stimulus.angular_acceleration_box == pytest.approx(slope, abs=1e-6)


HEADER = f"time_s,{FELT},{DPS}"
ROW = "0,0,0,9.8,0,0,0"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "0 data rows; at least two"),
        (f"{HEADER}\n{ROW}\n", "1 data rows; at least two"),
        (f"time_s,{PLACE}\n0,0,0,0\n1,0,0,0\n", f"header 'time_s,.*allowed are time_s with {PLACE.replace(',', ', ')}"),
        (f"{FELT},{DPS}\n0,0,0,0,0,0\n1,0,0,0,0,0\n", "allowed are time_s with"),
        (f"{HEADER},rate_x_radps\n{ROW},0\n{ROW},0\n", "force_x_mps2, .* or .*temperature_degc if it is known"),
        (f"{HEADER},time_s\n{ROW},0\n{ROW},0\n", "line 3: several columns are called 'time_s'"),
        (f"{HEADER}\n{ROW}\n1,0,0,9.8,0,0\n", "line 3: 6 cells, the first row has 7"),
        (f"{HEADER}\n# a comment\n{ROW}\n1,0,up,9.8,0,0,0\n", "line 4, column force_y_mps2: 'up' is not a number"),
        (f"{HEADER}\n{ROW}\n1,0,nan,9.8,0,0,0\n", "line 3, column force_y_mps2: 'nan' is not a number"),
        (f"{HEADER}\n{ROW}\n1,0,0,9.8,0,0,1e300\n", "line 3, column rate_z_dps: '1e300' is not a number between"),
        (f"{HEADER}\n{ROW}\n{ROW}\n", "line 3, column time_s: 0 is not later than the row before"),
        (f"{HEADER}\n{ROW}\nsoon,0,0,0,0,0,0\n", "line 3, column time_s: 'soon' is not a number"),
        (
            f"time_s,{PLACE},qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n1,0,0,0,0,0,0,0\n",
            "line 3: qw, qx, qy, qz have length 0; 1 is required",
        ),
    ],
)
def test_invalid_files_are_refused(text: str, complaint: str, tmp_path: Path) -> None:
    path = tmp_path / "path.csv"
    path.write_text(text)
    with pytest.raises(SourceError, match=complaint) as caught:
        load_trajectory(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"nothing\.csv: No such file or directory"):
        load_trajectory(tmp_path / "nothing.csv")
    with pytest.raises(SourceError, match="Is a directory"):
        load_trajectory(tmp_path)


@given(junk=st.binary(max_size=200))
def test_random_bytes_are_refused_in_one_line(junk: bytes, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.getbasetemp() / "junk.csv"
    for content in (junk, f"{HEADER}\n{ROW}\n".encode() + junk):
        path.write_bytes(content)
        try:
            load_trajectory(path)
        except SourceError as error:
            assert len(str(error).splitlines()) == 1
