"""The recording from a log with complete, partial or no information on the experiment."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.errors import LogError
from imuarray.gap.findings.experiment_design import _ABSENT, missing_in
from imuarray.gap.inference.comparison import prepare
from imuarray.gap.model.base_model import fit
from imuarray.gap.recording.recordings import Recording, recording_of, recordings_of, temperature_of
from imuarray.gap.statistics.campaign import Campaign
from imuarray.log import Block, LogWriter, Stimulus, open_log
from imuarray.log.format import Phase, SensorHeader, ThermometerScale
from imuarray.simulate import Simulation
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.timing import DroppedSamples
from imuarray.simulate.motion.faces import Still
from imuarray.simulate.motion.posed import PoseSequence
from imuarray.simulate.record import write_log
from tests.gap.hand_poses import directions, posed, simulated, written
from tests.gap.small_campaign import BASE, SECOND, simulation, summarised
from tests.selection import some

FOREIGN = [
    SensorHeader("Acc", "mpu9150", "specific_force", "g", 16.0, 2048.0, has_temperature=True),
    SensorHeader("Gyro", "mpu9150", "angular_rate", "dps", 2000.0, 16.4),
]


COMPASS = SensorHeader("Mag", "unheard_of", "magnetic_field", "gauss", 1.3, 1090.0, axes="-Y+X+Z")


def foreign_log(
    path: Path, phases: Sequence[Phase] = (), sensors: Sequence[SensorHeader] = FOREIGN, seconds: float = 12
) -> Path:
    """Flat on a table, 50 Hz, noise of some counts; a thermometer that warms up by 80 counts."""
    rows = round(50 * seconds)
    time = np.arange(rows, dtype=np.int64) * SECOND // 50
    rng = np.random.default_rng(0)
    with LogWriter(path, sensors, source="imported", epoch="2024-01-01T00:00:00Z") as log:
        for sensor in sensors:
            level = {"specific_force": [0, 0, 2048], "magnetic_field": [300, -40, 500]}.get(sensor.quantity, [0, 0, 0])
            counts = np.rint(rng.normal(level, 5, (rows, 3))).astype(np.int16)
            warm = np.linspace(0, 80, rows).astype(np.int16) if sensor.has_temperature else None
            log.append(sensor.name, Block(time, counts, np.zeros(rows, np.uint16), warm))
        for phase in phases:
            log.phase(phase)
    return path


def recorded(path: Path) -> Recording:
    return recording_of(open_log(path))


def phase(start_s: int, end_s: int, name: str, up: str = "") -> Phase:
    return Phase(start_s * SECOND, end_s * SECOND, name, up)


@pytest.mark.parametrize(
    ("phases", "kind"),
    [
        ([phase(0, 9, "static", "+Z")], "static"),
        ([phase(0, 4, "z_up", "+Z"), phase(5, 9, "x_up", "+X")], "tumble"),
        ([phase(0, 4, "z_up", "+Z"), phase(5, 9, "z_up_check", "+Z")], "static"),
        ([phase(0, 4, "room", "+Z"), phase(5, 9, "heat 1", "+Z")], "heating"),
        ([phase(0, 9, "run 3", "+Z")], "turn-on"),
    ],
)
def test_the_experiment_is_derived_from_the_phases(tmp_path: Path, phases: list[Phase], kind: str) -> None:
    found = recorded(foreign_log(tmp_path / "log.h5", phases))
    assert (found.name, found.kind, found.phases) == ("log.h5", kind, tuple(phases))
    assert found.notes == (
        "There is no reference temperature: 25 degC is assumed, and any usual change of a room's temperature.",
    )


def test_several_runs_in_a_log_are_no_turn_on_series(tmp_path: Path) -> None:
    """A series has a file for each run. Runs of a motor have the same names, and are at rest only if an axis is up."""
    phases = [phase(0, 3, "static", "+Z"), phase(3, 6, "run 1"), phase(6, 9, "run 2", "+Z")]
    found = recorded(foreign_log(tmp_path / "log.h5", phases))
    assert (found.kind, [item.name for item in found.phases]) == ("static", ["static", "run-2"])
    assert found.notes[0].startswith("Phase 'run-1' is left out: the log has no track")


@pytest.mark.parametrize(("louder", "names"), [((4.0, 4.0), ["static"]), ((4.0, 1.0), ["static", "phase 2"])])
def test_a_rest_in_which_all_sensors_are_loud_is_left_out(
    tmp_path: Path, louder: tuple[float, float], names: list[str]
) -> None:
    """A motor runs in the second phase; a single noisier sensor has an effect of its own."""
    time = np.arange(600, dtype=np.int64) * SECOND // 50
    rng = np.random.default_rng(0)
    with LogWriter(tmp_path / "log.h5", FOREIGN[:2], source="imported", epoch="2024-01-01T00:00:00Z") as log:
        for sensor, factor in zip(FOREIGN[:2], louder, strict=True):
            noise = rng.normal(0, 5, (600, 3)) * np.where(time < 6 * SECOND, 1.0, factor)[:, None]
            level = [0, 0, 2048] if sensor.quantity == "specific_force" else [0, 0, 0]
            counts = np.rint(noise + level).astype(np.int16)
            warm = np.zeros(600, np.int16) if sensor.has_temperature else None
            log.append(sensor.name, Block(time, counts, np.zeros(600, np.uint16), warm))
        for item in (phase(0, 5, "static", "+Z"), phase(6, 11, "phase 2", "+Z")):
            log.phase(item)
    assert [item.name for item in recorded(tmp_path / "log.h5").phases] == names


def test_a_motion_without_a_track_is_excluded(tmp_path: Path) -> None:
    phases = [phase(0, 4, "static", "+Z"), phase(4, 8, "motion")]
    found = recorded(foreign_log(tmp_path / "log.h5", phases))
    assert (found.kind, found.phases) == ("static", (phases[0],))
    assert found.notes[0] == (
        "Phase 'motion' is left out: the log has no track of the box's motion, nor two sensors of a kind and a "
        "gyroscope that show it (in phases of up to an hour)."
    )


@pytest.mark.slow
@pytest.mark.parametrize("with_unread", some([False, True], 1))
@pytest.mark.parametrize("turns_back", some([True, False], 1))
@pytest.mark.parametrize(("by_reference", "rate_dps"), [(False, 45.0), (True, 2.0)])
def test_a_turntable_with_noted_faces_is_not_at_rest(
    tmp_path: Path, by_reference: bool, rate_dps: float, *, turns_back: bool, with_unread: bool
) -> None:
    """By a reference of the rate alone, or by a mean reading that differs from that at rest; a bias of 40 dps, as at a
    range of 2000 dps, is not a rotation. Steps forth and back have a mean rate of zero. A second gyroscope that is read
    only at rest gives no information.
    """
    times = np.arange(0, 12 * SECOND, SECOND // 10)
    gyroscope = FOREIGN[1]
    turning = np.where(times >= 4 * SECOND, rate_dps, 0.0)[:, None] * [0.0, 0.0, 1.0]
    turning[times >= 8 * SECOND] *= -1 if turns_back else 1
    gyroscopes = [gyroscope, *([replace(gyroscope, name="Unread")] if with_unread else [])]
    with LogWriter(tmp_path / "log.h5", gyroscopes, source="imported", epoch="2024-01-01T00:00:00Z") as log:
        rows = np.rint((40.0 + turning) @ gyroscope.orientation * gyroscope.sensitivity).astype(np.int16)
        log.append("Gyro", Block(times, rows, np.zeros(len(times), np.uint16)))
        if with_unread:
            log.append("Unread", Block(times[:39], rows[:39], np.zeros(39, np.uint16)))
        if by_reference:
            force = np.tile([0.0, 0.0, 9.80665], (len(times), 1))
            log.stimulus("reference", Stimulus(times, force, np.radians(turning), np.full(len(times), 25.0)))
        for noted in (phase(0, 2, "z_up", "+Z"), phase(2, 4, "heat", "+Z"), phase(4, 12, "rate", "+Z")):
            log.phase(noted)
    if by_reference:
        with h5py.File(tmp_path / "log.h5", "r+") as file:
            del file["reference/specific_force"], file["reference/temperature"]
    recording = recorded(tmp_path / "log.h5")
    assert [item.name for item in recording.phases] == ["z_up", "heat"]


def test_a_reference_describes_the_motion(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    phases = [phase(0, 4, "static"), phase(4, 8, "motion")]
    times = np.arange(0, 12 * SECOND, SECOND // 10)
    force = np.tile([0.0, 0.0, 9.80665], (len(times), 1))
    with LogWriter(path, FOREIGN[1:], source="imported", epoch="2024-01-01T00:00:00Z") as log:
        rows = np.zeros((len(times), 3), np.int16)
        log.append("Gyro", Block(times, rows, np.zeros(len(times), np.uint16)))
        log.stimulus("reference", Stimulus(times, force, 0 * force, np.full(len(times), 31.0)))
        for one in phases:
            log.phase(one)
    found = recorded(path)
    assert (found.kind, found.phases, found.notes) == ("motion", tuple(phases), ())
    assert temperature_of(found.experiment.motion)(np.array([5 * SECOND])) == pytest.approx([31.0])


def test_the_turns_between_rests_are_compared_where_a_track_shows_them(tmp_path: Path) -> None:
    """The box turns by 90 degrees in 4 s, pauses for 2 s without turning, and turns in 1 s, which is short. A
    magnetometer has no statistics of a turn, since the field is unknown then, and is not excluded.
    """
    path = tmp_path / "log.h5"
    phases = [phase(0, 4, "z_up", "+Z"), phase(8, 12, "x_up", "+X"), phase(14, 18, "x_up", "+X")]
    phases.append(phase(19, 23, "z_up", "+Z"))
    times = np.arange(0, 23 * SECOND, SECOND // 20)
    share = np.interp(times / SECOND, [0, 4, 8, 18, 19, 23], [0, 0, 1, 1, 0, 0])
    force = 9.80665 * np.stack([np.sin(np.pi / 2 * share), 0 * share, np.cos(np.pi / 2 * share)], axis=1)
    rate = np.stack([0 * share, np.gradient(np.pi / 2 * share, times / SECOND), 0 * share], axis=1)
    with LogWriter(path, [*FOREIGN, COMPASS], source="imported", epoch="2024-01-01T00:00:00Z") as log:
        for sensor in (*FOREIGN, COMPASS):
            rows = np.random.default_rng(2).integers(-20, 20, (len(times), 3)).astype(np.int16)
            warm = np.zeros(len(times), np.int16) if sensor.has_temperature else None
            log.append(sensor.name, Block(times, rows, np.zeros(len(times), np.uint16), warm))
        log.stimulus("reference", Stimulus(times, force, rate, np.full(len(times), 25.0)))
        for noted in phases:
            log.phase(noted)
    recording = recorded(path)
    turn = Phase(4 * SECOND, 8 * SECOND, "turn")
    assert recording.kind == "tumble"
    assert recording.phases == tuple(sorted([*phases, turn]))
    assert "Mag" in recording.experiment.plan.sensors
    summary = summarised(recording)
    assert summary.phases[1].sensors.keys() == {"Acc", "Gyro"}
    assert "Mag" in summary.phases[0].sensors


@pytest.mark.slow
def test_rests_are_detected_and_their_attitudes_estimated(tmp_path: Path) -> None:
    """Ten poses; the directions do not include the array's common bias: 1.5e-3 is 0.1 degree."""
    ups = directions(10)
    found = recorded(written(tmp_path / "log.h5", simulated(posed(ups), {})))
    motion = found.experiment.motion
    assert (found.kind, len(found.phases), isinstance(motion, PoseSequence)) == ("tumble", 10, True)
    assert all(one.name == f"pose {number}" for number, one in enumerate(found.phases, start=1))
    middles = np.array([(one.start_ns + one.end_ns) // 2 for one in found.phases])
    np.testing.assert_allclose(motion.stimulus(middles).force_box / 9.80665, ups, atol=1.5e-3)
    assert found.notes[0] == "No phase is marked as at rest: 10 static stretches were detected."
    assert "not noted in 10 of 10 phases at rest" in found.notes[1]
    campaign = Campaign((summarised(found),))
    for name in ("A1", "A2"):
        (bias,) = [effect for effect in BASE[name] if isinstance(effect, Bias)]
        np.testing.assert_allclose(fit(campaign, [motion]).fitted[name].offset, bias.offset, atol=5e-4)


def test_one_long_rest_is_a_static_log(tmp_path: Path) -> None:
    found = recorded(foreign_log(tmp_path / "log.h5"))
    assert (found.kind, [one.name for one in found.phases]) == ("static", ["pose 1"])
    up = found.experiment.motion.stimulus(np.array([SECOND])).force_box[0] / 9.80665
    np.testing.assert_allclose(up, [0, 0, 1], atol=1e-3)


def test_noted_attitudes_are_used_except_for_a_tilt(tmp_path: Path) -> None:
    """One face is named, the other phase is only noted as at rest."""
    ups = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
    phases = (phase(0, 5, "z_up", "+Z"), phase(6, 11, "static"))
    found = recorded(written(tmp_path / "log.h5", simulated(posed(ups), {}), phases))
    motion = found.experiment.motion
    assert isinstance(motion, PoseSequence)
    assert [attitude.estimated for attitude in motion.attitudes] == [True, True]
    np.testing.assert_allclose([attitude.up_box for attitude in motion.attitudes], ups, atol=1e-3)


def test_a_foreign_chip_is_simulated_without_its_thermometer(tmp_path: Path) -> None:
    """Recorded and simulated summaries have the same statistics; counts of an unknown scale have none."""
    found = recorded(foreign_log(tmp_path / "log.h5", [phase(0, 9, "static", "+Z")]))
    bench, campaign = prepare([found], None, 0)
    made = bench.simulated(bench.models(), 0)
    for one in (campaign, made):
        assert one.logs[0].phases[0].sensors.keys() == {"Acc", "Gyro"}
        assert np.isnan(one.logs[0].phases[0].sensors["Acc"].segments.thermometer).all()
    assert bench.base.fitted["Acc"].rms[0] * 2048 == pytest.approx(5.0, rel=0.2)
    assert campaign.logs[0].phases[0].layout == made.logs[0].phases[0].layout


def test_all_triads_are_compared_unless_some_are_named(tmp_path: Path) -> None:
    path = foreign_log(tmp_path / "log.h5", [phase(0, 9, "static", "+Z")], [*FOREIGN, COMPASS])
    with open_log(path) as log:
        assert recording_of(log).experiment.plan.sensors.keys() == {"Acc", "Gyro", "Mag"}
        assert recording_of(log, ["Mag", "Acc"]).experiment.plan.sensors.keys() == {"Mag", "Acc"}
        with pytest.raises(LogError, match="no sensor 'Nose'"):
            recording_of(log, ["Nose"])


@pytest.mark.slow
def test_rows_that_a_recording_lost_are_in_its_plan(tmp_path: Path) -> None:
    """Simulated without dropped samples no row is missing, with them as many as in the recording: 600 of 6000 rows
    each, standard error sqrt(6000 0.1 0.9 (1 + r) / (1 - r)) = 38, r = 4 / 9 the correlation of neighbours (bursts of
    2).
    """
    still = Still(seconds=60)
    dropped = {name: (DroppedSamples(0.1, 2.0),) for name in BASE}
    made = simulation(still, dropped, seed=1)
    lost = write_log(made, tmp_path / "log.h5").lost
    found = recorded(tmp_path / "log.h5")
    plan, motion, *_ = pickle.loads(pickle.dumps(found.experiment))  # noqa: S301
    whole = Simulation(plan, motion, BASE, seed=2)
    again = Simulation(plan, motion, {name: (*BASE[name], *dropped[name]) for name in BASE}, seed=2)
    for name, sensor in whole.sensors.items():
        at_ends = made.sensors[name].rows - sensor.rows
        assert 0 <= at_ends < 30  # losses before the first row, or after the last, are unknown
        assert lost[name] - at_ends + len(found.log[name]) == sensor.rows
        assert len(sensor.lost_rows(0, sensor.rows)) == 0
        assert abs(len(again.sensors[name].lost_rows(0, sensor.rows)) - lost[name]) < 4 * 38 * 2**0.5
        stamps = plan.sensors[name][1].stamps(0, sensor.rows)
        assert np.abs(np.diff(stamps) / 10_000_000 - 1).max() < 0.1  # forth and back on the bus
    bench, campaign = prepare([found], None, 0)
    again_summarised = bench.simulated(bench.models(), 0)
    for name in BASE:
        ours, theirs = (one.logs[0].phases[0].sensors[name] for one in (campaign, again_summarised))
        assert theirs.intervals.gaps == 0 < 100 < ours.intervals.gaps  # in half of the log
        assert ours.flags["lost_before"] > 100


def test_logs_of_one_array_are_accepted(tmp_path: Path) -> None:
    still = [phase(0, 9, "static", "+Z")]
    one = open_log(foreign_log(tmp_path / "one.h5", still))
    other = open_log(foreign_log(tmp_path / "other.h5", still, FOREIGN[:1]))
    found = recordings_of([one, other])
    assert [len(recording.experiment.plan.sensors) for recording in found] == [2, 1]
    assert found[1].notes[0] == "Gyro is left out: it was not read in this log."
    with pytest.raises(LogError, match=r"one\.h5: no sensor 'Nose', nor in any other log"):
        recordings_of([one, other], ["Nose"])
    with pytest.raises(LogError, match=r"other\.h5: none of the sensors Gyro"):
        recordings_of([one, other], ["Gyro"])


def test_a_sensor_with_different_settings_is_refused(tmp_path: Path) -> None:
    still = [phase(0, 9, "static", "+Z")]
    turned = SensorHeader("Acc", "mpu9150", "specific_force", "g", 16.0, 2048.0, axes="-X+Y-Z", has_temperature=True)
    one = open_log(foreign_log(tmp_path / "one.h5", still))
    other = open_log(foreign_log(tmp_path / "other.h5", still, [turned]))
    with pytest.raises(
        LogError, match=r"other\.h5, sensor Acc: axes is -X\+Y-Z, but \+X\+Y\+Z in .*one\.h5, sensor Acc"
    ):
        recordings_of([one, other])


@pytest.mark.slow
def test_a_log_without_comparable_sensors_is_refused(tmp_path: Path) -> None:
    turning = replace(FOREIGN[1], sensitivity=0.5)  # noise of 10 dps
    with pytest.raises(LogError, match=r"the box is never at rest for 1\.5 s .*at least 3 s at rest are needed"):
        recorded(foreign_log(tmp_path / "log.h5", sensors=[turning]))
    with pytest.raises(LogError, match=r"it is 0\.98 s long, and at least 3 s at rest are needed"):
        recorded(foreign_log(tmp_path / "short.h5", seconds=1))
    unknown = SensorHeader("Acc", "x", "specific_force", "g", 0.0, 0.0)
    refusal = "no sensor with three axes, a known sensitivity and at least 10 readings"
    with pytest.raises(LogError, match=refusal):
        recorded(foreign_log(tmp_path / "unknown.h5", [phase(0, 9, "static", "+Z")], [unknown]))
    with pytest.raises(LogError, match=refusal):  # 9 rows at 50 Hz, too few for any statistic
        recorded(foreign_log(tmp_path / "nine.h5", [phase(0, 9, "static", "+Z")], seconds=0.18))
    recorded(foreign_log(tmp_path / "ten.h5", [phase(0, 9, "static", "+Z")], seconds=0.2))


@pytest.mark.parametrize("sensor", [FOREIGN[1], COMPASS])
def test_other_sensors_detect_rests_without_accelerometers(tmp_path: Path, sensor: SensorHeader) -> None:
    found = recorded(foreign_log(tmp_path / "log.h5", sensors=[sensor]))
    assert (found.kind, len(found.phases)) == ("static", 1)


def test_logs_of_two_arrays_are_refused(tmp_path: Path) -> None:
    one = open_log(foreign_log(tmp_path / "one.h5", [phase(0, 9, "static", "+Z")]))
    other = open_log(foreign_log(tmp_path / "other.h5", [phase(0, 9, "static", "+Z")], [COMPASS]))
    with pytest.raises(LogError, match=r"one\.h5: no sensor in common with .*other\.h5: logs of different arrays"):
        recordings_of([one, other])
    assert len(recordings_of([one, one])) == 2


def test_the_field_is_the_mean_of_the_magnetometers(tmp_path: Path) -> None:
    """Two magnetometers along different axes; their mean level in the box is the field, and not an error."""
    second = replace(COMPASS, name="Mag2", axes="+X+Y+Z")
    path = foreign_log(tmp_path / "log.h5", [phase(0, 4, "z_up", "+Z"), phase(5, 9, "x_up", "+X")], [COMPASS, second])
    found = recorded(path)
    counts = np.array([300.0, -40.0, 500.0])
    box = (np.array(COMPASS.orientation) @ counts + counts) / 2 / 1090
    stimulus = found.experiment.motion.stimulus(np.array([SECOND, 6 * SECOND]))
    np.testing.assert_allclose(stimulus.field_box, [box, box], atol=1e-3)
    again = pickle.loads(pickle.dumps(found.experiment.motion))  # noqa: S301
    np.testing.assert_allclose(again.stimulus(np.array([SECOND])).field_box, [box], atol=1e-3)


def test_a_magnetometer_alone_has_no_error_of_level(tmp_path: Path) -> None:
    found = recorded(foreign_log(tmp_path / "log.h5", sensors=[FOREIGN[0], COMPASS]))
    bench, _ = prepare([found], None, 0)
    assert bench.base.fitted["Mag"].offset == pytest.approx((0, 0, 0), abs=1e-3)  # the first half minus the whole
    assert bench.base.fitted["Mag"].rms[0] * 1090 == pytest.approx(5.0, rel=0.2)


@pytest.mark.slow
def test_a_track_of_the_motion_gives_no_field(tmp_path: Path) -> None:
    """At rest for a while, then turned to and fro, as measured by a reference: the magnetometer is compared at rest."""
    path = tmp_path / "turned.h5"
    time = np.arange(3000, dtype=np.int64) * SECOND // 50
    rate = np.where(time[:, None] % (2 * SECOND) < SECOND, 1.0, -1.0) * (time[:, None] > 20 * SECOND) * np.eye(3)[2]
    noise = np.random.default_rng(0).normal(0, 5, (3000, 3))
    with LogWriter(path, [*FOREIGN[1:], COMPASS], source="imported", epoch="2024-01-01T00:00:00Z") as log:
        turned = np.rint(noise + np.degrees(rate) * 16.4).astype(np.int16)
        log.append("Gyro", Block(time, turned, np.zeros(3000, np.uint16)))
        log.append("Mag", Block(time, np.rint(noise).astype(np.int16), np.zeros(3000, np.uint16)))
        force = np.tile([0.0, 0.0, 9.80665], (3000, 1))
        log.stimulus("reference", Stimulus(time, force, rate, np.full(3000, 20.0)))
        log.phase(phase(0, 19, "static", "+Z"))
    _, campaign = prepare([recorded(path)], None, 0)
    assert campaign.logs[0].phases[0].sensors.keys() == {"Gyro", "Mag"}


def test_the_field_is_unknown_in_motion(tmp_path: Path) -> None:
    path = tmp_path / "moving.h5"
    rows = np.arange(500, dtype=np.int64) * SECOND // 50
    with LogWriter(path, [*FOREIGN[1:], COMPASS], source="imported", epoch="2024-01-01T00:00:00Z") as log:
        counts = np.rint(np.random.default_rng(0).normal(0, 50, (500, 3))).astype(np.int16)
        for name in ("Gyro", "Mag"):
            log.append(name, Block(rows, counts, np.zeros(500, np.uint16)))
        force = np.tile([0.0, 0.0, 9.8], (500, 1))
        log.stimulus("reference", Stimulus(rows, force, np.zeros((500, 3)), np.full(500, 20.0)))
        log.phase(phase(0, 9, "motion"))
    found = recorded(path)
    assert found.experiment.plan.sensors.keys() == {"Gyro"}
    assert "Mag is left out: the magnetic field is not known while the box moves." in found.notes
    with pytest.raises(LogError, match="the magnetic field is not known while the box moves, and there is no other"):
        recording_of(open_log(path), ["Mag"])


@pytest.mark.parametrize("name", ["unheard_of", "bma180"])
def test_a_thermometer_of_known_scale_gives_the_temperature(tmp_path: Path, name: str) -> None:
    """From 36.5 degC at count 0 by 8 counts a degree: 10 degC more after 40 s, to a step. The box is warmer by its
    change in the 5 s of the thermometer's lag, 1.25 degC.
    """
    known = replace(FOREIGN[0], chip=name, extra=ThermometerScale(36.5, 8.0).attributes)
    path = foreign_log(tmp_path / "log.h5", [phase(0, 39, "static", "+Z")], [known, FOREIGN[1]], seconds=40)
    found = recorded(path)
    (note,) = found.notes
    assert note.startswith("There is no reference temperature: it is taken from a chip's own thermometer")
    degc = found.experiment.motion.stimulus(np.array([5, 20, 39]) * SECOND).temperature_degc
    assert degc == pytest.approx([36.5 + 2.5, 36.5 + 6.25, 36.5 + 11.0], abs=0.13)
    assert not found.experiment.plan.sensors["Acc"][0].has_temperature  # there is no other thermometer to compare with
    assert missing_in([found], _ABSENT) == (
        f"no reference temperature in {path.name}",
        f"no thermometer beside those of the chips in {path.name}",
    )


def test_a_thermometer_is_compared_with_another_temperature(tmp_path: Path) -> None:
    known = replace(FOREIGN[0], chip="unheard_of", extra=ThermometerScale(36.5, 8.0).attributes)
    path = tmp_path / "log.h5"
    rows = np.arange(600, dtype=np.int64) * SECOND // 50
    with LogWriter(path, [known], source="imported", epoch="2024-01-01T00:00:00Z") as log:
        counts = np.rint(np.random.default_rng(0).normal([0, 0, 2048], 5, (600, 3))).astype(np.int16)
        log.append("Acc", Block(rows, counts, np.zeros(600, np.uint16), np.full(600, -84, np.int16)))
        force = np.tile([0.0, 0.0, 9.80665], (600, 1))
        log.stimulus("reference", Stimulus(rows, force, np.zeros((600, 3)), np.full(600, 25.0)))
        log.phase(phase(0, 11, "static", "+Z"))
    found = recorded(path)
    assert found.notes == ()
    bench, campaign = prepare([found], None, 0)
    made = bench.simulated(bench.models(), 0)
    shown, expected = (one.logs[0].phases[0].sensors["Acc"].segments.thermometer for one in (campaign, made))
    assert shown == pytest.approx(np.full(len(shown), -84.0))
    assert expected == pytest.approx(np.full(len(shown), -92.0))  # (25 - 36.5) * 8


def test_flags_that_an_import_cannot_set_are_not_compared(tmp_path: Path) -> None:
    """A magnetometer that is read 50 times a second, as its simulation would flag where rows repeat."""
    chip = replace(COMPASS, chip="hmc5883l", sensitivity=100.0)
    found = recorded(foreign_log(tmp_path / "log.h5", [phase(0, 9, "static", "+Z")], [chip]))
    bench, _ = prepare([found], None, 0)
    quiet = {"Mag": replace(bench.models()["Mag"], fitted=replace(bench.base.fitted["Mag"], rms=(0.0, 0.0, 0.0)))}
    flags = bench.simulated(quiet, 0).logs[0].phases[0].sensors["Mag"].flags
    assert flags["stale"] == 0


def test_the_box_is_assumed_upright_without_accelerometers(tmp_path: Path) -> None:
    found = recorded(foreign_log(tmp_path / "log.h5", [phase(0, 9, "static")], FOREIGN[1:]))
    assert found.notes[0].endswith(
        "no accelerometer to estimate the attitude from: +Z up is assumed where no phase notes it."
    )
    np.testing.assert_allclose(found.experiment.motion.stimulus(np.array([0])).force_box, [[0, 0, 9.80665]])


def heated_log(path: Path, sensors: Sequence[SensorHeader], phases: Sequence[Phase], warm_degc: float) -> Path:
    """At rest for 40 s while the reference temperature rises by `warm_degc`."""
    rows = np.arange(2000, dtype=np.int64) * SECOND // 50
    with LogWriter(path, sensors, source="imported", epoch="2024-01-01T00:00:00Z") as log:
        for number, sensor in enumerate(sensors):
            counts = np.rint(np.random.default_rng(number).normal([0, 0, 2048], 5, (2000, 3))).astype(np.int16)
            log.append(sensor.name, Block(rows, counts, np.zeros(2000, np.uint16)))
        degc = np.linspace(25.0, 25.0 + warm_degc, 2000)
        log.stimulus("reference", Stimulus(rows, np.full((2000, 3), np.nan), np.full((2000, 3), np.nan), degc))
        for one in phases:
            log.phase(one)
    return path


@pytest.mark.parametrize(("warm_degc", "kind"), [(1.0, "static"), (10.0, "heating")])
def test_a_heating_is_recognised_with_any_name_of_its_phase(tmp_path: Path, warm_degc: float, kind: str) -> None:
    accelerometer = replace(FOREIGN[0], has_temperature=False)
    path = heated_log(tmp_path / "log.h5", [accelerometer], [phase(0, 39, "static", "+Z")], warm_degc)
    assert recorded(path).kind == kind


@pytest.mark.slow
@pytest.mark.parametrize("faces", [["+Z"], ["+Z", "-Z"]])
def test_a_magnetometer_heated_on_two_faces_is_excluded(tmp_path: Path, faces: list[str]) -> None:
    """Its scale follows the temperature, and the resulting bias differs between the faces."""
    sensors = [replace(FOREIGN[0], has_temperature=False), COMPASS]
    phases = [phase(20 * at, 20 * at + 19, "heat", up) for at, up in enumerate(faces)]
    found = recorded(heated_log(tmp_path / "log.h5", sensors, phases, 10.0))
    assert ("Mag" in found.experiment.plan.sensors) == (len(faces) == 1)
    note = "Mag is left out: the magnetic field is not known in a box that is heated on several faces."
    assert (note in found.notes) == (len(faces) == 2)


def test_a_heating_of_unknown_temperature_is_excluded_among_others(tmp_path: Path) -> None:
    sensors = [replace(FOREIGN[0], has_temperature=False)]
    static = foreign_log(tmp_path / "static.h5", [phase(0, 9, "static", "+Z")], sensors)
    heating = foreign_log(tmp_path / "heating.h5", [phase(0, 9, "heat", "+Z")], sensors)
    found = recordings_of([open_log(static), open_log(heating)])
    assert [recording.name for recording in found] == ["static.h5"]
    assert found[0].notes[0] == "heating.h5 is left out: the box is heated and no temperature is recorded."
    assert [recording.name for recording in recordings_of([open_log(heating)])] == ["heating.h5"]


def test_a_box_that_turns_by_its_track_is_not_at_rest(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    rows = np.arange(1000, dtype=np.int64) * SECOND // 50
    with LogWriter(path, FOREIGN[1:], source="imported", epoch="2024-01-01T00:00:00Z") as log:
        counts = np.rint(np.random.default_rng(0).normal(0, 5, (1000, 3))).astype(np.int16)
        log.append("Gyro", Block(rows, counts, np.zeros(1000, np.uint16)))
        rate = np.zeros((1000, 3))
        rate[500:, 2] = np.radians(10.0)
        force = np.tile([0.0, 0.0, 9.8], (1000, 1))
        log.stimulus("reference", Stimulus(rows, force, rate, np.full(1000, 20.0)))
        log.phase(phase(0, 9, "static", "+Z"))
        log.phase(phase(10, 19, "shaken", "+Z"))
    assert [one.up for one in recorded(path).phases] == ["+Z", ""]


def turning_log(path: Path, rate: float, noise: float) -> Recording:
    """Sensors too noisy to detect that the box turns about the vertical to and fro, with a noisy reference."""
    rng = np.random.default_rng(1)
    time = np.arange(1000, dtype=np.int64) * SECOND // 50
    turning = rate * np.sin(2 * np.pi * time / (4 * SECOND))[:, None] * np.eye(3)[2]
    with LogWriter(path, FOREIGN, source="imported", epoch="2024-01-01T00:00:00Z") as log:
        for sensor in FOREIGN:
            level = [0, 0, 2048] if sensor.quantity == "specific_force" else [0, 0, 0]
            counts = np.rint(rng.normal(level, 40, (1000, 3))).astype(np.int16)
            warm = np.zeros(1000, np.int16) if sensor.has_temperature else None
            log.append(sensor.name, Block(time, counts, np.zeros(1000, np.uint16), warm))
        force = rng.normal([0.0, 0.0, 9.8], 10 * noise, (1000, 3))
        log.stimulus("reference", Stimulus(time, force, turning + rng.normal(0, noise, (1000, 3)), np.full(1000, 20.0)))
    return recorded(path)


def test_a_track_distinguishes_a_gentle_motion_from_rest(tmp_path: Path) -> None:
    turned = turning_log(tmp_path / "turned.h5", 0.05, 2e-4)
    assert [part.name for part in turned.phases] == ["motion"]


@pytest.mark.parametrize("noise", some([2e-5, 2e-4, 2e-3], 1))
def test_the_noise_of_a_reference_is_not_a_motion(tmp_path: Path, noise: float) -> None:
    still = turning_log(tmp_path / "still.h5", 0.0, noise)
    rest = still.phases[0]
    assert [part.name for part in still.phases] == ["pose 1"]
    stimulus = still.experiment.motion.stimulus(np.linspace(rest.start_ns, rest.end_ns - 1, 50).astype(np.int64))
    assert np.ptp(stimulus.force_box, axis=0) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


COURSES = {
    "line": lambda share: share,
    "warm-up": lambda share: 1 - np.exp(-4 * share),
    "there and back": lambda share: np.sin(np.pi * share),
    "step": lambda share: share > 0.43,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drifting", "shape", "is_left_out"),
    some(
        [
            (3, "line", True),
            (3, "warm-up", True),
            (3, "there and back", True),
            (3, "step", False),
            (0, "line", False),
            (1, "line", False),
        ],
        2,
    ),
)
def test_an_unrecorded_heating_is_excluded(tmp_path: Path, drifting: int, shape: str, is_left_out: bool) -> None:
    """Most of three sensors drift by 60 counts in a minute with a noise of 5, linearly, with a time constant of a
    quarter of that, or up and down; a single sensor may wander, and exchanged sensors have steps.
    """
    sensors = [replace(FOREIGN[0], name=name, has_temperature=False) for name in ("A", "B", "C")]
    plain = foreign_log(tmp_path / "plain.h5", [phase(0, 12, "static", "+Z")], sensors)
    path, rows = tmp_path / "warm.h5", 3000
    time = np.arange(rows, dtype=np.int64) * SECOND // 50
    rng = np.random.default_rng(0)
    with LogWriter(path, sensors, source="imported", epoch="2024-01-01T00:01:00Z") as log:
        for number, sensor in enumerate(sensors):
            share = np.linspace(0, 1, rows)
            drift = 60 * (number < drifting) * COURSES[shape](share)[:, None]
            counts = np.rint(rng.normal([0, 0, 2048], 5, (rows, 3)) + drift).astype(np.int16)
            log.append(sensor.name, Block(time, counts, np.zeros(rows, np.uint16)))
        log.phase(phase(0, 60, "static", "+Z"))
    read = recordings_of([open_log(plain), open_log(path)])
    assert [recording.name for recording in read] == (["plain.h5"] if is_left_out else ["plain.h5", "warm.h5"])
    assert any("warm.h5 is left out" in note for note in read[0].notes) == is_left_out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shapes", "is_left_out"),
    some(
        [
            (("line", "line", "line"), True),
            (("there and back", "step", "there and back"), True),
            (("line", "there and back", "warm-up"), False),
            (("step", "step", "step"), False),
        ],
        2,
    ),
)
def test_a_common_drift_of_the_axes_of_a_single_sensor_is_a_heating(
    tmp_path: Path, shapes: Sequence[str], is_left_out: bool
) -> None:
    """By -40, 60 and 80 counts: two axes are sufficient; three axes with independent wander are not heated."""
    sensor = replace(FOREIGN[0], has_temperature=False)
    plain = foreign_log(tmp_path / "plain.h5", [phase(0, 12, "static", "+Z")], [sensor])
    path, rows = tmp_path / "warm.h5", 3000
    share = np.linspace(0, 1, rows)
    drift = np.transpose([size * COURSES[shape](share) for size, shape in zip((-40, 60, 80), shapes, strict=True)])
    counts = np.random.default_rng(1).normal([0, 0, 2048], 5, (rows, 3)) + drift
    with LogWriter(path, [sensor], source="imported", epoch="2024-01-01T00:01:00Z") as log:
        time = np.arange(rows, dtype=np.int64) * SECOND // 50
        log.append(sensor.name, Block(time, np.rint(counts).astype(np.int16), np.zeros(rows, np.uint16)))
        log.phase(phase(0, 60, "static", "+Z"))
    read = recordings_of([open_log(plain), open_log(path)])
    assert [recording.name for recording in read] == (["plain.h5"] if is_left_out else ["plain.h5", "warm.h5"])


@pytest.mark.parametrize("warming", [0, 1])
def test_the_noise_of_a_chip_thermometer_is_not_a_temperature_change(tmp_path: Path, warming: int) -> None:
    """Eight counts per degree, noise of one degree: a constant temperature, unless it warms up by ten degrees."""
    known = replace(FOREIGN[0], chip="unheard_of", extra=ThermometerScale(36.5, 8.0).attributes)
    path, rows = tmp_path / "log.h5", 3000
    time = np.arange(rows, dtype=np.int64) * SECOND // 50
    rng = np.random.default_rng(3)
    with LogWriter(path, [known], source="imported", epoch="2024-01-01T00:00:00Z") as log:
        counts = np.rint(rng.normal([0, 0, 2048], 5, (rows, 3))).astype(np.int16)
        readings = np.rint(rng.normal(np.linspace(0, 80 * warming, rows), 8)).astype(np.int16)
        log.append("Acc", Block(time, counts, np.zeros(rows, np.uint16), readings))
        log.phase(phase(0, 60, "static", "+Z"))
    seconds = np.arange(5, 56)
    degc = recorded(path).experiment.motion.stimulus(seconds * SECOND).temperature_degc
    assert degc[-1] - degc[0] == pytest.approx(50 / 6 * warming, abs=0.5)
    straight = np.polyval(np.polyfit(seconds, degc, 1), seconds)
    assert bool(np.abs(degc - straight).max() < 1e-6) == (not warming)
