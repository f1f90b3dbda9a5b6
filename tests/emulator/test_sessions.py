"""Sessions from a table: poses, turns, temperatures, vibrations against closed forms; a case of such a world."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from firmware_emulator.cases import BenchCase, main
from firmware_emulator.mechanisms.mechanism import RATE_ERROR, TURN_ON_SHARE, toleranced_part
from firmware_emulator.sessions import (
    RestPose,
    Rocking,
    Room,
    TableVibration,
    TemperatureStretch,
    session,
    sessions,
    turn_to,
)
from imuarray.log import open_log

G = 9.80665
UP = (0.0, 0.0, 1.0)
S = 10**9
ARRAY = """
[array]
name = "bench"
[[sensor]]
name = "ADX1"
chip = "adxl345"
address = 0x53
range = 4
rate_hz = 100
[[sensor]]
name = "BMA1"
chip = "bma180"
address = 0x40
range = 4
"""


def course(room=None, **table):
    poses = table.pop("poses", [{"up": list(UP), "hold_s": 10.0}])
    return session({"name": "a", "seconds": 10.0, "poses": poses, **table}, room or Room(degc=20.0), 1).world


def test_a_box_turns_between_poses_with_matching_gravity_and_rate():
    world = course(poses=[{"up": [0, 0, 1], "hold_s": 4.0}, {"up": [1, 0, 0], "hold_s": 4.0}], turn_s=2.0)
    assert world(2 * S).force_box == pytest.approx((0, 0, G))
    assert world(8 * S).force_box == pytest.approx((G, 0, 0))
    half = world(5 * S)
    assert half.force_box == pytest.approx((G / math.sqrt(2), 0, G / math.sqrt(2)))
    assert max(np.abs(half.rate_box)) == pytest.approx(math.pi / 2)  # twice the mean of a quarter turn in 2 s
    turned = np.sum([world(round(at * S)).rate_box for at in np.arange(4, 6, 0.001)], axis=0) * 0.001
    assert np.linalg.norm(turned) == pytest.approx(math.pi / 2, rel=1e-3)


@pytest.mark.parametrize("after", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.6, 0.0, 0.8), UP])
def test_a_turn_ends_in_the_requested_pose(after):
    axis, angle = turn_to(UP, after)
    assert np.linalg.norm(axis) == pytest.approx(1.0)
    assert math.cos(angle) == pytest.approx(after[2])


@pytest.mark.slow
def test_the_rate_of_a_rocked_box_matches_its_gravity():
    """Gravity, turned by the integral of the rate, is the specific force; shaking acts along the axis."""
    motion = {"start_s": 1.0, "end_s": 9.0, "axis": [1.0, 0.0, 0.0], "angle_rad": 0.5, "rock_hz": 0.7}
    world = course(motions=[{**motion, "peak_g": 0.0, "shake_hz": 3.0}])
    times = np.arange(1.0, 6.0, 0.0005)
    angle = np.cumsum([world(round(at * S)).rate_box[0] for at in times]) * 0.0005
    _, y, z = np.array([world(round(at * S)).force_box for at in times]).T
    assert np.abs(angle).max() > 0.4
    assert np.abs(np.arctan2(y, z) - angle).max() < 2e-3
    shaken = course(motions=[{**motion, "angle_rad": 0.0, "peak_g": 0.3, "shake_hz": 3.0}])
    assert max(shaken(round(at * S)).force_box[0] for at in times) == pytest.approx(0.3 * G, rel=0.01)


def test_temperatures_approach_exponentially_and_drift_with_the_room():
    stretches = [{"seconds": 5.0, "towards_degc": 40.0, "constant_s": 5.0}]
    world = course(Room(degc=20.0, drift_degc_per_s=0.01), stretches=stretches)
    assert world(5 * S).temperature_degc == pytest.approx(40 - 20 / math.e + 0.05)
    swings = course(Room(degc=20.0, draught_degc=0.5))
    temperatures = [swings(round(at * S)).temperature_degc for at in np.arange(0, 40000, 7)]
    assert np.std(temperatures) == pytest.approx(0.5, rel=0.05)


def test_a_table_vibration_runs_for_a_share_of_its_cycle_and_is_absent_from_the_reference():
    fridge = TableVibration(24.5, (1.0, 0.0, 0.0), 1e-3, 0.1, cycle_s=4.0, share=0.5)
    world = course(Room(vibrations=(fridge,)))
    on, off = (
        [abs(world(round(at * S)).force_box[0]) for at in np.arange(begin, begin + 2, 0.003)] for begin in (0, 2)
    )
    assert max(on) == pytest.approx(1e-3 * G, rel=0.01)
    assert max(off) == 0.0
    assert world.commanded(S // 3).force_box == pytest.approx((0, 0, G))


def test_unknown_entries_are_refused_in_one_line():
    with pytest.raises(ValueError, match="ghost: no entry of a rest pose; allowed are hold_s, up"):
        course(poses=[{"up": [0, 0, 1], "ghost": 1}])
    with pytest.raises(ValueError, match="session: 'poses' is missing"):
        sessions([{"name": "a", "seconds": 1.0}], Room(), 0)
    with pytest.raises(ValueError, match="world: recorder is missing"):
        BenchCase.of_world({"array": "", "sessions": [], "room": {}})
    assert RestPose(UP, 1.0) != TemperatureStretch(1.0, 2.0, 3.0) != Rocking(0, 1, UP, 1, 1, 1, 1)


def test_only_the_bias_of_toleranced_parts_changes_between_power_ups():
    parts = [toleranced_part("bma180", "B", 4.0, 1, run) for run in range(200)]
    scatter = np.std([part.bias for part in parts], axis=0)
    assert scatter == pytest.approx([TURN_ON_SHARE * 0.06] * 3, rel=0.2)
    assert pytest.approx(0.18) == TURN_ON_SHARE * 60  # mg
    assert len({part.response for part in parts}) == 1
    assert parts[0].scale_slope_per_degc != 0.0
    assert abs(RATE_ERROR["bma180"].limit) == 0.1


@pytest.mark.slow
def test_a_world_is_recorded_from_a_file(tmp_path, capsys):
    table = {
        "array": ARRAY,
        "room": {"degc": 22.0},
        "recorder": {
            "rate_hz": 50.0,
            "thermometers": False,
            "reference": False,
            "stalls_per_min": 60.0,
            "stall_s": 0.3,
        },
        "sessions": [
            {
                "name": "rest",
                "seconds": 6.0,
                "poses": [{"up": list(UP), "hold_s": 6.0}],
                "phases": [[0, 3, "static", "+Z"]],
            }
        ],
    }
    world = tmp_path / "world.json"
    world.write_text(json.dumps(table))
    words = [str(world), "-o", str(tmp_path / "logs"), "--truth", str(tmp_path / "truth.json"), "--seed", "3"]
    assert main(words) == 0
    (path,) = capsys.readouterr().out.split()
    with open_log(path) as log:
        assert [phase.name for phase in log.phases] == ["static"]
        assert log.reference is None
        assert log["BMA1"].temperature_counts is None
        assert 150 < len(log["BMA1"].time) < 300  # of 300, some were missed
        assert np.diff(log["BMA1"].time[:]).max() > 300_000_000
    world.write_text(json.dumps({**table, "recorder": {"rate_hz": 50.0, "ghost": 1}}))
    assert main([*words, "--force"]) == 2
    assert "ghost: no entry of a recorder" in capsys.readouterr().err
