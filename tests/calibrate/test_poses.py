"""Detection of static poses in a log without phases, and the mean reading of a pose."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import chi2

from imuarray.calibrate.pose_readings import Pose, PoseReadings, find_poses, find_rests, named_faces, read_pose
from imuarray.errors import CalibrationError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Phase, SensorHeader
from imuarray.units import Quantity
from tests.calibrate.conftest import EPOCH, Floats, Part, WriteLog, accelerometer, directions, gyroscope, skewed
from tests.selection import some

RATE_HZ = 100.0


def two_sensors(sigma: float = 10.0) -> list[Part]:
    rng = np.random.default_rng(3)
    axes = ("+X+Y+Z", "-Y-X-Z")
    return [
        Part(accelerometer(f"A{i}", a), skewed(a, 2048, rng), rng.uniform(-99, 99, 3), sigma)
        for i, a in enumerate(axes)
    ]


def tumbled() -> Floats:
    """14 poses, each far from the previous one."""
    ups = directions(14, np.random.default_rng(3))
    assert np.linalg.norm(np.diff(ups, axis=0), axis=1).min() > 0.3
    return ups


def check_poses(path: Path, rows: int, moving_rows: int) -> None:
    """Each pose is detected once, is inside the true pose, and is not much shorter."""
    with open_log(path) as log:
        poses = find_poses(log)
    assert len(poses) == 14
    for index, pose in enumerate(poses):
        first_ns = round(index * (rows + moving_rows) * 1e9 / RATE_HZ)
        last_ns = first_ns + round(rows * 1e9 / RATE_HZ)
        assert first_ns <= pose.phase.start_ns < pose.phase.end_ns <= last_ns
        # Up to a window is lost at each end to the grid of windows, and another window is cut off on purpose.
        assert pose.phase.end_ns - pose.phase.start_ns >= last_ns - first_ns - 2_000_000_000
        assert pose.up_box is None


@pytest.mark.parametrize("rows", some([300, 600], 1))
@pytest.mark.parametrize("moving_rows", some([10, 40, 250], 2))
@pytest.mark.parametrize("sigma", some([1.0, 0.0, 30.0], 1))
def test_every_pose_of_a_hand_tumbled_log_is_detected(
    write_log: WriteLog, rows: int, moving_rows: int, sigma: float
) -> None:
    check_poses(write_log(two_sensors(sigma), tumbled(), rows=rows, moving_rows=moving_rows), rows, moving_rows)


def test_drift_does_not_split_a_pose(write_log: WriteLog) -> None:
    """1 mg/s over 6 s poses, in all 80 mg."""
    path = write_log(two_sensors(), tumbled(), rows=600, moving_rows=50, drift_lsb_per_s=2.0)
    check_poses(path, 600, 50)


def test_gaps_between_the_poses_are_not_poses(write_log: WriteLog) -> None:
    """Nothing was recorded while the box was turned: 10 s without a row are not 10 s of standing still."""
    rows, moving = 600, 1000

    def keep(name: str, time: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        return np.asarray((time * 1e-9 * RATE_HZ) % (rows + moving) < rows)

    check_poses(write_log(two_sensors(), tumbled(), rows=rows, moving_rows=moving, keep=keep), rows, moving)


def test_lost_rows_of_one_sensor_do_not_hide_a_pose(write_log: WriteLog) -> None:
    rng = np.random.default_rng(6)
    keep: Callable[[str, npt.NDArray[np.int64]], npt.NDArray[np.bool_]] = lambda name, time: np.asarray(  # noqa: E731
        rng.random(len(time)) > (0.3 if name == "A0" else 0.0)
    )
    check_poses(write_log(two_sensors(), tumbled(), rows=600, moving_rows=50, keep=keep), 600, 50)


def felt_log(folder: Path, felt: Floats) -> Path:
    path = folder / "felt.h5"
    parts = two_sensors()
    time = np.arange(len(felt), dtype=np.int64) * 10_000_000
    with LogWriter(path, [part.header for part in parts], source="simulated", epoch=EPOCH) as writer:
        for part in parts:
            counts = part.read(felt, np.random.default_rng(1))
            writer.append(part.header.name, Block(time, counts, np.zeros(len(time), np.uint16)))
    return path


def test_a_box_that_turns_slowly_has_no_poses(tmp_path: Path) -> None:
    seconds = np.arange(6000) / RATE_HZ
    angle = 2 * np.pi * 0.05 * seconds
    felt = np.stack([np.sin(angle), np.cos(angle) * np.cos(angle / 3), np.cos(angle) * np.sin(angle / 3)], axis=1)
    with open_log(felt_log(tmp_path, felt)) as log:
        assert find_poses(log) == []


def test_a_box_that_is_shaken_has_no_poses(tmp_path: Path) -> None:
    felt = np.random.default_rng(4).normal(0, 0.5, (6000, 3)) + np.array([0, 0, 1])
    with open_log(felt_log(tmp_path, felt)) as log:
        assert find_poses(log) == []


def test_a_turn_about_the_vertical_is_not_rest(tmp_path: Path) -> None:
    """Accelerometers do not sense it; a gyroscope reads 5 dps for 4 of 20 s, from 8 s on."""
    time = np.arange(2000, dtype=np.int64) * 10_000_000
    part, path = two_sensors()[0], tmp_path / "run.h5"
    turning = np.where((time >= 8 * 10**9) & (time < 12 * 10**9), round(5 / 0.00875), 0)
    counts = np.random.default_rng(2).normal(40, 10, (2000, 3)) + turning[:, None] * np.array([0.0, 0.0, 1.0])
    still = np.zeros(2000, np.uint16)
    with LogWriter(path, [part.header, gyroscope("G")], source="simulated", epoch=EPOCH) as writer:
        up = np.tile([0.0, 0.0, 1.0], (2000, 1))
        writer.append(part.header.name, Block(time, part.read(up, np.random.default_rng(1)), still))
        writer.append("G", Block(time, np.rint(counts).astype(np.int16), still))
    with open_log(path) as log:
        result = [(pose.phase.start_ns * 1e-9, pose.phase.end_ns * 1e-9) for pose in find_poses(log)]
    # Windows of half a second, and another window cut off at each end.
    assert result == [pytest.approx((0.5, 7.5)), pytest.approx((12.5, 19.0))]


def test_a_log_too_short_for_poses_is_refused(tmp_path: Path) -> None:
    with (
        open_log(felt_log(tmp_path, np.tile([0.0, 0.0, 1.0], (150, 1)))) as log,
        pytest.raises(CalibrationError, match=r"1\.5 s of data, too short"),
    ):
        find_poses(log)


def test_an_accelerometer_without_rows_does_not_hide_the_poses(write_log: WriteLog) -> None:
    keep: Callable[[str, npt.NDArray[np.int64]], npt.NDArray[np.bool_]] = lambda name, time: np.full(  # noqa: E731
        len(time), name != "A1"
    )
    path = write_log(two_sensors(), tumbled(), rows=300, moving_rows=50, keep=keep)
    with open_log(path) as log:
        poses = find_poses(log)
        assert len(poses) == 14
        with pytest.raises(CalibrationError, match="sensor A1: no valid readings in phase 'pose 1'"):
            read_pose(log["A1"], poses[0])


def test_a_recorder_that_stalls_does_not_end_a_pose(tmp_path: Path) -> None:
    """51 rows at 17 ms, then nothing for 2.8 s, again and again, in one attitude: one pose, as long as the log."""
    felt = np.tile([0.0, 0.0, 1.0], (51 * 40, 1))
    row = np.arange(len(felt), dtype=np.int64)
    time = row * 17_000_000 + row // 51 * 2_800_000_000
    part, path = two_sensors()[0], tmp_path / "stalls.h5"
    with LogWriter(path, [part.header], source="simulated", epoch=EPOCH) as writer:
        counts = part.read(felt, np.random.default_rng(1))
        writer.append(part.header.name, Block(time, counts, np.zeros(len(time), np.uint16)))
    with open_log(path) as log:
        (pose,) = find_poses(log)
    assert (pose.phase.end_ns - pose.phase.start_ns) * 1e-9 == pytest.approx(40 * 51 * 0.017 + 39 * 2.8, abs=3.0)


@pytest.mark.parametrize(("silent_s", "poses"), [(4.0, 1), (8.0, 2)])
def test_a_longer_gap_ends_a_pose(tmp_path: Path, silent_s: float, poses: int) -> None:
    """Five seconds (`BRIDGED_S`) are too short to turn the box and put it back."""
    row = np.arange(2000, dtype=np.int64)
    time = row * 10_000_000 + np.where(row >= 1000, round(silent_s * 1e9), 0)
    part, path = two_sensors()[0], tmp_path / "silence.h5"
    with LogWriter(path, [part.header], source="simulated", epoch=EPOCH) as writer:
        counts = part.read(np.tile([0.0, 0.0, 1.0], (2000, 1)), np.random.default_rng(1))
        writer.append(part.header.name, Block(time, counts, np.zeros(2000, np.uint16)))
    with open_log(path) as log:
        assert len(find_poses(log)) == poses


@pytest.mark.parametrize(("unit", "moved"), [("dps", 30.0), ("gauss", 0.4)])
def test_gyroscopes_or_magnetometers_alone_detect_rests(tmp_path: Path, unit: str, moved: float) -> None:
    """20 s still, 4 s in which every axis oscillates, 20 s still; read four times a second by the slowest."""
    sensitivity, rate_hz = {"dps": (100.0, 50.0), "gauss": (1000.0, 4.0)}[unit]
    quantity: Quantity = "angular_rate" if unit == "dps" else "magnetic_field"
    header = SensorHeader("S", "unheard_of", quantity, unit, 1000.0, sensitivity)
    seconds = np.arange(round(44 * rate_hz)) / rate_hz
    moving = (seconds >= 20) & (seconds < 24)
    felt = np.where(moving[:, None], moved * np.sin(2 * np.pi * seconds)[:, None], 0.1) * np.ones(3)
    counts = np.rint(felt * sensitivity + np.random.default_rng(5).normal(0, 3, felt.shape)).astype(np.int16)
    path = tmp_path / "rests.h5"
    with LogWriter(path, [header], source="imported", epoch=EPOCH) as writer:
        writer.append("S", Block(np.rint(seconds * 1e9).astype(np.int64), counts, np.zeros(len(seconds), np.uint16)))
    with open_log(path) as log:
        result = [(pose.phase.start_ns * 1e-9, pose.phase.end_ns * 1e-9) for pose in find_rests(log)]
        with pytest.raises(CalibrationError, match="no accelerometer"):
            find_poses(log)
    assert result == [pytest.approx((0, 20), abs=2.6), pytest.approx((24, 44), abs=2.6)]


def test_named_faces_have_an_up_axis_and_the_name_of_a_face(write_log: WriteLog) -> None:
    names = [("z_up", "+Z"), ("static", "+Z"), ("x_down_check", "-X"), ("y_up", ""), ("w_up", "+X"), ("z_over", "+Z")]
    with open_log(write_log(two_sensors(), tumbled()[: len(names)], names=names)) as log:
        faces = named_faces(log)
    assert [(face.phase.name, face.up_box, face.is_check) for face in faces] == [
        ("z_up", (0.0, 0.0, 1.0), False),
        ("x_down_check", (-1.0, 0.0, 0.0), True),
    ]


def flagged(folder: Path, counts: npt.NDArray[np.int16], status: npt.NDArray[np.uint16]) -> Path:
    path = folder / "flagged.h5"
    with LogWriter(path, [accelerometer("A")], source="simulated", epoch=EPOCH) as writer:
        writer.append("A", Block(np.arange(len(counts), dtype=np.int64) * 10_000_000, counts, status))
    return path


def test_a_pose_excludes_saturated_and_suspect_but_not_stale_readings(tmp_path: Path) -> None:
    """One clipped reading in more than a thousand is excluded; with more of them there is no valid mean."""
    counts = np.tile(np.array([[1, 2, 3], [5, 6, 7]], np.int16), (600, 1))
    counts[10], counts[11] = (9999, 0, 0), (0, 9999, 0)
    status = np.zeros(1200, np.uint16)
    status[[10, 11, 12, 13]] = (4, 32, 1, 1)
    pose = Pose(Phase(0, 100_000_000_000, "pose"), None)
    with open_log(flagged(tmp_path, counts, status)) as log:
        reading = read_pose(log["A"], pose)
    assert reading.mean_lsb.tolist() == [3, 4, 5]
    assert reading.rows == 1198
    status[20] = 4
    (tmp_path / "more").mkdir()
    with (
        open_log(flagged(tmp_path / "more", counts, status)) as log,
        pytest.raises(CalibrationError, match="2 of 1200 readings clip in phase 'pose'"),
    ):
        read_pose(log["A"], pose)


@pytest.mark.slow
def test_standard_error_of_a_pose_is_valid_in_correlated_noise(tmp_path: Path) -> None:
    """In a moving average of 8 rows the variance of the mean is 8 times that of independent rows.

    200 poses of 1024 rows; the ratio of squares is chi-square with 200 (times the batches' own 15): error rate 1e-3.
    """
    rng = np.random.default_rng(17)
    white = rng.normal(0, 100, (200 * 1024 + 7, 3))
    smooth = np.lib.stride_tricks.sliding_window_view(white, 8, axis=0).mean(axis=2)
    path = flagged(tmp_path, np.rint(smooth).astype(np.int16), np.zeros(len(smooth), np.uint16))
    ratios = []
    with open_log(path) as log:
        for index in range(200):
            pose = Pose(Phase(index * 10_240_000_000, (index + 1) * 10_240_000_000, "pose"), None)
            reading = read_pose(log["A"], pose)
            ratios.append(reading.mean_lsb / reading.sem_lsb)
    # Student t with 15: variance 15 / 13; batches of 64 rows keep 63/64 of the correlation's effect or more.
    total = (np.array(ratios) ** 2).sum(axis=0) * 13 / 15
    low, high = chi2.ppf((0.0005, 0.9995), 200)
    assert (total > 0.9 * low).all() and (total < 1.15 * high).all(), total


@pytest.mark.parametrize("sensor", ["accelerometer", "gyroscope"])
def test_single_wrong_readings_do_not_end_a_pose(tmp_path: Path, sensor: str) -> None:
    """Single readings that are 40 standard deviations off do not mean that the box was turned."""
    counts = np.rint(np.random.default_rng(1).normal(0, 10, (3000, 3))).astype(np.int16)
    counts[[700, 1500, 1900], 1] += 400
    header = accelerometer("A1") if sensor == "accelerometer" else gyroscope("G1")
    time, path = np.arange(3000, dtype=np.int64) * 10_000_000, tmp_path / "spikes.h5"
    with LogWriter(path, [header], source="simulated", epoch=EPOCH) as writer:
        writer.append(header.name, Block(time, counts, np.zeros(3000, np.uint16)))
    with open_log(path) as log:
        (pose,) = find_rests(log)
    assert (pose.phase.end_ns - pose.phase.start_ns) * 1e-9 == pytest.approx(29.0, abs=1.0)


def test_a_short_shake_ends_a_pose(tmp_path: Path) -> None:
    """Ten readings, 0.1 s, 40 standard deviations off and back: the box was touched."""
    counts = np.rint(np.random.default_rng(1).normal(0, 10, (3000, 3))).astype(np.int16)
    counts[1510:1520, 1] += np.tile([400, -400], 5).astype(np.int16)
    header = accelerometer("A1")
    time, path = np.arange(3000, dtype=np.int64) * 10_000_000, tmp_path / "shake.h5"
    with LogWriter(path, [header], source="simulated", epoch=EPOCH) as writer:
        writer.append(header.name, Block(time, counts, np.zeros(3000, np.uint16)))
    with open_log(path) as log:
        assert len(find_rests(log)) == 2


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["specific_force", "angular_rate", "both"])
def test_the_slow_beginning_of_a_motion_is_not_rest(tmp_path: Path, quantity: str) -> None:
    """From 30 s on the box turns at 0.1 dps/s2 times the squared time: 0.9 dps after 3 s, when the angle is 0.9 degrees
    and gravity along x 16 mg. At 31 s the rate is as large as the noise.
    """
    seconds = np.arange(0, 40, 0.01)
    since = np.clip(seconds - 30, 0, None)
    angle = np.radians(since**3 / 30)
    nothing = np.zeros(len(seconds))
    acc, gyro = accelerometer("A"), gyroscope("G")
    force_g = np.stack([np.sin(angle), nothing, np.cos(angle)], axis=1)
    rate_dps = np.stack([nothing, 0.1 * since**2, nothing], axis=1)
    rng = np.random.default_rng(30)
    felt = {
        "A": (force_g + rng.normal(0, 2e-3, force_g.shape)) * acc.sensitivity,
        "G": (rate_dps + rng.normal(0, 0.1, rate_dps.shape)) * gyro.sensitivity,
    }
    kept = [header for header in (acc, gyro) if quantity in ("both", header.quantity)]
    path = tmp_path / "slow.h5"
    with LogWriter(path, kept, source="imported", epoch=EPOCH) as writer:
        for header in kept:
            counts, flags = np.rint(felt[header.name]).astype(np.int16), np.zeros(len(seconds), np.uint16)
            writer.append(header.name, Block(np.rint(seconds * 1e9).astype(np.int64), counts, flags))
    with open_log(path) as log:
        rest = find_rests(log)[0].phase
    assert 25.0 < rest.end_ns * 1e-9 <= 31.5


def test_drift_terms_are_powers_of_the_middle_times_of_the_poses() -> None:
    """Poses of 0.2 to 1 s about 1, 2, 3, 4 and 5 s: (-2, -1, 0, 1, 2) / sqrt(2) has a mean square of 1."""
    poses = tuple(
        Pose(Phase(round((middle - length / 2) * 1e9), round((middle + length / 2) * 1e9), "static", ""), None)
        for middle, length in zip((1.0, 2.0, 3.0, 4.0, 5.0), (1.0, 0.2, 0.6, 0.2, 0.8), strict=True)
    )
    nothing = np.zeros((0, 5, 3))
    readings = PoseReadings((), poses, nothing, nothing, nothing, nothing)
    expected = np.stack([np.ones(5), np.array([-2.0, -1.0, 0.0, 1.0, 2.0]) / np.sqrt(2)], axis=1)
    np.testing.assert_allclose(readings.powers_of_time(1), expected, atol=1e-12)
