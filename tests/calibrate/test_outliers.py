"""Faces that are mislabelled, that moved or that leaned are detected, named and excluded from the means."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imuarray.calibrate import TumbleResult, calibrate_tumble
from imuarray.calibrate.fits import find_outlier, misfit_probability, separated_poses
from imuarray.calibrate.pose_readings import Pose
from imuarray.errors import CalibrationError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Phase
from tests.calibrate.conftest import EPOCH, FACES, Floats, Part, WriteLog, accelerometer, ideal, skewed
from tests.selection import some

AXES = ("+X+Y+Z", "-Y-X-Z", "+Y+X-Z")
ROWS = 400
SIGMA = 10.0
UPS = {name: up for name, up, _ in FACES}


def three(mounted: Sequence[str] = AXES) -> list[Part]:
    """Three accelerometers; where `mounted` differs from AXES the log does not know it."""
    rng = np.random.default_rng(3)
    return [
        Part(accelerometer(f"A{i}", text), skewed(real, 2048, rng), rng.uniform(-99, 99, 3), SIGMA)
        for i, (text, real) in enumerate(zip(AXES, mounted, strict=True))
    ]


def calibrate(write_log: WriteLog, labels: Mapping[str, str], parts: Sequence[Part] = ()) -> TumbleResult:
    """Calibrate six faces and a check, some of them with another label."""
    named = [(labels.get(name, name), UPS[labels.get(name, name)]) for name in UPS]
    with open_log(write_log.faces(parts or three(), labels=named, rows=64)) as log:
        return calibrate_tumble(log)


def turned_faces(folder: Path, turns: Mapping[str, tuple[Floats, Floats]]) -> Path:
    """Seven faces of ROWS rows; `turns` (rotation vectors, degrees) lean the first and the second half of some."""
    path, parts = folder / "run.h5", three()
    time = np.arange(7 * ROWS, dtype=np.int64) * 10_000_000
    felt = np.repeat(np.array([up for _, _, up in FACES], float), ROWS, axis=0)
    for index, (name, _, _) in enumerate(FACES):
        for half, turn in enumerate(turns.get(name, ())):
            rows = slice(index * ROWS + half * ROWS // 2, index * ROWS + (half + 1) * ROWS // 2)
            felt[rows] = Rotation.from_rotvec(turn, degrees=True).apply(felt[rows])
    with LogWriter(path, [part.header for part in parts], source="simulated", epoch=EPOCH) as log:
        for part in parts:
            counts = part.read(felt, np.random.default_rng(7))
            log.append(part.header.name, Block(time, counts, np.zeros(len(time), np.uint16)))
        for index, (name, up, _) in enumerate(FACES):
            log.phase(Phase(int(time[index * ROWS]), int(time[(index + 1) * ROWS - 1]) + 1, name, up))
    return path


def both(turn: Sequence[float]) -> tuple[Floats, Floats]:
    return np.array(turn, float), np.array(turn, float)


def test_a_mislabelled_face_is_named_with_its_true_up_axis(write_log: WriteLog) -> None:
    with pytest.raises(
        CalibrationError, match=r"phase 'y_up' is 1\.4. g off the other faces: -X points up in it; misl"
    ):
        calibrate(write_log, {"x_down": "y_up"})


def test_two_swapped_labels_are_both_named(write_log: WriteLog) -> None:
    expected = r"phase 'y_down' .*: \+X points up in it; phase 'x_up' .*: -Y points up in it"
    with pytest.raises(CalibrationError, match=expected):
        calibrate(write_log, {"x_up": "y_down", "y_down": "x_up"})


def test_exchanged_opposite_labels_are_named(write_log: WriteLog) -> None:
    with pytest.raises(CalibrationError, match=r"labels of 'x_down' and 'x_up' are exchanged, and no chip is mirrored"):
        calibrate(write_log, {"x_up": "x_down", "x_down": "x_up"})


def test_a_differently_mounted_accelerometer_is_named_not_the_faces(write_log: WriteLog) -> None:
    with pytest.raises(CalibrationError, match=r"sensor A1: axis x .*'-Y-X-Z'; the faces indicate '-X\+Y-Z'") as caught:
        calibrate(write_log, {}, three((AXES[0], "-X+Y-Z", AXES[2])))
    assert "labels" not in str(caught.value)


def test_undisturbed_faces_are_all_used(write_log: WriteLog) -> None:
    result = calibrate(write_log, {})
    assert result.left_out == ()
    assert result.poses == 7


@pytest.mark.parametrize("face", some(["x_up", "z_down", "z_up_check"], 1))
def test_a_face_that_moved_is_excluded_and_named(tmp_path: Path, face: str) -> None:
    """By 1 degree in the middle of the reading: 17.5 mg between the halves."""
    axis = [0.0, 0.0, 1.0] if face == "x_up" else [1.0, 0.0, 0.0]
    with open_log(turned_faces(tmp_path, {face: (np.zeros(3), np.array(axis))})) as log:
        result = calibrate_tumble(log)
    (left,) = result.left_out
    assert left.phase == face
    assert left.reason.startswith("the box moved: gravity changed by ")
    assert float(left.reason.split()[6]) == pytest.approx(17.5, abs=1.5)
    check_bias(result)


def test_a_face_that_leaned_is_excluded_and_named(tmp_path: Path) -> None:
    """By 4 degrees: 70 mg, twice as much as the skew of the accelerometers' mean explains."""
    with open_log(turned_faces(tmp_path, {"y_up": both((0.0, 0.0, 4.0))})) as log:
        result = calibrate_tumble(log)
    (left,) = result.left_out
    assert left.phase == "y_up"
    assert left.reason == "70 mg off the straight line through the other faces"
    check_bias(result)


def check_bias(result: TumbleResult) -> None:
    """Of at least five faces, six standard errors of the worse half difference of two."""
    for part in three():
        outcome = result.calibration.sensors[part.header.name]
        assert outcome.bias_lsb == pytest.approx(part.bias, abs=6 * SIGMA / np.sqrt(2 * ROWS))


def test_an_ambiguous_leaning_face_is_refused(tmp_path: Path) -> None:
    """0.9 degrees, 16 mg: as much as the accelerometers' own angles, so that it may be this face or the opposite."""
    with (
        open_log(turned_faces(tmp_path, {"y_up": both((0.0, 0.0, 0.9))})) as log,
        pytest.raises(
            CalibrationError, match=r"phase 'y_down' or phase 'y_up' is 1[56] mg off .*; record these faces again"
        ),
    ):
        calibrate_tumble(log)


def test_too_few_valid_faces_are_refused_and_excluded_faces_named(tmp_path: Path) -> None:
    moved = (np.zeros(3), np.array([0.0, 1.0, 0.0]))
    with (
        open_log(turned_faces(tmp_path, {"x_up": moved, "x_down": moved})) as log,
        pytest.raises(CalibrationError, match=r"too few; .*; phase 'x_up': the box moved: .*; phase 'x_down': the box"),
    ):
        calibrate_tumble(log)


def test_random_leaning_of_the_table_widens_the_standard_errors(tmp_path: Path) -> None:
    """Random leaning of 0.2 degrees (3.5 mg, 7 counts) of every face: chi-squared is large, and standard errors of the
    bias include it, not only the noise (0.2 counts).
    """
    rng = np.random.default_rng(12)
    turns = {name: both(rng.normal(0, 0.2, 3).tolist()) for name in UPS}
    with open_log(turned_faces(tmp_path, turns)) as log:
        result = calibrate_tumble(log)
    assert result.left_out == ()
    for name, fit in result.fits.items():
        assert fit.reduced_chi_squared > 20
        sem = result.calibration.sensors[name].bias_sem_lsb
        assert sem is not None
        assert 0.5 < sem.mean() < 7.0


def test_the_p_value_of_a_misfit_is_that_of_the_f_distribution() -> None:
    """F(2, 10) above 4.103 in 5 % of cases (tables); a fit without degrees of freedom has no p-value."""
    assert misfit_probability(10.0 + 2 * 4.103, 10.0, 2, 10) == pytest.approx(0.05, abs=1e-4)
    assert misfit_probability(10.0, 1.0, 2, 0) == 1.0


def test_an_outlier_is_both_unlikely_and_the_largest() -> None:
    sizes = np.array([0.1, 0.001, 0.1])
    assert find_outlier([0.5, 1e-9, 0.5], sizes, 0.01) is None
    assert find_outlier([0.5, 1e-9, 1e-6], sizes, 0.01) == 2
    assert find_outlier([0.5, 0.5, 5e-4], sizes, 0.01) is None  # 5e-4 for each of three is above 1e-3 in all


def test_a_long_break_separates_poses() -> None:
    def pose(start_s: int) -> Pose:
        return Pose(Phase(start_s * 10**9, (start_s + 8) * 10**9, "pose"), None)

    regular = [pose(10 * k) for k in range(6)]
    assert separated_poses(regular) == {}
    assert list(separated_poses([*regular, pose(90)])) == [6]
    assert separated_poses([*regular, *(pose(200 + 10 * k) for k in range(6))]) == {}  # neither is the larger
    slow = [pose(50 * k) for k in range(6)]
    assert separated_poses([*slow, pose(360)]) == {}


@pytest.mark.slow
def test_a_single_sensor_with_any_axes_passes_the_check_of_labels(write_log: WriteLog) -> None:
    """A single sensor whose axes are those of the log passes the check of labels, whichever axes these are."""
    for axes in AXES:
        part = Part(accelerometer("A", axes), ideal(axes, 2048), np.array([400.0, -400.0, 300.0]), 5.0)
        assert calibrate(write_log, {}, [part]).left_out == ()
        (write_log.folder / "run.h5").unlink()
