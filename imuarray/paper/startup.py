"""Tables 6 and 7: which run came up in the wrong range, and which runs came up in which of two bias states.

Boot fault (Table 6). The channel that carries gravity is the one with the largest median over the runs. Each run's
reading over that median, times the configured sensitivity, is the sensitivity that the run appears to have had; the
nearest of the chip's ranges (nearest in ratio) is the range it was really in. A run is faulty when that is not the
configured range, so the threshold is the chip's own range table and not a number chosen here.

Two states (Table 7). The three axes are taken together: runs are sorted along the principal axis of their scatter and
cut at the place that leaves the least scatter within the two parts, over all three axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from math import dist, log, sqrt
from statistics import fmean, median, stdev
from typing import Any

from imuarray.paper.cells import RecomputedRow
from imuarray.paper.tables import BMA180_LSB_PER_G, Row, number_in, table

_AXES = ("x_lsb", "y_lsb", "z_lsb")
_CONFIGURED_RANGE = "16g"
_POWER_STEPS = 50

Point = tuple[float, ...]
"""The mean counts of x, y, z over one run."""


@dataclass(frozen=True)
class BootFault:
    """A run whose gravity reading belongs to another range than the configured one."""

    run: int
    column: str
    reading_lsb: Decimal
    ratio: Decimal
    """Reading over the median of all runs."""
    range_g: str
    range_lsb_per_g: Decimal

    def as_json(self) -> dict[str, Any]:
        """The fault with the ratio that the range it was in would give exactly."""
        return {
            "sensor": "BMA1",
            "run": self.run,
            "column": self.column,
            "reading_lsb": float(self.reading_lsb),
            "ratio": round(float(self.ratio), 3),
            "nearest_range": self.range_g,
            "nearest_range_lsb_per_g": int(self.range_lsb_per_g),
            "nearest_range_ratio": float(self.range_lsb_per_g / BMA180_LSB_PER_G[_CONFIGURED_RANGE]),
            "configured_range": _CONFIGURED_RANGE,
        }


def gravity_column(rows: Sequence[Row]) -> str:
    """The column with the largest median: the axis that carries 1 g."""
    return max(_AXES, key=lambda column: abs(median(number_in(row, column) for row in rows)))


def nearest_range(lsb_per_g: Decimal) -> str:
    """The BMA180 range whose sensitivity is nearest in ratio to a positive sensitivity in counts per g."""
    return min(BMA180_LSB_PER_G, key=lambda name: abs(log(lsb_per_g / BMA180_LSB_PER_G[name])))


def _ratio(row: Row) -> Decimal:
    column = gravity_column(table(6))
    return number_in(row, column) / median(number_in(other, column) for other in table(6))


def _range_of(row: Row) -> str:
    return nearest_range(_ratio(row) * BMA180_LSB_PER_G[_CONFIGURED_RANGE])


def boot_faults() -> tuple[BootFault, ...]:
    """The runs of Table 6 (BMA1) that were not in the configured range."""
    column = gravity_column(table(6))
    return tuple(
        BootFault(int(row["run"]), column, number_in(row, column), _ratio(row), name, BMA180_LSB_PER_G[name])
        for row in table(6)
        if (name := _range_of(row)) != _CONFIGURED_RANGE
    )


def table6() -> tuple[RecomputedRow, ...]:
    """Table 6 with each run's gravity reading over the median, and the range that this belongs to."""
    return tuple(
        RecomputedRow(row, (), {"ratio_to_median": round(float(_ratio(row)), 4), "nearest_range": _range_of(row)})
        for row in table(6)
    )


@dataclass(frozen=True)
class BiasState:
    """One of the states that a sensor comes up in: its runs, their centre and their spread, in counts."""

    runs: tuple[int, ...]
    centre: Point
    spread: Point
    """Sample standard deviation of the runs' means, per axis."""

    def as_json(self) -> dict[str, Any]:
        """The state with its numbers rounded to a thousandth of a count."""
        return {
            "runs": list(self.runs),
            "centre_lsb": [round(value, 3) for value in self.centre],
            "spread_lsb": [round(value, 3) for value in self.spread],
        }


def principal_axis(points: Sequence[Point]) -> Point:
    """The unit vector along which points scatter most (power iteration on their scatter matrix)."""
    centre = _centre(points)
    offsets = [tuple(value - mid for value, mid in zip(point, centre, strict=True)) for point in points]
    vector: Point = max(offsets, key=lambda offset: dist(offset, (0.0,) * len(offset)))
    for _ in range(_POWER_STEPS):
        weights = [_dot(offset, vector) for offset in offsets]
        pulled = [_dot(weights, column) for column in zip(*offsets, strict=True)]
        length = sqrt(_dot(pulled, pulled)) or 1.0
        vector = tuple(value / length for value in pulled)
    return vector


def two_way_split(points: Sequence[Point]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Indices of the two groups, of two points at least, with the least squared scatter within (module docstring)."""
    axis = principal_axis(points)
    order = sorted(range(len(points)), key=lambda i: _dot(points[i], axis))
    cuts = range(2, len(points) - 1)
    best = min(cuts, key=lambda cut: sum(_scatter([points[i] for i in part]) for part in (order[:cut], order[cut:])))
    return tuple(sorted(order[:best])), tuple(sorted(order[best:]))


def bias_states() -> tuple[BiasState, BiasState]:
    """The two bias states of Table 7 (Gyro3), the one of the first run first."""
    points = [tuple(float(row[column]) for column in _AXES) for row in table(7)]
    first, second = sorted(two_way_split(points))
    return _state(first, points), _state(second, points)


def separation(states: tuple[BiasState, BiasState]) -> float:
    """Distance between two states' centres over the larger of their spreads (root sum of squares over the axes)."""
    spreads = [sqrt(_dot(state.spread, state.spread)) for state in states]
    return dist(states[0].centre, states[1].centre) / max(spreads)


def table7() -> tuple[RecomputedRow, ...]:
    """Table 7 with the state that each run came up in: 1 for the first run's state, 2 for the other."""
    first, _ = bias_states()
    return tuple(RecomputedRow(row, (), {"state": 1 if int(row["run"]) in first.runs else 2}) for row in table(7))


def _state(indices: Sequence[int], points: Sequence[Point]) -> BiasState:
    members = [points[i] for i in indices]
    spread = tuple(stdev(column) for column in zip(*members, strict=True))
    return BiasState(tuple(int(table(7)[i]["run"]) for i in indices), _centre(members), spread)


def _centre(points: Sequence[Point]) -> Point:
    return tuple(fmean(column) for column in zip(*points, strict=True))


def _scatter(points: Sequence[Point]) -> float:
    centre = _centre(points)
    return sum(dist(point, centre) ** 2 for point in points)


def _dot(left: Sequence[float], right: Sequence[float]) -> float:
    return sum(a * b for a, b in zip(left, right, strict=True))
