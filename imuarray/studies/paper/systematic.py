"""Systematic errors: Tables 1, 3 and 4 from Table 10, Tables 2 and 9 in degrees per second, Appendix B, and Table 8.

Table 1 names, for each box axis, the sensor axis along it. The three names make a signed permutation; its determinant
is +1 for a right-handed triad, the only kind that is sold, and -1 for a mirrored one. For accelerometers Table 10 gives
the same information independently, by each channel's largest response. For gyroscopes Table 10 has no such information.

Table 3 has bias, scale factor and direction of every accelerometer axis, from six faces of a box. Up and down readings
of a face differ by 2 g along that box axis, so half their difference is the response in counts per g along it; the
three responses are the sensitivity vector of the axis in the box frame. Its norm is the scale factor, its direction the
sensitive axis. The bias is the mean of the six faces (section 5.2.1, Appendix B). The printed scale factor is that norm
with the sign of the half-difference along box X, regardless of the axis along which the sensor points; this rule was
determined by trial. The true sign is that of the main axis, which is given here as an extra column.

The bias of Table 4, unlike that of Table 3, is the mean of all seven readings, including the repeated first face. Its
differences are up minus down, and its drift is first minus last. Here and in the degrees per second of Tables 2 and 9
the sensitivities are the typical ones, 0.07 and 0.00875 dps per count (L3G-40, L3G-42).

Appendix B turns the three half-differences of a channel into azimuth, elevation and a scale factor averaged over the
six faces. It has two slips: the quotient of the azimuth is inverted, and the factor cos(azimuth), which belongs to the
first of the six terms, is in the third. The formulas are evaluated as printed and with each slip corrected, to
determine which form reproduces Table 3.

Table 8 determines the temperature drift that remains when two sensors of one design and range are averaged along a box
axis. The transformation of a reading to the box frame multiplies it by the sign s of its axis, so the mean of the two
drifts with (s1 k1 + s2 k2) / 2. A drift with the same sign in both sensors remains for parallel axes and cancels for
opposed axes; for drifts of opposite sign the reverse is true. Directions are those of Table 10's responses for
accelerometers and of Table 1 for gyroscopes. During the heating +Z was up: an accelerometer axis along box Z measured 1
g, so its slope is the sum of bias drift and scale-factor drift, which one orientation cannot separate (`carries_1g`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import combinations
from math import atan, atan2, cos, degrees, hypot, sin
from typing import Any

from imuarray.studies.paper.tables import (
    Cell,
    RecomputedRow,
    Row,
    channels,
    design_of,
    dps,
    is_inertial,
    mean,
    milli_g,
    number_in,
    numbers_in,
    numeric_cell,
    physical,
    row_of,
    table,
    text_cell,
)

READINGS = ("z_up", "x_up", "y_up", "x_down", "y_down", "z_down", "z_up_check")
"""Table 10's reading columns in the order in which the faces were turned up."""

Response = tuple[Decimal, Decimal, Decimal]
"""Half-differences along box X, Y, Z in counts per g."""


def half_differences(readings: Sequence[Decimal]) -> Response:
    """Return (up - down) / 2 along box X, Y, Z from readings in the order of `READINGS`, in counts per g."""
    z_up, x_up, y_up, x_down, y_down, z_down = readings[:6]
    return (x_up - x_down) / 2, (y_up - y_down) / 2, (z_up - z_down) / 2


def response_of(channel: str) -> Response:
    """Return the response of an accelerometer axis such as "BMA2 y" in the box frame, counts per g."""
    return half_differences(numbers_in(row_of(10, channel), READINGS))


def main_axis(response: Response) -> str:
    """Return the box axis that is nearest to a sensitive axis, with its sign: "-Y"."""
    size, letter = max(zip(response, "XYZ", strict=True), key=lambda item: abs(item[0]))
    return ("+" if size > 0 else "-") + letter


def six_face_bias(readings: Sequence[Decimal]) -> Decimal:
    """Return the mean of the six faces in counts, without the repeated first face."""
    return mean(readings[:6])


def check_drift(readings: Sequence[Decimal]) -> Decimal:
    """Return the first minus the last reading, both with +Z up, in counts."""
    return readings[0] - readings[6]


def norm(response: Response) -> Decimal:
    """Return the scale factor without a sign, in counts per g."""
    return sum((part * part for part in response), Decimal(0)).sqrt()


def printed_scale(readings: Sequence[Decimal]) -> Decimal:
    """Return the scale factor with the sign that the paper assigns to it: that of the half-difference along box X."""
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
    response = half_differences(readings)
    along_x, along_y, along_z = (float(part) for part in response)
    return RecomputedRow(
        row,
        cells,
        {
            "response_lsb_per_g": [round(along_x, 4), round(along_y, 4), round(along_z, 4)],
            "main_axis": main_axis(response),
            "azimuth_deg": round(degrees(atan2(along_y, along_x)), 3),
            "elevation_deg": round(degrees(atan2(along_z, hypot(along_x, along_y))), 3),
        },
    )


def table3() -> tuple[RecomputedRow, ...]:
    """Return Table 3 with all columns recomputed, and each axis' response, main axis, azimuth and elevation."""
    return tuple(_row(row) for row in table(3))


BoxAxes = Mapping[str, str]
"""For each sensor axis "x", "y", "z", the box axis along which it points, such as "-Y"."""

_COLUMNS = {"X": "box_plus_x", "Y": "box_plus_y", "Z": "box_plus_z"}


def printed_axes(row: Row) -> dict[str, str]:
    """Return the directions of a sensor's x, y and z in the box by Table 1."""
    named = {row[column][1].lower(): row[column][0] + box for box, column in _COLUMNS.items()}
    return {axis: named[axis] for axis in "xyz"}


def measured_axes(sensor: str) -> dict[str, str]:
    """Return the directions of an accelerometer's x, y and z in the box by the largest responses of Table 10."""
    return {axis: main_axis(response_of(f"{sensor} {axis}")) for axis in "xyz"}


def determinant(axes: BoxAxes) -> int:
    """Return +1 for a right-handed triad, -1 for a mirrored one; the three box axes must differ."""
    order = ["XYZ".index(axes[axis][1]) for axis in "xyz"]
    inversions = sum(order[i] > order[j] for i in range(3) for j in range(i + 1, 3))
    minus_signs = sum(axes[axis][0] == "-" for axis in "xyz")
    return -1 if (inversions + minus_signs) % 2 else 1


def believed_axes(sensor: str) -> dict[str, str]:
    """Return the measured directions for an accelerometer, those of Table 1 for a gyroscope."""
    if design_of(sensor) == "Gyro":
        return printed_axes(next(row for row in table(1) if row["sensor"] == sensor))
    return measured_axes(sensor)


def as_text(axes: BoxAxes) -> str:
    """Return the directions in the form of a configuration, "+Y+X-Z": the box axes of x, y and z."""
    return "".join(axes[axis] for axis in "xyz")


def _recompute(row: Row) -> RecomputedRow:
    axes = believed_axes(row["sensor"])
    extra: dict[str, Any] = {
        "axes": as_text(axes),
        "determinant": determinant(axes),
        "printed_determinant": determinant(printed_axes(row)),
    }
    if design_of(row["sensor"]) == "Gyro":
        return RecomputedRow(row, (), extra)
    directions = {box[1]: box[0] + axis.upper() for axis, box in axes.items()}
    return RecomputedRow(row, tuple(text_cell(row, column, directions[box]) for box, column in _COLUMNS.items()), extra)


def table1() -> tuple[RecomputedRow, ...]:
    """Return Table 1 with the accelerometers' axes recomputed from Table 10, and the determinants before and after."""
    return tuple(_recompute(row) for row in table(1))


def mirrored() -> tuple[RecomputedRow, ...]:
    """Return the rows of Table 1 that, as printed, describe a left-handed triad."""
    return tuple(row for row in table1() if row.extra["printed_determinant"] < 0)


def _up_minus_down(axis: str) -> Callable[[Sequence[Decimal]], Decimal]:
    up, down = READINGS.index(f"{axis}_up"), READINGS.index(f"{axis}_down")
    return lambda readings: readings[up] - readings[down]


_TABLE_4: dict[str, Callable[[Sequence[Decimal]], Decimal]] = {
    "bias": mean,
    "dbias_x": _up_minus_down("x"),
    "dbias_y": _up_minus_down("y"),
    "dbias_z": _up_minus_down("z"),
    "drift": check_drift,
}
"""Table 4's quantities (columns without `_lsb` or `_dps`) from the seven readings of Table 10."""


def _both_units(row: Row, quantity: str) -> tuple[Cell, Cell]:
    readings = numbers_in(row_of(10, row["channel"]), READINGS)
    formula = _TABLE_4[quantity]
    return (
        numeric_cell(row, f"{quantity}_lsb", formula, readings),
        numeric_cell(row, f"{quantity}_dps", lambda inputs: dps(row["range"], formula(inputs)), readings),
    )


def table4() -> tuple[RecomputedRow, ...]:
    """Return Table 4 with all ten columns recomputed from Table 10."""
    return tuple(
        RecomputedRow(row, tuple(cell for quantity in _TABLE_4 for cell in _both_units(row, quantity)))
        for row in table(4)
    )


def _dps_cells(row: Row, quantities: Sequence[str]) -> tuple[Cell, ...]:
    if not is_inertial(row):
        return ()
    return tuple(
        numeric_cell(
            row, f"{quantity}_dps", lambda inputs: dps(row["range"], inputs[0]), [number_in(row, f"{quantity}_lsb")]
        )
        for quantity in quantities
    )


def table2() -> tuple[RecomputedRow, ...]:
    """Return Table 2 with its dps columns recomputed from its counts."""
    return tuple(RecomputedRow(row, _dps_cells(row, ("mean", "std"))) for row in table(2))


def table9() -> tuple[RecomputedRow, ...]:
    """Return Table 9 with its dps columns recomputed; `samples` are the readings that its standard errors imply."""
    return tuple(
        RecomputedRow(
            row,
            _dps_cells(row, ("mean", "sem", "std")),
            {"samples": round((number_in(row, "std_lsb") / number_in(row, "sem_lsb")) ** 2)},
        )
        for row in table(9)
    )


_LAST_DIGIT = 0.01
"""One unit of the last digit of Table 3's scale factors, in counts per g."""


def azimuth(readings: Sequence[Decimal], *, quotient_corrected: bool) -> float:
    """Return the azimuth in radians: arctan(f_x / f_y) as printed, arctan(f_y / f_x) corrected (still without a
    quadrant).
    """
    along_x, along_y, _ = (float(part) for part in half_differences(readings))
    return atan(along_y / along_x) if quotient_corrected else atan(along_x / along_y)


def scale_factor(readings: Sequence[Decimal], *, quotient_corrected: bool, sum_corrected: bool) -> float:
    """Return Appendix B's scale factor in counts per g, with each slip corrected or not."""
    along_x, along_y, along_z = (float(part) for part in half_differences(readings))
    turn = azimuth(readings, quotient_corrected=quotient_corrected)
    lift = atan(2 * along_z / (along_x / cos(turn) + along_y / sin(turn)))
    bias = six_face_bias(readings)
    z_up, x_up, y_up, x_down, y_down, z_down = (float(reading - bias) for reading in readings[:6])
    first, third = (cos(turn), 1.0) if sum_corrected else (1.0, cos(turn))
    x_terms = (x_up / first - x_down / cos(turn)) / cos(lift)
    y_terms = (y_up - y_down) / (cos(lift) * sin(turn))
    z_terms = (z_up / third - z_down) / sin(lift)
    return (x_terms + y_terms + z_terms) / 6


def count_reproductions(*, quotient_corrected: bool, sum_corrected: bool) -> int:
    """Return the number of Table 3's scale factors that this form reproduces to one unit of the last digit."""
    count = 0
    for row in table(3):
        readings = numbers_in(row_of(10, row["channel"]), READINGS)
        value = scale_factor(readings, quotient_corrected=quotient_corrected, sum_corrected=sum_corrected)
        count += round(abs(value - float(number_in(row, "scale_lsb_per_g"))), 4) <= _LAST_DIGIT
    return count


def printed_azimuth_deg(channel: str) -> float:
    """Return the azimuth in degrees that Appendix B's formula, as printed, gives for a channel."""
    return degrees(azimuth(numbers_in(row_of(10, channel), READINGS), quotient_corrected=False))


@dataclass(frozen=True)
class AxisPair:
    """The same-named axes of two sensors of one design and range that lie along the same box axis."""

    first: Row
    second: Row
    axis_first: str
    """Box axis with sign, such as "+Y"."""
    axis_second: str

    @property
    def opposed(self) -> bool:
        """Return whether the two axes point in opposite directions."""
        return self.axis_first[0] != self.axis_second[0]

    @property
    def carries_1g(self) -> bool:
        """Return whether gravity was along the pair while it was heated (accelerometers along box Z)."""
        return design_of(self.first["channel"]) != "Gyro" and self.axis_first[1] == "Z"

    @property
    def slopes(self) -> tuple[Decimal, Decimal]:
        """The two printed slopes, counts per degree Celsius, sensor axes."""
        return number_in(self.first, "slope_lsb_per_degc"), number_in(self.second, "slope_lsb_per_degc")

    @property
    def fused_slope(self) -> Decimal:
        """The slope of the mean of the two along the positive box axis, in counts per degree Celsius."""
        first, second = self.slopes
        return (_sign_slope(self.axis_first, first) + _sign_slope(self.axis_second, second)) / 2

    @property
    def turned_slope(self) -> Decimal:
        """The same slope if the second sensor were mounted in the opposite direction."""
        first, second = self.slopes
        return (_sign_slope(self.axis_first, first) - _sign_slope(self.axis_second, second)) / 2

    @property
    def reduction(self) -> Decimal:
        """Return the ratio of the drift of a single sensor (mean of the two magnitudes) to the drift of the mean."""
        return mean([abs(slope) for slope in self.slopes]) / abs(self.fused_slope)

    def as_json(self) -> dict[str, Any]:
        """Return the pair with its slopes in counts and in mg or dps per degree Celsius."""
        unit = "dps" if design_of(self.first["channel"]) == "Gyro" else "mg"
        first, second = self.slopes
        return {
            "first": self.first["channel"],
            "second": self.second["channel"],
            "range": self.first["range"],
            "box_axis": self.axis_first[1],
            "relation": "opposed" if self.opposed else "parallel",
            "carries_1g": self.carries_1g,
            "slope_first_lsb_per_degc": float(first),
            "slope_second_lsb_per_degc": float(second),
            "fused_slope_lsb_per_degc": float(self.fused_slope),
            "fused_slope_if_turned_lsb_per_degc": float(self.turned_slope),
            "reduction": round(float(self.reduction), 2),
            "fused_slope_per_degc": round(float(physical(self.first, self.fused_slope)), 6),
            "unit": unit,
        }


def _sign_slope(axis: str, slope: Decimal) -> Decimal:
    return -slope if axis[0] == "-" else slope


def _pair(first: Row, second: Row) -> AxisPair | None:
    (sensor_first, axis), (sensor_second, second_axis) = first["channel"].split(), second["channel"].split()
    same_kind = design_of(sensor_first) == design_of(sensor_second) and first["range"] == second["range"]
    if not same_kind or axis != second_axis:
        return None
    along_first, along_second = believed_axes(sensor_first)[axis], believed_axes(sensor_second)[axis]
    return AxisPair(first, second, along_first, along_second) if along_first[1] == along_second[1] else None


def pairs() -> tuple[AxisPair, ...]:
    """Return every pair of Table 8's axes of the same design, range, axis name and box axis."""
    result = (_pair(first, second) for first, second in combinations(table(8), 2))
    return tuple(pair for pair in result if pair is not None)


def pair_of(first: str, second: str) -> AxisPair:
    """Return the pair of two channels such as "Gyro1 y" and "Gyro2 y"."""
    return next(pair for pair in pairs() if (pair.first["channel"], pair.second["channel"]) == (first, second))


def slopes(design: str, range_name: str | None = None, axes: str = "xyz") -> tuple[Decimal, ...]:
    """Return the printed slopes of one design in counts per degree Celsius, in the order of Table 8."""
    return tuple(number_in(row, "slope_lsb_per_degc") for row in channels(8, design, range_name, axes))


def table8() -> tuple[RecomputedRow, ...]:
    """Return Table 8 with each slope in physical units (typical sensitivity) and the channel's box axis."""
    return tuple(RecomputedRow(row, (), _extra(row)) for row in table(8))


def _extra(row: Row) -> dict[str, Any]:
    sensor, axis = row["channel"].split()
    slope = round(float(physical(row, number_in(row, "slope_lsb_per_degc"))), 6)
    unit = "dps" if design_of(sensor) == "Gyro" else "mg"
    return {"main_axis": believed_axes(sensor)[axis], "slope_per_degc": slope, "unit": unit}
