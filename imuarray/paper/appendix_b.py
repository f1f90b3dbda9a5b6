"""Appendix B evaluated as it is printed, and with its slips mended, one at a time.

The appendix turns the three half-differences of a channel into azimuth, elevation and a scale factor averaged over
the six faces. Two slips stand in it: the azimuth's quotient is upside down, and the factor cos(azimuth) of the first
term of the six belongs to it but stands in the third. Both are switches here, so that it can be counted which form
made Table 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
from math import atan, cos, degrees, sin

from imuarray.paper.accelerometers import READINGS, half_differences, six_face_bias
from imuarray.paper.tables import number_in, numbers_in, row_of, table

_LAST_DIGIT = 0.01
"""One unit of the last digit of Table 3's scale factors, in counts per g."""


def azimuth(readings: Sequence[Decimal], *, quotient_mended: bool) -> float:
    """Azimuth in radians: arctan(f_x / f_y) as printed, arctan(f_y / f_x) mended (still without a quadrant)."""
    along_x, along_y, _ = (float(part) for part in half_differences(readings))
    return atan(along_y / along_x) if quotient_mended else atan(along_x / along_y)


def scale_factor(readings: Sequence[Decimal], *, quotient_mended: bool, sum_mended: bool) -> float:
    """Appendix B's scale factor in counts per g, with either slip mended or left in."""
    along_x, along_y, along_z = (float(part) for part in half_differences(readings))
    turn = azimuth(readings, quotient_mended=quotient_mended)
    lift = atan(2 * along_z / (along_x / cos(turn) + along_y / sin(turn)))
    bias = six_face_bias(readings)
    z_up, x_up, y_up, x_down, y_down, z_down = (float(reading - bias) for reading in readings[:6])
    first, third = (cos(turn), 1.0) if sum_mended else (1.0, cos(turn))
    x_terms = (x_up / first - x_down / cos(turn)) / cos(lift)
    y_terms = (y_up - y_down) / (cos(lift) * sin(turn))
    z_terms = (z_up / third - z_down) / sin(lift)
    return (x_terms + y_terms + z_terms) / 6


def reproduced(*, quotient_mended: bool, sum_mended: bool) -> int:
    """How many of Table 3's scale factors this form gives to within one unit of the last printed digit."""
    count = 0
    for row in table(3):
        readings = numbers_in(row_of(10, row["channel"]), READINGS)
        value = scale_factor(readings, quotient_mended=quotient_mended, sum_mended=sum_mended)
        count += round(abs(value - float(number_in(row, "scale_lsb_per_g"))), 4) <= _LAST_DIGIT
    return count


def printed_azimuth_deg(channel: str) -> float:
    """The azimuth in degrees that Appendix B's formula, as printed, gives for a channel."""
    return degrees(azimuth(numbers_in(row_of(10, channel), READINGS), quotient_mended=False))
