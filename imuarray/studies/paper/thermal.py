"""Table 8: what is left of the temperature drift when two sensors of one design and range are averaged along a box
axis.

Bringing a reading into the box frame multiplies it by the sign s of its axis there, so the mean of two drifts with
(s1 k1 + s2 k2) / 2. Parallel axes keep a drift that both share, opposed axes cancel it, and it is the other way round
for drifts of opposite sign. Directions are those of Table 10's responses for accelerometers and of Table 1 for
gyroscopes.

During the heating +Z was up: an accelerometer axis along box Z carried 1 g, so its slope mixes bias and scale-factor
drift, and neither can be told from this one orientation (`carries_1g`).
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from itertools import combinations
from typing import Any

from imuarray.studies.paper.systematic import believed_axes
from imuarray.studies.paper.tables import RecomputedRow, Row, channels, design_of, mean, number_in, physical, table


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
        """Return whether gravity lay along the pair while it was heated (accelerometers along box Z)."""
        return design_of(self.first["channel"]) != "Gyro" and self.axis_first[1] == "Z"

    @property
    def slopes(self) -> tuple[Decimal, Decimal]:
        """The two printed slopes, counts per degree Celsius, sensor axes."""
        return number_in(self.first, "slope_lsb_per_degc"), number_in(self.second, "slope_lsb_per_degc")

    @property
    def fused_slope(self) -> Decimal:
        """Slope of the mean of the two along the positive box axis, counts per degree Celsius."""
        first, second = self.slopes
        return (_signed(self.axis_first, first) + _signed(self.axis_second, second)) / 2

    @property
    def turned_slope(self) -> Decimal:
        """The same had the second sensor been mounted the other way round."""
        first, second = self.slopes
        return (_signed(self.axis_first, first) - _signed(self.axis_second, second)) / 2

    @property
    def reduction(self) -> Decimal:
        """Return how many times less the mean drifts than a single sensor does (mean of the two magnitudes)."""
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


def _signed(axis: str, slope: Decimal) -> Decimal:
    return -slope if axis[0] == "-" else slope


def _pair(first: Row, second: Row) -> AxisPair | None:
    (sensor_first, axis), (sensor_second, other) = first["channel"].split(), second["channel"].split()
    same_kind = design_of(sensor_first) == design_of(sensor_second) and first["range"] == second["range"]
    if not same_kind or axis != other:
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
    """Printed slopes of one design in counts per degree Celsius, Table 8's order."""
    return tuple(number_in(row, "slope_lsb_per_degc") for row in channels(8, design, range_name, axes))


def table8() -> tuple[RecomputedRow, ...]:
    """Table 8 with each slope in physical units (typical sensitivity) and the channel's box axis."""
    return tuple(RecomputedRow(row, (), _extra(row)) for row in table(8))


def _extra(row: Row) -> dict[str, Any]:
    sensor, axis = row["channel"].split()
    slope = round(float(physical(row, number_in(row, "slope_lsb_per_degc"))), 6)
    unit = "dps" if design_of(sensor) == "Gyro" else "mg"
    return {"main_axis": believed_axes(sensor)[axis], "slope_per_degc": slope, "unit": unit}
