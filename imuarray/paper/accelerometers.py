"""Table 3 from Table 10: bias, scale factor and direction of every accelerometer axis, from six faces of a box.

Up and down readings of a face differ by 2 g along that box axis, so half their difference is the response in counts
per g along it; the three of them are the axis' sensitivity vector in the box frame. Its norm is the scale factor, its
direction the sensitive axis. The bias is the mean of the six faces (section 5.2.1, Appendix B).

Found by trying: the printed scale factor is that norm with the sign of the half-difference along box X, whatever axis
the sensor points along. The true sign is that of the main axis, given here as an extra column.
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
from math import atan2, degrees, hypot
from typing import Any

from imuarray.paper.cells import RecomputedRow, numeric_cell
from imuarray.paper.tables import Row, mean, milli_g, number_in, numbers_in, row_of, table

READINGS = ("z_up", "x_up", "y_up", "x_down", "y_down", "z_down", "z_up_check")
"""Table 10's reading columns in the order in which the faces were turned up."""

Response = tuple[Decimal, Decimal, Decimal]
"""Half-differences along box X, Y, Z in counts per g."""


def half_differences(readings: Sequence[Decimal]) -> Response:
    """(up - down) / 2 along box X, Y, Z from readings in the order of `READINGS`, in counts per g."""
    z_up, x_up, y_up, x_down, y_down, z_down = readings[:6]
    return (x_up - x_down) / 2, (y_up - y_down) / 2, (z_up - z_down) / 2


def response_of(channel: str) -> Response:
    """The response of an accelerometer axis such as "BMA2 y" in the box frame, counts per g."""
    return half_differences(numbers_in(row_of(10, channel), READINGS))


def main_axis(response: Response) -> str:
    """The box axis that a sensitive axis is nearest to, with its sign: "-Y"."""
    size, letter = max(zip(response, "XYZ", strict=True), key=lambda item: abs(item[0]))
    return ("+" if size > 0 else "-") + letter


def six_face_bias(readings: Sequence[Decimal]) -> Decimal:
    """Mean of the six faces, the repeated first face left out, in counts."""
    return mean(readings[:6])


def check_drift(readings: Sequence[Decimal]) -> Decimal:
    """First minus last reading, both with +Z up, in counts."""
    return readings[0] - readings[6]


def norm(response: Response) -> Decimal:
    """The scale factor without a sign, in counts per g."""
    return sum((part * part for part in response), Decimal(0)).sqrt()


def printed_scale(readings: Sequence[Decimal]) -> Decimal:
    """The scale factor with the sign that the paper gives it: that of the half-difference along box X."""
    response = half_differences(readings)
    return norm(response).copy_sign(response[0])


def _row(row: Row) -> RecomputedRow:
    measured = row_of(10, row["channel"])
    readings = numbers_in(measured, READINGS)
    cells = (
        numeric_cell(row, "drift_lsb", check_drift, readings),
        numeric_cell(row, "sem_lsb", lambda inputs: inputs[0], [number_in(measured, "sem_lsb")]),
        numeric_cell(row, "bias_lsb", six_face_bias, readings),
        numeric_cell(row, "bias_mg", lambda inputs: milli_g(row, six_face_bias(inputs)), readings),
        numeric_cell(row, "scale_lsb_per_g", printed_scale, readings),
    )
    return RecomputedRow(row, cells, _direction(half_differences(readings)))


def _direction(response: Response) -> dict[str, Any]:
    along_x, along_y, along_z = (float(part) for part in response)
    return {
        "response_lsb_per_g": [round(along_x, 4), round(along_y, 4), round(along_z, 4)],
        "main_axis": main_axis(response),
        "azimuth_deg": round(degrees(atan2(along_y, along_x)), 3),
        "elevation_deg": round(degrees(atan2(along_z, hypot(along_x, along_y))), 3),
    }


def table3() -> tuple[RecomputedRow, ...]:
    """Table 3 with all five columns recomputed, and each axis' response, main axis, azimuth and elevation added."""
    return tuple(_row(row) for row in table(3))
