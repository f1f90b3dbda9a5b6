"""Table 1 against Table 10: which way every triad points, and whether such a triad can exist.

Table 1 names, for each box axis, the sensor axis along it. The three names make a signed permutation; its determinant
is +1 for a right-handed triad, the only kind that is sold, and -1 for a mirrored one. For accelerometers Table 10
tells the same independently: each channel's largest response. Nothing in Table 10 tells it for gyroscopes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from imuarray.paper.accelerometers import main_axis, response_of
from imuarray.paper.cells import RecomputedRow, text_cell
from imuarray.paper.tables import Row, design_of, table

BoxAxes = Mapping[str, str]
"""For each sensor axis "x", "y", "z" the box axis that it points along, such as "-Y"."""

_COLUMNS = {"X": "box_plus_x", "Y": "box_plus_y", "Z": "box_plus_z"}


def printed_axes(row: Row) -> dict[str, str]:
    """Where Table 1 says that a sensor's x, y and z point in the box."""
    named = {row[column][1].lower(): row[column][0] + box for box, column in _COLUMNS.items()}
    return {axis: named[axis] for axis in "xyz"}


def measured_axes(sensor: str) -> dict[str, str]:
    """Where Table 10's largest responses say that an accelerometer's x, y and z point in the box."""
    return {axis: main_axis(response_of(f"{sensor} {axis}")) for axis in "xyz"}


def determinant(axes: BoxAxes) -> int:
    """+1 for a right-handed triad, -1 for a mirrored one; the three box axes must differ."""
    order = ["XYZ".index(axes[axis][1]) for axis in "xyz"]
    inversions = sum(order[i] > order[j] for i in range(3) for j in range(i + 1, 3))
    minus_signs = sum(axes[axis][0] == "-" for axis in "xyz")
    return -1 if (inversions + minus_signs) % 2 else 1


def believed_axes(sensor: str) -> dict[str, str]:
    """Measured directions for an accelerometer, Table 1's for a gyroscope."""
    if design_of(sensor) == "Gyro":
        return printed_axes(next(row for row in table(1) if row["sensor"] == sensor))
    return measured_axes(sensor)


def as_text(axes: BoxAxes) -> str:
    """Directions as a configuration spells them, "+Y+X-Z": the box axes of x, y and z."""
    return "".join(axes[axis] for axis in "xyz")


def _recomputed(row: Row) -> RecomputedRow:
    axes = believed_axes(row["sensor"])
    extra: dict[str, Any] = {
        "axes": as_text(axes),
        "determinant": determinant(axes),
        "printed_determinant": determinant(printed_axes(row)),
    }
    if design_of(row["sensor"]) == "Gyro":
        return RecomputedRow(row, (), extra)
    along = {box[1]: box[0] + axis.upper() for axis, box in axes.items()}
    return RecomputedRow(row, tuple(text_cell(row, column, along[box]) for box, column in _COLUMNS.items()), extra)


def table1() -> tuple[RecomputedRow, ...]:
    """Table 1 with the accelerometers' axes recomputed from Table 10, and the determinants before and after."""
    return tuple(_recomputed(row) for row in table(1))


def mirrored() -> tuple[RecomputedRow, ...]:
    """The rows of Table 1 that, as printed, describe a left-handed triad."""
    return tuple(row for row in table1() if row.extra["printed_determinant"] < 0)
