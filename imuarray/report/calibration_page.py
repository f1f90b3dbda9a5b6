"""Report of a calibration: biases, scale factors and temperature slopes with their standard errors, and the residuals
of the poses of a log that it calibrates.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from imuarray.calibrate import Calibration
from imuarray.calibrate.plots import readable_axes, residual_figure
from imuarray.calibrate.pose_readings import find_poses, named_faces, read_pose
from imuarray.errors import CalibrationError
from imuarray.log import Log
from imuarray.printable import listed
from imuarray.report.page import Figure, Section, Table
from imuarray.units import READABLE, STANDARD_GRAVITY

_FEWEST = 4
"""Least number of poses for which residuals are shown."""

_WIDEST = 12
"""Largest number of poses for which the table of residuals has a column each; more do not fit on a desktop page."""

_BASIC = {"bias", "response", "noise"}
"""Groups of a calibration's figures that the first table shows."""

_GROUPS = {"g_sensitivity": "g-sensitivity", "thermal": "temperature slopes", "turn_on": "changes from run to run"}
"""Names of the groups whose key is not their name."""


def calibration_summary(path: Path, calibration: Calibration) -> Iterator[str]:
    """Yield one line: what was measured, of how many sensors, from which logs."""
    sources = listed(list(dict.fromkeys(Path(source).name for source in calibration.sources))) or "unnamed logs"
    measured = sorted({group for sensor in calibration.sensors.values() for group in sensor.measured()})
    names = ", ".join(_GROUPS.get(group, group) for group in measured) or "nothing"
    yield f"{path.name}: {names} of {len(calibration.sensors)} sensors, from {sources}."


def calibration_sections(path: Path, calibration: Calibration) -> Iterator[Section]:
    """Yield the section with the figures of a calibration and their standard errors."""
    axes = list(_axes(calibration))
    words = "Measured figures have a standard error; figures without one come from the data sheet. "
    words += "A bias is the reading at zero input; the direction is the true direction of the axis in the box."
    heading = ["axis", "unit", "bias", "± s.e.", "counts per unit", "± s.e.", "azimuth °", "elevation °", "noise"]
    caption = "Biases, responses and the scatter of single readings, along each sensor's axes; –: not measured."
    parts = [Table(heading, axes, caption, (1,))] if axes else []
    if slopes := list(_slopes(calibration)):
        heading = ["axis", "unit", "slope per °C", "± s.e.", "lag s", "thermometer", "slope of"]
        parts.append(
            Table(heading, slopes, "Change per degree. “bias or scale”: one attitude cannot separate them.", (1, 5, 6))
        )
    if states := list(_turn_on(calibration)):
        heading = ["axis", "unit", "run to run", "± s.e.", "p by chance", "runs", "states"]
        parts.append(Table(heading, states, "How much a bias changes when the array is switched off and on.", (1,)))
    yield Section(f"{path.name}: calibration", words, parts)


def _axes(calibration: Calibration) -> Iterator[list[str]]:
    for sensor, axis, name, unit, per_count in readable_axes(calibration):
        if not _BASIC & {*sensor.measured()}:
            continue
        bias = READABLE[sensor.unit][0] * sensor.bias_in_units()
        sem = None if sensor.bias_sem_lsb is None else per_count * sensor.bias_sem_lsb[axis]
        response = None if sensor.response_sem_lsb_per_unit is None else sensor.response_sem_lsb_per_unit[axis]
        noise = None if sensor.noise_lsb is None else per_count * sensor.noise_lsb[axis]
        bias_text = "–" if sem is None and not bias.any() else f"{bias[axis]:.3f}"
        scale, angles = f"{sensor.scale_lsb_per_unit[axis]:.4g}", sensor.azimuth_elevation_deg()[axis]
        directions = [f"{angle:.2f}" for angle in angles]
        yield [name, unit, bias_text, _or_none(sem), scale, _or_none(response), *directions, _or_none(noise)]


def _slopes(calibration: Calibration) -> Iterator[list[str]]:
    for sensor, axis, name, unit, per_count in readable_axes(calibration):
        if (thermal := sensor.thermal) is not None:
            slope, sem = thermal.slope_lsb_per_degc[axis], thermal.slope_sem_lsb_per_degc[axis]
            figures = [f"{per_count * slope:.4f}", f"{per_count * sem:.4f}", f"{thermal.significant_lag_s:.0f}"]
            yield [name, unit, *figures, thermal.thermometer, thermal.meaning[axis]]


def _turn_on(calibration: Calibration) -> Iterator[list[str]]:
    for sensor, axis, name, unit, per_count in readable_axes(calibration):
        if (turn_on := sensor.turn_on) is not None:
            rms, sem = per_count * turn_on.rms_lsb[axis], per_count * turn_on.rms_sem_lsb[axis]
            p_value, states = turn_on.p_value[axis], str(max(1, len(turn_on.states)))
            chance = "–" if np.isnan(p_value) else f"{p_value:.2g}"
            yield [name, unit, f"{rms:.4f}", f"{sem:.4f}", chance, str(turn_on.runs), states]


def _or_none(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def residual_section(log: Log, calibration: Calibration, *, with_figures: bool) -> Section | None:
    """Return the residuals of each accelerometer, the calibrated specific force less 1 g in each pose of the log; None
    for fewer than four poses.
    """
    sensors = [sensor for sensor in log.of("specific_force") if sensor.name in calibration.sensors]
    try:
        poses = named_faces(log) or (find_poses(log) if sensors else [])
    except CalibrationError:
        return None
    if not sensors or len(poses) < _FEWEST:
        return None
    residual_mg = np.full((len(sensors), len(poses)), np.nan)
    for row, sensor in enumerate(sensors):
        sensor_calibration = calibration.of(sensor)
        for column, pose in enumerate(poses):
            try:
                force = sensor_calibration.stimulus_box(read_pose(sensor, pose).mean_lsb[None])[0]
            except CalibrationError:
                continue
            residual_mg[row, column] = 1e3 * (np.linalg.norm(force) / STANDARD_GRAVITY - 1)
    names, labels = [sensor.name for sensor in sensors], [pose.phase.name for pose in poses]
    rms = np.sqrt(np.nanmean(residual_mg**2, axis=1))
    table = np.column_stack([residual_mg, rms])
    if len(labels) > _WIDEST:  # a column for each sensor, so that the page holds all poses
        heading, labelled = ["pose", *names], list(zip([*labels, "rms"], table.T, strict=True))
    else:
        heading, labelled = ["sensor", *labels, "rms"], list(zip(names, table, strict=True))
    rows = [[name, *(f"{value:.2f}" for value in row)] for name, row in labelled]
    words = "At rest the specific force has a length of 1 g in any attitude. The figure shows the deviation, in mg."
    caption = (
        "All values should be near zero. A pose that is off in all sensors was disturbed; a sensor that"
        " is off has an error."
    )
    parts: list[Table | Figure] = []
    if with_figures:
        drawing = residual_figure(names, labels, residual_mg)
        parts.append(Figure(drawing, caption, f"Residuals of {len(names)} accelerometers in {len(labels)} poses"))
    parts.append(Table(heading, rows, caption if not with_figures else "The same values in numbers, mg."))
    return Section(f"{log.path.name}: residuals of the calibration", words, parts)
