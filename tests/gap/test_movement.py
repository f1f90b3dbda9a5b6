"""The motion of the box by the array's own sensors, in logs of a turn with known kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import lfilter

from imuarray.errors import LogError
from imuarray.gap.diagnose import diagnose
from imuarray.gap.inference.comparison import prepare
from imuarray.gap.recording import movement
from imuarray.gap.recording.movement import movements_of, shaken_quantities, shows_motion, unresolved_quantities
from imuarray.gap.recording.phases import is_at_rest
from imuarray.gap.recording.quiet import QuietRest, knocks, quiet_rest
from imuarray.gap.recording.recordings import recording_of, recordings_of
from imuarray.gap.statistics.catalogue import statistics
from imuarray.log import Block, Log, LogWriter, Stimulus, open_log
from imuarray.log.format import Phase, SensorHeader
from imuarray.simulate.motion.posed import Movement, PoseSequence
from tests.selection import some

Floats = npt.NDArray[np.float64]
SECOND = 1_000_000_000
ACC = SensorHeader("Acc", "unheard_of", "specific_force", "g", 4.0, 8000.0)
GYRO = SensorHeader("Gyro", "unheard_of", "angular_rate", "dps", 250.0, 100.0)
GRAVITY = 9.80665
REST, TURN, AFTER = (
    Phase(0, 4 * SECOND, "z_up", "+Z"),
    Phase(4 * SECOND, 8 * SECOND, "turn"),
    Phase(8 * SECOND, 12 * SECOND, "x_down", "-X"),
)


def angle_rad(seconds: Floats) -> Floats:
    """A smooth turn by a right angle about y from 4 s to 8 s."""
    share = np.clip((seconds - 4) / 4, 0.0, 1.0)
    return np.asarray(np.pi / 2 * (share - np.sin(2 * np.pi * share) / (2 * np.pi)))


def rate_rad_s(seconds: Floats) -> Floats:
    share = np.clip((seconds - 4) / 4, 0.0, 1.0)
    return np.asarray(np.pi / 8 * (1 - np.cos(2 * np.pi * share)))


def stimulus(header: SensorHeader, seconds: Floats) -> Floats:
    """Reading (n, 3) of a sensor along its own axes, in its unit: gravity's reaction in the box is (-sin, 0, cos)."""
    turned = angle_rad(seconds)
    if header.unit == "g":
        box = np.stack([-np.sin(turned), 0 * turned, np.cos(turned)], axis=1)
    else:
        turning = header.unit == "dps"  # a magnetometer reads nothing
        box = np.stack([0 * turned, turning * np.degrees(rate_rad_s(seconds)), 0 * turned], axis=1)
    return np.asarray(box @ np.asarray(header.orientation))


def written(
    path: Path,
    sensors: Sequence[SensorHeader],
    biases: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0),
    rates_hz: Sequence[float] = (100.0, 100.0, 50.0, 100.0, 80.0),
    phases: Sequence[Phase] = (REST, AFTER),
    missing_s: tuple[float, float] = (0.0, 0.0),
    is_tracked: bool = False,
    reversed_sensor: str = "",
    shaking: tuple[float, float] = (0.0, 1.0),
    shaken_s: tuple[float, float] = (4.0, 8.0),
    rocking: tuple[float, float] = (0.0, 1.0),
    memory: float = 0.0,
) -> Log:
    """Noise of two counts, with this correlation from row to row; the first sensor lacks the rows of a stretch; one may
    have axes that are all reversed. In a stretch accelerometers are shaken along z of the box, by an amplitude in g at
    a frequency in Hz, and gyroscopes by `rocking` about z, in dps.
    """
    with LogWriter(path, sensors, source="imported", epoch="2024-01-01T00:00:00Z") as log:
        for number, header in enumerate(sensors):
            time = np.arange(0, 12 * SECOND, round(SECOND / rates_hz[number]), dtype=np.int64)
            if number == 0:
                time = time[~((missing_s[0] * SECOND <= time) & (time < missing_s[1] * SECOND))]
            sign = -1 if header.name == reversed_sensor else 1
            amplitude, hertz = shaking if header.unit == "g" else rocking
            moves = (time >= shaken_s[0] * SECOND) & (time < shaken_s[1] * SECOND)
            shaken = amplitude * np.sin(2 * np.pi * hertz * time * 1e-9) * moves
            reading = (sign * stimulus(header, time * 1e-9) + biases[number]) * header.sensitivity
            reading += shaken[:, None] * np.asarray(header.orientation)[2] * header.sensitivity
            white = np.random.default_rng(number).normal(0, 2 * np.sqrt(1 - memory**2), (len(time), 3))
            noise = lfilter([1.0], [1.0, -memory], white, axis=0)
            log.append(
                header.name, Block(time, np.rint(reading + noise).astype(np.int16), np.zeros(len(time), np.uint16))
            )
        if is_tracked:
            time = np.arange(0, 12 * SECOND, SECOND // 50, dtype=np.int64)
            rate = np.radians(stimulus(GYRO, time * 1e-9))
            log.stimulus(
                "reference", Stimulus(time, GRAVITY * stimulus(ACC, time * 1e-9), rate, np.full(len(time), 25.0))
            )
        for phase in phases:
            log.phase(phase)
    return open_log(path)


def array(*, accelerometers: int, gyroscopes: int) -> list[SensorHeader]:
    """Sensors with individual axes."""
    axes = ("+X+Y+Z", "+Y-X+Z", "-Z+Y+X")
    return [
        *(replace(ACC, name=f"Acc{number}", axes=axes[number]) for number in range(accelerometers)),
        *(replace(GYRO, name=f"Gyro{number}", axes=axes[number]) for number in range(gyroscopes)),
    ]


def movement_of(log: Log, phase: Phase, rests: Sequence[Phase]) -> Movement | None:
    return movements_of(log, list(log.sensors), [phase], rests).get(phase)


@pytest.mark.parametrize("missing_s", some([((0.0, 0.0),), ((5.0, 6.5),)], 1))
def test_the_movement_is_the_mean_of_the_sensors(tmp_path: Path, missing_s: tuple[float, float]) -> None:
    """Force and rate within 4 mg and 0.1 dps (biases average to 2.5 mg, those of gyroscopes are known from the rest),
    and the angular acceleration within 5 %, for any orientation of the sensors; a sensor that lacks rows causes no
    step.
    """
    sensors = array(accelerometers=2, gyroscopes=3)
    log = written(tmp_path / "log.h5", sensors, (0.003, -0.002, 3.0, -2.0, 1.0), missing_s=missing_s)
    motion = movement_of(log, TURN, [REST, AFTER])
    assert motion is not None
    seconds = np.linspace(4.2, 7.8, 60)
    values, slopes = motion.columns.at((seconds * SECOND).astype(np.int64))
    turned = angle_rad(seconds)
    force = GRAVITY * np.stack([-np.sin(turned), 0 * turned, np.cos(turned)], axis=1)
    np.testing.assert_allclose(values[:, :3], force, atol=0.004 * GRAVITY)
    np.testing.assert_allclose(values[:, 4], rate_rad_s(seconds), atol=np.radians(0.1))
    np.testing.assert_allclose(values[:, [3, 5]], 0.0, atol=np.radians(0.1))
    acceleration = np.pi**2 / 16 * np.sin(2 * np.pi * (seconds - 4) / 4)
    np.testing.assert_allclose(slopes[:, 4], acceleration, atol=0.03)


def test_one_of_three_with_another_mounting_is_ignored(tmp_path: Path) -> None:
    """The median of three: a gyroscope whose axes are not those in its header changes nothing."""
    sensors = array(accelerometers=0, gyroscopes=3)
    log = written(tmp_path / "log.h5", sensors, reversed_sensor="Gyro0")
    motion = movement_of(log, TURN, [REST])
    assert motion is not None
    rate = motion.columns.at(np.array([6 * SECOND]))[0][0, 3:]
    np.testing.assert_allclose(rate, [0.0, np.pi / 4, 0.0], atol=np.radians(0.5))


@pytest.mark.parametrize("noted", some(["+Z", "-Y"], 1))
def test_one_of_two_that_contradicts_the_noted_face_is_ignored(tmp_path: Path, noted: str) -> None:
    """An accelerometer that reads -1 g on its upper face; if both contradict the note, the note is wrong, and the mean
    of the two is zero here.
    """
    sensors = array(accelerometers=2, gyroscopes=2)
    log = written(tmp_path / "log.h5", sensors, reversed_sensor="Acc1")
    motion = movement_of(log, TURN, [REST._replace(up=noted)])
    assert motion is not None
    force = motion.columns.at(np.array([6 * SECOND]))[0][0, :3]
    whole = GRAVITY * np.array([-np.sqrt(0.5), 0.0, np.sqrt(0.5)])
    np.testing.assert_allclose(force, whole if noted == "+Z" else 0.0, atol=0.01 * GRAVITY)


@pytest.mark.parametrize(("accelerometers", "gyroscopes"), some([(1, 1), (0, 1), (3, 0)], 1))
def test_a_movement_needs_two_sensors_of_a_kind_and_a_gyroscope(
    tmp_path: Path, accelerometers: int, gyroscopes: int
) -> None:
    sensors = array(accelerometers=accelerometers, gyroscopes=gyroscopes)
    log = written(tmp_path / "log.h5", sensors)
    assert movement_of(log, TURN, [REST]) is None


def test_a_rest_is_not_a_movement(tmp_path: Path) -> None:
    sensors = array(accelerometers=2, gyroscopes=2)
    log = written(tmp_path / "log.h5", sensors)
    assert movement_of(log, Phase(0, 4 * SECOND, "turn"), [REST]) is None
    assert movement_of(log, Phase(5 * SECOND, 5 * SECOND + SECOND // 10, "turn"), [REST]) is None


def test_a_movement_of_too_many_windows_is_not_estimated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sensors = array(accelerometers=2, gyroscopes=2)
    log = written(tmp_path / "log.h5", sensors)
    monkeypatch.setattr(movement, "MOST_WINDOWS", 50)
    assert movement_of(log, TURN, [REST]) is None


@pytest.mark.slow
def test_a_still_axis_has_no_noise_in_the_movement(tmp_path: Path) -> None:
    """Two gyroscopes of 0.02 dps (two counts) in windows of one row: their mean has 0.014 dps, of which at most two
    thirds remain about the still axes.
    """
    sensors = array(accelerometers=0, gyroscopes=2)
    motion = movement_of(written(tmp_path / "log.h5", sensors), TURN, [REST, AFTER])
    assert motion is not None
    times = np.linspace(4.1, 7.9, 500) * SECOND
    rate_dps = np.degrees(motion.columns.at(times.astype(np.int64))[0][:, [3, 5]])
    assert rate_dps.std() < 0.0095


def test_filtered_noise_is_reduced_like_white_noise(tmp_path: Path) -> None:
    """Noise with a correlation of 0.95 from row to row has tiny second differences; its spectrum at rest shows it. The
    mean of two gyroscopes has 0.014 dps.
    """
    log = written(tmp_path / "log.h5", array(accelerometers=0, gyroscopes=2), rates_hz=(400.0, 400.0), memory=0.95)
    motion = movement_of(log, TURN, [REST, AFTER])
    assert motion is not None
    times = np.linspace(4.1, 7.9, 500) * SECOND
    rate_dps = np.degrees(motion.columns.at(times.astype(np.int64))[0][:, [3, 5]])
    assert rate_dps.std() < 0.0095


@pytest.mark.parametrize(("amplitude_g", "quantities"), [(0.0, ()), (0.01, ("specific_force",))])
def test_changes_that_rows_do_not_resolve(tmp_path: Path, amplitude_g: float, quantities: tuple[str, ...]) -> None:
    """80 counts at 31 Hz in rows of 100 Hz, beside noise of two counts; the gyroscope turns smoothly."""
    sensors = array(accelerometers=2, gyroscopes=1)
    log = written(tmp_path / "log.h5", sensors, rates_hz=(100.0, 100.0, 100.0), shaking=(amplitude_g, 31.0))
    assert unresolved_quantities([log[name] for name in log.sensors], TURN, [REST, AFTER]) == quantities
    recording = recording_of(log)
    assert any("1 of 1 motions have changes" in note for note in recording.notes) == bool(quantities)
    _, campaign = prepare([recording], None, 0)
    found = statistics(campaign)
    least = {
        key.probe: resolution
        for key, resolution in zip(found.keys, found.resolutions.tolist(), strict=True)
        if key.domain == "motion" and key.sensor == "Acc0"
    }
    assert least["motion_delay"] == pytest.approx(
        0.03 if quantities else 0.003, rel=0.1
    )  # windows; what the motion determines
    assert least["motion_gain"] == (0.25 if quantities else 0.0)


def test_a_rough_reading_of_a_single_sensor_is_no_motion(tmp_path: Path) -> None:
    """A gyroscope whose readings have spikes in the turn is rough; the other two are not."""
    sensors = array(accelerometers=0, gyroscopes=3)
    log = written(tmp_path / "log.h5", sensors, rates_hz=(100.0, 100.0, 100.0))
    log.close()
    with h5py.File(tmp_path / "log.h5", "r+") as file:
        file["sensors/Gyro1/counts"][500:700:20] += 4000
    rough = open_log(tmp_path / "log.h5")
    assert unresolved_quantities([rough[name] for name in rough.sensors], TURN, [REST, AFTER]) == ()


@pytest.mark.slow
@pytest.mark.parametrize(("hertz", "is_left_out"), [(3.0, False), (31.0, True)])
def test_a_fast_vibration_is_not_a_movement(tmp_path: Path, hertz: float, is_left_out: bool) -> None:
    """A third of a g at 3 Hz is a motion, at 31 Hz every row of 100 Hz differs from the previous row."""
    sensors = array(accelerometers=2, gyroscopes=1)
    shaken = written(tmp_path / "log.h5", sensors, shaking=(1.0, hertz), phases=(REST, TURN._replace(name="drive")))
    assert (movement_of(shaken, TURN, [REST]) is None) == is_left_out
    recording = recording_of(shaken)
    assert (len(recording.phases) == 1) == is_left_out
    assert any("vibrates faster than the rows" in note for note in recording.notes) == is_left_out


@pytest.mark.parametrize(("amplitude_g", "is_left_out"), some([(0.002, True), (0.0, False)], 1))
def test_a_noted_rest_with_shaking_is_excluded(tmp_path: Path, amplitude_g: float, *, is_left_out: bool) -> None:
    """The box is in a hand that shakes it by 16 counts at 7 Hz, the noise is two; the label states a rest."""
    sensors = array(accelerometers=2, gyroscopes=1)
    recording = recording_of(
        written(tmp_path / "log.h5", sensors, shaking=(amplitude_g, 7.0), shaken_s=(0.0, 4.0), phases=(REST, AFTER))
    )
    assert (REST in recording.phases) != is_left_out
    assert AFTER in recording.phases
    assert any("feel the same motion" in note for note in recording.notes) == is_left_out


@pytest.mark.slow
def test_accelerometers_shaken_at_every_rest_are_excluded(tmp_path: Path) -> None:
    """Near a running engine, which the gyroscope does not sense; if all sensors sense it, they are compared."""
    sensors = array(accelerometers=2, gyroscopes=1)
    for count, expected in ((3, {"Gyro0"}), (2, {"Acc0", "Acc1"})):
        path = tmp_path / f"log{count}.h5"
        log = written(path, sensors[:count], shaking=(0.002, 7.0), shaken_s=(0.0, 12.0), phases=(REST,))
        recording = recording_of(log)
        assert set(recording.experiment.plan.sensors) == expected
        assert recording.phases == (REST,)
        assert any("shaken in every phase" in note for note in recording.notes) == (count == 3)


@pytest.mark.parametrize(
    ("rocking", "accelerometers", "expected"),
    some(
        [
            ((0.5, 7.0), 2, {"specific_force", "angular_rate"}),
            ((0.5, 33.0), 2, {"specific_force"}),
            ((0.0, 7.0), 2, {"specific_force"}),
            ((0.5, 7.0), 1, set()),
        ],
        2,
    ),
)
def test_a_single_gyroscope_is_shaken_at_the_frequency_of_the_accelerometers(
    tmp_path: Path, rocking: tuple[float, float], accelerometers: int, expected: set[str]
) -> None:
    """A line of the gyroscope at another frequency is its own, and a single accelerometer shows no shaken box."""
    sensors = array(accelerometers=accelerometers, gyroscopes=1)
    log = written(
        tmp_path / "log.h5",
        sensors,
        rates_hz=(200.0, 200.0, 200.0),
        shaking=(0.003, 7.0),
        shaken_s=(0.0, 4.0),
        rocking=rocking,
    )
    assert set(shaken_quantities(list(log.sensors.values()), REST)) == expected


@pytest.mark.slow
def test_a_log_with_a_shaken_box_is_left_out(tmp_path: Path) -> None:
    """If the box is shaken in all logs, all of them are compared."""
    sensors = array(accelerometers=2, gyroscopes=0)
    shaken, calm = (
        written(tmp_path / f"{name}.h5", sensors, shaking=(amplitude, 7.0), shaken_s=(0.0, 12.0), phases=(REST,))
        for name, amplitude in (("shaken", 0.003), ("calm", 0.0))
    )
    (recording,) = recordings_of([shaken, calm])
    assert recording.name == "calm.h5"
    assert recording.notes[0].startswith("shaken.h5 is left out: the box is shaken")
    assert [each.name for each in recordings_of([shaken, shaken])] == ["shaken.h5", "shaken.h5"]


@pytest.mark.slow
@pytest.mark.parametrize(("accelerometers", "is_left_out"), [(2, True), (1, False)])
def test_a_touch_sensed_by_several_sensors_is_excluded(
    tmp_path: Path, accelerometers: int, *, is_left_out: bool
) -> None:
    """A push by 0.05 g from 1.5 s to 1.6 s is excluded with its block of a third of a second and half a second around
    it; a disturbance of a single sensor is its own.
    """
    sensors = array(accelerometers=accelerometers, gyroscopes=1)
    recording = recording_of(
        written(tmp_path / "log.h5", sensors, shaking=(0.05, 5.0), shaken_s=(1.5, 1.6), phases=(REST,))
    )
    uncertain_ns = recording.experiment.uncertain_ns
    assert any("touched or shaken" in note for note in recording.notes) == is_left_out
    assert recording.phases == (REST,)
    assert uncertain_ns.keys() == ({"Acc0", "Acc1", "Gyro0"} if is_left_out else set())
    for times_ns in uncertain_ns.values():
        assert np.min(times_ns) * 1e-9 == pytest.approx(0.85, abs=0.35)
        assert np.max(times_ns) * 1e-9 == pytest.approx(2.25, abs=0.35)


def test_a_touch_at_the_end_of_a_rest_does_not_shorten_the_motion(tmp_path: Path) -> None:
    """A push from 3.4 s to 3.5 s of a rest that ends at 4 s: half a second after its block would end at 4.17 s."""
    sensors = array(accelerometers=2, gyroscopes=1)
    log = written(
        tmp_path / "log.h5",
        sensors,
        rates_hz=(100.0, 100.0, 100.0),
        shaking=(0.05, 5.0),
        shaken_s=(3.4, 3.5),
        phases=(REST,),
    )
    rest = quiet_rest([log[name] for name in ("Acc0", "Acc1", "Gyro0")], REST)
    ((begin_ns, end_ns),) = rest.restless
    assert 2.5 < begin_ns * 1e-9 < 3.4
    assert end_ns == REST.end_ns


def test_a_rest_is_cut_where_the_box_moves(tmp_path: Path) -> None:
    """The label of the rest ends a second late, when the box has begun to turn at 4 s; it turns by 0.5 dps after a
    tenth of a second. The next rest begins half a second early.
    """
    sensors = array(accelerometers=1, gyroscopes=1)
    phases = (REST._replace(end_ns=5 * SECOND), AFTER._replace(start_ns=15 * SECOND // 2))
    first, second = recording_of(written(tmp_path / "log.h5", sensors, phases=phases)).phases
    assert first._replace(end_ns=0) == REST._replace(end_ns=0)
    assert 3.0 < first.end_ns * 1e-9 < 4.0
    assert 8.0 < second.start_ns * 1e-9 < 9.0
    assert second._replace(start_ns=0) == AFTER._replace(start_ns=0)


@pytest.mark.parametrize(("gyroscopes", "drifting", "is_cut"), [(2, 1, False), (3, 2, True), (1, 1, True)])
def test_a_rest_is_cut_where_several_sensors_move(
    tmp_path: Path, gyroscopes: int, drifting: int, *, is_cut: bool
) -> None:
    """Biases of 5 dps in the first rows: a single one of several gyroscopes is not turned; one that is alone cannot be
    compared.
    """
    log = written(tmp_path / "log.h5", array(accelerometers=2, gyroscopes=gyroscopes), phases=(REST,))
    log.close()
    with h5py.File(tmp_path / "log.h5", "r+") as file:
        for number in range(drifting):
            file[f"sensors/Gyro{number}/counts"][:40] += 500
    with open_log(tmp_path / "log.h5") as log:
        rest = quiet_rest(list(log.sensors.values()), REST)
    assert (rest.phase.start_ns > REST.start_ns) == is_cut


@pytest.mark.slow
def test_a_rest_is_cut_where_motors_start(tmp_path: Path) -> None:
    """Two accelerometers are shaken by 0.02 g from 3 s until the end of the phase; a single one may be at fault."""
    for count, end_s in ((2, 2.35), (1, 4.0)):
        sensors = array(accelerometers=count, gyroscopes=1)
        log = written(
            tmp_path / f"log{count}.h5", sensors, shaking=(0.02, 21.0), shaken_s=(3.0, 4.0), phases=(REST, AFTER)
        )
        assert recording_of(log).phases[0].end_ns * 1e-9 == pytest.approx(end_s, abs=0.3 if count == 2 else 1e-9)


def test_held_readings_are_not_taken_as_low_noise(tmp_path: Path) -> None:
    """Two sensors repeat their readings for a fifth of the rest: the noise of the others is unchanged."""
    log = written(tmp_path / "log.h5", array(accelerometers=2, gyroscopes=1), phases=(REST,))
    log.close()
    with h5py.File(tmp_path / "log.h5", "r+") as file:
        for name in ("Acc0", "Acc1"):
            counts = file[f"sensors/{name}/counts"]
            counts[150:230] = np.tile(counts[150], (80, 1))
    with open_log(tmp_path / "log.h5") as held:
        rest = quiet_rest([held[name] for name in ("Acc0", "Acc1", "Gyro0")], REST)
    assert rest == QuietRest(REST)


def test_noise_alone_is_not_a_motion() -> None:
    """White noise of 0.5 m/s2 and 0.05 rad/s; a drift of the same size is motion."""
    noise = np.random.default_rng(1).standard_normal((500, 3))
    drift = np.linspace(-1, 1, 500)[:, None] * np.ones(3)
    assert not shows_motion(0.5 * noise, 0.05 * noise)
    assert shows_motion(0.5 * noise + drift, 0.05 * noise)


@pytest.mark.slow
def test_turns_of_a_log_without_a_track_are_simulated(tmp_path: Path) -> None:
    """Its simulation has the turns of the array, and its faces before and after."""
    sensors = array(accelerometers=2, gyroscopes=2)
    recording = recording_of(written(tmp_path / "log.h5", sensors))
    assert recording.phases == (REST, TURN, AFTER)
    assert recording.kind == "tumble"
    assert any("estimated from the array's own sensors" in note for note in recording.notes)
    motion = recording.experiment.motion
    assert isinstance(motion, PoseSequence)
    times = np.array([2, 6, 10], np.int64) * SECOND
    stimulus_box = motion.stimulus(times)
    half = GRAVITY / np.sqrt(2)
    np.testing.assert_allclose(stimulus_box.force_box, [[0, 0, GRAVITY], [-half, 0, half], [-GRAVITY, 0, 0]], atol=0.05)
    np.testing.assert_allclose(stimulus_box.rate_box[:, 1], [0.0, np.pi / 4, 0.0], atol=0.01)


@pytest.mark.parametrize(("longest_s", "is_compared"), some([(2.0, True), (20.0, False)], 1))
def test_a_motion_between_detected_rests_is_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, longest_s: float, is_compared: bool
) -> None:
    """No phase is noted: the box is at rest, turns for 4 s, and is at rest again."""
    monkeypatch.setattr("imuarray.gap.recording.phases._LONGEST_TURN_S", longest_s)
    sensors = array(accelerometers=2, gyroscopes=2)
    recording = recording_of(written(tmp_path / "log.h5", sensors, phases=()))
    between = ["motion"] if is_compared else []
    assert [phase.name for phase in recording.phases] == ["pose 1", *between, "pose 2"]
    if is_compared:
        moving = recording.phases[1]
        np.testing.assert_allclose([moving.start_ns * 1e-9, moving.end_ns * 1e-9], [4.0, 8.0], atol=0.6)


@pytest.mark.campaign
def test_turns_of_the_held_out_log_alone_are_simulated(tmp_path: Path) -> None:
    """Two logs of one kind, of which the second, with turns, is held out: its sensors are simulated together, and those
    that the search does not fit have no parameters in a replicate.
    """
    compass = SensorHeader("Mag", "unheard_of", "magnetic_field", "gauss", 1.3, 1090.0)
    sensors = [*array(accelerometers=2, gyroscopes=1), compass]
    still = (Phase(0, 4 * SECOND, "static"),)
    poses = (REST._replace(name="pose 1", up=""), AFTER._replace(name="pose 2", up=""))
    logs = [
        written(tmp_path / f"{name}.h5", sensors, (bias, 0.0, 0.0, 0.0), phases=phases, is_tracked=True)
        for name, phases, bias in (("static", still, 0.0), ("turned", poses, 0.05))
    ]
    assert [recording_of(log).kind for log in logs] == ["static", "static"]
    diagnosis = diagnose(logs, replicates=20)
    assert diagnosis.verdict != "no gap"
    assert "Acc0" in {deviation.sensor for deviation in diagnosis.where}


def test_a_noted_motion_that_two_sensors_show_is_compared(tmp_path: Path) -> None:
    sensors = array(accelerometers=1, gyroscopes=2)
    phases = (REST, TURN._replace(name="motion"), AFTER)
    assert recording_of(written(tmp_path / "log.h5", sensors, phases=phases)).phases == phases


@pytest.mark.parametrize(
    ("shaking", "accelerometers", "is_left_out"),
    some([((0.5, 30.0), 2, True), ((0.02, 5.0), 2, False), ((0.0, 30.0), 2, False), ((0.5, 30.0), 1, False)], 2),
)
def test_a_knock_in_a_turn_is_excluded(
    tmp_path: Path, shaking: tuple[float, float], accelerometers: int, *, is_left_out: bool
) -> None:
    """The box rings from 7.0 to 7.2 s of a turn from 4 to 8 s, faster than a hand moves it, or a single accelerometer
    says so.
    """
    sensors = array(accelerometers=accelerometers, gyroscopes=2)
    rates_hz = (100.0,) * 4
    log = written(tmp_path / "log.h5", sensors, rates_hz=rates_hz, shaking=shaking, shaken_s=(7.0, 7.2))
    spans = knocks(list(log.sensors.values()), TURN, [REST])
    assert bool(spans) == is_left_out
    if is_left_out:
        ((begin_ns, end_ns),) = spans
        assert 6.6 < begin_ns * 1e-9 < 7.0 and 7.2 < end_ns * 1e-9 < 7.6
        recording = recording_of(log)
        assert any("the box is knocked" in note for note in recording.notes)
        assert all(np.any(times == 7_100_000_000) for times in recording.experiment.uncertain_ns.values())


@pytest.mark.slow
@pytest.mark.parametrize(("other_range_g", "is_left_out"), [(16.0, True), (2.0, False)])
def test_a_knock_that_only_the_quietest_accelerometer_can_measure_is_excluded(
    tmp_path: Path, other_range_g: float, *, is_left_out: bool
) -> None:
    """Noise of two counts: of an accelerometer with an eighth of the range it is an eighth. The other one does not
    measure the disturbance from 1.5 to 1.6 s; with the same range it would.
    """
    quiet, other = array(accelerometers=2, gyroscopes=0)
    sensors = [
        replace(quiet, range=2.0, sensitivity=16384.0),
        replace(other, range=other_range_g, sensitivity=32768 / other_range_g),
    ]
    log = written(tmp_path / "log.h5", sensors, shaking=(0.0008, 20.0), shaken_s=(1.5, 1.6), phases=(REST,))
    log.close()
    with h5py.File(tmp_path / "log.h5", "r+") as file:
        counts = file["sensors/Acc1/counts"]
        counts[150:161] = counts[130:141]
    with open_log(tmp_path / "log.h5") as log:
        rest = quiet_rest(list(log.sensors.values()), REST)
    assert bool(rest.restless) == is_left_out


@pytest.mark.parametrize(("name", "is_still"), [("heat", True), ("cool", True), ("soak", True), ("drive", False)])
def test_the_box_is_at_rest_in_an_oven(name: str, *, is_still: bool) -> None:
    assert is_at_rest(Phase(0, SECOND, name)) is is_still


@pytest.mark.parametrize(("name", "is_still"), [("motion", False), ("on its lid", True)])
def test_a_noted_axis_does_not_make_a_motion_a_rest(name: str, *, is_still: bool) -> None:
    """A motor runs in a phase named motion, whichever axis is up."""
    assert is_at_rest(Phase(0, SECOND, name, "+Z")) is is_still


def test_still_parts_of_a_noted_motion_are_not_compared(tmp_path: Path) -> None:
    """A boat that hardly rocks for some seconds is not at rest."""
    log = written(tmp_path / "log.h5", array(accelerometers=1, gyroscopes=1), phases=(Phase(0, 12 * SECOND, "motion"),))
    with pytest.raises(LogError, match="never at rest"):
        recordings_of([log])


def test_the_force_of_a_rotation_is_centripetal_and_tangential() -> None:
    """The rate about z grows by 2 rad/s2 from 3 rad/s: at 50 mm along x the force is -r w^2 along x and 2 r along y."""
    seconds = np.arange(100) * 0.01
    rate = np.stack([0 * seconds, 0 * seconds, 3 + 2 * seconds], axis=1)
    rate[40:45] = np.nan
    nothing, force = movement.force_of_rotation(rate, 0.01, np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]]))
    assert not nothing.any()
    expected = np.stack([-0.05 * (3 + 2 * seconds) ** 2, 0 * seconds + 0.1, 0 * seconds], axis=1)
    np.testing.assert_allclose(force[5:-5], expected[5:-5], atol=1e-3)


def test_a_robust_mean_has_the_noise_of_a_mean() -> None:
    """Four equal sensors: the mean has a quarter of the variance of one, their median 0.30 (order statistics). A sensor
    that is far off shifts the result by at most half of a standard deviation, 2 / 4, beside that of the others.
    """
    readings = np.random.default_rng(5).normal(size=(4, 4000, 3))
    weights = np.ones(4)
    assert movement.robust_mean(readings, weights=weights).var() == pytest.approx(0.25, rel=0.06)
    readings[2] += 50.0
    assert np.abs(movement.robust_mean(readings, weights=weights).mean()) < 0.8


def test_a_weighted_median_of_unequal_sensors() -> None:
    """Equal weights give the median of those with readings. With half of the weight a value is the median, or the mean
    of it and the next if it is the first or the last.
    """
    values = np.random.default_rng(0).normal(size=(4, 50, 3))
    values[2, 10] = np.nan
    np.testing.assert_allclose(movement.weighted_median(values, weights=np.ones(4)), np.nanmedian(values, axis=0))
    three = np.array([[[1.0, 5.0, 9.0]], [[4.0, 4.0, 4.0]], [[7.0, 7.0, 7.0]]])
    assert movement.weighted_median(three, weights=np.array([2.0, 1.0, 1.0])).tolist() == [[2.5, 5.0, 8.0]]


@pytest.mark.slow
def test_a_quiet_gyroscope_determines_the_motion_beside_noisy_ones(tmp_path: Path) -> None:
    """Noise of two counts: four times the sensitivity means a quarter of the noise. Of three equal sensors the median
    has 0.45 of the variance of one; with a quiet one the estimated motion has less noise than that.
    """
    gyroscopes = array(accelerometers=1, gyroscopes=3)
    quiet = [*gyroscopes[:3], replace(gyroscopes[3], sensitivity=4 * gyroscopes[3].sensitivity)]
    residuals = []
    for name, sensors in (("equal", gyroscopes), ("quiet", quiet)):
        log = written(tmp_path / f"{name}.h5", sensors, rates_hz=(100.0,) * 4)
        motion = movement_of(log, TURN, [REST, AFTER])
        assert motion is not None
        middles_ns = np.arange(5 * SECOND, 7 * SECOND, SECOND // 50)
        rate = motion.columns.values_at(middles_ns)[:, 3:]
        residuals.append(np.std(np.degrees(rate[:, 1]) - np.degrees(rate_rad_s(middles_ns * 1e-9))))
    assert residuals[1] < 0.7 * residuals[0]
