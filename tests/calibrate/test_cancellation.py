"""The part of their biases that opposing axes cancel, computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.calibrate import Calibration, SensorCalibration, cancellation
from imuarray.commands.calibrate_tumble import _print_cancellation
from imuarray.log import open_log
from tests.calibrate.conftest import Part, WriteLog, accelerometer, gyroscope, ideal

# Name, chip, axes, bias in mg along the sensor's own axes.
SENSORS = (
    ("A1", "mpu", "+X+Y+Z", (-20.0, -10.0, -50.0)),
    ("A2", "mpu", "-Y-X-Z", (-24.0, -12.0, -40.0)),
    ("A3", "mpu", "+X+Y+Z", (-28.0, -14.0, -44.0)),
    ("B1", "bma180", "-X-Y+Z", (5.0, 6.0, 7.0)),
)


def test_mean_bias_of_parallel_and_opposed_axes_by_hand(write_log: WriteLog) -> None:
    parts = [Part(accelerometer(name, axes, chip), ideal(axes, 2048), np.zeros(3)) for name, chip, axes, _ in SENSORS]
    known = {
        name: SensorCalibration(name, "specific_force", "g", 2.048 * np.array(bias), ideal(axes, 2048))
        for name, _, axes, bias in SENSORS
    }
    with open_log(write_log(parts, np.eye(3))) as log:
        rows = {(row.chip, row.box_axis): row for row in cancellation(list(log.sensors.values()), Calibration(known))}
    assert len(rows) == 6
    # Box X: x of A1 and A3 along it (-20, -28), y of A2 against it (-12 there, +12 in the box frame).
    x = rows["mpu", "X"]
    assert (x.along, x.against, x.opposed) == pytest.approx((-0.024, 0.012, -0.006))
    assert x.single_rms == pytest.approx(1e-3 * np.sqrt((20**2 + 28**2 + 12**2) / 3))
    y = rows["mpu", "Y"]
    assert (y.along, y.against, y.opposed) == pytest.approx((-0.012, 0.024, 0.006))
    z = rows["mpu", "Z"]
    assert (z.along, z.against, z.opposed) == pytest.approx((-0.047, 0.040, -0.0035))
    lone = rows["bma180", "X"]
    assert (lone.along, lone.opposed) == (None, None)
    assert lone.against == pytest.approx(-0.005)
    assert rows["bma180", "Z"].along == pytest.approx(0.007)
    assert {row.unit for row in rows.values()} == {"g"}


def test_quantities_of_one_chip_are_separate_groups(write_log: WriteLog) -> None:
    parts = [
        Part(accelerometer("IMU1_acc", chip="l3g4200d"), ideal("+X+Y+Z", 2048), np.zeros(3)),
        Part(gyroscope("IMU1_gyro"), ideal("+X+Y+Z", 100), np.zeros(3)),
    ]
    with open_log(write_log(parts, np.eye(3))) as log:
        rows = cancellation(list(log.sensors.values()), Calibration())
    assert sorted((row.quantity, row.unit, row.box_axis) for row in rows) == [
        ("angular_rate", "dps", "X"),
        ("angular_rate", "dps", "Y"),
        ("angular_rate", "dps", "Z"),
        ("specific_force", "g", "X"),
        ("specific_force", "g", "Y"),
        ("specific_force", "g", "Z"),
    ]


def test_a_single_axis_of_its_design_is_not_printed(capsys: pytest.CaptureFixture[str]) -> None:
    """A single chip, 30 mg along X, has no opponent. Two parallel chips of 30 and 50 mg have a mean of 40."""
    single = {"chip": "any", "quantity": "specific_force", "unit": "g", "box_axis": "X"}
    alone = single | {"along": 0.03, "against": None, "opposed": None, "single_rms": 0.03}
    parallel = single | {"along": 0.04, "against": None, "opposed": None, "single_rms": (0.0017) ** 0.5}
    _print_cancellation([alone, alone | {"along": None, "against": -0.03}])
    assert capsys.readouterr().out == ""
    _print_cancellation([alone, parallel])
    (_, line) = capsys.readouterr().out.splitlines()
    assert "along     40.00" in line and "41.23 mg" in line
