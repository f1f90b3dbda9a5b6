"""Sensors in the text of a diagnosis."""

from __future__ import annotations

from imuarray.gap.findings.text import _by_kind


def test_many_sensors_are_listed_in_short() -> None:
    names = [f"IMU{number}_{half}" for number in range(1, 9) for half in ("acc", "gyro")]
    assert _by_kind(names) == "IMU1_acc to IMU8_acc, IMU1_gyro to IMU8_gyro"
    assert _by_kind(["BMA1", "Gyro1", "BMA2"]) == "BMA1, BMA2, Gyro1"
