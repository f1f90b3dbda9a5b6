"""Random worlds over seeds: each is possible, small enough and reproducible; a short run has all kinds."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.array import parse_array
from imuarray.cli import main
from imuarray.log import open_log
from imuarray.validation.generator import record_in
from imuarray.validation.worlds import KINDS, MOST_READINGS_PER_S, MOST_ROWS, MOST_SECONDS, draw_world
from tests.selection import examples, some

SEEDS = st.integers(0, 20_000_000_000)


@settings(max_examples=examples(80), deadline=None)
@given(SEEDS)
def test_every_world_is_possible(seed: int) -> None:
    """An array that its reader accepts, with at most 16 inertial sensors, read no faster than a bus of 400 kHz permits,
    in logs of at most ten minutes and 30000 rows; faces within a tilt, phases within their log.
    """
    world = draw_world(seed)
    array = parse_array(world.array)
    assert 1 <= len(world.inertial) <= 16
    assert {sensor.name: sensor.chip for sensor in array.sensors} == {
        name: sensor.chip for name, sensor in world.sensors.items()
    }
    assert sum(sensor.rate_hz for sensor in world.sensors.values()) <= MOST_READINGS_PER_S == 2500.0
    assert world.rows <= 1.01 * MOST_ROWS == pytest.approx(30_300)
    assert world.seconds <= 1.01 * MOST_SECONDS == pytest.approx(606)
    assert 20.0 <= world.recorder["rate_hz"] <= 1000.0
    for session in world.sessions:
        assert sum(pose["hold_s"] for pose in session["poses"]) <= session["seconds"] + 1e-6
        assert all(np.linalg.norm(pose["up"]) == pytest.approx(1.0) for pose in session["poses"])
        for begin, end, _, up in session["phases"]:
            assert 0 <= begin < end <= session["seconds"] + 1e-6
            assert up in ("", "+X", "-X", "+Y", "-Y", "+Z", "-Z")
        for motion in session["motions"]:
            assert 0 < motion["start_s"] < motion["end_s"] < session["seconds"]
    assert json.loads(json.dumps(world.table())) == world.table()
    assert draw_world(seed) == world


@pytest.mark.slow
def test_no_motion_clips_and_no_part_exceeds_its_data_sheet() -> None:
    """Gravity, shaking and turning stay within nine tenths of every range; effects of rooms are small."""
    for seed in range(200):
        world = draw_world(seed)
        forces = [world.sensors[name].range for name, chip in world.inertial.items() if chip != "l3g4200d"]
        rates = [world.sensors[name].range for name, chip in world.inertial.items() if chip == "l3g4200d"]
        for session in world.sessions:
            for motion in session["motions"]:
                assert 1.0 + motion["peak_g"] < 0.9 * min(forces, default=99.0)
                rate = np.degrees(2 * np.pi * motion["rock_hz"] * motion["angle_rad"])
                assert rate < 0.9 * min(rates, default=9999.0)
        assert abs(world.room["drift_degc_per_s"]) * 3600 <= 2.0
        assert world.room["draught_degc"] <= 0.4
        assert all(vibration["peak_g"] <= 5e-4 for vibration in world.room["vibrations"])


@pytest.mark.slow
@pytest.mark.parametrize("first", [1_000_000, 2_120_000])
def test_a_short_run_has_its_share_of_every_stratum(first: int) -> None:
    """In 40 consecutive seeds, from any start, each stratum has its share of 400 to within 0.15."""
    few = [draw_world(seed) for seed in range(first, first + 40)]
    many = [draw_world(seed) for seed in range(first, first + 400)]
    for name in many[0].strata:
        if name in ("sensors", "rate_hz", "poses"):  # strata of many kinds, or only in worlds with a tumble
            continue
        shares = {value: count / 400 for value, count in Counter(world.strata[name] for world in many).items()}
        counted = Counter(world.strata[name] for world in few)
        for value, share in shares.items():
            assert abs(counted[value] / 40 - share) < 0.15, (name, value)
    for kind in KINDS:
        assert sum(kind in world.kinds for world in many) == pytest.approx(206, abs=15)
        assert 12 <= sum(kind in world.kinds for world in few) <= 28
    counts = {len(world.inertial) for world in few}
    assert min(counts) == 1
    assert max(counts) >= 7
    assert {chip for world in few for chip in world.inertial.values()} == {"adxl345", "bma180", "l3g4200d"}
    rates = [world.recorder["rate_hz"] for world in many]
    assert min(rates) == 20.0
    assert max(rates) >= 500.0
    assert len({world.plan for world in many}) == 31


SMALL = [seed for seed in range(200) if draw_world(seed).rows < 14_000][:3]


@pytest.mark.slow
@pytest.mark.parametrize("seed", some(SMALL, 1, 0))
def test_logs_of_a_world_are_written_and_read(seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As `imuarray info` reads them: the sensors, about the expected number of rows, the noted phases, no truth;
    sensors that the recorder does not read are absent. The same seed gives the same rows.
    """
    world = draw_world(seed)
    logs, truth = record_in(world.table(), tmp_path / "one", (), seed)
    again, _ = record_in(world.table(), tmp_path / "two", (), seed)
    assert [path.stem for path in logs] == [session["name"] for session in world.sessions]
    assert truth["mechanisms"] == []
    rows = 0
    for path, other, session in zip(logs, again, world.sessions, strict=True):
        assert main(["info", str(path), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)
        with open_log(path) as log, open_log(other) as same:
            assert set(log.sensors) == set(world.sensors)
            assert [phase.name for phase in log.phases] == [phase[2] for phase in session["phases"]]
            assert log.truth is None
            assert (log.reference is not None) == world.recorder["reference"]
            for name, sensor in log.sensors.items():
                rows += len(sensor)
                assert np.array_equal(sensor.counts[:], same[name].counts[:])
                if sensor.chip != "bmp180" and not world.recorder["thermometers"]:
                    assert sensor.temperature_counts is None
    assert rows == pytest.approx(world.rows, rel=0.15)


@pytest.mark.slow
def test_the_reference_begins_with_the_log(tmp_path: Path) -> None:
    """After the sensors have been set up, however long the last frame waits: the box begins to turn at the noted begin
    of the motion.
    """
    table = draw_world(9_000_174).table()
    recorder = {**table["recorder"], "reference": True}
    paths, _ = record_in({**table, "recorder": recorder}, tmp_path, (), 9_000_174)
    (path,) = (path for path in paths if path.stem == "motion")
    with open_log(path) as log:
        assert log.reference is not None
        rates = np.abs(log.reference.angular_rate[:]).max(axis=1)
        begin_ns = log.reference.time[:][np.flatnonzero(rates > 1e-9)[0]]
        assert log.phases[1].name == "motion"
        assert abs(begin_ns - log.phases[1].start_ns) < 0.05e9
