"""What `imuarray calibrate noise` says."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from imuarray.units import READABLE

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration, SensorCalibration


def report_of(calibration: Calibration) -> dict[str, Any]:
    """Every sensor's noise, JSON-ready: counts, and mg or dps."""
    return {"sensors": [_row(sensor) for sensor in calibration.sensors.values()]}


def print_report(report: dict[str, Any]) -> None:
    """The same as a table."""
    click.echo(f"{'sensor':12} {'x':>9} {'y':>9} {'z':>9}  counts rms {'x':>9} {'y':>9} {'z':>9}")
    for row in report["sensors"]:
        counts, units = _three(row["noise_lsb"]), _three(row["noise"])
        click.echo(f"{row['name']:12} {counts}             {units}  {row['noise_unit']} rms")


def _row(sensor: SensorCalibration) -> dict[str, Any]:
    factor, unit = READABLE[sensor.unit]
    counts = [] if sensor.noise_lsb is None else sensor.noise_lsb.tolist()
    return {
        "name": sensor.name,
        "noise_lsb": counts,
        "noise": [factor * value / scale for value, scale in zip(counts, sensor.scale_lsb_per_unit, strict=True)],
        "noise_unit": unit,
    }


def _three(values: Sequence[float]) -> str:
    return " ".join(f"{value:9.3f}" for value in values)
