"""Six faces on a table: Tables 3 and 4 of the paper from its Table 10, the stated uncertainty, and refusals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from imuarray.calibrate import TumbleResult, calibrate_tumble
from imuarray.calibrate.faces import fit_faces
from imuarray.calibrate.pose_readings import named_faces
from imuarray.errors import CalibrationError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Phase, SensorHeader
from tests.calibrate.conftest import FACES, Part, WriteLog, accelerometer, gyroscope, ideal, skewed
from tests.selection import some

# Table 10: mean counts with z_up, x_up, y_up, x_down, y_down, z_down, z_up (check).
TABLE_10 = {
    "ADXL1": (
        (12.33293, -253.497, 2.469027, 269.075, 13.12513, 2.899611, 12.33366),
        (22.35989, 13.01353, -256.075, 2.25853, 271.2409, -5.9701, 22.18462),
        (247.2157, -3.95661, 4.159566, -11.9417, -22.4309, -262.606, 247.0093),
    ),
    "BMA1": (
        (-100.816, -81.7408, -604.112, -102.087, 418.4423, -84.4824, -100.769),
        (-134.907, 391.6477, -115.322, -648.648, -139.155, -120.145, -135.05),
        (537.0402, 13.09122, 7.244381, 10.84351, 16.37739, -515.345, 537.3207),
    ),
    "BMA3": (
        (515.6351, 144.0243, -5351.68, -24.0278, 5461.916, -415.383, 509.5691),
        (-9.89211, -5422.59, -77.3823, 5405.179, 57.58821, -21.7895, -11.0259),
        (-5522.18, 20.71929, -451.205, -138.035, 329.0204, 5444.336, -5521.33),
    ),
    "Gyro1": (
        (8.320732, 8.428642, 8.161185, 8.422897, 8.705721, 8.394012, 8.287603),
        (-7.01099, -7.1224, -7.14924, -6.9622, -7.00326, -6.98778, -6.94282),
        (12.79765, 12.80977, 12.88774, 12.90363, 12.8971, 13.00009, 12.91716),
    ),
    "Gyro3": (
        (-10.8525, -10.8913, -12.5124, -10.3831, -9.19768, -10.9854, -10.9321),
        (80.72398, 81.41718, 80.64504, 80.30853, 79.94402, 80.03002, 78.30344),
        (-5.92837, -6.55747, -7.26471, -5.88309, -5.85468, -5.72226, -5.59863),
    ),
}
HEADERS = {
    "ADXL1": SensorHeader("ADXL1", "adxl345", "specific_force", "g", 16.0, 256.0, axes="-X-Y+Z"),
    "BMA1": SensorHeader("BMA1", "bma180", "specific_force", "g", 16.0, 512.0, axes="-Y+X+Z"),
    "BMA3": SensorHeader("BMA3", "bma180", "specific_force", "g", 1.5, 5460.0, axes="-Y-X-Z"),
    "Gyro1": SensorHeader("Gyro1", "l3g4200d", "angular_rate", "dps", 2000.0, 1 / 0.07),
    "Gyro3": SensorHeader("Gyro3", "l3g4200d", "angular_rate", "dps", 250.0, 1 / 0.00875, axes="-X-Y+Z"),
}
# Table 3: bias (LSB), |scale factor| (LSB/g), drift (LSB), and how far two printed readings leave the drift open.
TABLE_3 = {
    "ADXL1": ((7.734, 7.805, -8.260), (261.38, 264.09, 255.29), (-0.001, 0.175, 0.206), 1.5e-3),
    "BMA1": ((-92.466, -127.755, 11.542), (511.44, 520.34, 526.21), (-0.048, 0.143, -0.280), 1.5e-3),
    "BMA3": ((55.081, -11.481, -52.891), (5427.45, 5414.31, 5497.69), (6.066, 1.134, -0.852), 1.1e-2),
}
# Table 4: bias (LSB); difference of the bias between up and down, columns box X, Y, Z; drift (LSB).
TABLE_4 = {
    "Gyro1": (
        (8.389, -7.026, 12.888),
        ((0.006, -0.545, -0.073), (-0.160, -0.146, -0.023), (-0.094, -0.009, -0.202)),
        (0.0331, -0.0682, -0.1195),
    ),
    "Gyro3": (
        (-10.822, 80.196, -6.116),
        ((-0.508, -3.315, 0.133), (1.109, 0.701, 0.694), (-0.674, -1.410, -0.206)),
        (0.0796, 2.4205, -0.3297),
    ),
}
ROWS = 4000
"""Whole counts whose mean is a printed reading to 1 / (2 ROWS)."""

UPS = ("+Z", "+X", "+Y", "-X", "-Y", "-Z", "+Z")
NAMES = ("z_up", "x_up", "y_up", "x_down", "y_down", "z_down", "z_up_check")


def whole_counts(mean: float) -> np.ndarray:
    """ROWS integers with that mean, in random order."""
    low = int(np.floor(mean))
    above = round((mean - low) * ROWS)
    return np.random.default_rng(5).permutation(np.r_[np.full(above, low + 1), np.full(ROWS - above, low)])


@pytest.fixture(scope="module")
def table_10(tmp_path_factory: pytest.TempPathFactory) -> TumbleResult:
    path = tmp_path_factory.mktemp("table10") / "run.h5"
    time = np.arange(7 * ROWS, dtype=np.int64) * 20_000_000
    with LogWriter(path, list(HEADERS.values()), source="simulated", epoch="2013-09-16T00:00:00Z") as writer:
        for name, axes in TABLE_10.items():
            counts = np.stack([np.concatenate([whole_counts(mean) for mean in axis]) for axis in axes], axis=1)
            writer.append(name, Block(time, counts.astype(np.int16), np.zeros(len(time), np.uint16)))
        for index, (name, up) in enumerate(zip(NAMES, UPS, strict=True)):
            writer.phase(Phase(int(time[index * ROWS]), int(time[(index + 1) * ROWS - 1]) + 1, name, up))
    with open_log(path) as log:
        return calibrate_tumble(log)


@pytest.mark.parametrize("name", some(TABLE_3, 1))
def test_table_10_gives_table_3(table_10: TumbleResult, name: str) -> None:
    bias, scale, drift, open_lsb = TABLE_3[name]
    result = table_10.calibration.sensors[name]
    assert result.bias_lsb == pytest.approx(bias, abs=7e-4)
    assert result.scale_lsb_per_unit == pytest.approx(scale, abs=6e-3)
    assert table_10.drift_lsb[name] == pytest.approx(drift, abs=open_lsb)
    assert table_10.method == "faces"
    assert table_10.poses == 7


@pytest.mark.parametrize("name", TABLE_4)
def test_table_10_gives_table_4(table_10: TumbleResult, name: str) -> None:
    bias, difference, drift = TABLE_4[name]
    result = table_10.calibration.sensors[name]
    assert result.bias_lsb == pytest.approx(bias, abs=7e-4)
    assert result.g_sensitivity_lsb_per_g is not None
    assert 2 * result.g_sensitivity_lsb_per_g == pytest.approx(np.array(difference), abs=8e-4)
    assert result.g_sensitivity_sem_lsb_per_g is not None
    assert table_10.drift_lsb[name] == pytest.approx(drift, abs=3e-4)


def test_response_is_the_half_difference_of_opposite_faces(table_10: TumbleResult) -> None:
    readings = np.array(TABLE_10["BMA3"])
    half = (readings[:, [1, 2, 0]] - readings[:, [3, 4, 5]]) / 2
    assert table_10.calibration.sensors["BMA3"].response_lsb_per_unit == pytest.approx(half, abs=3e-4)


def test_azimuth_and_elevation_of_a_tilted_axis_by_hand(table_10: TumbleResult) -> None:
    # BMA1 x points along box -Y. Half differences of Table 10: 10.1731, -511.27715, -8.1668; by hand:
    # azimuth = atan2(-511.27715, 10.1731) = -88.8601 degrees, elevation = atan2(-8.1668, 511.37835) = -0.9149 degrees.
    angles = table_10.calibration.sensors["BMA1"].azimuth_elevation_deg()
    assert angles[0] == pytest.approx((-88.8601, -0.9149), abs=2e-4)


@pytest.mark.slow
def test_errors_agree_with_the_stated_uncertainty(write_log: WriteLog) -> None:
    """100 sensors, errors over standard errors: chi-square, two-sided error rate 1e-3 for each of six sums."""
    rng = np.random.default_rng(11)
    parts = [
        Part(accelerometer(f"A{i:03}", "-Y-X-Z"), skewed("-Y-X-Z", 2048, rng), rng.uniform(-200, 200, 3), 20.0)
        for i in range(100)
    ]
    with open_log(write_log.faces(parts, rows=160, seed=12)) as log:
        fitted = calibrate_tumble(log).calibration.sensors
    bias, response = [], []
    for part in parts:
        result = fitted[part.header.name]
        assert result.bias_sem_lsb is not None and result.response_sem_lsb_per_unit is not None
        bias.append((result.bias_lsb - part.bias) / result.bias_sem_lsb)
        error = result.response_lsb_per_unit - part.response
        response.append(error[:, 0] / result.response_sem_lsb_per_unit)
    low, high = chi2.ppf((0.0005, 0.9995), 100)
    # sem is estimated from 16 batches per face: its scatter widens the ratios by about 1 + 1 / (6 * 15).
    for sums in ((np.array(bias) ** 2).sum(axis=0), (np.array(response) ** 2).sum(axis=0)):
        assert (sums > low).all() and (sums < high * (1 + 1 / 30)).all(), sums


@pytest.mark.slow
def test_parameters_of_200_sensors_are_within_their_covariance(write_log: WriteLog) -> None:
    """Normalised error squared of all twelve parameters, mean over 200 draws: chi-square with 2400 degrees of freedom
    over 200, 2 / 88 larger since the noise is estimated from 6 faces of 15 batches; two-sided error rate 1e-3.
    """
    rng = np.random.default_rng(21)
    parts = [
        Part(accelerometer(f"A{i:03}"), skewed("+X+Y+Z", 2048, rng), rng.uniform(-200, 200, 3), 20.0)
        for i in range(200)
    ]
    squares = []
    with open_log(write_log.faces(parts, rows=64, seed=22)) as log:
        faces = [pose for pose in named_faces(log) if not pose.is_check]
        for part in parts:
            _, fit, _ = fit_faces(log[part.header.name], faces)
            error = (fit.coefficients - np.column_stack([part.response, part.bias])).ravel()
            squares.append(error @ np.linalg.solve(fit.covariance, error))
    low, high = chi2.ppf((0.0005, 0.9995), 12 * 200) / 200
    assert low < np.mean(squares) < high * (1 + 2 / 88)


@pytest.mark.slow
def test_gyroscope_bias_uses_all_seven_readings(write_log: WriteLog) -> None:
    """sigma / sqrt(7 * 160), rms over 20 gyroscopes; 60 sums of 7 * 15 squares determine it to 0.9 %."""
    parts = [Part(gyroscope(f"G{i:03}"), np.zeros((3, 3)), np.array([40.0, -7.0, 0.3]), 20.0) for i in range(20)]
    with open_log(write_log.faces(parts, rows=160, seed=14)) as log:
        fitted = [fit_faces(log[part.header.name], named_faces(log))[0] for part in parts]
    assert all(result.bias_sem_lsb is not None for result in fitted)
    stated = np.sqrt(np.mean([np.square(result.bias_sem_lsb) for result in fitted if result.bias_sem_lsb is not None]))
    assert stated == pytest.approx(20 / np.sqrt(7 * 160), rel=0.04)
    assert np.mean([result.bias_lsb for result in fitted], axis=0) == pytest.approx(
        [40.0, -7.0, 0.3], abs=5 * stated / 4
    )


def test_a_slow_drift_is_the_difference_of_two_readings_of_a_face(write_log: WriteLog) -> None:
    part = Part(accelerometer("A"), ideal("+X+Y+Z", 2048), np.zeros(3), 3.0)
    with open_log(write_log.faces([part], rows=500, drift_lsb_per_s=0.8)) as log:
        # The check begins 6 faces of 5 s after the first reading: 30 s of 0.8 counts/s.
        assert calibrate_tumble(log).drift_lsb["A"] == pytest.approx([-24.0] * 3, abs=4 * 3 * np.sqrt(2 / 500))


def relabel(change: dict[str, str]) -> list[tuple[str, str]]:
    ups = dict(zip(NAMES, UPS, strict=True))
    return [(change.get(name, name), ups[change.get(name, name)]) for name in NAMES]


def sloppy(write_log: WriteLog, **options: object) -> Path:
    response = skewed("+X+Y+Z", 2048, np.random.default_rng(3))
    part = Part(accelerometer("A"), response, np.array([150.0, -130.0, 80.0]), 10.0)
    return write_log.faces([part], rows=64, **options)


@pytest.mark.parametrize(
    ("face", "called"), some([pair for pair in permutations(NAMES[:-1], 2) if pair[0] != "z_up"], 5), ids="-as-".join
)
def test_a_face_under_a_wrong_name_is_refused_and_named(write_log: WriteLog, face: str, called: str) -> None:
    path = sloppy(write_log, labels=relabel({face: called}))
    with open_log(path) as log, refused(f"phase '{called}' is .* off the other faces"):
        calibrate_tumble(log)


def test_two_faces_swapped_are_refused(write_log: WriteLog) -> None:
    path = sloppy(write_log, labels=relabel({"x_up": "y_down", "y_down": "x_up"}))
    with open_log(path) as log, refused("off the other faces"):
        calibrate_tumble(log)


def test_the_refusal_names_one_of_two_swapped_faces(write_log: WriteLog) -> None:
    path = sloppy(write_log, labels=relabel({"x_up": "y_down", "y_down": "x_up"}))
    with open_log(path) as log, refused("phase '(x_up|y_down)'"):
        calibrate_tumble(log)


def test_swapped_opposite_faces_indicate_a_mirrored_axis(write_log: WriteLog) -> None:
    path = sloppy(write_log, labels=relabel({"x_up": "x_down", "x_down": "x_up"}))
    with open_log(path) as log, refused(r"axis x .*'\+X\+Y\+Z'; the faces indicate '-X\+Y\+Z'"):
        calibrate_tumble(log)


def test_wrong_axes_are_refused_with_those_that_the_faces_indicate(write_log: WriteLog) -> None:
    part = Part(accelerometer("A", "+X+Y+Z"), ideal("-Y+X+Z", 2048), np.zeros(3), 10.0)
    with open_log(write_log.faces([part], rows=64)) as log, refused(r"'\+X\+Y\+Z'; the faces indicate '-Y\+X\+Z'"):
        calibrate_tumble(log)


@pytest.mark.parametrize("count", [1, 3])
def test_too_few_faces_are_refused(write_log: WriteLog, count: int) -> None:
    part = Part(accelerometer("A"), ideal("+X+Y+Z", 2048), np.zeros(3), 10.0)
    ups = np.array([up for _, _, up in FACES], float)[:count]
    path = write_log([part], ups, names=list(zip(NAMES, UPS, strict=True))[:count])
    with open_log(path) as log, refused("too few; z_up, x_up"):
        calibrate_tumble(log)


def test_four_faces_of_one_plane_are_too_few(write_log: WriteLog) -> None:
    part = Part(accelerometer("A"), ideal("+X+Y+Z", 2048), np.zeros(3), 10.0)
    ups = np.array([up for _, _, up in FACES], float)[1:5]
    path = write_log([part], ups, names=list(zip(NAMES, UPS, strict=True))[1:5])
    with open_log(path) as log, refused("too few"):
        calibrate_tumble(log)


def clipped(write_log: WriteLog, bias: float) -> Path:
    """Range +-1 g, so that z clips where it carries gravity: always, or for a part of the time, by its bias."""
    header = SensorHeader("A", "bma180", "specific_force", "g", 1.0, 8192.0)
    part = Part(header, np.diag([7500.0, 7500.0, 8192.0]), np.array([0.0, 0.0, bias]), 40.0, 8191)
    status: Callable[[str, np.ndarray], np.ndarray] = lambda name, counts: np.where(  # noqa: E731
        (np.abs(counts.astype(int)) >= 8191).any(axis=1), 4, 0
    ).astype(np.uint16)
    return write_log.faces([part], rows=1000, status=status)


def test_a_face_with_only_clipped_readings_is_refused_and_named(write_log: WriteLog) -> None:
    with open_log(clipped(write_log, 800.0)) as log, refused("no valid readings in phase 'z_up'"):
        fit_faces(log["A"], named_faces(log))


def test_a_partly_clipped_face_is_refused_and_named(write_log: WriteLog) -> None:
    """The mean is 0.46 standard deviations below the limit: a normal distribution clips 0.32 of its readings."""
    with open_log(clipped(write_log, -20.0)) as log, refused(r"3\d\d of 1000 readings clip in phase 'z_up': no valid"):
        fit_faces(log["A"], named_faces(log))


def test_a_phase_with_an_unknown_up_axis_is_refused(write_log: WriteLog) -> None:
    with open_log(sloppy(write_log, labels=[("z_up", "+Q")])) as log, pytest.raises(CalibrationError):
        calibrate_tumble(log)


@contextmanager
def refused(pattern: str) -> Iterator[None]:
    """A CalibrationError of one line that names the sensor and matches."""
    with pytest.raises(CalibrationError, match=pattern) as caught:
        yield
    assert "\n" not in str(caught.value)
    assert "sensor A" in str(caught.value)


def test_phases_with_a_noted_up_axis_are_faces(write_log: WriteLog) -> None:
    """A log whose phases are all called `static` and state which axis was up, as `imuarray log --up` notes it."""
    named = calibrate_tumble(open_log(sloppy(write_log)))
    noted = calibrate_tumble(open_log(sloppy(write_log, name="up.h5", labels=[("static", up) for _, up, _ in FACES])))
    assert noted.method == named.method == "faces"
    assert "static (-X)" in noted.pose_names
    for name, sensor in noted.calibration.sensors.items():
        other = named.calibration.sensors[name]
        # The reading of +Z that is named as a check in the other log is a seventh face here.
        assert sensor.response_lsb_per_unit == pytest.approx(other.response_lsb_per_unit, abs=6.0)
        assert sensor.bias_lsb == pytest.approx(other.bias_lsb, abs=6.0)


def test_five_faces_give_a_warning(write_log: WriteLog) -> None:
    """All faces except z_down; six faces give no warning."""
    rng = np.random.default_rng(3)
    parts = [Part(accelerometer("A"), skewed("+X+Y+Z", 2048, rng), np.array([30.0, -20, 10]), 3.0)]
    ups = np.array([up for _, _, up in FACES], float)
    names = [(label, up) for label, up, _ in FACES]
    five = calibrate_tumble(open_log(write_log(parts, ups[:5], names=names[:5], name="five.h5")))
    (warning,) = five.warnings
    assert warning.startswith("no face with -Z up: the opposite face is not checked")
    assert calibrate_tumble(open_log(write_log(parts, ups, names=names, name="six.h5"))).warnings == ()


def test_poses_that_disagree_give_a_warning(write_log: WriteLog) -> None:
    """A table that leans by three degrees in a different direction for each face: 50 mg."""
    rng = np.random.default_rng(4)
    parts = [Part(accelerometer("A"), ideal("+X+Y+Z", 2048), np.zeros(3), 3.0)]
    ups = np.array([up for _, _, up in FACES], float)[:6] + rng.normal(0, 0.05, (6, 3))
    ups /= np.linalg.norm(ups, axis=1, keepdims=True)
    result = calibrate_tumble(open_log(write_log(parts, ups, names=[(label, up) for label, up, _ in FACES[:6]])))
    assert any("bias known to +-" in warning and "mg only" in warning for warning in result.warnings)


@pytest.mark.slow
def test_the_file_of_a_mislabelled_face_is_named(write_log: WriteLog) -> None:
    """One log per face; in the log x_up the box was on its y face."""
    rng = np.random.default_rng(5)
    parts = [Part(accelerometer("A"), skewed("+X+Y+Z", 2048, rng), np.zeros(3), 3.0)]
    logs = []
    for label, up, direction in FACES[:6]:
        felt = (0, 1, 0) if label == "x_up" else direction
        logs.append(open_log(write_log(parts, np.array([felt], float), names=[(label, up)], name=f"log_{label}.h5")))
    with pytest.raises(CalibrationError, match=r"log_x_up\.h5, sensor A: phase 'x_up' is 1\.\d+ g off the other faces"):
        calibrate_tumble(*logs)
